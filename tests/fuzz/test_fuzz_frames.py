"""A million valid, damaged and random frames, three times, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FLAGS = (
    "-std=c11 -O2 -g -ffp-contract=off -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror "
    "-fsanitize=address,undefined -fno-sanitize-recover=all -DZYGOS_MAX_BLOCKS=8 -DZYGOS_SPATIAL=0"
)
FRAMES = 1_000_000


def build(folder: Path, capacity: int) -> Path:
    """Compiles the library for `capacity` joints together with the driver; few blocks of planar arms keep it small."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True).stdout
    # Also the last member of a struct has a size; clang 14 has no such check.
    strict = [] if "clang" in version else ["-fsanitize=bounds-strict"]
    program = folder / f"fuzz_frames_{capacity}"
    sources = [*sorted((ROOT / "c").glob("*.c")), Path(__file__).with_name("fuzz_frames.c")]
    command = [*compiler, *FLAGS.split(), *strict, f"-DZYGOS_MAX_JOINTS={capacity}", f"-I{ROOT / 'include'}"]
    subprocess.run([*command, *map(str, sources), "-lm", "-o", str(program)], check=True)
    return program


@pytest.mark.parametrize(
    ("seed", "joints", "fine"), [(1, 2, 1), (2, 2, 0), (3, 7, 1)], ids=["fine-gyro", "coarse-gyro", "seven-joints"]
)
def test_what_a_frame_may_change(tmp_path: Path, seed: int, joints: int, fine: int) -> None:
    program = build(tmp_path, joints)
    command = [str(program), *map(str, (seed, FRAMES, joints, fine))]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    counts = {name: int(count) for name, count in (line.split() for line in run.stdout.splitlines())}
    assert counts["foreign"] + counts["accepted"] + counts["rejected"] >= FRAMES
    missed = [name for name, count in counts.items() if count == 0]
    assert not missed, f"the frames did not provoke {missed}"
    assert counts["rows"] > 1000, "too few rows for an effect on them to show"

"""Drivers of the C library under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FLAGS = (
    "-std=c11 -O1 -g -ffp-contract=off -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror "
    "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all"
)


def build(folder: Path, driver: str, **capacities: int) -> Path:
    """Compiles the library with capacities (MAX_JOINTS=2 ..) together with a driver of this folder."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True).stdout
    # Also the last member of a struct has a size; clang 14 has no such check.
    strict = [] if "clang" in version else ["-fsanitize=bounds-strict"]
    program = folder / driver
    sources = [*sorted((ROOT / "c").glob("*.c")), Path(__file__).with_name(f"{driver}.c")]
    defines = [f"-DZYGOS_{name}={value}" for name, value in capacities.items()]
    command = [*compiler, *FLAGS.split(), *strict, *defines, f"-I{ROOT / 'include'}"]
    subprocess.run([*command, *map(str, sources), "-lm", "-o", str(program)], check=True)
    return program


def counts(program: Path, *arguments: int) -> dict[str, int]:
    """Runs a driver, which must find nothing, and returns what it counted."""
    run = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return {name: int(count) for name, count in (line.split() for line in run.stdout.splitlines())}

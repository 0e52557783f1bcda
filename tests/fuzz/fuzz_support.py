# SPDX-License-Identifier: MIT
"""Drivers of the C library under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path

from build_support import INCLUDE, objects

ROOT = Path(__file__).resolve().parents[2]
FLAGS = (
    "-std=c11 -O0 -g1 -ffp-contract=off -Wall -Wextra -Wconversion -Wsign-conversion -Wshadow -Werror "
    "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all"
)
"""Without optimisation the drivers run as fast, and compile in a third of the time."""
FEW_BLOCKS = {"MAX_BLOCKS": 16, "MAX_MOTOR_BLOCKS": 4, "MAX_MOMENTUM_BLOCKS": 4}
"""Capacities by which the state stays small, the same for all drivers."""


def build(folder: Path, driver: str, cc: str = "", **capacities: int) -> Path:
    """Compiles a driver of this folder with a library of these capacities (MAX_JOINTS=2 ..), which is kept."""
    compiler = shlex.split(cc or os.environ.get("CC", "cc"))
    version = subprocess.run([*compiler, "--version"], capture_output=True, text=True, check=True).stdout
    # Also the last member of a struct has a size; clang 14 has no such check.
    strict = [] if "clang" in version else ["-fsanitize=bounds-strict"]
    command = [*compiler, *FLAGS.split(), *strict, *(f"-DZYGOS_{name}={value}" for name, value in capacities.items())]
    program = folder / driver
    source = Path(__file__).with_name(f"{driver}.c")
    subprocess.run([*command, INCLUDE, source, *objects(command), "-lm", "-o", str(program)], check=True)
    return program


def counts(program: Path, *arguments: int | Path) -> dict[str, int]:
    """Runs a driver, which must find nothing, and returns what it counted."""
    run = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, timeout=300, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return {name: int(count) for name, count in (line.split() for line in run.stdout.splitlines())}

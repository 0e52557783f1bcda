# SPDX-License-Identifier: MIT
"""Flags that break IEEE arithmetic: headers refuse what a compiler tells, and zygos_arm_init() tests the arithmetic."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from build_support import ROOT, tool

UNSAFE = (
    "-Ofast",
    "-ffast-math",
    "-ffinite-math-only",
    "-funsafe-math-optimizations",
    "-fassociative-math -fno-signed-zeros -fno-trapping-math",
)
CASES = [(compiler, flag) for compiler in ("gcc", "clang") for flag in UNSAFE] + [("clang", "-fno-honor-nans")]
PROGRAM = """
#include <stdio.h>
#include "zygos/zygos.h"
static zygos_arm_t arm;
static zygos_config_t config;
int main(void) { printf("%d", zygos_arm_init(&arm, &config)); return 0; }
"""


def built(compiler: str, flags: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Compile the library and a program that initialises an arm of no joints."""
    (folder / "main.c").write_text(PROGRAM)
    flags = f"-std=c11 -O1 -ffp-contract=off -DZYGOS_MAX_JOINTS=2 -DZYGOS_SPATIAL=0 {flags}"
    sources = ["main.c", *map(str, sorted((ROOT / "c").glob("*/*.c")))]
    command = [tool(compiler), *flags.split(), f"-I{ROOT / 'include'}", *sources, "-lm", "-o", "program"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow(but=["gcc--ffinite-math-only"])
@pytest.mark.parametrize(("compiler", "flag"), CASES)
def test_unsafe_arithmetic_is_refused(compiler: str, flag: str, tmp_path: Path) -> None:
    done = built(compiler, flag, tmp_path)
    if done.returncode:
        assert "zygos needs IEEE arithmetic; remedy: compile without" in done.stderr
        return
    assert compiler == "clang", "gcc tells all of them"
    ran = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True)
    assert ran.stdout == "-27"


def test_the_manual_names_the_flags() -> None:
    manual = (ROOT / "docs" / "integrate.md").read_text()
    assert [flag for _, flags in CASES for flag in flags.split()[:1] if f"`{flag}`" not in manual] == []


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_usual_flags_are_accepted(compiler: str, tmp_path: Path) -> None:
    assert built(compiler, "-fno-math-errno", tmp_path).returncode == 0
    ran = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True)
    assert ran.stdout == "-2", "another refusal: the configuration is empty"

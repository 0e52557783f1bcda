# SPDX-License-Identifier: MIT
"""Objects of other capacities than the library's do not link; what a build takes is known before it is made."""

from __future__ import annotations

import functools
import re
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from build_support import INCLUDE, ROOT, tool

from zygos.native.flight import ffi, lib
from zygos.native.header import least_build
from zygos.native.sizes import memory

PROGRAM = (
    '#include "zygos/wire.h"\nint main(void) { zygos_frame_t f = { 0 }; return zygos_wire_check(&f, 1, 0) < 0; }\n'
)
SECTIONS = ["-ffunction-sections", "-fdata-sections"]
LINKS = {"gcc": ["gcc", "-std=c11"], "clang": ["clang", "-std=c11"], "sections": ["gcc", "-std=c11", *SECTIONS]}
"""Compilers; with sections, the linker leaves out what nobody calls."""


def compiled(link: str, source: Path, folder: Path, *flags: str) -> Path:
    tool(LINKS[link][0])
    subprocess.run([*LINKS[link], INCLUDE, *flags, "-c", str(source)], cwd=folder, check=True)
    return folder / f"{source.stem}.o"


def linked(link: str, library: Sequence[Path], folder: Path, *flags: str) -> str:
    """What the linker says of a library and of a program that is compiled with flags."""
    source = folder / "program.c"
    source.write_text(PROGRAM)
    objects = [str(path) for path in (compiled(link, source, folder, *flags), *library)]
    collect = ["-Wl,--gc-sections"] if link == "sections" else []
    command = [*LINKS[link], *objects, *collect, "-o", str(folder / "program")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (folder / "program").exists()
    return "" if done.returncode == 0 else done.stderr


def library(link: str, folder: Path, *flags: str) -> list[Path]:
    """Those rooms of the library that the program needs."""
    return [compiled(link, ROOT / "c" / f"{room}.c", folder, *flags) for room in ("in/wire", "loop/capacities")]


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[Path]]:
    """The library with the usual capacities, compiled once for each kind of link."""
    return functools.cache(lambda link: library(link, tmp_path_factory.mktemp("usual")))


OTHERS = (
    *("MAX_JOINTS=2", "MAX_HALF_WIDTH=14", "MAX_BLOCKS=30", "CYCLE_QUEUE=16", "MAX_EFFECTS=7", "SPATIAL=0"),
    *("MOMENTUM=0", "MAX_MOMENTUM_BLOCKS=14", "MAX_MOTOR_BLOCKS=30", "JOINT_ROWS=0", "JOINT_GROUPS=4"),
    *("MAX_PARAMETERS=58", "MAX_REDUCTION=0"),
)


@pytest.mark.parametrize(
    ("other", "link"), [*((other, "gcc") for other in OTHERS), ("MAX_JOINTS=2", "clang"), ("MAX_JOINTS=2", "sections")]
)
def test_objects_of_other_capacities_do_not_link(
    other: str, link: str, usual: Callable[[str], list[Path]], tmp_path: Path
) -> None:
    said = linked(link, usual(link), tmp_path, f"-DZYGOS_{other}")
    named = re.search(r"undefined reference to [`']zygos_capacities_(\w+)'", said)
    assert named, said
    name, _, value = other.lower().partition("=")
    assert f"{name.removeprefix('max_').removeprefix('cycle_').replace('joint_groups', 'groups')}_{value}" in named[1]


@pytest.mark.parametrize("link", ["gcc", "sections"])
def test_the_same_capacities_link_however_they_were_given(link: str, tmp_path: Path) -> None:
    """21 effects, 195 parameters and 2340 entries are what follows from seven joints in space."""
    given = [
        "-DZYGOS_MAX_JOINTS=7",
        "-DZYGOS_MAX_EFFECTS=21",
        "-DZYGOS_MAX_PARAMETERS=195",
        "-DZYGOS_MAX_REDUCTION=2340",
    ]
    assert linked(link, library(link, tmp_path, *given), tmp_path) == ""


def test_arithmetic_of_another_width_is_refused(tmp_path: Path) -> None:
    command = [tool("gcc"), "-std=c11", "-mfpmath=387", INCLUDE, "-c", str(ROOT / "c" / "loop" / "arm.c")]
    done = subprocess.run([*command, "-o", str(tmp_path / "o.o")], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "zygos needs doubles that are rounded to double after each operation; remedy:" in done.stderr


CAPACITIES = [
    {},
    {"MAX_JOINTS": 2, "SPATIAL": 0, "MOMENTUM": 0, "JOINT_ROWS": 0, "MAX_EFFECTS": 0, "MAX_REDUCTION": 0},
    {"MAX_JOINTS": 6, "MAX_PARAMETERS": 58, "MAX_BLOCKS": 12, "MOMENTUM": 0},
    {"MAX_JOINTS": 1, "MAX_PARAMETERS": 5, "SPATIAL": 0, "MAX_BLOCKS": 11},
    {"MAX_JOINTS": 3, "MAX_EFFECTS": 5, "MAX_HALF_WIDTH": 31, "JOINT_GROUPS": 16, "MAX_MOTOR_BLOCKS": 4},
]


@pytest.mark.parametrize("capacities", CAPACITIES, ids=str)
def test_the_memory_of_a_build_is_what_its_compiler_says(capacities: dict[str, int], tmp_path: Path) -> None:
    source = '#include "zygos/zygos.h"\nchar configuration[sizeof(zygos_config_t)], arm[sizeof(zygos_t)], '
    source += "background[sizeof(zygos_background_t)], estimate[sizeof(zygos_estimate_t)];\n"
    (tmp_path / "sizes.c").write_text(source)
    flags = [f"-DZYGOS_{name}={value}" for name, value in capacities.items()]
    out = str(compiled("gcc", tmp_path / "sizes.c", tmp_path, *flags))
    listed = subprocess.run([tool("nm"), "-S", "-t", "d", out], capture_output=True, text=True, check=True).stdout
    sizes = {name: int(size) for size, name in re.findall(r"^\d+ 0*(\d+) B (\w+)$", listed, re.M)}
    assert memory({f"ZYGOS_{name}": value for name, value in capacities.items()}) == sizes


def test_an_arm_has_the_parameters_that_it_needs_or_the_least_that_a_build_can_have() -> None:
    config = ffi.new("zygos_config_t *")
    config.joints, config.reduced, config.reductions, config.effects = 3, 5, 5, 1
    assert least_build(config[0])["ZYGOS_MAX_PARAMETERS"] == 9
    config.reduced = 11
    assert least_build(config[0])["ZYGOS_MAX_PARAMETERS"] == 12
    config.reduced, config.reductions = 0, 0  # planar, links whose centres of mass are on the lines between the joints
    assert least_build(config[0])["ZYGOS_MAX_PARAMETERS"] == 10 + 3 * 3 + 1


def test_rows_that_are_not_used_have_the_fewest_blocks() -> None:
    """Where rigid joints on a fixed base are estimated by joint rows alone, no energy row is solved."""
    config = ffi.new("zygos_config_t *")
    config.joints, config.base, config.impulse_arc_cycles, config.joint_row_cycles = 1, lib.ZYGOS_BASE_FREE, 100, 50
    assert least_build(config[0])["ZYGOS_MAX_BLOCKS"] == 12
    assert least_build(config[0])["ZYGOS_MAX_MOTOR_BLOCKS"] == 8
    config.base, config.joint[0].rigid, config.impulse_arc_cycles = lib.ZYGOS_BASE_FIXED, 1, 0
    assert least_build(config[0])["ZYGOS_MAX_BLOCKS"] == 11
    assert least_build(config[0])["ZYGOS_MAX_MOTOR_BLOCKS"] == 4

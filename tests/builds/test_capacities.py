"""Objects of other capacities than the library's do not link; what a build takes is known before it is made."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest
from build_support import ROOT, tool

from zygos.native.flight import ffi, lib
from zygos.native.header import least_build
from zygos.native.sizes import memory

PROGRAM = (
    '#include "zygos/wire.h"\nint main(void) { zygos_frame_t f = { 0 }; return zygos_wire_check(&f, 1, 0) < 0; }\n'
)
INCLUDE = f"-I{ROOT / 'include'}"
LINKS = {"plain": [], "sections": ["-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]}


def linked(folder: Path, compiler: str, library: list[str], program: list[str], link: list[str]) -> str:
    """What the linker says of a program of some capacities and a library of others."""
    (folder / "program.c").write_text(PROGRAM)
    compile_ = [tool(compiler), "-std=c11", INCLUDE]
    for name, flags, source in (
        ("library", library, ROOT / "c" / "wire.c"),
        ("capacities", library, ROOT / "c" / "capacities.c"),
        ("program", program, folder / "program.c"),
    ):
        command = [*compile_, *flags, *link[:2], "-c", str(source), "-o", str(folder / f"{name}.o")]
        subprocess.run(command, check=True)
    objects = [str(folder / f"{name}.o") for name in ("program", "library", "capacities")]
    done = subprocess.run(
        [tool(compiler), *objects, *link, "-o", str(folder / "program")], capture_output=True, text=True, check=False
    )
    assert (done.returncode == 0) == (folder / "program").exists()
    return "" if done.returncode == 0 else done.stderr


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize(
    "other",
    [
        *("MAX_JOINTS=2", "MAX_HALF_WIDTH=14", "MAX_BLOCKS=30", "CYCLE_QUEUE=16", "MAX_EFFECTS=7", "SPATIAL=0"),
        *("MOMENTUM=0", "MAX_MOMENTUM_BLOCKS=14", "MAX_MOTOR_BLOCKS=30", "JOINT_ROWS=0", "JOINT_GROUPS=4"),
        *("MAX_PARAMETERS=58", "MAX_REDUCTION=0"),
    ],
)
def test_objects_of_other_capacities_do_not_link(other: str, compiler: str, link: str, tmp_path: Path) -> None:
    said = linked(tmp_path, compiler, [], [f"-DZYGOS_{other}"], LINKS[link])
    named = re.search(r"undefined reference to [`']zygos_capacities_(\w+)'", said)
    assert named, said
    name, _, value = other.lower().partition("=")
    assert f"{name.removeprefix('max_').removeprefix('cycle_').replace('joint_groups', 'groups')}_{value}" in named[1]


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_same_capacities_link_however_they_were_given(compiler: str, link: str, tmp_path: Path) -> None:
    """21 effects, 195 parameters and 2340 entries are what follows from seven joints in space."""
    given = [
        "-DZYGOS_MAX_JOINTS=7",
        "-DZYGOS_MAX_EFFECTS=21",
        "-DZYGOS_MAX_PARAMETERS=195",
        "-DZYGOS_MAX_REDUCTION=2340",
    ]
    assert linked(tmp_path, compiler, given, [], LINKS[link]) == ""


def test_arithmetic_of_another_width_is_refused(tmp_path: Path) -> None:
    command = [tool("gcc"), "-std=c11", "-mfpmath=387", INCLUDE, "-c", str(ROOT / "c" / "zygos.c")]
    done = subprocess.run([*command, "-o", str(tmp_path / "o.o")], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "zygos needs doubles that are rounded to double after each operation; remedy:" in done.stderr


CAPACITIES = [
    {},
    {"MAX_JOINTS": 2, "SPATIAL": 0},
    {"MAX_JOINTS": 2, "SPATIAL": 0, "MOMENTUM": 0, "JOINT_ROWS": 0, "MAX_EFFECTS": 0, "MAX_REDUCTION": 0},
    {"MAX_JOINTS": 6, "MAX_PARAMETERS": 58, "MAX_BLOCKS": 12, "MOMENTUM": 0},
    {"MAX_JOINTS": 2, "MAX_PARAMETERS": 16, "MAX_REDUCTION": 16},
    {"MAX_JOINTS": 1, "MAX_PARAMETERS": 5, "SPATIAL": 0, "MAX_BLOCKS": 11},
    {"MAX_JOINTS": 3, "MAX_EFFECTS": 5, "MAX_HALF_WIDTH": 31, "JOINT_GROUPS": 16, "MAX_MOTOR_BLOCKS": 4},
]


@pytest.mark.parametrize("capacities", CAPACITIES, ids=str)
def test_the_memory_of_a_build_is_what_its_compiler_says(capacities: dict[str, int], tmp_path: Path) -> None:
    source = '#include "zygos/zygos.h"\nchar configuration[sizeof(zygos_config_t)], state[sizeof(zygos_t)], '
    source += "work[sizeof(zygos_work_t)], estimate[sizeof(zygos_estimate_t)];\n"
    (tmp_path / "sizes.c").write_text(source)
    flags = [f"-DZYGOS_{name}={value}" for name, value in capacities.items()]
    out = str(tmp_path / "sizes.o")
    subprocess.run([tool("gcc"), "-std=c11", *flags, INCLUDE, "-c", str(tmp_path / "sizes.c"), "-o", out], check=True)
    listed = subprocess.run([tool("nm"), "-S", "-t", "d", out], capture_output=True, text=True, check=True).stdout
    sizes = {name: int(size) for size, name in re.findall(r"^\d+ 0*(\d+) B (\w+)$", listed, re.M)}
    assert memory({f"ZYGOS_{name}": value for name, value in capacities.items()}) == sizes


def test_a_reduced_arm_has_the_least_parameters_that_a_build_can_have() -> None:
    config = ffi.new("zygos_config_t *")
    config.joints, config.reduced, config.reductions, config.effects = 3, 5, 5, 1
    assert least_build(config[0])["ZYGOS_MAX_PARAMETERS"] == 9
    config.reduced = 11
    assert least_build(config[0])["ZYGOS_MAX_PARAMETERS"] == 12


def test_rows_that_are_not_used_have_the_fewest_blocks() -> None:
    """Where rigid joints on a fixed base are estimated by joint rows alone, no energy row is solved."""
    config = ffi.new("zygos_config_t *")
    config.joints, config.base, config.impulse_arc_cycles, config.joint_row_cycles = 1, lib.ZYGOS_BASE_FREE, 100, 50
    assert least_build(config[0])["ZYGOS_MAX_BLOCKS"] == 32
    assert "ZYGOS_MAX_MOTOR_BLOCKS" not in least_build(config[0])
    config.base, config.joint[0].rigid, config.impulse_arc_cycles = lib.ZYGOS_BASE_FIXED, 1, 0
    assert least_build(config[0])["ZYGOS_MAX_BLOCKS"] == 11
    assert least_build(config[0])["ZYGOS_MAX_MOTOR_BLOCKS"] == 4

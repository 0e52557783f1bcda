# SPDX-License-Identifier: MIT
"""How the flight library compiles: strictly, freestanding, without memory of its own, on a small and bounded stack."""

from __future__ import annotations

import functools
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_support import exact_torques
from build_support import INCLUDE, ONBOARD, ROOMS, ROOT, TARGETS, capacities, objects, onboard, run, tool
from calls_support import Calls
from runs_support import trajectory_of

from conftest import house_flags
from zygos.arm import Arm, load_arm
from zygos.model.model import load_model
from zygos.native import flight
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

HEADERS = sorted((ROOT / "include" / "zygos").rglob("*.h"))

CORTEX_M7 = "arm-none-eabi-gcc -mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard -ffreestanding".split()
OPTIONS = {"m7": "-mfpu=fpv5-d16", "m4f": "-mfpu=fpv4-sp-d16", "leon3": "-m32"}
"""By which a compiler for several processors chooses its own library."""
# The freestanding subset that C compilers call on their own.
ALLOWED_SYMBOLS = {"memcpy", "memset", "memmove", "memcmp"}
# One call frame, and the deepest chain of calls below a public function, which hold a few rows. Measured at capacity 7
# and half width 15: 1616 and 2568 bytes in a planar build, 3056 and 4920 in a spatial one. The bounds leave room for
# other compilers; a planar build fits a 4 KiB task stack with an interrupt frame.
PLANAR_STACK, SPATIAL_STACK = (3328, 5376), (6656, 9728)


def test_the_manual_says_how_large_the_structs_are(tmp_path: Path) -> None:
    """The table of docs/cost.md, by the command of docs/integrate.md."""
    command = re.search(r"^    (printf .*\n.*sizes\.o)$", (ROOT / "docs" / "integrate.md").read_text(), re.M)
    assert command is not None
    cost = (ROOT / "docs" / "cost.md").read_text()
    rows = re.findall(r"^\| (\d) \| (\d) \| (\d+)" + r" \| ([\d,]+)" * 4 + r" \|$", cost, re.M)
    assert len(rows) >= 8
    asked = "-DZYGOS_MAX_JOINTS=2 -DZYGOS_SPATIAL=0"
    assert asked in command[1]
    for joints, spatial, blocks, *said in rows:
        given = (
            f"-DZYGOS_MAX_JOINTS={joints} -DZYGOS_SPATIAL={spatial} -DZYGOS_MAX_BLOCKS={blocks} -I{ROOT / 'include'}"
        )
        out = run(["sh", "-c", command[1].replace(asked, given)], tmp_path)
        found = {name: int(size) for size, name in re.findall(r"^\d+ 0*(\d+) B (\w+)$", out, re.M)}
        assert [f"{found[name]:,}" for name in ("arm", "background", "in_place", "estimate")] == said
        if (joints, spatial, blocks) == ("7", "1", "32"):
            together = found["arm"] + found["background"] + found["estimate"]
            assert f"structs, arm, background and estimate, take {together / 1e6:.1f} MB" in cost
            assert f"joints take {together / 1e6:.1f} MB" in cost


def test_the_manual_says_how_large_the_build_for_the_papers_arm_is() -> None:
    """By the comment of the header that `zygos compile-model` writes."""
    written = (ONBOARD / "arm_config.h").read_text()
    usual, in_place = re.findall(r" takes ([\d,]+) bytes", written)
    manual, tasks, readme = ((ROOT / page).read_text() for page in ("docs/integrate.md", "docs/tasks.md", "README.md"))
    assert f"{usual} bytes for that of the paper, and {in_place} in place" in manual
    thousands = [int(size.replace(",", "")) / 1000 for size in (usual, in_place)]
    assert f"paper's arm: {thousands[0]:.0f} kB for" in tasks and f"; {thousands[1]:.1f} kB where" in tasks
    assert f"{thousands[0]:.0f} kB, or {thousands[1]:.1f} kB where frames wait" in readme


def named(header: Path) -> str:
    """As a program includes it, below `zygos/`."""
    return str(header.relative_to(ROOT / "include" / "zygos"))


@functools.cache
def declared() -> dict[str, str]:
    """Prototypes in the public headers: name and the paragraph that it stands in."""
    out = {}
    for header in HEADERS:
        for paragraph in re.split(r"\n\s*\n", header.read_text()):
            for name in re.findall(r"^(?!typedef|static|///|#)[a-z][\w *]*?\b(zygos_\w+)\(", paragraph, re.M):
                out[name] = paragraph
    return out


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_exports_what_the_headers_declare_and_needs_the_compilers_runtime_only(target: str, tmp_path: Path) -> None:
    """The archive of a build with strict warnings, in freestanding C on the boards."""
    archive = onboard(target) / "library" / "libzygos.a"
    compiler = TARGETS[target][0]
    nm = tool(run([compiler, "-print-prog-name=nm"], tmp_path).strip())

    def symbols(path: str | Path) -> list[tuple[str, str]]:
        """(name, nm's type letter) of every symbol."""
        done = subprocess.run([nm, path], capture_output=True, text=True, check=True)
        return [(m[2], m[1]) for m in re.finditer(r"^[0-9a-f ]* ([A-Za-z]) (\S+)$", done.stdout, re.M)]

    found = symbols(archive)
    constants = {name for name, kind in found if kind == "R"}
    assert len(constants) == 2, "only the capacities (types.h) and the table of the CRC are constants that others know"
    exported = {name for name, kind in found if kind.isupper() and kind != "U"}
    assert {name for name, kind in found if kind == "T"} == set(declared()) == exported - constants
    # The reference to the capacities is an address, which a program that can be moved has filled in before it begins.
    kinds = {kind for name, kind in found if name != "zygos_capacities_used"}
    assert kinds <= set("TtrRUdnw$") - {"d"}, "the library has writable or common symbols"
    foreign = {name for name, kind in found if kind == "U"} - exported
    runtime: set[str] = set()
    if target in OPTIONS:  # arithmetic that the processor does not have
        path = run([compiler, OPTIONS[target], "-print-libgcc-file-name"], tmp_path).strip()
        runtime = {name for name, kind in symbols(path) if kind in "TW"}
    assert foreign - ALLOWED_SYMBOLS - runtime == ({"sqrt"} if target == "m4f" else set()), "the library calls others"


def test_every_public_function_is_described() -> None:
    assert len(declared()) > 30
    assert [name for name, paragraph in declared().items() if "///" not in paragraph] == []


LEAST = "-DZYGOS_SPATIAL=0 -DZYGOS_MAX_JOINTS=1 -DZYGOS_MAX_EFFECTS=0 -DZYGOS_MOMENTUM=0"


@pytest.mark.slow(but=["cortex-m7-"])
@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        ("cortex-m7", ""),
        ("gcc", "-DZYGOS_MAX_BLOCKS=11"),
        ("gcc", "-DZYGOS_MAX_HALF_WIDTH=2"),
        ("gcc", "-DZYGOS_MAX_EFFECTS=0"),
        ("gcc", "-DZYGOS_MOMENTUM=0"),
        ("gcc", "-DZYGOS_MAX_MOMENTUM_BLOCKS=4 -DZYGOS_MAX_MOTOR_BLOCKS=4 -DZYGOS_SPATIAL=0"),
        ("gcc", LEAST),
        ("gcc", "-DZYGOS_MAX_HALF_WIDTH=31 -DZYGOS_MAX_BLOCKS=128 -DZYGOS_CYCLE_QUEUE=1024"),
    ],
)
def test_is_sound_c_at_other_capacities(compiler: str, flags: str, tmp_path: Path) -> None:
    """No warning of the compiler, without the code that it would make."""
    command = ["gcc"] if compiler == "gcc" else CORTEX_M7
    tool(command[0])
    command = [*command, *house_flags(), "-Werror", INCLUDE, *flags.split(), "-fsyntax-only"]
    run([*command, *map(str, ROOMS)], tmp_path)


@pytest.mark.parametrize(
    "flag",
    [
        "JOINTS=0",
        "JOINTS=8",
        "HALF_WIDTH=1",
        "HALF_WIDTH=32",
        "BLOCKS=10",
        "BLOCKS=129",
        "EFFECTS=-1",
        "EFFECTS=33",
        "MOMENTUM_BLOCKS=2",
        "MOMENTUM_BLOCKS=5",
        "CYCLE_QUEUE=1025",
    ],
)
def test_refuses_to_compile_at_impossible_capacities(flag: str, tmp_path: Path) -> None:
    name = f"ZYGOS_{flag}" if flag.startswith("CYCLE") else f"ZYGOS_MAX_{flag}"
    command = [tool("gcc"), "-std=c11", INCLUDE, f"-D{name}", "-fsyntax-only", str(ROOMS[0])]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "#error" in done.stderr


@pytest.mark.parametrize("header", HEADERS, ids=named)
def test_each_header_stands_alone(header: Path, tmp_path: Path) -> None:
    warnings = ["-Wall", "-Wextra", "-pedantic", "-Werror"]
    unit = tmp_path / "unit.c"
    unit.write_text(f'#include "zygos/{named(header)}"\n#include "zygos/{named(header)}"\n')
    run([tool("gcc"), "-std=c11", *warnings, INCLUDE, "-fsyntax-only", str(unit)], tmp_path)
    run([tool("g++"), "-std=c++17", "-x", "c++", *warnings, INCLUDE, "-fsyntax-only", str(unit)], tmp_path)


@pytest.mark.parametrize("standard", ["11", "14", "17", "20"])
def test_the_headers_are_sound_in_every_cpp(standard: str, tmp_path: Path) -> None:
    unit = tmp_path / "unit.cpp"
    unit.write_text("".join(f'#include "zygos/{named(header)}"\n' for header in HEADERS))
    for compiler in ("g++", "clang++"):
        command = [tool(compiler), f"-std=c++{standard}", "-Wall", "-Wextra", "-pedantic", "-Werror", INCLUDE]
        run([*command, "-fsyntax-only", str(unit)], tmp_path)


@pytest.mark.slow(but=["gcc"])
@pytest.mark.parametrize("target", ["gcc", "m7", "spatial-m7"])
def test_stack_is_bounded_and_nothing_recurses(target: str) -> None:
    """Every frame has a fixed size, no function is called through a pointer, and no chain of calls comes back."""
    if target == "spatial-m7":
        tool(CORTEX_M7[0])
        rooms = objects([*CORTEX_M7, "-fcallgraph-info=su", *house_flags(), "-Werror"])
        folder, bounds = rooms[0].parent, SPATIAL_STACK
    else:
        folder, bounds = onboard(target) / "library" / "objects", PLANAR_STACK
    calls = Calls(folder)
    assert len(calls.frame) > 30
    assert "__indirect_call" not in calls.calls
    assert [name for name, bounded in calls.bounded.items() if not bounded] == []
    largest = max(calls.frame, key=lambda name: calls.frame[name])
    depth = {name: calls.depth(name) for name in calls.frame}
    deepest = max(depth, key=lambda name: depth[name])
    print(f"{target}: largest frame {calls.frame[largest]} in {largest}, deepest stack {depth[deepest]} in {deepest}")
    assert calls.frame[largest] <= bounds[0]
    assert depth[deepest] <= bounds[1]


def results(arm: Arm, cycles: Cycles) -> dict[str, Any]:
    """Everything that a run of an arm gives, through both doors."""
    doors = {}
    for name in ("frames", "cycles"):
        run_of = flight.Flight(arm)
        trace = run_of.frames(flight.encode(arm, cycles), trace=True) if name == "frames" else None
        trace = run_of.cycles(cycles, trace=True) if trace is None else trace
        assert trace is not None
        gram, right = run_of.normal_equations()
        estimate = run_of.estimate()
        doors[name] = [trace.row[trace.instant], trace.accepted, gram, right, estimate.value, estimate.sigma]
        doors[name] += [estimate.covariance, estimate.condition, estimate.residual]
    return doors


@pytest.mark.slow
@pytest.mark.parametrize(("example", "joints", "duration_s"), [("paper", 2, 30.0), ("spatial", 3, 12.0)])
def test_capacity_changes_no_bit(example: str, joints: int, duration_s: float) -> None:
    """An arm in a build for just its joints, without room for effects, and in the largest one; rows of every kind."""
    folder = ROOT / "examples" / example
    scenario, model = load_scenario(folder / "scenario.toml"), load_model(folder / "model.toml")
    arm = replace(exact_torques(load_arm(folder / "arm.toml")), momentum_max_s=10.0)
    cycles = trajectory_of(arm, model, scenario, noise=True, duration_s=duration_s, rtol=1e-6, atol=1e-8).cycles()
    large = results(arm, cycles)
    spatial = int(arm.spatial)
    with capacities(f"-DZYGOS_MAX_JOINTS={joints}", "-DZYGOS_MAX_EFFECTS=0", f"-DZYGOS_SPATIAL={spatial}"):
        lib = flight.lib
        sizes = (lib.ZYGOS_MAX_JOINTS_VALUE, lib.ZYGOS_MAX_EFFECTS_VALUE, lib.ZYGOS_SPATIAL_VALUE)
        assert sizes == (joints, 0, spatial)
        small = results(arm, cycles)
    for door, pieces in large.items():
        assert np.isfinite(pieces[4]).sum() >= 12
        for piece, other in zip(pieces, small[door], strict=True):
            np.testing.assert_array_equal(piece, other)

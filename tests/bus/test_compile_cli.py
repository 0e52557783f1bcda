# SPDX-License-Identifier: MIT
"""`zygos compile-model`: what onboard software links is what the harness runs, bit for bit."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from cli_support import run
from schema_support import hold
from wire_support import SEVEN_NODES, arm_text

from conftest import EXAMPLE, ROOT, need
from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.native import snapshot
from zygos.native.flight import Flight, config_of, ffi

WARNINGS = "-Wall -Wextra -Wconversion -Wsign-conversion -Wdouble-promotion -Wshadow -pedantic -Werror".split()
COMPILERS = {
    "gcc": ["gcc", "-std=c11", "-x", "c"],
    "clang": ["clang", "-std=c11", "-x", "c"],
    "g++": ["g++", "-std=c++17", "-x", "c++"],
    "clang++": ["clang++", "-std=c++17", "-x", "c++"],
}
PROGRAM = """
#include <stdio.h>
#include "arm_config.h"
int main(void) { return fwrite(&arm_config, sizeof arm_config, 1, stdout) == 1 ? 0 : 1; }
"""


def compiled(folder: Path, compiler: str, *flags: str) -> subprocess.CompletedProcess[str]:
    """Compile the program that writes the configuration of folder/arm_config.h to its output."""
    command = COMPILERS[compiler]
    need(shutil.which(command[0]), f"{command[0]}: this compiler stays unchecked")
    (folder / "program.c").write_text(PROGRAM)
    command = [*command, *WARNINGS, *flags, f"-I{ROOT / 'include'}", f"-I{folder}", str(folder / "program.c")]
    command.append(str(ROOT / "c" / "loop" / "capacities.c"))
    return subprocess.run([*command, "-o", str(folder / "program")], capture_output=True, text=True, check=False)


@pytest.mark.slow(only=["spatial*", "seven*"])
@pytest.mark.parametrize(
    ("example", "compiler"), [("paper", "gcc"), ("spatial", "clang"), ("seven", "g++"), ("spatial", "clang++")]
)
def test_header_blob_and_harness_have_the_same_bits(example: str, compiler: str, tmp_path: Path) -> None:
    arm_file = ROOT / "examples" / example / "arm.toml"
    assert run("compile-model", arm_file, "-o", tmp_path) == 0
    done = compiled(tmp_path, compiler)
    assert (done.returncode, done.stderr) == (0, "")
    linked = subprocess.run([tmp_path / "program"], capture_output=True, check=True).stdout
    expected = bytes(ffi.buffer(config_of(load_arm(arm_file))))
    assert linked == expected
    assert (tmp_path / "arm.zyg").read_bytes()[24:] == expected
    assert bytes(ffi.buffer(snapshot.read(tmp_path / "arm.zyg", "configuration"))) == expected


def test_effects_of_a_model_are_compiled_in(tmp_path: Path) -> None:
    text = (EXAMPLE / "model.toml").read_text()
    model = tmp_path / "model.toml"
    model.write_text(text + '\n[[effect]]\nkind = "torque_lag"\njoint = "elbow"\nvalue = 0.002\n')
    out = tmp_path / "answer.json"
    command = ("compile-model", EXAMPLE / "arm.toml", "--model", model, "-o", tmp_path, "--json", out)
    assert run(*command) == 0
    arm, effects = load_arm(EXAMPLE / "arm.toml"), load_model(model).effects
    assert len(effects) == 1
    assert compiled(tmp_path, "gcc").returncode == 0
    linked = subprocess.run([tmp_path / "program"], capture_output=True, check=True).stdout
    assert linked == bytes(ffi.buffer(config_of(arm, effects)))
    names = json.loads(out.read_text())["parameters"]
    assert names == list(Flight(arm, effects).names)
    assert names[-1] == "torque_lag2"


def test_effects_that_the_library_lacks_are_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All at once, and nothing is written; what needs no column is said and left out."""
    model, text = tmp_path / "model.toml", (EXAMPLE / "model.toml").read_text()
    entry = '\n[[effect]]\nkind = "{}"\njoint = "{}"\nvalue = 0.1\n'.format
    model.write_text(text + entry("load_friction", "elbow") + entry("motor_viscous", "elbow"))
    assert run("compile-model", EXAMPLE / "arm.toml", "--model", model, "-o", tmp_path / "out") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "the flight library has no column for load_friction at elbow; remedy: remove this entry" in said
    model.write_text(text + entry("load_friction", "elbow") + entry("load_friction", "shoulder"))
    assert run("compile-model", EXAMPLE / "arm.toml", "--model", model, "-o", tmp_path / "out") == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "load_friction at elbow, load_friction at shoulder; remedy: remove these entries" in said
    assert not (tmp_path / "out").exists()
    model.write_text(text + '\n[[effect]]\nkind = "angular_momentum"\nvalue = 1.0\n' + entry("motor_viscous", "elbow"))
    out = tmp_path / "answer.json"
    assert run("compile-model", EXAMPLE / "arm.toml", "--model", model, "-o", tmp_path / "out") == 0
    assert "not estimated on board, because the balance does not need it: angular_momentum" in capsys.readouterr().out
    assert run("compile-model", EXAMPLE / "arm.toml", "--model", model, "-o", tmp_path / "out", "--json", out) == 0
    answer = json.loads(out.read_text())
    hold("compile-model", answer)
    assert (answer["effects"], answer["omitted"]) == (["motor_viscous2"], ["angular_momentum"])


@pytest.mark.slow
def test_parameters_have_their_places(tmp_path: Path) -> None:
    """The names of a spatial arm hold brackets and commas; the enumeration counts as the estimate does."""
    (tmp_path / "arm.toml").write_text(arm_text(tuple("abcdefg"), SEVEN_NODES, kinetic="spatial"))
    assert run("compile-model", tmp_path / "arm.toml", "-o", tmp_path) == 0
    names = Flight(load_arm(tmp_path / "arm.toml")).names
    checks = "\n".join(
        f'_Static_assert(ARM_{"_".join(name.replace("[", ",").replace("]", ",").split(",")).rstrip("_")} == {k}, "");'
        for k, name in enumerate(names)
    )
    unit = tmp_path / "unit.c"
    unit.write_text(f'#include "arm_config.h"\n{checks}\n_Static_assert(ARM_PARAMETERS == {len(names)}, "");\n')
    subprocess.run(["gcc", "-std=c11", f"-I{ROOT / 'include'}", "-fsyntax-only", unit], check=True)
    assert len(names) > 150


@pytest.mark.slow(only=["spatial--DZYGOS_MAX_JOINTS=2*"])
@pytest.mark.parametrize(
    ("example", "flag", "word"),
    [
        ("spatial", "-DZYGOS_MAX_JOINTS=2", "ZYGOS_MAX_JOINTS 3"),
        ("spatial", "-DZYGOS_SPATIAL=0", "ZYGOS_SPATIAL 1"),
        ("paper", "-DZYGOS_MAX_HALF_WIDTH=4", "ZYGOS_MAX_HALF_WIDTH 5"),
    ],
)
def test_a_build_that_is_too_small_does_not_compile(example: str, flag: str, word: str, tmp_path: Path) -> None:
    assert run("compile-model", ROOT / "examples" / example / "arm.toml", "-o", tmp_path) == 0
    done = compiled(tmp_path, "gcc", flag)
    assert done.returncode != 0
    assert f"needs {word}; remedy: compile with -D{word.replace(' ', '=')}" in done.stderr


def test_a_smaller_build_that_suffices_compiles(tmp_path: Path) -> None:
    assert run("compile-model", EXAMPLE / "arm.toml", "-o", tmp_path) == 0
    flags = "-DZYGOS_MAX_JOINTS=2 -DZYGOS_SPATIAL=0 -DZYGOS_MOMENTUM=0 -DZYGOS_MAX_EFFECTS=0 -DZYGOS_MAX_HALF_WIDTH=5"
    assert compiled(tmp_path, "gcc", *flags.split()).returncode == 0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (("period_s = 0.05", "period_s = 0.066"), "period_s"),
        (("gear_ratio = 50", "gear_ratio = 1e7"), "out of range"),
        (("node = 2", "node = 1"), "node"),
        (("[smoother]", "[arc]\nmax_s = 0.9\n[smoother]"), "shorter than 20 cycles"),
    ],
)
def test_what_the_library_would_refuse_is_not_written(
    change: tuple[str, str], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (EXAMPLE / "arm.toml").read_text()
    assert change[0] in text
    (tmp_path / "arm.toml").write_text(text.replace(*change))
    assert run("compile-model", tmp_path / "arm.toml", "-o", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert word in said
    assert "remedy: " in said
    assert not (tmp_path / "out").exists()


def test_outputs_do_not_replace_inputs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(EXAMPLE / "arm.toml", tmp_path / "arm.zyg")
    assert run("compile-model", tmp_path / "arm.zyg", "-o", tmp_path) == 2
    assert "would replace" in capsys.readouterr().err
    assert not (tmp_path / "arm_config.h").exists()


@pytest.mark.slow
def test_memory_is_told_before_anything_is_flashed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Table, JSON and arm_config.h have the bytes that a compiler makes of the smallest build."""
    out = tmp_path / "answer.json"
    assert run("compile-model", EXAMPLE / "arm.toml", "-o", tmp_path, "--json", out) == 0
    answer, said = json.loads(out.read_text()), capsys.readouterr().out
    more = set(answer["least_build"]) - set(answer["capacities"])
    assert more == {"ZYGOS_MAX_BLOCKS", "ZYGOS_MAX_MOTOR_BLOCKS", "ZYGOS_MAX_MOMENTUM_BLOCKS"}
    assert answer["least_build"]["ZYGOS_MAX_PARAMETERS"] == 12
    assert sum(answer["bytes"].values()) <= 75_000 and sum(answer["in_place_bytes"].values()) <= 40_000
    assert answer["in_place_build"]["ZYGOS_MAX_BLOCKS"] == 11
    need(shutil.which("gcc"), "gcc: the memory of a build stays unchecked")
    text = (tmp_path / "arm_config.h").read_text()
    for build, listed, line, struct in (
        ("least_build", "bytes", "The smallest build that holds it", "background"),
        ("in_place_build", "in_place_bytes", "With the fewest blocks", "in_place"),
    ):
        flags = [f"-D{name}={value}" for name, value in answer[build].items()]
        found = _bytes_of(tmp_path, flags, struct)
        assert list(answer[listed].values()) == found
        assert f"// {line}: {' '.join(flags)}\n" in text
        assert f"options of this build: {' '.join(flags)}\n" in said
        assert f"t takes {sum(found):,} bytes: configuration {found[0]:,}, arm {found[1]:,}, {struct} " in text
        assert f"{sum(found):,}" in said


def _bytes_of(folder: Path, flags: Sequence[str], struct: str) -> list[int]:
    """What a compiler makes of configuration, arm, memory for solutions, and estimate."""
    program = (
        '#include "zygos/zygos.h"\n#include <stdio.h>\n'
        'int main(void) { printf("%d %d %d %d", (int)sizeof(zygos_config_t), '
        f"(int)sizeof(zygos_t), (int)sizeof(zygos_{struct}_t), (int)sizeof(zygos_estimate_t)); return 0; }}\n"
    )
    (folder / "sizes.c").write_text(program)
    command = ["gcc", "-std=c11", *flags, f"-I{ROOT / 'include'}", str(folder / "sizes.c")]
    subprocess.run([*command, str(ROOT / "c" / "loop" / "capacities.c"), "-o", str(folder / "sizes")], check=True)
    done = subprocess.run([folder / "sizes"], capture_output=True, check=True)
    return [int(word) for word in done.stdout.split()]

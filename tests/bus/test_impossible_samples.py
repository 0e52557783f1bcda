# SPDX-License-Identifier: MIT
"""Recordings with samples that no arm could have produced, or that are late: `convert` names the cause, its remedies
can be carried out, and then the values are those of the recording without the fault."""

from __future__ import annotations

import gzip
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run
from numpy.typing import NDArray
from telemetry_support import edited

from conftest import EXAMPLE, ROOT, need
from zygos.arm import Arm, load_arm
from zygos.files.tables import read_columns, write_columns
from zygos.runs.cycles import BREAK_BEFORE, INVALID, Cycles
from zygos.runs.tables import read_cycles, write_cycles
from zygos.simulation.plant import Trajectory

CASES = ROOT.parent / "shared" / "cases"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The arm files of the cases, and their tables as NPZ."""
    need(CASES.is_dir(), str(CASES))
    folder = tmp_path_factory.mktemp("cases")
    for name in ("jointstate_arm", "torque_late_arm"):
        (folder / f"{name}.toml").write_text((CASES / f"{name}.toml").read_text())
    for name in ("csv_angle_wraps_360", "torque_20ms_late"):
        text = gzip.decompress((CASES / f"{name}.csv.gz").read_bytes()).decode()
        names, *rows = text.splitlines()
        values = np.array([[float(field) for field in row.split(",")] for row in rows])
        write_columns(folder / f"{name}.npz", dict(zip(names.split(","), values.T, strict=True)))
    return folder


def convert(folder: Path, source: Path, map_file: Path, arm: str = "jointstate_arm") -> tuple[int, dict[str, Any]]:
    out = folder / source.stem
    code = run("convert", source, "--map", map_file, "--arm", folder / f"{arm}.toml", "-o", out / "run.npz",
               "--json", folder / "c.json")  # fmt: skip
    return code, json.loads((folder / "c.json").read_text()) if code != 2 else {}


def cycles(folder: Path, source: Path) -> Cycles:
    out = folder / source.stem
    return read_cycles(out / "run.npz", load_arm(out / "arm.toml"))


@pytest.fixture(scope="module")
def sound(folder: Path) -> dict[str, NDArray[Any]]:
    """The recording of the pendulum, as its angles are before they wrap: radians of up to half a turn."""
    columns = dict(read_columns(folder / "csv_angle_wraps_360.npz"))
    return columns | {name: (columns[name] + 180.0) % 360.0 - 180.0 for name in ("q1", "q2")}


def applied(remedy: str, map_file: Path, out: Path, column: str) -> Path:
    """The map with a key that a message proposes, at the entry of each angle."""
    found = re.search(r"remedy: write (\w+ = [-\d.e]+) there", remedy)
    assert found, remedy
    text = map_file.read_text()
    out.write_text(re.sub(rf'(motor\s*= \{{ {column} = "[^"]*",)', rf"\1 {found[1]},", text))
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "map_name", "key", "first"),
    [
        ("csv_angle_wraps_360.npz", "deg.toml", "column", "in row 12 (359.989, then 0.0109)"),
        ("jointstate_angle_wraps_2pi.mcap", "jointstate_map.toml", "topic", "at 0.0277834 s (6.28299, then"),
    ],
)
def test_an_angle_that_wraps_is_named_and_then_unwrapped(
    folder: Path,
    sound: dict[str, NDArray[Any]],
    name: str,
    map_name: str,
    key: str,
    first: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = folder / name if name.endswith("npz") else CASES / name
    assert convert(folder, source, CASES / map_name)[0] == 2
    said = capsys.readouterr().err.replace("\n", " ")
    assert first in said
    if key == "column":  # the row is that of the table, also where its beginning is cut off
        cut = ("--map", CASES / map_name, "--arm", folder / "jointstate_arm.toml", "-o", tmp_path / "r.npz")
        assert run("convert", source, *cut, "--from", "0.1") == 2
        assert "first in row 94 (" in capsys.readouterr().err
    code, report = convert(folder, source, applied(said, CASES / map_name, tmp_path / "map.toml", key))
    assert (code, [row["turns"] > 10 for row in report["signals"]]) == (0, [True, False, True, False])
    write_columns(tmp_path / "sound.npz", sound)
    assert convert(folder, tmp_path / "sound.npz", CASES / "deg.toml")[0] == 0
    got, expected = cycles(folder, source), cycles(folder, tmp_path / "sound.npz")
    moved = got.theta - expected.theta
    assert np.allclose(moved, np.round(moved[0] / (2 * np.pi)) * 2 * np.pi, atol=1e-4)  # steps of 0.01 degrees
    assert max(row["sigma"] for row in report["signals"] if row["unit"] == "rad") < 2e-4


def test_a_run_whose_angle_wraps_is_unwrapped_without_a_map(
    noisy: Trajectory, arm: Arm, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command that check-arm proposes; breaks and missing cycles of the run remain."""
    clean = noisy.cycles(0)
    q, flags = clean.q.copy(), clean.flags.copy()
    low = np.median(q[:, 1])
    q[:, 1] = np.mod(q[:, 1] - low, 2 * np.pi) + low
    wraps = int(np.count_nonzero(np.abs(np.diff(q[:, 1])) > np.pi))
    flags[700], flags[900] = BREAK_BEFORE, INVALID
    for suffix in ("npz", "csv"):
        source, out = tmp_path / f"wrapped.{suffix}", tmp_path / suffix / "run.npz"
        write_cycles(source, replace(clean, q=q, flags=flags))
        (tmp_path / "arm.toml").write_text((EXAMPLE / "arm.toml").read_text())
        assert run("check-arm", source, "--arm", tmp_path / "arm.toml") == 3
        assert f"elbow link angle wraps {wraps} times" in (said := capsys.readouterr().err.replace("\n", " "))
        assert "`zygos convert RUN --arm ARM.toml -o NEW`" in said
        assert run("convert", source, "--arm", tmp_path / "arm.toml", "-o", out) == 0
        got, kept = read_cycles(out, arm), np.delete(np.arange(len(clean)), 900)
        np.testing.assert_allclose(np.diff(got.q, axis=0), np.diff(clean.q[kept], axis=0), atol=1e-9)
        np.testing.assert_array_equal(got.tau, clean.tau[kept])
        assert np.flatnonzero(got.flags).tolist() == [700, 900]
        assert got.sync[900] == 901


def test_what_is_no_run_needs_a_map(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for source, said in (
        (CASES / "jointstate_two_publishers_zeros.mcap", "remedy: give it with --map"),
        (folder / "csv_angle_wraps_360.npz", "convert other tables with `zygos convert --map`"),
    ):
        assert run("convert", source, "--arm", folder / "jointstate_arm.toml", "-o", folder / "no" / "run.npz") == 2
        assert said in capsys.readouterr().err.replace("\n", " ")
        assert not (folder / "no").exists()


def test_the_zeros_of_a_second_publisher_are_left_out(folder: Path) -> None:
    """All 100 of them, also those where the first joint is at zero."""
    source = CASES / "jointstate_two_publishers_zeros.mcap"
    code, report = convert(folder, source, CASES / "jointstate_map.toml")
    assert code == 0
    assert [row["left_out"] for row in report["signals"]] == [100] * 4
    assert "100 samples of 5,097 far from what the neighbours say, first at 0.0562852 s (0)" in report["warnings"][0]
    assert "a second source" in report["warnings"][0]
    assert [row["sigma"] < 1.5e-4 for row in report["signals"]] == [True] * 4


def test_many_zeros_are_refused_and_left_out_by_the_key(
    folder: Path, sound: dict[str, NDArray[Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    second = np.random.default_rng(0).random(len(sound["t"])) < 0.3
    write_columns(tmp_path / "x.npz", {n: v if n == "t" else np.where(second, 0.0, v) for n, v in sound.items()})
    assert convert(folder, tmp_path / "x.npz", CASES / "deg.toml")[0] == 2
    said = capsys.readouterr().err.replace("\n", " ")
    assert "a second source" in said
    map_file = applied(said, CASES / "deg.toml", tmp_path / "map.toml", "column")
    code, report = convert(folder, tmp_path / "x.npz", map_file)
    assert (code, report["warnings"][:-1]) == (0, [])
    assert all(row["left_out"] == second.sum() for row in report["signals"])
    assert max(row["sigma"] for row in report["signals"]) < 3e-4


@pytest.mark.slow
def test_gaps_of_six_milliseconds_cost_nothing(folder: Path, sound: dict[str, NDArray[Any]], tmp_path: Path) -> None:
    """85 of them in a measured recording: friction reverses and drives vibrate in it."""
    gaps = np.random.default_rng(1).choice(np.arange(40, 4900, 20), 85, replace=False)
    kept = np.delete(np.arange(len(sound["t"])), np.concatenate([gaps, gaps + 1]))
    write_columns(tmp_path / "x.npz", {name: values[kept] for name, values in sound.items()})
    write_columns(tmp_path / "whole.npz", sound)
    code, report = convert(folder, tmp_path / "x.npz", CASES / "deg.toml")
    assert (code, report["breaks"], report["left_out"]["instants in holes"]) == (0, 0, 0)
    assert [(row["bridged"], row["holes"]) for row in report["signals"]] == [(85, 0)] * 4
    assert 0.0055 < report["signals"][0]["longest_bridged_s"] < 0.0085
    convert(folder, tmp_path / "whole.npz", CASES / "deg.toml")
    got, expected = cycles(folder, tmp_path / "x.npz"), cycles(folder, tmp_path / "whole.npz")
    assert len(got) == len(expected)
    for row in report["signals"][::2]:
        axis = 0 if row["signal"].startswith("shoulder") else 1
        difference = got.theta[:, axis] - expected.theta[:, axis]
        assert np.sqrt(np.mean(difference**2)) < row["sigma"]


@pytest.mark.slow
def test_a_late_torque_gives_the_true_values_with_its_delay(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Inertia 0.85 kg m², viscous friction 0.008 Nm s/rad; without the key they are 0.83 and 0.010. The means of the
    torque over 10 ms make the inertia 0.03 % too small, whatever the delay (docs/telemetry.md)."""
    key = ('at = "rotor"', 'at = "rotor", delay_s = 0.02')
    map_file = edited(CASES / "torque_late_map.toml", tmp_path / "map.toml", key)
    source = folder / "torque_20ms_late.npz"
    assert convert(folder, source, map_file, "torque_late_arm")[0] == 0
    out = folder / source.stem / "run.npz"
    assert run("estimate", out, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 0
    capsys.readouterr()
    content = json.loads((tmp_path / "m.json").read_text())
    found = {one["name"]: (one["value"], one["half95"]) for one in content["parameters"]}
    value, half = found["motor_viscous1"]
    assert abs(value - 0.008) < half
    value, half = found["Ixx1"]
    assert abs(value - 0.85) < max(half, 3e-4)


@pytest.mark.slow
def test_a_cut_off_is_proposed_and_can_be_used(
    folder: Path, sound: dict[str, NDArray[Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a measured arm whose drives vibrate: a faster recording or a slower motion is not what it needs."""
    write_columns(tmp_path / "x.npz", sound)
    text = re.sub(r"\[smoother\]\s*cutoff_hz = [\d.]+", "", (folder / "jointstate_arm.toml").read_text())
    (folder / "no_cutoff.toml").write_text(text)
    assert convert(folder, tmp_path / "x.npz", CASES / "deg.toml", "no_cutoff")[0] == 3
    said = capsys.readouterr().err.replace("\n", " ")
    assert "move more slowly" not in said and "record faster" not in said
    found = re.search(r"remedy: shorten period_s .*, or write (cutoff_hz = ([\d.]+)) in \[smoother\]", said)
    assert found, said
    assert 3.0 < float(found[2]) < 10.0
    (folder / "with_cutoff.toml").write_text(f"{text}\n[smoother]\n{found[1]}\n")
    assert convert(folder, tmp_path / "x.npz", CASES / "deg.toml", "with_cutoff")[0] == 0


@pytest.mark.slow(only=["vibration", "stamps"])
@pytest.mark.parametrize("cause", ["stamps", "vibration", "noise"])
def test_the_cause_of_much_noise_is_named(
    folder: Path, sound: dict[str, NDArray[Any]], cause: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    columns, n = dict(sound), len(sound["t"])
    if cause == "stamps":
        columns["t"] = np.sort(sound["t"] + rng.uniform(-0.0009, 0.0009, n))
        columns["q2"] = sound["q2"] + 200.0 * np.sin(3.0 * sound["t"])
    elif cause == "vibration":
        columns["q2"] = sound["q2"] + 0.5 * np.sin(2 * np.pi * 120.0 * sound["t"])
    else:
        columns["q2"] = sound["q2"] + 0.3 * rng.standard_normal(n)
    write_columns(tmp_path / "x.npz", columns)
    code, report = convert(folder, tmp_path / "x.npz", CASES / "deg.toml")
    assert code == 0
    said = [line for line in report["warnings"] if line.startswith("elbow.motor: conversion makes the noise")]
    assert len(said) == 1
    wanted = {"stamps": "time stamps jitter by", "vibration": "most at 120 Hz", "noise": "declare the noise"}
    assert wanted[cause] in said[0]
    assert "record it faster" not in said[0]


def sines() -> dict[str, NDArray[Any]]:
    """A table of 20 s at 500 Hz, whose angles have the steps of the encoders of the arm file."""
    t = np.arange(10_000) / 500.0
    step = 3.8147554741741054e-4
    columns = {"t": t}
    for i in (1, 2):
        columns[f"q{i}"] = step * np.round(np.sin(0.7 * i * t + i) / step)
        columns[f"tau{i}"] = np.sin(0.7 * i * t)
    return columns


@pytest.mark.parametrize(("factor", "key"), [(180.0 / np.pi, 'unit = "deg"'), (6.0, 'side = "rotor"')])
def test_noise_that_a_unit_or_the_gear_explains_is_that_of_the_map(
    folder: Path, factor: float, key: str, tmp_path: Path
) -> None:
    columns = sines()
    write_columns(tmp_path / "x.npz", columns | {"q1": factor * columns["q1"]})
    code, report = convert(folder, tmp_path / "x.npz", CASES / "m.toml")
    (said,) = (line for line in report["warnings"] if line.startswith("shoulder.motor: conversion makes"))
    assert code in (0, 3) and f"lacks {key}; remedy" in said
    assert not any(line.startswith("elbow.motor: conversion") for line in report["warnings"])


def test_noise_of_an_angle_that_stands_still_and_jumps_is_no_unit(folder: Path, tmp_path: Path) -> None:
    """Samples that a recorder repeats for 0.1 s; what is left of the jumps looks as noisy as any factor."""
    columns = sines()
    for name in ("q1", "q2", "tau1", "tau2"):
        for start in range(1000, 10_000, 1500):
            columns[name][start : start + 50] = columns[name][start]
    write_columns(tmp_path / "x.npz", columns)
    code, report = convert(folder, tmp_path / "x.npz", CASES / "m.toml")
    said = [line for line in report["warnings"] if "motor: conversion makes" in line]
    assert code in (0, 3) and len(said) == 2 and any("jumps in " in line for line in report["warnings"])
    assert all("it jumps, as said above; remedy: cut the recording" in line for line in said)


def test_counts_are_no_radians(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = sines()
    write_columns(tmp_path / "x.npz", columns | {"q2": np.round(columns["q2"] * 65536 / (2 * np.pi))})
    assert convert(folder, tmp_path / "x.npz", CASES / "m.toml")[0] == 2
    said = capsys.readouterr().err.replace("\n", " ")
    assert "joint[1].motor: q2 reads up to 1.043e+04 rad" in said and 'unit = "counts"' in said
    write_columns(tmp_path / "y.npz", columns | {"q2": 1e3 * columns["q2"]})
    assert convert(folder, tmp_path / "y.npz", CASES / "m.toml")[0] in (0, 3)


def test_rows_that_are_there_twice_are_taken_once(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = sines()
    twice = {name: np.repeat(values, 2) for name, values in columns.items()}
    write_columns(tmp_path / "once.npz", columns)
    write_columns(tmp_path / "twice.npz", twice)
    assert convert(folder, tmp_path / "once.npz", CASES / "m.toml")[0] == 0
    code, report = convert(folder, tmp_path / "twice.npz", CASES / "m.toml")
    assert code == 0 and report["left_out"]["repeated stamps"] == 40_000
    got, expected = cycles(folder, tmp_path / "twice.npz"), cycles(folder, tmp_path / "once.npz")
    assert np.array_equal(got.theta, expected.theta) and np.array_equal(got.tau, expected.tau)
    other = twice | {"q1": twice["q1"] + 0.01 * (np.arange(20_000) % 2)}
    write_columns(tmp_path / "other.npz", other)
    assert convert(folder, tmp_path / "other.npz", CASES / "m.toml")[0] == 2
    capsys.readouterr()


@pytest.mark.slow
def test_milliseconds_are_no_slow_recording(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = sines()
    write_columns(tmp_path / "ms.npz", columns | {"t": 1e3 * columns["t"]})
    assert convert(folder, tmp_path / "ms.npz", CASES / "m.toml")[0] == 3
    assert 'remedy: correct unit = "s" of the time in the map' in capsys.readouterr().err.replace("\n", " ")
    edited(CASES / "m.toml", tmp_path / "ms.toml", ('unit = "s"', 'unit = "ms"'))
    assert convert(folder, tmp_path / "ms.npz", tmp_path / "ms.toml")[0] == 0

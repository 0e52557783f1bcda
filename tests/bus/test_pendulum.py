# SPDX-License-Identifier: MIT
"""examples/pendulum: the logs hold what was published, and their conversion what was measured."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path

import can
import numpy as np
import pytest
from cli_support import run
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from conftest import ROOT, need, tool_module
from zygos.arm import load_arm
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth
from zygos.runs.tables import read_cycles

FOLDER = ROOT / "examples" / "pendulum"
DATA = ROOT.parent / "shared" / "data" / "dfki-double-pendulum"
NAMES = ("00", "01", "02", "03", "11")
GEAR = 6.0


def source(name: str) -> Path:
    path = DATA / f"trajectory_{name}.csv.gz"
    need(path.is_file(), str(path))
    return path


def table(name: str) -> dict[str, NDArray[np.float64]]:
    with gzip.open(source(name), "rt") as stream:
        names = stream.readline().strip().split(",")
        rows = np.loadtxt(stream, delimiter=",")
    return {column: rows[:, k] for k, column in enumerate(names)}


def convert(name: str, out: Path, *more: object) -> int:
    parts = ("--dbc", FOLDER / "arm.dbc", "--map", FOLDER / "map.toml")
    return run("convert", FOLDER / f"{name}.blf", *parts, "-o", out, *more)


@pytest.mark.parametrize("name", ["03", "11"])
def test_the_frames_hold_the_published_values(name: str) -> None:
    """Decoded by the bits that the drive's protocol names, without the DBC."""
    published = table(name)
    seen: dict[int, list[tuple[float, ...]]] = {8: [], 9: []}
    for message in can.LogReader(str(FOLDER / f"{name}.blf")):
        assert (message.arbitration_id, message.is_extended_id, message.dlc) == (0, False, 6)
        drive, *code = message.data
        bits = int.from_bytes(bytes(code), "big")
        position, velocity, torque = bits >> 24, (bits >> 12) & 0xFFF, bits & 0xFFF
        values = (position * 25 / 65535 - 12.5, velocity * 45 / 4095 - 22.5, torque * 24 / 4095 - 12.0)
        seen[drive].append((message.timestamp, *values))
    for joint, drive in ((1, 8), (2, 9)):
        got = np.array(seen[drive]).T
        assert np.max(np.abs(got[0] - got[0][0] - published["time"])) < 2e-6
        for row, field in zip(got[1:], ("pos", "vel", "tau"), strict=True):
            np.testing.assert_allclose(-row, published[f"{field}_meas{joint}"], atol=1e-9)


def test_the_shipped_logs_are_those_of_the_tool(tmp_path: Path) -> None:
    tool_module("pendulum").write(source("11"), tmp_path / "11.blf")
    wrote, shipped = (
        [(m.timestamp, bytes(m.data)) for m in can.LogReader(str(folder / "11.blf"))] for folder in (tmp_path, FOLDER)
    )
    assert wrote == shipped
    assert sum((FOLDER / f"{name}.blf").stat().st_size for name in NAMES) < 1_500_000


def test_values_between_the_steps_are_no_frames() -> None:
    with pytest.raises(ValueError, match="do not lie on the steps"):
        tool_module("pendulum").counts(np.array([0.0]), 12.5, 16)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_each_recording_becomes_a_run(name: str, tmp_path: Path) -> None:
    assert convert(name, tmp_path / "run.npz", "--json", tmp_path / "c.json") == 0
    content = json.loads((tmp_path / "c.json").read_text())
    assert content["breaks"] == 0
    assert ["its cut-off of 5 Hz takes more" in line for line in content["warnings"]] == [True]
    assert {(row["left_out"], row["turns"], row["holes"]) for row in content["signals"]} == {(0, 0, 0)}
    arm = load_arm(tmp_path / "arm.toml")
    assert arm.smoother.cutoff_hz == 5.0
    assert arm.torque_averaged  # from 500 Hz to 100 Hz
    quantum = 25 / 65535
    for joint in arm.joints:
        assert math.sqrt(0.15) * quantum < joint.motor_encoder.quantum_rad < 1.3 * quantum
        assert joint.torque_sigma == 0.0


def test_a_window_that_is_too_long_on_board_is_used_on_the_ground(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At 250 Hz the cut-off of 5 Hz needs 63 points: the conversion says so, the estimate takes them, and the flight
    library refuses them with the period that it needs."""
    text = (FOLDER / "arm.toml").read_text()
    (tmp_path / "fast.toml").write_text(text.replace("period_s = 0.01 ", "period_s = 0.004 "))
    for out in ("run.log", "run.npz"):  # a log is read by the receiver of the library
        folder = tmp_path / out.replace(".", "-")
        folder.mkdir()
        assert convert("00", folder / out, "--arm", tmp_path / "fast.toml", "--json", tmp_path / "c.json") == 0
        warnings = json.loads((tmp_path / "c.json").read_text())["warnings"]
        assert any("63 points" in line and "a period_s of at least 0.00809" in line for line in warnings)
        assert run("estimate", folder / out, "-o", tmp_path / "m.toml") == 0  # partial: one run is not enough
        capsys.readouterr()
        assert run("estimate", "--flight", folder / out, "-o", tmp_path / "f.toml") == 2
        assert "a period_s of at least 0.00809" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["03"])
def test_the_rates_are_those_that_the_drives_measured(name: str, tmp_path: Path) -> None:
    """Signs, sides and timing, by the velocities of the replies, which the map does not name: integrated and smoothed
    by the same window they are the same to 2 %, and worse 5 ms earlier or later."""
    published = table(name)
    assert convert(name, tmp_path / "run.npz") == 0
    arm = load_arm(tmp_path / "arm.toml")
    cycles = read_cycles(tmp_path / "run.npz", arm)
    smoothed = smooth(arm, calibrate(arm, cycles))
    begin = published["time"][0] + 0.02  # the averages reach 20 ms to both sides
    at = begin + 0.01 * np.arange(len(cycles))
    fit = np.linalg.pinv(np.vander(np.arange(-12, 13) * 0.01, 5, increasing=True))
    for joint in (1, 2):
        angle = cumulative_trapezoid(published[f"vel_meas{joint}"], published["time"], initial=0.0)
        own = smoothed.qd[:, joint - 1]
        off = {}
        for shift in (-0.005, 0.0, 0.005):
            moved = np.interp(at + shift, published["time"], angle)
            off[shift] = float(np.std(sliding_window_view(moved, 25) @ fit[1] - own) / np.std(own))
        assert min(off, key=lambda shift: off[shift]) == 0.0
        assert off[0.0] < 0.02
        inner = (published["time"] > at[0]) & (published["time"] < at[-1])
        assert GEAR * cycles.tau[:, joint - 1].mean() == pytest.approx(
            published[f"tau_meas{joint}"][inner].mean(), abs=2e-3
        )

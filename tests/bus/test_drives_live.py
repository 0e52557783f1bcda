# SPDX-License-Identifier: MIT
"""Frames of drives, classical, of 29 bits and CAN FD: `zygos simulate` sends them, and `zygos listen` hears them."""

from __future__ import annotations

import re
import shutil
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from bus_support import playing
from cli_support import run
from ground_support import recorded, short_arm
from numpy.typing import NDArray

from conftest import EXAMPLE, ROOT
from oracles import openarm
from zygos.arm import load_arm, save_arm
from zygos.can import bus
from zygos.can.run import read_run
from zygos.cli import listen
from zygos.model.model import load_model
from zygos.telemetry.drives import read_drives
from zygos.telemetry.frames import Encoder

URDF = ROOT / "examples" / "openarm" / "openarm.urdf"
PANDA = ROOT / "examples" / "laboratory" / "panda"


def damiao(data: bytes) -> tuple[float, float]:
    """16 bits of 12.5 rad and 12 bits of 200 Nm: decode_sensor_feedback() of the package damiao-motor 1.0.6."""
    return 25.0 * (data[1] << 8 | data[2]) / 65535 - 12.5, 400.0 * ((data[4] & 15) << 8 | data[5]) / 4095 - 200.0


def robstride(data: bytes) -> tuple[float, float]:
    """receive_status_frame() of RobStride's robstride_dynamics: (u16 / 0x7FFF - 1) of 4 pi rad and of 120 Nm."""
    angle, _, torque, _ = struct.unpack(">HHHH", data)
    return 4.0 * np.pi * (angle / 0x7FFF - 1.0), 120.0 * (torque / 0x7FFF - 1.0)


def moteus(data: bytes) -> tuple[float, float]:
    """RegisterParser of the package moteus 1.1.1: registers 1 to 3 as floats, in turns and Nm."""
    assert data[3:5] == b"\x2f\x01"
    turn, _, torque = struct.unpack_from("<fff", data, 5)
    return 2.0 * np.pi * turn, torque


@dataclass(frozen=True)
class Case:
    drive: str
    nodes: str
    identifiers: tuple[int, ...]
    extended: tuple[bool, ...]
    fd: bool
    read: Callable[[bytes], tuple[float, float]]
    steps: tuple[float, float]
    """rad, Nm"""


CASES = [
    Case("damiao:DM10010", "1-7", tuple(range(0x11, 0x18)), (False,) * 7, False, damiao, (25 / 65535, 400 / 4095)),
    Case("robstride:RS04", "1-7", tuple(0x02800000 + 0x100 * node for node in range(1, 8)), (True,) * 7, False,
         robstride, (4 * np.pi / 0x7FFF, 120 / 0x7FFF)),
    Case("moteus", "6-12", tuple(0x100 * node for node in range(6, 13)), (False,) * 2 + (True,) * 5, True, moteus,
         (1e-6, 1e-4)),
]  # fmt: skip


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("panda") / "panda"
    shutil.copytree(PANDA, folder)
    file = folder / "learn.toml"
    file.write_text(re.sub(r"duration_s = \S+", "duration_s = 0.5", file.read_text()))
    return file


@pytest.fixture(scope="module")
def readings(scenario: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[NDArray[np.float64], ...]:
    """Angles and torques behind the gears (n, 7) of the same run in frames of zygos."""
    log = tmp_path_factory.mktemp("plain") / "run.log"
    assert run("simulate", scenario, "-o", log) == 0
    arm = load_arm(log.with_name("arm.toml"))
    cycles = read_run(log, arm).cycles
    return cycles.theta, cycles.tau * (1.0 if arm.torque_at == "joint" else arm.gear_ratios)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.drive)
def test_simulated_frames_of_drives(
    case: Case, scenario: Path, readings: tuple[NDArray[np.float64], ...], tmp_path: Path
) -> None:
    """On a bus and in a log they are the same, and what the maker's code reads from them is what the run has."""
    log = tmp_path / "run.blf"
    with can.Bus(interface="virtual", channel="test_simulated") as heard:
        where = ("-i", "virtual", "-c", "test_simulated")
        assert run("simulate", scenario, "-o", log, "--drive", case.drive, "--nodes", case.nodes, *where) == 0
        live = [message for message in iter(lambda: heard.recv(0), None)]
    written = list(bus.read_messages(log, []))
    angles, torques = readings
    assert len(live) == len(written) and abs(len(written) - angles.size) <= 7
    for one, other in zip(live, written, strict=True):
        assert one.equals(other, timestamp_delta=None, check_channel=False, check_direction=False)
    assert [one.arbitration_id for one in written[:7]] == list(case.identifiers)
    assert [one.is_extended_id for one in written[:7]] == list(case.extended)
    assert {one.is_fd for one in written} == {case.fd}
    told = np.array([case.read(bytes(one.data)) for one in written[: angles.size]]).reshape(-1, 7, 2)
    assert np.abs(told[..., 0] - angles).max() <= 0.5 * case.steps[0] + 2e-6
    assert np.abs(told[..., 1] - torques).max() <= 0.5 * case.steps[1] + 0.02
    assert np.ptp(angles, axis=0).min() > 10 * case.steps[0]


@pytest.mark.slow
def test_listening_to_drives_is_converting_and_estimating(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """CAN FD frames with identifiers of 11 and 29 bits among others: the model is that of the log, bit by bit."""
    arm, model = short_arm()
    save_arm(arm, tmp_path / "arm.toml")
    drives = read_drives("moteus", "6-8")
    messages = Encoder(drives.dictionary(), drives.mapping(arm)).messages(recorded(arm, model).cycles, arm)
    stranger = can.Message(arbitration_id=0x601, is_extended_id=False, data=b"\x2f\x01\0\0\0\0\0\0")
    log = tmp_path / "run.log"
    bus.write_messages(log, [one for message in messages for one in (stranger, message)])
    named = ("--drive", "moteus", "--nodes", "6-8", "--arm", tmp_path / "arm.toml")
    with playing("test_drives", log):
        where = ("-i", "virtual", "-c", "test_drives", "--idle", 1)
        files = ("-o", tmp_path / "live.toml", "--log", tmp_path / "live.log", "--report", tmp_path / "live.html")
        assert run("listen", *named, *where, *files) == 0
    assert "22 of 22 parameters determined" in capsys.readouterr().out
    answers = listen._Answers(arm, drives, scatter=False)
    for message in messages:
        assert answers.counts(message)
    assert answers.line() == f"{len(messages):,} frames · 6/6 signals"
    heard = list(bus.read_messages(tmp_path / "live.log", []))
    assert len(heard) == 2 * len(messages) and all(one.is_fd for one in heard[1::2])
    assert (tmp_path / "live.html").read_text().startswith("<!doctype html>")
    assert run("convert", log, *named, "-o", tmp_path / "a" / "run.npz") == 0
    assert run("estimate", tmp_path / "a" / "run.npz", "-o", tmp_path / "later.toml") == 0
    live, later = load_model(tmp_path / "live.toml"), load_model(tmp_path / "later.toml")
    assert np.array_equal(live.base_values(arm), later.base_values(arm))
    assert [one.value for one in live.effects] == [one.value for one in later.effects] != []


ON = ("-i", "virtual", "-c", "test_refused", "--duration", "0.3")
NAMED = ("--drive", "damiao", "--nodes", "1-7")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "give its file with --arm, or with --drive its --urdf"),
        (("--urdf", URDF), "--urdf belongs to --drive"),
        (("--drive", "damiao", "--urdf", URDF), "add for instance --nodes 1-7"),
        ((*NAMED, "--urdf", URDF, "--arm", "arm.toml"), "both describe the arm"),
        ((*NAMED, "--urdf", URDF), "virtual test_refused has no Drive1.Position"),
        (("--drive", "moteus", "--nodes", "1-6", "--arm", PANDA / "arm.toml"), "names 6 drives, but arm"),
        (("--drive", "moteus", "--nodes", "1,2", "--arm", EXAMPLE / "arm.toml"), "floats or has flexible joints"),
    ],
)
def test_listening_refused(
    options: tuple[object, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("listen", *options, *ON, "-o", tmp_path / "m.toml") == 2
    err = capsys.readouterr().err.replace("\n", " ")
    assert said in err and "remedy: " in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--nodes", "1-7"), "belongs to --drive"),
        (("--drive", "moteus", "--nodes", "1-6"), "names 6 drives, but arm"),
        pytest.param(
            ("--drive", "damiao:DM4310", "--nodes", "1-7"),
            ".Torque of the drives carries at most 10; remedy: name",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_simulating_refused(
    options: tuple[object, ...], said: str, scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("simulate", scenario, *options, "-o", tmp_path / "run.log") == 2
    err = capsys.readouterr().err.replace("\n", " ")
    assert said in err and "remedy: " in err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_seven_drives_at_500_hz_on_can_fd_leave_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hearing, decoding and recording an answer takes at most half of the time in which the next one comes."""
    sent, heard = tmp_path / "sent.log", tmp_path / "heard.log"
    openarm.candump(openarm.wave(6.0), sent, seed=0)
    hear, spent_s = listen._hear, [0.0]

    def measured(*arguments: Any) -> Any:
        before = time.thread_time()
        try:
            return hear(*arguments)
        finally:
            spent_s[0] = time.thread_time() - before

    monkeypatch.setattr(listen, "_hear", measured)
    with playing("test_pace", sent):
        run("listen", *NAMED, "--urdf", URDF, "-i", "virtual", "-c", "test_pace", "--idle", 2, "--log", heard)
    told, known = ([bytes(one.data) for one in bus.read_messages(file, [])] for file in (heard, sent))
    assert told == known
    assert len(told) > 20_000
    assert 0.0 < spent_s[0] / len(told) < 0.5 * openarm.PERIOD_S / 7

# SPDX-License-Identifier: MIT
"""can-utils as foreign clients: they share no code with either end, and what they recorded is what is judged."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
from vcan_support import candump

from zygos.can import bus
from zygos.testing import Dut, Plant
from zygos.testing.dut import HEARTBEAT, TELEMETRY
from zygos.testing.stream import Stream


def heard(plant: Plant, log: Path) -> Stream:
    """What candump recorded, but for what the device said."""
    frames = bus.read_log(log).frames
    return Stream.recorded(plant.arm, frames[~np.isin(frames["id"], [TELEMETRY, HEARTBEAT])])


def test_canplayer_replays_a_log_and_candump_records_the_answers(plant: Plant, dut: Dut, tmp_path: Path) -> None:
    """Ten times as fast as life: nobody waits for the node."""
    stream = plant.run(400)
    recording = bus.LogWriter(tmp_path / "run.log")
    messages = stream.messages()
    for message in messages:
        message.timestamp /= 10.0
    recording.append(messages)
    recording.finish()
    dut.start()
    with candump(plant.channel, tmp_path / "heard.log"):
        player = ["canplayer", "-I", str(tmp_path / "run.log"), f"{plant.channel}=can0"]
        subprocess.run(player, check=True, stdin=subprocess.DEVNULL)
        dut.settle()
    assert np.array_equal(heard(plant, tmp_path / "heard.log").frames, stream.frames)
    recorded = [m.data for m in bus.read_messages(tmp_path / "heard.log", []) if m.arbitration_id == TELEMETRY]
    assert recorded == [message.data for message in dut.telemetry()]
    assert len(recorded) >= 400
    dut.judge(stream)


CANSEND: dict[str, dict[str, int]] = {
    "181#0011223344556677": {"crc": 1},
    "181#00112233": {"length": 1},
    "080#": {"length": 1},
    "080#F1": {"range": 1},
    "080#R": {},
    "00000181#0011223344556677": {},
    "181##00011223344556677": {},
    "18F#0011223344556677": {},
}
"""A frame by hand, and what the device counts."""


def test_cansend_disturbs(plant: Plant, dut: Dut, tmp_path: Path) -> None:
    stream = plant.run(400)
    dut.start()
    with candump(plant.channel, tmp_path / "heard.log"):
        plant.send(stream.part(0, 150))
        for frame in CANSEND:
            subprocess.run(["cansend", plant.channel, frame], check=True)
        plant.send(stream.part(150))
    said = heard(plant, tmp_path / "heard.log")
    assert len(said) == len(stream) + len(CANSEND)
    dut.judge(said, **sum(map(Counter, CANSEND.values()), Counter()))


def test_cangen_disturbs(plant: Plant, dut: Dut, tmp_path: Path) -> None:
    """256 frames that bear the identifier of joint 1's torque, with zeros but for the first byte, which counts.

    So each CRC comes once, and one of them is right; but counter 0 is not that of cycle 149 or 148.
    """
    stream = plant.run(400)
    dut.start()
    with candump(plant.channel, tmp_path / "heard.log"):
        plant.send(stream.part(0, 150))
        subprocess.run(["cangen", plant.channel, "-g", "0", "-n", "256", "-I", "281", "-L", "8", "-D", "i"], check=True)
        plant.send(stream.part(150))
    said = heard(plant, tmp_path / "heard.log")
    assert len(said) == len(stream) + 256
    dut.judge(said, crc=255, counter=1)

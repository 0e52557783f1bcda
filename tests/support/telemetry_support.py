# SPDX-License-Identifier: MIT
"""Logs as somebody else would record them: cantools' own encoder writes cycles under a DBC that is not zygos'.

Which unit, side and sign a signal has is written here a second time, as numbers, and shares nothing with the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from conftest import ROOT
from zygos.runs.cycles import Cycles

EXAMPLE = ROOT / "examples" / "telemetry"
GEAR = 50.0
COUNTS_PER_TURN = 65536
RPM = 60.0 / (2.0 * math.pi)
STEPS = {
    "q": math.radians(1e-4),
    "theta": 2 * math.pi / COUNTS_PER_TURN / GEAR,
    "tau": 1e-3 / GEAR,
    "omega": 1e-6 / RPM,
}
"""What one code of each field is worth in `Cycles`."""

Stamp = Callable[[int, str], float]
"""Stamp of the k-th cycle's message of that name, s."""


def messages(
    cycles: Cycles, stamp: Stamp, *, first_count: int = 0, time_s: Sequence[float] | NDArray[np.float64] | None = None
) -> list[can.Message]:
    """The cycles as messages of examples/telemetry/arm.dbc, in the order of their stamps."""
    database = cantools.database.load_file(str(EXAMPLE / "arm.dbc"))
    out = []

    def put(name: str, k: int, **signals: float) -> None:
        message = database.get_message_by_name(name)
        data = message.encode(signals)
        out.append(
            can.Message(
                timestamp=stamp(k, name),
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                data=data,
            )
        )

    for k in range(len(cycles)):
        seconds = 0.05 * k if time_s is None else float(time_s[k])
        put("Cycle", k, Count=(int(cycles.sync[k]) + first_count) % 65536, Time=(seconds * 1e3) % (2**32 / 10))
        for i in (0, 1):
            turns = -GEAR * cycles.theta[k, i] / (2 * math.pi)
            put(f"Drive{i + 1}Position", k, Motor=round(turns * COUNTS_PER_TURN), Link=math.degrees(cycles.q[k, i]))
            put(f"Drive{i + 1}Torque", k, Output=round(-1000.0 * GEAR * cycles.tau[k, i]))
        put("RatesXY", k, X=cycles.omega[k, 0] * RPM, Y=cycles.omega[k, 1] * RPM)
        put("RateZ", k, Z=cycles.omega[k, 2] * RPM)
    return sorted(out, key=lambda message: message.timestamp)


def write(path: Path, log: Sequence[can.Message]) -> Path:
    """Write a log in the format of the suffix."""
    with can.Logger(str(path)) as logger:
        for message in log:
            message.channel = "can0" if path.suffix == ".log" else 0
            logger.on_message_received(message)
    return path


def edited(path: Path, out: Path, *changes: tuple[str, str]) -> Path:
    """Copy a text file; every change must find its text."""
    text = path.read_text()
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    out.write_text(text)
    return out


def drawn_signals(path: Path) -> tuple[dict[str, list[tuple[int, Any]]], dict[str, str]]:
    """Times in ns and messages of each topic of an MCAP, as the decoder of its own package reads them, and units."""
    messages: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, record, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append((record.log_time, message))
        (units,) = reader.iter_metadata()
    return messages, units.metadata

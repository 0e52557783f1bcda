# SPDX-License-Identifier: MIT
"""The telemetry of a flight computer, frame 0x1A0: one round for each complete estimate."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import can
import numpy as np
from cantools.database.can import Database

from zygos.files.names import ascii_name
from zygos.native.flight import ffi, lib, text_of
from zygos.native.refine import Refined

TELEMETRY = 0x1A0
"""Identifier of its frames."""
_MODULUS = 2.0**24
"""Of counts, which a float holds exactly below it."""


class Telemetry:
    """Takes the messages of a bus one by one, and keeps the newest complete round of the flight computer.

    Names are those of the signals: k1, k1_sigma, fault_crc, verdict_cycle. Values that were not finite are missing,
    because they are never sent. A round begins with verdict_validity, and is complete when the next one begins.
    """

    def __init__(self, database: Database) -> None:
        """database: the DBC of the arm."""
        self.newest: dict[str, float] | None = None
        """The newest complete round."""
        self._message = database.get_message_by_frame_id(TELEMETRY)
        self._names = {place: one.name for one in self._message.signals for place in one.multiplexer_ids or ()}
        self._current: dict[str, float] | None = None

    def take(self, message: can.Message) -> bool:
        """Take a message; others than telemetry, damaged ones, and items that the DBC does not have are passed over.

        Returns whether it has made a round complete, which is the newest then.
        """
        if message.arbitration_id != TELEMETRY or message.is_extended_id or message.is_error_frame:
            return False
        frame, value = ffi.new("zygos_frame_t *"), ffi.new("float *")
        frame.id, frame.length = TELEMETRY, len(message.data)
        frame.data = bytes(message.data[:8]).ljust(8, b"\0")
        counter, index, kind = (ffi.new("uint8_t *") for _ in range(3))
        if lib.zygos_wire_decode_telemetry(frame, counter, index, kind, value) != lib.ZYGOS_WIRE_OK:
            return False
        name = self._names.get(index[0] + 256 * kind[0])
        begins = name == "verdict_validity"
        complete = begins and self._current is not None
        if begins:
            self.newest, self._current = self._current, {}
        if name is not None and self._current is not None:
            self._current[name] = float(value[0])
        return complete


def rounds(database: Database, messages: Iterable[can.Message]) -> list[dict[str, float]]:
    """The complete rounds among messages, in their order; the last one may be cut off and is left out."""
    telemetry = Telemetry(database)
    return [telemetry.newest for message in messages if telemetry.take(message) and telemetry.newest is not None]


def refined_of(told: dict[str, float], names: Sequence[str]) -> Refined | None:
    """What a round tells of the refinement; None where it tells nothing, or a count is missing or impossible.

    names: those of the p parameters without effects. Values that are not published are NaN, and counts are modulo 2^24.
    """

    def number(name: str) -> float:
        return told.get(f"refined_{name}", math.nan)

    counts = [number(name) for name in ("reason", "farthest", "cycle", "used", "lost", "restarts", "rejected")]
    if not all(0.0 <= count < _MODULUS for count in counts) or not counts[1] < len(names):
        return None
    reason, farthest, cycle, used, lost, restarts, rejected = map(int, counts)
    channels = ("link", "motor", "gyro")
    plain = [ascii_name(name) for name in names]
    return Refined(
        published=reason == lib.ZYGOS_REFINE_NONE,
        reason=reason,
        text=text_of(lib.zygos_refine_text, reason),
        value=np.array([told.get(f"{name}_refined", math.nan) for name in plain]),
        sigma=np.array([told.get(f"{name}_refined_sigma", math.nan) for name in plain]),
        level=number("level"),
        level_error=number("level_error"),
        nis=np.array([number(f"nis_{channel}") for channel in channels]),
        ratio=np.array([number(f"ratio_{channel}") for channel in channels]),
        farthest=farthest,
        distance=number("distance"),
        cycle=cycle,
        used=used,
        lost=lost,
        restarts=restarts,
        rejected=rejected,
    )

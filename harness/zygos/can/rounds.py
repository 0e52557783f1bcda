"""The telemetry of a flight computer, frame 0x1A0: one round for each complete estimate."""

from __future__ import annotations

from collections.abc import Iterable

import can
from cantools.database.can import Database

TELEMETRY = 0x1A0
"""Identifier of its frames."""


def rounds(database: Database, messages: Iterable[can.Message]) -> list[dict[str, float]]:
    """The complete rounds among messages, in their order, decoded by the arm's DBC; other messages are passed over.

    Names are those of the signals: k1, k1_sigma, fault_crc, verdict_cycle. Values that were not finite are missing,
    because they are never sent. A round begins with verdict_validity; the last one may be cut off and is left out.
    """
    found: list[dict[str, float]] = []
    for message in messages:
        if message.arbitration_id != TELEMETRY:
            continue
        decoded = database.decode_message(TELEMETRY, bytes(message.data), decode_choices=False)
        assert isinstance(decoded, dict)
        name, value = next(reversed(decoded.items()))
        assert isinstance(value, float | int)
        if name == "verdict_validity":
            found.append({})
        if found:
            found[-1][name] = value
    return found[:-1]

# SPDX-License-Identifier: MIT
"""Share of a classical CAN bus that an arm's frames take: in the worst case, and in a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.dbc import arm_database, cycles_between
from zygos.can.wire import ERROR, EXTENDED, FD, REMOTE, SYNC_MODULUS, database
from zygos.errors import ZygosError

LIMIT = 0.7
"""Share of the bus that planned traffic may take; the rest is for repetitions and other traffic."""


OTHERS = "others"
"""Name under which all foreign frames are counted."""


_CRC15 = 0x4599


_UNSTUFFED = 13
"""Bits of CRC delimiter, acknowledge slot and its delimiter, end of frame, and the space before the next frame."""


def worst_bits(length: int) -> int:
    """Bits of a data frame with 11-bit identifier and `length` bytes in the worst case of bit stuffing, with the space
    after it: Davis et al., Real-Time Systems 35 (2007) 239, eq. (1), and 3 bits of space."""
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED


def exact_bits(frames: NDArray[Any]) -> NDArray[np.int64]:
    """(n,) bits that `FRAME` records take on the bus, stuff bits and the space after each frame included.

    Error and CAN FD frames count 0, because a record does not contain their bits. A remote frame is assumed to request
    0 bytes.
    """
    bits = np.zeros(len(frames), dtype=np.int64)
    classical = (frames["flags"] & (ERROR | FD)) == 0
    extended = (frames["flags"] & EXTENDED) > 0
    for length in range(9):
        for long in (False, True):
            chosen = np.flatnonzero(classical & (extended == long) & (frames["length"] == length))
            if len(chosen):
                bits[chosen] = _with_stuffing(_columns(frames[chosen], long, length)) + _UNSTUFFED
    return bits


def _columns(frames: NDArray[Any], extended: bool, length: int) -> list[NDArray[np.int64]]:
    """Bits of frames with one layout, from the start of frame to the last bit of the CRC; each array is (n,)."""

    def split(value: NDArray[np.int64], width: int) -> list[NDArray[np.int64]]:
        return [(value >> k) & 1 for k in reversed(range(width))]

    identifier = frames["id"].astype(np.int64)
    zero, one = np.zeros_like(identifier), np.ones_like(identifier)
    remote = np.where(frames["flags"] & REMOTE, one, zero)
    if extended:
        columns = [zero, *split(identifier >> 18, 11), one, one, *split(identifier, 18), remote, zero, zero]
    else:
        columns = [zero, *split(identifier, 11), remote, zero, zero]
    columns += split(zero + length, 4)
    for byte in range(length):
        columns += split(frames["data"][:, byte].astype(np.int64), 8)
    crc = zero
    for bit in columns:
        crc = ((crc << 1) & 0x7FFF) ^ np.where((crc >> 14) ^ bit, _CRC15, 0)
    return columns + split(crc, 15)


def _with_stuffing(columns: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """(n,) number of these bits plus the stuff bits: after five equal bits, one of opposite value is inserted."""
    last, run = np.full_like(columns[0], -1), np.zeros_like(columns[0])
    added = np.zeros_like(run)
    for bit in columns:
        run = np.where(bit == last, run + 1, 1)
        full = run == 5
        added += full
        last, run = np.where(full, 1 - bit, bit), np.where(full, 1, run)
    return added + len(columns)


@dataclass(frozen=True)
class Share:
    """Share of a bus that one message takes in the worst case."""

    name: str
    id: int
    bytes: int
    bits: int
    """Longest frame on the bus, in bits."""
    rate_hz: float
    load: float
    """Load of the bus by this message; 1 is the whole bus."""


@dataclass(frozen=True)
class Plan:
    """The worst-case traffic of an arm on a bus."""

    shares: tuple[Share, ...]
    load: float
    largest_sync_hz: float
    """The SYNC rate that loads the bus to LIMIT, Hz; 0 if attitude and telemetry alone exceed it."""


def plan(arm: Arm, bitrate: int, attitude_hz: float | None = None, telemetry_hz: float = 100.0) -> Plan:
    """The worst-case load of an arm's frames on a bus of `bitrate` bit/s.

    SYNC, joints and gyro are sent once a cycle, FTIME as often as zygos.dbc states, attitude (None: 100 Hz where there
    is a gyro, otherwise none) and telemetry at the given rates. Errors: ZygosError for an attitude without a gyro.
    """
    if attitude_hz and not arm.free:
        raise ZygosError(
            f"arm {arm.name}: a fixed base has no gyro to send an attitude; remedy: leave --attitude-hz out"
        )
    own = {"IMU_ATTITUDE": 100.0 if attitude_hz is None else attitude_hz, "TELEMETRY": telemetry_hz, "HEARTBEAT": 1.0}
    # the shipped file states the interval of FTIME exactly; in the arm's own file it is rounded to milliseconds
    per_cycle = {"FTIME": 1.0 / cycles_between(database().get_message_by_name("FTIME"))}
    shares = []
    bits_per_cycle = bits_per_second = 0.0
    for message in arm_database(arm).messages:
        bits = worst_bits(message.length)
        if message.name in own:
            rate = own[message.name]
            bits_per_second += bits * rate
        else:
            rate = per_cycle.get(message.name, 1.0) / arm.period_s
            bits_per_cycle += bits * rate * arm.period_s
        shares.append(Share(message.name, message.frame_id, message.length, bits, rate, bits * rate / bitrate))
    largest = max(0.0, (LIMIT * bitrate - bits_per_second) / bits_per_cycle)
    return Plan(tuple(shares), sum(share.load for share in shares), largest)


@dataclass(frozen=True)
class Usage:
    """What the frames of a log took of a bus, from the first SYNC to the last."""

    duration_s: float
    """Number of cycles according to the SYNC counters, times the arm's period, s."""
    frames: dict[str, int]
    """Number of frames by name of the arm's message, and of OTHERS."""
    bits: dict[str, int]
    load: float
    busiest: float
    """Load of the cycle with the most bits."""
    uncounted: int
    """Number of error and CAN FD frames, whose bits are unknown."""


def usage(arm: Arm, bitrate: int, frames: NDArray[Any], bits: NDArray[np.int64]) -> Usage:
    """Load of a bus of `bitrate` bit/s by `FRAME` records (n,) that take `bits` (n,).

    Times are those of the SYNC counters; the time stamps of a log are not used. Errors: ZygosError if no cycle passes.
    """
    names = {message.frame_id: message.name for message in arm_database(arm).messages}
    plain = frames["flags"] == 0
    syncs = np.flatnonzero(plain & (frames["id"] == 0x080) & (frames["length"] == 1))
    steps = np.diff(frames["data"][syncs, 0].astype(np.int64)) % SYNC_MODULUS
    if not steps.any():
        raise ZygosError("the log holds no two different SYNCs (0x080); remedy: record a bus whose SYNC is running")
    inside = slice(syncs[0], syncs[-1])
    frames, plain, bits = frames[inside], plain[inside], bits[inside]
    per_cycle = np.add.reduceat(bits, syncs[:-1] - syncs[0])
    found: dict[str, int] = {}
    taken: dict[str, int] = {}
    others = np.ones(len(frames), dtype=bool)
    for identifier, name in names.items():
        chosen = plain & (frames["id"] == identifier)
        others &= ~chosen
        found[name], taken[name] = int(chosen.sum()), int(bits[chosen].sum())
    uncounted = (frames["flags"] & (ERROR | FD)) > 0
    others &= ~uncounted
    found[OTHERS], taken[OTHERS] = int(others.sum()), int(bits[others].sum())
    capacity = bitrate * arm.period_s
    return Usage(
        float(steps.sum() * arm.period_s),
        found,
        taken,
        float(bits.sum() / (steps.sum() * capacity)),
        float((per_cycle[steps > 0] / (steps[steps > 0] * capacity)).max()),
        int(uncounted.sum()),
    )

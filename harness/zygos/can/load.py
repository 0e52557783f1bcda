"""How much of a classical CAN bus an arm's frames take: at worst, and in a log."""

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
"""Share of the bus that planned traffic may take: the rest is for repetitions and for others."""


OTHERS = "others"
"""Name of all frames that are none of the arm's."""


_CRC15 = 0x4599


_UNSTUFFED = 13
"""CRC delimiter, acknowledge and its delimiter, end of frame, and the space before the next frame."""


def worst_bits(length: int) -> int:
    """Bits of a data frame with 11-bit identifier and `length` bytes where stuffing is at its worst, with the space
    behind it: Davis et al., Real-Time Systems 35 (2007) 239, eq. (1), and 3 bits of space."""
    stuffed = 34 + 8 * length
    return stuffed + (stuffed - 1) // 4 + _UNSTUFFED


def exact_bits(frames: NDArray[Any]) -> NDArray[np.int64]:
    """(n,) bits that `FRAME` records take on the bus, stuff bits and the space behind each frame included.

    Error and CAN FD frames, whose bits a record does not tell, count 0. A remote frame is taken as asking for 0 bytes.
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
    """Frames of one layout, bit by bit from the start of frame to the last of the CRC; each (n,)."""

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
    """(n,) number of these bits and of those that stuffing adds: after five alike, one of the other kind."""
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
    """What one message takes of a bus at worst."""

    name: str
    id: int
    bytes: int
    bits: int
    """Worst length of a frame on the bus."""
    rate_hz: float
    load: float
    """1 is all of the bus."""


@dataclass(frozen=True)
class Plan:
    """The worst-case traffic of an arm on a bus."""

    shares: tuple[Share, ...]
    load: float
    largest_sync_hz: float
    """The SYNC rate that loads the bus to LIMIT; 0 where attitude and telemetry alone load it more."""


def plan(arm: Arm, bitrate: int, attitude_hz: float | None = None, telemetry_hz: float = 100.0) -> Plan:
    """The worst-case load of an arm's frames on a bus of `bitrate` bit/s.

    SYNC, joints and gyro once a cycle, FTIME as often as zygos.dbc says, attitude (None: 100 where there is a gyro)
    and telemetry at rates of their own. Errors: ZygosError for an attitude without a gyro.
    """
    if attitude_hz and not arm.free:
        raise ZygosError(
            f"arm {arm.name}: a fixed base has no gyro to send an attitude; remedy: leave --attitude-hz out"
        )
    own = {"IMU_ATTITUDE": 100.0 if attitude_hz is None else attitude_hz, "TELEMETRY": telemetry_hz, "HEARTBEAT": 1.0}
    # how often FTIME comes is exact in the shipped file; the arm's own is rounded to milliseconds
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
    """What a log took of a bus, from its first SYNC to its last."""

    duration_s: float
    """The cycles that the SYNC counters count, times the arm's period."""
    frames: dict[str, int]
    """By name of the arm's message, and OTHERS."""
    bits: dict[str, int]
    load: float
    busiest: float
    """Load of the fullest cycle."""
    uncounted: int
    """Error and CAN FD frames."""


def usage(arm: Arm, bitrate: int, frames: NDArray[Any], bits: NDArray[np.int64]) -> Usage:
    """What `FRAME` records (n,) and their bits (n,) took of a bus of `bitrate` bit/s.

    Times are those of the SYNC counters: the stamps of a log decide nothing. Errors: ZygosError where no cycle passes.
    """
    names = {message.frame_id: message.name for message in arm_database(arm).messages}
    plain = frames["flags"] == 0
    syncs = np.flatnonzero(plain & (frames["id"] == 0x080) & (frames["length"] == 1))
    steps = np.diff(frames["data"][syncs, 0].astype(np.int64)) % SYNC_MODULUS
    if not steps.any():
        raise ZygosError("the log holds no two SYNCs (0x080) that differ; remedy: record a bus whose SYNC runs")
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
    room = bitrate * arm.period_s
    return Usage(
        float(steps.sum() * arm.period_s),
        found,
        taken,
        float(bits.sum() / (steps.sum() * room)),
        float((per_cycle[steps > 0] / (steps[steps > 0] * room)).max()),
        int(uncounted.sum()),
    )

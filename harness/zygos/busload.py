"""How much of a classical CAN bus an arm's frames take: at worst, and in a log."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, load_arm
from zygos.bus import check_log
from zygos.commands import damage_of, not_whole, progress, read_run
from zygos.dbc import arm_database, cycles_between
from zygos.errors import Undecided, ZygosError
from zygos.output import check_outputs, counted, note, number, say, table, write_json
from zygos.reference.wire import ERROR, EXTENDED, FD, REMOTE, SYNC_MODULUS, database

LIMIT = 0.7
"""Share of the bus that planned traffic may take: the rest is for repetitions and for others."""
OTHERS = "others"
"""Name of all frames that are none of the arm's."""
_FASTEST = 1_000_000
"""Bits per second of classical CAN."""
_LONGEST_S = 0.065
"""SYNC period above which no arm file may go (docs/wire.md)."""
_CRC15 = 0x4599
_UNSTUFFED = 13
"""CRC delimiter, acknowledge and its delimiter, end of frame, and the space before the next frame."""
_AT_ONCE = 65_536
"""Frames whose bits are counted together."""


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


def report_bus_load(
    arm_file: Path, bitrate: int, attitude_hz: float | None, telemetry_hz: float, run: Path | None, json: str | None
) -> None:
    """Tell the load of an arm's frames; see `zygos bus-load --help`."""
    if run is not None:
        check_log(run)
    check_outputs([json], [arm_file, run])
    arm = load_arm(arm_file)
    planned = plan(arm, bitrate, attitude_hz, telemetry_hz)
    used, log = None, None
    if run is not None:
        log = read_run(run)
        frames = log.frames
        parts = [frames[k : k + _AT_ONCE] for k in range(0, len(frames), _AT_ONCE)]
        with progress() as bar:
            bits = np.concatenate([exact_bits(part) for part in bar.track(parts, description="counting bits")])
        used = usage(arm, bitrate, frames, bits)
    if json:
        write_json(
            json,
            {
                "arm": arm.name,
                "bitrate": bitrate,
                "sync_hz": 1.0 / arm.period_s,
                "messages": [asdict(share) for share in planned.shares],
                "load": planned.load,
                "limit": LIMIT,
                "margin": LIMIT - planned.load,
                "largest_sync_hz": planned.largest_sync_hz,
                "run": None if used is None else {"file": str(run), **asdict(used)},
            },
        )
    if json != "-":
        _print(arm, bitrate, planned, used)
    if used is not None and used.uncounted:
        note(f"{counted(used.uncounted, 'error or CAN FD frame')} of {run}: what they take is not counted")
    if planned.load > LIMIT:
        much = "cannot be carried" if planned.load > 1.0 else f"is above {100 * LIMIT:g} %"
        raise Undecided(f"a load of {100 * planned.load:.1f} % {much}; remedy: {_remedy(planned, bitrate)}")
    if used is not None and used.load > LIMIT:
        raise Undecided(
            f"{run}: a load of {100 * used.load:.1f} % is above {100 * LIMIT:g} %, {OTHERS} included; remedy: a higher "
            "bit rate, or fewer frames of others"
        )
    not_whole(damage_of(log))


def _print(arm: Arm, bitrate: int, planned: Plan, used: Usage | None) -> None:
    rows = [
        [
            share.name,
            f"0x{share.id:03X}",
            str(share.bytes),
            str(share.bits),
            number(share.rate_hz),
            _percent(share.load),
        ]
        for share in planned.shares
    ]
    columns = ["message", "identifier", "bytes", "bits at worst", "per second", "load %"]
    total = ["all", "", "", "", number(sum(share.rate_hz for share in planned.shares)), _percent(planned.load)]
    if used is not None:
        columns += ["frames in the log", "bits, mean", "load %"]
        rows.append([OTHERS, *[""] * 5])
        room = bitrate * used.duration_s
        for row in rows:
            frames, bits = used.frames[row[0]], used.bits[row[0]]
            row += [f"{frames:,}", number(bits / frames, 4) if frames else "–", _percent(bits / room)]
        total += [f"{sum(used.frames.values()):,}", "", _percent(used.load)]
    table(columns, [*rows, total])
    if used is not None:
        say(f"the log: {used.duration_s:,.1f} s, fullest cycle {_percent(used.busiest)} %")
    say(
        f"arm {arm.name} · {bitrate:,} bit/s · SYNC {1 / arm.period_s:.6g} Hz · load {_percent(planned.load)} %, "
        f"margin to {100 * LIMIT:g} % {_percent(LIMIT - planned.load)} % · largest SYNC rate "
        f"{math.floor(10 * planned.largest_sync_hz) / 10:g} Hz"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.3f}"


def _remedy(planned: Plan, bitrate: int) -> str:
    ways = []
    if planned.largest_sync_hz >= 1.0 / _LONGEST_S:
        ways.append(f"a period_s of at least {math.ceil(1e6 / planned.largest_sync_hz) / 1e6:g}")
    needed = math.ceil(planned.load * bitrate / LIMIT)
    if needed <= _FASTEST:
        ways.append(f"at least {needed:,} bit/s")
    return " or ".join([*ways, "fewer frames of attitude and telemetry"] if ways else ["fewer joints on this bus"])

# SPDX-License-Identifier: MIT
"""Faults of frames on a bus. Each function returns a `Fault`, which changes a stream into another:

    stream.through(faults.drop(joint=2, cycles=range(100, 103)), faults.late(message="rates", cycles=[200]))

`cycles` are counted from 0, `joint` from 1 in the order of the arm file. `message` is "sync", "time", "angles",
"torque" or "rates"; without it all frames of the joint are selected, without a joint all frames of the cycle. A frame
belongs to the cycle whose data it carries, whatever faults were applied before. Random choices come from `seed`.

Errors: ZygosError for a fault that selects no frame, because a drill with it would test nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from zygos.can.wire import ERROR, EXTENDED, REMOTE, identifiers
from zygos.errors import ZygosError
from zygos.testing.stream import SYNC, Fault, Stream

MessageName = Literal["sync", "time", "angles", "torque", "rates"]
ErrorKind = Literal["bus-off", "controller", "no-acknowledge"]
_CLASSES: dict[ErrorKind, int] = {"bus-off": 0x40, "controller": 0x04, "no-acknowledge": 0x20}
"""Classes of error frames in SocketCAN: bits of the identifier (linux/can/error.h)."""


def drop(*, cycles: Iterable[int], joint: int | None = None, message: MessageName | None = None) -> Fault:
    """Lose the frames; without joint and message whole cycles, including their SYNCs, as in an outage of the bus."""

    def fault(stream: Stream) -> Stream:
        kept = ~_picked(stream, cycles, joint, message)
        return Stream(stream.arm, stream.frames[kept], stream.cycle[kept])

    return fault


def late(*, cycles: Iterable[int], by: int = 1, joint: int | None = None, message: MessageName | None = None) -> Fault:
    """Send the frames `by` cycles later, directly after the SYNC of that cycle."""

    def fault(stream: Stream) -> Stream:
        place = np.arange(len(stream), dtype=np.float64)
        for i in np.flatnonzero(_picked(stream, cycles, joint, message)):
            after = np.flatnonzero(stream.cycle >= stream.cycle[i] + by)
            if len(after):
                place[i] = after[0] + (0.5 if stream.frames["id"][after[0]] == SYNC else -0.5)
            else:
                place[i] = len(stream)
        return _taken(stream, np.argsort(place, kind="stable"))

    return fault


def repeat(
    *, cycles: Iterable[int], times: int = 1, joint: int | None = None, message: MessageName | None = None
) -> Fault:
    """Send the frames `times` more times, directly after themselves."""

    def fault(stream: Stream) -> Stream:
        count = np.where(_picked(stream, cycles, joint, message), 1 + times, 1)
        return _taken(stream, np.repeat(np.arange(len(stream)), count))

    return fault


def reorder(*, cycles: Iterable[int], seed: int = 0) -> Fault:
    """Send the frames of a cycle in a random order after its SYNC. The order within a cycle is not a fault."""

    def fault(stream: Stream) -> Stream:
        rng = np.random.default_rng(seed)
        moved = _picked(stream, cycles, None, None) & (stream.frames["id"] != SYNC)
        order = np.arange(len(stream))
        for number in np.unique(stream.cycle[moved]):
            places = np.flatnonzero(moved & (stream.cycle == number))
            order[places] = rng.permutation(places)
        return _taken(stream, order)

    return fault


def truncate(
    *, cycles: Iterable[int], length: int, joint: int | None = None, message: MessageName | None = None
) -> Fault:
    """Cut the frames to `length` bytes."""

    def fault(stream: Stream) -> Stream:
        picked = _picked(stream, cycles, joint, message) & (stream.frames["length"] > length)
        if not picked.any():
            raise ZygosError(f"no frame of these is longer than {length} bytes; remedy: cut shorter")
        frames = stream.frames.copy()
        frames["length"][picked] = length
        frames["data"][picked, length:] = 0
        return Stream(stream.arm, frames, stream.cycle)

    return fault


def flip(
    *,
    cycles: Iterable[int],
    bits: int = 1,
    joint: int | None = None,
    message: MessageName | None = None,
    seed: int = 0,
) -> Fault:
    """Invert the given number of data bits in each of the frames."""

    def fault(stream: Stream) -> Stream:
        rng = np.random.default_rng(seed)
        frames = stream.frames.copy()
        for i in np.flatnonzero(_picked(stream, cycles, joint, message)):
            for bit in rng.choice(8 * int(frames["length"][i]), bits, replace=False):
                frames["data"][i, bit // 8] ^= 1 << (bit % 8)
        return Stream(stream.arm, frames, stream.cycle)

    return fault


def stick(*, cycles: Iterable[int], joint: int | None = None, message: MessageName | None = None) -> Fault:
    """Send the frames of the first cycle in all cycles: a node whose data and counter are frozen. Not for SYNC."""

    def fault(stream: Stream) -> Stream:
        picked = _picked(stream, cycles, joint, message) & (stream.frames["id"] != SYNC)
        frames = stream.frames.copy()
        for identifier in np.unique(frames["id"][picked]):
            places = np.flatnonzero(picked & (frames["id"] == identifier))
            frames[places] = frames[places[np.argmin(stream.cycle[places])]]
        return Stream(stream.arm, frames, stream.cycle)

    return fault


def outage(*, start: int, cycles: int) -> Fault:
    """Lose all frames of that many cycles, starting at cycle `start`; 240 of them leave no gap in the SYNC counter."""
    return drop(cycles=range(start, start + cycles))


def babble(*, cycles: Iterable[int], per_cycle: int, seed: int = 0) -> Fault:
    """Let a foreign node send: in each cycle that many standard, extended and remote frames that are not the arm's.

    Extended and remote ones may have the arm's identifiers, but are foreign frames nevertheless.
    """

    def fault(stream: Stream) -> Stream:
        rng = np.random.default_rng(seed)
        own = np.array(sorted(identifiers(stream.arm)))
        others = np.setdiff1d(np.arange(1, 0x700), np.append(own, 0x1A0))
        starts = np.flatnonzero(_picked(stream, cycles, None, None) & (stream.frames["id"] == SYNC))
        if not len(starts):
            raise ZygosError("the cycles to babble in have no SYNC; remedy: apply babble before their SYNCs are lost")
        ends = np.append(np.flatnonzero(stream.frames["id"] == SYNC), len(stream))
        stops = ends[np.searchsorted(ends, starts, side="right")]
        place = np.concatenate([rng.integers(a + 1, b + 1, per_cycle) for a, b in zip(starts, stops, strict=True)])
        added = np.zeros(len(place), dtype=stream.frames.dtype)
        added["flags"] = rng.choice([0, EXTENDED, REMOTE], len(place), p=[0.6, 0.3, 0.1])
        standard = added["flags"] == 0
        added["id"] = np.where(standard, rng.choice(others, len(place)), rng.choice(own, len(place)))
        wide = rng.random(len(place)) < 0.5
        added["id"] = np.where((added["flags"] == EXTENDED) & wide, rng.integers(0x800, 2**29, len(place)), added["id"])
        added["length"] = np.where(added["flags"] == REMOTE, 0, rng.integers(0, 9, len(place)))
        added["data"] = rng.integers(0, 256, (len(place), 8)) * (np.arange(8) < added["length"][:, None])
        return _inserted(stream, place, added, np.repeat(stream.cycle[starts], per_cycle))

    return fault


def error(*, cycles: Iterable[int], kind: ErrorKind) -> Fault:
    """Let the controller report an error after the SYNC of each cycle: an error frame as delivered by SocketCAN.

    vcan delivers such frames from any sender. A real bus does not, because each controller creates its own.
    """

    def fault(stream: Stream) -> Stream:
        if kind not in _CLASSES:
            raise ZygosError(f"{kind!r} is not an error of a controller; remedy: use one of {', '.join(_CLASSES)}")
        starts = np.flatnonzero(_picked(stream, cycles, None, "sync"))
        added = np.zeros(len(starts), dtype=stream.frames.dtype)
        added["id"], added["length"], added["flags"] = _CLASSES[kind], 8, ERROR
        return _inserted(stream, starts + 1, added, stream.cycle[starts])

    return fault


def _picked(stream: Stream, cycles: Iterable[int], joint: int | None, message: MessageName | None) -> NDArray[np.bool_]:
    """Which frames are selected, (n,); at least one."""
    chosen = np.array(list(cycles), dtype=np.int64)
    picked = np.isin(stream.cycle, chosen)
    if joint is not None or message is not None:
        picked &= stream.ours() & np.isin(stream.frames["id"], _identifiers(stream, joint, message))
    if not picked.any():
        of = f"{message or 'frame'}{f' of joint {joint}' if joint is not None else ''}"
        where = f"{chosen.min()} to {chosen.max()}" if len(chosen) else "(none)"
        raise ZygosError(
            f"the stream has no {of} in cycles {where}; remedy: name cycles of the stream, which has {len(stream)} "
            f"frames up to cycle {int(stream.cycle.max(initial=-1))}"
        )
    return picked


def _identifiers(stream: Stream, joint: int | None, message: MessageName | None) -> list[int]:
    """Identifiers of the messages with that name, of a joint or of the arm."""
    if message is not None and message not in get_args(MessageName):
        raise ZygosError(f"there is no message {message!r}; remedy: use one of {', '.join(get_args(MessageName))}")
    if joint is not None and not 1 <= joint <= stream.arm.n:
        raise ZygosError(f"there is no joint {joint}; remedy: joints are counted from 1 to {stream.arm.n}")
    chosen = []
    for identifier, kind in identifiers(stream.arm).items():
        content = kind.content or ("sync" if identifier == SYNC else "time")
        name = "rates" if content.startswith("rate") else content
        if (message is None or name == message) and (joint is None or (kind.of_joint and kind.joint == joint - 1)):
            chosen.append(identifier)
    return chosen


def _taken(stream: Stream, order: NDArray[Any]) -> Stream:
    return Stream(stream.arm, stream.frames[order], stream.cycle[order])


def _inserted(stream: Stream, place: NDArray[Any], frames: NDArray[Any], cycle: NDArray[Any]) -> Stream:
    return Stream(stream.arm, np.insert(stream.frames, place, frames), np.insert(stream.cycle, place, cycle))

# SPDX-License-Identifier: MIT
"""Logs damaged at random: the flight library and the numpy twin make the same of them, frame by frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from e2e.p02 import e2e_p02_protect
from numpy.typing import NDArray

from zygos import reference
from zygos.arm import Arm
from zygos.can.wire import BUS_OFF, ERROR, EXTENDED, FD, REMOTE, data_ids, identifiers
from zygos.model.model import Model
from zygos.native.flight import FRAME, Flight, encode, ffi, lib
from zygos.reference.compare import check_frames, decode
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory

Log = NDArray[Any]
Damage = Callable[[np.random.Generator, Arm, Log], Log]

SYNC, FTIME = 0x080, 0x3A0
CYCLES = 420
VERDICTS = ("foreign", "accepted", "rejected")
SEEDS = range(1044, 1052)
"""Of logs with several kinds of damage: so few in which each fault is found with either gyro."""


@pytest.fixture(scope="module", params=["fine", "coarse"])
def hardware(request: pytest.FixtureRequest, arm: Arm) -> Arm:
    """The example's arm with either gyro, at another period, and with a latch delay that the frames must state."""
    joints = tuple(replace(joint, latch_us=400 * i) for i, joint in enumerate(arm.joints))
    return replace(arm, period_s=0.01, joints=joints, imu=replace(arm.imu, resolution=request.param))


@pytest.fixture(scope="module")
def whole(hardware: Arm) -> Log:
    """A log without damage. The microseconds of FTIME run over 2^32 within, and the SYNC counter over 240."""
    rng = np.random.default_rng(0)
    n = CYCLES
    first = 429_400
    motion = np.cumsum(rng.normal(scale=0.01, size=(n, 3 * hardware.n + 3)), axis=0)
    q, theta, tau, omega = np.split(motion, [hardware.n, 2 * hardware.n, 3 * hardware.n], axis=1)
    sync = np.arange(first, first + n, dtype=np.uint64)
    return encode(hardware, Cycles(sync, q, theta, 10.0 * tau, omega, np.zeros(n, dtype=np.uint32)))


def picks(rng: np.random.Generator, frames: Log, count: int) -> NDArray[np.int64]:
    return rng.choice(len(frames), size=count, replace=False)


def lost(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    return frames[rng.random(len(frames)) > rng.choice([0.002, 0.01, 0.1])]


def doubled(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    """Some come twice, at once or a few frames later."""
    of = picks(rng, frames, 10)
    return np.insert(frames, np.minimum(of + rng.integers(1, 12, len(of)), len(frames)), frames[of])


def swapped(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    out = frames.copy()
    for a in picks(rng, frames, 12):
        b = min(a + int(rng.integers(1, 20)), len(frames) - 1)
        out[[a, b]] = out[[b, a]]
    return out


def bit_flipped(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    out = frames.copy()
    for i in picks(rng, frames, 25):
        out["data"][i, rng.integers(0, 8)] ^= 1 << rng.integers(0, 8)
    for i in picks(rng, frames, 5):
        out["id"][i] ^= 1 << rng.integers(0, 11)
    return out


def sync_changed(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    """SYNC has no CRC: any counter may arrive."""
    out = frames.copy()
    for i in rng.choice(np.flatnonzero(out["id"] == SYNC), 4):
        out["data"][i, 0] = rng.choice([0, 241, 255, rng.integers(1, 241), (int(out["data"][i, 0]) + 16) % 240 + 1])
    return out


def wrong_length(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    out = frames.copy()
    out["length"][picks(rng, frames, 10)] = rng.integers(0, 10, 10)
    return out


def flagged(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    out = frames.copy()
    out["flags"][picks(rng, frames, 10)] = rng.choice([EXTENDED, REMOTE, FD, EXTENDED | FD], 10)
    return out


def error_frames(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    errors = np.zeros(6, dtype=FRAME)
    errors["id"] = rng.integers(0, 0x200, 6) & ~BUS_OFF | BUS_OFF * (rng.random(6) < 0.3)
    errors["flags"] = ERROR | rng.choice([0, EXTENDED], 6)
    errors["length"] = 8
    return np.insert(frames, np.sort(picks(rng, frames, 6)), errors)


def without_time(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    """FTIME falls silent for a while: too short, or long enough to be noticed."""
    first = rng.integers(0, len(frames))
    gone = (frames["id"] == FTIME) & (np.arange(len(frames)) >= first)
    gone &= np.arange(len(frames)) < first + rng.choice([500, 1500, 4000])
    return frames[~gone]


def outage(rng: np.random.Generator, _: Arm, frames: Log) -> Log:
    """240 SYNCs, and what belongs to them, are missing: the counters do not show it."""
    syncs = np.flatnonzero(frames["id"] == SYNC)
    if len(syncs) <= 300:
        return frames
    first = int(rng.integers(5, len(syncs) - 245))
    inside = int(rng.integers(0, 4))  # it may begin and end within a cycle
    return np.concatenate([frames[: syncs[first] + inside], frames[syncs[first + 240] + inside :]])


def foreign(rng: np.random.Generator, arm: Arm, frames: Log) -> Log:
    others = np.setdiff1d(np.arange(0x800), list(identifiers(arm)))
    strangers = np.zeros(300, dtype=FRAME)
    strangers["id"] = rng.choice(others, 300)
    strangers["length"] = rng.integers(0, 9, 300)
    strangers["data"] = rng.integers(0, 256, (300, 8))
    return np.insert(frames, np.sort(rng.integers(0, len(frames), 300)), strangers)


def well_protected(rng: np.random.Generator, arm: Arm, frames: Log) -> Log:
    """Other contents under a CRC that fits: another counter, status, latch delay, time, or a code that is no value."""
    out = frames.copy()
    kinds = identifiers(arm)
    for i in picks(rng, frames, 60):
        kind = kinds.get(int(out["id"][i]))
        length = int(out["length"][i])
        if kind is None or kind.family is None or length != kind.message.length:
            continue
        data = out["data"][i]
        way = rng.integers(0, 7)
        if way == 0:
            data[1] = int(data[1]) & 0x0F | int(rng.integers(0, 16)) << 4
        elif way == 1:
            data[1] = int(data[1]) & 0xF0 | (int(data[1]) + int(rng.integers(-3, 4))) % 16
        elif way == 2:
            data[2:length] = rng.choice([[0, 0, 0x80] * 2, [0xFF, 0xFF, 0x7F] * 2])[: length - 2]
        elif way == 3:
            at = int(rng.choice([2, 5])) if length == 8 else 2
            data[at : at + 3] = rng.choice([[0, 0, 0x80], [1, 0, 0x80], [0xFF, 0xFF, 0x7F], [0xFE, 0xFF, 0x7F]])
        elif way == 4:
            at = int(rng.integers(2, length))
            data[at] ^= 1 << rng.integers(0, 8)
        elif way == 5:
            data[2:length] = rng.integers(0, 256, length - 2)
        else:
            data[2] = rng.choice([0, 241, 7])  # the SYNC counter of FTIME
        payload = bytearray(data[:length].tobytes())
        e2e_p02_protect(payload, data_ids(kind.family, kind.node), increment_counter=False)
        data[:length] = list(payload)
    return out


DAMAGES: tuple[Damage, ...] = (
    lost, doubled, swapped, bit_flipped, sync_changed, wrong_length, flagged, error_frames, without_time, outage,
    foreign, well_protected,
)  # fmt: skip


def received(arm: Arm, frames: Log) -> tuple[Cycles, dict[str, int], list[str]]:
    """Cycles, fault counters that are not zero, and the verdict on each frame, of the flight library."""
    flight = Flight(arm)
    trace = flight.frames(frames, trace=True)
    assert trace is not None
    verdicts = np.zeros(len(frames), dtype=np.uint8)
    again = np.ascontiguousarray(frames)
    pointers = ffi.cast("zygos_frame_t *", again.ctypes.data), ffi.cast("uint8_t *", verdicts.ctypes.data)
    lib.zygos_batch_frames(Flight(arm).native, pointers[0], len(frames), pointers[1], ffi.NULL)
    faults = {name: count for name, count in flight.faults.items() if count}
    return trace.cycles, faults, [VERDICTS[verdict] for verdict in verdicts]


def same(arm: Arm, frames: Log) -> tuple[Cycles, dict[str, int]]:
    """Compare the two. Returns the cycles and the fault counters."""
    cycles, faults, verdicts = received(arm, frames)
    reception = decode(arm, frames)
    assert verdicts == list(reception.verdicts)
    assert faults == dict(reception.faults)
    np.testing.assert_array_equal(cycles.sync, reception.cycles.sync)
    np.testing.assert_array_equal(cycles.flags, reception.cycles.flags)
    for name in ("q", "theta", "tau", "omega"):
        np.testing.assert_allclose(getattr(cycles, name), getattr(reception.cycles, name), rtol=1e-15)
    return cycles, faults


@pytest.mark.slow(only=["fine"])
def test_no_damage(hardware: Arm, whole: Log) -> None:
    cycles, faults = same(hardware, whole)
    assert (len(cycles), faults) == (CYCLES, {})


@pytest.mark.slow(only=["coarse-error_frames", "fine-wrong_length"])
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_one_kind_of_damage(hardware: Arm, whole: Log, damage: Damage) -> None:
    same(hardware, damage(np.random.default_rng(0), hardware, whole))


@pytest.mark.slow
def test_every_kind_of_damage_together(hardware: Arm, whole: Log) -> None:
    """In random order and number; all that can be counted is counted at least once."""
    total: Counter[str] = Counter()
    flags: Counter[int] = Counter()
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        frames = whole
        for damage in rng.permutation(np.array(DAMAGES, dtype=object))[: rng.integers(2, len(DAMAGES) + 1)]:
            frames = damage(rng, hardware, frames)
        cycles, faults = same(hardware, frames)
        total += Counter(faults)
        flags += Counter(int(flag) for flag in cycles.flags)
    possible = set(Flight(hardware).faults) - {"overrun"}
    assert set(total) == possible
    assert {flag & 7 for flag in flags} == {0, 1, 5}


@pytest.mark.slow
def test_an_estimate_from_a_damaged_log(arm: Arm, model: Model, clean: Callable[[float], Trajectory]) -> None:
    """All rooms behind the receiver agree as well, over arcs that ended for many reasons and one that was void."""
    run = clean(arm.period_s)
    arm = replace(arm, compensate_every=0)
    rng = np.random.default_rng(5)
    frames = encode(arm, run.cycles(0))
    syncs = np.flatnonzero(frames["id"] == SYNC)
    # An outage of 240 cycles in the middle of an arc that is sound otherwise, and other damage on both sides of it.
    before = bit_flipped(rng, arm, frames[: syncs[330]])
    after = error_frames(rng, arm, bit_flipped(rng, arm, frames[syncs[660] :]))
    frames = np.concatenate([before, frames[syncs[330] : syncs[400]], frames[syncs[640] : syncs[660]], after])
    frames = foreign(rng, arm, frames)
    flight = Flight(arm)
    flight.frames(frames)
    estimate = flight.estimate()
    assert flight.faults["time_jumped"] == 1
    assert flight.counts["arcs_dropped"] >= 1
    assert reference.chain(arm, decode(arm, frames).cycles).balance.void
    assert estimate.arcs >= 5
    rooms = {room.name: room for room in check_frames(arm, frames)}
    assert [room for room in rooms.values() if not room.equal] == []
    assert rooms["solution"].compared == np.sum(np.isfinite(estimate.value)) >= 8
    errors = estimate.value / model.base_values(arm) - 1.0
    assert np.nanmax(np.abs(errors)) < 0.2

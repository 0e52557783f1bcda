# SPDX-License-Identifier: MIT
"""Faults of `zygos.testing` do to a stream what they say, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from flight_support import sines

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native.flight import Flight
from zygos.simulation.plant import Trajectory
from zygos.testing import faults, oracle
from zygos.testing.stream import Fault, Stream

SYNC, FTIME = 0x080, 0x3A0
ANGLES, TORQUE = (0x181, 0x182), (0x281, 0x282)
RATES = (0x190, 0x390)
CYCLES = 120


@pytest.fixture(scope="module")
def stream(arm: Arm) -> Stream:
    return Stream.of(arm, sines(arm, CYCLES, first=0))


Line = tuple[int, int, bytes, int]


def lines(stream: Stream) -> list[Line]:
    """(cycle, identifier, data, flags) of each frame, by hand."""
    return [
        (int(cycle), int(frame["id"]), bytes(frame["data"][: frame["length"]]), int(frame["flags"]))
        for frame, cycle in zip(stream.frames, stream.cycle, strict=True)
    ]


def test_a_stream_is_labelled_by_its_syncs(stream: Stream) -> None:
    got = lines(stream)
    every = [SYNC, ANGLES[0], TORQUE[0], ANGLES[1], TORQUE[1], *RATES]
    assert [i for c, i, _, _ in got if c == 1] == every
    assert [i for c, i, _, _ in got if c == 50] == [SYNC, FTIME, *every[1:]]
    assert [i for c, i, _, _ in got if c == CYCLES] == [SYNC]
    assert len(stream) == 7 * CYCLES + 3 + 1


def without(before: list[Line], gone: Callable[[Line], bool]) -> list[Line]:
    return [line for line in before if not gone(line)]


def test_drop(stream: Stream) -> None:
    before = lines(stream)
    joint2 = (ANGLES[1], TORQUE[1])
    cases: list[tuple[Fault, Callable[[Line], bool]]] = [
        (faults.drop(joint=2, cycles=range(100, 103)), lambda f: f[0] in (100, 101, 102) and f[1] in joint2),
        (faults.drop(joint=1, message="angles", cycles=[7]), lambda f: f[0] == 7 and f[1] == ANGLES[0]),
        (faults.drop(message="torque", cycles=[7]), lambda f: f[0] == 7 and f[1] in TORQUE),
        (faults.drop(message="rates", cycles=[7, 9]), lambda f: f[0] in (7, 9) and f[1] in RATES),
        (faults.drop(message="sync", cycles=[7]), lambda f: f[0] == 7 and f[1] == SYNC),
        (faults.drop(message="time", cycles=range(120)), lambda f: f[1] == FTIME),
        (faults.drop(cycles=[7]), lambda f: f[0] == 7),
        (faults.outage(start=20, cycles=30), lambda f: 20 <= f[0] < 50),
    ]
    for fault, gone in cases:
        assert lines(stream.through(fault)) == without(before, gone)
        assert lines(stream) == before  # what went in is as it was


def test_late(stream: Stream) -> None:
    before = lines(stream)
    for by in (1, 2, 16):
        after = lines(stream.through(faults.late(joint=1, cycles=[30, 31], by=by)))
        assert sorted(after) == sorted(before)
        moved = [line for line in before if line[0] in (30, 31) and line[1] in (ANGLES[0], TORQUE[0])]
        assert without(after, lambda f: f in moved) == without(before, lambda f: f in moved)  # noqa: B023
        for line in moved:
            opened = after.index(next(f for f in before if f[:2] == (line[0] + by, SYNC)))
            assert opened < after.index(line) <= opened + 2
    last = lines(stream.through(faults.late(message="rates", cycles=[CYCLES - 1], by=5)))
    assert [line[1] for line in last[-3:]] == [SYNC, *RATES]


def test_late_where_its_sync_is_lost(stream: Stream) -> None:
    """It comes when the SYNC would have come: in front of the frames of that cycle."""
    after = lines(stream.through(faults.drop(message="sync", cycles=[31]), faults.late(joint=1, cycles=[30])))
    there = [(c, i) for c, i, _, _ in after]
    assert there.index((30, 0x181)) + 2 == there.index((31, 0x181))
    assert there.index((30, 0x390)) + 1 == there.index((30, 0x181))


def test_repeat(stream: Stream) -> None:
    after = lines(stream.through(faults.repeat(joint=2, message="angles", cycles=[5, 6], times=2)))
    expected = []
    for line in lines(stream):
        expected += [line] * (3 if line[0] in (5, 6) and line[1] == ANGLES[1] else 1)
    assert after == expected


def test_reorder(stream: Stream) -> None:
    before, after = lines(stream), lines(stream.through(faults.reorder(cycles=range(10, 60), seed=3)))
    shuffled = 0
    for cycle in range(CYCLES + 1):
        one, other = ([f for f in which if f[0] == cycle] for which in (before, after))
        assert sorted(one) == sorted(other)
        assert other[0][1] == SYNC
        shuffled += one != other
        assert one == other or 10 <= cycle < 60
    assert shuffled > 45
    assert [f[0] for f in after] == [f[0] for f in before]
    assert after == lines(stream.through(faults.reorder(cycles=range(10, 60), seed=3)))
    assert after != lines(stream.through(faults.reorder(cycles=range(10, 60), seed=4)))


def test_truncate(stream: Stream) -> None:
    after = lines(stream.through(faults.truncate(message="angles", cycles=[8], length=5)))
    for one, other in zip(lines(stream), after, strict=True):
        cut = one[0] == 8 and one[1] in ANGLES
        assert other == ((*one[:2], one[2][:5], 0) if cut else one)
    with pytest.raises(ZygosError, match="no frame of these is longer than 8 bytes; remedy"):
        stream.through(faults.truncate(message="angles", cycles=[8], length=8))


@pytest.mark.parametrize("bits", [1, 3, 40])
def test_flip(stream: Stream, bits: int) -> None:
    after = lines(stream.through(faults.flip(message="rates", cycles=range(40, 80), bits=bits, seed=1)))
    places = set()
    for one, other in zip(lines(stream), after, strict=True):
        if 40 <= one[0] < 80 and one[1] in RATES:
            unlike = int.from_bytes(one[2], "little") ^ int.from_bytes(other[2], "little")
            assert unlike.bit_count() == bits
            assert (len(one[2]), one[3]) == (len(other[2]), other[3])
            places.add(unlike)
        else:
            assert one == other
    assert len(places) > (30 if bits < 40 else 10)  # all forty bits of a short frame leave no choice


def test_stick(stream: Stream) -> None:
    after = lines(stream.through(faults.stick(joint=1, cycles=range(60, 90))))
    held = {line[1]: line[2] for line in lines(stream) if line[0] == 60}
    for one, other in zip(lines(stream), after, strict=True):
        stuck = 60 <= one[0] < 90 and one[1] in (ANGLES[0], TORQUE[0])
        assert other == ((*one[:2], held[one[1]], 0) if stuck else one)
    everything = lines(stream.through(faults.stick(cycles=range(60, 90))))
    assert [f[2] for f in everything if f[1] == SYNC] == [f[2] for f in lines(stream) if f[1] == SYNC]


def test_babble(stream: Stream) -> None:
    after = lines(stream.through(faults.babble(cycles=range(20, 70), per_cycle=40, seed=2)))
    own = {SYNC, FTIME, *ANGLES, *TORQUE, *RATES, 0x290, 0x1A0, 0x720}
    foreign = [line for line in after if line[3] or line[1] not in own]
    assert without(after, lambda line: line in foreign) == lines(stream)
    assert len(foreign) == 50 * 40
    assert np.bincount([line[0] for line in foreign])[20:].tolist() == [40] * 50
    now = -1
    for cycle, identifier, data, flags in after:  # each comes in its cycle
        now += (identifier, flags) == (SYNC, 0)
        assert cycle == now
        assert flags in (0, 1, 2)
        assert identifier < (2**29 if flags == 1 else 2**11)
        assert not (flags == 2 and data)
    kinds = {flags: {line[1] for line in foreign if line[3] == flags} for flags in (0, 1, 2)}
    assert all(len(found) >= 8 for found in kinds.values())
    assert kinds[1] & own and kinds[2] & own  # foreign by their flags alone


def test_error(stream: Stream) -> None:
    after = lines(stream.through(faults.error(kind="bus-off", cycles=[9, 11])))
    added = [(i, line) for i, line in enumerate(after) if line[3]]
    assert [line for _, line in added] == [(9, 0x40, bytes(8), 4), (11, 0x40, bytes(8), 4)]
    assert all(after[i - 1][:2] == (line[0], SYNC) for i, line in added)
    assert without(after, lambda line: line[3] == 4) == lines(stream)


def test_faults_compose_and_keep_their_cycles(stream: Stream) -> None:
    """Cycles are those of the run, whatever was lost before them."""
    both = stream.through(faults.outage(start=20, cycles=30), faults.drop(joint=1, cycles=[80]))
    other = stream.through(faults.drop(joint=1, cycles=[80]), faults.outage(start=20, cycles=30))
    assert lines(both) == lines(other)
    assert len(both) == len(stream) - 30 * 7 - 2
    assert both.due_s()[-1] == pytest.approx(CYCLES * stream.arm.period_s)


def test_what_is_late_is_sent_late(stream: Stream) -> None:
    moved = stream.through(faults.late(joint=1, message="angles", cycles=[30], by=2))
    at = np.flatnonzero((moved.cycle == 30) & (moved.frames["id"] == ANGLES[0]))
    assert moved.due_s()[at] == pytest.approx(32 * stream.arm.period_s)
    assert len(moved.part(0, 32)) + len(moved.part(32)) == len(moved)
    assert lines(moved.part(0, 32) + moved.part(32)) == lines(moved)
    assert at in range(len(moved.part(0, 32)), len(moved))
    stamps = [message.timestamp for message in moved.messages()]
    assert stamps == pytest.approx(moved.due_s())


NOTHING: list[tuple[Fault, str]] = [
    (faults.drop(joint=3, cycles=[1]), "there is no joint 3; remedy: joints are counted from 1 to 2"),
    (faults.drop(joint=1, cycles=[]), r"no frame of joint 1 in cycles \(none\); remedy"),
    (faults.drop(joint=1, cycles=[500]), "in cycles 500 to 500; remedy: .* up to cycle 120"),
    (faults.late(message="time", cycles=[3]), "no time in cycles 3 to 3; remedy"),
    (faults.error(kind="off", cycles=[3]), "'off' is not an error of a controller; remedy: use one of bus-off"),  # type: ignore[arg-type]
    (faults.drop(message="rate", cycles=[3]), "there is no message 'rate'; remedy: use one of sync, time"),  # type: ignore[arg-type]
]


@pytest.mark.parametrize(("fault", "message"), NOTHING)
def test_a_fault_that_would_do_nothing_is_refused(stream: Stream, fault: Fault, message: str) -> None:
    with pytest.raises(ZygosError, match=message):
        stream.through(fault)


def test_any_function_of_a_stream_is_a_fault(stream: Stream) -> None:
    def backwards(whole: Stream) -> Stream:
        return Stream(whole.arm, whole.frames[::-1], whole.cycle[::-1])

    assert lines(stream.through(backwards, backwards)) == lines(stream)


# -- the oracle -----------------------------------------------------------------------------------------------------


def test_what_survives_of_two_lives(stream: Stream) -> None:
    """Of each the cycles that a SYNC closed, less one that lacks a frame; numbers of their own, and a break between."""
    first = stream.part(0, 60).through(faults.drop(joint=2, message="torque", cycles=[20]))
    second = stream.part(80)
    cycles = oracle.survived(first, second)
    assert len(cycles) == 58 + 40
    assert np.flatnonzero(cycles.flags & 1).tolist() == [0, 58]
    assert np.diff(cycles.sync.astype(int))[[18, 19, 20, 57]].tolist() == [1, 2, 1, 1000]
    np.testing.assert_allclose(cycles.q[58:], sines(stream.arm, CYCLES, first=0).q[80:], atol=4e-6)
    assert oracle.fault_counts(first) == {"incomplete": 1, "dropped": 1}


def test_an_estimate_is_held_against_numpy(arm: Arm, clean: Callable[[float], Trajectory]) -> None:
    whole = Stream.of(arm, clean(arm.period_s).cycles(0)).part(0, 800)
    flight = Flight(arm)
    flight.frames(whole.frames)
    estimate = flight.estimate()
    assert oracle.disagreement(estimate, whole) <= 1.0
    k1 = np.array(estimate.names) == "k1"
    tolerance = max(1e-9, 1e-14 * estimate.condition)
    for share in (0.5, 2.0):
        off = replace(estimate, value=estimate.value * (1.0 + share * tolerance * k1))
        assert oracle.disagreement(off, whole) == pytest.approx(share, rel=0.1)
    assert oracle.disagreement(replace(estimate, value=np.full(len(k1), np.nan)), whole) == np.inf
    assert oracle.disagreement(estimate, whole.part(0, 600)) > 1.0

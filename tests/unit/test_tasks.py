# SPDX-License-Identifier: MIT
"""What proceeds beside the cycles gives what it would have given at once, whatever comes between."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from arm_support import random_arm
from flight_support import copy_of, joined, part, sines
from numpy.typing import NDArray
from soak_support import again, stored, with_all_rows
from state_support import config_of_its_own, one_of_each

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import Flight, cycles_to_native, ffi, lib
from zygos.reference.compare import check_cycles
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

ARCS = 24
SEEDS = 16


@pytest.fixture(scope="module")
def motion(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(arm, model, scenario)


def unlike(arm: Arm, cycles: Cycles, flight: Flight | None = None) -> list[str]:
    """What numpy, told which instants have no row, finds otherwise."""
    return [room.name for room in check_cycles(arm, cycles, flight) if not room.equal]


def intact(flight: Flight) -> bool:
    work = ffi.new("zygos_work_t *")
    return bool(lib.zygos_arm_check(flight.native, config_of_its_own(flight), work) == 1)


def scrubbed(flight: Flight) -> int:
    return int(lib.zygos_arm_scrub(flight.native, config_of_its_own(flight)))


def sums(flight: Flight) -> list[Floats]:
    """The sums of each kind of rows and of the noise, the open arcs ended, and their counts."""
    blocks = flight.blocks()
    motors = [sum((joint[i][0] for joint in blocks.motors), np.zeros(())) for i in range(flight.arm.n)]
    counts = np.array([flight.counts["accepted"], flight.estimate().arcs])
    return [*flight.normal_equations(), flight.noise(), *motors, sum(blocks.momentum, np.zeros(())), counts]


def same(found: list[Floats], expected: list[Floats]) -> None:
    """To rounding, in units of the columns' lengths."""
    for one, other in zip(found, expected, strict=True):
        size = np.sqrt(np.abs(np.diag(other))) if other.ndim == 2 else np.abs(other).max(initial=0.0)
        scale = np.outer(size, size) if other.ndim == 2 else size
        assert one.shape == other.shape
        assert (np.abs(one - other) <= 1e-9 * scale + 1e-150).all()


# ---------------------------------------------------------------- arcs that meet


def pieces(arm: Arm, motion: Cycles, rng: np.random.Generator, voids: bool) -> Iterator[Cycles]:
    """Arcs of all lengths, broken off and interrupted."""
    cycle, at = 1, 0
    kinds = [(1, 15), (12, 45), (12, 45), (40, 120), (100, 600)]
    for _ in range(ARCS):
        n = int(rng.integers(*kinds[rng.integers(len(kinds))]))
        index = (at + np.arange(n)) % len(motion)
        noisy = again(arm, motion, 1, rng)
        at = int(index[-1]) + 1
        how = ["gap", "break", "goes on", "losses", "void" if voids else "gap"][rng.integers(5)]
        sync = np.arange(cycle, cycle + n, dtype=np.uint64)
        sync += np.uint64(rng.integers(1, 5) if how == "gap" else 0)
        if how == "losses":
            sync += np.cumsum(rng.random(n) < 0.02).astype(np.uint64)
        flags = np.zeros(n, dtype=np.uint32)
        if how == "break":
            flags[0] = BREAK_BEFORE
        if how == "void":
            flags[0] = VOID_BEFORE | int(rng.integers(1, 200)) << VOID_SHIFT
        cycle = int(sync[-1]) + 1
        chosen = Cycles(*(getattr(noisy, name)[index] for name in Cycles.__dataclass_fields__))
        yield replace(chosen, sync=sync, flags=flags)


def drawn(arm: Arm, rng: np.random.Generator) -> Arm:
    """Arcs so short that tasks meet."""

    def one(*of_these: float) -> float:
        return of_these[rng.integers(len(of_these))]

    return replace(
        arm,
        arc_max_s=arm.period_s * one(60, 150, 400, 1000),
        impulse_arc_s=arm.period_s * one(0, 20, 60, 150),
        momentum_max_s=arm.period_s * one(0, 25, 70, 200),
        compensate_every=int(one(0, 1, 5)),
    )


@pytest.mark.slow(but=["1", "3"])
@pytest.mark.parametrize("seed", range(SEEDS))
def test_sums_are_numpys_whose_arcs_end_at_once(arm: Arm, motion: Cycles, seed: int) -> None:
    """Whatever tasks meet; numpy has no row where an arc waited."""
    rng = np.random.default_rng(seed)
    short = drawn(arm, rng)
    assert unlike(short, joined(*pieces(short, motion, rng, voids=False))) == []


@pytest.mark.slow(but=["[0-3]"])
@pytest.mark.parametrize("seed", range(SEEDS))
def test_arcs_that_are_dropped_amid_tasks_leave_the_sums_whole(arm: Arm, motion: Cycles, seed: int) -> None:
    rng = np.random.default_rng(seed)
    flight = Flight(drawn(arm, rng))
    for cycles in pieces(flight.arm, motion, rng, voids=True):
        flight.cycles(cycles)
        assert intact(flight)


@pytest.mark.slow(but=["lengths[02]"])
@pytest.mark.parametrize("lengths", [(200, 20, 200), (200, 200, 25), (60, 20, 25)])
def test_rows_of_each_kind_wait_for_themselves(arm: Arm, motion: Cycles, lengths: tuple[int, int, int]) -> None:
    """Arcs so short that they take longer to close than the next one lasts, but for those of the motors: no kind of
    rows keeps the others waiting for ever, and numpy, told which instants have no row of which kind, has the same
    sums."""
    cycles = part(again(arm, motion, 1, np.random.default_rng(0)), 0, 700)
    energy, motors, momentum = (arm.period_s * n for n in lengths)
    short = replace(arm, compensate_every=1, arc_max_s=energy, impulse_arc_s=motors, momentum_max_s=momentum)
    flight = Flight(short)
    assert unlike(short, cycles, flight) == []
    assert (lengths[1:] != (20, 200)) == (max(flight.native.waited) > 0)
    assert max(flight.native.waited) < 400


LONG = 1100


@pytest.mark.slow(but=["gaps3-*"])
@pytest.mark.parametrize(
    ("gaps", "snaps"),
    [([LONG + 17, LONG + 59], []), ([LONG + 17, LONG + 94], []), ([], [LONG + 160]), ([LONG + 170], [LONG + 150])],
)
def test_rows_wait_where_a_long_arc_takes_longer_to_close(
    arm: Arm, motion: Cycles, gaps: list[int], snaps: list[int]
) -> None:
    """Two gaps, or a jump of an encoder, soon behind an arc of many blocks: the arcs are all there in the end."""
    long = replace(with_all_rows(arm), arc_max_s=LONG * arm.period_s, momentum_max_s=0.0, compensate_every=1)
    laps = [again(long, motion, 1 + lap * len(motion), np.random.default_rng(lap)) for lap in range(2)]
    whole = part(joined(*laps), 0, LONG + 500)
    at = np.arange(len(whole))
    lost = np.cumsum(np.isin(at, gaps)).astype(np.uint64)
    jump = 0.02 * np.cumsum(np.isin(at, snaps))
    flight = Flight(long)
    assert unlike(long, replace(whole, sync=whole.sync + lost, q=whole.q + jump[:, None]), flight) == []
    assert 0 < flight.native.waited[0] < 200
    assert flight.counts["waited"] == sum(flight.native.waited)


def test_short_arcs_of_other_rows_leave_time_to_those_of_the_energy(arm: Arm, motion: Cycles) -> None:
    """Motor rows that always have a task: blocks of the energy rows merge, and close as without them."""
    laps = joined(*(again(arm, motion, 1 + lap * len(motion), np.random.default_rng(lap)) for lap in range(4)))
    arcs, longest = [], []
    for motors, momentum in [(0, 0), (20, 25)]:
        seconds = [arm.period_s * n for n in (1500, motors, momentum)]
        flight = Flight(replace(arm, arc_max_s=seconds[0], impulse_arc_s=seconds[1], momentum_max_s=seconds[2]))
        flight.cycles(laps)
        arcs.append(flight.estimate().arcs)
        longest.append(max(block[2] for block in flight.blocks().energy))
    assert arcs[0] - 1 <= arcs[1] <= arcs[0]
    assert longest[1] <= 3.0 * longest[0]


# ---------------------------------------------------------------- an arc that closes, cycle by cycle


def silent(arm: Arm, motion: Cycles, first: int, count: int) -> Cycles:
    """Cycles without a row: a gap comes before the window of the smoother is full, again and again."""
    cycles = part(again(arm, motion, first, np.random.default_rng(1)), 0, count)
    lost = np.cumsum(np.arange(count) % arm.smoother.points == 0).astype(np.uint64)
    return replace(cycles, sync=cycles.sync + lost, flags=np.zeros(count, dtype=np.uint32))


@pytest.mark.parametrize("memory_s", [None, 30.0])
def test_while_an_arc_closes_the_sums_stay_and_what_drops_it_leaves_those_before(
    arm: Arm, motion: Cycles, memory_s: float | None
) -> None:
    """In each cycle behind the end of its arc, whatever task proceeds: a copy that settles has the same sums, a copy in
    which the arc is void those of before it began, and a scrub finds nothing."""
    short = replace(arm, arc_max_s=40.0, impulse_arc_s=9.0, momentum_max_s=9.0, compensate_every=1, memory_s=memory_s)

    def shape(flight: Flight) -> list[Floats]:
        """The sums; where they fade, what of them is in proportion."""
        found = sums(flight)
        return found if memory_s is None else [each / np.trace(found[0]) for each in found[:3]]

    flight = Flight(short)
    flight.cycles(part(again(short, motion, 1, np.random.default_rng(0)), 0, 150))
    flight.cycles(silent(short, motion, 255, 60))
    before, arcs = shape(flight), flight.estimate().arcs
    arc = part(again(short, motion, 400, np.random.default_rng(2)), 0, 140)
    flight.cycles(replace(arc, flags=np.zeros(len(arc), dtype=np.uint32)))
    behind = silent(short, motion, 541, 100)
    expected: list[Floats] = []
    steps = [*range(6), *range(6, len(behind), 4)]
    for k, after in zip(steps, [*steps[1:], len(behind)], strict=True):
        dropped, void = copy_of(flight), part(behind, k, k + 1)
        void.flags[0] = VOID_BEFORE | 200 << VOID_SHIFT
        dropped.cycles(void)
        found = shape(dropped)
        found[2] = before[2]  # of the noise of arcs that are dropped later as much goes as they had instants
        same(found, before)
        assert dropped.estimate().arcs == arcs and intact(dropped), k
        void.flags[0] = 0
        flight.cycles(part(behind, k, after))
        expected = expected or shape(flight)
        same(shape(flight), expected)
        if k % 16 == 2:
            settled = copy_of(flight)
            assert scrubbed(settled) == 0
            same(shape(settled), expected)


def test_a_changed_bit_amid_tasks_costs_at_most_the_arc_that_closes(arm: Arm, motion: Cycles) -> None:
    """Sums that change while their constant is eliminated were compared with their row sums before: the arc is left
    out and counted, and what was closed before stays."""
    short = replace(arm, arc_max_s=10.0, impulse_arc_s=0.0, momentum_max_s=0.0)
    flight = Flight(short)
    flight.cycles(part(again(short, motion, 1, np.random.default_rng(0)), 0, 415))
    behind, count = cycles_to_native(silent(short, motion, 416, 120)), 120
    damaged, found, arcs = copy_of(flight), Counter[int](), flight.estimate().arcs
    for k in range(0, 40, 4):
        later = copy_of(flight)
        lib.zygos_batch_cycles(later.native, behind + k, 20, ffi.NULL)
        for place in one_of_each(flight.native, np.random.default_rng(k), without=("config", "receiver", "smoother")):
            number = place.values(flight.native)
            if place.leaf.count > 50 and number != 0 and number != place.values(later.native):
                ffi.memmove(damaged.native, flight.native, ffi.sizeof("zygos_arm_t"))
                place.flip(damaged.native, 33)
                lib.zygos_batch_cycles(damaged.native, behind + k, count - k, ffi.NULL)
                verdict = scrubbed(damaged)
                found[verdict] += 1
                if not verdict & lib.ZYGOS_SCRUBBED_SUMS:
                    assert damaged.estimate().arcs >= arcs - (verdict & lib.ZYGOS_SCRUBBED_BLOCKS != 0), (k, place)
                    assert damaged.native.quarantined == (verdict & lib.ZYGOS_SCRUBBED_BLOCKS != 0)
        lib.zygos_batch_cycles(flight.native, behind + k, 4, ffi.NULL)
    assert found[lib.ZYGOS_SCRUBBED_BLOCKS] >= 3


# ---------------------------------------------------------------- an arc that waits for its end


WAITS = int(lib.ZYGOS_MIN_ARC_INSTANTS_VALUE)
"""Instants of the arc that waits: from so many on it counts as one."""


def until_an_arc_waits(flight: Flight, motion: Cycles) -> int:
    """Flies until an arc of energy rows has been ended by a gap while the one before it is closing. Returns the number
    of its newest cycle."""
    cycles, end = again(flight.arm, motion, 1, np.random.default_rng(0)), 60
    flight.cycles(part(cycles, 0, end))
    while flight.estimate().arcs < 2:  # an instant that is refused ends the first one
        flight.cycles(part(cycles, end, end + 1))
        end += 1
    flight.cycles(part(again(flight.arm, motion, end + 3, np.random.default_rng(1)), 0, 1))
    assert flight.native.sums.ending & 1
    return end


def energy_alone(arm: Arm, memory_s: float | None = None) -> Arm:
    return replace(arm, arc_max_s=20.0, impulse_arc_s=0.0, compensate_every=1, memory_s=memory_s)


def test_an_arc_that_a_gap_ends_waits_until_the_one_before_it_is_closed(arm: Arm, motion: Cycles) -> None:
    """Its end comes in the cycles without rows, and its sums are those that it would have had at once."""
    flight = Flight(energy_alone(arm))
    end = until_an_arc_waits(flight, motion)
    ended = copy_of(flight)
    assert scrubbed(ended) == 0
    same(sums(flight), sums(ended))
    behind = silent(arm, motion, end + 4, 60)
    flight.cycles(behind)
    same(sums(flight), sums(ended))
    assert flight.native.waited[0] < 10  # the first instant behind has no row
    assert flight.estimate().arcs == 2


@pytest.mark.parametrize(("doubtful", "arcs"), [(0, 2), (3, 2), (15, 1)])
def test_cycles_that_may_be_missing_while_an_arc_waits(arm: Arm, motion: Cycles, doubtful: int, arcs: int) -> None:
    """What is doubtful drops the arc that waits only where it reaches into it."""
    flight = Flight(energy_alone(arm))
    end = until_an_arc_waits(flight, motion)
    behind = part(again(flight.arm, motion, end + 5, np.random.default_rng(1)), 0, 20)
    behind.flags[0] = VOID_BEFORE | doubtful << VOID_SHIFT
    flight.cycles(behind)
    assert flight.estimate().arcs == arcs
    assert intact(flight)


def test_a_restart_that_keeps_joints_ends_no_arc_of_sums_that_it_clears(arm: Arm, motion: Cycles) -> None:
    flight = Flight(replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=5.0))
    until_an_arc_waits(flight, motion)
    known = len(flight.blocks().motors)
    assert lib.zygos_arm_restart(flight.native, lib.ZYGOS_KEEP_JOINTS) == 1
    assert (flight.counts["accepted"], len(flight.blocks().motors)) == (0, known)
    assert intact(flight)


def test_normal_equations_are_those_of_an_arm_whose_arcs_have_ended(arm: Arm, motion: Cycles) -> None:
    """Where an arc waits for its end, the sums have not faded."""
    waiting = Flight(energy_alone(arm, 50.0))
    until_an_arc_waits(waiting, motion)
    ended = copy_of(waiting)
    assert scrubbed(ended) == 0
    for found, expected in zip(waiting.normal_equations(), ended.normal_equations(), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(waiting.noise(), ended.noise(), rtol=1e-12, atol=1e-15 * waiting.noise().max())


def test_what_would_have_faded_with_an_arc_that_is_dropped_fades_with_the_next_one(arm: Arm, motion: Cycles) -> None:
    """The arc that waited is dropped, because memory was changed; the sums are those of the arcs before and behind."""
    fading = replace(energy_alone(arm, 50.0), compensate_every=0)
    flight, first, last = Flight(fading), Flight(fading), Flight(fading)
    end = until_an_arc_waits(flight, motion)
    first.cycles(part(again(fading, motion, 1, np.random.default_rng(0)), 0, end - WAITS))
    for place in one_of_each(flight.native, np.random.default_rng(0), without=("config", "magic")):
        trial = copy_of(flight)
        place.flip(trial.native, 0)
        verdict, accepted = scrubbed(trial), trial.counts["accepted"]
        if verdict == lib.ZYGOS_SCRUBBED_PLACES and abs(accepted - first.counts["accepted"]) <= 1:
            break
    else:
        raise AssertionError("no place with which the arc that waits is dropped alone")
    behind = part(again(fading, motion, end + 5, np.random.default_rng(1)), 0, 120)
    for one in (trial, last):
        one.cycles(behind)
    for one in (trial, first, last):
        assert lib.zygos_arm_end_arcs(one.native) == 1
    whole, old, new = (one.normal_equations()[0] for one in (trial, first, last))
    left = np.vdot(whole - new, old) / np.vdot(old, old)
    np.testing.assert_allclose(whole, left * old + new, rtol=1e-6, atol=1e-9 * whole.max())
    assert left == pytest.approx(np.exp(-(WAITS + 120) * arm.period_s / 50.0), rel=0.01)


def test_an_arc_with_large_entries_is_not_taken_for_changed_memory(arm: Arm) -> None:
    """The column of a rotor is the square of gear ratio and rate: its mean is far from the rows while the arm rests,
    and products with it round far more than what is left of columns that do not change."""
    for ratio in (1.0, 1e3, 1e6):
        geared = replace(arm, joints=tuple(replace(joint, gear_ratio=ratio) for joint in arm.joints), arc_max_s=60.0)
        cycles = sines(geared, 2400)
        cycles.q[:1200], cycles.theta[:1200], cycles.omega[:1200] = cycles.q[1200], cycles.theta[1200], 0.0
        flight = Flight(energy_alone(geared))
        flight.cycles(cycles)
        assert scrubbed(flight) == 0, ratio
        assert flight.native.quarantined == 0
        assert intact(flight)


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_buffers_that_wait_behind_an_arc_are_shared_out_before_they_are_filled(joints: int) -> None:
    """Arcs that end at each filling of a buffer, for widths of each parity: the sums are those of all rows."""
    arm = energy_alone(random_arm(joints, joints, "free", "planar-symmetric", [True] * joints)[0])
    arm = replace(arm, momentum_max_s=0.0, compensate_every=0)
    arcs, first = [], 1
    for over in range(8):
        n = 2 * arm.smoother.lag + 3 + 48 + over
        arcs.append(sines(arm, n, first=first))
        first += n + 3
    assert unlike(arm, joined(*arcs)) == []


@pytest.mark.parametrize(("arc_cycles", "target"), [(120, 24), (1500, 48), (3000, 56), (15_000, 312), (100_000, 1024)])
def test_how_long_the_first_segments_are(arm: Arm, arc_cycles: int, target: int) -> None:
    """48 of the longest arc, but of a second at least and of 1024 instants at most, in whole buffers; a quarter of a
    short arc, but three buffers at least. In cycles of 20 ms, and each segment has a block of its own."""
    arm = replace(energy_alone(arm), period_s=0.02, arc_max_s=0.02 * arc_cycles)
    flight, opened, k = Flight(arm), {}, 0
    cycles = sines(arm, 4 * target + 40)
    while flight.estimate().blocks < 4:
        flight.cycles(part(cycles, k, k + 8))
        opened.setdefault(flight.estimate().blocks, k := k + 8)
    assert opened[4] - opened[3] == target

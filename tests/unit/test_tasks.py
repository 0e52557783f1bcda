"""What proceeds beside the cycles gives what it would have given at once, whatever comes between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flight_support import copy_of, joined, part
from numpy.typing import NDArray
from soak_support import again, resealed, settle, stored, with_all_rows

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import Flight, cycles_to_native, ffi, lib
from zygos.reference.compare import check_cycles
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

CENTRE, ADMIT, MOMENTUM_ELIMINATE, MOMENTUM_ADMIT = 4, 6, 3, 5
ARCS = 40
SEEDS = 40


@pytest.fixture(scope="module")
def motion(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(arm, model, scenario)


def of(array: Any, entries: int) -> Floats:
    return np.frombuffer(ffi.buffer(array), dtype=np.float64)[:entries].copy()


def sums(flight: Flight) -> dict[str, Floats]:
    """The sums of closed arcs of each kind and of their noise, whatever the blocks are; all that fades has faded."""
    state, work = flight.native, ffi.new("zygos_work_t *")
    lib.zygos_take(state, work)
    assert lib.zygos_work_settle(work)
    energy, motors, momentum = work.accumulator, work.motor_sums, work.momentum_sums
    inner = (energy.width - 1) * energy.width // 2
    closed = (energy.block[place] for place in energy.order[0 : energy.open])
    out = {
        "energy": state.forgetting * sum((block.fade * of(block.gram, inner) for block in closed), np.zeros(inner)),
        "noise": state.forgetting * energy.noise_fade * of(energy.noise_closed.gram, inner),
    }
    for i in range(flight.arm.n):
        width = motors.column_map.count[i] + 1
        blocks = motors.block[0 : motors.count]
        entries = width * (width + 1) // 2
        grams = (block.fade * of(block.joint[i].gram, entries) for block in blocks)
        out[f"motor {i}"] = state.motors_forgetting * sum(grams, np.zeros(entries))
    entries = momentum.columns * (momentum.columns + 1) // 2
    grams = (block.fade * of(block.rows.gram, entries) for block in momentum.block[0 : momentum.count])
    out["momentum"] = state.momentum_forgetting * sum(grams, np.zeros(entries))
    out["momentum noise"] = state.momentum_forgetting * momentum.noise_fade * of(momentum.noise_closed.gram, entries)
    return out


def counters(flight: Flight) -> dict[str, Any]:
    work = ffi.new("zygos_work_t *")
    lib.zygos_take(flight.native, work)
    assert lib.zygos_work_settle(work)
    energy, motors, momentum = work.accumulator, work.motor_sums, work.momentum_sums
    kinds = (energy, motors, momentum)
    return {
        "accepted": energy.accepted,
        "refused": energy.refused,
        "arcs": energy.arcs,
        "arcs_dropped": energy.arcs_dropped,
        "left_out": list(work.guard.left_out),
        "quarantined": [kind.quarantined for kind in kinds],
        "corrupt": [kind.corrupt for kind in kinds],
    }


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


def drawn(arm: Arm, rng: np.random.Generator) -> tuple[Arm, float]:
    """Arcs so short that tasks meet, and a factor of forgetting."""

    def one(*of_these: float) -> float:
        return of_these[rng.integers(len(of_these))]

    changed = replace(
        arm,
        arc_max_s=arm.period_s * one(60, 150, 400, 1000),
        impulse_arc_s=arm.period_s * one(0, 20, 60, 150),
        momentum_max_s=arm.period_s * one(0, 25, 70, 200),
        compensate_every=int(one(0, 1, 5)),
    )
    return changed, one(1.0, 1.0, 0.9999, 0.999)


def same(found: dict[str, Floats], expected: dict[str, Floats]) -> None:
    """To rounding, in units of the columns' lengths."""
    for name, gram in expected.items():
        width = int(np.sqrt(2 * len(gram)))
        rows, columns = np.tril_indices(width)
        length = np.sqrt(np.abs(gram[rows == columns]))
        length = np.maximum(length, 1e-7 * np.max(length, initial=0.0)) + 1e-150
        off = np.abs(found[name] - gram) / (length[rows] * length[columns])
        assert np.max(off, initial=0.0) < 1e-9, name


def scrubbed(flight: Flight) -> int:
    config = ffi.new("zygos_config_t *", flight.native.config)
    return int(lib.zygos_scrub(flight.native, config))


def resumed(flight: Flight) -> int:
    config = ffi.new("zygos_config_t *", flight.native.config)
    return int(lib.zygos_resume(flight.native, config))


def let_wait(flight: Flight, kinds: int) -> None:
    """The next cycle finds arcs of these kinds of rows that wait for their ends: empty ones, where none does."""
    state = flight.native
    before = of_waiting(state)
    state.ending |= kinds
    state.moving ^= before ^ of_waiting(state)


def of_waiting(state: Any) -> int:
    """What the exclusive or of `moving` has of arcs that wait."""
    if state.ending == 0:
        return 0
    words = np.concatenate([np.array(list(state.ended), np.uint64), of(state.ended_forgetting, 3).view(np.uint64)])
    return int(np.bitwise_xor.reduce(words)) ^ int(state.ending)


@pytest.mark.parametrize("first", range(0, SEEDS, 10))
def test_sums_and_counters_are_those_of_an_arm_that_waits_for_its_tasks(arm: Arm, motion: Cycles, first: int) -> None:
    """One finishes its tasks after each cycle, and has no row where the other one waits for them."""
    left = np.zeros(3, np.int64)
    for seed in range(first, first + 10):
        rng = np.random.default_rng(seed)
        short, keep = drawn(arm, rng)
        flights = [Flight(short), Flight(short)]
        for flight in flights:
            config = ffi.new("zygos_config_t *", flight.native.config)
            config.forgetting_factor = keep
            assert lib.zygos_init(flight.native, config) == 1
        busy, waiting = flights
        for cycles in pieces(short, motion, rng, voids=False):
            trace = busy.cycles(cycles, trace=True)
            assert trace is not None
            without_row = dict(zip(trace.cycles.sync.tolist(), (trace.waited @ [1, 2, 4]).tolist(), strict=True))
            native = cycles_to_native(cycles)
            for k in range(len(cycles)):
                kinds = without_row.get(int(cycles.sync[k]), 0)
                if waiting.native.ending & ~kinds:  # a task had begun in the cycle in which the arc ended
                    assert scrubbed(waiting) == 0
                let_wait(waiting, kinds)
                lib.zygos_cycle(waiting.native, native + k)
                settle(waiting)
            left += trace.waited.sum(axis=0)
            between = rng.integers(20)
            if between == 0:
                assert [scrubbed(flight) for flight in flights] == [0, 0]
            elif between == 1:
                assert [resumed(flight) for flight in flights] == [1, 1]
            assert counters(busy) == counters(waiting), seed
            same(sums(busy), sums(waiting))
    assert (left > 0).all()


def intact(flight: Flight) -> bool:
    config, work = ffi.new("zygos_config_t *", flight.native.config), ffi.new("zygos_work_t *")
    return bool(lib.zygos_check(flight.native, config, work) == 1)


@pytest.mark.parametrize("first", range(0, SEEDS, 10))
def test_arcs_that_are_dropped_amid_tasks_leave_the_sums_whole(arm: Arm, motion: Cycles, first: int) -> None:
    for seed in range(first, first + 10):
        rng = np.random.default_rng(seed)
        flight = Flight(drawn(arm, rng)[0])
        for cycles in pieces(flight.arm, motion, rng, voids=True):
            flight.cycles(cycles)
            assert intact(flight), seed
            assert sorted(flight.native.accumulator.order) == [*range(lib.ZYGOS_MAX_BLOCKS_VALUE)], seed


def until_an_arc_waits(flight: Flight, motion: Cycles, forgetting: float = 1.0) -> int:
    """Flies until an arc of energy rows has been ended by a gap while the one before it is closing. Returns the number
    of its newest cycle."""
    config = ffi.new("zygos_config_t *", flight.native.config)
    config.forgetting_factor = forgetting
    assert lib.zygos_init(flight.native, config) == 1
    cycles, state = again(flight.arm, motion, 1, np.random.default_rng(0)), flight.native
    end = 0
    while not (state.accumulator.fresh > state.accumulator.open and state.arc >= 20):  # closing, and open
        flight.cycles(part(cycles, end, end + 1))
        end += 1
    flight.cycles(part(again(flight.arm, motion, end + 3, np.random.default_rng(1)), 0, 1))
    assert state.ending & 1
    return end


def test_an_arc_that_a_gap_ends_waits_until_the_one_before_it_is_closed(arm: Arm, motion: Cycles) -> None:
    """Its end comes in the cycles without rows."""
    short = replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=0.0, momentum_max_s=0.0, compensate_every=1)
    flight = Flight(short)
    state, end = flight.native, until_an_arc_waits(flight, motion)
    behind = part(again(short, motion, int(state.cycle) + 1, np.random.default_rng(1)), 0, 60)
    behind.flags[0] = 0
    waited = 1
    for k in range(len(behind)):
        flight.cycles(part(behind, k, k + 1))
        waited += int(state.ending != 0)
        assert state.ending == 0 or state.ended[0] == end
    assert 0 < waited <= state.smoother.window + 1 + state.waited[0]  # the first instant behind has no row
    assert counters(flight)["arcs"] == 2


def parts_left(flight: Flight) -> int:
    """Blocks of the closing arc whose constant is still in them."""
    energy = flight.native.accumulator
    return int(energy.fresh - energy.rank) if energy.fresh > energy.open else 0


LONG = 1100


@pytest.mark.parametrize(
    ("gaps", "snaps"),
    [([LONG + 17, LONG + 59], []), ([LONG + 17, LONG + 94], []), ([], [LONG + 160]), ([LONG + 170], [LONG + 150])],
)
def test_rows_wait_where_a_long_arc_takes_longer_to_close(
    arm: Arm, motion: Cycles, gaps: list[int], snaps: list[int]
) -> None:
    """Two gaps, or a jump of an encoder, soon behind an arc of many blocks: no cycle works off more than two or three
    parts of tasks, the arcs are all there in the end, and numpy without the instants that have no row has the same
    sums."""
    long = replace(with_all_rows(arm), arc_max_s=LONG * arm.period_s, momentum_max_s=0.0, compensate_every=1)
    laps = [again(long, motion, 1 + lap * len(motion), np.random.default_rng(lap)) for lap in range(2)]
    whole = part(joined(*laps), 0, LONG + 500)
    at = np.arange(len(whole))
    lost = np.cumsum(np.isin(at, gaps)).astype(np.uint64)
    jump = 0.02 * np.cumsum(np.isin(at, snaps))
    cycles = replace(whole, sync=whole.sync + lost, q=whole.q + jump[:, None])
    flight = Flight(long)
    state, most = flight.native, 0
    for k in range(len(cycles)):
        before = parts_left(flight)
        flight.cycles(part(cycles, k, k + 1))
        most = max(most, before - parts_left(flight) if state.accumulator.rank > state.accumulator.open else 0)
    assert most <= 1
    assert 0 < state.waited[0] < 200
    assert flight.counts["waited"] == sum(state.waited)
    assert [room.name for room in check_cycles(long, cycles) if not room.equal] == []


@pytest.mark.parametrize("lengths", [(200, 20, 200), (200, 200, 25), (60, 20, 25)])
def test_rows_of_each_kind_wait_for_themselves(arm: Arm, motion: Cycles, lengths: tuple[int, int, int]) -> None:
    """Arcs so short that each takes longer to close than the next one lasts: no kind of rows keeps the others waiting
    for ever, and numpy, told which instants have no row of which kind, has the same sums."""
    cycles = part(again(arm, motion, 1, np.random.default_rng(0)), 0, 1200)
    energy, motors, momentum = (arm.period_s * n for n in lengths)
    short = replace(arm, compensate_every=1, arc_max_s=energy, impulse_arc_s=motors, momentum_max_s=momentum)
    flight = Flight(short)
    flight.cycles(cycles)
    assert 0 < max(flight.native.waited) < 700
    assert [room.name for room in check_cycles(short, cycles) if not room.equal] == []


def test_short_arcs_of_other_rows_leave_time_to_those_of_the_energy(arm: Arm, motion: Cycles) -> None:
    """Motor rows that always have a task: blocks of the energy rows merge, are cleared, and close as without them."""
    laps = [again(arm, motion, 1 + lap * len(motion), np.random.default_rng(lap)) for lap in range(4)]
    arcs, longest = [], []
    for motors, momentum in [(0, 0), (20, 25)]:
        seconds = [arm.period_s * n for n in (1500, motors, momentum)]
        flight = Flight(replace(arm, arc_max_s=seconds[0], impulse_arc_s=seconds[1], momentum_max_s=seconds[2]))
        flight.cycles(joined(*laps))
        energy = flight.native.accumulator
        assert energy.ready >= 2
        arcs.append(energy.arcs)
        longest.append(max(energy.block[place].instants for place in energy.order[0 : energy.count]))
    assert arcs[0] - 1 <= arcs[1] <= arcs[0]
    assert longest[1] <= 3.0 * longest[0]


@pytest.mark.parametrize(("doubtful", "arcs"), [(0, 2), (3, 2), (15, 1)])
def test_cycles_that_may_be_missing_while_an_arc_waits(arm: Arm, motion: Cycles, doubtful: int, arcs: int) -> None:
    """What is doubtful drops the arc that waits only where it reaches into it."""
    short = replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=0.0, momentum_max_s=0.0, compensate_every=1)
    flight = Flight(short)
    end = until_an_arc_waits(flight, motion)
    behind = part(again(short, motion, end + 5, np.random.default_rng(1)), 0, 200)
    behind.flags[0] = VOID_BEFORE | doubtful << VOID_SHIFT
    flight.cycles(behind)
    assert flight.native.ending == 0
    settle(flight)
    assert counters(flight)["arcs"] == arcs
    assert intact(flight)


def test_a_restart_that_keeps_joints_does_not_end_arcs_of_sums_that_it_clears(arm: Arm, motion: Cycles) -> None:
    """Memory may have been changed there: the buffer that is filled is none."""
    flight = Flight(replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=5.0))
    until_an_arc_waits(flight, motion)
    flight.native.accumulator.filling = 1 << 30
    assert lib.zygos_restart(flight.native, lib.ZYGOS_KEEP_JOINTS) == 1
    assert flight.native.ending == 0
    assert flight.native.motor_sums.count > 0
    assert intact(flight)


def test_normal_equations_are_those_of_an_arm_whose_arcs_have_ended(arm: Arm, motion: Cycles) -> None:
    """Where an arc waits for its end, the sums have not faded."""
    short = replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=0.0, momentum_max_s=0.0)
    waiting = Flight(short)
    until_an_arc_waits(waiting, motion, forgetting=0.999)
    ended = copy_of(waiting)
    assert scrubbed(ended) == 0
    assert (waiting.native.ending, ended.native.ending) == (1, 0)
    for found, expected in zip(waiting.normal_equations(), ended.normal_equations(), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_array_equal(waiting.noise(), ended.noise())


@pytest.mark.parametrize("name", ["ended", "ended_forgetting"])
def test_a_change_of_what_waits_stops_the_cycles(arm: Arm, motion: Cycles, name: str) -> None:
    flight = Flight(replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=5.0))
    end = until_an_arc_waits(flight, motion)
    changed = getattr(flight.native, name)
    changed[0] = type(changed[0])(changed[0] / 2)
    behind = cycles_to_native(part(again(arm, motion, end + 4, np.random.default_rng(1)), 0, 1))
    assert lib.zygos_cycle(flight.native, behind) == lib.ZYGOS_E_STATE
    assert scrubbed(flight) & lib.ZYGOS_SCRUBBED_PLACES
    assert flight.native.ending == 0
    assert intact(flight)


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_a_product_of_factors_without_an_arc_that_waits_forgets_nothing(arm: Arm, motion: Cycles, kind: int) -> None:
    """Whatever it is, where cycles may be missing."""
    flight = Flight(replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=5.0, momentum_max_s=5.0))
    end = until_an_arc_waits(flight, motion, forgetting=0.9999)
    assert scrubbed(flight) == 0
    state = flight.native
    state.ended_forgetting[kind] = 0.5
    before = [state.forgetting, state.motors_forgetting, state.momentum_forgetting]
    behind = part(again(arm, motion, end + 5, np.random.default_rng(1)), 0, 1)
    behind.flags[0] = VOID_BEFORE
    flight.cycles(behind)
    after = [state.forgetting, state.motors_forgetting, state.momentum_forgetting]
    np.testing.assert_allclose(after, before, rtol=1e-3)
    assert list(state.ended_forgetting) == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_a_flipped_bit_of_what_waits_forgets_nothing(arm: Arm, motion: Cycles, kind: int) -> None:
    """Where none waits, there is no product of factors from before."""
    flight = Flight(replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=5.0, momentum_max_s=5.0))
    until_an_arc_waits(flight, motion, forgetting=0.9999)
    assert scrubbed(flight) == 0
    flight.native.ending ^= 1 << kind
    work = ffi.new("zygos_work_t *")
    lib.zygos_take(flight.native, work)
    assert lib.zygos_work_settle(work)
    assert resumed(flight) == 1
    for held in (work, flight.native):
        energy, motors, momentum = held.accumulator, held.motor_sums, held.momentum_sums
        assert energy.block[energy.order[0]].fade > 0.9
        assert motors.block[0].fade > 0.5
        assert momentum.block[0].fade > 0.5


def test_what_would_have_faded_with_an_arc_that_is_dropped_fades_with_the_next_one(arm: Arm, motion: Cycles) -> None:
    flight = Flight(replace(with_all_rows(arm), arc_max_s=20.0, impulse_arc_s=0.0, momentum_max_s=0.0))
    until_an_arc_waits(flight, motion, forgetting=0.999)
    state = flight.native
    expected = state.ended_forgetting[0] * state.forgetting
    state.smoother.position ^= 1
    assert scrubbed(flight) == lib.ZYGOS_SCRUBBED_PLACES
    assert state.ending == 0
    assert state.forgetting == pytest.approx(expected, rel=1e-12)
    assert expected < 0.98


@pytest.mark.parametrize("factor", [1.0, 1.0 + 2.0**-20])
def test_an_entry_that_changes_while_the_constant_is_eliminated_leaves_the_arc_out(
    arm: Arm, motion: Cycles, factor: float
) -> None:
    """It was compared with the row sums before."""
    short = replace(with_all_rows(arm), arc_max_s=10.0, impulse_arc_s=0.0, momentum_max_s=0.0)
    flight = Flight(short)
    cycles, sums, end = again(short, motion, 1, np.random.default_rng(0)), flight.native.accumulator, 0
    while not (sums.task == CENTRE and sums.row > 0):
        flight.cycles(part(cycles, end, end + 1))
        end += 1
    sums.block[sums.places & 255].gram[(sums.row + 1) * (sums.row + 4) // 2] *= factor  # a later row's diagonal
    flight.cycles(part(cycles, end, end + 100))
    assert sums.fresh == sums.open
    assert (sums.arcs, sums.quarantined) == ((1, 0) if factor == 1.0 else (0, 1))


@pytest.mark.parametrize("shape", ["rests at first", "swings about zero"])
@pytest.mark.parametrize("largest", [1.0, 1e3, 1e5, 1e9])
def test_an_arc_with_large_entries_is_not_taken_for_changed_memory(shape: str, largest: float) -> None:
    """The column of a rotor is the square of gear ratio and rate: its mean is far from the rows while the arm rests,
    and products with it round far more than what is left of columns that do not change."""
    rows, p = 2000, 6
    sums, row = ffi.new("zygos_accumulator_t *"), ffi.new("zygos_row_t *")
    lib.zygos_accumulator_init(sums, p, rows, 0.02)
    rng = np.random.default_rng(0)
    if shape == "rests at first":
        z = np.where(np.arange(rows) < rows // 2, 0.001, 1.0)[:, None] * rng.normal(1.0, 0.3, (rows, p + 1))
    else:
        z = np.tile(rng.normal(size=p + 1), (rows, 1))
        z[:, 0] = np.sin(2.0 * np.pi * (np.arange(rows) + 0.5) / 8.0)
    z[:, 0] *= largest
    for k in range(rows):
        row.column[0:p] = z[k, :p].tolist()
        row.work = z[k, p]
        lib.zygos_accumulator_add(sums, row, 1.0)
    lib.zygos_accumulator_end_arc(sums, rows)
    assert (sums.arcs, sums.quarantined) == (1, 0)
    assert lib.zygos_accumulator_check(sums) <= 1.0


@pytest.mark.parametrize(("kind", "task"), [("accumulator", ADMIT), ("momentum_sums", MOMENTUM_ADMIT)])
def test_an_arc_that_is_void_while_it_is_admitted_leaves_no_noise(
    arm: Arm, motion: Cycles, kind: str, task: int
) -> None:
    """What of its noise is in that of closed arcs goes with it."""
    short = replace(with_all_rows(arm), arc_max_s=4.0, impulse_arc_s=0.0, momentum_max_s=5.0, compensate_every=1)
    flight = Flight(short)
    cycles = again(short, motion, 1, np.random.default_rng(0))
    found = 0
    for k in range(len(cycles)):
        one = part(cycles, k, k + 1)
        state = getattr(flight.native, kind)
        if state.task == task and state.row > 0:
            copy = copy_of(flight)
            one.flags[0] = VOID_BEFORE | 200 << VOID_SHIFT
            copy.cycles(one)
            assert intact(copy), k
            one.flags[0] = 0
            found += 1
        flight.cycles(one)
    assert found > 5


def of_closed_arcs(arm: Arm, motion: Cycles) -> Flight:
    """A flight whose second arc is closing."""
    short = replace(arm, arc_max_s=10.0, impulse_arc_s=0.0, momentum_max_s=0.0)
    flight = Flight(short)
    cycles = again(short, motion, 1, np.random.default_rng(0))
    for k in range(len(cycles)):
        flight.cycles(part(cycles, k, k + 1))
        energy = flight.native.accumulator
        if energy.open > 1 and energy.fresh > energy.open and energy.rank == energy.open + 1:
            return flight
    raise AssertionError


@pytest.mark.parametrize("bit", [0, 1, 4, 31])
@pytest.mark.parametrize("name", ["rank", "closing_instants", "parity"])
def test_which_arc_is_closing_and_how_far_it_is_has_a_twin(arm: Arm, motion: Cycles, name: str, bit: int) -> None:
    """No block of closed arcs is centred again, and none is admitted as it is: both arcs are given up."""
    flight = of_closed_arcs(arm, motion)
    closed = flight.native.accumulator.open
    cycles = part(again(flight.arm, motion, int(flight.native.cycle) + 1, np.random.default_rng(1)), 0, 1)
    native = cycles_to_native(cycles)
    setattr(flight.native.accumulator, name, getattr(flight.native.accumulator, name) ^ 1 << bit)
    assert lib.zygos_cycle(flight.native, native) == lib.ZYGOS_E_STATE
    assert scrubbed(flight) > 0
    energy = flight.native.accumulator
    assert (energy.open, energy.fresh, energy.count) == (closed, closed, closed)
    assert lib.zygos_cycle(flight.native, native) == 1
    assert intact(flight)


@pytest.mark.parametrize("name", ["parity", "count", "closing_cycles"])
def test_what_tells_the_two_arcs_of_momentum_rows_apart_is_twofold(arm: Arm, motion: Cycles, name: str) -> None:
    """Otherwise the noise of one arc would be subtracted from another, or a closed block be centred once more."""
    flight = Flight(with_all_rows(arm))
    flight.cycles(part(motion, 0, 100))
    native = cycles_to_native(part(motion, 100, 101))
    assert flight.native.momentum_sums.task == 0
    setattr(flight.native.momentum_sums, name, getattr(flight.native.momentum_sums, name) ^ 1)
    assert lib.zygos_cycle(flight.native, native) == lib.ZYGOS_E_STATE
    known = name == "count"  # its checksum repairs it
    assert scrubbed(flight) == lib.ZYGOS_SCRUBBED_PLACES | (0 if known else lib.ZYGOS_SCRUBBED_BLOCKS)
    assert lib.zygos_cycle(flight.native, native) == 1
    assert intact(flight)


@pytest.mark.parametrize("bit", range(3))
def test_a_task_of_momentum_rows_without_a_closing_arc_is_found(arm: Arm, motion: Cycles, bit: int) -> None:
    """Where no arc is closing, its place has what is left of another one, which would be admitted again."""
    flight = Flight(with_all_rows(arm))
    momentum = flight.native.momentum_sums
    for k in range(len(motion)):
        flight.cycles(part(motion, k, k + 1))
        if momentum.count >= 2 and momentum.task == 0 and momentum.closing_cycles == 0:
            break
    before = [momentum.block[b].instants for b in range(momentum.count)]
    momentum.task ^= 1 << bit
    assert lib.zygos_cycle(flight.native, cycles_to_native(part(motion, k + 1, k + 2))) == lib.ZYGOS_E_STATE
    assert scrubbed(flight) & lib.ZYGOS_SCRUBBED_PLACES
    assert [momentum.block[b].instants for b in range(momentum.count)] == before
    assert intact(flight)


def test_blocks_behind_which_an_arc_closes_are_dropped_with_it(arm: Arm, motion: Cycles) -> None:
    """Numbers of cycles may begin anew, so that the closing arc has a smaller one than the blocks before it."""
    flight = Flight(with_all_rows(arm))
    momentum = flight.native.momentum_sums
    for k in range(len(motion)):
        flight.cycles(part(motion, k, k + 1))
        if momentum.count >= 2 and momentum.task == MOMENTUM_ELIMINATE:
            break
    end = momentum.block[momentum.count].end
    momentum.block[momentum.count - 1].end = end + 1000
    count = momentum.count
    lib.zygos_momentum_sums_drop_after(ffi.addressof(momentum), end)
    assert (momentum.count, momentum.task, momentum.closing_cycles) == (count - 1, 0, 0)
    assert lib.zygos_momentum_sums_steady(ffi.addressof(momentum))


@pytest.mark.parametrize("task", range(1, 6))
def test_a_momentum_arc_is_dropped_at_each_of_its_tasks(arm: Arm, motion: Cycles, task: int) -> None:
    """Nothing of it is left behind, so that the next arc finds its place empty."""
    flight = Flight(with_all_rows(arm))
    momentum = flight.native.momentum_sums
    for k in range(len(motion)):
        flight.cycles(part(motion, k, k + 1))
        if momentum.task == task:
            break
    assert momentum.task == task
    lib.zygos_momentum_sums_drop_after(ffi.addressof(momentum), 0)
    assert (momentum.task, momentum.count) == (0, 0)
    assert momentum.arc.instants == momentum.closing_cycles == 0
    empty = [momentum.arc.rows, *momentum.noise_arc]
    assert not any(np.any(of(rows.gram, len(rows.gram))) for rows in empty)
    assert lib.zygos_momentum_sums_check(ffi.addressof(momentum)) <= 1.0


@pytest.mark.parametrize("task", range(3, 7))
def test_an_energy_arc_is_dropped_at_each_of_its_tasks(arm: Arm, motion: Cycles, task: int) -> None:
    """No task, instant or block of it is left behind."""
    flight, rng = Flight(arm), np.random.default_rng(0)
    energy = flight.native.accumulator
    flight.cycles(part(again(arm, motion, 1, rng), 0, 300))
    behind = again(arm, motion, 301, rng)
    for k in range(300):
        flight.cycles(part(behind, k, k + 1))
        if energy.task == task and lib.zygos_accumulator_closing(ffi.addressof(energy)):
            break
    assert energy.task == task
    lib.zygos_accumulator_drop_after(ffi.addressof(energy), 0)
    assert lib.zygos_accumulator_rests(ffi.addressof(energy)) and energy.task == 0
    assert (energy.accepted, energy.arcs, energy.open, energy.fresh, energy.count) == (0, 0, 0, 0, 0)
    assert lib.zygos_accumulator_check(ffi.addressof(energy)) <= 1.0


@pytest.mark.parametrize("name", ["mean", "closing_end"])
def test_an_arc_that_is_centred_with_changed_means_is_left_out(arm: Arm, motion: Cycles, name: str) -> None:
    flight, expected = of_closed_arcs(arm, motion), of_closed_arcs(arm, motion)
    lib.zygos_accumulator_drop_after(ffi.addressof(expected.native, "accumulator"), 200)
    before = sums(expected)
    energy = flight.native.accumulator
    if name == "mean":
        image = ffi.cast("uint64_t *", energy.mean)
        image[2] ^= 1 << 40
    else:
        energy.closing_end ^= 1
    settle(flight)
    assert energy.quarantined == 1
    assert energy.fresh == energy.open
    for kind in ("energy", "noise"):
        np.testing.assert_array_equal(sums(flight)[kind], before[kind])
    assert scrubbed(flight) == lib.ZYGOS_SCRUBBED_BLOCKS


def test_blocks_that_cannot_merge_are_given_up(arm: Arm) -> None:
    """Changed numbers of instants, and all blocks in use: an arc that begins finds its two blocks nevertheless."""
    flight = Flight(arm)
    energy = flight.native.accumulator
    most = len(energy.block)
    for r in range(most):
        energy.block[r].instants = 1e300
    energy.count = energy.open = energy.fresh = most - 1
    energy.ready = 1
    energy.checksum = resealed(energy)
    row = ffi.new("zygos_row_t *")
    lib.zygos_accumulator_add(ffi.addressof(energy), row, 1.0)
    assert (energy.corrupt, energy.open, energy.fresh, energy.count, energy.ready) == (1, 0, 0, 2, 0)
    assert sorted(energy.order[0:most]) == list(range(most))


def test_an_arc_is_admitted_once(arm: Arm) -> None:
    """Whatever the flag of its admission is."""
    flight = Flight(with_all_rows(arm))
    momentum = flight.native.momentum_sums
    momentum.task, momentum.admitted = MOMENTUM_ADMIT, 100
    settle(flight)
    assert (momentum.count, momentum.corrupt) == (1, 0)


SLICES = 16  # ZYGOS_BUFFER_SLICES


@pytest.mark.parametrize("p", [3, 4, 12, 60])
@pytest.mark.parametrize("over", range(8))
def test_buffers_that_wait_behind_an_arc_are_shared_out_before_they_are_filled(p: int, over: int) -> None:
    """Of each parity of the width, narrow and wide; the blocks then hold the products of all rows, and their sums."""
    energy, row = ffi.new("zygos_accumulator_t *"), ffi.new("zygos_row_t *")
    lib.zygos_accumulator_init(energy, p, 1000, 0.05)
    rng = np.random.default_rng(over)
    length = 48 + over
    z = np.column_stack([rng.normal(size=(length + 24, p + 1)), np.ones(length + 24)])
    for k, one in enumerate(z):
        if energy.filled == 0:
            assert energy.buffer[energy.filling].shared == SLICES
        row.column[0:p], row.work = one[:p].tolist(), one[p]
        lib.zygos_accumulator_add(energy, row, 1.0)
        if k + 1 == length:
            assert lib.zygos_accumulator_close(energy, length, length)
    lib.zygos_accumulator_flush(energy)
    entries = (p + 2) * (p + 3) // 2
    blocks = [energy.block[place] for place in energy.order[0 : energy.count]]
    found = sum(np.array(list(block.gram)[:entries]) for block in blocks)
    np.testing.assert_allclose(found, (z.T @ z)[np.tril_indices(p + 2)], rtol=1e-12, atol=1e-12)
    sums = sum(np.array(list(block.sum)[: p + 2]) for block in blocks)
    np.testing.assert_allclose(sums, z.T @ z.sum(axis=1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("arc_cycles", "target"), [(120, 24), (1500, 48), (3000, 56), (15_000, 312), (100_000, 1024)])
def test_how_long_the_first_segments_are(arc_cycles: int, target: int) -> None:
    """48 of the longest arc, but of a second at least and of 1024 instants at most, in whole buffers; a quarter of a
    short arc, but three buffers at least. In cycles of 20 ms."""
    energy = ffi.new("zygos_accumulator_t *")
    lib.zygos_accumulator_init(energy, 3, arc_cycles, 0.02)
    assert energy.target == target

"""Arcs that contradict the running solution: left out, counted and named; several in a row are a change of the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from flight_support import bytes_of, joined, part, symmetric
from numpy.typing import NDArray
from rows_support import effect
from runs_support import trajectory_of
from scipy import stats

from conftest import EXAMPLE
from zygos.arm import Arm, TorqueLaw, load_arm
from zygos.effects import Effect
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_left_out
from zygos.model.model import Model, Quantity, load_model
from zygos.native.flight import REASONS, Estimate, Flight, encode, ffi, lib
from zygos.reference import chain
from zygos.reference.compare import check_chain, check_cycles, check_frames
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory, record
from zygos.simulation.scenario import Ramp, Scenario, load_scenario
from zygos.simulation.sensors import draw_noise

Floats = NDArray[np.float64]
Fault = Callable[[Cycles], Cycles]

ARC_S, ARCS = 20.0, 10
LAWS: tuple[TorqueLaw, ...] = ("applied_from_sync", "applied_previous_cycle")
"""Those that the simulator has. They differ in the record alone: the motion is the same."""


def arm_of(law: TorqueLaw = "applied_from_sync") -> Arm:
    return replace(load_arm(EXAMPLE / "arm.toml"), arc_max_s=ARC_S, torque_law=law)


def scenario_of(lively: bool) -> Scenario:
    """The example's motion; or arcs of very different ones: both joints, rest, one at a time, a little, fast, both."""
    scenario = load_scenario(EXAMPLE / "scenario.toml")
    if lively:
        return scenario
    shoulder = ((0, 9, 1.0), (10, 9, -0.9), (41, 8, 0.7), (50, 9, -1.2), (101, 12, 0.3), (121, 7, 1.1), (130, 7, -1.1))
    elbow = ((1, 7, -0.9), (9, 8, 1.1), (62, 8, -1.3), (71, 8, 0.9), (104, 9, -0.2), (121, 9, 1.2), (131, 8, -1.4))
    late = ((162, 8, 0.8), (171, 8, -0.8), (181, 9, 1.3))
    motions = [
        replace(scenario.manoeuvre[name], sines=(), ramps=tuple(Ramp(float(t), float(d), c) for t, d, c in ramps))
        for name, ramps in (("shoulder", (*shoulder, *late)), ("elbow", elbow))
    ]
    return replace(scenario, manoeuvre=dict(zip(("shoulder", "elbow"), motions, strict=True)))


def moved(arm: Arm, lively: bool, model: Model | None = None) -> Trajectory:
    model = model or load_model(EXAMPLE / "model.toml")
    return trajectory_of(arm, model, scenario_of(lively), duration_s=ARC_S * ARCS, noise=False, rtol=1e-9, atol=1e-11)


def seen(motion: Trajectory, seed: int) -> Cycles:
    """The motion as other noise shows it."""
    return record(replace(motion, noise=draw_noise(motion.arm, len(motion.t), [seed])))


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    return moved(arm_of(), lively=True)


def stuck(signal: str, first: int, count: int, joint: int = 0) -> Fault:
    """A sensor that repeats its last reading, its frames good in all else."""

    def fault(cycles: Cycles) -> Cycles:
        readings = getattr(cycles, signal).copy()
        of = slice(None) if signal == "omega" else joint
        readings[first : first + count, of] = readings[first - 1, of]
        return replace(cycles, **{signal: readings})

    return fault


def weak(first: int, count: int) -> Fault:
    """A motor that gives two thirds of the torque that it reports."""

    def fault(cycles: Cycles) -> Cycles:
        tau = cycles.tau.copy()
        tau[first : first + count, 0] *= 1.5
        return replace(cycles, tau=tau)

    return fault


def watched(arm: Arm, cycles: Cycles) -> Watch:
    watch = Watch(Flight(arm))
    watch.frames(encode(arm, cycles))
    return watch


def far(estimate: Estimate, motion: Trajectory) -> Floats:
    """(p,) errors in half widths of the 95 % intervals."""
    true = load_model(EXAMPLE / "model.toml").base_values(motion.arm)
    return np.asarray(np.abs(estimate.value - true) / estimate.half95)


@dataclass(frozen=True)
class Case:
    name: str
    fault: Fault


SOON = 1250
"""In the middle of an arc."""
CASES = (
    Case("link encoder", stuck("q", SOON, 60)),
    Case("motor encoder", stuck("theta", SOON, 60, joint=1)),
    Case("gyro", stuck("omega", SOON, 60)),
    Case("torque", weak(SOON, 150)),
)


# ---------------------------------------------------------------- one bad arc


@pytest.mark.slow(but=["link encoder"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_one_bad_arc_is_left_out_and_the_rest_is_as_without_it(case: Case, motion: Trajectory) -> None:
    arm, spoilt, clean, bad = motion.arm, [], [], []
    for seed in range(3):
        cycles = seen(motion, seed)
        faulty = case.fault(cycles)
        deaf = Flight(arm)
        deaf.frames(encode(arm, faulty))
        spoilt.append(deaf.estimate())
        watch = watched(arm, faulty)
        estimate = watch.flight.estimate()
        assert estimate.validity == "valid"
        assert estimate.left_out[0] == 1
        assert [arc.rows for arc in watch.left_out].count("energy") == 1
        arc = next(arc for arc in watch.left_out if arc.rows == "energy")
        assert arc.first <= SOON + 60 and arc.last >= SOON
        assert "left out" in about_left_out(estimate, watch) and "1 arc of the energy rows" in about_left_out(
            estimate, watch
        )
        # one bad arc is no change of the arm
        found = watch.look()
        assert found is None or not found.changed
        bad.append(far(estimate, motion))
        clean.append(far(watched(arm, cycles).flight.estimate(), motion))
    # which a flight that adopts nothing refuses, doubts, or answers with residuals that noise does not explain
    plain = [estimate for estimate in spoilt if estimate.validity == "valid"]
    assert all(estimate.noise_ratio > 1.25 for estimate in plain)
    assert np.mean(np.array(bad) > 1.0) <= np.mean(np.array(clean) > 1.0) + 3.0 * np.sqrt(0.05 * 0.95 / np.size(bad))
    assert np.mean(np.square(bad)) < 1.0 and np.mean(np.square(clean)) < 1.0


def test_an_estimate_in_the_middle_of_a_bad_arc_does_not_flip(motion: Trajectory) -> None:
    arm = motion.arm
    faulty = CASES[0].fault(seen(motion, 0))
    watch = Watch(Flight(arm))
    watch.cycles(part(faulty, 0, SOON + 50))
    estimate = watch.flight.estimate()
    assert (estimate.validity, estimate.left_out[0], estimate.consecutive) == ("valid", 1, 1)
    # the arc is still open: nothing was left out yet but in the copy
    assert watch.flight.native.guard.left_out[0] == 0
    assert "the newest, still open" in about_left_out(estimate, watch)


# ---------------------------------------------------------------- good arcs


@pytest.mark.slow
def test_good_arcs_are_never_left_out() -> None:
    """Over 500 judged arcs: lively ones, and very different ones, resting ones among them."""
    judged, largest = 0, np.zeros(3)
    for lively in (True, False):
        once = moved(arm_of(), lively)
        for law in LAWS:
            motion = replace(once, arm=arm_of(law))
            for seed in range(14):
                flight, cycles = Flight(motion.arm), seen(motion, seed)
                for first in range(0, len(cycles), 200):
                    known = bool(flight.native.guard.known)
                    before = flight.native.accumulator.arcs
                    flight.cycles(part(cycles, first, first + 200))
                    estimate = flight.estimate()
                    assert estimate.left_out == (0, 0, 0), (law, lively, seed, first)
                    flight.adopt()  # which admits an arc that is closing
                    judged += (flight.native.accumulator.arcs - before) * known
                    largest = np.maximum(largest, list(flight.native.guard.contradiction))
    print(judged, largest.round(3))
    assert judged > 500
    # and are far from it: in units of the limit
    assert np.all(largest < 0.5)


# ---------------------------------------------------------------- several in a row


def heavier(model: Model) -> Model:
    *others, last = model.bodies
    return replace(model, bodies=(*others, replace(last, mass=Quantity(2.0 * last.mass.value))))


def behind(first: Cycles, second: Cycles, gap: int = 37) -> Cycles:
    """second comes so many cycles after first."""
    return joined(first, replace(second, sync=second.sync + first.sync[-1] + np.uint64(gap)))


@pytest.mark.slow
def test_several_in_a_row_are_a_change_of_the_arm(motion: Trajectory) -> None:
    arm, model = motion.arm, heavier(load_model(EXAMPLE / "model.toml"))
    heavy = seen(moved(arm, True, model), 100)
    cycles = behind(seen(motion, 0), part(heavy, 0, 1500))
    watch = watched(arm, cycles)
    estimate = watch.flight.estimate()
    assert estimate.validity == "doubtful" and estimate.consecutive >= 3
    assert "the arm changed" in estimate.reason
    # the values are still those of the arm before
    assert np.mean(far(estimate, motion) > 1.0) < 0.3
    found = watch.look()
    assert found is not None and "a22" in found.changed
    assert found.until * arm.period_s == pytest.approx(ARC_S * ARCS, abs=0.1)
    # the restart takes the new arm
    watch.flight.restart(keep_joints=True)
    assert watch.flight.native.guard.known == 0
    watch.cycles(replace(heavy, sync=heavy.sync + cycles.sync[-1] + np.uint64(9)))
    estimate = watch.flight.estimate()
    assert (estimate.validity, estimate.consecutive) == ("valid", 0)
    assert np.mean(np.abs(estimate.value - model.base_values(arm)) > estimate.half95) < 0.3


def test_a_fault_of_several_arcs_is_over_when_an_arc_agrees(motion: Trajectory) -> None:
    arm, cycles = motion.arm, seen(motion, 0)
    faulty = stuck("q", 2250, 1200)(cycles)
    watch = Watch(Flight(arm))
    watch.cycles(part(faulty, 0, 3450))
    estimate = watch.flight.estimate()
    assert "the arm changed" in estimate.reason and estimate.consecutive >= 3
    watch.cycles(part(faulty, 3450, len(faulty)))
    estimate = watch.flight.estimate()
    assert (estimate.validity, estimate.consecutive) == ("valid", 0)
    assert estimate.left_out[0] >= 3


def test_a_change_soon_after_the_first_arc_is_learned_anew(motion: Trajectory) -> None:
    """The arcs that contradict hold more instants than the sums: arcs are admitted from then on, and no estimate judges
    them before half an arc has passed."""
    arm, begin = motion.arm, 300
    faulty = stuck("q", begin, 1500)(seen(motion, 0))
    flight = Flight(arm)
    flight.cycles(part(faulty, 0, begin))
    flight.estimate()
    assert flight.adopt()
    guard, k = flight.native.guard, begin
    while not guard.changed:
        assert guard.known == 1
        flight.cycles(part(faulty, k, k + 1))
        k += 1
    rows = int(np.argmax(guard.consecutive))
    newest = max(int(arc.end) for arc in guard.newest)
    assert (guard.known, guard.since) == (0, newest + round(0.5 * ARC_S / arm.period_s))
    assert guard.instants[rows] > sum(flight.native.motor_sums.block[0].instants)
    left_out = list(guard.left_out)
    flight.cycles(part(faulty, k, k + 100))
    early = flight.estimate()
    assert early.cycle <= guard.since and not flight.adopt()
    flight.cycles(part(faulty, k + 100, len(faulty)))
    assert list(guard.left_out) == left_out
    estimate = flight.estimate()
    assert "the arm changed" in estimate.reason and estimate.cycle > guard.since
    assert flight.adopt() and guard.known == 1


def test_where_every_arc_is_bad_from_the_start_the_answer_is_a_refusal(motion: Trajectory) -> None:
    cycles = seen(motion, 0)
    for first in range(50, len(cycles), 200):
        cycles = stuck("q", first, 60)(cycles)
    estimate = watched(motion.arm, cycles).flight.estimate()
    assert estimate.validity == "refused"
    assert estimate.left_out == (0, 0, 0)


@pytest.mark.parametrize("law", ["sampled", "applied_previous_cycle"])
def test_what_is_wrong_with_every_arc_stays_a_refusal(law: TorqueLaw, motion: Trajectory) -> None:
    """Leaving arcs out heals no wrong torque law."""
    arm, cycles = replace(motion.arm, torque_law=law), seen(motion, 0)
    flight = Flight(arm)
    for first in range(0, len(cycles), 200):
        flight.cycles(part(cycles, first, first + 200))
        estimate = flight.estimate()
        assert estimate.validity in ("refused", "doubtful")
        assert not flight.adopt()
    assert flight.counts["accepted"] > 3000


def test_a_bad_first_arc_is_dropped_when_those_behind_it_agree(motion: Trajectory) -> None:
    """Before there is a running solution nothing can contradict it; the solver tries without the oldest arcs."""
    for seed in range(3):
        watch = watched(motion.arm, stuck("q", 100, 60)(seen(motion, seed)))
        estimate = watch.flight.estimate()
        assert estimate.validity == "valid"
        assert estimate.left_out[0] >= 1
        assert watch.flight.native.guard.dropped > 0
        assert np.mean(far(estimate, motion) > 1.0) < 0.3
        # who adopts nothing gets the answer for all arcs
        deaf = Flight(motion.arm)
        deaf.cycles(stuck("q", 100, 60)(seen(motion, seed)))
        assert deaf.estimate().validity != "valid" or deaf.estimate().noise_ratio > 1.5


def test_stale_frames_for_an_hour(motion: Trajectory) -> None:
    """One frame in ten thousand repeats what it said sixteen cycles ago: its counter and its checksum are good."""
    arm, runs, last = replace(motion.arm, arc_max_s=60.0), [], 0
    rng = np.random.default_rng(0)
    for seed in range(18):
        run = seen(motion, seed)
        for names, joints in ((("q", "theta"), arm.n), (("tau",), arm.n), (("omega",), 1)):
            for joint in range(joints):
                for k in np.flatnonzero(rng.random(len(run)) < 1e-4):
                    for name in names:
                        of = slice(None) if name == "omega" else joint
                        getattr(run, name)[k, of] = getattr(run, name)[max(k - 16, 0), of]
        runs.append(replace(run, sync=run.sync + np.uint64(last)))
        last += len(run) + 9
    watch = Watch(Flight(arm))
    for run in runs:
        watch.cycles(run)
    estimate = watch.flight.estimate()
    print(estimate.left_out, estimate.noise_ratio, far(estimate, motion).round(2))
    assert estimate.validity == "valid"
    assert np.mean(far(estimate, motion) > 1.0) < 0.3


# ---------------------------------------------------------------- C against numpy


def test_c_equals_numpy_with_arcs_left_out(motion: Trajectory) -> None:
    arm = motion.arm
    for faulty in (CASES[0].fault(seen(motion, 0)), stuck("omega", len(motion.t) - 120, 60)(seen(motion, 0))):
        for rooms in (check_frames(arm, encode(arm, faulty)), check_cycles(arm, faulty)):
            assert [room.name for room in rooms if not room.equal] == []
            assert rooms[-1].name == "solution" and "noise" in [room.name for room in rooms]
        # numpy that is not told differs
        flight = Flight(arm)
        watch = Watch(flight, trace=True)
        watch.frames(encode(arm, faulty))

        if any(arc.rows == "energy" for arc in watch.left_out):
            assert not all(room.equal for room in check_chain(arm, watch.trace(), flight))


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_c_equals_numpy_with_momentum_rows_of_an_arm_that_lacks_a_parameter(which: int) -> None:
    """The rotor of a rigid joint at gear one turns with its link: it has columns and no parameter of its own."""
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    joints, drives = list(arm.joints), list(model.joints)
    own = joints[which]
    joints[which] = replace(own, flexible=False, gear_ratio=1.0, link_encoder=own.motor_encoder)
    drives[which] = replace(drives[which], stiffness=Quantity(np.inf), damping=Quantity(0.0))
    arm = replace(arm, joints=tuple(joints), momentum_max_s=ARC_S, arc_max_s=ARC_S)
    assert f"Im{which + 1}" not in arm.parameter_names
    plant = replace(model, joints=tuple(drives))
    cycles = trajectory_of(arm, plant, scenario_of(True), noise=True, duration_s=ARC_S * 5).cycles()
    flight = Flight(arm)
    rooms = check_cycles(arm, cycles, flight)  # a frame has no room for the torques before such a gear
    assert [room.name for room in rooms if not room.equal] == []
    assert {"noise", "sigmas", "solution"} <= {room.name for room in rooms}
    estimate = flight.estimate()
    assert (estimate.validity, estimate.left_out) == ("valid", (0, 0, 0))
    assert flight._work.solver.momentum_weight > 0.0
    contradiction = list(flight.native.guard.contradiction)
    assert all(0.0 < one < 0.5 for one in contradiction)
    assert (np.abs(estimate.value - plant.base_values(arm)) < 2.0 * estimate.half95).all()


@pytest.mark.slow
def test_a_bad_arc_of_momentum_rows_is_left_out(motion: Trajectory) -> None:
    """A gyro that repeats its reading for 15 s: the angular momentum of what it shows is not constant."""
    arm = replace(motion.arm, momentum_max_s=ARC_S)
    for seed in range(2):
        cycles = seen(motion, seed)
        good = watched(arm, cycles).flight
        assert good.estimate().validity == "valid" and good.estimate().left_out == (0, 0, 0)
        assert good._work.solver.momentum_weight > 0.0
        faulty = stuck("omega", SOON, 300)(cycles)
        watch = watched(arm, faulty)
        estimate = watch.flight.estimate()
        assert (estimate.validity, estimate.left_out[2]) == ("valid", 1)
        assert [arc.rows for arc in watch.left_out].count("momentum") == 1
        assert all(arc.first <= SOON + 300 and arc.last >= SOON for arc in watch.left_out)
        assert len(watch.flight.blocks().momentum) == len(good.blocks().momentum) - 1
        assert np.mean(far(estimate, motion) > 1.0) < 0.3
    for one in (cycles, faulty):
        assert [room.name for room in check_frames(arm, encode(arm, one)) if not room.equal] == []


# ---------------------------------------------------------------- misuse, memory


def test_only_a_valid_estimate_of_this_arm_is_adopted(motion: Trajectory) -> None:
    arm, cycles = motion.arm, seen(motion, 0)
    flight = Flight(arm)
    flight.cycles(part(cycles, 0, 30))
    assert flight.estimate().validity == "refused"
    assert not flight.adopt()
    before = bytes(ffi.buffer(flight.native))
    assert not flight.adopt()
    assert bytes(ffi.buffer(flight.native)) == before
    assert lib.zygos_adopt(ffi.NULL, flight._estimate) == lib.ZYGOS_E_NULL
    assert lib.zygos_adopt(flight.native, ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_adopt(ffi.new("zygos_t *"), flight._estimate) == lib.ZYGOS_E_ORDER
    flight.cycles(part(cycles, 30, len(cycles)))
    assert flight.estimate().validity == "valid"
    flight.restart()
    assert not flight.adopt(), "an estimate from before the restart"


def test_an_estimate_without_residuals_judges_no_arc(motion: Trajectory) -> None:
    """Nothing says how large those of a good arc may be."""
    arm, faulty = motion.arm, CASES[0].fault(seen(motion, 0))
    flight = Flight(arm)
    flight.cycles(part(faulty, 0, SOON - 100))
    flight.estimate()
    flight._estimate.residual = 0.0
    assert flight.adopt()
    arcs = flight.native.accumulator.arcs
    flight.cycles(part(faulty, SOON - 100, len(faulty)))
    guard = flight.native.guard
    assert (guard.known, guard.left_out[0]) == (1, 0)
    assert flight.native.accumulator.arcs > arcs + 2


def test_the_open_arc_is_compared_with_those_before_it_once_it_is_long_enough(motion: Trajectory) -> None:
    """By a flight that leaves arcs out; one that is too short is judged like any other."""
    arm, cycles = motion.arm, seen(motion, 0)
    flight, at = Flight(arm), 2000
    flight.cycles(part(cycles, 0, at))
    flight.estimate()
    assert flight.adopt()
    for behind in (60, 390):
        flight.cycles(part(cycles, int(flight.native.cycle) + 1, at + behind))
        drift = flight.drift()
        assert drift.changed == () and np.isfinite(drift.deviation).all()
        assert flight.native.guard.known == 1


@pytest.mark.parametrize(("freedom", "error"), [(10.0, 0.05), (100.0, 0.004), (1e4, 1e-4)])
def test_the_limit_of_a_mean_square_is_six_sigmas_of_chi_square_with_its_margin(freedom: float, error: float) -> None:
    """By the cube root that is nearly normal; fewer than one row count as one."""
    expected = 1.25 * stats.chi2.isf(stats.norm.sf(6.0), freedom) / freedom
    assert lib.zygos_guard_chi_square_limit(freedom) == pytest.approx(expected, rel=error)
    assert lib.zygos_guard_chi_square_limit(0.5) == lib.zygos_guard_chi_square_limit(1.0)


def fly_until(flight: Flight, cycles: Cycles, reached: Callable[[], bool]) -> None:
    """Half of the cycles, of which the estimate is adopted, and then one after the other."""
    half = len(cycles) // 2
    flight.cycles(part(cycles, 0, half))
    flight.estimate()
    assert flight.adopt()
    for k in range(half, len(cycles)):
        flight.cycles(part(cycles, k, k + 1))
        if reached():
            break


@pytest.mark.parametrize("worst", [0.99, 1.01])
def test_motor_rows_are_left_out_where_the_worst_joint_is_above_its_limit(motion: Trajectory, worst: float) -> None:
    arm, judge, admit = motion.arm, 2, 3
    flight = Flight(arm)
    motors, guard = flight.native.motor_sums, flight.native.guard
    fly_until(flight, seen(motion, 0), lambda: bool(motors.task == judge and motors.joint == 1))
    assert guard.motor_worst < 0.99
    guard.motor_worst = worst  # of the first joint
    names = ("guard", "config", "column_map", "motor_sums")
    assert lib.zygos_guard_proceed_motors(*(ffi.addressof(flight.native, name) for name in names))
    assert guard.contradiction[1] == worst
    assert (motors.task == admit) == (guard.left_out[1] == 0) == (worst < 1.0)


def test_an_arc_is_compared_by_the_sums_of_residuals_in_its_blocks(motion: Trajectory) -> None:
    """Squared sums, over the squares of the weights, and their limit: those of numpy for the arc that closes."""
    arm, cycles, admit = motion.arm, seen(motion, 0), 6
    off = replace(cycles, tau=cycles.tau + 0.3)  # of which the sums of residuals tell more than their squares
    flight, half = Flight(arm), len(cycles) // 2
    flight.cycles(part(cycles, 0, half))
    flight.estimate()
    assert flight.adopt()
    guard, sums, p = flight.native.guard, flight.native.accumulator, flight.native.column_map.count
    for k in range(half, len(cycles)):
        flight.cycles(part(off, k, k + 1))
        if sums.task == admit:
            break
    assert guard.comparing == 1
    closing = [sums.block[place] for place in list(sums.order)[sums.open : sums.fresh]]
    deviation, square = (
        np.array(
            [
                list(lib.zygos_accumulator_deviation(ffi.addressof(sums), ffi.addressof(one))[0 : p + 1])
                for one in closing
            ]
        ),
        [one.square for one in closing],
    )
    covariance = np.zeros((p, p))
    covariance[np.tril_indices(p)] = list(guard.covariance)[: p * (p + 1) // 2]
    covariance += np.tril(covariance, -1).T
    walk = np.einsum("bi,ij,bj->b", deviation[:, :p], covariance, deviation[:, :p])
    left = deviation[:, p] - deviation[:, :p] @ list(guard.solution)[:p]
    assert len(closing) == guard.compared > 1
    assert guard.blocks.uncertainty == pytest.approx(float(np.sum(walk / square)), rel=1e-9)
    assert guard.blocks.residual == pytest.approx(float(np.sum(left**2 / square)), rel=1e-9)
    expected = max(guard.rows.expected / sums.closing_instants, guard.energy.residual)
    most = lib.zygos_guard_chi_square_limit(0.5 * len(closing)) * guard.cluster * expected * len(closing)
    most += 36.0 * guard.blocks.uncertainty + 1e-6 * guard.energy.spread * guard.share
    assert guard.contradiction[0] == pytest.approx(guard.blocks.residual / most, rel=1e-9)


def test_an_arc_that_moves_more_than_those_before_may_leave_more(motion: Trajectory) -> None:
    """Residuals of a wrong model grow with the motion, so that they are compared with those of as much motion."""
    admit = 6
    flight, cycles = Flight(motion.arm), seen(motion, 0)
    half = len(cycles) // 2
    flight.cycles(part(cycles, 0, half))
    flight.estimate()
    assert flight.adopt()
    guard, sums = flight.native.guard, flight.native.accumulator
    ahead = iter(range(half, len(cycles)))
    while not guard.comparing:
        k = next(ahead)
        flight.cycles(part(cycles, k, k + 1))
    guard.energy.spread /= 1e4  # as if the arcs before had hardly moved
    guard.energy.residual /= 1e2
    guard.cluster = 1e9  # the sums of blocks say nothing
    while sums.task != admit:
        k = next(ahead)
        flight.cycles(part(cycles, k, k + 1))
    rows, n = guard.rows, float(sums.closing_instants)
    alike = guard.energy.residual / guard.energy.spread * rows.spread
    assert rows.spread > n * guard.energy.spread and alike > max(rows.expected, n * guard.energy.residual)
    limit = lib.zygos_guard_chi_square_limit(n / motion.arm.smoother.points) * alike
    limit += 36.0 * rows.uncertainty + 1e-6 * rows.spread
    assert guard.contradiction[0] == pytest.approx(rows.residual / limit, rel=1e-9)


def test_what_noise_leaves_in_momentum_rows_is_that_of_the_arc_which_is_judged(motion: Trajectory) -> None:
    """Not that of the open arc, which is longer or shorter."""
    judge = 4
    flight = Flight(replace(motion.arm, momentum_max_s=ARC_S))
    guard, momentum, column_map = flight.native.guard, flight.native.momentum_sums, flight.native.column_map
    fly_until(flight, seen(motion, 0), lambda: bool(momentum.task == judge))
    columns = int(momentum.columns)
    noise = symmetric(momentum.noise_arc[(momentum.parity & 1) ^ 1].gram, columns)
    kinetic = int(column_map.kinetic)
    ranks = [k if k < kinetic else column_map.joint[k - kinetic] for k in range(columns)]
    solution = np.array([guard.solution[column_map.place[rank]] for rank in ranks])
    names = ("guard", "config", "column_map", "momentum_sums")
    lib.zygos_guard_settle_momentum(*(ffi.addressof(flight.native, name) for name in names))
    assert guard.momentum_noise.residual == pytest.approx(solution @ noise @ solution, rel=1e-9)
    assert guard.momentum_noise.residual > 0.0


def test_the_newest_arc_is_compared_with_its_own_momentum_rows(motion: Trajectory) -> None:
    """And where the arcs before do not close but the newest one does, the answer says so."""
    flight = Flight(replace(motion.arm, momentum_max_s=ARC_S))
    flight.cycles(stuck("q", 100, 60)(part(seen(motion, 0), 0, round(6.2 * ARC_S / motion.arm.period_s))))
    drift = flight.drift()
    used, count = flight._work.solver.momenta, flight._work.momentum_sums.count
    assert 0 < used.first < used.end == count
    assert drift.reason == REASONS[lib.ZYGOS_REASON_UNCLOSED]


@pytest.mark.parametrize("task", [4, 5])  # ZYGOS_MOTOR_MERGE, ZYGOS_MOTOR_SHIFT
def test_a_merge_of_motor_blocks_is_ended_before_arcs_are_dropped(motion: Trajectory, task: int) -> None:
    flight = Flight(replace(motion.arm, impulse_arc_s=2.0))
    motors = flight.native.motor_sums
    fly_until(flight, seen(motion, 0), lambda: bool(motors.task == task and (task == 5 or motors.joint == 1)))
    assert motors.task == task
    ended = ffi.new("zygos_motor_sums_t *", motors)
    while ended.task in (4, 5):
        lib.zygos_motor_sums_proceed(ended, ffi.addressof(flight.native, "config"))
    newest = motors.block[motors.count - 1].end
    for sums in (ffi.addressof(motors), ended):
        lib.zygos_motor_sums_drop_after(sums, newest - 1)
    assert motors.count == ended.count > 3 and motors.checksum == ended.checksum
    for b in range(motors.count):
        assert bytes_of(ffi.addressof(motors.block[b])) == bytes_of(ffi.addressof(ended.block[b]))


@pytest.mark.parametrize("effects", [(), (effect("motor_viscous", "shoulder"), effect("torque_offset", "elbow"))])
def test_what_arcs_are_compared_with_are_the_means_over_those_before(
    motion: Trajectory, effects: tuple[Effect, ...]
) -> None:
    """Residuals and right sides of the adopted solution, for each kind of row."""
    arm = replace(motion.arm, momentum_max_s=ARC_S)
    cycles = part(seen(motion, 0), 0, round(0.75 * ARCS * ARC_S / arm.period_s))
    flight = Flight(arm, effects)
    flight.cycles(cycles)
    solution = flight.estimate().solution
    assert flight.adopt()
    guard, column_map = flight.native.guard, flight.native.column_map
    design = chain(arm, cycles).design
    closed = design.w[design.arc < design.arc.max()]
    assert guard.energy.spread == pytest.approx(np.mean(closed**2), rel=0.02)  # numpy subtracts no noise from it
    motors = flight.native.motor_sums
    assert motors.count >= 3
    for i in range(arm.n):
        count, at = int(motors.column_map.count[i]), int(column_map.joint[i])
        further = [column_map.effects + e for e in list(motors.column_map.effect[i])[: count - 3]]
        x = np.array([solution[column_map.place[column]] for column in (at, at + 1, at + 2, *further)])
        sums = sum(symmetric(motors.block[b].joint[i].gram, count + 1) for b in range(motors.count))
        n = sum(motors.block[b].instants[i] for b in range(motors.count))
        noise, ahead = symmetric(motors.noise[i], count), np.append(x, -1.0)
        assert guard.motor[i].residual == pytest.approx(ahead @ sums @ ahead / n + x @ noise @ x, rel=1e-6)
        assert guard.motor[i].spread == pytest.approx(sums[-1, -1] / n, rel=1e-6)
    momentum = flight.native.momentum_sums
    columns, kinetic = int(momentum.columns), int(column_map.kinetic)
    ranks = [k if k < kinetic else column_map.joint[k - kinetic] for k in range(columns)]
    x = np.array([solution[column_map.place[rank]] for rank in ranks])
    blocks = [momentum.block[b] for b in range(momentum.count)]
    sums = sum(symmetric(block.rows.gram, columns) for block in blocks) + symmetric(momentum.noise_closed.gram, columns)
    n = sum(block.instants for block in blocks)
    assert momentum.count >= 3 and momentum.noise_fade == 1.0
    assert guard.momentum.residual == pytest.approx(x @ sums @ x / n, rel=1e-6)
    assert guard.momentum.spread == pytest.approx(x**2 @ np.diag(sums) / n, rel=1e-9)


def test_residuals_of_momentum_rows_begin_at_zero_with_each_arc(motion: Trajectory) -> None:
    """What is left of the arc before changes nothing."""
    judge = 4
    flight = Flight(replace(motion.arm, momentum_max_s=ARC_S))
    guard, momentum = flight.native.guard, flight.native.momentum_sums
    fly_until(flight, seen(motion, 0), lambda: bool(momentum.task == judge))
    assert (momentum.task, momentum.row) == (judge, 0)
    before, found = bytes(ffi.buffer(flight.native)), []
    for left in (0.0, 1e3):
        ffi.memmove(flight.native, before, len(before))
        for finding in (guard.momenta, guard.momentum_noise):
            finding.residual, finding.uncertainty, finding.spread = left, left, left
        names = ("guard", "config", "column_map", "momentum_sums")
        lib.zygos_guard_settle_momentum(*(ffi.addressof(flight.native, name) for name in names))
        found.append((guard.contradiction[2], guard.left_out[2]))
    assert found[0] == found[1] and 0.0 < found[0][0] < 1.0


def test_how_many_arcs_of_momentum_rows_mean_a_change_follows_from_their_own_length(motion: Trajectory) -> None:
    """Three that are as long as those of the energy rows, however short the arcs of motor rows are."""
    judge, first = 4, 2050
    flight = Flight(replace(motion.arm, momentum_max_s=ARC_S, impulse_arc_s=2.0))
    guard, momentum = flight.native.guard, flight.native.momentum_sums
    cycles = stuck("omega", first, 300)(seen(motion, 0))
    fly_until(flight, cycles, lambda: bool(momentum.task == judge and flight.native.cycle > first + 300))
    assert guard.changed == 0
    guard.consecutive[2] = 2
    names = ("guard", "config", "column_map", "momentum_sums")
    lib.zygos_guard_settle_momentum(*(ffi.addressof(flight.native, name) for name in names))
    assert (guard.left_out[2], guard.consecutive[2], guard.changed) == (1, 3, 1)


def test_a_flipped_bit_in_the_running_solution_leaves_no_good_arc_out(motion: Trajectory) -> None:
    arm, cycles = motion.arm, seen(motion, 0)
    half = len(cycles) // 2
    for member in ("solution", "covariance", "noise_ratio", "cluster"):
        flight = Flight(arm)
        flight.cycles(part(cycles, 0, half))
        flight.estimate()
        assert flight.adopt()
        place = ffi.offsetof("zygos_guard_t", member) + 6  # in the exponent
        ffi.cast("unsigned char *", ffi.addressof(flight.native, "guard"))[place] ^= 0x40
        flight.cycles(part(cycles, half, len(cycles)))
        guard = flight.native.guard
        assert (guard.known, guard.lost, list(guard.left_out)) == (0, 1, [0, 0, 0])
        assert flight.estimate().validity == "valid"
        assert flight.adopt()
        for keep, lost in ((lib.ZYGOS_KEEP_FAULTS, 1), (0, 0)):
            assert lib.zygos_restart(flight.native, keep) == 1
            assert guard.lost == lost


def test_a_state_goes_on_with_its_running_solution(motion: Trajectory) -> None:
    arm, faulty = motion.arm, CASES[0].fault(seen(motion, 0))
    flight = Flight(arm)
    flight.cycles(part(faulty, 0, SOON - 100))
    flight.estimate()
    assert flight.adopt()
    assert lib.zygos_resume(flight.native, ffi.addressof(flight.native, "config")) == 1
    flight.cycles(part(faulty, SOON - 100, len(faulty)))
    estimate = flight.estimate()
    assert (estimate.validity, estimate.left_out[0]) == ("valid", 1)
    target = flight.native.accumulator.target
    flight.native.accumulator.target = np.nan
    assert lib.zygos_adopt(flight.native, flight._estimate) == lib.ZYGOS_E_STATE
    flight.native.accumulator.target = target
    for member, wrong in (("known", 2), ("changed", 2)):
        right = getattr(flight.native.guard, member)
        setattr(flight.native.guard, member, wrong)
        assert lib.zygos_resume(flight.native, ffi.addressof(flight.native, "config")) == lib.ZYGOS_E_STATE
        setattr(flight.native.guard, member, right)


def test_each_arc_is_compared_for_itself() -> None:
    """What was summed over the blocks of the arc before is not in the limit of the next."""
    arm = replace(arm_of(), arc_max_s=10.0, impulse_arc_s=0.0)
    flight = Flight(arm)
    cycles = seen(moved(arm, True), 0)
    flight.cycles(part(cycles, 0, 900))
    flight.estimate()
    assert flight.adopt()
    guard, sums, ends = flight.native.guard, flight.native.accumulator, []
    for k in range(900, len(cycles)):
        flight.cycles(part(cycles, k, k + 1))
        blocks = [sums.block[place] for place in sums.order[0 : sums.open]]
        newest = [block for block in blocks if block.end == blocks[-1].end]
        if newest[0].end in ends or lib.zygos_accumulator_closing(ffi.addressof(sums)) or guard.compared == 0.0:
            continue
        ends.append(newest[0].end)
        assert guard.compared == len(newest)
        assert guard.share == pytest.approx(sum(block.instants**2 / block.square for block in newest), rel=1e-9)
    assert len(ends) >= 2

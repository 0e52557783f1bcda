# SPDX-License-Identifier: MIT
"""Arcs that contradict the running solution: left out, counted and named; several in a row are a change of the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from flight_support import copy_of, joined, part
from guard_support import Running, contradiction, quantile
from numpy.typing import NDArray
from runs_support import trajectory_of
from scipy import stats
from state_support import config_of_its_own, lose_the_way, one_of_each

from conftest import EXAMPLE
from zygos.arm import Arm, TorqueLaw, load_arm
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_left_out
from zygos.model.model import Model, Quantity, load_model
from zygos.native.flight import Blocks, Estimate, Flight, encode, ffi, lib
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


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_one_bad_arc_is_left_out_and_the_rest_is_as_without_it(case: Case, motion: Trajectory) -> None:
    arm, spoilt, clean, bad = motion.arm, [], [], []
    for seed in range(2):
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
    assert watch.flight.left_out[0] == 0
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
                flight, cycles, adopted, arcs = Flight(motion.arm), seen(motion, seed), False, 0
                for first in range(0, len(cycles), 200):
                    flight.cycles(part(cycles, first, first + 200))
                    estimate = flight.estimate()
                    assert estimate.left_out == (0, 0, 0), (law, lively, seed, first)
                    judged += (estimate.arcs - arcs) * adopted
                    adopted, arcs = flight.adopt() or adopted, estimate.arcs
                    largest = np.maximum(largest, contradiction(flight))
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
    assert estimate.validity == "doubtful" and estimate.left_out[0] >= 3
    # the values are still those of the arm before
    assert np.mean(far(estimate, motion) > 1.0) < 0.3
    found = watch.look()
    assert found is not None and "a22" in found.changed
    assert found.until * arm.period_s == pytest.approx(ARC_S * ARCS, abs=0.1)
    # the restart takes the new arm
    watch.flight.restart(keep_joints=True)
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
    arm, begin, end = motion.arm, 300, 1800
    faulty = stuck("q", begin, end - begin)(seen(motion, 0))
    flight = Flight(arm)
    flight.cycles(part(faulty, 0, begin))
    flight.estimate()
    assert flight.adopt()
    left_out, last, early = 0, begin, flight
    for k in range(begin, end, 100):
        flight.cycles(part(faulty, k, k + 100))
        if flight.left_out[0] > left_out:
            left_out, last, early = flight.left_out[0], k, copy_of(flight)
    assert left_out >= 3 and last < end - 300  # the arcs behind it are as bad
    early.estimate()
    assert not early.adopt()
    flight.cycles(behind(part(faulty, end, len(faulty)), part(seen(motion, 1), 0, 1000)))
    assert flight.left_out[0] == left_out
    assert "the arm changed" in flight.estimate().reason
    assert flight.adopt()


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
    for seed in range(2):
        watch = watched(motion.arm, stuck("q", 100, 60)(seen(motion, seed)))
        estimate = watch.flight.estimate()
        assert estimate.validity == "valid"
        assert estimate.left_out[0] >= 1
        assert np.mean(far(estimate, motion) > 1.0) < 0.3
        # who adopts nothing gets the answer for all arcs
        deaf = Flight(motion.arm)
        deaf.cycles(stuck("q", 100, 60)(seen(motion, seed)))
        assert deaf.estimate().validity != "valid" or deaf.estimate().noise_ratio > 1.5


def test_stale_frames_for_half_an_hour(motion: Trajectory) -> None:
    """One frame in five thousand repeats what it said sixteen cycles ago: its counter and its checksum are good."""
    arm, runs, last = replace(motion.arm, arc_max_s=60.0), [], 0
    rng = np.random.default_rng(0)
    for seed in range(9):
        run = seen(motion, seed)
        for names, joints in ((("q", "theta"), arm.n), (("tau",), arm.n), (("omega",), 1)):
            for joint in range(joints):
                for k in np.flatnonzero(rng.random(len(run)) < 2e-4):
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
    cycles = part(seen(motion, 0), 0, 1700)
    frames = encode(arm, CASES[0].fault(cycles))
    for rooms in (check_frames(arm, frames), check_cycles(arm, stuck("omega", 1580, 60)(cycles))):
        assert [room.name for room in rooms if not room.equal] == []
        assert rooms[-1].name == "solution" and "noise" in [room.name for room in rooms]
    # numpy that is not told differs
    watch = Watch(Flight(arm), trace=True)
    watch.frames(frames)
    assert any(arc.rows == "energy" for arc in watch.left_out)
    assert not all(room.equal for room in check_chain(arm, watch.trace(), watch.flight))


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
    assert all(0.0 < one < 0.5 for one in contradiction(flight))
    assert (np.abs(estimate.value - plant.base_values(arm)) < 2.0 * estimate.half95).all()


def test_a_bad_arc_of_momentum_rows_is_left_out(motion: Trajectory) -> None:
    """A gyro that repeats its reading for 15 s: the angular momentum of what it shows is not constant."""
    arm, cycles = replace(motion.arm, momentum_max_s=ARC_S), part(seen(motion, 0), 0, 2400)
    good = watched(arm, cycles).flight
    assert good.estimate().validity == "valid" and good.estimate().left_out == (0, 0, 0)
    assert good._work.solver.momentum_weight > 0.0
    watch = watched(arm, stuck("omega", SOON, 300)(cycles))
    estimate = watch.flight.estimate()
    assert (estimate.validity, estimate.left_out[2]) == ("valid", 1)
    assert [arc.rows for arc in watch.left_out].count("momentum") == 1
    assert all(arc.first <= SOON + 300 and arc.last >= SOON for arc in watch.left_out)
    assert len(watch.flight.blocks().momentum) == len(good.blocks().momentum) - 1
    assert np.mean(far(estimate, motion) > 1.0) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("fault", [lambda cycles: cycles, stuck("omega", SOON, 300)])
def test_c_equals_numpy_with_momentum_rows_left_out(fault: Fault, motion: Trajectory) -> None:
    arm = replace(motion.arm, momentum_max_s=ARC_S)
    rooms = check_frames(arm, encode(arm, fault(part(seen(motion, 0), 0, 2400))))
    assert [room.name for room in rooms if not room.equal] == []


# ---------------------------------------------------------------- misuse, memory


def test_only_a_valid_estimate_of_this_arm_is_adopted(motion: Trajectory) -> None:
    arm, cycles = motion.arm, seen(motion, 0)
    flight = Flight(arm)
    flight.cycles(part(cycles, 0, 30))
    assert flight.estimate().validity == "refused"
    assert not flight.adopt()
    before = bytes(ffi.buffer(flight.native))
    assert not flight.adopt()
    flight.native.sums.dropped -= 1  # tasks were finished
    assert bytes(ffi.buffer(flight.native)) == before
    assert lib.zygos_arm_adopt(ffi.NULL, flight._estimate) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_adopt(flight.native, ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_adopt(ffi.new("zygos_arm_t *"), flight._estimate) == lib.ZYGOS_E_ORDER
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
    arcs = flight.estimate().arcs
    flight.cycles(part(faulty, SOON - 100, len(faulty)))
    assert flight.left_out[0] == 0
    assert flight.estimate().arcs > arcs + 2


def test_the_open_arc_is_compared_with_those_before_it_once_it_is_long_enough(motion: Trajectory) -> None:
    """By a flight that leaves arcs out; until then the arc before it is, if there is one."""
    arm, cycles = motion.arm, seen(motion, 0)
    flight, at = Flight(arm), 2000
    flight.cycles(part(cycles, 0, at))
    flight.estimate()
    assert flight.adopt()
    for behind, compared in ((60, False), (390, True), (480, True)):
        flight.cycles(part(cycles, int(flight.native.sums.cycle) + 1, at + behind))
        drift = flight.drift()
        assert drift.changed == ()
        assert np.isfinite(drift.deviation).all() == compared


@pytest.mark.parametrize(("freedom", "error"), [(10.0, 0.05), (100.0, 0.004), (1e4, 1e-4)])
def test_the_limit_of_a_mean_square_is_six_sigmas_of_chi_square_with_its_margin(freedom: float, error: float) -> None:
    """By the cube root that is nearly normal."""
    expected = 1.25 * stats.chi2.isf(stats.norm.sf(6.0), freedom) / freedom
    assert quantile(freedom) == pytest.approx(expected, rel=error)


def louder(cycles: Cycles, by: float) -> Cycles:
    """Torques that are larger than the others'."""
    return replace(cycles, tau=cycles.tau * (1.0 + by))


def pulsing(cycles: Cycles, by: float) -> Cycles:
    """Torques beside which others swing: blocks tell less of them than rows."""
    return replace(cycles, tau=cycles.tau + by * np.sin(np.arange(len(cycles)) * 2.0 * np.pi / 9.0)[:, None])


def louder_joint(joint: int) -> Callable[[Cycles, float], Cycles]:
    return lambda cycles, by: replace(cycles, tau=cycles.tau * (1.0 + by * (np.arange(2) == joint)))


SCALED: dict[str, tuple[int, Callable[[Cycles, float], Cycles], float]] = {
    "blocks": (0, louder, 1.0),
    "rows": (0, pulsing, 100.0),
    "motor rows of the shoulder": (1, louder_joint(0), 1.0),
    "motor rows of the elbow": (1, louder_joint(1), 1.0),
}
"""Kind of rows, a fault of any size, and a size that is too large."""


@pytest.mark.slow(but=["*-1", "rows-*", "*elbow-*"])
@pytest.mark.parametrize(("case", "arcs_between"), [("blocks", 1), *((case, 0) for case in SCALED if case != "blocks")])
def test_an_arc_is_left_out_from_the_limit_on_that_numpy_has(case: str, arcs_between: int, motion: Trajectory) -> None:
    """By as little as one percent of a fault; by itself, whatever arcs came between the adoption and it."""
    kind, fault, high = SCALED[case]
    cycles, at, low = seen(motion, 0), 2000, 0.0
    flight, plain = (Flight(replace(motion.arm, compensate_every=every)) for every in (motion.arm.compensate_every, 0))
    for one in (flight, plain):
        one.cycles(part(cycles, 0, at))
        assert lib.zygos_arm_end_arcs(one.native) == 1
    running = Running(motion.arm, flight.estimate(), flight.blocks(), plain.blocks())
    judging = copy_of(flight)
    judging.estimate()
    assert judging.adopt()
    for _ in range(arcs_between):
        for one in (flight, plain, judging):
            one.cycles(part(cycles, at, at + 110))
            assert lib.zygos_arm_end_arcs(one.native) == 1
        at += 110
    rest, noise = part(cycles, at, at + 120), flight.noise()

    def of_numpy(size: float) -> float:
        after, without = copy_of(flight), copy_of(plain)
        for one in (after, without):
            one.cycles(fault(rest, size))
        arc = only_the_newest(after.blocks(), after.counts["accepted"] - flight.counts["accepted"])
        if kind == 1:
            return max(running.motors(arc, without.blocks()))
        rows, blocks = running.energy(arc, after.noise() - noise)
        assert (rows > blocks) == (case == "rows")
        return max(rows, blocks)

    while high - low > 5e-3 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if of_numpy(middle) < 1.0 else (low, middle)
    for size, is_left_out in ((0.99 * low, False), (1.01 * high, True)):
        judged = copy_of(judging)
        judged.cycles(fault(rest, size))
        assert (judged.estimate().left_out[kind] > 0) == is_left_out


def only_the_newest(blocks: Blocks, instants: float) -> Blocks:
    """The blocks of energy rows that hold the newest instants."""
    first = len(blocks.energy)
    while instants > 0.5:
        first -= 1
        instants -= blocks.energy[first][2]
    return replace(blocks, energy=blocks.energy[first:])


def test_a_flipped_bit_in_the_running_solution_leaves_no_good_arc_out(motion: Trajectory) -> None:
    """In what is new in the state since the adoption: it is given up, and the next estimate is adopted."""
    cycles, half = part(seen(motion, 0), 0, 3000), 2000
    flight, rng = Flight(motion.arm), np.random.default_rng(0)
    flight.cycles(part(cycles, 0, half))
    assert lib.zygos_arm_scrub(flight.native, config_of_its_own(flight)) == 0
    before = copy_of(flight)
    flight.estimate()
    assert flight.adopt()
    new = [
        place
        for place in one_of_each(flight.native, rng)
        if place.leaf.kind == "double" and place.values(flight.native) != place.values(before.native)
    ]
    assert len(new) > 5
    for place in new:
        damaged = copy_of(flight)
        place.flip(damaged.native, 54)
        damaged.cycles(part(cycles, half, len(cycles)))
        estimate = damaged.estimate()
        assert (estimate.validity, estimate.left_out) == ("valid", (0, 0, 0)), place
        assert damaged.adopt()


def test_a_state_goes_on_with_its_running_solution(motion: Trajectory) -> None:
    arm, faulty = motion.arm, CASES[0].fault(seen(motion, 0))
    flight = Flight(arm)
    flight.cycles(part(faulty, 0, SOON - 100))
    flight.estimate()
    assert flight.adopt()
    assert lib.zygos_arm_resume(flight.native, ffi.addressof(flight.native, "sums", "config")) == 1
    flight.cycles(part(faulty, SOON - 100, SOON + 400))
    estimate = flight.estimate()
    assert estimate.left_out[0] == 1
    assert np.all(far(estimate, motion) < 1.0)
    lose_the_way(flight)
    assert lib.zygos_arm_adopt(flight.native, flight._estimate) == lib.ZYGOS_E_STATE

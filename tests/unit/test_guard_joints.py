"""Segments of joint rows that contradict the running solution, where joint rows alone determine the estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_support import copy_of, part
from ground_support import heavier, seen, short_arm, torque_of
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_left_out
from zygos.model.model import Model
from zygos.native.flight import REASONS, Estimate, Flight, config_of, encode, ffi, lib
from zygos.reference.compare import check_frames
from zygos.runs.cycles import Cycles

Array = NDArray[np.float64]
SEGMENT_S = 2.0
CONSECUTIVE = 3
"""ZYGOS_CONSECUTIVE_ARCS"""


def doubled(model: Model) -> Model:
    """With a payload of the last body's own mass, beside its centre."""
    x, y, z = model.bodies[-1].origin_xyz
    return heavier(model, model.bodies[-1].mass.value, (x + 0.05, y, z))


def laden(arm: Arm, model: Model) -> tuple[Array, Array, int]:
    """Angles and exact torques (n, N) of 80 s; the cycle, at 45 s, from which the last body has twice its mass."""
    q, tau = torque_of(arm, model, 0, 80.0)
    _, loaded = torque_of(arm, doubled(model), 0, 80.0)
    at = round(45.0 / arm.period_s)
    return q, np.concatenate([tau[:at], loaded[at:]]), at


def flight_of(arm: Arm, model: Model, *, energy_rows: bool = True) -> Flight:
    flight = Flight(arm, model.effects)
    if not energy_rows:
        config = config_of(arm, model.effects)
        config.arc_cycles = 0
        assert lib.zygos_init(flight.native, config) == 1
    return flight


def watched(flight: Flight, cycles: Cycles) -> tuple[Estimate, float]:
    """Adopt every second. Returns the last estimate and the largest contradiction of a segment that was judged."""
    step, largest = round(1.0 / flight.arm.period_s), 0.0
    for first in range(0, len(cycles), step):
        flight.cycles(part(cycles, first, first + step))
        estimate = flight.estimate()
        flight.adopt()
        largest = max(largest, float(flight.native.guard.contradiction[0]))
    return estimate, largest


def true_values(arm: Arm, model: Model, names: tuple[str, ...]) -> Array:
    values = dict(zip(arm.parameter_names, model.base_values(arm).tolist(), strict=True))
    values |= {effect.column(arm): effect.value for effect in model.effects}
    return np.array([values[name] for name in names])


def far(estimate: Estimate, arm: Arm, model: Model) -> Array:
    """(p,) errors in half widths of the 95 % intervals."""
    return np.asarray(np.abs(estimate.value - true_values(arm, model, estimate.names)) / estimate.half95)


@pytest.mark.parametrize(("joints", "energy_rows"), [(2, False), (3, True), (6, False)])
def test_a_payload_that_doubles_is_a_change(joints: int, energy_rows: bool) -> None:
    """Within three segments; the values stay those of the arm before, and those that differ are of its bodies."""
    arm, model = short_arm(joints)
    load = doubled(model)
    q, tau, at = laden(arm, model)
    cycles = seen(arm, q, tau, 0)
    flight = flight_of(arm, model, energy_rows=energy_rows)
    before, _ = watched(flight, part(cycles, 0, at))
    assert (before.validity, before.left_out[0]) == ("valid", 0)
    assert flight.drift().largest == 0.0

    soon = at + round((CONSECUTIVE + 1) * 1.1 * SEGMENT_S / arm.period_s)
    estimate, largest = watched(flight, part(cycles, at, soon))
    assert estimate.validity == "doubtful" and estimate.reason.startswith("the arm changed")
    assert estimate.consecutive >= CONSECUTIVE
    assert largest > 100.0

    estimate, _ = watched(flight, part(cycles, soon, len(cycles)))
    assert estimate.reason.startswith("the arm changed")
    assert np.mean(far(estimate, arm, model) > 1.0) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(estimate.value))
    drift = flight.drift()
    assert 0.0 <= 45.0 - drift.until * arm.period_s <= 1.1 * SEGMENT_S + 1.0
    last = f"{joints}"
    assert any(name.endswith(last) for name in drift.changed)
    moved = np.abs(true_values(arm, load, drift.names) - true_values(arm, model, drift.names)) > 0.0
    assert all(moved[drift.names.index(name)] for name in drift.changed)

    ended, _ = flight.left_out
    flight.restart()
    again = seen(arm, *torque_of(arm, load, 1, 60.0), 1)
    after, _ = watched(flight, replace(again, sync=again.sync + cycles.sync[-1] + np.uint64(9)))
    assert flight.native.guard.known == 1
    assert (after.validity, after.left_out, after.consecutive) == ("valid", (ended, 0, 0), 0)
    assert np.mean(far(after, arm, load) > 1.0) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(after.value))


@pytest.mark.slow
def test_no_segment_of_an_arm_that_stays_the_same_contradicts() -> None:
    """Over 200 judged segments of two motions: the estimate is that of a flight that adopts nothing."""
    arm, model = short_arm(6)
    exact = [torque_of(arm, model, path, 100.0) for path in range(2)]
    judged, contradictions = 0, []
    for seed in range(6):
        cycles = seen(arm, *exact[seed % 2], seed)
        flight = flight_of(arm, model)
        flight.cycles(part(cycles, 0, 10000))
        while not flight.native.guard.known:
            flight.cycles(part(cycles, flight.native.cycles, flight.native.cycles + 1000))
            flight.estimate()
            flight.adopt()
        before = flight.native.joint_sums.segments
        estimate, largest = watched(flight, part(cycles, flight.native.cycles, len(cycles)))
        judged += flight.native.joint_sums.segments - before
        contradictions.append(largest)
        assert (estimate.validity, estimate.left_out) == ("valid", (0, 0, 0))
        deaf = flight_of(arm, model)
        deaf.cycles(cycles)
        np.testing.assert_array_equal(estimate.value, deaf.estimate().value)
    print(f"largest contradiction of {judged} segments: {max(contradictions):.2f} of the limit")
    assert judged > 200
    assert max(contradictions) < 0.5


@pytest.mark.parametrize("mass", [0.1, None])
def test_a_small_payload_at_the_wrist(mass: float | None) -> None:
    """100 g beside a hand of 2 kg are seen, and what six joints know of the bodies tells where."""
    arm, model = short_arm(6)
    hand = model.bodies[-1]
    at = round(45.0 / arm.period_s)
    q, tau = torque_of(arm, model, 0, 80.0)
    _, loaded = torque_of(arm, heavier(model, mass or hand.mass.value, hand.origin_xyz), 0, 80.0)
    flight = flight_of(arm, model)
    _, largest = watched(flight, seen(arm, q, np.concatenate([tau[:at], loaded[at:]]), 0))
    print(f"payload of {mass or hand.mass.value:g} kg: {largest:.0f} times the limit")
    assert largest > 10.0
    assert "mz6" in flight.drift().changed
    assert not any(name.startswith("motor") for name in flight.drift().changed)


@pytest.mark.slow
def test_what_a_fault_spoils_is_left_out_and_over_when_a_segment_agrees() -> None:
    """The torque sensor of one joint is stuck for seven seconds: numpy leaves the same segments out."""
    arm, model = short_arm(2)
    arm = replace(arm, arc_max_s=20.0)
    cycles = seen(arm, *torque_of(arm, model, 0, 60.0), 0)
    stuck = cycles.tau.copy()
    first, count = round(45.0 / arm.period_s), round(7.0 / arm.period_s)
    stuck[first : first + count, 1] = stuck[first, 1]
    faulty = replace(cycles, tau=stuck)
    flight = flight_of(arm, model)
    rooms = check_frames(arm, encode(arm, faulty), flight)
    assert [room.name for room in rooms if not room.equal] == []
    assert {"joint rows", "sigmas", "solution"} <= {room.name for room in rooms}
    estimate = flight.estimate()
    assert (estimate.validity, estimate.consecutive) == ("valid", 0)
    assert 3 <= estimate.left_out[0] <= 5
    assert flight.drift().reason == "too few accepted instants"
    count, arcs = flight.left_out
    assert count == estimate.left_out[0]
    assert arcs[0].last * arm.period_s >= 45.0 and arcs[-1].first * arm.period_s <= 52.0
    assert np.mean(far(estimate, arm, model) > 1.0) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(estimate.value))
    # without the adoption they spoil the estimate
    deaf = flight_of(arm, model)
    deaf.cycles(faulty)
    spoilt = deaf.estimate()
    assert spoilt.validity != "valid" or spoilt.noise_ratio > 4.0


def test_the_watch_tells_the_change_in_words() -> None:
    arm, model = short_arm(2)
    arm = replace(arm, arc_max_s=10.0)
    q, tau, _ = laden(arm, model)
    watch = Watch(flight_of(arm, model))
    watch.cycles(seen(arm, q, tau, 0))
    found = watch.look()
    assert found is not None and found.changed
    said = about_left_out(watch.flight.estimate(), watch)
    assert "segments of the joint rows" in said


def test_a_state_goes_on_with_its_running_solution_and_what_was_set_aside() -> None:
    arm, model = short_arm(2)
    q, tau, at = laden(arm, model)
    cycles = seen(arm, q, tau, 0)
    flight = flight_of(arm, model)
    watched(flight, part(cycles, 0, at + round(12.0 / arm.period_s)))
    aside = flight.native.joint_sums.group[lib.ZYGOS_JOINT_GROUPS_VALUE].count
    assert aside > 0.0
    other = copy_of(flight)
    assert lib.zygos_resume(other.native, config_of(arm, model.effects)) == 1
    assert other.estimate().reason.startswith("the arm changed")
    assert other.native.joint_sums.group[lib.ZYGOS_JOINT_GROUPS_VALUE].count == aside
    np.testing.assert_array_equal(other.drift().deviation, flight.drift().deviation)


def test_a_change_is_told_where_next_to_no_noise_is_left() -> None:
    """Other motions then leave over what the approximations do, of which a thousandth of the signal is let pass."""
    arm, model = short_arm(2)
    q, tau, _ = laden(arm, model)
    cycles = seen(arm, q, tau, 0)
    angle = q + 1e-3 * (cycles.q - q)
    flight = flight_of(arm, model, energy_rows=False)
    watched(flight, replace(cycles, q=angle, theta=angle, tau=tau))
    assert any(name.endswith("2") for name in flight.drift().changed)


def test_segments_that_another_arm_does_not_explain_either_are_not_compared() -> None:
    """From some time on, one torque is nearly noise: many segments contradict, and no parameter is said to differ."""
    arm, model = short_arm(2)
    cycles = seen(arm, *torque_of(arm, model, 0, 80.0), 0)
    at = round(45.0 / arm.period_s)
    tau = cycles.tau.copy()
    tau[at:, 1] += np.random.default_rng(0).normal(scale=np.std(tau[:, 1]), size=len(tau) - at)
    flight = flight_of(arm, model, energy_rows=False)
    estimate, _ = watched(flight, replace(cycles, tau=tau))
    assert estimate.reason.startswith("the arm changed")
    drift = flight.drift()
    assert (drift.changed, drift.largest) == ((), 0.0)
    deviation = ffi.new("double[]", lib.ZYGOS_MAX_PARAMETERS_VALUE)
    assert lib.zygos_detect_change(flight._work, flight._before, deviation) == 0


def test_segments_that_are_set_aside_leave_their_noise_out_of_the_estimate() -> None:
    arm, model = short_arm(2)
    q, tau, at = laden(arm, model)
    cycles = seen(arm, q, tau, 0)
    flight = flight_of(arm, model)
    sums, aside = flight.native.joint_sums, lib.ZYGOS_JOINT_GROUPS_VALUE
    seconds = round(10.0 / arm.period_s)
    watched(flight, part(cycles, 0, at + seconds))
    noise, before = bytes(ffi.buffer(sums.noise.gram)), sums.group[aside].count
    assert any(sums.noise.gram) and before > 0.0
    watched(flight, part(cycles, at + seconds, at + 2 * seconds))
    assert sums.group[aside].count > before
    assert bytes(ffi.buffer(sums.noise.gram)) == noise


def test_an_estimate_of_another_flight_judges_the_segments_of_one_that_has_none() -> None:
    """Where it has residuals; without them every segment is admitted."""
    arm, model = short_arm(2)
    cycles = seen(arm, *torque_of(arm, model, 0, 60.0), 0)
    half = len(cycles) // 2
    first = flight_of(arm, model, energy_rows=False)
    first.cycles(part(cycles, 0, half))
    first.estimate()
    for residual in (float(first._estimate.residual), 0.0):
        flight = flight_of(arm, model, energy_rows=False)
        first._estimate.residual = residual
        assert lib.zygos_adopt(flight.native, first._estimate) == 1
        assert (flight.native.guard.known, flight.native.guard.energy.spread) == (1, 0.0)
        flight.cycles(part(cycles, half, len(cycles)))
        assert flight.native.joint_sums.segments > 4
        assert flight.native.guard.left_out[0] == 0
        assert (flight.native.guard.contradiction[0] > 0.0) == (residual > 0.0)


def test_segments_are_compared_with_the_mean_over_all_before_and_nothing_is_set_aside() -> None:
    arm, model = short_arm(2)
    flight = flight_of(arm, model, energy_rows=False)
    flight.cycles(seen(arm, *torque_of(arm, model, 0, 40.0), 0))
    flight.estimate()
    assert flight.adopt()
    guard, sums = flight.native.guard, flight.native.joint_sums
    last = int(sums.width) * (int(sums.width) + 1) // 2 - 1
    groups = [sums.group[g] for g in range(lib.ZYGOS_JOINT_GROUPS_VALUE)]
    assert all(group.count > 0.0 and group.fade > 0.0 for group in groups)
    mean = sum(one.fade * one.rows.gram[last] for one in groups) / sum(one.fade * one.count for one in groups)
    assert guard.energy.spread == pytest.approx(mean, rel=1e-12)
    drift = flight.drift()
    assert (drift.changed, drift.reason) == ((), REASONS[lib.ZYGOS_REASON_NO_DATA])
    assert np.isnan(drift.deviation).all()

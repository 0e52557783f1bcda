# SPDX-License-Identifier: MIT
"""Segments of joint rows that contradict the running solution, where joint rows alone determine the estimate."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from flight_support import copy_of, part
from ground_support import heavier, seen, short_arm, torque_of
from guard_support import contradiction
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_left_out
from zygos.model.model import Model
from zygos.native.flight import REASONS, Estimate, Flight, config_of, encode, lib
from zygos.reference.compare import check_frames
from zygos.runs.cycles import Cycles

Array = NDArray[np.float64]
SEGMENT_S = 2.0
CONSECUTIVE = 3
"""ZYGOS_CONSECUTIVE_ARCS"""


DOUBLED = -1.0


@cache
def arm_of(joints: int) -> tuple[Arm, Model]:
    return short_arm(joints, period_s=0.002 if joints > 2 else 0.004)


def with_load(model: Model, kg: float) -> Model:
    """A payload in the last body's centre; DOUBLED: of that body's own mass, beside its centre."""
    x, y, z = model.bodies[-1].origin_xyz
    return (
        heavier(model, model.bodies[-1].mass.value, (x + 0.05, y, z))
        if kg == DOUBLED
        else heavier(model, kg, (x, y, z))
    )


@cache
def exact(joints: int, kg: float = 0.0, path: int = 0) -> tuple[Array, Array]:
    """Angles and exact torques (n, N) of 70 s."""
    arm, model = arm_of(joints)
    return torque_of(arm, with_load(model, kg) if kg else model, path, 70.0)


def laden(joints: int, kg: float = DOUBLED) -> tuple[Array, Array, int]:
    """Angles and exact torques (n, N); the cycle, at 45 s, from which there is a payload."""
    (q, tau), (_, loaded) = exact(joints), exact(joints, kg)
    at = round(45.0 / arm_of(joints)[0].period_s)
    return q, np.concatenate([tau[:at], loaded[at:]]), at


def flight_of(arm: Arm, model: Model, *, energy_rows: bool = True) -> Flight:
    flight = Flight(arm, model.effects)
    if not energy_rows:
        config = config_of(arm, model.effects)
        config.arc_cycles = 0
        assert lib.zygos_arm_init(flight.native, config) == 1
    return flight


def watched(flight: Flight, cycles: Cycles) -> tuple[Estimate, float]:
    """Adopt every second. Returns the last estimate and the largest contradiction of a segment that was judged."""
    step, largest = round(1.0 / flight.arm.period_s), 0.0
    for first in range(0, len(cycles), step):
        flight.cycles(part(cycles, first, first + step))
        estimate = flight.estimate()
        flight.adopt()
        largest = max(largest, float(contradiction(flight)[0]))
    return estimate, largest


def true_values(arm: Arm, model: Model, names: tuple[str, ...]) -> Array:
    values = dict(zip(arm.parameter_names, model.base_values(arm).tolist(), strict=True))
    values |= {effect.column(arm): effect.value for effect in model.effects}
    return np.array([values[name] for name in names])


def far(estimate: Estimate, arm: Arm, model: Model) -> Array:
    """(p,) errors in half widths of the 95 % intervals."""
    return np.asarray(np.abs(estimate.value - true_values(arm, model, estimate.names)) / estimate.half95)


@pytest.mark.slow(but=["2-*"])
@pytest.mark.parametrize(("joints", "energy_rows"), [(2, False), (3, True), (6, False)])
def test_a_payload_that_doubles_is_a_change(joints: int, energy_rows: bool) -> None:
    """Within three segments; the values stay those of the arm before, and those that differ are of its bodies."""
    arm, model = arm_of(joints)
    load = with_load(model, DOUBLED)
    q, tau, at = laden(joints)
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
    again = part(seen(arm, *exact(joints, DOUBLED, 1), 1), 0, round(60.0 / arm.period_s))
    after, _ = watched(flight, replace(again, sync=again.sync + cycles.sync[-1] + np.uint64(9)))
    assert (after.validity, after.left_out, after.consecutive) == ("valid", (ended, 0, 0), 0)
    assert np.mean(far(after, arm, load) > 1.0) <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(after.value))


@pytest.mark.slow
def test_no_segment_of_an_arm_that_stays_the_same_contradicts() -> None:
    """Over 100 judged segments of two motions: the estimate is that of a flight that adopts nothing."""
    arm, model = arm_of(6)
    judged, contradictions = 0, []
    for seed in range(5):
        cycles = seen(arm, *exact(6, path=seed % 2), seed)
        flight = flight_of(arm, model)
        flight.cycles(part(cycles, 0, 10000))
        adopted = False
        while not adopted:
            flight.cycles(part(cycles, flight.native.cycles, flight.native.cycles + 1000))
            flight.estimate()
            adopted = flight.adopt()
        before = flight.estimate().arcs
        estimate, largest = watched(flight, part(cycles, flight.native.cycles, len(cycles)))
        judged += estimate.arcs - before
        contradictions.append(largest)
        assert (estimate.validity, estimate.left_out) == ("valid", (0, 0, 0))
        deaf = flight_of(arm, model)
        deaf.cycles(cycles)
        np.testing.assert_array_equal(estimate.value, deaf.estimate().value)
    print(f"largest contradiction of {judged} segments: {max(contradictions):.2f} of the limit")
    assert judged > 100
    assert max(contradictions) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("kg", [0.1, 2.0])
def test_a_small_payload_at_the_wrist(kg: float) -> None:
    """100 g beside a hand of 2 kg are seen, and what six joints know of the bodies tells where."""
    arm, model = arm_of(6)
    q, tau, _ = laden(6, kg)
    flight = flight_of(arm, model)
    _, largest = watched(flight, seen(arm, q, tau, 0))
    print(f"payload of {kg:g} kg: {largest:.0f} times the limit")
    assert largest > 10.0
    assert "mz6" in flight.drift().changed
    assert not any(name.startswith("motor") for name in flight.drift().changed)


@pytest.mark.slow
def test_what_a_fault_spoils_is_left_out_and_over_when_a_segment_agrees() -> None:
    """The torque sensor of one joint is stuck for seven seconds: numpy leaves the same segments out."""
    arm, model = arm_of(2)
    arm = replace(arm, arc_max_s=20.0)
    cycles = seen(arm, *exact(2), 0)
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
    arm, model = arm_of(2)
    arm = replace(arm, arc_max_s=10.0)
    q, tau, _ = laden(2)
    watch = Watch(flight_of(arm, model))
    watch.cycles(seen(arm, q, tau, 0))
    found = watch.look()
    assert found is not None and found.changed
    said = about_left_out(watch.flight.estimate(), watch)
    assert "segments of the joint rows" in said


def test_segments_that_are_set_aside_are_no_part_of_the_estimate_and_go_on_with_the_state() -> None:
    """Neither their rows nor their noise; a state that is resumed compares with them."""
    arm, model = arm_of(2)
    q, tau, at = laden(2)
    cycles, seconds = seen(arm, q, tau, 0), round(10.0 / arm.period_s)
    flight = flight_of(arm, model)
    first, _ = watched(flight, part(cycles, 0, at + seconds))
    before = flight.blocks().joints
    second, _ = watched(flight, part(cycles, at + seconds, at + 2 * seconds))
    assert second.left_out[0] > first.left_out[0] >= CONSECUTIVE
    for (sums, count), (sums_before, count_before) in zip(flight.blocks().joints, before, strict=True):
        np.testing.assert_array_equal(sums, sums_before)
        assert count == count_before
    np.testing.assert_array_equal(second.value, first.value)
    assert second.noise_ratio == first.noise_ratio
    other = copy_of(flight)
    assert lib.zygos_arm_resume(other.native, config_of(arm, model.effects)) == 1
    assert other.estimate().reason.startswith("the arm changed")
    np.testing.assert_array_equal(other.drift().deviation, flight.drift().deviation)


def test_a_change_is_told_where_next_to_no_noise_is_left() -> None:
    """Other motions then leave over what the approximations do, of which a thousandth of the signal is let pass."""
    arm, model = arm_of(2)
    q, tau, _ = laden(2)
    cycles = seen(arm, q, tau, 0)
    angle = q + 1e-3 * (cycles.q - q)
    flight = flight_of(arm, model, energy_rows=False)
    watched(flight, replace(cycles, q=angle, theta=angle, tau=tau))
    assert any(name.endswith("2") for name in flight.drift().changed)


def test_segments_that_another_arm_does_not_explain_either_are_not_compared() -> None:
    """From some time on, one torque is nearly noise: many segments contradict, and no parameter is said to differ."""
    arm, model = arm_of(2)
    cycles = seen(arm, *exact(2), 0)
    at = round(45.0 / arm.period_s)
    tau = cycles.tau.copy()
    tau[at:, 1] += np.random.default_rng(0).normal(scale=np.std(tau[:, 1]), size=len(tau) - at)
    flight = flight_of(arm, model, energy_rows=False)
    estimate, _ = watched(flight, replace(cycles, tau=tau))
    assert estimate.reason.startswith("the arm changed")
    drift = flight.drift()
    assert (drift.changed, drift.reason) == ((), REASONS[lib.ZYGOS_REASON_UNCLOSED])


def test_an_estimate_of_another_flight_judges_the_segments_of_one_that_has_none() -> None:
    """Where it has residuals; without them every segment is admitted."""
    arm, model = arm_of(2)
    cycles = seen(arm, *exact(2), 0)
    half = len(cycles) // 2
    first = flight_of(arm, model, energy_rows=False)
    first.cycles(part(cycles, 0, half))
    first.estimate()
    for residual in (float(first._estimate.residual), 0.0):
        flight = flight_of(arm, model, energy_rows=False)
        first._estimate.residual = residual
        assert lib.zygos_arm_adopt(flight.native, first._estimate) == 1
        flight.cycles(part(cycles, half, len(cycles)))
        estimate = flight.estimate()
        assert estimate.accepted > 1000 and estimate.left_out[0] == 0
        assert (contradiction(flight)[0] > 0.0) == (residual > 0.0)


def test_where_nothing_is_set_aside_nothing_is_compared() -> None:
    arm, model = arm_of(2)
    flight = flight_of(arm, model, energy_rows=False)
    flight.cycles(part(seen(arm, *exact(2), 0), 0, round(40.0 / arm.period_s)))
    flight.estimate()
    assert flight.adopt()
    drift = flight.drift()
    assert (drift.changed, drift.reason) == ((), REASONS[lib.ZYGOS_REASON_NO_DATA])
    assert np.isnan(drift.deviation).all()

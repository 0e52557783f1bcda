# SPDX-License-Identifier: MIT
"""Stretches in fixed steps against the simulator, and the number of steps they take."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from gap_support import Floats, effect, example, moved
from runs_support import trajectory_of

from zygos.arm import Arm
from zygos.balances.state import State
from zygos.dynamics.planar import PlanarDynamics
from zygos.dynamics.replay import STEP_OF_MODE, exact_readings, replay, substeps
from zygos.effects import Effect
from zygos.model.model import Model, Quantity
from zygos.simulation.plant import Trajectory

DURATION_S = 2.0
CYCLES = 151
"""Samples of a stretch: 0.75 s."""


def packed(trajectory: Trajectory) -> Floats:
    """(n, 4N+1) states of a run of one seed."""
    t = trajectory
    return State(t.q[0], t.theta[0], t.qd[0], t.thetad[0], t.omega0[0]).packed()


def with_drives(model: Model, **values: float) -> Model:
    """The model with another stiffness, damping or rotor inertia in every joint."""
    quantities: dict[str, Any] = {name: Quantity(value) for name, value in values.items()}
    return replace(model, joints=tuple(replace(joint, **quantities) for joint in model.joints))


def away(trajectory: Trajectory, cycles: int, factor: int = 1) -> float:
    """Largest distance of stretches from the run they begin on, by state in units of how far that state moves."""
    path, tau, dynamics = packed(trajectory), trajectory.tau[0], trajectory.dynamics
    starts = np.arange(0, len(path) - cycles + 1, 24)
    at = starts[:, None] + np.arange(cycles)
    torque = np.concatenate([np.zeros((1, tau.shape[1])), tau])
    period = trajectory.arm.period_s
    steps = factor * substeps(dynamics, trajectory.q[:, ::20], period)
    states, applied = replay(
        dynamics, period, path[starts], lambda k, _: torque[1 + at[:, k]], torque[starts], cycles, steps
    )
    assert len(starts) >= 10
    np.testing.assert_array_equal(applied, tau[at])
    np.testing.assert_array_equal(states[:, 0], path[starts])
    return float((np.abs(states - path[at]).max(axis=(0, 1)) / np.ptp(path, axis=0)).max())


def friction(arm: Arm) -> tuple[Effect, ...]:
    return effect(arm, "motor_coulomb", 0, 0.2), effect(arm, "link_coulomb", 1, 5.0)


def smooth(arm: Arm) -> tuple[Effect, ...]:
    listed = (("motor_viscous", 0, 0.5), ("cubic_stiffness", 1, 1000.0), ("rotor_coupling", 0, 0.0))
    return (*(effect(arm, *one) for one in listed), effect(arm, "angular_momentum", -1, 10.0))


def lagging(arm: Arm) -> tuple[Effect, ...]:
    return effect(arm, "torque_lag", 0, 0.002), effect(arm, "torque_lag", 1, 0.0005)


@pytest.mark.slow
@pytest.mark.parametrize(("effects", "tolerance"), [
    (smooth, 1e-9),
    (lagging, 1e-9),
    # within a step a fixed step does not see the corner of Coulomb friction at a turn of the motion
    (friction, 3e-6),
])  # fmt: skip
def test_stretches_stay_on_the_simulators_run(effects: object, tolerance: float) -> None:
    assert callable(effects)
    arm, _, _ = example()
    error = away(moved("b", DURATION_S, *effects(arm)), CYCLES)
    print(f"{error:.1e}")
    assert error <= tolerance


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [(0,), (0, 1)])
def test_rigid_joints_stay_on_the_simulators_run(rigid: tuple[int, ...]) -> None:
    arm, model, scenario = example()
    joints = tuple(replace(j, stiffness=Quantity(np.inf)) if i in rigid else j for i, j in enumerate(model.joints))
    run = trajectory_of(
        arm, replace(model, joints=joints), scenario, noise=False, duration_s=DURATION_S, rtol=1e-10, atol=1e-12
    )
    error = away(run, CYCLES)
    print(f"{error:.1e}")
    assert error <= 1e-9


def test_a_stretch_is_the_same_alone_and_among_others() -> None:
    run = moved("b", DURATION_S)
    path, tau = packed(run), run.tau[0]
    starts = np.array([0, 100, 300])
    at = starts[:, None] + np.arange(50)
    before = tau[np.maximum(starts - 1, 0)]
    whole, _ = replay(run.dynamics, 0.005, path[starts], lambda k, _: tau[at[:, k]], before, 50, 2)
    for i in range(len(starts)):
        one = slice(i, i + 1)
        alone, _ = replay(run.dynamics, 0.005, path[starts[one]], lambda k, _: tau[at[one, k]], before[one], 50, 2)  # noqa: B023
        np.testing.assert_allclose(alone[0], whole[i], rtol=1e-12, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("effects", [smooth, lagging])
def test_converges_with_order_4(effects: object) -> None:
    """Twice the steps, a sixteenth of the error. At 20 Hz, where steps of a period are long enough to tell."""
    assert callable(effects)
    arm, model, scenario = example()
    arm = arm.at_period(0.05)
    # a lag of half a period cuts it into halves whose steps double alike
    listed = tuple(replace(one, value=0.025) if "lag" in one.kind.key else one for one in effects(arm))
    slow = replace(scenario, controller=replace(scenario.controller, gain=0.2))
    run = trajectory_of(arm, replace(model, effects=listed), slow, noise=False, duration_s=14.0, rtol=1e-12, atol=1e-14)
    errors = [away(run, 20, factor) for factor in (2, 4, 8)]
    print(" ".join(f"{x:.2e}" for x in errors))
    assert errors[2] > 1e-11
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.3)


def test_steps_follow_the_fastest_mode() -> None:
    """Against the eigenvalues of the linearised equations of motion: steps a period grow as the square root of k."""
    arm, model, _ = example()
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (5, 2))
    counts = []
    for stiffness in (1e3, 1e5, 1e7):
        dynamics = PlanarDynamics.from_model(arm, with_drives(model, stiffness=stiffness, damping=0.0))
        fastest = 0.0
        for posture in q:
            zero = np.zeros(2)
            shifts = np.concatenate([1e-6 * np.eye(4), -1e-6 * np.eye(4)])
            _, link, motor = dynamics.accelerations(
                posture + shifts[:, :2], posture + shifts[:, 2:], np.zeros(8), np.zeros((8, 2)), np.zeros((8, 2)), zero
            )
            both = np.hstack([link, motor])
            slope = (both[:4] - both[4:]).T / 2e-6
            fastest = max(fastest, float(np.sqrt(np.abs(np.linalg.eigvals(slope)).max())))
        counts.append(substeps(dynamics, q, 0.1))
        # what a spring's rotor passes to the carrying body, 1/n of the torque, is left out of the count
        assert counts[-1] == pytest.approx(0.1 * fastest / STEP_OF_MODE, rel=0.02, abs=1.0)
    assert counts[0] < counts[1] < counts[2]
    assert counts[2] / counts[1] == pytest.approx(10.0, rel=0.1)


def test_steps_follow_what_damps() -> None:
    """A damper or friction that is faster than every spring; a rigid joint has no mode."""
    arm, model, _ = example()
    q = np.zeros((1, 2))

    def count(whole: Model, *effects: Effect) -> int:
        return substeps(PlanarDynamics.from_model(arm, replace(whole, effects=effects)), q, 0.005)

    assert count(model) == 1
    assert count(with_drives(model, damping=1e6)) > 10 * count(with_drives(model, damping=1e5)) / 2 > 10
    assert count(model, effect(arm, "motor_coulomb", 0, 20.0)) > 1
    assert count(model, effect(arm, "link_coulomb", 1, 1e4)) > 1
    assert count(with_drives(model, stiffness=np.inf)) == 1


@pytest.mark.slow(only=["100000000.0"])
@pytest.mark.parametrize("stiffness", [1e6, 1e8])
def test_stiff_joints_do_not_blow_up(stiffness: float) -> None:
    """With the steps that are chosen, a free motion keeps its energy or loses some of it."""
    arm, model, _ = example()
    dynamics = PlanarDynamics.from_model(arm, with_drives(model, stiffness=stiffness))
    start = np.array([[0.01, 0.3, -1.0, 0.3, -1.0, 0.1, -0.2, 0.1, -0.2]])
    steps = substeps(dynamics, start[:, 1:3], 0.005)
    states, _ = replay(dynamics, 0.005, start, lambda k, _: np.zeros((1, 2)), np.zeros((1, 2)), 40, steps)
    s = State.unpacked(states[0])
    energy = dynamics.kinetic_energy(s.q, s.base, s.qd, s.thetad) + dynamics.elastic_energy(s.q, s.theta)
    assert energy[-1] <= energy[0] * (1.0 + 1e-9)
    assert energy[-1] >= 0.99 * energy[0]


@pytest.mark.slow(only=["late2", "late0"])
@pytest.mark.parametrize("late", [(0, 0, 0), (300, 1200, 4000), (4900, 0, 100)])
def test_late_latches_are_read_as_the_simulator_reads_them(late: tuple[int, int, int]) -> None:
    """Microseconds of link encoders, motor encoders and gyro after SYNC, beside 50 of the joints."""
    arm, model, scenario = example("b")
    joints = tuple(
        replace(
            j,
            latch_us=50,
            link_encoder=replace(j.link_encoder, latch_us=late[0]),
            motor_encoder=replace(j.motor_encoder, latch_us=late[1]),
        )
        for j in arm.joints
    )
    arm = replace(arm, joints=joints, imu=replace(arm.imu, latch_us=late[2]))
    run = trajectory_of(arm, model, scenario, noise=False, duration_s=0.5, rtol=1e-10, atol=1e-12)
    q, theta, omega0 = exact_readings(run.dynamics, arm, packed(run)[None], run.tau)
    # of what a sensor reads; each is far below its noise (1.7e-6 rad, 1e-5 rad/s)
    for got, want, tolerance in (
        (q, run.q_latched[:, :-1], 1e-10),
        (theta, run.theta_latched[:, :-1], 1e-8),
        (omega0, run.omega0_latched[:, :-1], 1e-7),
    ):
        error = np.abs(got - want).max()
        print(f"{error:.1e}")
        assert error <= tolerance


def test_states_pack_and_unpack() -> None:
    packed_ = np.arange(2 * 3 * 9, dtype=np.float64).reshape(2, 3, 9)
    s = State.unpacked(packed_)
    assert s.base.shape == (2, 3)
    assert s.q.shape == s.theta.shape == s.qd.shape == s.thetad.shape == (2, 3, 2)
    np.testing.assert_array_equal(s.packed(), packed_)
    np.testing.assert_array_equal(s.thetad, packed_[..., -2:])

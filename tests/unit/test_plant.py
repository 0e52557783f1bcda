# SPDX-License-Identifier: MIT
"""The simulated arm: conservation laws, another integrator, the servo, the latches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_support import Floats, lively, random_arm
from scipy.integrate import solve_ivp

from zygos.arm import Arm
from zygos.dynamics.planar import PlanarDynamics
from zygos.errors import ZygosError
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Motion, Scenario, Sine


def energy_terms(trajectory: Trajectory) -> tuple[Floats, Floats]:
    """(B, n) change of kinetic and elastic energy plus dissipation, and (B, n) work of the motors, J."""
    run, law = trajectory, trajectory.dynamics
    stored = law.kinetic_energy(run.q, run.omega0, run.qd, run.thetad) + law.elastic_energy(run.q, run.theta)
    spent = (law.damping * run.slip2).sum(axis=-1)
    steps = (law.gear_ratio * run.tau[:, :-1] * np.diff(run.theta, axis=1)).sum(axis=-1)
    work = np.concatenate([np.zeros((len(run.seeds), 1)), np.cumsum(steps, axis=1)], axis=1)
    return stored - stored[:, :1] + spent, work


@pytest.mark.slow
@pytest.mark.parametrize(
    ("duration", "period", "seeds"), [(20.05, None, range(2)), (120.0, None, [0]), (7.0, 0.01, [0])]
)
def test_energy_and_momentum_close(duration: float, period: float | None, seeds: list[int]) -> None:
    """Work = change of energy + dissipation, and h = 1 Nms of itself, although its terms reach 1e5 Nms."""
    arm, model, scenario = lively()
    run = simulate(arm, model, scenario, seeds=seeds, duration_s=duration, period_s=period)
    assert run.t[-1] == pytest.approx(duration - run.arm.period_s)
    gained, work = energy_terms(run)
    assert work.max() > 1e3
    assert np.abs(gained - work).max() < 1e-8 * np.abs(work).max()
    h = run.dynamics.momentum(run.q, run.omega0, run.qd, run.thetad)
    assert np.abs(h - 1.0).max() < (1e-8 if duration < 100.0 else 1e-7)


@pytest.mark.slow
def test_energy_and_momentum_close_for_seven_joints() -> None:
    arm, model = random_arm(np.random.default_rng(3), 7, "planar")
    scenario = replace(
        lively()[2],
        manoeuvre={joint.name: Motion(sines=(Sine(0.2, 0.5 + 0.2 * i),)) for i, joint in enumerate(arm.joints)},
        initial_angles_rad=(),
        angular_momentum_nms=3.0,
    )
    scenario = replace(scenario, controller=replace(scenario.controller, kp=20.0, kd=5.0))
    run = simulate(arm, model, scenario, duration_s=5.0)
    gained, work = energy_terms(run)
    assert np.abs(work).max() > 0.1
    assert np.abs(gained - work).max() < 1e-8 * np.abs(work).max()
    h = run.dynamics.momentum(run.q, run.omega0, run.qd, run.thetad)
    np.testing.assert_allclose(h, 3.0, rtol=1e-8)


def test_another_integrator_gives_the_same_motion() -> None:
    """LSODA over 3 s, period by period, with the attitude and the slip integral; and the run with latches below."""
    arm, model, scenario = lively()
    run = simulate(arm, model, scenario, duration_s=3.0)
    end = 40
    state = np.concatenate(
        [[0.0, run.omega0[0, 0]], run.q[0, 0], run.qd[0, 0], run.theta[0, 0], run.thetad[0, 0], [0.0, 0.0]]
    )
    for k in range(end):
        state = advance(run.dynamics, state, run.tau[0, k], arm.period_s)
    expected = np.concatenate(
        [
            [run.attitude[0, end], run.omega0[0, end]],
            run.q[0, end],
            run.qd[0, end],
            run.theta[0, end],
            run.thetad[0, end],
            run.slip2[0, end],
        ]
    )
    np.testing.assert_allclose(state, expected, rtol=0, atol=1e-9)


def advance(dynamics: PlanarDynamics, state: Floats, tau: Floats, span: float) -> Floats:
    """phi0, omega0, q, qd, theta, thetad, slip2 of a two-joint arm, `span` s later."""

    def rates(_: float, y: Floats) -> Floats:
        base, link, motor = dynamics.accelerations(y[2:4], y[6:8], y[1], y[4:6], y[8:10], tau)
        return np.concatenate([[y[1], base], y[4:6], link, y[8:10], motor, (y[8:10] - y[4:6]) ** 2])

    return np.asarray(solve_ivp(rates, (0.0, span), state, method="LSODA", rtol=1e-12, atol=1e-13).y[:, -1])


def test_the_servo_holds_what_its_law_says() -> None:
    """From the recorded encoder alone: the noise that is fed back is the noise that is recorded."""
    arm, model, scenario = lively()
    run = simulate(arm, model, scenario, seeds=[5, 6], duration_s=3.0)
    angle, rate = scenario.desired([joint.name for joint in arm.joints], run.t)
    np.testing.assert_array_equal(run.desired, angle)
    for index in range(2):
        cycles = run.cycles(index)
        measured = np.diff(cycles.theta, axis=0, prepend=cycles.theta[:1]) / arm.period_s
        u = 1000.0 * (angle - cycles.theta) + 250.0 * (rate - measured)
        np.testing.assert_allclose(50.0 * cycles.tau, u, rtol=0, atol=1e-9 * np.abs(u).max())
    assert np.abs(run.tau[0] - run.tau[1]).max() > 1e-3


def test_link_angle_feedback_reads_the_link_encoder() -> None:
    arm, model, scenario = lively()
    scenario = replace(scenario, controller=replace(scenario.controller, angle="link", gain=0.1))
    run = simulate(arm, model, scenario, duration_s=1.0)
    angle, rate = scenario.desired([joint.name for joint in arm.joints], run.t)
    cycles = run.cycles()
    measured = np.diff(cycles.q, axis=0, prepend=cycles.q[:1]) / arm.period_s
    u = 0.1 * (1000.0 * (angle - cycles.q) + 250.0 * (rate - measured))
    np.testing.assert_allclose(50.0 * cycles.tau, u, rtol=0, atol=1e-9 * np.abs(u).max())


def test_signs_and_zeros_do_not_change_the_motion() -> None:
    arm, model, scenario = lively()

    def turned(arm: Arm) -> Arm:
        joints = [
            replace(
                joint,
                motor_encoder=replace(joint.motor_encoder, sign=-1, zero_rad=0.7),
                link_encoder=replace(joint.link_encoder, sign=-1, zero_rad=-0.2),
            )
            for joint in arm.joints
        ]
        return replace(arm, joints=tuple(joints), imu=replace(arm.imu, mount_xyzw=(1.0, 0.0, 0.0, 0.0)))

    plain = simulate(arm, model, scenario, duration_s=2.0, noise=False)
    other = simulate(turned(arm), model, scenario, duration_s=2.0, noise=False)
    np.testing.assert_allclose(other.q, plain.q, atol=1e-10)
    np.testing.assert_allclose(other.cycles().theta, 0.7 - plain.theta[0], atol=1e-10)
    np.testing.assert_allclose(other.cycles().q, -0.2 - plain.q[0], atol=1e-10)
    np.testing.assert_allclose(other.cycles().omega, -plain.cycles().omega, atol=1e-10)


def test_without_noise_the_sensors_are_exact() -> None:
    arm, model, scenario = lively()
    for run in (
        simulate(arm, model, scenario, duration_s=1.0, noise=False),
        simulate(arm, model, replace(scenario, noise=False, encoder_noise="quantised"), duration_s=1.0),
    ):
        cycles = run.cycles()
        np.testing.assert_array_equal(cycles.q, run.q[0])
        np.testing.assert_array_equal(cycles.theta, run.theta[0])
        np.testing.assert_array_equal(cycles.tau, run.tau[0])
        np.testing.assert_array_equal(cycles.omega[:, 2], run.omega0[0])
        np.testing.assert_array_equal(cycles.omega[:, :2], 0.0)
        np.testing.assert_array_equal(cycles.sync, np.arange(20, dtype=np.uint64))
        assert cycles.q.dtype == np.float64
        assert cycles.flags.dtype == np.uint32
        assert not cycles.flags.any()


@pytest.mark.slow
def test_late_latches_read_later_angles() -> None:
    """Every sensor with a delay of its own, against an independent integration from the SYNC state."""
    arm, model, scenario = lively()
    shoulder, elbow = arm.joints
    late = replace(
        arm,
        joints=(
            replace(shoulder, latch_us=3000, motor_encoder=replace(shoulder.motor_encoder, latch_us=2000)),
            replace(elbow, link_encoder=replace(elbow.link_encoder, latch_us=8000)),
        ),
        imu=replace(arm.imu, latch_us=10_000),
    )
    run = simulate(late, model, scenario, duration_s=2.0, noise=False)
    plain = simulate(arm, model, scenario, duration_s=2.0, noise=False)
    np.testing.assert_allclose(run.q, plain.q, atol=1e-9)
    for k in (0, 17, 39):
        state = np.concatenate(
            [[0.0, run.omega0[0, k]], run.q[0, k], run.qd[0, k], run.theta[0, k], run.thetad[0, k], [0.0, 0.0]]
        )
        at = {us: advance(run.dynamics, state, run.tau[0, k], us * 1e-6) for us in (3000, 5000, 8000, 10_000)}
        cycles = run.cycles()
        np.testing.assert_allclose(cycles.q[k], [at[3000][2], at[8000][3]], atol=1e-10)
        np.testing.assert_allclose(cycles.theta[k], [at[5000][6], run.theta[0, k, 1]], atol=1e-10)
        np.testing.assert_allclose(cycles.omega[k, 2], at[10_000][1], atol=1e-10)
    assert np.abs(run.q_latched - run.q).max() > 1e-3


@pytest.mark.slow
def test_accelerations_are_the_slopes_after_sync() -> None:
    arm, model, scenario = lively()
    run = simulate(arm, model, scenario, duration_s=0.4, period_s=0.001, noise=False)
    base, link, motor = run.accelerations()
    # over one period the torque is constant: a one-sided difference is off by half a period of jerk
    np.testing.assert_allclose(np.diff(run.omega0, axis=1) / 0.001, base[:, :-1], atol=2e-3)
    np.testing.assert_allclose(np.diff(run.qd, axis=1) / 0.001, link[:, :-1], atol=2e-2)
    np.testing.assert_allclose(np.diff(run.thetad, axis=1) / 0.001, motor[:, :-1], atol=5e-2)


@pytest.mark.slow
def test_a_batch_is_its_seeds_and_repeats() -> None:
    arm, model, scenario = lively()
    batch = simulate(arm, model, scenario, seeds=range(4), duration_s=3.0)
    again = simulate(arm, model, scenario, seeds=range(4), duration_s=3.0)
    alone = simulate(arm, model, scenario, seeds=[2], duration_s=3.0)
    np.testing.assert_array_equal(batch.q, again.q)
    np.testing.assert_array_equal(batch.noise.motor[2], alone.noise.motor[0])
    np.testing.assert_allclose(batch.q[2], alone.q[0], rtol=0, atol=1e-9)
    default = simulate(arm, model, replace(scenario, seed=2), duration_s=3.0)
    np.testing.assert_array_equal(default.q, alone.q)


def test_start() -> None:
    arm, model, scenario = lively()
    run = simulate(arm, model, replace(scenario, initial_angles_rad=(0.3, -0.4)), duration_s=0.1)
    np.testing.assert_array_equal(run.q[0, 0], [0.3, -0.4])
    np.testing.assert_array_equal(run.theta[0, 0], [0.3, -0.4])
    np.testing.assert_array_equal(run.slip2[0, 0], 0.0)
    assert run.attitude[0, 0] == 0.0
    assert run.dynamics.momentum(run.q, run.omega0, run.qd, run.thetad)[0, 0] == pytest.approx(1.0, rel=1e-12)


def test_misuse_is_refused() -> None:
    unfit = "cannot be simulated"
    for change, message in (({"duration_s": 0.05}, unfit), ({"seeds": []}, unfit), ({"period_s": -1.0}, "period")):
        with pytest.raises(ZygosError, match=f"{message}.*remedy"):
            simulate(*lively(), **change)  # type: ignore[arg-type]


def test_a_model_too_stiff_to_integrate_is_refused() -> None:
    arm, model, scenario = lively()
    stiff = replace(
        model, joints=tuple(replace(joint, damping=replace(joint.damping, value=1e9)) for joint in model.joints)
    )
    with pytest.raises(ZygosError, match=r"400 integration steps.*remedy: check the units"):
        simulate(arm, stiff, scenario)


def test_unfit_scenarios_are_refused() -> None:
    arm, model, scenario = lively()
    unfit: list[tuple[Scenario, str]] = [
        (replace(scenario, manoeuvre={"shoulder": Motion()}), "manoeuvre has joints"),
        (replace(scenario, initial_angles_rad=(0.0,)), "1 initial angles for 2 joints"),
        (replace(scenario, controller=replace(scenario.controller, angle="link", gain=1e4)), "diverges"),
    ]
    for wrong, message in unfit:
        with pytest.raises(ZygosError, match=f"{message}.*remedy"):
            simulate(arm, model, wrong)

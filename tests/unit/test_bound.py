# SPDX-License-Identifier: MIT
"""Derivatives of the motion against differences of the simulator's equations, and the bound against dense least squares
over all that is unknown, which share no code with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arm_support import random_arm
from numpy.typing import NDArray
from plant_support import example
from runs_support import trajectory_of

from zygos.arm import TORQUE_STEP, Arm
from zygos.balances.state import State
from zygos.dynamics.equations import from_parameters
from zygos.dynamics.joints import Drives
from zygos.effects import effect
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Model
from zygos.refinement import bound as module
from zygos.refinement.bound import ATOL, RTOL, bound
from zygos.refinement.motion import FlexibleMotion
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]


def accelerations(dynamics: Drives, motion: FlexibleMotion, x: Floats, tau: Floats) -> Floats:
    s = State.unpacked(x)
    base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau)
    base = base if base.ndim == 2 else base[:, None]
    return np.concatenate([base[:, : motion.base_rates], link, motor], axis=1)


@pytest.mark.slow(only=["free-spatial", "fixed*"])
@pytest.mark.parametrize("kinetic", ["planar-symmetric", "planar", "spatial"])
@pytest.mark.parametrize("base", ["free", "fixed"])
def test_derivatives_are_differences_of_the_simulators_equations(base: str, kinetic: str) -> None:
    for seed, joints in ((0, 1), (2, 3)):
        arm, model = random_arm(seed, joints, base, kinetic, True)
        values = np.array(model.base_values(arm))
        motion, dynamics = FlexibleMotion(arm, values), from_parameters(arm, values)
        rng = np.random.default_rng(seed)
        x, tau = rng.normal(size=(4, motion.states)), rng.normal(size=(4, joints))
        links = slice(motion.base_rates, motion.base_rates + joints)
        bent = 1e-3 * rng.normal(size=(4, joints))  # springs bend little
        x[:, links.stop : links.stop + joints] = x[:, links] + bent
        found = motion.slopes(x, tau)
        exact = accelerations(dynamics, motion, x, tau)
        size = np.abs(exact).max()
        np.testing.assert_allclose(found.acceleration, exact, rtol=0, atol=1e-11 * size)

        def at(x: Floats, tau: Floats, p: Floats, arm: Arm = arm, motion: FlexibleMotion = motion) -> Floats:
            return accelerations(from_parameters(arm, p), motion, x, tau)

        step = 1e-5
        for found_slope, differences in (
            (
                found.of_state,
                [at(x + step * e, tau, values) - at(x - step * e, tau, values) for e in np.eye(motion.states)],
            ),
            (found.of_torque, [at(x, tau + step * e, values) - at(x, tau - step * e, values) for e in np.eye(joints)]),
        ):
            expected = np.stack(differences, axis=-1) / (2.0 * step)
            largest = np.abs(expected).max(axis=(0, 1))
            assert np.all(np.abs(found_slope - expected).max(axis=(0, 1)) < 1e-7 * largest + 1e-9 * size)
        for k, e in enumerate(np.eye(len(values))):
            step = 1e-5 * motion.size[k]
            expected = (at(x, tau, values + step * e) - at(x, tau, values - step * e)) / (2.0 * step)
            error = np.abs(found.of_parameters[..., k] - expected).max()
            assert error < 1e-6 * max(np.abs(expected).max(), size / motion.size[k]), arm.parameter_names[k]


@pytest.mark.slow
def test_derivatives_of_a_period_are_differences_of_its_end() -> None:
    arm, model = random_arm(5, 2, "free", "planar", True)
    values = np.array(model.base_values(arm))
    motion = FlexibleMotion(arm, values)
    rng = np.random.default_rng(0)
    x, tau, h = 0.3 * rng.normal(size=(1, motion.states)), rng.normal(size=(1, 2)), 2e-3
    (slope,) = motion.step(x, tau, h, 2)[1]
    single = np.eye(motion.states + 2)
    starts, torques = np.split(1e-5 * np.vstack([single, -single]), [motion.states], axis=1)
    ahead, behind = np.split(motion.step(x + starts, tau + torques, h, 2)[0], 2)
    expected = np.insert((ahead - behind).T / 2e-5, [motion.states] * len(values), 0.0, axis=1)
    for k, step in enumerate(1e-5 * motion.size):
        change = step * np.eye(len(values))[k]
        ahead, behind = (FlexibleMotion(arm, values + sign * change).step(x, tau, h, 2)[0] for sign in (1.0, -1.0))
        expected[:, motion.states + k] = (ahead - behind)[0] / (2.0 * step)
    assert np.all(np.abs(slope - expected).max(axis=0) < 1e-6 * np.maximum(np.abs(expected).max(axis=0), 1e-3))


@cache
def sensitivities() -> tuple[Floats, Floats, list[Floats]]:
    """Of a motion of the example at its SYNCs: the torques (n, N), the parameters (p,) and how all readings (n * m)
    change with the state at the start, with each torque of each period, and with each parameter's share of itself.
    They are differences of exact integrations. The readings of a SYNC are base rate, q and theta.
    """
    arm, model, scenario = moving(2.0)
    run = trajectory_of(arm, model, scenario, rtol=RTOL, atol=ATOL)
    values, tau = np.array(model.base_values(arm)), run.tau[0]
    n, joints = tau.shape

    def flow(start: Floats, parameters: Floats, torque: Floats) -> Floats:
        """(B, n, x) states at all SYNCs of B motions from starts (B, x), parameters (p,) and torques (B, n, N)."""
        dynamics, x, listed = from_parameters(arm, parameters), start, [start]

        def rate(x: Floats, t: Floats) -> Floats:
            s = State.unpacked(x)
            base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, t)
            return State(s.qd, s.thetad, link, motor, base).packed()

        for k in range(n - 1):
            for _ in range(2):
                h, t = arm.period_s / 2, torque[:, k]
                a = rate(x, t)
                b = rate(x + 0.5 * h * a, t)
                c = rate(x + 0.5 * h * b, t)
                x = x + h / 6.0 * (a + 2.0 * (b + c) + rate(x + h * c, t))
            listed.append(x)
        return np.stack(listed, axis=1)[:, :, : 1 + 2 * joints]

    start = State(run.q[0], run.theta[0], run.qd[0], run.thetad[0], run.omega0[0]).packed()[:1]

    def slope(change: Floats, torque: Floats) -> Floats:
        """(n * m, B) slopes of all readings by changes of the start (B, x) and of the torques (B, n, N)."""
        ends = [flow(start + sign * change, values, tau + sign * torque) for sign in (1.0, -1.0)]
        return np.asarray(((ends[0] - ends[1]) / 2.0).reshape(len(change), -1).T)

    h, kick, size = 1e-5, 1e-2, start.shape[1]
    of_start = slope(h * np.eye(size), np.zeros((size, n, joints))) / h
    kicks = np.eye(n * joints).reshape(-1, n, joints)
    of_torques = slope(np.zeros((len(kicks), size)), kick * kicks) / kick
    of_parameters = []
    for step in 1e-5 * np.diag(values):
        ends = [flow(start, values + sign * step, tau[None])[0].ravel() for sign in (1.0, -1.0)]
        of_parameters.append((ends[0] - ends[1]) / 2e-5)
    return tau, values, [of_start, of_torques, np.stack(of_parameters, axis=1)]


def moving(seconds: float) -> tuple[Arm, Model, Scenario]:
    """The lively example without noise: its motion is that of any sensors."""
    arm, model, scenario = example("lively")
    return arm, model, replace(scenario, duration_s=seconds, noise=False)


def dense(arm: Arm, relative: float) -> Floats:
    """(p,) sigmas of least squares for the state at the start, the bias and its steps, the errors of all torques, and
    the parameters, from all readings at once."""
    tau, values, (of_start, of_torques, of_parameters) = sensitivities()
    wire = arm.over_the_wire
    (n, joints), p, size = tau.shape, len(values), of_start.shape[1]
    m = 1 + 2 * joints
    sigma = np.sqrt(TORQUE_STEP**2 / 12.0 + (relative * tau) ** 2)
    bias = np.zeros((n, m, n))
    bias[:, 0] = np.tri(n)
    bias[:, 0, 1:] *= arm.imu.bias_walk * np.sqrt(arm.period_s)
    known = [j.link_encoder for j in wire.joints] + [j.motor_encoder for j in wire.joints]
    zeros = [max(one.zero_sigma_rad, one.quantum_rad) for one in known]  # mounted to a step at best
    offsets = np.tile(np.eye(m)[:, 1:] * zeros, (n, 1))
    columns = np.hstack([of_start, offsets, of_torques * sigma.ravel(), bias.reshape(-1, n), of_parameters])
    size += 2 * joints
    columns /= np.tile([wire.imu.rate_sigma, *(one.sigma_rad for one in known)], n)[:, None]
    prior = np.zeros((n * joints + n - 1, columns.shape[1]))
    prior[: n * joints, size : size + n * joints] = np.eye(n * joints)
    prior[n * joints :, size + n * joints + 1 : size + n * joints + n] = np.eye(n - 1)
    mounted = np.eye(2 * joints, columns.shape[1], size - 2 * joints)
    whole = np.concatenate([columns, prior, mounted])
    scale = np.linalg.norm(whole, axis=0)
    triangle = np.linalg.qr(whole / scale, mode="r")[-p:, -p:]
    return np.asarray(np.linalg.norm(np.linalg.inv(triangle), axis=1) / scale[-p:] * np.abs(values))


@pytest.mark.slow(only=["0.0-0.0", "0.02*"])
@pytest.mark.parametrize(("relative", "zero"), [(0.0, 0.0), (0.02, 0.0), (0.0, 1e-3)])
def test_the_bound_is_that_of_least_squares_over_everything_unknown(relative: float, zero: float) -> None:
    arm, model, scenario = moving(2.0)
    joints = tuple(
        replace(
            joint,
            torque_relative_sigma=relative,
            link_encoder=replace(joint.link_encoder, quantum_rad=1e-4, zero_sigma_rad=zero),
            motor_encoder=replace(joint.motor_encoder, quantum_rad=2e-4, zero_sigma_rad=zero),
        )
        for joint in arm.joints
    )
    arm = replace(arm, joints=joints, imu=replace(arm.imu, bias_walk=1e-6))
    (found,) = bound(arm, model, scenario)
    np.testing.assert_allclose(found.sigma, dense(arm, relative), rtol=2e-3)


@pytest.mark.slow
def test_the_bound_of_a_known_motion(clean: Callable[[], Trajectory], monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of a prototype in another language, which differentiated other equations automatically."""
    monkeypatch.setattr(module, "simulate", lambda *_, **__: clean())
    means = [one.mean_percent for one in bound(*example("lively"), [0.0, 0.001, 0.01])]
    assert means[0] == pytest.approx(0.00005, rel=0.1)  # printed with one digit
    np.testing.assert_allclose(means[1:], [0.0035, 0.028], rtol=0.03)


@pytest.mark.slow
def test_a_late_latch_is_heeded() -> None:
    arm, model, scenario = moving(2.0)
    (plain,) = bound(arm, model, scenario)
    late = tuple(replace(joint, latch_us=20_000) for joint in arm.joints)
    (moved,) = bound(replace(arm, joints=late), model, scenario)
    np.testing.assert_allclose(moved.sigma, plain.sigma, rtol=0.3)
    assert not np.allclose(moved.sigma, plain.sigma, rtol=1e-4)


def test_what_has_no_bound_is_refused() -> None:
    arm, model, scenario = example("lively")
    scenario = replace(scenario, duration_s=2.0)
    rubbing = replace(model, effects=(effect("motor_coulomb", "elbow", 1.0),))
    with pytest.raises(ZygosError, match=r"effects \(motor_coulomb\); remedy"):
        bound(arm, rubbing, scenario)
    with pytest.raises(ZygosError, match=r"held from SYNC to SYNC; remedy"):
        bound(replace(arm, torque_law="sampled"), model, scenario)
    rigid, solid = random_arm(1, 2, "free", "planar", False)
    with pytest.raises(ZygosError, match=r"is rigid.*remedy"):
        bound(rigid, solid, scenario)
    still = {name: replace(one, offset=0.0, sines=()) for name, one in scenario.manoeuvre.items()}
    resting = replace(scenario, manoeuvre=still, initial_angles_rad=(0.0, 0.0), angular_momentum_nms=0.0, noise=False)
    with pytest.raises(Undecided, match=r"does not determine .*remedy"):
        bound(arm, model, resting)

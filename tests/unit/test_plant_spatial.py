# SPDX-License-Identifier: MIT
"""The simulator in space and on the ground: momentum, energy, engines by others, and the paper's reduced equations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_support import run
from plant_support import LIVELY, example, lively
from scipy.spatial.transform import Rotation

from zygos.arm import NO_IMU, Arm
from zygos.dynamics.equations import EngineName
from zygos.dynamics.planar import PlanarDynamics
from zygos.dynamics.serial import SpatialDynamics
from zygos.errors import ZygosError
from zygos.model.model import JointModel, Model, Quantity
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario

SPATIAL = LIVELY.parent / "spatial"


def rigid(arm: Arm, model: Model, which: tuple[int, ...]) -> tuple[Arm, Model]:
    def stiff(drive: JointModel) -> JointModel:
        return replace(drive, stiffness=Quantity(np.inf), damping=Quantity(0.0))

    joints = tuple(replace(joint, flexible=i not in which) for i, joint in enumerate(arm.joints))
    drives = tuple(stiff(drive) if i in which else drive for i, drive in enumerate(model.joints))
    return replace(arm, joints=joints), replace(model, joints=drives)


def grounded(arm: Arm) -> Arm:
    return replace(arm, base="fixed", imu=NO_IMU, gravity=(0.0, 1.0, -9.7))


def moved(
    arm: Arm, model: Model, scenario: Scenario, engine: EngineName = "zygos", duration_s: float = 0.1
) -> Trajectory:
    return simulate(arm.at_period(0.01), model, scenario, engine=engine, noise=False, duration_s=duration_s)


CASES = {
    "free": lambda arm, model: (arm, model),
    "free, two rigid": lambda arm, model: rigid(arm, model, (0, 2)),
    "fixed": lambda arm, model: (grounded(arm), model),
    "fixed, first rigid": lambda arm, model: rigid(grounded(arm), model, (0,)),
}


@pytest.mark.parametrize("case", CASES)
def test_energy_and_momentum_are_accounted_for(case: str) -> None:
    arm, model, scenario = example("spatial")
    arm, model = CASES[case](arm, model)
    run = moved(arm, model, scenario, duration_s=0.5)
    law = run.dynamics
    assert isinstance(law, SpatialDynamics)
    q, theta, omega0, qd, thetad = run.q[0], run.theta[0], run.omega0[0], run.qd[0], run.thetad[0]
    stored = law.kinetic_energy(q, omega0, qd, thetad) + law.elastic_energy(q, theta) + law.gravity_energy(q)
    work = np.sum(arm.gear_ratios * run.tau[0, :-1] * np.diff(theta, axis=0), axis=1)
    lost = run.slip2[0] @ np.where(law.rigid, 0.0, law.damping)
    balance = stored - stored[0] + lost - lost[0]
    np.testing.assert_allclose(balance[1:], np.cumsum(work), atol=1e-9 * np.abs(stored).max())
    np.testing.assert_allclose(theta[:, law.rigid], q[:, law.rigid], atol=1e-12)
    if arm.free:
        turned = Rotation.from_quat(run.attitude[0])
        h = turned.apply(law.momentum(q, omega0, qd, thetad))
        np.testing.assert_allclose(h, np.broadcast_to(scenario.angular_momentum_nms, h.shape), atol=1e-8)
        assert np.abs(omega0).max() > 0.01
    else:
        assert not omega0.any()
        assert run.attitude.shape[-1] == 0


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("engine", ["pinocchio", "mujoco"])
def test_engines_by_others_move_alike(engine: EngineName, case: str) -> None:
    arm, model, scenario = example("spatial")
    arm, model = CASES[case](arm, model)
    ours, theirs = moved(arm, model, scenario), moved(arm, model, scenario, engine)
    for name in ("q", "theta", "omega0", "qd", "tau", "attitude"):
        np.testing.assert_allclose(getattr(theirs, name), getattr(ours, name), atol=1e-8, err_msg=name)
    np.testing.assert_allclose(theirs.cycles().omega, ours.cycles().omega, atol=1e-8)


def test_a_planar_arm_moves_alike_in_space() -> None:
    """The planar equations against Pinocchio's, whose base is free to leave the plane."""
    arm, model, scenario = lively()
    ours = simulate(arm, model, scenario, noise=False, duration_s=2.0)
    theirs = simulate(arm, model, scenario, engine="pinocchio", noise=False, duration_s=2.0)
    assert isinstance(ours.dynamics, PlanarDynamics)
    np.testing.assert_allclose(theirs.q, ours.q, atol=1e-8)
    np.testing.assert_allclose(theirs.omega0, ours.omega0[..., None] * arm.axis, atol=1e-8)
    np.testing.assert_allclose(theirs.cycles().omega, ours.cycles().omega, atol=1e-8)


def test_late_latches_in_space() -> None:
    arm, model, scenario = example("spatial")
    late = replace(arm, imu=replace(arm.imu, latch_us=1500))
    exact, read = moved(arm, model, scenario), moved(late, model, scenario)
    np.testing.assert_allclose(read.omega0, exact.omega0, atol=1e-9)
    base = exact.accelerations()[0]
    np.testing.assert_allclose(
        read.cycles().omega, exact.omega0[0] + 0.0015 * base[0], atol=0.05 * 0.0015 * np.abs(base).max() + 1e-6
    )


def test_reduced_equations_hold_on_a_spatial_arm() -> None:
    """Nanos & Papadopoulos eqs. (14)-(18): with the base eliminated and R_0' h held fixed in the derivatives.

    Lagrange's equations of T(q, qd, thetad; h) with the base rate that belongs to h, differentiated numerically, and h
    turning with the base: h' = -omega_0 x h in base axes.
    """
    arm, model, _ = example("spatial")
    law = SpatialDynamics.from_model(arm, model)
    rng = np.random.default_rng(3)
    n = arm.n
    q, qd = rng.uniform(-1.0, 1.0, n), rng.normal(size=n)
    theta, thetad = q + rng.normal(scale=0.03, size=n), qd + rng.normal(scale=0.2, size=n)
    tau, h = rng.normal(size=n), rng.normal(size=3) * 5.0
    omega0 = law.base_rate(q, h, qd, thetad)
    _, qdd, thetadd = law.accelerations(q, theta, omega0, qd, thetad, tau)

    def routhian(x: np.ndarray, rate: np.ndarray, momentum: np.ndarray) -> float:
        """T - h . omega_0 of x = (q, theta), with the base rate that the momentum asks for."""
        base = law.base_rate(x[:n], momentum, rate[:n], rate[n:])
        return float(law.kinetic_energy(x[:n], base, rate[:n], rate[n:]) - momentum @ base)

    x, rate, acceleration = (np.concatenate(pair) for pair in ((q, theta), (qd, thetad), (qdd, thetadd)))
    turning = -np.cross(omega0, h)

    def impulse(t: float) -> np.ndarray:
        """Derivative with respect to the rates along the motion: a central difference, exact for a quadratic."""
        at, moving, momentum = x + t * rate + 0.5 * t * t * acceleration, rate + t * acceleration, h + t * turning
        return np.array(
            [(routhian(at, moving + e, momentum) - routhian(at, moving - e, momentum)) / 2.0 for e in np.eye(2 * n)]
        )

    def slope(f: object, step: float) -> np.ndarray:
        assert callable(f)
        return np.asarray((8.0 * (f(step) - f(-step)) - (f(2 * step) - f(-2 * step))) / (12.0 * step))

    change = slope(impulse, 1e-3)
    force = np.array([slope(lambda t, e=e: np.array(routhian(x + t * e, rate, h)), 1e-3) for e in np.eye(2 * n)])
    spring = law.spring(q, theta, qd, thetad)
    applied = np.concatenate([spring, arm.gear_ratios * tau - spring])
    np.testing.assert_allclose(change - force, applied, atol=1e-9 * np.abs(change).max())


def test_what_is_refused() -> None:
    arm, model, scenario = example("spatial")
    with pytest.raises(ZygosError, match=r"2 kp for 3 joints; remedy: give one number, or one for each joint"):
        moved(arm, model, replace(scenario, controller=replace(scenario.controller, kp=(1.0, 2.0))))
    planar = lively()
    with pytest.raises(ZygosError, match=r"angular_momentum_nms is a vector, but arm lively moves in a plane"):
        simulate(*planar[:2], replace(planar[2], angular_momentum_nms=(0.0, 0.0, 1.0)), duration_s=1.0)
    parameters = Model("learned", parameters=model.base_parameters(arm))
    with pytest.raises(ZygosError, match=r"engine pinocchio needs bodies"):
        moved(arm, parameters, scenario, "pinocchio")


def test_engines_and_arms_that_commands_refuse(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run.blf"
    assert run("simulate", SPATIAL / "scenario.toml", "--engine", "ode", "-o", out) == 2
    assert "there is no engine 'ode'; remedy: use one of zygos, pinocchio, mujoco" in capsys.readouterr().err
    assert not out.exists()
    assert run("paper", "--seeds", 2, "--example", SPATIAL) == 2
    assert "the paper's methods need a free-floating arm that moves in a plane" in capsys.readouterr().err

# SPDX-License-Identifier: MIT
"""The planar equations of motion against Pinocchio, and against the paper's equations written out."""

from __future__ import annotations

import numpy as np
import pytest
from dynamics_support import Oracle, random_state
from plant_support import lively, random_arm

from zygos.dynamics.planar import PlanarDynamics
from zygos.errors import ZygosError


@pytest.mark.parametrize(("kinetic", "joints"), [
    ("lively", 2), ("planar", 1), ("planar", 2), ("planar", 3), ("planar", 7), ("planar-symmetric", 2),
    ("planar-symmetric", 7),
])  # fmt: skip
def test_energy_momentum_and_accelerations_equal_pinocchio(kinetic: str, joints: int) -> None:
    pin = pytest.importorskip("pinocchio", reason="needs the test extra: pip install zygos[test]")
    rng = np.random.default_rng(joints)
    arm, model = lively()[:2] if kinetic == "lively" else random_arm(rng, joints, kinetic)  # type: ignore[arg-type]
    dynamics = PlanarDynamics.from_parameters(arm, model.base_values(arm))
    oracle = Oracle(pin, arm, model)
    for _ in range(20):
        q, theta, omega0, qd, thetad, tau = random_state(rng, joints)
        position, velocity = oracle.place(q, theta, omega0, qd, thetad)

        energy = pin.computeKineticEnergy(oracle.model, oracle.data, position, velocity)
        assert dynamics.kinetic_energy(q, omega0, qd, thetad) == pytest.approx(energy, rel=1e-10)

        angular = pin.computeCentroidalMomentum(oracle.model, oracle.data, position, velocity).angular
        attitude = pin.Quaternion(position[3:7]).toRotationMatrix()
        h = dynamics.momentum(q, omega0, qd, thetad)
        assert abs(h) > 1e-3
        np.testing.assert_allclose(attitude.T @ angular, h * arm.axis, rtol=0, atol=1e-10 * np.abs(angular).max())

        force = dynamics.stiffness * (theta - q) + dynamics.damping * (thetad - qd)
        effort = np.zeros(oracle.model.nv)
        for i in range(joints):
            effort[oracle.links[i]] = force[i]
            effort[oracle.rotors[i]] = tau[i] - force[i] / arm.gear_ratios[i]
        accelerations = pin.aba(oracle.model, oracle.data, position, velocity, effort)
        got = dynamics.accelerations(q, theta, omega0, qd, thetad, tau)
        scale = np.abs(accelerations).max()
        np.testing.assert_allclose(got[0] * arm.axis, accelerations[3:6], rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(got[1], accelerations[oracle.links], rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(arm.gear_ratios * got[2], accelerations[oracle.rotors], rtol=0, atol=1e-10 * scale)


def test_accelerations_solve_the_papers_equations() -> None:
    """docs/paper.md, "The three methods": five equations of the two-joint arm in absolute angles."""
    arm, model, _ = lively()
    value = {name: quantity.value for name, quantity in model.base_parameters(arm).items()}
    dynamics = PlanarDynamics.from_parameters(arm, model.base_values(arm))
    rng = np.random.default_rng(0)
    for _ in range(20):
        q, theta, omega0, qd, thetad, tau = random_state(rng, 2)
        base, link, motor = dynamics.accelerations(q, theta, omega0, qd, thetad, tau)
        n = 50.0
        f0, f1, f2 = omega0, omega0 + qd[0], omega0 + qd[0] + qd[1]
        df0, df1, df2 = base, base + link[0], base + link[0] + link[1]
        c1, s1, c12, s12 = np.cos(q[0]), np.sin(q[0]), np.cos(q[0] + q[1]), np.sin(q[0] + q[1])
        c2, s2 = np.cos(q[1]), np.sin(q[1])
        e1 = value["k1"] * (theta[0] - q[0]) + value["b1"] * (thetad[0] - qd[0])
        e2 = value["k2"] * (theta[1] - q[1]) + value["b2"] * (thetad[1] - qd[1])
        rows = [
            value["a00"] * df0
            + value["a01"] * (c1 * df1 - s1 * f1**2)
            + value["a02"] * (c12 * df2 - s12 * f2**2)
            + n * value["Im1"] * motor[0]
            + e1,
            value["a01"] * (c1 * df0 + s1 * f0**2)
            + value["a11"] * df1
            + value["a12"] * (c2 * df2 - s2 * f2**2)
            + n * value["Im2"] * motor[1]
            - e1
            + e2,
            value["a02"] * (c12 * df0 + s12 * f0**2) + value["a12"] * (c2 * df1 + s2 * f1**2) + value["a22"] * df2 - e2,
            n * value["Im1"] * df0 + n**2 * value["Im1"] * motor[0] + e1 - n * tau[0],
            n * value["Im2"] * df1 + n**2 * value["Im2"] * motor[1] + e2 - n * tau[1],
        ]
        scale = value["a11"] * max(abs(df0), abs(df1), abs(df2), f2**2)
        np.testing.assert_allclose(rows, 0.0, atol=1e-12 * scale)


def test_a_batch_is_its_members() -> None:
    arm, model, _ = lively()
    dynamics = PlanarDynamics.from_parameters(arm, model.base_values(arm))
    rng = np.random.default_rng(1)
    q, theta, qd, thetad, tau = rng.normal(size=(5, 3, 4, 2))
    omega0 = rng.normal(size=(3, 4))
    base, link, motor = dynamics.accelerations(q, theta, omega0, qd, thetad, tau)
    energy = dynamics.kinetic_energy(q, omega0, qd, thetad)
    momentum = dynamics.momentum(q, omega0, qd, thetad)
    elastic = dynamics.elastic_energy(q, theta)
    assert base.shape == energy.shape == momentum.shape == elastic.shape == (3, 4)
    for i in np.ndindex(3, 4):
        one = dynamics.accelerations(q[i], theta[i], omega0[i], qd[i], thetad[i], tau[i])
        np.testing.assert_allclose(np.hstack([base[i], link[i], motor[i]]), np.hstack(one), rtol=1e-12)
        assert energy[i] == pytest.approx(dynamics.kinetic_energy(q[i], omega0[i], qd[i], thetad[i]), rel=1e-12)
        assert momentum[i] == pytest.approx(dynamics.momentum(q[i], omega0[i], qd[i], thetad[i]), rel=1e-12)
        assert elastic[i] == pytest.approx(0.5 * dynamics.stiffness @ (theta[i] - q[i]) ** 2, rel=1e-12)


def test_base_rate_gives_the_momentum_asked_for() -> None:
    arm, model, _ = lively()
    dynamics = PlanarDynamics.from_parameters(arm, model.base_values(arm))
    rng = np.random.default_rng(2)
    q, qd, thetad = rng.normal(size=(3, 5, 2))
    rate = dynamics.base_rate(q, 1.0, qd, thetad)
    np.testing.assert_allclose(dynamics.momentum(q, rate, qd, thetad), 1.0, atol=1e-9)
    at_rest = dynamics.base_rate(np.zeros(2), 1.0)
    total = 23774.1975 + 81831.7048 + 5098.5390 + 2 * (42329.8731 + 9611.6878 + 19708.7659)
    assert at_rest == pytest.approx(1.0 / total, rel=1e-8, abs=0)


def test_parameters_without_a_body_are_refused() -> None:
    arm, model, _ = lively()
    values = model.base_values(arm)
    with pytest.raises(ZygosError, match="12 parameters"):
        PlanarDynamics.from_parameters(arm, values[:-1])
    values[arm.parameter_names.index("a22")] *= 0.9
    with pytest.raises(ZygosError, match="negative kinetic energy"):
        PlanarDynamics.from_parameters(arm, values)

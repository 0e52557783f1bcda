# SPDX-License-Identifier: MIT
"""The MuJoCo plant: it conserves what it must, moves as the package's plant does, and its laws do what they say."""

from __future__ import annotations

import ast
import hashlib
import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from runs_support import trajectory_of

from conftest import ROOT

if not os.environ.get("CI"):  # there, a missing tool is a failure
    pytest.importorskip("mujoco")

from oracles.demo_log import built
from oracles.laws import (
    BaseDetent,
    CubicStiffness,
    Law,
    LinkCoulomb,
    Local,
    MotorCoulomb,
    MotorViscous,
    RateStiffness,
    TorqueLag,
)
from oracles.plant import TORQUE_STEP, Motion, MujocoPlant
from oracles.simulate import run, write
from zygos.arm import Arm, load_arm
from zygos.model.model import Model, load_model
from zygos.simulation.scenario import Scenario, load_scenario

Floats = NDArray[np.float64]
GAP = ROOT / "examples" / "gap"
ELBOW = 1
LAWS = (
    MotorCoulomb(ELBOW, 0.03),
    MotorViscous(ELBOW, 0.2),
    LinkCoulomb(ELBOW, 2.0),
    CubicStiffness(ELBOW, 300.0),
    TorqueLag(ELBOW, 0.003),
    RateStiffness(ELBOW, 0.02),
    BaseDetent(0, 1.0),
)


@cache
def example() -> tuple[Arm, Model, Scenario]:
    """Arm, model and motion."""
    # without what the drawing assumes of the momentum: here the scenario has the word
    drawn = replace(load_model(GAP / "cad.toml"), effects=())
    return load_arm(GAP / "arm.toml"), drawn, load_scenario(GAP / "a.toml")


@cache
def audited(kind: type[Law] | None) -> Motion:
    """Three seconds with the law of LAWS that is of this kind, or without any; its energy balance is kept."""
    arm, model, scenario = example()
    laws = [law for law in LAWS if type(law) is kind]
    return MujocoPlant(arm, model).run(scenario, laws, duration_s=3.0, audit=True)


def at(**values: float) -> Local:
    """Where a law stands: everything at rest but what is said."""
    rest = {name: 0.0 for name in Local._fields}
    return Local(**{**rest, "stiffness": 1000.0, "step": 1e-3, **values})


def test_nothing_is_shared_with_the_plant_of_the_package() -> None:
    readers = {"zygos.arm", "zygos.model.model", "zygos.simulation.scenario", "zygos.runs.cycles"}
    for file in ("plant", "laws"):
        tree = ast.parse((ROOT / "tests" / "oracles" / f"{file}.py").read_text())
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert {name for name in imported if name and name.startswith("zygos")} <= readers


@pytest.mark.slow
def test_a_motion_conserves_energy_and_momentum() -> None:
    arm, model, scenario = example()
    plant = MujocoPlant(arm, model)
    motion = plant.run(replace(scenario, angular_momentum_nms=1.0), audit=True, duration_s=20.0)
    balance = motion.balance
    assert balance is not None
    assert balance.gap < 1e-9
    assert balance.motor[-1] > 100.0
    assert np.all(np.diff(balance.damper) <= 0.0)
    linear, angular = plant.momentum(motion.position, motion.rate)
    np.testing.assert_allclose(angular, 1.0, atol=1e-6)  # its terms reach 1e4 Nms
    assert np.abs(linear).max() < 1e-6  # and those of this one 1e3 kg m/s


@pytest.mark.slow
def test_moves_as_the_plant_of_the_package() -> None:
    """Two formulations, two integrators."""
    arm, model, scenario = example()
    scenario = replace(scenario, angular_momentum_nms=5.0)
    ours = MujocoPlant(arm, model).run(scenario, noise=False, duration_s=1.0, step_s=1e-3)
    theirs = trajectory_of(arm, model, scenario, noise=False, duration_s=1.0)
    np.testing.assert_allclose(ours.q, theirs.q[0], atol=1e-11)
    np.testing.assert_allclose(ours.theta, theirs.theta[0], atol=1e-11)
    np.testing.assert_allclose(ours.omega0, theirs.omega0[0], atol=1e-11)
    np.testing.assert_allclose(ours.tau, theirs.tau[0], atol=1e-9)


@pytest.mark.slow
def test_moves_alike_about_another_axis() -> None:
    """The arm turned on its side, its mass centres off the lines between the joints."""
    arm, model, scenario = example()
    joints = tuple(replace(joint, axis=(1.0, 0.0, 0.0)) for joint in arm.joints)
    arm = replace(arm, kinetic="planar", joints=joints)
    bodies = [replace(body, origin_xyz=(0.0, body.origin_xyz[0], 0.7 + 0.2 * i)) for i, body in enumerate(model.bodies)]
    for i in (0, 1):
        bodies[i] = replace(bodies[i], joint_xyz=(0.0, 5.0, 1.0 - i))
    model = replace(model, bodies=tuple(bodies))
    ours = MujocoPlant(arm, model).run(scenario, noise=False, duration_s=1.0, step_s=1e-3)
    theirs = trajectory_of(arm, model, scenario, noise=False, duration_s=1.0)
    np.testing.assert_allclose(ours.q, theirs.q[0], atol=1e-10)
    np.testing.assert_allclose(ours.omega0, theirs.omega0[0], atol=1e-10)
    np.testing.assert_allclose(ours.cycles.omega, theirs.cycles(0).omega, atol=1e-10)


@pytest.mark.slow(only=["MotorCoulomb"])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_energy_closes_with_every_law(law: Law) -> None:
    arm, model, scenario = example()
    plant, plain, hidden = MujocoPlant(arm, model), audited(None), audited(type(law))
    assert hidden.balance is not None
    assert hidden.balance.gap < 1e-9
    assert np.abs(hidden.q - plain.q).max() > 1e-4
    _, angular = plant.momentum(hidden.position, hidden.rate)
    if law.where == "base":
        assert np.abs(angular).max() > 1.0
    else:
        assert np.abs(angular).max() < 1e-6
    # a run leaves the law as it was
    np.testing.assert_array_equal(plant.run(scenario, (law,), duration_s=0.5).q, hidden.q[:100])


@pytest.mark.parametrize(
    "law", [law for law in LAWS if law.key.endswith(("coulomb", "viscous"))], ids=lambda law: law.key
)
def test_friction_dissipates(law: Law) -> None:
    arm, motion = example()[0], audited(type(law))
    assert motion.balance is not None
    loss = -motion.balance.law
    # the bristles of a Dahl spring hold a little back
    kept = law.size * 1e-3 if isinstance(law, LinkCoulomb) else 0.0
    assert np.all(np.diff(loss) >= -kept)
    rate = motion.thetad if law.where == "motor" else motion.qd
    ratio = arm.joints[ELBOW].gear_ratio if law.where == "motor" else 1.0
    way = np.abs(rate[:, ELBOW]) ** (2 if isinstance(law, MotorViscous) else 1)
    ideal = ratio * law.size * float(np.sum(0.5 * (way[1:] + way[:-1]))) * arm.period_s
    assert loss[-1] == pytest.approx(ideal, rel=0.1)
    assert loss[-1] < ideal  # rounded at the reversals, bent at speed


def test_a_spring_gives_back_what_it_takes() -> None:
    motion = audited(CubicStiffness)
    (law,) = (law for law in LAWS if isinstance(law, CubicStiffness))
    assert motion.balance is not None
    deflection = (motion.theta - motion.q)[:, ELBOW]
    stored = np.array([law.energy(d) for d in deflection])
    assert stored.max() > 1.0
    np.testing.assert_allclose(motion.balance.law, -stored, atol=1e-6)


def test_a_detent_has_a_potential() -> None:
    motion = audited(BaseDetent)
    (law,) = (law for law in LAWS if isinstance(law, BaseDetent))
    assert motion.balance is not None
    stored = law.size / law.teeth * np.cos(law.teeth * motion.phi0)
    np.testing.assert_allclose(motion.balance.law, stored[0] - stored, atol=1e-6)


def test_torques_have_the_form_they_state() -> None:
    assert MotorCoulomb(0, 2.0).torque(at(thetad=0.004)) == pytest.approx(-2.0 * np.tanh(1.0))
    assert MotorViscous(0, 2.0).torque(at(thetad=-0.5)) == pytest.approx(1.0 / 1.1)
    assert CubicStiffness(0, 10.0).torque(at(theta=0.5, q=0.1)) == pytest.approx(10.0 * (0.4**3 + 0.3 * 0.4**5))
    assert RateStiffness(0, 0.1).torque(at(theta=0.5, qd=-0.1)) == pytest.approx(50.0 * np.tanh(1.0))
    assert BaseDetent(0, 3.0, teeth=4).torque(at(phi=0.2)) == pytest.approx(3.0 * np.sin(0.8))


def test_dahl_friction_depends_on_the_way_alone() -> None:
    """One step or a hundred; from rest to sliding, and back over twice the distance."""

    def walk(law: LinkCoulomb, stops: Floats) -> float:
        for before, after in pairwise(stops.tolist()):
            law.begin(at(q=before))
            law.end(at(q=after))
        law.begin(at(q=stops.item(-1)))
        return law.torque(at(q=stops.item(-1)))

    slide = 1.0 - np.exp(-1.0)
    for count in (2, 100):
        law = LinkCoulomb(0, 5.0)
        bend = law.presliding
        assert walk(law, np.linspace(0.0, bend, count)) == pytest.approx(-5.0 * slide)
        assert walk(law, np.linspace(bend, 0.1, count)) == pytest.approx(-5.0)
        assert walk(law, np.linspace(0.1, 0.0, count)) == pytest.approx(5.0)


@pytest.mark.parametrize("lag", [1e-5, 0.003])
def test_a_lag_delays_the_impulse_by_its_time_constant(lag: float) -> None:
    """What a step of the command loses is its height times the lag, however short the lag."""
    law, missing = TorqueLag(0, lag), 0.0
    for _ in range(100):
        law.begin(at(command=2.0))
        missing += 1e-3 * law.torque(at(command=2.0))
        law.end(at(command=2.0))
    assert missing == pytest.approx(-2.0 * lag)


def test_readings_are_whole_quanta() -> None:
    arm, model, scenario = example()
    joints = [
        replace(joint, motor_encoder=replace(joint.motor_encoder, sign=-1, zero_rad=0.1, quantum_rad=1e-4))
        for joint in arm.joints
    ]
    arm = replace(arm, joints=tuple(joints))
    motion = MujocoPlant(arm, model).run(scenario, seed=3, duration_s=2.0)
    for row, readings, angle in ((0, motion.cycles.q, motion.q), (1, motion.cycles.theta, 0.1 - motion.theta)):
        encoders = [(joint.link_encoder, joint.motor_encoder)[row] for joint in arm.joints]
        quantum = np.array([encoder.quantum_rad for encoder in encoders])
        counts = readings / quantum
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
        assert np.all(np.abs(motion.offset[row]) <= 0.5 * quantum)
        assert np.all(np.abs(readings - angle - motion.offset[row]) <= 0.5 * quantum * (1 + 1e-9))
    steps = motion.tau / TORQUE_STEP
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    np.testing.assert_array_equal(motion.cycles.tau, motion.tau)
    other = MujocoPlant(arm, model).run(scenario, seed=4, duration_s=2.0)
    assert not np.array_equal(other.offset, motion.offset)


@pytest.mark.slow
def test_the_gyro_errs_as_declared() -> None:
    arm, model, scenario = example()
    noisy = replace(arm, imu=replace(arm.imu, rate_sigma=1e-4, bias_walk=0.0))
    motion = MujocoPlant(noisy, model).run(scenario, duration_s=10.0)
    error = motion.cycles.omega - motion.omega0[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(error.std(axis=0), 1e-4, rtol=0.05)
    walking = replace(arm, imu=replace(arm.imu, rate_sigma=0.0, bias_walk=1e-4))
    motion = MujocoPlant(walking, model).run(scenario, duration_s=10.0)
    error = motion.cycles.omega - motion.omega0[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(np.diff(error, axis=0).std(axis=0), 1e-4 * np.sqrt(arm.period_s), rtol=0.05)


@pytest.mark.slow
def test_a_log_has_the_same_bytes_each_time(tmp_path: Path) -> None:
    arm, model, scenario = example()
    digests = set()
    for name in ("one.blf", "two.blf"):
        cycles = run(arm, built(model, 20), replace(scenario, duration_s=2.0), 1, MotorCoulomb(ELBOW, 0.03))
        write(cycles, arm, tmp_path / name)
        digests.add(hashlib.sha256((tmp_path / name).read_bytes()).hexdigest())
    assert len(digests) == 1

# SPDX-License-Identifier: MIT
"""Pinocchio and MuJoCo against each other, against point masses, and against the laws of energy and momentum."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_support import Floats, State, random_arm, random_state
from motion_support import FLEXIBLE
from plant_support import lively
from scipy.spatial.transform import Rotation

from conftest import ROOT, need
from zygos.arm import Arm, Base, Kinetic
from zygos.dynamics.engines import ENGINES, engine
from zygos.dynamics.planar import PlanarDynamics
from zygos.errors import ZygosError
from zygos.model.model import Body, Model, Quantity, load_model, save_model

for library in ENGINES:
    try:
        __import__(library)
    except ImportError as reason:
        need(None, f"{reason} (pip install 'zygos[engines]')")

ARMS = pytest.mark.parametrize("springs", list(FLEXIBLE))
BASES = pytest.mark.parametrize("base", ["free", "fixed"])
JOINTS = pytest.mark.parametrize("joints", [1, 3, 7])
NAMES = pytest.mark.parametrize("name", list(ENGINES))


def made(seed: int, joints: int, base: Base, springs: str, kinetic: Kinetic = "spatial") -> tuple[Arm, Model]:
    return random_arm(seed, joints, base, kinetic, [FLEXIBLE[springs](i) for i in range(joints)])


def alike(got: Floats, wanted: Floats, tolerance: float) -> None:
    """Equal as vectors: the largest difference against the largest entry."""
    np.testing.assert_allclose(got, wanted, rtol=0, atol=tolerance * np.max(np.abs(wanted)))


def equal_engines(arm: Arm, model: Model, *states: State, tolerance: float = 1e-10) -> None:
    """They agree to 1e-12 in accelerations and to 1e-14 in energies and momenta."""
    one, other = engine("pinocchio", arm, model), engine("mujoco", arm, model)
    for state in states:
        for got, wanted in zip(other.accelerations(*state), one.accelerations(*state), strict=True):
            alike(got, wanted, tolerance)
        q, _, *rates = state[:5]
        assert other.kinetic_energy(q, *rates) == pytest.approx(one.kinetic_energy(q, *rates), rel=tolerance)
        if arm.free:
            assert abs(one.potential_energy(q)) + abs(other.potential_energy(q)) < 1e-20
            h = one.momentum(q, *rates)
            assert np.linalg.norm(h) > 1.0
            alike(other.momentum(q, *rates), h, tolerance)
        else:
            zero = np.zeros(arm.n)
            lift = one.potential_energy(q) - one.potential_energy(zero)
            # the difference of two energies, each with an error of its own
            weight = sum(body.mass.value for body in model.bodies) * 9.81
            assert other.potential_energy(q) - other.potential_energy(zero) == pytest.approx(
                lift, abs=tolerance * weight
            )
            assert abs(lift) > 1e-6 * weight


@JOINTS
@BASES
@ARMS
def test_the_engines_agree(joints: int, base: Base, springs: str) -> None:
    arm, model = made(0, joints, base, springs)
    rng = np.random.default_rng(0)
    equal_engines(arm, model, *(random_state(rng, arm) for _ in range(4)))


@BASES
@pytest.mark.parametrize("kinetic", ["planar", "planar-symmetric"])
def test_the_engines_agree_on_planar_arms(base: Base, kinetic: Kinetic) -> None:
    arm, model = made(0, 3, base, "mixed", kinetic)
    equal_engines(arm, model, random_state(np.random.default_rng(0), arm))


@BASES
def test_rotors_without_mass_and_flat_bodies(base: Base) -> None:
    """MuJoCo takes neither as they stand."""
    arm, model = made(1, 3, base, "flexible")
    flat = replace(model.bodies[1], inertia=tuple(map(Quantity, (0.1, 0.0, 0.0, 0.2, 0.0, 0.1 + 0.2))))
    bodies = (model.bodies[0], flat, *model.bodies[2:])
    model = replace(
        model, bodies=bodies, joints=tuple(replace(joint, rotor_mass=Quantity(0.0)) for joint in model.joints)
    )
    equal_engines(arm, model, random_state(np.random.default_rng(0), arm))


def turned(axis: tuple[float, ...] | Floats, angle: complex) -> Floats:
    """Rodrigues' rotation, of a complex angle, too."""
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across


def cloud(mass: float, centre: Floats, tensor: Floats) -> tuple[Floats, Floats]:
    """Six point masses that move as the body does: masses (6,) and places (6, 3)."""
    second, axes = np.linalg.eigh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
    arms = axes * np.sqrt(3.0 * np.maximum(second, 0.0) / mass)
    return np.full(6, mass / 6.0), centre + np.vstack([arms.T, -arms.T])


def points(arm: Arm, model: Model, state: State) -> tuple[Floats, Floats, Floats]:
    """Masses (P,), places and velocities (P, 3) of an arm made of point masses; the base stands at the origin.

    Velocities are derivatives with respect to time by a complex step: exact, and without a word of mechanics.
    """
    instant = 1e-30j
    speed = float(np.linalg.norm(state.omega0))
    attitude = turned(state.omega0 / speed, speed * instant) if speed else np.eye(3)
    origin = np.zeros(3)
    masses, places = [], []

    def add(mass: float, centre: Floats, tensor: Floats) -> None:
        weights, spots = cloud(mass, centre, tensor)
        masses.append(weights)
        places.append(origin + spots @ attitude.T)

    for i, body in enumerate(model.bodies):
        add(body.mass.value, np.array(body.origin_xyz), body.tensor)
        if body.joint_xyz is None:
            break
        joint, drive = arm.joints[i], model.joints[i]
        origin = origin + attitude @ np.array(body.joint_xyz)
        attitude = carrier = attitude @ Rotation.from_euler("xyz", joint.frame_rpy).as_matrix()
        # the rotor: a disc about the third axis of a frame whose third axis is the joint's
        third = np.linalg.svd(np.array(joint.axis)[None, :])[2].T[:, [1, 2, 0]]
        moment = drive.rotor_inertia.value
        attitude = carrier @ turned(joint.axis, joint.gear_ratio * (state.theta[i] + instant * state.thetad[i]))
        add(drive.rotor_mass.value, np.zeros(3), third @ np.diag([moment / 2, moment / 2, moment]) @ third.T)
        attitude = carrier @ turned(joint.axis, state.q[i] + instant * state.qd[i])
    spots = np.concatenate(places)
    return np.concatenate(masses), spots.real, spots.imag / instant.imag


@NAMES
@BASES
@ARMS
def test_energy_and_momentum_of_point_masses(name: str, base: Base, springs: str) -> None:
    for seed in range(2):
        arm, model = made(seed, 3, base, springs)
        body = engine(name, arm, model)
        rng = np.random.default_rng(seed)
        heights = []
        for _ in range(4):
            state = random_state(rng, arm)
            q, _, *rates = state[:5]
            mass, place, velocity = points(arm, model, state)
            if arm.free:
                place, velocity = place - mass @ place / mass.sum(), velocity - mass @ velocity / mass.sum()
                alike(body.momentum(q, *rates), mass @ np.cross(place, velocity), 1e-11)
            energy = 0.5 * float(mass @ (velocity * velocity).sum(axis=1))
            assert body.kinetic_energy(q, *rates) == pytest.approx(energy, rel=1e-11)
            heights.append(body.potential_energy(q) + mass @ place @ np.array(arm.gravity))
        # up to a constant
        np.testing.assert_allclose(np.diff(heights), 0.0, atol=1e-11 * 9.81 * mass.sum())


def slope(function: Callable[[float], Floats]) -> Floats:
    """Derivative at zero, of fourth order."""
    step = 1e-3
    return (8.0 * (function(step) - function(-step)) - (function(2 * step) - function(-2 * step))) / (12.0 * step)


@NAMES
@JOINTS
@BASES
@ARMS
def test_power_balance_and_constant_momentum(name: str, joints: int, base: Base, springs: str) -> None:
    arm, model = made(0, joints, base, springs)
    body = engine(name, arm, model)
    state = random_state(np.random.default_rng(0), arm)
    end = body.accelerations(*state)
    stiffness = np.array(
        [joint.stiffness.value if np.isfinite(joint.stiffness.value) else 0.0 for joint in model.joints]
    )
    damping = np.array([joint.damping.value for joint in model.joints])

    def at(t: float) -> State:
        q, theta, omega0, qd, thetad, tau = state
        return State(q + t * qd, theta + t * thetad, omega0 + t * end[0], qd + t * end[1], thetad + t * end[2], tau)

    def energy(t: float) -> float:
        q, theta, *rates = at(t)[:5]
        return body.kinetic_energy(q, *rates) + body.potential_energy(q) + 0.5 * float(stiffness @ (theta - q) ** 2)

    motor = arm.gear_ratios * state.tau * state.thetad
    damper = damping * (state.thetad - state.qd) ** 2
    size = body.kinetic_energy(state.q, state.omega0, state.qd, state.thetad)
    power = motor.sum() - damper.sum()
    assert slope(energy) == pytest.approx(power, abs=1e-8 * (np.abs(motor).sum() + damper.sum() + size))
    if arm.free:
        h = body.momentum(state.q, state.omega0, state.qd, state.thetad)

        def momentum(t: float) -> Floats:
            q, _, *rates = at(t)[:5]
            return body.momentum(q, *rates)

        # h stands still in space, and so turns back in base axes
        turning = np.cross(state.omega0, h)
        np.testing.assert_allclose(slope(momentum), -turning, rtol=0, atol=1e-8 * np.linalg.norm(h))
        assert np.linalg.norm(turning) > 1e-2 * np.linalg.norm(h)


def against_planar(name: str, arm: Arm, model: Model, rng: np.random.Generator) -> None:
    body, dynamics = engine(name, arm, model), PlanarDynamics.from_model(arm, model)
    for _ in range(3):
        state = random_state(rng, arm)
        rigid = dynamics.rigid
        state = state._replace(
            theta=np.where(rigid, state.q, state.theta), thetad=np.where(rigid, state.qd, state.thetad)
        )
        rate = float(state.omega0 @ arm.axis)
        base, links, motors = body.accelerations(*state)
        wanted = dynamics.accelerations(state.q, state.theta, rate, state.qd, state.thetad, state.tau)
        alike(base, wanted[0] * arm.axis, 1e-10)
        alike(links, wanted[1], 1e-10)
        alike(motors, wanted[2], 1e-10)
        q, _, *rates = state[:5]
        energy = dynamics.kinetic_energy(q, rate, state.qd, state.thetad)
        assert body.kinetic_energy(q, *rates) == pytest.approx(energy, rel=1e-11)
        alike(body.momentum(q, *rates), dynamics.momentum(q, rate, state.qd, state.thetad) * arm.axis, 1e-11)


@NAMES
def test_the_examples_move_as_our_planar_equations_say(name: str) -> None:
    arm, model, _ = lively()
    against_planar(name, arm, model, np.random.default_rng(0))
    drawing = load_model(ROOT / "examples" / "gap" / "cad.toml")
    against_planar(name, arm, replace(drawing, effects=()), np.random.default_rng(1))


@NAMES
@pytest.mark.parametrize("kinetic", ["planar", "planar-symmetric"])
@pytest.mark.parametrize("stiff", [(), (0,), (1, 2), (0, 1, 2, 3)])
def test_planar_arms_move_as_our_planar_equations_say(name: str, kinetic: Kinetic, stiff: tuple[int, ...]) -> None:
    """The joints in `stiff` are flexible to the arm file, and infinitely stiff to the model."""
    arm, model = random_arm(4, 4, "free", kinetic)
    joints = [
        replace(joint, stiffness=Quantity(np.inf)) if i in stiff else joint for i, joint in enumerate(model.joints)
    ]
    against_planar(name, arm, replace(model, joints=tuple(joints)), np.random.default_rng(2))


@NAMES
def test_a_rigid_joint_reads_no_motor_angle(name: str) -> None:
    arm, model = made(0, 3, "free", "mixed")
    body = engine(name, arm, model)
    state = random_state(np.random.default_rng(0), arm)
    astray = np.array([1.0, 0.0, 1.0])  # the first and third are rigid
    other = state._replace(theta=state.theta + astray, thetad=state.thetad - astray)
    for got, wanted in zip(body.accelerations(*other), body.accelerations(*state), strict=True):
        np.testing.assert_array_equal(got, wanted)
    q, _, *rates = state[:5]
    q, _, *others = other[:5]
    assert body.kinetic_energy(q, *others) == body.kinetic_energy(q, *rates)
    np.testing.assert_array_equal(body.momentum(q, *others), body.momentum(q, *rates))


@pytest.mark.slow(only=["planar-free"])
@BASES
@pytest.mark.parametrize("kinetic", ["spatial", "planar", "planar-symmetric"])
def test_random_arms_could_be_built(base: Base, kinetic: Kinetic, tmp_path: Path) -> None:
    """A model file refuses inertias that no body has."""
    for seed in range(2):
        model = made(seed, 7, base, "mixed", kinetic)[1]
        save_model(model, tmp_path / "model.toml")
        for read, body in zip(load_model(tmp_path / "model.toml").bodies, model.bodies, strict=True):
            np.testing.assert_array_equal(read.tensor, body.tensor)


@NAMES
def test_what_an_engine_refuses(name: str) -> None:
    arm, model, _ = lively()
    with pytest.raises(ZygosError, match=r"effects \(angular_momentum\).*remedy: engine \"zygos\""):
        engine(name, arm, load_model(ROOT / "examples" / "gap" / "cad.toml"))
    with pytest.raises(ZygosError, match=r"base parameters.*remedy: .*engine \"zygos\""):
        engine(name, arm, Model("table", parameters=model.base_parameters(arm)))
    with pytest.raises(ZygosError, match=r"has joints .*remedy: use the same joint names"):
        engine(name, *(random_arm(0, 2, "free")[0], model))


def test_an_unknown_engine_is_refused() -> None:
    arm, model, _ = lively()
    with pytest.raises(ZygosError, match="no engine 'ode'; remedy: use one of pinocchio, mujoco"):
        engine("ode", arm, model)


@NAMES
def test_an_engine_that_is_not_installed_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, f"zygos.dynamics.engines.{name}", raising=False)
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ZygosError, match=rf"engine {name}.*remedy: .* -m pip install 'zygos\[engines\]'"):
        engine(name, *lively()[:2])


def test_mujoco_names_the_model_that_it_refuses() -> None:
    arm, model = random_arm(0, 1, "free")
    entries = map(Quantity, (1.0, 0.0, 0.0, 1.0, 0.0, 3.0))
    impossible: Body = replace(model.bodies[1], inertia=tuple(entries))
    with pytest.raises(ZygosError, match=r"model random: MuJoCo rejects it.*inertia.*remedy"):
        engine("mujoco", arm, replace(model, bodies=(model.bodies[0], impossible)))

# SPDX-License-Identifier: MIT
"""Effects, rigid joints and torque lag in the equations of motion: against Lagrange's equations drawn up from the
bodies, against Pinocchio, and against what energy and momentum must do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import pytest
from dynamics_support import Oracle, random_state
from gap_support import effect, example
from plant_support import Floats, lively, random_arm
from runs_support import trajectory_of

from zygos.arm import Arm
from zygos.balances.state import State
from zygos.dynamics.planar import PlanarDynamics
from zygos.dynamics.replay import replay
from zygos.effects import CATALOGUE, SLOWEST_RATE, Effect
from zygos.errors import ZygosError
from zygos.model.model import Model, Quantity

SIZE = {
    "motor_coulomb": 0.3,
    "motor_viscous": 2.0,
    "link_coulomb": 8.0,
    "cubic_stiffness": 700.0,
    "spring_offset": -60.0,
}
"""Coefficients of the torque laws, large enough that each is a good share of the torques of a random state."""

LAWS: dict[str, tuple[Callable[[Floats, Floats], Floats], Callable[[float, float, float], float]]] = {
    "motor_coulomb": (lambda _, thetad: -np.sign(thetad), lambda n, _, thetad: n * abs(thetad)),
    "motor_viscous": (lambda _, thetad: -thetad, lambda n, _, thetad: n * thetad**2),
    "link_coulomb": (lambda qd, _: -np.sign(qd), lambda _, qd, __: abs(qd)),
}
"""By key: torque a unit coefficient, and power lost, written down a second time."""


@dataclass(frozen=True)
class Lagrange:
    """Lagrange's equations of an arm of bodies, differentiated numerically.

    Coordinates are base attitude, link angles, motor angles; a joint in `rigid` has theta = q. coupling: share of the
    rotors' inertia in the product of rotor and carrier rates.
    """

    arm: Arm
    model: Model
    effects: tuple[Effect, ...] = ()
    rigid: tuple[int, ...] = ()

    @cached_property
    def skew(self) -> Floats:
        """(3, 3) its product with a vector is the cross product of the joints' axis and that vector."""
        return np.cross(np.eye(3), self.arm.axis)

    def turned(self, angle: float) -> Floats:
        """Rodrigues' matrix of a rotation about the joints' axis."""
        return np.asarray(np.eye(3) + np.sin(angle) * self.skew + (1.0 - np.cos(angle)) * self.skew @ self.skew)

    def kinetic(self, y: Floats, rate: Floats) -> float:
        """Kinetic energy about the mass centre, J: every body and rotor by itself, in the base's frame."""
        joints, axis = self.arm.n, self.arm.axis
        coupling = np.ones(joints)
        for one in self.effects:
            if one.kind.key == "rotor_coupling":
                coupling[one.index(self.arm)] = one.value
        f, phi = np.cumsum(rate[: joints + 1]), np.cumsum(y[: joints + 1])
        speed = np.zeros(3)
        mass, momentum, energy = 0.0, np.zeros(3), 0.0

        def point(m: float, v: Floats) -> None:
            nonlocal mass, momentum, energy
            mass, momentum, energy = mass + m, momentum + m * v, energy + 0.5 * m * float(v @ v)

        for i, body in enumerate(self.model.bodies):
            turn = self.turned(phi[i]) @ self.arm.frames[i]
            local = self.arm.frames[i].T @ axis
            point(body.mass.value, speed + f[i] * self.skew @ turn @ body.origin_xyz)
            energy += 0.5 * float(local @ body.tensor @ local) * f[i] ** 2
            if body.joint_xyz is None:
                break
            speed = speed + f[i] * self.skew @ turn @ body.joint_xyz
            drive, spin = self.model.joints[i], self.arm.gear_ratios[i] * rate[1 + joints + i]
            point(drive.rotor_mass.value, speed)
            square = spin**2 + 2.0 * coupling[i] * spin * f[i] + f[i] ** 2
            energy += 0.5 * drive.rotor_inertia.value * square
        return energy - 0.5 * float(momentum @ momentum) / mass

    def forces(self, y: Floats, rate: Floats, tau: Floats) -> Floats:
        """Generalised forces of motors, springs, dampers and torque laws."""
        joints, ratio = self.arm.n, self.arm.gear_ratios
        q, theta, qd, thetad = y[1 : 1 + joints], y[1 + joints :], rate[1 : 1 + joints], rate[1 + joints :]
        stiffness = np.array([joint.stiffness.value for joint in self.model.joints])
        damping = np.array([joint.damping.value for joint in self.model.joints])
        spring = stiffness * (theta - q) + damping * (thetad - qd)
        link, motor = np.zeros(joints), ratio * tau
        for one in self.effects:
            i, key = one.index(self.arm), one.kind.key
            if key == "cubic_stiffness":
                spring[i] += one.value * (theta[i] - q[i]) ** 3
            elif key == "spring_offset":
                spring[i] += one.value
            elif key == "link_coulomb":
                link[i] += one.value * LAWS[key][0](qd, thetad)[i]
            elif key in LAWS:
                motor[i] += ratio[i] * one.value * LAWS[key][0](qd, thetad)[i]
        spring[list(self.rigid)] = 0.0
        return np.concatenate([[0.0], link + spring, motor - spring])

    def accelerations(self, y: Floats, rate: Floats, tau: Floats) -> Floats:
        """d/dt dT/dy' - dT/dy = forces, solved for the accelerations of the coordinates that are free."""
        size, joints = len(y), self.arm.n
        tie = np.eye(size)
        for i in self.rigid:
            tie[1 + joints + i, 1 + i] = 1.0
        free = tie[:, [k for k in range(size) if k - 1 - joints not in self.rigid]]

        def mass(at: Floats) -> Floats:
            # T is quadratic in the rates, so these differences are exact
            units = np.eye(size)
            single = np.array([self.kinetic(at, unit) for unit in units])
            upper = np.zeros((size, size))
            for i, j in combinations(range(size), 2):
                upper[i, j] = self.kinetic(at, units[i] + units[j]) - single[i] - single[j]
            return upper + upper.T + np.diag(2.0 * single)

        step = 1e-5
        turned = (mass(y + step * rate) - mass(y - step * rate)) @ rate / (2.0 * step)
        slope = np.array([
            (self.kinetic(y + step * unit, rate) - self.kinetic(y - step * unit, rate)) / (2.0 * step)
            for unit in np.eye(size)
        ])  # fmt: skip
        right = self.forces(y, rate, tau) - turned + slope
        return np.asarray(free @ np.linalg.solve(free.T @ mass(y) @ free, free.T @ right), dtype=np.float64)


def stiffened(model: Model, stiffness: float, joints: Sequence[int]) -> Model:
    """The model with another stiffness in some joints."""
    return replace(
        model,
        joints=tuple(
            replace(joint, stiffness=Quantity(stiffness)) if i in joints else joint
            for i, joint in enumerate(model.joints)
        ),
    )


def tied(state: tuple[Floats, Floats, float, Floats, Floats, Floats], rigid: Sequence[int]) -> State:
    """A random state whose rigid joints have theta = q, without rates in the band where friction fades."""
    q, theta, omega0, qd, thetad, _ = state
    theta[list(rigid)], thetad[list(rigid)] = q[list(rigid)], qd[list(rigid)]
    assert np.abs([qd, thetad]).min() > SLOWEST_RATE
    return State(q, theta, qd, thetad, np.float64(omega0))  # type: ignore[arg-type]


SPRING = {"cubic_stiffness", "spring_offset"}
"""They have no place at a rigid joint."""
EVERY = [
    *((key, SIZE[key]) for key in SIZE),
    ("rotor_coupling", 0.0),
    ("rotor_coupling", 0.4),
]


@pytest.mark.slow(only=["lively-each-rigid1", "lively-each-rigid2", "lively-each-rigid0"])
@pytest.mark.parametrize("rigid", [(), (0,), (1,), (0, 1)])
@pytest.mark.parametrize(
    ("kinetic", "case"),
    [("lively", "none"), ("lively", "each"), ("lively", "all"), ("planar", "none"), ("planar", "all")],
)
def test_accelerations_are_lagranges(kinetic: str, case: str, rigid: tuple[int, ...]) -> None:
    """Effects one at a time and together, at flexible and at rigid joints."""
    rng = np.random.default_rng(5)
    arm, model = lively()[:2] if kinetic == "lively" else random_arm(rng, 3, "planar")
    each = [
        (effect(arm, key, joint, value),)
        for key, value in EVERY
        for joint in range(arm.n)
        if not (key in SPRING and joint in rigid)
    ]
    together = tuple(one for (one,) in each if one.value != 0.4)
    cases: dict[str, list[tuple[Effect, ...]]] = {"none": [()], "each": [*each], "all": [together]}
    for effects in cases[case]:
        dynamics = PlanarDynamics.from_model(arm, replace(stiffened(model, np.inf, rigid), effects=effects))
        oracle = Lagrange(arm, model, effects, rigid)
        for _ in range(1 if case == "each" else 4):
            drawn = random_state(rng, arm.n)
            s, tau = tied(drawn, rigid), 20.0 * drawn[-1]
            assert (dynamics.spring(s.q, s.theta, s.qd, s.thetad)[list(rigid)] == 0.0).all()
            base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau)
            y, rate = np.hstack([0.3, s.q, s.theta]), np.hstack([s.base, s.qd, s.thetad])
            want = oracle.accelerations(y, rate, tau)
            # central differences of the kinetic energy leave 1e-8 or so
            np.testing.assert_allclose(np.hstack([base, link, motor]), want, rtol=0, atol=1e-6 * np.abs(want).max())


def rates_of(dynamics: PlanarDynamics, s: State, tau: Floats, of: Callable[[State], Floats]) -> Floats:
    """Time derivative of a function of the state along the motion."""
    base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau)
    flow = State(s.qd, s.thetad, link, motor, base).packed()
    step = 1e-5 / np.abs(flow).max()
    ahead, behind = (of(State.unpacked(s.packed() + sign * step * flow)) for sign in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * step), dtype=np.float64)


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize(
    ("key", "value", "rigid"),
    [(*one, rigid) for one in EVERY for rigid in (False, True) if not (rigid and one[0] in SPRING)],
)
def test_power_balance_and_momentum(key: str, value: float, joint: int, rigid: bool) -> None:
    """d(T + V)/dt = power of the motors - losses, and nothing inside the arm changes its angular momentum."""
    arm, model, _ = lively()
    effects = (effect(arm, key, joint, value),)
    whole = stiffened(model, np.inf, (joint,)) if rigid else model
    dynamics = PlanarDynamics.from_model(arm, replace(whole, effects=effects))
    rng = np.random.default_rng(3)
    damping, ratio = dynamics.damping, arm.gear_ratios
    for _ in range(20):
        drawn = random_state(rng, 2)
        s, tau = tied(drawn, (joint,) if rigid else ()), 20.0 * drawn[-1]

        def energy(at: State) -> Floats:
            kinetic = dynamics.kinetic_energy(at.q, at.base, at.qd, at.thetad)
            return np.asarray(kinetic + dynamics.elastic_energy(at.q, at.theta), dtype=np.float64)

        def momentum(at: State) -> Floats:
            return dynamics.momentum(at.q, at.base, at.qd, at.thetad)

        lost = float(damping @ (s.thetad - s.qd) ** 2)
        if key in LAWS:
            lost += value * LAWS[key][1](ratio[joint], s.qd[joint], s.thetad[joint])
        power = float(ratio * tau @ s.thetad)
        scale = abs(power) + lost
        assert rates_of(dynamics, s, tau, energy) == pytest.approx(power - lost, abs=1e-5 * scale)
        # inertias of 1e5 kg m^2 times accelerations of some rad/s^2
        turned = np.abs(dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau)[0])
        assert abs(rates_of(dynamics, s, tau, momentum)) <= 1e-6 * dynamics.a.max() * (1.0 + turned)


@pytest.mark.slow
@pytest.mark.parametrize("rigid", [(), (0,), (0, 1)])
def test_a_run_without_losses_keeps_energy_and_momentum(rigid: tuple[int, ...]) -> None:
    """A quarter of a second of free motion of an arm whose rotors do not couple, with a cubic spring."""
    arm, model, _ = lively()
    drives = tuple(replace(joint, damping=Quantity(0.0)) for joint in stiffened(model, np.inf, rigid).joints)
    listed = (("rotor_coupling", 0, 0.0), ("rotor_coupling", 1, 0.0), ("cubic_stiffness", 1, 500.0))
    effects = tuple(effect(arm, *one) for one in listed if not (one[0] in SPRING and one[1] in rigid))
    dynamics = PlanarDynamics.from_model(arm, replace(model, joints=drives, effects=effects))
    rng = np.random.default_rng(4)
    start = np.stack([tied(random_state(rng, 2), rigid).packed() for _ in range(5)])
    states, _ = replay(dynamics, 0.01, start, lambda k, _: np.zeros((5, 2)), np.zeros((5, 2)), 26, 20)
    s = State.unpacked(states)
    energy = dynamics.kinetic_energy(s.q, s.base, s.qd, s.thetad) + dynamics.elastic_energy(s.q, s.theta)
    momentum = dynamics.momentum(s.q, s.base, s.qd, s.thetad)
    for kept in (energy, momentum):
        drift = np.abs(kept - kept[:, :1]).max() / np.abs(kept).max()
        assert drift < 1e-8
    np.testing.assert_array_equal(s.q[..., list(rigid)], s.theta[..., list(rigid)])


@pytest.mark.slow
def test_a_rigid_joint_is_the_limit_of_a_stiff_one() -> None:
    """Ten times the stiffness leaves a tenth of the difference."""
    arm, model, scenario = example()
    arm = arm.at_period(0.01)

    def run(stiffness: float) -> Floats:
        whole = stiffened(model, stiffness, (0, 1))
        moved = trajectory_of(arm, whole, scenario, noise=False, duration_s=0.3, rtol=1e-10)
        return np.asarray(moved.q[0], dtype=np.float64)

    limit = run(np.inf)
    turned = np.abs(limit - limit[0]).max()
    far, near = (np.abs(run(stiffness) - limit).max() / turned for stiffness in (1e6, 1e7))
    assert near < 1e-2
    assert far / near == pytest.approx(10.0, rel=0.2)


@pytest.mark.parametrize("rigid", [(0,), (0, 1)])
def test_rigid_joints_equal_pinocchio(rigid: tuple[int, ...]) -> None:
    """The rotors are bodies of their own there, tied to their links by the gear."""
    pin = pytest.importorskip("pinocchio", reason="needs the test extra: pip install zygos[test]")
    rng = np.random.default_rng(6)
    arm, model = random_arm(rng, 2, "planar")
    dynamics = PlanarDynamics.from_model(arm, stiffened(model, np.inf, rigid))
    oracle = Oracle(pin, arm, model)
    for _ in range(10):
        drawn = random_state(rng, 2)
        s, tau = tied(drawn, rigid), drawn[-1]
        position, velocity = oracle.place(s.q, s.theta, float(s.base), s.qd, s.thetad)
        effort, tie = np.zeros(oracle.model.nv), np.eye(oracle.model.nv)
        spring = np.where(np.isin([0, 1], rigid), 0.0, dynamics.spring(s.q, s.theta, s.qd, s.thetad))
        for i in range(2):
            effort[oracle.links[i]] = spring[i]
            effort[oracle.rotors[i]] = tau[i] - spring[i] / arm.gear_ratios[i]
            if i in rigid:
                tie[oracle.rotors[i], oracle.links[i]] = arm.gear_ratios[i]
        free = np.delete(tie, [oracle.rotors[i] for i in rigid], axis=1)
        upper = np.triu(pin.crba(oracle.model, oracle.data, position))
        mass = upper + np.triu(upper, 1).T
        bias = pin.nonLinearEffects(oracle.model, oracle.data, position, velocity)
        want = free @ np.linalg.solve(free.T @ mass @ free, free.T @ (effort - bias))
        base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau)
        scale = np.abs(want).max()
        np.testing.assert_allclose(base * arm.axis, want[3:6], rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(link, want[oracle.links], rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(arm.gear_ratios * motor, want[oracle.rotors], rtol=0, atol=1e-10 * scale)


@pytest.mark.slow
def test_torque_lag_is_a_later_torque() -> None:
    """A run in which the motors lag by 2 and 1 ms of 5, and one at 1 ms whose torques are shifted by hand."""
    arm, model, scenario = example()
    late, parts = (2, 1), 5
    effects = tuple(effect(arm, "torque_lag", i, 1e-3 * ms) for i, ms in enumerate(late))
    run = trajectory_of(arm, replace(model, effects=effects), scenario, noise=False, duration_s=0.2)
    assert run.dynamics.torque_lag is not None

    reported = np.concatenate([np.zeros((1, 2)), run.tau[0]])
    fine = np.repeat(run.tau[0], parts, axis=0)
    for i, ms in enumerate(late):
        for part in range(ms):
            fine[part::parts, i] = reported[:-1, i]
    start = np.hstack([run.omega0[:, 0, None], run.q[:, 0], run.theta[:, 0], run.qd[:, 0], run.thetad[:, 0]])
    plain = PlanarDynamics.from_model(arm, model)
    cycles = parts * (len(run.t) - 1) + 1
    states, _ = replay(plain, 1e-3, start, lambda k, _: fine[None, k], np.zeros((1, 2)), cycles, 2)
    s = State.unpacked(states[0, ::parts])
    for got, want in ((s.q, run.q[0]), (s.thetad, run.thetad[0]), (s.base, run.omega0[0])):
        error = np.abs(got - want).max() / np.abs(want - want[0]).max()
        assert error < 1e-8

    unlagged = trajectory_of(arm, model, scenario, noise=False, duration_s=0.2)
    assert np.abs(unlagged.q - run.q).max() > 1e-4 * np.abs(run.q - run.q[:, :1]).max()


@pytest.mark.parametrize(("key", "place", "sign"), [
    (kind.key, kind.place, sign)
    for kind in CATALOGUE.values() if kind.torque is not None and kind.positive for sign in (-1.0, 1.0)
])  # fmt: skip
def test_positive_entries_dissipate(key: str, place: str, sign: float) -> None:
    """Friction opposes the rate it depends on, also where it fades."""
    torque = CATALOGUE[key].torque
    assert torque is not None
    assert place in {"motor", "link"}
    rates = sign * np.geomspace(1e-6, 10.0, 200)
    assert np.all(torque(rates) * rates > 0.0)


def test_a_lag_beyond_a_period_is_refused() -> None:
    arm, model, _ = example()
    for lag in (0.005, 0.02, -1e-4, np.nan):
        with pytest.raises(ZygosError, match="not within a SYNC period"):
            PlanarDynamics.from_model(arm, replace(model, effects=(effect(arm, "torque_lag", 0, lag),)))


def test_an_unknown_joint_is_refused() -> None:
    arm, model, _ = example()
    for key in {kind.place: kind.key for kind in CATALOGUE.values() if kind.at_joint}.values():
        refusal = f"effect {key}: arm gap has no joint 'wrist'; remedy: one of shoulder, elbow"
        with pytest.raises(ZygosError, match=refusal):
            PlanarDynamics.from_model(arm, replace(model, effects=(Effect(CATALOGUE[key], "wrist", 0.1),)))


def test_no_lag_and_unit_coupling_change_nothing() -> None:
    """What a model need not mention may be mentioned."""
    arm, model, _ = example()
    said = [effect(arm, "torque_lag", 0, 0.0), effect(arm, "rotor_coupling", 1, 1.0)]
    dynamics = PlanarDynamics.from_model(arm, replace(model, effects=tuple(said)))
    assert dynamics.torque_lag is None
    np.testing.assert_array_equal(dynamics.coupling, 1.0)
    assert dynamics.laws == ()

# SPDX-License-Identifier: MIT
"""The arm in MuJoCo: bodies, gears, springs and a sampled servo, integrated by RK4 over mj_forward.

Nothing of the package's dynamics, plant or sensors is used, only its readers of files. The coordinates are two slides
and a hinge of the base, then for each joint the hinge of its rotor, which turns by n theta, and the hinge of its link,
q. Both sit on the body that carries the joint. The spring is a fixed tendon whose length is theta - q.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np
from numpy.typing import NDArray

from oracles.laws import Law, Local
from zygos.arm import Arm
from zygos.model.model import Body, JointModel, Model
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Scenario

Array = NDArray[np.float64]

STEP_S = 2.5e-3
"""Longest integration step, s. The arm's modes are slow (2.4 rad/s): energy closes to 1e-11 over a minute."""
TORQUE_STEP = 1e-4
"""A drive takes its command in the wire's steps, Nm."""
_LIGHTEST = 1e-9
"""MuJoCo moves no body without mass, kg."""

# An RK4 step of x'' = a(x, x'). Rows: stages 2, 3, 4 and the end. Columns: their shares of x, x' and a at the
# four stages, times 1, h and h^2 for positions, 1, 1 and h for rates.
_POSITION = np.array(
    [[1, 1 / 2, 0, 0, 0, 0], [1, 1 / 2, 1 / 4, 0, 0, 0], [1, 1, 0, 1 / 2, 0, 0], [1, 1, 1 / 6, 1 / 6, 1 / 6, 0]]
)
_RATE = np.array(
    [[0, 1, 1 / 2, 0, 0, 0], [0, 1, 0, 1 / 2, 0, 0], [0, 1, 0, 0, 1, 0], [0, 1, 1 / 6, 1 / 3, 1 / 3, 1 / 6]]
)
_WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


@dataclass(frozen=True)
class Balance:
    """Energy at each SYNC, J: what came in since the start, and what is there."""

    motor: Array
    """(n,) work of the commanded torques."""
    law: Array
    """(n,) work of the hidden laws; negative where they dissipate or store."""
    damper: Array
    """(n,) work of the joints' dampers, never positive."""
    kinetic: Array
    """(n,) of all bodies and rotors, summed body by body."""
    spring: Array
    """(n,) in the joints' own springs."""

    @property
    def gap(self) -> float:
        """Largest gap between what came in and what is there, as a share of the largest of the five."""
        there = self.kinetic + self.spring
        gap = there - there[0] - self.motor - self.law - self.damper
        parts = (self.motor, self.law, self.damper, self.kinetic, self.spring)
        return float(np.max(np.abs(gap)) / np.max(np.abs(parts)))


@dataclass(frozen=True)
class Motion:
    """The exact motion at n SYNC instants of an arm with N joints, and what its sensors say."""

    t: Array
    """(n,) s."""
    position: Array
    """(n, 3+2N) coordinates: x, y in m, phi, then n theta and q of each joint in rad."""
    rate: Array
    """(n, 3+2N) their rates."""
    ratio: Array
    """(N,) gear ratios."""
    tau: Array
    """(n, N) commanded rotor torque, held on [t_k, t_{k+1}), Nm."""
    offset: Array
    """(2, N) mounting offsets of link and motor encoders, rad, at most half a quantum."""
    cycles: Cycles
    balance: Balance | None
    """Of audited runs."""

    @property
    def phi0(self) -> Array:
        """(n,) base attitude, rad."""
        return self.position[:, 2]

    @property
    def omega0(self) -> Array:
        """(n,) base rate, rad/s."""
        return self.rate[:, 2]

    @property
    def q(self) -> Array:
        """(n, N) link angles, rad."""
        return self.position[:, 4::2]

    @property
    def qd(self) -> Array:
        """(n, N) link rates, rad/s."""
        return self.rate[:, 4::2]

    @property
    def theta(self) -> Array:
        """(n, N) motor angles after the gear, rad."""
        return np.asarray(self.position[:, 3::2] / self.ratio)

    @property
    def thetad(self) -> Array:
        """(n, N) motor rates after the gear, rad/s."""
        return np.asarray(self.rate[:, 3::2] / self.ratio)


class MujocoPlant:
    """An arm built from the bodies and joints of a model."""

    def __init__(self, arm: Arm, model: Model) -> None:
        """Compile the arm. Latch delays and joint frames other than the base's are not simulated but refused."""
        delays = [arm.imu.latch_us]
        for joint in arm.joints:
            delays += [joint.latch_us, joint.link_encoder.latch_us, joint.motor_encoder.latch_us]
        assert model.bodies and not any(delays), "the plant needs bodies, and sensors that latch at SYNC"
        assert np.array_equal(arm.frames, np.broadcast_to(np.eye(3), arm.frames.shape)), "frame_rpy is not simulated"
        bodies, joints, axis = model.bodies, model.joints, np.array(arm.axis)
        self.arm = arm
        self.model = mujoco.MjModel.from_xml_string(mjcf(arm, model))
        self.ratio = np.array([joint.gear_ratio for joint in arm.joints])
        self.stiffness = np.array([joint.stiffness.value for joint in joints])
        self.damping = np.array([joint.damping.value for joint in joints])
        self.mass = np.array([part.mass.value for part in bodies] + [_rotor_mass(joint) for joint in joints])
        """(2N+1,) of bodies, then of rotors, kg."""
        self.inertia = np.array(
            [axis @ body.tensor @ axis for body in bodies] + [joint.rotor_inertia.value for joint in joints]
        )
        """(2N+1,) about the mass centres, kg m^2."""
        # vectors across the axis as complex numbers, m
        first, second = _across(axis)
        plane = first + 1j * second
        self._centre = np.array([np.array(body.origin_xyz) @ plane for body in bodies])
        self._reach = np.array([np.array(body.joint_xyz) @ plane for body in bodies[:-1]])

    def _turning(self, columns: Array) -> Array:
        """(n, N+1) of the bodies, absolute, from coordinates or rates (n, 3+2N)."""
        return np.cumsum(np.concatenate([columns[:, 2:3], columns[:, 4::2]], axis=1), axis=1)

    def _points(self, position: Array, rate: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128], Array]:
        """(n, 2N+1) places and velocities of the mass centres, m and m/s, and turning rates, rad/s."""
        ahead, turn = np.exp(1j * self._turning(position)), self._turning(rate)
        reach, centre = self._reach * ahead[:, :-1], self._centre * ahead
        base, speed = position[:, :1] + 1j * position[:, 1:2], rate[:, :1] + 1j * rate[:, 1:2]
        origin = np.cumsum(np.concatenate([base, reach], axis=1), axis=1)
        moves = np.cumsum(np.concatenate([speed, 1j * turn[:, :-1] * reach], axis=1), axis=1)
        return (
            np.concatenate([origin + centre, origin[:, 1:]], axis=1),
            np.concatenate([moves + 1j * turn * centre, moves[:, 1:]], axis=1),
            np.concatenate([turn, turn[:, :-1] + rate[:, 3::2]], axis=1),
        )

    def kinetic_energy(self, position: Array, rate: Array) -> Array:
        """(n,) J, summed body by body."""
        _, speed, turn = self._points(position, rate)
        return np.asarray(0.5 * (self.mass * np.abs(speed) ** 2 + self.inertia * turn**2).sum(axis=1))

    def spring_energy(self, position: Array) -> Array:
        """(n,) J in the joints' own springs."""
        deflection = position[:, 3::2] / self.ratio - position[:, 4::2]
        return np.asarray(0.5 * (self.stiffness * deflection**2).sum(axis=1))

    def momentum(self, position: Array, rate: Array) -> tuple[NDArray[np.complex128], Array]:
        """(n,) linear momentum, kg m/s, and (n,) angular momentum about the mass centre, Nms."""
        place, speed, turn = self._points(position, rate)
        lever = place - (place @ self.mass)[:, None] / self.mass.sum()
        return speed @ self.mass, (lever.conj() * speed).imag @ self.mass + turn @ self.inertia

    def start(self, scenario: Scenario) -> tuple[Array, Array]:
        """(3+2N,) coordinates and rates: springs relaxed, joints and mass centre at rest, the momentum wanted."""
        position, rate = np.zeros((1, self.model.nv)), np.zeros((1, self.model.nv))
        if scenario.initial_angles_rad:
            position[0, 4::2] = scenario.initial_angles_rad
            position[0, 3::2] = self.ratio * position[0, 4::2]
        rate[0, 2] = 1.0
        rate[0, 2] = scenario.angular_momentum_nms / self.momentum(position, rate)[1][0]
        drift = self.momentum(position, rate)[0][0] / self.mass.sum()
        rate[0, :2] = -drift.real, -drift.imag
        return position[0], rate[0]

    def run(
        self,
        scenario: Scenario,
        laws: Sequence[Law] = (),
        *,
        seed: int = 0,
        noise: bool = True,
        audit: bool = False,
        step_s: float = STEP_S,
        duration_s: float | None = None,
    ) -> Motion:
        """Simulate the scenario in closed loop with the laws acting; `seed` is that of the sensors.

        Without noise, sensors are exact and drives do not round their torque. An audited run keeps its energy balance.
        """
        arm, period, servo = self.arm, self.arm.period_s, scenario.controller
        n = round((duration_s or scenario.duration_s) / period)
        substeps = math.ceil(period / step_s - 1e-9)
        t = period * np.arange(n, dtype=np.float64)
        desired, desired_rate = scenario.desired([joint.name for joint in arm.joints], t)
        sensors = Sensors(arm, n, seed) if noise else ExactSensors(arm, n)
        stepper = _Stepper(self, [copy.copy(law) for law in laws], period / substeps, audit)
        stepper.position[:], stepper.rate[:] = self.start(scenario)
        position, rate = np.empty((2, n, self.model.nv))
        tau, works = np.empty((n, arm.n)), np.empty((n, 3))
        before: Array | None = None
        for k in range(n):
            position[k], rate[k], works[k] = stepper.position, stepper.rate, stepper.works
            if servo.angle == "motor":
                angle = sensors.angle(1, position[k, 3::2] / self.ratio)
            else:
                angle = sensors.angle(0, position[k, 4::2])
            slope = 0.0 if before is None else (angle - before) / period
            before = angle
            wanted = servo.gain * (servo.kp * (desired[k] - angle) + servo.kd * (desired_rate[k] - slope))
            tau[k] = sensors.command(wanted / self.ratio)
            stepper.hold(tau[k])
            for _ in range(substeps):
                stepper.step()
        if not np.isfinite(rate).all():
            raise FloatingPointError(f"scenario {scenario.name}: the motion diverges")
        balance = None
        if audit:
            motor, law, damper = works.T
            kinetic, spring = self.kinetic_energy(position, rate), self.spring_energy(position)
            balance = Balance(motor, law, damper, kinetic, spring)
        cycles = sensors.record(position[:, 4::2], position[:, 3::2] / self.ratio, tau, rate[:, 2])
        return Motion(t, position, rate, self.ratio, tau, sensors.offset, cycles, balance)


class _Stepper:
    """RK4 on MuJoCo's state. Held torques and those of the laws are applied forces."""

    def __init__(self, plant: MujocoPlant, laws: list[Law], h: float, audit: bool) -> None:
        self.model, self.data = plant.model, mujoco.MjData(plant.model)
        self.position, self.rate = self.data.qpos, self.data.qvel
        self.held = np.zeros(plant.model.nv)
        self.works = np.zeros(3)
        """Of motors, laws and dampers since the start, J; kept by an audit."""
        self._laws = [(law, _direction(plant, law)) for law in laws]
        self._plant, self._h, self._audit = plant, h, audit
        self._to_position = list(_POSITION * [1.0, h, h**2, h**2, h**2, h**2])
        self._to_rate = list(_RATE * [1.0, 1.0, h, h, h, h])
        self._stages = np.zeros((6, plant.model.nv))

    def hold(self, tau: Array) -> None:
        """Command rotor torques (N,), Nm, until further notice."""
        self.held[3::2] = tau
        self.data.qfrc_applied[:] = self.held

    def step(self) -> None:
        """Advance by h."""
        stages, acceleration = self._stages, self.data.qacc
        stages[0], stages[1] = self.position, self.rate
        for law, _ in self._laws:
            law.begin(self._local(law))
        for stage in range(4):
            if self._laws:
                self._apply(_WEIGHTS[stage])
            mujoco.mj_forwardSkip(self.model, self.data, mujoco.mjtStage.mjSTAGE_NONE, 1)
            if self._audit:
                slip = self.data.ten_velocity
                self.works[0] += self._h * _WEIGHTS[stage] * (self.held @ self.rate)
                self.works[2] -= self._h * _WEIGHTS[stage] * (self._plant.damping @ slip**2)
            stages[2 + stage] = acceleration
            np.dot(self._to_position[stage], stages, out=self.position)
            np.dot(self._to_rate[stage], stages, out=self.rate)
        for law, _ in self._laws:
            law.end(self._local(law))

    def _apply(self, weight: float) -> None:
        applied = self.data.qfrc_applied
        applied[:] = self.held
        for law, direction in self._laws:
            torque = law.torque(self._local(law)) * direction
            applied += torque
            if self._audit:
                self.works[1] += self._h * weight * (torque @ self.rate)

    def _local(self, law: Law) -> Local:
        position, rate, i = self.position.item, self.rate.item, law.joint
        ratio, rotor, link = self._plant.ratio.item(i), 3 + 2 * i, 4 + 2 * i
        return Local(
            phi=position(2),
            q=position(link),
            qd=rate(link),
            theta=position(rotor) / ratio,
            thetad=rate(rotor) / ratio,
            stiffness=self._plant.stiffness.item(i),
            command=self.held.item(rotor),
            step=self._h,
        )


def _direction(plant: MujocoPlant, law: Law) -> Array:
    """(3+2N,) of a law's torque in the plant's coordinates."""
    direction, rotor, link = np.zeros(plant.model.nv), 3 + 2 * law.joint, 4 + 2 * law.joint
    if law.where == "motor":
        direction[rotor] = 1.0
    elif law.where == "link":
        direction[link] = 1.0
    elif law.where == "spring":
        direction[link], direction[rotor] = 1.0, -1.0 / plant.ratio[law.joint]
    else:
        direction[2] = 1.0
    return direction


class ExactSensors:
    """Sensors and drives without error. Encoders come in two rows: of the links, of the motors."""

    def __init__(self, arm: Arm, cycles: int) -> None:
        """For a run of that many cycles."""
        encoders = [[joint.link_encoder for joint in arm.joints], [joint.motor_encoder for joint in arm.joints]]
        self.arm, self.n = arm, cycles
        self.sign = np.array([[float(encoder.sign) for encoder in row] for row in encoders])
        self.zero = np.array([[encoder.zero_rad for encoder in row] for row in encoders])
        self.quantum = np.array([[encoder.quantum_rad for encoder in row] for row in encoders])
        self.offset = np.zeros_like(self.zero)

    def reading(self, row: int, angle: Array) -> Array:
        """(..., N) of the encoders of a row at the joints' angles, rad."""
        return np.asarray(self.sign[row] * angle + self.zero[row])

    def angle(self, row: int, angle: Array) -> Array:
        """(N,) what the servo makes of the readings, rad."""
        return np.asarray(self.sign[row] * (self.reading(row, angle) - self.zero[row]))

    def command(self, tau: Array) -> Array:
        """(N,) torque in force where the servo asks for tau, Nm."""
        return tau

    def errors(self) -> tuple[Array, Array]:
        """Of the run's torques (n, N), Nm, and of its gyro (n, 3), rad/s."""
        return np.zeros((self.n, self.arm.n)), np.zeros((self.n, 3))

    def record(self, q: Array, theta: Array, tau: Array, omega0: Array) -> Cycles:
        """What the run leaves behind."""
        torque, gyro = self.errors()
        if self.arm.torque_law == "applied_previous_cycle":
            tau = np.concatenate([np.zeros_like(tau[:1]), tau[:-1]])
        return Cycles(
            sync=np.arange(self.n, dtype=np.uint64),
            q=self.reading(0, q),
            theta=self.reading(1, theta),
            tau=tau + torque,
            omega=omega0[:, None] * (self.arm.mount.T @ self.arm.axis) + gyro,
            flags=np.zeros(self.n, dtype=np.uint32),
        )


class Sensors(ExactSensors):
    """Encoders that round, each mounted off by a part of its quantum; a noisy gyro whose bias walks."""

    def __init__(self, arm: Arm, cycles: int, seed: int) -> None:
        """For a run of that many cycles, with errors of their own for every seed."""
        super().__init__(arm, cycles)
        self._random = np.random.default_rng([seed, 1757])
        self.offset = self.quantum * self._random.uniform(-0.5, 0.5, self.quantum.shape)

    def reading(self, row: int, angle: Array) -> Array:
        quantum = self.quantum[row]
        return np.asarray(quantum * np.rint((super().reading(row, angle) + self.offset[row]) / quantum))

    def command(self, tau: Array) -> Array:
        return np.asarray(TORQUE_STEP * np.rint(tau / TORQUE_STEP))

    def errors(self) -> tuple[Array, Array]:
        imu, normal = self.arm.imu, self._random.standard_normal
        torque = normal((self.n, self.arm.n)) * [joint.torque_sigma for joint in self.arm.joints]
        bias = np.cumsum(imu.bias_walk * math.sqrt(self.arm.period_s) * normal((self.n, 3)), axis=0)
        return torque, imu.rate_sigma * normal((self.n, 3)) + bias


def mjcf(arm: Arm, model: Model) -> str:
    """The arm as MJCF: no weight, no contact, no limit."""
    axis = np.array(arm.axis)
    first, second = _across(axis)
    root, tendons = Element("mujoco"), Element("tendon")
    SubElement(root, "compiler", angle="radian")
    option = SubElement(root, "option", gravity="0 0 0")
    unused = "constraint contact equality frictionloss limit gravity warmstart sensor actuation autoreset island"
    SubElement(option, "flag", {name: "disable" for name in unused.split()})
    parent, place = SubElement(root, "worldbody"), (0.0, 0.0, 0.0)
    for i, part in enumerate(model.bodies):
        body = SubElement(parent, "body", name=part.name, pos=_text(place))
        if i == 0:
            SubElement(body, "joint", type="slide", axis=_text(first))
            SubElement(body, "joint", type="slide", axis=_text(second))
        SubElement(body, "joint", name=f"q{i}", type="hinge", axis=_text(axis))
        SubElement(body, "inertial", _inertial(part))
        if part.joint_xyz is None:
            continue
        drive, place, parent = model.joints[i], part.joint_xyz, body
        rotor = SubElement(body, "body", pos=_text(place))
        SubElement(rotor, "joint", name=f"rotor{i + 1}", type="hinge", axis=_text(axis))
        # in the plane only the moment about the axis acts; the others are as for a sphere
        moments = _text([drive.rotor_inertia.value] * 3)
        SubElement(rotor, "inertial", pos="0 0 0", mass=repr(_rotor_mass(drive)), diaginertia=moments)
        spring = {"stiffness": repr(drive.stiffness.value), "damping": repr(drive.damping.value), "springlength": "0"}
        tendon = SubElement(tendons, "fixed", spring)
        SubElement(tendon, "joint", joint=f"rotor{i + 1}", coef=repr(1.0 / arm.joints[i].gear_ratio))
        SubElement(tendon, "joint", joint=f"q{i + 1}", coef="-1")
    root.append(tendons)
    return tostring(root, encoding="unicode")


def _inertial(body: Body) -> dict[str, str]:
    ixx, ixy, ixz, iyy, iyz, izz = (entry.value for entry in body.inertia)
    moments = _text([ixx, iyy, izz, ixy, ixz, iyz])
    return {"pos": _text(body.origin_xyz), "mass": repr(body.mass.value), "fullinertia": moments}


def _rotor_mass(joint: JointModel) -> float:
    return max(joint.rotor_mass.value, _LIGHTEST)


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed frame with the axis."""
    first = np.cross(np.roll(np.eye(3)[np.argmax(np.abs(axis))], 1), axis)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _text(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)

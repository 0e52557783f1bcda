# SPDX-License-Identifier: MIT
"""What the hardware is: joints, encoders, gyro, timing and declared noise (`arm.toml`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.cutoff import HALF_WIDTH_MAX, periods, window
from zygos.errors import ZygosError
from zygos.files.output import write_text
from zygos.files.toml import Table

if TYPE_CHECKING:
    from zygos.structure import Structure

Base = Literal["free", "fixed"]
Kinetic = Literal["planar-symmetric", "planar", "spatial"]
TorqueLaw = Literal["applied_from_sync", "applied_previous_cycle", "sampled"]

Side = Literal["output", "rotor"]
TorqueAt = Literal["rotor", "joint"]
TorqueUnit = Literal["Nm", "A"]
Symbol = Literal[
    "N", "a", "b", "G", "m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "Im", "k"
]  # fmt: skip
Resolution = Literal["fine", "coarse"]

Floats = NDArray[np.float64]

_BASES: tuple[Base, ...] = ("free", "fixed")
OF_CURRENTS = {
    "Nm": "A",
    "Nms/rad": "As/rad",
    "Nm/rad": "A/rad",
    "kg m^2": "A s^2",
    "kg m": "A s^2/m",
    "kg": "A s^2/m^2",
    "J": "A rad",
}
"""Units of quantities that are known in proportion to the torque constant of the first joint only."""
_KINETICS: tuple[Kinetic, ...] = ("planar-symmetric", "planar", "spatial")
_SIDES: tuple[Side, ...] = ("output", "rotor")
_TORQUE_ATS: tuple[TorqueAt, ...] = ("rotor", "joint")
_TORQUE_UNITS: tuple[TorqueUnit, ...] = ("Nm", "A")
_RESOLUTIONS: tuple[Resolution, ...] = ("fine", "coarse")
_TORQUE_LAWS: tuple[TorqueLaw, ...] = ("applied_from_sync", "applied_previous_cycle", "sampled")
ANGLE_STEP = 2.0 * math.pi / 2**20
"""Step of an angle in a CAN frame, rad (docs/wire.md)."""
TORQUE_STEP = 1e-4
"""Step of a torque in a CAN frame, Nm."""
RATE_STEPS: dict[Resolution, float] = {"fine": 2.0**-21, "coarse": 2.0**-13}
"""Step of a rate in a CAN frame, rad/s, by the resolution of the gyro."""
TORQUE_GAIN_SIGMA = 0.01
"""Standard deviation of the error of a torque sensor's gain of which the arm file says nothing, as a share."""

MOMENTUM_ARC_S = 10.0
"""Longest arc of the momentum rows of an arm that has them by default, s."""
_LATCH_MAX_US = 65_535  # the CAN frame carries the latch delay as u16
JOINT_ROW_S = 0.2
"""Length of the increments of the joint rows of an arm that has them by default, s."""
_FARTHEST_M = 1e6
MOST_JOINTS = 31
"""Number of CAN nodes that joints can have."""
HIGHEST_ORDER = 8
"""Highest order of the smoother's polynomial."""
_SHORTEST_MEMORY = 2
"""Shortest memory, as a number of arcs."""


def rounded(sigma: float, step: float) -> float:
    """Standard deviation of the error of readings that are then rounded to a step: theirs, and one uniform over it."""
    return math.hypot(sigma, step / math.sqrt(12.0))


@dataclass(frozen=True)
class Encoder:
    """An angle encoder. The angle of the joint is ``sign * (reading - zero_rad)``, always after the gear."""

    quantum_rad: float
    """Step of the reading in rad, referred to the gear's output side."""
    counts: int | None = None
    """Steps per turn of the encoder's own disc; None where the file states the quantum itself."""
    side: Side = "output"
    sign: int = 1
    zero_rad: float = 0.0
    zero_sigma_rad: float = 0.0
    """Standard deviation of `zero_rad`, rad. Above 0 the joint's spring is estimated with an offset."""
    latch_us: int = 0
    """Delay of this encoder's latch after SYNC in µs, on top of the joint's."""

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of a uniform error one quantum wide, rad (Nanos & Papadopoulos eq. (28);
        docs/paper-tables.md, erratum 4)."""
        return self.quantum_rad / math.sqrt(12.0)

    @property
    def zero_uncertainty_rad(self) -> float:
        """Standard deviation of `zero_rad` where all readings are used, rad: an encoder is mounted to a step at best,
        whatever the file states of its zero."""
        return max(self.zero_sigma_rad, self.quantum_rad)

    @property
    def over_the_wire(self) -> Encoder:
        """The same encoder with the error that its readings have after rounding to the steps of the CAN frame
        (docs/wire.md).

        An encoder without a quantum stays exact, so that its declared noise remains zero.
        """
        if self.quantum_rad == 0.0:
            return self
        steps = self.quantum_rad / ANGLE_STEP
        # readings that lie on the steps of the CAN frame are not rounded again
        aligned = steps > 0.5 and abs(steps - round(steps)) < 1e-6
        return self if aligned else replace(self, quantum_rad=math.hypot(self.quantum_rad, ANGLE_STEP))


@dataclass(frozen=True)
class Joint:
    """One revolute joint with its motor, gear and both encoders."""

    name: str
    node: int
    """CAN node number, 1..31."""
    axis: tuple[float, float, float]
    """Unit vector of the joint axis in the joint frame."""
    frame_rpy: tuple[float, float, float]
    """Attitude of the joint frame in the carrying body, rad, as URDF's <origin rpy>."""
    gear_ratio: float
    link_encoder: Encoder
    """Encoder of the link angle. A rigid joint has the motor's encoder here as well, which then measures both
    angles."""
    motor_encoder: Encoder
    torque_sigma: float = 0.0
    """Standard deviation of the reported torque, Nm, on its side of the gear."""
    torque_relative_sigma: float = 0.0
    """Standard deviation of the reported torque as a share of its size. Both deviations add in squares."""
    torque_gain_sigma: float = 0.0
    """Standard deviation of the error of the torque sensor's gain, as a share. 0: the gain is exact. An arm file that
    does not state it means `TORQUE_GAIN_SIGMA`."""
    latch_us: int = 0
    """Delay of both encoders' latch after SYNC in µs, as stated in the CAN frame."""
    flexible: bool = True
    """Whether the joint has a spring; a rigid one has theta = q, and neither stiffness nor damping."""
    position_m: tuple[float, float, float] | None = None
    """Origin of the joint's frame in the frame of the joint before, m, as URDF's <origin xyz>; None: not known."""

    @property
    def unsure_zero(self) -> bool:
        """Whether the encoders may disagree about where theta = q: one of their zeros has a standard deviation above
        0."""
        return self.flexible and max(self.link_encoder.zero_sigma_rad, self.motor_encoder.zero_sigma_rad) > 0.0

    @property
    def over_the_wire(self) -> Joint:
        """The same joint with the errors that its readings have after rounding to the steps of the CAN frames."""
        return replace(
            self,
            link_encoder=self.link_encoder.over_the_wire,
            motor_encoder=self.motor_encoder.over_the_wire,
            torque_sigma=rounded(self.torque_sigma, TORQUE_STEP),
        )


@dataclass(frozen=True)
class Imu:
    """The base's rate gyro."""

    node: int
    """CAN node number, 1..31; 0 where there is no gyro, as on a fixed base."""
    mount_xyzw: tuple[float, float, float, float]
    """Rotation from the sensor's frame to the base's, scalar last."""
    rate_sigma: float
    """White noise of one sample, rad/s: sigma_v / sqrt(period)."""
    bias_walk: float
    """Random walk of the bias, rad/s^1.5: one step is bias_walk * sqrt(period)."""
    latch_us: int = 0
    resolution: Resolution = "fine"

    @property
    def step(self) -> float:
        """Step of its rates on the wire, rad/s."""
        return RATE_STEPS[self.resolution]

    @property
    def over_the_wire(self) -> Imu:
        """The same gyro with the error that its readings have after rounding to the steps of the CAN frames.

        Node 0 is no gyro, and stays as it is.
        """
        if self.node == 0:
            return self
        return replace(self, rate_sigma=rounded(self.rate_sigma, self.step))


NO_IMU = Imu(node=0, mount_xyzw=(0.0, 0.0, 0.0, 1.0), rate_sigma=0.0, bias_walk=0.0)
"""The gyro entry of an arm with a fixed base: the rate of the base is zero, and no node sends it."""


@dataclass(frozen=True)
class Smoother:
    """The fixed-lag Savitzky-Golay filter of the estimator."""

    points: int = 7
    order: int = 4
    lag: int = 3
    cutoff_hz: float | None = None
    """Frequency at which its rates are 3 dB below the true ones, Hz, from which points and order were found; None: the
    arm file states points and order."""


@dataclass(frozen=True)
class Parameter:
    """An identified parameter (docs/theory.md)."""

    symbol: Symbol
    """b is a damping where it belongs to a joint."""
    unit: str
    ends: tuple[str, ...] = ()
    """Of a parameter of bodies: the two bodies of a and b, such as "0" and "1"; the two directions of N, such as "0x"
    and "1u"; the direction of G; the body of mass, first moments and inertias."""
    joint: int | None = None
    """From 0; None: it is a parameter of bodies."""

    @property
    def name(self) -> str:
        """As files and tables have it: N[0x,1u], a01, G[1u], mx2, Izz2, Im1."""
        if self.joint is not None:
            return f"{self.symbol}{self.joint + 1}"
        return (
            f"{self.symbol}[{','.join(self.ends)}]" if self.symbol in ("N", "G") else self.symbol + "".join(self.ends)
        )


@dataclass(frozen=True)
class Arm:
    """The hardware as `arm.toml` describes it; no masses, no lengths."""

    name: str
    base: Base
    kinetic: Kinetic
    period_s: float
    """SYNC period, s."""
    torque_law: TorqueLaw
    torque_at: TorqueAt
    joints: tuple[Joint, ...]
    imu: Imu
    smoother: Smoother = Smoother()
    arc_max_s: float = 60.0
    impulse_arc_s: float = 10.0
    """Longest arc of the motor impulse rows, s; 0 switches these rows off. Their noise accumulates over an arc."""
    memory_s: float | None = None
    """Time in which the contribution of a closed arc to the estimate fades to 1/e, s; None: it does not fade."""
    compensate_every: int | None = None
    """Interval of the noise compensation in cycles: the contribution of sensor noise to the normal equations is
    subtracted, for each sensor once in that many cycles. 0: it is not subtracted. None: `compensation` applies."""
    momentum_max_s: float | None = None
    """Longest arc of the momentum rows of a floating base, s; 0 switches these rows off. None: `momentum_arc_s`."""
    joint_increment_s: float | None = None
    """Length of the increments of the joint rows, s; 0 switches these rows off. None: `joint_row_s`."""
    torque_unit: TorqueUnit = "Nm"
    """Unit of the reported torques. "A": they are motor currents, whose torque constants nobody knows."""
    torque_averaged: bool = False
    """Whether a sampled torque is the mean over the period about its instant."""
    torque_scale_sigma: float = 0.0
    """Standard deviation of the error that all torques have in common, as a share of them. No run shows it. 0: nothing
    is known of it, and no interval contains it."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Gravity in the base frame, m/s^2, for a fixed base; a free-floating arm falls with its orbit and feels none."""
    nadir: tuple[float, float, float] | None = None
    """Unit vector to the centre of the Earth, in the axes that the base has at the start of each run, of an arm that
    floats in space; None: not known. Only the gravity gradient needs it."""

    @property
    def free(self) -> bool:
        """Whether the base floats."""
        return self.base == "free"

    @cached_property
    def over_the_wire(self) -> Arm:
        """The same arm with the errors that the readings of its sensors have after rounding to the steps of the CAN
        frames: a variance of step^2/12 is added, except to encoder readings that lie on these steps (docs/wire.md)."""
        return replace(self, joints=tuple(joint.over_the_wire for joint in self.joints), imu=self.imu.over_the_wire)

    @property
    def compensation(self) -> int:
        """Cycles between two compensations of the same sensor; by default one sensor is compensated in each cycle, or
        one axis of the gyro in space."""
        axes = 3 if self.free and self.spatial else 1
        return 2 * self.n + axes if self.compensate_every is None else self.compensate_every

    @property
    def momentum_arc_s(self) -> float:
        """Longest arc of the momentum rows, s; 0 switches these rows off. The default is 10 s for an arm that floats in
        space, where these rows separate the inertias. The base's attitude is integrated over an arc, with the gyro's
        bias."""
        default = MOMENTUM_ARC_S if self.free and self.spatial else 0.0
        return default if self.momentum_max_s is None else self.momentum_max_s

    @property
    def grounded(self) -> bool:
        """Whether the base is fixed and no joint has a spring: the joint rows alone then determine all parameters."""
        return not self.free and not any(joint.flexible for joint in self.joints)

    @property
    def joint_row_s(self) -> float:
        """Length of the increments of the joint rows, s; 0 switches these rows off. By default only an arm with a fixed
        base and rigid joints has them."""
        default = JOINT_ROW_S if self.grounded else 0.0
        return default if self.joint_increment_s is None else self.joint_increment_s

    @property
    def spatial(self) -> bool:
        """Whether the arm moves in space, not in a plane."""
        return self.kinetic == "spatial"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def gear_ratios(self) -> NDArray[np.float64]:
        """(N,) ratios between the torques that are reported and those at the joints: 1 where they are measured behind
        the gear, and the gear ratios elsewhere."""
        if self.torque_at == "joint":
            return np.ones(self.n)
        return np.array([joint.gear_ratio for joint in self.joints])

    @property
    def held_s(self) -> float:
        """h/12 where torques are held between SYNCs, else 0 [s]: a smooth curve through samples of a held torque's
        motion has rates that are so many times the jump of the acceleration too high (docs/theory.md)."""
        return 0.0 if self.torque_law == "sampled" else self.period_s / 12.0

    @property
    def impulse_s(self) -> float:
        """By how much an impulse, the integral of a torque, is larger for each change of the torque from one cycle to
        the next at its end [s]: `held_s`, and -h/8 of means over the period about an instant, because the trapezoid
        rule takes the half of the last one from both sides of the end."""
        return -self.period_s / 8.0 if self.torque_averaged else self.held_s

    @property
    def gain_reference(self) -> int:
        """The joint (from 0) to whose torque sensor the gains of the others are relative: the first of the most exact
        ones."""
        sigmas = [joint.torque_gain_sigma for joint in self.joints]
        return sigmas.index(min(sigmas))

    @property
    def relative_gains(self) -> tuple[int, ...]:
        """The joints (from 0) whose torque sensors have a gain that is estimated, relative to `gain_reference`."""
        reference = self.gain_reference
        return tuple(i for i, joint in enumerate(self.joints) if i != reference and joint.torque_gain_sigma > 0.0)

    @property
    def relative_gain_covariance(self) -> NDArray[np.float64]:
        """(g, g) what is known of the errors of `relative_gains` beforehand: each is the error of the reference's gain
        less its own, up to squares."""
        sigma = np.array([joint.torque_gain_sigma for joint in self.joints])
        own = sigma[list(self.relative_gains)]
        return np.asarray(np.diag(own**2) + sigma[self.gain_reference] ** 2, dtype=np.float64)

    @cached_property
    def structure(self) -> Structure:
        """Which parameters are independent of each other. Errors: ZygosError if the geometry leaves that open."""
        from zygos.structure import structure_of  # noqa: PLC0415  (a structure has parameters of an arm)

        return structure_of(self)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The identified parameters in the order of every row and output: those of bodies, then those of joints.

        They are independent of each other: some motion determines each of them, and no motion determines more
        (docs/theory.md, "Structural base parameters"). Errors: as `structure`.
        """
        return self.structure.parameters

    @cached_property
    def full_parameters(self) -> tuple[Parameter, ...]:
        """The parameters of an arm whose axes are in general position and whose lengths are not known: those of bodies,
        then those of joints.

        In space these are N[ia,jb], the upper triangle over 0x 0y 0z 1u 1v .. Nu Nv; in a plane a_ij, then b_ij. On a
        fixed base those of body 0 are absent, and the first moments G[iu], G[iv] that gravity can move are added
        (docs/theory.md). Every joint has Im, and a flexible one also k and b; the rotor of a rigid first joint on a
        fixed base turns with its link alone, so its inertia is part of the link's.
        """
        first = 0 if self.free else 1
        bodies = [str(i) for i in range(first, self.n + 1)]
        listed: list[Parameter] = []
        if self.spatial:
            vectors = [f"0{axis}" for axis in "xyz" if self.free] + [
                f"{i}{p}" for i in range(1, self.n + 1) for p in "uv"
            ]
            pairs = [(a, b) for k, a in enumerate(vectors) for b in vectors[k:]]
            # with the base fixed, the first body turns about its axis only: two of its three entries have no effect
            pairs = [pair for pair in pairs if self.free or pair not in (("1u", "1v"), ("1v", "1v"))]
            listed += [Parameter("N", "kg m^2", pair) for pair in pairs]
        else:
            pairs = [(a, b) for k, a in enumerate(bodies) for b in bodies[k:]]
            listed += [Parameter("a", "kg m^2", pair) for pair in pairs]
            if self.kinetic == "planar":
                listed += [Parameter("b", "kg m^2", (a, b)) for a, b in pairs if a != b]
        for i in range(self.n):
            if self.feels_gravity[i]:
                listed += [Parameter("G", "kg m", (f"{i + 1}{p}",)) for p in "uv"]
        for i, joint in enumerate(self.joints):
            if joint.flexible or self.free or i > 0:
                listed.append(Parameter("Im", "kg m^2", joint=i))
            if joint.flexible:
                listed += [Parameter("k", "Nm/rad", joint=i), Parameter("b", "Nms/rad", joint=i)]
        return tuple(listed)

    @cached_property
    def body_parameters(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of the parameters that bodies have, before those of the joints."""
        return tuple((one.name, one.unit) for one in self.parameters if one.joint is None)

    @cached_property
    def joint_parameters(self) -> tuple[tuple[str, int, str], ...]:
        """Symbol, joint (from 0) and unit of the joint parameters."""
        return tuple((one.symbol, one.joint, one.unit) for one in self.parameters if one.joint is not None)

    @cached_property
    def full_names(self) -> tuple[str, ...]:
        """Name of each of `full_parameters`."""
        return tuple(one.name for one in self.full_parameters)

    @cached_property
    def full_body_names(self) -> tuple[str, ...]:
        """Names of those of `full_parameters` that bodies have."""
        return tuple(one.name for one in self.full_parameters if one.joint is None)

    @cached_property
    def full_joint_parameters(self) -> tuple[tuple[str, int], ...]:
        """Symbol and joint (from 0) of those of `full_parameters` that joints have."""
        return tuple((one.symbol, one.joint) for one in self.full_parameters if one.joint is not None)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Name of each of `parameters`."""
        return tuple(one.name for one in self.parameters)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Unit of each of `parameters`."""
        return tuple(self.unit(one.unit) for one in self.parameters)

    def unit(self, unit: str) -> str:
        """What a unit becomes where the torques are motor currents: a torque of the first joint is counted in amperes,
        and what follows from it, such as an inertia, in what amperes give."""
        return OF_CURRENTS.get(unit, unit) if self.torque_unit == "A" else unit

    @cached_property
    def feels_gravity(self) -> tuple[bool, ...]:
        """(N,) whether gravity does work on the first moment of the body after each joint as the joints move. It does
        not while every axis up to that joint is vertical."""
        gravity = np.array(self.gravity)
        weight = float(np.linalg.norm(gravity))
        if self.free or weight == 0.0:
            return (False,) * self.n
        axes = self.axes if self.spatial else np.tile(self.axis, (self.n, 1))
        tilted = np.linalg.norm(np.cross(axes, gravity / weight), axis=1) > 1e-9
        return tuple(bool(tilted[: i + 1].any()) for i in range(self.n))

    def at_period(self, period_s: float) -> Arm:
        """The same hardware at another SYNC period (s). The gyro's white noise keeps its density, so that the
        deviation of one sample grows as the period shrinks, and a declared cut-off is kept. Errors: ZygosError if the
        period is not positive, does not allow that cut-off, or if a latch would fall into the following period."""
        latest = max(
            [self.imu.latch_us]
            + [
                joint.latch_us + encoder.latch_us
                for joint in self.joints
                for encoder in (joint.link_encoder, joint.motor_encoder)
            ]
        )
        if not (_within(latest, period_s) and period_s < math.inf):
            raise ZygosError(
                f"arm {self.name}: period {period_s!r} s is not longer than the latest latch "
                f"({latest} µs); remedy: choose a longer period_s"
            )
        sigma = self.imu.rate_sigma * math.sqrt(self.period_s / period_s)
        smoother = self.smoother
        if smoother.cutoff_hz is not None:
            smoother = smoother_at(smoother.cutoff_hz, period_s)
        return replace(self, period_s=period_s, imu=replace(self.imu, rate_sigma=sigma), smoother=smoother)

    @cached_property
    def frames(self) -> NDArray[np.float64]:
        """(N+1, 3, 3) attitudes of the bodies in the base frame at zero joint angles."""
        attitudes = [np.eye(3)]
        for joint in self.joints:
            attitudes.append(attitudes[-1] @ Rotation.from_euler("xyz", joint.frame_rpy).as_matrix())
        return np.array(attitudes)

    @cached_property
    def axes(self) -> NDArray[np.float64]:
        """(N, 3) joint axes in the base frame at zero joint angles."""
        directions: NDArray[np.float64] = np.einsum(
            "jab,jb->ja", self.frames[1:], np.array([joint.axis for joint in self.joints])
        )
        return directions

    @cached_property
    def across(self) -> NDArray[np.float64]:
        """(N, 3, 2) two directions across the axis of each joint, in the joint's frame."""
        return np.array([across(np.array(joint.axis)) for joint in self.joints])

    @cached_property
    def axis(self) -> NDArray[np.float64]:
        """(3,) the planar arm's common joint axis in the base frame. Errors: ZygosError if the axes are not parallel
        with the same sense."""
        axes = self.axes
        if np.max(np.abs(axes - axes[0])) > 1e-9:
            raise ZygosError(
                f"arm {self.name}: the joint axes are not parallel with the same sense, but kinetic is "
                f'"{self.kinetic}"; remedy: write kinetic = "spatial", or correct axis or frame_rpy (a reversed '
                "encoder has sign = -1)"
            )
        common: NDArray[np.float64] = axes[0]
        return common

    @cached_property
    def mount(self) -> NDArray[np.float64]:
        """(3, 3) rotation matrix of the gyro's mount: base rate = mount @ sensor rate."""
        matrix: NDArray[np.float64] = Rotation.from_quat(self.imu.mount_xyzw).as_matrix()
        return matrix


def across(axis: Floats) -> Floats:
    """P, shape (3, 2): two unit vectors across a unit vector axis (3,).

    The reflection that takes the axis to its largest component k takes e_k+1 and e_k+2 (cyclically) to these; an axis
    along x, y or z has the next two axes.
    """
    largest = int(np.argmax(np.abs(axis)))
    mirror = axis + np.copysign(1.0, axis[largest]) * np.eye(3)[largest]
    reflection = np.eye(3) - 2.0 * np.outer(mirror, mirror) / (mirror @ mirror)
    return np.asarray(reflection[:, [(largest + 1) % 3, (largest + 2) % 3]], dtype=np.float64)


def load_arm(path: str | Path) -> Arm:
    """Read `arm.toml`. Errors: ZygosError naming file, key and remedy for anything unknown, missing, of the wrong
    type or out of range."""
    return read_arm(Table.load(path, "an arm file"))


def read_arm(top: Table) -> Arm:
    """The arm of a table with the keys of `arm.toml`. Errors: as `load_arm`."""
    joints = tuple(
        read_joint(table) for table in top.tables("joint", "The joints, in the order from the base to the tip.")
    )
    base = top.choice("base", "Whether the base floats freely or stands on the ground.", _BASES)
    if base == "fixed" and top.has("imu"):
        raise top.error("imu", "a fixed base has no rate to measure", 'remove [imu], or write base = "free"')
    arc = top.table("arc", "How long the arcs are over which the estimator balances energy.", optional=True)
    if base == "fixed" and arc.has("momentum_max_s"):
        raise arc.error("momentum_max_s", "a fixed base takes up momentum", 'remove it, or write base = "free"')
    if base == "free" and top.has("gravity"):
        raise top.error("gravity", "a free-floating arm feels no gravity", 'remove it, or write base = "fixed"')
    kinetic = top.choice(
        "kinetic",
        'How the arm moves. "spatial": the axes have any direction. "planar": all axes are parallel. '
        '"planar-symmetric": as "planar", and the mass centre of each body lies on the line between its joints; '
        'under gravity it is read as "planar".',
        _KINETICS,
    )
    imu = NO_IMU
    if base == "free":
        imu = _imu(
            top.table("imu", "The rate gyro of the base.", otherwise='required where base is "free", refused elsewhere')
        )
    gravity: tuple[float, ...] = (0.0, 0.0, 0.0)
    if base == "fixed":
        gravity = top.vector(
            "gravity",
            "Acceleration of gravity in the frame of the base.",
            3,
            limit=1e3,
            unit="m/s^2",
            otherwise='required where base is "fixed", refused elsewhere',
        )
    # the wire's drop-out rules and the latch delay (u16 µs) hold up to a SYNC period of 65 ms
    period_s = top.number("period_s", "Period of the SYNC message.", above=0.0, high=0.065, unit="s")
    arm = Arm(
        name=top.text("name", "Name of the arm, for tables and messages."),
        base=base,
        kinetic=kinetic,
        period_s=period_s,
        torque_law=top.choice(
            "torque_law",
            'When a reported torque acts. "applied_from_sync": from the SYNC of its cycle to the next SYNC. '
            '"applied_previous_cycle": during the cycle before. "sampled": the torque varies continuously, and this '
            "is its value at the SYNC.",
            _TORQUE_LAWS,
        ),
        torque_at=top.choice(
            "torque_at",
            'Where torques are reported. "rotor": before the gear. "joint": by a sensor behind the gear, for arms of '
            "rigid joints; such a torque holds neither the rotor's inertia nor the gear ratio.",
            _TORQUE_ATS,
        ),
        torque_unit=top.choice(
            "torque_unit",
            'Unit of the reported torques. "A": the values are motor currents with unknown torque constants; estimates '
            "are then relative to the first joint.",
            _TORQUE_UNITS,
            "Nm",
        ),
        torque_averaged=top.boolean(
            "torque_averaged",
            'Whether the torques, with the torque_law "sampled", are means over the period about the SYNC, as `zygos '
            "convert` makes them of a faster recording. Friction is then averaged likewise in estimates on the ground.",
            False,
        ),
        torque_scale_sigma=top.number(
            "torque_scale_sigma",
            "Standard deviation of the error that all torques have in common, as a share of them, by a calibration. No "
            "run shows it. The interval of a payload contains it.",
            0.0,
            low=0.0,
            high=1.0,
            unit="1",
        ),
        joints=joints,
        imu=imu,
        smoother=_smoother(
            top.table("smoother", "The Savitzky-Golay filter of the estimator.", optional=True), period_s
        ),
        arc_max_s=arc.number("max_s", "Longest arc of the energy balance.", 60.0, above=0.0, unit="s"),
        gravity=(gravity[0], gravity[1], gravity[2]),
        nadir=_nadir(top, base, kinetic),
        impulse_arc_s=arc.number(
            "impulse_max_s",
            "Longest arc of the impulse balance of each motor. 0 switches this balance off.",
            10.0,
            low=0.0,
            unit="s",
        ),
        momentum_max_s=_momentum(arc),
        joint_increment_s=_joint_rows(
            top.table("joint_rows", "The balance of each joint's momentum, over short increments.", optional=True)
        ),
        memory_s=_memory(arc),
        compensate_every=_compensation(
            top.table("compensation", "How often the bias that sensor noise causes is removed.", optional=True)
        ),
    )
    arc.finish()
    top.finish()
    _check_whole(arm, top)
    if kinetic == "planar-symmetric" and any(gravity):
        # an estimate under gravity takes no mass centre as known
        return replace(arm, kinetic="planar")
    return arm


def _nadir(top: Table, base: Base, kinetic: Kinetic) -> tuple[float, float, float] | None:
    if not top.has("nadir"):
        return None
    if base != "free" or kinetic != "spatial":
        raise top.error("nadir", "only an arm that floats in space has a gravity gradient in space", "remove it")
    x, y, z = top.vector(
        "nadir",
        "Unit vector to the centre of the Earth, in the axes that the base has at the start of each run. The gravity "
        "gradient is only sought with it.",
        3,
        otherwise='not known; refused unless base is "free" and kinetic is "spatial"',
    )
    size = math.sqrt(x * x + y * y + z * z)
    if abs(size - 1.0) > 1e-3:
        raise top.error("nadir", f"has length {size:g}", "give a unit vector")
    return x / size, y / size, z / size


def _momentum(arc: Table) -> float | None:
    if not arc.has("momentum_max_s"):
        return None
    return arc.number(
        "momentum_max_s",
        "Longest arc of the balance of angular momentum, for a free base only. 0 switches this balance off.",
        low=0.0,
        unit="s",
        otherwise=f'{MOMENTUM_ARC_S:g} where base is "free" and kinetic is "spatial", else 0',
    )


def _joint_rows(table: Table) -> float | None:
    increment_s: float | None = None
    if table.has("increment_s"):
        increment_s = table.number(
            "increment_s",
            "Length of the increments. Neighbouring ones share half of their time. 0 switches this balance off.",
            low=0.0,
            high=5.0,
            unit="s",
            otherwise=f'{JOINT_ROW_S:g} where base is "fixed" and no joint is flexible, else 0',
        )
    table.finish()
    return increment_s


def _memory(arc: Table) -> float | None:
    if not arc.has("memory_min"):
        return None
    return 60.0 * arc.number(
        "memory_min",
        f"Time in which the weight of past data falls to 1/e. It is at least {_SHORTEST_MEMORY} times max_s.",
        above=0.0,
        unit="min",
        otherwise="past data keeps its weight",
    )


def _compensation(table: Table) -> int | None:
    every: int | None = None
    if table.has("every"):
        every = table.integer(
            "every",
            "The noise of each sensor is compensated once in this many cycles. 1: in every cycle; 0: never.",
            low=0,
            high=17,
            otherwise="twice the number of joints, plus 1, or plus 3 where the arm floats in space",
        )
    table.finish()
    return every


def read_joint(table: Table) -> Joint:
    """One [[joint]] of an arm file. Errors: as `load_arm`."""
    gear_ratio = table.number(
        "gear_ratio",
        'Turns of the motor for one turn of the joint. With torque_at = "joint", torques are not divided by it; it '
        'divides only angles that are stated on the rotor (side = "rotor").',
        above=0.0,
    )
    axis = np.array(
        table.vector(
            "axis",
            "Unit vector along the joint axis, in the frame of the joint. Each joint turns, and has its own motor: "
            "linear axes, and wrists where one motor turns two joints, are not supported.",
            3,
        )
    )
    if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-6:
        raise table.error("axis", f"has length {np.linalg.norm(axis):g}", "give a unit vector")
    axis /= np.linalg.norm(axis)
    rpy = table.vector(
        "frame_rpy",
        "Roll, pitch and yaw of the joint frame in the frame of the body that carries the joint, as in URDF.",
        3,
        (0.0, 0.0, 0.0),
        unit="rad",
    )
    position: tuple[float, ...] | None = None
    if table.has("position_m"):
        position = table.vector(
            "position_m",
            "Origin of the joint's frame in the frame of the joint before, as in URDF. All joints have it, or none; "
            "with it, an arm on a fixed base has fewer parameters (docs/theory.md).",
            3,
            limit=_FARTHEST_M,
            unit="m",
            otherwise="not known",
        )
    flexible = table.boolean("flexible", "Whether the joint has a spring. A rigid joint has none.", True)
    if not flexible and table.has("link_encoder"):
        raise table.error(
            "link_encoder", "a rigid joint has only its motor's encoder", "remove it, or write flexible = true"
        )
    motor_encoder = _encoder(table.table("motor_encoder", "The encoder of the motor."), gear_ratio)
    joint = Joint(
        name=table.text("name", "Name of the joint. Every joint has its own."),
        node=table.integer(
            "node", "Number of the joint's node on the CAN bus. Every node has its own.", low=1, high=MOST_JOINTS
        ),
        axis=(float(axis[0]), float(axis[1]), float(axis[2])),
        frame_rpy=(rpy[0], rpy[1], rpy[2]),
        gear_ratio=gear_ratio,
        link_encoder=_link_encoder(table) if flexible else motor_encoder,
        motor_encoder=motor_encoder,
        torque_sigma=table.number(
            "torque_sigma", "Standard deviation of the reported torque, where it is reported.", 0.0, low=0.0, unit="Nm"
        ),
        torque_relative_sigma=table.number(
            "torque_relative_sigma",
            "Standard deviation of the reported torque as a share of its size. It adds to torque_sigma in squares. The "
            "simulator draws it, the intervals of energy rows contain it, `zygos plan --by bound` weighs "
            "torques by it, and `zygos estimate` needs it to refine.",
            0.0,
            low=0.0,
            high=1.0,
        ),
        torque_gain_sigma=table.number(
            "torque_gain_sigma",
            "Standard deviation of the error of the torque sensor's gain, as a share. Gains of joints relative to each "
            "other are estimated with this prior, and intervals contain them (docs/theory.md). 0: the gain is exact.",
            TORQUE_GAIN_SIGMA,
            low=0.0,
            high=1.0,
        ),
        latch_us=table.integer(
            "latch_us",
            "Delay from SYNC to the instant at which both encoders are read.",
            0,
            low=0,
            high=_LATCH_MAX_US,
            unit="µs",
        ),
        flexible=flexible,
        position_m=None if position is None else (position[0], position[1], position[2]),
    )
    table.finish()
    return joint


def _link_encoder(table: Table) -> Encoder:
    entry = table.table(
        "link_encoder",
        "The encoder of the link, behind the gear and the spring.",
        otherwise="required where flexible is true, refused elsewhere",
    )
    return _encoder(entry, None)


def _encoder(table: Table, gear_ratio: float | None) -> Encoder:
    """Read an encoder. The link's has no side (gear_ratio None); the motor's is at the output or on the rotor."""
    side: Side = "output"
    if gear_ratio is not None:
        side = table.choice("side", "The side of the gear at which the encoder of the motor sits.", _SIDES)
    counts: int | None = None
    if table.has("quantum_rad"):
        if table.has("counts"):
            raise table.error("quantum_rad", "is given with counts", "state one of the two")
        quantum = table.number(
            "quantum_rad",
            "Step of the encoder's reading, as an angle of its own disc. It may be given in place of counts.",
            above=0.0,
            high=1.0,
            unit="rad",
            otherwise="required where counts is absent, refused beside it",
        )
    else:
        counts = table.integer(
            "counts",
            "Steps of the encoder in one turn of its disc.",
            low=4,
            high=2**32,
            otherwise="required where quantum_rad is absent, refused beside it",
        )
        quantum = 2.0 * math.pi / counts
    if side == "rotor" and gear_ratio is not None:
        quantum /= gear_ratio
    sign = table.integer(
        "sign", "1, or -1 where the reading falls while the joint turns about its axis.", 1, low=-1, high=1
    )
    if sign == 0:
        raise table.error("sign", "is 0", "write 1 or -1")
    encoder = Encoder(
        quantum_rad=quantum,
        counts=counts,
        side=side,
        sign=sign,
        zero_rad=table.number(
            "zero_rad",
            "Reading, after the gear, at which the angle is 0.",
            0.0,
            low=-16 * math.pi,
            high=16 * math.pi,
            unit="rad",
        ),
        zero_sigma_rad=table.number(
            "zero_sigma_rad",
            "Standard deviation of zero_rad. Where it is above 0, the estimator also finds an offset of the joint's "
            "spring.",
            0.0,
            low=0.0,
            unit="rad",
        ),
        latch_us=table.integer(
            "latch_us",
            "Delay of this encoder alone, which is added to the latch_us of the joint.",
            0,
            low=0,
            high=_LATCH_MAX_US,
            unit="µs",
        ),
    )
    table.finish()
    return encoder


def _imu(table: Table) -> Imu:
    mount = np.array(
        table.vector(
            "mount_xyzw",
            "Unit quaternion, scalar last, that rotates a rate from the gyro's axes to the axes of the base.",
            4,
            (0.0, 0.0, 0.0, 1.0),
        )
    )
    if abs(float(np.linalg.norm(mount)) - 1.0) > 1e-6:
        raise table.error("mount_xyzw", f"has length {np.linalg.norm(mount):g}", "give a unit quaternion, scalar last")
    mount /= np.linalg.norm(mount)
    imu = Imu(
        node=table.integer("node", "Number of the gyro's node on the CAN bus.", low=1, high=MOST_JOINTS),
        mount_xyzw=(float(mount[0]), float(mount[1]), float(mount[2]), float(mount[3])),
        rate_sigma=table.number("rate_sigma", "Standard deviation of the noise of one sample.", low=0.0, unit="rad/s"),
        bias_walk=table.number(
            "bias_walk",
            "Random walk of the bias. Over one period its standard deviation grows by this times the square root of "
            "period_s.",
            low=0.0,
            unit="rad/s^1.5",
        ),
        latch_us=table.integer(
            "latch_us",
            "Delay from SYNC to the instant at which the gyro is read.",
            0,
            low=0,
            high=_LATCH_MAX_US,
            unit="µs",
        ),
        resolution=table.choice(
            "resolution",
            'Format of the gyro\'s frames (docs/wire.md). "fine": two frames with 24-bit rates; "coarse": one frame '
            "with 16-bit rates.",
            _RESOLUTIONS,
            "fine",
        ),
    )
    table.finish()
    return imu


def smoother_at(cutoff_hz: float, period_s: float) -> Smoother:
    """The filter whose rates have a cut-off (Hz) at a SYNC period (s): of order 4, and of order 2 where order 4 needs
    more than 63 points. Errors: ZygosError with the periods at which there is one."""
    found = window(cutoff_hz, period_s)
    if found is None:
        shortest, longest = periods(cutoff_hz)
        too_short = period_s < shortest
        raise ZygosError(
            f"cut-off {cutoff_hz:g} Hz needs a period of at {'least' if too_short else 'most'} "
            f"{1e3 * (shortest if too_short else longest):.3g} ms with {2 * HALF_WIDTH_MAX + 1 if too_short else 7} "
            f"points, not {1e3 * period_s:g} ms; remedy: change period_s of the arm file (`zygos convert` resamples a "
            f"recording to it), or write a {'higher' if too_short else 'lower'} cutoff_hz"
        )
    points, order = found
    return Smoother(points, order, points // 2, cutoff_hz)


def _smoother(table: Table, period_s: float) -> Smoother:
    if table.has("cutoff_hz"):
        cutoff = table.number(
            "cutoff_hz",
            "Frequency at which the rates that the filter finds are 3 dB below the true ones. It decides points and "
            "order: order 4, or 2 where order 4 needs more than 63 points.",
            above=0.0,
            unit="Hz",
            otherwise="points and order apply; refused beside them",
        )
        for key in ("points", "order", "lag"):
            if table.has(key):
                raise table.error(key, "is given with cutoff_hz, which decides it", "state one of the two")
        table.finish()
        try:
            return smoother_at(cutoff, period_s)
        except ZygosError as error:
            raise ZygosError(f"{table.file}: {table.where}.cutoff_hz: {error}") from None
    points = table.integer("points", "Number of cycles in the filter's window, an odd number.", 7, low=5, high=31)
    if points % 2 == 0:
        raise table.error("points", f"{points} is even", "write an odd number: the filter needs a middle sample")
    order = table.integer(
        "order",
        "Order of the polynomial that is fitted to the window, at most points - 3.",
        min(4, points - 3),
        low=2,
        high=HIGHEST_ORDER,
        otherwise="the lesser of 4 and points - 3",
    )
    if order > points - 3:
        raise table.error(
            "order",
            f"{order} needs at least {order + 3} points: the bandwidth test fits two fewer",
            "lower order or raise points",
        )
    lag = table.integer(
        "lag",
        "Cycles by which the filter's output is behind its newest input. Only the default is accepted.",
        points // 2,
        low=0,
        high=63,
        otherwise="half of points, rounded down",
    )
    if lag != points // 2:
        raise table.error(
            "lag",
            f"{lag} would need end-point filters, whose errors are 30 times larger",
            f"write lag = {points // 2} (points // 2) or leave it out",
        )
    table.finish()
    return Smoother(points, order, lag)


def _within(latch_us: int, period_s: float) -> bool:
    """Whether a latch comes before the next SYNC, with half a microsecond of tolerance for a rounded period."""
    return latch_us + 0.5 < period_s * 1e6


def _check_whole(arm: Arm, top: Table) -> None:
    names = [joint.name for joint in arm.joints]
    if len(set(names)) < len(names):
        raise top.error("joint", f"joint names repeat ({', '.join(names)})", "give every joint a name of its own")
    nodes = [joint.node for joint in arm.joints] + [arm.imu.node]
    if len(set(nodes)) < len(nodes):
        raise top.error(
            "joint", f"node numbers repeat ({nodes}, the last is the IMU's)", "give every node a number of its own"
        )
    if arm.torque_averaged and arm.torque_law != "sampled":
        raise top.error(
            "torque_averaged",
            f'means about an instant are sampled torques, but torque_law is "{arm.torque_law}"',
            'remove it, or write torque_law = "sampled"',
        )
    if arm.memory_s is not None and arm.memory_s < _SHORTEST_MEMORY * arm.arc_max_s:
        raise top.error(
            "arc.memory_min",
            f"{arm.memory_s / 60.0:g} min are less than {_SHORTEST_MEMORY} arcs: too short to detect a change",
            f"give at least {_SHORTEST_MEMORY * arm.arc_max_s / 60.0:g} min, or shorter arcs (max_s)",
        )
    for index, joint in enumerate(arm.joints):
        for key, encoder in (("link_encoder", joint.link_encoder), ("motor_encoder", joint.motor_encoder)):
            if not _within(joint.latch_us + encoder.latch_us, arm.period_s):
                raise top.error(
                    f"joint[{index}].{key}.latch_us",
                    "the latch falls into the following SYNC period",
                    "keep joint and encoder latch_us together below period_s",
                )
    if not _within(arm.imu.latch_us, arm.period_s):
        raise top.error("imu.latch_us", "the latch falls into the following SYNC period", "keep it below period_s")
    _check_geometry(arm, top)


def _check_geometry(arm: Arm, top: Table) -> None:
    if arm.torque_at == "joint" and any(joint.flexible for joint in arm.joints):
        raise top.error(
            "torque_at",
            "a joint is flexible, and a torque behind its gear is that of its spring",
            'write flexible = false for every joint, or torque_at = "rotor" with the torques of the motors',
        )
    known = [joint.position_m is not None for joint in arm.joints]
    if any(known) and not all(known):
        raise top.error(
            f"joint[{known.index(False)}].position_m",
            "is absent, but other joints have it",
            "give it for every joint, or for none",
        )
    if arm.spatial:
        return
    if np.max(np.abs(arm.frames - np.eye(3))) > 1e-9:
        raise top.error(
            "joint.frame_rpy",
            "a planar arm counts link angles from its stretched posture",
            'write [0, 0, 0] and put the rotation into the encoders\' zero_rad, or write kinetic = "spatial"',
        )
    try:
        _ = arm.axis
    except ZygosError as error:
        raise ZygosError(f"{top.file}: joint: {error}") from None
    if arm.kinetic == "planar-symmetric" and all(known):
        reaches = np.array([joint.position_m for joint in arm.joints[1:]]).reshape(-1, 3)
        reaches = reaches - np.outer(reaches @ arm.axis, arm.axis)
        spread = np.linalg.svd(reaches, compute_uv=False) if len(reaches) > 1 else np.zeros(2)
        if spread[1] > 1e-9 * spread[0]:
            raise top.error(
                "joint.position_m",
                'the joints of the stretched arm lie on no line, but kinetic is "planar-symmetric"',
                'write kinetic = "planar", or count the link angles from the stretched posture',
            )


def save_arm(arm: Arm, path: str | Path) -> None:
    """Write `arm.toml` so that a reader sees the old file or the whole new one. Errors: ZygosError if it cannot be
    written."""
    document = tomlkit.document()
    document.update({"name": arm.name, "base": arm.base, "kinetic": arm.kinetic, "period_s": arm.period_s})
    document.update({"torque_law": arm.torque_law, "torque_at": arm.torque_at})
    if arm.torque_unit != "Nm":
        document["torque_unit"] = arm.torque_unit
    if arm.torque_averaged:
        document["torque_averaged"] = True
    if arm.torque_scale_sigma:
        document["torque_scale_sigma"] = arm.torque_scale_sigma
    if not arm.free:
        document["gravity"] = list(arm.gravity)
    if arm.nadir is not None:
        document["nadir"] = list(arm.nadir)
    joints = tomlkit.aot()
    for joint in arm.joints:
        entry = tomlkit.table()
        entry.update({"name": joint.name, "node": joint.node, "axis": list(joint.axis)})
        entry.update({"frame_rpy": list(joint.frame_rpy), "gear_ratio": joint.gear_ratio})
        if joint.position_m is not None:
            entry["position_m"] = list(joint.position_m)
        entry["torque_sigma"] = joint.torque_sigma
        if joint.torque_relative_sigma > 0.0:
            entry["torque_relative_sigma"] = joint.torque_relative_sigma
        entry["torque_gain_sigma"] = joint.torque_gain_sigma
        entry.update({"latch_us": joint.latch_us, "flexible": joint.flexible})
        if joint.flexible:
            entry["link_encoder"] = _encoder_entry(joint.link_encoder)
        entry["motor_encoder"] = _encoder_entry(joint.motor_encoder, joint.gear_ratio)
        joints.append(entry)
    document["joint"] = joints
    if arm.free:
        imu = {"node": arm.imu.node, "mount_xyzw": list(arm.imu.mount_xyzw), "rate_sigma": arm.imu.rate_sigma}
        others = {"bias_walk": arm.imu.bias_walk, "latch_us": arm.imu.latch_us, "resolution": arm.imu.resolution}
        document["imu"] = imu | others
    document["smoother"] = (
        {"points": arm.smoother.points, "order": arm.smoother.order}
        if arm.smoother.cutoff_hz is None
        else {"cutoff_hz": arm.smoother.cutoff_hz}
    )
    document["arc"] = _arc_entry(arm)
    if arm.joint_increment_s is not None:
        document["joint_rows"] = {"increment_s": arm.joint_increment_s}
    if arm.compensate_every is not None:
        document["compensation"] = {"every": arm.compensate_every}
    write_text(Path(path), tomlkit.dumps(document))


def _arc_entry(arm: Arm) -> dict[str, float]:
    """The table [arc] as `read_arm` reads it."""
    arc = {"max_s": arm.arc_max_s, "impulse_max_s": arm.impulse_arc_s}
    if arm.momentum_max_s is not None:
        arc["momentum_max_s"] = arm.momentum_max_s
    if arm.memory_s is not None:
        arc["memory_min"] = arm.memory_s / 60.0
    return arc


def _encoder_entry(encoder: Encoder, gear_ratio: float | None = None) -> Any:
    """An encoder as `_encoder` reads it. gear_ratio: of the motor's encoder, which also says its side."""
    entry = tomlkit.inline_table()
    if encoder.counts is not None:
        entry["counts"] = encoder.counts
    else:
        on_rotor = gear_ratio is not None and encoder.side == "rotor"
        entry["quantum_rad"] = encoder.quantum_rad * (gear_ratio or 1.0) if on_rotor else encoder.quantum_rad
    if gear_ratio is not None:
        entry["side"] = encoder.side
    entry.update({"sign": encoder.sign, "zero_rad": encoder.zero_rad, "zero_sigma_rad": encoder.zero_sigma_rad})
    entry["latch_us"] = encoder.latch_us
    return entry

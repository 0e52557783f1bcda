"""What the hardware is: joints, encoders, gyro, timing and declared noise (`arm.toml`)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.errors import ZygosError
from zygos.files.toml import Table

Base = Literal["free", "fixed"]
Kinetic = Literal["planar-symmetric", "planar", "spatial"]
TorqueLaw = Literal["applied_from_sync", "applied_previous_cycle", "sampled"]

Side = Literal["output", "rotor"]
TorqueAt = Literal["rotor"]
Resolution = Literal["fine", "coarse"]

_BASES: tuple[Base, ...] = ("free", "fixed")
_KINETICS: tuple[Kinetic, ...] = ("planar-symmetric", "planar", "spatial")
_SIDES: tuple[Side, ...] = ("output", "rotor")
_TORQUE_ATS: tuple[TorqueAt, ...] = ("rotor",)
_RESOLUTIONS: tuple[Resolution, ...] = ("fine", "coarse")
_TORQUE_LAWS: tuple[TorqueLaw, ...] = ("applied_from_sync", "applied_previous_cycle", "sampled")
ANGLE_STEP = 2.0 * math.pi / 2**20
"""Step of an angle on the wire, rad (docs/wire.md)."""
TORQUE_STEP = 1e-4
"""Step of a torque on the wire, Nm."""
RATE_STEPS: dict[Resolution, float] = {"fine": 2.0**-21, "coarse": 2.0**-13}
"""Step of a rate on the wire, rad/s, by the resolution of the gyro."""
MOMENTUM_ARC_S = 10.0
"""Arcs of momentum rows where an arm has them by default."""
_LATCH_MAX_US = 65_535  # the wire carries the latch delay as u16
_SHORTEST_MEMORY = 2
"""Arcs."""


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
    """How well `zero_rad` is known, rad. Above 0 the joint's spring is estimated with an offset."""
    latch_us: int = 0
    """Delay of this encoder's latch after SYNC in µs, on top of the joint's."""

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of a uniform error one quantum wide, rad (Nanos & Papadopoulos eq. (28); docs/paper.md,
        erratum 4)."""
        return self.quantum_rad / math.sqrt(12.0)

    @property
    def over_the_wire(self) -> Encoder:
        """The same encoder with the error that its readings have once the wire has rounded them (docs/wire.md).

        An encoder without a quantum stays exact: the bandwidth test then accepts every instant.
        """
        if self.quantum_rad == 0.0:
            return self
        steps = self.quantum_rad / ANGLE_STEP
        # readings that lie on the wire's own grid are not rounded again
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
    """Of a rigid joint: the motor's, which then speaks for both sides."""
    motor_encoder: Encoder
    torque_sigma: float = 0.0
    """Standard deviation of the reported rotor torque, Nm."""
    latch_us: int = 0
    """Delay of both encoders' latch after SYNC in µs, as stated on the wire."""
    flexible: bool = True
    """Whether the joint has a spring; a rigid one has theta = q, and neither stiffness nor damping."""

    @property
    def unsure_zero(self) -> bool:
        """Whether the encoders may disagree about where theta = q: the zero of one has a deviation."""
        return self.flexible and max(self.link_encoder.zero_sigma_rad, self.motor_encoder.zero_sigma_rad) > 0.0

    @property
    def over_the_wire(self) -> Joint:
        """The same joint with the errors that its readings have once the wire has rounded them."""
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
    """CAN node number, 1..31; 0: there is none, as on a fixed base."""
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
        """The same gyro with the error that its readings have once the wire has rounded them; node 0 sends none."""
        if self.node == 0:
            return self
        return replace(self, rate_sigma=rounded(self.rate_sigma, self.step))


NO_IMU = Imu(node=0, mount_xyzw=(0.0, 0.0, 0.0, 1.0), rate_sigma=0.0, bias_walk=0.0)
"""What a fixed base has: its rate is zero, and nobody reports it."""


@dataclass(frozen=True)
class Smoother:
    """The fixed-lag Savitzky-Golay filter of the estimator."""

    points: int = 7
    order: int = 4
    lag: int = 3


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
    """Longest arc of the motor impulse rows, s; 0: none of them. Their noise sums up over an arc."""
    memory_s: float | None = None
    """Time in which what closed arcs left fades to 1/e, s; None: it does not."""
    compensate_every: int | None = None
    """What sensor noise adds to the normal equations is taken off, each sensor's share in every that many cycles; 0: it
    is not. None: `compensation`."""
    momentum_max_s: float | None = None
    """Longest arc of the momentum rows of a floating base, s; 0: none of them. None: `momentum_arc_s`."""
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m/s^2 in the base frame, of a fixed base; a free-floating arm falls with its orbit and feels none."""

    @property
    def free(self) -> bool:
        """Whether the base floats."""
        return self.base == "free"

    @cached_property
    def over_the_wire(self) -> Arm:
        """The same arm with the errors that the readings of its sensors have once the wire has rounded them: a
        variance of step^2/12 is added, but not to encoder readings that lie on the wire's own grid (docs/wire.md)."""
        return replace(self, joints=tuple(joint.over_the_wire for joint in self.joints), imu=self.imu.over_the_wire)

    @property
    def compensation(self) -> int:
        """Cycles from one turn of a sensor's compensation to the next: by default one sensor has its turn a cycle."""
        return 2 * self.n + 1 if self.compensate_every is None else self.compensate_every

    @property
    def momentum_arc_s(self) -> float:
        """Longest arc of the momentum rows, s, 0 for none: by default 10 s for an arm that floats in space, whose
        inertias they tell apart. The attitude of the base is integrated over an arc, with the gyro's bias."""
        default = MOMENTUM_ARC_S if self.free and self.spatial else 0.0
        return default if self.momentum_max_s is None else self.momentum_max_s

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
        """(N,) gear ratios."""
        return np.array([joint.gear_ratio for joint in self.joints])

    @cached_property
    def body_parameters(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of the parameters that bodies have, before those of the joints.

        In space N[ia,jb], the upper triangle over 0x 0y 0z 1u 1v .. Nu Nv; in a plane a_ij, then b_ij; on a fixed base
        without those of body 0, and with the first moments G[iu], G[iv] that gravity can move (docs/theory.md).
        """
        first = 0 if self.free else 1
        bodies = range(first, self.n + 1)
        if self.spatial:
            vectors = [f"0{axis}" for axis in "xyz" if self.free] + [
                f"{i}{p}" for i in range(1, self.n + 1) for p in "uv"
            ]
            names = [f"N[{a},{b}]" for k, a in enumerate(vectors) for b in vectors[k:]]
            # with the base fixed, the first body turns about its axis only: two of its three entries are no parameters
            names = [name for name in names if self.free or name not in ("N[1u,1v]", "N[1v,1v]")]
        else:
            names = [f"a{i}{j}" for i in bodies for j in bodies if i <= j]
            if self.kinetic == "planar":
                names += [f"b{i}{j}" for i in bodies for j in bodies if i < j]
        moments = [f"G[{i + 1}{p}]" for i in range(self.n) if self.feels_gravity[i] for p in "uv"]
        return tuple((name, "kg m^2") for name in names) + tuple((name, "kg m") for name in moments)

    @cached_property
    def joint_parameters(self) -> tuple[tuple[str, int, str], ...]:
        """Kind, joint from 0 and unit of the parameters of the joints: Im, and k and b of a flexible one.

        The rotor of a rigid first joint on a fixed base turns with its link alone, and is counted there.
        """
        listed: list[tuple[str, int, str]] = []
        for i, joint in enumerate(self.joints):
            if joint.flexible or self.free or i > 0:
                listed.append(("Im", i, "kg m^2"))
            if joint.flexible:
                listed += [("k", i, "Nm/rad"), ("b", i, "Nms/rad")]
        return tuple(listed)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The identified parameters in the order of every row and output: `body_parameters`, `joint_parameters`."""
        of_joints = (f"{kind}{i + 1}" for kind, i, _ in self.joint_parameters)
        return (*(name for name, _ in self.body_parameters), *of_joints)

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Unit of each of `parameter_names`."""
        return (*(unit for _, unit in self.body_parameters), *(unit for _, _, unit in self.joint_parameters))

    @cached_property
    def feels_gravity(self) -> tuple[bool, ...]:
        """(N,) whether gravity does work on the first moment of the body behind each joint as the joints move: not
        while every axis up to it is vertical."""
        gravity = np.array(self.gravity)
        weight = float(np.linalg.norm(gravity))
        if self.free or weight == 0.0:
            return (False,) * self.n
        axes = self.axes if self.spatial else np.tile(self.axis, (self.n, 1))
        tilted = np.linalg.norm(np.cross(axes, gravity / weight), axis=1) > 1e-9
        return tuple(bool(tilted[: i + 1].any()) for i in range(self.n))

    def at_period(self, period_s: float) -> Arm:
        """The same hardware at another SYNC period (s). The gyro's white noise keeps its density, so that the
        deviation of one sample grows as the period shrinks. Errors: ZygosError if the period is not positive or a
        latch would fall into the following period."""
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
        return replace(self, period_s=period_s, imu=replace(self.imu, rate_sigma=sigma))

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
    def axis(self) -> NDArray[np.float64]:
        """(3,) the planar arm's common joint axis in the base frame. Errors: ZygosError if the axes are not parallel
        and alike in sense."""
        axes = self.axes
        if np.max(np.abs(axes - axes[0])) > 1e-9:
            raise ZygosError(
                f"arm {self.name}: the joint axes are not parallel and alike in sense, but kinetic is "
                f'"{self.kinetic}"; remedy: kinetic = "spatial", or correct axis or frame_rpy (a reversed encoder is '
                "sign = -1)"
            )
        common: NDArray[np.float64] = axes[0]
        return common

    @cached_property
    def mount(self) -> NDArray[np.float64]:
        """(3, 3) rotation matrix of the gyro's mount: base rate = mount @ sensor rate."""
        matrix: NDArray[np.float64] = Rotation.from_quat(self.imu.mount_xyzw).as_matrix()
        return matrix


def load_arm(path: str | Path) -> Arm:
    """Read `arm.toml`. Errors: ZygosError naming file, key and remedy for anything unknown, missing, of the wrong
    type or out of range."""
    return read_arm(Table.load(path))


def read_arm(top: Table) -> Arm:
    """The arm of a table with the keys of `arm.toml`. Errors: as `load_arm`."""
    joints = tuple(read_joint(table) for table in top.tables("joint"))
    base = top.choice("base", _BASES)
    if base == "fixed" and top.has("imu"):
        raise top.error("imu", "a fixed base has no rate to measure", 'remove [imu], or write base = "free"')
    arc = top.table("arc", optional=True)
    if base == "fixed" and arc.has("momentum_max_s"):
        raise arc.error("momentum_max_s", "a fixed base takes up momentum", 'remove it, or write base = "free"')
    if base == "free" and top.has("gravity"):
        raise top.error("gravity", "a free-floating arm feels none", 'remove it, or write base = "fixed"')
    imu = _imu(top.table("imu")) if base == "free" else NO_IMU
    gravity = (0.0, 0.0, 0.0) if base == "free" else top.vector("gravity", 3, limit=1e3, unit="m/s^2")
    arm = Arm(
        name=top.text("name"),
        base=base,
        kinetic=top.choice("kinetic", _KINETICS),
        # the wire's drop-out rules and the latch delay (u16 µs) hold up to a SYNC period of 65 ms
        period_s=top.number("period_s", above=0.0, high=0.065, unit="s"),
        torque_law=top.choice("torque_law", _TORQUE_LAWS),
        torque_at=top.choice("torque_at", _TORQUE_ATS),
        joints=joints,
        imu=imu,
        smoother=_smoother(top.table("smoother", optional=True)),
        arc_max_s=arc.number("max_s", 60.0, above=0.0, unit="s"),
        gravity=(gravity[0], gravity[1], gravity[2]),
        impulse_arc_s=arc.number("impulse_max_s", 10.0, low=0.0, unit="s"),
        momentum_max_s=arc.number("momentum_max_s", low=0.0, unit="s") if arc.has("momentum_max_s") else None,
        memory_s=60.0 * arc.number("memory_min", above=0.0, unit="min") if arc.has("memory_min") else None,
        compensate_every=_compensation(top.table("compensation", optional=True)),
    )
    arc.finish()
    top.finish()
    _check_whole(arm, top)
    return arm


def _compensation(table: Table) -> int | None:
    every = table.integer("every", low=0, high=15) if table.has("every") else None
    table.finish()
    return every


def read_joint(table: Table) -> Joint:
    """One [[joint]] of an arm file. Errors: as `load_arm`."""
    gear_ratio = table.number("gear_ratio", above=0.0)
    axis = np.array(table.vector("axis", 3))
    if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-6:
        raise table.error("axis", f"has length {np.linalg.norm(axis):g}", "give a unit vector")
    axis /= np.linalg.norm(axis)
    rpy = table.vector("frame_rpy", 3, (0.0, 0.0, 0.0), unit="rad")
    flexible = table.boolean("flexible", True)
    if not flexible and table.has("link_encoder"):
        raise table.error(
            "link_encoder", "a rigid joint has one angle, its motor encoder's", "remove it, or write flexible = true"
        )
    motor_encoder = _encoder(table.table("motor_encoder"), gear_ratio)
    joint = Joint(
        name=table.text("name"),
        node=table.integer("node", low=1, high=31),
        axis=(float(axis[0]), float(axis[1]), float(axis[2])),
        frame_rpy=(rpy[0], rpy[1], rpy[2]),
        gear_ratio=gear_ratio,
        link_encoder=_encoder(table.table("link_encoder"), None) if flexible else motor_encoder,
        motor_encoder=motor_encoder,
        torque_sigma=table.number("torque_sigma", 0.0, low=0.0, unit="Nm"),
        latch_us=table.integer("latch_us", 0, low=0, high=_LATCH_MAX_US),
        flexible=flexible,
    )
    table.finish()
    return joint


def _encoder(table: Table, gear_ratio: float | None) -> Encoder:
    """The link's encoder has no side (gear_ratio None); the motor's sits at the output or on the rotor."""
    side: Side = "output" if gear_ratio is None else table.choice("side", _SIDES)
    counts: int | None = None
    if table.has("quantum_rad"):
        if table.has("counts"):
            raise table.error("quantum_rad", "stands beside counts", "state one of the two")
        quantum = table.number("quantum_rad", above=0.0, high=1.0, unit="rad")
    else:
        counts = table.integer("counts", low=4, high=2**32)
        quantum = 2.0 * math.pi / counts
    if side == "rotor" and gear_ratio is not None:
        quantum /= gear_ratio
    sign = table.integer("sign", 1, low=-1, high=1)
    if sign == 0:
        raise table.error("sign", "is 0", "write 1 or -1")
    encoder = Encoder(
        quantum_rad=quantum,
        counts=counts,
        side=side,
        sign=sign,
        zero_rad=table.number("zero_rad", 0.0, low=-16 * math.pi, high=16 * math.pi, unit="rad"),
        zero_sigma_rad=table.number("zero_sigma_rad", 0.0, low=0.0, unit="rad"),
        latch_us=table.integer("latch_us", 0, low=0, high=_LATCH_MAX_US),
    )
    table.finish()
    return encoder


def _imu(table: Table) -> Imu:
    mount = np.array(table.vector("mount_xyzw", 4, (0.0, 0.0, 0.0, 1.0)))
    if abs(float(np.linalg.norm(mount)) - 1.0) > 1e-6:
        raise table.error("mount_xyzw", f"has length {np.linalg.norm(mount):g}", "give a unit quaternion, scalar last")
    mount /= np.linalg.norm(mount)
    imu = Imu(
        node=table.integer("node", low=1, high=31),
        mount_xyzw=(float(mount[0]), float(mount[1]), float(mount[2]), float(mount[3])),
        rate_sigma=table.number("rate_sigma", low=0.0, unit="rad/s"),
        bias_walk=table.number("bias_walk", low=0.0, unit="rad/s^1.5"),
        latch_us=table.integer("latch_us", 0, low=0, high=_LATCH_MAX_US),
        resolution=table.choice("resolution", _RESOLUTIONS, "fine"),
    )
    table.finish()
    return imu


def _smoother(table: Table) -> Smoother:
    points = table.integer("points", 7, low=5, high=31)
    if points % 2 == 0:
        raise table.error("points", f"{points} is even", "write an odd number: the filter is centred on its instant")
    order = table.integer("order", min(4, points - 3), low=2, high=8)
    if order > points - 3:
        raise table.error(
            "order",
            f"{order} needs at least {order + 3} points: the bandwidth test fits two fewer",
            "lower order or raise points",
        )
    lag = table.integer("lag", points // 2, low=0, high=63)
    if lag != points // 2:
        raise table.error(
            "lag",
            f"{lag} makes end-point filters, whose errors are 30 times larger",
            f"write lag = {points // 2} (points // 2) or leave it out",
        )
    table.finish()
    return Smoother(points, order, lag)


def _within(latch_us: int, period_s: float) -> bool:
    """Whether a latch comes before the next SYNC; half a microsecond settles rounding of the period."""
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
    if arm.memory_s is not None and arm.memory_s < _SHORTEST_MEMORY * arm.arc_max_s:
        raise top.error(
            "arc.memory_min",
            f"{arm.memory_s / 60.0:g} min are less than {_SHORTEST_MEMORY} arcs: too little to know a change by",
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

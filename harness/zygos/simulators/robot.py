# SPDX-License-Identifier: MIT
"""A serial arm as the file of a simulator describes it, and what zygos makes of it: an arm and a model.

Everything is stated in the axes of the base at zero joint angles. A simulator knows no gears: what turns with a joint
is in the inertia of its link and, in MuJoCo, in an `armature` that is added to the joint alone. zygos has a rotor of
inertia Im before a gear of ratio n, which the body before the joint carries. Its kinetic energy is that of

    link     + n Im a a'
    carrier  - (n - 1) Im a a' + Im (E - a a') / 2
    armature   (n^2 - n) Im

with rigid joints (a: axis), exactly: Im (w a)^2 / 2 + n Im qd (w a) + n^2 Im qd^2 / 2 for a carrier that turns with w,
and as a thin disc across its axis half as much as about it. A joint with a spring cannot be mapped so: its rotor is a
body of its own on a hinge beside the joint, which turns n times as far, and the spring a tendon between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import NO_IMU, Arm, Encoder, Joint, Smoother
from zygos.can.run import Run
from zygos.effects import Effect, effect
from zygos.errors import ZygosError
from zygos.gap.record import MeasuredRun
from zygos.model.model import Body, JointModel, Model, Quantity

Array = NDArray[np.float64]
Format = Literal["MJCF", "URDF"]

USUAL_GEAR = 100.0
"""Gear ratio where neither arm file nor actuator states one: only Im and n together are seen."""
_AT_STOP_RAD = 1e-3
_SAME_PLACE_M = 1e-5
_SAME_AXIS = 1e-5
_SAME_RATIO = 1e-6
_UPPER = np.triu_indices(3)


@dataclass(frozen=True)
class Lump:
    """Mass of one or several bodies that move together, in the axes of the base at zero joint angles."""

    mass: float
    """kg."""
    centre: Array
    """(3,) mass centre, m."""
    tensor: Array
    """(3, 3) inertia about the mass centre, kg m^2."""

    @property
    def standard(self) -> Array:
        """(10,) mass, first moments and inertia about the origin: m, mx, my, mz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz."""
        about = self.tensor + self.mass * _spread(self.centre)
        return np.concatenate([[self.mass], self.mass * self.centre, about[_UPPER]])

    @classmethod
    def of(cls, standard: Array) -> Lump:
        """From (10,) as `standard` has them; a lump without mass has its inertia at the origin."""
        mass = float(standard[0])
        centre = standard[1:4] / mass if mass else np.zeros(3)
        tensor = np.zeros((3, 3))
        tensor[_UPPER] = standard[4:]
        tensor = tensor + tensor.T - np.diag(np.diag(tensor)) - mass * _spread(centre)
        return cls(mass, np.asarray(centre, dtype=np.float64), tensor)

    def in_frame(self, attitude: Array, origin: Array) -> Lump:
        """In the axes of a frame with that attitude (3, 3) and origin (3,)."""
        return Lump(self.mass, attitude.T @ (self.centre - origin), attitude.T @ self.tensor @ attitude)


@dataclass(frozen=True)
class Spring:
    """The spring of a joint in the file: a tendon between the joint and the hinge of its rotor, which the body before
    the joint carries."""

    rotor: Lump
    zero_rad: float
    """Angle of the rotor's hinge at which the arm has the posture of the file."""
    ratio: float
    """Turns of the rotor for one turn of the joint at which the spring is relaxed."""
    stiffness: float
    """Nm/rad behind the gear, beyond the gap."""
    damping: float
    """Nms/rad behind the gear."""
    cubic: float = 0.0
    """Nm/rad^3 behind the gear."""
    offset: float = 0.0
    """Nm at the link where joint and rotor are at their zeros."""
    slack: float = 0.0
    """By how much the stiffness is smaller within the gap, Nm/rad behind the gear: a second tendon has it."""
    gap_rad: float = 0.0
    """Half width of the gap behind the gear."""
    friction: float = 0.0
    """Nm of the rotor's hinge, before the gear."""
    rub: float = 0.0
    """Nms/rad of the rotor's hinge, before the gear."""
    number: int = -1
    """Of the hinge of the rotor in MuJoCo; -1 where the file lacks the spring."""
    tendon: int = -1
    """Of the tendon in MuJoCo."""
    second: int = -1
    """Of the one with the gap; -1 where there is none."""
    coefficient: float = 1.0
    """Length of the tendon for each radian of the rotor, m."""

    @property
    def added(self) -> bool:
        """Whether the file lacks it."""
        return self.number < 0

    def inertia(self, axis: Array) -> float:
        """Of the rotor about the axis (3,) of its joint, kg m^2."""
        return float(axis @ self.rotor.tensor @ axis)


@dataclass(frozen=True)
class Hinge:
    """A joint of the arm in the file."""

    name: str
    anchor: Array
    """(3,) m."""
    axis: Array
    """(3,) unit vector."""
    zero_rad: float = 0.0
    """Angle of the simulator at which the arm has the posture of the file."""
    armature: float = 0.0
    """kg m^2."""
    friction: float = 0.0
    """Nm."""
    damping: float = 0.0
    """Nms/rad."""
    gear: float | None = None
    """Of its actuator; None where there is none, or none that is a gear."""
    number: int = -1
    """Of the joint in MuJoCo; -1 in a URDF."""
    written: str = ""
    """Its name in the file."""
    range_rad: tuple[float, float] | None = None
    """Angles of the simulator at which stops are."""
    spring: Spring | None = None
    """None of a rigid joint."""


@dataclass(frozen=True)
class Owner:
    """The body of a segment whose inertial in the file is changed."""

    name: str
    attitude: Array
    """(3, 3) of its frame in that of the base."""
    origin: Array
    """(3,) m."""
    own: Lump
    rest: tuple[Lump, ...] = ()
    """Of the bodies that move with it and stay as they are."""
    number: int = -1
    """Of the body in MuJoCo; -1 in a URDF."""


@dataclass(frozen=True)
class Robot:
    """A serial arm of N hinges."""

    path: Path
    format: Format
    """Of the file that is written."""
    hinges: tuple[Hinge, ...]
    owners: tuple[Owner, ...]
    """(N) of the segment behind each hinge."""
    gravity: Array
    """(3,) m/s^2."""
    notes: tuple[str, ...] = ()
    """What zygos does not use, in sentences."""
    translated: bool = False
    """Whether the file that is read is a URDF, and the one that is written an MJCF."""
    base: Owner | None = None
    """Of a base that floats; None where it is fixed."""

    @property
    def added(self) -> tuple[Hinge, ...]:
        """Those whose spring the file lacks."""
        return tuple(one for one in self.hinges if one.spring is not None and one.spring.added)

    @property
    def bodies(self) -> tuple[Owner, ...]:
        """Those that move: the base where it floats, then the segments behind the hinges."""
        return self.owners if self.base is None else (self.base, *self.owners)

    @property
    def segments(self) -> tuple[Lump, ...]:
        """All that moves with each of `bodies`, without rotors on hinges of their own."""
        return tuple(Lump.of(sum((one.standard for one in owner.rest), owner.own.standard)) for owner in self.bodies)

    def arm(self, period_s: float, quantum_rad: Sequence[float]) -> Arm:
        """The arm, its frames parallel to the base at zero angles, with torques that are reported before the gear.

        quantum_rad: (N,) steps of the angles. Errors: ZygosError for a period that no arm has.
        """
        if not 0.0 < period_s <= 0.065:
            raise ZygosError(
                f"{self.path}: the runs have a period of {period_s:g} s; remedy: record at least every 65 ms"
            )
        parallel = bool(np.all([hinge.axis @ self.hinges[0].axis > 1.0 - 1e-9 for hinge in self.hinges]))
        joints, before = [], np.zeros(3)
        for number, (hinge, quantum) in enumerate(zip(self.hinges, quantum_rad, strict=True), start=1):
            encoder = Encoder(quantum, zero_rad=hinge.zero_rad)
            x, y, z = (float(value) for value in hinge.anchor - before)
            a, b, c = (float(value) for value in (self.hinges[0].axis if parallel else hinge.axis))
            joints.append(
                Joint(
                    hinge.name, number, (a, b, c), (0.0, 0.0, 0.0), hinge.gear or USUAL_GEAR, encoder, encoder,
                    flexible=False, position_m=(x, y, z),
                )
            )  # fmt: skip
            before = hinge.anchor
        gx, gy, gz = (float(value) for value in self.gravity)
        kinetic: Literal["planar", "spatial"] = "planar" if parallel else "spatial"
        return Arm(
            self.path.stem, "fixed", kinetic, period_s, "sampled", "rotor", tuple(joints), NO_IMU,
            smoother=Smoother(), gravity=(gx, gy, gz),
        )  # fmt: skip

    def ordered(self, arm: Arm) -> Robot:
        """The robot with the names of the arm's joints, which its hinges must be in place, axis and order; gravity
        too. Errors: ZygosError that names what differs, with what to do."""
        if len(self.hinges) != arm.n:
            raise ZygosError(
                f"{self.path}: has {len(self.hinges)} hinges, arm {arm.name} has {arm.n} joints; remedy: give the arm "
                "file of this robot"
            )
        self._check_joints(arm)
        for hinge, axis in zip(self.hinges, arm.axes, strict=True):
            if np.max(np.abs(hinge.axis - axis)) > _SAME_AXIS:
                raise ZygosError(
                    f"{self.path}: joint {hinge.name} turns about {_said(hinge.axis)} at zero angles, in arm "
                    f"{arm.name} about {_said(axis)}; remedy: correct axis or frame_rpy in the arm file (a reversed "
                    "encoder has sign = -1)"
                )
        if np.max(np.abs(self.gravity - arm.gravity)) > 1e-3 * (1.0 + float(np.linalg.norm(self.gravity))):
            raise ZygosError(
                f"{self.path}: gravity is {_said(self.gravity)} m/s^2, in arm {arm.name} {_said(arm.gravity)}; remedy: "
                + ('<option gravity="0 0 0"/>, as it falls' if arm.free else "correct the wrong one")
            )
        self._shift(arm)
        return replace(
            self,
            hinges=tuple(replace(one, name=joint.name) for one, joint in zip(self.hinges, arm.joints, strict=True)),
        )

    def _check_joints(self, arm: Arm) -> None:
        """Refuse, with ZygosError, a base or joints of another kind than those of the arm."""
        if arm.free != (self.base is not None):
            floats = "floats" if arm.free else "is fixed"
            remedy = "give the body of the base a <freejoint/>" if arm.free else 'write base = "free" in the arm file'
            raise ZygosError(
                f"{self.path}: the base {'is fixed' if arm.free else 'floats'}, but in arm {arm.name} it {floats}; "
                f"remedy: {remedy}, or correct the other one"
            )
        for hinge, joint in zip(self.hinges, arm.joints, strict=True):
            if joint.flexible and hinge.spring is None:
                raise ZygosError(
                    f"{self.path}: joint {hinge.name} is rigid, but flexible in arm {arm.name}; remedy: `zygos "
                    f"estimate RUN -o MODEL.toml`, then `zygos export --arm ARM.toml --model MODEL.toml --mjcf "
                    f"{self.path.name} -o NEW.xml` gives it a spring, or flexible = false in the arm file, or a "
                    "model.toml as --simulation"
                )
            if hinge.spring is not None and not joint.flexible:
                raise ZygosError(
                    f"{self.path}: joint {hinge.name} has a spring, but is rigid in arm {arm.name}; remedy: write "
                    "flexible = true in the arm file"
                )
            if hinge.spring is not None and abs(hinge.spring.ratio / joint.gear_ratio - 1.0) > _SAME_RATIO:
                raise ZygosError(
                    f"{self.path}: the spring of joint {hinge.name} is relaxed where its rotor turns "
                    f"{hinge.spring.ratio:.6g} times as far, but gear_ratio of arm {arm.name} is {joint.gear_ratio:g}; "
                    "remedy: correct the coefficients of the tendon or gear_ratio"
                )

    def _shift(self, arm: Arm) -> Array:
        """(3,) by which the joints lie elsewhere than in the arm file, all alike: where the base stands has no effect,
        and neither has a place along an axis."""
        if arm.joints[0].position_m is None:
            return np.zeros(3)
        apart = np.array([hinge.anchor for hinge in self.hinges]) - origins(arm)
        across = [np.eye(3) - np.outer(hinge.axis, hinge.axis) for hinge in self.hinges]
        shift = np.linalg.lstsq(
            np.concatenate(across), np.concatenate([p @ x for p, x in zip(across, apart, strict=True)]), rcond=None
        )[0]
        for hinge, p, x in zip(self.hinges, across, apart, strict=True):
            if np.linalg.norm(p @ (x - shift)) > _SAME_PLACE_M:
                raise ZygosError(
                    f"{self.path}: joint {hinge.name} lies {1e3 * float(np.linalg.norm(p @ (x - shift))):.3g} mm off "
                    f"its place in arm {arm.name}; remedy: correct position_m in the arm file, or leave it out for "
                    "every joint"
                )
        return np.asarray(shift, dtype=np.float64)

    def frames(self, arm: Arm) -> list[tuple[Array, Array]]:
        """Attitude and origin of the frame of each body of the arm (N+1) in the axes of the base."""
        shift = self._shift(arm)
        if arm.joints[0].position_m is None:
            places = np.array([hinge.anchor for hinge in self.hinges])
        else:
            places = origins(arm) + shift
        base = np.zeros(3) if self.base is None else shift
        return [(frame, place) for frame, place in zip(arm.frames, np.vstack([base, places]), strict=True)]

    def model(self, arm: Arm) -> Model:
        """The model of the file for an arm whose joints are its hinges: bodies, rotors, and friction as effects.

        With torques behind the gear, `torque_at = "joint"`, the rotors of zygos are not seen: armatures are left out.
        """
        frames, rotors = self.frames(arm), self.rotors(arm)
        standard = unreflected([one.standard for one in self.segments], rotors, arm, self.hinges)
        bodies = [Body("base", Quantity(0.0, 0.0, "CAD", "kg"), (0.0, 0.0, 0.0), _six(np.zeros((3, 3))))]
        bodies = [
            *(bodies if self.base is None else []),
            *(
                body_of(owner.name, Lump.of(own).in_frame(*frame))
                for owner, own, frame in zip(self.bodies, standard, frames[-len(standard) :], strict=True)
            ),
        ]
        for i in range(arm.n):
            attitude, origin = frames[i]
            x, y, z = (float(v) for v in attitude.T @ (frames[i + 1][1] - origin))
            bodies[i] = replace(bodies[i], joint_xyz=arm.joints[i].position_m or (x, y, z))
        drives = tuple(
            JointModel(
                joint.name,
                Quantity(0.0),
                Quantity(inertia),
                Quantity(np.inf if hinge.spring is None else hinge.spring.stiffness),
                Quantity(0.0 if hinge.spring is None else hinge.spring.damping),
            )
            for joint, hinge, inertia in zip(arm.joints, self.hinges, rotors.tolist(), strict=True)
        )
        return Model(self.path.stem, tuple(bodies), drives, effects=self.effects(arm))

    def rotors(self, arm: Arm) -> Array:
        """(N,) inertias of the rotors, kg m^2 before the gear: those that stand for the armatures of rigid joints."""
        if arm.torque_at == "joint":
            return np.zeros(arm.n)
        ratio = arm.gear_ratios
        armature = np.array([hinge.armature for hinge in self.hinges]) / np.maximum(ratio**2 - ratio, 1e-12)
        springs = [hinge.spring and hinge.spring.inertia(hinge.axis) for hinge in self.hinges]
        return np.array([x if own is None else own for x, own in zip(armature, springs, strict=True)])

    def effects(self, arm: Arm) -> tuple[Effect, ...]:
        """Friction and damping of the file, before the gear at rigid joints, and what its springs have besides."""
        listed = []
        for joint, hinge, ratio in zip(arm.joints, self.hinges, arm.gear_ratios.tolist(), strict=True):
            sizes = [("motor_coulomb", hinge.friction / ratio), ("motor_viscous", hinge.damping / ratio)]
            own = hinge.spring
            if own is not None:
                sizes = [
                    ("motor_coulomb", own.friction),
                    ("motor_viscous", own.rub * ratio),
                    ("link_coulomb", hinge.friction),
                    ("link_viscous", hinge.damping),
                    ("cubic_stiffness", own.cubic),
                    ("spring_offset", own.offset),
                ]
            listed += [effect(key, joint.name, size) for key, size in sizes if size != 0.0]
            if own is not None and own.slack != 0.0:
                listed.append(effect("backlash", joint.name, own.slack, shape=own.gap_rad))
        return tuple(sorted(listed, key=lambda one: one.kind.key))


def at_stops(robot: Robot, runs: Sequence[Run | MeasuredRun]) -> list[str]:
    """Which joints reach a stop of the file in which runs, in sentences: zygos has no stops."""
    out = []
    for number, run in enumerate(runs, start=1):
        for j, hinge in enumerate(robot.hinges):
            if hinge.range_rad is None:
                continue
            q = _link_angle(run, j) + hinge.zero_rad
            low, high = hinge.range_rad
            share = float(np.mean((q <= low + _AT_STOP_RAD) | (q >= high - _AT_STOP_RAD)))
            if share > 0.0:
                out.append(
                    f"{run.path.name if run.path else f'run {number}'}: {hinge.name} reaches its range of {low:.4g} .. "
                    f"{high:.4g} rad in {100.0 * share:.2g} % of the readings, and no effect is a stop: leave these "
                    "parts out (--from, --to)"
                )
    return out


def _link_angle(run: Run | MeasuredRun, j: int) -> Array:
    """(n,) angle of a joint as it was read, rad."""
    if isinstance(run, MeasuredRun):
        return run.samples.q[:, j]
    joint, cycles = run.arm.joints[j], run.cycles
    encoder, read = (joint.link_encoder, cycles.q) if joint.flexible else (joint.motor_encoder, cycles.theta)
    return np.asarray(encoder.sign * (read[:, j] - encoder.zero_rad), dtype=np.float64)


def check_gears(arm: Arm, named: str) -> None:
    """Refuse, with ZygosError, a gear ratio for which no armature stands for a rotor."""
    for joint in arm.joints:
        rigid = arm.torque_at == "rotor" and not joint.flexible
        if rigid and not joint.gear_ratio > 1.0 + limits.MATERIAL_DIFFERENCE.value:
            raise ZygosError(
                f"{named}: gear_ratio of joint {joint.name} is {joint.gear_ratio:g}, and the inertia of a rotor "
                "without a gear cannot be told from an armature; remedy: write a gear ratio above 1 with torques "
                'before the gear, or torque_at = "joint"'
            )


def unreflected(segments: Sequence[Array], rotors: Array, arm: Arm, hinges: Sequence[Hinge]) -> list[Array]:
    """(10,) of each body of zygos from those of the simulator, which has the reflected rotors (N,) of rigid joints in
    its inertials, and those of joints with springs as bodies of their own. segments: as `Robot.segments`."""
    out = [one.copy() for one in segments]
    floats = len(out) - arm.n
    for i, (inertia, ratio, hinge) in enumerate(zip(rotors, arm.gear_ratios, hinges, strict=True), start=floats):
        about = np.outer(hinge.axis, hinge.axis)[_UPPER]
        across = 0.5 * inertia * (np.eye(3)[_UPPER] - about)
        if hinge.spring is None:
            out[i][4:] -= ratio * inertia * about
            carried = np.concatenate([np.zeros(4), (ratio - 1.0) * inertia * about - across])
        else:
            carried = hinge.spring.rotor.standard
            carried[4:] -= inertia * about + across
        if i > 0:
            out[i - 1] += carried
    return out


def armatures(rotors: Array, arm: Arm) -> Array:
    """(N,) armatures that belong to rotors (N,) in the reflected map, kg m^2."""
    ratio = arm.gear_ratios
    return np.asarray((ratio**2 - ratio) * rotors, dtype=np.float64)


def origins(arm: Arm) -> Array:
    """(N, 3) places of the joints at zero angles, from `position_m`."""
    out, at = [], np.zeros(3)
    for joint, carrier in zip(arm.joints, arm.frames[:-1], strict=True):
        assert joint.position_m is not None
        at = at + carrier @ np.array(joint.position_m)
        out.append(at)
    return np.array(out)


def _spread(at: Array) -> Array:
    """(3, 3) inertia of a unit mass at `at` about the origin, m^2."""
    return np.asarray((at @ at) * np.eye(3) - np.outer(at, at), dtype=np.float64)


def _six(tensor: Array) -> tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]:
    ixx, ixy, ixz, iyy, iyz, izz = (Quantity(float(entry), 0.0, "CAD", "kg m^2") for entry in tensor[_UPPER])
    return ixx, ixy, ixz, iyy, iyz, izz


def body_of(name: str, lump: Lump) -> Body:
    """The body of a model with this mass, mass centre and inertia."""
    x, y, z = (float(value) for value in lump.centre)
    return Body(name, Quantity(lump.mass, 0.0, "CAD", "kg"), (x, y, z), _six(lump.tensor))


def written(numbers: Array | Sequence[float]) -> str:
    """Numbers in a file, with ten digits; what rounding leaves of a zero is 0."""
    least = 1e-9 * max(abs(float(x)) for x in numbers)
    return " ".join(f"{float(x):.10g}" if abs(float(x)) > least else "0" for x in numbers)


def _said(vector: Sequence[float] | Array) -> str:
    return "[" + ", ".join(f"{float(value):.4g}" for value in vector) + "]"

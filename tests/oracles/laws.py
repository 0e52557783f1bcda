# SPDX-License-Identifier: MIT
"""Effects that the plant hides. Each is a torque along one direction of the plant's coordinates.

None of them has the form of a column of the package: friction is a tanh or a Dahl spring and never a sign, viscous
friction bends, the spring's excess is no pure cube, a late torque is a low pass and no delay.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, sin, tanh
from typing import ClassVar, Literal, NamedTuple

Where = Literal["motor", "link", "spring", "base"]
"""What a torque acts on: the rotor's hinge (before the gear); the link's hinge, against the carrying body; +1 on the
link's hinge and -1/n on the rotor's, as the joint's own spring; the base's hinge, from outside."""


class Local(NamedTuple):
    """The plant as the law of one joint sees it; rad, rad/s, after the gear."""

    phi: float
    """Absolute angle of the base."""
    q: float
    qd: float
    theta: float
    thetad: float
    stiffness: float
    """Of the joint's own spring, Nm/rad."""
    command: float
    """Rotor torque that is held, Nm."""
    step: float
    """Length of the integration step, s."""


@dataclass
class Law:
    """A hidden effect at a joint (0 = first). A run works on a copy, so that inner states start anew."""

    joint: int
    size: float

    key: ClassVar[str] = ""
    """What the package's catalogue calls such an effect; empty where it has no entry."""
    where: ClassVar[Where]
    unit: ClassVar[str]
    """Of `size`. Torques at a motor are before the gear, rates after it."""
    form: ClassVar[str]
    """Formula of the torque."""

    def begin(self, now: Local) -> None:
        """An integration step starts."""

    def torque(self, now: Local) -> float:
        """Nm along the law's direction, at any stage of the step."""
        raise NotImplementedError

    def end(self, now: Local) -> None:
        """The step is over."""


@dataclass
class MotorCoulomb(Law):
    """Friction of the rotor that reverses within +-v0 rad/s."""

    v0: float = 0.004

    key = "motor_coulomb"
    where = "motor"
    unit = "Nm"
    form = "-size tanh(thetad / v0)"

    def torque(self, now: Local) -> float:
        return -self.size * tanh(now.thetad / self.v0)


@dataclass
class MotorViscous(Law):
    """Friction of the rotor that grows with its rate, and less so towards `bend` rad/s."""

    bend: float = 5.0

    key = "motor_viscous"
    where = "motor"
    unit = "Nms/rad"
    form = "-size thetad / (1 + |thetad| / bend)"

    def torque(self, now: Local) -> float:
        return -self.size * now.thetad / (1.0 + abs(now.thetad) / self.bend)


@dataclass
class LinkCoulomb(Law):
    """Dahl friction of the link against the body that carries it: bristles that bend over `presliding` rad.

    dz/dq = (1 - z sign(qd)) / presliding has a closed form where q does not turn back, as within an integration step
    but for an invisibly short one.
    """

    presliding: float = 5e-4
    bent: float = field(default=0.0, init=False)
    """z at the start of the step, -1 .. 1."""
    start: float = field(default=0.0, init=False)

    key = "link_coulomb"
    where = "link"
    unit = "Nm"
    form = "-size z, dz/dt = (qd - |qd| z) / presliding"

    def begin(self, now: Local) -> None:
        self.start = now.q

    def _bristle(self, now: Local) -> float:
        way = now.q - self.start
        limit = 1.0 if way > 0.0 else -1.0
        return limit + (self.bent - limit) * exp(-abs(way) / self.presliding)

    def torque(self, now: Local) -> float:
        return -self.size * self._bristle(now)

    def end(self, now: Local) -> None:
        self.bent = self._bristle(now)


@dataclass
class CubicStiffness(Law):
    """A spring that hardens with its deflection d = theta - q."""

    key = "cubic_stiffness"
    where = "spring"
    unit = "Nm/rad^3"
    form = "size (d^3 + 0.3 d^5)"

    def torque(self, now: Local) -> float:
        d = now.theta - now.q
        return self.size * d**3 * (1.0 + 0.3 * d * d)

    def energy(self, d: float) -> float:
        """Stored at a deflection of d rad, J."""
        return self.size * d**4 * (0.25 + 0.05 * d * d)


@dataclass
class TorqueLag(Law):
    """The motor's torque follows its command as a first-order low pass.

    It acts with its mean over an integration step, so that a lag much shorter than the step keeps its impulse.
    """

    late: float = field(default=0.0, init=False)
    """Torque given at the start of the step, Nm."""
    mean: float = field(default=0.0, init=False)

    key = "torque_lag"
    where = "motor"
    unit = "s"
    form = "u - tau, du/dt = (tau - u) / size"

    def begin(self, now: Local) -> None:
        missing = self.late - now.command
        left = exp(-now.step / self.size)
        self.mean = missing * (1.0 - left) * self.size / now.step
        self.late = now.command + missing * left

    def torque(self, now: Local) -> float:
        return self.mean


@dataclass
class RateStiffness(Law):
    """Outside every catalogue: the joint's spring is stiffer by the share `size` while the link is faster than v."""

    v: float = 0.1
    """rad/s."""

    where = "spring"
    unit = "1"
    form = "size k tanh(|qd| / v) (theta - q)"

    def torque(self, now: Local) -> float:
        return self.size * now.stiffness * tanh(abs(now.qd) / self.v) * (now.theta - now.q)


@dataclass
class BaseDetent(Law):
    """Outside every catalogue: a torque on the base from outside. Its joint means nothing."""

    teeth: int = 8

    where = "base"
    unit = "Nm"
    form = "size sin(teeth phi)"

    def torque(self, now: Local) -> float:
        return self.size * sin(self.teeth * now.phi)

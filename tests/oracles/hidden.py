# SPDX-License-Identifier: MIT
"""What the plants of the trials hide: torques, errors of sensors, and changes of bodies.

Every law says which entry of the package's catalogue it is, if any (`key`), whether it has the form of that entry's
column (`exact`), and that column along an exact motion, so that the size of a law of another form can be stated as its
projection on the column. None of the package's laws is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import cos, exp, sin, tanh
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Place = Literal["motor", "link", "spring", "base", "field"]
"""What a torque acts on: the rotor before the gear; the link against the body that carries it; the joint's spring; the
base from outside. A field pulls at all bodies."""
WIDTH = 1e-3
"""Rate within which the Coulomb friction of the package's catalogue fades, rad/s."""


class Now(NamedTuple):
    """The plant as a law at one joint sees it; rad, rad/s, Nm; angles after the gear."""

    t: float
    step: float
    q: float
    qd: float
    theta: float
    thetad: float
    stiffness: float
    """Of the joint's own spring; 0 where it is rigid."""
    ratio: float
    """Of the gear."""
    command: float
    """Torque of the drive before the gear."""
    load: float
    """Torque that the joint passed on after the gear, one integration step ago."""
    omega: Array
    """(3,) rate of the base in its own axes."""
    attitude: float
    """Angle of a planar base; the angle about z of any other."""
    rates: Array
    """(N,) rates of all links."""

    @property
    def deflection(self) -> float:
        """Of the spring."""
        return self.theta - self.q


class Motion(NamedTuple):
    """An exact motion at n SYNC instants of an arm with N joints."""

    t: Array
    q: Array
    """(n, N)."""
    qd: Array
    theta: Array
    thetad: Array
    omega: Array
    """(n, 3)."""
    attitude: Array
    """(n,)."""
    tau: Array
    """(n, N) of the drives, before the gear."""
    load: Array
    """(n, N) through the joints, after the gear."""
    torques: Array
    """(n, laws) of the hidden laws along their directions."""
    ratio: Array
    """(N,) of the gears."""


@dataclass
class Law:
    """A hidden torque at a joint (0 = first). A run works on a copy, so that inner states start anew."""

    joint: int
    size: float

    key: ClassVar[str] = ""
    """Entry of the catalogue; empty where it has none."""
    near: ClassVar[tuple[str, ...]] = ()
    """Entries that a verdict "part named" may state instead, declared here before any run."""
    place: ClassVar[Place] = "motor"
    exact: ClassVar[bool] = False
    """Whether the law has the form of the catalogue's column."""

    @property
    def shape(self) -> float | None:
        """Of the catalogue's entry, where that has one and this law has it as well."""
        return None

    def begin(self, now: Now) -> None:
        """An integration step starts."""

    def torque(self, now: Now) -> float:
        """Nm along the law's direction, at any stage of the step."""
        raise NotImplementedError

    def end(self, now: Now) -> None:
        """The step is over."""

    def column(self, motion: Motion) -> Array | None:
        """(n,) torque of the catalogue's entry per unit; None where the size is the coefficient by definition."""
        return None

    def stiffness(self) -> float:
        """Largest slope of the torque over a rate, Nms/rad: it bounds the integration step."""
        return 0.0

    def _rate(self, now: Now) -> float:
        return now.thetad if self.place == "motor" else now.qd

    def _rates(self, motion: Motion) -> Array:
        return (motion.thetad if self.place == "motor" else motion.qd)[:, self.joint]


def _sign(rate: Array) -> Array:
    return np.asarray(np.clip(rate / WIDTH, -1.0, 1.0))


# Coulomb friction


@dataclass
class MotorCoulomb(Law):
    """Friction that reverses within a width, as the catalogue's."""

    key = "motor_coulomb"
    exact = True

    def torque(self, now: Now) -> float:
        return -self.size * min(1.0, max(-1.0, self._rate(now) / WIDTH))

    def column(self, motion: Motion) -> Array:
        return -_sign(self._rates(motion))

    def stiffness(self) -> float:
        return self.size / WIDTH


@dataclass
class LinkCoulomb(MotorCoulomb):
    """The same between a link and the body that carries it."""

    key = "link_coulomb"
    place = "link"


@dataclass
class TanhCoulomb(Law):
    """Friction that reverses as a tanh of the rate."""

    v0: float = 0.004

    key = "motor_coulomb"

    def torque(self, now: Now) -> float:
        return -self.size * tanh(self._rate(now) / self.v0)

    def column(self, motion: Motion) -> Array:
        return -_sign(self._rates(motion))

    def stiffness(self) -> float:
        return self.size / self.v0


@dataclass
class DahlLink(Law):
    """Dahl friction of a link: bristles that bend over `presliding` rad."""

    presliding: float = 5e-4
    bent: float = field(default=0.0, init=False)
    start: float = field(default=0.0, init=False)

    key = "link_coulomb"
    place = "link"
    near = ("link_stribeck",)

    def begin(self, now: Now) -> None:
        self.start = now.q

    def _bristle(self, now: Now) -> float:
        way = now.q - self.start
        limit = 1.0 if way > 0.0 else -1.0
        return limit + (self.bent - limit) * exp(-abs(way) / self.presliding)

    def torque(self, now: Now) -> float:
        return -self.size * self._bristle(now)

    def end(self, now: Now) -> None:
        self.bent = self._bristle(now)

    def column(self, motion: Motion) -> Array:
        return -_sign(self._rates(motion))


@dataclass
class LuGre(Law):
    """LuGre friction of a rotor: bristles, a Stribeck curve, and no viscous part. Nearest to Coulomb friction."""

    stribeck: float = 0.02
    extra: float = 0.15
    presliding: float = 3e-4
    bent: float = field(default=0.0, init=False)

    key = "motor_coulomb"
    near = ("motor_stribeck",)

    def _limit(self, rate: float) -> float:
        return 1.0 + self.extra * exp(-((rate / self.stribeck) ** 2))

    def torque(self, now: Now) -> float:
        return -self.size * self.bent

    def end(self, now: Now) -> None:
        rate = self._rate(now)
        limit = self._limit(rate)
        way = rate * now.step
        target = limit if way > 0.0 else -limit
        self.bent = target + (self.bent - target) * exp(-abs(way) / (self.presliding * limit))

    def column(self, motion: Motion) -> Array:
        return -_sign(self._rates(motion))


@dataclass
class BoucWen(Law):
    """Hysteresis after Bouc and Wen with an exponent of 1.3, which bends over `distance` rad of the motor."""

    distance: float = 0.01
    bent: float = field(default=0.0, init=False)

    key = "motor_dahl"
    near = ("motor_maxwell", "motor_coulomb", "motor_stribeck")

    def torque(self, now: Now) -> float:
        return -self.size * self.bent

    def end(self, now: Now) -> None:
        way = self._rate(now) * now.step / 10.0
        for _ in range(10):
            held = abs(self.bent) ** 1.3 * (0.5 + 0.5 * np.sign(way * self.bent))
            self.bent += way * (1.0 - held) / self.distance


@dataclass
class Sliders(Law):
    """Ten springs in parallel, each of which slides from its own share of `distance` rad on."""

    distance: float = 0.01
    bent: Array = field(default_factory=lambda: np.zeros(10), init=False)

    key = "motor_maxwell"
    near = ("motor_dahl", "motor_coulomb", "motor_stribeck")

    def torque(self, now: Now) -> float:
        return -self.size * float(self.bent.mean())

    def end(self, now: Now) -> None:
        way = self._rate(now) * now.step
        self.bent = np.clip(self.bent + way / (self.distance * np.linspace(0.1, 1.0, 10)), -1.0, 1.0)


@dataclass
class Stribeck(Law):
    """The excess of friction near rest, exp(-(v/vs)^2) sgn v, on top of nothing."""

    vs: float = 0.03

    key = "motor_stribeck"
    near = ("motor_coulomb",)
    exact = True

    @property
    def shape(self) -> float:
        return self.vs

    def torque(self, now: Now) -> float:
        rate = self._rate(now)
        return -self.size * exp(-((rate / self.vs) ** 2)) * min(1.0, max(-1.0, rate / WIDTH))

    def column(self, motion: Motion) -> Array:
        rate = self._rates(motion)
        return -_sign(rate) * np.exp(-((rate / self.vs) ** 2))

    def stiffness(self) -> float:
        return self.size / WIDTH


@dataclass
class StribeckLorentz(Stribeck):
    """The excess as 1 / (1 + (v/vs)^2) with a tanh."""

    exact = False

    def torque(self, now: Now) -> float:
        rate = self._rate(now)
        return -self.size * tanh(rate / 0.004) / (1.0 + (rate / self.vs) ** 2)

    def stiffness(self) -> float:
        return self.size / 0.004


# viscous friction


@dataclass
class MotorViscous(Law):
    """Friction in proportion to the rate."""

    key = "motor_viscous"
    exact = True

    def torque(self, now: Now) -> float:
        return -self.size * self._rate(now)

    def column(self, motion: Motion) -> Array:
        return -self._rates(motion)

    def stiffness(self) -> float:
        return self.size


@dataclass
class LinkViscous(MotorViscous):
    """The same at the link."""

    key = "link_viscous"
    place = "link"


@dataclass
class BentViscous(MotorViscous):
    """Friction that grows less than in proportion; a cell sets the bend to twenty times the arm's typical rate."""

    bend: float = 5.0

    exact = False

    def torque(self, now: Now) -> float:
        rate = self._rate(now)
        return -self.size * rate / (1.0 + abs(rate) / self.bend)


@dataclass
class BentLinkViscous(BentViscous):
    """The same at the link."""

    key = "link_viscous"
    place = "link"


@dataclass
class AsymmetricViscous(Law):
    """A viscous friction that is larger in one direction and smaller in the other, by `size`."""

    key = "viscous_asymmetry"
    near = ("motor_viscous", "torque_offset")
    exact = True

    def torque(self, now: Now) -> float:
        return -self.size * abs(self._rate(now))

    def column(self, motion: Motion) -> Array:
        return -np.abs(self._rates(motion))

    def stiffness(self) -> float:
        return self.size


@dataclass
class SmoothAsymmetry(AsymmetricViscous):
    """The same, rounded near rest."""

    exact = False

    def torque(self, now: Now) -> float:
        rate = self._rate(now)
        return -self.size * rate * tanh(rate / 0.02)


@dataclass
class LoadFriction(Law):
    """Friction in proportion to the load, both after the gear."""

    v0: float = 0.004

    key = "load_friction"
    near = ("motor_coulomb",)

    def torque(self, now: Now) -> float:
        return -self.size * abs(now.load) / now.ratio * tanh(self._rate(now) / self.v0)

    def column(self, motion: Motion) -> Array:
        return -np.abs(motion.load[:, self.joint]) / motion.ratio[self.joint] * _sign(self._rates(motion))

    def stiffness(self) -> float:
        return self.size * 100.0 / self.v0


# springs


@dataclass
class Cubic(Law):
    """A spring that hardens with the cube of its deflection."""

    key = "cubic_stiffness"
    near = ("backlash",)
    place = "spring"
    exact = True

    def torque(self, now: Now) -> float:
        return self.size * now.deflection**3

    def column(self, motion: Motion) -> Array:
        return np.asarray((motion.theta - motion.q)[:, self.joint] ** 3)


@dataclass
class Hardening(Cubic):
    """d^3 + 0.3 d^5, and an odd even part: the deflections of these arms are small, so the fifth power weighs more."""

    exact = False

    def torque(self, now: Now) -> float:
        d = now.deflection
        return self.size * d**3 * (1.0 + 0.3 * d * d)


@dataclass
class Backlash(Law):
    """A gap: the spring's torque is missing within +-size rad. The entry's coefficient is the stiffness, its shape the
    gap."""

    key = "backlash"
    near = ("cubic_stiffness", "motor_coulomb", "link_coulomb")
    place = "spring"

    @property
    def shape(self) -> float:
        return self.size

    def torque(self, now: Now) -> float:
        d, gap = now.deflection, self.size
        linear = now.stiffness * d
        return now.stiffness * (d - gap if d > gap else d + gap if d < -gap else 0.0) - linear

    def column(self, motion: Motion) -> Array:
        return -np.clip((motion.theta - motion.q)[:, self.joint], -self.size, self.size)


# the drive


@dataclass
class LowPass(Law):
    """The motor's torque follows its command as a first-order low pass."""

    late: float = field(default=0.0, init=False)
    mean: float = field(default=0.0, init=False)

    key = "torque_lag"

    def begin(self, now: Now) -> None:
        missing = self.late - now.command
        left = exp(-now.step / self.size)
        self.mean = missing * (1.0 - left) * self.size / now.step
        self.late = now.command + missing * left

    def torque(self, now: Now) -> float:
        return self.mean


@dataclass
class Offset(Law):
    """A constant torque that the reports do not contain; the entry is what the report has too much."""

    key = "torque_offset"
    exact = True

    def torque(self, now: Now) -> float:
        return -self.size


@dataclass
class Ripple(Law):
    """A torque that repeats with the angle, `order` times a turn of the motor, with a weaker third harmonic."""

    order: int = 2

    key = "ripple_sin"
    near = ("ripple_cos",)

    @property
    def shape(self) -> float:
        return float(self.order)

    def torque(self, now: Now) -> float:
        angle = self.order * now.ratio * now.theta
        return self.size * (sin(angle) + 0.1 * sin(3.0 * angle))


# the base


@dataclass
class BaseTorque(Law):
    """A constant torque on the base, in its axes, about z."""

    key = "base_torque"
    near = ("base_leak", "gravity_gradient_sin", "gravity_gradient_cos")
    place = "base"
    exact = True

    def torque(self, now: Now) -> float:
        return self.size


@dataclass
class Leak(Law):
    """A thruster that leaks from `onset` on, weaker with time."""

    onset: float = 20.0

    key = "base_leak"
    near = ("base_torque",)
    place = "base"

    def torque(self, now: Now) -> float:
        since = now.t - self.onset
        return self.size * (1.0 - exp(-since / 0.3)) if since > 0.0 else 0.0


@dataclass
class Gradient(Law):
    """A gravity gradient: sin of twice the attitude."""

    key = "gravity_gradient_sin"
    near = ("gravity_gradient_cos", "detent_sin", "base_torque")
    place = "base"
    exact = True

    def torque(self, now: Now) -> float:
        return self.size * sin(2.0 * now.attitude)


@dataclass
class TidalField(Law):
    """The gravity gradient of an arm in space: `size` is 3 mu / r^3, and the Earth stands still at `nadir`."""

    nadir: tuple[float, float, float] = (0.0, 0.0, -1.0)

    key = "gravity_gradient"
    near = ("base_torque", "base_leak")
    place = "field"
    exact = True

    def torque(self, now: Now) -> float:
        return self.size


@dataclass
class BaseDetent(Law):
    """Outside every catalogue: a torque on the base that repeats eight times a turn, distorted."""

    place = "base"
    near = ("detent_sin", "detent_cos", "gravity_gradient_sin", "gravity_gradient_cos")

    def torque(self, now: Now) -> float:
        return self.size * sin(8.0 * now.attitude + 0.6 * cos(5.0 * now.attitude))


# outside the catalogue


@dataclass
class RateStiffness(Law):
    """The joint's spring is stiffer by the share `size` while the link is fast."""

    place = "spring"
    near = ("cubic_stiffness",)

    def torque(self, now: Now) -> float:
        return self.size * now.stiffness * tanh(abs(now.qd) / 0.1) * now.deflection


@dataclass
class ConcaveFriction(Law):
    """Friction that bends at rates that the arm has: between viscous and Coulomb friction, and neither."""

    bend: float = 1.0

    near = ("motor_viscous", "motor_coulomb", "motor_stribeck", "link_viscous", "link_coulomb")

    def torque(self, now: Now) -> float:
        rate = self._rate(now)
        return -self.size * rate / (1.0 + abs(rate) / self.bend)

    def stiffness(self) -> float:
        return self.size


@dataclass
class QuadraticDrag(Law):
    """Friction with the square of the rate."""

    near = ("motor_viscous", "link_viscous")

    def torque(self, now: Now) -> float:
        rate = self._rate(now)
        return -self.size * abs(rate) * rate

    def column(self, motion: Motion) -> Array:
        return -self._rates(motion)

    def stiffness(self) -> float:
        return 4.0 * self.size


@dataclass
class PostureFriction(Law):
    """Coulomb friction that depends on where the joint stands."""

    near = ("motor_coulomb", "link_coulomb")

    def torque(self, now: Now) -> float:
        return -self.size * (1.0 + 0.6 * sin(3.0 * now.theta)) * tanh(now.thetad / 0.004)

    def column(self, motion: Motion) -> Array:
        return -_sign(self._rates(motion))

    def stiffness(self) -> float:
        return 1.6 * self.size / 0.004


@dataclass
class WarmingFriction(Law):
    """Viscous friction that falls to a third as the gear warms up."""

    near = ("motor_viscous", "link_viscous")

    def torque(self, now: Now) -> float:
        return -self.size * now.thetad * (1.0 + 2.0 * exp(-now.t / 20.0)) / 3.0

    def column(self, motion: Motion) -> Array:
        return -self._rates(motion)

    def stiffness(self) -> float:
        return self.size


@dataclass
class CrossDamping(Law):
    """A torque at this link in proportion to the rate of the joint before it (the one after, at the first): a cable."""

    place = "link"

    def torque(self, now: Now) -> float:
        other = self.joint - 1 if self.joint else 1
        return -self.size * float(now.rates[other])


@dataclass
class CableSpring(Law):
    """A cable across the joint that pulls it towards an angle, as the sine of twice the distance."""

    place = "link"
    near = ("torque_offset", "spring_offset")

    def torque(self, now: Now) -> float:
        return -self.size * sin(2.0 * (now.q - 0.4))


@dataclass
class HardCable(Law):
    """A cable across the joint that pulls it towards an angle, and the harder the farther it is. A sine of the angle
    would be the ripple of the catalogue, where a rigid joint has a gear ratio of 1."""

    place = "link"
    near = ("torque_offset", "spring_offset")

    def torque(self, now: Now) -> float:
        distance = now.q - 0.4
        return -self.size * distance * (1.0 + distance * distance)


@dataclass
class BaseDrag(Law):
    """A drag on the base with the square of its rate."""

    place = "base"
    near = ("base_torque", "base_leak")

    def torque(self, now: Now) -> float:
        rate = float(now.omega[2])
        return -self.size * abs(rate) * rate


# sensors: readings of an exact motion, before they are rounded


class Readings(NamedTuple):
    """What exact sensors would read, (n, N) each, of the gyro (n, 3) in base axes; torques as they are reported."""

    q: Array
    theta: Array
    omega: Array
    tau: Array


@dataclass(frozen=True)
class SensorError:
    """An error of a sensor at a joint (-1: the gyro), as the catalogue has it."""

    joint: int
    size: float
    key: str
    change: Callable[[Motion, Readings, int, float], Readings]
    near: tuple[str, ...] = ()
    exact: bool = True


def _only(values: Array, joint: int, column: Array) -> Array:
    out = values.copy()
    out[:, joint] = column
    return out


def link_scale(joint: int, size: float) -> SensorError:
    """A link encoder that reads too much by a share."""
    return SensorError(joint, size, "link_scale", lambda m, r, i, s: r._replace(q=_only(r.q, i, (1.0 + s) * r.q[:, i])))


def link_eccentricity(joint: int, size: float) -> SensorError:
    """A disc mounted off its centre: once a turn, with a small second harmonic; the sine part is the size."""
    return SensorError(
        joint,
        size,
        "link_eccentricity_sin",
        lambda m, r, i, s: r._replace(
            q=_only(r.q, i, r.q[:, i] + s * (np.sin(m.q[:, i]) + 0.1 * np.sin(2.0 * m.q[:, i])))
        ),
        ("link_eccentricity_cos", "link_scale", "link_zero"),
        exact=False,
    )


def motor_eccentricity(joint: int, size: float, ratio: float) -> SensorError:
    """The disc of a motor encoder, mounted off its centre: once a turn of the motor, with a small second harmonic."""

    def change(motion: Motion, readings: Readings, i: int, off: float) -> Readings:
        angle = ratio * motion.theta[:, i]
        wrong = off * (np.sin(angle) + 0.1 * np.sin(2.0 * angle))
        return readings._replace(theta=_only(readings.theta, i, readings.theta[:, i] + wrong))

    return SensorError(joint, size, "motor_eccentricity_sin", change, ("motor_eccentricity_cos",), exact=False)


def link_late(joint: int, size: float) -> SensorError:
    """A link encoder that latches late by `size` seconds: it reads a later angle."""

    def change(motion: Motion, readings: Readings, i: int, late: float) -> Readings:
        qd = motion.qd[:, i]
        h = motion.t[1] - motion.t[0]
        bend = np.gradient(qd, h)
        return readings._replace(q=_only(readings.q, i, readings.q[:, i] + late * qd + 0.5 * late**2 * bend))

    return SensorError(joint, size, "link_late", change)


def motor_scale(joint: int, size: float) -> SensorError:
    """A motor encoder that reads too much by a share."""
    return SensorError(
        joint, size, "motor_scale", lambda m, r, i, s: r._replace(theta=_only(r.theta, i, (1.0 + s) * r.theta[:, i]))
    )


def motor_late(joint: int, size: float) -> SensorError:
    """A motor encoder that latches late by `size` seconds."""

    def change(motion: Motion, readings: Readings, i: int, late: float) -> Readings:
        rate = motion.thetad[:, i]
        bend = np.gradient(rate, motion.t[1] - motion.t[0])
        return readings._replace(
            theta=_only(readings.theta, i, readings.theta[:, i] + late * rate + 0.5 * late**2 * bend)
        )

    return SensorError(joint, size, "motor_late", change, ("torque_lag",))


def motor_zero(joint: int, size: float) -> SensorError:
    """A motor encoder that reads too much by a constant."""
    return SensorError(
        joint, size, "motor_zero", lambda m, r, i, s: r._replace(theta=_only(r.theta, i, r.theta[:, i] + s)),
        ("link_zero", "spring_offset"),
    )  # fmt: skip


def gyro_bias(_: int, size: float) -> SensorError:
    """A constant rate that the gyro reads at rest, about z of the base."""
    return SensorError(
        -1, size, "gyro_bias", lambda m, r, i, s: r._replace(omega=r.omega + s * np.array([0.0, 0.0, 1.0]))
    )


def gyro_scale(_: int, size: float) -> SensorError:
    """A gyro that reads too much by a share."""
    return SensorError(-1, size, "gyro_scale", lambda m, r, i, s: r._replace(omega=(1.0 + s) * r.omega))


def torque_gain(joint: int, size: float) -> SensorError:
    """A torque that acts exceeds the reported one by a share."""
    return SensorError(
        joint, size, "torque_gain", lambda m, r, i, s: r._replace(tau=_only(r.tau, i, r.tau[:, i] / (1.0 + s)))
    )

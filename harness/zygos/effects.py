"""The catalogue of effects that a model may carry beyond rigid bodies, rotors and linear springs.

An entry here defines an effect completely: its name in the model file, the torque that the simulator applies, and the
columns that it has in the balances. A torque law f with coefficient c acts

    at the motor:   rotor torque -c f(thetad)       energy column  n int f thetad dt     impulse column  int f dt
    at the link:    link torque  -c f(qd)                          int f qd dt                           none
    in the spring:  link torque  +c f(theta - q)                   int f d(theta - q)                    1/n int f dt

with all angles after the gear. The columns are computed in `zygos.balances.effects`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zygos.arm import MOST_JOINTS, Arm
from zygos.errors import ZygosError

Array = NDArray[np.float64]
Place = Literal["motor", "link", "spring", "torque", "rotor", "base", "load", "sensor"]

OFFSET = "spring_offset"
"""Key of the effect with which an estimator accounts for encoders whose zeros are wrong."""

SLOWEST_RATE = 1e-3
"""Rate below which Coulomb friction fades linearly to zero, rad/s after the gear: a sign function cannot be integrated,
and a noisy rate does not show its sign."""


@dataclass(frozen=True)
class Kind:
    """One entry of the catalogue."""

    key: str
    """Name of the effect in files; followed by the joint's number it is the name of the column."""
    title: str
    """Name of the effect in sentences."""
    unit: str
    place: Place
    torque: Callable[[Array], Array] | None = None
    """f: torque per unit coefficient, as a function of the rate (motor, link; rad/s) or the deflection (spring;
    rad)."""
    potential: Callable[[Array], Array] | None = None
    """Stored energy per unit coefficient as a function of the deflection, where f is conservative."""
    impulse: Callable[[Array], Array] | None = None
    """Integral of f over time per unit coefficient as a function of the angle (motor; rad), where the angle alone
    determines it."""
    viscous: bool = False
    """Whether f is proportional to a rate. Its power is then a square, in which noise leaves a mean value."""
    positive: bool = True
    """Whether the coefficient must not be negative: a negative one would create energy, so the model would be wrong."""
    twins: tuple[str, ...] = ()
    """Keys of the effects that look the same as this one in some motions."""
    searched: bool = True
    """Whether `zygos explain` tries this effect."""

    @property
    def on_ground(self) -> bool:
        """Whether only estimates on the ground have a column for it: it needs the predicted torque, or multiplies the
        reported one."""
        return self.place in ("load", "sensor")

    @property
    def at_joint(self) -> bool:
        """Whether the effect belongs to a joint."""
        return self.place != "base"


def smooth_sign(rate: Array) -> Array:
    """Sign of a rate (rad/s), linear within `SLOWEST_RATE`."""
    return np.clip(rate / SLOWEST_RATE, -1.0, 1.0)


def _same(x: Array) -> Array:
    return x


def _cube(deflection: Array) -> Array:
    return deflection**3


def _one(deflection: Array) -> Array:
    return np.ones_like(deflection)


def _quarter_fourth(deflection: Array) -> Array:
    return 0.25 * deflection**4


CATALOGUE = {
    kind.key: kind
    for kind in (
        Kind(
            "motor_coulomb",
            "Coulomb friction at the motor",
            "Nm",
            "motor",
            smooth_sign,
            twins=("motor_viscous", "link_coulomb"),
        ),
        Kind(
            "motor_viscous",
            "viscous friction at the motor",
            "Nms/rad",
            "motor",
            _same,
            impulse=_same,
            viscous=True,
            twins=("motor_coulomb", "torque_lag"),
        ),
        Kind("torque_offset", "constant offset of the torque", "Nm", "motor", _one, positive=False, searched=False),
        Kind(
            "viscous_asymmetry",
            "difference of viscous friction between the directions",
            "Nms/rad",
            "motor",
            np.abs,
            positive=False,
            searched=False,
        ),
        Kind("load_friction", "friction in proportion to the load", "1", "load", searched=False),
        Kind("torque_gain", "error of the torque sensor's gain", "1", "sensor", positive=False, searched=False),
        Kind("link_coulomb", "Coulomb friction at the link", "Nm", "link", smooth_sign, twins=("motor_coulomb",)),
        Kind("cubic_stiffness", "cubic joint stiffness", "Nm/rad^3", "spring", _cube, _quarter_fourth, positive=False),
        Kind(OFFSET, "offset of the spring", "Nm", "spring", _one, _same, positive=False),
        Kind("torque_lag", "torque lag", "s", "torque", twins=("motor_viscous",)),
        Kind("rotor_coupling", "rotor gyroscopic coupling", "1", "rotor", positive=False),
        Kind("angular_momentum", "angular momentum", "Nms", "base", positive=False),
    )
}
"""Entries by key. Units are those of the coefficient: torques at a motor in Nm before the gear, rates after it.

torque_offset: the constant by which the reported torque exceeds the one that acts. A friction of different size in both
directions looks the same except at rest, so that one entry stands for both.
viscous_asymmetry: half of the difference of the viscous coefficients in positive and negative direction.
load_friction: share of the torque through the gear, as the model predicts it, that friction opposes the motion with.
torque_gain: share by which the torque that acts exceeds the reported one. The gain of one joint must be left out:
without a torque that is known, all gains, masses and frictions can grow together.
spring_offset: the spring's torque where theta = q reads 0. If wrong encoder zeros make theta - q read too large by x, a
spring of stiffness k looks as if it had an offset of -k x.
torque_lag: the time by which the motor follows the reported torque later, less than a SYNC period.
rotor_coupling: the share of the rotor's inertia that the carrying body's rotation acts on. It is 1 in nature and 0 in
simulators whose `armature` adds to the joint's inertia alone. A model that does not mention it has 1.
angular_momentum: the angular momentum of the whole arm about its mass centre. A model that does not mention it makes no
assumption about it.
"""


@dataclass(frozen=True)
class Effect:
    """An effect in a model, with its value."""

    kind: Kind
    joint: str | None
    """Name of its joint; None for an effect of the base."""
    value: float
    sigma: float = 0.0
    source: str = "CAD"
    evidence: str = ""
    """Why the effect is in the model, in words."""

    def index(self, arm: Arm) -> int:
        """Number of the effect's joint from 0; -1 for the base.

        Errors: ZygosError if the arm has no such joint, or if what the effect acts on does not exist in this arm: a
        spring, a carrying body that turns, or an angular momentum that is a single number.
        """
        names = [joint.name for joint in arm.joints]
        if self.joint is None:
            if not arm.free or arm.spatial:
                lacks = "the base is fixed" if not arm.free else "the arm moves in space, where it is a vector"
                raise ZygosError(
                    f"effect {self.kind.key}: exists only for free-floating planar arms, but for arm {arm.name} "
                    f"{lacks}; "
                    "remedy: remove the entry"
                    + (", and state angular_momentum_nms in the scenario" if arm.free else "")
                )
            return -1
        if self.joint not in names:
            raise ZygosError(
                f"effect {self.kind.key}: arm {arm.name} has no joint {self.joint!r}; remedy: one of {', '.join(names)}"
            )
        joint = names.index(self.joint)
        if self.kind.place == "spring" and not arm.joints[joint].flexible:
            raise ZygosError(
                f"effect {self.kind.key} at {self.joint}: the joint is rigid in arm {arm.name} and has no spring; "
                "remedy: remove the entry, or write flexible = true in the arm file"
            )
        if self.kind.place == "rotor" and joint == 0 and not arm.free:
            raise ZygosError(
                f"effect {self.kind.key} at {self.joint}: the body that carries this rotor is the base, which is fixed "
                f"in arm {arm.name} and does not turn; remedy: remove the entry"
            )
        return joint

    def column(self, arm: Arm) -> str:
        """Name of the effect's column: the key of its kind, and the number of its joint from 1."""
        return column_name(self.kind, self.index(arm))


def effect(kind: str, joint: str | None = None, value: float = 0.0, sigma: float = 0.0) -> Effect:
    """An effect of the catalogue: `kind` is its key there, joint the name of its joint, None for one of the base.

    value, sigma: in the unit of its entry. Errors: ZygosError for a key that is not in the catalogue, and for a joint
    where none belongs, or none where one does.
    """
    if kind not in CATALOGUE:
        raise ZygosError(f"there is no effect {kind!r}; remedy: one of {', '.join(CATALOGUE)}")
    entry = CATALOGUE[kind]
    if entry.at_joint != (joint is not None):
        remedy = "name its joint" if entry.at_joint else "leave the joint out"
        raise ZygosError(f"effect {kind}: belongs to {'a joint' if entry.at_joint else 'the base'}; remedy: {remedy}")
    return Effect(entry, joint, value, sigma)


class EffectColumn(NamedTuple):
    """The column of an entry of the catalogue at a joint."""

    key: str
    joint: int
    """From 0; -1 for the base."""

    @property
    def name(self) -> str:
        """The entry's key, and the number from 1 of the joint."""
        return self.key if self.joint < 0 else f"{self.key}{self.joint + 1}"


def column_name(kind: Kind, joint: int) -> str:
    """Name of the column of an entry at a joint (from 0; -1 for the base)."""
    return EffectColumn(kind.key, joint).name


def column_named(name: str) -> EffectColumn:
    """The column of that name. Errors: KeyError where the catalogue has none."""
    return _columns()[name]


def is_column(name: str) -> bool:
    """Whether an entry of the catalogue has a column of that name."""
    return name in _columns()


def _columns() -> dict[str, EffectColumn]:
    """Every column of the catalogue by name, for as many joints as a bus has nodes."""
    places = [(kind, joint) for kind in CATALOGUE.values() for joint in (range(MOST_JOINTS) if kind.at_joint else [-1])]
    return {column.name: column for column in (EffectColumn(kind.key, joint) for kind, joint in places)}


def spoken(arm: Arm, column: str) -> str:
    """Name of a column in sentences: title and joint of its effect."""
    key, joint = column_named(column)
    title = CATALOGUE[key].title
    return title if joint < 0 else f"{title} ({arm.joints[joint].name})"


def estimated(arm: Arm, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that have a column in the energy balance, so that an estimator finds their values.

    These are the effects of a model, without those that exist only in an estimate on the ground. Where it does not name
    the offset of a spring, the offset is added if the zero of one of the encoders is uncertain (`zero_sigma_rad` above
    0). Rotor coupling as in nature is part of the columns of every arm, and an angular momentum does no work: both are
    omitted. Errors: ZygosError for any other rotor coupling, and for an effect that the arm cannot have.
    """
    for effect in effects:
        effect.index(arm)
        if effect.kind.key == "rotor_coupling" and effect.value != 1.0:
            raise ZygosError(
                f"effect rotor_coupling at {effect.joint}: the estimator has no columns for a rotor coupling of "
                f"{effect.value:g}; remedy: leave the entry out, in nature it is 1"
            )
    offset = CATALOGUE[OFFSET]
    named = {effect.joint for effect in effects if effect.kind == offset}
    return (
        *(effect for effect in effects if effect.kind.place not in ("rotor", "base", "load", "sensor")),
        *(Effect(offset, joint.name, 0.0) for joint in arm.joints if joint.unsure_zero and joint.name not in named),
    )

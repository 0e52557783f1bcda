"""The catalogue of effects that a model may carry beyond rigid bodies, rotors and linear springs.

One entry is all there is of an effect: its name in the model file, the torque that the simulator applies, and the
columns it has in the balances follow from it. A torque law f acts with coefficient c

    at the motor:   rotor torque -c f(thetad)       energy column  n int f thetad dt     impulse column  int f dt
    at the link:    link torque  -c f(qd)                          int f qd dt                           none
    in the spring:  link torque  +c f(theta - q)                   int f d(theta - q)                    1/n int f dt

with all angles after the gear. The columns are made in `zygos.balances.effects`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError

Array = NDArray[np.float64]
Place = Literal["motor", "link", "spring", "torque", "rotor", "base"]

OFFSET = "spring_offset"
"""The entry by which an estimator takes encoders whose zeros are off."""

SLOWEST_RATE = 1e-3
"""Below this rate, rad/s after the gear, Coulomb friction fades to zero: a sign cannot be integrated, nor be read from
a noisy rate."""


@dataclass(frozen=True)
class Kind:
    """One entry of the catalogue."""

    key: str
    """Its name in files; with the joint's number, that of its column."""
    title: str
    """As a sentence names it."""
    unit: str
    place: Place
    torque: Callable[[Array], Array] | None = None
    """f: of the rate (motor, link; rad/s) or the deflection (spring; rad), torque a unit coefficient."""
    potential: Callable[[Array], Array] | None = None
    """Energy stored a unit coefficient, of the deflection, where f is conservative."""
    impulse: Callable[[Array], Array] | None = None
    """Integral of f over time a unit coefficient, of the angle (motor; rad), where the angle alone tells it."""
    positive: bool = True
    """Whether a negative coefficient would create energy, and so means that the model is wrong."""
    twins: tuple[str, ...] = ()
    """Entries that some motions cannot tell from this one."""

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
            twins=("motor_coulomb", "torque_lag"),
        ),
        Kind("link_coulomb", "Coulomb friction at the link", "Nm", "link", smooth_sign, twins=("motor_coulomb",)),
        Kind("cubic_stiffness", "cubic joint stiffness", "Nm/rad^3", "spring", _cube, _quarter_fourth, positive=False),
        Kind(OFFSET, "offset of the spring", "Nm", "spring", _one, _same, positive=False),
        Kind("torque_lag", "torque lag", "s", "torque", twins=("motor_viscous",)),
        Kind("rotor_coupling", "rotor gyroscopic coupling", "1", "rotor", positive=False),
        Kind("angular_momentum", "angular momentum", "Nms", "base", positive=False),
    )
}
"""Entries by key. Units are those of the coefficient: torques at a motor in Nm before the gear, rates after it.

spring_offset: the spring's torque where theta = q reads 0. Encoders whose zeros are off, so that theta - q reads too
much by x, make a spring of stiffness k look as if it had one of -k x.
torque_lag: the motor follows the reported torque later by that time, less than a SYNC period.
rotor_coupling: the share of the rotor's inertia that the carrying body's rotation acts on, 1 in nature and 0 in
simulators whose `armature` adds to the joint's inertia alone. A model that does not mention it has 1.
angular_momentum: that of the whole arm about its mass centre. A model that does not mention it assumes none in
particular.
"""


@dataclass(frozen=True)
class Effect:
    """An effect in a model."""

    kind: Kind
    joint: str | None
    """Name of its joint; None for an effect of the base."""
    value: float
    sigma: float = 0.0
    source: str = "CAD"
    evidence: str = ""
    """Why it is in the model, in words."""

    def index(self, arm: Arm) -> int:
        """Number of its joint from 0; -1 for the base.

        Errors: ZygosError if the arm has no such joint, or not what the effect acts on: a spring, a carrying body that
        turns, a momentum of the whole arm that one number is.
        """
        names = [joint.name for joint in arm.joints]
        if self.joint is None:
            if not arm.free or arm.spatial:
                lacks = "its base is fixed" if not arm.free else "it moves in space, where that is a vector"
                raise ZygosError(
                    f"effect {self.kind.key}: is one of free-floating arms in a plane, but of arm {arm.name} {lacks}; "
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
        """Name of its column: the entry's, and the number of its joint from 1."""
        return column_name(self.kind, self.index(arm))


def column_name(kind: Kind, joint: int) -> str:
    """Name of a column: the entry's, and the number from 1 of its joint (from 0; below 0: the base)."""
    return kind.key if joint < 0 else f"{kind.key}{joint + 1}"


def of_column(name: str) -> tuple[str, int]:
    """The inverse of `column_name`: the entry's key, and its joint from 0, -1 for the base."""
    key = name.rstrip("0123456789")
    return key, int(name[len(key) :] or 0) - 1


def spoken(arm: Arm, column: str) -> str:
    """A column as a sentence names it: title and joint of its effect."""
    key, joint = of_column(column)
    title = CATALOGUE[key].title
    return title if joint < 0 else f"{title} ({arm.joints[joint].name})"


def estimated(arm: Arm, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that have a column in the energy balance, so that an estimator finds their values.

    Those of a model, and, where it does not name them, the offset of each spring between encoders whose zeros the arm
    file does not vouch for (`zero_sigma_rad` above 0). Rotor coupling as in nature is in the columns of every arm, and
    an angular momentum does no work: both are passed over. Errors: ZygosError for any other rotor coupling, and for an
    effect that the arm cannot have.
    """
    for effect in effects:
        effect.index(arm)
        if effect.kind.key == "rotor_coupling" and effect.value != 1.0:
            raise ZygosError(
                f"effect rotor_coupling at {effect.joint}: the estimator has no columns for a rotor that couples by "
                f"{effect.value:g}; remedy: leave the entry out, in nature it is 1"
            )
    offset = CATALOGUE[OFFSET]
    named = {effect.joint for effect in effects if effect.kind == offset}
    return (
        *(effect for effect in effects if effect.kind.place not in ("rotor", "base")),
        *(Effect(offset, joint.name, 0.0) for joint in arm.joints if joint.unsure_zero and joint.name not in named),
    )

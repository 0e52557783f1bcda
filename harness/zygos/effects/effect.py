# SPDX-License-Identifier: MIT
"""An effect in a model: an entry of the catalogue with its place and its value, and the names of its columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zygos.arm import MOST_JOINTS, Arm
from zygos.effects.catalogue import CATALOGUE, GAIN, OFFSET
from zygos.effects.kind import Kind, R
from zygos.effects.motion import Motion
from zygos.errors import ZygosError

Array = NDArray[np.float64]


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
    shape: float | None = None
    """Shape parameter of its law; None where the law has none."""
    component: str = ""
    """Which of the components of `Kind.components`; empty where it is a number."""

    def index(self, arm: Arm) -> int:
        """Number of the effect's joint from 0; -1 for the base.

        Errors: ZygosError if the arm has no such joint, or if what the effect acts on does not exist in this arm: a
        spring, a carrying body that turns, a base that moves, a component; and for a law without its shape.
        """
        kind, names = self.kind, [joint.name for joint in arm.joints]
        where = f" at {self.joint}" if self.joint is not None else ""
        if self.joint is not None and self.joint not in names:
            raise ZygosError(
                f"effect {kind.key}: arm {arm.name} has no joint {self.joint!r}; remedy: one of {', '.join(names)}"
            )
        joint = names.index(self.joint) if self.joint is not None else -1
        if lacking := kind.lacking(arm, joint):
            raise ZygosError(f"effect {kind.key}{where}: {lacking}; remedy: {self._remedy(arm)}")
        if self.component not in kind.components(arm):
            raise ZygosError(
                f"effect {kind.key}{where}: has no component {self.component!r} on arm {arm.name}; remedy: "
                + (f"component = one of {', '.join(kind.components(arm))}" if kind.components(arm)[0] else "remove it")
            )
        if (self.shape is None) == bool(kind.shapes):
            raise ZygosError(
                f"effect {kind.key}{where}: its law "
                + (f"needs a shape ({kind.shape_title}, {kind.shape_unit})" if kind.shapes else "has no shape")
                + f"; remedy: {'give' if kind.shapes else 'leave out'} shape"
            )
        return joint

    def _remedy(self, arm: Arm) -> str:
        if self.kind.place == "spring":
            return "remove the entry, or write flexible = true in the arm file"
        if self.kind.key == "angular_momentum" and arm.free:
            return "remove the entry, and state angular_momentum_nms in the scenario"
        if self.kind.place == "field" and arm.free and arm.spatial:
            return "remove the entry, or state nadir in the arm file"
        return "remove the entry"

    def component_index(self, arm: Arm) -> int:
        """Number of its component from 0."""
        return self.kind.components(arm).index(self.component)

    def law(self, motion: Motion, period_s: float) -> Array:
        """Its torque, or what stands for it at its site, per unit of its value, along a motion at instants a period
        apart."""
        assert self.kind.law is not None
        shape = np.nan if self.shape is None else self.shape
        return self.kind.law(self.kind.memory.along(motion, shape, period_s) if self.kind.memory else motion, shape)

    def column(self, arm: Arm) -> str:
        """Name of the effect's column: the key of its kind, and the number of its joint from 1 or its component."""
        return column_name(self.kind, self.index(arm), self.component)


def effect(
    kind: str,
    joint: str | None = None,
    value: float = 0.0,
    sigma: float = 0.0,
    shape: float | None = None,
    component: str = "",
) -> Effect:
    """An effect of the catalogue: `kind` is its key there, joint the name of its joint, None for one of the base.

    value, sigma: in the unit of its entry; shape in that of its shape. Errors: ZygosError for a key that is not in the
    catalogue, for a joint where none belongs, or none where one does, and likewise for a shape.
    """
    if kind not in CATALOGUE:
        raise ZygosError(f"there is no effect {kind!r}; remedy: one of {', '.join(CATALOGUE)}")
    entry = CATALOGUE[kind]
    if entry.at_joint != (joint is not None):
        remedy = "name its joint" if entry.at_joint else "leave the joint out"
        raise ZygosError(f"effect {kind}: belongs to {'a joint' if entry.at_joint else 'the base'}; remedy: {remedy}")
    if bool(entry.shapes) != (shape is not None):
        remedy = f"give its {entry.shape_title}" if entry.shapes else "leave the shape out"
        raise ZygosError(f"effect {kind}: its law has {'a' if entry.shapes else 'no'} shape; remedy: {remedy}")
    return Effect(entry, joint, value, sigma, shape=shape, component=component)


def sensed(arm: Arm, exact: R, sensors: Sequence[Effect]) -> R:
    """What sensors with these errors read where exact ones read `exact`."""
    for one in sensors:
        exact = one.kind.transform(arm, exact, one.index(arm), one.value, one.component_index(arm))
    return exact


class EffectColumn(NamedTuple):
    """The column of an entry of the catalogue at a joint."""

    key: str
    joint: int
    """From 0; -1 for the base."""
    component: str = ""

    @property
    def name(self) -> str:
        """The entry's key, and the number from 1 of the joint or the name of the component."""
        return f"{self.key}{self.component}" if self.joint < 0 else f"{self.key}{self.joint + 1}"


def column_name(kind: Kind, joint: int, component: str = "") -> str:
    """Name of the column of an entry at a joint (from 0; -1 for the base)."""
    return EffectColumn(kind.key, joint, component).name


def columns_at(arm: Arm, kind: Kind) -> tuple[EffectColumn, ...]:
    """Every column that an entry has on an arm: at each joint that can have it, or each component."""
    joints = range(arm.n) if kind.at_joint else (-1,)
    return tuple(
        EffectColumn(kind.key, joint, component)
        for joint in joints
        if not kind.lacking(arm, joint)
        for component in kind.components(arm)
    )


def column_named(name: str) -> EffectColumn:
    """The column of that name, with or without @ and the shape of its law. Errors: KeyError where the catalogue has
    none."""
    name = name.partition("@")[0]
    columns = _columns(tuple(CATALOGUE.values()))
    if name in columns:
        return columns[name]
    for kind in CATALOGUE.values():
        # a change of a body has a column for each parameter, which an arm names
        if kind.place == "body" and name.startswith(kind.key) and name != kind.key:
            return EffectColumn(kind.key, -1, name.removeprefix(kind.key))
    raise KeyError(name)


def is_column(name: str) -> bool:
    """Whether an entry of the catalogue has a column of that name."""
    try:
        column_named(name)
    except KeyError:
        return False
    return True


@cache
def _columns(kinds: tuple[Kind, ...]) -> dict[str, EffectColumn]:
    """Every column of entries by name, for as many joints as a bus has nodes."""
    out: dict[str, EffectColumn] = {}
    for kind in kinds:
        components = ("", "x", "y", "z") if kind.axes else ("",)
        for joint in range(MOST_JOINTS) if kind.at_joint else (-1,):
            for column in (EffectColumn(kind.key, joint, component) for component in components):
                out[column.name] = column
    return out


def spoken(arm: Arm, column: str) -> str:
    """Name of a column in sentences: title and joint of its effect."""
    key, joint, component = column_named(column)
    title = CATALOGUE[key].title
    return f"{title} ({arm.joints[joint].name})" if joint >= 0 else f"{title} ({component})" if component else title


def estimated(arm: Arm, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that have a column in the energy balance, so that an estimator finds their values.

    These are the effects of a model at its joints, without those of encoders and without friction in proportion to the
    load, which only an estimate on the ground has. Where it does not name the offset of a spring, the offset is added
    if the zero of one of the encoders is uncertain (`zero_sigma_rad` above 0). Rotor coupling as in nature is part of
    the columns of every arm, and an angular momentum does no work: both are omitted. Errors: ZygosError for any other
    rotor coupling, and for an effect that the arm cannot have.
    """
    for effect in effects:
        effect.index(arm)
        if effect.kind.place == "rotor" and effect.value != 1.0:
            raise ZygosError(
                f"effect {effect.kind.key} at {effect.joint}: the estimator has no columns for a rotor coupling of "
                f"{effect.value:g}; remedy: leave the entry out, in nature it is 1"
            )
    offset = CATALOGUE[OFFSET]
    named = {effect.joint for effect in effects if effect.kind == offset}
    return (
        *(effect for effect in effects if effect.kind.at_joint and _has_column(effect.kind)),
        *(Effect(offset, joint.name, 0.0) for joint in arm.joints if joint.unsure_zero and joint.name not in named),
    )


def with_gains(arm: Arm, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects that `estimated` names and, behind them, the gains of the torque sensors relative to the most exact
    one (`Arm.relative_gains`), whether the effects name them or not. Errors: as `estimated`."""
    others = (effect for effect in estimated(arm, effects) if not effect.kind.gain)
    return (*others, *gains(arm))


def gains(arm: Arm) -> tuple[Effect, ...]:
    """The gain of each torque sensor that has one relative to the most exact sensor (`Arm.relative_gains`)."""
    return tuple(Effect(CATALOGUE[GAIN], arm.joints[i].name, 0.0) for i in arm.relative_gains)


def _has_column(kind: Kind) -> bool:
    return kind.place in ("motor", "link", "spring", "torque")

# SPDX-License-Identifier: MIT
"""What `zygos explain` tries at the joints of an arm on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from zygos.arm import Arm
from zygos.effects import CATALOGUE, Effect, Kind, column_name
from zygos.effects.catalogue import ENTRIES
from zygos.gap.findings import ROTOR_INERTIA
from zygos.model.model import Model

_PLACES = ("motor", "link", "load", "torque")
"""Sites at which the torques of a rigid joint show an effect."""
_KNOWN = frozenset(kind.key for kind in ENTRIES)
GAIN = "torque_gain"
OFFSET_OF_TORQUE = "torque_offset"
"""Every fit has this one, for each run."""


@dataclass(frozen=True)
class Candidate:
    """A column that is tried."""

    name: str
    """Of its column."""
    key: str
    """Name in the catalogue, or `ROTOR_INERTIA`."""
    title: str
    unit: str
    joint: int
    """From 0."""
    positive: bool
    """Whether a negative coefficient would create energy."""
    effect: Effect | None
    """The entry of a model; None for a parameter of the arm."""


def candidates_of(
    arm: Arm, simulation: Model, without: Sequence[str] = (), *, wide: bool = False
) -> tuple[Candidate, ...]:
    """Everything that the simulation may lack: entries of the catalogue, and inertias of rotors where it has none. A
    law with a shape is tried with every shape of its grid. wide: entries that look like others in many motions as
    well."""
    had = {(effect.kind.key, effect.joint) for effect in simulation.effects}
    out = [
        Candidate(
            column_name(kind, j) + ("" if shape is None else f"@{shape:g}"),
            kind.key,
            kind.title,
            kind.unit,
            j,
            kind.positive,
            Effect(kind, joint.name, 0.0, shape=shape),
        )
        for kind in CATALOGUE.values()
        if _is_tried(kind, wide) and not kind.left_out(without)
        for j, joint in enumerate(arm.joints)
        if (kind.key, joint.name) not in had and (kind.key != GAIN or j > 0)
        for shape in (kind.shapes or (None,))
    ]
    return (*out, *_rotors(arm, simulation))


def _is_tried(kind: Kind, wide: bool) -> bool:
    """Whether an entry is tried: those of the catalogue that say so, the time of the torques, and a user's own. The
    link and the motor of a rigid joint turn together, so that entries at the link are found at the motor."""
    own = kind.searched and kind.key not in _KNOWN
    last = wide and kind.place in ("motor", "torque") and kind.searched_last and kind.memory is None
    return (
        kind.place in _PLACES and kind.key != OFFSET_OF_TORQUE and (kind.searched_on_ground or kind.lags or own or last)
    )


def _rotors(arm: Arm, simulation: Model) -> list[Candidate]:
    base = simulation.base_values(arm)
    out = []
    for parameter, value in zip(arm.parameters, base.tolist(), strict=True):
        if parameter.symbol == "Im" and value == 0.0 and parameter.joint is not None:
            out.append(
                Candidate(
                    parameter.name,
                    ROTOR_INERTIA,
                    "inertia of the rotor",
                    "kg m^2",
                    parameter.joint,
                    positive=True,
                    effect=None,
                )
            )
    return out


def names_of(candidates: Sequence[Candidate]) -> list[str]:
    """Their columns."""
    return [one.name for one in candidates]

# SPDX-License-Identifier: MIT
"""Delays between signals: readings that are older, or newer, than the others of their cycle.

The readings of a group are taken from other cycles, and the run is explained best where they belong. What is left over
of a balance is a quadratic function of a small shift, so that three shifts by whole cycles give the delay; a jackknife
over blocks of the run gives its standard error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from zygos import limits
from zygos.audit.means import BLOCKS, Array
from zygos.audit.remedies import ANGLES, Kind
from zygos.runs.cycles import INVALID, Cycles

Residual = Callable[[float, int | None], float]
"""What is left of a run whose readings of a group are taken from some periods later, without a block of it; infinite
where there is no balance."""
MOST_S = 0.3
"""Largest delay that is searched, s; three periods at least."""
_ROUNDS, _CLOSE = 3, 0.02
"""Number of times that the three shifts are laid about the last result at most, and the step after which they are
not, in periods."""
_SPANS: dict[Kind, tuple[float, float]] = {
    "q": (1.0, 2.0),
    "theta": (1.0, 2.0),
    "tau": (0.25, 1.0),
    "omega": (0.25, 1.0),
}
"""Distance of the last three shifts, in periods, and of three whose difference from these is part of the error. Shifts
by whole periods apart interpolate alike, so that the steps of an encoder remain in the readings to the same part."""


@dataclass(frozen=True)
class Group:
    """Readings that are delayed together."""

    kind: Kind
    columns: tuple[int, ...]
    both: bool = False
    """Whether the other angles of these joints are delayed as well."""

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """All kinds of its readings."""
        return ANGLES if self.both else (self.kind,)


@dataclass(frozen=True)
class Delay:
    """A delay of a group."""

    group: Group
    periods: float
    """Time by which the readings are older than their cycle says, in periods; negative: newer."""
    sigma: float
    """Its standard error."""
    residual: float
    """What is left without the delay."""
    ratio: float
    """By how much less that is."""


_STRAIGHT, _CURVED = (0, 1), (-1, 0, 1, 2)
"""Cycles about a reading between which it is interpolated: torques, which may be held, linearly."""


def shifted(cycles: Cycles, group: Group, periods: float) -> Cycles:
    """The run with the readings of a group taken from `periods` later; cycles for which there are none are invalid.

    Torques are interpolated linearly between cycles, because they may be held, and others by a cubic polynomial.
    """
    n, whole = len(cycles), math.floor(periods)
    share = periods - whole
    points = (0,) if not share else _STRAIGHT if group.kind == "tau" else _CURVED
    steps = [whole + point for point in points]
    weights = [math.prod((share - other) / (point - other) for other in points if other != point) for point in points]
    number, flags = cycles.sync.astype(np.int64), cycles.flags
    at = [np.clip(np.arange(n) + step, 0, n - 1) for step in steps]
    same = np.ones(n, dtype=np.bool_)
    for taken, step in zip(at, steps, strict=True):
        same &= (number[taken] - number == step) & ((flags[taken] & INVALID) == 0)
    fields: dict[str, Any] = {"flags": np.where(same, flags, flags | np.uint32(INVALID)).astype(np.uint32)}
    columns = list(group.columns)
    for kind in group.kinds:
        readings: Array = getattr(cycles, kind)
        fields[kind] = readings.copy()
        fields[kind][:, columns] = sum(
            weight * readings[taken][:, columns] for weight, taken in zip(weights, at, strict=True)
        )
    return replace(cycles, **fields)


def without(cycles: Cycles, block: int | None) -> Cycles:
    """The run without one of `BLOCKS` blocks."""
    if block is None:
        return cycles
    flags = cycles.flags.copy()
    flags[np.arange(len(flags)) * BLOCKS // len(flags) == block] |= np.uint32(INVALID)
    return replace(cycles, flags=flags)


def _vertex(before: float, here: float, after: float) -> float:
    """Position of the smallest value of a parabola through squares at -1, 0 and 1, within these; NaN without one."""
    bend = before - 2.0 * here + after
    return min(max(0.5 * (before - after) / bend, -1.0), 1.0) if bend > 0.0 and math.isfinite(bend) else math.nan


def find_delay(group: Group, residual: Residual, now: float, period_s: float) -> Delay | None:
    """The delay of a group; None where less is not clearly left with any. now: what is left as the run is.

    First the whole number of cycles that leaves least, then the fraction.
    """

    @cache
    def square(periods: float, block: int | None = None) -> float:
        return residual(periods, block) ** 2 if periods or block is not None else now**2

    def step(about: float, block: int | None = None, span: float = 1.0) -> float:
        return span * _vertex(*(square(about + by * span, block) for by in (-1.0, 0.0, 1.0)))

    best, most = 0.0, max(3.0, MOST_S / period_s)
    sense = min((1.0, -1.0), key=square)
    while square(best + sense) < square(best):
        best += sense
        if abs(best) > most:
            return None
    first = step(best)
    if not math.isfinite(first):
        return None
    left, centre = min((square(best), best), (square(best + first), best + first))
    ratio = now / math.sqrt(left) if left > 0.0 else math.inf
    if ratio < limits.AUDIT_SURE.value or abs(centre) < limits.SKEW.value:
        return None
    for _ in range(_ROUNDS):
        further = step(centre)
        if not abs(further) > _CLOSE:
            break
        centre += further
    near, far = _SPANS[group.kind]
    each = [step(centre, block, near) for block in range(BLOCKS)]
    nearer = step(centre, span=near)
    # what is left is not exactly quadratic: two spans differ
    sigma = math.hypot(math.sqrt((BLOCKS - 1) * float(np.var(each))), nearer - step(centre, span=far))
    centre += nearer
    if not (math.isfinite(sigma) and abs(centre) > limits.SKEW_Z.value * sigma):
        return None
    return Delay(group, centre, sigma, math.sqrt(left), ratio)


def groups(joints: Sequence[int], flexible: Sequence[int] = (), *, gyro: bool) -> list[Group]:
    """What may be delayed together: the gyro, all torques, each torque, and of flexible joints all link angles, all
    motor angles, and each of these. With a gyro also all angles of the arm: without one, they are late if all
    torques are early."""
    found = [Group("omega", (0, 1, 2)), Group("theta", tuple(joints), both=True)] if gyro else []
    kinds: list[tuple[Kind, Sequence[int]]] = [("tau", joints), ("q", flexible), ("theta", flexible)]
    for kind, columns in kinds:
        found += [Group(kind, tuple(columns))] if columns else []
        found += [Group(kind, (i,)) for i in columns] if len(columns) > 1 else []
    return found

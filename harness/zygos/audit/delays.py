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
from zygos.audit.remedies import Kind
from zygos.runs.cycles import INVALID, Cycles

Residual = Callable[[float, int | None], float]
"""What is left of a run whose readings of a group are taken from some periods later, without a block of it; infinite
where there is no balance."""
MOST_S = 0.3
"""Largest delay that is searched, s; three periods at least."""
_ROUNDS, _CLOSE = 3, 0.02
"""Number of times that the three shifts are laid about the last result at most, and the step after which they are
not, in periods."""
_SPAN = 0.25
"""Distance of the last three shifts, in periods."""


@dataclass(frozen=True)
class Group:
    """Readings that are delayed together."""

    kind: Kind
    columns: tuple[int, ...]


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


def shifted(cycles: Cycles, group: Group, periods: float) -> Cycles:
    """The run with the readings of a group taken from `periods` later; cycles for which there are none are invalid.

    Torques that are held, and others nearly, are interpolated linearly between cycles.
    """
    n, whole = len(cycles), math.floor(periods)
    share = periods - whole
    readings: Array = getattr(cycles, group.kind)
    later = np.arange(n) + whole
    first, second = np.clip(later, 0, n - 1), np.clip(later + (share > 0.0), 0, n - 1)
    inside = (later >= 0) & (later + (share > 0.0) < n)
    number = cycles.sync.astype(np.int64)
    same = inside & (number[first] - number == whole) & (number[second] - number == whole + (share > 0.0))
    same &= ((cycles.flags[first] | cycles.flags[second]) & INVALID) == 0
    moved = readings.copy()
    columns = list(group.columns)
    moved[:, columns] = (1.0 - share) * readings[first][:, columns] + share * readings[second][:, columns]
    fields: dict[str, Any] = {group.kind: moved}
    flags = np.where(same, cycles.flags, cycles.flags | np.uint32(INVALID)).astype(np.uint32)
    return replace(cycles, flags=flags, **fields)


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
    each = [step(centre, block, _SPAN) for block in range(BLOCKS)]
    nearer = step(centre, span=_SPAN)
    # what is left is not exactly quadratic: two spans differ
    sigma = math.hypot(math.sqrt((BLOCKS - 1) * float(np.var(each))), nearer - step(centre))
    centre += nearer
    if not (math.isfinite(sigma) and abs(centre) > limits.SKEW_Z.value * sigma):
        return None
    return Delay(group, centre, sigma, math.sqrt(left), ratio)


def groups(joints: Sequence[int], *, gyro: bool) -> list[Group]:
    """What may be delayed together: the gyro, all torques, and each torque."""
    found = [Group("omega", (0, 1, 2))] if gyro else []
    found += [Group("tau", tuple(joints))]
    if len(joints) > 1:
        found += [Group("tau", (i,)) for i in joints]
    return found

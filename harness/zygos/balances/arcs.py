# SPDX-License-Identifier: MIT
"""Which arc an instant belongs to, over whole records (docs/theory.md, "Arcs and the constant that drops out")."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

MIN_ARC_INSTANTS = 20
"""An arc with fewer accepted instants is dropped."""


def without_row(arm: Arm, samples: Samples, smoothed: Smoothed, rows: str) -> NDArray[np.bool_]:
    """(m,) whether the library made no row of such rows ("energy", "motor", "momentum") of a smoothed instant, because
    an arc waited for its end."""
    return np.isin(smoothed.index + arm.smoother.lag, sorted(samples.waited.get(rows, ())))


def numbered(smoothed: Smoothed, longest: int, without: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Number from 0 of the arc of each of m smoothed instants, (m,), -1 for those that only fill the integrals.

    An arc lies within one segment and holds at most `longest` instants. without: (m,) as of `without_row`; these are in
    no arc either, and none goes on behind them.
    """
    arc = np.full(len(smoothed.index), -1, dtype=np.int64)
    held = np.zeros(len(arc), np.bool_) if without is None else without
    arcs = 0
    for number in np.unique(smoothed.segment):
        of = np.flatnonzero(smoothed.segment == number)[FILL_INSTANTS:]
        edges = np.flatnonzero(np.diff(~held[of], prepend=False, append=False))
        for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            arc[of[first:end]] = arcs + np.arange(end - first) // longest
            arcs += -(-(end - first) // longest)
    return arc


def unused(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], longest: int, rows: str
) -> frozenset[int]:
    """Numbers of the arcs of `numbered` in which cycles may be missing, or which the library left out.

    rows: their kind, "motor" or "momentum".
    """
    ends = []
    for number in range(int(arc.max(initial=-1)) + 1):
        of = np.flatnonzero(arc == number)
        ends.append(End(int(smoothed.index[of[-1]]) + arm.smoother.lag, len(of) == longest))
    return void_arcs(samples, ends) | left_out_arcs(samples, ends, rows)


FILL_INSTANTS = 3
"""Smoothed instants of a segment that only fill the dissipation integral; the next one is the first arc's origin."""


class End(NamedTuple):
    """at: position of the newest cycle of an arc. full: the arc ended by itself, not by a break."""

    at: int
    full: bool


def left_out_arcs(samples: Samples, ends: Sequence[End], rows: str) -> frozenset[int]:
    """Numbers of the arcs of such rows ("energy", "motor", "momentum") that the library left out."""
    told = samples.left_out.get(rows, frozenset())
    return frozenset(number for number, end in enumerate(ends) if int(samples.sync[end.at]) in told)


def void_arcs(samples: Samples, ends: Sequence[End]) -> frozenset[int]:
    """Numbers of the arcs in which cycles may be missing."""
    void: set[int] = set()
    stops = np.array([stop for _, stop in samples.segments])
    for position, trusted in samples.voids:
        before = stops[stops <= position]
        newest = int(before[-1]) - 1 if len(before) else -1
        for number, end in enumerate(ends):
            if end.at > newest:
                continue
            opened = end.at == newest and not end.full
            if trusted is None:
                doubtful = opened
            else:
                doubtful = int(samples.sync[newest]) > trusted and (opened or int(samples.sync[end.at]) > trusted)
            if doubtful:
                void.add(number)
    return frozenset(void)


def arc_cycles(arm: Arm) -> int:
    """Instants an arc holds at most, its origin among them."""
    return round(arm.arc_max_s / arm.period_s)


def spans(
    accepted: NDArray[np.bool_], longest: int, without: NDArray[np.bool_] | None = None
) -> list[tuple[int, int, bool]]:
    """Origin and end of each arc of a segment, and whether it ended by itself: full, or at an instant that is refused,
    from an eighth of that on.

    What the integrals get wrong in a snap is then a constant of the next arc. without: as of `numbered`; such instants
    lie between two arcs.
    """
    held = np.zeros(len(accepted), np.bool_) if without is None else without
    ends: list[tuple[int, int, bool]] = []
    shortest = max(1, longest // 8)
    origin = FILL_INSTANTS
    while origin < len(accepted):
        if held[origin]:
            origin += 1
            continue
        stop = origin + longest
        refused = np.flatnonzero(~accepted[origin + shortest - 1 : stop])
        if len(refused):
            stop = origin + shortest + int(refused[0])
        ends.append((origin, min(stop, len(accepted)), stop <= len(accepted)))
        origin = stop
    return ends

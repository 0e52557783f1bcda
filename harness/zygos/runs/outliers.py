"""Samples that no arm could have produced between their neighbours: outliers, and steps of whole turns.

A sample is compared with what its neighbours on both sides say of it, and the difference with how much the second
differences of the signal vary around it: they contain its noise and its motion alike.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from zygos import limits

Floats = NDArray[np.float64]
Places = NDArray[np.int64]


def resolution(x: Floats) -> float:
    """Smallest usual step of a signal (n,), in its unit: the quantum where it is coarse."""
    steps = np.abs(np.diff(x))
    moved = steps[steps > 0.0]
    return float(np.percentile(moved, 5)) if len(moved) else 0.0


def outliers(x: Floats, floor: float, turn: float = np.inf) -> Places:
    """Positions of isolated samples, or of short bursts, that lie off the course of a signal (n,).

    A burst lies off where its first and its last value differ, to the same side, from the neighbours themselves, from
    the straight line between them and from the straight lines through two neighbours of each side, by many times of
    what varies around it; behind it, the signal goes on as before. So neither the beginning of a motion nor a step is
    one. floor: the least variation, in the unit of x. turn: a step of that size is that of an angle that starts again,
    which is no outlier.
    """
    kept = np.arange(len(x))
    while len(kept) > 2 * limits.OUTLIER_WINDOW.value:
        bad = _bursts(x[kept], max(floor, resolution(x[kept])), turn)
        if not bad.any():
            break
        kept = kept[~bad]
    return np.setdiff1d(np.arange(len(x)), kept)


def _bursts(x: Floats, floor: float, turn: float) -> NDArray[np.bool_]:
    """(n,) the samples of the shortest bursts that lie off."""
    bad = np.zeros(len(x), dtype=np.bool_)
    around = _Around(x)
    for size in range(1, limits.OUTLIER_BURST.value + 1):
        begin = np.arange(2, len(x) - size - 1)
        end = begin + size
        before, after = x[begin - 1], x[end]
        slopes = before - x[begin - 2], x[end + 1] - after
        line = (after - before) / (size + 1)
        off = np.full(len(begin), np.inf)
        for at, value in ((1, x[begin]), (size, x[end - 1])):
            by = np.array(
                [
                    value - before,
                    value - after,
                    value - (before + at * line),
                    value - (before + at * slopes[0]),
                    value - (after - (size + 1 - at) * slopes[1]),
                ]
            )
            same = np.all(by > 0, axis=0) | np.all(by < 0, axis=0)
            off = np.minimum(off, np.where(same, np.min(np.abs(by), axis=0), 0.0))
        steps = np.abs([after - before - (size + 1) * slope for slope in (*slopes, 0.0)])
        possible = np.abs(off - turn) > limits.TURN_NEAR.value * turn if np.isfinite(turn) else True
        likely = (off > limits.OUTLIER.value * floor) & (np.min(steps, axis=0) < 0.25 * off) & possible
        chosen = np.flatnonzero(likely)
        chosen = chosen[off[chosen] > limits.OUTLIER.value * around.varies(begin[chosen] - 2, end[chosen] + 1)]
        for k in chosen:
            bad[begin[k] : end[k]] = True
        if len(chosen):
            break
    return bad


def steps_off(x: Floats, intervals: Floats, floor: float) -> Floats:
    """(n-1,) by how much each step of a signal (n,) differs from its slopes on both sides; 0 where that is no more than
    varies around it.

    intervals: (n-1,) the usual intervals between two samples, 1 where none is missing. floor: as in `outliers`.
    """
    out = np.zeros(max(len(x) - 1, 0))
    if len(x) < 2 * limits.OUTLIER_WINDOW.value:
        return out
    slope = np.diff(x) / intervals
    padded = np.pad(slope, 3, mode="reflect")
    sides = sliding_window_view(padded, 3)
    mean = 0.5 * (np.median(sides[: len(slope)], axis=1) + np.median(sides[4:], axis=1))
    off = intervals * (slope - mean)
    likely = np.flatnonzero(np.abs(off) > limits.OUTLIER.value * max(floor, resolution(x)))
    varies = _Around(x).varies(likely - 1, likely + 2)
    sure = likely[np.abs(off[likely]) > limits.OUTLIER.value * varies]
    out[sure] = off[sure]
    return out


class _Around:
    """How much the second differences of a signal vary around a place."""

    def __init__(self, x: Floats) -> None:
        window = limits.OUTLIER_WINDOW.value
        second = np.abs(np.diff(x, 2))
        self._second = np.concatenate([[0.0], second, [0.0]])  # at the sample in the middle
        self._padded = np.pad(self._second, window, mode="reflect")

    def varies(self, last: Places, first: Places) -> Floats:
        """The median of a window before and of one behind a place, whichever is larger, and at least the values next to
        it. last, first: (m,) positions of the samples whose second difference does not contain the place."""
        window = limits.OUTLIER_WINDOW.value
        last, first = np.maximum(last, 0), np.minimum(first, len(self._second) - 1)
        views = sliding_window_view(self._padded, window)
        before = np.median(views[last + 1], axis=1)  # the window ends with `last`
        behind = np.median(views[first + window], axis=1)
        adjacent = np.maximum(self._second[last], self._second[first])
        out: Floats = np.maximum.reduce([before, behind, adjacent])
        return out


def two_courses(x: Floats, floor: float) -> Places:
    """Positions of the rarer course, if a signal (n,) changes back and forth between two courses; empty otherwise.

    Each sample belongs to the course whose latest value is nearer. Two courses are many times as short together as the
    line through all samples. floor: as in `outliers`.
    """
    steps = np.abs(np.diff(x))
    total = float(steps.sum())
    if len(x) < 2 * limits.OUTLIER_WINDOW.value or total <= 0.0:
        return np.zeros(0, dtype=np.int64)
    ends = [float(x[0]), float(x[int(np.argmax(steps)) + 1])]
    second = np.zeros(len(x), dtype=np.bool_)
    length = 0.0
    for k, value in enumerate(x.tolist()):
        which = abs(value - ends[1]) < abs(value - ends[0])
        length += abs(value - ends[which])
        ends[which] = value
        second[k] = which
    changes = int(np.count_nonzero(np.diff(second)))
    rarer = np.flatnonzero(second if second.sum() < 0.5 * len(x) else ~second)
    apart = np.median(steps[np.flatnonzero(np.diff(second))]) if changes else 0.0
    many = changes > limits.SECOND_SOURCE.value * len(x) and len(rarer) > limits.SECOND_SOURCE.value * len(x)
    if not many or total < limits.OUTLIER.value * length or apart < limits.OUTLIER.value * max(floor, resolution(x)):
        return np.zeros(0, dtype=np.int64)
    return rarer

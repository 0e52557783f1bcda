# SPDX-License-Identifier: MIT
"""Samples that no arm could have produced between their neighbours: outliers, and steps of whole turns.

A sample is compared with what its neighbours on both sides say of it, and the difference with how much the second
differences of the signal vary around it: they contain its noise and its motion alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from zygos import limits

Floats = NDArray[np.float64]
Places = NDArray[np.int64]

GAP = 2.5
"""A pause of a signal that is longer than that many of its usual intervals is a gap; the motion in it is not small."""
_CODE_COUNT, _CODE_SHARE = 3, 0.6
"""Number of equal values, and their share, from which on they are a code rather than readings."""


def resolution(x: Floats) -> float:
    """Smallest usual step of a signal (n,), in its unit: the quantum where it is coarse."""
    steps = np.abs(np.diff(x))
    moved = steps[steps > 0.0]
    return float(np.percentile(moved, 5)) if len(moved) else 0.0


def outliers(x: Floats, floor: float, periods: Sequence[float] = ()) -> Places:
    """Positions of isolated samples, or of short bursts, that lie off the course of a signal (n,).

    A burst lies off where its first and its last value differ, to the same side, from the neighbours themselves, from
    the straight line between them and from the slopes on both sides, by many times of what varies around it; behind
    it, the signal goes on as before. So neither the beginning of a motion nor a step is one. floor: the least
    variation, in the unit of x. periods: numbers at which an angle may start again; such a step is no outlier.
    """
    kept = np.arange(len(x))
    while len(kept) > 2 * limits.OUTLIER_WINDOW.value:
        many = len(x) - len(kept) > limits.OUTLIERS_MANY.value * len(x)
        bad = _bursts(x[kept], max(floor, resolution(x[kept])), periods, many)
        if not bad.any():
            break
        kept = kept[~bad]
    return np.setdiff1d(np.arange(len(x)), kept)


def _bursts(x: Floats, floor: float, periods: Sequence[float], many: bool) -> NDArray[np.bool_]:
    """(n,) the samples of the shortest bursts that lie off. many: whether outliers may be close to each other."""
    bad = np.zeros(len(x), dtype=np.bool_)
    window = limits.OUTLIER_WINDOW.value
    around = _Around(x, 3 * window, 3 * window) if many else _Around(x, window, 1)
    slopes = np.median(sliding_window_view(np.pad(np.diff(x), 1, mode="edge"), 3), axis=1)  # (n-1,) about each step
    for size in range(1, limits.OUTLIER_BURST.value + 1):
        begin = np.arange(3, len(x) - size - 2)
        end = begin + size
        before, after = x[begin - 1], x[end]
        last, first = slopes[begin - 3], slopes[end + 1]
        line = (after - before) / (size + 1)
        off = np.full(len(begin), np.inf)
        for at, value in ((1, x[begin]), (size, x[end - 1])):
            by = value - np.array(
                [before, after, before + at * line, before + at * last, after - (size + 1 - at) * first]
            )
            same = np.all(by > 0, axis=0) | np.all(by < 0, axis=0)
            off = np.minimum(off, np.where(same, np.min(np.abs(by), axis=0), 0.0))
        rest = np.min(np.abs([after - before - (size + 1) * slope for slope in (last, first, 0.0)]), axis=0)
        chosen = np.flatnonzero((off > limits.OUTLIER.value * floor) & (rest < 0.25 * off))
        varies = np.maximum(around.varies(begin[chosen] - 2, end[chosen] + 1), floor)
        step = x[begin[chosen]] - before[chosen]
        turned = np.zeros(len(chosen), dtype=np.bool_)
        for period in periods:
            turned |= np.abs(np.abs(step) - period) <= limits.OUTLIER.value * varies
        chosen = chosen[(off[chosen] > limits.OUTLIER.value * varies) & ~turned]
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
    varies = _Around(x, limits.OUTLIER_WINDOW.value, 1).varies(likely - 1, likely + 2)
    sure = likely[np.abs(off[likely]) > limits.OUTLIER.value * varies]
    out[sure] = off[sure]
    return out


def unwrapped(x: Floats, modulo: float, intervals: Floats) -> Floats:
    """(n,) an angle (n,) that starts again after a modulo, without that: each step is the shortest, in a gap the one
    nearest to the motion on both sides. intervals: as in `steps_off`."""
    steps = np.diff(x)
    short = steps - modulo * np.round(steps / modulo)
    for k in np.flatnonzero(intervals > GAP):
        sides = [part for part in (short[max(k - 5, 0) : k], short[k + 1 : k + 6]) if len(part)]
        moved = intervals[k] * float(np.mean([np.median(part) for part in sides])) if sides else 0.0
        short[k] = steps[k] - modulo * np.round((steps[k] - moved) / modulo)
    turns = np.concatenate([[0.0], np.cumsum(np.round((short - steps) / modulo))])
    out: Floats = x + modulo * turns
    return out


class _Around:
    """How much the second differences of a signal (n,) vary around a place.

    window, nearest: numbers of them on each side whose medians it is at least.
    """

    def __init__(self, x: Floats, window: int, nearest: int) -> None:
        self._window, self._nearest, self._n = window, nearest, len(x)
        second = np.concatenate([[0.0], np.abs(np.diff(x, 2)), [0.0]])  # at the sample in the middle
        self._padded = np.pad(second, window, mode="symmetric")

    def varies(self, last: Places, first: Places) -> Floats:
        """The median of a window before and of one behind a place, whichever is larger, and at least that next to it.
        last, first: (m,) positions of the samples whose second difference does not contain the place."""
        window = self._window
        last, first = np.maximum(last, 0), np.minimum(first, self._n - 1)
        out = np.zeros(len(last))
        for size in (window, self._nearest):
            views = sliding_window_view(self._padded, size)
            out = np.maximum(out, np.median(views[last + window + 1 - size], axis=1))  # ends with `last`
            out = np.maximum(out, np.median(views[first + window], axis=1))
        return out


def two_courses(x: Floats, floor: float) -> Places:
    """Positions of one course, if a signal (n,) changes back and forth between two; empty otherwise.

    Each sample belongs to the course whose latest value is nearer. Two courses are many times as short together as the
    line through all samples. The one that is returned has mostly one value, or is the rarer one. floor: as in
    `outliers`.
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
    changes = np.flatnonzero(np.diff(second))
    share = limits.SECOND_SOURCE.value * len(x)
    often = len(changes) > share and share < second.sum() < len(x) - share
    least = limits.OUTLIER.value * max(floor, length / len(x))
    if not often or total < limits.OUTLIER.value * length or np.median(steps[changes]) < least:
        return np.zeros(0, dtype=np.int64)
    courses = np.flatnonzero(second), np.flatnonzero(~second)
    return min(courses, key=lambda one: (code_of(x[one]) is None, len(one)))


def far_off(x: Floats, found: Places) -> Places:
    """Of positions of samples of a torque or a rate (n,) that lie off: those far outside of the range of all others,
    and those that have one and the same value, as a code or a second source sends it. Others may be short strokes."""
    if not len(found):
        return found
    others = np.delete(x, found)
    low, high = float(others.min()), float(others.max())
    outside = (x[found] < low - (high - low)) | (x[found] > high + (high - low))
    out: Places = found[outside | (x[found] == code_of(x[found]))]
    return out


def code_of(values: Floats) -> float | None:
    """The value that most of these have, if they are several."""
    sent, times = np.unique(values, return_counts=True)
    often = len(values) and times.max() >= max(_CODE_COUNT, _CODE_SHARE * len(values))
    return float(sent[np.argmax(times)]) if often else None

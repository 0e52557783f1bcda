# SPDX-License-Identifier: MIT
"""Properties of a single signal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.signal import spectrogram

from zygos import limits
from zygos.audit.means import Array


def runs_of_equal(readings: Array, ranges: Sequence[tuple[int, int]], at_least: int) -> list[tuple[int, int]]:
    """Half-open ranges of `at_least` or more equal readings."""
    out = []
    least = 1e-9 * float(np.nanmax(np.abs(readings), initial=0.0))  # means of equal readings differ by rounding
    for start, stop in ranges:
        edges = np.flatnonzero(np.abs(np.diff(readings[start:stop])) > least) + 1 + start
        bounds = np.concatenate([[start], edges, [stop]])
        out += [(int(a), int(b)) for a, b in itertools.pairwise(bounds) if b - a >= at_least]
    return out


def grid_step(readings: Array, ranges: Sequence[tuple[int, int]], finest: float) -> float:
    """Step of the grid on which readings lie, apart from rounding to steps of `finest`; NaN if there is no grid at
    least four times coarser."""
    steps = np.abs(np.concatenate([np.diff(readings[a:b]) for a, b in ranges] or [np.zeros(0)]))
    steps = steps[steps > max(0.5 * finest, 1e-12)]
    if len(steps) < 20:
        return math.nan
    step = float(np.min(steps))
    if step < 4.0 * finest:
        return math.nan
    for reach in (1.5, 4.5, 20.5, 100.5, 1000.5):
        near = steps[steps < reach * step]
        times = np.rint(near / step)
        step = float(near @ times / (times @ times))
    off = np.abs(steps - step * np.rint(steps / step))
    on_grid = float(np.mean(off <= 1.01 * finest + 1e-6 * step))
    return step if on_grid > limits.ON_GRID.value else math.nan


def noise_level(readings: Array, ranges: Sequence[tuple[int, int]]) -> float:
    """Standard deviation of the random changes from cycle to cycle, from the median of the fourth differences."""
    fourth = [np.diff(readings[a:b], 4) for a, b in ranges if b - a > 8]
    if not fourth:
        return math.nan
    return 1.4826 * float(np.median(np.abs(np.concatenate(fourth)))) / math.sqrt(70.0)  # 1 + 16 + 36 + 16 + 1


_SPAN, _BANDS = 64, 6
"""Cycles of a span of the spectrum, and its bands from an eighth of the sampling rate to half of it."""
_QUIET = 0.25
"""Share of the spans that are not louder than the noise; densities of white noise are distributed exponentially."""


def white_noise(readings: Array, ranges: Sequence[tuple[int, int]]) -> float:
    """Standard deviation of white noise that readings can have at most: their smallest density in any band.

    Motion and vibration are in some bands and not in others; white noise is alike in all of them. The spectrum is that
    of the fourth differences, divided by their response, so that the motion does not leak into it. The density is that
    of the quietest quarter of the spans, since the others may hold a fast motion. A run that is too short has its
    `noise_level`.
    """
    spans = []
    for a, b in ranges:
        if b - a < _SPAN + 4:
            continue
        frequency, _, density = spectrogram(
            np.diff(readings[a:b], 4), nperseg=_SPAN, noverlap=_SPAN // 2, detrend=False, window="hann"
        )
        spans.append(density)
    if not spans:
        return noise_level(readings, ranges)
    kept = np.flatnonzero((frequency >= 0.125) & (frequency < 0.5))
    quiet = np.quantile(np.hstack(spans)[kept], _QUIET, axis=1) / -math.log1p(-_QUIET)
    density = quiet / (2.0 * np.sin(math.pi * frequency[kept])) ** 8
    return math.sqrt(0.5 * min(float(np.mean(density[band])) for band in np.array_split(np.arange(len(kept)), _BANDS)))


_LAGS = 4
"""Number of past cycles whose readings may influence a controller's torque."""


def noise_beside(readings: Array, others: Array, ranges: Sequence[tuple[int, int]]) -> float:
    """`noise_level` of readings (n,) without the part correlated with the noise of other readings (n, m) of past
    cycles.

    A torque that a controller computes from encoders and gyro contains their noise, and is really applied. Fourth
    differences of the readings are fitted by those of the others; the remainder is the readings' own noise. NaN if the
    run is too short.
    """
    target, columns = [], []
    for a, b in ranges:
        if b - a <= 4 + _LAGS:
            continue
        rest = np.diff(others[a:b], 4, axis=0)
        n = len(rest) - _LAGS + 1
        target.append(np.diff(readings[a:b], 4)[_LAGS - 1 :])
        columns.append(np.column_stack([rest[lag : lag + n] for lag in range(_LAGS)]))
    if not target:
        return math.nan
    y, x = np.concatenate(target), np.concatenate(columns)
    if len(y) < 10 * x.shape[1]:
        return math.nan
    scale = np.sqrt(np.mean(x**2, axis=0))
    x = x[:, scale > 0.0] / scale[scale > 0.0]
    left, kept = y, np.ones(len(y), dtype=np.bool_)
    for _ in range(limits.OUTLIER_ROUNDS.value):
        left = y - x @ np.linalg.lstsq(x[kept], y[kept], rcond=None)[0]
        kept = np.abs(left) <= limits.OUTLIER_Z.value * 1.4826 * float(np.median(np.abs(left)))
        if np.count_nonzero(kept) < 5 * x.shape[1]:
            break
    level = min(float(np.median(np.abs(left))), float(np.median(np.abs(y))))
    return 1.4826 * level / math.sqrt(70.0)

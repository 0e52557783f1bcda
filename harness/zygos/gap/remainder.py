# SPDX-License-Identifier: MIT
"""What is left over after the named effects, and what it varies with."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.balances.state import State
from zygos.gap.findings import Gap
from zygos.gap.search import allowed
from zygos.gap.study import Study, residuals
from zygos.gap.verdicts import Remainder, Unpredicted
from zygos.gap.whereabouts import joint_of

Floats = NDArray[np.float64]


def closes(gap: Gap) -> bool:
    """Whether the closed model predicts each untouched run as well as noise allows, in the middle and at the end.

    Noise acts twice: on the readings of the untouched run, and on the values that were learned from the others.
    """
    return not unclosed(gap)


def unclosed(gap: Gap) -> tuple[int, ...]:
    """The untouched runs, from 0, that the closed model does not predict as well as noise allows."""
    return tuple(k for k in sorted({*gap.closed.run.tolist()}) if not _closes(gap, k))


def far_off(gap: Gap) -> Unpredicted | None:
    """The untouched run that is predicted worst, where that is beyond all that errors of values and sensors do."""
    each = [Unpredicted(gap.runs[k], gap.closed.of_run(k).median, allowed_by(gap, k)[0]) for k in unclosed(gap)]
    far = [one for one in each if one.median > limits.CLOSED_TORQUES.value * one.allowed]
    return max(far, key=lambda one: one.median / one.allowed, default=None)


def _closes(gap: Gap, run: int) -> bool:
    found, (median, tenth) = gap.closed.of_run(run), allowed_by(gap, run)
    return bool(found.median <= limits.CLOSED.value * median and found.tenth <= limits.CLOSED.value * tenth)


def allowed_by(gap: Gap, run: int) -> tuple[float, float]:
    """Median and tenth of the closed model on its own twin, with its values and with redrawn ones."""
    each = [one.of_run(run) for one in (gap.floor, *gap.reach)]
    return max(one.median for one in each), max(one.tenth for one in each)


def closes_by_noise(gap: Gap) -> bool:
    """Whether the closed model predicts each untouched run as well as the noise of its readings alone allows."""
    return closes(replace(gap, reach=()))


def remainders(arm: Arm, study: Study, gap: Gap | None) -> tuple[Remainder, ...]:
    """What is left over on the untouched run, then of the balances that do not close, worst first."""
    out = []
    if gap is not None:
        runs = sorted({*gap.closed.run.tolist()})
        # where all of them close, or there is one, its error is said; else that of those that do not close
        for run in unclosed(gap) or runs[:1]:
            named = f"the untouched run {gap.runs[run]}" if len(runs) > 1 else "the untouched run"
            found, floor = gap.closed.of_run(run), gap.floor.of_run(run)
            out.append(Remainder(named, found.median, "sigma", floor.median, "", 0.0))
    over = study.excess**2 - 1.0
    fails = np.isfinite(over) & (over > allowed(study)[1])
    worst = np.where(fails, study.excess, 0.0).max(axis=0)
    for balance in np.argsort(-worst, kind="stable"):
        if worst[balance] > 0.0:
            name = study.layout.balances[balance]
            run = int(np.nanargmax(study.excess[:, balance]))
            quantity, share = _varies_with(arm, study, run, int(balance))
            out.append(Remainder(f"balance {name}", float(worst[balance]), "1", math.nan, quantity, share))
    return tuple(out)


def _varies_with(arm: Arm, study: Study, run: int, balance: int) -> tuple[str, float]:
    """The quantity that says most about the slope of a balance's residual, and its share of the variance."""
    left, state = residuals(study, run)
    window = max(2, round(limits.SLOPE_WINDOW_S.value / arm.period_s))
    y = (left[balance][:, window:] - left[balance][:, :-window])[:, ::window]
    listed = [
        (explained_share(over[:, window // 2 :][:, : y.shape[1] * window : window], y), name)
        for name, over in _quantities(arm, state, study.records[run].time_s, joint_of(study.layout.balances[balance]))
    ]
    share, name = max(listed)
    return (name, share) if share > limits.TELLS.value else ("", 0.0)


def _quantities(arm: Arm, state: State, time: Floats, joint: int | None) -> Iterator[tuple[str, Floats]]:
    """(A, instants) what a residual may vary with, of one joint or of all."""
    for i in range(arm.n) if joint is None else [joint]:
        at = f" of the {arm.joints[i].name}"
        yield f"rate{at}", state.thetad[..., i]
        yield f"angle{at}", np.mod(state.q[..., i], 2.0 * np.pi)
        if arm.joints[i].flexible:
            yield f"deflection{at}", state.theta[..., i] - state.q[..., i]
    yield "time", time


def explained_share(over: Floats, values: Floats) -> float:
    """Share of the variance of values that their means in bins of a quantity take away, less what chance would."""
    count = min(over.shape[1], values.shape[1])
    x, y = over[:, :count].ravel(), values[:, :count].ravel()
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if len(y) < 4 * limits.BINS.value or not np.var(y) > 0.0:
        return 0.0
    edges = np.quantile(x, np.linspace(0.0, 1.0, limits.BINS.value + 1)[1:-1])
    index = np.searchsorted(edges, x)
    counts = np.maximum(np.bincount(index, minlength=limits.BINS.value), 1)
    means = np.bincount(index, weights=y, minlength=limits.BINS.value) / counts
    left = float(np.sum((y - means[index]) ** 2)) / (len(y) - limits.BINS.value)
    return 1.0 - left / float(np.var(y, ddof=1))

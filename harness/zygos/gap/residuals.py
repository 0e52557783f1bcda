# SPDX-License-Identifier: MIT
"""What models leave over of a run's balances and of its predictions: the numbers behind a page's charts and tables."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.balances.state import State
from zygos.dynamics.equations import from_model
from zygos.gap.explanation import Explanation
from zygos.gap.findings import Gap
from zygos.gap.forecast import Forecast
from zygos.gap.record import MeasuredRun
from zygos.gap.study import Study, coefficient, residuals

Array = NDArray[np.float64]
Stage = Literal["delivered", "refit", "flexibility", "candidate", "closed"]

FAILS = math.sqrt(1.0 + limits.EXCESS.value)
"""rho from which on a balance fails."""


@dataclass(frozen=True)
class LeftOver:
    """Residuals of one run's balances under several models; A arcs."""

    record: MeasuredRun
    state: State
    """Smoothed, (A, instants, ...)."""
    failing: tuple[int, ...]
    """Balances that fail, worst first; of models whose values differ, under the simulation's own."""
    refit: Array
    """(balances, A, instants) about each arc's mean, as all of these; NaN where there is none."""
    closed: Array | None
    """With what was named or guessed; None where nothing was."""
    delivered: Array | None
    """With the simulation's own values, where values alone differ."""
    struck: Array | None
    """The closed model with the named effects struck out; None where none is adopted."""


def left_over(x: Explanation, run: int = 0) -> LeftOver:
    """The residuals of an explanation's run."""
    differ = x.answer == "values differ"
    refit, state = residuals(x.refit, run)
    return LeftOver(
        x.refit.records[run],
        state,
        tuple(failing(as_delivered(x).excess if differ else x.local)),
        refit,
        residuals(x.closed, run)[0] if x.closed is not x.refit else None,
        residuals(as_delivered(x), run)[0] if differ and x.closed is x.refit else None,
        _struck(x, run),
    )


def failing(rho: Array) -> list[int]:
    """Balances that fail on a run, rho (runs, balances), worst first."""
    worst = np.where(np.isfinite(rho), rho, 0.0).max(axis=0)
    return [int(k) for k in np.argsort(-worst, kind="stable") if worst[k] > FAILS]


def as_delivered(x: Explanation) -> Study:
    """The refit's study with the simulation's own values in its fit's place."""
    study = x.refit
    dynamics = from_model(x.arm, x.simulation)
    values = [coefficient(dynamics, study.hypothesis, name) for name in study.hypothesis.names]
    return replace(study, fit=study.of(study.hypothesis, fixed=np.array(values)))


def freed(x: Explanation) -> list[int]:
    """Joints that are rigid in the simulation and flexible in what was found."""
    before, after = x.refit.hypothesis.rigid, x.closed.hypothesis.rigid
    return [i for i, (was, still) in enumerate(zip(before, after, strict=True)) if was and not still]


def _struck(x: Explanation, run: int) -> Array | None:
    study = x.closed
    if x.search is None or x.answer not in {"named", "part named"}:
        return None
    names = {candidate.name for candidate in x.search.named}
    names |= {f"{key}{i + 1}" for i in freed(x) for key in "kb"}
    value = np.where([name in names for name in study.hypothesis.names], 0.0, study.fit.value)
    return residuals(replace(study, fit=replace(study.fit, value=value)), run)[0]


def base_angle(left: LeftOver) -> Array:
    """(A, instants) angle that the base has turned, rad."""
    time, rate = left.record.time_s.ravel(), left.state.base.ravel()
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)]).reshape(left.state.base.shape)


def slope(left: Array, window: int, period_s: float) -> Array:
    """(A, instants - window) rise of residuals (A, instants) over so many cycles, a second; window 0: left itself."""
    return np.asarray((left[:, window:] - left[:, :-window]) / (window * period_s)) if window else left


def middle(over: Array, window: int) -> Array:
    """(A, instants - window) an abscissa (A, instants) in the middle of each slope's window."""
    shift = window // 2
    return over[:, shift : over.shape[1] - window + shift]


def medians(over: Array, values: Array, edges: Array) -> Array:
    """(bins,) median of the values in each bin; NaN where there are few."""
    known = np.isfinite(values)
    x, y = over[known], values[known]
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    out = np.full(len(edges) - 1, np.nan)
    for k in range(len(out)):
        inside = y[index == k]
        if len(inside) >= limits.BIN_VALUES.value:
            out[k] = np.median(inside)
    return out


@dataclass(frozen=True)
class Step:
    """One step from the simulation to what was found."""

    stage: Stage
    column: str
    """Of a candidate; else empty."""
    left: float
    """Mean over runs and balances of rho^2 - 1."""


def steps(x: Explanation) -> list[Step]:
    """What is left as delivered, refitted, and with each effect that was named."""
    out = [Step("delivered", "", _mean_excess(as_delivered(x))), Step("refit", "", _mean_excess(x.refit))]
    if x.search is not None:
        if x.search.before is not x.refit:
            out.append(Step("flexibility", "", _mean_excess(x.search.before)))
        used = int(np.isfinite(x.search.before.excess).sum())
        out += [Step("candidate", candidate.name, candidate.left / used - 1.0) for candidate in x.search.named]
        if x.search.named:
            out.append(Step("closed", "", _mean_excess(x.search.after)))
    return out


def _mean_excess(study: Study) -> float:
    return float(np.nanmean(study.excess**2) - 1.0)


def segment_errors(forecast: Forecast) -> Array:
    """(S, 2N+1) root mean square residual of each segment and signal, sigma."""
    return _rms(forecast.residual, 1)


def poor_segment(gap: Gap) -> int:
    """The segment that the refit predicts worse than nine tenths of the others."""
    each = _rms(gap.refit.residual, (1, 2))
    order = np.argsort(np.where(np.isfinite(each), each, np.inf), kind="stable")
    return int(order[round(limits.TAIL_PERCENT.value / 100.0 * (len(order) - 1))])


def _rms(values: Array, axis: int | tuple[int, ...]) -> Array:
    # predictions with a wrong model may run away
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.mean(values**2, axis=axis)), dtype=np.float64)

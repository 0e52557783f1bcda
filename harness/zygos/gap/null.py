# SPDX-License-Identifier: MIT
"""How large the scores of candidates get on runs that lack nothing: the distribution of the largest of them.

What noise does to a coefficient is linear in the products of the columns and of what the twin's own coefficients leave
over of its readings. Noise of different arcs is independent, so that a new draw of a run takes each of its arcs from
any reading of the twin: a few readings of some arcs each are as many draws as are wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import Undecided
from zygos.gap.fit import influence
from zygos.gap.study import Study
from zygos.quantiles import normal_sf, student_isf, student_sf

Array = NDArray[np.float64]


def null_scores(
    study: Study,
    names: Sequence[str],
    draws: int = limits.NULL_DRAWS.value,
    *,
    runs: Sequence[int] | None = None,
    seed: int = 0,
) -> Array:
    """(draws, candidates) scores of columns of the catalogue in draws of the study's twin, in their own deviations.

    runs: those that are fitted together; all by default. A column that cannot be told from the others has NaN.
    """
    chosen = range(len(study.records)) if runs is None else runs
    generator = np.random.default_rng(seed)
    parts = [_by_arc(study, names, chosen, run) for run in chosen]
    out = np.zeros((draws, len(names)))
    variance = np.zeros(len(names))
    for part in parts:
        readings, arcs = part.shape[:2]
        centred = (part - part.mean(axis=0)) * np.sqrt(readings / (readings - 1.0))
        variance += (centred**2).mean(axis=0).sum(axis=0)
        taken = generator.integers(readings, size=(draws, arcs))
        out += centred[taken, np.arange(arcs)].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(out / np.sqrt(variance), dtype=np.float64)


def null_sigmas(study: Study, names: Sequence[str], runs: Sequence[int] | None = None) -> Array:
    """(candidates,) standard deviations of their coefficients on such runs, from every arc of every reading of the
    twin; NaN as in `null_scores`."""
    chosen = range(len(study.records)) if runs is None else runs
    parts = [_by_arc(study, names, chosen, run) for run in chosen]
    return np.asarray(np.sqrt(sum(part.var(axis=0, ddof=1).sum(axis=0) for part in parts)), dtype=np.float64)


@dataclass(frozen=True)
class Chance:
    """How often noise alone names a candidate of a list, and what is asked of one so that this is rare.

    A search divides each run's coefficient by the deviation of a few readings of its twin, so that its scores have
    Student's distribution, and a candidate must pass on every run with one sign. The candidates look alike in part:
    together they are as good as `count` independent ones.
    """

    runs: int
    candidates: int
    count: float
    """Independent candidates whose largest score is distributed as that of the draws."""
    freedom: int
    """Degrees of freedom of a deviation."""
    draws: int
    """Runs without an effect that were drawn."""
    threshold: float
    """Deviations that a candidate must reach on every run."""

    def rate(self, threshold: float) -> float:
        """Share of searches on runs that lack nothing in which any candidate reaches it on every run."""
        passing = 2.0 * student_sf(threshold, self.freedom) ** self.runs
        return float(-np.expm1(self.count * np.log1p(-passing)))

    def needed(self, rate: float) -> float:
        """The deviations at which this share is `rate`."""
        passing = -0.5 * np.expm1(np.log1p(-rate) / self.count)
        return float(student_isf(passing ** (1.0 / self.runs), self.freedom))

    def beside(self, others: int, rate: float = limits.FALSE_ALARMS.value) -> Chance:
        """With so many more candidates, which count as independent."""
        wider = replace(self, candidates=self.candidates + others, count=self.count + others)
        return replace(wider, threshold=max(self.threshold, wider.needed(rate)))

    @property
    def false_alarms(self) -> float:
        """Share of searches on runs that lack nothing in which noise alone names a candidate."""
        return self.rate(self.threshold)


def chance(study: Study, names: Sequence[str], rate: float = limits.FALSE_ALARMS.value, *, others: int = 0) -> Chance:
    """What is asked of candidates so that on runs that lack nothing at most a share `rate` of searches names one; not
    below `FLOOR`. others: how many more there were from which these were chosen; they count as independent."""
    most = 1.0
    for run in range(len(study.records)):
        scores = null_scores(study, names, runs=[run], seed=run)
        known = scores[:, np.isfinite(scores).all(axis=0)]
        if known.shape[1]:
            largest = np.abs(known).max(axis=1)
            most = max(most, float(-len(largest) / np.sum(np.log1p(-2.0 * normal_sf(largest)))))
    readings = study.twin_sums[0].gram[0].shape[0]
    draws, floor = limits.NULL_DRAWS.value, limits.NAMED_Z.value
    return Chance(len(study.records), len(names), most, readings - 1, draws, floor).beside(others, rate)


def _by_arc(study: Study, names: Sequence[str], runs: Sequence[int], run: int) -> Array:
    """(readings, A, candidates) what each arc of a run adds to the coefficients of candidates in a fit of some runs."""
    scores = study.twin_sums[run].scores
    assert scores is not None
    readings, arcs = scores[0].shape[:2]
    out = np.full((readings, arcs, len(names)), np.nan)
    sums = [study.mean_sums[k] for k in runs]
    for k, name in enumerate(names):
        effects = study.hypothesis.effects
        wider = study.hypothesis if name in effects else replace(study.hypothesis, effects=(*effects, name))
        try:
            shares = influence(wider, sums, study.weight, name)[list(runs).index(run)]
        except Undecided:
            continue
        out[..., k] = sum(scores[balance] @ share for balance, share in shares.items())
    return out

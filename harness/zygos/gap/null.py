"""How large the scores of candidates get on runs that lack nothing: the distribution of the largest of them.

What noise does to a coefficient is linear in the products of the columns and of what the twin's own coefficients leave
over of its readings. Noise of different arcs is independent, so that a new draw of a run takes each of its arcs from any
reading of the twin: a few readings of some arcs each are as many draws as are wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from zygos.errors import Undecided
from zygos.gap.fit import influence
from zygos.gap.study import Study

Array = NDArray[np.float64]

FLOOR = 4.5
"""Deviations below which no candidate is named, whatever the twin says."""
DRAWS = 500


def null_scores(
    study: Study, names: Sequence[str], draws: int = DRAWS, *, runs: Sequence[int] | None = None, seed: int = 0
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


def threshold(study: Study, names: Sequence[str], rate: float = 0.001) -> float:
    """The score that the largest of all candidates exceeds on one run in a share `rate` of runs that lack nothing; not
    below `FLOOR`.

    As many independent normal scores are sought whose largest is distributed as that of the draws, and the tail is
    theirs.
    """
    found = [FLOOR]
    for run in range(len(study.records)):
        scores = null_scores(study, names, runs=[run], seed=run)
        known = scores[:, np.isfinite(scores).all(axis=0)]
        if not known.shape[1]:
            continue
        largest = np.abs(known).max(axis=1)
        count = -len(largest) / np.sum(np.log1p(-2.0 * norm.sf(largest)))
        found.append(float(norm.isf(-0.5 * np.expm1(np.log1p(-rate) / count))))
    return max(found)


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

# SPDX-License-Identifier: MIT
"""Compares answers with true values; this happens only here, after the answers are written.

Errors are in percent of the true values. An answer that an estimator calls refused or doubtful counts as a refusal and
is in no error. Errors are those of the seeds' own sensor errors (draw 0); coverage and wild values count all draws.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.accuracy.cases import Case
from zygos.accuracy.estimators import ESTIMATORS, Estimator
from zygos.arm import Arm
from zygos.refinement.inertia import POSTURES, inertia_errors
from zygos.simulation.score import score

Floats = NDArray[np.float64]
Line = dict[str, Any]

RELIED_ON = ("valid", "partial")
WILD_SIGMAS, WILD_PERCENT = 5.0, 2.0
"""A published value is called wild if its error is above both limits."""


@dataclass(frozen=True)
class EstimatorResults:
    """All answers of one estimator in one case; A answers, p parameters."""

    first: NDArray[np.bool_]
    """(A,) whether the answer belongs to draw 0 of a seed."""
    validity: NDArray[np.str_]
    """(A,)"""
    reason: list[str]
    value: Floats
    """(A, p) values; NaN where there is none, or where the answer is refused or doubtful."""
    half95: Floats
    """(A, p) half widths of the 95 % intervals, NaN likewise."""
    sigma: Floats
    """(A, p) standard deviations, NaN likewise."""
    solution: Floats
    """(A, p) solutions, NaN likewise; all NaN if they are not stored."""

    @classmethod
    def of(cls, columns: Sequence[Line], parameters: int) -> EstimatorResults:
        """Answers from the columns of a case's lines."""

        def joined(key: str) -> list[Any]:
            return [entry for column in columns for entry in column[key]]

        def array(key: str) -> Floats:
            empty = [None] * parameters
            filled = [entry or empty for entry in joined(key)] if key in columns[0] else [empty] * len(validity)
            out = np.array(filled, dtype=np.float64)
            out[~np.isin(validity, RELIED_ON)] = np.nan
            return out

        validity = np.array(joined("validity"))
        return cls(
            np.array(joined("draw")) == 0,
            validity,
            joined("reason"),
            array("value"),
            array("half95"),
            array("sigma"),
            array("solution"),
        )


def summarise(cases: Sequence[Case], lines: Sequence[Line]) -> list[dict[str, Any]]:
    """One entry for each case and estimator."""
    out = []
    for case in cases:
        true = case.model.base_values(case.arm)
        limit = next((line["percent"] for line in lines if line.get("limit") == case.name), None)
        for estimator in ESTIMATORS:
            if estimator.fits(case.arm):
                out.append(_entry(case, estimator, _answers(case.name, estimator, lines, len(true)), true, limit))
    return out


def compare(cases: Sequence[Case], lines: Sequence[Line]) -> list[dict[str, Any]]:
    """One entry for each case with a partner `beside` it among them that has the same runs, of the estimator that is
    given every draw. Each ratio is that of a parameter's rms over the draws in which both publish it, and the entry has
    the median over the parameters; the coverage is that of the same intervals, on average."""
    out = []
    for case in cases:
        if case.beside not in (one.name for one in cases):
            continue
        (estimator,) = (one for one in ESTIMATORS if one.redrawn)
        true = case.model.base_values(case.arm)
        own, other = (_answers(name, estimator, lines, len(true)) for name in (case.name, case.beside))
        both = np.isfinite(own.value) & np.isfinite(other.value)
        holds = [intervals_hold(answers, true) for answers in (other, own)]
        out.append(
            {
                "case": case.name,
                "beside": case.beside,
                "seeds": int(own.first.sum()),
                "draws": len(own.first),
                "parameters": int(both.any(axis=0).sum()),
                "error_ratio": float(np.median(_rms(own.value - true, both) / _rms(other.value - true, both))),
                "sigma_ratio": float(np.median(_rms(own.sigma, both) / _rms(other.sigma, both))),
                "coverage95_beside": float(holds[0][both].mean()),
                "coverage95": float(holds[1][both].mean()),
                "published_beside": int(np.isfinite(other.value).sum()),
                "published": int(np.isfinite(own.value).sum()),
            }
        )
    return out


def _rms(values: Floats, chosen: NDArray[np.bool_]) -> Floats:
    """Of each column that has any entry chosen, over those entries."""
    squares = np.where(chosen, values, np.nan)[:, chosen.any(axis=0)] ** 2
    return np.asarray(np.sqrt(np.nanmean(squares, axis=0)), dtype=np.float64)


def _answers(case: str, estimator: Estimator, lines: Sequence[Line], parameters: int) -> EstimatorResults:
    own = [line["answers"][estimator.name] for line in lines if line.get("case") == case]
    return EstimatorResults.of(own, parameters)


def _entry(
    case: Case, estimator: Estimator, answers: EstimatorResults, true: Floats, limit: Sequence[float] | None
) -> dict[str, Any]:
    names = case.arm.parameter_names
    relied = np.isin(answers.validity, RELIED_ON)
    seeds = answers.first
    error = score(answers.value, true).error_percent
    gives = bool(np.isfinite(answers.half95).any())
    coverage = _coverage(names, answers, true) if gives and estimator.redrawn else None
    per_parameter = {}
    for k, name in enumerate(names):
        own = error[seeds, k]
        own = own[np.isfinite(own)]
        per_parameter[name] = {
            "published": len(own),
            "rms_percent": float(np.sqrt(np.mean(own**2))) if len(own) else None,
            "bias_percent": float(np.mean(own)) if len(own) else None,
            "spread_percent": float(np.std(own, ddof=1)) if len(own) > 1 else None,
            "coverage95": None if coverage is None else coverage[name],
        }
    both = [
        (entry["rms_percent"], least)
        for entry, least in zip(per_parameter.values(), limit or [], strict=False)
        if entry["rms_percent"] is not None
    ]
    rms = [entry["rms_percent"] for entry in per_parameter.values() if entry["rms_percent"] is not None]
    entry = {
        "case": case.name,
        "said": case.description,
        "estimator": estimator.name,
        "benign": case.benign,
        "seeds": int(seeds.sum()),
        "refused": int(np.sum(~relied[seeds])),
        "validity": dict(Counter(answers.validity[seeds].tolist())),
        "reasons": dict(Counter(r for r, s in zip(answers.reason, seeds, strict=True) if s and r)),
        "draws": len(relied),
        "draws_refused": int(np.sum(~relied)),
        "wild": wild_values(answers, true) if gives else None,
        "mean_rms_percent": float(np.mean(rms)) if rms else None,
        "max_rms_percent": float(np.max(rms)) if rms else None,
        # both are means over the parameters that have values
        "times_bound": float(np.sum([a for a, _ in both]) / np.sum([b for _, b in both])) if both else None,
        "per_parameter": per_parameter,
        "coverage95": coverage,
    }
    if case.arm.spatial:
        entry["inertia"] = _inertia_errors(case.arm, answers.solution[seeds & relied], true)
    return entry


def _coverage(names: Sequence[str], answers: EstimatorResults, true: Floats) -> dict[str, float | None]:
    """Share of the published intervals that contain the true value, by parameter."""
    published = np.isfinite(answers.value) & np.isfinite(answers.half95)
    holds = intervals_hold(answers, true)
    return {
        name: float(held / count) if count else None
        for name, held, count in zip(names, holds.sum(axis=0), published.sum(axis=0), strict=True)
    }


def intervals_hold(answers: EstimatorResults, true: Floats) -> NDArray[np.bool_]:
    """(A, p) whether a published interval contains the true value (p,); false where none is published."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(answers.value - true) <= answers.half95, dtype=np.bool_)


def wild_values(answers: EstimatorResults, true: Floats) -> int:
    """Number of published values that are wrong with confidence."""
    error = score(answers.value, true).error_percent
    with np.errstate(invalid="ignore"):
        far = np.abs(answers.value - true) > WILD_SIGMAS * answers.sigma
        return int(np.sum(far & (np.abs(error) > WILD_PERCENT)))


def _inertia_errors(arm: Arm, solutions: Floats, true: Floats) -> dict[str, Any]:
    """Worst and median error of the inertia matrix, percent, as `inertia_errors`."""
    kept = solutions[np.isfinite(solutions).all(axis=1)]
    worst, median = inertia_errors(arm, kept, true) or (None, None)
    return {"postures": POSTURES, "seeds": len(kept), "worst_percent": worst, "median_percent": median}

# SPDX-License-Identifier: MIT
"""Compares the answers of the C library with those of another state of the code, of the same sensor errors.

Who changes an estimator wants to see that bias and spread stay, that intervals neither widen nor stop to hold, and that
no value is wrong with confidence. Each state runs the campaign in its own checkout; the files of their cells meet here.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.accuracy.cases import Case
from zygos.accuracy.cell import Cell
from zygos.accuracy.estimators import ESTIMATORS
from zygos.accuracy.summary import EstimatorResults, intervals_hold, wild_values
from zygos.errors import ZygosError
from zygos.files.output import counted

Floats = NDArray[np.float64]
Line = dict[str, Any]

NOMINAL = 0.95
STANDARD_ERRORS = 3.0
WIDER = 1.5
"""Half widths may be larger by this factor."""
(_REDRAWN,) = (one.name for one in ESTIMATORS if one.redrawn)
"""The estimator that is given every draw."""


def read_cells(path: Path) -> list[Line]:
    """The cells of a file that a campaign wrote. Errors: ZygosError if there is none, or a line is no cell."""
    try:
        lines = [json.loads(text) for text in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise ZygosError(
            f"{path}: no cells of a campaign ({error}); remedy: run `make accuracy` in the other checkout, and give "
            "its out/accuracy/cells.jsonl"
        ) from None
    found = [line for line in lines if isinstance(line, dict) and "case" in line and "answers" in line]
    if not found:
        raise ZygosError(f"{path}: contains no cell of a campaign; remedy: give out/accuracy/cells.jsonl of a checkout")
    return found


def check_draws(jobs: Sequence[Cell], others: Sequence[Line]) -> None:
    """Refuse cells with other seeds or other draws than those that are to be computed. Call it before any work.

    Errors: ZygosError naming the case.
    """
    for job in jobs:
        if _has(others, job.case.name):
            seeds = [seed for seed in job.seeds for _ in range(job.draws)]
            _matching(job.case.name, seeds, [*range(job.draws)] * len(job.seeds), others)


def against(cases: Sequence[Case], lines: Sequence[Line], others: Sequence[Line]) -> list[dict[str, Any]]:
    """One entry for each case that both have. What is compared are values that both publish; errors are in standard
    deviations of the parameter's own errors, ratios are medians over the parameters. The margin is three standard
    errors of the difference of the two coverages, from its scatter over the seeds, whose draws share a motion.

    Errors: ZygosError if a case has other seeds or other draws there.
    """
    out = []
    for case in (one for one in cases if _has(others, one.name)):
        here = [line["answers"][_REDRAWN] for line in lines if line.get("case") == case.name]
        there = [_matching(case.name, column["seed"], column["draw"], others) for column in here]
        true = case.model.base_values(case.arm)
        own, other = (EstimatorResults.of(columns, len(true)) for columns in (here, there))
        out.append(_entry(case, np.array([seed for column in here for seed in column["seed"]]), own, other, true))
    return out


def _has(others: Sequence[Line], case: str) -> bool:
    return any(line["case"] == case for line in others)


def _matching(case: str, seeds: Sequence[int], draws: Sequence[int], others: Sequence[Line]) -> Line:
    """The column of the other state with these seeds and draws, one of each for an answer."""
    for line in others:
        found: Line = line["answers"].get(_REDRAWN, {})
        if line["case"] == case and (found.get("seed"), found.get("draw")) == (seeds, draws):
            return found
    raise ZygosError(
        f"case {case!r}: the other cells have other seeds or draws than {counted(len(seeds), 'draw')} of "
        f"seeds {min(seeds)} … {max(seeds)}; remedy: run both with the same --seeds and --draws"
    )


@dataclass(frozen=True)
class _State:
    """What one state of the code makes of the values that both publish; k parameters with at least two of them."""

    spread: Floats
    """(k,) standard deviations of the errors."""
    bias: Floats
    """(k,) mean errors, in standard deviations."""
    half95: Floats
    """(k,) medians of the half widths."""
    holds: Floats
    """(A, p) 1 where an interval contains the true value, 0 where it does not, NaN outside the values of both."""
    published: int
    wild: int

    @classmethod
    def of(cls, answers: EstimatorResults, both: NDArray[np.bool_], true: Floats) -> _State:
        kept = both.sum(axis=0) > 1
        error = np.where(both, answers.value - true, np.nan)[:, kept]
        spread = np.nanstd(error, axis=0, ddof=1)
        return cls(
            spread,
            np.abs(np.nanmean(error, axis=0)) / spread,
            np.nanmedian(np.where(both, answers.half95, np.nan)[:, kept], axis=0),
            np.where(both, intervals_hold(answers, true), np.nan),
            int(np.isfinite(answers.value).sum()),
            wild_values(answers, true),
        )


def _entry(
    case: Case, seeds: NDArray[np.int64], own: EstimatorResults, other: EstimatorResults, true: Floats
) -> dict[str, Any]:
    both = np.isfinite(own.value) & np.isfinite(other.value)
    here, there = (_State.of(answers, both, true) for answers in (own, other))
    groups = [seeds == seed for seed in np.unique(seeds)]
    per_seed = [float(np.nanmean((here.holds - there.holds)[rows])) for rows in groups if both[rows].any()]
    margin = STANDARD_ERRORS * float(np.std(per_seed, ddof=1)) / len(per_seed) ** 0.5 if len(per_seed) > 1 else None
    entry = {
        "case": case.name,
        "seeds": len(groups),
        "draws": len(seeds),
        "published_other": there.published,
        "published": here.published,
        "bias_other": _median(there.bias),
        "bias": _median(here.bias),
        "spread_ratio": _median(here.spread / there.spread),
        "half95_ratio": _median(here.half95 / there.half95),
        "coverage95_other": float(np.nanmean(there.holds)) if both.any() else None,
        "coverage95": float(np.nanmean(here.holds)) if both.any() else None,
        "coverage95_margin": margin,
        "wild_other": there.wild,
        "wild": here.wild,
    }
    return entry | {"worse": _worse(entry)}


def _median(values: Floats) -> float | None:
    return float(np.median(values)) if len(values) else None


def _worse(entry: dict[str, Any]) -> list[str]:
    """What is worse than in the other state, by the rules of the constants above."""
    out = []
    if None not in (entry["coverage95"], entry["coverage95_margin"]):
        further = abs(entry["coverage95"] - NOMINAL) - abs(entry["coverage95_other"] - NOMINAL)
        out += ["coverage"] if further > entry["coverage95_margin"] else []
    out += ["half widths"] if (entry["half95_ratio"] or 0.0) > WIDER else []
    out += ["wild values"] if entry["wild"] > entry["wild_other"] else []
    return out

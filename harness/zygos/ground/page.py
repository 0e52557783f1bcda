"""The pages of estimates on the ground and of predictions: verdict, parameters, joints, runs, and measured beside
predicted torques."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.effects import column_named, is_column, spoken
from zygos.files.output import number, ratio
from zygos.ground.estimate import GroundEstimate
from zygos.ground.motion import cutoff_hz
from zygos.ground.score import Score
from zygos.report.figures import LogScale, down_to, unit_of
from zygos.report.page import Entry, joint_colour, numbers, render, series, thinned
from zygos.report.provenance import Provenance

Floats = NDArray[np.float64]

MEANS = {
    "valid": "Values and intervals can be used.",
    "partial": "Values that are given can be used within their intervals; the reason says what is missing.",
    "doubtful": "There are values, but they should not be relied on before the cause is found.",
    "refused": "There are no values.",
}
"""What a verdict means, for readers."""
_TEMPLATE = "ground/page.html"
_POINTS = 1500
"""Of a line of a chart."""


def write_ground_report(path: Path, found: GroundEstimate, source: Provenance, *, written: str = "") -> None:
    """Write the page of an estimate on the ground.

    written: what became of the model, in words. Errors: ZygosError if it cannot be written.
    """
    data, content = ground_content(found, source, written)
    render(path, _TEMPLATE, data, **content)


def write_score_report(path: Path, scores: Sequence[Score], source: Provenance) -> None:
    """Write the page of predictions of one or several runs. Errors: ZygosError if it cannot be written."""
    data, runs = _predictions(scores)
    render(
        path,
        _TEMPLATE,
        data,
        found=None,
        arm=scores[0].run.arm,
        model=scores[0].model,
        share=number(100 * float(np.sqrt(np.nanmean([one.share**2 for one in scores]))), 3),
        predictions=runs,
        number=number,
        provenance=source,
    )


def ground_content(found: GroundEstimate, source: Provenance, written: str) -> tuple[Entry, dict[str, Any]]:
    """Data of the charts, and content of the template, of an estimate on the ground."""
    data, runs = _predictions(found.validated)
    return data, {
        "found": found,
        "arm": found.arm,
        "means": MEANS[found.validity],
        "written": written,
        "held_out": [number(100 * float(share), 3) for share in found.solution.share],
        "missing": [name for name, good in zip(found.names, found.determined, strict=True) if not good],
        "cutoff": number(cutoff_hz(found.arm), 3),
        "table": _parameters(found),
        "joints": _joints(found),
        "across": _across(found),
        "predictions": runs,
        "number": number,
        "provenance": source,
    }


def run_names(paths: Sequence[Path | None]) -> list[str]:
    """Short names of runs: file and folder, or a number where there is no file."""
    return [
        f"{path.parent.name}/{path.name}" if path is not None else f"run {number}"
        for number, path in enumerate(paths, 1)
    ]


def _parameters(found: GroundEstimate) -> Entry:
    """Rows of the table; the bars are half widths of the intervals, in per cent of the values."""
    arm = found.arm
    shares = [100 * ratio(half, abs(x)) for half, x in zip(found.half95.tolist(), found.value.tolist(), strict=True)]
    scale = LogScale.of(shares, 0.01, 100.0)
    grouping = dict(zip(arm.parameter_names, arm.structure.grouping, strict=True))
    rows = []
    for k, (name, unit, share) in enumerate(zip(found.names, found.units, shares, strict=True)):
        x, half, spread = (float(values[k]) for values in (found.value, found.half95, found.spread))
        known = np.isfinite(x)
        rows.append(
            {
                "name": name,
                "what": spoken(arm, name) if is_column(name) else grouping[name],
                "colour": joint_colour(_joint(found, k)),
                "unit": unit_of(unit),
                "value": down_to(x, half) if known else "–",
                "half": down_to(half, half) if known else "–",
                "freedom": number(float(found.solution.freedom[k]), 2) if known else "–",
                "spread": down_to(spread, spread) if np.isfinite(spread) else "–",
                "percent": number(share, 2),
                "at": scale.at(share),
            }
        )
    return {"rows": rows, "ticks": scale.ticks, "several": bool(np.isfinite(found.spread).any())}


def _joint(found: GroundEstimate, k: int) -> int | None:
    """Joint (from 0) of a parameter of a drive or an effect; None for one of bodies."""
    name = found.names[k]
    if is_column(name):
        joint = column_named(name).joint
        return joint if joint >= 0 else None
    return found.arm.parameters[k].joint


def _joints(found: GroundEstimate) -> list[Entry]:
    solution = found.solution
    measured = np.sqrt(np.mean(solution.measured**2, axis=0))
    residual = np.sqrt(np.mean(solution.residual**2, axis=0))
    return [
        {
            "name": joint.name,
            "colour": joint_colour(j),
            "held_out": number(100 * float(solution.share[j]), 3),
            "residual": number(100 * ratio(float(residual[j]), float(measured[j])), 3),
            "noise": number(float(found.torque_sigma[j]), 3),
            "excess": number(float(found.excess[j]), 3),
            "cluster": number(float(solution.cluster[j]), 2),
            "offsets": [number(float(one), 3) for one in solution.offset[:, j]],
        }
        for j, joint in enumerate(found.arm.joints)
    ]


def _across(found: GroundEstimate) -> Entry | None:
    """What each run alone leaves of the others."""
    if not len(found.across):
        return None
    names = run_names([run.path for run in found.runs])
    return {
        "names": names,
        "rows": [
            {"name": name, "cells": [number(100 * float(cell), 3) for cell in line]}
            for name, line in zip(names, found.across, strict=True)
        ],
    }


def _predictions(scores: Sequence[Score]) -> tuple[Entry, list[Entry]]:
    """Data of the charts, and tables, of predicted runs."""
    times, charts, runs = {}, dict[str, Entry](), []
    names = run_names([score.run.path for score in scores])
    for k, (score, name) in enumerate(zip(scores, names, strict=True)):
        at = thinned(len(score.t), _POINTS)
        times[f"run{k}"] = numbers(score.t[at])
        own = []
        for j, joint in enumerate(score.joints):
            left = score.measured[at, j] - score.predicted[at, j]
            lines = [
                series("measured", "soft", score.measured[at, j]),
                series("predicted", joint_colour(j), score.predicted[at, j], wide=False),
            ]
            error = [series("measured − predicted", joint_colour(j), left)]
            for key, title, drawn, height in (("torque", "torque", lines, 180), ("error", "error", error, 130)):
                chart: Entry = {
                    "id": f"{key}-{k}-{j}",
                    "title": f"{joint.joint}, {title}",
                    "unit": "N m",
                    "time": f"run{k}",
                    "domain": f"run{k}",
                    "axis": "s",
                    "height": height,
                    "series": drawn,
                }
                charts[chart["id"]] = chart
                own.append(chart)
        runs.append(
            {
                "name": name,
                "how": f"at {score.cutoff_hz:.1f} Hz"
                if score.cutoff_hz
                else f"over increments of {score.increment_s:g} s",
                "joints": [_scored(score, j) for j in range(len(score.joints))],
                "flexible": any(np.isfinite(one.spring_nm) for one in score.joints),
                "work": number(100 * score.arm_energy_share, 3),
                "charts": own,
            }
        )
    return {"times": times, "refused": [], "charts": charts}, runs


def _scored(score: Score, j: int) -> Entry:
    one = score.joints[j]
    return {
        "name": one.joint,
        "colour": joint_colour(j),
        "measured": number(one.measured_nm, 4),
        "error": number(one.error_nm, 3),
        "floor": number(one.floor_nm, 3),
        "share": number(100 * one.share, 3) if one.evaluated else "not evaluated",
        "offset": number(one.offset_nm, 2),
        "raw": number(100 * one.raw_share, 3),
        "work": number(one.energy_error_j, 3),
        "work_share": number(100 * one.energy_share, 3),
        "sigmas": number(one.sigmas, 3),
        "spring": number(one.spring_nm, 3),
    }

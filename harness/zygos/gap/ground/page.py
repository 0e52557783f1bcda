"""The page of an explained gap of an arm on the ground."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.files.output import number
from zygos.gap.charts import planned_chart
from zygos.gap.findings import Finding
from zygos.gap.ground.answer import predicted_errors
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.predictions import Prediction, quantities, run_name
from zygos.gap.ground.search import false_alarms, threshold
from zygos.gap.ground.sentences import after_gear, against, evidence, title
from zygos.gap.page import check_rows, limit_rows, planned_entry
from zygos.gap.sentences import asked_of_candidates
from zygos.gap.verdicts import PartNamed
from zygos.plan.separating import Separating
from zygos.report.figures import down_to, unit_of
from zygos.report.page import Entry, joint_colour, numbers, render, series, thinned
from zygos.report.provenance import Provenance

Floats = NDArray[np.float64]

_POINTS = 1500
"""Of a line of a chart."""
_BINS = 24
_UNITS = {"rate": "rad/s", "angle": "rad", "load": "N m", "time": "s"}
_GOOD = ("named", "nothing missing", "values differ", "plain estimate")


def write_ground_gap_report(
    path: Path, found: GroundExplanation, source: Provenance, planned: Separating | None = None
) -> None:
    """Write the page of an explanation. planned: the motion that tells a set apart. Errors: ZygosError if it cannot be
    written."""
    data, content = gap_content(found, source, planned)
    render(path, "gap/ground/page.html", data, **content)


def gap_content(
    found: GroundExplanation, source: Provenance, planned: Separating | None = None
) -> tuple[Entry, dict[str, Any]]:
    """Data of the charts, and content of the template."""
    arm = found.arm
    times, charts, runs = dict[str, Any](), dict[str, Entry](), []
    for k, one in enumerate(() if found.gap is None else found.gap.predictions):
        drawn = _charts(one, k, times)
        charts |= {chart["id"]: chart for chart in drawn}
        runs.append({"name": run_name(one.run), "charts": drawn, "cutoff": number(one.rows.cutoff_hz, 3)})
    tried = len(found.search.rounds[0]) if found.search.rounds else 0
    if planned is not None:
        times["planned"], charts["planned"] = planned_chart(arm, planned)
    content = {
        "x": found,
        "planned": planned and planned_entry(planned),
        "arm": arm,
        "good": found.answer in _GOOD,
        "findings": [_finding(found, one) for one in found.findings],
        "left": found.verdict.left if isinstance(found.verdict, PartNamed) else (),
        "gap": None
        if found.gap is None
        else [
            {"name": name, "energy": number(100 * share, 3), "torques": [number(x, 3) for x in torques]}
            for name, share, torques in predicted_errors(found.gap)
        ],
        "checks": check_rows(found.adopted, found.verdict),
        "joints": [
            {
                "name": one.joint,
                "colour": joint_colour(j),
                **{
                    key: " · ".join(number(x, 3) for x in getattr(one, key))
                    for key in ("delivered", "refit", "closed", "floor")
                },
            }
            for j, one in enumerate(found.joints)
        ],
        "candidates": [
            {
                "name": title(arm, one.name),
                "value": number(one.value, 4),
                "limit": number(one.limit, 2),
                "unit": unit_of(one.candidate.unit),
                "each": " · ".join(number(x, 3) for x in one.each),
                "z": number(one.z, 3),
                "explained": f"{100 * max(0.0, min(1.0, one.explained)):.0f}",
                "against": against(one),
            }
            for one in (found.search.rounds[0] if found.search.rounds else ())
        ],
        "asked": asked_of_candidates(threshold(tried), false_alarms(tried), "on all runs together"),
        "named": len(found.search.named),
        "beyond": limit_rows(
            arm,
            [
                (one.candidate.effect.kind, one.candidate.joint, one.limit)
                for one in found.search.beyond
                if one.candidate.effect is not None and math.isfinite(one.limit)
            ],
        ),
        "values": [
            {
                "name": v.name,
                "unit": unit_of(v.unit),
                "delivered": number(v.delivered, 5),
                "found": down_to(v.found, v.sigma),
                "half": number(limits.INTERVAL_Z.value * v.sigma, 2),
                "differs": v.differs,
            }
            for v in found.values
        ],
        "runs": runs,
        "number": number,
        "provenance": source,
    }
    return {"times": times, "refused": [], "charts": charts}, content


def _finding(found: GroundExplanation, one: Finding) -> Entry:
    low, high = one.interval
    return {
        "title": one.title,
        "place": one.joint,
        "value": down_to(one.value, one.sigma),
        "interval": f"{down_to(low, one.sigma)} … {down_to(high, one.sigma)}",
        "unit": unit_of(one.unit),
        "after": after_gear(found.arm, one),
        "evidence": evidence(one),
        "instead": [title(found.arm, name) for name in one.instead],
    }


def _charts(one: Prediction, k: int, times: dict[str, Any]) -> list[Entry]:
    """Torques over time, and what is left over rate, angle and load, of each joint."""
    at = thinned(len(one.closed.t), _POINTS)
    times[f"run{k}"] = numbers(one.closed.t[at])
    out = []
    for j, joint in enumerate(one.run.arm.joints):
        measured = one.closed.measured[at, j]
        torque = [
            series("measured", "soft", measured),
            series("as delivered", "joint3", one.delivered.predicted[at, j], wide=False),
            series("with what was found", joint_colour(j), one.closed.predicted[at, j], wide=False),
        ]
        error = [
            series("as delivered", "joint3", _error(one.delivered.measured, one.delivered.predicted)[at, j]),
            series("with what was found", joint_colour(j), one.error[at, j]),
        ]
        for key, said, drawn in (("torque", "torque", torque), ("error", "torque left", error)):
            out.append(_chart(f"{key}-{k}-{j}", f"{joint.name}, {said}", f"run{k}", "s", drawn))
        refit = _error(one.refit.measured, one.refit.predicted)[:, j]
        for name, x in quantities(one, j):
            if name == "time":
                continue
            centre, before = _medians(x, refit)
            _, after = _medians(x, one.error[:, j])
            times[f"{name}-{k}-{j}"] = numbers(centre)
            drawn = [series("refit", "joint1", before), series("with what was found", joint_colour(j), after)]
            said = f"{joint.name}, median of the torque left over the {name}"
            out.append(_chart(f"{name}-{k}-{j}", said, f"{name}-{k}-{j}", _UNITS[name], drawn))
    return out


def _chart(name: str, said: str, time: str, axis: str, drawn: list[Entry]) -> Entry:
    return {
        "id": name,
        "title": said,
        "unit": "N m",
        "time": time,
        "domain": time,
        "axis": axis,
        "height": 150,
        "lines": [0.0],
        "series": drawn,
    }


def _error(measured: Floats, predicted: Floats) -> Floats:
    return np.asarray(measured - predicted, dtype=np.float64)


def _medians(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Medians of both in bins of x with equally many values."""
    order = np.argsort(x, kind="stable")
    parts = [part for part in np.array_split(order, _BINS) if len(part)]
    return np.array([np.median(x[part]) for part in parts]), np.array([np.median(y[part]) for part in parts])

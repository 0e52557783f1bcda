"""The page of a plan: the ranking, the expected sigmas, and the best motion over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zygos.arm import Arm
from zygos.files.output import number
from zygos.plan.expected import Expectation
from zygos.plan.limits import Limits
from zygos.plan.planning import ranked
from zygos.plan.simulated import By
from zygos.report.figures import unit_of
from zygos.report.page import Entry, joint_colour, numbers, render, series, thinned
from zygos.report.provenance import Provenance

_POINTS = 6000
"""Of all lines of a chart together, about."""


def write_plan_report(
    path: Path,
    arm: Arm,
    expected: Sequence[Expectation],
    limits: Limits,
    provenance: Provenance,
    by: By = "energy",
) -> None:
    """Write the page of motions and what they tell. Errors: ZygosError if it cannot be written."""
    order = ranked(expected)
    best = order[0]
    charts = _charts(arm, best, limits)
    at = thinned(len(best.angle), _POINTS // arm.n)
    render(
        path,
        "plan/page.html",
        {
            "times": {"motion": numbers(best.step_s * at.astype(np.float64))},
            "refused": [],
            "charts": {chart["id"]: chart for chart in charts},
        },
        arm=arm,
        best=best.name,
        bound=by == "bound",
        worst=best.columns[best.worst].name,
        worst_percent=number(float(best.percent[best.worst]), 3),
        motions=[
            {
                "name": one.name,
                "mean": number(one.mean_percent, 3) if by == "bound" else f"{math.exp(one.measure - best.measure):.2f}",
                "worst": "–" if one.open else one.columns[one.worst].name,
                "percent": number(float(one.percent[one.worst]), 3),
                "rate": number(float(np.abs(one.rate).max()), 3),
                "torque": number(float(np.abs(one.torque).max()), 3),
                "excess": one.excess,
                "open": one.open,
            }
            for one in order
        ],
        parameters=[
            {
                "name": column.name,
                "unit": unit_of(column.unit),
                "value": number(column.value, 4),
                "percent": [number(float(one.percent[k]), 3) for one in order],
            }
            for k, column in enumerate(best.columns)
        ],
        charts=charts,
        provenance=provenance,
    )


def _charts(arm: Arm, best: Expectation, limits: Limits) -> list[Entry]:
    """Angle, rate and torque of each joint, with the limits as lines."""
    at = thinned(len(best.angle), _POINTS // arm.n)
    charts: list[Entry] = []
    for i, joint in enumerate(arm.joints):
        for key, title, unit, values, lines in (
            ("angle", "angle", "rad", best.angle, [limits.low[i], limits.high[i]]),
            ("rate", "rate", "rad/s", best.rate, [-limits.rate[i], limits.rate[i]]),
            ("torque", "torque as reported", "N m", best.torque, [-limits.torque[i], limits.torque[i]]),
        ):
            charts.append(
                {
                    "id": f"{key}-{i}",
                    "title": f"{joint.name}, {title}",
                    "unit": unit,
                    "lines": [float(line) for line in lines if math.isfinite(line)],
                    "series": [series(title, joint_colour(i), values[at, i])],
                    "time": "motion",
                    "domain": "time",
                    "axis": "s",
                    "height": 150,
                }
            )
    return charts

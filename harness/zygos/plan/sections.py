# SPDX-License-Identifier: MIT
"""The answer of `zygos plan`: its JSON, and its sections."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from zygos.arm import Arm
from zygos.files.output import number
from zygos.plan.expected import Expectation
from zygos.plan.limits import Limits
from zygos.plan.planning import Planner, ranked
from zygos.report.answer import NOTHING_DRAWN, Answer, Text, charts, section, sections, table
from zygos.report.figures import unit_of
from zygos.report.page import Entry, joint_colour, numbers, series, thinned

_POINTS = 6000
"""Of all lines of a chart together, about."""
_OF_BOUND = (
    (
        "σ in %",
        "The smallest standard deviation that any unbiased estimate can have after one run (the Cramér–Rao bound), in "
        "per cent of the value, or of a typical size where the value is close to 0. A dash: that size is 0, or the "
        "motion does not determine all parameters.",
    ),
    ("Mean σ", "The mean over the arm's parameters. The motions are ranked by it."),
)
_OF_ROWS = (
    (
        "σ in %",
        "The standard deviation that is expected after one run, in per cent of the largest value with the same unit of "
        "the same body. A dash: all these values are 0, or no value is expected.",
    ),
    ("Mean σ", "The mean over the arm's parameters, relative to the best motion."),
)
_SIGMA_OF_BOUND = (
    "σ: the smallest of any unbiased estimate after one run, in % of the value, or of what it is compared to"
)
_SIGMA_OF_ROWS = (
    "σ: expected after one run, in % of the largest value with the same unit of the same body; mean σ: of the arm's "
    "parameters, relative to the best motion"
)
_CHARTS = (
    "Charts",
    "One run of the best motion; limits are horizontal lines. Move the pointer to read values, drag to zoom, "
    "double-click to see the whole run.",
)


def answer_of(expected: Sequence[Expectation], planner: Planner, *, written: str = "", draw: bool = False) -> Answer:
    """The answer of a plan. written: the scenario that was written, in words. draw: with charts of the best motion."""
    arm, bound = planner.arm, planner.by == "bound"
    order = ranked(expected)
    best = order[0]
    drawn = _charts(arm, best, planner.limits) if draw else []
    at = thinned(len(best.angle), _POINTS // arm.n)
    worst = best.columns[best.worst].name
    lead = [Text(f"{written}.", "lead")] if written else []
    lead += [Text(f"{one.name}: {text}", "note") for one in expected for text in (one.excess, one.open) if text]
    return Answer(
        about="a planned motion",
        arm=arm.name,
        verdict="plan",
        tone="good",
        sentence=f"the motion {best.name} tells most: the worst known parameter is {worst}, with "
        f"{number(float(best.percent[best.worst]), 3)} %",
        lead=tuple(lead),
        reading=(*(_OF_BOUND if bound else _OF_ROWS), _CHARTS),
        sections=sections(
            section(
                "ranking",
                "Motions",
                Text(_SIGMA_OF_BOUND if bound else _SIGMA_OF_ROWS, "small"),
                table(
                    (
                        "motion",
                        f"mean σ{', %' if bound else ''}",
                        "worst parameter::text",
                        "its σ, %",
                        "largest rate, rad/s",
                        "largest torque, N m",
                        "limits::wrap",
                        *(("not determined::wrap",) if bound else ()),
                    ),
                    [
                        (
                            one.name,
                            number(one.mean_percent, 3) if bound else f"{math.exp(one.measure - best.measure):.2f}",
                            "–" if one.open else one.columns[one.worst].name,
                            number(float(one.percent[one.worst]), 3),
                            number(float(np.abs(one.rate).max()), 3),
                            number(float(np.abs(one.torque).max()), 3),
                            one.excess or "kept",
                            *((one.open or "nothing",) if bound else ()),
                        )
                        for one in order
                    ],
                ),
            ),
            section("motion", "The best motion", charts(drawn)),
            section(
                "parameters",
                "Parameters",
                table(
                    (
                        "parameter::name",
                        "unit::unit",
                        "model",
                        *(f"{one.name} σ, %" for one in order),
                    ),
                    [
                        (
                            column.name,
                            unit_of(column.unit),
                            number(column.value, 4),
                            *(number(float(one.percent[k]), 3) for one in order),
                        )
                        for k, column in enumerate(best.columns)
                    ],
                ),
            ),
        ),
        drawn={
            "times": {"motion": numbers(best.step_s * at.astype(np.float64))},
            "refused": [],
            "charts": {chart["id"]: chart for chart in drawn},
        }
        if draw
        else NOTHING_DRAWN,
    )


def as_json(expected: Sequence[Expectation], planner: Planner, scenario: str | None) -> dict[str, Any]:
    """The content of a plan's JSON. scenario: the file that was written."""
    limits = planner.limits
    return {
        "arm": planner.arm.name,
        "scenario": scenario,
        "rows": "bound" if planner.by == "bound" else "joint" if planner.grounded is not None else "simulated",
        "ranking": [one.name for one in ranked(expected)],
        "limits": {
            "low_rad": limits.low.tolist(),
            "high_rad": limits.high.tolist(),
            "rate_rad_s": limits.rate.tolist(),
            "torque_nm": limits.torque.tolist(),
        },
        "motions": [
            {
                "name": one.name,
                "measure": one.measure,
                "mean_percent": one.mean_percent,
                "worst": None if one.open else one.columns[one.worst].name,
                "excess": one.excess,
                "open": one.open,
                "largest_rate_rad_s": np.abs(one.rate).max(axis=0).tolist(),
                "largest_torque_nm": np.abs(one.torque).max(axis=0).tolist(),
                "parameters": [
                    {
                        "name": column.name,
                        "unit": column.unit,
                        "value": column.value,
                        "size": float(size),
                        "sigma": float(sigma),
                        "percent": float(percent),
                        "of_the_arm": column.structural,
                    }
                    for column, size, sigma, percent in zip(one.columns, one.size, one.sigma, one.percent, strict=True)
                ],
            }
            for one in expected
        ],
    }


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

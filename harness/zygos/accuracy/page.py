# SPDX-License-Identifier: MIT
"""The page of a campaign: errors, coverage and refusals of every estimator, and the paper's Figure 4.

Python selects and scales the numbers; the template `accuracy.html` contains the text and draws the charts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zygos.accuracy.cases import Case
from zygos.accuracy.estimators import ESTIMATORS
from zygos.accuracy.figure4 import HAIR, PRINTED
from zygos.accuracy.summary import WILD_PERCENT, WILD_SIGMAS
from zygos.files.output import number
from zygos.paper.response import PARTING
from zygos.report.page import Entry, render, series
from zygos.report.provenance import measured_commit

BAND = (0.92, 0.97)
"""Accepted range of the coverage of a 95 % interval."""
REFUSALS = 0.1
"""Largest share of the seeds that an estimator may refuse in a case without a fault."""
_COLOURS = {"DE": "joint5", "AMC": "joint3", "EB": "joint1"}
_OURS = ("joint0", "joint2", "joint6", "joint4")
_LOW, _HIGH = 1e-6, 1e4
"""Limits of the scales of errors, percent."""
_TOP, _HEIGHT, _LEFT = 12.0, 190.0, 46.0
_CROWDED = 16
"""Number of parameters from which their names are written vertically."""
_EVERY = 6
"""Every that many points of a long motion are drawn."""


def write_accuracy_report(
    path: Path,
    cases: Sequence[Case],
    summary: Sequence[Mapping[str, Any]],
    compared: Sequence[Mapping[str, Any]],
    figure: Mapping[str, Any] | None,
    draws: int,
) -> None:
    """Write the page. Errors: ZygosError if it cannot be written."""
    groups = []
    for case in cases:
        entries = [entry for entry in summary if entry["case"] == case.name]
        groups.append(
            {
                "name": case.name,
                "said": case.description,
                "benign": case.benign,
                "rows": [_row(entry) for entry in entries],
                "errors": _errors(case, entries),
                "coverage": _coverage(case, entries),
                "reasons": [
                    (entry["estimator"], reason, count)
                    for entry in entries
                    for reason, count in entry["reasons"].items()
                ],
                "compared": [
                    {key: _number(one[key]) if isinstance(one[key], float) else one[key] for key in one}
                    | {key: _number(100.0 * one[key]) for key in ("coverage95", "coverage95_beside")}
                    for one in compared
                    if one["case"] == case.name
                ],
                "inertia": [
                    (e["estimator"], _number(e["inertia"]["worst_percent"]), _number(e["inertia"]["median_percent"]))
                    for e in entries
                    if "inertia" in e
                ],
            }
        )
    render(
        path,
        "accuracy/page.html",
        _charts(figure) if figure else {"times": {}, "charts": {}, "refused": []},
        groups=groups,
        estimators=[(one.name, one.description, colour(one.name)) for one in ESTIMATORS],
        seeds=max(entry["seeds"] for entry in summary),
        draws=draws,
        commit=measured_commit(),
        figure=None if figure is None else _figure(figure),
        wild=(WILD_SIGMAS, WILD_PERCENT),
        band=BAND,
        refusals=REFUSALS,
        whole="Show all of it",
    )


def colour(estimator: str) -> str:
    """Colour of an estimator's marks and lines: a custom property of the style."""
    ours = [one.name for one in ESTIMATORS if one.ours]
    return _COLOURS[estimator] if estimator in _COLOURS else _OURS[ours.index(estimator) % len(_OURS)]


def _number(value: float | None) -> str:
    return number(value, 3)


def _row(entry: Mapping[str, Any]) -> Entry:
    shares = [share for share in (entry["coverage95"] or {}).values() if share is not None]
    return {
        "estimator": entry["estimator"],
        "colour": colour(entry["estimator"]),
        "seeds": entry["seeds"],
        "refused": entry["refused"],
        "many": entry["benign"] and entry["refused"] > REFUSALS * entry["seeds"],
        "mean": _number(entry["mean_rms_percent"]),
        "max": _number(entry["max_rms_percent"]),
        "bound": _number(entry["times_bound"]),
        "coverage": f"{100 * min(shares):.1f} … {100 * max(shares):.1f}" if shares else "–",
        "inside": f"{sum(BAND[0] <= share <= BAND[1] for share in shares)} of {len(shares)}" if shares else "–",
        "wild": "–" if entry["wild"] is None else str(entry["wild"]),
    }


def _panel(case: Case, ticks: Sequence[Entry]) -> Entry:
    """An empty chart with a column for each parameter."""
    names = case.arm.parameter_names
    upright = len(names) > _CROWDED
    step = 19.0 if upright else 41.0
    return {
        "width": _LEFT + step * len(names) + 8.0,
        "height": _TOP + _HEIGHT + (62.0 if upright else 20.0),
        "left": _LEFT,
        "bottom": _TOP + _HEIGHT,
        "step": step,
        "upright": upright,
        "ticks": ticks,
        "names": [{"x": _LEFT + step * (k + 0.5), "name": name} for k, name in enumerate(names)],
        "marks": [],
    }


def _mark(
    panel: Entry, entry: Mapping[str, Any], index: int, count: int, of: Mapping[str, Mapping[int, float]]
) -> None:
    """Add the marks of one of `count` estimators, side by side in the columns; `of` maps the kind, "dots" or "bars", to
    ordinates by parameter."""
    aside = panel["step"] * 0.8 * ((index + 0.5) / count - 0.5)
    columns = panel["names"]

    def path(kind: str, half: float) -> str:
        """Horizontal strokes of the given half width at each mark."""
        marks = of.get(kind, {}).items()
        return "".join(f"M{columns[k]['x'] + aside - half:.1f} {y:.1f}h{2 * half:g}" for k, y in marks)

    panel["marks"].append(
        {
            "name": entry["estimator"],
            "colour": colour(entry["estimator"]),
            "dots": path("dots", 0.0),
            "bars": path("bars", 3.0),
        }
    )


def _errors(case: Case, entries: Sequence[Mapping[str, Any]]) -> Entry | None:
    """Bias and spread on a logarithmic scale."""

    def sizes(entry: Mapping[str, Any], key: str) -> dict[int, float]:
        own = (parameter[key] for parameter in entry["per_parameter"].values())
        return {k: min(max(abs(value), _LOW), _HIGH) for k, value in enumerate(own) if value}

    found = [(sizes(entry, "bias_percent"), sizes(entry, "spread_percent")) for entry in entries]
    every = [size for bias, spread in found for size in (*bias.values(), *spread.values())]
    if not every:
        return None
    low = math.floor(math.log10(min(every)))
    high = max(low + 1, math.ceil(math.log10(max(every))))

    def at(size: float) -> float:
        return _TOP + _HEIGHT * (high - math.log10(size)) / (high - low)

    panel = _panel(case, [{"y": round(at(10.0**k), 1), "label": f"{10.0**k:g}"} for k in range(low, high + 1)])
    for index, (entry, (bias, spread)) in enumerate(zip(entries, found, strict=True)):
        of = {"dots": {k: at(v) for k, v in bias.items()}, "bars": {k: at(v) for k, v in spread.items()}}
        _mark(panel, entry, index, len(entries), of)
    return panel


def _coverage(case: Case, entries: Sequence[Mapping[str, Any]]) -> Entry | None:
    """Coverage of the estimators that give intervals, 0 to 100 %."""
    given = [entry for entry in entries if entry["coverage95"]]
    if not given:
        return None

    def at(share: float) -> float:
        return _TOP + _HEIGHT * (1.0 - share)

    panel = _panel(case, [{"y": round(at(k / 5), 1), "label": str(20 * k)} for k in range(6)])
    panel["band"] = {"y": round(at(BAND[1]), 1), "height": round(at(BAND[0]) - at(BAND[1]), 1)}
    for index, entry in enumerate(given):
        shares = {k: at(share) for k, share in enumerate(entry["coverage95"].values()) if share is not None}
        _mark(panel, entry, index, len(given), {"dots": shares})
    return panel


_STYLES: dict[str, Entry] = {
    "true": {"colour": "ink", "wide": True},
    PRINTED: {"colour": "joint1", "dash": True},
    "+10 %": {"colour": "joint5"},
    "−10 %": {"colour": "joint3"},
    "+0.1 %": {"colour": "joint5", "dash": True},
    HAIR: {"colour": "soft", "dash": True},
}


def _style(name: str) -> Entry:
    return _STYLES.get(name) or {"colour": colour(name)}


def _charts(figure: Mapping[str, Any]) -> dict[str, Any]:
    long = {
        f"motion{k}": {
            "id": f"motion{k}",
            "title": f"Response to the torques (50): link angle of the {joint}",
            "unit": "rad",
            "time": "long",
            "height": 240,
            "series": [series(name, y=np.array(q[k][::_EVERY]), **_style(name)) for name, q in figure["free"].items()],
        }
        for k, joint in enumerate(figure["joints"])
    }
    arcs = {
        "id": "arcs",
        "title": "Error of predictions under the same torques, from true states",
        "unit": "rad, median over the arcs",
        "time": "arc",
        "domain": "arc",
        "axis": "s",
        "log": True,
        "height": 300,
        "series": [
            series(name, y=np.array(y), **_style(name)) for name, y in figure["arcs_rad"].items() if name != "true"
        ],
    }
    times = {"long": figure["time_s"][::_EVERY], "arc": figure["horizon_s"]}
    rounded = {name: [round(t, 4) for t in values] for name, values in times.items()}
    return {"times": rounded, "charts": {**long, "arcs": arcs}, "refused": []}


def _most(figure: Mapping[str, Any], name: str) -> str:
    """Largest distance of a free motion from the true one, rad."""
    return number(float(np.max(np.abs(np.array(figure["free"][name]) - np.array(figure["free"]["true"])))), 2)


def _figure(figure: Mapping[str, Any]) -> Entry:
    horizon = figure["horizon_s"]
    at = [int(np.argmin(np.abs(np.array(horizon) - s))) for s in (0.5, 2.0, 5.0)]
    return {
        "charts": [*(f"motion{k}" for k in range(len(figure["joints"]))), "arcs"],
        "rows": [
            {
                "name": name,
                "colour": _style(name)["colour"],
                "free": _number(rms),
                "percent": _number(figure["free_rms_percent"][name]),
                "servo": _number(figure["servo_rms_rad"][name]),
                "short": [_number(figure["arcs_rad"][name][k]) if name in figure["arcs_rad"] else "–" for k in at],
            }
            for name, rms in figure["free_rms_rad"].items()
            if name != "true"
        ],
        "missing": figure["missing"],
        "duration": f"{figure['time_s'][-1]:.0f}",
        "parting": number(figure["parting"], 2),
        "chaotic": figure["parting"] > PARTING,
        "printed": PRINTED,
        "hair": HAIR,
        "hair_most": _most(figure, HAIR),
        "small": "+0.1 %",
        "small_most": _most(figure, "+0.1 %"),
        "horizons": [f"{horizon[k]:g}" for k in at],
    }

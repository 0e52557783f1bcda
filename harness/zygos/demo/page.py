# SPDX-License-Identifier: MIT
"""The report of the demonstration: one self-contained page.

Python selects and scales the numbers; `demo.html` contains the text, and the script in `charts.html` draws the charts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.estimation.charts import drawn, energy, meaning, residual, sheet, times, trajectories
from zygos.estimation.ledger import balance
from zygos.files.output import number
from zygos.native.flight import Estimate, Trace
from zygos.report.figures import grouped, signed
from zygos.report.page import UNITS, Entry, joint_colour, numbers, render, series

Floats = NDArray[np.float64]

_SETTLED = 0.5  # share of the run whose estimates are ignored for the scale of the convergence charts


@dataclass(frozen=True)
class Convergence:
    """Estimates during a run, at m times; NaN where a parameter is not identifiable yet."""

    time_s: Floats
    """(m,)"""
    value: Floats
    """(m, p) values."""
    half95: Floats
    """(m, p) half width of the 95 % interval."""


def write_report(
    path: Path,
    arm: Arm,
    trace: Trace,
    estimate: Estimate,
    numpy_value: Floats,
    true: Floats,
    convergence: Convergence,
    content: Mapping[str, Any],
) -> None:
    """Write the page: parameter table, trajectories, energy ledger, convergence, residual.

    numpy_value (p,) is the reference's estimate, true (p,) the plant's values; content has `bus`, `cycles` and
    `faults`, and may have `parameters` with refined values, and `gap`, the result of
    `zygos.demo.demonstration.explain_gap`.
    """
    ledger = balance(arm, trace, estimate.value)
    every = drawn(trace)
    complete = bool(np.all(np.isfinite(estimate.value)))
    groups = {
        "trajectories": trajectories(arm, trace, every),
        "energy": energy(ledger, every) if complete else [],
        "residual": residual(ledger, estimate, every) if complete else [],
        "convergence": _convergence(arm, true, convergence),
    }
    time = trace.cycles.sync.astype(np.float64) * arm.period_s
    state_time = time - arm.smoother.lag * arm.period_s
    seen, refused = times(arm, trace, every)
    data = {
        "times": {**seen, "estimate": numbers(convergence.time_s)},
        "refused": refused,
        "charts": {chart["id"]: chart for charts in groups.values() for chart in charts},
    }
    render(
        path,
        "demo/page.html",
        data,
        arm=arm,
        estimate=estimate,
        bus=content["bus"],
        cycles=int(content["cycles"]),
        faults=dict(content["faults"]),
        gap=content.get("gap"),
        instants=int(trace.instant.sum()),
        refused=len(refused),
        duration=float(time[-1] - time[0]) if len(time) else 0.0,
        sheet=sheet(ledger, state_time) if complete else None,
        missing=[name for name, x in zip(estimate.names, estimate.value, strict=True) if not math.isfinite(x)],
        groups=groups,
        number=number,
        **_refined(content.get("parameters", [])),
        **_parameters(arm, estimate, numpy_value, true),
    )


def _refined(parameters: Sequence[Mapping[str, Any]]) -> Entry:
    """The refined value of each parameter and its error in per cent, as text, and their mean error."""
    cells = {p["name"]: (grouped(p["refined"]), f"{p['refined_error_percent']:+.5f}") for p in parameters}
    errors = [abs(p["refined_error_percent"]) for p in parameters]
    return {"refined": cells, "refined_error": sum(errors) / len(errors) if errors else None}


def _parameters(arm: Arm, estimate: Estimate, numpy_value: Floats, true: Floats) -> Entry:
    """The table's rows, and the main numbers for the headline."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error = 100.0 * (estimate.value / true - 1.0)
        half95 = 100.0 * np.abs(estimate.half95 / true)
        difference = np.abs(estimate.value / numpy_value - 1.0)
    known = np.isfinite(error)
    reach = np.where(known, np.abs(error) + np.where(np.isfinite(half95), half95, 0.0), 0.0)
    scale = max(float(reach.max(initial=0.0)), 1e-9)
    rows: list[Entry] = []
    for k, name in enumerate(arm.parameter_names):
        what, joint = meaning(arm, name)
        spread = half95[k] if np.isfinite(half95[k]) else 0.0
        rows.append(
            {
                "name": name,
                "meaning": what,
                "colour": joint_colour(joint),
                "unit": UNITS.get(arm.parameter_units[k], arm.parameter_units[k]),
                "true": grouped(true[k]),
                "c": grouped(estimate.value[k]),
                "error": signed(error[k]),
                "half95": f"{half95[k]:.2f}" if np.isfinite(half95[k]) else "–",
                "outside": bool(abs(error[k]) > half95[k]),
                "difference": f"{difference[k]:.0e}" if np.isfinite(difference[k]) else "–",
                # per cent of the cell's width
                "bar": {
                    "at": 50.0 + 50.0 * error[k] / scale,
                    "left": 50.0 + 50.0 * (error[k] - spread) / scale,
                    "width": 100.0 * spread / scale,
                }
                if known[k]
                else None,
            }
        )
    worst = int(np.argmax(np.where(known, np.abs(error), -1.0)))
    compared = difference[np.isfinite(difference)]
    return {
        "parameters": rows,
        "scale": number(scale, 2),
        "learned": int(np.isfinite(estimate.value).sum()),
        "mean_error": float(np.abs(error[known]).mean()) if known.any() else None,
        "worst_error": float(abs(error[worst])) if known.any() else None,
        "worst_name": arm.parameter_names[worst],
        "outside": int(np.count_nonzero(np.abs(error) > half95)),
        "compared": int(np.count_nonzero(np.isfinite(error) & np.isfinite(half95))),
        "difference": f"{compared.max():.0e}" if compared.size else None,
    }


def _convergence(arm: Arm, true: Floats, convergence: Convergence) -> list[Entry]:
    """One chart per parameter: deviation from the true value in per cent, and the 95 % interval as a band."""
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = 100.0 * (convergence.value / true - 1.0)
        spread = 100.0 * np.abs(convergence.half95 / true)
    reach = np.abs(deviation) + np.nan_to_num(spread, posinf=0.0)
    time = convergence.time_s
    settled = time >= (_SETTLED * time[-1] if len(time) else 0.0)
    reach = np.where(settled[:, None] & np.isfinite(reach), reach, 0.0).max(axis=0, initial=0.0)
    shared = float(reach.max(initial=0.0))
    charts = []
    for k, name in enumerate(arm.parameter_names):
        what, joint = meaning(arm, name)
        charts.append(
            {
                "id": f"parameter-{k}",
                "title": name,
                "note": what,
                "unit": "%",
                "time": "estimate",
                "height": 130,
                "small": True,
                "known": bool(np.isfinite(deviation[:, k]).any()),
                "lines": [0.0],
                "reach": {"shared": 1.05 * shared or 1.0, "own": 1.1 * float(reach[k]) or 1.0},
                "series": [series(what, joint_colour(joint), deviation[:, k], band=numbers(spread[:, k]))],
            }
        )
    return charts

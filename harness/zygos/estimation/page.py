"""The page of an estimate: verdict, parameters, what was lost or left out, the motion and the energy balance.

It knows what the estimator knows, and no true value.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.estimation.charts import Drawn, drawn, energy, meaning, rates, residual, sheet, times, trajectories
from zygos.estimation.estimate import Estimation
from zygos.estimation.ledger import Ledger, balance
from zygos.estimation.watch import Note, Watch
from zygos.estimation.words import about_left_out, about_noise, losses
from zygos.files.output import number, ratio
from zygos.native.flight import Drift, Estimate, Trace
from zygos.report.figures import LogScale, down_to, unit_of
from zygos.report.page import Entry, joint_colour, numbers, render, series
from zygos.report.provenance import Provenance

Floats = NDArray[np.float64]

_POINTS = 6000
"""Of all lines of a chart together, about."""
_LEFT_OUT = 60
"""Arcs that are listed."""
_FEWEST = 4
"""Estimates on the way that are worth a chart."""
_SMALL_CHARTS = 40
"""Parameters whose way is drawn; of an arm with more, the best known ones."""
_SETTLED = 0.5
"""Of the run: what comes before does not set the scale of the charts of the way."""
_MEANS = {
    "valid": "Values and intervals can be used.",
    "partial": "The motion determines only some of the parameters; those that have a value can be used.",
    "doubtful": "There are values, but they should not be relied on before the cause is found.",
    "refused": "There are no values.",
}


def write_estimate_report(
    path: Path,
    found: Estimation,
    provenance: Provenance,
    *,
    written: str = "",
    damage: Sequence[str] = (),
) -> None:
    """Write the page of an estimate that kept its trace.

    written: what became of the model, in words. damage: of the run's log. Errors: ZygosError if it cannot be written.
    """
    result, watch, drift = found.result, found.watch, found.drift
    arm, flight, trace = watch.flight.arm, watch.flight, watch.trace()
    at = drawn(trace, _POINTS // (arm.n + 2))
    names, refused = times(arm, trace, at)
    predicts = bool(np.all(np.isfinite(result.solution)))
    ledger = balance(arm, trace, result.solution, flight.effects) if predicts else None
    noted = trace.cycles.sync[[max(note.cycles, 1) - 1 for note in watch.notes]] if len(trace.cycles) else np.zeros(0)
    names["estimate"] = numbers(noted.astype(np.float64) * arm.period_s)
    groups = {
        "motion": trajectories(arm, trace, at) + rates(arm, trace, at) if len(trace.cycles) else [],
        "energy": energy(ledger, at) if ledger else [],
        "residual": residual(ledger, result, at) if ledger else [],
        "way": _way(arm, result, watch.notes),
    }
    every = [chart for charts in groups.values() for chart in charts]
    for chart in every:
        # the cycles of a log need not begin at 0
        chart["domain"], chart["axis"] = "time", "s"
    missing = [name for name, x in zip(result.names, result.value, strict=True) if not np.isfinite(x)]
    render(
        path,
        "estimation/page.html",
        {"times": names, "refused": refused, "charts": {chart["id"]: chart for chart in every}},
        arm=arm,
        result=result,
        means=_MEANS.get(result.validity, ""),
        measured="" if found.validity == "valid" else found.measured,
        remedy=found.remedy,
        written=written,
        learned=len(result.names) - len(missing),
        missing=missing,
        cycles=len(trace.cycles),
        duration=len(trace.cycles) * arm.period_s,
        counts=flight.counts,
        faults=flight.faults,
        lost=losses(flight),
        left_out=_left_out(arm, watch),
        said_left_out=about_left_out(result, watch),
        change=found.change,
        drift=_drift(arm, drift),
        noise=about_noise(result),
        damage=list(damage),
        table=_parameters(arm, result),
        sheet=_sheet(arm, ledger, trace, at) if ledger else None,
        groups=groups,
        number=number,
        provenance=provenance,
    )


def _parameters(arm: Arm, result: Estimate) -> Entry:
    """Rows of the table; the bars are half widths of the intervals, in per cent of the values."""
    shares = [
        100.0 * ratio(half, abs(x)) for half, x in zip(result.half95.tolist(), result.value.tolist(), strict=True)
    ]
    scale = LogScale.of(shares, 0.01, 100.0)
    rows = []
    for name, unit, x, half, share in zip(
        result.names, result.units, result.value.tolist(), result.half95.tolist(), shares, strict=True
    ):
        what, joint = meaning(arm, name)
        rows.append(
            {
                "name": name,
                "what": what,
                "colour": joint_colour(joint),
                "unit": unit_of(unit),
                "value": down_to(x, half) if np.isfinite(x) else "–",
                "half": down_to(half, half) if np.isfinite(half) else "–",
                "interval": f"{down_to(x - half, half)} … {down_to(x + half, half)}"
                if np.isfinite(x) and np.isfinite(half)
                else "–",
                "percent": number(share, 2),
                "at": scale.at(share),
            }
        )
    return {"rows": rows, "ticks": scale.ticks}


def _left_out(arm: Arm, watch: Watch) -> Entry:
    listed = [
        {"rows": arc.rows, "first": f"{arc.first * arm.period_s:.1f}", "last": f"{arc.last * arm.period_s:.1f}"}
        for arc in watch.left_out
    ]
    return {"rows": listed[:_LEFT_OUT], "more": max(0, len(listed) - _LEFT_OUT)}


def _drift(arm: Arm, drift: Drift | None) -> list[Entry]:
    """Parameters that contradict what was known before, furthest first."""
    if drift is None or not drift.contradicting:
        return []
    far = [
        (name, x) for name, x in zip(drift.names, drift.deviation.tolist(), strict=True) if name in drift.contradicting
    ]
    return [
        {"name": name, "what": meaning(arm, name)[0], "deviation": number(x, 3)}
        for name, x in sorted(far, key=lambda one: -abs(one[1]))
    ]


def _sheet(arm: Arm, ledger: Ledger, trace: Trace, at: Drawn) -> Entry | None:
    time = trace.cycles.sync.astype(np.float64) * arm.period_s - arm.smoother.lag * arm.period_s
    return sheet(ledger, time)


def _way(arm: Arm, result: Estimate, notes: Sequence[Note]) -> list[Entry]:
    """One chart a parameter: each estimate on the way as its deviation from the last one in per cent, and its 95 %
    interval as a band."""
    value, half95 = (np.array([getattr(note, key) for note in notes]) for key in ("value", "half95"))
    if np.count_nonzero(np.isfinite(value).any(axis=-1)) < _FEWEST:
        return []
    with np.errstate(divide="ignore", invalid="ignore"):
        deviation = 100.0 * (value / result.value - 1.0)
        spread = 100.0 * np.abs(half95 / result.value)
        known = 100.0 * np.abs(result.half95 / result.value)
    time = np.array([note.cycles for note in notes], dtype=np.float64)
    settled = (time >= _SETTLED * time[-1])[:, None]
    reach = np.abs(deviation) + np.where(np.isfinite(spread), spread, 0.0)
    reach = np.where(settled & np.isfinite(reach), reach, 0.0).max(axis=0, initial=0.0)
    usable = np.flatnonzero(np.isfinite(deviation).any(axis=0))
    drawn_at = np.sort(usable[np.argsort(known[usable], kind="stable")][:_SMALL_CHARTS]).tolist()
    shared = float(reach[drawn_at].max(initial=0.0)) if drawn_at else 0.0
    charts = []
    for k in drawn_at:
        what, joint = meaning(arm, result.names[k])
        charts.append(
            {
                "id": f"parameter-{k}",
                "title": result.names[k],
                "note": what,
                "unit": "%",
                "time": "estimate",
                "height": 130,
                "small": True,
                "lines": [0.0],
                "reach": {"shared": 1.05 * shared or 1.0, "own": 1.1 * float(reach[k]) or 1.0},
                "series": [series(what, joint_colour(joint), deviation[:, k], band=numbers(spread[:, k]))],
            }
        )
    return charts

"""The report of the demonstration: one self-contained page.

Python selects and scales the numbers; `demo.html` contains the text, and the script in `charts.html` draws the charts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.files.output import number
from zygos.native.flight import Estimate, Trace
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


@dataclass(frozen=True)
class Ledger:
    """Both sides of the energy balance at n cycles in J; NaN where a cycle completed no instant.

    work + constant of the arc = kinetic + elastic + dissipated + residual
    """

    kinetic: Floats
    """(n,)"""
    elastic: Floats
    """(n,)"""
    dissipated: Floats
    """(n,) energy dissipated since the origin of the arc."""
    supplied: Floats
    """(n,) work of the motors since the origin of the arc, plus the energy at the origin: the arc's constant."""
    residual: Floats
    """(n,)"""
    arcs: int


def balance(arm: Arm, trace: Trace, value: Floats) -> Ledger:
    """Split each row into the kinds of energy of its parameters, value (p,).

    The constant of an arc is the mean of W - row . value over its accepted instants, as in least squares.
    """
    row = np.where(trace.instant[:, None], trace.row, np.nan)
    terms, work = row[:, :-1] * value, row[:, -1]
    first = len(arm.parameter_names) - 3 * arm.n
    slip = row[:, first + 2 : -1 : 3]
    kinetic = terms[:, :first].sum(axis=1) + terms[:, first::3].sum(axis=1)
    elastic = terms[:, first + 1 :: 3].sum(axis=1)
    dissipated = terms[:, first + 2 :: 3].sum(axis=1)
    left = work - kinetic - elastic - dissipated
    # work and slip are exactly zero at the origin of an arc
    origin = trace.instant & (work == 0.0) & np.all(slip == 0.0, axis=1)
    arc = np.cumsum(origin)
    constant = np.full(len(work), np.nan)
    for index in np.unique(arc[trace.instant]):
        of_arc = trace.instant & (arc == index)
        used = of_arc & trace.accepted
        constant[of_arc] = left[used if used.any() else of_arc].mean()
    return Ledger(kinetic, elastic, dissipated, work - constant, left - constant, int(origin.sum()))


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
    `faults`, and may have `gap`, the result of `zygos.demo.demonstration.explain_gap`.
    """
    ledger = balance(arm, trace, estimate.value)
    complete = bool(np.all(np.isfinite(estimate.value)))
    groups = {
        "trajectories": _trajectories(arm, trace),
        "energy": _energy(ledger) if complete else [],
        "residual": _residual(ledger, estimate) if complete else [],
        "convergence": _convergence(arm, true, convergence),
    }
    time = trace.cycles.sync.astype(np.float64) * arm.period_s
    refused = trace.instant & ~trace.accepted
    state_time = time - arm.smoother.lag * arm.period_s
    data = {
        "times": {"state": numbers(state_time), "cycle": numbers(time), "estimate": numbers(convergence.time_s)},
        "refused": np.flatnonzero(refused).tolist(),
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
        refused=int(refused.sum()),
        duration=float(time[-1] - time[0]) if len(time) else 0.0,
        sheet=_sheet(ledger, state_time) if complete else None,
        missing=[name for name, x in zip(estimate.names, estimate.value, strict=True) if not math.isfinite(x)],
        groups=groups,
        number=number,
        **_parameters(arm, estimate, numpy_value, true),
    )


def _meaning(arm: Arm, index: int) -> tuple[str, int | None]:
    """The meaning of a parameter, and the joint to which it belongs, or None."""
    inertial = len(arm.parameter_names) - 3 * arm.n
    if index >= inertial:
        joint, kind = divmod(index - inertial, 3)
        return f"{('rotor inertia', 'stiffness', 'damping')[kind]}, {arm.joints[joint].name}", joint
    i, j = ("base" if c == "0" else f"link {c}" for c in arm.parameter_names[index][1:])
    return (f"inertia, {i}" if i == j else f"inertia, {i} with {j}"), None


def _signed(value: float, digits: int = 2) -> str:
    return f"{value:+.{digits}f}".replace("-", "−") if math.isfinite(value) else "–"


def _grouped(value: float) -> str:
    return f"{value:,.7g}".replace("-", "−") if math.isfinite(value) else "–"


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
        meaning, joint = _meaning(arm, k)
        spread = half95[k] if np.isfinite(half95[k]) else 0.0
        rows.append(
            {
                "name": name,
                "meaning": meaning,
                "colour": joint_colour(joint),
                "unit": UNITS.get(arm.parameter_units[k], arm.parameter_units[k]),
                "true": _grouped(true[k]),
                "numpy": _grouped(numpy_value[k]),
                "c": _grouped(estimate.value[k]),
                "error": _signed(error[k]),
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


def _trajectories(arm: Arm, trace: Trace) -> list[Entry]:
    """The input of the estimator: smoothed and calibrated, except the torque."""
    n = arm.n
    state = np.where(trace.instant[:, None], trace.state, np.nan)
    q, theta, omega = state[:, :n], state[:, n : 2 * n], state[:, 4 * n :] @ arm.axis
    tau = trace.cycles.tau.copy()
    tau[1:][np.diff(trace.cycles.sync) != 1] = np.nan  # no line across a gap
    joints = [(i, joint.name, joint_colour(i)) for i, joint in enumerate(arm.joints)]
    angles = [
        series(f"{name}, {end}", colour, values[:, i], dash=end == "motor")
        for i, name, colour in joints
        for end, values in (("link", q), ("motor", theta))
    ]
    deflection = [series(name, colour, theta[:, i] - q[:, i]) for i, name, colour in joints]
    torque = [series(name, colour, tau[:, i], step=True) for i, name, colour in joints]
    return [
        {"id": "angles", "title": "Joint angles", "unit": "rad", "time": "state", "series": angles},
        {
            "id": "deflection",
            "title": "Deflection, motor angle − link angle",
            "unit": "rad",
            "time": "state",
            "series": deflection,
        },
        {
            "id": "base",
            "title": "Turning rate of the base",
            "unit": "rad/s",
            "time": "state",
            "series": [series("base", "ink", omega)],
        },
        {"id": "torque", "title": "Motor torque, before the gear", "unit": "N m", "time": "cycle", "series": torque},
    ]


def _energy(ledger: Ledger) -> list[Entry]:
    return [
        {
            "id": "energy",
            "title": "Work of the motors, and the energies",
            "unit": "J",
            "time": "state",
            "height": 300,
            "series": [
                series("dissipated", "dissipated", ledger.dissipated, stack=True),
                series("elastic", "elastic", ledger.elastic, stack=True),
                series("kinetic", "kinetic", ledger.kinetic, stack=True),
                series("work of the motors + energy at the start", "ink", ledger.supplied, wide=True),
            ],
        }
    ]


def _residual(ledger: Ledger, estimate: Estimate) -> list[Entry]:
    return [
        {
            "id": "residual",
            "title": "Work not accounted for by the parameters",
            "unit": "J",
            "time": "state",
            "height": 220,
            "lines": [0.0, *([estimate.residual, -estimate.residual] if math.isfinite(estimate.residual) else [])],
            "series": [series("residual", "ink", ledger.residual, mark=True)],
        }
    ]


def _sheet(ledger: Ledger, time: Floats) -> Entry | None:
    """The energies at the last instant."""
    at = np.flatnonzero(np.isfinite(ledger.residual))
    if not at.size:
        return None
    last = at[-1]
    names = ("supplied", "kinetic", "elastic", "dissipated", "residual")
    return {"time": f"{time[last]:.2f}"} | {name: _signed(getattr(ledger, name)[last], 1) for name in names}


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
        meaning, joint = _meaning(arm, k)
        charts.append(
            {
                "id": f"parameter-{k}",
                "title": name,
                "note": meaning,
                "unit": "%",
                "time": "estimate",
                "height": 130,
                "small": True,
                "known": bool(np.isfinite(deviation[:, k]).any()),
                "lines": [0.0],
                "reach": {"shared": 1.05 * shared or 1.0, "own": 1.1 * float(reach[k]) or 1.0},
                "series": [series(meaning, joint_colour(joint), deviation[:, k], band=numbers(spread[:, k]))],
            }
        )
    return charts

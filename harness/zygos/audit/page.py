"""The page of an audit: what is wrong with an arm file, what each signal is like, and the readings themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.audit.answer import advice, summary
from zygos.audit.findings import Audit, Pair, Signal
from zygos.can.run import Run
from zygos.files.output import number
from zygos.report.page import Entry, joint_colour, numbers, render, series, thinned
from zygos.report.provenance import Provenance
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]

_POINTS = 6000
"""Of all lines of a chart together, about."""


def write_audit_report(
    path: Path,
    run: Run,
    found: Audit,
    provenance: Provenance,
) -> None:
    """Write the page of what is found in a run. Errors: ZygosError if it cannot be written."""
    arm, cycles = run.arm, run.cycles
    at = thinned(len(cycles), _POINTS // (arm.n + 2))
    time = cycles.sync.astype(np.float64) * arm.period_s
    charts = _charts(arm, cycles, at) if len(cycles) else []
    accused = {finding.signal for finding in found.findings}
    render(
        path,
        "audit/page.html",
        {"times": {"cycle": numbers(time[at])}, "refused": [], "charts": {chart["id"]: chart for chart in charts}},
        arm=arm,
        found=found,
        tag="confirmed" if found.ok else "something is wrong" if found.findings else "not confirmed",
        summary=summary(found),
        advice=advice(found),
        cycles=len(cycles),
        signals=[_signal(signal, wrong=signal.name in accused) for signal in found.signals],
        pairs=[_pair(one) for one in found.pairs],
        laws=[
            {"name": name, "residual": number(left, 4), "chosen": name == arm.torque_law}
            for name, left in found.laws.items()
        ],
        faults=dict(run.faults),
        charts=charts,
        damage=list(run.damage),
        provenance=provenance,
    )


def _signal(signal: Signal, *, wrong: bool) -> Entry:
    return {
        "name": signal.name,
        "unit": signal.unit,
        "share": number(100 * signal.share, 4),
        "low": number(signal.low, 4),
        "high": number(signal.high, 4),
        "step": number(signal.step, 3),
        "quantum": number(signal.quantum, 3),
        "noise": number(signal.noise, 2),
        "declared": number(signal.declared, 2),
        "verdict": signal.verdict,
        "wrong": wrong or not signal.decided,
    }


def _pair(one: Pair) -> Entry:
    return {
        "joint": one.joint,
        "skew": number(1e3 * one.skew_s, 3),
        "skew_sigma": number(1e3 * one.skew_sigma_s, 1),
        "zero": number(1e3 * one.zero_rad, 3),
        "zero_sigma": number(1e3 * one.zero_sigma_rad, 1),
        "stiffness": number(one.stiffness, 3),
        "unskewed": number(one.stiffness_unskewed, 3),
    }


def _charts(arm: Arm, cycles: Cycles, at: NDArray[np.intp]) -> list[Entry]:
    """The readings as they came, without a line across a gap."""
    stretch = int(at[1]) if len(at) > 1 else 1
    gap = np.concatenate([[False], np.diff(cycles.sync[at]) > (stretch if stretch == 1 else 2 * stretch)])

    def drawn(readings: Floats, column: int) -> Floats:
        return np.where(gap, np.nan, readings[at, column])

    charts: list[Entry] = []
    for i, joint in enumerate(arm.joints):
        colour = joint_colour(i)
        lines = [series("motor", colour, drawn(cycles.theta, i), dash=joint.flexible)]
        if joint.flexible:
            lines.insert(0, series("link", colour, drawn(cycles.q, i)))
        torque = [series("torque", colour, drawn(cycles.tau, i), step=True)]
        charts += [
            {"id": f"angle-{i}", "title": f"{joint.name}, angles as read", "unit": "rad", "series": lines},
            {"id": f"torque-{i}", "title": f"{joint.name}, torque before the gear", "unit": "N m", "series": torque},
        ]
    if arm.free:
        gyro = [series(axis, joint_colour(i), drawn(cycles.omega, i)) for i, axis in enumerate("xyz")]
        charts.append({"id": "gyro", "title": "Gyro as read", "unit": "rad/s", "series": gyro})
    return [{**chart, "time": "cycle", "domain": "time", "axis": "s", "height": 180} for chart in charts]

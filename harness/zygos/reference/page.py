"""The page of a comparison between the C library and numpy: its stages, and the differences over the run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from zygos.files.output import number
from zygos.reference.check import Check
from zygos.reference.compare import Curve, Room
from zygos.report.figures import LogScale
from zygos.report.page import Entry, numbers, render, series, thinned
from zygos.report.provenance import Provenance

_MEANS = {
    "wire and cycles": "the readings of every cycle, decoded from the frames",
    "cycle numbers and breaks": "which cycles are numbered alike and begin a stretch alike",
    "fault counters": "lost and rejected frames and cycles, counted by kind",
    "smoother": "smoothed angles and rates at every instant",
    "balance": "the columns and the work of the energy balance at every instant",
    "bandwidth test": "which instants are used",
    "joint rows": "the sums of the rows of the joints' momentum",
    "torque noise": "what the noise of the torques adds to the variance of the work",
    "noise": "what the sensors' noise adds to the sums",
    "normal equations": "the sums that the parameters are solved from",
    "sigmas": "standard deviations and intervals",
    "solution": "the parameters",
}


def write_check_report(
    path: Path,
    found: Check,
    provenance: Provenance,
    damage: Sequence[str] = (),
) -> None:
    """Write the page. damage: of the run's log. Errors: ZygosError if it cannot be written."""
    arm, rooms, undecided = found.flight.arm, found.stages, found.undecided
    times: Entry = {}
    charts = [_chart(k, room, room.over, times) for k, room in enumerate(rooms) if room.over is not None]
    charts = [chart for chart in charts if any(y is not None for y in chart["series"][0]["y"])]
    scale = LogScale.of([x for room in rooms for x in (room.difference, room.tolerance)], 1e-17, 1e-9)
    render(
        path,
        "reference/page.html",
        {"times": times, "refused": [], "charts": {chart["id"]: chart for chart in charts}},
        arm=arm,
        equal=undecided is None,
        differs=any(not room.equal for room in rooms),
        what=undecided[0] if undecided else "",
        remedy=undecided[1] if undecided else "",
        rooms=[_row(room, scale) for room in rooms],
        compared=sum(room.compared for room in rooms),
        ticks=scale.ticks,
        charts=charts,
        damage=list(damage),
        provenance=provenance,
    )


def _row(room: Room, scale: LogScale) -> Entry:
    return {
        "name": room.name,
        "means": _MEANS.get(room.name, ""),
        "compared": f"{room.compared:,}",
        "difference": number(room.difference, 2) if np.isfinite(room.difference) else "not comparable",
        "cycle": "–" if room.cycle is None else f"{room.cycle:,}",
        "tolerance": number(room.tolerance, 2),
        "equal": room.equal,
        "at": scale.at(room.difference),
        "limit": scale.at(room.tolerance) if room.tolerance > 0.0 else None,
    }


def _chart(index: int, room: Room, curve: Curve, times: Entry) -> Entry:
    """The largest difference of each stretch of cycles, so that no peak is lost; nothing where it is zero."""
    at = thinned(len(curve.sync))
    name = f"cycles-{index}"
    times[name] = numbers(curve.sync[at].astype(np.float64))
    most = np.maximum.reduceat(curve.difference, at) if len(at) else np.zeros(0)
    line = np.where((most > 0.0) & np.isfinite(most), most, np.nan)
    return {
        "id": f"room-{index}",
        "title": room.name,
        "unit": "of the column's largest entry",
        "time": name,
        "domain": "cycles",
        "axis": "cycle",
        "height": 200,
        "log": True,
        "lines": [room.tolerance] if room.tolerance > 0.0 else [],
        "series": [series("largest difference", "joint0" if room.equal else "alarm", line)],
    }

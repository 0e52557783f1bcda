# SPDX-License-Identifier: MIT
"""The sections of a comparison between the C library and numpy: its stages, and the differences over the run."""

from __future__ import annotations

import numpy as np

from zygos.files.output import number
from zygos.reference.check import Check
from zygos.reference.compare import Curve, Room
from zygos.report.answer import Answer, Bar, Mark, Row, Text, charts, section, sections, table
from zygos.report.figures import LogScale
from zygos.report.page import Entry, numbers, series, thinned

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
_READING = (
    (
        "Two programs",
        "The C library that flies and a program in numpy compute the same run, and share no code. What both agree on "
        "is right, or wrong in the theory that both follow.",
    ),
    (
        "Differences",
        "They are relative to the largest entry of the column. A tolerance is what rounding alone may do to this run.",
    ),
    (
        "Charts",
        "Move the pointer to read values in all of them, drag to zoom, double-click to see the whole run. The dashed "
        "line is the tolerance. Where a stage is equal to the last bit, there is nothing to draw.",
    ),
)


def answer_of(found: Check, *, draw: bool = False) -> Answer:
    """The answer of a comparison. draw: with charts of the differences."""
    undecided, times = found.undecided, dict[str, Entry]()
    drawn = [_chart(k, room, room.over, times) for k, room in enumerate(found.stages) if room.over is not None]
    drawn = [chart for chart in drawn if any(y is not None for y in chart["series"][0]["y"])] if draw else []
    scale = LogScale.of([x for room in found.stages for x in (room.difference, room.tolerance)], 1e-17, 1e-9)
    compared = sum(room.compared for room in found.stages)
    lead = [] if undecided is None else [Text(undecided[1], "note", "Remedy")]
    lead.append(Text(f"{compared:,} numbers were compared.", "lead"))
    lead += [Text(text, "note", "Warning") for text in found.run.damage]
    differs = any(not room.equal for room in found.stages)
    return Answer(
        about="the C library beside numpy",
        arm=found.flight.arm.name,
        verdict="equal" if undecided is None else "differs" if differs else "no solution",
        tone="good" if undecided is None else "open",
        sentence=f"C and numpy agree in all {len(found.stages)} stages" if undecided is None else undecided[0],
        lead=tuple(lead),
        reading=_READING,
        sections=sections(
            section(
                "stages",
                "Stages",
                Text(
                    "In the order in which a run passes through them. The bar is the largest difference in powers of "
                    "ten, the tick the tolerance."
                ),
                table(
                    "stage | what is compared::wrap | numbers | largest difference::main | at cycle | tolerance | "
                    "::state | difference and tolerance::bar",
                    [_row(room, scale) for room in found.stages],
                    ticks=scale.ticks,
                ),
            ),
            section(
                "differences",
                "Differences over the run",
                Text("The largest difference of each cycle, over the number of its SYNC.")
                if drawn
                else Text("Not drawn: every stage is equal to the last bit."),
                charts(drawn),
            )
            if draw
            else None,
        ),
        drawn={"times": times, "refused": [], "charts": {chart["id"]: chart for chart in drawn}},
    )


def _row(room: Room, scale: LogScale) -> Row:
    limit = Mark(scale.at(room.tolerance) if room.tolerance > 0.0 else None, note=f"tolerance {room.tolerance:.2g}")
    return Row(
        (
            room.name,
            _MEANS.get(room.name, ""),
            f"{room.compared:,}",
            number(room.difference, 2) if np.isfinite(room.difference) else "not comparable",
            "–" if room.cycle is None else f"{room.cycle:,}",
            number(room.tolerance, 2),
            "equal" if room.equal else "differs",
            Bar(scale.at(room.difference), "joint0" if room.equal else "alarm", (limit,)),
        ),
        "" if room.equal else "fails",
    )


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

# SPDX-License-Identifier: MIT
"""The answer of `zygos check-arm`: its JSON, and its sections."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.audit.findings import Audit, Pair, Signal
from zygos.can.run import Run
from zygos.files.output import counted, number
from zygos.report.answer import (
    NOTHING_DRAWN,
    Answer,
    Counts,
    Items,
    Row,
    Text,
    charts,
    section,
    sections,
    table,
)
from zygos.report.page import Entry, joint_colour, numbers, series, thinned
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]

_POINTS = 6000
"""Of all lines of a chart together, about."""
_READING = (
    (
        "Signals",
        "“Rate” is the share of the expected cycles that came. “Steps” are those of the readings' own grid, “noise” is "
        "what changes from cycle to cycle at random; beside each stands what the arm file declares.",
    ),
    (
        "Verdict",
        "A signal is ok if the run confirms its sign, its place and its scale. Where nothing confirms them, nothing is "
        "wrong yet: the run does not tell.",
    ),
    (
        "Encoders",
        "The two encoders of a flexible joint may be read at different moments, or their zeros may differ; both look "
        "like another stiffness.",
    ),
    (
        "Charts",
        "Readings as they came, long runs thinned. Move the pointer to read values in all of them, drag to zoom, "
        "double-click to see the whole run.",
    ),
)


def answer_of(run: Run, found: Audit, *, draw: bool = False, weighed: bool = False) -> Answer:
    """The answer of an audit of a run. draw: with charts of the readings. weighed: masses were used."""
    arm, cycles = run.arm, run.cycles
    at = thinned(len(cycles), _POINTS // (arm.n + 2))
    drawn = _charts(arm, cycles, at) if draw and len(cycles) else []
    time = cycles.sync.astype(np.float64) * arm.period_s
    accused = {finding.signal for finding in found.findings}
    lead = [Text(advice(found), "note", "Remedy")] if advice(found) else []
    lead += [Text(text, "note", "Warning") for text in run.damage]
    known = "Torques were weighed against masses" if weighed else "No model was needed"
    lead.append(Text(f"{counted(len(cycles), 'cycle')} of {arm.period_s * 1000:g} ms were compared. {known}.", "lead"))
    return Answer(
        about="a run beside its arm file",
        arm=arm.name,
        verdict="something is wrong"
        if found.findings
        else "not confirmed"
        if not found.ok
        else "signals confirmed, not everything decided"
        if found.notes
        else "confirmed",
        tone="good" if found.ok and not found.notes else "open",
        sentence=summary(found),
        lead=tuple(lead),
        reading=_READING,
        sections=sections(
            section(
                "findings",
                "What is wrong",
                table(
                    "signal | fault::state | evidence::wrap | remedy::wrap",
                    [Row((one.signal, one.fault, one.evidence, one.remedy), "fails") for one in found.findings],
                ),
            ),
            section("open", "What is open", Items(tuple(found.notes)) if found.notes else None),
            section("remarks", "What is no fault", Items(tuple(found.remarks)) if found.remarks else None),
            section(
                "signals",
                "Signals",
                table(
                    "signal | unit::unit | rate, % | low | high | steps | declared step | noise | declared noise | "
                    "verdict::state",
                    [_signal(one, wrong=one.name in accused) for one in found.signals],
                ),
            ),
            section(
                "encoders",
                "The two encoders of each joint",
                table(
                    "joint | motor newer by, ms | ± | zero, mrad | ± | stiffness as read, N m/rad | stiffness "
                    "without skew",
                    [_pair(one) for one in found.pairs],
                ),
            ),
            section(
                "law",
                "Torque law",
                Text("What the energy balance of the whole arm leaves over under each law."),
                table(
                    "law::name | residual, J | ::text",
                    [
                        (name, number(left, 4), "the arm file's" if name == arm.torque_law else "")
                        for name, left in found.laws.items()
                    ],
                ),
            )
            if found.laws
            else None,
            section(
                "readings",
                "Readings",
                None if len(cycles) else Text("Not drawn: no whole cycle of this arm came.", "note"),
                charts(drawn),
            )
            if draw
            else None,
            section("faults", "Faults on the bus", Counts(dict(run.faults)) if run.faults else None),
        ),
        drawn={"times": {"cycle": numbers(time[at])}, "refused": [], "charts": {one["id"]: one for one in drawn}}
        if draw
        else NOTHING_DRAWN,
        brief=(
            *(f"{one.signal}: {one.fault} ({one.evidence}); remedy: {one.remedy}" for one in found.findings),
            *(f"open: {text}" for text in found.notes),
            *(f"no fault: {text}" for text in found.remarks),
        ),
    )


def _signal(signal: Signal, *, wrong: bool) -> Row:
    return Row(
        (
            signal.name,
            signal.unit,
            number(100 * signal.share, 4),
            number(signal.low, 4),
            number(signal.high, 4),
            number(signal.step, 3),
            number(signal.quantum, 3),
            number(signal.noise, 2),
            number(signal.declared, 2),
            signal.verdict,
        ),
        "fails" if wrong or not signal.decided else "",
    )


def _pair(one: Pair) -> tuple[str, ...]:
    return (
        one.joint,
        number(1e3 * one.skew_s, 3),
        number(1e3 * one.skew_sigma_s, 1),
        number(1e3 * one.zero_rad, 3),
        number(1e3 * one.zero_sigma_rad, 1),
        number(one.stiffness, 3),
        number(one.stiffness_unskewed, 3),
    )


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


def as_json(found: Audit) -> dict[str, Any]:
    """The content of an audit's JSON."""
    return {key: value for key, value in asdict(found).items() if key not in ("still", "short")}


def summary(found: Audit) -> str:
    """What is found, in a line."""
    if found.findings:
        first = found.findings[0]
        return f"{counted(len(found.findings), 'finding')}, the first: {first.signal} {first.fault}"
    if not found.ok:
        names = ", ".join(signal.name for signal in found.signals if not signal.decided)
        return f"no fault was found, but nothing confirms {names}"
    if found.notes:
        return f"signs and places of the signals are confirmed, but not decided: {', '.join(open_questions(found))}"
    return "the run confirms every signal of the arm file"


def open_questions(found: Audit) -> list[str]:
    """What the notes are about, each once."""
    return list(dict.fromkeys(note.partition(":")[0] for note in found.notes))


def advice(found: Audit) -> str:
    """The remedy for the first finding, or what would confirm the signals that nothing confirms; else empty."""
    if found.findings:
        return found.findings[0].remedy
    if found.ok:
        return ""
    if found.still:
        return f"a run in which {', '.join(found.still)} moves"
    if found.short:
        return "a longer run without gaps"
    return 'a run that moves every joint faster and at different speeds; the lines with "open" give the reasons'

# SPDX-License-Identifier: MIT
"""The sections of an explained gap of an arm on the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.files.output import number
from zygos.gap.charts import planned_chart
from zygos.gap.ground.content import predicted_errors
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.predictions import Prediction, quantities, run_name
from zygos.gap.ground.search import false_alarms, threshold
from zygos.gap.ground.sentences import after_gear, against
from zygos.gap.sections import (
    TONES,
    beyond_content,
    check_section,
    finding_card,
    limit_rows,
    planned_section,
    value_section,
)
from zygos.gap.sentences import asked_of_candidates, title
from zygos.gap.verdicts import PartNamed, PlainEstimate
from zygos.plan.separating import Separating
from zygos.report.answer import (
    NOTHING_DRAWN,
    Answer,
    Cards,
    Row,
    Section,
    Text,
    charts,
    section,
    sections,
    table,
)
from zygos.report.figures import unit_of
from zygos.report.page import Entry, joint_colour, numbers, series, thinned

Floats = NDArray[np.float64]

_POINTS = 1500
"""Of a line of a chart."""
_BINS = 24
_UNITS = {"rate": "rad/s", "angle": "rad", "load": "N m", "time": "s"}


def answer_of(
    found: GroundExplanation, *, planned: Separating | None = None, beside: Sequence[str] = (), draw: bool = False
) -> Answer:
    """The answer of an explanation. planned: the motion that tells a set apart. beside: further remarks. draw: with
    charts."""
    tone = TONES[found.answer]
    times, drawn, runs = dict[str, Any](), dict[str, Entry](), []
    predictions = () if found.gap is None else found.gap.predictions
    for k, one in enumerate(predictions if draw else ()):
        pictures = _charts(one, k, times)
        drawn |= {chart["id"]: chart for chart in pictures}
        heading = f"{run_name(one.run)}, which was not used, at {number(one.rows.cutoff_hz, 3)} Hz"
        runs.append(section(f"run-{k + 1}", heading, charts(pictures)))
    if planned is not None and draw:
        times["planned"], drawn["planned"] = planned_chart(found.arm, planned)
    lead = [Text(found.where, "lead")]
    lead += [Text(f"{found.remedy}.", "note", "Next")] if found.remedy and tone == "open" else []
    lead += [Text(text, "note", "Note") for text in (*found.notes, *beside)]
    cards = tuple(finding_card(found.arm, one, after_gear(found.arm, one)) for one in found.findings)
    return Answer(
        about="simulation and measured runs of an arm on the ground",
        arm=found.arm.name,
        verdict=found.answer,
        tone=tone,
        sentence=found.sentence,
        lead=tuple(lead),
        facts=(Cards(cards, tone),) if cards else (),
        sections=sections(
            planned_section(planned, draw=draw),
            _left(found),
            _gap(found),
            check_section(found.adopted, found.verdict),
            _joints(found),
            _candidates(found),
            value_section(found),
            *runs,
        ),
        drawn={"times": times, "refused": [], "charts": drawn} if draw else NOTHING_DRAWN,
        brief=_brief(found),
    )


def _brief(found: GroundExplanation) -> tuple[str, ...]:
    """Errors of predictions in a line."""
    if found.gap is None:
        return ()
    each = ", ".join(f"{name} {number(100 * share, 3)}" for name, share, _ in predicted_errors(found.gap))
    return (f"energy over one second on the untouched runs, error: {each} %",)


def _left(found: GroundExplanation) -> Section | None:
    rows = [
        (
            rest.where,
            number(rest.size, 3),
            number(rest.floor, 3),
            rest.over or "none of rate, angle, load and time",
            number(100 * rest.share, 2) if rest.over else "–",
        )
        for rest in (found.verdict.left if isinstance(found.verdict, PartNamed | PlainEstimate) else ())
    ]
    columns = "where::text | rms, N m::main | noise alone, N m | varies with::text | share, %"
    return section("left", "What is left over", table(columns, rows))


def _gap(found: GroundExplanation) -> Section | None:
    if found.gap is None:
        return None
    return section(
        "gap",
        "The gap on the untouched runs",
        Text(
            "The error of the energy predicted over one second, in per cent of the work of the motors, and the error "
            "of the torque of each joint while it moves (root mean square, without a constant offset). The floor is "
            "the error on its own simulated twin of the baseline (as delivered, refit or plain estimate) that predicts "
            "best: noise, quanta and filters."
        ),
        table(
            (
                "model::text",
                "energy, %::main",
                *(f"{joint.name}, N m" for joint in found.arm.joints),
            ),
            [
                (name, number(100 * share, 3), *(number(x, 3) for x in torques))
                for name, share, torques in predicted_errors(found.gap)
            ],
        ),
    )


def _joints(found: GroundExplanation) -> Section | None:
    rows = [
        Row(
            (
                one.joint,
                *(" · ".join(number(x, 3) for x in each) for each in (one.delivered, one.refit, one.closed, one.floor)),
            ),
            colour=joint_colour(j),
        )
        for j, one in enumerate(found.joints)
    ]
    return section(
        "joints",
        "Measured runs",
        Text(
            f"Residual of the increments of {found.span_s:g} s as mean torque after the gear, in N m, run by run: with "
            "the values of the simulation, with its own equations refitted, with what was found, and of noise alone."
        ),
        table("joint | as delivered | refit | closed::main | noise", rows),
    )


def _candidates(found: GroundExplanation) -> Section | None:
    if not found.search.rounds:
        return None
    tried = found.search.rounds[0]
    asked = asked_of_candidates(threshold(len(tried)), false_alarms(len(tried)), "on all runs together")
    null = found.answer in ("nothing missing", "values differ")
    rows = [
        (
            title(found.arm, one.name),
            number(one.value, 4),
            unit_of(one.candidate.unit),
            " · ".join(number(x, 3) for x in one.each),
            number(one.z, 3),
            "–" if null else f"{100 * max(0.0, min(1.0, one.explained)):.0f}",
            number(one.limit, 2),
            against(one) or "–",
        )
        for one in tried
    ]
    columns = (
        "candidate::text | value::main | unit::unit | on each run | z | explains, % | seen from | against it::wrap"
    )
    beyond = limit_rows(
        found.arm,
        [
            (one.candidate.effect.kind, one.candidate.joint, one.limit)
            for one in found.search.beyond
            if one.candidate.effect is not None and math.isfinite(one.limit)
        ],
    )
    return section(
        "candidates",
        "Why not something else" if found.search.named else "What was tried",
        Text(
            "Each candidate alone beside the simulation's own equations, and the usual friction where that stays in "
            "the model. A candidate must be significant (z from the scatter over blocks of time and over runs), and "
            "the values of the other runs must explain a fifth more with it of what noise does not explain at its "
            f"joint. “Seen from” is the size from which on it would be significant. {asked}"
        ),
        table(columns, rows),
        *beyond_content(
            beyond,
            "These entries are searched last. The limit is the size from which on they would be significant; of a law "
            "with a shape, from the shape that is seen best to the one that is seen worst.",
        ),
    )


def _charts(one: Prediction, k: int, times: dict[str, Any]) -> list[Entry]:
    """Torques over time, and what is left over rate, angle and load, of each joint."""
    at = thinned(len(one.closed.t), _POINTS)
    times[f"run{k}"] = numbers(one.closed.t[at])
    out = []
    for j, joint in enumerate(one.run.arm.joints):
        measured = one.closed.measured[at, j]
        torque = [
            series("measured", "soft", measured),
            series("as delivered", "joint3", one.delivered.predicted[at, j], wide=False),
            series("with what was found", joint_colour(j), one.closed.predicted[at, j], wide=False),
        ]
        error = [
            series("as delivered", "joint3", _error(one.delivered.measured, one.delivered.predicted)[at, j]),
            series("with what was found", joint_colour(j), one.error[at, j]),
        ]
        for key, said, drawn in (("torque", "torque", torque), ("error", "torque left", error)):
            out.append(_chart(f"{key}-{k}-{j}", f"{joint.name}, {said}", f"run{k}", "s", drawn))
        refit = _error(one.refit.measured, one.refit.predicted)[:, j]
        for name, x in quantities(one, j):
            if name == "time":
                continue
            centre, before = _medians(x, refit)
            _, after = _medians(x, one.error[:, j])
            times[f"{name}-{k}-{j}"] = numbers(centre)
            drawn = [series("refit", "joint1", before), series("with what was found", joint_colour(j), after)]
            said = f"{joint.name}, median of the torque left over the {name}"
            out.append(_chart(f"{name}-{k}-{j}", said, f"{name}-{k}-{j}", _UNITS[name], drawn))
    return out


def _chart(name: str, said: str, time: str, axis: str, drawn: list[Entry]) -> Entry:
    return {
        "id": name,
        "title": said,
        "unit": "N m",
        "time": time,
        "domain": time,
        "axis": axis,
        "height": 150,
        "lines": [0.0],
        "series": drawn,
    }


def _error(measured: Floats, predicted: Floats) -> Floats:
    return np.asarray(measured - predicted, dtype=np.float64)


def _medians(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Medians of both in bins of x with equally many values."""
    order = np.argsort(x, kind="stable")
    parts = [part for part in np.array_split(order, _BINS) if len(part)]
    return np.array([np.median(x[part]) for part in parts]), np.array([np.median(y[part]) for part in parts])

# SPDX-License-Identifier: MIT
"""The sections of an estimate on the ground, and of the torques of a run beside those that a model predicts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.effects import column_named, is_column, spoken
from zygos.files.output import counted, number, ratio
from zygos.ground.estimate import GroundEstimate
from zygos.ground.motion import cutoff_hz
from zygos.ground.payload import Payload
from zygos.ground.score import JointScore, Score
from zygos.report.answer import (
    Answer,
    Bar,
    Fact,
    Facts,
    Row,
    Section,
    Table,
    Text,
    charts,
    section,
    sections,
    table,
)
from zygos.report.figures import LogScale, down_to, listed, unit_of
from zygos.report.page import Entry, joint_colour, numbers, series, thinned

Floats = NDArray[np.float64]

MEANS = {
    "valid": "Values and intervals can be used.",
    "partial": "Values that are given can be used within their intervals; the reason says what is missing.",
    "doubtful": "There are values, but they should not be relied on before the cause is found.",
    "refused": "There are no values.",
}
"""What a verdict means, for readers."""
_POINTS = 1500
"""Of a line of a chart."""
_OF_ESTIMATES = (
    (
        "Joint rows",
        "The change of a joint's momentum over a short increment of time equals the integral of the torques that act "
        "on it. Each increment gives one equation for each joint, and no acceleration is needed.",
    ),
    (
        "± 95 %",
        "Half of an interval from leaving out one block of time at a time. It contains what the model lacks, as far "
        "as other blocks lack it differently. Few degrees of freedom make it wide.",
    ),
    (
        "Held-out torque left",
        "The part of the torque that the parameters of all other blocks do not predict. A joint with less torque "
        "than five times its noise is not evaluated.",
    ),
)
READING = (
    (
        "Offset",
        "A constant torque that a sensor or drive reports belongs to the run and not to the arm. Errors are given "
        "without it, and with it.",
    ),
    (
        "Floor and σ",
        "The floor is what the noise of all sensors, quanta and filters make of the same model; σ is the error in "
        "floors. Near 1, only noise is left. A joint with less torque than five floors is not evaluated.",
    ),
    (
        "At rest",
        "While a joint rests, its friction may be anything up to that of a joint that moves: that error stands apart.",
    ),
    (
        "Charts",
        "Move the pointer to read values at the same time in all charts of a run, drag to zoom all of them, "
        "double-click to see the whole run. Long runs are thinned for drawing only.",
    ),
)
"""How to read predicted torques."""


def estimate_answer(
    found: GroundEstimate, *, written: str = "", draw: bool = False, beside: Sequence[Section] = ()
) -> Answer:
    """The answer of an estimate on the ground. written: what became of the model, in words. draw: with charts. beside:
    further sections that stand first."""
    missing = [name for name, good in zip(found.names, found.determined, strict=True) if not good]
    count = len(found.names)
    reason = f": {found.reason}" if found.reason else ""
    lead = [Text(MEANS[found.validity] + (f" Model: {written}." if written else ""), "lead")]
    lead += [Text(found.remedy, "note", "Remedy")] if found.remedy else []
    lead += [Text(text, "note", "Note") for text in found.notes]
    lead += [Text(f"Not determined by the motion: {', '.join(missing)}.")] if missing else []
    shares = zip(found.solution.share.tolist(), found.evaluated.tolist(), strict=True)
    held_out = ", ".join(number(100 * share, 3) if seen else "not evaluated" for share, seen in shares)
    facts = Facts(
        (
            Fact("runs", str(len(found.runs))),
            Fact(f"increments of {found.span_s:g} s", f"{found.increments:,}"),
            Fact("cut-off of the smoother", f"{number(cutoff_hz(found.arm), 3)} Hz"),
            Fact("held-out torque left, by joint", f"{held_out} %"),
        )
    )
    parts, drawn = score_sections(found.validated, "Validated on ", draw=draw)
    return Answer(
        about="an estimate on the ground",
        arm=found.arm.name,
        verdict=found.validity,
        tone="good" if found.validity == "valid" else "open",
        sentence=f"{count - len(missing)} of {count} parameters determined by "
        f"{counted(len(found.runs), 'run')}{reason}",
        lead=tuple(lead),
        facts=(facts,),
        reading=(*_OF_ESTIMATES, *READING),
        sections=sections(*beside, _parameters(found), _joints(found), _across(found), *parts),
        drawn=drawn,
        brief=listed(found.names, found.units, found.value.tolist(), found.half95.tolist()),
    )


def payload_answer(found: Payload, *, written: str = "") -> Answer:
    """The answer of an estimate of a payload. written: what became of the model, in words."""
    lead = [Text(f"{written}.", "lead")] if written else []
    lead.append(Text(f"{found.rests_on[0].upper()}{found.rests_on[1:]}.", "note"))
    if found.relative:
        lead.append(
            Text(
                "The torques are motor currents: the values are relative to the torque constants of the model.", "note"
            )
        )
    mass, half = float(found.value[0]), float(found.half95[0])
    unit = found.arm.unit(found.parameters[0].unit)
    return Answer(
        about="what the last body took on",
        arm=found.arm.name,
        verdict="payload" if found.found else "no payload",
        tone="good" if found.found else "open",
        sentence=f"{found.names[0]} changed by {down_to(mass, half)} ± {down_to(half, half)} {unit}"
        if found.found
        else "nothing differs from the model beyond its interval",
        lead=tuple(lead),
        sections=sections(
            section(
                "parameters",
                "Change of the last body",
                table(
                    "name::name | estimate::main | ± 95 % | unit::unit | stands for::wrap",
                    [
                        (one.name, number(value), number(half, 2), unit_of(found.arm.unit(one.unit)), group)
                        for one, value, half, group in zip(
                            found.parameters, found.value.tolist(), found.half95.tolist(), found.groups, strict=True
                        )
                    ],
                ),
            ),
            section(
                "joints",
                "Joints",
                table(
                    "joint | torque left before, % | held-out left with it, %",
                    [
                        (joint.name, number(100 * before, 3), number(100 * after, 3))
                        for joint, before, after in zip(
                            found.arm.joints, found.before.tolist(), found.after.tolist(), strict=True
                        )
                    ],
                ),
            ),
        ),
    )


def score_sections(
    scores: Sequence[Score], before: str = "", *, draw: bool = False
) -> tuple[list[Section | None], Entry]:
    """A section for each predicted run, and what the charts draw. before: begins the title. draw: with charts."""
    times: dict[str, Any] = {}
    drawn: dict[str, Entry] = {}
    parts = []
    names = run_names([score.run.path for score in scores])
    for k, (score, name) in enumerate(zip(scores, names, strict=True)):
        pictures = _charts(score, k, times) if draw else []
        drawn |= {chart["id"]: chart for chart in pictures}
        how = f"at {score.cutoff_hz:.1f} Hz" if score.cutoff_hz else f"over increments of {score.increment_s:g} s"
        work = number(100 * score.arm_energy_share, 3)
        parts.append(
            section(
                f"run-{k + 1}",
                f"{before}{name}, {how}",
                _score_table(score),
                Text(f"Of the work of all motors in 1 s, {work} % are left by the energy of the arm."),
                charts(pictures),
            )
        )
    return parts, {"times": times, "refused": [], "charts": drawn}


def run_names(paths: Sequence[Path | None]) -> list[str]:
    """Short names of runs: the file, behind its folder where several have that name, or a number without a file."""
    files = [path.name for path in paths if path is not None]
    return [
        f"run {number}" if path is None else path.name if files.count(path.name) == 1 else "/".join(path.parts[-2:])
        for number, path in enumerate(paths, 1)
    ]


def _parameters(found: GroundEstimate) -> Section | None:
    """The bars are half widths of the intervals, in per cent of the values."""
    arm = found.arm
    shares = [100 * ratio(half, abs(x)) for half, x in zip(found.half95.tolist(), found.value.tolist(), strict=True)]
    scale = LogScale.of(shares, 0.01, 100.0)
    grouping = dict(zip(arm.parameter_names, arm.structure.grouping, strict=True))
    several = bool(np.isfinite(found.spread).any())
    rows = []
    for k, (name, unit, share) in enumerate(zip(found.names, found.units, shares, strict=True)):
        x, half, spread = (float(values[k]) for values in (found.value, found.half95, found.spread))
        known, colour = np.isfinite(x), joint_colour(_joint(found, k))
        cells = (
            name,
            spoken(arm, name) if is_column(name) else grouping[name],
            down_to(x, half) if known else "–",
            down_to(half, half) if known else "–",
            unit_of(unit),
            number(float(found.solution.freedom[k]), 2) if known else "–",
            *((down_to(spread, spread) if np.isfinite(spread) else "–",) if several else ()),
            number(share, 2),
            Bar(scale.at(share), colour),
        )
        rows.append(Row(cells, colour=colour))
    columns = (
        "name::name | stands for::wrap | estimate::main | ± 95 % | unit::unit | degrees of freedom"
        + (" | spread over runs" if several else "")
        + " | ± 95 %, % | ± 95 %, % of the value::bar"
    )
    said = (
        "What stands for several quantities is their sum, which is all that any motion shows. The bars are the half "
        "widths of the 95 % intervals in per cent of the values, in powers of ten."
    )
    if several:
        said += " The spread over runs is the standard deviation from leaving out one run at a time."
    return section("parameters", "Parameters", Text(said), table(columns, rows, ticks=scale.ticks))


def _joint(found: GroundEstimate, k: int) -> int | None:
    """Joint (from 0) of a parameter of a drive or an effect; None for one of bodies."""
    name = found.names[k]
    if is_column(name):
        joint = column_named(name).joint
        return joint if joint >= 0 else None
    return found.arm.parameters[k].joint


def _joints(found: GroundEstimate) -> Section | None:
    solution, unit = found.solution, found.arm.torque_unit
    measured = np.sqrt(np.mean(solution.measured**2, axis=0))
    residual = np.sqrt(np.mean(solution.residual**2, axis=0))
    rows = [
        Row(
            (
                joint.name,
                *(
                    (number(100 * x, 3) if found.evaluated[j] else "not evaluated")
                    for x in (float(solution.share[j]), ratio(float(residual[j]), float(measured[j])))
                ),
                number(float(found.torque_sigma[j]), 3),
                number(float(found.excess[j]), 3),
                number(float(solution.cluster[j]), 2),
                " · ".join(number(float(one), 3) for one in solution.offset[:, j]),
            ),
            colour=joint_colour(j),
        )
        for j, joint in enumerate(found.arm.joints)
    ]
    return section(
        "joints",
        "Joints",
        Text(
            "The residual as noise is the standard deviation of one torque reading, as reported, that would leave as "
            "much. “In noise” is the residual in units of what the noise of torques and angles causes. “Sums of "
            "residuals” are the squared sums over blocks in units of those of independent residuals: far above 1, the "
            "residuals are not noise."
        ),
        table(
            (
                "joint",
                "held-out torque left, %::main",
                "left where learned, %",
                f"residual as noise, {unit}",
                "in noise",
                "sums of residuals",
                f"offset by run, {unit}",
            ),
            rows,
        ),
    )


def _across(found: GroundEstimate) -> Section | None:
    """What each run alone leaves of the others."""
    if not len(found.across):
        return None
    names = run_names([run.path for run in found.runs])
    return section(
        "runs",
        "Run against run",
        Text(
            "The part of the torque, in per cent, that the values of one run alone leave of each other run. A run that "
            "no other predicts was recorded under other conditions, or moves what the others do not."
        ),
        table(
            ("torque left, %", *(f"in {name}" for name in names)),
            [
                (f"from {name}", *(number(100 * float(cell), 3) for cell in line))
                for name, line in zip(names, found.across, strict=True)
            ],
        ),
    )


def _score_table(score: Score) -> Table | None:
    flexible = any(np.isfinite(one.spring_nm) for one in score.joints)
    rests = any(one.rest_share > 0.0 for one in score.joints)
    torque, work = (unit_of(score.run.arm.unit(unit)) for unit in ("Nm", "J"))
    columns = (
        f"joint | torque, rms, {torque} | error, rms, {torque} | floor, {torque} | in %::main | σ"
        + (f" | at rest, {torque}" if rests else "")
        + f" | offset, {torque} | error with the offset, % | work of the error in 1 s, {work} | in %"
        + (f" | spring, {torque}" if flexible else "")
    )

    def cells(one: JointScore) -> tuple[str, ...]:
        return (
            one.joint,
            number(one.measured_nm, 4),
            number(one.error_nm, 3),
            number(one.floor_nm, 3),
            number(100 * one.share, 3) if one.evaluated else "not evaluated",
            number(one.sigmas, 3),
            *((f"{number(one.rest_nm, 3)} ({100 * one.rest_share:.0f} % of the time)",) if rests else ()),
            number(one.offset_nm, 2),
            number(100 * one.raw_share, 3) if one.evaluated else "–",
            number(one.energy_error_j, 3),
            number(100 * one.energy_share, 3) if one.evaluated else "–",
            *((number(one.spring_nm, 3),) if flexible else ()),
        )

    return table(columns, [Row(cells(one), colour=joint_colour(j)) for j, one in enumerate(score.joints)])


def _charts(score: Score, k: int, times: dict[str, Any]) -> list[Entry]:
    """Measured and predicted torque of each joint of run k, and their difference."""
    at = thinned(len(score.t), _POINTS)
    times[f"run{k}"] = numbers(score.t[at])
    out = []
    for j, joint in enumerate(score.joints):
        lines = [
            series("measured", "soft", score.measured[at, j]),
            series("predicted", joint_colour(j), score.predicted[at, j], wide=False),
        ]
        left = series("measured − predicted", joint_colour(j), score.measured[at, j] - score.predicted[at, j])
        for key, title, drawn, height in (("torque", "torque", lines, 180), ("error", "error", [left], 130)):
            out.append(
                {
                    "id": f"{key}-{k}-{j}",
                    "title": f"{joint.joint}, {title}",
                    "unit": unit_of(score.run.arm.unit("Nm")),
                    "time": f"run{k}",
                    "domain": f"run{k}",
                    "axis": "s",
                    "height": height,
                    "series": drawn,
                }
            )
    return out

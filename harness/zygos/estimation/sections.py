# SPDX-License-Identifier: MIT
"""The answer of `zygos estimate`: its JSON, and its sections.

It knows what the estimator knows, and no true value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import Effect, is_column
from zygos.estimation.charts import drawn, energy, meaning, rates, residual, sheet, times, trajectories
from zygos.estimation.ledger import balance
from zygos.estimation.watch import Note, Watch
from zygos.estimation.words import about_left_out, about_noise, losses
from zygos.files.output import counted, number, ratio
from zygos.model.model import Quantity
from zygos.native.flight import ROWS, Drift, Estimate
from zygos.report.answer import (
    NOTHING_DRAWN,
    Answer,
    Bar,
    Charts,
    Content,
    Counts,
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
from zygos.report.page import Entry, joint_colour, numbers, series

if TYPE_CHECKING:
    from zygos.estimation.estimate import Estimation

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
MEANS = {
    "valid": "Values and intervals can be used.",
    "partial": "The motion determines only some of the parameters; those that have a value can be used.",
    "doubtful": "There are values, but they should not be relied on before the cause is found.",
    "refused": "There are no values.",
}
"""What a verdict means, for readers."""
_READING = (
    (
        "The idea",
        "The work of the motors becomes motion, twist in the joints, or heat. Each of the three is a sum of measured "
        "quantities times unknown parameters, so every instant gives one equation.",
    ),
    (
        "± 95 %",
        "Half of an interval that holds the true value in 95 of 100 runs with other noise. An error common to all "
        "torques is in no interval: it scales everything alike.",
    ),
    (
        "Arcs",
        "The run is cut into stretches, each with a constant of its own. An arc that contradicts the others is left "
        "out. Energy, motor and momentum equations have arcs of their own; the three numbers above are in that order.",
    ),
    (
        "Charts",
        "Move the pointer to read values at the same time in all of them, drag to zoom all of them, double-click to "
        "see the whole run. Small marks at the foot of a chart are refused instants. Long runs are thinned for "
        "drawing, not for the estimate.",
    ),
)


def answer_of(found: Estimation, *, written: str = "", damage: Sequence[str] = (), draw: bool = False) -> Answer:
    """The answer of an estimate.

    written: what became of the model, in words. damage: of the run's log. draw: with charts, for
    which the estimate must have kept its trace.
    """
    result, watch = found.result, found.watch
    arm, flight = watch.flight.arm, watch.flight
    cycles = flight.counts["cycles"]
    missing = [name for name, x in zip(result.names, result.value, strict=True) if not np.isfinite(x)]
    count = len(result.names)
    learnt = count - len(missing)
    reason = f": {result.reason}" if result.reason else ""
    sentence = (
        f"no parameter could be learned from {counted(cycles, 'cycle')}{reason}"
        if result.validity == "refused" or learnt == 0
        else f"{learnt} of {counted(count, 'parameter')} learned from {counted(cycles, 'cycle')}{reason}"
    )
    means = MEANS.get(result.validity, "")
    if found.measured and result.validity != "valid":
        means += f" Measured: {found.measured}."
    if written:
        means += f" Model: {written}."
    lead = [Text(means.strip(), "lead")]
    lead += [Text(found.remedy, "note", "Remedy")] if found.remedy else []
    lead += [Text(text, "note", "Warning") for text in (found.change, *damage) if text]
    if missing and learnt:
        lead.append(Text(f"Without a value: {', '.join(missing)}."))
    noise = about_noise(result)
    if noise:
        lead.append(Text(f"{noise.replace('noise: ', 'About the noise: ', 1)}."))
    facts = Facts(
        (
            Fact("input", "frames" if found.run is None or found.run.frames is not None else "table of cycles"),
            Fact("run", f"{cycles * arm.period_s:.0f} s"),
            Fact(f"cycles of {arm.period_s * 1000:g} ms", f"{cycles:,}"),
            Fact("lost", losses(flight)),
            Fact("instants used", f"{result.accepted:,}"),
            Fact("instants refused", f"{result.refused:,}"),
            Fact("arcs", f"{result.arcs:,}, {flight.counts['arcs_dropped']:,} dropped"),
            *(
                Fact(f"arcs left out, {rows} rows", f"{count:,}")
                for rows, count in zip(ROWS, result.left_out, strict=True)
                if count
            ),
            Fact("rank", f"{result.rank} of {count}"),
            Fact("residual, rms", f"{number(result.residual, 3)} J"),
            Fact("residual² / declared noise²", number(result.noise_ratio, 3)),
        )
    )
    total = sum(flight.faults.values())
    rejected = (
        f"{total:,} frames or cycles were rejected. A fault costs its cycle and ends the arc; it never enters an "
    )
    pictures, data = _pictures(arm, result, watch, missing) if draw else ((), NOTHING_DRAWN)
    return Answer(
        about="parameters from a run",
        arm=arm.name,
        verdict=result.validity,
        tone="good" if result.validity == "valid" else "open",
        sentence=sentence,
        lead=tuple(lead),
        facts=(facts,),
        reading=_READING,
        sections=sections(
            section(
                "parameters",
                "Parameters",
                Text(
                    "The bars are the half widths of the 95 % intervals in per cent of the values, in powers of ten: "
                    "a shorter bar is a better known parameter."
                ),
                _parameters(arm, result),
            ),
            _contradicting(arm, found.drift),
            section("left-out", "Arcs that were left out", *_left_out(arm, result, watch)),
            *pictures,
            section(
                "faults",
                "Faults on the bus",
                Text(f"{rejected}estimate." if total else "None was seen."),
                Counts(flight.faults),
            ),
        ),
        drawn=data,
        brief=listed(result.names, result.units, result.value.tolist(), result.half95.tolist()),
    )


def _parameters(arm: Arm, result: Estimate) -> Table | None:
    """The bars are half widths of the intervals, in per cent of the values."""
    shares = [
        100.0 * ratio(half, abs(x)) for half, x in zip(result.half95.tolist(), result.value.tolist(), strict=True)
    ]
    scale = LogScale.of(shares, 0.01, 100.0)
    some = any(is_column(name) for name in result.names)
    rows = []
    for name, unit, x, half, share, z in zip(
        result.names,
        result.units,
        result.value.tolist(),
        result.half95.tolist(),
        shares,
        result.significance.tolist(),
        strict=True,
    ):
        what, joint = meaning(arm, name)
        known, bounded = np.isfinite(x), np.isfinite(x) and np.isfinite(half)
        cells = (
            name,
            what,
            down_to(x, half) if known else "–",
            down_to(half, half) if np.isfinite(half) else "–",
            unit_of(unit),
            f"{down_to(x - half, half)} … {down_to(x + half, half)}" if bounded else "–",
            number(share, 2),
            *((number(z, 3) if is_column(name) else "",) if some else ()),
            Bar(scale.at(share), joint_colour(joint)),
        )
        rows.append(Row(cells, colour=joint_colour(joint)))
    columns = (
        "name::name | what it is::text | estimate::main | ± 95 % | unit::unit | 95 % interval | ± 95 %, %"
        + (" | significance" if some else "")
        + " | ± 95 %, % of the value::bar"
    )
    return table(columns, rows, ticks=scale.ticks)


def _left_out(arm: Arm, result: Estimate, watch: Watch) -> list[Content | None]:
    said = about_left_out(result, watch)
    listed = [(arc.rows, f"{arc.first * arm.period_s:.1f}", f"{arc.last * arm.period_s:.1f}") for arc in watch.left_out]
    if not (listed or said):
        return [Text("None: no arc contradicts the others.")]
    more = len(listed) - _LEFT_OUT
    return [
        Text(f"{said.capitalize()}.") if said else None,
        table("equations | from, s | to, s", listed[:_LEFT_OUT]),
        Text(f"And {more} more, which the JSON lists.", "small") if more > 0 else None,
    ]


def _contradicting(arm: Arm, drift: Drift | None) -> Section | None:
    """Parameters that contradict what was known before, furthest first."""
    if drift is None or not drift.contradicting:
        return None
    far = [
        (name, x) for name, x in zip(drift.names, drift.deviation.tolist(), strict=True) if name in drift.contradicting
    ]
    return section(
        "change",
        "What contradicts",
        Text(
            "Parameters whose value in the newest arc contradicts what was known before, in standard deviations of the "
            "difference."
        ),
        table(
            "name::name | what it is::text | deviation",
            [
                Row((name, meaning(arm, name)[0], number(x, 3)), "fails")
                for name, x in sorted(far, key=lambda one: -abs(one[1]))
            ],
        ),
    )


def _pictures(
    arm: Arm, result: Estimate, watch: Watch, missing: Sequence[str]
) -> tuple[tuple[Section | None, ...], Mapping[str, Any]]:
    """The sections of charts, and what they draw."""
    trace = watch.trace()
    at = drawn(trace, _POINTS // (arm.n + 2))
    names, refused = times(arm, trace, at)
    predicts = bool(np.all(np.isfinite(result.solution)))
    ledger = balance(arm, trace, result.solution, watch.flight.effects) if predicts else None
    noted = trace.cycles.sync[[max(note.cycles, 1) - 1 for note in watch.notes]] if len(trace.cycles) else np.zeros(0)
    names["estimate"] = numbers(noted.astype(np.float64) * arm.period_s)
    motion = trajectories(arm, trace, at) + rates(arm, trace, at) if len(trace.cycles) else []
    balanced, left = (energy(ledger, at), residual(ledger, result, at)) if ledger else ([], [])
    way = _way(arm, result, watch.notes)
    every = [*motion, *balanced, *left, *way]
    for chart in every:
        # the cycles of a log need not begin at 0
        chart["domain"], chart["axis"] = "time", "s"
    time = trace.cycles.sync.astype(np.float64) * arm.period_s - arm.smoother.lag * arm.period_s
    sums = sheet(ledger, time) if ledger else None
    about_sums = (
        " Some parameters have no value of their own here: the line between the areas is not determined then, their "
        "sum is."
        if missing
        else ""
    )
    parts = (
        section(
            "motion",
            "The motion",
            Text(
                f"As the estimator saw it: angles and rates after the {arm.smoother.points}-point smoother, torques as "
                "the drives reported them."
            )
            if motion
            else Text("Not drawn: no whole cycle of this arm came.", "note"),
            charts(motion),
        ),
        section(
            "energy",
            "The energy balance",
            Text(
                "The coloured areas are what the parameters say; the line is the work of the motors, measured as "
                "torque times motion, plus the energy that the arm had at the start of the arc. The better the "
                f"estimate, the closer the line runs along the top of the areas.{about_sums}"
            )
            if balanced
            else Text("Not drawn: there is no solution that predicts the energy.", "note"),
            charts(balanced, "one"),
            None
            if sums is None
            else Text(
                f"At {sums['time']} s, J: work and start {sums['supplied']} = kinetic {sums['kinetic']}, elastic "
                f"{sums['elastic']}, dissipated {sums['dissipated']}, left over {sums['residual']}",
                "small",
            ),
        ),
        section(
            "residual",
            "What is left over",
            Text(
                "The line less the areas. The dashed lines are zero and ± the rms over the accepted instants. Instants "
                "where two smoothers disagree by more than the declared noise allows are refused: the motion was too "
                "fast there for the sample rate."
            ),
            charts(left, "one"),
        )
        if left
        else None,
        section(
            "way",
            "While the run goes on",
            Text(
                "Each estimate on the way, as deviation from the last one in per cent, with its 95 % interval as a "
                "band."
            ),
            Charts(tuple(chart["id"] for chart in way), "many", scaling=True),
        )
        if way
        else None,
    )
    return parts, {"times": names, "refused": refused, "charts": {chart["id"]: chart for chart in every}}


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


def report_estimate(result: Estimate, watch: Watch, drift: Drift | None, heading: Mapping[str, Any]) -> dict[str, Any]:
    """The content of an estimate's JSON."""
    flight = watch.flight
    return {
        **heading,
        "arm": flight.arm.name,
        "validity": result.validity,
        "reason": result.reason or None,
        "cycles": flight.counts["cycles"],
        "accepted": result.accepted,
        "refused": result.refused,
        "arcs": result.arcs,
        "left_out": dict(zip(ROWS, result.left_out, strict=True)),
        "left_out_arcs": [
            {"rows": arc.rows, "from_s": arc.first * flight.arm.period_s, "to_s": arc.last * flight.arm.period_s}
            for arc in watch.left_out
        ],
        "blocks": result.blocks,
        "rank": result.rank,
        "condition": result.condition,
        "residual_j": result.residual,
        "cluster": result.cluster,
        "noise_ratio": result.noise_ratio,
        "gate": result.signal_to_noise,
        "drift": dict(zip(drift.names, drift.deviation.tolist(), strict=True)) if drift else None,
        "changed": drift.changed if drift else (),
        "contradicting": drift.contradicting if drift else (),
        "changed_after_s": drift.until * flight.arm.period_s if drift and drift.changed else None,
        "faults": flight.faults,
        "counts": {"fd_frames": flight.fd_frames, **flight.counts},
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "value": float(value),
                "sigma": float(sigma),
                "half95": float(half95),
                "significance": float(significance) if is_column(name) else None,
            }
            for name, unit, value, sigma, half95, significance in zip(
                result.names, result.units, result.value, result.sigma, result.half95, result.significance, strict=True
            )
        ],
        "solution": result.solution.tolist(),
        "covariance": result.covariance.tolist(),
        # the normal equations contain the correlations of the columns in this motion, which `zygos fit` uses as weights
        "normal": flight.normal_equations()[0].tolist(),
    }


def learned(effect: Effect, found: Quantity | None) -> Effect:
    """An effect with its estimated value. Negative friction or lag, which only noise can cause, is set to zero."""
    if found is None:
        return effect
    value = max(found.value, 0.0) if effect.kind.positive else found.value
    return replace(effect, value=value, sigma=found.sigma, source=found.source)

# SPDX-License-Identifier: MIT
"""The sections of an explained gap: verdict, gap, where, why not something else, and what the model becomes.

`zygos.gap.residuals` has the numbers, `zygos.gap.sentences` the sentences, `zygos.gap.charts` the charts; here numbers
are selected, scaled and written as people write them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations, groupby
from typing import TYPE_CHECKING

import numpy as np

from zygos import limits
from zygos.arm import Arm
from zygos.effects import CATALOGUE, Effect, Kind, column_named, is_column, spoken
from zygos.errors import Undecided
from zygos.files.output import ratio
from zygos.gap.adopted import Adopted
from zygos.gap.charts import Charts as Drawn
from zygos.gap.content import decided
from zygos.gap.explanation import Explanation
from zygos.gap.findings import Deflection, Finding, Gap, Value
from zygos.gap.forecast import Forecast
from zygos.gap.record import MeasuredRun, letter
from zygos.gap.residuals import Stage, failing, steps
from zygos.gap.search import Candidate, Search
from zygos.gap.sentences import against, asked_of_candidates, balance_title, evidence, motion, predicted, title
from zygos.gap.verdicts import Verdict
from zygos.plan.separating import Separating
from zygos.report.answer import (
    NOTHING_DRAWN,
    Answer,
    Bar,
    Card,
    Cards,
    Content,
    Fact,
    Facts,
    Mark,
    Row,
    Section,
    Text,
    Tone,
    charts,
    section,
    sections,
    table,
)
from zygos.report.figures import LogScale, down_to, figure, percent, unit_of, within
from zygos.report.page import Entry, joint_colour

if TYPE_CHECKING:
    from zygos.gap.ground.explanation import GroundExplanation

_LEAST = 1e-3
"""Excess per balance that the scale of the shares begins with; below it the twin's own draws differ more."""
TONES: Mapping[str, Tone] = {
    "named": "named",
    "part named": "named",
    "changed": "differ",
    "plain estimate": "differ",
    "values differ": "differ",
    "nothing missing": "good",
    "cannot tell": "open",
    "unknown": "open",
}
"""Colour of each answer."""
_READING = (
    (
        "Balances",
        "Work of the motors = energy of the arm + losses; impulse of each motor = momentum of its rotor + what spring "
        "and friction take; the angular momentum of the whole arm keeps its value. Where one does not close, something "
        "is missing in it.",
    ),
    (
        "Twin",
        "The refitted model is run once more under the measured torques and read by the same sensors. What is left "
        "over is counted in what is left over of that twin: ρ = 1 is as good as it gets.",
    ),
    (
        "Refit",
        "The simulation's own equations, values fitted. A refit hides a part of what is missing in wrong values, so it "
        "is the fair rival of whatever is named.",
    ),
    (
        "Charts",
        "Move the pointer to read values in all charts of a kind, drag to zoom them, double-click to see all.",
    ),
)


def answer_of(
    x: Explanation, *, planned: Separating | None = None, beside: Sequence[str] = (), draw: bool = False
) -> Answer:
    """The answer of an explanation. planned: the motion that tells a set apart. beside: further remarks. draw: with
    charts."""
    drawn = Drawn(x, planned) if draw else None
    null, values = x.answer == "nothing missing", x.answer == "values differ"
    candidates, model = _candidates(x), value_section(x)
    lead = [Text(f"**Part of it looks like** {x.partly}; that is a hint, not a name.")] if x.partly else []
    lead.append(Text(x.where, "lead"))
    lead += [Text(remark, "note") for remark in (*x.notes, *beside)]
    cards: list[Facts | Cards] = []
    if x.findings:
        cards.append(Cards(tuple(finding_card(x.arm, one) for one in x.findings), TONES[x.answer]))
    if values:
        cards.append(Cards(tuple(_card(one) for one in x.values if one.differs), "differ"))
    runs = " ".join(f"Run {letter(k)}: {r.path}, {_length(r)} in unbroken arcs." for k, r in enumerate(x.refit.records))
    return Answer(
        about=f"what a simulation lacks · simulation {x.simulation.name}",
        arm=x.arm.name,
        verdict=x.answer,
        tone=TONES[x.answer],
        sentence=x.sentence,
        lead=tuple(lead),
        facts=tuple(cards),
        reading=_READING,
        sections=sections(
            section("gap", "The gap", *_gap(x)),
            check_section(x.adopted, x.verdict),
            candidates if null else None,
            model if values else None,
            _experiments(x),
            planned_section(planned, draw=draw),
            _where(x, drawn),
            _phase(x, drawn),
            _waterfall(x),
            *(_held_out(drawn) if drawn is not None and x.gap is not None else ()),
            _torques(drawn),
            None if null else candidates,
            None if values else model,
            _against(x),
        ),
        drawn=NOTHING_DRAWN if drawn is None else drawn.data,
        foot=runs,
        brief=()
        if x.gap is None
        else (
            "gap on the untouched runs: "
            + ", ".join(
                f"{name} {_error(one.gap)}"
                for name, one in (
                    ("as delivered", x.gap.delivered),
                    ("refit", x.gap.refit),
                    ("closed", x.gap.closed),
                    ("floor", x.gap.floor),
                )
            )
            + " σ",
        ),
    )


def planned_section(planned: Separating | None, *, draw: bool) -> Section | None:
    """A planned motion."""
    if planned is None:
        return None
    return section(
        "next",
        "The next motion",
        Text(
            f"{planned.scenario.name}, {planned.scenario.duration_s:g} s, {planned.form}: the best of {planned.tried} "
            "motions that keep the limits. After one run of it the effects are expected to be "
            f"{figure(planned.z)} standard deviations apart."
        ),
        charts([{"id": "planned"}], "one") if draw else None,
    )


def check_section(adopted: Adopted | None, verdict: Verdict) -> Section | None:
    """What decided whether a model is written."""
    rows = [
        Row(
            (
                one.name,
                figure(one.found),
                "more than 0" if one.lowest == limits.LEAST_INERTIA.value else figure(one.lowest),
                figure(one.highest),
                unit_of(one.unit),
                one.beside or "physical",
                "yes" if one.holds else "no",
            ),
            "" if one.holds else "fails",
        )
        for one in decided(adopted, verdict)
    ]
    columns = "what was found::wrap | size::main | at least | at most | unit::unit | limit::wrap | holds::state"
    return section("checks", "What decided whether a model is written", table(columns, rows))


def _length(record: MeasuredRun) -> str:
    return f"{len(record.starts) * record.instants * record.arm.period_s:.0f} s"


# verdict


def finding_card(arm: Arm, finding: Finding, after_gear: str = "") -> Card:
    """A finding. after_gear: its value after the gear, where that differs."""
    low, high = finding.interval
    unit = unit_of(finding.unit)
    lines = [f"95 % interval {down_to(low, finding.sigma)} … {down_to(high, finding.sigma)} {unit}", evidence(finding)]
    if after_gear:
        lines.insert(1, f"{after_gear} after the gear")
    if finding.instead:
        names = "; ".join(title(arm, name) for name in finding.instead)
        lines.insert(0, f"these runs cannot tell it from {names}")
    place = finding.joint or "the base"
    return Card(f"{finding.title}, {place}", f"{down_to(finding.value, finding.sigma)} {unit}", tuple(lines))


def _card(value: Value) -> Card:
    reach, unit = limits.INTERVAL_Z.value * value.sigma, unit_of(value.unit)
    low, high = (down_to(x, value.sigma) for x in (value.found - reach, value.found + reach))
    return Card(
        f"`{value.name}`",
        f"{down_to(value.found, value.sigma)} {unit}",
        (
            f"95 % interval {low} … {high} {unit}",
            f"simulation {figure(value.delivered, 5)}"
            + (f": {percent(value.change)} %" if math.isfinite(value.change) else ""),
        ),
    )


# gap


def _gap(x: Explanation) -> list[Content | None]:
    gap = x.gap
    if gap is None:
        return [
            Text(
                "No run was kept apart, so the gap is not known: what the runs below say of themselves is no test. "
                "Give a third run with `--validate`.",
                "note",
            )
        ]
    listed: list[tuple[str, str, str, Forecast]] = [
        ("as delivered", "delivered", "the simulation as it came", gap.delivered),
        ("refit", "refit", "its own equations, values fitted to runs A and B", gap.refit),
        ("closed", "closed", _closed(x), gap.closed),
        ("floor", "floor", "the closed model's own twin: nothing can be missing there", gap.floor),
    ]
    facts = [
        Fact(
            name,
            _error(one.gap) + (" σ" if math.isfinite(one.gap) else ""),
            (f"median {_error(one.median)}", f"90th percentile {_error(one.tenth)}"),
            colour,
            colour,
        )
        for name, colour, _, one in listed
    ]
    shrinks = _shrinks(x, gap)
    facts.append(Fact("shrinks", shrinks[0], shrinks[1:]))
    if gap.wrong is not None:
        what = "the best other candidate in place of the guess"
        if x.answer in {"named", "part named"}:
            what = "the best wrong candidate in place of what was named"
        listed.append((f"{spoken(x.arm, gap.wrong_name)}, instead", "wrong", what, gap.wrong))
    scale = LogScale.of([v for *_, one in listed for v in (one.gap, one.median, one.tenth)], 0.3, 30.0)
    rows = []
    for name, colour, what, one in listed:
        marks = (
            Mark(scale.at(one.median), "tick dotted", f"median {_error(one.median)}"),
            Mark(scale.at(one.tenth), "tick", f"90th percentile {_error(one.tenth)}"),
        )
        rows.append(Row((name, Bar(scale.at(one.gap), colour, marks), _error(one.gap)), about=what))
    said = " ".join(predicted(x.answer, gap, added=x.closed is not x.refit))
    horizon = f"{limits.HORIZON_S.value:g}"
    return [
        Facts(tuple(facts)),
        Text(
            "The gap is the rms error, in standard deviations σ of the sensors' declared noise, with which a model "
            f"predicts the next {horizon} s of an untouched run, from a state fitted to the {horizon} s before; over "
            f"{len(gap.segments.tau)} segments and all sensors. {said}"
        ),
        table("model | ::bar | rms, σ::main", rows, ticks=scale.ticks, one=scale.at(1.0)),
        Text(
            "rms in σ, powers of ten; dotted tick: median of the segments, full tick: their 90th percentile; dashed "
            "line: σ itself.",
            "small",
        ),
    ]


def _shrinks(x: Explanation, gap: Gap) -> tuple[str, str]:
    """By how much the gap shrinks, and from what to what."""
    if x.closed is not x.refit:
        return f"{figure(ratio(gap.refit.gap, gap.closed.gap))} ×", "refit / closed"
    if x.answer == "values differ":
        return f"{figure(ratio(gap.delivered.gap, gap.refit.gap))} ×", "as delivered / refit: values alone"
    return "–", "nothing was added to the refit"


def _error(value: float) -> str:
    """An error of predictions; a model that is far off may run away."""
    return figure(value) if math.isfinite(value) else "diverges"


def _closed(x: Explanation) -> str:
    if x.closed is x.refit:
        return "nothing was added: the refit"
    if x.answer in {"unknown", "cannot tell"}:
        return "with the best guess, which is not adopted"
    return "with what was named, all values fitted anew"


# where


def _where(x: Explanation, drawn: Drawn | None) -> Section | None:
    layout, after, added = x.refit.layout, x.closed.excess, x.closed is not x.refit
    scale = LogScale.of(
        [*x.local.ravel().tolist(), *x.refit.excess.ravel().tolist(), *after.ravel().tolist()], 0.5, 10.0
    )
    broken = failing(x.local)
    letters = [letter(k) for k in range(len(x.refit.records))]
    rows = []
    for k, name in enumerate(layout.balances):
        used = k in x.refit.hypothesis.balances
        own, left = x.local[:, k].tolist(), after[:, k].tolist()
        marks = [Mark(scale.at(v), "mark", colour="refit") for v in own] if used else []
        marks += [Mark(scale.at(v), "ring", colour="closed") for v in left] if added else []
        cells = (
            balance_title(x.arm, name),
            *(figure(v) for v in own),
            Bar(marks=tuple(marks)),
            *(figure(v) for v in x.refit.excess[:, k].tolist()),
            *((figure(v) for v in left) if added else ()),
        )
        about = "" if used else "not drawn up for a rigid joint"
        rows.append(Row(cells, "fails" if k in broken else "", about=about))
    columns = (
        "balance",
        *(f"{one}, by itself" for one in letters),
        "ρ, powers of ten::bar",
        *(f"{one}, refit" for one in letters),
        *((f"{one}, after" for one in letters) if added else ()),
    )
    ring = ""
    if added:
        what = "with the best guess" if TONES[x.answer] == "open" else "after naming"
        ring = f"; the small ring is what is left {what}, in one fit of all"
    about = "a balance"
    if x.answer == "values differ":
        about = "the balances that fail with the simulation's own values"
    elif len(broken):
        about = "the balances that fail"
    return section(
        "where",
        "Where",
        Text(
            "ρ of each balance fitted by itself, so that what happens elsewhere does not touch it"
            f"{ring}. A balance fails above 1.1."
        ),
        table(columns, rows, ticks=scale.ticks, one=scale.at(1.0)),
        *(Text(_bent(one)) for one in x.deflections),
        None
        if drawn is None
        else Text(
            f"What is left over of {about} on run A, about the mean of each arc; of an angular momentum that the "
            "simulation assumes, all of it."
        ),
        None if drawn is None else charts(drawn.groups["time"]),
    )


def _bent(one: Deflection) -> str:
    share = f"{100.0 * one.skew_share:.0f}" if math.isfinite(one.skew_share) else "–"
    skew = f", as if one encoder latched {figure(1e3 * one.skew_s)} ms after the other" if one.skew_share > 0.5 else ""
    return (
        f"The simulation takes the {one.joint} as rigid. Link and motor part there by {figure(one.rms_rad)} rad rms, "
        f"{figure(ratio(one.rms_rad, one.noise_rad))} times their noise; {share} % of it goes with the joint's "
        f"rate{skew}."
    )


def _phase(x: Explanation, drawn: Drawn | None) -> Section | None:
    if drawn is None:
        return None
    if drawn.subject.startswith("angular"):
        said = (
            "What is left over of the angular momentum on run A, over the base's rate, where an error of the gyro "
            "shows as a line and a wrong constant as an offset; and its slope over the angle that the base has "
            "turned, where a torque on the base shows. Dots are single moments, lines their medians."
        )
    else:
        said = (
            f"The slope of what is left over on run A ({drawn.subject}): a torque or a power that acts beyond what the "
            "model has. Friction shows as a step or a line over the rate, a stiffening spring as a curve over the "
            "deflection, noise as a cloud about zero. Dots are single moments, lines their medians."
        )
        if x.answer == "named":
            said += (
                " Dashed: the closed model with what was named struck out: all that is missing, of which the refit may "
                "hide a part in wrong values."
            )
    return section("phase", "What is missing, in phase space", Text(said), charts(drawn.groups["phase"]))


def _held_out(drawn: Drawn) -> tuple[Section | None, ...]:
    return (
        section(
            "held-out",
            "Predictions of the untouched run",
            Text(
                "Error of each segment over the run's time, by sensor, in σ and powers of ten. The dashed line is the "
                "floor."
            ),
            charts(drawn.groups["signals"], "three"),
            Text(
                f"One segment in full, {drawn.overlay}, predicted − measured: nine tenths of the segments are "
                "predicted better than this one by the refit."
            ),
            charts(drawn.groups["overlay"], "three"),
        ),
    )


def _torques(drawn: Drawn | None) -> Section | None:
    if drawn is None or not drawn.groups["torque"]:
        return None
    by_joint = groupby(sorted(drawn.groups["torque"], key=_joint_of), _joint_of)
    return section(
        "torques",
        "Torques of the untouched run",
        Text(
            "Torque before the gear that was measured, and that each model needs for the same motion: inverse dynamics "
            f"along the smoothed angles, as means over {limits.SLOPE_WINDOW_S.value:g} s at a flexible joint and over "
            "an increment of its row at a rigid one. Below it, what is left over: measured less needed, over time, "
            "rate, angle and deflection. Dots are single windows, lines their medians."
        ),
        *(charts(list(own)) for _, own in by_joint),
    )


def _joint_of(chart: Entry) -> int:
    return int(chart["joint"])


# candidates


def _experiments(x: Explanation) -> Section | None:
    if x.answer != "cannot tell":
        return None
    if not x.experiments:
        said: list[Content | None] = [Text("No variant of the first run's motion would: it takes another motion.")]
    else:
        said = [
            Text(
                "z is by how many standard deviations the one would stand out beside the other; "
                f"{limits.NAMED_Z.value:g} are needed."
            ),
            table(
                "a run with | z there | z now",
                [
                    Row((motion(one), figure(one.z), figure(one.now)), "named" if one.tells else "")
                    for one in x.experiments
                ],
            ),
        ]
    return section("experiments", "What would tell them apart", *said)


def _candidates(x: Explanation) -> Section | None:
    null = x.answer == "nothing missing"
    title = "What would have been seen" if null else "Why not something else"
    said = (
        "From these sizes on, these runs would have named each entry of the catalogue, nineteen times in twenty. A "
        "smaller effect may still be there."
        if null
        else "Every entry of the catalogue beside the simulation's own equations, the one that leaves least over "
        "first. z is its size in standard deviations of the null twin; every run must reach the threshold below the "
        f"table, and agree on the size. What is named must explain {100 * limits.COMPLETE.value:.0f} % of the excess "
        "on both runs."
    )
    if x.search is None:
        none = "No candidate was tried: as long as the encoders' timing is in doubt, any name would be a guess."
        return section("candidates", title, Text(said), Text(none, "note"))
    return section("candidates", title, Text(said), *_searched(x, x.search, null=null))


def _searched(x: Explanation, search: Search, *, null: bool) -> list[Content | None]:
    named = {candidate.name for candidate in search.named}
    sets = {other: names[0] for names in search.sets for other in names[1:]}
    listed = search.rounds[0]
    if null:
        listed = tuple(sorted(listed, key=lambda c: (list(CATALOGUE).index(c.kind.key), c.joint)))
    adopted = x.answer in {"named", "part named", "cannot tell"}
    letters = [letter(k) for k in range(len(x.refit.records))]
    columns = (
        "candidate",
        *(("detection limit::main",) if null else ()),
        *(f"run {one}" for one in letters),
        "unit::unit",
        *(f"z, {one}" for one in letters),
        *(() if null else ("explains, %", "seen from")),
        "what speaks against it::state",
    )
    beyond = limit_rows(x.arm, [(one.kind, one.joint, one.value) for one in search.beyond])
    together = " % and ".join(f"{100.0 * share:.1f}" for share in search.completeness)
    return [
        table(columns, [_candidate(x.arm, c, named, sets, adopted=adopted, null=null) for c in listed]),
        Text(asked_of_candidates(search.chance.threshold, search.chance.false_alarms, "on every run"), "small"),
        *beyond_content(
            beyond,
            "These entries are only searched where something is left over. The limit is the size from which on these "
            "runs would show them, nineteen times in twenty; of a law with a shape, from the shape that is seen best "
            "to the one that is seen worst.",
        ),
        Text(
            f"Together, what the search took explains {together} % of the excess on runs {' and '.join(letters)}. "
            "“Seen from” is the size from which on these runs would name the entry, nineteen times in twenty.",
            "small",
        )
        if named
        else None,
    ]


def beyond_content(rows: Sequence[tuple[str, ...]], said: str) -> tuple[Content | None, ...]:
    """Detection limits of entries that are searched last."""
    if not rows:
        return ()
    return Text(said), table("entry | detection limit::main | unit::unit", rows)


def limit_rows(arm: Arm, found: Sequence[tuple[Kind, int, float]]) -> list[tuple[str, ...]]:
    """A row for each entry at each joint (from 0; -1 for the base), from its smallest to its largest limit over
    components and shapes."""
    rows: dict[tuple[str, int], list[float]] = {}
    kinds = {kind.key: kind for kind, _, _ in found}
    for kind, joint, value in found:
        rows.setdefault((kind.key, joint), []).append(value)
    out: list[tuple[str, ...]] = []
    for (key, joint), values in rows.items():
        low, high = figure(min(values), 2), figure(max(values), 2)
        place = "the base" if joint < 0 else arm.joints[joint].name
        limit = low if low == high else f"{low} – {high}"
        out.append((f"{kinds[key].title}, {place}", limit, unit_of(kinds[key].unit)))
    return out


def _candidate(arm: Arm, c: Candidate, named: set[str], sets: dict[str, str], *, adopted: bool, null: bool) -> Row:
    speaks, state = against(c) or "explains less", ""
    if c.name in named:
        speaks, state = ("named", "named") if adopted else ("best guess, not adopted", "guess")
    elif c.name in sets:
        speaks, state = f"these runs cannot tell it from {spoken(arm, sets[c.name])}", "guess"
    elif c.passes and not named:
        speaks = "nothing is left to explain"
    place = "the base" if c.joint < 0 else arm.joints[c.joint].name
    limit = figure(c.limit, 2)
    complete = f"{100.0 * max(0.0, c.complete):.1f}" if math.isfinite(c.complete) else "–"
    cells = (
        f"{c.kind.title}, {place}",
        *((limit,) if null else ()),
        *(figure(v) for v in c.each),
        unit_of(c.kind.unit),
        *(f"{v:,.0f}".replace("-", "−") if abs(v) >= 100 else figure(v, 2) for v in c.z),
        *(() if null else (complete, limit)),
        speaks,
    )
    return Row(cells, "named" if state == "named" else "guess" if state else "")


def _waterfall(x: Explanation) -> Section | None:
    """What each step leaves over beyond the twin."""
    listed = steps(x)
    first = listed[1].left
    scale = LogScale.of([step.left for step in listed], _LEAST, 1.0)
    matters = first > limits.EXCESS.value
    rows = []
    for k, step in enumerate(listed):
        colour = "delivered" if not k else "closed" if k > 1 and k == len(listed) - 1 else "refit"
        name, note = _STEPS[step.stage]
        cells = (
            name or f"+ {spoken(x.arm, step.column)}",
            Bar(scale.at(step.left), colour),
            figure(step.left) if step.left > _LEAST else "none",
            f"{100.0 * max(0.0, step.left) / first:.3g} %" if k and matters else "–",
        )
        rows.append(Row(cells, about=note))
    none = (
        "" if matters else " There is nothing to explain: the simulation's own equations leave no more than their twin."
    )
    return section(
        "waterfall",
        "How much each step explains",
        Text(
            "Mean of ρ² − 1 over all runs and balances, in powers of ten: what is left over beyond the twin; per cent "
            f"are of the refit.{none}"
        ),
        table("step | ::bar | left over::main | of the refit", rows, ticks=scale.ticks),
    )


_STEPS: dict[Stage, tuple[str, str]] = {
    "delivered": ("as delivered", "the simulation's own values"),
    "refit": ("refit", "its own equations, values fitted"),
    "flexibility": ("+ joint flexibility", "springs where it has none"),
    "candidate": ("", "as the search saw it, against the twin before"),
    "closed": ("closed", "all of it, fitted anew, against its own twin"),
}
"""Name and note of each stage; a candidate has a name of its own."""


# values


def value_section(x: Explanation | GroundExplanation) -> Section | None:
    """The parameters of the simulation and those found, and the effects of both models."""
    reach = [abs(v.change) + (2.0 * ratio(v.delivered_sigma, abs(v.delivered)) or 0.0) for v in x.values]
    scale = max((r for r in reach if math.isfinite(r)), default=0.0) or 1e-6
    rows = []
    inertial = len(x.values) if x.arm.grounded else len(x.arm.parameter_names) - 3 * x.arm.n
    for k, v in enumerate(x.values):
        colour = joint_colour((k - inertial) // 3 if k >= inertial else None)
        spread = ratio(v.delivered_sigma, abs(v.delivered))
        band = 2.0 * spread if math.isfinite(spread) else 0.0
        bar = Bar()
        if math.isfinite(v.change):
            at, left = 50.0 + 50.0 * v.change / scale, 50.0 - 50.0 * band / scale
            bar = Bar(None, colour, (Mark(at, "mark", colour=colour),), (left, 100.0 * band / scale))
        freed = not math.isfinite(v.delivered) and math.isfinite(v.found)
        change = ("was rigid" if freed else percent(v.change)) + (" ◂" if v.differs else "")
        cells = (
            v.name,
            _value(v.name, v.delivered, v.delivered_sigma),
            _value(v.name, v.found, v.sigma),
            unit_of(v.unit),
            change,
            bar,
        )
        rows.append(Row(cells, "outside" if v.differs or freed else "", colour))
    adopted = "" if x.model is not None else "**None of it is adopted**: with an effect unexplained, the values bend. "
    effects = _effects(x)
    last: Content | None = effects
    if effects is None:
        last = Text(
            "No new model was written."
            if x.model is None
            else "Neither the simulation nor the new model has effects beyond rigid bodies, rotors and springs.",
            "small",
        )
    return section(
        "values",
        "Which values differ" if x.answer == "values differ" else "What becomes of the model",
        Text(
            "Base parameters of the simulation, and as the runs have them; ± is half of the 95 % interval. "
            f"{adopted}Marked are those that are more than {limits.DIFFERS_Z.value:g} standard deviations and "
            f"{100 * limits.MATERIAL_DIFFERENCE.value:g} % apart. In the bars the band is the simulation's value ± 2 "
            f"standard deviations, the dot the value found, on one scale of ± {figure(100.0 * scale, 2)} %."
        ),
        table(
            "name::name | simulation | found::main | unit::unit | change, % | simulation's band, and found::signed",
            rows,
        ),
        last,
    )


def _against(x: Explanation) -> Section | None:
    """What each run says by itself."""
    study, added = x.closed, x.closed is not x.refit
    hypothesis = study.hypothesis
    units = {value.name: value.unit for value in x.values} | {
        one.name: one.kind.unit for one in study.layout.effects if one.name in hypothesis.effects
    }
    # one value has one error: that of the answer, which contains more than noise
    whole = {value.name: value.sigma for value in x.values}
    whole |= {name: one.sigma for name in hypothesis.names if (one := _found_as(x, name)) is not None}
    found, spread, runs = [], [], []
    for k in range(len(study.records)):
        runs.append(letter(k))
        try:
            drawn = study.of_twin(hypothesis, [k]).value
            found.append(study.of(hypothesis, [k]).value - (drawn.mean(axis=0) - study.made))
            spread.append(drawn.std(axis=0, ddof=1))
        except Undecided:
            found.append(np.full(len(hypothesis.names), np.nan))
            spread.append(np.full(len(hypothesis.names), np.nan))
    if len(runs) < 2:
        return None
    each, sigma = np.array(found), np.array(spread)
    rows = []
    for i, name in enumerate(hypothesis.names):
        pairs = [
            abs(each[a, i] - each[b, i]) / max(float(np.hypot(sigma[a, i], sigma[b, i])), 1e-300)
            for a, b in combinations(range(len(runs)), 2)
        ]
        z = max((one for one in pairs if np.isfinite(one)), default=math.nan)
        cells = (
            name,
            *(_half(v, s) if np.isfinite(v) else "–" for v, s in zip(each[:, i], sigma[:, i], strict=True)),
            _half(float(study.value[i]), whole.get(name, float(study.spread[i]))),
            unit_of(units.get(name, "")),
            figure(z, 2),
        )
        rows.append(Row(cells, "fails" if z > limits.DISAGREE_Z.value else ""))
    named = " and what is named" if added else ""
    agree = (
        f" An effect is named although z is above {limits.DISAGREE_Z.value:g} where its sizes differ by less than "
        f"{100 * limits.AGREE_SHARE.value:.0f} %: no law is exact, noise shows the smallest difference in a long "
        "run, and the error for all runs contains it."
        if x.findings
        else ""
    )
    return section(
        "runs",
        "Run against run",
        Text(
            f"What each run says by itself with the same equations{named}; ± is half of the 95 % interval, of single "
            "runs by noise alone. z: difference of the two runs that are furthest apart, in standard deviations of "
            f"their noise; a run whose motion does not tell the values apart has none.{agree}"
        ),
        table(
            (
                "name::name",
                *runs,
                "all runs::main",
                "unit::unit",
                "z",
            ),
            rows,
        ),
    )


def _found_as(x: Explanation, name: str) -> Finding | None:
    """The finding that a column stands for; None where it is none."""
    if not is_column(name):
        return None
    column = column_named(name)
    place = None if column.joint < 0 else x.arm.joints[column.joint].name
    return next((one for one in x.findings if one.kind == column.key and one.joint == place), None)


def _half(value: float, sigma: float) -> str:
    """A value ± half of its 95 % interval."""
    return within(value, limits.INTERVAL_Z.value * sigma)


def _value(name: str, value: float, sigma: float) -> str:
    if math.isinf(value) and name[0] == "k":
        return "rigid"
    return _half(value, sigma)


def _effects(x: Explanation | GroundExplanation) -> Content | None:
    """Effects of both models, what is new first."""
    if x.model is None:
        return None
    old = {(e.kind.key, e.joint): e for e in x.simulation.effects}
    new = {(e.kind.key, e.joint): e for e in x.model.effects}
    rows = []
    for key in sorted({**old, **new}, key=lambda key: key in old):
        was, now = old.get(key), new.get(key)
        one = now or was
        assert one is not None
        if was is None or now is None:
            state = "added" if was is None else "left out"
        else:
            state = "kept" if now.value == was.value else "changed"
        cells = (
            one.kind.title,
            one.joint or "the base",
            _effect_value(was),
            _effect_value(now),
            unit_of(one.kind.unit),
            state,
            now.evidence if now is not None else "",
        )
        rows.append(Row(cells, "named" if state == "added" else ""))
    columns = "effect | where::text | simulation | new model | unit::unit | ::state | evidence::wrap"
    return table(columns, rows)


def _effect_value(effect: Effect | None) -> str:
    return "–" if effect is None else _half(effect.value, effect.sigma)

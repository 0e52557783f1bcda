"""The page of an explained gap: verdict, gap, where, why not something else, and what the model becomes.

`zygos.gap.residuals` has the numbers, `zygos.gap.sentences` the sentences, `zygos.gap.charts` the charts, `page.html`
the layout; here numbers are selected, scaled and written as people write them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from zygos import limits
from zygos.arm import Arm
from zygos.effects import CATALOGUE, Effect, Kind, spoken
from zygos.errors import Undecided
from zygos.files.output import ratio
from zygos.gap.adopted import Adopted
from zygos.gap.answer import decided
from zygos.gap.charts import Charts
from zygos.gap.explanation import Explanation
from zygos.gap.findings import Deflection, Finding, Gap, Value
from zygos.gap.forecast import Forecast
from zygos.gap.record import MeasuredRun, letter
from zygos.gap.residuals import Stage, failing, steps
from zygos.gap.search import Candidate
from zygos.gap.sentences import against, asked_of_candidates, balance_title, evidence, motion, predicted
from zygos.gap.verdicts import Verdict
from zygos.plan.separating import Separating
from zygos.report.figures import LogScale, down_to, figure, percent, unit_of, within
from zygos.report.page import Entry, joint_colour, render
from zygos.report.provenance import Provenance

_LEAST = 1e-3
"""Excess per balance that the scale of the shares begins with; below it the twin's own draws differ more."""


def write_gap_report(
    path: Path, explanation: Explanation, provenance: Provenance, planned: Separating | None = None
) -> None:
    """Write the page of an explanation. planned: the motion that tells a set apart. Errors: ZygosError if it cannot be
    written."""
    x, charts = explanation, Charts(explanation, planned)
    render(
        path,
        "gap/page.html",
        charts.data,
        x=x,
        tag=_TAGS[x.answer],
        provenance=provenance,
        findings=[_finding(x.arm, finding) for finding in x.findings],
        changed=[_card(value) for value in x.values if value.differs] if x.answer == "values differ" else [],
        gap=None if x.gap is None else _gap(x, x.gap),
        checks=check_rows(x.adopted, x.verdict),
        balances=_balances(x),
        bent=[_bent(d) for d in x.deflections],
        waterfall=_waterfall(x),
        search=None if x.search is None else _search(x),
        experiments=[
            {"said": motion(e), "z": figure(e.z), "now": figure(e.now), "tells": e.tells} for e in x.experiments
        ],
        planned=planned and planned_entry(planned),
        values=_values(x),
        against=_against(x),
        window=f"{limits.SLOPE_WINDOW_S.value:g}",
        effects=_effects(x),
        groups=charts.groups,
        subject=charts.subject,
        overlay=charts.overlay,
        runs=[{"letter": letter(k), "path": str(r.path), "length": _length(r)} for k, r in enumerate(x.refit.records)],
        horizon=f"{limits.HORIZON_S.value:g}",
        whole="Show all of it",
    )


def planned_entry(planned: Separating) -> Entry:
    """A planned motion as people write it."""
    return {
        "name": planned.scenario.name,
        "form": planned.form,
        "duration": f"{planned.scenario.duration_s:g}",
        "z": figure(planned.z),
        "tried": planned.tried,
    }


_TAGS = {
    "named": "named",
    "part named": "named",
    "changed": "differ",
    "plain estimate": "differ",
    "values differ": "differ",
    "nothing missing": "nothing",
    "cannot tell": "open",
    "unknown": "open",
}
"""Class of the answer's tag."""


def _length(record: MeasuredRun) -> str:
    return f"{len(record.starts) * record.instants * record.arm.period_s:.0f} s"


def check_rows(adopted: Adopted | None, verdict: Verdict) -> list[Entry]:
    """What decided whether a model is written."""
    return [
        {
            "name": one.name,
            "found": figure(one.found),
            "lowest": "more than 0" if one.lowest == limits.LEAST_INERTIA.value else figure(one.lowest),
            "highest": figure(one.highest),
            "unit": unit_of(one.unit),
            "beside": one.beside or "physical",
            "holds": one.holds,
        }
        for one in decided(adopted, verdict)
    ]


# verdict


def _finding(arm: Arm, finding: Finding) -> Entry:
    low, high = finding.interval
    return {
        "title": finding.title,
        "place": finding.joint or "the base",
        "value": down_to(finding.value, finding.sigma),
        "interval": f"{down_to(low, finding.sigma)} … {down_to(high, finding.sigma)}",
        "unit": unit_of(finding.unit),
        "evidence": evidence(finding),
        "instead": [spoken(arm, name) for name in finding.instead],
    }


def _card(value: Value) -> Entry:
    low, high = value.found - limits.INTERVAL_Z.value * value.sigma, value.found + limits.INTERVAL_Z.value * value.sigma
    return {
        "name": value.name,
        "value": down_to(value.found, value.sigma),
        "interval": f"{down_to(low, value.sigma)} … {down_to(high, value.sigma)}",
        "unit": unit_of(value.unit),
        "delivered": figure(value.delivered, 5),
        "change": percent(value.change),
    }


# gap


def _gap(x: Explanation, gap: Gap) -> Entry:
    listed: list[tuple[str, str, str, Forecast]] = [
        ("as delivered", "delivered", "the simulation as it came", gap.delivered),
        ("refit", "refit", "its own equations, values fitted to runs A and B", gap.refit),
        ("closed", "closed", _closed(x), gap.closed),
        ("floor", "floor", "the closed model's own twin: nothing can be missing there", gap.floor),
    ]
    wrong: list[tuple[str, str, str, Forecast]] = []
    if gap.wrong is not None:
        name = f"{spoken(x.arm, gap.wrong_name)}, instead"
        what = "the best other candidate in place of the guess"
        if x.answer in {"named", "part named"}:
            what = "the best wrong candidate in place of what was named"
        wrong.append((name, "wrong", what, gap.wrong))
    every = [v for *_, one in listed + wrong for v in (one.gap, one.median, one.tenth)]
    scale = LogScale.of(every, 0.3, 30.0)
    made = [
        {
            "name": name,
            "colour": colour,
            "what": what,
            "gap": _error(one.gap),
            "median": _error(one.median),
            "tenth": _error(one.tenth),
            "at": scale.at(one.gap),
            "median_at": scale.at(one.median),
            "tenth_at": scale.at(one.tenth),
        }
        for name, colour, what, one in listed + wrong
    ]
    return {
        "numbers": made[:4],
        "wrong": made[4] if wrong else None,
        "bars": made,
        "ticks": scale.ticks,
        "noise": scale.at(1.0),
        "shrinks": _shrinks(x, gap),
        "said": predicted(x.answer, gap, added=x.closed is not x.refit),
        "segments": len(gap.segments.tau),
    }


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


def _balances(x: Explanation) -> Entry:
    layout = x.refit.layout
    after = x.closed.excess
    scale = LogScale.of(
        [*x.local.ravel().tolist(), *x.refit.excess.ravel().tolist(), *after.ravel().tolist()], 0.5, 10.0
    )
    broken = failing(x.local)
    rows = []
    for k, name in enumerate(layout.balances):
        used = k in x.refit.hypothesis.balances
        rows.append(
            {
                "name": name,
                "what": balance_title(x.arm, name),
                "fails": k in broken,
                "used": used,
                "local": [figure(v) for v in x.local[:, k].tolist()],
                "refit": [figure(v) for v in x.refit.excess[:, k].tolist()],
                "closed": [figure(v) for v in after[:, k].tolist()],
                "marks": [scale.at(v) for v in x.local[:, k].tolist()],
                "left": [scale.at(v) for v in after[:, k].tolist()],
            }
        )
    return {"rows": rows, "ticks": scale.ticks, "one": scale.at(1.0), "added": x.closed is not x.refit}


def _bent(deflection: Deflection) -> Entry:
    return {
        "joint": deflection.joint,
        "rms": figure(deflection.rms_rad),
        "noise": figure(ratio(deflection.rms_rad, deflection.noise_rad)),
        "share": f"{100.0 * deflection.skew_share:.0f}" if math.isfinite(deflection.skew_share) else "–",
        "skew": figure(1e3 * deflection.skew_s) if deflection.skew_share > 0.5 else "",
    }


# candidates


def _search(x: Explanation) -> Entry:
    search = x.search
    assert search is not None
    named = {candidate.name for candidate in search.named}
    sets = {other: names[0] for names in search.sets for other in names[1:]}
    listed = search.rounds[0]
    if x.answer == "nothing missing":
        listed = tuple(sorted(listed, key=lambda c: (list(CATALOGUE).index(c.kind.key), c.joint)))
    adopted = x.answer in {"named", "part named", "cannot tell"}
    return {
        "candidates": [_candidate(x.arm, c, named, sets, adopted=adopted) for c in listed],
        "letters": [letter(k) for k in range(len(x.refit.records))],
        "rounds": len(search.rounds),
        "completeness": [f"{100.0 * share:.1f}" for share in search.completeness],
        "named": bool(named),
        "asked": asked_of_candidates(search.chance.threshold, search.chance.false_alarms, "on every run"),
        "beyond": limit_rows(x.arm, [(one.kind, one.joint, one.value) for one in search.beyond]),
    }


def limit_rows(arm: Arm, limits: Sequence[tuple[Kind, int, float]]) -> list[Entry]:
    """A row for each entry at each joint (from 0; -1 for the base), from its smallest to its largest limit over
    components and shapes."""
    rows: dict[tuple[str, int], list[float]] = {}
    kinds = {kind.key: kind for kind, _, _ in limits}
    for kind, joint, value in limits:
        rows.setdefault((kind.key, joint), []).append(value)
    out = []
    for (key, joint), values in rows.items():
        low, high = figure(min(values), 2), figure(max(values), 2)
        out.append(
            {
                "title": kinds[key].title,
                "joint": "the base" if joint < 0 else arm.joints[joint].name,
                "limit": low if low == high else f"{low} – {high}",
                "unit": unit_of(kinds[key].unit),
            }
        )
    return out


def _candidate(arm: Arm, c: Candidate, named: set[str], sets: dict[str, str], *, adopted: bool) -> Entry:
    speaks, state = against(c) or "explains less", ""
    if c.name in named:
        speaks, state = ("named", "named") if adopted else ("best guess, not adopted", "guess")
    elif c.name in sets:
        speaks, state = f"these runs cannot tell it from {spoken(arm, sets[c.name])}", "guess"
    elif c.passes and not named:
        speaks = "nothing is left to explain"
    return {
        "title": c.kind.title,
        "joint": "the base" if c.joint < 0 else arm.joints[c.joint].name,
        "unit": unit_of(c.kind.unit),
        "each": [figure(v) for v in c.each],
        "z": [f"{v:,.0f}".replace("-", "−") if abs(v) >= 100 else figure(v, 2) for v in c.z],
        "complete": f"{100.0 * max(0.0, c.complete):.1f}" if math.isfinite(c.complete) else "–",
        "limit": figure(c.limit, 2),
        "against": speaks,
        "state": state,
    }


def _waterfall(x: Explanation) -> Entry:
    """What each step leaves over beyond the twin."""
    listed = steps(x)
    first = listed[1].left
    scale = LogScale.of([step.left for step in listed], _LEAST, 1.0)
    return {
        "steps": [
            {
                "name": _STEPS[step.stage][0] or f"+ {spoken(x.arm, step.column)}",
                "note": _STEPS[step.stage][1],
                "left": figure(step.left) if step.left > _LEAST else "none",
                "share": f"{100.0 * max(0.0, step.left) / first:.3g}" if k and first > limits.EXCESS.value else "–",
                "at": scale.at(step.left),
                "colour": "delivered" if not k else "closed" if k > 1 and k == len(listed) - 1 else "refit",
            }
            for k, step in enumerate(listed)
        ],
        "ticks": scale.ticks,
        "matters": first > limits.EXCESS.value,
    }


_STEPS: dict[Stage, tuple[str, str]] = {
    "delivered": ("as delivered", "the simulation's own values"),
    "refit": ("refit", "its own equations, values fitted"),
    "flexibility": ("+ joint flexibility", "springs where it has none"),
    "candidate": ("", "as the search saw it, against the twin before"),
    "closed": ("closed", "all of it, fitted anew, against its own twin"),
}
"""Name and note of each stage; a candidate has a name of its own."""


# values


def _values(x: Explanation) -> Entry:
    reach = [abs(v.change) + (2.0 * ratio(v.delivered_sigma, abs(v.delivered)) or 0.0) for v in x.values]
    scale = max((r for r in reach if math.isfinite(r)), default=0.0) or 1e-6
    rows = []
    inertial = len(x.arm.parameter_names) - 3 * x.arm.n
    for k, v in enumerate(x.values):
        joint = (k - inertial) // 3 if k >= inertial else None
        spread = ratio(v.delivered_sigma, abs(v.delivered))
        band = 2.0 * spread if math.isfinite(spread) else 0.0
        rows.append(
            {
                "name": v.name,
                "unit": unit_of(v.unit),
                "colour": joint_colour(joint),
                "delivered": _value(v.name, v.delivered, v.delivered_sigma),
                "found": _value(v.name, v.found, v.sigma),
                "change": percent(v.change),
                "differs": v.differs,
                "freed": not math.isfinite(v.delivered) and math.isfinite(v.found),
                # per cent of the cell's width
                "bar": {
                    "at": 50.0 + 50.0 * v.change / scale,
                    "left": 50.0 - 50.0 * band / scale,
                    "width": 100.0 * band / scale,
                }
                if math.isfinite(v.change)
                else None,
            }
        )
    return {"rows": rows, "scale": figure(100.0 * scale, 2), "adopted": x.model is not None}


def _against(x: Explanation) -> Entry:
    """What each run says by itself."""
    study = x.closed
    hypothesis = study.hypothesis
    units = {value.name: value.unit for value in x.values} | {
        one.name: one.kind.unit for one in study.layout.effects if one.name in hypothesis.effects
    }
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
    each, sigma = np.array(found), np.array(spread)
    rows = []
    for i, name in enumerate(hypothesis.names):
        pairs = [
            abs(each[a, i] - each[b, i]) / max(float(np.hypot(sigma[a, i], sigma[b, i])), 1e-300)
            for a, b in combinations(range(len(runs)), 2)
        ]
        z = max((one for one in pairs if np.isfinite(one)), default=math.nan)
        rows.append(
            {
                "name": name,
                "unit": unit_of(units.get(name, "")),
                "each": [within(v, s) if np.isfinite(v) else "–" for v, s in zip(each[:, i], sigma[:, i], strict=True)],
                "all": within(float(study.value[i]), float(study.spread[i])),
                "z": figure(z, 2),
                "apart": z > limits.DISAGREE_Z.value,
            }
        )
    return {"rows": rows if len(runs) > 1 else [], "runs": runs, "added": x.closed is not x.refit}


def _value(name: str, value: float, sigma: float) -> str:
    if math.isinf(value) and name[0] == "k":
        return "rigid"
    return within(value, sigma)


def _effects(x: Explanation) -> list[Entry]:
    """Effects of both models, what is new first."""
    if x.model is None:
        return []
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
        rows.append(
            {
                "title": one.kind.title,
                "joint": one.joint or "the base",
                "unit": unit_of(one.kind.unit),
                "delivered": _effect_value(was),
                "found": _effect_value(now),
                "state": state,
                "evidence": now.evidence if now is not None else "",
            }
        )
    return rows


def _effect_value(effect: Effect | None) -> str:
    return "–" if effect is None else within(effect.value, effect.sigma)

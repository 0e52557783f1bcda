"""The page of an explained gap: verdict, gap, where, why not something else, and what the model becomes.

Python selects and scales the numbers; `gap.html` says them, and the script in `charts.html` draws them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.dynamics.planar import PlanarDynamics
from zygos.effects import CATALOGUE, Effect, spoken
from zygos.files.output import ratio
from zygos.gap.explain import INTERVAL, Explanation, Finding, Gap, Value
from zygos.gap.forecast import HORIZON_S, Forecast
from zygos.gap.provenance import Provenance
from zygos.gap.record import MeasuredRun
from zygos.gap.search import EXCESS, Candidate
from zygos.gap.study import Study, coefficient, residuals
from zygos.report.page import UNITS, Entry, joint_colour, numbers, render, series

Floats = NDArray[np.float64]

RUNS = "ABCDEFGH"
_POINTS = 1500
"""Of a line of a chart, and of all dots of a chart together."""
_BALANCES = 3
"""Failing balances that are drawn over time."""
_SUBJECTS = 2
"""And in phase space."""
_WINDOW_S = 0.1
"""Over which the slope of a residual is taken."""
_LONG_WINDOW_S = 1.0
"""The same for the momentum, which the noise of the gyro shakes."""
_BINS = 48
_FEWEST = 4
"""Slopes in a bin that has a median."""
_FAILS = math.sqrt(1.0 + EXCESS)
"""rho from which on a balance fails."""
_VISIBLE = 10.0
"""Refit over floor from which on a gap is plain to see."""
_LEAST = 1e-3
"""Excess per balance that the scale of the shares begins with; below it the twin's own draws differ more."""


def write_gap_report(path: Path, explanation: Explanation, provenance: Provenance) -> None:
    """Write the page of an explanation. Errors: ZygosError if it cannot be written."""
    x = explanation
    drawing = _Drawing(x)
    drawing.over_time()
    drawing.phase_space()
    if x.gap is not None:
        drawing.held_out(x.gap)
    data = {
        "times": drawing.times,
        "refused": [],
        "charts": {chart["id"]: chart for charts in drawing.groups.values() for chart in charts},
    }
    render(
        path,
        "gap/page.html",
        data,
        x=x,
        tag=_TAGS[x.answer],
        provenance=provenance,
        findings=[_finding(x.arm, finding) for finding in x.findings],
        changed=[_card(value) for value in x.values if value.differs] if x.answer == "values differ" else [],
        gap=None if x.gap is None else _gap(x, x.gap),
        balances=_balances(x),
        bent=[_bent(d) for d in x.deflections],
        waterfall=_waterfall(x),
        search=None if x.search is None else _search(x),
        experiments=[{"said": e.said, "z": figure(e.z), "now": figure(e.now), "tells": e.tells} for e in x.experiments],
        values=_values(x),
        effects=_effects(x),
        groups=drawing.groups,
        subject=drawing.subject,
        overlay=drawing.overlay,
        runs=[{"letter": RUNS[k], "path": str(r.path), "length": _length(r)} for k, r in enumerate(x.refit.records)],
        horizon=f"{HORIZON_S:g}",
        whole="Show all of it",
    )


_TAGS = {
    "named": "named",
    "values differ": "differ",
    "nothing missing": "nothing",
    "cannot tell": "open",
    "unknown": "open",
}
"""Class of the answer's tag."""


# numbers as people write them


def figure(value: float, digits: int = 3) -> str:
    """A number with so many digits that count; powers of ten where it is small, a dash where it is none."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    if int(power) < -3:
        return f"{mantissa}·10{_raised(int(power))}".replace("-", "−")
    return f"{value:,.{max(0, digits - 1 - int(power))}f}".replace("-", "−")


def _raised(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _to(value: float, sigma: float) -> str:
    """A value down to the second digit of its standard deviation."""
    if not (sigma > 0.0 and math.isfinite(value) and math.isfinite(sigma)):
        return figure(value, 6)
    return f"{value:,.{min(9, max(0, 1 - math.floor(math.log10(sigma))))}f}".replace("-", "−")


def _within(value: float, sigma: float) -> str:
    known = sigma > 0.0 and math.isfinite(value) and math.isfinite(sigma)
    return f"{_to(value, sigma)} ± {_to(sigma, sigma)}" if known else figure(value, 6)


def _unit(unit: str) -> str:
    return "" if unit == "1" else UNITS.get(unit, unit.replace("Nms", "N m s").replace("Nm", "N m").replace("^3", "³"))


def _percent(share: float) -> str:
    if not math.isfinite(share):
        return "–"
    if abs(share) < 5e-5:
        return "0.00" if share == 0.0 else "< 0.01"
    return f"{100.0 * share:+.2f}".replace("-", "−")


def _length(record: MeasuredRun) -> str:
    return f"{len(record.starts) * record.instants * record.arm.period_s:.0f} s"


@dataclass(frozen=True)
class _Log:
    """A scale of powers of ten, in per cent of a cell's width."""

    low: float
    high: float
    """Decimal logarithms of its ends."""

    @classmethod
    def of(cls, values: Iterable[float], least: float, most: float) -> _Log:
        """From the least of all values to a bit above the largest; it holds `least` and `most` in any case."""
        known = [math.log10(v) for v in values if math.isfinite(v) and v > least]
        return cls(math.log10(least), max([*known, math.log10(most)]) + 0.1)

    def at(self, value: float) -> float | None:
        """Position of a value; the scale's ends where it is beyond them, None where it is no number."""
        if math.isnan(value):
            return None
        if value <= 0.0:
            return 0.0
        share = (math.log10(value) - self.low) / (self.high - self.low) if math.isfinite(value) else 1.0
        return min(100.0, max(0.0, 100.0 * share))

    @property
    def ticks(self) -> list[Entry]:
        """Powers of ten, thinned to eight."""
        first, last = math.ceil(self.low - 1e-9), math.floor(self.high)
        powers = range(first, last + 1, max(1, math.ceil((last - first) / 8)))
        return [
            {"at": self.at(10.0**k), "label": figure(10.0**k, 1) if abs(k) <= 3 else f"10{_raised(k)}"} for k in powers
        ]


# verdict


def _finding(arm: Arm, finding: Finding) -> Entry:
    low, high = finding.interval
    return {
        "title": finding.title,
        "place": finding.place,
        "value": _to(finding.value, finding.sigma),
        "interval": f"{_to(low, finding.sigma)} … {_to(high, finding.sigma)}",
        "unit": _unit(finding.unit),
        "evidence": finding.evidence,
        "instead": [spoken(arm, name) for name in finding.instead],
    }


def _card(value: Value) -> Entry:
    low, high = value.found - INTERVAL * value.sigma, value.found + INTERVAL * value.sigma
    return {
        "name": value.name,
        "value": _to(value.found, value.sigma),
        "interval": f"{_to(low, value.sigma)} … {_to(high, value.sigma)}",
        "unit": _unit(value.unit),
        "delivered": figure(value.delivered, 5),
        "change": _percent(value.change),
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
        if x.answer == "named":
            what = "the best wrong candidate in place of what was named"
        wrong.append((name, "wrong", what, gap.wrong))
    every = [v for *_, one in listed + wrong for v in (one.gap, one.median, one.tenth)]
    scale = _Log.of(every, 0.3, 30.0)
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
        "said": _said(x, gap),
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


def _said(x: Explanation, gap: Gap) -> list[str]:
    """What the numbers mean, in sentences."""
    delivered, refit, closed, floor = (one.gap for one in (gap.delivered, gap.refit, gap.closed, gap.floor))
    out: list[str] = []
    if x.answer == "named" and closed < delivered:
        out.append(f"Against the simulation as delivered it shrinks {figure(ratio(delivered, closed))} ×.")
    if refit > 1.1 * delivered:
        out.append("The refit predicts worse than what was delivered: its values bend to fit what they cannot express.")
    if math.isfinite(ratio(refit, floor)) and x.answer not in {"nothing missing", "values differ"}:
        seen = "plain to see" if refit >= _VISIBLE * floor else "above the floor" if refit > 1.5 * floor else "faint"
        out.append(f"The refit's is {figure(ratio(refit, floor))} × the floor: {seen}.")
    if math.isfinite(ratio(closed, floor)) and (x.closed is not x.refit or x.answer != "unknown"):
        out.append(f"What is closed is left with {figure(ratio(closed, floor))} × the floor.")
    return out


# where


def _balance_name(arm: Arm, name: str) -> str:
    if name[0] == "M":
        return f"motor balance, {arm.joints[int(name[1:]) - 1].name}"
    return {"E": "energy of the whole arm", "H": "angular momentum of the whole arm"}[name]


def _failing(rho: Floats) -> list[int]:
    """Balances that fail on a run, rho (runs, balances), worst first."""
    worst = np.where(np.isfinite(rho), rho, 0.0).max(axis=0)
    return [int(k) for k in np.argsort(-worst, kind="stable") if worst[k] > _FAILS]


def _balances(x: Explanation) -> Entry:
    layout = x.refit.layout
    after = x.closed.excess
    scale = _Log.of([*x.local.ravel().tolist(), *x.refit.excess.ravel().tolist(), *after.ravel().tolist()], 0.5, 10.0)
    failing = _failing(x.local)
    rows = []
    for k, name in enumerate(layout.balances):
        used = k in x.refit.hypothesis.balances
        rows.append(
            {
                "name": name,
                "what": _balance_name(x.arm, name),
                "fails": k in failing,
                "used": used,
                "local": [figure(v) for v in x.local[:, k].tolist()],
                "refit": [figure(v) for v in x.refit.excess[:, k].tolist()],
                "closed": [figure(v) for v in after[:, k].tolist()],
                "marks": [scale.at(v) for v in x.local[:, k].tolist()],
                "left": [scale.at(v) for v in after[:, k].tolist()],
            }
        )
    return {"rows": rows, "ticks": scale.ticks, "one": scale.at(1.0), "added": x.closed is not x.refit}


def _bent(deflection: Any) -> Entry:
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
    adopted = x.answer in {"named", "cannot tell"}
    return {
        "candidates": [_candidate(x.arm, c, named, sets, adopted=adopted) for c in listed],
        "letters": RUNS[: len(x.refit.records)],
        "rounds": len(search.rounds),
        "completeness": [f"{100.0 * share:.1f}" for share in search.completeness],
        "named": bool(named),
    }


def _candidate(arm: Arm, c: Candidate, named: set[str], sets: dict[str, str], *, adopted: bool) -> Entry:
    against, state = c.verdict or "explains less", ""
    if c.name in named:
        against, state = ("named", "named") if adopted else ("best guess, not adopted", "guess")
    elif c.name in sets:
        against, state = f"these runs cannot tell it from {spoken(arm, sets[c.name])}", "guess"
    elif not c.verdict and not named:
        against = "nothing is left to explain"
    return {
        "title": c.kind.title,
        "joint": "the base" if c.joint < 0 else arm.joints[c.joint].name,
        "unit": _unit(c.kind.unit),
        "each": [figure(v) for v in c.each],
        "z": [f"{v:,.0f}".replace("-", "−") if abs(v) >= 100 else figure(v, 2) for v in c.z],
        "complete": f"{100.0 * max(0.0, c.complete):.1f}" if math.isfinite(c.complete) else "–",
        "limit": figure(c.limit, 2),
        "against": against,
        "state": state,
    }


def _waterfall(x: Explanation) -> Entry:
    """Mean over runs and balances of rho^2 - 1: as delivered, refitted, and with each effect that was named."""
    steps: list[tuple[str, float, str]] = [
        ("as delivered", _mean_excess(_delivered(x)), "the simulation's own values"),
        ("refit", _mean_excess(x.refit), "its own equations, values fitted"),
    ]
    if x.search is not None:
        if x.search.before is not x.refit:
            steps.append(("+ joint flexibility", _mean_excess(x.search.before), "springs where it has none"))
        used = int(np.isfinite(x.search.before.excess).sum())
        for candidate in x.search.named:
            left = candidate.left / used - 1.0
            note = "as the search saw it, against the twin before"
            steps.append((f"+ {spoken(x.arm, candidate.name)}", left, note))
        if x.search.named:
            steps.append(("closed", _mean_excess(x.search.after), "all of it, fitted anew, against its own twin"))
    first = steps[1][1]
    scale = _Log.of([left for _, left, _ in steps], _LEAST, 1.0)
    return {
        "steps": [
            {
                "name": name,
                "note": note,
                "left": figure(left) if left > _LEAST else "none",
                "share": f"{100.0 * max(0.0, left) / first:.3g}" if k and first > EXCESS else "–",
                "at": scale.at(left),
                "colour": "delivered" if not k else "closed" if k > 1 and k == len(steps) - 1 else "refit",
            }
            for k, (name, left, note) in enumerate(steps)
        ],
        "ticks": scale.ticks,
        "matters": first > EXCESS,
    }


def _delivered(x: Explanation) -> Study:
    """The refit's study with the simulation's own values in its fit's place."""
    study = x.refit
    dynamics = PlanarDynamics.from_model(x.arm, x.simulation)
    values = [coefficient(dynamics, study.hypothesis, name) for name in study.hypothesis.names]
    return replace(study, fit=study.of(study.hypothesis, fixed=np.array(values)))


def _mean_excess(study: Study) -> float:
    return float(np.nanmean(study.excess**2) - 1.0)


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
                "unit": _unit(v.unit),
                "colour": joint_colour(joint),
                "delivered": _value(v.name, v.delivered, v.delivered_sigma),
                "found": _value(v.name, v.found, v.sigma),
                "change": _percent(v.change),
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


def _value(name: str, value: float, sigma: float) -> str:
    if math.isinf(value) and name[0] == "k":
        return "rigid"
    return _within(value, sigma)


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
                "unit": _unit(one.kind.unit),
                "delivered": _effect_value(was),
                "found": _effect_value(now),
                "state": state,
                "evidence": now.evidence if now is not None else "",
            }
        )
    return rows


def _effect_value(effect: Effect | None) -> str:
    return "–" if effect is None else _within(effect.value, effect.sigma)


# charts


class _Drawing:
    """The charts of a page, and the abscissae they share."""

    def __init__(self, x: Explanation) -> None:
        self.x, self.arm = x, x.arm
        self.record = x.refit.records[0]
        self.times: dict[str, list[float | None]] = {}
        self.groups: dict[str, list[Entry]] = {"time": [], "phase": [], "signals": [], "overlay": []}
        self.subject = ""
        """What the charts in phase space are about."""
        self.overlay = ""
        """Where the segment lies that is drawn in full."""
        self.closed = "best guess added" if x.answer in {"unknown", "cannot tell"} else "closed"
        # where values differ it is the simulation as delivered that fails
        failing = _failing(_delivered(x).excess if x.answer == "values differ" else x.local)
        self.balances = failing[:_BALANCES] or [x.refit.hypothesis.balances[0]]
        refit, self.state = residuals(x.refit, 0)
        self.left = [("refit", "refit", refit)]
        """Label, colour and what is left over of run A's balances, (balances, A, instants)."""
        if x.closed is not x.refit:
            self.left.append((self.closed, "closed", residuals(x.closed, 0)[0]))
        elif x.answer == "values differ":
            self.left.insert(0, ("as delivered", "delivered", residuals(_delivered(x), 0)[0]))

    def _lines(self, balance: int) -> list[tuple[str, str, Floats]]:
        """(A, instants) of one balance, from whom it can be drawn up."""
        every = ((label, colour, left[balance]) for label, colour, left in self.left)
        return [line for line in every if np.isfinite(line[2]).any()]

    def over_time(self) -> None:
        """Residual of the failing balances over run A."""
        arcs, instants = self.state.base.shape
        chosen = np.arange(0, instants, max(1, math.ceil(arcs * instants / _POINTS)))
        time = self.record.time_s

        def flat(values: Floats) -> Floats:
            # a constant belongs to each arc: no line across
            return np.pad(values[:, chosen], ((0, 0), (0, 1)), constant_values=np.nan).ravel()

        self.times["run"] = numbers(np.concatenate([time[:, chosen], time[:, -1:]], axis=1).ravel())
        for k in self.balances:
            name = self.x.refit.layout.balances[k]
            self.groups["time"].append(
                {
                    "id": f"left-{k}",
                    "title": f"Left over: {_balance_name(self.arm, name)}",
                    "unit": "J" if name == "E" else "N m s",
                    "time": "run",
                    "lines": [0.0],
                    "series": [series(label, colour, flat(left)) for label, colour, left in self._lines(k)],
                }
            )

    def phase_space(self) -> None:
        """Slope of a failing balance's residual against rates and deflections."""
        layout, state = self.x.refit.layout, self.state
        subjects = self._subjects()
        self.subject = " and ".join(_balance_name(self.arm, layout.balances[k]) for k in subjects)
        bare = self._without()
        for k in subjects:
            name, lines = layout.balances[k], self._lines(k)
            if name == "H":
                self._momentum(lines)
                continue
            if name[0] == "M":
                joints, side, what, unit = [int(name[1:]) - 1], "motor", "Missing torque", "N m"
            else:
                joints, side, what, unit = self._joints(), "link", "Missing power", "W"
            if bare is not None:
                lines.append(("without what was named", "without", bare[k]))
            for i in joints:
                joint, rate = self.arm.joints[i].name, (state.thetad if side == "motor" else state.qd)[..., i]
                deflection = state.theta[..., i] - state.q[..., i]
                title = f"{what} over the {side}'s rate, {joint}"
                self._scatter(f"rate-{i}", title, unit, "rad/s", lines, rate, _WINDOW_S)
                title = f"{what} over the deflection, {joint}"
                self._scatter(f"deflection-{i}", title, unit, "rad", lines, deflection, _WINDOW_S)

    def _subjects(self) -> list[int]:
        """Balances of motors if they fail, as they are local: those of named joints, else the worst; else what fails
        most. A joint that was rigid had no motor balance to fail."""
        names = self.x.refit.layout.balances
        springs = {f"M{i + 1}" for i in self._bent()}
        bent = [k for k, name in enumerate(names) if name in springs]
        motors = [k for k in self.balances if names[k][0] == "M"]
        named = [k for k in motors if self.x.findings and int(names[k][1:]) - 1 in self._joints()]
        return (bent or named or motors[:1] or self.balances[:1])[:_SUBJECTS]

    def _joints(self) -> list[int]:
        """Those that were named, else all."""
        names = [joint.name for joint in self.arm.joints]
        found = sorted({names.index(f.joint) for f in self.x.findings if f.joint is not None})
        return found or list(range(self.arm.n))

    def _bent(self) -> list[int]:
        """Joints that are rigid in the simulation and flexible in what was found."""
        before, after = self.x.refit.hypothesis.rigid, self.x.closed.hypothesis.rigid
        return [i for i, (was, now) in enumerate(zip(before, after, strict=True)) if was and not now]

    def _without(self) -> Floats | None:
        """What the closed fit leaves over if the named effects are struck out of it; None where none is adopted."""
        x, study = self.x, self.x.closed
        if x.search is None or x.answer != "named":
            return None
        names = {candidate.name for candidate in x.search.named}
        names |= {f"{key}{i + 1}" for i in self._bent() for key in "kb"}
        value = np.where([name in names for name in study.hypothesis.names], 0.0, study.fit.value)
        return residuals(replace(study, fit=replace(study.fit, value=value)), 0)[0]

    def _momentum(self, lines: Sequence[tuple[str, str, Floats]]) -> None:
        """The momentum's residual over the base's rate, where a wrong gyro or constant shows, and its slope over the
        angle that the base has turned, where a torque on the base does."""
        time, rate = self.record.time_s.ravel(), self.state.base.ravel()
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time)
        angle = np.concatenate([[0.0], np.cumsum(steps)]).reshape(self.state.base.shape)
        title = "Missing momentum over the base's rate"
        self._scatter("base-rate", title, "N m s", "rad/s", lines, self.state.base, 0.0)
        title = "Missing torque on the base over the angle it has turned"
        self._scatter("base-angle", title, "N m", "rad", lines, angle, _LONG_WINDOW_S)

    def _scatter(
        self,
        name: str,
        title: str,
        unit: str,
        axis: str,
        lines: Sequence[tuple[str, str, Floats]],
        over: Floats,
        window_s: float,
    ) -> None:
        """Dots and medians in bins. window_s: the slope over so long is drawn; 0: the residual itself."""
        window = max(2, round(window_s / self.arm.period_s)) if window_s else 0
        shift = window // 2
        middle = over[:, shift : over.shape[1] - window + shift]
        low, high = float(middle.min()), float(middle.max())
        edges = np.linspace(low, high, _BINS + 1)
        step = max(1, window, math.ceil(middle.size * len(lines) / _POINTS))
        self.times[name] = numbers(0.5 * (edges[1:] + edges[:-1]))
        dots: list[Entry] = []
        medians: list[Entry] = []
        for label, colour, left in lines:
            y = left
            if window:
                y = (left[:, window:] - left[:, :-window]) / (window * self.arm.period_s)
            if colour != "without":
                dots.append(series(label, colour, y.ravel()[::step], x=numbers(middle.ravel()[::step]), dots=True))
            medians.append(series(label, colour, _medians(middle, y, edges), wide=True, dash=colour == "without"))
        self.groups["phase"].append(
            {
                "id": name,
                "title": title,
                "unit": unit,
                "time": name,
                "domain": name,
                "axis": axis,
                "height": 260,
                "lines": [0.0],
                "series": dots + medians,
            }
        )

    def held_out(self, gap: Gap) -> None:
        """Predictions of the untouched run: rms of every segment, and one segment in full."""
        half = gap.refit.residual.shape[1]
        time = gap.segments.time_s[:, half]
        each = _rms(gap.refit.residual, (1, 2))
        order = np.argsort(np.where(np.isfinite(each), each, np.inf), kind="stable")
        chosen = int(order[round(0.9 * (len(order) - 1))])
        start = float(time[chosen])
        self.overlay = f"{start:.1f} … {start + HORIZON_S:.1f} s"
        self.times["segments"] = numbers(time)
        self.times["ahead"] = numbers(gap.segments.time_s[chosen, half:] - start)
        models = [("refit", "refit", gap.refit)]
        if gap.closed is not gap.refit:
            models.append((self.closed, "closed", gap.closed))
        elif self.x.answer == "values differ":
            models.insert(0, ("as delivered", "delivered", gap.delivered))
        joints = [joint.name for joint in self.arm.joints]
        signals = [*(f"link angle, {j}" for j in joints), *(f"motor angle, {j}" for j in joints), "rate of the base"]
        floor = gap.floor.signals
        for k, signal in enumerate(signals):
            self.groups["signals"].append(
                {
                    "id": f"signal-{k}",
                    "title": signal,
                    "unit": "σ rms",
                    "time": "segments",
                    "domain": "segments",
                    "axis": "s",
                    "height": 170,
                    "log": True,
                    "lines": [float(floor[k])] if floor[k] > 0.0 and math.isfinite(floor[k]) else [],
                    "series": [series(label, c, _rms(one.residual[..., k], 1)) for label, c, one in models],
                }
            )
            self.groups["overlay"].append(
                {
                    "id": f"overlay-{k}",
                    "title": signal,
                    "unit": "σ",
                    "time": "ahead",
                    "domain": "ahead",
                    "axis": "s",
                    "height": 170,
                    "lines": [0.0],
                    "series": [series(label, c, one.residual[chosen, :, k]) for label, c, one in models],
                }
            )


def _rms(values: Floats, axis: int | tuple[int, ...]) -> Floats:
    # predictions with a wrong model may run away
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.sqrt(np.mean(values**2, axis=axis)), dtype=np.float64)


def _medians(over: Floats, values: Floats, edges: Floats) -> Floats:
    """(bins,) median of the values in each bin; NaN where there are few."""
    known = np.isfinite(values)
    x, y = over[known], values[known]
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    out = np.full(len(edges) - 1, np.nan)
    for k in range(len(out)):
        inside = y[index == k]
        if len(inside) >= _FEWEST:
            out[k] = np.median(inside)
    return out

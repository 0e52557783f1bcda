# SPDX-License-Identifier: MIT
"""The answer of `zygos refine`: its JSON, and its sections.

It knows what the refinement knows, and no true value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zygos.estimation.charts import meaning
from zygos.files.output import number
from zygos.native.flight import CHANNELS
from zygos.native.refiner import NORMAL_95
from zygos.refinement.search import REMEDY
from zygos.report.answer import (
    NOTHING_DRAWN,
    Answer,
    Bar,
    Charts,
    Fact,
    Facts,
    Mark,
    Row,
    Section,
    Table,
    Text,
    charts,
    section,
    sections,
    table,
)
from zygos.report.figures import LogScale, down_to, figure, listed, unit_of
from zygos.report.page import Entry, joint_colour, numbers, series

if TYPE_CHECKING:
    from zygos.refinement.refine import Refinement

Floats = NDArray[np.float64]

_POINTS = 240
"""Stretches of readings whose innovations are drawn."""
_SMALL_CHARTS = 40
"""Parameters whose way is drawn."""
_READING = (
    (
        "The idea",
        "The equations of motion predict each reading from those before it. What a reading says otherwise is its "
        "innovation, and the parameters are those with which all innovations are as small as noise makes them. If the "
        "model is complete, no unbiased estimator can be much better.",
    ),
    (
        "The rules",
        "A model that lacks something gives wrong values with small intervals. Values are published only if everything "
        "that can be checked without knowing the truth speaks for the model.",
    ),
    ("Normalised squares", "The square of an innovation divided by its expected variance is 1 on average."),
    (
        "The bound",
        "The smallest standard deviation that any unbiased estimator can have from this motion, with the noise of "
        "the torques that was found.",
    ),
    ("What nothing here sees", "A common error of all torques scales all parameters alike, and no rule notices it."),
)


def answer_of(found: Refinement, *, written: str = "", damage: Sequence[str] = (), draw: bool = False) -> Answer:
    """The answer of a refinement. written: what became of the model, in words. damage: of the runs' logs. draw: with
    charts."""
    lead = [Text(f"Model: {written}.", "lead")] if written else []
    lead += [] if found.published else [Text(REMEDY, "note", "Remedy")]
    lead += [Text(f"Only {found.part} are refined, which take 1 GB of memory.", "note", "Part")] if found.part else []
    lead += [Text(text, "note", "Warning") for text in damage]
    pictures, drawn = _pictures(found) if draw else ((), NOTHING_DRAWN)
    return Answer(
        about="parameters near the information limit",
        arm=found.arm.name,
        verdict="published" if found.published else "not published",
        tone="good" if found.published else "open",
        sentence=f"{len(found.names)} parameters, refined with every reading"
        if found.published
        else f"nothing is published: {found.reason}",
        lead=tuple(lead),
        facts=(Facts(tuple(Fact(title, text) for title, text in _facts(found))),),
        reading=_READING,
        sections=sections(
            section(
                "rules",
                "What was checked",
                _checked(found),
            ),
            section(
                "rivals",
                "Models with one thing more",
                Text(
                    "By how many standard deviations the readings favour a model that has one thing more, and how "
                    "large it would be."
                ),
                table(
                    "what::wrap | value | σ",
                    [(one.title, f"{figure(one.value)} {one.unit}", number(one.sigmas, 2)) for one in found.rivals],
                ),
            ),
            _parameters(found),
            *pictures,
        ),
        drawn=drawn,
        brief=listed(found.names, found.units, found.value.tolist(), found.half95.tolist()) if found.published else (),
    )


def _pictures(found: Refinement) -> tuple[tuple[Section | None, ...], Mapping[str, Any]]:
    """The sections of charts, and what they draw."""
    period = found.arm.period_s
    edges = np.linspace(0, found.record.cycles, min(_POINTS, found.record.cycles) + 1).astype(int)
    times: Entry = {
        "innovations": numbers(0.5 * (edges[:-1] + edges[1:]) * period),
        "way": [read * period for read, _, _ in found.final.way],
    }
    innovations, way = _innovations(found, edges), _way(found) if found.published else []
    for chart in (*innovations, *way):
        chart["domain"], chart["axis"] = "readings", "s of readings"
    level = _level(found, times) if sum(one > 0.0 for one, _ in found.tried) > 1 else []
    parts = (
        section(
            "innovations",
            "Innovations",
            Text(
                "Mean normalised squares over the readings of all runs, one after the other. The dashed lines are 1, "
                "and the largest mean of a window that passes."
            ),
            charts(innovations),
        ),
        section(
            "level",
            "Noise of the torques",
            Text(
                "How badly the readings are followed with each noise of the torques that was tried: the lowest point "
                "is the noise that they have."
            ),
            charts(level, "one"),
        )
        if level
        else None,
        section(
            "way",
            "The way of the parameters",
            Text(
                "Deviation from the last value in per cent of the size, with the 95 % interval as a band, from the "
                "readings up to each time."
            ),
            Charts(tuple(chart["id"] for chart in way), "many", scaling=True),
        )
        if way
        else None,
    )
    drawn = {chart["id"]: chart for chart in (*innovations, *way, *level)}
    return parts, {"times": times, "refused": [], "charts": drawn}


def _facts(found: Refinement) -> list[tuple[str, str]]:
    """Titles and numbers of the whole."""
    record = found.record
    levels = ", ".join(f"{100.0 * level:.2g}" for level in found.level)
    declared = ", ".join(f"{100.0 * level:.2g}" for level in found.declared)
    squares = ", ".join(number(float(mean), 3) for mean, n in zip(found.squares, found.final.counts, strict=True) if n)
    return [
        ("cycles used", f"{record.cycles:,}"),
        ("pieces", f"{len(record.pieces):,}"),
        ("lost cycles in them", f"{record.lost:,}"),
        ("cycles left out", f"{record.left_out:,}"),
        ("estimate from energy rows", found.energy.validity),
        ("noise of the torques found, %", levels),
        ("declared, %", declared),
        ("mean square of the innovations", squares),
        ("σ, × bound, mean", "–" if found.times_bound is None else f"{float(np.mean(found.times_bound)):.3g}"),
    ]


def _innovations(found: Refinement, edges: NDArray[np.int64]) -> list[Entry]:
    """Of each channel the normalised innovations: short stretches, and the windows that are checked."""
    squares, counts = found.final.squares, found.final.counts
    widest = max(part.stop - part.start for part, _ in found.windows)
    charts = []
    for k, channel in enumerate(CHANNELS):
        if counts[k] == 0.0:
            continue
        sums = np.add.reduceat(squares[:, k], edges[:-1]) / (np.diff(edges) * counts[k])
        seen = np.array([means[k] for _, means in found.windows])
        ends = np.array([part.stop for part, _ in found.windows])
        windows = seen[np.minimum(np.searchsorted(ends, edges[:-1], side="right"), len(seen) - 1)]
        charts.append(
            {
                "id": f"channel-{k}",
                "title": channel,
                "note": "mean normalised square of the innovations",
                "unit": "1 is expected",
                "time": "innovations",
                "height": 190,
                "lines": [1.0, float(found.band(widest)[k])],
                "series": [
                    series("short stretches", joint_colour(k), sums),
                    series("windows", "ink", windows, wide=True),
                ],
            }
        )
    return charts


def _way(found: Refinement) -> list[Entry]:
    """Each parameter while readings are used, as deviation from its last value in per cent of its size."""
    value = np.array([one for _, one, _ in found.final.way])
    spread = NORMAL_95 * np.array([one for _, _, one in found.final.way])
    deviation, band = 100.0 * (value - found.value) / found.size, 100.0 * spread / found.size
    later = len(value) // 3
    reach = (np.abs(deviation) + band)[later:].max(axis=0)
    drawn = np.sort(np.argsort(found.sigma / found.size, kind="stable")[:_SMALL_CHARTS]).tolist()
    shared = float(reach[drawn].max())
    charts = []
    for k in drawn:
        what, joint = meaning(found.arm, found.names[k])
        charts.append(
            {
                "id": f"parameter-{k}",
                "title": found.names[k],
                "note": what,
                "unit": "%",
                "time": "way",
                "height": 130,
                "small": True,
                "lines": [0.0],
                "reach": {"shared": 1.05 * shared or 1.0, "own": 1.1 * float(reach[k]) or 1.0},
                "series": [series(what, joint_colour(joint), deviation[:, k], band=numbers(band[:, k]))],
            }
        )
    return charts


def _level(found: Refinement, times: Entry) -> list[Entry]:
    """The deviance of each level that was tried, above the least."""
    tried = sorted((level, deviance) for level, deviance in found.tried if level > 0.0)
    least = min(deviance for _, deviance in found.tried)
    times["level"] = numbers(np.log10([100.0 * level for level, _ in tried]))
    over = np.array([deviance - least + 1.0 for _, deviance in tried])
    return [
        {
            "id": "level",
            "title": "noise of the torques",
            "unit": "deviance above the least, and 1",
            "time": "level",
            "domain": "level",
            "axis": "log₁₀ of noise in %",
            "height": 190,
            "log": True,
            "lines": [],
            "series": [series("deviance", "ink", over)],
        }
    ]


def _checked(found: Refinement) -> Table | None:
    """The rules; what a rule that fails means has a column of its own."""
    failed = any(rule.sentence for rule in found.rules)
    rows = []
    for rule in found.rules:
        cells = (rule.title, number(rule.value, 3), number(rule.limit, 3), "holds" if rule.holds else "fails")
        rows.append(Row((*cells, rule.sentence) if failed else cells, "" if rule.holds else "fails"))
    return table("rule::wrap | found | passes up to | ::state" + (" | meaning::wrap" if failed else ""), rows)


def _parameters(found: Refinement) -> Section | None:
    """Bars of the standard deviations in per cent of the sizes; None where no value is published."""
    if not found.published:
        return None
    p = len(found.names)
    bound = np.full(p, np.nan) if found.limit is None else 100.0 * found.limit.sigma / found.size
    energy = 100.0 * found.energy.sigma[:p] / found.size
    own = 100.0 * found.sigma / found.size
    known = [x for x in (*bound.tolist(), *energy.tolist(), *own.tolist()) if np.isfinite(x) and x > 0.0]
    scale = LogScale.of(known, 0.5 * min(known), max(known))
    rows = []
    for k, (name, unit) in enumerate(zip(found.names, found.units, strict=True)):
        what, joint = meaning(found.arm, name)
        value, sigma = float(found.value[k]), float(found.sigma[k])
        texts = [figure(float(x[k]), 2) for x in (own, bound, energy)]
        marks = (
            Mark(scale.at(float(bound[k])), note=f"bound {texts[1]} %"),
            Mark(scale.at(float(energy[k])), note=f"energy rows {texts[2]} %"),
        )
        colour = joint_colour(joint)
        rows.append(
            Row(
                (
                    name,
                    what,
                    down_to(value, sigma),
                    figure(float(found.half95[k]), 2),
                    unit_of(unit),
                    *texts,
                    Bar(scale.at(float(own[k])), colour, marks),
                ),
                colour=colour,
            )
        )
    for one in found.effects:
        half = NORMAL_95 * one.sigma
        blank = ("", "", "", Bar())
        rows.append(
            Row((f"{one.kind.key} {one.joint}", one.kind.title, down_to(one.value, one.sigma), figure(half, 2),
                 unit_of(one.kind.unit), *blank))
        )  # fmt: skip
    columns = (
        "name::name | what it is::text | estimate::main | ± 95 % | unit::unit | σ, % | bound, % | energy rows, % | "
        "σ, %::bar"
    )
    return section(
        "parameters",
        "Parameters",
        Text(
            "The bars are standard deviations in per cent of the sizes of the parameters, in powers of ten; the first "
            "tick is the bound, the second one the estimate from energy rows."
        ),
        table(columns, rows, ticks=scale.ticks),
    )


def report_refinement(found: Refinement, heading: Mapping[str, Any]) -> dict[str, Any]:
    """All of a refinement; without values where it is not published."""
    p, shown = len(found.names), found.published
    times = np.full(p, np.nan) if found.times_bound is None else found.times_bound
    bound = np.full(p, np.nan) if found.limit is None else found.limit.sigma
    columns = (found.value, found.sigma, found.half95) if shown else (np.full(p, np.nan),) * 3
    return {
        **heading,
        "arm": found.arm.name,
        "published": shown,
        "reason": found.reason or None,
        "cycles": found.record.cycles,
        "lost": found.record.lost,
        "left_out": found.record.left_out,
        "pieces": [
            {"run": piece.run, "first": piece.first, "cycles": int(piece.read.sum())} for piece in found.record.pieces
        ],
        "energy": {"validity": found.energy.validity, "reason": found.energy.reason or None},
        "levels": [
            {"joint": joint.name, "found": level, "declared": declared}
            for joint, level, declared in zip(found.arm.joints, found.level, found.declared, strict=True)
        ],
        "level_error": found.level_error,
        "tried": [{"level": level, "deviance": deviance} for level, deviance in found.tried],
        "innovations": [
            {
                "channel": channel,
                "mean": float(found.squares[k]),
                "limit": float(found.band(found.record.cycles)[k]),
                "windows": [
                    {
                        "first": part.start,
                        "last": part.stop - 1,
                        "mean": float(means[k]),
                        "limit": float(found.band(part.stop - part.start)[k]),
                    }
                    for part, means in found.windows
                ],
            }
            for k, channel in enumerate(CHANNELS)
            if found.final.counts[k] > 0.0
        ],
        "rules": [rule.as_dict() for rule in found.rules],
        "rivals": [
            {"title": one.title, "value": one.value, "unit": one.unit, "sigmas": one.sigmas} for one in found.rivals
        ],
        "times_bound": None if found.times_bound is None else float(np.mean(times)),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "value": float(value),
                "sigma": float(sigma),
                "half95": float(half),
                "size": float(size),
                "bound": float(best),
                "times_bound": float(ratio),
            }
            for name, unit, value, sigma, half, size, best, ratio in zip(
                found.names, found.units, *columns, found.size, bound, times, strict=True
            )
        ],
        "effects": [
            {
                "kind": one.kind.key,
                "joint": one.joint,
                "unit": one.kind.unit,
                "value": one.value if shown else float("nan"),
                "sigma": one.sigma if shown else float("nan"),
            }
            for one in found.effects
        ],
        "covariance": found.covariance.tolist() if shown else None,
    }

"""The page of a refinement: what was checked, the innovations, the way of the parameters, and the bound.

It knows what the refinement knows, and no true value.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.estimation.charts import meaning
from zygos.files.output import number
from zygos.native.flight import CHANNELS
from zygos.native.refiner import NORMAL_95
from zygos.refinement.refine import Refinement
from zygos.report.figures import LogScale, down_to, figure, unit_of
from zygos.report.page import Entry, joint_colour, numbers, render, series
from zygos.report.provenance import Provenance

Floats = NDArray[np.float64]

_POINTS = 240
"""Stretches of readings whose innovations are drawn."""
_SMALL_CHARTS = 40
"""Parameters whose way is drawn."""


def write_refine_report(
    path: Path, found: Refinement, provenance: Provenance, *, written: str = "", damage: Sequence[str] = ()
) -> None:
    """Write the page of a refinement.

    written: what became of the model, in words. damage: of the runs' logs. Errors: ZygosError if it cannot be written.
    """
    period = found.arm.period_s
    edges = np.linspace(0, found.record.cycles, min(_POINTS, found.record.cycles) + 1).astype(int)
    times: Entry = {
        "innovations": numbers(0.5 * (edges[:-1] + edges[1:]) * period),
        "way": [read * period for read, _, _ in found.final.way],
    }
    groups = {"innovations": _innovations(found, edges), "way": _way(found) if found.published else []}
    charts = [chart for listed in groups.values() for chart in listed]
    for chart in charts:
        chart["domain"], chart["axis"] = "readings", "s of readings"
    if sum(level > 0.0 for level, _ in found.tried) > 1:
        groups["level"] = _level(found, times)
        charts += groups["level"]
    render(
        path,
        "refinement/page.html",
        {"times": times, "refused": [], "charts": {chart["id"]: chart for chart in charts}},
        arm=found.arm,
        published=found.published,
        reason=found.reason,
        written=written,
        rules=[
            {
                "title": rule.title,
                "value": number(rule.value, 3),
                "limit": number(rule.limit, 3),
                "holds": rule.holds,
                "sentence": rule.sentence,
            }
            for rule in found.rules
        ],
        rivals=[
            {"title": one.title, "value": f"{figure(one.value)} {one.unit}", "sigmas": number(one.sigmas, 2)}
            for one in found.rivals
        ],
        facts=_facts(found),
        table=_parameters(found),
        groups=groups,
        damage=list(damage),
        provenance=provenance,
    )


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


def _parameters(found: Refinement) -> Entry | None:
    """Rows of the table, with bars of the standard deviations in per cent of the sizes; nothing where none is
    published."""
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
        rows.append(
            {
                "name": name,
                "what": what,
                "unit": unit_of(unit),
                "colour": joint_colour(joint),
                "value": down_to(value, sigma),
                "half": figure(float(found.half95[k]), 2),
                "percent": figure(float(own[k]), 2),
                "bound": figure(float(bound[k]), 2),
                "energy": figure(float(energy[k]), 2),
                "at": scale.at(float(own[k])),
                "limit": scale.at(float(bound[k])),
                "before": scale.at(float(energy[k])),
            }
        )
    return {"rows": rows, "ticks": scale.ticks}

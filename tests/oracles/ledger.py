# SPDX-License-Identifier: MIT
"""The ledger of the trials: a line for every run that was ever scored, and the table of docs/trials.md made from it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

ROOT = Path(__file__).resolve().parents[2]
LEDGER = ROOT / "tests" / "oracles" / "ledger.jsonl"
PAGE = ROOT / "docs" / "trials.md"
BEGIN, END = "<!-- make gap writes this -->\n", "<!-- to here -->\n"
Line = dict[str, Any]
FEW = 20
"""Runs below which a figure is shown and not judged."""
IDENTICAL = 0.975
"""Overlap from which on runs do not tell two columns apart: one takes away 95 % of what the other does, squared."""


def _digest(paths: Iterable[Path]) -> str:
    found = hashlib.sha256()
    for path in sorted(paths):
        found.update(str(path.relative_to(ROOT)).encode())
        found.update(path.read_bytes())
    return found.hexdigest()[:12]


@cache
def product() -> str:
    """Digest of the sources of the product."""
    listed = [*(ROOT / "harness").rglob("*.py"), *(ROOT / "c").glob("*/*.c"), *(ROOT / "include").rglob("*.h")]
    return _digest(path for path in listed if "_native" not in path.parts)


@cache
def generator() -> str:
    """Digest of what makes the runs, and of what scores them."""
    folder = ROOT / "tests" / "oracles"
    return _digest(folder / f"{name}.py" for name in ("hidden", "tree", "arms", "cells", "score"))


def read(path: Path | None = None) -> list[Line]:
    """All lines."""
    path = path or LEDGER
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def append(line: Line, path: Path | None = None) -> None:
    """Add a line; nothing is ever replaced."""
    path = path or LEDGER
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line, separators=(",", ":")) + "\n")


def newest(lines: Sequence[Line]) -> list[Line]:
    """Of each cell and draw the run that was scored last, whatever version of the product it is of."""
    return list({(line["cell"], line["draw"]): line for line in lines}.values())


def first_scores(lines: Sequence[Line]) -> list[Line]:
    """Of each cell and draw the run that was scored first: runs that nobody had looked at when they were made."""
    out: dict[tuple[str, int], Line] = {}
    for line in lines:
        out.setdefault((line["cell"], line["draw"]), line)
    return list(out.values())


def upper(events: int, runs: int, level: float = 0.95) -> float:
    """Exact upper limit (Clopper and Pearson) of a rate, one-sided."""
    return 1.0 if events >= runs else float(beta.ppf(level, events + 1, runs - events))


def lower(events: int, runs: int, level: float = 0.95) -> float:
    """Exact lower limit of a rate, one-sided."""
    return 0.0 if events <= 0 else float(beta.ppf(1.0 - level, events, runs - events + 1))


@dataclass(frozen=True)
class Measure:
    """One of the figures that are asked."""

    name: str
    asked: str
    runs: int
    value: float
    limit: str
    """Exact limit of a rate; empty for others."""
    met: bool | None
    """None where there are no runs."""


def _rate(name: str, asked: float, flags: Sequence[bool], most: bool) -> Measure:
    runs, events = len(flags), sum(map(bool, flags))
    value = events / runs if runs else float("nan")
    sign = "≤" if most else "≥"
    bound = (
        "" if not runs else f"≤ {100 * upper(events, runs):.1f} %" if most else f"≥ {100 * lower(events, runs):.1f} %"
    )
    met = None if not runs else value <= asked if most else value >= asked
    return Measure(name, f"{sign} {100 * asked:g} %", runs, value, bound, met)


def measures(lines: Sequence[Line]) -> list[Measure]:
    """The figures that the trials are about; a refusal is an answer, and never a right one."""
    nulls = [line for line in lines if line["group"] == "null"]
    inside = [line for line in lines if line["group"] in {"law", "pair", "structure"}]
    large = [line for line in inside if (line["multiple"] or line["nominal"] or 30.0) >= 3.0]
    outside = [line for line in lines if line["group"] in {"outside", "without"}]
    named = [line for line in inside if line["score"]["in_set"] is not None]
    sizes = [size for line in inside for size in line["score"]["sizes"] if line["answer"] in {"named", "part named"}]
    errors = [abs(size["error"]) for size in sizes]
    held = [
        line["gap"]["closed"] / line["gap"]["floor"] for line in inside if line["answer"] == "named" and _floor(line)
    ]
    extra = [line["score"]["extra"] for line in lines if line["group"] != "outside" and line["group"] != "without"]
    median = float(np.median(errors)) if errors else float("nan")
    works = [abs(size.get("error_work", size["error"])) for size in sizes]
    own = [size["covered"] for size in sizes if size["exact"]]
    held_median = float(np.median(held)) if held else float("nan")
    extras = float(np.mean(extra)) if extra else float("nan")
    covered = [size["covered"] for size in sizes]
    share = float(np.mean(covered)) if covered else float("nan")
    bound = (
        f"{100 * lower(sum(covered), len(covered), 0.975):.0f}–{100 * upper(sum(covered), len(covered), 0.975):.0f} %"
    )
    return [
        _rate("nulls with any false name", 0.01, [line["score"]["false"] for line in nulls], True),
        _rate(
            "nulls answered *unknown* or refused",
            0.01,
            [not line["score"]["right"] and not line["score"]["false"] for line in nulls],
            True,
        ),
        _rate(
            "right effect and place first, from 3 detection limits on",
            0.95,
            [line["score"]["first"] for line in large],
            False,
        ),
        _rate(
            "truth in the reported set, where one is reported", 0.99, [line["score"]["in_set"] for line in named], False
        ),
        Measure("extra names a run", "≤ 0.05", len(extra), extras, "", extras <= 0.05 if extra else None),
        _rate("outside the catalogue: misnamed", 0.05, [line["score"]["misnamed"] for line in outside], True),
        _rate(
            "outside the catalogue: *unknown* or rightly *part named*",
            0.9,
            [line["score"]["right"] for line in outside],
            False,
        ),
        Measure("error of the size, median", "≤ 3 %", len(errors), median, "", median <= 0.03 if errors else None),
        Measure(
            "the same, sizes projected by power",
            "≤ 3 %",
            len(works),
            float(np.median(works)) if works else float("nan"),
            "",
            bool(np.median(works) <= 0.03) if works else None,
        ),
        Measure(
            "sizes inside their 95 % interval",
            "92–97 %",
            len(covered),
            share,
            bound if covered else "",
            0.92 <= share <= 0.97 if covered else None,
        ),
        Measure(
            "of these, laws that have the form of the column",
            "92–97 %",
            len(own),
            float(np.mean(own)) if own else float("nan"),
            "",
            0.92 <= float(np.mean(own)) <= 0.97 if own else None,
        ),
        Measure(
            "held-out error over its floor, median",
            "≤ 1.1",
            len(held),
            held_median,
            "",
            held_median <= 1.1 if held else None,
        ),
    ]


def verdict(measure: Measure) -> str:
    """Whether a figure is what was asked, in words."""
    if measure.met is None:
        return "not tried"
    return "too few runs" if measure.runs < FEW else "met" if measure.met else "missed"


def _floor(line: Line) -> bool:
    return bool(line["gap"] and line["gap"].get("closed") and line["gap"].get("floor"))


def shown(measure: Measure) -> str:
    """Its value for a table."""
    if not measure.runs:
        return "–"
    return f"{measure.value:.2f}" if "%" not in measure.asked else f"{100 * measure.value:.1f} %"


def by_law(lines: Sequence[Line]) -> list[tuple[str, ...]]:
    """Arm, what is hidden, and right answers at each size."""
    out: dict[tuple[str, str], list[Line]] = {}
    arms = list(dict.fromkeys(line["arm"] for line in lines))
    for line in sorted(lines, key=lambda line: arms.index(line["arm"])):
        parts = line["cell"].split("/")
        what = "/".join(parts[1:2] if line["group"] in {"law", "null"} else parts[1:])
        out.setdefault((parts[0], what), []).append(line)
    rows = []
    for (arm, what), of in out.items():
        cells = []
        for size in (3.0, 10.0, 30.0):
            at = [line for line in of if line["nominal"] == size]
            cells.append(f"{sum(_good(line) for line in at)}/{len(at)}" if at else "–")
        if of[0]["group"] not in {"law", "pair"}:
            cells = [f"{sum(_good(line) for line in of)}/{len(of)}", "–", "–"]
        rows.append((arm, what, *cells))
    return rows


def missed(lines: Sequence[Line]) -> list[tuple[str, ...]]:
    """Cell, draws, size in stated limits, answer and cause of the runs that are not right; draws of a cell with the
    same answer and cause are one row."""
    out: dict[tuple[str, str, str, str], list[int]] = {}
    for line in lines:
        if not _good(line):
            times = "" if line["multiple"] is None else f"{line['multiple']:.2g}"
            row = (line["cell"], "" if line["group"] == "null" else times, instead(line), cause(line))
            out.setdefault(row, []).append(line["draw"])
    return [(row[0], ", ".join(map(str, sorted(draws))), *row[1:]) for row, draws in sorted(out.items())]


def cause(line: Line) -> str:
    """Why an answer is not right: the runs show no difference between what was hidden and what was named, the size is
    below three of the limits that the verdict states, or ours."""
    if line["group"] not in {"law", "pair", "structure"}:
        return "ours"
    most, name = max(((x, name) for name, x in (line.get("overlap") or {}).items()), default=(0.0, ""))
    told = f"overlap of {name} {most:.3f}"
    if most >= IDENTICAL:
        return f"identical on this motion: {told}"
    if line["multiple"] is not None and line["multiple"] < 3.0:
        return "size below three stated limits"
    return f"ours; {told}" if name else "ours"


def _good(line: Line) -> bool:
    return bool(line["score"]["right"])


def instead(line: Line) -> str:
    """What was answered, in short."""
    said = ", ".join(f"{effect} {joint or ''}".strip() for effect, joint, *_ in line["findings"])
    return f"{line['answer']}{': ' + said if said else ''}"


def behind(lines: Sequence[Line]) -> str:
    """How many runs of which versions of the product a table is made of, in words."""
    of = newest(lines)
    if not of:
        return "No run has been scored."
    versions: dict[str, list[Line]] = {}
    for line in of:
        versions.setdefault(line["product"], []).append(line)
    listed = ", ".join(f"{len(x)} of {product} (commit {x[-1]['commit']})" for product, x in versions.items())
    before = {(line["cell"], line["draw"]): line for line in first_scores(lines)}
    again = [(before[line["cell"], line["draw"]], line) for line in of]
    again = [(old, line) for old, line in again if old is not line]
    gained = sum(not _good(old) and _good(line) for old, line in again)
    lost = sum(_good(old) and not _good(line) for old, line in again)
    several = len(versions) != 1
    return (
        f"{len(of)} runs of {len({line['cell'] for line in of})} cells with {len(versions)} "
        f"version{'s' if several else ''} of the product: {listed}. Of each cell and draw the run that was scored last "
        f"counts; the ledger has {len(lines)} scores. {len(again)} of these runs were scored before, with an earlier "
        f"version: {gained} were not right then and are right in the table, {lost} were right then and are not."
    )


def costs(lines: Sequence[Line]) -> list[tuple[str, str, str, str, str]]:
    """Arm, runs, processor time of a plant's three runs and of an answer, s (median), and all runs together, min."""
    rows = []
    for arm in dict.fromkeys(line["arm"] for line in lines):
        of = [line for line in lines if line["arm"] == arm and line.get("cpu_s") is not None]
        # older lines have the elapsed time of the plant alone
        plant = [line.get("plant_cpu_s", line.get("plant_s")) or 0.0 for line in of]
        if of:
            answer = [line["cpu_s"] for line in of]
            whole = (sum(plant) + sum(answer)) / 60.0
            middle, most = float(np.median(answer)), max(answer)
            rows.append((arm, str(len(of)), f"{np.median(plant):.1f}", f"{middle:.1f} ({most:.0f})", f"{whole:.1f}"))
    return rows


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(head)} |", "|---" * len(head) + "|", *(f"| {' | '.join(row)} |" for row in rows)]


def markdown(lines: Sequence[Line]) -> str:
    """The tables of docs/trials.md."""
    of = newest(lines)
    before = {m.name: m for m in measures(first_scores(lines))}
    figures = [
        (m.name, m.asked, shown(m), m.limit, str(m.runs), verdict(m), shown(before[m.name])) for m in measures(of)
    ]
    head = ("measure", "asked", "found", "exact 95 % limit", "runs", "", "at the first score")
    sizes = (
        "Right answers by what is hidden, at 3, 10 and 30 detection limits (cells without a size in the first column):"
    )
    wrong = (
        "Every run that is not right, with its cause. The *overlap* of a column that was named is the cosine between "
        "what is missing and the column, beside all other coefficients, over that of the true column. From "
        f"{IDENTICAL:g} on the two are identical on this motion. *Ours*: the method fails."
    )
    out = [behind(lines), "", *_table(head, figures), "", sizes, ""]
    out += [*_table(("arm", "hidden", "3", "10", "30"), by_law(of)), "", wrong, ""]
    out += _table(("cell", "draws", "stated limits", "answer", "cause"), missed(of))
    out += ["", "Processor time of these runs, median and in brackets the largest:", ""]
    out += _table(("arm", "runs", "plants, s", "answer, s", "all, min"), costs(of))
    return "\n".join(out) + "\n"


def counted(lines: Sequence[Line], cells: Iterable[str]) -> list[Line]:
    """The lines of cells that exist: others were given up, because what they hid cannot be told from errors of sensors,
    or for the time that they took. The ledger keeps them."""
    names = set(cells)
    return [line for line in lines if line["cell"] in names]


def write_page(cells: Iterable[str], path: Path | None = None) -> None:
    """Put the tables of these cells between the markers of docs/trials.md."""
    path = path or PAGE
    text = path.read_text()
    head, rest = text.split(BEGIN, 1)
    tail = rest.split(END, 1)[1]
    path.write_text(f"{head}{BEGIN}\n{markdown(counted(read(), cells))}\n{END}{tail}")


def typical_limits(lines: Sequence[Line]) -> dict[str, dict[str, float]]:
    """Median of the limits that nulls state, by arm and condition, then by column: those of the last product that
    answered nulls of the arm."""
    nulls = [line for line in lines if line["group"] == "null" and line["limits"]]
    last = {line["arm"]: line["product"] for line in nulls}
    found: dict[str, dict[str, list[float]]] = {}
    for line in nulls:
        if line["product"] == last[line["arm"]]:
            of = found.setdefault(f"{line['arm']}/{'dirty' if line['dirty'] else 'clean'}", {})
            for column, value in line["limits"].items():
                of.setdefault(column, []).append(value)
    return {
        arm: {column: float(f"{np.median(values):.3g}") for column, values in sorted(columns.items())}
        for arm, columns in sorted(found.items())
    }

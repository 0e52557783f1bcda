# SPDX-License-Identifier: MIT
"""Writes the table of latencies into docs/results.md and the picture beside it, from what `make hil` has measured.

python tools/latency.py out/hil.json docs/results.md docs/latency.svg
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

BEGIN, END = "<!-- latency: written by make latency -->\n", "<!-- end of latency -->\n"
HEAD = (
    "arm",
    "rate, load (frames/s)",
    "the node",
    "cycles",
    "median, ms",
    "99 %, ms",
    "latest, ms",
    "misses",
)
COLOURS, DEADLINE = ("#1d4ed8", "#c2410c", "#93c5fd", "#fdba74"), "#404040"

Case = dict[str, Any]


def cases(content: dict[str, Any]) -> list[Case]:
    """What was timed, in the order of the tests."""
    return [row["latency"] for row in content["drills"] if "latency" in row]


def name(case: Case) -> str:
    """Arm, rate and load."""
    return f"{case['arm']}, {1e3 / case['period_ms']:g} Hz, {case['load']}"


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"


def table(found: list[Case]) -> str:
    """Markdown: a line for each kind of cycle of each case."""
    lines = [f"| {' | '.join(HEAD)} |", f"|{'---|' * len(HEAD)}"]
    for case in found:
        first = f"{1e3 / case['period_ms']:g} Hz, {case['load']} ({case['frames_per_s']:,})"
        for kind in case["cycles"]:
            if kind["count"]:
                times = (_ms(kind[key]) for key in ("median_ms", "p99_ms", "largest_ms"))
                cells = (case["arm"], first, kind["kind"], f"{kind['count']:,}", *times, f"{kind['misses']:,}")
                lines.append(f"| {' | '.join(cells)} |")
    machines = ", ".join(sorted({case["machine"] for case in found}))
    cycles = sum(kind["count"] for case in found for kind in case["cycles"])
    unanswered = sum(kind["unanswered"] for case in found for kind in case["cycles"])
    return (
        f"Measured on: {machines}, one processor, on a host that others use at the same time. Of {cycles:,} SYNCs, "
        f"{cycles - unanswered:,} were answered.\n\n" + "\n".join(lines) + "\n"
    )


def picture(found: list[Case]) -> str:
    """SVG: of each case the number of cycles of each kind in each class of latencies."""
    style: Any = {
        "svg.hashsalt": "zygos",
        "svg.fonttype": "none",
        "font.size": 8.0,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
    with mpl.rc_context(style):
        figure: Any = Figure(figsize=(10.0, 1.0 + 1.7 * ((len(found) + 1) // 2)), layout="constrained")
        panels = figure.subplots((len(found) + 1) // 2, 2, sharex=True, squeeze=False)
        for axes in panels.flat[len(found) :]:
            axes.set_axis_off()
        for axes, case in zip(panels.flat, found, strict=False):
            edges = case["edges_ms"]
            for place, (colour, kind) in enumerate(zip(COLOURS, case["cycles"], strict=True)):
                some = [(k + 0.2 * (place - 1.5), count) for k, count in enumerate(kind["histogram"]) if count]
                axes.bar([at for at, _ in some], [count for _, count in some], 0.2, color=colour)
            deadline = sum(edge <= case["period_ms"] for edge in edges)
            into = case["period_ms"] / edges[deadline - 1] - 1.0
            axes.axvline(deadline - 0.5 + into, color=DEADLINE, linestyle="--", linewidth=1)
            axes.set_yscale("log")
            axes.minorticks_off()
            axes.set_ylim(0.7, 2000.0)
            axes.set_yticks([1, 10, 100, 1000], ["1", "10", "100", "1000"])
            axes.set_xlim(-0.6, len(edges) + 0.6)
            axes.set_xticks([k + 0.5 for k in range(0, len(edges), 2)], [f"{edge:g}" for edge in edges[::2]])
            axes.set_title(name(case), fontsize=8.5)
        for axes in panels[:, 0]:
            axes.set_ylabel("cycles")
        for axes in panels[-1]:
            axes.set_xlabel("from SYNC to the answer, ms")
        kinds = [
            Patch(color=colour, label=kind["kind"]) for colour, kind in zip(COLOURS, found[0]["cycles"], strict=True)
        ]
        deadline = Line2D([], [], color=DEADLINE, linestyle="--", linewidth=1, label="deadline")
        figure.legend(handles=[*kinds, deadline], loc="outside lower center", ncols=5, frameon=False)
        svg = io.StringIO()
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    return "".join(f"{line.rstrip()}\n" for line in svg.getvalue().splitlines())


def main(measured: Path, page: Path, drawn: Path) -> int:
    """Replace what stands between the two marks, and draw; the exit code."""
    found = cases(json.loads(measured.read_text(encoding="utf-8"))) if measured.is_file() else []
    if not found:
        print(f"{measured}: has no latencies; remedy: make hil writes it", file=sys.stderr)
        return 2
    text = page.read_text(encoding="utf-8")
    before, begins, rest = text.partition(BEGIN)
    _, ends, after = rest.partition(END)
    if not begins or not ends:
        print(f"{page}: the lines {BEGIN.strip()} and {END.strip()} are missing; remedy: restore them", file=sys.stderr)
        return 2
    drawn.write_text(picture(found), encoding="utf-8")
    page.write_text(f"{before}{BEGIN}{table(found)}{END}{after}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*map(Path, sys.argv[1:4])))

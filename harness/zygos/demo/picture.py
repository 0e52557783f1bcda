# SPDX-License-Identifier: MIT
"""The picture of the closed loop that docs/results.md shows."""

from __future__ import annotations

import io
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from zygos.demo.loop import Closed, errors
from zygos.errors import ZygosError, installs
from zygos.files.output import number, write_text

_BEFORE, _AFTER, _TRUE = "#c2410c", "#1d4ed8", "#404040"
_SETTLED_S = 3.0
"""The first estimates are too uncertain to be drawn, s."""


def draw_loop(path: Path, closed: Closed, period_s: float) -> None:
    """Draw a closed loop as SVG: the steps, the parameters before and after, the effect on board, and the gap.

    The same result gives the same bytes. Errors: ZygosError where matplotlib is not installed.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415  (an optional dependency)
        from matplotlib.figure import Figure  # noqa: PLC0415
    except ImportError as error:
        raise ZygosError(f"the picture needs matplotlib; remedy: {installs('view')}") from error
    style: Any = {"svg.hashsalt": "zygos", "font.size": 9.0, "axes.spines.top": False, "axes.spines.right": False}
    with mpl.rc_context(style):
        figure: Any = Figure(figsize=(10.0, 4.6), layout="constrained")
        figure.get_layout_engine().set(w_pad=0.12, h_pad=0.08)
        steps, panels = figure.subfigures(2, 1, height_ratios=[1.0, 2.6])
        _steps(steps, closed.content)
        left, middle, right = panels.subplots(1, 3, width_ratios=[1.15, 1.15, 0.8])
        _parameters(left, closed.content)
        _effect(middle, closed, period_s)
        _gap(right, closed.content)
        svg = io.StringIO()
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    write_text(path, "".join(f"{line.rstrip()}\n" for line in svg.getvalue().splitlines()))


def _steps(figure: Any, content: dict[str, Any]) -> None:
    """Five boxes with arrows between them."""
    axes = figure.subplots()
    axes.set_axis_off()
    axes.set_xlim(0.0, 5.0)
    axes.set_ylim(0.0, 1.0)
    (effect,), (named,) = content["effects"], content["named"]
    texts = [
        ("1  fly", "the node estimates with the simulation's model"),
        ("2  capture", "frames of the arm and telemetry, as candump records them"),
        ("3  explain", f"{named['effect']} at the {named['joint']}: {number(effect['explained'], 4)} {effect['unit']}"),
        ("4  adopt", "new.toml is compiled and loaded, and the node restarts"),
        ("5  fly again", "the effect's column is estimated on board"),
    ]
    for k, (title, text) in enumerate(texts):
        colour = _BEFORE if k < 2 else _TRUE if k < 4 else _AFTER
        box = {"boxstyle": "round,pad=0.5", "facecolor": "white", "edgecolor": colour}
        said = "\n".join([title, *textwrap.wrap(text, 23), *[""] * 3][:4])
        axes.text(k + 0.5, 0.5, said, ha="center", va="center", bbox=box, fontsize=8.5)
        if k:
            axes.annotate("", (k + 0.06, 0.5), (k - 0.06, 0.5), arrowprops={"arrowstyle": "->", "color": _TRUE})


def _parameters(axes: Any, content: dict[str, Any]) -> None:
    """Errors of the parameters that the node told of run D."""
    names = [one["name"] for one in content["parameters"]]
    at = np.arange(len(names))
    for when, colour, word in (("before", _BEFORE, "simulation's model"), ("after", _AFTER, "adopted model")):
        axes.semilogx(100.0 * np.abs(errors(content, when)), at, "o", color=colour, markersize=4.5, label=word)
    axes.set_yticks(at, names)
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.3)
    axes.set_xlabel("error of the estimate on board, %")
    axes.set_title("the same run with both models", fontsize=9.5)
    axes.legend(loc="upper center", bbox_to_anchor=(0.45, -0.22), ncols=2, frameon=False, fontsize=8, handletextpad=0.1)


def _effect(axes: Any, closed: Closed, period_s: float) -> None:
    """The estimate of the effect during run D, as the telemetry tells it."""
    (effect,) = closed.content["effects"]
    column = effect["column"]
    told = [one for one in closed.after if column in one and one["verdict_cycle"] * period_s >= _SETTLED_S]
    time = [one["verdict_cycle"] * period_s for one in told]
    value, half = (np.array([one[name] for one in told]) for name in (column, f"{column}_half95"))
    axes.fill_between(time, value - half, value + half, color=_AFTER, alpha=0.25, linewidth=0)
    axes.plot(time, value, color=_AFTER)
    axes.axhline(effect["true"], color=_TRUE, linestyle="--", linewidth=1, label="hidden value")
    axes.legend(loc="upper right", frameon=False, fontsize=8)
    spread = 4.0 * float(np.median(half))
    axes.set_ylim(effect["true"] - spread, effect["true"] + spread)
    axes.set_xlabel("time, s")
    axes.set_ylabel(f"{column}, {effect['unit']}")
    axes.set_title(f"telemetry ± 95 %; significance {number(effect['significance'], 3)}", fontsize=9.5)


def _gap(axes: Any, content: dict[str, Any]) -> None:
    """The gap of the run that explain left untouched, and of the run flown with the adopted model."""
    runs = [("promised\n(run C)", content["promised"]), ("flown\n(run D)", content["flown"])]
    for shift, name, colour, word in ((-0.2, "refit", _BEFORE, "refit"), (0.2, "closed", _AFTER, "adopted")):
        bars = axes.bar(np.arange(2) + shift, [gap[name] for _, gap in runs], 0.36, color=colour, label=word)
        axes.bar_label(bars, [number(gap[name], 3) for _, gap in runs], fontsize=8)
    floor = max(gap["floor"] for _, gap in runs)
    axes.axhline(floor, color=_TRUE, linestyle="--", linewidth=1, label="noise")
    axes.set_yscale("log")
    axes.set_ylim(0.5, 3.0 * max(gap["refit"] for _, gap in runs))
    axes.set_xticks(np.arange(2), [name for name, _ in runs])
    axes.set_ylabel("gap, σ of the sensors")
    axes.set_title("predictions half a second ahead", fontsize=9.5)
    axes.legend(loc="upper center", bbox_to_anchor=(0.45, -0.22), ncols=3, frameon=False, fontsize=8, handlelength=1.2)

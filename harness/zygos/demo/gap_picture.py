# SPDX-License-Identifier: MIT
"""A picture of a closed gap, as SVG: the torque of one joint of an untouched run, measured and predicted, and the
energy that is predicted wrongly."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from zygos.files.output import write_text
from zygos.ground.score import Score
from zygos.report.page import thinned

Floats = NDArray[np.float64]

_WIDTH, _HEIGHT, _LEFT, _PLOT = 900, 300, 55, 560
_MIDDLE, _HALF = 140.0, 105.0
"""Of the torques' axis."""
_COLOURS = {"measured": "#888888", "as delivered": "#c2410c", "closed": "#1d4ed8"}
_SAID = {"measured": "measured", "as delivered": "simulation as delivered", "closed": "with what was found"}
_POINTS = 600


def write_picture(path: Path, runs: Sequence[tuple[str, Score, Score]], where: str) -> None:
    """Draw the torque of the last joint in the first of some untouched runs, and the error of the energy in all.

    runs: name, prediction as delivered and with what was found. where: in which simulator. Errors: ZygosError if it
    cannot be written.
    """
    run, delivered, closed = runs[0]
    at = thinned(len(closed.t), _POINTS)
    t = closed.t[at]
    lines = {
        "measured": closed.measured[at, -1],
        "as delivered": delivered.predicted[at, -1],
        "closed": closed.predicted[at, -1],
    }
    most = float(max(np.abs(y).max() for y in lines.values()))
    said = f"torque of the {closed.joints[-1].joint} in recording {run}, Nm ({where})"
    parts = [_text(_LEFT, 22, said, bold=True)]
    for value in _ticks(-most, most):
        y = _MIDDLE - _HALF * value / most
        parts.append(f'<path d="M{_LEFT} {y:.1f}h{_PLOT}" stroke="#dddddd" fill="none"/>')
        parts.append(_text(_LEFT - 8, y + 4.0, f"{value:.4g}".replace("-", "−"), anchor="end"))
    for value in _ticks(0.0, float(t[-1] - t[0])):
        x = _LEFT + _PLOT * value / (t[-1] - t[0])
        parts.append(f'<path d="M{x:.1f} {_MIDDLE + _HALF:.0f}v5" stroke="#888888" fill="none"/>')
        unit = " s" if value == 0.0 else ""
        parts.append(_text(x, _MIDDLE + _HALF + 20, f"{value:.4g}{unit}", anchor="middle"))
    for name, y in lines.items():
        points = " ".join(
            f"{_LEFT + _PLOT * (a - t[0]) / (t[-1] - t[0]):.1f},{_MIDDLE - _HALF * b / most:.1f}"
            for a, b in zip(t.tolist(), y.tolist(), strict=True)
        )
        wide = 3.0 if name == "measured" else 1.5
        parts.append(f'<polyline points="{points}" fill="none" stroke="{_COLOURS[name]}" stroke-width="{wide}"/>')
    for k, name in enumerate(lines):
        parts.append(f'<path d="M{_LEFT + 190 * k} 286h22" stroke="{_COLOURS[name]}" stroke-width="3"/>')
        parts.append(_text(_LEFT + 190 * k + 28, 290, _SAID[name]))
    parts.append(_text(650, 22, "error of the energy over 1 s, %", bold=True))
    shares = [
        (run, name, 100.0 * score.arm_energy_share)
        for run, *scores in runs
        for name, score in zip(("as delivered", "closed"), scores, strict=True)
    ]
    largest = max(share for *_, share in shares)
    for k, (run, name, share) in enumerate(shares):
        y = 45 + 28 * k + 24 * (k // 2)
        parts.append(_text(650, y + 17, run if name == "as delivered" else ""))
        wide = 150.0 * share / largest
        parts.append(f'<rect x="700" y="{y}" width="{wide:.1f}" height="24" fill="{_COLOURS[name]}"/>')
        parts.append(_text(706 + wide, y + 17, f"{share:.0f}"))
    write_text(
        path,
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        f'font-size="13"><rect width="{_WIDTH}" height="{_HEIGHT}" fill="#ffffff"/>{"".join(parts)}</svg>\n',
    )


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers from low to high, about five."""
    rough = (high - low) / 5.0
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= rough)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def _text(x: float, y: float, said: str, *, bold: bool = False, anchor: str = "start") -> str:
    weight = ' font-weight="bold"' if bold else ""
    return f'<text x="{x:.0f}" y="{y:.0f}" fill="#222222" text-anchor="{anchor}"{weight}>{escape(said)}</text>'

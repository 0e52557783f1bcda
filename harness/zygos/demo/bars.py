# SPDX-License-Identifier: MIT
"""The picture of README.md: the gap of the demonstration, before and after."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from zygos.files.output import number, write_text

_BARS = (("as_delivered", "#c2410c"), ("refit", "#d97706"), ("closed", "#1d4ed8"))
_WORDS = {
    "as_delivered": "simulation as delivered",
    "refit": "its own values fitted",
    "closed": "with the effect that zygos names",
}


def draw_gap(path: Path, gap: Mapping[str, Any]) -> None:
    """Draw the gap of an explanation as SVG: a bar for each model, on a logarithmic scale that begins at the floor."""
    width, left, top, step = 760, 250, 44, 34
    scale = (width - left - 80) / math.log10(gap["as_delivered"] / gap["floor"])
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {top + 3 * step + 10}" '
        'font-family="sans-serif" font-size="14">',
        f'<rect width="{width}" height="{top + 3 * step + 10}" fill="white"/>',
        f'<text x="10" y="24" font-weight="bold">Gap between simulation and measurement, in σ of the noise '
        f"(logarithmic; floor {number(gap['floor'], 3)})</text>",
    ]
    for k, (key, colour) in enumerate(_BARS):
        y, length = top + k * step, max(scale * math.log10(gap[key] / gap["floor"]), 2.0)
        said = _WORDS[key] + (f": {gap['title']}, {gap['where']}" if key == "closed" else "")
        lines += [
            f'<text x="{left - 10}" y="{y + 17}" text-anchor="end">{_WORDS[key]}</text>',
            f'<rect x="{left}" y="{y}" width="{length:.1f}" height="24" fill="{colour}"><title>{said}</title></rect>',
            f'<text x="{left + length + 8:.1f}" y="{y + 17}">{number(gap[key], 3)}</text>',
        ]
    write_text(path, "\n".join([*lines, "</svg>"]) + "\n")

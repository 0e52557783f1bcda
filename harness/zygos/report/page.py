# SPDX-License-Identifier: MIT
"""Common parts of the pages: one self-contained file, its style, and the charts that the script in it draws.

A page's data are `times`, named lists of instants or of other abscissae; `charts` by id, each over one of them; and
`refused`, positions of refused instants in the times "state". Charts of the same `domain` share zoom and cursor.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from zygos.files.output import write_text

Floats = NDArray[np.float64]
Entry = dict[str, Any]

UNITS = {"kg m^2": "kg m²", "Nm/rad": "N m/rad", "Nms/rad": "N m s/rad"}
"""Units of parameters as printed for people."""
_JOINT_COLOURS = 7
_FOLDER = Path(__file__).parent
PAGES = Environment(
    loader=FileSystemLoader([_FOLDER, _FOLDER.parent]), autoescape=True, undefined=StrictUndefined, trim_blocks=True
)


def render(path: Path, template: str, data: Mapping[str, Any], **content: Any) -> None:
    """Write a page: a template, by its name in the package's folder, its content, and the data of its charts."""
    page = PAGES.get_template(template)
    # no "<" may end the script element prematurely
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    write_text(path, page.render(**content, data=Markup(text), charted=bool(data["charts"])))


def numbers(values: Floats) -> list[float | None]:
    """Values with six digits, more than a screen can show; NaN becomes null."""
    return [float(f"{x:.6g}") if math.isfinite(x) else None for x in values.tolist()]


def series(label: str, colour: str, y: Floats, **style: Any) -> Entry:
    """One line of a chart. colour: a custom property of the style."""
    return {"label": label, "colour": colour, "y": numbers(y), **style}


def thinned(count: int, most: int = 1500) -> NDArray[np.intp]:
    """Positions, evenly spaced from 0, at which so many of `count` samples at most are drawn."""
    return np.arange(0, count, max(1, math.ceil(count / most)))


def joint_colour(joint: int | None) -> str:
    """Colour of a joint's lines; None: of lines that belong to no joint."""
    return "ink" if joint is None else f"joint{joint % _JOINT_COLOURS}"

"""The picture of the closed loop that README.md shows."""

from __future__ import annotations

from pathlib import Path

from zygos.demo.loop import Closed


def draw_loop(path: Path, closed: Closed, period_s: float) -> None:
    """Draw it as SVG."""

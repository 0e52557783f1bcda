"""What commands say: tables for people, JSON for machines, files that are whole or absent."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

# A file or a pipe has no width: its tables are not cut to a terminal's nominal 80 columns.
console = Console(soft_wrap=True, width=None if sys.stdout.isatty() else 200)
errors = Console(stderr=True, soft_wrap=True)


def number(value: float | None, digits: int = 6) -> str:
    """A number for a table; a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], title: str | None = None) -> None:
    """Print a table: first column left, the others right."""
    out = Table(title=title, title_justify="left", header_style="bold", box=None, pad_edge=False)
    for k, column in enumerate(columns):
        out.add_column(column, justify="left" if k == 0 else "right", no_wrap=True)
    for row in rows:
        out.add_row(*row)
    console.print(out)


def _clean(value: Any) -> Any:
    """NaN and infinity have no JSON: null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(entry) for entry in value]
    return value


def write_text(path: Path, text: str) -> None:
    """Write a file whole, or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write JSON to a file, or to standard output for "-"."""
    text = json.dumps(_clean(dict(content)), indent=1, ensure_ascii=False) + "\n"
    if str(path) == "-":
        print(text, end="")
    else:
        write_text(Path(path), text)

"""Tables of numbers: CSV and Parquet through polars, NPZ through numpy. A column is a name and n values."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError
from zygos.files.inputs import local, suffix
from zygos.files.output import cannot_be_written

TABLE_SUFFIXES = (".csv", ".parquet", ".npz")

Columns = dict[str, NDArray[Any]]

_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "vertical bars"}
"""Column separators of a CSV and their names; only the comma is read."""
_DECIMAL_COMMA = re.compile(r'(?:^|[;|\t"])\s*[+-]?\d+,\d')
"""A decimal comma in a row of numbers."""
_LINE = 1_000_000
"""Length of a line that is examined, in characters."""


def is_table(path: Path) -> bool:
    """Whether an input is a table: by its suffix, or for standard input by its first bytes."""
    return suffix(path) in TABLE_SUFFIXES


def check_table(path: Path) -> None:
    """Refuse a table that does not exist."""
    if not local(path).is_file():
        raise ZygosError(f"{path}: no such file; remedy: give a table ({' '.join(TABLE_SUFFIXES)}) that exists")


def read_columns(path: Path) -> Columns:
    """Read a table whose columns have equal length; a missing value is NaN.

    A column of text remains text. Column k of a two-dimensional member of an NPZ is ``name[k]``. Raises ZygosError when
    the file is missing, unreadable, or has no row.
    """
    check_table(path)
    try:
        columns = _read_npz(local(path)) if suffix(path) == ".npz" else _read_polars(path)
    except ZygosError:
        raise
    except Exception as error:  # polars and numpy raise different errors for each kind of damage
        first = (str(error).strip().splitlines() or [""])[0]
        raise ZygosError(
            f"{path}: not a readable {suffix(path)} table ({type(error).__name__}: {first}); remedy: write it again "
            "with one row of column names (CSV), or without objects (NPZ)"
        ) from error
    lengths = {len(values) for values in columns.values()}
    if len(lengths) > 1:
        raise ZygosError(f"{path}: columns of {sorted(lengths)} rows; remedy: give every column as many rows")
    if not columns or lengths == {0}:
        raise ZygosError(f"{path}: the table has no row; remedy: export it again")
    return columns


def write_columns(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table in the format of the suffix, completely or not at all. Errors: ZygosError if it cannot be
    written."""
    partial = path.with_name(f".{os.getpid()}.partial{path.suffix}")
    kind = path.suffix.lower()
    frame = None if kind == ".npz" else _polars(path).DataFrame(dict(columns))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            if frame is None:
                with partial.open("wb") as stream:
                    np.savez_compressed(stream, **dict[str, Any](columns))
            elif kind == ".csv":
                frame.write_csv(partial)
            else:
                frame.write_parquet(partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_be_written(path, error) from error


def _polars(path: Path) -> Any:
    try:
        import polars  # noqa: PLC0415  (an extra: only CSV and Parquet need it)
    except ImportError:
        raise ZygosError(
            f"{path}: {suffix(path)} tables need polars, which is not installed; remedy: pip install 'zygos[tables]', "
            "or use NPZ"
        ) from None
    return polars


def _read_polars(path: Path) -> Columns:
    polars = _polars(path)
    if suffix(path) == ".csv":
        _check_separator(path)
        frame = polars.read_csv(local(path), infer_schema_length=None)
    else:
        frame = polars.read_parquet(local(path))
    return {series.name.strip(): series.to_numpy() for series in frame.iter_columns()}


def _check_separator(path: Path) -> None:
    """Refuse a CSV whose columns are not separated by commas, or whose numbers have a decimal comma."""
    with local(path).open(encoding="utf-8-sig", errors="replace") as stream:
        head, row = stream.readline(_LINE), stream.readline(_LINE)
    found = max(_SEPARATORS, key=head.count)
    decimal = _DECIMAL_COMMA.search(row) is not None
    if found != "," and head.count(found):
        also = ", and decimals by a comma" if decimal else ""
        option = ", decimal_comma=True" if decimal else ""
        raise ZygosError(
            f"{path}: columns are separated by {_SEPARATORS[found]}{also}; remedy: export it with a comma between "
            "columns and a point in numbers, or rewrite it in Python: "
            f"polars.read_csv(FILE, separator={found!r}{option}).write_csv(NEW)"
        )
    if '"' in row and decimal:
        raise ZygosError(f"{path}: numbers have a decimal comma; remedy: export it with a decimal point")


def _read_npz(path: Path) -> Columns:
    columns: Columns = {}
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            values = archive[name]
            if values.ndim == 2:
                columns |= {f"{name}[{k}]": values[:, k] for k in range(values.shape[1])}
            elif values.ndim == 1:
                columns[name] = values
            else:
                raise ValueError(f"{name} has {values.ndim} axes, not 1 or 2")
    return columns

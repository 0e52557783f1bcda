"""Tables of numbers: CSV and Parquet through polars, NPZ through numpy. A column is a name and n values."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError
from zygos.files.inputs import encoding as text_encoding
from zygos.files.inputs import is_cut, local, suffix
from zygos.files.output import cannot_be_written

TABLE_SUFFIXES = (".csv", ".parquet", ".npz")

Columns = dict[str, NDArray[Any]]

_SEPARATORS = (";", "\t", "|", ",")
"""Column separators of a CSV. The comma comes last, because it may also be the decimal mark."""
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
"""A number with a decimal comma."""
_MISSING = ("", "nan", "-nan", "na", "n/a", "#n/a", "null", "none")
"""How a CSV may say that a value is missing, in lower case."""
_EXAMINED = 200
"""Number of lines of a CSV from which its format is found."""
_LINE = 1_000_000
"""Length of a line that is examined, in characters."""


def is_table(path: Path) -> bool:
    """Whether an input is a table: by its suffix, or for standard input by its first bytes."""
    return suffix(path) in TABLE_SUFFIXES


def check_table(path: Path) -> None:
    """Refuse a table that does not exist, or whose compression breaks off."""
    if not local(path).is_file():
        raise ZygosError(f"{path}: no such file; remedy: give a table ({' '.join(TABLE_SUFFIXES)}) that exists")
    if is_cut(path):
        raise ZygosError(f"{path}: is compressed, and its end is missing; remedy: copy it again")


def read_columns(path: Path) -> Columns:
    """Read a table whose columns have equal length; a missing value is NaN.

    A column of text remains text. Column k of a two-dimensional member of an NPZ is ``name[k]``; single values are left
    out. The columns of a CSV may be separated by commas, semicolons, tabs or vertical bars; with the latter three,
    decimals may have a comma. Spaces around a number do not count, and a missing value may be empty, or one of
    `_MISSING`. A CSV that is not UTF-8 is read as UTF-16 if it begins like one, and as Windows-1252 otherwise. The
    columns of a CSV without names are "1", "2", … Raises ZygosError when the file is missing, unreadable, or has no
    row.
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
            "with equally many fields in each row (CSV), or without objects (NPZ)"
        ) from error
    lengths = {len(values): name for name, values in columns.items()}
    if len(lengths) > 1:
        listed = ", ".join(f"{name} has {count:,}" for count, name in sorted(lengths.items()))
        raise ZygosError(
            f"{path}: columns have different numbers of rows: {listed}; remedy: give every column a row for each "
            "instant, and transpose an array that has one column for each"
        )
    if not columns or set(lengths) == {0}:
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
    if suffix(path) != ".csv":
        frame = polars.read_parquet(local(path))
        return {series.name.strip(): _plain(polars, series).to_numpy() for series in frame.iter_columns()}
    form = _csv_form(path)
    source: Any = local(path)
    if form.encoding != "utf-8-sig":
        source = source.read_bytes().decode(form.encoding, errors="replace").encode()
    frame = polars.read_csv(
        source,
        separator=form.separator,
        decimal_comma=form.decimal_comma,
        has_header=form.names,
        infer_schema_length=None,
    )
    return {
        series.name.strip() if form.names else str(k): _numeric(polars, series, form.decimal_comma).to_numpy()
        for k, series in enumerate(frame.iter_columns(), start=1)
    }


def _plain(polars: Any, series: Any) -> Any:
    """Decimals as floats; any other column as it is."""
    return series.cast(polars.Float64) if series.dtype.is_decimal() else series


def _numeric(polars: Any, series: Any, decimal_comma: bool) -> Any:
    """A column of text as numbers, if that is what it has beside spaces and missing values; otherwise as it is."""
    if series.dtype != polars.String:
        return series
    text = series.str.strip_chars()
    text = text.set(text.str.to_lowercase().is_in(_MISSING), None)
    if decimal_comma:
        text = text.str.replace(",", ".", literal=True)
    for kind in (polars.Int64, polars.Float64):
        numbers = text.cast(kind, strict=False)
        if numbers.null_count() == text.null_count():
            return numbers.cast(polars.Float64) if numbers.null_count() else numbers
    return series


@dataclass(frozen=True)
class _CsvForm:
    encoding: str
    separator: str
    decimal_comma: bool
    names: bool
    """Whether the first row has the names of the columns."""


def _csv_form(path: Path) -> _CsvForm:
    """How a CSV is written, from its first lines: the separator is the one that divides the first two lines into
    equally many fields, and a first row of numbers alone has no names. Errors: ZygosError where columns are separated
    by spaces, where they begin further down, and for commas that are both separators and decimal marks."""
    encoding = text_encoding(path)
    with local(path).open(encoding=encoding, errors="replace", newline="") as stream:
        lines = [line.rstrip("\r\n") for line in islice(iter(lambda: stream.readline(_LINE), ""), _EXAMINED)]
    lines = [line for line in lines if line.strip()]
    separator = next((one for one in _SEPARATORS if _divides(one, lines)), "")
    if not separator:
        _check_columns(path, lines)
        separator = ","
    rows = list(csv.reader(lines, delimiter=separator))
    decimal = any(_DECIMAL_COMMA.fullmatch(field.strip()) for row in rows[1:] or rows for field in row)
    if decimal and separator == ",":
        raise ZygosError(
            f"{path}: numbers have a decimal comma, and columns are separated by commas as well; remedy: export it "
            "with semicolons or tabs between the columns, or with a decimal point"
        )
    fields = [field.strip().replace(",", ".") if decimal else field.strip() for field in (rows[0] if rows else [])]
    names = not (any(fields) and all(not one or _is_number(one) for one in fields))
    return _CsvForm(encoding, separator, decimal, names)


def _check_columns(path: Path, lines: Sequence[str]) -> None:
    """Refuse a CSV whose first two lines have no columns, but others have."""
    below = next((k for k in range(1, len(lines) - 1) if any(_divides(one, lines[k:]) for one in _SEPARATORS)), 0)
    if below:
        raise ZygosError(
            f"{path}: the columns begin below {lines[0][:40]!r}, in row {below + 1} (empty lines not counted); remedy: "
            "remove the lines above the names of the columns"
        )
    counts = {len(line.split()) for line in lines[:2]}
    if len(lines) > 1 and len(counts) == 1 and min(counts) > 1:
        raise ZygosError(
            f"{path}: columns are separated by spaces; remedy: export it with commas, semicolons or tabs between the "
            "columns"
        )


def _divides(separator: str, lines: Sequence[str]) -> bool:
    """Whether a separator divides the first two lines into equally many fields, at least two."""
    counts = [len(row) for row in csv.reader(lines[:2], delimiter=separator)]
    return bool(counts) and min(counts) > 1 and len(set(counts)) == 1


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_npz(path: Path) -> Columns:
    columns: Columns = {}
    with np.load(path, allow_pickle=False) as archive:
        for name in archive.files:
            values = archive[name]
            if values.ndim == 2:
                columns |= {f"{name}[{k}]": values[:, k] for k in range(values.shape[1])}
            elif values.ndim == 1:
                columns[name] = values
            elif values.ndim > 2:
                raise ValueError(f"{name} has {values.ndim} axes, not 1 or 2")
    return columns

# SPDX-License-Identifier: MIT
"""Tables of numbers: CSV, NPZ, and Parquet through polars. A column is a name and n values."""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError, installs
from zygos.files import inputs
from zygos.files.inputs import check_file, local, suffix
from zygos.files.output import cannot_be_written, counted

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
_HEAD = 4096
"""Number of bytes that show whether a CSV is text."""


def is_table(path: Path) -> bool:
    """Whether an input is a table: by its suffix, or for standard input by its first bytes."""
    return suffix(path) in TABLE_SUFFIXES


def check_table(path: Path) -> None:
    """Refuse a table that does not exist."""
    check_file(path, f"give a table ({' '.join(TABLE_SUFFIXES)}) that exists")


def read_columns(path: Path, damage: list[str] | None = None) -> Columns:
    """Read a table whose columns have equal length; a missing value is NaN.

    A column of text remains text. Column k of a two-dimensional member of an NPZ, and the k-th of several columns of a
    CSV that have the same name, is ``name[k]``; single values are left out. The columns of a CSV may be separated by
    commas, semicolons, tabs or vertical bars; with the latter three, decimals may have a comma. Spaces around a number
    do not count, and a missing value may be empty, or one of `_MISSING`. A CSV that is not UTF-8 is read as UTF-16 if
    it begins like one, and as Windows-1252 otherwise. The columns of a CSV without names are "1", "2", …

    damage: gets a sentence about rows of a CSV that have another number of fields than the others, which are left out;
    None: such a table is refused. Raises ZygosError when the file is missing, unreadable, or has no row.
    """
    check_table(path)
    kind = suffix(path)
    found: list[str] = []
    try:
        columns = (
            _read_npz(local(path)) if kind == ".npz" else _read_csv(path, found) if kind == ".csv" else _parquet(path)
        )
    except ZygosError:
        raise
    except Exception as error:  # polars, csv and numpy raise different errors for each kind of damage
        first = (str(error).strip().splitlines() or [""])[0]
        raise ZygosError(
            f"{path}: not a readable {kind} table ({type(error).__name__}: {first}); remedy: write it again"
            + (", without objects" if kind == ".npz" else "")
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
    if damage is None and found:
        raise ZygosError(f"{path} {'; '.join(found)}; remedy: export it again, or remove these rows")
    if damage is not None:
        damage += found
    return columns


def write_columns(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table in the format of the suffix, completely or not at all. Errors: ZygosError if it cannot be
    written."""
    partial = path.with_name(f".{os.getpid()}.partial{path.suffix}")
    kind = path.suffix.lower()
    frame = _polars(path).DataFrame(dict(columns)) if kind == ".parquet" else None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            if frame is not None:
                frame.write_parquet(partial)
            elif kind == ".csv":
                with partial.open("w", encoding="utf-8", newline="") as text:
                    writer = csv.writer(text, lineterminator="\n")
                    writer.writerow(columns)
                    writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
            else:
                with partial.open("wb") as stream:
                    np.savez_compressed(stream, **dict[str, Any](columns))
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_be_written(path, error) from error


def _polars(path: Path) -> Any:
    try:
        import polars  # noqa: PLC0415  (an extra: only Parquet needs it)
    except ImportError:
        raise ZygosError(
            f"{path}: .parquet tables need polars; remedy: {installs('tables')}, or use a .csv or .npz"
        ) from None
    return polars


def _parquet(path: Path) -> Columns:
    polars = _polars(path)

    def plain(series: Any) -> Any:
        return series.cast(polars.Float64) if series.dtype.is_decimal() else series

    return {series.name.strip(): plain(series).to_numpy() for series in polars.read_parquet(local(path)).iter_columns()}


@dataclass(frozen=True)
class _CsvForm:
    encoding: str
    separator: str
    decimal_comma: bool
    names: bool
    """Whether the first row has the names of the columns."""
    width: int
    """Number of columns."""


def _read_csv(path: Path, damage: list[str]) -> Columns:
    form = _csv_form(path)
    rows: list[list[str]] = []
    odd: list[tuple[int, int]] = []
    with _text(path, form.encoding) as stream:
        for line, row in _rows(stream, form.separator):
            if len(row) == form.width + 1 and not row[-1].strip():  # a separator at the end of the line
                row.pop()
            if len(row) == form.width:
                rows.append(row)
            else:
                odd.append((line, len(row)))
    if inputs.is_cut(path):
        rows = rows[:-1]  # its last number may be cut
        damage.append("is compressed, and its end is missing")
    if odd:
        line, count = odd[0]
        others = f", and {counted(len(odd) - 1, 'row')} after it do not have {form.width}" if odd[1:] else ""
        damage.append(f"has {count} of {form.width} columns in line {line:,}, which is left out{others}")
    names = [name.strip() for name in rows.pop(0)] if form.names else [str(k + 1) for k in range(form.width)]
    often = Counter(names)
    seen: Counter[str] = Counter()
    columns: Columns = {}
    for name, texts in zip(names, zip(*rows, strict=True), strict=False):
        columns[f"{name}[{seen[name]}]" if often[name] > 1 else name] = _numbers(texts, form.decimal_comma)
        seen[name] += 1
    return columns


def _text(path: Path, encoding: str) -> TextIO:
    return local(path).open(encoding=encoding, errors="replace", newline="")


def _rows(lines: Iterable[str], separator: str) -> Iterator[tuple[int, list[str]]]:
    """The rows of a CSV that are not empty, with the numbers of the lines where they end."""
    reader = csv.reader(lines, delimiter=separator)
    for row in reader:
        if len(row) > 1 or any(map(str.strip, row)):
            yield reader.line_num, row


def _numbers(texts: Sequence[str], decimal_comma: bool) -> NDArray[Any]:
    """A column as whole numbers, or else as numbers that may be missing, or else as text."""
    words = [text.replace(",", ".") for text in texts] if decimal_comma else texts
    for kind in (np.int64, np.float64):
        try:
            return np.array(words, dtype=kind)
        except (ValueError, OverflowError):
            continue
    try:
        return np.array(["nan" if word.strip().lower() in _MISSING else word for word in words], dtype=np.float64)
    except ValueError:
        return np.array(texts)


def _encoding(path: Path) -> str:
    """Of a CSV. Errors: ZygosError where it is no text."""
    found = inputs.encoding(path)
    with local(path).open("rb") as stream:
        if not found.startswith("utf-16") and b"\0" in stream.read(_HEAD):
            raise ZygosError(
                f"{path}: is not text, but binary; remedy: export it as text, or, if it has another format, give it "
                "the suffix of that"
            )
    return found


def _csv_form(path: Path) -> _CsvForm:
    """How a CSV is written, from its first lines: the separator is the one that divides most of them into equally many
    fields, and a first row of numbers alone has no names. Errors: ZygosError where columns are separated by spaces,
    where they begin further down, for a first row with another number of fields than most, and for commas that are both
    separators and decimal marks."""
    encoding = _encoding(path)
    with _text(path, encoding) as stream:
        lines = [line for line in islice(iter(lambda: stream.readline(_LINE), ""), _EXAMINED) if line.strip()]
    widths = {separator: _width(separator, lines) for separator in _SEPARATORS}
    separator = next(
        (one for one, (_, share) in widths.items() if share > 0.5), max(widths, key=lambda one: widths[one][1])
    )
    width, share = widths[separator]
    if not share:
        separator, width = ",", 1
        if len(lines) > 1 and len(counts := {len(line.split()) for line in lines[:2]}) == 1 and min(counts) > 1:
            raise ZygosError(
                f"{path}: columns are separated by spaces; remedy: export it with commas, semicolons or tabs between "
                "the columns"
            )
    rows = [row for _, row in _rows(lines, separator)]
    if rows and len(rows[0]) == width - 1 and all(not row[-1].strip() for row in rows if len(row) == width):
        width -= 1  # every line but the first ends with a separator
    if rows and len(rows[0]) not in (width, width + (not rows[0][-1].strip())):
        below = next(k for k, row in enumerate(rows, start=1) if len(row) >= width)
        raise ZygosError(
            f"{path}: the columns begin below {lines[0].strip()[:40]!r}, in row {below} (empty lines not counted); "
            "remedy: remove the lines above the names of the columns"
            if len(rows[0]) == 1
            else f"{path}: the first row has {len(rows[0])} fields, but most rows have {width}; remedy: remove lines "
            "above the names of the columns, and give every column a name"
        )
    decimal = any(_DECIMAL_COMMA.fullmatch(field.strip()) for row in rows[1:] or rows for field in row)
    if decimal and separator == ",":
        raise ZygosError(
            f"{path}: numbers have a decimal comma, and columns are separated by commas as well; remedy: export it "
            "with semicolons or tabs between the columns, or with a decimal point"
        )
    fields = [field.strip().replace(",", ".") if decimal else field.strip() for field in (rows[0] if rows else [])]
    names = not (any(fields) and all(not one or _is_number(one) for one in fields))
    return _CsvForm(encoding, separator, decimal, names, width)


def _width(separator: str, lines: Sequence[str]) -> tuple[int, float]:
    """The most frequent number of fields, at least two, into which a separator divides lines, and their share."""
    counts = Counter(len(row) for _, row in _rows(lines, separator) if len(row) > 1)
    width, often = max(counts.items(), key=lambda item: item[1], default=(1, 0))
    return width, often / max(len(lines), 1)


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

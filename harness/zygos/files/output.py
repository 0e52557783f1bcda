# SPDX-License-Identifier: MIT
"""Output of commands: tables for people, JSON for programs, files that are written completely or not at all."""

from __future__ import annotations

import io
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from zygos.errors import ZygosError

console = Console(soft_wrap=True)
errors = Console(stderr=True, soft_wrap=True)

_WIDE = 200
"""Width for a file or a pipe, which have no width of their own, in characters."""
_BETWEEN = 2
"""Space between two columns of a table, in characters."""


def say(text: str) -> None:
    """Print a line unchanged: brackets and colons in a path are not taken as markup."""
    console.print(text, highlight=False, markup=False, emoji=False)


def note(text: str) -> None:
    """Print a line unchanged on stderr."""
    errors.print(text, highlight=False, markup=False, emoji=False)


@contextmanager
def errors_end_the_program() -> Iterator[None]:
    """Errors of the user end the program with a message on stderr and their exit code, never with a traceback.

    SIGTERM ends it as Ctrl-C does, so that no incomplete output is left behind.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without UTF-8 shows "?" for missing characters
    before = signal.getsignal(signal.SIGTERM)
    alone = threading.current_thread() is threading.main_thread()  # other threads may not set a signal handler
    if alone:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        yield
    except (ZygosError, OSError) as error:
        message = str(error)
        if isinstance(error, OSError):
            message += "; remedy: check that the file or folder exists and may be written"
        errors.print("[bold red]zygos:[/]", end=" ")
        note(message)
        sys.exit(error.exit_code if isinstance(error, ZygosError) else 2)
    except KeyboardInterrupt:
        note("zygos: interrupted")
        sys.exit(128 + signal.SIGINT)
    finally:
        if alone:
            signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def is_dash(path: str | Path | None) -> bool:
    """Whether a name is "-", which stands for standard input or output."""
    return str(path) == "-"


def quiet(*outputs: str | Path | None) -> bool:
    """Whether one of the outputs is standard output, so that nothing else may be printed there."""
    return any(map(is_dash, outputs))


def named(output: str | Path) -> str:
    """Name of an output in messages."""
    return "standard output" if is_dash(output) else str(output)


def counted(count: int, noun: str) -> str:
    """A number and its noun, in the plural (with s) unless the number is 1."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def ratio(value: float, base: float) -> float:
    """value / base; NaN where base is zero."""
    return float(value) / float(base) if base else math.nan


def number(value: float | None, digits: int = 6) -> str:
    """A number for a table; a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def good(text: str) -> Text:
    """A table cell in the colour of a good result."""
    return Text(text, style="green")


def bad(text: str) -> Text:
    """A table cell in the colour of a bad result."""
    return Text(text, style="red")


def _available_width() -> int:
    """Width that a table may take, in characters: that of the terminal, or the value of COLUMNS."""
    stated = os.environ.get("COLUMNS", "")
    if stated.isdigit():
        return int(stated)
    return console.width if console.is_terminal else _WIDE


def table(columns: Sequence[str], rows: Sequence[Sequence[str | Text]], title: str | None = None) -> None:
    """Print a table: first column left, the others right. Text is printed unchanged, brackets are not taken as markup.

    Nothing is cut off. If the columns do not fit side by side, their heads are broken at spaces; if that is not enough,
    several tables are printed, each of which begins with the first column.
    """
    cells = [[Text(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
    available = _available_width()
    heads = [Text(column, style="bold") for column in columns]
    inside = [max((row[k].cell_len for row in cells), default=0) for k in range(len(columns))]
    widths = [max(width, head.cell_len) for width, head in zip(inside, heads, strict=True)]
    if sum(widths) + _BETWEEN * (len(columns) - 1) > available:
        widths = [max([width, *map(len, column.split())]) for width, column in zip(inside, columns, strict=True)]
    for k, width in enumerate(widths[1:], start=1):  # a text longer than a line is broken at its spaces
        words = [len(word) for text in (heads[k], *(row[k] for row in cells)) for word in text.plain.split()]
        widths[k] = max(min(width, available - widths[0] - _BETWEEN), *words, 1)
    for k, group in enumerate(_groups(widths, available)):
        out = Table(title=Text(title) if title and k == 0 else None, title_justify="left", box=None, pad_edge=False)
        for column in group:
            justify: JustifyMethod = "left" if column == 0 else "right"
            out.add_column(heads[column], justify=justify, width=widths[column], overflow="fold")
        for row in cells:
            out.add_row(*(row[column] for column in group))
        if k > 0:
            console.print()
        Console(width=max(available, sum(widths[column] + _BETWEEN for column in group))).print(out)


def _groups(widths: Sequence[int], available: int) -> list[list[int]]:
    """Columns of each printed table: the first column is in every table, the others are spread over as few as
    possible."""
    groups = [[0]]
    for column in range(1, len(widths)):
        taken = sum(widths[other] + _BETWEEN for other in groups[-1])
        if len(groups[-1]) > 1 and taken + widths[column] > available:
            groups.append([0])
        groups[-1].append(column)
    return groups


def _clean(value: Any) -> Any:
    """Replace NaN and infinity, which JSON cannot express, by null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(entry) for entry in value]
    return value


def check_outputs(outputs: Sequence[str | Path | None], inputs: Sequence[str | Path | None]) -> None:
    """Refuse outputs that would replace an input or one another, or that cannot be written, and "-" for two of them.

    Call it before any work. None and "-" are not files. Nothing is left behind. Errors: ZygosError naming the file, or
    both files.
    """
    for stream, entries in (("input", inputs), ("output", outputs)):
        if sum(map(is_dash, entries)) > 1:
            raise ZygosError(f"- stands for standard {stream} more than once; remedy: give all but one a file name")
    taken = [Path(entry) for entry in inputs if entry is not None and not is_dash(entry)]
    for entry in outputs:
        if entry is None or is_dash(entry):
            continue
        path = Path(entry)
        for other in taken:
            if path.resolve() == other.resolve() or (path.exists() and other.exists() and path.samefile(other)):
                raise ZygosError(
                    f"{path}: writing it would replace {other}, which this command also needs; "
                    "remedy: give every file a different name"
                )
        taken.append(path)
        if path.exists() and not path.is_file():
            raise ZygosError(f"{path}: is not a regular file; remedy: name a file to write")
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        try:
            with TemporaryFile(dir=folder):  # only an attempt shows what permissions, mounts and quotas allow
                pass
        except OSError as error:
            raise ZygosError(
                f"{path}: cannot be written, {folder} takes no file ({error.strerror}); remedy: choose another folder"
            ) from error


def cannot_be_written(path: Path, error: Exception) -> ZygosError:
    """The error for a file that could not be written; it names this file, not the temporary one."""
    reason = getattr(error, "strerror", None) or str(error)
    return ZygosError(f"{path}: cannot be written ({reason}); remedy: check the folder, its permissions and free space")


def write_text(path: Path, text: str) -> None:
    """Write text as UTF-8, in the same way as `write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file completely or not at all; missing folders are made; "-" is standard output.

    Errors: ZygosError if it cannot be written.
    """
    if is_dash(path):
        sys.stdout.flush()
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
        return
    partial = path.with_name(f".{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with partial.open("wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_be_written(path, error) from error


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write JSON to a file, or to standard output for "-"."""
    write_text(Path(path), json.dumps(_clean(dict(content)), indent=1) + "\n")

"""Input of commands: a file, or standard input if the name is "-"."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

from zygos.errors import ZygosError
from zygos.files.output import is_dash, note

_KINDS = (
    (".blf", re.compile(rb"LOGG")),
    (".mf4", re.compile(rb"MDF ")),
    (".npz", re.compile(rb"PK\x03\x04")),
    (".parquet", re.compile(rb"PAR1")),
    (".mcap", re.compile(rb"\x89MCAP")),
    (".log", re.compile(rb"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]+#")),
    (".asc", re.compile(rb"\s*(date|base|//|\d+\.\d+\s)", re.IGNORECASE)),
    (".trc", re.compile(rb"\s*;")),
    (".csv", re.compile(rb"(\xef\xbb\xbf)?[^\n\0]*[,;\t][^\n\0]*\n")),
)
"""First bytes of each kind of log and table, and the suffix of its files."""
_HEAD = 4096
"""Number of bytes that are examined to recognise the kind."""


class _Spool:
    """Standard input as a file, for readers that seek in it or read it twice."""

    def __init__(self, cleanup: ExitStack) -> None:
        self._cleanup = cleanup

    @cached_property
    def file(self) -> Path:
        """The file; standard input is read at the first call, and the suffix follows from its first bytes."""
        if sys.stdin.isatty():
            note("reading standard input; Ctrl-D ends it")
        raw = Path(self._cleanup.enter_context(TemporaryDirectory(prefix="zygos-")), "input")
        with raw.open("wb") as copy:
            shutil.copyfileobj(sys.stdin.buffer, copy)
        with raw.open("rb") as copy:
            head = copy.read(_HEAD)
        suffix = next((suffix for suffix, sign in _KINDS if sign.match(head)), "")
        return raw.rename(raw.with_suffix(suffix))


_SPOOL: ContextVar[_Spool | None] = ContextVar("spool", default=None)


@contextmanager
def standard_input() -> Iterator[None]:
    """Context in which the input name "-" means standard input, which is read at most once."""
    with ExitStack() as cleanup:
        token = _SPOOL.set(_Spool(cleanup))
        try:
            yield
        finally:
            _SPOOL.reset(token)


def local(path: Path) -> Path:
    """The file to open for an input: the file itself, or the copy of standard input if the name is "-"."""
    spool = _SPOOL.get()
    return path if spool is None or not is_dash(path) else spool.file


def check_file(path: Path, remedy: str) -> None:
    """Refuse an input that does not exist, or that is a folder. remedy: where it does not exist."""
    if local(path).is_dir():
        raise ZygosError(f"{path}: is a folder; remedy: give a file in it")
    if not local(path).is_file():
        raise ZygosError(f"{path}: no such file; remedy: {remedy}")


def suffix(path: Path) -> str:
    """Suffix of an input in small letters; for standard input the one that its first bytes suggest, or ""."""
    return local(path).suffix.lower()

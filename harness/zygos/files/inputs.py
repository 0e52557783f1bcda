# SPDX-License-Identifier: MIT
"""Input of commands: a file, or standard input if the name is "-"; either may be compressed with gzip."""

from __future__ import annotations

import codecs
import re
import shutil
import sys
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from zygos.errors import ZygosError
from zygos.files.output import is_dash, note

LOG_SUFFIXES = (".log", ".blf", ".asc", ".trc", ".mf4")
"""Formats of CAN logs, in which python-can stores classical frames without loss."""
_GZIP = ".gz"
_GZIP_MARK = b"\x1f\x8b"
_BINARIES = (
    (".blf", b"LOGG"),
    (".mf4", b"MDF "),
    (".npz", b"PK\x03\x04"),
    (".parquet", b"PAR1"),
    (".mcap", b"\x89MCAP"),
)
"""First bytes of each binary kind of log and table, and the suffix of its files."""
_DIALECTS = {
    "candump": re.compile(r"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-F]+#", re.IGNORECASE),
    "candump on the screen": re.compile(r".{0,80}?(?<=\s)([0-9A-F]{3}|[0-9A-F]{8})\s+(\[\d\d?\]|\{[9A-F]\})\s"),
    "BUSMASTER": re.compile(r"\*\*\*BUSMASTER\b", re.IGNORECASE),
    "slcan": re.compile(
        r"[\azZ]*([trdb][0-7][0-9A-F]{2}|[TRDB][01][0-9A-F]{7})[0-9A-F]([0-9A-F]{2})*\s*\n", re.IGNORECASE
    ),
    "SavvyCAN": re.compile(r"Time Stamp,ID,Extended,(Dir,)?Bus,LEN\b", re.IGNORECASE),
    "python-can": re.compile(r"timestamp,arbitration_id,extended,remote,error,dlc,data\b"),
}
"""How a line of each dialect of .log begins."""
_TEXTS = (
    (".asc", re.compile(r"\s*(date|base|//|[+-]?\d+\.\d+\s)", re.IGNORECASE)),
    (".trc", re.compile(r"\s*;")),
    (".csv", re.compile(r"[^\n\x00-\x08\x0e-\x1f]*[,;\t][^\n\x00-\x08\x0e-\x1f]*\n")),
)
"""How the other texts begin, and the suffix of their files."""
TOML_KINDS = {
    "time": "a map",
    "manoeuvre": "a scenario",
    "body": "a model",
    "parameters": "a model",
    "period_s": "an arm file",
}
"""What a TOML file is that has this key at its top."""
_HEAD = 4096
"""Number of bytes that are examined to recognise the kind."""
_PART = 1 << 20
"""Number of bytes that are unpacked at once."""


@dataclass(frozen=True)
class _Copy:
    """An input that was copied because it came from standard input, or was compressed."""

    file: Path
    cut: bool
    """Whether the end of a compressed input is missing."""


class _Copies:
    """Copies of inputs, for readers that seek in them or read them twice."""

    def __init__(self, cleanup: ExitStack) -> None:
        self._cleanup = cleanup
        self._unpacked: dict[tuple[Path, int, int], _Copy] = {}

    @cached_property
    def standard(self) -> Path:
        """Standard input as a file, which is read at the first call."""
        if sys.stdin.isatty():
            note("reading standard input; Ctrl-D ends it")
        file = self._folder() / "input"
        with file.open("wb") as copy:
            shutil.copyfileobj(sys.stdin.buffer, copy)
        return file

    def unpacked(self, file: Path) -> _Copy:
        """A compressed file without its compression, as far as it can be unpacked."""
        state = file.stat()
        key = (file.absolute(), state.st_mtime_ns, state.st_size)
        if key not in self._unpacked:
            target = self._folder() / _without_gzip(file).name
            with file.open("rb") as source, target.open("wb") as copy:
                cut = _unpack(source, copy)
            self._unpacked[key] = _Copy(target, cut)
        return self._unpacked[key]

    def _folder(self) -> Path:
        return Path(self._cleanup.enter_context(TemporaryDirectory(prefix="zygos-")))


def _without_gzip(file: Path) -> Path:
    """A name without the suffix of gzip."""
    return file.with_suffix("") if file.suffix.lower() == _GZIP else file


def _unpack(source: BinaryIO, copy: BinaryIO) -> bool:
    """Unpack what gzip wrote, several files one after the other included. Returns whether the end is missing."""
    stream = zlib.decompressobj(wbits=31)
    while part := source.read(_PART):
        while part:
            if stream.eof:
                if not part.startswith(_GZIP_MARK[:1]):
                    return False  # padding
                stream = zlib.decompressobj(wbits=31)
            try:
                copy.write(stream.decompress(part))
            except zlib.error:
                return True
            part = stream.unused_data
    return not stream.eof


_COPIES: ContextVar[_Copies | None] = ContextVar("copies", default=None)
_OF_THIS_PROCESS = _Copies(ExitStack())
"""Copies outside of such a context; they are removed when Python ends."""


@contextmanager
def standard_input() -> Iterator[None]:
    """Context in which the input name "-" means standard input, which is read at most once. Copies of inputs are
    removed at its end."""
    with ExitStack() as cleanup:
        token = _COPIES.set(_Copies(cleanup))
        try:
            yield
        finally:
            _COPIES.reset(token)


def given(path: Path) -> Path:
    """The file as it was given: the file itself, or the copy of standard input if the name is "-"."""
    copies = _COPIES.get()
    return path if copies is None or not is_dash(path) else copies.standard


def local(path: Path) -> Path:
    """The file to open for an input: as it was given, or a copy without its compression, as far as it goes."""
    file = given(path)
    return _unpacked(file).file if _begin(file, len(_GZIP_MARK)) == _GZIP_MARK else file


def is_cut(path: Path) -> bool:
    """Whether an input is compressed, and its end is missing."""
    file = given(path)
    return _begin(file, len(_GZIP_MARK)) == _GZIP_MARK and _unpacked(file).cut


def _unpacked(file: Path) -> _Copy:
    return (_COPIES.get() or _OF_THIS_PROCESS).unpacked(file)


def _begin(file: Path, count: int) -> bytes:
    """The first bytes of a file; none of one that cannot be read."""
    try:
        with file.open("rb") as stream:
            return stream.read(count)
    except OSError:
        return b""


def encoding(path: Path) -> str:
    """The encoding of a text, from its first bytes."""
    begin = _begin(local(path), _PART)
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if re.match(rb"([^\0]\0){4}|(\0[^\0]){4}", begin):
        return "utf-16-le" if begin[0] else "utf-16-be"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(begin)  # a character may be cut at the end
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


@dataclass(frozen=True)
class Kind:
    """The kind of an input."""

    suffix: str
    """Suffix of its files in small letters; "" where neither name nor content say it."""
    dialect: str = ""
    """Of a .log: candump, or the program that wrote it."""


def kind(path: Path) -> Kind:
    """The kind of an input. Its suffix says it, or its first bytes: of standard input, of .txt, and of .log and .csv,
    which several programs write. Binaries and dialects of .log are recognised under any other suffix."""
    suffix = _without_gzip(local(path)).suffix.lower()
    if suffix in {one for one, _ in (*_BINARIES, *_TEXTS)} - {".csv"}:
        return Kind(suffix)
    found = content(path)
    if suffix in ("", ".txt"):
        return found
    if suffix in (".log", ".csv"):
        return found if found.dialect else Kind(suffix)
    return Kind(suffix) if found.suffix in {"", *(one for one, _ in _TEXTS)} else found


def content(path: Path) -> Kind:
    """The kind of an input as its first bytes say it; a dialect may begin below lines that are of none."""
    begin = _begin(local(path), _HEAD)
    for one, mark in _BINARIES:
        if begin.startswith(mark):
            return Kind(one)
    head = begin.decode(encoding(path), errors="replace").replace("\r", "\n")
    for line in re.sub(r"\x1b\[\d*m", "", head).splitlines(keepends=True):
        for name, sign in _DIALECTS.items():
            if sign.match(line):
                return Kind(".log", name)
    return Kind(next((one for one, sign in _TEXTS if sign.match(head)), ""))


def check_file(path: Path, remedy: str) -> None:
    """Refuse an input that does not exist, or that is a folder. remedy: where it does not exist."""
    if local(path).is_dir():
        raise ZygosError(f"{path}: is a folder; remedy: give a file in it")
    if not local(path).is_file():
        raise ZygosError(f"{path}: no such file; remedy: {remedy}")


def suffix(path: Path) -> str:
    """Suffix of an input in small letters, as `kind` says it."""
    return kind(path).suffix


def toml_kind(path: Path) -> str:
    """What a TOML file is, in words."""
    try:
        keys = tomllib.loads(local(path).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        keys = {}
    return next((known for sign, known in TOML_KINDS.items() if sign in keys), "a TOML file")

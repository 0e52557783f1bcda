"""Reads logs that may be damaged: python-can decodes the intact parts, damaged parts are skipped and reported."""

from __future__ import annotations

import logging
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can

from zygos.files.output import counted

_NO_IDENTIFIER = 1 << 29
"""The smallest number that is too large for a CAN identifier."""
_CANDUMP_ERROR = re.compile(r"\s*\S+\s+\S+\s+([23][0-9a-f]{7})#", re.IGNORECASE)
"""candump marks error frames by bit 29 of the identifier; python-can's reader recognises only one class of them."""


@dataclass(frozen=True)
class _Text:
    """A text format of logs."""

    reader: Any
    """The reader of python-can."""
    silent: re.Pattern[str]
    """Pattern of intact lines that hold no frame."""


_TEXTS = {
    ".log": _Text(can.CanutilsLogReader, re.compile(r"\s*$")),
    ".asc": _Text(
        can.ASCReader,
        # Many kinds of events begin with a time stamp. A line that looks like a frame has to be one.
        re.compile(
            r"\s*($|//|(date|base|((no\s+)?internal)|previous|begin|end)\b"
            r"|\d+\.\d+\s+(.*J1939|(?!\d+\s+[0-9a-f]+x?\s)(?!.*\s[RT]x\s+[dr]\s)))",
            re.IGNORECASE,
        ),
    ),
    ".trc": _Text(can.TRCReader, re.compile(r"\s*($|;|.*\s(ST|EC|ER|EV|Warng|Error)\s)")),
}


class _Lines:
    """The lines of a text log as a file object, from which a reader of python-can reads."""

    def __init__(self, stream: Iterator[str], silent: re.Pattern[str]) -> None:
        self._stream = stream
        self._silent = silent
        self._offered = 0
        """How often the reader got the current line without returning a frame for it; 0: the line is finished."""
        self.line = ""
        self.number = 0
        self.bad: list[int] = []
        """Numbers of the lines that should hold a frame but do not."""
        self.cut = False
        """Whether the last line lacks its line end."""
        self.begun = False
        """Whether a Begin TriggerBlock of an .asc file has no End TriggerBlock yet."""
        self.over = False

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        """The next line. A line that gave no frame is given twice, because the .asc reader skips the one after a
        header."""
        if self._offered == 2:
            self.refuse()
        if self._offered:
            self._offered += 1
            return self.line
        self._advance()
        while "\0" in self.line:  # a disk returns zeros for a lost sector, which joins the lines on both sides
            self.bad.append(self.number)
            self._advance()
        silent = self._silent.match(self.line) is not None
        self.cut = not self.line.endswith("\n") and not silent
        self.over = not self.line or self.cut
        if self.over:
            raise StopIteration
        self._offered = 0 if silent else 1
        words = self.line.lower().split(maxsplit=2)
        if words[1:2] == ["triggerblock"]:
            self.begun = words[0] == "begin"
        return self.line

    def _advance(self) -> None:
        self.line = next(self._stream, "")
        self.number += 1

    def answer(self) -> None:
        """Record that the line gave a frame."""
        self._offered = 0

    def refuse(self) -> None:
        """Record that the line gave no frame although it should."""
        if not self.over:
            self.bad.append(self.number)
        self._offered = 0

    def close(self) -> None:
        """Do nothing; readers of python-can close their file."""


def _text(path: Path, damage: list[str]) -> Iterator[can.Message]:
    """Read line by line. After a line that it cannot read, the reader continues with the next and keeps the header."""
    kind = _TEXTS[path.suffix.lower()]
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        lines = _Lines(stream, kind.silent)
        reader = kind.reader(lines)
        while not lines.over:
            try:
                for message in reader:
                    if not 0 <= message.arbitration_id < _NO_IDENTIFIER:
                        lines.refuse()
                        continue
                    lines.answer()
                    error = kind.reader is can.CanutilsLogReader and _CANDUMP_ERROR.match(lines.line)
                    if error:
                        message.is_error_frame = True
                        message.arbitration_id = int(error[1], 16) % _NO_IDENTIFIER
                    yield message
            except Exception:  # each reader raises different errors
                lines.refuse()
    if lines.bad:
        others = f" nor in {counted(len(lines.bad) - 1, 'line')} after it" if len(lines.bad) > 1 else ""
        damage.append(f"has no frame in line {lines.bad[0]:,}{others}")
    if lines.cut:
        damage.append(f"ends in the middle of line {lines.number:,}, which is left out")
    elif lines.begun:
        damage.append("ends without its end mark, End TriggerBlock")


_MARK = b"LOBJ"
_CONTAINER, _FRAMES = 10, frozenset({1, 73, 86, 100, 101})
"""Types of objects: a container, and the objects that python-can converts to messages."""
_SLACK = 8
"""Objects are padded; the next one begins within that many bytes."""
_HEADER = struct.Struct("<4sL8xQ8xL")
"""Header of the file: mark, size of the header, size of the file, number of objects."""
_OBJECT = struct.Struct("<4sHHLL")
"""Header of every object: mark, size of the header, its version, size of the object, type."""
_METHOD = struct.Struct("<H6xL4x")
"""Fields after the header of a container: compression (0: stored, 2: zlib), size of the content."""
_HEADER_SIZE = 144
_STORED = 0
_BATCH = 100_000
"""Number of objects decoded at once; the size of a container is limited to a 32-bit number."""


@dataclass(frozen=True)
class _Object:
    """Position of an object, recognised by its mark, in a .blf or in the content of its containers."""

    begin: int
    end: int
    """End of the object; for an incomplete one the position of the next mark, or the end of the data."""
    kind: int
    whole: bool
    """Whether the next object begins where this one ends."""


def _objects(data: bytes | bytearray) -> Iterator[_Object]:
    """All objects. After a damaged object the search continues at the next mark."""
    begin = data.find(_MARK)
    while 0 <= begin <= len(data) - _OBJECT.size:
        *_, size, kind = _OBJECT.unpack_from(data, begin)
        end = begin + size
        following = data.find(_MARK, end, end + _SLACK)
        whole = size >= 2 * _OBJECT.size and (following >= 0 or 0 <= len(data) - end < _SLACK)
        if not whole:
            following = data.find(_MARK, begin + len(_MARK))
            end = following if following >= 0 else len(data)
        yield _Object(begin, end, kind, whole)
        begin = following


def _unpack(data: bytes, container: _Object) -> tuple[bytes, bool]:
    """The content of a container, and whether it is complete."""
    inside = container.begin + _OBJECT.size
    if container.end < inside + _METHOD.size:
        return b"", False
    method, size = _METHOD.unpack_from(data, inside)
    content = data[inside + _METHOD.size : container.end]
    if method == _STORED:
        # for a damaged container this is the part before the first mark in it; the objects after it are found by their
        # marks
        return (content, container.whole) if not container.whole or len(content) >= size else (b"", False)
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(content)
    except zlib.error:
        return b"", False
    cut = not container.whole and container.end == len(data)
    return (content, stream.eof) if stream.eof or cut else (b"", False)  # the checksum stands at the end


def _decode(objects: Sequence[bytes]) -> Iterator[can.Message]:
    """Decode objects to messages with python-can, from a file in memory that is neither compressed nor damaged."""
    for first in range(0, len(objects), _BATCH):
        content = b"".join(objects[first : first + _BATCH])
        container = _OBJECT.pack(_MARK, _OBJECT.size, 1, _OBJECT.size + _METHOD.size + len(content), _CONTAINER)
        file = _HEADER.pack(b"LOGG", _HEADER_SIZE, 0, 0).ljust(_HEADER_SIZE, b"\0") + container
        yield from can.BLFReader(BytesIO(file + _METHOD.pack(_STORED, len(content)) + content))


def _blf(path: Path, damage: list[str]) -> Iterator[can.Message]:
    """Read container by container and object by object; damaged ones are skipped, and the following ones are read."""
    data = path.read_bytes()
    mark, start, length, count = _HEADER.unpack(data[: _HEADER.size].ljust(_HEADER.size, b"\0"))
    if mark != b"LOGG":
        damage.append("does not begin with the header of a .blf")
        start = length = count = 0
    pieces = [bytearray()]  # of the content; within a piece objects may extend from one container into the next
    bad: list[int] = []
    containers = 0
    entries = list(_objects(data))
    if entries and entries[0].begin >= start + _SLACK:
        bad.append(start)
    for entry in entries:
        content, complete = data[entry.begin : entry.end] if entry.whole else b"", entry.whole
        if entry.kind == _CONTAINER:
            content, complete = _unpack(data, entry)
            containers += 1
        pieces[-1] += content
        if not (complete and entry.whole):
            bad.append(entry.begin)
            pieces.append(bytearray())
    found = [(piece, entry) for piece in pieces for entry in _objects(piece)]
    sound = [bytes(piece[entry.begin : entry.end]) for piece, entry in found if entry.whole]
    frames = sum(entry.whole and entry.kind in _FRAMES for _, entry in found)
    read = 0
    for message in _decode(sound):
        read += 1
        yield message
    if bad:
        others = f" and in {counted(len(bad) - 1, 'place')} after it" if len(bad) > 1 else ""
        damage.append(f"is damaged in the object at byte {bad[0]:,}{others}")
    torn = sum(not entry.whole for _, entry in found) + frames - read
    if torn and not bad:
        damage.append(f"holds only a part of {counted(torn, 'object')}")
    if count > len(found) + containers:  # some writers count the containers as well
        damage.append(f"counts {count:,} objects in its header, but {len(sound):,} can be read")
    if length > len(data):
        damage.append(f"is {len(data):,} bytes long, but its header states {length:,}")
    elif 0 < length <= start < len(data):
        damage.append("has a header that was never completed: its recorder was killed, and the end may be missing")


def _convert(source: Path, target: Path) -> str:
    """Run python-can's converter in a separate process. Returns its error, or "" if it succeeded."""
    command = [sys.executable, "-m", "can.logconvert", str(source.absolute()), str(target)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False)
    reported = re.search(r"^[\w.]+(Error|Exception): .*", done.stderr, re.MULTILINE)
    return "" if done.returncode == 0 else reported[0] if reported else f"exit code {done.returncode}"


def _mf4(path: Path, damage: list[str]) -> Iterator[can.Message]:
    """Read as far as asammdf can. Damaged files may crash it, so it runs in a separate process and writes a .blf."""
    read = 0
    with TemporaryDirectory() as folder:
        target = Path(folder, "run.blf")
        death = _convert(path, target)
        if target.exists():
            for message in _blf(target, []):
                read += 1
                yield message
    if death:
        damage.append(f"cannot be read beyond frame {read:,}, where asammdf fails ({death})")


@contextmanager
def silence() -> Iterator[None]:
    """Suppress what libraries log about what they cannot read; the damage is reported by their callers."""
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        yield
    finally:
        logging.disable(level)


def messages(path: Path, damage: list[str]) -> Iterator[can.Message]:
    """The readable messages of a log, in file order. After the last, `damage` lists what is missing: "ends in …".

    Only compressed parts have a checksum. Errors inside a frame elsewhere are left for the receiver to detect.
    """
    suffix = path.suffix.lower()
    with silence():
        yield from (_blf if suffix == ".blf" else _mf4 if suffix == ".mf4" else _text)(path, damage)

# SPDX-License-Identifier: MIT
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

import can

from zygos.can.texts import text_messages
from zygos.files import inputs
from zygos.files.output import counted

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
    command = [sys.executable, "-m", "can.logconvert", str(source), str(target)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False)
    reported = re.search(r"^[\w.]+(Error|Exception): .*", done.stderr, re.MULTILINE)
    return "" if done.returncode == 0 else reported[0] if reported else f"exit code {done.returncode}"


def _mf4(path: Path, damage: list[str]) -> Iterator[can.Message]:
    """Read as far as asammdf can. Damaged files may crash it, so it runs in a separate process and writes a .blf."""
    read = 0
    with TemporaryDirectory() as folder:
        # the converter takes the format from the suffix
        source, target = Path(folder, "run.mf4"), Path(folder, "run.blf")
        source.symlink_to(path.absolute())
        death = _convert(source, target)
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
    suffix = inputs.suffix(path)
    with silence():
        if suffix in (".blf", ".mf4"):
            yield from (_blf if suffix == ".blf" else _mf4)(inputs.local(path), damage)
        else:
            yield from text_messages(path, damage)
    if inputs.is_cut(path):
        damage.append("is compressed, and its end is missing")

# SPDX-License-Identifier: MIT
"""Records of an MCAP (https://mcap.dev/spec), also of one that is cut or damaged."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import UnsupportedCompressionError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import get_chunk_data_stream

from zygos.errors import ZygosError
from zygos.files.inputs import local
from zygos.files.output import counted

_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
"""Head of a record: its kind, and the length of what follows."""


def read_records(path: Path, damage: list[str]) -> Iterator[Schema | Channel | Message]:
    """The schemas, channels and messages of an MCAP in the order of the file, as far as they go. A damaged chunk is
    skipped, and of a cut one the beginning is read.

    damage: gets sentences about what is missing. Errors: ZygosError for a file that does not begin as an MCAP, or that
    is compressed in an unknown way.
    """
    bad: list[int] = []
    end: int | None = None
    kind = 0
    with local(path).open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ZygosError(f"{path}: does not begin as an MCAP; remedy: give the .mcap that a recorder wrote")
        for begin, kind, body, whole in _split(stream, local(path).stat().st_size):
            if kind == Opcode.CHUNK:
                content, sound = _unpacked(path, body, whole)
                for _, inner, data, complete in _split(BytesIO(content), len(content)):
                    found = _parsed(inner, data) if complete else []
                    sound &= found is not None and complete
                    yield from found or []
            else:
                found = _parsed(kind, body) if whole else []
                sound = found is not None
                yield from found or []
            if not whole:
                end = begin
            elif not sound:
                bad.append(begin)
            if kind == Opcode.DATA_END:
                break
    if bad:
        others = f" and in {counted(len(bad) - 1, 'place')} after it" if len(bad) > 1 else ""
        damage.append(f"is damaged in the record at byte {bad[0]:,}{others}")
    if end is not None:
        damage.append(f"cannot be read beyond byte {end:,}, where it is cut or damaged")
    elif kind != Opcode.DATA_END:
        damage.append("ends without its end mark, because its recorder was stopped")


def _split(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes, bool]]:
    """Place, kind and content of each record of a stream that has at most `size` bytes, and whether it is whole."""
    while head := stream.read(_HEAD.size):
        begin = stream.tell() - len(head)
        if len(head) < _HEAD.size:
            yield begin, 0, b"", False
            return
        kind, length = _HEAD.unpack(head)
        body = stream.read(min(length, size))
        yield begin, kind, body, len(body) == length
        if len(body) < length:
            return


def _parsed(kind: int, body: bytes) -> list[Any] | None:
    """The record, if it is one of those that are read; None: it is damaged."""
    stream = ReadDataStream(BytesIO(body))
    try:
        if kind == Opcode.MESSAGE:
            return [Message.read(stream, len(body))]
        if kind == Opcode.SCHEMA:
            return [Schema.read(stream)]
        return [Channel.read(stream)] if kind == Opcode.CHANNEL else []
    except Exception:  # the library raises different errors for each kind of damage
        return None


def _unpacked(path: Path, body: bytes, whole: bool) -> tuple[bytes, bool]:
    """The records in a chunk, and whether they are undamaged. Of a cut chunk it is what can be unpacked."""
    try:
        chunk = Chunk.read(ReadDataStream(BytesIO(body)))
        if whole:
            stream, length = get_chunk_data_stream(chunk, validate_crc=True)
            return stream.read(length), True
        if chunk.compression == "zstd":
            return zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data), True
        if chunk.compression == "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data), True
        return chunk.data, True
    except UnsupportedCompressionError as error:
        raise ZygosError(f"{path}: {error}; remedy: compress it with zstd (`mcap compress`)") from None
    except Exception:  # each library raises different errors for each kind of damage
        return b"", False

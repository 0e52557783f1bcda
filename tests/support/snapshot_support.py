"""What a snapshot is, once more and without the library: the head by struct, the CRC by the package crc32c."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import crc32c

HEAD = struct.Struct("<8sHBBIII")
MAGIC = b"\x89zygos\r\n"


def sealed(kind: int, image: bytes, layout: int, *, form: int = 1, order: int = 1, magic: bytes = MAGIC) -> bytes:
    """Head and image, as docs/snapshot.md has them."""
    bare = HEAD.pack(magic, form, kind, order, layout, len(image), 0)[:20]
    return bare + struct.pack("<I", crc32c.crc32c(bare + image)) + image


def struct_texts(headers: list[Path]) -> str:
    """The text of all structs of headers in the order of their names: no comments, single spaces."""
    structs = {}
    for header in headers:
        text = re.sub(r"/\*.*?\*/|//[^\n]*", " ", header.read_text(), flags=re.S)
        for body, name in re.findall(r"^typedef struct (\{.*?^\}) (\w+);", text, re.S | re.M):
            structs[name] = " ".join(body.split())
    return "\n".join(f"{name} {body}" for name, body in sorted(structs.items()))


def layout_digest(headers: list[Path]) -> int:
    """What ZYGOS_LAYOUT must be."""
    return zlib.crc32(struct_texts(headers).encode())

# SPDX-License-Identifier: MIT
"""What a snapshot is, once more and without the library: the head by struct, the CRC by the package crc32c."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import crc32c

HEAD = struct.Struct("<8sHBBIII")
MAGIC = b"\x89zygos\r\n"
STRUCTS = tuple(f"zygos_{name}_t".replace("__", "_") for name in ("", "config", "work", "estimate", "cycle", "frame"))
"""What library and caller exchange: the structs of which ZYGOS_ABI knows the sizes."""


def sealed(kind: int, image: bytes, layout: int, *, form: int = 1, order: int = 1, magic: bytes = MAGIC) -> bytes:
    """Head and image, as docs/snapshot.md has them."""
    bare = HEAD.pack(magic, form, kind, order, layout, len(image), 0)[:20]
    return bare + struct.pack("<I", crc32c.crc32c(bare + image)) + image


def layout_of(binding: Any, kind: Any) -> str:
    """Offsets and types of all that a type of cffi consists of, without a name."""
    if kind.kind == "struct":
        inside = (f"{field.offset}:{layout_of(binding, field.type)}" for _, field in kind.fields)
        return f"{{{','.join(inside)}}}{binding.sizeof(kind)}"
    if kind.kind == "array":
        return f"{layout_of(binding, kind.item)}[{kind.length}]"
    return str(kind.cname) if kind.kind == "primitive" else str(kind.kind)


def layout_digest(binding: Any, structs: tuple[str, ...] = STRUCTS) -> int:
    """What ZYGOS_LAYOUT must be."""
    return zlib.crc32("\n".join(layout_of(binding, binding.typeof(name)) for name in structs).encode())

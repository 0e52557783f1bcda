# SPDX-License-Identifier: MIT
"""Logs for the tests of logs: every format, and .blf as recorders of others write it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
from numpy.typing import NDArray

from zygos.can import bus

SMALL = 8192
"""Bytes that the containers of "small.blf" hold, before compression."""
KINDS = (".log", ".asc", ".trc", ".mf4", "small.blf", "stored.blf")
"""Of logs; the .blf are of many containers, compressed or not."""


def write(folder: Path, kind: str, frames: NDArray[Any], period_s: float, container: int = SMALL) -> Path:
    """Write frames as a log of that kind."""
    path = folder / f"run{kind}" if kind.startswith(".") else folder / kind
    if kind.startswith("."):
        bus.write_log(path, frames, period_s)
    else:
        level = 0 if kind == "stored.blf" else -1
        with can.BLFWriter(path, compression_level=level, max_container_size=container) as writer:
            for message in bus.to_messages(frames, period_s):
                message.channel = 0
                writer.on_message_received(message)
    return path


def containers(data: bytes) -> list[tuple[int, int]]:
    """Begin and end of the containers of a sound .blf, by their stated sizes."""
    out, at = [], int.from_bytes(data[4:8], "little")
    while at < len(data):
        size = int.from_bytes(data[at + 8 : at + 12], "little")
        out.append((at, at + size))
        at += size + size % 4
    return out

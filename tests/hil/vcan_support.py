"""The channel of these tests, and who listens on it."""

from __future__ import annotations

import os
import time
from pathlib import Path

CHANNEL = os.environ.get("ZYGOS_VCAN_IFS", "vcan0").split()[0]


def listeners() -> int:
    """Sockets that hear every frame on the channel."""
    return Path("/proc/net/can/rcvlist_all").read_text(encoding="ascii").count(f"\n   {CHANNEL} ")


def wait_for_listeners(count: int) -> None:
    deadline = time.monotonic() + 60.0  # a guest in emulation takes long to start a process
    while listeners() < count:
        assert time.monotonic() < deadline, "nobody listens"
        time.sleep(0.05)

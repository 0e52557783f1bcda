# SPDX-License-Identifier: MIT
"""The channel of these tests, who listens on it, and candump as a foreign recorder."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from zygos.can.vcan import kernel_counts

CHANNEL = os.environ.get("ZYGOS_VCAN_IFS", "vcan0").split()[0]
GUEST = "User Mode Linux" in Path("/proc/cpuinfo").read_text(encoding="ascii")
"""Whether the kernel is a guest, whose system calls take many times as long."""
ROOM = "400000000"
"""Bytes of what candump has yet to take; one processor has the sender, the device and candump to run."""


def listeners() -> int:
    """Sockets that hear every frame on the channel."""
    return Path("/proc/net/can/rcvlist_all").read_text(encoding="ascii").count(f"\n   {CHANNEL} ")


def wait_for_listeners(count: int) -> None:
    deadline = time.monotonic() + 180.0  # a guest in emulation takes long to start a process
    while listeners() < count:
        assert time.monotonic() < deadline, "nobody listens"
        time.sleep(0.05)


@contextmanager
def candump(channel: str, log: Path) -> Iterator[None]:
    """Record all that is on the channel meanwhile: at the end, as many frames as the kernel has counted."""
    already = listeners()
    with log.open("wb") as file:
        recorder = subprocess.Popen(["stdbuf", "-oL", "candump", "-L", "-r", ROOM, channel], stdout=file)
        try:
            wait_for_listeners(already + 1)
            before = kernel_counts(channel)
            yield
            deadline = time.monotonic() + 30.0
            while log.read_bytes().count(b"\n") < (kernel_counts(channel) - before).sent:
                assert time.monotonic() < deadline, "candump has not recorded every frame"
                time.sleep(0.05)
        finally:
            recorder.kill()
            recorder.wait()

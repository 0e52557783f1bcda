# SPDX-License-Identifier: MIT
"""Frames per second into the library from Python, side by side on one machine: through cffi, and through a vcan.

    tools/with-vcan python -m bench.throughput FILE

Lone times say little; their ratio says what python-can and the kernel's bus cost beside the library.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.configurations import CONFIGURATIONS, random_cycles
from zygos.can.bus import from_messages, to_messages
from zygos.can.vcan import transfer
from zygos.files.output import write_json
from zygos.native.flight import Flight, encode

CYCLES = 1500
LEAST_S = 2.0
"""A guest's clock is coarse."""
CHANNEL = os.environ.get("ZYGOS_VCAN_IFS", "vcan0").split()[0]


def measure() -> dict[str, float]:
    """Frames per second of the paper's arm, by the way that they take. Without a vcan that way is left out."""
    arm = CONFIGURATIONS["paper"]().arm
    frames = encode(arm, random_cycles(arm, CYCLES))
    messages = to_messages(frames, arm.period_s)

    def rate(way: Callable[[Flight], object]) -> float:
        flight, rounds, begin = Flight(arm), 0, time.perf_counter()
        while (took := time.perf_counter() - begin) < LEAST_S:
            way(flight)
            rounds += 1
        assert flight.counts["cycles"] >= rounds * CYCLES
        return rounds * len(frames) / took

    ways: dict[str, Callable[[Flight], object]] = {
        "cffi, a recording in one call": lambda flight: flight.frames(frames),
        "python-can messages, without a bus": lambda flight: flight.frames(from_messages(messages)),
    }
    if (Path("/sys/class/net") / CHANNEL).exists():
        ways["vcan, from python-can to a socket"] = lambda flight: flight.frames(
            from_messages(transfer(messages, CHANNEL))
        )
    return {name: rate(way) for name, way in ways.items()}


if __name__ == "__main__":
    write_json(Path(sys.argv[1]), measure())

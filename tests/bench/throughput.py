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
from zygos.bus import from_messages, to_messages
from zygos.flight import Flight, encode
from zygos.output import write_json
from zygos.vcan import transfer

CYCLES = 1500
LEAST_S = 2.0
CHANNEL = os.environ.get("ZYGOS_VCAN_IFS", "vcan0").split()[0]


def measure() -> dict[str, float]:
    """Frames per second of the paper's arm, by the way that they take."""
    arm = CONFIGURATIONS["paper"]().arm
    frames = encode(arm, random_cycles(arm, CYCLES))
    messages = to_messages(frames, arm.period_s)

    def rate(way: Callable[[Flight], object]) -> float:
        rounds, begin = 0, time.perf_counter()
        while (took := time.perf_counter() - begin) < LEAST_S:  # a guest's clock is coarse
            flight = Flight(arm)
            way(flight)
            assert flight.counts["cycles"] == CYCLES
            rounds += 1
        return rounds * len(frames) / took

    return {
        "cffi, a recording in one call": rate(lambda flight: flight.frames(frames)),
        "python-can messages, without a bus": rate(lambda flight: flight.frames(from_messages(messages))),
        "vcan, from python-can to a socket": rate(
            lambda flight: flight.frames(from_messages(transfer(messages, CHANNEL)))
        ),
    }


if __name__ == "__main__":
    write_json(Path(sys.argv[1]), measure())

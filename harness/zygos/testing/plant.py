# SPDX-License-Identifier: MIT
"""The plant of a test bench: simulates the arm; a separate process sends its frames on the bus."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from zygos.arm import Arm, load_arm
from zygos.can.wire import ERROR, EXTENDED, REMOTE
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import Scenario
from zygos.testing.stream import Stream

Pace = Literal["fast", "real", "flood"]
"""fast: as the device under test answers. real: each cycle at its time. flood: at once, even if frames are lost."""

_SENDER = Path(__file__).with_name("sender.py")
_RECORD = struct.Struct("=dIB3x8s")
_WORD = {EXTENDED: 1 << 31, REMOTE: 1 << 30, ERROR: 1 << 29}
"""Flags of a frame, as in the identifiers of SocketCAN."""


@dataclass(frozen=True)
class Sent:
    """How a stream was sent."""

    frames: int
    seconds: float
    latest_s: float
    """Largest delay of a frame at real-time pace, s."""


@dataclass(frozen=True)
class Plant:
    """An arm that moves according to its scenario, on a SocketCAN channel."""

    scenario: Scenario
    channel: str
    patience_s: float = 20.0
    """Longest time that the device may take for an answer, s; an emulated device is slow."""

    @cached_property
    def arm(self) -> Arm:
        """The arm of the scenario."""
        return load_arm(self.scenario.arm)

    @cached_property
    def _cycles(self) -> Cycles:
        return simulate(self.arm, load_model(self.scenario.plant), self.scenario).cycles()

    def run(self, cycles: int | None = None) -> Stream:
        """The first cycles of the scenario, by default all; the simulation is done only once.

        Errors: ZygosError if the scenario is shorter, or cannot be simulated.
        """
        longest = len(self._cycles)
        if cycles is not None and not 1 <= cycles <= longest:
            raise ZygosError(f"scenario {self.scenario.name} has {longest} cycles; remedy: ask for at most that many")
        wanted = slice(0, cycles)
        return Stream.of(self.arm, Cycles(*(getattr(self._cycles, name)[wanted] for name in _FIELDS)))

    def send(self, stream: Stream, pace: Pace = "fast", hurry: float = 1.0) -> Sent:
        """Send a stream on the bus from a separate process, and wait for its end.

        hurry: how many times as fast as in reality the cycles follow each other at pace "real", which begins with the
        first frame of the stream.

        At pace "fast" that is when the device has answered the last SYNC, or sends no more. An answer is a telemetry
        frame with the counter of a SYNC; at least one in fifteen SYNCs must have one.

        Errors: ZygosError if there is no such channel, if it refuses a frame, or if no answer comes.
        """
        command = [sys.executable, "-I", str(_SENDER), self.channel, pace, str(self.patience_s)]
        done = subprocess.run(command, input=_packed(stream, hurry), capture_output=True, check=False)
        if done.returncode:
            message = done.stderr.decode(errors="replace").strip().splitlines()
            raise ZygosError(
                f"{self.channel}: {message[-1] if message else 'the sender ended'}; remedy: check that the interface "
                "is up and that the device under test answers, or send at another pace"
            )
        return Sent(**json.loads(done.stdout))


_FIELDS = tuple(Cycles.__dataclass_fields__)


def _packed(stream: Stream, hurry: float) -> bytes:
    """Input of the sender: the time of each frame since the first one, and the frame in the form of SocketCAN."""
    due_s = (stream.due_s() - stream.due_s()[:1]) / hurry
    words = stream.frames["id"].astype(np.uint32)
    for flag, bit in _WORD.items():
        words |= np.where(stream.frames["flags"] & flag, np.uint32(bit), np.uint32(0))
    return b"".join(
        _RECORD.pack(due, word, frame["length"], bytes(frame["data"]))
        for due, word, frame in zip(due_s, words, stream.frames, strict=True)
    )

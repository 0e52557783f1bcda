"""The plant of a bench: simulates the arm, and lets a process of its own put the frames on the bus."""

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
"""fast: as the device under test answers. real: each cycle when it is due. flood: at once, whatever is lost."""

_SENDER = Path(__file__).with_name("sender.py")
_RECORD = struct.Struct("=dIB3x8s")
_WORD = {EXTENDED: 1 << 31, REMOTE: 1 << 30, ERROR: 1 << 29}
"""Flags of a frame, as SocketCAN has them in its identifier."""


@dataclass(frozen=True)
class Sent:
    """How a stream went out."""

    frames: int
    seconds: float
    latest_s: float
    """At real-time pace, how late the latest frame was."""


@dataclass(frozen=True)
class Plant:
    """An arm that moves as its scenario says, on a SocketCAN channel."""

    scenario: Scenario
    channel: str
    patience_s: float = 20.0
    """How long the device may take for an answer. A guest in emulation is slow."""

    @cached_property
    def arm(self) -> Arm:
        """The arm of the scenario."""
        return load_arm(self.scenario.arm)

    @cached_property
    def _cycles(self) -> Cycles:
        return simulate(self.arm, load_model(self.scenario.plant), self.scenario).cycles()

    def run(self, cycles: int | None = None) -> Stream:
        """The first cycles of the scenario, by default all of it; what was simulated once is kept.

        Errors: ZygosError if the scenario is shorter, or cannot be simulated.
        """
        longest = len(self._cycles)
        if cycles is not None and not 1 <= cycles <= longest:
            raise ZygosError(f"scenario {self.scenario.name} has {longest} cycles; remedy: ask for no more than that")
        wanted = slice(0, cycles)
        return Stream.of(self.arm, Cycles(*(getattr(self._cycles, name)[wanted] for name in _FIELDS)))

    def send(self, stream: Stream, pace: Pace = "fast") -> Sent:
        """Put a stream on the bus, from a process of its own, and wait for the end of it.

        At pace "fast" that is when the device has answered the last SYNC, or says no more. An answer is a telemetry
        frame with the counter of a SYNC; at the latest each fifteenth SYNC must have one.

        Errors: ZygosError if there is no such channel, if it refuses a frame, or if no answer comes.
        """
        command = [sys.executable, "-I", str(_SENDER), self.channel, pace, str(self.patience_s)]
        done = subprocess.run(command, input=_packed(stream), capture_output=True, check=False)
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().splitlines()
            raise ZygosError(
                f"{self.channel}: {said[-1] if said else 'the sender ended'}; remedy: see whether the interface is up "
                "and the device under test answers, or send at another pace"
            )
        return Sent(**json.loads(done.stdout))


_FIELDS = tuple(Cycles.__dataclass_fields__)


def _packed(stream: Stream) -> bytes:
    """What the sender reads: when each frame is due, and the frame as SocketCAN takes it."""
    words = stream.frames["id"].astype(np.uint32)
    for flag, bit in _WORD.items():
        words |= np.where(stream.frames["flags"] & flag, np.uint32(bit), np.uint32(0))
    return b"".join(
        _RECORD.pack(due, word, frame["length"], bytes(frame["data"]))
        for due, word, frame in zip(stream.due_s(), words, stream.frames, strict=True)
    )

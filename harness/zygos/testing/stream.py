"""Frames of a run, each with the cycle that it tells of: what a plant sends and what faults are made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can import bus
from zygos.can.wire import identifiers
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles

SYNC = 0x080
"""Identifier of SYNC."""


@dataclass(frozen=True)
class Stream:
    """n frames of an arm in the order in which they are sent."""

    arm: Arm
    frames: NDArray[Any]
    """(n,) `zygos.native.flight.FRAME` records."""
    cycle: NDArray[np.int64]
    """(n,) the cycle that each frame tells of, from 0; a frame that somebody else sends has that in which it comes."""

    @classmethod
    def of(cls, arm: Arm, cycles: Cycles) -> Stream:
        """Encode a run. Behind its n cycles comes the SYNC of cycle n, which closes the last one."""
        return cls.recorded(arm, encode(arm, cycles))

    @classmethod
    def recorded(cls, arm: Arm, frames: NDArray[Any]) -> Stream:
        """Frames as they were on a bus, `FRAME` records (n,): each SYNC begins a cycle, good or not."""
        return cls(arm, frames, np.maximum(np.cumsum(frames["id"] == SYNC) - 1, 0))

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def through(self, *faults: Fault) -> Stream:
        """What is left of it behind these faults, one after the other."""
        stream = self
        for fault in faults:
            stream = fault(stream)
        return stream

    def part(self, first: int, stop: int | None = None) -> Stream:
        """The frames that are sent from the SYNC of cycle `first` on and before that of cycle `stop`."""
        now = self._now()
        inside = (now >= first) & (now < (len(self) if stop is None else stop))
        return Stream(self.arm, self.frames[inside], self.cycle[inside])

    def __add__(self, other: Stream) -> Stream:
        """One stream behind the other."""
        return Stream(self.arm, np.concatenate([self.frames, other.frames]), np.concatenate([self.cycle, other.cycle]))

    def due_s(self) -> NDArray[np.float64]:
        """When each frame is due at real-time pace, in seconds since cycle 0: with the SYNC before it."""
        due: NDArray[np.float64] = self._now().astype(np.float64) * self.arm.period_s
        return due

    def ours(self) -> NDArray[np.bool_]:
        """(n,) which frames bear an identifier of the arm."""
        ours: NDArray[np.bool_] = np.isin(self.frames["id"], list(identifiers(self.arm)))
        ours &= self.frames["flags"] == 0
        return ours

    def messages(self) -> list[can.Message]:
        """The frames as python-can's messages, stamped with the time at which they are due."""
        messages = bus.to_messages(self.frames, self.arm.period_s)
        for message, due in zip(messages, self.due_s(), strict=True):
            message.timestamp = float(due)
        return messages

    def _now(self) -> NDArray[np.int64]:
        """(n,) the cycle in which each frame is sent: late frames tell of one before."""
        now: NDArray[np.int64] = np.maximum.accumulate(self.cycle)
        return now


Fault = Callable[[Stream], Stream]
"""What happens to a stream. Faults are made by `zygos.testing.faults`; any function of a stream will do."""

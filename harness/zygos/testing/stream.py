# SPDX-License-Identifier: MIT
"""Frames of a run, each with the cycle whose data it carries: a plant sends them, and faults change them."""

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
_ERROR = 4
"""Of a frame's flags: it tells of an error on the bus."""


@dataclass(frozen=True)
class Stream:
    """n frames of an arm in the order in which they are sent."""

    arm: Arm
    frames: NDArray[Any]
    """(n,) `zygos.native.flight.FRAME` records."""
    cycle: NDArray[np.int64]
    """(n,) the cycle whose data each frame carries, from 0; for a foreign frame the cycle in which it is sent."""

    @classmethod
    def of(cls, arm: Arm, cycles: Cycles) -> Stream:
        """Encode a run. After its n cycles comes the SYNC of cycle n, which closes the last one."""
        return cls.recorded(arm, encode(arm, cycles))

    @classmethod
    def recorded(cls, arm: Arm, frames: NDArray[Any]) -> Stream:
        """Frames as recorded on a bus, `FRAME` records (n,): each SYNC begins a cycle, valid or not."""
        return cls(arm, frames, np.maximum(np.cumsum(frames["id"] == SYNC) - 1, 0))

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def through(self, *faults: Fault) -> Stream:
        """The stream after these faults, applied one after the other."""
        stream = self
        for fault in faults:
            stream = fault(stream)
        return stream

    def part(self, first: int, stop: int | None = None) -> Stream:
        """The frames that are sent from the SYNC of cycle `first` until before that of cycle `stop`."""
        now = self._now()
        inside = (now >= first) & (now < (len(self) if stop is None else stop))
        return Stream(self.arm, self.frames[inside], self.cycle[inside])

    def __add__(self, other: Stream) -> Stream:
        """One stream followed by the other."""
        return Stream(self.arm, np.concatenate([self.frames, other.frames]), np.concatenate([self.cycle, other.cycle]))

    def due_s(self) -> NDArray[np.float64]:
        """Time of each frame at real-time pace, in seconds since cycle 0: that of the SYNC before it."""
        due: NDArray[np.float64] = self._now().astype(np.float64) * self.arm.period_s
        return due

    def ours(self) -> NDArray[np.bool_]:
        """(n,) whether each frame has an identifier of the arm."""
        ours: NDArray[np.bool_] = np.isin(self.frames["id"], list(identifiers(self.arm)))
        ours &= self.frames["flags"] == 0
        return ours

    def passed(self) -> NDArray[Any]:
        """The frames that pass the filters of a device: those with an identifier of the arm, and error frames."""
        passed: NDArray[Any] = self.frames[self.ours() | ((self.frames["flags"] & _ERROR) != 0)]
        return passed

    def messages(self) -> list[can.Message]:
        """The frames as python-can's messages, stamped with the time at which they are to be sent."""
        messages = bus.to_messages(self.frames, self.arm.period_s)
        for message, due in zip(messages, self.due_s(), strict=True):
            message.timestamp = float(due)
        return messages

    def _now(self) -> NDArray[np.int64]:
        """(n,) the cycle in which each frame is sent: late frames carry data of an earlier one."""
        now: NDArray[np.int64] = np.maximum.accumulate(self.cycle)
        return now


Fault = Callable[[Stream], Stream]
"""A change of a stream. `zygos.testing.faults` makes such functions; any function of a stream can be used."""

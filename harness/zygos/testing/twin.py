# SPDX-License-Identifier: MIT
"""What zygos-node does with frames, in this process: the loop of the flight library, and when an estimate is due."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import Effect
from zygos.errors import ZygosError
from zygos.native import flight, snapshot
from zygos.native.flight import FRAME, Flight

HEAD = 24
"""Bytes before the image of a snapshot."""


class Event(Enum):
    """What a twin stops at, in the order in which it happens behind a frame."""

    ANSWER = "a new estimate"
    JUDGED = "the verdict on the refinement that belongs to it"
    SYNC = "a SYNC was accepted"


@dataclass
class Answer:
    """An estimate, and what was counted when it came."""

    estimate: Any
    """``zygos_estimate_t *``, a copy."""
    faults: dict[str, int]
    counts: dict[str, int]
    """With the arcs."""
    corrupt: int
    """Number of times that memory was found changed."""
    syncs: int
    """Number of SYNCs that the twin had accepted before."""
    refined: Any = None
    """``zygos_refined_t *``, a copy, once the refinement was judged by this estimate."""


class Twin(Flight):
    """A flight whose `native` is the state of a ``zygos_t``. Frames come in by `hear` or `events` alone."""

    def __init__(
        self,
        arm: Arm,
        effects: Sequence[Effect] = (),
        *,
        every: int = 100,
        save_every: int = 0,
        refine: float | None = None,
    ) -> None:
        """The options are those of zygos-node.

        Errors: ZygosError as `Flight`, and if the arm cannot be refined.
        """
        super().__init__(arm, effects)
        self.every, self.save_every, self._refine = every, save_every, refine
        self.config = flight.config_of(arm, effects)
        self._compiled = bytes(flight.ffi.buffer(self.config))
        self.loop = flight.ffi.new("zygos_t *")
        self.native = flight.ffi.addressof(self.loop, "state")
        self.answers: list[Answer] = []
        self.saved = b""
        """The newest state that was saved."""
        self.syncs = 0
        """Number of SYNCs that were accepted since the start."""
        self.corrupt = 0
        """Number of times that memory was found changed."""
        self._noticed = 0
        self._memory = flight.ffi.new("zygos_background_t *")
        self._newest = flight.ffi.new("zygos_estimate_t *")
        self._fine = flight.ffi.new("zygos_refine_t *")
        self._wanted = False
        self._judged = True
        self._begin(b"")

    def _begin(self, stored: bytes) -> None:
        size = flight.ffi.sizeof(self._memory[0])
        if stored:
            flight.ffi.memmove(self.native, stored[HEAD:], flight.ffi.sizeof("zygos_arm_t"))
            verdict = flight.lib.zygos_resume(self.loop, self.config, self._memory, size, stored[:HEAD], len(stored))
        else:
            verdict = flight.lib.zygos_init(self.loop, self.config, self._memory, size)
        self._noticed, self._judged = 0, True
        self._counter = int(self.native.receiver.assembly.counter)
        if verdict == 1 and self._refine is not None:
            settings = flight.ffi.new("zygos_refine_settings_t *")
            flight.lib.zygos_refine_defaults(settings, self.config)
            for i in range(self.arm.n):
                settings.filter.torque_relative_sigma[i] = self._refine
            verdict = flight.lib.zygos_refine(self.loop, self._fine, settings, 0)
        if verdict != 1:
            reason = flight.text_of(flight.lib.zygos_text, verdict)
            raise ZygosError(f"arm {self.arm.name!r} does not begin: {reason}; remedy: read include/zygos/zygos.h")

    def resume(self, path: Path) -> None:
        """Continue with a stored state, as zygos-node at its start. Errors: ZygosError where it cannot be used."""
        snapshot.read(path, "state")  # whose errors name the file
        self.saved = path.read_bytes()
        self._begin(self.saved)

    def seal(self) -> bytes:
        """The file that zygos-node saves. Errors: ZygosError where memory is beyond repair."""
        head = flight.ffi.new("uint8_t[]", HEAD)
        verdict = flight.lib.zygos_seal(self.loop, head)
        if verdict != 1:
            raise ZygosError(
                f"the state is not sealed: {flight.text_of(flight.lib.zygos_text, verdict)}; remedy: start again"
            )
        self.saved = bytes(flight.ffi.buffer(head)) + bytes(flight.ffi.buffer(self.native))
        return self.saved

    def hear(self, frames: NDArray[Any]) -> None:
        """Feed `FRAME` records."""
        for _ in self.events(frames):
            pass

    def events(self, frames: NDArray[Any]) -> Iterator[Event]:
        """Feed `FRAME` records; pauses whenever something happens that the telemetry tells."""
        frames = np.ascontiguousarray(frames, dtype=FRAME)
        pointer = flight.ffi.cast("zygos_frame_t *", frames.ctypes.data)
        for k in range(len(frames)):
            before, more = self.syncs, flight.lib.zygos_frame(self.loop, pointer + k) != 0
            while more:
                stepped = flight.lib.zygos_step(self.loop)
                self._heal(stepped)
                yield from self.told()
                more = stepped == 1 or self._wanted
            if self.save_every and self.syncs != before and self.syncs % self.save_every == 0:
                self.seal()

    def _heal(self, returned: int) -> None:
        """What zygos-node does about memory that was changed: it goes back to what was saved last."""
        found = int(self.loop.repairs + self.loop.losses)
        if returned >= 0 and found == self._noticed:
            return
        self.corrupt += max(found - self._noticed, 1)
        self._noticed = found
        if returned < 0 or self.loop.losses:
            flight.ffi.memmove(self.config, self._compiled, len(self._compiled))
            self._begin(self.saved)

    def told(self) -> Iterator[Event]:
        """What the telemetry does behind each step."""
        if self._wanted and flight.lib.zygos_solve(self.loop, self._newest) == 1:
            self._wanted, self._judged = False, self._refine is None
            counts = self.counts | {"arcs": int(self.native.sums.energy.store.arcs)}
            copied = flight.ffi.new("zygos_estimate_t *", self._newest[0])
            self.answers.append(Answer(copied, self.faults, counts, self.corrupt, self.syncs))
            yield Event.ANSWER
        if not self._judged and self.loop.stage == flight.lib.ZYGOS_STAGE_IDLE:
            self._judged = True
            self.answers[-1].refined = flight.ffi.new("zygos_refined_t *", self.loop.refined)
            yield Event.JUDGED
        counter = int(self.native.receiver.assembly.counter)
        accepted = counter not in (0, self._counter)
        if accepted:
            self._wanted = self._wanted or self.syncs % self.every == 0
            self.syncs += 1
        self._counter = counter
        if accepted:
            yield Event.SYNC

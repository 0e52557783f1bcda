# SPDX-License-Identifier: MIT
"""Frames that are lost or stale on their way, and what a receiver must count of them.

The counts follow from the rules of docs/wire.md ("Assembly", "FTIME") and docs/snapshot.md ("Going on"), and from which
frames were disturbed. No frame is decoded here, and no code is shared with the C library or its numpy reference.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

SYNC, FTIME = 0x080, 0x3A0
SYNC_MODULUS, COUNTER_MODULUS = 240, 16
MOST_WITHOUT_TIME = 120
"""Cycles without FTIME before it counts as lost."""


@dataclass(frozen=True)
class Disturbed:
    """n frames of whole cycles as their senders meant them, and what became of each."""

    frames: NDArray[Any]
    """(n,) `zygos.native.flight.FRAME` records as they are sent; a stale one has the bytes of the cycle before."""
    number: NDArray[np.int64]
    """(n,) number of the cycle in which each frame is sent."""
    lost: NDArray[np.bool_]
    """(n,) frames that do not arrive."""
    stale: NDArray[np.bool_]
    """(n,) frames that arrive with the content of the cycle before, as from a node that hangs for a cycle."""

    @property
    def arriving(self) -> NDArray[Any]:
        """The frames that arrive."""
        return self.frames[~self.lost]


def disturbed(frames: NDArray[Any], first: int, lost: float, stale: float, rng: np.random.Generator) -> Disturbed:
    """Lose a share of all frames, and send a share of the frames of drives and gyro with the content of the cycle
    before.

    frames: whole cycles, each beginning with its SYNC. first: number of the first of them.
    """
    identifiers = frames["id"]
    number = first - 1 + np.cumsum(identifiers == SYNC, dtype=np.int64)
    gone = rng.random(len(frames)) < lost
    candidates = np.flatnonzero((rng.random(len(frames)) < stale) & ~gone & (number > first))
    held = np.zeros(len(frames), dtype=np.bool_)
    out = frames.copy() if len(candidates) else frames
    for at in candidates.tolist():
        if identifiers[at] in (SYNC, FTIME):
            continue
        before = at - 1
        while identifiers[before] != identifiers[at]:
            before -= 1
        out[at] = frames[before]
        held[at] = True
    return Disturbed(out, number, gone, held)


@dataclass
class Book:
    """What a receiver must have counted so far."""

    parts: int
    """Frames of drives and gyro that a cycle consists of."""
    faults: Counter[str] = field(default_factory=Counter)
    """By the names of `zygos_faults_t`."""
    cycles: int = 0
    """Complete cycles, which the library works off."""
    _number: int | None = None
    _open: bool = False
    _content: set[int] = field(default_factory=set)
    _sound: bool = True
    _timed: int | None = None

    def hear(self, sent: Disturbed) -> None:
        """Take down whole cycles that follow the ones before. Cycles of which every frame arrives as it was meant are
        counted together, all others one by one."""
        number, identifiers = sent.number, sent.frames["id"]
        begins = np.flatnonzero(identifiers == SYNC)
        ends = np.append(begins[1:], len(number))
        n, first = len(begins), int(number[0])
        singly = np.zeros(n, dtype=np.bool_)
        singly[[0, n - 1]] = True
        singly[number[sent.lost | sent.stale] - first] = True
        unopened = number[begins[sent.lost[begins]]] - first
        singly[np.clip(np.concatenate([unopened - 1, unopened + 1]), 0, n - 1)] = True
        heard = np.flatnonzero((identifiers == FTIME) & ~sent.lost)
        self._time(number[heard[~sent.lost[begins[number[heard] - first]]]])
        before = -1
        for cycle in np.flatnonzero(singly).tolist():
            if cycle > before + 1:
                self._close()
                self.cycles += cycle - before - 1
                self._number, self._open = first + cycle - 1, False
            self._cycle(sent, int(begins[cycle]), int(ends[cycle]))
            before = cycle

    def _cycle(self, sent: Disturbed, begin: int, end: int) -> None:
        """One cycle, frame by frame."""
        number = int(sent.number[begin])
        if not sent.lost[begin]:
            self._close()
            if self._number is not None and (number - self._number) % SYNC_MODULUS != 1:
                self.faults["sync_jumped"] += 1
            self._number, self._open, self._content, self._sound = number, True, set(), True
        assert self._number is not None and self._open, "the first SYNC is lost"
        for at in range(begin + 1, end):
            if sent.lost[at]:
                continue
            identifier = int(sent.frames["id"][at])
            meant = number - int(sent.stale[at])
            behind = (self._number - meant) % COUNTER_MODULUS
            if behind:
                self.faults["late" if behind == 1 else "counter"] += 1
            elif identifier == FTIME:
                continue
            elif identifier in self._content:
                self.faults["repeated"] += 1
                self._sound = False
            else:
                self._content.add(identifier)

    def _close(self) -> None:
        """The open cycle, if there is one, ends."""
        if not self._open:
            return
        complete = len(self._content) == self.parts
        self.faults["incomplete"] += not complete
        self.faults["dropped"] += not (complete and self._sound)
        self.cycles += complete and self._sound
        self._open = False

    def _time(self, heard: NDArray[np.int64]) -> None:
        """Cycles with an FTIME that is accepted."""
        if len(heard):
            whole = heard if self._timed is None else np.insert(heard, 0, self._timed)
            self.faults["time_lost"] += int(np.sum(np.diff(whole) > MOST_WITHOUT_TIME))
            self._timed = int(heard[-1])

    def resume(self) -> None:
        """The receiver goes on from a snapshot: the open cycle is lost, and counted when the next SYNC closes it."""
        self._content = set()

    def end(self) -> None:
        """One more SYNC closes the last cycle."""
        self._close()

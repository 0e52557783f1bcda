"""Whether the arm changed while it was watched: what `Flight.drift` says twice an arc, the plainest of it kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.cycles import Cycles
from zygos.flight import Drift, Flight
from zygos.remedies import Known

SYNC = 0x080
LOOKS = 2
"""In an arc: the arc behind a change stands out only until the next one takes it for known."""


class Watch:
    """Feeds a flight, and looks for a change of its arm."""

    def __init__(self, flight: Flight) -> None:
        """Nothing has come yet."""
        self.flight = flight
        self.plainest: Drift | None = None
        """The look with the largest deviation, those that prove a change before others; None where there was none."""
        self.known: list[Known] = []
        """What was known while the run grew, each entry at twice the cycles of the one before."""
        self._every = max(1, round(flight.arm.arc_max_s / flight.arm.period_s) // LOOKS)
        self._since = 0

    def frames(self, frames: NDArray[Any], progress: Callable[[float], None] | None = None) -> None:
        """Feed frames as `Flight.frames`. progress is called now and then with the share that is done."""
        starts = np.flatnonzero(frames["id"] == SYNC)
        self._feed(starts, len(frames), lambda first, last: self.flight.frames(frames[first:last]), progress)

    def cycles(self, cycles: Cycles, progress: Callable[[float], None] | None = None) -> None:
        """Feed cycles as `Flight.cycles`."""

        def feed(first: int, last: int) -> None:
            self.flight.cycles(Cycles(*(getattr(cycles, field.name)[first:last] for field in fields(Cycles))))

        self._feed(np.arange(len(cycles)), len(cycles), feed, progress)

    def _feed(
        self,
        starts: NDArray[np.intp],
        n: int,
        feed: Callable[[int, int], object],
        progress: Callable[[float], None] | None,
    ) -> None:
        """starts: where cycles begin in what is fed, of n entries."""
        first = 0
        for last in starts[self._every - self._since :: self._every]:
            feed(first, int(last))
            first = int(last)
            self.look()
            if progress:
                progress(first / n)
        feed(first, n)
        self._since = (self._since + len(starts)) % self._every

    def look(self) -> Drift | None:
        """Compare the newest arc with all before it. Returns the plainest look so far."""
        cycles = self.flight.counts["cycles"]
        if cycles > 2 * (self.known[-1].cycles if self.known else 0):
            values = self.flight.estimate().value
            self.known.append(Known(cycles, int(np.count_nonzero(np.isfinite(values)))))
        drift = self.flight.drift()
        best = (bool(self.plainest.changed), self.plainest.largest) if self.plainest else (False, 0.0)
        if (bool(drift.changed), drift.largest) > best:
            self.plainest = drift
        return self.plainest

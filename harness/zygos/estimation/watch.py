# SPDX-License-Identifier: MIT
"""Monitors a flight: it adopts valid estimates twice per arc and detects whether the arm changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.estimation.remedies import Known
from zygos.native.flight import Drift, Flight, LeftOut, Trace
from zygos.runs.cycles import Cycles

SYNC = 0x080
LOOKS = 2
"""Comparisons per arc: the arc after a change stands out only until the next adoption includes it."""


NOTES = 24
"""Estimates that are noted of what is fed at once, evenly spaced."""
STRETCH = 100
"""Cycles that are fed at once: so few that the library can list all arcs that end in them."""


@dataclass(frozen=True)
class Note:
    """What was estimated at some time of a run; p parameters."""

    cycles: int
    value: NDArray[np.float64]
    """(p,) NaN where a parameter is not identifiable yet."""
    half95: NDArray[np.float64]
    """(p,) half width of the 95 % interval."""


class Watch:
    """Feeds a flight, lets it leave out arcs that contradict the estimate so far, and detects a change of the arm."""

    def __init__(self, flight: Flight, *, trace: bool = False) -> None:
        """Start with no data. trace: store the intermediate results of each stage for each cycle, and `NOTES`
        estimates on the way."""
        self.flight = flight
        self.plainest: Drift | None = None
        """The comparison with the largest deviation, where those that prove a change come first; None if there was
        none.

        Comparisons with arcs that were left out do not count once a later arc agrees with the estimate before them.
        """
        self.known: list[Known] = []
        """The number of determined parameters during the run, each entry at twice the cycles of the previous one."""
        self.left_out: list[LeftOut] = []
        """Arcs that were left out when they ended."""
        self.notes: list[Note] = []
        """Estimates on the way, if the trace is kept."""
        self._traces: list[Trace] | None = [] if trace else None
        self._left_out = 0
        self._settled: Drift | None = None
        self._found = 0
        """The newest cycle when a change was found first."""
        self._every = max(1, round(flight.arm.arc_max_s / flight.arm.period_s) // LOOKS)
        self._since = 0
        others = max(flight.arm.impulse_arc_s, flight.arm.momentum_arc_s)
        self._reach = round(others / flight.arm.period_s)

    def frames(self, frames: NDArray[Any], progress: Callable[[float], None] | None = None) -> None:
        """Feed frames as `Flight.frames`. progress is called from time to time with the share that is finished."""
        starts = np.flatnonzero(frames["id"] == SYNC)

        def feed(first: int, last: int) -> Trace | None:
            return self.flight.frames(frames[first:last], trace=self._traces is not None)

        self._feed(starts, len(frames), feed, progress)

    def cycles(self, cycles: Cycles, progress: Callable[[float], None] | None = None) -> None:
        """Feed cycles as `Flight.cycles`."""

        def feed(first: int, last: int) -> Trace | None:
            part = Cycles(*(getattr(cycles, field.name)[first:last] for field in fields(Cycles)))
            return self.flight.cycles(part, trace=self._traces is not None)

        self._feed(np.arange(len(cycles)), len(cycles), feed, progress)

    def _feed(
        self,
        starts: NDArray[np.intp],
        n: int,
        feed: Callable[[int, int], Trace | None],
        progress: Callable[[float], None] | None,
    ) -> None:
        """Feed n entries piece by piece with `feed`; starts: positions in them at which cycles begin."""
        first = noted = 0
        ends = [*starts[1:].tolist(), n]
        for count, last in enumerate(ends, start=self._since + min(1, len(starts))):
            due = count % self._every == 0
            if last < n and not due and count % STRETCH:
                continue
            trace = feed(first, last)
            first = last
            if self._traces is not None and trace is not None:
                self._traces.append(trace)
            self._note_arcs()
            if self._traces is not None and n > 0 and last * NOTES // n > noted:
                noted = last * NOTES // n
                self._note_estimate()
            if due and last < n:
                self.look()
                if progress:
                    progress(first / n)
        self._since = (self._since + len(starts)) % self._every

    @property
    def traced(self) -> bool:
        """Whether the trace is kept."""
        return self._traces is not None

    def trace(self) -> Trace:
        """The intermediate results of each stage for each cycle so far. Needs a watch with `trace` that was fed."""
        assert self._traces
        return Trace.joined(self._traces)

    def look(self) -> Drift | None:
        """Compare the newest arc with the running solution, and adopt a valid estimate unless the arm changed. Returns
        the clearest comparison so far."""
        self._note_arcs()
        estimate, cycles = self.flight.estimate(), self.flight.counts["cycles"]
        if not estimate.consecutive:
            self.plainest = self._settled  # the deviation in arcs that were left out was not a change
        drift = self.flight.compared()
        best = (bool(self.plainest.changed), self.plainest.largest) if self.plainest else (False, 0.0)
        # motor rows from the time of an arc that was left out are no evidence about an arc that agrees
        spoilt = not estimate.consecutive and any(arc.last + self._reach > drift.until for arc in self.left_out)
        # an arc that began after the change was found says less well since when
        late = best[0] and drift.until > self._found
        if not spoilt and not late and (bool(drift.changed), drift.largest) > best:
            self.plainest = drift
            self._found = self._found if best[0] else int(self.flight.native.sums.cycle)
        if cycles > 2 * (self.known[-1].cycles if self.known else 0):
            self.known.append(Known(cycles, int(np.count_nonzero(np.isfinite(estimate.value)))))
        if not estimate.consecutive:
            self._settled = self.plainest
        if not drift.changed:
            self.flight.adopt()
        return self.plainest

    def _note_estimate(self) -> None:
        """Note what is estimated now."""
        estimate = self.flight.estimate()
        self.notes.append(Note(self.flight.counts["cycles"], estimate.value, estimate.half95))

    def _note_arcs(self) -> None:
        """Add the arcs that were left out since the last call."""
        count, newest = self.flight.left_out
        fresh = count - self._left_out
        self._left_out = count
        self.left_out += newest[max(0, len(newest) - fresh) :]
        if self.flight.native.sums.guard.changed:
            self._settled = self.plainest

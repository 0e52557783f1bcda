# SPDX-License-Identifier: MIT
"""How long a device takes from a SYNC to its answer, by the kernel's time stamps of the frames on the bus.

A SYNC closes a cycle. The device processes that cycle, solves if it is due, and then sends the telemetry frames of this
SYNC: the first of them shows that the cycle is finished. Its deadline is the next SYNC, one period later.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from zygos.can.rounds import TELEMETRY
from zygos.testing.stream import SYNC

EDGES_MS = tuple(0.125 * 2.0**k for k in range(12))
"""Limits of the classes of the histogram, ms; the first class begins at 0, the last one has no end."""
KINDS = ("accumulates", "solves", "waits for one that accumulates", "waits for one that solves")
"""What a device does between a SYNC and its answer. A cycle waits if its SYNC came before the answer to an earlier one;
it waits for the first of them that did not wait itself."""
_FIRST_OF_ESTIMATE = bytes([0, 3])
"""Index and kind of the telemetry frame that begins an estimate: its validity (docs/wire.md)."""


@dataclass(frozen=True)
class Answers:
    """n SYNCs in the order of the bus, each with the answer to it."""

    period_s: float
    """Time from one SYNC to the next, s: the deadline."""
    latency_s: NDArray[np.float64]
    """(n,) from the SYNC to the first telemetry frame that answers it, s; NaN where none came."""
    solves: NDArray[np.bool_]
    """(n,) whether the answer begins an estimate, which the device made between the SYNC and the answer."""
    behind: NDArray[np.int64]
    """(n,) the place of the SYNC whose cycle this one waits for; -1 if it does not wait."""

    @property
    def misses(self) -> int:
        """Number of SYNCs without an answer within the period."""
        return int(np.sum(~(self.latency_s <= self.period_s)))

    @property
    def kind(self) -> NDArray[np.int64]:
        """(n,) index into KINDS."""
        waits = self.behind >= 0
        return 2 * waits + np.where(waits, self.solves[self.behind], self.solves)

    def as_json(self) -> dict[str, Any]:
        """The distribution of all cycles of each kind, as it stands in the file of `--zygos-json`."""
        return {
            "period_ms": 1e3 * self.period_s,
            "edges_ms": list(EDGES_MS),
            "cycles": [self._of_kind(kind, self.kind == k) for k, kind in enumerate(KINDS)],
        }

    def _of_kind(self, kind: str, which: NDArray[np.bool_]) -> dict[str, Any]:
        latency = self.latency_s[which]
        answered = np.sort(1e3 * latency[np.isfinite(latency)])
        middle, late, latest = np.quantile(answered, [0.5, 0.99, 1.0]) if len(answered) else (None, None, None)
        return {
            "kind": kind,
            "count": len(latency),
            "unanswered": len(latency) - len(answered),
            "misses": int(np.sum(~(latency <= self.period_s))),
            "median_ms": _rounded(middle),
            "p99_ms": _rounded(late),
            "largest_ms": _rounded(latest),
            "histogram": np.bincount(np.searchsorted(EDGES_MS, answered), minlength=len(EDGES_MS) + 1).tolist(),
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 3)


def answers(messages: Iterable[can.Message], period_s: float) -> Answers:
    """Match the telemetry frames among messages with the SYNCs before them; other messages are passed over.

    messages: in the order of the bus, with time stamps in s. period_s: time from one SYNC to the next, s.

    A device answers in the order of the SYNCs, and a telemetry frame has the counter of its SYNC modulo 16. A frame
    therefore answers the oldest SYNC with its counter that waits for an answer, and those before it have none. This is
    certain unless fifteen SYNCs in turn have no answer.
    """
    synced: list[float] = []
    latency: list[float] = []
    solves: list[bool] = []
    behind: list[int] = []
    waiting: deque[tuple[int, int]] = deque()
    newest, before, answered_s = -1, -1, -np.inf
    for message in messages:
        if message.arbitration_id == SYNC:
            waiting.append((len(synced), message.data[0] % 16))
            synced.append(message.timestamp)
            latency.append(np.nan)
            solves.append(False)
            behind.append(-1)
        elif message.arbitration_id == TELEMETRY:
            counter = message.data[1] % 16
            if counter == newest or all(counter != own for _, own in waiting):
                continue  # one more frame of the answer that is known
            while waiting[0][1] != counter:
                waiting.popleft()
            at, newest = waiting.popleft()
            latency[at] = message.timestamp - synced[at]
            solves[at] = message.data[2:4] == _FIRST_OF_ESTIMATE
            if synced[at] < answered_s:
                behind[at] = behind[before] if behind[before] >= 0 else before
            before, answered_s = at, message.timestamp
    return Answers(period_s, np.array(latency), np.array(solves, dtype=np.bool_), np.array(behind, dtype=np.int64))

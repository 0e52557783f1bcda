# SPDX-License-Identifier: MIT
"""The expected results of a device for given frames, by the numpy reference, which shares no code with C."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zygos.native.flight import Estimate
from zygos.reference.compare import decode, solution_of
from zygos.runs.cycles import BREAK_BEFORE, Cycles
from zygos.testing.stream import Stream

_FIELDS = tuple(Cycles.__dataclass_fields__)
_OF_BLOCKS = 1e-5
"""Tolerance of a solution that depends on where blocks end."""


def fault_counts(stream: Stream) -> dict[str, int]:
    """Number of faults by name, without those that did not occur."""
    return {name: count for name, count in decode(stream.arm, stream.frames).faults.items() if count}


def survived(*streams: Stream) -> Cycles:
    """The usable cycles of one stream after the other; the arc ends between two of them."""
    parts: list[Cycles] = []
    first = 0
    for stream in streams:
        cycles = decode(stream.arm, stream.frames).cycles
        cycles.flags[:1] |= BREAK_BEFORE
        parts.append(replace(cycles, sync=cycles.sync + np.uint64(first)))
        first = int(parts[-1].sync.max(initial=first)) + 1000
    return Cycles(*(np.concatenate([getattr(part, name) for part in parts]) for name in _FIELDS))


def disagreement(estimate: Estimate, *streams: Stream) -> float:
    """Difference of an estimate from numpy's over the cycles that survived, in units of its tolerance.

    The tolerance is 1e-9 of a parameter, or 1e-14 times the condition where that is larger; 1e-5 where gains of torque
    sensors are estimated, whose prior depends on where blocks end. The result is infinite if
    the estimate has no values. Raises Undecided if the streams determine no parameter.
    """
    arm = streams[0].arm
    expected, size = solution_of(arm, survived(*streams))
    known = np.isfinite(estimate.value)
    if not known.any():
        return float("inf")
    relative: NDArray[np.float64] = (np.abs(estimate.value - expected) / size)[known]
    least = _OF_BLOCKS if arm.relative_gains else 1e-9
    return float(relative.max() / max(least, 1e-14 * estimate.condition))

# SPDX-License-Identifier: MIT
"""When a joint is at rest: one rule for estimates, predictions and explanations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.effects import SLOWEST_RATE

Floats = NDArray[np.float64]


def at_rest(rate: Floats, segment: NDArray[np.int64], period_s: float) -> NDArray[np.bool_]:
    """(n, N) whether a joint rests or creeps: its rate stays below a share of its root mean square for some time.

    Its friction may then be anything up to that of a joint that moves, so that no model predicts its torque. rate:
    (n, N) rad/s. segment: (n,) number of the unbroken piece of each instant.
    """
    slow = np.abs(rate) < np.maximum(limits.CREEP.value * np.sqrt(np.mean(rate**2, axis=0)), SLOWEST_RATE)
    breaks = np.diff(segment, prepend=-1) != 0
    for j in range(rate.shape[1]):
        edges = np.flatnonzero(breaks | (np.diff(slow[:, j], prepend=False) != 0))
        for part in np.split(np.arange(len(slow)), edges):
            if len(part) * period_s < limits.CREEPING_S.value:
                slow[part, j] = False
    return np.asarray(slow, dtype=np.bool_)

# SPDX-License-Identifier: MIT
"""What the laws of a model remember along measured motions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.readings import Readings
from zygos.dynamics.joints import Drives
from zygos.gap.record import smoothed_states


def memory_along(dynamics: Drives, arm: Arm, readings: Readings) -> NDArray[np.complex128] | None:
    """(A, cycles, S) internal states at the cycles of the arcs of a run; None where no law has a memory.

    They follow the smoothed motion. Before an arc's first smoothed instant they are those of the arc before, as far as
    it is the one that came before, else those at that instant; behind its last one those at the last.
    """
    if not dynamics.states:
        return None
    half = arm.smoother.points // 2
    assert readings.time is not None
    time = readings.time[:, half:-half] if half else readings.time
    memory = dynamics.memory_along(smoothed_states(arm, readings), time, arm.period_s)
    first = np.repeat(memory[:, :1], half, axis=1)
    follows = np.flatnonzero(np.abs(np.diff(time[:, 0]) - time.shape[1] * arm.period_s) < 0.5 * arm.period_s) + 1
    if half:
        first[follows] = memory[follows - 1, -half:]
    return np.concatenate([first, memory, np.repeat(memory[:, -1:], half, axis=1)], axis=1)

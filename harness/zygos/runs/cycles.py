# SPDX-License-Identifier: MIT
"""A run as reported by the sensors: one record per SYNC cycle, in SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BREAK_BEFORE = 1
"""Bit of `Cycles.flags`: the run is interrupted between the previous cycle and this one."""
INVALID = 2
"""Bit of `Cycles.flags`: the cycle's values are not to be used."""
VOID_BEFORE = 4
"""Bit of `Cycles.flags`: an interruption after which the previous cycles cannot be trusted; arcs that contain them are
discarded. The bits from VOID_SHIFT up give the number of these cycles; 0 means the whole open arc.
"""
VOID_SHIFT = 8


@dataclass(frozen=True)
class Cycles:
    """n cycles of an arm with N joints, before sign, zero and mount correction.

    The joint angle is ``sign * (reading - zero_rad)``, the base rate ``mount @ omega``.
    """

    sync: NDArray[np.uint64]
    """(n,) cycle number; time is sync * period."""
    q: NDArray[np.float64]
    """(n, N) link encoder readings, rad."""
    theta: NDArray[np.float64]
    """(n, N) motor encoder readings after the gear, rad."""
    tau: NDArray[np.float64]
    """(n, N) rotor torque, Nm, at the instant or interval that the arm's `torque_law` states."""
    omega: NDArray[np.float64]
    """(n, 3) gyro reading in the sensor's frame, rad/s."""
    flags: NDArray[np.uint32]
    """(n,) bits BREAK_BEFORE, INVALID, VOID_BEFORE."""

    def __len__(self) -> int:
        """Number of cycles."""
        return len(self.sync)

# SPDX-License-Identifier: MIT
"""The motion at its site that a law may depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNKNOWN: Any = np.float64("nan")
"""A signal that is not known; a law that needs it has no value either."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What a law may depend on, at instants of any shape (...). What is not known is NaN."""

    rate: Array = UNKNOWN
    """rad/s: of the motor after the gear (motor, torque, load), of the link (link), of the deflection (spring), of the
    base about the axis of a planar arm (base)."""
    angle: Array = UNKNOWN
    """rad: the integral of the rate; of the base since the start of the run."""
    deflection: Array = UNKNOWN
    """Motor angle less link angle, rad."""
    slip: Array = UNKNOWN
    """Rate of the deflection, rad/s."""
    applied: Array = UNKNOWN
    """Reported torque of the motor, Nm before the gear."""
    load: Array = UNKNOWN
    """Torque through the gear, Nm after it: of the spring, or of the motor less its friction where the joint is
    rigid."""
    time: Array = UNKNOWN
    """Time since the start of the run, s."""
    ratio: float = float("nan")
    """Gear ratio n."""
    memory: Array = UNKNOWN
    """(..., s) internal states of a law with a memory."""

# SPDX-License-Identifier: MIT
"""What the sensors of an arm read, before it is smoothed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Readings:
    """Calibrated samples of A arcs of n cycles each; N joints. Leading axes may be added (draws of a twin).

    q, theta: (..., A, n, N) link and motor angles after the gear [rad]. tau: (..., A, n, N) rotor torque in force on
    [t_k, t_k+1) [Nm]. omega0: base rate [rad/s], (..., A, n) about the axis of a planar arm, (..., A, n, 3) in base
    axes of a spatial one; zeros on a fixed base. time: (A, n) since the start of the run [s]. turned: (A, n) angle that
    the base of a planar arm has turned since then [rad]. nadir: (A, n, 3) unit vector to the Earth in base axes, of an
    arm that knows it. Without the last three, no law may depend on them.
    """

    q: Floats
    theta: Floats
    omega0: Floats
    tau: Floats
    time: Floats | None = None
    turned: Floats | None = None
    nadir: Floats | None = None

# SPDX-License-Identifier: MIT
"""The response to the torques (50) of the paper, from rest, and its difference for other parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from zygos.arm import Arm
from zygos.balances.state import State
from zygos.dynamics.planar import PlanarDynamics

Floats = NDArray[np.float64]

AMPLITUDES_NM = (0.5, 0.1)
RATES = (1.0, 0.1)
"""Angular frequencies, rad/s: the rotor torques are [0.5 cos t, 0.1 cos 0.1 t] Nm."""
DURATION_S = 120.0
HAIR_RAD = 1e-3
"""Change of the initial angle, rad, that shows how fast two copies of the same arm diverge."""
PARTING = 10.0
"""A motion whose copies diverge by more than this multiple of their initial distance is not compared point by point."""


def sync_instants(arm: Arm) -> Floats:
    """(n,) SYNC instants of a response, s."""
    return np.asarray(arm.period_s * np.arange(round(DURATION_S / arm.period_s) + 1), dtype=np.float64)


def respond(arm: Arm, values: Floats, momentum_nms: float, off_rad: float = 0.0) -> Floats:
    """(n, 2) link angles [rad] of an arm of two joints with these parameters (p,), at the instants.

    The arm starts stretched, with its joints at rest, its springs relaxed, and an angular momentum; off_rad is added to
    the first joint. DOP853, relative tolerance 1e-10. Errors: ZygosError if no arm can have the parameters, because an
    inertia is not positive.
    """
    dynamics = PlanarDynamics.from_parameters(arm, values)
    start = np.zeros(4 * arm.n + 1)
    start[[1, 1 + arm.n]] = off_rad
    start[0] = momentum_nms / float(np.sum(dynamics.inertia(start[1 : 1 + arm.n])[0]))

    def rate(t: float, x: Floats) -> Floats:
        s = State.unpacked(x)
        tau = np.array(AMPLITUDES_NM) * np.cos(np.array(RATES) * t)
        base, link, motor = dynamics.accelerations(s.q, s.theta, s.base, s.qd, s.thetad, tau)
        return State(s.qd, s.thetad, link, motor, base).packed()

    found = solve_ivp(
        rate, (0.0, DURATION_S), start, method="DOP853", t_eval=sync_instants(arm), rtol=1e-10, atol=1e-12
    )
    return np.asarray(State.unpacked(found.y.T).q, dtype=np.float64)


def apart_percent(response: Floats, true: Floats) -> Floats:
    """(n, N) error of a response, in per cent of the largest angle of the true one so far."""
    largest = np.maximum.accumulate(np.abs(true), axis=0)
    out = np.zeros_like(true)
    return np.asarray(np.divide(100.0 * np.abs(response - true), largest, out=out, where=largest > 0.0))

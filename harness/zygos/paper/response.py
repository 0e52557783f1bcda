"""The response to the torques (50) of the paper, from rest, and by how much that of other parameters differs."""

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
"""rad/s: the rotor torques are [0.5 cos t, 0.1 cos 0.1 t] Nm."""
DURATION_S = 120.0
HAIR_RAD = 1e-3
"""By which a start is off that shows how fast copies of the same arm part."""
PARTING = 10.0
"""A motion whose copies part by more than so many times their first distance is not to be compared point by point."""


def sync_instants(arm: Arm) -> Floats:
    """(n,) SYNC instants of a response, s."""
    return np.asarray(arm.period_s * np.arange(round(DURATION_S / arm.period_s) + 1), dtype=np.float64)


def respond(arm: Arm, values: Floats, momentum_nms: float, off_rad: float = 0.0) -> Floats:
    """(n, 2) link angles [rad] of an arm of two joints with these parameters (p,), at the instants.

    The arm starts stretched, its joints at rest, its springs relaxed, with an angular momentum; off_rad is added to the
    first joint. DOP853, 1e-10 of the motion. Errors: ZygosError where the parameters are no arm: an inertia that is not
    positive.
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
    """(n, N) by how much a response is off, in per cent of the largest angle of the true one until then."""
    largest = np.maximum.accumulate(np.abs(true), axis=0)
    out = np.zeros_like(true)
    return np.asarray(np.divide(100.0 * np.abs(response - true), largest, out=out, where=largest > 0.0))

# SPDX-License-Identifier: MIT
"""How far the inertia matrix of an estimate is off: the error that a controller sees, whatever the parameters are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from zygos.arm import Arm
from zygos.balances.kinematics import body_columns
from zygos.balances.state import State

Floats = NDArray[np.float64]

POSTURES = 200
"""Number of postures at which the inertia matrix of a spatial arm is compared."""


def inertia(arm: Arm, q: Floats, values: Floats) -> Floats:
    """(P, 3+N, 3+N) inertia matrices H of base and joints, rotors locked, at postures q (P, N) [rad], kg m^2.

    The energy of the bodies is 1/2 u' H u, so that each entry follows from three energies.
    """
    size = 3 + arm.n
    kinetic = arm.structure.expanded(values[: len(arm.parameter_names)])[: len(arm.full_body_names)]

    def energy(u: Floats) -> Floats:
        """(P,) [J] with the rates u (size,)."""
        rates = np.broadcast_to(u, (len(q), size))
        still = np.zeros_like(q)
        columns, _ = body_columns(arm, State(q, q, rates[:, 3:], still, rates[:, :3]))
        return columns @ kinetic

    units = np.eye(size)
    own = np.array([energy(unit) for unit in units])
    out = np.empty((len(q), size, size))
    for i in range(size):
        for j in range(size):
            out[:, i, j] = energy(units[i] + units[j]) - own[i] - own[j]
    return out


def inertia_errors(arm: Arm, solutions: Floats, true: Floats) -> tuple[float, float] | None:
    """Largest deviation from 1 of the generalised eigenvalues of the inertia matrix of estimates (S, p) and the true
    one (p,), in percent: worst and median over `POSTURES` random postures, rms over the estimates of each. None if
    there are no estimates."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSTURES, arm.n))
    right = inertia(arm, q, true)
    worst, median = [], []
    for solution in solutions:
        found = inertia(arm, q, solution)
        off = [100.0 * np.max(np.abs(eigh(a, b, eigvals_only=True) - 1.0)) for a, b in zip(found, right, strict=True)]
        worst.append(max(off))
        median.append(float(np.median(off)))
    if not worst:
        return None
    return float(np.sqrt(np.mean(np.square(worst)))), float(np.sqrt(np.mean(np.square(median))))

# SPDX-License-Identifier: MIT
"""The gravity gradient, which pulls at every mass of an arm in space (docs/theory.md, "Gravity gradient").

A mass at x from the mass centre of the whole arm feels the force c (r r' - 1/3) x per kg beside that of the orbit; r is
the direction to the Earth, and c = 3 mu / rho^3 at the distance rho. With the directions d_a and the matrix N_ab of the
kinetic energy, the second moment of all masses is sum N_ab d_a d_b', so that energy and torques are linear in the same
parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.balances.kinematics import Posture, crossed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pull:
    """What the field does per unit of its coefficient."""

    energy: Floats
    """(...,) potential energy, kg m^2."""
    base: Floats
    """(..., 3) torque on the whole arm, kg m^2, base axes."""
    joints: Floats
    """(..., N) torque about each joint on what lies beyond it, kg m^2."""


def pull(places: Posture, matrix: Floats, nadir: Floats) -> Pull:
    """Of postures (...) of an arm with the matrix N (V, V), kg m^2. nadir: (..., 3) unit vector to the Earth, base
    axes."""
    rho = places.direction
    along = np.sum(rho * nadir[..., None, :], axis=-1)
    force = (matrix @ along[..., None]) * nadir[..., None, :] - (matrix @ rho) / 3.0
    torque = crossed(rho, force)
    joints = [
        np.sum(places.axis[..., i, :] * torque[..., places.body > i, :].sum(axis=-2), axis=-1)
        for i in range(places.axis.shape[-2])
    ]
    return Pull(-0.5 * np.sum(rho * force, axis=(-1, -2)), torque.sum(axis=-2), np.stack(joints, axis=-1))


def nadir_along(nadir: Floats, omega: Floats, time: Floats) -> Floats:
    """(n, 3) unit vector to the Earth in base axes at n instants (s) of a run, from that at the first (3,) and the base
    rates (n, 3) in base axes, rad/s."""
    step = 0.5 * (omega[1:] + omega[:-1]) * np.diff(time)[:, None]
    out = np.empty_like(omega)
    out[0] = nadir
    # the direction stands still while the base turns
    back = Rotation.from_rotvec(-step).as_matrix() if len(step) else np.zeros((0, 3, 3))
    for k, turn in enumerate(back):
        out[k + 1] = turn @ out[k]
    return out

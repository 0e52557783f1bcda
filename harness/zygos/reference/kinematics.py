"""Absolute rates and the Gram matrix of planar rate vectors (docs/theory.md, "Kinetic energy, in closed form").

Planar arm, all axes parallel: body i turns at f_i about the common axis and stands at phi_i relative to the base.
With v_i = f_i (cos phi_i, sin phi_i) the kinetic energy of the bodies is 1/2 sum_ij a_ij v_i . v_j, and for an arm
whose centres of mass lie off the joint-to-joint lines also sum_i<j b_ij v_i x v_j.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """A planar arm at any number of instants.

    q, theta: (..., N) link and motor angles [rad]. qd, thetad: (..., N) their rates [rad/s].
    f0: (...) base rate about the common axis [rad/s].
    """

    q: Floats
    theta: Floats
    qd: Floats
    thetad: Floats
    f0: Floats

    @property
    def f(self) -> Floats:
        """Absolute rates, shape (..., N+1) [rad/s]."""
        return absolute(self.f0, self.qd)

    @property
    def phi(self) -> Floats:
        """Attitude of each body relative to the base, shape (..., N+1) [rad]; phi_0 = 0."""
        return absolute(np.zeros(self.q.shape[:-1]), self.q)


def absolute(base: Floats, joints: Floats) -> Floats:
    """base (...) plus the sum of the first i of joints (..., N), for i = 0 .. N: shape (..., N+1)."""
    return np.concatenate([base[..., None], base[..., None] + np.cumsum(joints, axis=-1)], axis=-1)


def rate_vectors(f: Floats, phi: Floats) -> Floats:
    """v, shape (..., N+1, 2) [rad/s]. f, phi: (..., N+1)."""
    return np.asarray(f[..., None] * np.stack([np.cos(phi), np.sin(phi)], axis=-1), dtype=np.float64)


def gram(f: Floats, phi: Floats) -> Floats:
    """v_i . v_j of the planar rate vectors, shape (..., N+1, N+1) [rad^2/s^2]. f, phi: (..., N+1)."""
    vectors = rate_vectors(f, phi)
    return np.asarray(vectors @ np.swapaxes(vectors, -1, -2), dtype=np.float64)


def cross(f: Floats, phi: Floats) -> Floats:
    """v_i x v_j of the planar rate vectors, shape (..., N+1, N+1) [rad^2/s^2]. f, phi: (..., N+1)."""
    vectors = rate_vectors(f, phi)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.asarray(x[..., :, None] * y[..., None, :] - y[..., :, None] * x[..., None, :], dtype=np.float64)

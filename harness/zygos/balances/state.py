# SPDX-License-Identifier: MIT
"""What an arm does at an instant: angles and rates of its joints, and the rate of its base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """An arm at any number of instants.

    q, theta: (..., N) link and motor angles [rad]. qd, thetad: (..., N) their rates [rad/s].
    base: base rate [rad/s]: (...) about the common axis of a planar arm, (..., 3) in base axes of a spatial one. What
    stands there for a fixed base is not read; it may be (..., 0).
    """

    q: Floats
    theta: Floats
    qd: Floats
    thetad: Floats
    base: Floats

    @classmethod
    def smoothed(cls, arm: Arm, smoothed: Smoothed) -> State:
        """The states at the m smoothed instants of a record."""
        base = smoothed.omega if arm.spatial else smoothed.omega @ arm.axis
        return cls(smoothed.q, smoothed.theta, smoothed.qd, smoothed.thetad, base)

    @classmethod
    def unpacked(cls, packed: Floats) -> State:
        """The state from arrays (..., 4N+B): base, q, theta, qd, thetad; B is 1 in a plane, 3 in space, 0 where the
        base is fixed."""
        n, width = divmod(packed.shape[-1], 4)
        q, theta, qd, thetad = (packed[..., width + i * n : width + (i + 1) * n] for i in range(4))
        return cls(q, theta, qd, thetad, packed[..., 0] if width == 1 else packed[..., :width])

    def packed(self) -> Floats:
        """The state as arrays (..., 4N+B): base, q, theta, qd, thetad, as `unpacked` takes them."""
        base = self.base if self.base.ndim == self.q.ndim else self.base[..., None]
        return np.concatenate([base, self.q, self.theta, self.qd, self.thetad], axis=-1)

    @property
    def f(self) -> Floats:
        """Absolute rates of a planar arm's bodies, shape (..., N+1) [rad/s]."""
        return absolute(self.base, self.qd)

    @property
    def phi(self) -> Floats:
        """Attitude of a planar arm's bodies relative to the base, shape (..., N+1) [rad]; phi_0 = 0."""
        return absolute(np.zeros(self.q.shape[:-1]), self.q)


def absolute(base: Floats, joints: Floats) -> Floats:
    """base (...) plus the sum of the first i of joints (..., N), for i = 0 .. N: shape (..., N+1)."""
    return np.concatenate([base[..., None], base[..., None] + np.cumsum(joints, axis=-1)], axis=-1)

# SPDX-License-Identifier: MIT
"""Periodic motions within limits of angle and rate that begin and end at rest: among these, a motion is sought."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.special import expit

from zygos.plan.limits import Limits
from zygos.simulation.scenario import Motion, Sine

Floats = NDArray[np.float64]

_DENSE = 512
"""Instants of a period at which limits are checked."""


@dataclass(frozen=True)
class FourierMotion:
    """Motion of N joints as Fourier series of K harmonics of one period."""

    period_s: float
    offset: Floats
    """(N,) rad."""
    sine: Floats
    """(N, K) coefficients of sin(k w t), rad."""
    cosine: Floats
    """(N, K) coefficients of cos(k w t), rad."""

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Angles, rad, rates, rad/s, and accelerations, rad/s^2, at the times t (m,), s: each (m, N)."""
        omega = 2.0 * np.pi / self.period_s * np.arange(1, self.sine.shape[1] + 1)
        s, c = np.sin(np.outer(t, omega)), np.cos(np.outer(t, omega))
        angle = self.offset + s @ self.sine.T + c @ self.cosine.T
        rate = (c * omega) @ self.sine.T - (s * omega) @ self.cosine.T
        acceleration = -(s * omega**2) @ self.sine.T - (c * omega**2) @ self.cosine.T
        return angle, rate, acceleration

    def motions(self) -> list[Motion]:
        """The motion of each joint as a scenario has it."""
        omega = 2.0 * np.pi / self.period_s * np.arange(1, self.sine.shape[1] + 1)
        size, phase = np.hypot(self.sine, self.cosine), np.arctan2(self.cosine, self.sine)
        return [
            Motion(float(offset), tuple(Sine(*of) for of in zip(a.tolist(), omega.tolist(), p.tolist(), strict=True)))
            for offset, a, p in zip(self.offset, size, phase, strict=True)
        ]


class Space:
    """Coordinates of all Fourier motions that are at rest at the start, with no acceleration, within the limits.

    For each joint there are the shape (2K - 2), the size as a share of the largest that the limits permit, and the
    place within what is left of the range of angles. The limits hold for all values of the coordinates.
    """

    def __init__(self, limits: Limits, period_s: float, harmonics: int) -> None:
        """harmonics: K >= 2."""
        self.limits, self.period_s, self.harmonics = limits, period_s, harmonics
        k = np.arange(1, harmonics + 1)
        # rate: sum k sine = 0; acceleration: sum k^2 cosine = 0
        rest = np.zeros((2, 2 * harmonics))
        rest[0, :harmonics], rest[1, harmonics:] = k, k**2
        # a shape of unit coordinates has rates of the same size in all harmonics
        weight = np.tile(1.0 / k, 2)
        self._shapes = weight[:, None] * null_space(rest * weight)
        self.joints = len(limits.low)
        self.per_joint = self._shapes.shape[1] + 2
        self._dense = period_s * np.arange(_DENSE) / _DENSE

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return int(self.joints * self.per_joint)

    def draw(self, rng: np.random.Generator) -> Floats:
        """Coordinates of a random motion that uses most of the range."""
        x = rng.normal(size=(self.joints, self.per_joint))
        x[:, -2] = 2.0
        return x.ravel()

    def motion(self, x: Floats) -> FourierMotion:
        """The motion with these coordinates (size,)."""
        x = x.reshape(self.joints, self.per_joint)
        coefficients = x[:, :-2] @ self._shapes.T
        sine, cosine = coefficients[:, : self.harmonics], coefficients[:, self.harmonics :]
        plain = FourierMotion(self.period_s, np.zeros(self.joints), sine, cosine)
        angle, rate, _ = plain.at(self._dense)
        low, high = angle.min(axis=0), angle.max(axis=0)
        room = self.limits.high - self.limits.low
        # the extremes lie between the instants by a little
        largest = 0.999 * np.minimum(
            self.limits.rate / np.maximum(np.abs(rate).max(axis=0), 1e-300), room / np.maximum(high - low, 1e-300)
        )
        scale = largest * expit(x[:, -2])
        share = expit(x[:, -1])
        offset = self.limits.low - scale * low + share * (room - scale * (high - low))
        return FourierMotion(self.period_s, offset, scale[:, None] * sine, scale[:, None] * cosine)

    def derivatives(self, x: Floats, t: Floats) -> tuple[Floats, Floats]:
        """Derivatives of angles and rates at the times t (m,) with respect to the coordinates: each (size, m, N)."""
        step = 1e-6
        angles, rates = [], []
        for unit in step * np.eye(self.size):
            ahead, behind = self.motion(x + unit).at(t), self.motion(x - unit).at(t)
            angles.append((ahead[0] - behind[0]) / (2.0 * step))
            rates.append((ahead[1] - behind[1]) / (2.0 * step))
        return np.array(angles), np.array(rates)

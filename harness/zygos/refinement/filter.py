# SPDX-License-Identifier: MIT
"""The filter of the C library (``zygos/refiner.h``) in numpy, with triangular square roots from QR decompositions.

It shares no code with the C library, and checks it (`tests/unit/test_refiner.py`). All arrays are dense; derivatives
come from `FlexibleMotion`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zygos.refinement.motion import FlexibleMotion

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations that the filter assumes; N joints, W rates of the base."""

    angles: Floats
    """(2N,) of link and motor encoders, rad."""
    gyro: float
    """rad/s."""
    walk: float
    """Step of the bias of the gyro in a period, rad/s."""
    torque: Floats
    """(N,) Nm before the gear."""
    relative: Floats
    """(N,) share of the torque."""
    second_order: float
    """Factor of the variance of the link rates by which the noise of the gyro is increased, s."""


@dataclass
class NumpyFilter:
    """State, bias of the gyro and parameters in units of their sizes: x (n,) with the covariance root root'."""

    motion: FlexibleMotion
    """The arm; its values are only those at the start."""
    noise: FilterNoise
    steps: int
    x: Floats
    root: Floats
    """(n, n)."""
    squares: Floats = field(default_factory=lambda: np.zeros(3))
    """Sums of the squared innovations of link encoders, motor encoders and gyro, each divided by its variance."""

    def read(self, q: Floats, theta: Floats, rate: Floats) -> None:
        """Use angles (N,), rad, and base rates (W,), rad/s, one after the other."""
        n, width = self.motion.arm.n, self.motion.base_rates
        for k, angle in enumerate(np.concatenate([q, theta])):
            joint = self.motion.arm.joints[k % n]
            encoder = joint.link_encoder if k < n else joint.motor_encoder
            row = np.zeros(len(self.x))
            row[width + k] = 1.0
            row[width + 2 * n + k] = 1e-6 * (joint.latch_us + encoder.latch_us)
            self._update(row, angle, self.noise.angles[k] ** 2, k // n)
        rates = self.root[width + 2 * n : width + 3 * n]
        variance = self.noise.gyro**2 + (self.noise.second_order * np.sum(rates**2)) ** 2
        for k, value in enumerate(rate):
            row = np.zeros(len(self.x))
            row[k] = row[self.motion.states + k] = 1.0
            self._update(row, value, variance, 2)

    def _update(self, row: Floats, value: float, variance: float, channel: int) -> None:
        seen = self.root.T @ row
        front = np.zeros((len(row) + 1, len(row) + 1))
        front[0, 0], front[0, 1:], front[1:, 1:] = np.sqrt(variance), seen, self.root
        lower = _lower(front)
        error = (value - row @ self.x) / lower[0, 0]
        self.squares[channel] += error**2
        self.x = self.x + lower[1:, 0] * error
        self.root = lower[1:, 1:]

    def advance(self, tau: Floats) -> None:
        """Move to the next SYNC under torques (N,), Nm before the gear."""
        moving, width = self.motion.states, self.motion.base_rates
        fast = moving + width
        motion = FlexibleMotion(self.motion.arm, self.x[fast:] * self.motion.size)
        after, slope = motion.step(self.x[None, :moving], tau[None], self.motion.arm.period_s, self.steps)
        across = np.eye(len(self.x))
        across[:moving, :moving] = slope[0, :, :moving]
        across[:moving, fast:] = slope[0, :, moving : -len(tau)] * self.motion.size
        pushed = np.zeros((len(self.x), len(tau) + width))
        pushed[:moving, : len(tau)] = slope[0, :, -len(tau) :] * np.hypot(self.noise.torque, self.noise.relative * tau)
        pushed[moving:fast, len(tau) :] = self.noise.walk * np.eye(width)
        self.x = np.concatenate([after[0], self.x[moving:]])
        self.root = _lower(np.concatenate([across @ self.root, pushed], axis=1))


def _lower(table: Floats) -> Floats:
    """The lower triangular L with L L' = table table'."""
    return np.asarray(np.linalg.qr(table.T, mode="r"), dtype=np.float64).T

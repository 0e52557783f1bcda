# SPDX-License-Identifier: MIT
"""Means of readings and of their derivatives over a window that slides along the run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm, Encoder, TorqueLaw
from zygos.runs.cycles import Cycles
from zygos.runs.samples import segments

Array = NDArray[np.float64]

BLOCKS = 8
"""Number of blocks of the jackknife, since the errors of neighbouring rows are correlated."""

_BELL = (1.0 - Polynomial([0.0, 1.0]) ** 2) ** 6


class Window:
    """The sliding window; each half is as wide as two windows of the arm's smoother."""

    def __init__(self, arm: Arm, cycles: Cycles) -> None:
        """Errors: ZygosError if no uninterrupted part of the run is longer than the window."""
        self.h = arm.period_s
        self.width = 2 * arm.smoother.points * self.h
        self.reach = math.ceil(self.width / self.h) + 1
        self.stride = max(1, 2 * arm.smoother.points // 8)
        self.ranges = [r for r in segments(cycles).ranges if r[1] - r[0] > 2 * self.reach]
        self.count = sum(len(range(0, b - a - 2 * self.reach, self.stride)) for a, b in self.ranges)

    def __call__(self, readings: Array, derivative: int = 0, late_s: float = 0.0) -> Array:
        """(instants,) the windowed mean of a reading (n,), or of its derivative, taken late_s after SYNC."""
        at = self.h * np.arange(-self.reach, self.reach + 1, dtype=np.float64)

        def bell(t: Array, order: int) -> Array:
            x = t / self.width
            inside: Array = np.where(np.abs(x) < 1.0, _BELL.deriv(order)(x), 0.0)
            return inside

        weights = (-1.0 / self.width) ** derivative * bell(at + late_s, derivative) / bell(at, 0).sum()
        middle = float(np.mean(readings[self.ranges[0][0] : self.ranges[-1][1]]))
        middle = middle if math.isfinite(middle) else 0.0
        parts = [
            np.convolve(readings[a:b] - middle, weights[::-1], mode="valid")[:: self.stride][
                : len(range(0, b - a - 2 * self.reach, self.stride))
            ]
            for a, b in self.ranges
        ]
        return np.concatenate(parts) + (middle if derivative == 0 else 0.0)


def calibrated(arm: Arm, cycles: Cycles) -> tuple[Array, Array]:
    """(n, N) link and motor angles, rad, signs and zeros applied."""

    def angles(encoders: Sequence[Encoder], readings: Array) -> Array:
        out: Array = np.array([e.sign for e in encoders]) * (readings - np.array([e.zero_rad for e in encoders]))
        return out

    motors = angles([j.motor_encoder for j in arm.joints], cycles.theta)
    links = angles([j.link_encoder for j in arm.joints], cycles.q)
    rigid = [not j.flexible for j in arm.joints]
    links[:, rigid] = motors[:, rigid]
    return links, motors


TORQUE_LATE: dict[TorqueLaw, float] = {"applied_from_sync": 0.5, "applied_previous_cycle": -0.5, "sampled": 0.0}
"""Middle of the time for which a torque record is valid, in periods after SYNC."""


class Means:
    """Windowed means of all signals of an arm: lists by joint, then by order of the derivative."""

    def __init__(self, arm: Arm, cycles: Cycles) -> None:
        """Compute the means of a run. Errors: ZygosError as `Window`."""
        window = Window(arm, cycles)
        self.arm, self.count = arm, window.count
        if not self.count:
            return
        q, theta = calibrated(arm, cycles)
        late = [
            (1e-6 * (j.latch_us + j.link_encoder.latch_us), 1e-6 * (j.latch_us + j.motor_encoder.latch_us))
            for j in arm.joints
        ]
        torque_late = TORQUE_LATE[arm.torque_law] * arm.period_s
        self.q = [[window(q[:, i], d, late[i][0]) for d in range(3)] for i in range(arm.n)]
        self.theta = [[window(theta[:, i], d, late[i][1]) for d in range(3)] for i in range(arm.n)]
        self.tau = [[window(cycles.tau[:, i], d, torque_late) for d in range(2)] for i in range(arm.n)]
        axes = range(3 if arm.free else 0)
        self.spin = [window(cycles.omega[:, axis], 1, 1e-6 * arm.imu.latch_us) for axis in axes]
        self.one = np.ones(self.count)

    def moves(self, joint: int) -> bool:
        """Whether an encoder of the joint shows that it moves."""
        pair = self.arm.joints[joint]
        return bool(
            np.ptp(self.q[joint][0]) > limits.FLAT_QUANTA.value * pair.link_encoder.quantum_rad
            or np.ptp(self.theta[joint][0]) > limits.FLAT_QUANTA.value * pair.motor_encoder.quantum_rad
        )


def jackknifed(columns: Sequence[Array], y: Array) -> tuple[Array, Array]:
    """Coefficients of y on columns by least squares and their standard errors by a jackknife over `BLOCKS` blocks."""
    x = np.column_stack(columns)
    scale = np.sqrt(np.mean(x**2, axis=0))
    x = x / np.where(scale > 0.0, scale, 1.0)
    whole = np.linalg.lstsq(x, y, rcond=None)[0]
    gram, right = x.T @ x, x.T @ y
    blocks = np.array_split(np.arange(len(y)), BLOCKS)
    each = np.array([np.linalg.lstsq(gram - x[b].T @ x[b], right - x[b].T @ y[b], rcond=None)[0] for b in blocks])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((each - each.mean(axis=0)) ** 2).sum(axis=0))
    back = np.where(scale > 0.0, scale, np.inf)
    return whole / back, spread / back


def smooth_direction(rate: Array) -> Array:
    """Sign of a rate, with a smooth transition through zero like the window's means."""
    out: Array = np.tanh(rate / max(0.05 * float(np.std(rate)), 1e-300))
    return out

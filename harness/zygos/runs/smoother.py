# SPDX-License-Identifier: MIT
"""Fixed-lag Savitzky-Golay smoother over whole records (docs/theory.md, "Smoother and bandwidth test").

Every state at instant k comes from the samples k-M .. k+M: a polynomial is fitted to them by least squares, and its
value and its derivative are evaluated at the instant. If a sensor latches late, its polynomial is evaluated earlier by
that delay, so that all signals belong to one instant.

The coefficients come from a least-squares solve on a Vandermonde matrix and are applied by convolution; no formula is
shared with the flight library.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.runs.samples import Samples

Floats = NDArray[np.float64]

BANDWIDTH_SIGMAS = 4.0
"""Largest accepted difference of two derivative estimates, in standard deviations by the declared noise."""


@dataclass(frozen=True)
class Smoothed:
    """State at every smoothed instant; m instants, N joints.

    index: (m,) position of the instant in the record of samples.
    segment: (m,) number of the unbroken segment the instant belongs to.
    sync: (m,) cycle number of the instant.
    q, theta: (m, N) angles [rad]. qd, thetad: (m, N) rates [rad/s]. omega: (m, 3) base rate in base axes [rad/s].
    accepted: (m,) False where the bandwidth test refuses the instant.
    bandwidth: (m,) largest |difference of the derivative estimates| / its standard deviation over the joints' signals;
        0 where every test is switched off.
    """

    index: NDArray[np.int64]
    segment: NDArray[np.int64]
    sync: NDArray[np.uint64]
    q: Floats
    theta: Floats
    qd: Floats
    thetad: Floats
    omega: Floats
    accepted: NDArray[np.bool_]
    bandwidth: Floats

    def part(self, at: NDArray[np.int64]) -> Smoothed:
        """The instants at these positions."""
        return Smoothed(*(getattr(self, name)[at] for name in self.__dataclass_fields__))


@cache
def coefficients(points: int, order: int, offset: float = 0.0, derivative: int = 0) -> Floats:
    """Weights c, shape (points,), oldest sample first, of a Savitzky-Golay filter.

    c @ x is the `derivative`-th derivative (per sample) of the polynomial of degree `order` fitted to the samples at
    -M .. M, evaluated at `offset` samples from the middle. Savitzky & Golay 1964. The array is read-only, because
    calls with equal arguments share it.

    Raises ZygosError where the window is even or too short for the order.
    """
    if points < 3 or points % 2 == 0:
        raise ZygosError(f"what is wrong: a smoother of {points} points has no middle; remedy: an odd number from 3 on")
    if not 0 <= derivative <= order < points:
        raise ZygosError(
            f"what is wrong: order {order} does not fit {points} points and derivative {derivative}; "
            "remedy: derivative <= order < points"
        )
    half = points // 2
    # Positions scaled to -1 .. 1 keep the Vandermonde matrix well conditioned.
    design = np.vander(np.arange(-half, half + 1) / half, order + 1, increasing=True)
    fit = np.linalg.lstsq(design, np.eye(points), rcond=None)[0]
    reader = np.zeros(order + 1)
    for power in range(derivative, order + 1):
        factor = np.prod(np.arange(power - derivative + 1, power + 1, dtype=np.float64))
        reader[power] = factor * (offset / half) ** (power - derivative) / half**derivative
    weights: Floats = reader @ fit
    weights.flags.writeable = False
    return weights


def bandwidth_coefficients(points: int, order: int, offset: float = 0.0) -> Floats:
    """Difference of two first-derivative estimates over the same samples, shape (points,), per sample.

    The second estimate has a half width smaller by one and the same order, and follows fast changes of the motion
    better.
    Raises ZygosError where the narrower window cannot carry the order: order <= 2 (half width) - 2 is needed.
    """
    half = points // 2
    if order > 2 * half - 2:
        raise ZygosError(
            f"what is wrong: the bandwidth test of a smoother of {points} points needs order <= {2 * half - 2}, "
            f"not {order}; remedy: more points or a lower order"
        )
    narrow = np.pad(coefficients(points - 2, order, offset, 1), 1)
    return coefficients(points, order, offset, 1) - narrow


def convolve(x: Floats, weights: Floats) -> Floats:
    """Filter a record x (n, ...) along its first axis; returns (n - len(weights) + 1, ...), valid instants only."""
    flat = x.reshape(x.shape[0], -1)
    out = np.stack([np.convolve(column, weights[::-1], mode="valid") for column in flat.T], axis=1)
    return out.reshape(out.shape[:1] + x.shape[1:])


def smooth(arm: Arm, samples: Samples) -> Smoothed:
    """Smooth every segment of a record that is long enough to fill the window.

    Raises ZygosError where the window cannot carry the order.
    """
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s
    half = points // 2
    bandwidth_coefficients(points, order)  # refuses a window that cannot be tested, whatever the noise
    late = 1e-6 / h
    links = [-late * (joint.latch_us + joint.link_encoder.latch_us) for joint in arm.joints]
    motors = [-late * (joint.latch_us + joint.motor_encoder.latch_us) for joint in arm.joints]
    gyro = coefficients(points, order, -late * arm.imu.latch_us)
    link_sigmas = [joint.link_encoder.over_the_wire.sigma_rad for joint in arm.joints]
    motor_sigmas = [joint.motor_encoder.over_the_wire.sigma_rad for joint in arm.joints]

    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats, Floats, Floats, Floats, Floats, Floats]] = []
    for number, (start, stop) in enumerate(samples.segments):
        count = stop - start - 2 * half
        if count <= 0:
            continue
        angle: list[Floats] = []
        rate: list[Floats] = []
        worst = np.zeros(count)
        for signals, offsets, sigmas in ((samples.q, links, link_sigmas), (samples.theta, motors, motor_sigmas)):
            segment = signals[start:stop]
            values = [convolve(segment[:, i], coefficients(points, order, s)) for i, s in enumerate(offsets)]
            slopes = [convolve(segment[:, i], coefficients(points, order, s, 1)) for i, s in enumerate(offsets)]
            angle.append(np.stack(values, axis=1))
            rate.append(np.stack(slopes, axis=1) / h)
            for i, sigma in enumerate(sigmas):
                if sigma > 0.0:
                    weights = bandwidth_coefficients(points, order, offsets[i]) / h
                    spread = sigma * np.linalg.norm(weights)
                    worst = np.maximum(worst, np.abs(convolve(segment[:, i], weights)) / spread)
        parts.append(
            (
                np.arange(start + half, stop - half, dtype=np.int64),
                np.full(count, number, dtype=np.int64),
                angle[0],
                angle[1],
                rate[0],
                rate[1],
                convolve(samples.omega[start:stop], gyro),
                worst,
            )
        )
    joints = len(arm.joints)
    if not parts:
        none = np.zeros((0, joints))
        empty = np.zeros(0, dtype=np.int64)
        parts = [(empty, empty, none, none, none, none, np.zeros((0, 3)), np.zeros(0))]
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    index, segment_of, q, theta, qd, thetad, omega, bandwidth = columns
    return Smoothed(
        index=index,
        segment=segment_of,
        sync=samples.sync[index],
        q=q,
        theta=theta,
        qd=qd,
        thetad=thetad,
        omega=omega,
        accepted=bandwidth <= BANDWIDTH_SIGMAS,
        bandwidth=bandwidth,
    )

# SPDX-License-Identifier: MIT
"""Sensor readings of a motion (Nanos & Papadopoulos eqs. (28)-(32); docs/paper.md, noise).

The error of an encoder is Gaussian with variance quantum^2/12, or its reading is rounded to the quantum. The gyro has
white noise and a bias with random walk. The reported torque has white noise. The errors of one seed are the same bits
whether it is drawn alone or with others, and those of a short run are the beginning of those of a long one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, Encoder
from zygos.simulation.scenario import EncoderNoise

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Errors of all readings of B seeds over n cycles."""

    link: Array
    """(B, n, N) errors of the link encoders, rad; zero if they round."""
    motor: Array
    """(B, n, N) errors of the motor encoders after the gear, rad; zero if they round."""
    torque: Array
    """(B, n, N) errors of the reported rotor torque that do not depend on its size, Nm."""
    gyro: Array
    """(B, n, 3) errors of the gyro in its own frame, bias included, rad/s."""
    bias: Array
    """(B, n, 3) bias of the gyro at the start of each cycle, rad/s."""
    torque_share: Array
    """(B, n, N) errors of the reported rotor torque as shares of its size."""
    rounding: bool = False
    """Whether encoder readings are rounded to the quantum."""


def draw_noise(arm: Arm, cycles: int, seeds: Sequence[int], encoder_noise: EncoderNoise = "gaussian") -> Noise:
    """Draw the errors of all sensors, shapes as in `Noise`, at the arm's SYNC period.

    Each seed has its own generator, `numpy.random.default_rng(seed)`, which gives 3N+6 standard normals per cycle,
    cycle after cycle: link encoders 1..N, motor encoders 1..N, torques 1..N, gyro white x y z, gyro bias step x y z.
    All are drawn even if a deviation is zero, so that a setting never changes the other sensors' draws.
    """
    joints = arm.n
    normal = np.empty((len(seeds), cycles, 3 * joints + 6))
    for row, seed in enumerate(seeds):
        normal[row] = np.random.default_rng(seed).standard_normal((cycles, 3 * joints + 6))
    rounding = encoder_noise == "quantised"
    share = 0.0 if rounding else 1.0
    link = share * np.array([joint.link_encoder.sigma_rad for joint in arm.joints])
    motor = share * np.array([joint.motor_encoder.sigma_rad for joint in arm.joints])
    torque = np.array([joint.torque_sigma for joint in arm.joints])
    share_of_torque = np.array([joint.torque_relative_sigma for joint in arm.joints])
    step = arm.imu.bias_walk * np.sqrt(arm.period_s)
    after = np.cumsum(step * normal[..., 3 * joints + 3 :], axis=1)
    bias = np.concatenate([np.zeros_like(after[:, :1]), after[:, :-1]], axis=1)
    # a sample is the mean rate over its period; its noise includes the mean bias and the variance of the walk around it
    white = np.sqrt(arm.imu.rate_sigma**2 + step**2 / 12.0)
    gyro = white * normal[..., 3 * joints : 3 * joints + 3] + 0.5 * (bias + after)
    return Noise(
        link * normal[..., :joints],
        motor * normal[..., joints : 2 * joints],
        torque * normal[..., 2 * joints : 3 * joints],
        gyro,
        bias,
        share_of_torque * normal[..., 2 * joints : 3 * joints],
        rounding,
    )


def no_noise(arm: Arm, cycles: int, seeds: Sequence[int]) -> Noise:
    """Exact sensors, shapes as in `Noise`."""
    angles = np.zeros((len(seeds), cycles, arm.n))
    rates = np.zeros((len(seeds), cycles, 3))
    return Noise(angles, angles, angles, rates, rates, angles)


def encoder_reading(encoders: Sequence[Encoder], angle: Array, error: Array, rounding: bool) -> Array:
    """(..., N) readings of N encoders, rad: sign * angle + zero, with the error added or rounded to the quantum."""
    sign = np.array([encoder.sign for encoder in encoders])
    zero = np.array([encoder.zero_rad for encoder in encoders])
    reading: Array = sign * angle + zero + error
    if rounding:
        quantum = np.array([encoder.quantum_rad for encoder in encoders])
        reading = quantum * np.rint(reading / quantum)
    return reading


def encoder_angle(encoders: Sequence[Encoder], reading: Array) -> Array:
    """(..., N) joint angles, rad, of the given readings: sign * (reading - zero)."""
    sign = np.array([encoder.sign for encoder in encoders])
    zero = np.array([encoder.zero_rad for encoder in encoders])
    angle: Array = sign * (reading - zero)
    return angle


def gyro_reading(arm: Arm, omega0: Array, error: Array) -> Array:
    """(..., 3) gyro readings in the sensor's frame, rad/s, of the base rate (..., 3) in base axes."""
    reading: Array = omega0 @ arm.mount + error
    return reading


def torque_error(tau: Array, error: Array, share: Array) -> Array:
    """(..., N) errors of reported torques tau (..., N), Nm: those that do not depend on the torque (..., N), Nm, and
    those that are shares of it (..., N), of the same sign. Their deviations add in squares."""
    together: Array = np.copysign(np.hypot(error, share * tau), error + share)
    return together


def torque_record(arm: Arm, tau: Array, error: Array, share: Array) -> Array:
    """(..., n, N) rotor torque as recorded, Nm, from the torque that acts on [t_k, t_{k+1}); error and share as in
    `torque_error`.

    `applied_previous_cycle` records at k the torque of the period that ends at t_k (zero before the first).
    """
    record = tau
    if arm.torque_law == "applied_previous_cycle":
        record = np.concatenate([np.zeros_like(tau[..., :1, :]), tau[..., :-1, :]], axis=-2)
    return record + torque_error(record, error, share)

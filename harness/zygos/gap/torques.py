# SPDX-License-Identifier: MIT
"""Noise of torque sensors that the arm file says nothing about, from the runs themselves.

A servo answers every reading of its encoders, so that a torque jitters although it is measured without error: this
jitter acts. What is left of a torque's fast part after the answer to the readings is taken off is noise of its sensor,
or the answer of a servo that reads its encoders otherwise than they are recorded. Only noise adds up in the impulse of
the motor: where a joint is flexible, its motor balance tells the two apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, toeplitz
from scipy.ndimage import correlate1d

from zygos import limits
from zygos.arm import TORQUE_STEP, Arm
from zygos.gap.balances import Layout, balance_rows
from zygos.gap.record import MeasuredRun, followed
from zygos.runs.smoother import coefficients

Array = NDArray[np.float64]

_ROUNDING = TORQUE_STEP / np.sqrt(12.0)
"""Standard deviation of the rounding on the bus, Nm."""


def with_torque_noise(arm: Arm, records: Sequence[MeasuredRun]) -> tuple[Arm, Arm]:
    """The arm with the noise that its torques have in these runs, where its file declares none, and with the most that
    they do not rule out. Noise that does not exceed the rounding on the bus is none."""
    sigma = np.sqrt((np.array([torque_noise(record) for record in records]) ** 2).mean(axis=0))
    declared = np.array([joint.torque_sigma > 0.0 for joint in arm.joints])
    likely, most = sigma.copy(), sigma.copy()
    looked_at = [i for i, joint in enumerate(arm.joints) if joint.flexible and sigma[i] > 0.0 and not declared[i]]
    for i, left in _motors(arm, records, looked_at):
        variance, deviation = _acting(arm, i, left)
        # the least of several estimates is too small rather than too large
        least = float(np.sqrt(variance + deviation)) if variance > deviation else 0.0
        likely[i] = min(sigma[i], least) if least > limits.ROUNDING_Z.value * _ROUNDING else 0.0
        most[i] = min(sigma[i], float(np.sqrt(max(variance, 0.0) + limits.NOISE_Z.value * deviation)))
    if likely.any() or declared.any():
        # the torque sensors of an arm are of a kind: where one has noise, another has what is not ruled out
        likely = np.where((likely > 0.0) | (most <= limits.ROUNDING_Z.value * _ROUNDING), likely, most)
    return _with_sigmas(arm, likely), _with_sigmas(arm, most)


def with_hidden_noise(arm: Arm) -> Arm:
    """The arm with no more noise of its torques than the rounding on the bus, where its file declares none: sensors
    that may have constant errors all the same."""
    return _with_sigmas(arm, np.full(arm.n, _ROUNDING))


def _with_sigmas(arm: Arm, sigma: Array) -> Arm:
    joints = tuple(
        joint if joint.torque_sigma > 0.0 else replace(joint, torque_sigma=float(x))
        for joint, x in zip(arm.joints, sigma, strict=True)
    )
    return replace(arm, joints=joints)


@dataclass(frozen=True)
class _Left:
    """What a motor balance leaves over, with its impulse smoothed as its angles are, so that what acts within a window
    of the smoother falls out."""

    impulse: Array
    """(A, instants) Nms; NaN where the smoother does not follow."""
    inertia: float
    """kg m^2, of the rotor."""


def _motors(arm: Arm, records: Sequence[MeasuredRun], joints: Sequence[int]) -> Iterator[tuple[int, list[_Left]]]:
    """By joint, what its motor balance leaves over of each run beside every column that it has."""
    if not joints:
        return
    layout = Layout(arm)
    smooth = coefficients(arm.smoother.points, arm.smoother.order, 0.0, 0)
    half = len(smooth) // 2
    # an offset of the torque and the zeros of the encoders make an impulse that grows with time
    none = tuple(np.zeros(0) for _ in layout.balances)
    tables = [balance_rows(layout, record.readings(), zeros=none) for record in records]
    kept = [followed(arm, record.readings()) for record in records]
    for i in joints:
        balance = layout.balances.index(f"M{i + 1}")
        inertia = int(np.flatnonzero(layout.used[balance] == layout.index[f"Im{i + 1}"])[0])
        out = []
        for table, good in zip(tables, kept, strict=True):
            own = table.balances[balance]
            right = correlate1d(own.right, smooth, axis=-1)[:, half:-half]
            known = own.left.shape[-1] - len(layout.zeros)
            time = np.broadcast_to(np.linspace(-1.0, 1.0, right.shape[1]), right.shape)
            z = np.concatenate([own.left[:, half:-half, :known], time[..., None], right[..., None]], axis=-1)
            z[~good[:, half:-half]] = np.nan
            z -= np.nanmean(z, axis=1, keepdims=True)
            flat = z.reshape(-1, z.shape[-1])
            flat = flat[np.isfinite(flat).all(axis=1)]
            scale = np.maximum(np.linalg.norm(flat, axis=0)[:-1], 1e-300)
            value = (
                np.linalg.lstsq(flat[:, :-1] / scale, flat[:, -1], rcond=limits.RCOND_OF_CONTROLLER.value)[0] / scale
            )
            out.append(_Left(z[..., :-1] @ value - z[..., -1], float(value[inertia])))
        yield i, out


def _acting(arm: Arm, joint: int, runs: Sequence[_Left]) -> tuple[float, float]:
    """Variance of one torque reading of a joint, Nm^2, as its motor balance shows it, and the deviation of that.

    Second differences of what is left over of the impulse, beyond what the noise of the encoder leaves: of white noise
    they say the same at every distance, and what no column explains only adds to them. So the least of all distances
    counts.
    """
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s
    smooth, rate = (coefficients(points, order, 0.0, k) / h**k for k in (0, 1))
    inertia = float(np.mean([abs(one.inertia) for one in runs]))
    # the two encoders of a joint part at its spring alone, which adds little
    reading = inertia * arm.gear_ratios[joint] * arm.over_the_wire.joints[joint].motor_encoder.sigma_rad
    found: list[tuple[float, float]] = []
    lag = points
    while 3 * lag < min(one.impulse.shape[-1] for one in runs):
        each = (x[:, 2 * lag :] - 2.0 * x[:, lag:-lag] + x[:, : -2 * lag] for x in (one.impulse for one in runs))
        second = np.concatenate([x[np.isfinite(x)] for x in each])
        if len(second) < limits.FEWEST_CYCLES.value:
            break
        taps = np.zeros(2 * lag + 1)
        taps[[0, lag, 2 * lag]] = 1.0, -2.0, 1.0
        of_reading = reading * float(np.linalg.norm(np.convolve(taps, rate)))
        of_torque = h * float(np.linalg.norm(np.cumsum(np.convolve(taps, smooth))))
        square = (float(np.median(np.abs(second))) / limits.MEDIAN_DEVIATION.value) ** 2
        independent = len(second) / (points if square < 2.0 * of_reading**2 else lag)
        deviation = square / of_torque**2 * np.sqrt(2.0 / (limits.MEDIAN_EFFICIENCY.value * max(independent, 1.0)))
        found.append(((square - of_reading**2) / of_torque**2, float(deviation)))
        lag *= 2
    return min(found, key=lambda one: one[0] + one[1], default=(np.inf, np.inf))


def torque_noise(record: MeasuredRun) -> Array:
    """(N,) standard deviation of one torque reading, Nm; 0 where it is that of the bus.

    The servo read its encoders before the bus rounded their readings, which is taken into account.
    """
    samples, arm = record.samples, record.arm
    out = np.zeros(arm.n)
    taps = _binomial(limits.DIFFERENCES.value)
    correlation = np.correlate(taps, taps, "full")[limits.DIFFERENCES.value :]
    rounded = toeplitz(
        np.pad(correlation, (0, max(0, limits.LAGS.value - limits.DIFFERENCES.value)))[: limits.LAGS.value + 1]
    )
    for i, joint in enumerate(arm.joints):
        fast, answers = [], []
        for start, stop in samples.segments:
            good = np.flatnonzero(np.isfinite(samples.tau[start:stop, i]))
            if len(good) < limits.FEWEST_CYCLES.value:
                continue
            of = slice(start, start + int(good[-1]) + 1)
            signals = [np.diff(x[of, i], limits.DIFFERENCES.value) for x in (samples.q, samples.theta)]
            fast.append(np.diff(samples.tau[of, i], limits.DIFFERENCES.value)[limits.LAGS.value :])
            shifted = [
                x[limits.LAGS.value - lag : len(x) - lag] for x in signals for lag in range(limits.LAGS.value + 1)
            ]
            answers.append(np.stack(shifted, axis=1))
        if not fast:
            continue
        jitter, answer = np.concatenate(fast), np.concatenate(answers)
        sigmas = [(e.over_the_wire.sigma_rad**2 - e.sigma_rad**2) for e in (joint.link_encoder, joint.motor_encoder)]
        error = block_diag(*(max(x, 0.0) * rounded for x in sigmas))
        gram = answer.T @ answer / len(answer)
        scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
        if np.linalg.eigvalsh((gram - error) / np.outer(scale, scale))[0] < 1e-6:
            # no reading tells more than the bus rounded away
            error = np.zeros_like(error)
        gain = np.linalg.lstsq(gram - error, answer.T @ jitter / len(answer), rcond=limits.RCOND_OF_CONTROLLER.value)[0]
        # a torque that steps would count otherwise
        left = float(np.median(np.abs(jitter - answer @ gain))) / limits.MEDIAN_DEVIATION.value
        sigma = np.sqrt(max(0.0, left**2 - gain @ error @ gain) / float(taps @ taps))
        out[i] = sigma if sigma > limits.ROUNDING_Z.value * _ROUNDING else 0.0
    return out


def _binomial(order: int) -> Array:
    row = np.ones(1)
    for _ in range(order):
        row = np.convolve(row, [1.0, -1.0])
    return np.asarray(row, dtype=np.float64)

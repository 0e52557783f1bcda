"""Noise of torque sensors that the arm file says nothing about, from the runs themselves.

A servo answers every reading of its encoders, so that a torque jitters although it is measured without error: this
jitter acts. What is left of a torque's fast part after the answer to the readings is taken off is noise of its sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, toeplitz

from zygos.arm import TORQUE_STEP, Arm
from zygos.gap.record import MeasuredRun

Array = NDArray[np.float64]

_ORDER = 3
"""Differences that leave nothing of a motion but what changes from cycle to cycle."""
_LAGS = 4
"""Readings that a servo answers to: the newest and those before."""
_STEPS = 3.0
"""Noise below so many deviations of the rounding on the bus is none."""
_FEWEST = 200


def with_torque_noise(arm: Arm, records: Sequence[MeasuredRun]) -> Arm:
    """The arm with the noise that its torques have in these runs, where its file declares none."""
    found = np.array([torque_noise(record) for record in records])
    sigma = np.sqrt((found**2).mean(axis=0))
    joints = tuple(
        joint if joint.torque_sigma > 0.0 else replace(joint, torque_sigma=float(x))
        for joint, x in zip(arm.joints, sigma, strict=True)
    )
    return replace(arm, joints=joints)


def torque_noise(record: MeasuredRun) -> Array:
    """(N,) standard deviation of one torque reading, Nm; 0 where it is that of the bus.

    The servo read its encoders before the bus rounded their readings, which is taken into account.
    """
    samples, arm = record.samples, record.arm
    out = np.zeros(arm.n)
    taps = _binomial(_ORDER)
    correlation = np.correlate(taps, taps, "full")[_ORDER:]
    rounded = toeplitz(np.pad(correlation, (0, max(0, _LAGS - _ORDER)))[: _LAGS + 1])
    for i, joint in enumerate(arm.joints):
        fast, answers = [], []
        for start, stop in samples.segments:
            good = np.flatnonzero(np.isfinite(samples.tau[start:stop, i]))
            if len(good) < _FEWEST:
                continue
            of = slice(start, start + int(good[-1]) + 1)
            signals = [np.diff(x[of, i], _ORDER) for x in (samples.q, samples.theta)]
            fast.append(np.diff(samples.tau[of, i], _ORDER)[_LAGS:])
            shifted = [x[_LAGS - lag : len(x) - lag] for x in signals for lag in range(_LAGS + 1)]
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
        gain = np.linalg.lstsq(gram - error, answer.T @ jitter / len(answer), rcond=1e-9)[0]
        # a torque that steps would count otherwise
        left = float(np.median(np.abs(jitter - answer @ gain))) / 0.6745
        sigma = np.sqrt(max(0.0, left**2 - gain @ error @ gain) / float(taps @ taps))
        out[i] = sigma if sigma > _STEPS * TORQUE_STEP / np.sqrt(12.0) else 0.0
    return out


def _binomial(order: int) -> Array:
    row = np.ones(1)
    for _ in range(order):
        row = np.convolve(row, [1.0, -1.0])
    return np.asarray(row, dtype=np.float64)

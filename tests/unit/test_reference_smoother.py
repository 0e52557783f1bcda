# SPDX-License-Identifier: MIT
"""The numpy smoother against SciPy's coefficients, exact polynomials and known noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from reference_support import Floats, make_arm
from scipy.signal import savgol_coeffs

from zygos.arm import Smoother
from zygos.errors import ZygosError
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import bandwidth_coefficients, coefficients, convolve, smooth


def record(q: Floats, theta: Floats, omega: Floats | None = None) -> Cycles:
    n = len(q)
    return Cycles(
        sync=np.arange(n, dtype=np.uint64),
        q=q,
        theta=theta,
        tau=np.zeros_like(q),
        omega=np.zeros((n, 3)) if omega is None else omega,
        flags=np.zeros(n, dtype=np.uint32),
    )


@pytest.mark.parametrize(("points", "order"), [(5, 2), (7, 4), (11, 6), (15, 4), (31, 6)])
@pytest.mark.parametrize("offset", [0.0, -0.3, 0.45])
@pytest.mark.parametrize("derivative", [0, 1])
def test_coefficients_are_scipys(points: int, order: int, offset: float, derivative: int) -> None:
    expected = savgol_coeffs(points, order, deriv=derivative, pos=points // 2 + offset, use="dot")
    np.testing.assert_allclose(coefficients(points, order, offset, derivative), expected, atol=2e-13)


def test_seven_points_of_order_four_are_the_printed_ones() -> None:
    """Savitzky & Golay 1964, tables II and V: quartic smoothing and its first derivative over seven points."""
    np.testing.assert_allclose(coefficients(7, 4) * 231, [5, -30, 75, 131, 75, -30, 5], atol=1e-11)
    np.testing.assert_allclose(coefficients(7, 4, 0.0, 1) * 252, [22, -67, -58, 0, 58, 67, -22], atol=1e-11)


@pytest.mark.parametrize(("points", "order", "derivative"), [(6, 2, 0), (5, 5, 0), (1, 0, 0), (7, 2, 3)])
def test_impossible_windows_are_refused(points: int, order: int, derivative: int) -> None:
    with pytest.raises(ZygosError, match="remedy"):
        coefficients(points, order, 0.0, derivative)


def test_a_window_too_short_for_the_bandwidth_test_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="bandwidth"):
        bandwidth_coefficients(5, 4)
    arm = replace(make_arm(tmp_path), smoother=Smoother(points=5, order=4, lag=2))
    with pytest.raises(ZygosError, match="bandwidth"):
        smooth(arm, calibrate(arm, record(np.zeros((20, 2)), np.zeros((20, 2)))))


def test_convolution_is_a_correlation_and_keeps_the_axis() -> None:
    x = np.arange(24.0).reshape(8, 3) ** 2
    out = convolve(x, np.array([1.0, 0.0, -2.0]))
    np.testing.assert_array_equal(out, x[:-2] - 2.0 * x[2:])


def test_latch_delays_are_undone(tmp_path: Path) -> None:
    """A quartic motion, each sensor read late by its own delay: the smoothed state is that of the SYNC."""
    arm = make_arm(
        tmp_path,
        encoder="latch_us = 1500",
        joint="latch_us = 2500",
        imu="mount_xyzw = [0, 0, 0, 1]\nlatch_us = 7000",
    )
    t = arm.period_s * np.arange(40)
    q = np.polynomial.Polynomial([0.2, 0.7, -0.8, 0.3, 0.2])
    rate = np.polynomial.Polynomial([0.1, -0.3, 0.2, 0.5, -0.4])
    late = t + 4e-3
    readings = np.stack([q(late), 2.0 * q(late)], axis=1)
    omega = np.stack([np.zeros(40), np.zeros(40), rate(t + 7e-3)], axis=1)
    smoothed = smooth(arm, calibrate(arm, record(readings, readings + 1.0, omega)))
    inner = t[3:-3]
    np.testing.assert_array_equal(smoothed.index, np.arange(3, 37))
    np.testing.assert_allclose(smoothed.q, np.stack([q(inner), 2.0 * q(inner)], axis=1), atol=1e-13)
    np.testing.assert_allclose(smoothed.theta, smoothed.q + 1.0, atol=1e-13)
    np.testing.assert_allclose(smoothed.qd[:, 1], 2.0 * q.deriv()(inner), atol=1e-11)
    np.testing.assert_allclose(smoothed.thetad, smoothed.qd, atol=1e-11)
    np.testing.assert_allclose(smoothed.omega[:, 2], rate(inner), atol=1e-13)


def test_segments_are_not_bridged(tmp_path: Path) -> None:
    arm = make_arm(tmp_path)
    cycles = record(np.random.default_rng(1).normal(size=(60, 2)), np.zeros((60, 2)))
    cycles.flags[25] = 1
    cycles.flags[50] = 2
    smoothed = smooth(arm, calibrate(arm, cycles))
    expected = [*range(3, 22), *range(28, 47), *range(54, 57)]
    np.testing.assert_array_equal(smoothed.index, expected)
    np.testing.assert_array_equal(np.unique(smoothed.segment, return_counts=True)[1], [19, 19, 3])


def test_a_record_too_short_gives_nothing(tmp_path: Path) -> None:
    arm = make_arm(tmp_path)
    smoothed = smooth(arm, calibrate(arm, record(np.zeros((6, 2)), np.zeros((6, 2)))))
    assert smoothed.q.shape == (0, 2)
    assert smoothed.omega.shape == (0, 3)


def test_bandwidth_statistic_is_a_standard_normal_under_declared_noise(tmp_path: Path) -> None:
    """Only one signal is noisy; then |statistic| exceeds 1, 2 as often as a normal variable does, and never 6."""
    arm = make_arm(tmp_path, counts=2000)
    sigma = arm.joints[1].motor_encoder.sigma_rad
    theta = np.zeros((60_000, 2))
    theta[:, 1] = np.random.default_rng(5).normal(scale=sigma, size=60_000)
    smoothed = smooth(arm, calibrate(arm, record(np.zeros((60_000, 2)), theta)))
    assert np.mean(smoothed.bandwidth > 1.0) == pytest.approx(0.3173, abs=0.01)
    assert np.mean(smoothed.bandwidth > 2.0) == pytest.approx(0.0455, abs=0.005)
    assert smoothed.bandwidth.max() < 6.0
    np.testing.assert_array_equal(smoothed.accepted, smoothed.bandwidth <= 4.0)


def test_a_snap_is_refused_and_slow_motion_is_not(tmp_path: Path) -> None:
    arm = make_arm(tmp_path, counts=2000, period=0.05)
    t = arm.period_s * np.arange(200)
    slow = np.stack([np.sin(t), np.cos(2.0 * t)], axis=1)
    snap = slow.copy()
    snap[:, 0] += 0.3 * np.tanh((t - t[100]) / 0.05)
    for theta, refused in ((slow, 0), (snap, None)):
        smoothed = smooth(arm, calibrate(arm, record(slow, theta)))
        if refused == 0:
            assert smoothed.accepted.all()
        else:
            at = smoothed.index[~smoothed.accepted]
            assert 2 <= len(at) <= 10
            assert np.all(np.abs(at - 100) <= 5)

# SPDX-License-Identifier: MIT
"""The library's smoother against scipy's, on polynomials, and its bandwidth test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray
from reference_support import make_arm
from scipy.signal import savgol_coeffs

from zygos.arm import Arm
from zygos.native.flight import config_of, ffi, lib

Floats = NDArray[np.float64]


def coefficients(half: int, order: int, offset: float, derivative: int) -> Floats:
    out = ffi.new("double[]", lib.ZYGOS_MAX_WINDOW_VALUE)
    lib.zygos_smoother_coefficients(half, order, offset, derivative, out)
    return np.array(list(out))[: 2 * half + 1]


class Smoother:
    """zygos_smoother_t of an arm; push() takes (2N+3,) samples and gives the state, or None while the window fills."""

    def __init__(self, arm: Arm) -> None:
        self.native = ffi.new("zygos_smoother_t *")
        lib.zygos_smoother_init(self.native, config_of(arm))
        self.state = ffi.new("zygos_arm_state_t *")

    def push(self, signal: Floats) -> Any:
        full = lib.zygos_smoother_push(
            self.native, ffi.from_buffer("double[]", np.ascontiguousarray(signal)), self.state
        )
        return self.state if full else None


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize("offset", [0.0, -0.06, -0.5, -1.0, 0.4])
@pytest.mark.parametrize(("half", "order"), [(2, 2), (3, 2), (3, 4), (5, 2), (5, 4), (7, 4), (15, 3), (15, 4)])
def test_coefficients_are_scipys(half: int, order: int, offset: float, derivative: int) -> None:
    expected = savgol_coeffs(2 * half + 1, order, deriv=derivative, pos=half + offset, use="dot")
    np.testing.assert_allclose(coefficients(half, order, offset, derivative), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("derivative", [0, 1])
@pytest.mark.parametrize("offset", [0.0, -1.0, 0.37])
@pytest.mark.parametrize(("half", "order"), [(3, 4), (5, 6), (5, 8), (7, 8), (15, 8), (15, 20)])
def test_coefficients_of_high_orders_are_exact(half: int, order: int, offset: float, derivative: int) -> None:
    """Against the normal equations in 60 digits: scipy's powers of the sample number are too ill-conditioned here."""
    with mpmath.workdps(60):
        design = mpmath.matrix(2 * half + 1, order + 1)
        reader = mpmath.matrix(order + 1, 1)
        for power in range(order + 1):
            for j in range(2 * half + 1):
                design[j, power] = mpmath.mpf(j - half) ** power
            reader[power] = mpmath.diff(lambda x, n=power: x**n, offset, derivative)
        exact = design * mpmath.lu_solve(design.T * design, reader)
    np.testing.assert_allclose(coefficients(half, order, offset, derivative), [float(c) for c in exact], atol=1e-12)


@pytest.mark.parametrize(("half", "order"), [(2, 2), (3, 4), (8, 14), (15, 28)])
def test_coefficients_reproduce_polynomials_up_to_the_largest_allowed_order(half: int, order: int) -> None:
    x = np.arange(-half, half + 1) / half
    for offset in (0.0, -1.0):
        at = offset / half
        value, slope = coefficients(half, order, offset, 0), coefficients(half, order, offset, 1)
        for power in range(order + 1):
            assert abs(value @ x**power - at**power) < 1e-9
            exact = power * at ** (power - 1) / half if power else 0.0
            assert abs(slope @ x**power - exact) < 1e-8


def test_a_polynomial_of_the_order_passes_unchanged(tmp_path: Path) -> None:
    """Signals and rates of all joints and the gyro, at the middle of the window, whatever the place in the ring."""
    arm = replace(make_arm(tmp_path), period_s=0.02)
    rng = np.random.default_rng(1)
    signals = 2 * arm.n + 3
    polynomials = [np.polynomial.Polynomial(rng.normal(size=arm.smoother.order + 1)) for _ in range(signals)]
    smoother = Smoother(arm)
    half = arm.smoother.lag
    times = arm.period_s * np.arange(40)
    for c, t in enumerate(times):
        state = smoother.push(np.array([p(t) for p in polynomials]))
        assert (state is not None) == (c >= 2 * half)
        if state is None:
            continue
        k = times[c - half]
        value = [*state.q[0:2], *state.theta[0:2], *state.omega]
        rate = [*state.q_rate[0:2], *state.theta_rate[0:2]]
        np.testing.assert_allclose(value, [p(k) for p in polynomials], rtol=0, atol=1e-13)
        np.testing.assert_allclose(rate, [p.deriv()(k) for p in polynomials[:4]], rtol=0, atol=1e-11)
        assert state.accepted == 1.0


def test_a_late_sensor_is_read_early_on_its_own_polynomial(tmp_path: Path) -> None:
    """Each sensor shows the motion of the moment when it latched; the state is that of the SYNC."""
    arm = make_arm(tmp_path, period=0.02, imu="latch_us = 4000", joint="latch_us = 1500")
    joints = tuple(
        replace(
            joint,
            link_encoder=replace(joint.link_encoder, latch_us=700 * (i + 1)),
            motor_encoder=replace(joint.motor_encoder, latch_us=2500),
        )
        for i, joint in enumerate(arm.joints)
    )
    arm = replace(arm, joints=joints)
    late = 1e-6 * np.array([1500 + 700, 1500 + 1400, 1500 + 2500, 1500 + 2500, 4000, 4000, 4000])
    rng = np.random.default_rng(2)
    polynomials = [np.polynomial.Polynomial(rng.normal(size=5)) for _ in late]
    smoother = Smoother(arm)
    times = arm.period_s * np.arange(12)
    state = None
    for t in times:
        state = smoother.push(np.array([p(t + d) for p, d in zip(polynomials, late, strict=True)]))
    assert state is not None
    k = times[-1 - arm.smoother.lag]
    value = [*state.q[0:2], *state.theta[0:2], *state.omega]
    rate = [*state.q_rate[0:2], *state.theta_rate[0:2]]
    np.testing.assert_allclose(value, [p(k) for p in polynomials], rtol=0, atol=1e-13)
    np.testing.assert_allclose(rate, [p.deriv()(k) for p in polynomials[:4]], rtol=0, atol=1e-11)


def test_a_gap_empties_the_window(tmp_path: Path) -> None:
    arm = make_arm(tmp_path)
    smoother = Smoother(arm)
    window = arm.smoother.points
    for _ in range(window):
        state = smoother.push(np.full(7, 1e9))
    assert state is not None
    lib.zygos_smoother_reset(smoother.native)
    for c in range(window):
        state = smoother.push(np.full(7, 0.5))
        assert (state is not None) == (c == window - 1)
    assert state is not None
    np.testing.assert_allclose([*state.q[0:2], *state.theta[0:2], *state.omega], 0.5, rtol=1e-15)


@pytest.mark.parametrize("signal", range(4))
def test_bandwidth_test_refuses_above_four_sigma_only(tmp_path: Path, signal: int) -> None:
    """A single sample that stands out moves the two slopes apart by its coefficient of their difference."""
    arm = make_arm(tmp_path, period=0.02, counts=2000)
    half, order = arm.smoother.lag, arm.smoother.order
    probe = coefficients(half, order, 0.0, 1) - np.pad(coefficients(half - 1, order, 0.0, 1), 1)
    sigma = arm.joints[0].link_encoder.sigma_rad
    place = int(np.argmax(np.abs(probe)))
    threshold = 4.0 * sigma * float(np.linalg.norm(probe)) / abs(probe[place])
    for factor, accepted in ((0.999, 1.0), (1.001, 0.0), (-0.999, 1.0), (-1.001, 0.0)):
        smoother = Smoother(arm)
        for j in range(2 * half + 1):
            sample = np.zeros(7)
            sample[signal] = factor * threshold if j == place else 0.0
            state = smoother.push(sample)
        assert state.accepted == accepted


def test_the_gyro_and_encoders_without_declared_noise_are_not_tested(tmp_path: Path) -> None:
    arm = make_arm(tmp_path)
    config = config_of(arm)
    for i in range(arm.n):
        config.joint[i].link_sigma_rad = 0.0
    native, state = ffi.new("zygos_smoother_t *"), ffi.new("zygos_arm_state_t *")
    lib.zygos_smoother_init(native, config)
    for j in range(arm.smoother.points):
        wild = [100.0 * (-1) ** j] * 2 + [0.0] * 2 + [-50.0 * (-1) ** j] * 3
        full = lib.zygos_smoother_push(native, ffi.new("double[]", wild), state)
    assert full == 1
    assert state.accepted == 1.0

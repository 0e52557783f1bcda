# SPDX-License-Identifier: MIT
"""The library's sine and cosine against mpmath, and the Gram table of the rate vectors."""

from __future__ import annotations

from pathlib import Path

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray
from reference_support import make_arm

from zygos.native.flight import config_of, ffi, lib

Floats = NDArray[np.float64]


def sincos(angles: Floats) -> Floats:
    """(2, n): sines and cosines."""
    sine, cosine = ffi.new("double *"), ffi.new("double *")
    out = np.empty((2, len(angles)))
    for i, angle in enumerate(angles):
        lib.zygos_sincos(float(angle), sine, cosine)
        out[:, i] = sine[0], cosine[0]
    return out


def worst_ulp(angles: Floats) -> float:
    """Largest error of sine or cosine in units of the last place of the exact value."""
    worst = 0.0
    found = sincos(angles)
    with mpmath.workdps(60):
        for i, angle in enumerate(angles):
            exact_angle = mpmath.mpf(float(angle))
            for value, exact in zip(found[:, i], (mpmath.sin(exact_angle), mpmath.cos(exact_angle)), strict=True):
                worst = max(worst, float(abs(mpmath.mpf(float(value)) - exact) / np.spacing(abs(float(exact)))))
    return worst


def around(points: Floats) -> Floats:
    """Each point, its neighbours among the doubles, and points a little further off."""
    return np.concatenate([points, np.nextafter(points, np.inf), np.nextafter(points, -np.inf), points * (1 + 1e-9)])


def test_one_ulp_over_fifty_radians() -> None:
    angles = np.random.default_rng(1).uniform(-50.0, 50.0, 5_000)
    assert worst_ulp(angles) <= 1.0


def test_one_ulp_beside_the_multiples_of_an_eighth_turn() -> None:
    """There the exact value is near 0, +-1 or equal for both, and the quadrant changes."""
    assert worst_ulp(around(np.arange(-64, 65) * (np.pi / 4))) <= 1.0


def test_one_ulp_of_tiny_angles() -> None:
    tiny = 10.0 ** np.random.default_rng(2).uniform(-300.0, -1.0, 500)
    assert worst_ulp(np.concatenate([tiny, -tiny])) <= 1.0


def test_one_ulp_up_to_the_stated_range() -> None:
    rng = np.random.default_rng(3)
    far = rng.uniform(-1e5, 1e5, 1000)
    quarters = np.round(rng.uniform(-6e4, 6e4, 300)) * (np.pi / 2)
    assert worst_ulp(np.concatenate([far, around(quarters), [1e5, -1e5]])) <= 1.0


def test_zero() -> None:
    assert sincos(np.array([0.0])).tolist() == [[0.0], [1.0]]


def test_sine_is_odd_and_cosine_even_to_the_bit() -> None:
    angles = np.random.default_rng(4).uniform(0.0, 50.0, 5000)
    right, left = sincos(angles), sincos(-angles)
    np.testing.assert_array_equal(left[0], -right[0])
    np.testing.assert_array_equal(left[1], right[1])


def test_on_the_unit_circle() -> None:
    sine, cosine = sincos(np.random.default_rng(5).uniform(-50.0, 50.0, 5000))
    np.testing.assert_allclose(sine**2 + cosine**2, 1.0, rtol=4.5e-16)


def test_not_a_number_stays_one() -> None:
    assert np.isnan(sincos(np.array([np.nan, np.inf, -np.inf]))).all()


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (0.6, 0.0, -0.8)])
@pytest.mark.parametrize("joints", [1, 2, 7])
def test_gram_table_is_that_of_the_plane_vectors(tmp_path: Path, joints: int, axis: tuple[float, ...]) -> None:
    arm = make_arm(tmp_path, joints=joints)
    rng = np.random.default_rng(joints)
    config = config_of(arm)
    for i in range(joints):
        config.joint[i].axis = axis
    state = ffi.new("zygos_arm_state_t *")
    q, rate, omega = rng.uniform(-8.0, 8.0, joints), rng.normal(size=joints), rng.normal(size=3)
    state.q[0:joints] = q.tolist()
    state.q_rate[0:joints] = rate.tolist()
    state.omega = omega.tolist()
    motion, geometry = ffi.new("zygos_motion_t *"), ffi.new("zygos_geometry_t *")
    lib.zygos_geometry_init(geometry, config)
    lib.zygos_kinematics(geometry, config, state, motion)

    f = np.concatenate([[0.0], np.cumsum(rate)]) + omega @ np.array(axis)
    vector = f * np.exp(1j * np.concatenate([[0.0], np.cumsum(q)]))
    gram = np.real(vector[:, None] * vector.conj()) * (1.0 - 0.5 * np.eye(len(vector)))
    entries = len(vector) * (len(vector) + 1) // 2
    np.testing.assert_allclose(list(motion.column)[:entries], gram[np.triu_indices(joints + 1)], rtol=0, atol=2e-14)
    np.testing.assert_allclose(list(motion.carrier_rate)[:joints], f[:-1], rtol=1e-15, atol=1e-15)

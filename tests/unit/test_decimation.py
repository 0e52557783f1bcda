# SPDX-License-Identifier: MIT
"""Recordings faster than the grid: averages against motions, noise and integrals that are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.runs.smoother import coefficients, convolve
from zygos.telemetry.grid import Track, averaged, decimated, grid_noise, linear_mean, noisier, regrid
from zygos.telemetry.map import Channel, Clock, Map

Floats = NDArray[np.float64]
PERIOD = 0.05
CHANNEL = Channel("elbow.motor", "theta", 1, "angle", "m", "rad", 1.0, 0.0, True, "map.toml: joint[1].motor")
TORQUE = replace(CHANNEL, label="elbow.torque", field="tau", quantity="torque")
MAP = Map(Clock("receive", interpolation="cubic"), (CHANNEL,))


def stamps(ratio: float, length_s: float, seed: int, jitter: float = 0.3) -> Floats:
    """Uneven times, about `ratio` to a period."""
    even = np.arange(0.0, length_s, PERIOD / ratio)
    return even + jitter * PERIOD / ratio * np.random.default_rng(seed).uniform(-1, 1, len(even))


@pytest.mark.parametrize(("cycles_per_period", "low", "high"), [(0.02, 0.999, 1.001), (0.1, 0.995, 1.001)])
def test_slow_motion_keeps_its_size(cycles_per_period: float, low: float, high: float) -> None:
    """Also with uneven stamps, and without delay."""
    t = stamps(5.0, 60.0, 0)
    w = 2 * math.pi * cycles_per_period / PERIOD
    at = np.arange(1.0, 59.0, PERIOD)
    got = averaged(Track(CHANNEL, t, np.sin(w * t)), at, PERIOD).value
    sine, cosine = np.linalg.lstsq(np.column_stack([np.sin(w * at), np.cos(w * at)]), got, rcond=None)[0]
    assert low < math.hypot(sine, cosine) < high
    assert abs(math.atan2(cosine, sine)) < 2e-3


@pytest.mark.parametrize("cycles_per_period", [0.9, 1.0, 1.1, 2.0])
def test_what_would_appear_as_slow_motion_is_reduced(cycles_per_period: float) -> None:
    """Interpolation leaves it as it is."""
    t = stamps(8.0, 60.0, 0, jitter=0.0)
    at = np.arange(1.0, 59.0, PERIOD) + 0.013
    track = Track(CHANNEL, t, np.sin(2 * math.pi * cycles_per_period / PERIOD * t + 0.4))
    assert np.max(np.abs(averaged(track, at, PERIOD).value)) < 0.04


@pytest.mark.slow(only=["20.0"])
@pytest.mark.parametrize("ratio", [3.0, 20.0])
def test_the_declared_noise_is_that_of_smoothed_rates(arm: Arm, ratio: float) -> None:
    """White noise keeps its density: the rate that a smoother finds is as uncertain as the arm file of the run says."""
    sigma = 1e-3
    weights = coefficients(25, 4, 0.0, 1)
    seen = []
    for seed in range(12):
        t = stamps(ratio, 40.0, seed)
        x = sigma * np.random.default_rng(100 + seed).standard_normal(len(t))
        got = averaged(Track(CHANNEL, t, x), np.arange(1.0, 39.0, PERIOD), PERIOD).value
        seen.append(float(np.std(convolve(got[:, None], weights))))
    fine = sigma * math.sqrt(12.0)
    fine_arm = replace(
        arm, joints=tuple(replace(j, motor_encoder=replace(j.motor_encoder, quantum_rad=fine)) for j in arm.joints)
    )
    noise = grid_noise(Track(CHANNEL, t, x), np.arange(1.0, 39.0, PERIOD), fine_arm, MAP)
    assert noise.kept == pytest.approx(1.0 / math.sqrt(ratio), rel=0.02)
    declared = noisier(fine_arm, [CHANNEL], [noise]).joints[1].motor_encoder
    assert declared.counts is None
    spread = np.std(seen) / math.sqrt(len(seen))
    expected = declared.sigma_rad * np.linalg.norm(weights)
    print(ratio, np.mean(seen) / expected)
    assert abs(np.mean(seen) - expected) < 3 * spread + 0.05 * expected


def test_noise_beyond_the_declared_one_is_added(arm: Arm) -> None:
    t = stamps(5.0, 60.0, 0)
    x = np.sin(t) + 0.02 * np.random.default_rng(1).standard_normal(len(t))
    noise = grid_noise(Track(CHANNEL, t, x), np.arange(1.0, 59.0, PERIOD), arm, MAP)
    own = arm.joints[1].motor_encoder.sigma_rad
    assert noise.kept == pytest.approx(math.sqrt(0.2), rel=0.01)
    assert noise.added == pytest.approx(math.sqrt(0.2 * (0.02**2 - own**2)), rel=0.05)


@pytest.mark.slow
def test_the_integral_of_a_torque_is_kept() -> None:
    """The sum of the means over a minute, against the integral of the straight lines between the samples."""
    t = stamps(7.0, 60.0, 3)
    x = np.cumsum(np.random.default_rng(4).standard_normal(len(t)))
    at = 1.0 + PERIOD * np.arange(1000)
    got = linear_mean(Track(TORQUE, t, x), at, PERIOD)
    fine = np.linspace(at[0] - PERIOD / 2, at[-1] + PERIOD / 2, 2_000_001)
    expected = np.trapezoid(np.interp(fine, t, x), fine)
    assert PERIOD * got.sum() == pytest.approx(expected, rel=1e-9)
    assert np.isnan(linear_mean(Track(TORQUE, t, x), np.array([t[0]]), PERIOD)[0])


@pytest.mark.parametrize("law", ["applied_from_sync", "sampled"])
def test_the_grid_averages_what_is_fast_enough(arm: Arm, law: str) -> None:
    """From 2.5 samples in a period on they are averaged, two are interpolated."""
    described = replace(arm, torque_law=law)
    for ratio, expected in ((3.0, True), (2.0, False)):
        t = np.arange(0.0, 30.0, PERIOD / ratio)
        x = np.random.default_rng(5).standard_normal(len(t))
        found = [Track(CHANNEL, t, x), Track(TORQUE, t, x)]
        got = regrid(found, described, MAP)
        assert decimated(found[0], PERIOD) is expected
        size = float(np.std(got.theta[:, 1]))
        assert (size < 0.7) is expected
        # either way the mean of the torque is kept
        assert np.mean(got.tau[5:-5, 1]) == pytest.approx(np.mean(x), abs=0.15)


def test_nothing_is_averaged_over_a_hole() -> None:
    t = np.r_[0.0:10.0:0.01, 10.2:20.0:0.01]
    got = averaged(Track(CHANNEL, t, np.sin(t)), np.array([9.85, 9.95, 10.1, 10.25, 10.35]), PERIOD)
    assert np.isfinite(got.value).tolist() == [True, False, False, False, True]
    assert np.isfinite(got.variance).tolist() == [True, False, False, False, True]

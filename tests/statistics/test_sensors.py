# SPDX-License-Identifier: MIT
"""Sensor errors: sizes and units within three standard errors over fixed seeds, and reproducibility by seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_support import Floats, lively
from runs_support import trajectory_of

from zygos.arm import Arm
from zygos.simulation.sensors import draw_noise, encoder_angle, encoder_reading, gyro_reading, no_noise, torque_record

SEEDS = range(40)
CYCLES = 1200


def loud() -> Arm:
    """An arm with torque noise, which it does not have."""
    arm = lively()[0]
    return replace(arm, joints=tuple(replace(joint, torque_sigma=0.02) for joint in arm.joints))


def assert_gaussian(values: Floats, sigma: float) -> None:
    """Mean 0, variance sigma^2 and no correlation from cycle to cycle, each within three standard errors."""
    count = values.size
    assert abs(values.mean()) < 3 * sigma / np.sqrt(count)
    assert abs(np.mean(values**2) / sigma**2 - 1.0) < 3 * np.sqrt(2.0 / count)
    assert abs(np.mean(values[:, 1:] * values[:, :-1])) < 3 * sigma**2 / np.sqrt(count)
    assert abs(np.mean(values**4) / sigma**4 - 3.0) < 3 * np.sqrt(96.0 / count)


def test_encoders_and_torque() -> None:
    noise = draw_noise(loud(), CYCLES, SEEDS)
    for joint in range(2):
        assert_gaussian(noise.link[..., joint], 0.003 / np.sqrt(12))
        assert_gaussian(noise.motor[..., joint], 0.003 / np.sqrt(12))
        assert_gaussian(noise.torque[..., joint], 0.02)
    every = np.concatenate([noise.link, noise.motor, noise.torque], axis=-1).reshape(-1, 6)
    correlation = np.corrcoef(every.T) - np.eye(6)
    assert np.abs(correlation).max() < 3.5 / np.sqrt(len(every))  # the largest of 15


def test_gyro_white_part_and_units() -> None:
    """sigma_v = 0.31623 urad/s^(1/2): one sample at 0.05 s errs by 1.414e-6 rad/s."""
    arm = lively()[0]
    noise = draw_noise(arm, CYCLES, SEEDS)
    white = noise.gyro - noise.bias
    for axis in range(3):
        assert_gaussian(white[..., axis], 0.31623e-6 / np.sqrt(0.05))
    faster = draw_noise(arm.at_period(0.005), CYCLES, SEEDS)
    assert_gaussian(faster.gyro[..., 2] - faster.bias[..., 2], 0.31623e-6 / np.sqrt(0.005))


def test_gyro_bias_walks() -> None:
    """sigma_u = 3.1623e-4 urad/s^(3/2): after t seconds the bias has the variance sigma_u^2 t."""
    arm = lively()[0]
    seeds = range(400)
    bias = draw_noise(arm, 241, seeds).bias
    sigma = 3.1623e-10
    np.testing.assert_array_equal(bias[:, 0], 0.0)
    for axis in range(3):
        assert_gaussian(np.diff(bias[..., axis], axis=1), sigma * np.sqrt(0.05))
    variance = np.mean(bias[:, -1] ** 2)
    assert abs(variance / (sigma**2 * 12.0) - 1.0) < 3 * np.sqrt(2.0 / (3 * len(seeds)))


def test_a_strong_walk_shows_in_the_reading() -> None:
    """Farrenkopf's sampled gyro: the mean of both ends of the bias, and the walk's own variance in the white part."""
    arm = lively()[0]
    arm = replace(arm, imu=replace(arm.imu, rate_sigma=1e-9, bias_walk=1.0))
    noise = draw_noise(arm, CYCLES, SEEDS)
    mean = 0.5 * (noise.bias[:, 1:] + noise.bias[:, :-1])
    assert_gaussian((noise.gyro[:, :-1] - mean)[..., 0], np.sqrt(0.05 / 12.0))


def test_a_seed_is_the_same_alone_in_a_batch_and_in_a_longer_run() -> None:
    arm = loud()
    batch = draw_noise(arm, 300, range(10))
    alone = draw_noise(arm, 300, [7])
    short = draw_noise(arm, 200, [7])
    for name in ("link", "motor", "torque", "gyro", "bias"):
        assert getattr(batch, name)[7].tobytes() == getattr(alone, name)[0].tobytes(), name
        assert getattr(alone, name)[0, :200].tobytes() == getattr(short, name)[0].tobytes(), name
        assert not np.array_equal(getattr(batch, name)[6], getattr(batch, name)[7]), name


def test_a_setting_does_not_change_other_sensors_draws() -> None:
    quiet, noisy = draw_noise(lively()[0], 50, [1]), draw_noise(loud(), 50, [1])
    for name in ("link", "motor", "gyro"):
        np.testing.assert_array_equal(getattr(quiet, name), getattr(noisy, name))
    np.testing.assert_array_equal(quiet.torque, 0.0)


def test_first_draws_of_a_seed() -> None:
    """The order of draws is part of the contract: link, motor, torque, gyro white, gyro bias, cycle by cycle."""
    arm = loud()
    normal = np.random.default_rng(11).standard_normal(24)
    noise = draw_noise(arm, 2, [11])
    sigma = 0.003 / np.sqrt(12)
    np.testing.assert_allclose(noise.link[0], sigma * normal[[[0, 1], [12, 13]]])
    np.testing.assert_allclose(noise.motor[0], sigma * normal[[[2, 3], [14, 15]]])
    np.testing.assert_allclose(noise.torque[0], 0.02 * normal[[[4, 5], [16, 17]]])
    np.testing.assert_allclose(noise.bias[0, 1], 3.1623e-10 * np.sqrt(0.05) * normal[9:12])
    np.testing.assert_allclose(noise.gyro[0, 0] - 0.5 * noise.bias[0, 1], 1.4142e-6 * normal[6:9], rtol=1e-8)


def test_cycles_carry_the_declared_errors() -> None:
    _, model, scenario = lively()
    run = trajectory_of(loud(), model, scenario, seeds=range(3), duration_s=20.0, rtol=1e-9)
    readings = [run.cycles(i) for i in range(3)]
    assert_gaussian(np.array([cycles.q for cycles in readings])[..., 0] - run.q[..., 0], 0.003 / np.sqrt(12))
    assert_gaussian(np.array([cycles.theta for cycles in readings])[..., 1] - run.theta[..., 1], 0.003 / np.sqrt(12))
    assert_gaussian(np.array([cycles.tau for cycles in readings])[..., 1] - run.tau[..., 1], 0.02)
    omega = np.array([cycles.omega for cycles in readings])
    assert_gaussian(omega[..., 2] - run.omega0, 1.41422e-6)
    assert_gaussian(omega[..., 0], 1.41422e-6)


def test_quantised_encoders() -> None:
    arm, model, scenario = lively()
    run = trajectory_of(arm, model, replace(scenario, encoder_noise="quantised"), duration_s=20.0, rtol=1e-9)
    cycles = run.cycles()
    for reading, truth in ((cycles.q, run.q[0]), (cycles.theta, run.theta[0])):
        steps = reading / 0.003
        np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
        assert np.abs(reading - truth).max() <= 0.0015 * (1 + 1e-9)
        # the error of a moving angle is nearly uniform, not exactly so
        assert np.mean((reading - truth) ** 2) == pytest.approx(0.003**2 / 12, rel=0.15)


def test_readings_lead_back_to_angles() -> None:
    arm = lively()[0]
    encoders = [
        replace(joint.link_encoder, sign=sign, zero_rad=zero)
        for joint, sign, zero in zip(arm.joints, (-1, 1), (0.4, -1.1), strict=True)
    ]
    angles = np.random.default_rng(0).normal(size=(6, 2))
    reading = encoder_reading(encoders, angles, np.zeros_like(angles), False)
    np.testing.assert_allclose(reading[:, 0], 0.4 - angles[:, 0])
    np.testing.assert_allclose(encoder_angle(encoders, reading), angles, atol=1e-15)


def test_a_turned_gyro_reads_in_its_own_frame() -> None:
    arm = lively()[0]
    quaternion = (0.1, -0.5, 0.3, np.sqrt(1 - 0.35))
    arm = replace(arm, imu=replace(arm.imu, mount_xyzw=quaternion))
    reading = gyro_reading(arm, np.array([2.0, -1.0])[:, None] * arm.axis, np.zeros((2, 3)))
    np.testing.assert_allclose(reading @ arm.mount.T, [[0, 0, 2.0], [0, 0, -1.0]], atol=1e-15)
    x, y, z, w = quaternion
    # third row of the rotation matrix of (x, y, z, w)
    np.testing.assert_allclose(
        reading[0], [2 * 2 * (x * z - y * w), 2 * 2 * (y * z + x * w), 2 * (1 - 2 * (x * x + y * y))], atol=1e-12
    )


@pytest.mark.parametrize(("law", "expected"), [
    ("applied_from_sync", [1.0, 2.0, 3.0]), ("sampled", [1.0, 2.0, 3.0]), ("applied_previous_cycle", [0.0, 1.0, 2.0]),
])  # fmt: skip
def test_torque_laws(law: str, expected: list[float]) -> None:
    arm = replace(lively()[0], torque_law=law)  # type: ignore[arg-type]
    tau = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    np.testing.assert_array_equal(torque_record(arm, tau, np.zeros((3, 2)), np.zeros((3, 2)))[:, 1], expected)


def test_no_noise_is_none() -> None:
    noise = no_noise(lively()[0], 5, [0, 1])
    assert noise.link.shape == noise.motor.shape == noise.torque.shape == (2, 5, 2)
    assert noise.gyro.shape == noise.bias.shape == (2, 5, 3)
    assert not any(array.any() for array in (noise.link, noise.motor, noise.torque, noise.gyro))


def test_torque_noise_grows_with_the_torque() -> None:
    arm = loud()
    joints = tuple(replace(joint, torque_relative_sigma=0.05) for joint in arm.joints)
    noise = draw_noise(replace(arm, joints=joints), 20_000, [3])
    for size in (0.0, 0.2, 5.0):
        tau = np.full((20_000, 2), size)
        error = torque_record(arm, tau, noise.torque[0], noise.torque_share[0]) - tau
        assert_gaussian(error[None, :, 0], np.hypot(0.02, 0.05 * size))
    np.testing.assert_array_equal(noise.torque, draw_noise(arm, 20_000, [3]).torque)

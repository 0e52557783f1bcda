# SPDX-License-Identifier: MIT
"""The square-root filter: the C library against numpy, which shares no code with it, and against the bound."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from arm_support import random_arm
from numpy.typing import NDArray
from plant_support import lively
from refine_support import Case, moved, sensed
from runs_support import trajectory_of
from scipy.linalg import block_diag

from zygos.arm import TORQUE_STEP, Arm
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.native.flight import config_of, ffi, lib
from zygos.native.refiner import Refiner, Settings
from zygos.refinement.bound import bound
from zygos.refinement.filter import FilterNoise, NumpyFilter
from zygos.refinement.motion import FlexibleMotion
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Controller, Motion, Scenario, Sine

Floats = NDArray[np.float64]

RELATIVE = 0.005


SECONDS = 16.0


def lively_readings(duration_s: float = SECONDS, seed: int = 0) -> tuple[Floats, ...]:
    """Angles (n, N) twice, torques (n, N) with noise, and rates (n, 3) of the base in its axes, of examples/lively."""
    case = Case("lively", RELATIVE)
    cycles = sensed(case, seed, moved("lively", (), SECONDS))
    return tuple(part[: round(duration_s / case.arm.period_s) + 1] for part in in_base_axes(case.arm, cycles))


def in_base_axes(arm: Arm, cycles: Cycles) -> tuple[Floats, ...]:
    return cycles.q, cycles.theta, cycles.tau, cycles.omega @ arm.mount.T


def start(arm: Arm, model: Model, read: tuple[Floats, ...], seed: int) -> tuple[FlexibleMotion, Floats, Floats, Floats]:
    """Motion, entries, their sigmas, and the covariance of the parameters: an estimate that is off by 0.1 %, with a
    sigma of 0.1 %."""
    motion = FlexibleMotion(arm, np.array(model.base_values(arm)))
    n, width = arm.n, motion.base_rates
    q, theta, _, omega = read
    rate = omega[0] if width == 3 else omega[:1] @ arm.axis if width else np.zeros(0)
    off = 1e-3 * np.random.default_rng(seed).normal(size=len(motion.values))
    x = np.concatenate([rate, q[0], theta[0], np.zeros(2 * n + width), motion.values + off * motion.size])
    sigma = np.concatenate([np.full(width, 1e-4), np.full(2 * n, 0.01), np.full(2 * n, 0.05), np.full(width, 1e-5)])
    return motion, x, np.concatenate([sigma, np.zeros(len(off))]), np.diag((1e-3 * motion.size) ** 2)


def root_of(refiner: Refiner) -> Floats:
    """The upper triangular root of the covariance of all entries, in the filter's units."""
    count = int(refiner._native.entries)
    root = np.zeros((count, count))
    packed = np.frombuffer(ffi.buffer(refiner._native.root), dtype=np.float64)
    root.T[np.tril_indices(count)] = packed[: count * (count + 1) // 2]
    return root


def native(arm: Arm, motion: FlexibleMotion, steps: int, **more: bool) -> Refiner:
    return Refiner(arm, Settings(motion.size, steps, [RELATIVE] * arm.n, **more))


def swinging(arm: Arm, duration_s: float) -> Scenario:
    """A motion of any arm that starts at rest."""
    sines = {joint.name: Motion(0.3, (Sine(0.4, 1.0 + 0.7 * k),)) for k, joint in enumerate(arm.joints)}
    scenario = lively()[2]
    angles = tuple(motion.offset for motion in sines.values())
    return replace(
        scenario, manoeuvre=sines, duration_s=duration_s, initial_angles_rad=angles,
        controller=Controller(kp=50.0, kd=20.0), angular_momentum_nms=0.3,
    )  # fmt: skip


def test_it_begins_with_the_correlations_of_the_parameters() -> None:
    arm, model, _ = lively()
    motion, x, sigma, _ = start(arm, model, lively_readings(0.2), 0)
    p = len(motion.values)
    relative = np.random.default_rng(0).normal(size=(p, 2 * p))
    relative = 1e-6 * relative @ relative.T
    refiner = native(arm, motion, 2)
    refiner.start(x, sigma, relative * np.outer(motion.size, motion.size))
    root, fast = root_of(refiner), motion.states + motion.base_rates
    np.testing.assert_allclose(root @ root.T, block_diag(np.diag(sigma[:fast] ** 2), relative), rtol=1e-9, atol=1e-18)


@pytest.mark.slow(only=["free-spatial", "fixed*"])
@pytest.mark.parametrize(("base", "kinetic"), [("free", "planar"), ("free", "spatial"), ("fixed", "spatial")])
def test_c_is_numpy(base: str, kinetic: str) -> None:
    arm, model = random_arm(1, 2, base, kinetic, True)
    arm = replace(arm, joints=tuple(replace(joint, latch_us=300) for joint in arm.joints))
    if base == "free":
        arm = replace(arm, imu=replace(arm.imu, bias_walk=1e-3))
    noisy = replace(arm, joints=tuple(replace(joint, torque_relative_sigma=RELATIVE) for joint in arm.joints))
    run = trajectory_of(noisy, model, swinging(arm, 15 * arm.period_s), seeds=[0], rtol=1e-9, atol=1e-11)
    read = in_base_axes(arm, run.cycles())
    motion, x, sigma, covariance = start(arm, model, read, 0)
    refiner = native(arm, motion, 2)
    refiner.start(x, sigma, covariance)
    fast = motion.states + motion.base_rates
    wire = arm.over_the_wire
    encoders = [joint.link_encoder for joint in wire.joints] + [joint.motor_encoder for joint in wire.joints]
    noise = FilterNoise(
        np.array([one.sigma_rad for one in encoders]),
        wire.imu.rate_sigma,
        arm.imu.bias_walk * math.sqrt(arm.period_s),
        np.full(arm.n, TORQUE_STEP / math.sqrt(12.0)),
        np.full(arm.n, RELATIVE),
        20.0,
    )
    own = np.concatenate([sigma[:fast], 1e-3 * np.ones(len(motion.values))])
    reference = NumpyFilter(motion, noise, 2, np.concatenate([x[:fast], x[fast:] / motion.size]), np.diag(own))
    for k, (q, theta, tau, omega) in enumerate(zip(*read, strict=True)):
        refiner.read(q, theta, omega)
        rate = omega if motion.base_rates == 3 else omega[:0] if base == "fixed" else np.array([omega @ arm.axis])
        reference.read(q, theta, rate)
        spread = np.sqrt(np.sum(reference.root**2, axis=1))
        assert np.abs((refiner.x - reference.x) / spread).max() < 1e-6, k
        ours, theirs = refiner.root @ refiner.root.T, reference.root @ reference.root.T
        assert np.abs((ours - theirs) / np.outer(spread, spread)).max() < 1e-6, k
        if k + 1 < len(read[0]):
            refiner.advance(tau)
            reference.advance(tau)
    counts = len(read[0]) * np.array([arm.n, arm.n, max(1, motion.base_rates)])
    np.testing.assert_allclose(refiner.squares, reference.squares / counts, rtol=1e-6)
    value, found = refiner.estimate()
    np.testing.assert_allclose(value, reference.x[fast:] * motion.size, rtol=1e-9, atol=1e-9 * motion.size.max())
    expected = (reference.root @ reference.root.T)[fast:, fast:] * np.outer(motion.size, motion.size)
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=1e-6)


@pytest.mark.slow
def test_errors_reach_the_bound_and_are_as_large_as_stated() -> None:
    arm, model, scenario = lively()
    (best,) = bound(arm, model, replace(scenario, duration_s=SECONDS), [RELATIVE])
    away = []
    for seed in range(3):
        read = lively_readings(seed=seed)
        motion, x, sigma, covariance = start(arm, model, read, seed)
        refiner = native(arm, motion, 5)
        refiner.start(x, sigma, covariance)
        for k in range(len(read[0])):
            if k:
                refiner.advance(read[2][k - 1])
            refiner.read(read[0][k], read[1][k], read[3][k])
        value, found = refiner.estimate()
        stated = np.sqrt(np.diag(found))
        # the estimate at the start tells something, too
        known = np.linalg.inv(np.linalg.inv(best.covariance) + np.linalg.inv(covariance))
        np.testing.assert_allclose(stated, np.sqrt(np.diag(known)), rtol=0.1)
        away.append((value - motion.values) / stated)
        assert np.all(np.abs(refiner.squares[:2] - 1.0) < 0.2)
        assert 0.5 < refiner.squares[2] < 1.2  # the noise of the gyro is increased while the rates are poor
    assert np.sqrt(np.mean(np.square(away))) < 1.5


def test_friction_offsets_and_zeros_are_estimated() -> None:
    arm, model, _ = lively()
    q, theta, tau, omega = lively_readings()
    offset, zero = np.array([0.03, -0.02]), np.array([2e-3, -1e-3, 1e-3, 0.0])
    read = (q + zero[:2], theta + zero[2:], tau + offset, omega)
    motion, x, sigma, covariance = start(arm, model, read, 0)
    refiner = native(arm, motion, 5, friction=True, offsets=True, zeros=True)
    more = np.concatenate([np.full(2, 0.1), np.full(2, 0.1), np.full(4, 3e-3)])
    refiner.start(np.concatenate([x, np.zeros(8)]), np.concatenate([sigma, more]), covariance)
    for k in range(len(q)):
        if k:
            refiner.advance(read[2][k - 1])
        refiner.read(read[0][k], read[1][k], read[3][k])
    deviation = np.sqrt(np.sum(refiner.root**2, axis=1))[-8:]
    found = refiner.x[-8:]
    away = (found - np.concatenate([np.zeros(2), offset, zero])) / deviation
    assert np.abs(away).max() < 4.0
    assert np.all(deviation[2:4] < 0.01) and np.all(deviation[:2] < 0.01)
    # of the zeros, the motion shows the difference of both encoders of a joint
    bent = refiner.root[-2:] - refiner.root[-4:-2]
    assert np.all(np.sqrt(np.sum(bent**2, axis=1)) < 2e-3)


def test_zeros_of_encoders_push_no_joint() -> None:
    """Without a reading that shows both, state and zeros stay independent."""
    arm, model, _ = lively()
    read = lively_readings(1.0)
    motion, x, sigma, covariance = start(arm, model, read, 0)
    refiner = native(arm, motion, 5, zeros=True)
    refiner.start(np.concatenate([x, np.zeros(4)]), np.concatenate([sigma, np.full(4, 3e-3)]), covariance)
    for k in range(3):
        refiner.advance(read[2][k])
    covariance = refiner.root @ refiner.root.T
    assert np.all(np.diag(covariance)[-4:] > 0.0)
    assert np.abs(covariance[: motion.states, -4:]).max() < 1e-15 * np.diag(covariance).max()


def test_the_readings_favour_the_noise_that_the_torques_have() -> None:
    arm, model, _ = lively()
    read = lively_readings()
    motion, x, sigma, covariance = start(arm, model, read, 0)
    deviance = {}
    for level in (0.002, RELATIVE, 0.0125):
        refiner = Refiner(arm, Settings(motion.size, 5, [level] * arm.n))
        refiner.start(x, sigma, covariance)
        for k in range(len(read[0])):
            if k:
                refiner.advance(read[2][k - 1])
            refiner.read(read[0][k], read[1][k], read[3][k])
        deviance[level] = refiner.deviance
    assert min(deviance, key=lambda level: deviance[level]) == RELATIVE


def test_lost_torques_widen_the_estimate() -> None:
    arm, model, _ = lively()
    read = lively_readings(1.0)
    motion, x, sigma, covariance = start(arm, model, read, 0)
    spreads = []
    for lost in (0.0, 10.0):
        refiner = native(arm, motion, 5)
        refiner.start(x, sigma, covariance)
        refiner.read(read[0][0], read[1][0], read[3][0])
        refiner.advance(read[2][0], lost)
        spreads.append(np.sqrt(np.sum(refiner.root**2, axis=1)))
    turned = arm.period_s * 10.0 / (arm.joints[0].gear_ratio * motion.values[6])  # a rotor, almost free
    assert spreads[1][7] ** 2 - spreads[0][7] ** 2 == pytest.approx(turned**2, rel=0.1)
    np.testing.assert_allclose(spreads[1][10:], spreads[0][10:])


def test_a_bias_that_is_known_exactly_stays_so() -> None:
    """It has no noise, so that its row of the root is zero."""
    arm, model, _ = lively()
    arm = replace(arm, imu=replace(arm.imu, bias_walk=0.0))
    read = lively_readings(1.0)
    motion, x, sigma, covariance = start(arm, model, read, 0)
    bias = motion.states
    refiner = native(arm, motion, 5)
    refiner.start(x, np.where(np.arange(len(x)) == bias, 0.0, sigma), covariance)
    for k in range(5):
        refiner.read(read[0][k], read[1][k], read[3][k])
        refiner.advance(read[2][k])
    assert np.isfinite(refiner.root).all() and np.isfinite(refiner.x).all()
    assert not refiner.root[bias].any() and refiner.x[bias] == x[bias]


def test_what_the_filter_cannot_use_is_refused() -> None:
    arm, model, _ = lively()
    read = lively_readings(1.0)
    motion, x, sigma, covariance = start(arm, model, read, 0)
    refiner = native(arm, motion, 5)
    with pytest.raises(ZygosError, match="has left the possible arms; remedy"):
        refiner.advance(read[2][0])  # it has not begun
    with pytest.raises(ZygosError, match="not positive definite; remedy"):
        refiner.start(x, sigma, -covariance)
    refiner.start(x, sigma, covariance)
    refiner.read(read[0][0], read[1][0], read[3][0])
    refiner.start(np.where(np.arange(len(x)) == 10, -1.0, x), sigma, covariance)
    with pytest.raises(ZygosError, match="has left the possible arms; remedy"):
        refiner.advance(read[2][0])
    for rate in (1e7, -1e7):
        refiner.start(np.where(np.arange(len(x)) == 5, rate, x), sigma, covariance)
        with pytest.raises(ZygosError, match="has left the possible arms; remedy"):
            refiner.advance(read[2][0])
    for wrong in (-1.0, np.nan, np.inf):
        with pytest.raises(ZygosError, match="not positive definite; remedy"):
            refiner.start(x, np.where(np.arange(len(x)) == 1, wrong, sigma), covariance)
    with pytest.raises(ZygosError, match="remedy"):
        Refiner(arm, Settings(motion.size, 0))
    for wrong in (0.0, np.nan, np.inf):
        with pytest.raises(ZygosError, match="remedy"):
            Refiner(arm, Settings(np.where(np.arange(len(motion.size)) == 1, wrong, motion.size), 1))
    exact = tuple(replace(one, link_encoder=replace(one.link_encoder, quantum_rad=0.0)) for one in arm.joints)
    with pytest.raises(ZygosError, match="noise of a sensor is 0; remedy"):
        Refiner(replace(arm, joints=exact), Settings(motion.size, 1))


RANGES = (
    ("steps", None, 1, 1000), ("friction", None, 0, 1), ("offsets", None, 0, 1), ("zeros", None, 0, 1),
    ("bias_walk", None, 0.0, 1e3), ("second_order", None, 0.0, 1e3), ("gyro_sigma", None, 1e-12, 1e3),
    ("link_sigma", 1, 1e-12, 10.0), ("motor_sigma", 1, 1e-12, 10.0), ("torque_sigma", 1, 0.0, 1e6),
    ("torque_relative_sigma", 1, 0.0, 1.0), ("size", 3, 1e-300, 1e300),
)  # fmt: skip
"""Member of the settings, its place, and the least and the largest value (zygos/refiner.h)."""


@pytest.mark.parametrize(("member", "place", "least", "most"), RANGES, ids=str)
def test_settings_are_taken_up_to_their_ends_and_not_beyond(
    member: str, place: int | None, least: float, most: float
) -> None:
    arm, model, _ = lively()
    config = config_of(arm)

    def taken(value: float) -> bool:
        settings, native = ffi.new("zygos_refiner_settings_t *"), ffi.new("zygos_refiner_t *")
        settings.steps, settings.gyro_sigma = 2, 1e-3
        settings.size[0 : len(arm.parameter_names)] = list(model.base_values(arm))
        settings.link_sigma[0:2] = settings.motor_sigma[0:2] = [1e-4, 1e-4]
        if place is None:
            setattr(settings, member, value)
        else:
            getattr(settings, member)[place] = value
        answer = lib.zygos_refiner_init(native, config, settings)
        assert answer in (1, lib.ZYGOS_E_VALUE)
        assert native.failed == 1  # it has not begun
        return bool(answer == 1)

    assert taken(least) and taken(most)
    if isinstance(least, int):
        assert not taken(most + 1) and (least == 0 or not taken(least - 1))
    else:
        assert not taken(most * 1.001) and not taken(math.nan) and not taken(least * 0.999 if least else -1e-300)

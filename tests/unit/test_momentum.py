# SPDX-License-Identifier: MIT
"""Rows of the angular momentum: against engines and the simulator, C against numpy, and what noise adds to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_support import random_arm, random_state
from rows_support import Floats, awkward, c_rooms, less_means, run, smoothed, wandering
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.balances import momentum
from zygos.balances.state import State
from zygos.dynamics.engines import engine
from zygos.native.flight import config_of, ffi, lib

ARMS = [("spatial", (True, False, True)), ("planar", (True, True, False)), ("planar-symmetric", (True, True))]


def kinetic_values(arm: Arm, values: Floats) -> Floats:
    """Those of the kinetic parameters, then Im_1 .. Im_N."""
    names = arm.parameter_names
    rotors = [names.index(f"Im{i + 1}") for i in range(arm.n)]
    return np.concatenate([values[: len(arm.body_parameters)], values[rotors]])


@pytest.mark.parametrize(("kinetic", "flexible"), ARMS)
def test_columns_give_the_momentum_of_bodies(kinetic: str, flexible: tuple[bool, ...]) -> None:
    """Pinocchio has the momentum from masses and lengths."""
    arm, model = random_arm(11, len(flexible), "free", kinetic, flexible)  # type: ignore[arg-type]
    oracle = engine("pinocchio", arm, model)
    rng = np.random.default_rng(2)
    values = kinetic_values(arm, model.base_values(arm))
    for _ in range(5):
        sample = random_state(rng, arm)
        base = sample.omega0 if arm.spatial else sample.omega0 @ arm.axis
        h = oracle.momentum(sample.q, sample.omega0, sample.qd, sample.thetad)
        found = momentum.momentum_columns(arm, State(sample.q, sample.theta, sample.qd, sample.thetad, base)) @ values
        expected = h if arm.spatial else [h @ arm.axis]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.linalg.norm(h))


def test_columns_are_stated_in_other_axes() -> None:
    arm, _ = random_arm(11, 3, "free", "spatial", (True, False, True))
    rng = np.random.default_rng(3)
    samples = [random_state(rng, arm) for _ in range(4)]
    parts = [np.stack([getattr(one, name) for one in samples]) for name in ("q", "theta", "qd", "thetad", "omega0")]
    attitude = Rotation.random(4, random_state=4).as_matrix()
    plain = momentum.momentum_columns(arm, State(*parts))
    turned = momentum.momentum_columns(arm, State(*parts), attitude=attitude)
    np.testing.assert_allclose(turned, attitude @ plain, rtol=0, atol=1e-13 * np.abs(plain).max())
    assert np.abs(turned - plain).max() > 0.1 * np.abs(plain).max()


@pytest.mark.slow(only=["lively-*"])
@pytest.mark.parametrize(("name", "share"), [("lively", 1e-4), ("lively 10 ms", 1e-5), ("spatial", 1e-4)])
def test_rows_close_on_simulated_motion(name: str, share: float) -> None:
    """What the true parameters leave over is a small share of what the base alone contributes."""
    arm, cycles, values, _ = run(name)
    _, instants, arc = smoothed(arm, cycles, round(2.0 / arm.period_s))
    inside = arc >= 0
    z = momentum.momentum_rows(arm, instants, arc)[inside]
    true = kinetic_values(arm, values[: len(arm.parameter_names)])
    terms = less_means(z * true, arc[inside])
    rest = np.sqrt(np.mean(terms.sum(axis=-1) ** 2))
    assert rest <= share * np.sqrt(np.mean(terms**2, axis=(0, 1))).max()
    if arm.spatial:
        # in axes that turn with the base it does not keep its direction
        still = less_means(momentum.momentum_rows(arm, instants, np.arange(len(arc)))[inside] * true, arc[inside])
        assert np.sqrt(np.mean(still.sum(axis=-1) ** 2)) > 100.0 * rest


def test_the_attitude_is_the_simulated_one() -> None:
    """A base that turns about a fixed axis at a rate of its own: the angle is the integral; and about a cone."""
    arm = awkward(3, 2, "spatial", (True, True))
    cycles = wandering(arm, 400)
    t = arm.period_s * np.arange(400)
    rate = 0.9
    cone = np.stack([rate * np.cos(2.0 * t), rate * np.sin(2.0 * t), np.full(400, 0.4)], axis=1)
    cycles = replace(cycles, omega=cone @ arm.mount)
    _, instants, arc = smoothed(arm, cycles, 1000)
    found = momentum.base_attitudes(arm, instants, arc)
    # seen from a frame that turns at 2 about z, the rate is constant: R(t) = exp(A t) exp(-2 t z)
    origin = int(np.argmax(arc >= 0))
    start = t[instants.index[origin]]
    for k in (origin + 10, len(arc) - 1):
        now = t[instants.index[k]]

        def frame(s: float) -> Rotation:
            return Rotation.from_rotvec(s * np.array([rate, 0.0, 2.4])) * Rotation.from_rotvec([0.0, 0.0, -2.0 * s])

        expected = (frame(start).inv() * frame(now)).as_matrix()
        np.testing.assert_allclose(found[k], expected, atol=2e-7)


@pytest.mark.parametrize("angle", [0.02, 0.5, 1.0])
def test_the_attitude_after_steps_of_up_to_a_radian(angle: float) -> None:
    """At a constant rate it is one rotation about its direction; the series ends at 3e-10."""
    arm = awkward(3, 2, "spatial", (True, True))
    config, native, state = config_of(arm), ffi.new("zygos_momentum_t *"), ffi.new("zygos_arm_state_t *")
    rate = np.array([0.48, -0.6, 0.64]) * angle / arm.period_s
    state.omega = rate.tolist()
    lib.zygos_momentum_reset(native)
    for _ in range(4):  # the rates of the instants before are those of the steps behind
        lib.zygos_momentum_advance(native, config, state)
    lib.zygos_momentum_new_arc(native)
    for steps in range(4):
        assert lib.zygos_momentum_advance(native, config, state) == 1
        expected = Rotation.from_rotvec(steps * arm.period_s * rate).as_quat()
        found = np.array(list(native.attitude))
        np.testing.assert_allclose(found * np.sign(found @ expected), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("kinetic", "flexible"), ARMS)
def test_c_is_numpy(kinetic: str, flexible: tuple[bool, ...]) -> None:
    arm = awkward(8, len(flexible), kinetic, flexible, latch_us=2000)
    cycles = wandering(arm, 300, gap=120)
    _, instants, arc = smoothed(arm, cycles, 50)
    inside = arc >= 0
    found = c_rooms(arm, cycles, 50, noise=True)
    np.testing.assert_array_equal(found.arc, arc[inside])
    expected = momentum.momentum_rows(arm, instants, arc)[inside]
    size = np.abs(expected).max(axis=(0, 1))
    assert (size > 0.0).all()
    np.testing.assert_allclose(found.momentum / size, expected / size, rtol=0, atol=1e-12)
    owed = momentum.momentum_noise(arm, instants)[inside]
    scale = np.sqrt(np.einsum("mii->mi", owed).max(axis=0))
    size = np.outer(scale, scale)
    np.testing.assert_allclose(found.noise / size, owed / size, rtol=0, atol=1e-12)


def test_a_fixed_base_has_no_rows() -> None:
    for base, kinetic, rows in (("free", "spatial", 3), ("free", "planar", 1), ("fixed", "spatial", 0)):
        arm, _ = random_arm(1, 2, base, kinetic)  # type: ignore[arg-type]
        assert lib.zygos_momentum_count(config_of(arm)) == rows


@pytest.mark.parametrize(("kinetic", "flexible"), ARMS)
def test_noise_entry_by_entry(kinetic: str, flexible: tuple[bool, ...]) -> None:
    """Of 3e4 draws of the smoothed rates at one state: sensors' noise through the filter, without the angles'."""
    arm = awkward(6, len(flexible), kinetic, flexible)
    cycles = wandering(arm, 60)
    _, instants, _ = smoothed(arm, cycles, 1000)
    owed = momentum.momentum_noise(arm, instants)[20]
    draws, points, n = 30_000, arm.smoother.points, arm.n
    rng = np.random.default_rng(1)
    at = np.arange(points) - points // 2
    # value and slope of a least-squares polynomial, from numpy's own
    fit = np.linalg.pinv(np.vander(at, arm.smoother.order + 1, increasing=True).astype(float))
    link = [j.link_encoder.over_the_wire.sigma_rad for j in arm.joints]
    motor = [j.motor_encoder.over_the_wire.sigma_rad for j in arm.joints]
    slope = fit[1] / arm.period_s
    qd = np.stack([rng.standard_normal((draws, points)) @ slope * s for s in link], axis=1)
    thetad = np.stack([rng.standard_normal((draws, points)) @ slope * s for s in motor], axis=1)
    thetad = np.where([joint.flexible for joint in arm.joints], thetad, qd)
    base = np.stack(
        [rng.standard_normal((draws, points)) @ fit[0] * arm.imu.over_the_wire.rate_sigma for _ in range(3)], axis=1
    )
    angles = np.broadcast_to(instants.q[20], (draws, n))
    state = State(
        angles,
        angles,
        qd + instants.qd[20],
        thetad + instants.thetad[20],
        base + instants.omega[20] if arm.spatial else (base + instants.omega[20]) @ arm.axis,
    )
    z = momentum.momentum_columns(arm, state)
    z = z - z.mean(axis=0)
    drawn, square = np.zeros_like(owed), np.zeros_like(owed)
    for some in np.array_split(z, 50):
        products = np.swapaxes(some, -1, -2) @ some
        drawn += products.sum(axis=0) / draws
        square += np.sum(products**2, axis=0) / draws
    spread = np.sqrt((square - drawn**2) / draws)
    off = np.abs(drawn - owed) / (spread + 1e-30)
    # 3 standard errors, where a share of 0.27 % of independent entries is beyond
    assert np.mean(off > 3.0) <= 0.02
    assert off.max() <= 5.0

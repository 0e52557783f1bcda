# SPDX-License-Identifier: MIT
"""Rows of the motors' impulse: against the simulator, C against numpy, and what the sensors' noise adds to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rows_support import LIVELY_EFFECTS, Floats, awkward, c_rooms, effect, less_means, run, smoothed, wandering

from zygos.arm import Arm, Smoother
from zygos.balances import impulse
from zygos.effects import Effect
from zygos.native.flight import config_of, ffi, lib
from zygos.runs.cycles import Cycles

EVERY = (
    effect("torque_lag", "joint2"),
    effect("motor_viscous", "joint2"),
    effect("link_coulomb", "joint2"),
    effect("spring_offset", "joint2"),
    effect("cubic_stiffness", "joint1"),
    effect("motor_coulomb", "joint2"),
    effect("torque_offset", "joint2"),
    effect("viscous_asymmetry", "joint2"),
)


def left_over(name: str, *, corrected: bool = True) -> list[tuple[float, dict[str, float]]]:
    """For each joint the rms of z . true - w, and that of each term of it, less the means of arcs of 3 s."""
    arm, cycles, values, effects = run(name)
    samples, instants, arc = smoothed(arm, cycles, round(3.0 / arm.period_s))
    value = dict(zip((*arm.parameter_names, *(one.column(arm) for one in effects)), values.tolist(), strict=True))
    inside = arc >= 0
    out = []
    for rows in impulse.impulse_rows(arm, samples, instants, arc, effects):
        true = np.array([value[name] for name in rows.names])
        w = rows.w
        if not corrected:
            jump = np.diff(samples.tau[:, rows.joint])[instants.index - 1]
            w = w - arm.gear_ratios[rows.joint] * arm.period_s / 12.0 * jump
        terms = less_means(rows.z * true, arc)[inside]
        rest = terms.sum(axis=1) - less_means(w, arc)[inside]
        size = np.sqrt(np.mean(terms**2, axis=0))
        out.append((float(np.sqrt(np.mean(rest**2))), dict(zip(rows.names, size.tolist(), strict=True))))
    return out


@pytest.mark.parametrize(("name", "share"), [("lively", 2e-4), ("lively 10 ms", 1e-5), ("spatial", 1e-4)])
def test_rows_close_on_simulated_motion(name: str, share: float) -> None:
    """What the true parameters leave over is a small share of the largest term, and of every term that stands out."""
    for rest, terms in left_over(name):
        assert rest <= share * max(terms.values())
        assert all(rest < 0.5 * size for key, size in terms.items() if not key.startswith("b"))


def test_rows_close_faster_with_faster_cycles_and_not_without_the_torque_step() -> None:
    fine = left_over("lively 10 ms")
    for (rest, _), (without, _) in zip(fine, left_over("lively 10 ms", corrected=False), strict=True):
        assert without > 10.0 * rest


def compare(arm: Arm, cycles: Cycles, longest: int, effects: tuple[Effect, ...]) -> None:
    samples, instants, arc = smoothed(arm, cycles, longest)
    found = c_rooms(arm, cycles, longest, effects)
    inside = arc >= 0
    np.testing.assert_array_equal(found.arc, arc[inside])
    assert found.arc.max() >= 2
    joints = impulse.impulse_rows(arm, samples, instants, arc, effects)
    assert [rows.joint for rows in joints] == [i for i, joint in enumerate(arm.joints) if joint.flexible]
    for rows in joints:
        expected = np.column_stack([rows.z, rows.w])[inside]
        ours = found.impulse[:, rows.joint][:, [*range(rows.z.shape[1]), -1]]
        size = np.abs(expected).max(axis=0)
        assert (size > 0.0).all()
        np.testing.assert_allclose(ours / size, expected / size, rtol=0, atol=1e-12)


def test_c_is_numpy_on_a_planar_arm_with_effects() -> None:
    arm, cycles, _, effects = run("lively")
    compare(arm, cycles, 150, effects)


@pytest.mark.parametrize("law", ["applied_from_sync", "applied_previous_cycle", "sampled"])
@pytest.mark.parametrize(("kinetic", "flexible"), [("spatial", (True, True, False)), ("planar", (False, True, True))])
def test_c_is_numpy_across_gaps(law: str, kinetic: str, flexible: tuple[bool, ...]) -> None:
    arm = replace(awkward(4, 3, kinetic, flexible, latch_us=3000), torque_law=law)  # type: ignore[arg-type]
    effects = [one for one in EVERY if kinetic == "spatial" or one.joint == "joint2"]
    compare(arm, wandering(arm, 260, gap=90), 40, tuple(effects))


def c_noise(arm: Arm, joint: int, effects: tuple[Effect, ...]) -> Floats:
    config, smoother = config_of(arm, effects), ffi.new("zygos_smoother_t *")
    column_map = ffi.new("zygos_impulse_column_map_t *")
    lib.zygos_impulse_column_map(config, column_map)
    lib.zygos_smoother_init(smoother, config)
    width = column_map.count[joint]
    packed = ffi.new("double[]", width * (width + 1) // 2)
    lib.zygos_impulse_noise(config, column_map, smoother, arm.imu.over_the_wire.rate_sigma, joint, packed)
    out = np.zeros((width, width))
    out[np.tril_indices(width)] = list(packed)
    return out + np.tril(out, -1).T


@pytest.mark.parametrize("latch_us", [0, 4000])
@pytest.mark.parametrize("joint", [1, 2])
def test_noise_entry_by_entry(joint: int, latch_us: int) -> None:
    """Of 1e4 independent draws of one window; the columns that integrate are not counted."""
    arm = awkward(5, 3, "planar", (False, True, True), latch_us)
    effects = (effect("motor_viscous", "joint3"), effect("torque_lag", "joint2"), effect("motor_viscous", "joint2"))
    owed = impulse.impulse_noise(arm, joint, effects)
    mine = c_noise(arm, joint, effects)
    assert (np.abs(mine - owed) <= 1e-12 * np.sqrt(np.outer(np.diag(owed), np.diag(owed)))).all()

    # an arm at rest, whose readings are noise; instants a window apart share no sample
    draws, points = 10_000, arm.smoother.points
    count = draws * points + 2 * points
    rng = np.random.default_rng(joint)
    zero = np.zeros((count, arm.n))
    cycles = Cycles(
        np.arange(count, dtype=np.uint64),
        rng.standard_normal(zero.shape) * [one.link_encoder.over_the_wire.sigma_rad for one in arm.joints],
        rng.standard_normal(zero.shape) * [one.motor_encoder.over_the_wire.sigma_rad for one in arm.joints],
        zero,
        rng.standard_normal((count, 3)) * arm.imu.over_the_wire.rate_sigma,
        np.zeros(count, dtype=np.uint32),
    )
    samples, instants, arc = smoothed(arm, cycles, count)
    found = next(one for one in impulse.impulse_rows(arm, samples, instants, arc, effects) if one.joint == joint)
    z = found.z[points : points + draws * points : points]
    z[:, 1] = 0.0
    assert len(z) == draws
    z = z - z.mean(axis=0)
    products = z[:, :, None] * z[:, None, :]
    spread = products.std(axis=0) / np.sqrt(draws)
    drawn = products.mean(axis=0)
    assert (owed[[0, 2], [0, 2]] > 0.0).all()
    np.testing.assert_array_less(np.abs(drawn - owed), 3.0 * spread + 1e-30)


def test_noise_with_a_planar_arm() -> None:
    """sigma^2 of the encoders times the sums of squares of the filter, by hand: SG7/4."""
    arm, _, _, effects = run("lively")
    arm = replace(arm, smoother=Smoother(7, 4, 3))
    value = np.array([5.0, -30.0, 75.0, 131.0, 75.0, -30.0, 5.0]) / 231.0
    slope = np.array([22.0, -67.0, -58.0, 0.0, 58.0, 67.0, -22.0]) / 252.0 / arm.period_s
    sigma = arm.joints[0].link_encoder.over_the_wire.sigma_rad
    owed = impulse.impulse_noise(arm, 0, effects)
    assert owed[0, 0] == pytest.approx(50.0**4 * sigma**2 * slope @ slope, rel=1e-9)
    assert owed[2, 2] == pytest.approx(2.0 * sigma**2 * value @ value, rel=1e-12)
    assert impulse.joint_effects(arm, 1, LIVELY_EFFECTS) == LIVELY_EFFECTS[1:]

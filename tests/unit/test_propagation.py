# SPDX-License-Identifier: MIT
"""The motion over a period and its derivatives: the C library against numpy, and friction against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arm_support import arm_of_known_lengths, random_arm
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.native.flight import ffi, lib
from zygos.native.propagation import Propagation
from zygos.refinement.motion import FlexibleMotion

Floats = NDArray[np.float64]


def state_of(motion: FlexibleMotion, seed: int) -> tuple[Floats, Floats]:
    """A state whose springs bend little, and torques."""
    rng = np.random.default_rng(seed)
    n, width = motion.arm.n, motion.base_rates
    x = rng.normal(size=motion.states)
    x[width + n : width + 2 * n] = x[width : width + n] + 0.01 * rng.normal(size=n)
    return x, rng.normal(size=n)


@pytest.mark.parametrize("kinetic", ["planar-symmetric", "planar", "spatial"])
@pytest.mark.parametrize("base", ["free", "fixed"])
def test_c_is_numpy(base: str, kinetic: str) -> None:
    for seed, joints in enumerate((1, 2, 3, 7)):
        arm, model = random_arm(seed, joints, base, kinetic, True)
        values = np.array(model.base_values(arm))
        motion = FlexibleMotion(arm, values)
        x, tau = state_of(motion, seed)
        after, slope = (part[0] for part in motion.step(x[None], tau[None], arm.period_s, 2))
        found, slopes = Propagation(arm, 2).step(values, x, tau)
        np.testing.assert_allclose(found, after, rtol=0, atol=1e-12 * np.abs(after).max())
        error = np.abs(slopes - slope).max(axis=0)
        assert np.all(error <= 1e-8 * np.abs(slope).max(axis=0))  # a light rotor is eliminated


@pytest.fixture
def planar() -> tuple[Arm, Floats]:
    arm, model = random_arm(4, 2, "free", "planar", True)
    return arm, np.array(model.base_values(arm))


def test_friction_and_its_derivatives_are_those_of_the_torque_it_takes(planar: tuple[Arm, Floats]) -> None:
    arm, values = planar
    with_friction, without = Propagation(arm, 1, friction=True), Propagation(arm, 1)
    x, tau = state_of(FlexibleMotion(arm, values), 3)
    x[-2:] = 1.0, -1.0  # both rotors keep turning
    friction = np.array([0.3, 0.2])
    after, slope = with_friction.step(np.concatenate([values, friction]), x, tau)
    lost, taken = without.step(values, x, tau - friction * [1.0, -1.0])
    np.testing.assert_allclose(after, lost, rtol=0, atol=1e-13)
    p = len(values)
    np.testing.assert_allclose(slope[:, : 9 + p], taken[:, : 9 + p], rtol=0, atol=1e-10)
    np.testing.assert_allclose(slope[:, 9 + p : 11 + p], -slope[:, 11 + p :] * [1.0, -1.0], rtol=0, atol=1e-13)
    # a rotor that hardly turns: friction rises with the rate
    x[-2:] = 2e-4, 0.5
    step = 1e-7
    ends = [
        with_friction.step(np.concatenate([values, friction]), x + s * step * np.eye(9)[7], tau)[0] for s in (1, -1)
    ]
    middle = with_friction.step(np.concatenate([values, friction]), x, tau)[1][:, 7]
    expected = (ends[0] - ends[1]) / (2.0 * step)
    assert np.abs(middle - expected).max() < 1e-5 * np.abs(expected).max()


def test_impossible_parameters_and_rigid_joints_are_refused(planar: tuple[Arm, Floats]) -> None:
    arm, values = planar
    x, tau = state_of(FlexibleMotion(arm, values), 0)
    for changed in (-values, np.where(np.array(arm.parameter_names) == "Im1", 0.0, values)):
        with pytest.raises(ZygosError, match="negative kinetic energy; remedy"):
            Propagation(arm, 1).step(changed, x, tau)
    rigid = replace(arm.joints[0], flexible=False)
    for refused in (Propagation(replace(arm, joints=(rigid, arm.joints[1])), 1), Propagation(arm, 0)):
        with pytest.raises(ZygosError, match=r"a joint is rigid, or .* steps are not from 1 to 1000; remedy"):
            refused.step(values, x, tau)


def test_an_arm_of_known_lengths_has_the_columns_of_its_independent_parameters() -> None:
    known, values = arm_of_known_lengths()
    assert known.structure.reduces
    motion = FlexibleMotion(known, values)
    x, tau = state_of(motion, 1)
    after, slope = (part[0] for part in motion.step(x[None], tau[None], known.period_s, 1))
    found, slopes = Propagation(known, 1).step(values, x, tau)
    np.testing.assert_allclose(found, after, rtol=0, atol=1e-11)
    assert np.all(np.abs(slopes - slope).max(axis=0) <= 1e-8 * np.abs(slope).max(axis=0))


@pytest.mark.parametrize("cycles", [1, 2, 20])
def test_means_over_the_ends_of_cycles(cycles: int) -> None:
    """Of each term of the series, for a torque that is held."""
    means = ffi.new("zygos_propagation_means_t *")
    lib.zygos_propagation_means(means, cycles)
    ends = np.arange(1, cycles + 1) / cycles
    expected = [np.mean(ends**m) for m in range(len(means.share))]
    np.testing.assert_allclose([terms[0] for terms in means.share], expected, rtol=1e-13)

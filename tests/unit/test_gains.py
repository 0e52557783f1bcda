# SPDX-License-Identifier: MIT
"""Gains of torque sensors: their columns, their prior, and what an estimate says of a sensor whose gain is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arm_support import with_gain_sigma
from flight_support import energy_only
from numpy.typing import NDArray
from plant_support import lively
from runs_support import trajectory_of

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import effect
from zygos.errors import ZygosError
from zygos.native.flight import REASONS, Estimate, Flight, config_of, ffi, lib
from zygos.native.refine import OnboardRefiner
from zygos.reference.compare import check_cycles
from zygos.refinement.refine import refine_runs
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import Trajectory

Floats = NDArray[np.float64]
SHARE = 0.01
UNCLOSED = REASONS[6]


def reported(cycles: Cycles, *gains: float) -> Cycles:
    """The cycles as torque sensors with these gains report them."""
    return replace(cycles, tau=cycles.tau * np.array(gains))


def told(arm: Arm, cycles: Cycles) -> Estimate:
    flight = Flight(arm)
    flight.cycles(cycles)
    return flight.estimate()


def far(found: Estimate, true: Floats) -> NDArray[np.bool_]:
    """(p,) which values are more than five sigmas and 2 % off."""
    p = len(true)
    off = np.abs(found.value[:p] - true)
    return np.asarray((off > 5.0 * found.sigma[:p]) & (off > 0.02 * np.abs(true)))


@pytest.fixture(scope="module")
def cycles(noisy: Trajectory) -> Cycles:
    return noisy.cycles(0)


def test_the_reference_is_the_most_exact_sensor(arm: Arm) -> None:
    assert with_gain_sigma(arm, 0.01).relative_gains == (1,)
    assert with_gain_sigma(arm, 0.02, 0.01).relative_gains == (0,)
    assert with_gain_sigma(arm, 0.0, 0.01).relative_gains == (1,)
    assert with_gain_sigma(arm, 0.0).relative_gains == ()
    np.testing.assert_allclose(with_gain_sigma(arm, 0.02, 0.01).relative_gain_covariance, [[5e-4]])
    assert Flight(with_gain_sigma(arm, 0.02, 0.01)).names[-1] == "torque_gain1"


def test_a_wrong_gain_without_a_column_is_wrong_and_with_it_right(arm: Arm, cycles: Cycles, true: Floats) -> None:
    """The elbow reports 2 % too much, which is within what an arm file that says nothing declares."""
    wrong = reported(cycles, 1.0, 1.02)
    without, found = told(with_gain_sigma(arm, 0.0), wrong), told(with_gain_sigma(arm, SHARE), wrong)
    off = np.abs(without.value - true) / without.sigma
    assert float(off.max()) > 5.0
    assert found.validity == "valid"
    assert not far(found, true).any()
    assert float(np.max(np.abs(found.value[:-1] - true) / found.half95[:-1])) < 2.0
    assert found.value[-1] == pytest.approx(1.0 / 1.02 - 1.0, abs=4.0 * found.sigma[-1])
    assert found.sigma[-1] < 0.2 * SHARE


@pytest.mark.parametrize("gain", [0.8, 0.95, 1.05, 1.3])
def test_a_gain_that_contradicts_the_arm_file_is_doubted_and_named(
    arm: Arm, cycles: Cycles, true: Floats, gain: float
) -> None:
    wrong = reported(cycles, 1.0, gain)
    found = told(with_gain_sigma(arm, SHARE), wrong)
    assert found.validity == "doubtful"
    assert found.reason == "the gain of a torque sensor differs from what is declared of it"
    assert not far(found, true).any()
    assert found.value[-1] == pytest.approx(1.0 / gain - 1.0, abs=5.0 * found.sigma[-1] + 5e-4)
    # an arm file that knows how uncertain it is makes it valid
    again = told(with_gain_sigma(arm, 0.2), wrong)
    assert again.validity == "valid"
    assert not far(again, true).any()


def test_the_first_sensor_is_the_scale(arm: Arm, cycles: Cycles, true: Floats) -> None:
    """Where it reports 3 % too much, all values grow by that, and the other sensor seems to report too little."""
    found = told(with_gain_sigma(arm, 0.1), reported(cycles, 1.03, 1.0))
    assert found.validity == "valid"
    assert not far(found, 1.03 * true).any()
    assert found.value[-1] == pytest.approx(0.03, abs=4.0 * found.sigma[-1])


def test_a_gain_that_is_declared_as_nearly_exact_changes_nothing(arm: Arm, cycles: Cycles) -> None:
    """The prior decides where it is better than the motion, and its error is all that the gain's sigma has."""
    known, found = told(with_gain_sigma(arm, 0.0), cycles), told(with_gain_sigma(arm, 1e-6), cycles)
    np.testing.assert_allclose(found.value[:-1], known.value, rtol=1e-5)
    np.testing.assert_allclose(found.sigma[:-1], known.sigma, rtol=1e-2)
    assert found.sigma[-1] == pytest.approx(np.sqrt(2.0) * 1e-6, rel=1e-2)


@pytest.mark.slow(only=["gains2-applied_from_sync", "gains1-applied_from_sync", "gains0-applied_from_sync"])
@pytest.mark.parametrize("law", ["applied_from_sync", "sampled"])
@pytest.mark.parametrize("gains", [(SHARE, 1.0), (SHARE, 1.05), (0.1, 1.3)])
def test_c_equals_numpy_with_gains(arm: Arm, cycles: Cycles, law: str, gains: tuple[float, float]) -> None:
    sigma, gain = gains
    known = replace(with_gain_sigma(arm, sigma), torque_law=law)
    rooms = {room.name: room for room in check_cycles(known, reported(cycles, 1.0, gain))}
    assert [name for name, room in rooms.items() if not room.equal] == []
    # a run of held torques has no solution under another law, but its rows are compared
    assert set(rooms) >= ({"balance"} if law == "sampled" else {"balance", "noise", "normal equations", "solution"})


def test_c_equals_numpy_where_only_energy_rows_tell(arm: Arm, cycles: Cycles) -> None:
    rooms = check_cycles(energy_only(with_gain_sigma(arm, SHARE)), cycles)
    assert [room.name for room in rooms if not room.equal] == []


def test_gains_are_refused_where_they_mean_nothing(arm: Arm) -> None:
    """All joints cannot be relative; a gain needs a prior, and stands behind all other effects."""
    native = ffi.new("zygos_arm_t *")

    def answer(change: Callable[..., None]) -> int:
        config = config_of(with_gain_sigma(arm, SHARE), (effect("motor_viscous", arm.joints[0].name),))
        assert config.effects == 2
        change(config)
        return int(lib.zygos_arm_init(native, config))

    def every(config: object) -> None:
        config.effect[0].kind, config.effect[0].joint = lib.ZYGOS_TORQUE_GAIN, 0  # type: ignore[attr-defined]

    def first(config: object) -> None:
        entries = config.effect  # type: ignore[attr-defined]
        entries[0].kind, entries[0].joint = lib.ZYGOS_TORQUE_GAIN, 1
        entries[1].kind, entries[1].joint = lib.ZYGOS_MOTOR_VISCOUS, 0

    def without(config: object) -> None:
        config.joint[1].torque_gain_sigma = 0.0  # type: ignore[attr-defined]

    def large(config: object) -> None:
        config.joint[1].torque_gain_sigma = 1.5  # type: ignore[attr-defined]

    assert answer(lambda config: None) == 1
    assert [answer(change) for change in (every, first, without)] == [lib.ZYGOS_E_EFFECT] * 3
    assert answer(large) == lib.ZYGOS_E_VALUE


def test_a_model_may_name_a_gain_only_where_one_is_estimated(arm: Arm) -> None:
    named = [effect("torque_gain", joint.name, 0.01) for joint in arm.joints]
    assert Flight(with_gain_sigma(arm, SHARE), named[1:]).names[-1] == "torque_gain2"
    with pytest.raises(ZygosError, match="torque_gain_sigma"):
        Flight(with_gain_sigma(arm, SHARE), named[:1])
    with pytest.raises(ZygosError, match="torque_gain_sigma"):
        Flight(with_gain_sigma(arm, 0.0), named[1:])


@cache
def _noisy_torques() -> tuple[Arm, Floats]:
    arm, model, _ = lively()
    joints = tuple(replace(joint, torque_relative_sigma=0.005) for joint in arm.joints)
    return replace(arm, joints=joints), model.base_values(arm)


def _with_noise(cycles: Cycles) -> Cycles:
    rng = np.random.default_rng(1)
    return replace(cycles, tau=cycles.tau * (1.0 + 0.005 * rng.normal(size=cycles.tau.shape)))


@pytest.mark.slow
def test_a_refinement_finds_the_gain(cycles: Cycles) -> None:
    """A gain within the declared 1 % makes no value wrong, and is known to a small part of it."""
    arm, true = _noisy_torques()
    wrong = _with_noise(reported(cycles, 1.0, 1.01))
    found = refine_runs(Run.of_cycles(with_gain_sigma(arm, SHARE), wrong))
    (gain,) = found.effects
    assert found.published, found.reason
    assert gain.kind.key == "torque_gain"
    assert gain.value == pytest.approx(1.0 / 1.01 - 1.0, abs=4.0 * gain.sigma)
    assert gain.sigma < 0.1 * SHARE
    assert float(np.max(np.abs(found.value - true) / found.sigma)) < 4.5
    without = refine_runs(Run.of_cycles(with_gain_sigma(arm, 0.0), wrong))
    assert float(np.max(np.abs(without.value - true) / without.sigma)) > 10.0


@pytest.mark.slow
def test_a_refinement_on_board_finds_the_gain(cycles: Cycles) -> None:
    arm, true = _noisy_torques()
    wrong = _with_noise(reported(cycles, 1.0, 1.01))
    for sigma in (SHARE, 0.0):
        known = with_gain_sigma(arm, sigma)
        flight, refiner = Flight(known), OnboardRefiner(known)
        flight.cycles(wrong)
        refiner.start(flight)
        refiner.cycles(wrong)
        value, spread = refiner.estimate
        off = float(np.max(np.abs(value - true) / spread))
        assert off < 5.0 if sigma else off > 10.0


@pytest.mark.slow
def test_a_friction_that_no_column_has_is_doubted_though_its_residuals_are_small() -> None:
    """Coulomb friction of 1 % of the typical torque: rows disturb each other. Without it they do not."""
    arm, model, scenario = lively()
    for value in (0.0, 0.22):
        hidden = replace(model, effects=(effect("motor_coulomb", arm.joints[1].name, value),) if value else ())
        run = trajectory_of(arm, hidden, scenario, seeds=[0], noise=True).cycles(0)
        for sigma in (0.0, SHARE):
            found = told(with_gain_sigma(arm, sigma), run)
            assert (found.validity, found.reason) == (("doubtful", UNCLOSED) if value else ("valid", ""))
            assert found.cluster < 20.0

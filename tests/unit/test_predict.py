# SPDX-License-Identifier: MIT
"""Predictions of runs stand beside what the noise of all sensors makes of the same model."""

from __future__ import annotations

from dataclasses import replace

import ground_support
import numpy as np
import pytest
from ground_support import recorded, short_arm
from numpy.typing import NDArray
from runs_support import trajectory_of

from conftest import ROOT
from zygos.arm import Arm, load_arm
from zygos.can.run import Run
from zygos.gap.predict import predict
from zygos.ground.rest import at_rest
from zygos.ground.score import score
from zygos.model.model import Model, load_model
from zygos.simulation.scenario import load_scenario

Floats = NDArray[np.float64]


def flown(name: str, seed: int) -> tuple[Model, Run]:
    """The model of an example, and a run of it."""
    folder = ROOT / "examples" / name
    arm, model = load_arm(folder / "arm.toml"), load_model(folder / "model.toml")
    flight = trajectory_of(arm, model, load_scenario(folder / "scenario.toml"), noise=True, seeds=(seed,))
    return model, Run.of_cycles(arm, flight.cycles())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "lively", "spatial"])
def test_the_true_model_leaves_noise_alone(name: str) -> None:
    model, run = flown(name, seed=1)
    found = predict(model, run)
    assert found.ahead is not None and found.gap == pytest.approx(1.0, abs=0.1)
    assert found.ahead.error == pytest.approx(found.ahead.floor, rel=0.3)
    assert all(0.6 < one.sigmas < 1.4 for one in found.torques.joints)


@pytest.mark.slow
def test_a_wrong_spring_is_seen_in_the_motion_and_not_in_the_torque() -> None:
    model, run = flown("lively", seed=1)
    first = model.joints[0]
    soft = replace(first, stiffness=replace(first.stiffness, value=0.98 * first.stiffness.value))
    wrong = predict(replace(model, joints=(soft, *model.joints[1:])), run)
    true = predict(model, run)
    assert wrong.gap > 2.0 * true.gap
    assert [one.sigmas for one in wrong.torques.joints] == pytest.approx(
        [one.sigmas for one in true.torques.joints], rel=0.05
    )


def test_a_model_that_no_arm_has_predicts_torques_alone() -> None:
    model, run = flown("lively", seed=1)
    parameters = model.base_parameters(run.arm)
    name = next(key for key in parameters if key.startswith("a"))
    impossible = Model("impossible", parameters=parameters | {name: replace(parameters[name], value=-1.0)})
    found = predict(impossible, run)
    assert found.ahead is None and found.reason and found.as_dict()["not_ahead"] == found.reason
    assert np.isfinite(found.gap)


@pytest.mark.slow
def test_a_joint_at_rest_is_scored_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """What friction holds there is anybody's guess: it must not count as an error of the model."""
    arm, model = short_arm(2)
    own = score(recorded(arm, model, seconds=12.0), model)
    assert all(one.rest_share < 0.05 for one in own.joints)
    free = ground_support.motion

    def braked(arm: Arm, seconds: float, seed: int) -> tuple[Floats, Floats, Floats]:
        """The same motion, which ends in a stop three seconds before the end."""
        q, _, _ = free(arm, seconds, seed)
        x = np.clip(np.linspace(seconds, 0.0, len(q)) - 3.0, 0.0, 2.0)[:, None] / 2.0
        q = x**3 * (10.0 - 15.0 * x + 6.0 * x**2) * q
        qd = np.gradient(q, arm.period_s, axis=0)
        return q, qd, np.gradient(qd, arm.period_s, axis=0)

    monkeypatch.setattr(ground_support, "motion", braked)
    run = recorded(arm, model, seconds=12.0)
    tau = run.cycles.tau.copy()
    tau[-round(2.9 / arm.period_s) :] += 0.3 * np.std(tau, axis=0)
    found = score(replace(run, frames=None, table=replace(run.cycles, tau=tau)), model)
    assert all(0.15 < one.rest_share < 0.35 and one.rest_nm > 5.0 * one.error_nm for one in found.joints)
    for one, two in zip(own.joints, found.joints, strict=True):
        assert two.error_nm == pytest.approx(one.error_nm, rel=0.3)


def test_rest_is_slow_for_some_time() -> None:
    rate = np.ones((100, 1))
    rate[20:25] = 0.0  # a reversal
    rate[60:90] = 0.01
    found = at_rest(rate, np.zeros(100, dtype=np.int64), 0.01)
    assert np.flatnonzero(found[:, 0]).tolist() == list(range(60, 90))
    assert not at_rest(rate, np.arange(100) // 40, 0.02)[:10].any()

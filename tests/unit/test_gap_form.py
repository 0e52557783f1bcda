# SPDX-License-Identifier: MIT
"""What the form of a law leaves open of its size: a law of the column's form leaves little open, one that reverses
slowly as much as the size by the torque differs from the one by the energy."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gap_arms_support import standing
from ground_gap_support import Array, Law, axis, measured, size
from ground_support import motion

from oracles.arms import Plant
from oracles.hidden import WIDTH, MotorCoulomb, TanhCoulomb
from oracles.score import projected
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE, Effect
from zygos.gap.balances import Layout, law_along
from zygos.gap.form import form_sigma
from zygos.gap.ground import explain
from zygos.gap.ground.explain import explain_ground
from zygos.gap.ground.form import form_sigmas
from zygos.gap.runs import record_of
from zygos.gap.study import Study, base_values, begin, read_hypothesis

SECONDS, GROUND_S = 4.0, 10.0
SIZE, COLUMN = 0.004, "motor_coulomb2"
LAWS = {"column": MotorCoulomb(1, SIZE), "slow": TanhCoulomb(1, SIZE, v0=0.1)}
"""A law of the form of the column, and one that reverses slowly."""


@cache
def sized(law: str) -> tuple[Study, float]:
    """The study of two runs in which the second joint hides a law, with the column of Coulomb friction; and the size of
    the law by least squares of its torque."""
    trial = standing()
    plain = replace(trial.drawn, effects=())
    cycles, motions = zip(*(Plant(trial, plain, (LAWS[law],)).run(which, 3, SECONDS) for which in (0, 1)), strict=True)
    runs = [record_of(Run(trial.arm, table=table, path=Path(name))) for table, name in zip(cycles, "ab", strict=True)]
    guess = replace(plain, effects=(Effect(CATALOGUE["motor_coulomb"], trial.arm.joints[1].name, 1.25 * SIZE),))
    study = begin(runs, read_hypothesis(Layout(trial.arm), guess), from_model(trial.arm, guess))
    return study, projected(LAWS[law], motions, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("law", "least", "most"), [("column", 0.0, 0.01), ("slow", 0.02, 0.2)])
def test_the_size_that_a_form_leaves_open(law: str, least: float, most: float) -> None:
    study, of_torque = sized(law)
    at = study.hypothesis.names.index(COLUMN)
    value, noise, form = float(study.value[at]), float(study.spread[at]), form_sigma(study, COLUMN)
    assert least < form / value < most
    assert abs(value - of_torque) < 2.0 * np.hypot(noise, form)
    # noise alone explains the size of a law of the column's form, and not that of the other
    assert (abs(value - of_torque) > 4.0 * noise) == (least > 0.0)


def at_once(_: Array, qd: Array) -> Array:
    """A sign that reverses as the column does."""
    return np.asarray(np.clip(qd / WIDTH, -1.0, 1.0))


def slowly(_: Array, qd: Array) -> Array:
    """A sign that reverses within 0.3 rad/s."""
    return np.asarray(np.tanh(qd / 0.3))


@pytest.mark.slow(only=["at_once*"])
@pytest.mark.parametrize(("sign", "least", "most"), [(at_once, 0.0, 0.02), (slowly, 0.03, 0.2)])
def test_the_size_that_a_form_leaves_open_on_the_ground(
    sign: Law, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = measured(lambda q, qd: 0.1 * size() * sign(q, qd), seconds=GROUND_S)[:2]
    arm, model = axis()
    rates = np.concatenate([motion(arm, GROUND_S, path)[1][:, 0] for path in (0, 1)])
    column = at_once(rates, rates)
    of_torque = 0.1 * size() * (column @ sign(rates, rates)) / (column @ column)
    forms: dict[str, float] = {}

    def noted(*arguments: Any) -> dict[str, float]:
        forms.update(form_sigmas(*arguments))
        return forms

    monkeypatch.setattr(explain, "form_sigmas", noted)
    (finding,) = (named for named in explain_ground(arm, model, runs).findings if named.kind == COLUMN[:-1])
    form = forms[f"{COLUMN[:-1]}1"]
    assert least < form / finding.value < most
    # what the noise leaves open is added to it, and is what a law of the column's form leaves open
    noise = np.sqrt(finding.sigma**2 - form**2)
    assert 0.0 < noise < 0.02 * finding.value
    assert abs(finding.value - of_torque) < 2.0 * finding.sigma


@pytest.mark.slow
def test_a_law_along_a_run() -> None:
    """What the parts of a law are weighted by: the torque per unit at every smoothed instant, and the rate."""
    study, _ = sized("column")
    law = study.layout.find(COLUMN)
    torque, rate = law_along(study.layout, law, study.records[0].readings(), base_values(study.model, study.layout))
    assert torque.shape == rate.shape == study.accepted[0].shape
    fast = rate > 0.01
    np.testing.assert_array_equal(np.abs(torque[fast]), 1.0)
    assert 0.5 < fast.mean() < 1.0
    assert rate.min() >= 0.0

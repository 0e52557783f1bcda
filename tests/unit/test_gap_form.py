"""What the form of a law leaves open of its size: a law of the column's form leaves little open, one that reverses
slowly as much as the size by the torque differs from the one by the energy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_arms_support import SECONDS, begun, standing

from oracles.arms import Plant, pendulum
from oracles.hidden import Law, MotorCoulomb, TanhCoulomb
from oracles.score import projected
from zygos.can.run import Run
from zygos.gap.balances import law_along
from zygos.gap.form import form_sigma
from zygos.gap.ground import explain
from zygos.gap.ground.columns import Table
from zygos.gap.ground.explain import explain_ground
from zygos.gap.ground.form import form_sigmas
from zygos.gap.ground.predictions import Stage
from zygos.gap.ground.search import Search
from zygos.gap.runs import record_of
from zygos.gap.study import Study, again, base_values
from zygos.model.model import Model

SIZE, COLUMN = 0.004, "motor_coulomb2"


def sized(law: Law) -> tuple[Study, float]:
    """The study of two runs in which the second joint hides a law, with the column of Coulomb friction; and the size of
    the law by least squares of its torque."""
    trial = standing()
    plant = Plant(trial, replace(trial.drawn, effects=()), (law,))
    made = [plant.run(which, 3, SECONDS) for which in (0, 1)]
    runs = tuple(
        record_of(Run(trial.arm, table=cycles, path=Path(name))) for (cycles, _), name in zip(made, "ab", strict=True)
    )
    plain = begun(trial, runs, ())
    after = again(plain, replace(plain.hypothesis, effects=(COLUMN,)))
    return after, projected(law, [motion for _, motion in made], 0)


@pytest.mark.parametrize(
    ("law", "least", "most"), [(MotorCoulomb(1, SIZE), 0.0, 0.01), (TanhCoulomb(1, SIZE, v0=0.1), 0.02, 0.2)]
)
def test_the_size_that_a_form_leaves_open(law: Law, least: float, most: float) -> None:
    study, size = sized(law)
    at = study.hypothesis.names.index(COLUMN)
    value, noise, form = float(study.value[at]), float(study.spread[at]), form_sigma(study, COLUMN)
    print(value, size, noise, form)
    assert least < form / value < most
    assert abs(value - size) < 2.0 * np.hypot(noise, form)
    # noise alone explains the size of a law of the column's form, and not that of the other
    assert (abs(value - size) > 4.0 * noise) == (least > 0.0)


@pytest.mark.parametrize(
    ("law", "least", "most"), [(MotorCoulomb(0, 0.1), 0.0, 0.02), (TanhCoulomb(0, 0.1, v0=0.3), 0.03, 0.2)]
)
def test_the_size_that_a_form_leaves_open_on_the_ground(
    law: Law, least: float, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = pendulum()
    model = replace(trial.drawn, effects=())
    made = [Plant(trial, model, (law,)).run(which, 3, SECONDS) for which in (0, 1)]
    runs = [Run(trial.arm, table=cycles, path=Path(name)) for (cycles, _), name in zip(made, "ab", strict=True)]
    size = projected(law, [motion for _, motion in made], 0)
    forms: dict[str, float] = {}

    def noted(simulation: Model, table: Table, found: Search, stage: Stage) -> dict[str, float]:
        forms.update(form_sigmas(simulation, table, found, stage))
        return forms

    monkeypatch.setattr(explain, "form_sigmas", noted)
    (finding,) = (one for one in explain_ground(trial.arm, model, runs).findings if one.kind == COLUMN[:-1])
    form = forms[f"{COLUMN[:-1]}1"]
    print(finding.value, size, finding.sigma, form)
    assert least < form / finding.value < most
    # what the noise leaves open is added to it, and is what a law of the column's form leaves open
    noise = np.sqrt(finding.sigma**2 - form**2)
    assert 0.0 < noise < 0.02 * finding.value
    assert abs(finding.value - size) < 2.0 * finding.sigma


def test_a_law_along_a_run() -> None:
    """What the parts of a law are weighted by: the torque per unit at every smoothed instant, and the rate."""
    study, _ = sized(MotorCoulomb(1, SIZE))
    one = study.layout.find(COLUMN)
    torque, rate = law_along(study.layout, one, study.records[0].readings(), base_values(study.model, study.layout))
    assert torque.shape == rate.shape == study.accepted[0].shape
    fast = rate > 0.01
    np.testing.assert_array_equal(np.abs(torque[fast]), 1.0)
    assert 0.5 < fast.mean() < 1.0
    assert rate.min() >= 0.0

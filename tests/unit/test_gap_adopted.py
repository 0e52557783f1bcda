# SPDX-License-Identifier: MIT
"""The gate of an explanation: what no arm can have, and what predicts worse than a baseline, is no model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from conftest import EXAMPLE
from zygos import limits
from zygos.arm import Arm, load_arm
from zygos.effects import CATALOGUE, Effect
from zygos.gap.adopted import Adopted, Check, NotAdopted, no_worse
from zygos.gap.findings import Disagreement, Value
from zygos.gap.sentences import verdict
from zygos.gap.verdicts import RunsDisagree, ValuesDiffer
from zygos.model.model import Model, load_model


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm(EXAMPLE / "arm.toml")


def with_values(arm: Arm, values: Mapping[str, float]) -> Model:
    """The example's base parameters, some of them changed."""
    base = load_model(EXAMPLE / "model.toml").base_parameters(arm)
    return Model("test", parameters=base | {name: replace(base[name], value=x) for name, x in values.items()})


def failures(arm: Arm, model: Model, *comparisons: Check) -> list[str]:
    with pytest.raises(NotAdopted) as refused:
        Adopted(arm, model, comparisons)
    assert all(check.sentence in str(refused.value) for check in refused.value.failed)
    assert "remedy:" in str(refused.value)
    return [check.name for check in refused.value.failed]


def test_the_models_own_values_pass(arm: Arm) -> None:
    passed = Adopted(arm, with_values(arm, {}))
    assert {"Im1", "k2", "b1"} <= {check.name for check in passed.checks}
    assert all(check.holds for check in passed.checks)


@pytest.mark.parametrize(("name", "value"), [("Im1", 0.0), ("Im2", -0.1), ("k1", -5.0), ("b2", -1e-3), ("k1", np.nan)])
def test_a_drive_that_no_arm_has(arm: Arm, name: str, value: float) -> None:
    assert failures(arm, with_values(arm, {name: value})) == [name]


@pytest.mark.parametrize("values", [{"a00": -11.0}, {"a11": 0.0}, {"a00": 0.1}])
def test_a_kinetic_energy_that_no_arm_has(arm: Arm, values: Mapping[str, float]) -> None:
    (name,) = failures(arm, with_values(arm, values))
    assert "conditions" in name


@pytest.mark.parametrize(
    ("key", "size", "fits"),
    [
        ("torque_lag", 0.99, True), ("torque_lag", 1.0, False), ("link_late", -0.5, True), ("link_late", 87.0, False),
        ("motor_late", -1.01, False), ("torque_gain", -0.9, True), ("torque_gain", 1.1, False),
        ("motor_scale", -1.5, False), ("backlash", 0.9, True), ("backlash", 2.1, False),
        ("motor_coulomb", -0.01, False),
    ],
)  # fmt: skip
def test_effects_lie_within_their_bounds(arm: Arm, key: str, size: float, fits: bool) -> None:
    """size: delays in periods, a gap in units of the stiffness."""
    plain = with_values(arm, {})
    kind = CATALOGUE[key]
    unit = {"s": arm.period_s}.get(kind.unit, plain.parameters["k1"].value if key == "backlash" else 1.0)
    effect = Effect(kind, arm.joints[0].name, size * unit, shape=kind.shapes[0] if kind.shapes else None)
    model = replace(plain, effects=(effect,))
    if fits:
        Adopted(arm, model)
    else:
        assert failures(arm, model) == [effect.column(arm)]


def test_a_model_is_no_worse_than_the_best_baseline(arm: Arm) -> None:
    baselines = [("as delivered", 3.0), ("refit", 2.0), ("plain estimate", np.nan)]
    good = no_worse("the error", "sigma", limits.NOT_WORSE.value * 2.0, baselines)
    assert good.holds and "refit" in good.sentence
    assert no_worse("the error", "sigma", 2.9, baselines, closed=3.0).holds
    for bad in (2.3, np.nan, np.inf):
        assert failures(arm, with_values(arm, {}), no_worse("the error", "sigma", bad, baselines)) == ["the error"]
    assert Adopted(arm, with_values(arm, {}), (good,)).checks[-1] is good


def test_a_sentence_names_the_plainest_values_and_counts_the_others(arm: Arm) -> None:
    values = [Value(f"v{k}", "kg m^2", 1.0, 0.0, 1.0 + 0.01 * k, 0.01) for k in range(1, 21)]
    said = verdict(arm, ValuesDiffer(tuple(values)))
    assert "v20 " in said and "v17 " in said and "v16 " not in said
    assert said.endswith("and 16 more.")
    apart = tuple(Disagreement(f"v{k}", 1.0, 2.0) for k in range(6))
    assert "and 2 more, and each closes by itself." in verdict(arm, RunsDisagree(apart))

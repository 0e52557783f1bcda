# SPDX-License-Identifier: MIT
"""Tiers and budgets of the tests, and the cache of simulated runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import runs_support
import tiers
from runs_support import kept, trajectory_of

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.simulation import plant
from zygos.simulation.scenario import Scenario


@pytest.mark.parametrize(
    ("case", "chosen", "slow"),
    [
        ("one", {}, True),
        ("one", {"but": ["one"]}, False),
        ("one-2", {"but": ["two-*", "one-*"]}, False),
        ("one-2", {"but": ["one"]}, True),
        ("one-2", {"only": ["one-*"]}, True),
        ("two-2", {"only": ["one-*"]}, False),
        ("one-2", {"only": ["one-*"], "but": ["*-2"]}, False),
    ],
)
def test_which_cases_are_slow(case: str, chosen: dict[str, list[str]], slow: bool) -> None:
    assert tiers.is_slow(case, **chosen) == slow


def test_a_run_that_costs_more_than_its_budget_fails_and_names_the_dearest() -> None:
    costs = {f"test_{k}": tiers.Cost(float(k)) for k in range(30)}
    good, lines = tiers.summary(costs, 435.0, 0.5, 871.0)
    assert good and len(lines) == tiers.DEAREST + 1
    assert lines[0].split() == ["29.0", "s", "test_29"]
    assert "435.0 s of processor time for 30 tests: 870 units of 0.500 s" in lines[-1]
    good, lines = tiers.summary(costs, 435.0, 0.5, 869.0)
    assert not good and "budget is 869; remedy" in lines[-1]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setattr(runs_support, "FOLDER", tmp_path)
    monkeypatch.setattr(runs_support, "_recent", {})
    return tmp_path


def test_a_run_is_simulated_once_and_is_that_of_the_simulator(
    arm: Arm, model: Model, scenario: Scenario, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    direct = plant.simulate(arm, model, scenario, seeds=[3], noise=True, duration_s=0.4)
    made = trajectory_of(arm, model, scenario, seeds=[3], noise=True, duration_s=0.4)
    monkeypatch.setattr(plant, "simulate", lambda *_, **__: pytest.fail("simulated again"))
    monkeypatch.setattr(runs_support, "_recent", {})  # another process
    read = trajectory_of(arm, model, scenario, seeds=[3], noise=True, duration_s=0.4)
    for trajectory in (made, read):
        for name in ("q", "theta", "omega0", "tau", "slip2"):
            np.testing.assert_array_equal(getattr(trajectory, name), getattr(direct, name))
        np.testing.assert_array_equal(trajectory.cycles().q, direct.cycles().q)
        assert not trajectory.q.flags.writeable
    np.testing.assert_array_equal(read.accelerations()[0], direct.accelerations()[0])
    assert len([path for path in folder.rglob("*") if path.is_file()]) == 1


def test_whatever_a_run_depends_on_makes_another_one(arm: Arm, model: Model, scenario: Scenario, folder: Path) -> None:
    others = [
        (arm, model, scenario, {}),
        (replace(arm, period_s=0.5 * arm.period_s), model, scenario, {}),
        (arm, replace(model, joints=tuple(replace(j, rotor_inertia=j.stiffness) for j in model.joints)), scenario, {}),
        (arm, model, replace(scenario, seed=scenario.seed + 1), {}),
        (arm, model, scenario, {"noise": False}),
        (arm, model, scenario, {"rtol": 1e-9}),
    ]
    for place, (*parts, options) in enumerate(others):
        assert kept(lambda place=place: place, ("zygos.simulation.plant",), *parts, options) == place
    assert kept(lambda: -1, ("zygos.simulation.plant",), arm, model, replace(scenario, arm=Path("elsewhere")), {}) == 0


def test_other_sources_begin_a_new_cache(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that a simulator imports has changed: nothing that was computed before is used."""
    monkeypatch.setattr(runs_support, "HARNESS", tmp_path / "sources")
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "law.py").write_text("FORCE = 1.0\n")
    (tmp_path / "sources" / "engine.py").write_text("from law import FORCE\n")
    for text, expected in (("1.0", 0), ("1.0", 0), ("2.0", 2)):
        (tmp_path / "sources" / "law.py").write_text(f"FORCE = {text}\n")
        runs_support._sources.cache_clear()
        assert kept(lambda expected=expected: expected, ("engine",), "argument") == expected
    assert len(list(folder.glob("engine-*"))) == 1
    runs_support._sources.cache_clear()


def test_what_the_cache_cannot_tell_apart_is_refused(folder: Path) -> None:
    with pytest.raises(TypeError, match="cannot be an argument of a cached run; remedy"):
        kept(lambda: 0, ("zygos.simulation.plant",), object())

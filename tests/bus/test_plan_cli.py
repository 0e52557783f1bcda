# SPDX-License-Identifier: MIT
"""`zygos plan` as a user types it: a motion that simulate runs and estimate reads, a ranking, and refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm_support import random_arm
from cli_support import run

from conftest import EXAMPLE
from zygos.arm import load_arm, save_arm
from zygos.effects import effect
from zygos.model.model import load_model, save_model
from zygos.simulation.scenario import load_scenario, save_scenario


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rigid joints in a plane on the ground, and their planned motion."""
    folder = tmp_path_factory.mktemp("plan")
    arm, model = random_arm(3, 2, "fixed", "planar", False)
    save_arm(replace(arm, period_s=0.01), folder / "arm.toml")
    save_model(model, folder / "model.toml")
    written = ("-o", folder / "planned.toml", "--json", folder / "plan.json", "--report", folder / "plan.html")
    assert plan(folder, "--rate", "1.5", "--period", "4", "--harmonics", "3", *written) == 0
    return folder


def plan(folder: Path, *more: object) -> int:
    return run("plan", "--arm", folder / "arm.toml", "--model", folder / "model.toml", "--torque-noise", "0.05", *more)


@pytest.mark.slow
def test_a_planned_scenario_is_simulated_and_ranked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads((folder / "plan.json").read_text())
    arm = load_arm(folder / "arm.toml")
    (motion,) = content["motions"]
    own = [entry["name"] for entry in motion["parameters"] if entry["of_the_arm"]]
    assert own == list(arm.parameter_names)
    assert max(motion["largest_rate_rad_s"]) <= 1.5 and motion["excess"] is None
    assert motion["worst"] in own and "kg m²" in (folder / "plan.html").read_text()
    assert run("simulate", folder / "planned.toml", "-o", folder / "run.blf") == 0
    planned = load_scenario(folder / "planned.toml")
    slow = {
        name: replace(one, sines=tuple(replace(sine, omega=0.5 * sine.omega) for sine in one.sines))
        for name, one in planned.manoeuvre.items()
    }
    save_scenario(replace(planned, name="slow", manoeuvre=slow), folder / "slow.toml")
    capsys.readouterr()
    assert plan(folder, "--candidates", folder / "slow.toml", folder / "planned.toml", "--json", "-") == 0
    ranking = json.loads(capsys.readouterr().out)
    assert ranking["ranking"] == ["planned", "slow"] and ranking["scenario"] is None
    assert [one["name"] for one in ranking["motions"]] == ["slow", "planned"]


def test_a_saved_scenario_is_read_as_it_was(folder: Path) -> None:
    planned = load_scenario(folder / "planned.toml")
    save_scenario(planned, folder / "again" / "same.toml")
    same = load_scenario(folder / "again" / "same.toml")
    assert same.arm.resolve() == planned.arm.resolve()
    assert replace(same, arm=planned.arm, plant=planned.plant) == planned
    example = load_scenario(EXAMPLE / "scenario.toml")
    save_scenario(example, folder / "example.toml")
    again = load_scenario(folder / "example.toml")
    t = np.linspace(0.0, example.duration_s, 50)
    names = list(example.manoeuvre)
    np.testing.assert_allclose(again.desired(names, t), example.desired(names, t), atol=1e-15)


@pytest.fixture(scope="module")
def springs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two motions of examples/lively with 0.5 % noise of the torques, and its model with friction."""
    folder = tmp_path_factory.mktemp("springs")
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    joints = tuple(replace(joint, torque_relative_sigma=0.005) for joint in arm.joints)
    save_arm(replace(arm, joints=joints), folder / "arm.toml")
    save_model(model, folder / "model.toml")
    save_model(replace(model, effects=(effect("motor_coulomb", "elbow", 1.0),)), folder / "rubbing.toml")
    scenario = load_scenario(EXAMPLE / "scenario.toml")
    scenario = replace(scenario, arm=folder / "arm.toml", plant=folder / "model.toml")
    for name, seconds in (("short", 3.0), ("long", 5.0)):
        save_scenario(replace(scenario, name=name, duration_s=seconds), folder / f"{name}.toml")
    return folder


@pytest.mark.slow
def test_motions_are_ranked_by_the_bound(springs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = (springs / "short.toml", springs / "long.toml")
    given = ("--json", springs / "plan.json", "--report", springs / "plan.html")
    assert run("plan", *files, "--by", "bound", *given, "--details") == 0
    table = capsys.readouterr().out
    content = json.loads((springs / "plan.json").read_text())
    page = (springs / "plan.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
    assert content["ranking"] == ["long", "short"] and content["rows"] == "bound"
    assert "the smallest of any unbiased estimate" in table and "Cramér–Rao bound" in page
    assert "mean σ, %" in page and "not determined" in page
    for motion in content["motions"]:
        assert run("bound", springs / f"{motion['name']}.toml", "--json", "-") == 0
        (least,) = json.loads(capsys.readouterr().out)["bounds"]
        assert motion["worst"] == least["worst"] and motion["open"] is None
        assert motion["mean_percent"] == pytest.approx(least["mean_percent"], rel=1e-6)
        for one, other in zip(motion["parameters"], least["parameters"], strict=True):
            assert one["sigma"] == pytest.approx(other["sigma"], rel=1e-6) and one["size"] == other["size"]
        mean = f"{motion['mean_percent']:.3g}"
        assert mean in table and mean in page


def test_a_motion_is_searched_by_the_bound(springs: Path, tmp_path: Path) -> None:
    files = (springs / "short.toml", "--arm", springs / "arm.toml", "--model", springs / "model.toml")
    sought = ("--by", "bound", "--simulations", 2, "--period", 3, "-o", tmp_path / "planned.toml")
    assert run("plan", *files, *sought, "--json", tmp_path / "plan.json") == 0
    assert load_scenario(tmp_path / "planned.toml").duration_s == 3.0
    content = json.loads((tmp_path / "plan.json").read_text())
    assert sorted(content["ranking"]) == ["planned", "short"] and content["rows"] == "bound"


def test_the_bound_of_what_has_none_is_refused(folder: Path, springs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert plan(folder, "--by", "bound", folder / "planned.toml") == 2
    said = capsys.readouterr().err
    assert "joint joint1 is rigid" in said and "remedy: " in said and "or leave out --by bound" in said
    files = (springs / "short.toml", "--model", springs / "rubbing.toml")
    assert run("plan", *files, "--by", "bound") == 2
    assert "(motor_coulomb); remedy: remove them" in capsys.readouterr().err


@pytest.mark.slow(only=["more1-*"])
@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("-o", "{out}/p.toml", "--rate", "wrist=1"), "no joint 'wrist'"),
        (("-o", "{out}/p.toml", "--torque", "0.001"), "no motion within the limits was found"),
        (("-o", "{out}/p.toml", "--duration", "15"), "not a whole number of periods"),
        (("-o", "{out}/p.toml", "--candidates"), "only ranks"),
        (("-o", "{out}/p.txt"), "not a name for a model"),
        (("{in}/planned.toml", "--rate", "0.5"), "beyond its limit of 0.5 rad/s"),
        ((), "there is nothing to do"),
        ((EXAMPLE / "scenario.toml",), "the manoeuvre has joints"),
    ],
)
def test_what_cannot_be_planned_is_refused(
    folder: Path, tmp_path: Path, more: tuple[object, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(part).format(out=tmp_path, **{"in": folder}) for part in more]
    assert plan(folder, *given) == 2
    said = capsys.readouterr().err
    assert words in said and "remedy: " in said
    assert not list(tmp_path.iterdir())

# SPDX-License-Identifier: MIT
"""What `zygos estimate` and `zygos listen` say of an arm that changed, of intervals, and of noise."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bus_support import playing
from cli_support import run
from runs_support import trajectory_of

from conftest import EXAMPLE
from zygos.arm import load_arm
from zygos.can import bus
from zygos.model.model import Model, Quantity, load_model
from zygos.native.flight import encode
from zygos.simulation.scenario import load_scenario

pytestmark = pytest.mark.slow
BODIES = {"a00", "a01", "a02", "a11", "a12", "a22"}


def heavier(model: Model) -> Model:
    *others, last = model.bodies
    return replace(model, bodies=(*others, replace(last, mass=Quantity(2.0 * last.mass.value))))


def heavy_a22() -> float:
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    return float(heavier(model).base_values(arm)[5])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of 250 s: same.blf, where nothing happens, and changed.blf, where the last link is heavier from 120 s on."""
    folder = tmp_path_factory.mktemp("change")
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    scenario = load_scenario(EXAMPLE / "scenario.toml")
    heavy = heavier(model)
    same = trajectory_of(arm, model, scenario, duration_s=250.0, seeds=[1]).cycles(0)
    before = trajectory_of(arm, model, scenario, duration_s=120.0, seeds=[1]).cycles(0)
    after = trajectory_of(arm, heavy, scenario, duration_s=130.0, seeds=[2]).cycles(0)
    after = replace(after, sync=after.sync + np.uint64(2400 + 17))
    (folder / "arm.toml").write_bytes((EXAMPLE / "arm.toml").read_bytes())
    bus.write_log(folder / "same.blf", encode(arm, same), arm.period_s)
    bus.write_log(folder / "changed.blf", np.concatenate([encode(arm, before), encode(arm, after)]), arm.period_s)
    return folder


@pytest.mark.slow
def test_a_change_is_a_warning_that_names_what_and_when(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, numbers = tmp_path / "m.toml", tmp_path / "m.json"
    # the change alone is no reason to refuse; that the balance of such a mixture does not close is
    assert run("estimate", "--energy", folder / "changed.blf", "-o", out, "--json", numbers) == 3
    said = capsys.readouterr().err
    assert "warning: the arm changed after 120 s" in said
    assert "split the log" in said and "memory_min" in said
    assert "remedy: read the warning" in said
    content = json.loads(numbers.read_text())
    assert content["changed"] and set(content["changed"]) <= BODIES
    assert content["changed_after_s"] == pytest.approx(120.0, abs=0.1)
    assert abs(content["drift"]["a22"]) > 6.0
    assert set(content["drift"]) == {parameter["name"] for parameter in content["parameters"]}
    assert out.exists()


def test_where_old_arcs_fade_the_answer_follows(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """130 s behind the change, with a memory of 40 s, a twenty-fifth of what the light arm left is left."""
    arm = tmp_path / "arm.toml"
    off = []
    for text in ("[arc]\nmax_s = 20.0\nmemory_min = 0.67\n", "[arc]\nmax_s = 20.0\n"):
        arm.write_text((EXAMPLE / "arm.toml").read_text() + text)
        out = tmp_path / "m.toml"
        numbers = tmp_path / "m.json"
        assert run("estimate", "--energy", folder / "changed.blf", "--arm", arm, "-o", out, "--json", numbers) in (0, 3)
        said = capsys.readouterr().err  # arcs of 20 s hardly tell a change from an effect that is missing
        assert "warning: the arm changed after 120 s" in said or "warning: the data after 120 s contradict" in said
        off.append(abs(json.loads(numbers.read_text())["solution"][5] / heavy_a22() - 1.0))
    assert off[0] < 0.04 < 0.1 < off[1]
    arm.write_text((EXAMPLE / "arm.toml").read_text() + "[arc]\nmemory_min = 0.0\n")
    assert run("estimate", folder / "changed.blf", "--arm", arm, "-o", out) == 2
    assert "arc.memory_min" in capsys.readouterr().err


def test_no_warning_where_nothing_happens(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "m.json"
    assert run("estimate", "--energy", folder / "same.blf", "-o", tmp_path / "m.toml", "--json", numbers) == 0
    said = capsys.readouterr()
    assert "changed" not in said.err
    assert said.out.startswith("valid: ")
    assert "noise:" not in said.out
    content = json.loads(numbers.read_text())
    assert content["changed"] == [] and content["changed_after_s"] is None
    assert max(map(abs, content["drift"].values())) < 6.0
    assert 0.6 < content["noise_ratio"] < 1.7 and content["gate"] > 2.0
    for parameter in content["parameters"]:
        # Student's factor for at least two blocks, at most as many as there are
        assert 1.95 < parameter["half95"] / parameter["sigma"] < 5.0


def test_sensors_that_are_better_than_declared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.blf"
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", log, "--no-noise") == 0
    assert run("estimate", log, "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json") == 3  # doubtful
    assert "of what the arm file's sigmas predict" in capsys.readouterr().out
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["noise_ratio"] < 0.6
    # a single arc has nothing before it
    assert content["drift"] is None


def test_listen_says_it_too(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "live.json"
    options = ["-i", "virtual", "-c", "test_change", "--idle", 1, "--json", numbers]
    with playing("test_change", folder / "changed.blf"):
        code = run("listen", "--arm", EXAMPLE / "arm.toml", *options, "-o", tmp_path / "live.toml")
    assert code == 3
    assert "warning: the arm changed after 120 s" in capsys.readouterr().err
    assert (
        run("estimate", "--energy", folder / "changed.blf", "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json")
        == 3
    )
    live, replayed = (json.loads(file.read_text()) for file in (numbers, tmp_path / "m.json"))
    assert live["drift"] == replayed["drift"]

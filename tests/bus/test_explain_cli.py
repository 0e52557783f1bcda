"""`zygos explain` as a user types it: answers, refusals, and what is written in each case."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from cli_support import run

from conftest import EXAMPLE, ROOT
from zygos.arm import load_arm
from zygos.cli.explain import flown, unflown
from zygos.effects import CATALOGUE, Effect, effect
from zygos.model.model import load_model, save_model

FRICTION = 2.0
"""Nm at the elbow's rotor."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of examples/lively, plain (p0 p1 p2) and with friction at the elbow's motor (f0 f1 f2)."""
    folder = tmp_path_factory.mktemp("runs")
    rubbing = folder / "rubbing.toml"
    model = load_model(EXAMPLE / "model.toml")
    save_model(replace(model, effects=(Effect(CATALOGUE["motor_coulomb"], "elbow", FRICTION),)), rubbing)
    for seed in range(3):
        assert run("simulate", EXAMPLE / "scenario.toml", "-o", folder / f"p{seed}.blf", "--seed", seed) == 0
        out = folder / f"f{seed}.blf"
        assert run("simulate", EXAMPLE / "scenario.toml", "--model", rubbing, "-o", out, "--seed", seed) == 0
    # nothing that holds the truth is left beside the runs
    rubbing.unlink()
    return folder


def coarse(folder: Path) -> Path:
    """An arm file that declares coarser encoders than the arm has."""
    arm = folder / "arm.toml"
    arm.write_text((EXAMPLE / "arm.toml").read_text().replace("quantum_rad = 0.003", "quantum_rad = 0.006"))
    return arm


def explain(folder: Path, prefix: str, out: Path, *more: object, simulation: Path = EXAMPLE / "model.toml") -> int:
    runs = [folder / f"{prefix}{k}.blf" for k in range(3)]
    arguments = ["--simulation", simulation, "--measured", runs[0], runs[1], "--validate", runs[2], "-o", out]
    return run("explain", *arguments, *more)


@pytest.mark.slow
def test_names_what_the_simulation_lacks(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, verdict, page = tmp_path / "new.toml", tmp_path / "verdict.json", tmp_path / "gap.html"
    assert explain(folder, "f", out, "--json", verdict, "--report", page) == 0
    said = capsys.readouterr()
    assert "named: The simulation lacks Coulomb friction at the motor (elbow)" in said.out
    assert "as delivered" in said.out and "floor" in said.out
    assert "estimate of the flight library: motor_coulomb2" in said.out
    content = json.loads(verdict.read_text())
    (found,) = content["findings"]
    assert (found["effect"], found["joint"], found["unit"]) == ("motor_coulomb", "elbow", "Nm")
    assert found["interval"][0] < found["value"] < found["interval"][1]
    assert found["value"] == pytest.approx(FRICTION, rel=0.05)
    assert list(content["gap"])[1:5] == ["as_delivered", "refit", "closed", "floor"]
    assert {entry["role"] for entry in content["files"]} == {"simulation", "arm", "measured", "validate"}
    assert all(re.fullmatch("[0-9a-f]{64}", entry["sha256"]) for entry in content["files"])
    assert content["command"].startswith("zygos explain --simulation")
    flown = content["flight"][0]
    assert flown["value"] == pytest.approx(FRICTION, rel=0.1)
    assert 1.9 * flown["sigma"] < flown["half95"]
    assert "Coulomb friction" in page.read_text()
    (effect,) = load_model(out).effects
    assert (effect.kind.key, effect.joint, effect.value) == ("motor_coulomb", "elbow", found["value"])


def test_a_damaged_log_is_explained_with_a_warning(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 4, the same name, and the model is written; an answer that is none goes before."""
    runs = [folder / "f0.blf", tmp_path / "f1.blf", folder / "f2.blf"]
    runs[1].write_bytes((folder / "f1.blf").read_bytes()[:-5000])
    out, verdict = tmp_path / "new.toml", tmp_path / "verdict.json"
    arguments = ["--simulation", EXAMPLE / "model.toml", "--measured", *runs[:2], "--validate", runs[2], "-o", out]
    arguments += ["--arm", folder / "arm.toml", "--json", verdict]
    assert run("explain", *arguments) == 4
    error = capsys.readouterr().err
    assert f"warning: {runs[1]} is damaged" in error and "based on the readable part of a damaged log" in error
    content = json.loads(verdict.read_text())
    assert [found["effect"] for found in content["findings"]] == ["motor_coulomb"]
    assert content["damage"][0].startswith(f"{runs[1]} is damaged in the object at byte")
    assert load_model(out).effects
    arguments[arguments.index(folder / "arm.toml")] = coarse(tmp_path)
    assert run("explain", *arguments) == 3
    assert "warning" in capsys.readouterr().err


def test_estimate_learns_the_effect_that_explain_wrote(folder: Path, tmp_path: Path) -> None:
    out, learned = tmp_path / "new.toml", tmp_path / "learned.toml"
    assert explain(folder, "f", out) == 0
    assert run("estimate", folder / "f2.blf", "--model", out, "-o", learned) == 0
    (effect,) = load_model(learned).effects
    assert effect.value == pytest.approx(FRICTION, rel=0.1)


def test_nothing_missing_is_an_answer(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert explain(folder, "p", tmp_path / "new.toml", "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["answer"] == "nothing missing"
    assert content["findings"] == []
    assert all(candidate["limit"] > 0.0 for candidate in content["candidates"])


def test_unknown_writes_no_model_but_says_why(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The balances close better than the noise that the arm file declares."""
    arm = coarse(tmp_path)
    out, verdict, page = tmp_path / "new.toml", tmp_path / "verdict.json", tmp_path / "gap.html"
    assert explain(folder, "p", out, "--arm", arm, "--json", verdict, "--report", page) == 3
    assert not out.exists()
    content = json.loads(verdict.read_text())
    assert content["answer"] == "unknown"
    assert content["findings"] == []
    assert "unknown" in page.read_text()
    error = capsys.readouterr().err
    assert "not written" in error and "remedy" in error and "Traceback" not in error


def test_a_rigid_simulation_lacks_flexibility(folder: Path, tmp_path: Path) -> None:
    rigid = tmp_path / "rigid.toml"
    text = (EXAMPLE / "model.toml").read_text()
    rigid.write_text(re.sub("damping = .*", "damping = 0", re.sub("stiffness = .*", "stiffness = inf", text)))
    out, verdict = tmp_path / "new.toml", tmp_path / "verdict.json"
    assert explain(folder, "p", out, "--json", verdict, simulation=rigid) == 0
    found = json.loads(verdict.read_text())["findings"]
    assert [(f["effect"], f["joint"]) for f in found] == [
        ("joint_flexibility", "shoulder"),
        ("joint_flexibility", "elbow"),
    ]
    parameters = load_model(out).parameters
    assert parameters["k1"].value == pytest.approx(3000.0, rel=0.02)
    assert parameters["k2"].value == pytest.approx(1000.0, rel=0.02)


def test_without_a_third_run_the_gap_is_not_known(folder: Path, tmp_path: Path) -> None:
    verdict = tmp_path / "verdict.json"
    arguments = ["--simulation", EXAMPLE / "model.toml", "--measured", folder / "f0.blf", folder / "f1.blf"]
    assert run("explain", *arguments, "-o", tmp_path / "new.toml", "--json", verdict) == 0
    content = json.loads(verdict.read_text())
    assert content["gap"] is None
    assert any("--validate" in remark for remark in content["remarks"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"second": "p0.blf"}, "are the same recording"),
        ({"second": "nowhere.blf"}, "no such"),
        ({"third": "p1.blf"}, "are the same recording"),
        ({"out": "new.txt"}, "give it the suffix .toml"),
        ({"report": "p1.blf"}, "would replace"),
        ({"simulation": "nowhere.toml"}, "no such file"),
        ({"arm": "nowhere.toml"}, "no such arm file"),
    ],
)
def test_refusals_name_the_thing_and_the_remedy(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, str], message: str
) -> None:
    out = tmp_path / change.get("out", "new.toml")
    simulation = folder / change["simulation"] if "simulation" in change else EXAMPLE / "model.toml"
    arguments: list[object] = ["--simulation", simulation, "--measured", folder / "p0.blf"]
    arguments += [folder / change.get("second", "p1.blf"), "--validate", folder / change.get("third", "p2.blf")]
    arguments += ["-o", out]
    for option in ("report", "arm"):
        arguments += [f"--{option}", folder / change[option]] if option in change else []
    before = sorted(folder.iterdir())
    assert run("explain", *arguments) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert message in error and "remedy" in error and "Traceback" not in error
    assert not out.exists()
    assert sorted(folder.iterdir()) == before


def test_a_model_of_another_arm_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other.toml"
    other.write_text((EXAMPLE / "model.toml").read_text().replace('name = "elbow"', 'name = "wrist"'))
    assert explain(folder, "p", tmp_path / "new.toml", simulation=other) == 2
    assert "use the same joint names" in " ".join(capsys.readouterr().err.split())


def test_motor_currents_of_an_arm_that_floats_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = tmp_path / "arm.toml"
    text = (EXAMPLE / "arm.toml").read_text()
    arm.write_text(text.replace('torque_at = "rotor"', 'torque_at = "rotor"\ntorque_unit = "A"', 1))
    out = tmp_path / "new.toml"
    assert explain(folder, "p", out, "--arm", arm) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "its torques are motor currents" in error and "remedy: give torques in Nm" in error
    assert not out.exists()


def test_a_single_run_is_cut_into_thirds(folder: Path, tmp_path: Path) -> None:
    verdict, arguments = tmp_path / "verdict.json", ["--simulation", EXAMPLE / "model.toml", "--measured"]
    assert run("explain", *arguments, folder / "f0.blf", "-o", tmp_path / "new.toml", "--json", verdict) == 0
    content = json.loads(verdict.read_text())
    assert [(found["effect"], found["joint"]) for found in content["findings"]] == [("motor_coulomb", "elbow")]
    assert content["findings"][0]["value"] == pytest.approx(FRICTION, rel=0.05)
    # what is learned from one part holds on the second, and the gap is measured on the third
    assert {len(candidate["each"]) for candidate in content["candidates"]} == {2}
    assert content["gap"] is not None
    arcs = [entry["arcs"] for entry in content["runs"]]
    assert len(arcs) == 3 and max(arcs) - min(arcs) <= 1


def test_a_single_short_run_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short, out = tmp_path / "short.blf", tmp_path / "new.toml"
    for name in ("arm.toml", "model.toml"):
        (tmp_path / name).write_text((EXAMPLE / name).read_text())
    scenario = (EXAMPLE / "scenario.toml").read_text().replace("duration_s = 60.0", "duration_s = 12.0")
    (tmp_path / "scenario.toml").write_text(scenario)
    assert run("simulate", tmp_path / "scenario.toml", "-o", short) == 0
    assert run("explain", "--simulation", EXAMPLE / "model.toml", "--measured", short, "-o", out) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "cannot be cut into 3 parts" in error and "remedy: give two runs (--measured A B)" in error
    assert not out.exists()


@pytest.mark.slow
def test_a_single_run_is_halved_beside_two_that_are_kept_apart(folder: Path, tmp_path: Path) -> None:
    verdict, apart = tmp_path / "verdict.json", ["--validate", folder / "f1.blf", folder / "f2.blf"]
    arguments = ["--simulation", EXAMPLE / "model.toml", "--measured", folder / "f0.blf", *apart]
    assert run("explain", *arguments, "-o", tmp_path / "new.toml", "--json", verdict) == 0
    content = json.loads(verdict.read_text())
    assert [(found["effect"], found["joint"]) for found in content["findings"]] == [("motor_coulomb", "elbow")]
    assert [entry["role"] for entry in content["files"]] == ["simulation", "arm", "measured", "validate", "validate"]
    assert [Path(entry["run"]).name for entry in content["runs"]] == ["f0.blf", "f0.blf", "f1.blf", "f2.blf"]
    # values from half a run predict both runs better than without the effect
    assert content["gap"]["median"]["closed"] < 0.5 * content["gap"]["median"]["refit"]


@pytest.mark.slow
def test_an_untouched_run_that_lacks_the_effect_forbids_its_name(folder: Path, tmp_path: Path) -> None:
    verdict, arguments = tmp_path / "verdict.json", ["--simulation", EXAMPLE / "model.toml", "--measured"]
    arguments += [folder / "f0.blf", folder / "f1.blf", "--validate", folder / "p0.blf"]
    run("explain", *arguments, "-o", tmp_path / "new.toml", "--json", verdict)
    assert json.loads(verdict.read_text())["answer"] in {"part named", "unknown"}


def test_the_shipped_logs_are_those_that_were_sealed() -> None:
    import hashlib

    demo = ROOT / "examples" / "gap" / "demo"
    sealed = json.loads((demo / "sealed.json").read_text())
    assert {path.name for path in demo.glob("*.blf")} == set(sealed["sha256"])
    for name, digest in sealed["sha256"].items():
        assert hashlib.sha256((demo / name).read_bytes()).hexdigest() == digest


def test_the_flight_library_estimates_nothing_where_it_lacks_a_column() -> None:
    """A model that it can only estimate in part would bias what it has columns for."""
    arm = load_arm(ROOT / "examples/gap/arm.toml")
    model = load_model(ROOT / "examples/gap/cad.toml")
    adopted = replace(model, effects=(*model.effects, replace(effect("link_viscous", "elbow", 1.0), source="zygos")))
    found: Any = SimpleNamespace(arm=arm, model=adopted)
    assert unflown(found) == ["link_viscous2"]
    assert flown(found, []) == []
    found.model = None
    assert unflown(found) == []

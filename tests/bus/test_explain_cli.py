# SPDX-License-Identifier: MIT
"""`zygos explain` as a user types it: answers, refusals, and what is written in each case."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from cli_support import run
from runs_support import trajectory_of

from conftest import EXAMPLE, ROOT
from zygos.arm import load_arm, save_arm
from zygos.can.run import Run, load_run, save_run
from zygos.cli.explain import flown, unflown
from zygos.effects import effect
from zygos.model.model import load_model, save_model
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

FRICTION = 2.0
"""Nm at the rotor."""


def record(folder: Path, joints: int, duration_s: float) -> None:
    """Runs of the first joints of examples/lively, plain (p0 p1 p2) and with friction at the last motor (f0 f1 f2)."""
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    scenario = load_scenario(EXAMPLE / "scenario.toml")
    arm = replace(arm, joints=arm.joints[:joints])
    bodies = (*model.bodies[:joints], replace(model.bodies[joints], joint_xyz=None))
    model = replace(model, bodies=bodies, joints=model.joints[:joints])
    manoeuvre = {joint.name: scenario.manoeuvre[joint.name] for joint in arm.joints}
    start = scenario.initial_angles_rad[:joints]
    scenario = replace(scenario, manoeuvre=manoeuvre, initial_angles_rad=start, duration_s=duration_s)
    save_arm(arm, folder / "arm.toml")
    save_model(model, folder / "model.toml")
    for name, effects in (("p", ()), ("f", (effect("motor_coulomb", arm.joints[-1].name, FRICTION),))):
        plant = replace(model, effects=effects)
        made = trajectory_of(arm, plant, scenario, seeds=range(3), noise=True, rtol=1e-9, atol=1e-11)
        for k in range(3):
            save_run(Run.of_cycles(arm, made.cycles(k)), folder / f"{name}{k}.blf")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The runs of the shoulder alone, and one that is too short to be cut."""
    folder = tmp_path_factory.mktemp("runs")
    record(folder, 1, 40.0)
    whole = load_run(folder / "p0.blf")
    part = Cycles(*(getattr(whole.cycles, field)[:240] for field in Cycles.__dataclass_fields__))
    save_run(Run.of_cycles(whole.arm, part), folder / "short.blf")
    return folder


def damaged(folder: Path, name: str, out: Path) -> Path:
    """A log that ends within an object."""
    (out / name).write_bytes((folder / name).read_bytes()[:-5000])
    return out / name


def explain(
    folder: Path, out: Path, measured: list[Path], validate: list[Path], *more: object, simulation: str = "model.toml"
) -> int:
    """Exit code; the JSON is out/verdict.json and the page out/gap.html."""
    apart = ["--validate", *validate] if validate else []
    files = ("-o", out / "new.toml", "--json", out / "verdict.json", "--report", out / "gap.html")
    return run("explain", "--simulation", folder / simulation, *measured, *apart, *files, *more)


def verdict(out: Path) -> Any:
    return json.loads((out / "verdict.json").read_text())


def runs(folder: Path, *names: str) -> list[Path]:
    return [folder / f"{name}.blf" for name in names]


class Answer(NamedTuple):
    """An exit code, the folder of what was written, and what was said."""

    code: int
    out: Path
    said: str


@pytest.fixture(scope="module")
def named(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Answer:
    """The answer to runs with friction."""
    out = tmp_path_factory.mktemp("named")
    with contextlib.redirect_stdout(io.StringIO()) as said:
        code = explain(folder, out, runs(folder, "f0", "f1"), runs(folder, "f2"))
    return Answer(code, out, said.getvalue())


def test_names_what_the_simulation_lacks(named: Answer) -> None:
    assert named.code == 0
    assert "named: The simulation lacks Coulomb friction at the motor (shoulder)" in named.said
    assert "as delivered" in named.said and "floor" in named.said
    assert "estimate of the flight library: motor_coulomb1" in named.said
    content = verdict(named.out)
    (found,) = content["findings"]
    assert (found["effect"], found["joint"], found["unit"]) == ("motor_coulomb", "shoulder", "Nm")
    assert found["interval"][0] < found["value"] < found["interval"][1]
    assert found["value"] == pytest.approx(FRICTION, rel=0.05)
    assert list(content["gap"])[1:5] == ["as_delivered", "refit", "closed", "floor"]
    # the runs do not rule out noise of the torque sensors, of which the arm file says nothing
    assert any("an offset and a gain of each torque sensor" in remark for remark in content["remarks"])
    assert {entry["role"] for entry in content["files"]} == {"simulation", "arm", "measured", "validate"}
    assert all(re.fullmatch("[0-9a-f]{64}", entry["sha256"]) for entry in content["files"])
    assert content["command"].startswith("zygos explain --simulation")
    flown = content["flight"][0]
    assert flown["value"] == pytest.approx(FRICTION, rel=0.1)
    assert 1.9 * flown["sigma"] < flown["half95"]
    assert "Coulomb friction" in (named.out / "gap.html").read_text()
    (learned,) = load_model(named.out / "new.toml").effects
    assert (learned.kind.key, learned.joint, learned.value) == ("motor_coulomb", "shoulder", found["value"])


@pytest.mark.slow
def test_estimate_learns_the_effect_that_explain_wrote(folder: Path, named: Answer, tmp_path: Path) -> None:
    learned = tmp_path / "learned.toml"
    assert run("estimate", folder / "f2.blf", "--model", named.out / "new.toml", "-o", learned) == 0
    (friction,) = load_model(learned).effects
    assert friction.value == pytest.approx(FRICTION, rel=0.1)


@pytest.mark.slow
def test_a_damaged_log_is_explained_with_a_warning(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 4, the same name, and the model is written. Without a third run the gap is not known."""
    log = damaged(folder, "f1.blf", tmp_path)
    assert explain(folder, tmp_path, [folder / "f0.blf", log], [], "--arm", folder / "arm.toml") == 4
    error = capsys.readouterr().err
    assert f"warning: {log} is damaged" in error and "based on the readable part of a damaged log" in error
    content = verdict(tmp_path)
    assert [found["effect"] for found in content["findings"]] == ["motor_coulomb"]
    assert content["damage"][0].startswith(f"{log} is damaged in the object at byte")
    assert load_model(tmp_path / "new.toml").effects
    assert content["gap"] is None
    assert any("--validate" in remark for remark in content["remarks"])


def test_unknown_writes_no_model_but_says_why(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The balances close better than the noise that the arm file declares. An answer that is none goes before the
    damage of a log."""
    arm = tmp_path / "arm.toml"
    arm.write_text((folder / "arm.toml").read_text().replace("quantum_rad = 0.003", "quantum_rad = 0.006"))
    log = damaged(folder, "p1.blf", tmp_path)
    assert explain(folder, tmp_path, [folder / "p0.blf", log], runs(folder, "p2"), "--arm", arm) == 3
    assert not (tmp_path / "new.toml").exists()
    content = verdict(tmp_path)
    assert content["answer"] == "unknown"
    assert content["findings"] == []
    assert "unknown" in (tmp_path / "gap.html").read_text()
    error = capsys.readouterr().err
    assert "warning" in error and "not written" in error and "remedy" in error and "Traceback" not in error


def test_nothing_missing_is_an_answer_and_a_single_run_is_cut_into_thirds(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert explain(folder, tmp_path, runs(folder, "p0"), [], "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["answer"] == "nothing missing"
    assert content["findings"] == []
    assert all(candidate["limit"] > 0.0 for candidate in content["candidates"])
    # what is learned from one part holds on the second, and the gap is measured on the third
    assert {len(candidate["each"]) for candidate in content["candidates"]} == {2}
    assert content["gap"] is not None
    arcs = [entry["arcs"] for entry in content["runs"]]
    assert len(arcs) == 3 and max(arcs) - min(arcs) <= 1


def test_a_rigid_simulation_lacks_flexibility(folder: Path, tmp_path: Path) -> None:
    text = (folder / "model.toml").read_text()
    text = re.sub("damping = .*", "damping = 0", re.sub("stiffness = .*", "stiffness = inf", text))
    (folder / "rigid.toml").write_text(text)
    assert explain(folder, tmp_path, runs(folder, "p0"), [], simulation="rigid.toml") == 0
    found = verdict(tmp_path)["findings"]
    assert [(f["effect"], f["joint"]) for f in found] == [("joint_flexibility", "shoulder")]
    assert load_model(tmp_path / "new.toml").parameters["k1"].value == pytest.approx(3000.0, rel=0.02)


@pytest.mark.slow(only=["change1*"])
@pytest.mark.parametrize(
    ("change", "message"),
    [
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
    simulation = folder / change.get("simulation", "model.toml")
    arguments: list[object] = ["--simulation", simulation, folder / "p0.blf"]
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
    (folder / "other.toml").write_text((folder / "model.toml").read_text().replace('"shoulder"', '"wrist"'))
    assert explain(folder, tmp_path, runs(folder, "p0", "p1"), [], simulation="other.toml") == 2
    assert "use the same joint names" in " ".join(capsys.readouterr().err.split())


def test_motor_currents_of_an_arm_that_floats_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = tmp_path / "arm.toml"
    text = (folder / "arm.toml").read_text()
    arm.write_text(text.replace('torque_at = "rotor"', 'torque_at = "rotor"\ntorque_unit = "A"', 1))
    assert explain(folder, tmp_path, runs(folder, "p0", "p1"), [], "--arm", arm) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "its torques are motor currents" in error and "remedy: give torques in Nm" in error
    assert not (tmp_path / "new.toml").exists()


def test_a_single_short_run_is_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert explain(folder, tmp_path, runs(folder, "short"), []) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "cannot be cut into 3 parts" in error and "remedy: give two runs, or one of at least" in error
    assert not (tmp_path / "new.toml").exists()


@pytest.mark.slow
def test_values_from_half_a_run_are_not_written_where_they_predict_others_worse(folder: Path, tmp_path: Path) -> None:
    """What half a run says of the values predicts another run worse than the model as delivered, and is not written."""
    assert explain(folder, tmp_path, runs(folder, "f0"), runs(folder, "f1", "f2")) == 3
    content = verdict(tmp_path)
    assert "Coulomb friction at the motor (shoulder)" in content["partly"]
    assert "as delivered" in next(check["beside"] for check in content["checks"] if not check["holds"])
    assert [entry["role"] for entry in content["files"]] == ["simulation", "arm", "measured", "validate", "validate"]
    assert [Path(entry["run"]).name for entry in content["runs"]] == ["f0.blf", "f0.blf", "f1.blf", "f2.blf"]
    # they predict both runs better than without the effect
    assert content["gap"]["median"]["closed"] < 0.5 * content["gap"]["median"]["refit"]


@pytest.mark.slow
def test_an_untouched_run_that_lacks_the_effect_forbids_its_name(tmp_path: Path) -> None:
    record(tmp_path, 2, 40.0)
    explain(tmp_path, tmp_path, runs(tmp_path, "f0", "f1"), runs(tmp_path, "p0"))
    assert verdict(tmp_path)["answer"] in {"part named", "unknown"}


def test_the_shipped_logs_are_those_that_were_sealed() -> None:
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

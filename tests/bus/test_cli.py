# SPDX-License-Identifier: MIT
"""The commands as a user types them, with an answer and with a refusal each."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from bus_support import playing
from cli_support import run
from numpy.typing import NDArray
from rich.console import Console
from runs_support import trajectory_of
from schema_support import hold
from telemetry_support import drawn_signals

from conftest import EXAMPLE, ROOT
from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.can.run import read_run
from zygos.cli import simulate as simulate_command
from zygos.cli.live import line_of, table_of
from zygos.demo import demonstration as demo
from zygos.effects import effect
from zygos.errors import ZygosError
from zygos.estimation.remedies import remedy as remedy_of
from zygos.estimation.watch import Watch
from zygos.model.model import load_model, save_model
from zygos.native.flight import Flight
from zygos.reference import compare as check
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed


def example_with(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """A copy of the example whose file `name` is changed; returns that file."""
    shutil.copytree(EXAMPLE, folder, dirs_exist_ok=True)
    text = (folder / name).read_text()
    for find, put in changes:
        assert find in text
        text = text.replace(find, put)
    (folder / name).write_text(text)
    return folder / name


def lasting(folder: Path, duration_s: float) -> Path:
    """The scenario of a copy of the example that ends earlier."""
    return example_with(folder, "scenario.toml", ("duration_s = 60.0", f"duration_s = {duration_s}"))


def test_simulate_leaves_a_run_and_its_arm_and_no_truth(recording: Path) -> None:
    assert sorted(path.name for path in recording.parent.iterdir()) == ["arm.toml", "run.blf"]
    assert recording.with_name("arm.toml").read_bytes() == (EXAMPLE / "arm.toml").read_bytes()


def test_simulated_signals_for_programs_that_draw_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario, log = lasting(tmp_path / "example", 2.0), tmp_path / "run.blf"
    assert run("simulate", scenario, "-o", log, "--mcap", tmp_path / "drawn.csv") == 2
    assert "give it the suffix .mcap" in capsys.readouterr().err and not log.exists()
    assert run("simulate", scenario, "-o", log, "--mcap", tmp_path / "drawn.mcap") == 0
    messages, _ = drawn_signals(tmp_path / "drawn.mcap")
    arm = load_arm(tmp_path / "arm.toml")
    cycles = read_run(log, arm).cycles
    states = [message for _, message in messages["/measured/joint_states"]]
    np.testing.assert_allclose([state.position for state in states[: len(cycles)]], cycles.q, atol=1e-5)
    assert abs(len(states) - len(cycles)) <= 1 and len(messages["/measured/motor_states"]) == len(states)


@pytest.mark.slow
def test_estimate_where_no_truth_exists(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(recording.parent, tmp_path, dirs_exist_ok=True)
    out, numbers = tmp_path / "m.toml", tmp_path / "m.json"
    assert run("estimate", tmp_path / "run.blf", "-o", out, "--json", numbers) == 0
    assert "a11" in capsys.readouterr().out
    content = json.loads(numbers.read_text())
    assert content["validity"] == "valid"
    model = load_model(out)
    arm = load_arm(tmp_path / "arm.toml")
    values = [one["value"] for one in content["values"]]
    assert np.allclose(model.base_values(arm), values, rtol=1e-12)
    assert {quantity.source for quantity in model.parameters.values()} == {"zygos"}


@pytest.mark.slow
def test_estimate_json_to_stdout_is_all_there_is(
    brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("estimate", "--energy", brief_recording, "-o", tmp_path / "m.toml", "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["arm"] == "lively"


def test_the_estimate_can_be_simulated(brief_recording: Path, tmp_path: Path) -> None:
    assert run("estimate", "--energy", brief_recording, "-o", tmp_path / "m.toml") == 0
    scenario = lasting(tmp_path / "example", 1.0)
    assert run("simulate", scenario, "--model", tmp_path / "m.toml", "-o", tmp_path / "again.log") == 0


FRICTION = """
[[effect]]
kind = "motor_coulomb"
joint = "elbow"
value = 0.8
unit = "Nm"
evidence = "the elbow's brake drags"

[[effect]]
kind = "rotor_coupling"
joint = "elbow"
value = 1.0

[[effect]]
kind = "angular_momentum"
value = 1.0
"""


@pytest.mark.slow
def test_effects_of_a_model_are_learned(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Their values in the prior play no part; what is no column is carried over."""
    plant = example_with(tmp_path / "example", "model.toml")
    bodies = plant.read_text()
    plant.write_text(bodies + FRICTION)
    log, out, numbers = tmp_path / "run.blf", tmp_path / "m.toml", tmp_path / "m.json"
    assert run("simulate", lasting(tmp_path / "brief", 20.0), "--model", plant, "-o", log) == 0
    assert run("estimate", log, "-o", out) == 3
    assert "only if --model names them" in capsys.readouterr().err
    plant.write_text(bodies + FRICTION.replace("0.8", "0.0"))
    assert run("estimate", log, "--energy", "-o", out, "--model", plant, "--json", numbers) == 0
    assert "motor_coulomb2" in capsys.readouterr().out
    friction, *others = load_model(out).effects
    assert friction.value == pytest.approx(0.8, rel=0.05)
    assert (friction.source, friction.evidence) == ("zygos", "the elbow's brake drags")
    assert 0.0 < friction.sigma < 0.1
    assert tuple(others) == load_model(plant).effects[1:]
    last = json.loads(numbers.read_text())["parameters"][-1]
    assert (last["name"], last["unit"], last["value"]) == ("motor_coulomb2", "Nm", friction.value)
    assert run("self-test", log, "--model", plant, "--json", numbers) == 0
    rooms = {room["room"]: room for room in json.loads(numbers.read_text())["rooms"]}
    assert rooms["solution"]["compared"] == 13
    # the model that was learned is one to begin with
    assert run("estimate", log, "--energy", "-o", tmp_path / "again.toml", "--model", out) == 0
    assert load_model(tmp_path / "again.toml") == load_model(out)


@pytest.mark.slow
def test_an_arm_file_that_does_not_vouch_for_a_zero_gets_an_offset(recording: Path, tmp_path: Path) -> None:
    """The run was made with zeros that are right; here the elbow's are not: 0.02 rad at 1000 Nm/rad."""
    arm = tmp_path / "arm.toml"
    off = "zero_rad = 0.0, zero_sigma_rad = 0.0"
    before, after = (EXAMPLE / "arm.toml").read_text().rsplit(off, 1)
    out, log = tmp_path / "m.toml", recording
    arm.write_text(f"{before}zero_rad = 0.02, zero_sigma_rad = 0.02{after}")
    assert run("self-test", log, "--arm", arm) == 0
    run("estimate", "--energy", log, "--arm", arm, "-o", out)
    (found,) = load_model(out).effects
    assert (found.kind.key, found.joint, found.source) == ("spring_offset", "elbow", "zygos")
    # q reads too little, theta - q too much
    assert found.value == pytest.approx(-20.0, rel=0.1)
    # a prior that names it is not asked twice
    again = tmp_path / "again.toml"
    run("estimate", "--energy", log, "--arm", arm, "--model", out, "-o", again)
    assert load_model(again) == load_model(out)


@pytest.mark.slow
def test_a_friction_that_noise_makes_negative_is_written_as_none(brief_recording: Path, tmp_path: Path) -> None:
    written = set()
    for joint in ("shoulder", "elbow"):
        for kind in ("motor_coulomb", "motor_viscous", "cubic_stiffness"):
            prior = example_with(tmp_path / "example", "model.toml")
            prior.write_text(prior.read_text() + f'[[effect]]\nkind = "{kind}"\njoint = "{joint}"\nvalue = 1.0\n')
            out, numbers = tmp_path / "m.toml", tmp_path / "m.json"
            command = ("estimate", brief_recording, "--energy", "-o", out, "--model", prior, "--json", numbers)
            assert run(*command) == 0
            found = json.loads(numbers.read_text())["parameters"][-1]["value"]
            expected = found if kind == "cubic_stiffness" else max(found, 0.0)
            assert load_model(out).effects[0].value == expected
            written.add(found < 0.0)
    assert written == {True, False}


@pytest.mark.parametrize("command", ["estimate", "self-test"])
def test_a_rotor_that_does_not_couple_is_refused(
    command: str, brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = example_with(tmp_path / "example", "model.toml")
    prior.write_text(prior.read_text() + FRICTION.replace("value = 1.0", "value = 0.0"))
    more = ("-o", tmp_path / "m.toml") if command == "estimate" else ()
    assert run(command, brief_recording, "--model", prior, *more) == 2
    assert re.search("rotor_coupling at elbow.*remedy", capsys.readouterr().err, re.S)


@pytest.mark.slow
def test_a_rigid_prior_is_kept_where_the_run_is_silent(tmp_path: Path) -> None:
    """An elbow that is rigid, and seen to be: neither stiffness nor damping has a value. Its deflection is noise, or
    nothing where there is none and none is declared."""
    rigid = example_with(tmp_path / "example", "model.toml", ("stiffness = 1000.0", "stiffness = inf"))
    exact = example_with(tmp_path / "exact", "arm.toml", ("# [compensation]", "[compensation]\nevery = 0"))
    shutil.copy(rigid, exact.with_name("model.toml"))
    out = tmp_path / "m.toml"
    for scenario, noise, close in ((EXAMPLE, (), 0.05), (exact.parent, ("--no-noise",), 0.01)):
        log = tmp_path / scenario.name / "run.blf"
        log.parent.mkdir(exist_ok=True)
        assert run("simulate", scenario / "scenario.toml", "--model", rigid, "-o", log, *noise) == 0
        assert run("estimate", log, "-o", out, "--model", rigid) == 0  # partial
        arm, model, plant = load_arm(scenario / "arm.toml"), load_model(out), load_model(rigid)
        assert model.parameters["k2"].value == np.inf
        assert model.parameters["k2"].source == "CAD"
        learned = [name for name, quantity in model.parameters.items() if quantity.source == "zygos"]
        assert set(learned) == set(arm.parameter_names) - {"k2", "b2"}
        np.testing.assert_allclose(model.base_values(arm)[:10], plant.base_values(arm)[:10], rtol=close)
    # a rigid prior for an arm that is not rigid is corrected
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", tmp_path / "soft.blf") == 0
    assert run("estimate", "--energy", tmp_path / "soft.blf", "-o", out, "--model", rigid) == 0
    assert load_model(out).parameters["k2"].value == pytest.approx(1000.0, rel=0.05)


@pytest.mark.slow
def test_estimate_of_too_short_a_run_is_undecided(
    brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = bus.read_log(brief_recording).frames
    short = tmp_path / "short.blf"
    bus.write_log(short, frames[:150], 0.05)
    code = run(
        "estimate", short, "--arm", EXAMPLE / "arm.toml", "-o", tmp_path / "m.toml", "--json", tmp_path / "m.json"
    )
    assert code == 3
    assert not (tmp_path / "m.toml").exists()
    assert "too few" in capsys.readouterr().err
    content = json.loads((tmp_path / "m.json").read_text())
    assert content["validity"] == "refused"
    assert content["parameters"][0]["value"] is None


@pytest.mark.slow
def test_check(recording: Path, tmp_path: Path) -> None:
    assert run("self-test", recording, "--json", tmp_path / "check.json") == 0
    rooms = {room["room"]: room for room in json.loads((tmp_path / "check.json").read_text())["rooms"]}
    assert all(room["equal"] for room in rooms.values())
    assert rooms["balance"]["compared"] > 10_000


def test_check_says_when_c_and_numpy_differ(brief_recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from zygos.runs.smoother import smooth

    def bent(arm: Arm, samples: Samples) -> Smoothed:
        straight = smooth(arm, samples)
        return replace(straight, qd=straight.qd * (1 + 1e-9))

    monkeypatch.setattr(check, "smooth", bent)
    assert run("self-test", brief_recording) == 3


@pytest.mark.slow
def test_listen(brief_recording: Path, tmp_path: Path) -> None:
    with playing("test_listen", brief_recording):
        where = ("-i", "virtual", "-c", "test_listen", "--idle", 1)
        files = ("-o", tmp_path / "live.toml", "--log", tmp_path / "live.blf", "--report", tmp_path / "live.html")
        code = run("listen", "--arm", EXAMPLE / "arm.toml", *where, *files)
    assert code == 0
    assert "The energy" in (tmp_path / "live.html").read_text()
    assert run("estimate", brief_recording, "--energy", "-o", tmp_path / "replayed.toml") == 0
    assert (tmp_path / "live.toml").read_bytes() == (tmp_path / "replayed.toml").read_bytes()
    assert bus.read_log(tmp_path / "live.blf").frames.tobytes() == bus.read_log(brief_recording).frames.tobytes()


@pytest.mark.parametrize("effects", [(), ("cubic_stiffness",)])
def test_an_estimate_says_for_each_value_which_it_is_and_why(
    effects: tuple[str, ...], brief_recording: Path, tmp_path: Path
) -> None:
    """Refined, but not where the model has an effect that a refinement does not know."""
    model, joint = load_model(EXAMPLE / "model.toml"), load_arm(EXAMPLE / "arm.toml").joints[0].name
    save_model(replace(model, effects=tuple(effect(key, joint, 1.0) for key in effects)), tmp_path / "prior.toml")
    out, written = tmp_path / "m.json", tmp_path / "m.toml"
    assert run("estimate", brief_recording, "--model", tmp_path / "prior.toml", "-o", written, "--json", out) == 0
    found = json.loads(out.read_text())
    assert {one["source"] for one in found["values"]} == {"energy balance" if effects else "refined"}
    assert found["refinement"]["published"] == (not effects)
    assert all(("cubic_stiffness" in one["reason"]) == bool(effects) and one["reason"] for one in found["values"])
    parameters = load_model(written).parameters
    known = [one for one in found["values"] if one["name"] in parameters]
    assert len(known) == 12 and [parameters[one["name"]].value for one in known] == [one["value"] for one in known]


def test_energy_stops_before_the_refinement(brief_recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.json"
    assert run("estimate", brief_recording, "-o", tmp_path / "m.toml", "--energy", "--json", out) == 0
    found = json.loads(out.read_text())
    assert "values" not in found and "refinement" not in found
    written = load_model(tmp_path / "m.toml").parameters
    assert [written[one["name"]].value for one in found["parameters"]] == [one["value"] for one in found["parameters"]]


def test_what_listen_shows_while_it_listens(brief_recording: Path) -> None:
    """Too little data is no refusal; with all of it the table has the values that `estimate` gives."""
    frames, arm = bus.read_log(brief_recording).frames, load_arm(EXAMPLE / "arm.toml")
    watch = Watch(Flight(arm))
    watch.frames(frames[:200])
    early = watch.flight.estimate()
    assert early.validity == "refused"
    assert line_of(watch, early).endswith("0/12 parameters · learning")
    watch.frames(frames[200:])
    late = watch.flight.estimate()
    table, console = table_of(watch, late), Console(width=100, file=io.StringIO())
    console.print(table)
    said = console.file.getvalue()
    assert [name for name in late.names if f" {name} " not in said] == []
    assert f"{late.value[0]:.7g}" in said
    assert "0 cycles dropped, 0 frames rejected · 12/12 parameters · valid" in re.sub(r"\s+", " ", said)


def test_listen_estimates_the_effects_of_a_model(
    brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As `estimate` does; table and JSON tell the significance of effects, and of nothing else."""
    prior = tmp_path / "prior.toml"
    entry = '\n[[effect]]\nkind = "motor_viscous"\njoint = "elbow"\nvalue = 0\n'
    prior.write_text((EXAMPLE / "model.toml").read_text() + entry)
    answers = []
    with playing("test_effects", brief_recording):
        options = ("--idle", 1, "--model", prior, "--details", "--json", tmp_path / "live.json")
        listen("test_effects", tmp_path, *options)
    given = ("--energy", "--model", prior, "-o", tmp_path / "o.toml", "--json", tmp_path / "o.json", "--details")
    run("estimate", brief_recording, *given)
    for name in ("live.json", "o.json"):
        answers.append(json.loads((tmp_path / name).read_text()))
        hold("estimate", answers[-1])
    assert answers[0]["parameters"] == answers[1]["parameters"]
    *others, friction = answers[0]["parameters"]
    assert friction["name"] == "motor_viscous2"
    assert friction["significance"] == pytest.approx(abs(friction["value"]) / friction["sigma"])
    assert {other["significance"] for other in others} == {None}
    assert load_model(tmp_path / "live.toml").effects == load_model(tmp_path / "o.toml").effects
    said = capsys.readouterr().out
    assert said.count("significance") == 2
    assert run("estimate", "--energy", brief_recording, "-o", tmp_path / "o.toml", "--details") == 0
    assert "significance" not in capsys.readouterr().out


@pytest.mark.slow
def test_paper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("zygos.paper.tables.simulate", trajectory_of)
    assert run("paper", "--seeds", 2, "--example", EXAMPLE, "--json", tmp_path / "paper.json") == 0
    said = capsys.readouterr().out
    assert "Table III" in said
    assert "Table IV" in said
    assert "23774.1975" in said
    methods = {entry["method"]: entry for entry in json.loads((tmp_path / "paper.json").read_text())["methods"]}
    assert methods["EB, exact data"]["max_rms_percent"] < 1e-6


@pytest.mark.parametrize(
    "arguments",
    [
        ("estimate", "none.blf", "-o", "m.toml"),
        ("estimate", "run.csv", "--arm", EXAMPLE / "arm.toml", "-o", "m.toml"),
        ("self-test", "none.blf", "--arm", EXAMPLE / "arm.toml"),
        ("simulate", "none.toml", "-o", "run.blf"),
        ("simulate", EXAMPLE / "scenario.toml", "-o", "run.csv"),
        ("simulate", EXAMPLE / "arm.toml", "-o", "run.blf"),
        ("simulate", EXAMPLE / "scenario.toml", "--model", EXAMPLE / "arm.toml", "-o", "run.blf"),
        ("simulate", EXAMPLE / "scenario.toml", "-o", "run.blf", "--seed", "-1"),
        ("listen", "--arm", EXAMPLE / "arm.toml", "-i", "no_such_interface", "-c", "x", "-o", "m.toml"),
        ("listen", "--arm", "none.toml", "-i", "virtual", "-o", "m.toml"),
        ("paper", "--example", "nowhere"),
        ("paper", "--seeds", "many"),
        ("estimate", "run.db", "--arm", EXAMPLE / "arm.toml", "-o", "m.toml"),
        ("simulate", EXAMPLE / "scenario.toml", "-o", "run.db"),
        ("listen", "--arm", EXAMPLE / "arm.toml", "-i", "virtual", "-c", "x", "-o", "m.json"),
        ("listen", "--arm", EXAMPLE / "arm.toml", "-i", "virtual", "-c", "x", "-o", "m.toml", "--log", "run.csv"),
        ("no_such_command",),
        ("estimate", "--no-such-option"),
    ],
)
def test_bad_input(
    arguments: Sequence[object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    said = capsys.readouterr().err
    assert said.strip()
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_another_arm_beside_the_run_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "arm.toml").write_text("name = 'mine'\n")
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", tmp_path / "run.blf") == 2
    assert "a different arm" in capsys.readouterr().err
    assert (tmp_path / "arm.toml").read_text() == "name = 'mine'\n"
    assert not (tmp_path / "run.blf").exists()


@pytest.mark.parametrize("command", ["simulate", "estimate", "self-test", "listen", "dbc", "bus-load", "paper"])
def test_help_teaches(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "--help") == 0
    assert f"zygos {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("estimate", "run.blf", "-o", "arm.toml"), "arm.toml"),
        (("estimate", "run.blf", "--arm", "hardware.toml", "-o", "hardware.toml"), "hardware.toml"),
        (("estimate", "run.blf", "--arm", "hardware.toml", "-o", "arm.toml"), "arm.toml"),
        (("estimate", "run.blf", "--model", "model.toml", "-o", "./model.toml"), "model.toml"),
        (("estimate", "run.blf", "-o", "link.toml"), "arm.toml"),
        (("estimate", "run.blf", "-o", "m.toml", "--json", "run.blf"), "run.blf"),
        (("estimate", "run.blf", "-o", "m.toml", "--json", "m.toml"), "m.toml"),
        (("simulate", "scenario.toml", "-o", "other.blf", "--json", "scenario.toml"), "scenario.toml"),
        (("simulate", "scenario.toml", "-o", "other.blf", "--json", "model.toml"), "model.toml"),
        (("simulate", "scenario.toml", "-o", "new/other.blf", "--json", "new/arm.toml"), "new/arm.toml"),
        (("simulate", "scenario.toml", "-o", "other.blf", "--json", "other.blf"), "other.blf"),
        (("self-test", "run.blf", "--json", "run.blf"), "run.blf"),
        (("self-test", "run.blf", "--json", "arm.toml"), "arm.toml"),
        (("self-test", "run.blf", "--report", "arm.toml"), "arm.toml"),
        (("estimate", "run.blf", "-o", "m.toml", "--report", "m.toml"), "m.toml"),
        (("check-arm", "run.blf", "--arm", "arm.toml", "--report", "run.blf"), "run.blf"),
        (("listen", "-i", "virtual", "-c", "x", "--arm", "arm.toml", "-o", "arm.toml"), "arm.toml"),
        (("listen", "-i", "virtual", "-c", "x", "--arm", "arm.toml", "-o", "m.toml", "--json", "m.toml"), "m.toml"),
        (("paper", "--seeds", 2, "--example", ".", "--json", "scenario.toml"), "scenario.toml"),
    ],
)
def test_no_output_replaces_an_input_or_another_output(
    arguments: Sequence[object],
    named: str,
    brief_recording: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(EXAMPLE, tmp_path, dirs_exist_ok=True)
    shutil.copy(brief_recording, tmp_path)
    shutil.copy(EXAMPLE / "arm.toml", tmp_path / "hardware.toml")
    (tmp_path / "link.toml").symlink_to("arm.toml")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    assert f"would replace {named}" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_model_is_called_toml_and_its_folder_is_made(brief_recording: Path, tmp_path: Path) -> None:
    assert run("estimate", brief_recording, "-o", tmp_path / "m.json") == 2
    assert list(tmp_path.iterdir()) == []
    assert run("estimate", "--energy", brief_recording, "-o", tmp_path / "new" / "m.toml") == 0
    assert (tmp_path / "new" / "m.toml").is_file()


def test_the_run_is_looked_for_before_its_arm(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (("estimate", "-o", tmp_path / "m.toml"), ("self-test",)):
        assert run(command[0], tmp_path / "none.blf", *command[1:]) == 2
        assert "none.blf: no such file" in capsys.readouterr().err


def test_paths_are_printed_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = lasting(tmp_path / "example", 1.0)
    log = tmp_path / "[red]:car:" / "run.log"
    assert run("simulate", scenario, "-o", log) == 0
    assert str(log) in capsys.readouterr().out
    assert run("self-test", tmp_path / "[red]:car:" / "none.log") == 2
    assert "[red]:car:" in capsys.readouterr().err


def test_a_file_that_cannot_be_written_is_named(
    brief_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", ".123.partial")

    monkeypatch.setattr("os.replace", full)
    out = tmp_path / "m.toml"
    assert run("estimate", "--energy", brief_recording, "-o", out, "--json", "-") == 2
    said = capsys.readouterr()
    assert json.loads(said.out)["validity"] == "valid"
    assert f"{out}: cannot be written (No space left" in said.err
    assert "partial" not in said.err
    with pytest.raises(ZygosError, match=r"run\.blf: cannot be written"):
        bus.write_log(tmp_path / "run.blf", bus.read_log(brief_recording).frames[:100], 0.05)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_terminal_without_utf8(brief_recording: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    environment.pop("PYTHONIOENCODING", None)
    for end in ([], ["--json", "-"]):
        command = [sys.executable, "-m", "zygos.cli", "estimate", brief_recording, "-o", tmp_path / "m.toml"]
        done = subprocess.run([*command, *end], env=environment, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
        assert b"a00" in done.stdout


def test_what_estimate_says(brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = bus.read_log(brief_recording).frames
    frames["data"][300, 3] ^= 1
    damaged = tmp_path / "run.log"
    bus.write_log(damaged, frames, 0.05)
    numbers = tmp_path / "m.json"
    assert run("estimate", damaged, "--arm", EXAMPLE / "arm.toml", "-o", tmp_path / "m.toml", "--json", numbers) == 0
    said = capsys.readouterr().out
    assert "1 cycle dropped, 1 frame rejected" in said
    assert "arcs: 2, 0 dropped" in said
    assert len(said.splitlines()) <= 10 and said.startswith("valid: ")
    assert (
        run("estimate", "--energy", damaged, "--arm", EXAMPLE / "arm.toml", "-o", tmp_path / "m.toml", "--details") == 0
    )
    assert "stiffness, elbow" in capsys.readouterr().out
    content = json.loads(numbers.read_text())
    covariance = np.array(content["covariance"])
    sigma = np.array([parameter["sigma"] for parameter in content["parameters"]])
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), sigma)
    assert covariance.shape == (12, 12)


Damage = Callable[[NDArray[np.void]], NDArray[np.void]]


@pytest.mark.parametrize(
    ("damage", "remedy"),
    [
        (lambda frames: frames[:0], "no frame of this arm came"),
        (lambda frames: frames[frames["id"] != 0x181], r"no cycle was complete.*incomplete"),
        (lambda frames: np.delete(frames, np.s_[::9]), r"loses or damages frames.*incomplete"),
        (lambda frames: frames[frames["id"] != 0x3A0], r"FTIME \(0x3A0\) must come"),
    ],
)
def test_the_remedy_begins_with_the_bus(damage: Damage, remedy: str, brief_recording: Path) -> None:
    flight = Flight(load_arm(EXAMPLE / "arm.toml"))
    flight.frames(damage(bus.read_log(brief_recording).frames))
    result = replace(flight.estimate(), reason="the estimate is not physical")
    assert re.search(remedy, remedy_of(result, flight))


def test_the_remedy_names_another_period(brief_recording: Path) -> None:
    arm = load_arm(EXAMPLE / "arm.toml")
    flight = Flight(replace(arm, period_s=0.02))
    flight.frames(bus.read_log(brief_recording).frames)
    assert flight.faults["time_jumped"] > 0
    assert "period_s of the arm file disagrees" in remedy_of(flight.estimate(), flight)


@pytest.mark.parametrize("count", [0, 40])
def test_check_of_a_run_without_an_instant(
    count: int, brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = bus.read_log(brief_recording).frames[: count or None]
    bus.write_log(tmp_path / "run.blf", frames, 0.05)
    change = ("node = 1\n", "node = 9\n") if count == 0 else ("node = 1\n", "node = 1\n")
    arm = example_with(tmp_path / "example", "arm.toml", change)
    assert run("self-test", tmp_path / "run.blf", "--arm", arm, "--details") == 3
    said = capsys.readouterr()
    assert "too few accepted instants; remedy" in said.err
    assert "fault counters" in said.out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "changes"),
    [
        ("--noise", [("gain = 1.0", "gain = 0.0")]),
        ("--no-noise", [(f"amplitude_rad = {size}", "amplitude_rad = 0.0") for size in (0.9, 0.8)]),
    ],
)
def test_a_run_at_rest_is_undecided(
    noise: str, changes: Sequence[tuple[str, str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = ("duration_s = 60.0", "duration_s = 10.0")
    scenario = example_with(tmp_path / "example", "scenario.toml", short, *changes)
    log = tmp_path / "run.blf"
    assert run("simulate", scenario, "-o", log, noise) == 0
    assert run("estimate", log, "-o", tmp_path / "m.toml") == 3
    capsys.readouterr()
    assert run("self-test", log, "--details") == 3
    said = capsys.readouterr()
    assert "no solution to compare" in said.err
    assert "bandwidth test" in said.out
    assert "differs" not in said.out


def listen(channel: str, folder: Path, *more: object) -> int:
    where = ("-i", "virtual", "-c", channel, "-o", folder / "live.toml", "--log", folder / "live.log")
    return run("listen", "--arm", EXAMPLE / "arm.toml", *where, *more)


@pytest.mark.slow(only=["2"])
@pytest.mark.parametrize("which", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_listening_and_keeps_what_was_learned(
    which: signal.Signals, brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def unheard(*_: object) -> None:
        raise AssertionError("the signal was not taken")

    before = signal.signal(which, unheard)
    try:
        with playing(f"test_{which}", brief_recording, lambda: os.kill(os.getpid(), which)):
            begin = time.monotonic()
            assert listen(f"test_{which}", tmp_path, "--idle", 60) == 0
        assert time.monotonic() - begin < 20
        assert signal.getsignal(which) is unheard
    finally:
        signal.signal(which, before)
    said = capsys.readouterr().err
    assert re.search(
        r"stopped; the estimate is of [\d,]+ cycles and goes to .*live.toml, and the frames to .*live.log", said
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["live.log", "live.toml"]
    assert bus.read_log(tmp_path / "live.log").frames.tobytes() == bus.read_log(brief_recording).frames.tobytes()


@pytest.mark.slow
def test_the_heartbeat_of_others_does_not_keep_it_listening(brief_recording: Path, tmp_path: Path) -> None:
    done = threading.Event()

    other = bus.open_bus("virtual", "test_beat")

    def beat() -> None:
        with other:
            while not done.wait(0.2):
                other.send(can.Message(arbitration_id=0x720, data=[5], is_extended_id=False))

    beating = threading.Thread(target=beat)
    beating.start()
    try:
        with playing("test_beat", brief_recording):
            assert listen("test_beat", tmp_path, "--idle", 1, "--duration", 40) == 0
        begin = time.monotonic()
        assert listen("test_beat", tmp_path, "--idle", 0.1, "--duration", 40) == 3
        assert time.monotonic() - begin < 20
    finally:
        done.set()
        beating.join()


def test_a_bus_that_fails_while_listening(
    brief_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from can.interfaces.virtual import VirtualBus

    down = threading.Event()
    receive = VirtualBus._recv_internal

    def failing(self: VirtualBus, timeout: float | None) -> tuple[can.Message | None, bool]:
        if down.is_set():
            raise can.CanOperationError("Network is down")
        return receive(self, timeout)

    monkeypatch.setattr(VirtualBus, "_recv_internal", failing)
    with playing("test_down", brief_recording, down.set):
        assert listen("test_down", tmp_path, "--idle", 60) == 3
    said = capsys.readouterr()
    assert "Network is down" in said.err
    assert "a00" in said.out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["live.log", "live.toml"]


def test_a_log_that_fails_does_not_lose_the_estimate(
    brief_recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(can.CanutilsLogWriter, "on_message_received", full)
    with playing("test_full", brief_recording):
        assert listen("test_full", tmp_path, "--idle", 2) == 2
    said = capsys.readouterr()
    assert "live.log: cannot be written (No space left" in said.err
    assert "a00" in said.out
    assert [path.name for path in tmp_path.iterdir()] == ["live.toml"]


@pytest.mark.parametrize("option", ["-o", "--log", "--json"])
def test_listen_looks_at_its_outputs_first(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.toml").mkdir()
    names = {"-o": "m.toml", "--log": "run.log", "--json": "m.json"}
    for bad in (tmp_path / "file" / names[option], tmp_path / "folder.toml"):
        given = {"-o": tmp_path / "m.toml", option: bad}
        if option == "--log" and bad.suffix != ".log":
            continue
        code = run("listen", "--arm", EXAMPLE / "arm.toml", "-i", "virtual", "-c", "x", "--duration", 1,
                   *(part for pair in given.items() for part in pair))  # fmt: skip
        said = capsys.readouterr().err
        assert code == 2
        assert str(bad) in said
        assert "listening" not in said


@pytest.mark.slow
def test_listen_to_silence_for_a_second(tmp_path: Path) -> None:
    begin = time.monotonic()
    assert listen("test_silence", tmp_path, "--duration", 1) == 3
    assert time.monotonic() - begin < 4
    assert list(tmp_path.iterdir()) == []


def test_simulate_opens_the_bus_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(simulate_command, "simulate", lambda *_, **__: pytest.fail("simulated before the bus was open"))
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", tmp_path / "run.blf", "-i", "nothing", "-c", "x") == 2
    assert "cannot be opened" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_bus_that_takes_no_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from can.interfaces.virtual import VirtualBus

    def down(*_: object, **__: object) -> None:
        raise can.CanOperationError("Network is down")

    monkeypatch.setattr(VirtualBus, "send", down)
    log = tmp_path / "run.blf"
    assert run("simulate", lasting(tmp_path / "example", 1.0), "-o", log, "-i", "virtual", "-c", "x") == 2
    assert f"(Network is down); {log} is written; remedy" in capsys.readouterr().err
    assert log.is_file()


@pytest.mark.slow
def test_the_demo_says_when_frames_were_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(bus, "transferred", lambda frames, *_: np.delete(frames, 500))
    with pytest.raises(ZygosError, match=r"lost or damaged.*incomplete 1.*remedy"):
        demo.run_demo(tmp_path / "demo")
    assert not (tmp_path / "demo.json").exists()


@pytest.mark.slow
def test_the_demo_says_what_its_estimate_is_worth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And README shows some of it, as a terminal of 100 columns does."""
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(demo, "choose_bus", lambda: ("virtual", "test_demo"))
    demo.run_demo(tmp_path / "demo")
    content = json.loads((tmp_path / "demo.json").read_text())
    hold("demo", content)
    assert content["validity"] == "valid"
    assert list(content["faults"].values()) == [0] * len(content["faults"])
    said = {line.split("  ")[0]: line for line in capsys.readouterr().out.splitlines()}
    table = (ROOT / "README.md").read_text(encoding="utf-8").split("```")[1].strip().splitlines()[1:-2]
    shown = [line for line in table if line != "…"]
    assert len(shown) == 6
    for line in shown:
        rows = [re.findall(r"[-+]?\d+\.?\d*", one) for one in (line, said[line.split("  ")[0]])]
        readme, printed = (np.array(row, dtype=float) for row in rows)
        np.testing.assert_allclose(readme, printed, rtol=1e-4, atol=2e-5)

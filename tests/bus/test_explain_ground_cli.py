# SPDX-License-Identifier: MIT
"""`zygos explain` of an arm on the ground as a user types it: answers, exit codes, files, refusals."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from cli_support import run
from ground_gap_support import Array, Law, axis, measured, nothing, sign, simulated, size

from zygos.arm import save_arm
from zygos.can.run import save_run
from zygos.effects import CATALOGUE, Effect
from zygos.model.model import Model, Quantity, load_model, save_model
from zygos.simulation.scenario import load_scenario


def coulomb(q: Array, qd: Array) -> Array:
    return 0.1 * size() * sign(qd)


def one_sided(q: Array, qd: Array) -> Array:
    """Coulomb friction that differs between the directions, in a motion that never rests."""
    return np.where(qd > 0.0, 0.13, 0.07) * size() * sign(qd)


def bent(q: Array, qd: Array) -> Array:
    """A viscous friction of another form than the catalogue's."""
    return 0.1 * size() * (qd + 0.5 * qd**3)


def cubic(q: Array, qd: Array) -> Array:
    """A friction with which viscous friction predicts most of a run worse."""
    return 0.1 * size() * qd**3


def of_angle(q: Array, qd: Array) -> Array:
    """No entry of the catalogue depends on the angle of a link alone."""
    return 0.05 * size() * np.sin(7.0 * q)


def from_half(q: Array, qd: Array) -> Array:
    """Coulomb friction that begins half-way."""
    late = np.arange(len(q))[:, None] >= len(q) // 2
    return np.where(late, coulomb(q, qd), 0.0)


LAWS: dict[str, Law | list[Law]] = {
    "nothing": nothing,
    "coulomb": coulomb,
    "one_sided": one_sided,
    "bent": bent,
    "cubic": cubic,
    "of_angle": of_angle,
    "inside": [nothing, from_half, coulomb],
}


SECONDS = 10.0


def write(folder: Path, laws: Iterable[str], seconds: float) -> Path:
    """Write three runs with each law as tables, and the simulation. Returns the folder."""
    arm, model = axis()
    save_arm(arm, folder / "arm.toml")
    save_model(model, folder / "cad.toml")
    base = model.base_parameters(arm)
    base["mz1"] = Quantity(1.1 * base["mz1"].value, 0.0, "CAD", base["mz1"].unit)
    save_model(Model("heavier", parameters=base), folder / "heavier.toml")
    friction = Effect(CATALOGUE["motor_coulomb"], arm.joints[0].name, 0.1 * size())
    save_model(replace(model, effects=(friction,)), folder / "rubbing.toml")
    for name in laws:
        for k, recorded in enumerate(measured(LAWS[name], seconds=seconds)):
            save_run(recorded, folder / f"{name}{k}.npz")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs with all laws, and one that is too short."""
    folder = write(tmp_path_factory.mktemp("axis"), LAWS, SECONDS)
    save_run(measured(coulomb, seconds=4.0)[0], folder / "short.npz")
    return folder


def explain(folder: Path, out: Path, runs: list[str], validate: list[str], *more: object, cad: str = "cad") -> Any:
    """Exit code and JSON."""
    apart = ["--validate", *(folder / f"{name}.npz" for name in validate)] if validate else []
    code = run(
        *("explain", "--simulation", folder / f"{cad}.toml", *(folder / f"{name}.npz" for name in runs)),
        *(*apart, "-o", out / "new.toml", "--json", out / "verdict.json", *more),
    )
    return code, json.loads((out / "verdict.json").read_text())


class Answer(NamedTuple):
    """What came of three runs with a law: the exit code, the JSON, what went wrong, and the folder of the files."""

    code: int
    found: Any
    error: str
    out: Path


@pytest.fixture(scope="module")
def answer(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Answer]:
    """The answer to a law, explained once."""

    @cache
    def explained(name: str) -> Answer:
        out, cad = tmp_path_factory.mktemp(name), "rubbing" if name == "one_sided" else "cad"
        with contextlib.redirect_stderr(io.StringIO()) as error:
            more = ("--report", out / "gap.html")
            code, found = explain(folder, out, [f"{name}0", f"{name}1"], [f"{name}2"], *more, cad=cad)
        return Answer(code, found, error.getvalue(), out)

    return explained


ANSWERS = {
    "nothing": ("nothing missing", 0),
    "coulomb": ("named", 0),
    "bent": ("part named", 0),
    "cubic": ("plain estimate", 0),
    "inside": ("changed", 0),
    "one_sided": ("cannot tell", 3),
    "of_angle": ("unknown", 3),
}


@pytest.mark.slow(only=["nothing", "cubic", "bent", "coulomb"])
@pytest.mark.parametrize("name", ANSWERS)
def test_every_answer_has_its_exit_code_and_its_files(answer: Callable[[str], Answer], name: str) -> None:
    code, found, error, out = answer(name)
    assert (found["answer"], code) == ANSWERS[name], found["sentence"]
    assert found["estimator"] == "explain-ground"
    assert found["answer"] in (out / "gap.html").read_text()
    assert (out / "new.toml").exists() == (code == 0)
    assert ("remedy" in error and "not written" in error) == (code == 3)
    assert bool(found["left"]) == (found["answer"] in {"part named", "plain estimate"})
    assert (found["change"] is not None) == (found["answer"] == "changed")


@pytest.mark.slow
def test_values_that_differ(folder: Path, tmp_path: Path) -> None:
    code, found = explain(folder, tmp_path, ["nothing0", "nothing1"], ["nothing2"], cad="heavier")
    assert (found["answer"], code) == ("values differ", 0), found["sentence"]
    assert [one["name"] for one in found["values"] if one["differs"]] == ["mz1"]
    arm, model = axis()
    learned = load_model(tmp_path / "new.toml").parameters["mz1"]
    assert learned.value == pytest.approx(model.base_parameters(arm)["mz1"].value, rel=0.01)


def test_what_is_left_over_goes_with_the_rate(answer: Callable[[str], Answer]) -> None:
    found = answer("bent").found
    (rest,) = found["left"]
    assert (rest["unit"], rest["over"]) == ("Nm", "rate")
    assert rest["size"] > 3.0 * rest["floor"]
    assert 0.5 < rest["share"] <= 1.0
    assert found["findings"][0]["effect"] == "motor_viscous"


def test_a_friction_that_begins_within_a_run(answer: Callable[[str], Answer]) -> None:
    _, found, _, out = answer("inside")
    change = found["change"]
    assert (change["what"], change["run"], change["between_runs"]) == ("motor_coulomb1", "inside1.npz", False)
    assert 0.4 * SECONDS < change["before_s"] < 0.5 * SECONDS < change["after_s"] < 0.6 * SECONDS
    (friction,) = change["coefficients"]
    assert friction["old"] == pytest.approx(0.0, abs=0.01 * size())
    assert friction["new"] == pytest.approx(0.1 * size(), rel=0.05)
    # what is predicted, and what is written, is the arm as it is after the change
    (effect,) = load_model(out / "new.toml").effects
    assert effect.kind.key == "motor_coulomb"
    assert effect.value == pytest.approx(0.1 * size(), rel=0.05)


@pytest.mark.slow
def test_a_single_run_is_cut_into_thirds(folder: Path, tmp_path: Path) -> None:
    code, found = explain(folder, tmp_path, ["coulomb0"], [])
    assert (found["answer"], code) == ("named", 0), found["sentence"]
    assert len(found["runs"]) == 3
    assert len(found["candidates"][0]["each"]) == 2
    assert found["gap"]["closed"] < 0.5 * found["gap"]["refit"]


@pytest.mark.slow
def test_a_single_run_is_halved_beside_runs_that_are_kept_apart(folder: Path, tmp_path: Path) -> None:
    """Those stay whole, and each of them is predicted."""
    _, found = explain(folder, tmp_path, ["coulomb0"], ["coulomb1", "coulomb2"])
    assert found["answer"] == "named"
    assert len(found["candidates"][0]["each"]) == 2
    assert [run["run"] for run in found["gap"]["runs"]] == ["coulomb1.npz", "coulomb2.npz"]
    roles = ["simulation", "arm", "measured", "validate", "validate"]
    assert [file["role"] for file in found["files"]] == roles


def test_a_single_run_that_is_too_short_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new.toml"
    assert run("explain", "--simulation", folder / "cad.toml", folder / "short.npz", "-o", out) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "cannot be cut into 3 parts" in error and "remedy" in error
    assert not out.exists()


@pytest.mark.slow
def test_runs_in_their_former_place_are_added(folder: Path, answer: Callable[[str], Answer], tmp_path: Path) -> None:
    """The former place of runs adds to those in front."""
    more = ("--measured", folder / "nothing1.npz")
    _, found = explain(folder, tmp_path, ["nothing0"], ["nothing2"], *more)
    first, second = ({**content, "command": ""} for content in (answer("nothing").found, found))
    assert first == second


def test_without_runs_or_simulation_the_call_is_shown(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("explain", "--simulation", folder / "cad.toml", "-o", tmp_path / "new.toml") == 2
    assert "no run to explain; remedy: `zygos explain RUN... --simulation MODEL.toml`" in capsys.readouterr().err
    assert run("explain", folder / "coulomb0.npz", "-o", tmp_path / "new.toml") == 2
    assert "add --simulation" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_motor_currents_are_explained(folder: Path, tmp_path: Path) -> None:
    """On the ground one constant for each joint is fitted to the simulation's own torques."""
    arm, _ = axis()
    amps = replace(arm, torque_unit="A", joints=(replace(arm.joints[0], torque_sigma=0.0),))
    save_arm(amps, tmp_path / "arm.toml")
    code, found = explain(folder, tmp_path, ["coulomb0"], [], "--arm", tmp_path / "arm.toml")
    assert (found["answer"], code) == ("named", 0), found["sentence"]
    assert any("motor currents" in note for note in found["remarks"])


def test_an_entry_that_is_left_out_is_not_tried(folder: Path, tmp_path: Path) -> None:
    _, found = explain(folder, tmp_path, ["coulomb0"], [], "--without", "motor_coulomb")
    assert found["answer"] != "named", found["sentence"]
    assert "motor_coulomb1" not in {one["name"] for one in found["candidates"]}


@pytest.mark.parametrize(
    ("option", "value", "message"), [("--without", "glue", "glue"), ("--effects", "none.py", "there is no such file")]
)
def test_entries_and_laws_that_do_not_exist_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, message: str
) -> None:
    runs = (folder / "coulomb0.npz", folder / "coulomb1.npz")
    assert run("explain", "--simulation", folder / "cad.toml", *runs, "-o", tmp_path / "new.toml", option, value) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert message in error and "remedy" in error
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_set_comes_with_a_motion_that_is_ready_to_fly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write(tmp_path, ("one_sided", "coulomb"), 2.0 * SECONDS)
    scenario, page = tmp_path / "next.toml", tmp_path / "gap.html"
    more = ("--next-motion", scenario, "--report", page)
    _, found = explain(folder, tmp_path, ["one_sided0", "one_sided1"], ["one_sided2"], *more)
    assert found["next_motion"]["z"] > 4.5
    assert load_scenario(scenario).duration_s == found["next_motion"]["duration_s"]
    assert "The next motion" in page.read_text()
    assert 'data-chart="planned"' in page.read_text()
    scenario.unlink()
    _, found = explain(folder, tmp_path, ["coulomb0", "coulomb1"], ["coulomb2"], "--next-motion", scenario)
    assert found["next_motion"] is None
    assert not scenario.exists()
    assert "no effects have to be told apart" in capsys.readouterr().out
    code, _ = explain(folder, tmp_path, ["coulomb0", "coulomb1"], ["coulomb2"], "--rate", "1")
    assert code == 2
    assert "--next-motion" in capsys.readouterr().err


@pytest.mark.slow
def test_the_simulation_may_be_a_run_of_another_simulator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write(tmp_path, ("nothing", "coulomb"), 2.0 * SECONDS)
    made, out = folder / "made.npz", tmp_path / "new.toml"
    save_run(simulated(measured(coulomb, seconds=2.0 * SECONDS)[0]), made)
    given = (folder / "coulomb0.npz", folder / "coulomb1.npz", "--validate", folder / "coulomb2.npz")
    page, json_file = tmp_path / "gap.html", tmp_path / "verdict.json"
    assert run("explain", "--simulation", made, *given, "-o", out, "--json", json_file, "--report", page) == 0
    found = json.loads(json_file.read_text())
    assert (found["answer"], found["findings"][0]["effect"]) == ("named", "motor_coulomb")
    assert found["simulation"] == {"run": str(made), "torques_of": str(folder / "coulomb0.npz")}
    assert "the values of the simulation are estimated from made.npz" in page.read_text()
    capsys.readouterr()
    assert run("explain", "--simulation", made, *given, "-o", out, "--next-motion", tmp_path / "next.toml") == 2
    assert "zygos estimate" in capsys.readouterr().err
    other = (folder / "nothing0.npz", folder / "nothing1.npz")
    assert run("explain", "--simulation", made, *other, "-o", out) == 2
    assert "none of the measured runs" in capsys.readouterr().err

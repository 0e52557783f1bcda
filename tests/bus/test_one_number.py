# SPDX-License-Identifier: MIT
"""One number for one thing: the console, the JSON, the page and Python say the same of a run."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import pytest
from cli_support import run
from ground_support import recorded, short_arm
from runs_support import trajectory_of

from conftest import ROOT
from zygos.arm import load_arm, save_arm
from zygos.can.run import Run, load_run, save_run
from zygos.estimation.estimate import estimate
from zygos.gap.predict import predict
from zygos.ground.estimate import estimate_ground
from zygos.model.model import load_model, save_model
from zygos.refinement.refine import refine_runs
from zygos.simulation.scenario import load_scenario


def flown(name: str, folder: Path) -> Path:
    """A short run of an example, as a table."""
    example = ROOT / "examples" / name
    of, motion = ("cad.toml", "a.toml") if name == "gap" else ("model.toml", "scenario.toml")
    arm, model = load_arm(example / "arm.toml"), load_model(example / of)
    seen = trajectory_of(arm, model, load_scenario(example / motion), noise=True, duration_s=30.0)
    save_arm(arm, folder / "arm.toml")
    save_run(Run.of_cycles(arm, seen.cycles()), folder / "run.npz")
    return folder / "run.npz"


def driven(folder: Path) -> Path:
    """A run of an arm on the ground."""
    arm, model = short_arm(2)
    save_arm(arm, folder / "arm.toml")
    save_model(model, folder / "model.toml")
    save_run(recorded(arm, model, path=0, seed=0, seconds=10.0), folder / "run.npz")
    return folder / "run.npz"


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file has no width of its own, so that every table is side by side."""
    monkeypatch.delenv("COLUMNS", raising=False)


def rows_of(page: str, key: str) -> list[list[str]]:
    """Cells of the table in a section of a page, without those that are drawn."""
    part = page[page.index(f'id="{key}"') :]
    body = part[part.index("<tbody>") : part.index("</tbody>")]
    rows = []
    for row in re.findall(r"<tr[^>]*>(.*?)</tr>", body, re.DOTALL):
        cells = re.findall(r'<td(?! class="log")[^>]*>(.*?)</td>', row, re.DOTALL)
        rows.append([html.unescape(re.sub(r"<[^>]*>", "", cell)) for cell in cells])
    return [row for row in rows if any(row)]


def answered(command: str, file: Path, capsys: pytest.CaptureFixture[str], *more: object) -> tuple[str, Any, str]:
    """Console, JSON and page of a command."""
    page, numbers = file.parent / "page.html", file.parent / "answer.json"
    capsys.readouterr()
    assert run(command, file, *more, "--details", "--json", numbers, "--report", page) == 0
    return capsys.readouterr().out, json.loads(numbers.read_text()), page.read_text()


def as_number(text: str) -> float:
    plain = text.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻−", "0123456789--"))
    return float(plain.replace(",", "").replace("·10", "e"))


def check_row(one: Any, row: list[str], at: int, said: str, word: str = "") -> None:
    """Page and console have the value and the interval of an entry of the JSON. at: the column of the value."""
    assert as_number(row[at]) == pytest.approx(one["value"], abs=0.06 * one["half95"])
    assert as_number(row[at + 1]) == pytest.approx(one["half95"], rel=0.06)
    line = next(line for line in said.splitlines() if line.startswith(f"{one['name']} ") and word in line)
    assert [cell for cell in row if cell] == re.split(r"  +", line.strip())


@pytest.mark.slow(but=["paper"])
@pytest.mark.parametrize("name", ["paper", "lively", "gap", "ground"])
def test_an_estimate_has_one_value_and_one_interval(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = driven(tmp_path) if name == "ground" else flown(name, tmp_path)
    stop = () if name == "ground" else ("--energy",)
    said, content, page = answered("estimate", file, capsys, *stop, "-o", tmp_path / "m.toml")
    measured = load_run(file, tmp_path / "arm.toml")
    found = estimate_ground([measured]) if name == "ground" else estimate(measured)
    written = load_model(tmp_path / "m.toml")
    values = {key: one.value for key, one in written.parameters.items()}
    values |= {effect.column(measured.arm): effect.value for effect in written.effects}
    for k, (one, row) in enumerate(zip(content["parameters"], rows_of(page, "parameters"), strict=True)):
        assert (one["name"], one["value"], one["half95"]) == (found.names[k], found.value[k], found.half95[k])
        assert values[one["name"]] == pytest.approx(one["value"], rel=1e-12)
        check_row(one, row, 2, said)


@pytest.mark.slow
def test_a_refined_estimate_has_one_value_and_one_interval(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The published values: those of the refinement, in the model file, the JSON, the page and the console."""
    file = flown("paper", tmp_path)
    said, content, page = answered("estimate", file, capsys, "-o", tmp_path / "m.toml")
    found = refine_runs(load_run(file, tmp_path / "arm.toml"))
    assert found.published and content["refinement"]["published"]
    values = {one.name: (one.value, one.sigma) for one in found.values()}
    written = load_model(tmp_path / "m.toml").parameters
    for one, row in zip(content["values"], rows_of(page, "published"), strict=True):
        value, sigma = values[one["name"]]
        assert (one["source"], one["value"]) == ("refined", pytest.approx(value, abs=1e-3 * sigma))
        assert one["half95"] == pytest.approx(1.96 * sigma, rel=1e-3)
        assert written[one["name"]].value == pytest.approx(one["value"], rel=1e-12)
        check_row(one, row, 1, said, "refined")


@pytest.mark.slow(only=["ground"])
@pytest.mark.parametrize("name", ["paper", "ground"])
def test_a_prediction_has_one_error(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = driven(tmp_path) if name == "ground" else flown(name, tmp_path)
    model = tmp_path / "model.toml" if name == "ground" else ROOT / "examples" / name / "model.toml"
    said, content, page = answered("predict", file, capsys, "--model", model)
    found = predict(load_model(model), load_run(file, tmp_path / "arm.toml"))
    (answer,) = content["runs"]
    for one, joint, row in zip(answer["joints"], found.torques.joints, rows_of(page, "run-1"), strict=True):
        assert (one["error_nm"], one["floor_nm"]) == (joint.error_nm, joint.floor_nm)
        assert as_number(row[2]) == pytest.approx(one["error_nm"], rel=0.01)
        assert as_number(row[5]) == pytest.approx(one["error_nm"] / one["floor_nm"], rel=0.01)
        assert any(re.split(r"  +", line.strip()) == row for line in said.splitlines())
    if answer["ahead"] is not None:
        assert answer["ahead"]["median"] == found.gap
        assert f"{found.gap:.3g} σ" in said and f"{found.gap:.3g} σ" in page

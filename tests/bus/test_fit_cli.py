# SPDX-License-Identifier: MIT
"""`zygos fit` as a user types it: from an estimate to bodies that simulate and export take, and refusals."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_support import run
from physical_support import estimate_of

from conftest import EXAMPLE, ROOT
from zygos.arm import load_arm
from zygos.model.model import Model, Quantity, load_model, save_model
from zygos.simulation.scenario import load_scenario, save_scenario

SPATIAL = ROOT / "examples" / "spatial"
URDF = """<robot name="paper">
  <link name="base"/>
  <link name="link1"/>
  <link name="link2"/>
  <joint name="shoulder" type="continuous">
    <parent link="base"/><child link="link1"/><origin xyz="5 0 0"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="link1"/><child link="link2"/><origin xyz="10 0 0"/><axis xyz="0 0 1"/>
  </joint>
</robot>
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A drawing of the paper's arm with a tenth more of each mass, and an estimate of the arm itself."""
    arm, built = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    heavier = tuple(replace(body, mass=Quantity(1.1 * body.mass.value)) for body in built.bodies)
    save_model(replace(built, bodies=heavier), tmp_path / "cad.toml")
    report = estimate_of(arm, built.base_values(arm), noise_j=10.0)
    (tmp_path / "estimate.json").write_text(json.dumps(report))
    (tmp_path / "in.urdf").write_text(URDF)
    return tmp_path


def fit(folder: Path, *more: object, arm: Path = EXAMPLE / "arm.toml") -> int:
    files = ("--arm", arm, "--model", folder / "cad.toml", "-o", folder / "fit.toml")
    return run("fit", folder / "estimate.json", *files, *more)


@pytest.mark.slow
def test_from_a_run_to_bodies(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What estimate writes is what fit reads; simulate and export take the result."""
    out = folder / "run.blf"
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", out) == 0
    assert run("estimate", out, "-o", folder / "estimate.toml", "--json", folder / "estimate.json") == 0
    assert fit(folder, "--lengths", "0", "--json", folder / "fit.json") == 0
    assert "chi^2" in capsys.readouterr().out
    arm, fitted = load_arm(EXAMPLE / "arm.toml"), load_model(folder / "fit.toml")
    estimated = load_model(folder / "estimate.toml").base_values(arm)
    # an arm in a plane can have any base parameters that are positive definite, and these are refined
    np.testing.assert_allclose(fitted.base_values(arm), estimated, rtol=1e-6)
    stiffness = fitted.joints[0].stiffness
    assert stiffness.sigma < 2e-6 * stiffness.value
    assert {fitted.bodies[1].mass.source, fitted.joints[0].stiffness.source} == {"zygos"}
    content = json.loads((folder / "fit.json").read_text())
    assert content["explained"] is True and content["limit"] is None
    assert [entry["name"] for entry in content["parameters"]] == list(arm.parameter_names)
    brief = replace(load_scenario(EXAMPLE / "scenario.toml"), duration_s=1.0)
    save_scenario(brief, folder / "brief.toml")
    assert run("simulate", folder / "brief.toml", "--model", folder / "fit.toml", "-o", folder / "again.blf") == 0
    export = ("export", "--arm", EXAMPLE / "arm.toml", "--urdf", folder / "in.urdf", "-o", folder / "out.urdf")
    assert run(*export, "--model", folder / "fit.toml") == 0
    assert f'value="{fitted.bodies[2].mass.value!r}"' in (folder / "out.urdf").read_text()


def test_export_names_the_remedy_for_lengths(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    moved = load_model(folder / "cad.toml")
    first, *rest = moved.bodies
    save_model(replace(moved, bodies=(replace(first, joint_xyz=(5.0001, 0.0, 0.0)), *rest)), folder / "moved.toml")
    export = ("export", "--arm", EXAMPLE / "arm.toml", "--urdf", folder / "in.urdf", "-o", folder / "out.urdf")
    assert run(*export, "--model", folder / "moved.toml") == 2
    assert "zygos fit --lengths 0" in capsys.readouterr().err


@pytest.mark.slow
def test_an_estimate_that_no_arm_explains_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm, built = load_arm(SPATIAL / "arm.toml"), load_model(SPATIAL / "model.toml")
    wrong = replace(arm, joints=(*arm.joints[:2], replace(arm.joints[2], frame_rpy=(0.4, 0.0, 0.0))))
    (folder / "estimate.json").write_text(json.dumps(estimate_of(arm, built.base_values(wrong), noise_j=0.03)))
    save_model(built, folder / "cad.toml")
    assert fit(folder, "--json", folder / "fit.json", arm=SPATIAL / "arm.toml") == 3
    said = capsys.readouterr().err
    assert "no arm like spatial explains the estimate" in said and "remedy: " in said
    assert not (folder / "fit.toml").exists()
    content = json.loads((folder / "fit.json").read_text())
    assert content["model"] is None and content["chi2"] > content["limit"] * content["dof"]


def test_bad_input_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(code: int, words: str, *more: object) -> None:
        assert fit(folder, *more) == code
        said = capsys.readouterr().err
        assert words in said and "remedy: " in said
        assert not (folder / "fit.toml").exists()

    good = (folder / "estimate.json").read_text()
    report = json.loads(good)
    for content, code, words in (
        ("{", 2, "is not JSON"),
        ("[]", 2, "has no arm, parameters"),
        (json.dumps({key: value for key, value in report.items() if key != "normal"}), 2, "has no normal"),
        (json.dumps(report | {"normal": [[1.0]]}), 2, "do not have 12 parameters"),
        (json.dumps(report | {"normal": [[1.0], [1.0, 2.0]]}), 2, "do not have 12 parameters"),
        (json.dumps(report | {"normal": [[None] * 12] * 12}), 2, "do not have 12 parameters"),
        (json.dumps(report | {"validity": "refused", "reason": "too few accepted instants"}), 3, "was refused"),
        (
            json.dumps(report | {"refinement": {"published": True}}),
            2,
            "refined values have no covariance of their number",
        ),
    ):
        (folder / "estimate.json").write_text(content)
        refused(code, words)
    (folder / "estimate.json").write_text(good)
    refused(2, "would replace", "--json", folder / "cad.toml")
    arm, built = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    save_model(Model("base", parameters=built.base_parameters(arm)), folder / "cad.toml")
    refused(2, "contains base parameters")
    save_model(load_model(SPATIAL / "model.toml"), folder / "cad.toml")
    refused(2, "has joints")
    (folder / "estimate.json").unlink()
    refused(2, "cannot be read")


def test_without_the_library_the_remedy_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    assert fit(folder) == 2
    said = capsys.readouterr().err
    assert "pip install 'zygos[fit]'" in said
    assert "Traceback" not in said

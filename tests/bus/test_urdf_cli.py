# SPDX-License-Identifier: MIT
"""`zygos import` and `zygos export` as a user types them, with an answer and with refusals."""

from __future__ import annotations

import json
import os
import pty
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_support import run

from conftest import ROOT
from zygos.arm import load_arm
from zygos.model.model import Model, Quantity, load_model, save_model

URDF, ANSWERS = ROOT / "examples" / "urdf" / "arm.urdf", ROOT / "examples" / "urdf" / "answers.toml"
GAP = ROOT / "examples" / "gap"
PLANAR = """<robot name="gap">
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


def import_into(folder: Path, *more: object) -> int:
    return run("import", URDF, "-o", folder, *more)


@pytest.mark.slow
def test_import_and_export_and_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, numbers = tmp_path / "arm", tmp_path / "arm.json"
    assert import_into(out, "--answers", ANSWERS, "--json", numbers) == 0
    said = capsys.readouterr()
    assert "satellite" in said.out and "<limit> is not used" in said.err
    content = json.loads(numbers.read_text())
    assert content["bodies"][-1]["merged"] == ["gripper", "camera", "grasp_point"]
    assert content["joints"][0] == "shoulder_roll_joint"
    model = load_model(out / "model.toml")
    assert model.joints[6].stiffness == Quantity(7000.0, 0.0, "CAD", "Nm/rad")
    assert {body.mass.source for body in model.bodies} == {"CAD"}
    new = tmp_path / "new.urdf"
    files = ("--arm", out / "arm.toml", "--model", out / "model.toml")
    assert run("export", *files, "--urdf", URDF, "-o", new) == 0
    assert run("import", new, "-o", tmp_path / "again", "--answers", ANSWERS) == 0
    assert (tmp_path / "again" / "model.toml").read_text() == (out / "model.toml").read_text()
    # a file that is there is never replaced
    assert import_into(out, "--answers", ANSWERS) == 2
    assert "exists already; remedy" in capsys.readouterr().err


def test_what_is_missing_is_listed_with_a_template(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Under pytest stdin is no terminal."""
    assert import_into(tmp_path / "arm") == 2
    refusal = capsys.readouterr().err
    said = " ".join(refusal.split())
    assert "62 values are missing" in said and "gear_ratio: gear ratio" in said and "(every joint)" in said
    assert not (tmp_path / "arm").exists()
    template = tmp_path / "answers.toml"
    assert run("import", URDF, "--template", template) == 0
    assert template.read_text() in refusal
    assert import_into(tmp_path / "arm", "--answers", template) == 2  # nothing is answered until someone answers it
    assert run("import", URDF, "--template", template) == 2  # it may hold answers by now
    filled = re.sub(r"^# (?=[\w.]+ = )", "", template.read_text(), flags=re.MULTILINE)
    template.write_text(filled)
    assert import_into(tmp_path / "arm", "--answers", template) == 0
    arm = load_arm(tmp_path / "arm" / "arm.toml")
    assert [joint.node for joint in arm.joints] == [1, 2, 3, 4, 5, 6, 7]
    assert arm.joints[2].motor_encoder.quantum_rad == pytest.approx(2 * np.pi / 4096 / 100)
    # a template of what is known holds it, and lists only the rest
    partial, second = tmp_path / "partial.toml", tmp_path / "second.toml"
    partial.write_text(filled.replace('motor_encoder.side = "rotor"', ""))
    assert run("import", URDF, "--answers", partial, "--template", second) == 0
    assert "7 values to fill in" in capsys.readouterr().out
    second.write_text(re.sub(r"^# (?=[\w.]+ = )", "", second.read_text(), flags=re.MULTILINE))
    assert import_into(tmp_path / "other", "--answers", second) == 0
    assert load_arm(tmp_path / "other" / "arm.toml") == arm


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("gear_ratio = 160", "gear_ratio = 0", "joint.shoulder_roll_joint.gear_ratio: 0 is out of range"),
        ("rotor_inertia = 8e-5", "rotor_inertia = -8e-5", "joint.shoulder_roll_joint.rotor_inertia"),
        ("stiffness = 24000", "stiffness = 0", "stiffness: 0 is out of range"),
        ("damping = 18", "damping = -1", "damping: -1 is out of range"),
        ("rate_sigma = 1e-5 ", "rate_sigma = -1e-5 ", "imu.rate_sigma"),
        ("period_s = 0.005", "period_s = 5", "period_s"),
        ("node = 2", "node = 1", "node numbers repeat"),
        ("counts = 16384", "counts = 2", "motor_encoder.counts: 2 is out of range"),
        ('side = "rotor"', 'side = "left"', "motor_encoder.side"),
        ('base = "free"', 'base = "fixed"', "a fixed base has no rate to measure"),
        ('base = "free"', 'base = "free"\ngravity = [0, 0, -9.81]', "a free-floating arm feels no gravity"),
        ("[joint.wrist_roll_joint]", "[joint.wrist]", "joint.wrist: the chain has no such joint"),
        ("gear_ratio = 100", "axis = [0, 0, 1]", "axis: unknown key"),
        ("gear_ratio = 100", "flexible = false\nstiffness = 3", "stiffness: a rigid joint has no spring"),
        ("[smoother]", "[smother]", "smother: unknown key"),
    ],
)
def test_an_answer_that_cannot_be_is_refused(
    before: str, after: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = ANSWERS.read_text()
    assert before in text
    (tmp_path / "a.toml").write_text(text.replace(before, after))
    if "flexible" in after:
        (tmp_path / "a.toml").write_text((tmp_path / "a.toml").read_text().replace("stiffness = 7000\n", ""))
    assert import_into(tmp_path / "arm", "--answers", tmp_path / "a.toml") == 2
    said = capsys.readouterr().err
    assert words in said and "; remedy: " in said and str(tmp_path / "a.toml") in said
    assert not (tmp_path / "arm").exists()


def test_a_fixed_base_with_a_rigid_joint(tmp_path: Path) -> None:
    text = ANSWERS.read_text().replace('base = "free"', 'base = "fixed"')
    text = re.sub(r"\[imu\].*?\n\n", "", text, flags=re.DOTALL)
    text = text.replace("stiffness = 7000\ndamping = 5", "flexible = false")
    (tmp_path / "a.toml").write_text(text)
    assert import_into(tmp_path / "arm", "--answers", tmp_path / "a.toml") == 0
    arm = load_arm(tmp_path / "arm" / "arm.toml")
    assert arm.gravity == (0.0, 0.0, -9.81) and not arm.free
    assert [joint.flexible for joint in arm.joints] == [True] * 6 + [False]
    assert load_model(tmp_path / "arm" / "model.toml").joints[6].stiffness.value == np.inf


def test_a_base_without_mass_can_only_be_fixed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As of most robots on the ground: a base link that is there to hang the first joint on."""
    text = URDF.read_text()
    arm_begins = text.index('<link name="shoulder_roll"')
    bare = tmp_path / "bare.urdf"
    bare.write_text(re.sub(r"<inertial>.*?</inertial>", "", text[:arm_begins], flags=re.DOTALL) + text[arm_begins:])
    assert run("import", bare, "--answers", ANSWERS, "-o", tmp_path / "free") == 2
    assert "the base satellite has no mass, but it floats in arm servicer" in capsys.readouterr().err
    assert not (tmp_path / "free" / "arm.toml").exists()
    grounded = tmp_path / "answers.toml"
    answers = ANSWERS.read_text().replace('base = "free"', 'base = "fixed"')
    grounded.write_text(re.sub(r"\[imu\].*?\n\n", "", answers, flags=re.DOTALL))
    assert run("import", bare, "--answers", grounded, "-o", tmp_path / "fixed") == 0
    arm, model = load_arm(tmp_path / "fixed" / "arm.toml"), load_model(tmp_path / "fixed" / "model.toml")
    assert model.bodies[0].mass.value == 0.0
    assert np.isfinite(model.base_values(arm)).all()


def test_the_arm_file_alone_needs_no_masses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Inertias of zero, as in a URDF that is only to be drawn; neither rotors nor springs are asked for."""
    bare, alone = tmp_path / "bare.urdf", tmp_path / "new" / "mine.toml"
    bare.write_text(re.sub(r'(i[xyz]{2}|mass value)="[^"]*"', r'\1="0"', URDF.read_text()))
    assert run("import", bare, "--answers", ANSWERS, "-o", tmp_path / "both") == 2
    assert "has no mass, and nothing with mass is fixed to it; remedy: " in (said := capsys.readouterr().err)
    assert "or write the arm file alone, which needs no masses, with -o ARM.toml" in said
    without = re.sub(r"^(rotor_inertia|stiffness|damping) = .*\n", "", ANSWERS.read_text(), flags=re.MULTILINE)
    (tmp_path / "a.toml").write_text(without)
    numbers = tmp_path / "n.json"
    assert run("import", bare, "--answers", tmp_path / "a.toml", "-o", alone, "--json", numbers) == 0
    assert f"{alone}: the arm file, 7 joints" in capsys.readouterr().out
    assert [path.name for path in alone.parent.iterdir()] == ["mine.toml"]
    assert json.loads(numbers.read_text())["model"] is None
    assert import_into(tmp_path / "arm", "--answers", ANSWERS) == 0
    assert load_arm(alone) == load_arm(tmp_path / "arm" / "arm.toml")
    assert run("import", bare, "--answers", tmp_path / "a.toml", "-o", alone) == 2
    assert run("import", bare, "--template", tmp_path / "t.toml") == 0


def test_without_any_inertial_the_arm_file_comes_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare, out = tmp_path / "bare.urdf", tmp_path / "out"
    bare.write_text(re.sub(r"<inertial>.*?</inertial>", "", URDF.read_text(), flags=re.DOTALL))
    assert run("import", bare, "--answers", ANSWERS, "-o", out) == 0
    assert "no link has an <inertial>, so that only the arm file is written" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["arm.toml"] and load_arm(out / "arm.toml").n == 7


def test_a_terminal_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One joint; the first gear ratio is refused and asked again, enter takes what is offered."""
    link = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    (tmp_path / "a.urdf").write_text(
        f'<robot name="r"><link name="a">{link}</link><link name="b">{link}</link><link name="c">{link}</link>'
        '<joint name="one" type="continuous"><parent link="a"/><child link="b"/></joint>'
        '<joint name="two" type="continuous"><parent link="b"/><child link="c"/></joint></robot>'
    )
    typed = ["free", "0.01", "sampled", "16", "1e-5", "1e-8"]
    typed += ["1", "-5", "120", "2e-4", "4096", "rotor", "9000", "8", "65536"]
    typed += ["2", "", "3e-4", "", "", "", "", ""]
    here, there = pty.openpty()
    os.write(here, ("\n".join(typed) + "\n").encode())
    with os.fdopen(there, closefd=True) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        assert run("import", tmp_path / "a.urdf", "-o", tmp_path / "arm") == 0
    os.close(here)
    said = "".join(capsys.readouterr())
    assert "joint one: gear ratio" in said and "out of range" in said and "usually 30 to 2000" in said
    assert "joint two: gear ratio, motor turns per joint turn (usually 30 to 2000) [120]" in said
    arm, model = load_arm(tmp_path / "arm" / "arm.toml"), load_model(tmp_path / "arm" / "model.toml")
    assert [joint.gear_ratio for joint in arm.joints] == [120.0, 120.0]
    assert [joint.rotor_inertia.value for joint in model.joints] == [2e-4, 3e-4]
    assert arm.torque_law == "sampled" and arm.imu.node == 16


@pytest.fixture
def planar(tmp_path: Path) -> Path:
    (tmp_path / "in.urdf").write_text(PLANAR)
    arm, cad = load_arm(GAP / "arm.toml"), load_model(GAP / "cad.toml")
    heavier = replace(cad, bodies=tuple(replace(b, mass=Quantity(1.02 * b.mass.value)) for b in cad.bodies), effects=())
    save_model(Model("learned", parameters=heavier.base_parameters(arm)), tmp_path / "learned.toml")
    return tmp_path


def export(folder: Path, *more: object) -> int:
    return run("export", "--arm", GAP / "arm.toml", "--urdf", folder / "in.urdf", "-o", folder / "out.urdf", *more)


def test_base_parameters_go_back_into_a_urdf(planar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Checked by Pinocchio: the URDF that came out moves as the parameters say."""
    import pinocchio as pin

    learned, numbers = planar / "learned.toml", planar / "n.json"
    assert export(planar, "--model", learned, "--cad", GAP / "cad.toml", "--json", numbers) == 0
    said = capsys.readouterr().out
    assert "link2 izz" in said and "determined" in said
    entries = json.loads(numbers.read_text())["links"][2]["entries"]
    assert [entry["name"] for entry in entries if entry["determined"]] == ["y"]
    text = (planar / "out.urdf").read_text()
    assert "link2: y" in text
    # a_ij are the inertias of the arm about its own centre, in absolute angles (docs/theory.md)
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    for i, rotor in ((1, 1.0), (2, 1.0)):  # the rotors of the model are in no URDF
        carrier = 1 if i == 1 else 2
        place = model.jointPlacements[i + 1].translation
        inertia = pin.Inertia(rotor, place, np.diag([0.5, 0.5, 1.0]))
        model.appendBodyToJoint(carrier, inertia, pin.SE3.Identity())
    full = np.triu(pin.crba(model, model.createData(), np.array([0, 0, 0, 0, 0, 0, 1, 1, 0, 1, 0], dtype=float)))
    full = full + np.triu(full, 1).T
    turning = [5, 6, 7]
    lateral = [0, 1]
    own = full[np.ix_(turning, turning)] - full[np.ix_(turning, lateral)] @ np.linalg.solve(
        full[np.ix_(lateral, lateral)], full[np.ix_(lateral, turning)]
    )
    absolute = np.array([[1, 0, 0], [-1, 1, 0], [0, -1, 1]])  # relative rates from absolute ones
    a = absolute.T @ own @ absolute
    given = load_model(learned).parameters
    for i in range(3):
        for j in range(i, 3):
            assert a[i, j] == pytest.approx(given[f"a{i}{j}"].value, rel=1e-8), (i, j)


@pytest.mark.slow
def test_export_refuses(planar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    learned, cad = planar / "learned.toml", GAP / "cad.toml"

    def refused(code: int, words: str, *more: object) -> None:
        assert export(planar, *more) == code
        said = capsys.readouterr().err
        assert words in said and "remedy: " in said
        assert not (planar / "out.urdf").exists()

    refused(2, "--cad", "--model", learned)
    refused(2, "leave out --cad", "--model", cad, "--cad", cad)
    refused(2, "contains base parameters", "--model", learned, "--cad", learned)
    refused(2, "would replace", "--model", cad, "--json", planar / "in.urdf")
    refused(2, "has no link bus", "--model", cad, "--base", "bus")
    model = load_model(learned)
    wrong = dict(model.parameters) | {"a22": replace(model.parameters["a22"], value=-10.0)}
    save_model(Model("wrong", parameters=wrong), planar / "wrong.toml")
    refused(3, "model wrong", "--model", planar / "wrong.toml", "--cad", cad)
    for before, after, words in (
        ('xyz="10 0 0"', 'xyz="11 0 0"', "place (m) of joint elbow"),
        ('axis xyz="0 0 1"', 'axis xyz="0 1 0"', "axis of joint shoulder"),
        ('xyz="10 0 0"', 'xyz="10 0 0" rpy="0 0 1"', "attitude of joint elbow"),
        ('name="elbow"', 'name="knee"', "has no joint elbow"),
        ('name="shoulder"', 'name="hip"', "the joints from link base are hip, elbow"),
    ):
        (planar / "in.urdf").write_text(PLANAR.replace(before, after))
        refused(2, words, "--model", cad)


def test_without_the_library_the_remedy_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "urdf_parser_py.urdf", None)
    for module in [name for name in sys.modules if name.startswith(("zygos.urdf", "zygos.cli.import"))]:
        monkeypatch.delitem(sys.modules, module)
    assert import_into(tmp_path / "arm") == 2
    said = capsys.readouterr().err
    assert "pip install 'zygos[urdf]'" in said
    assert "Traceback" not in said

"""MJCF and URDF as simulations of `zygos explain`: read, corrected in their own bytes, measured in MuJoCo, refused.

MuJoCo is the oracle: it compiles every file that is written, and is the plant of the runs from plain tables.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from cli_support import run

from conftest import ROOT
from zygos.demo.real import learn_pendulum
from zygos.errors import ZygosError
from zygos.files.tables import write_columns
from zygos.gap.ground.explain import explain_ground
from zygos.simulators.explain import FileExplanation
from zygos.simulators.file import contents, read_robot, write
from zygos.simulators.robot import Lump, Robot

EXAMPLE = ROOT / "examples" / "pendulum" / "pendulum.xml"
URDF = ROOT / "examples" / "openarm" / "openarm.urdf"

INCLUDED = """<mujocoinclude>
  <body name='link' pos='0 0 -.3'><!-- single quotes stay -->
    <inertial pos="0 0 -.2" mass=".5" fullinertia=".004 .004 .001 0 0 0"/>
    <joint name="second" class="drive" damping = '.5'/>
  </body>
</mujocoinclude>
"""
FILE = """<?xml version="1.0"?>
<!-- a > b in a comment -->
<mujoco model="two">
\t<compiler angle="degree" autolimits="true"/>
  <default><default class="drive"><joint axis="1 0 0" armature="0.010"/></default></default>
  <worldbody>
    <body name="first" pos="0 0 1">
      <joint name="a &amp; b" class="drive" range="-90 90"/>
      <inertial pos="0 0 -.1" mass="1" quat="1 0 0 0" diaginertia=".01 .01 .001"/>
      <include file="link.xml"/>
    </body>
  </worldbody>
</mujoco>
"""


def written(folder: Path, text: str = FILE, included: str = INCLUDED) -> Path:
    (folder / "link.xml").write_bytes(included.encode())
    path = folder / "robot.xml"
    path.write_bytes(text.replace("\n", "\r\n").encode())
    return path


def heavier(robot: Robot, i: int) -> Robot:
    """With another inertial of a body, and friction, damping and armature of its joint."""
    own = robot.owners[i].own
    lump = Lump(1.25 * own.mass, own.centre + np.array([0.0, 0.01, 0.02]), 1.5 * own.tensor)
    owners, hinges = list(robot.owners), list(robot.hinges)
    owners[i] = replace(owners[i], own=lump)
    hinges[i] = replace(hinges[i], friction=0.3, damping=0.07, armature=0.02)
    return replace(robot, owners=tuple(owners), hinges=tuple(hinges))


@pytest.mark.parametrize("body", [0, 1])
def test_only_what_is_corrected_changes(tmp_path: Path, body: int) -> None:
    path = written(tmp_path)
    robot = read_robot(path, None)
    out = tmp_path / "new.xml"
    files = contents(robot, heavier(robot, body), out)
    write(files)
    assert set(files) == {out} | ({tmp_path / "new-link.xml"} if body else set())
    edited = files[tmp_path / "new-link.xml"] if body else files[out]
    original = (tmp_path / "link.xml").read_bytes() if body else path.read_bytes()
    lines = list(zip(original.splitlines(keepends=True), edited.splitlines(keepends=True), strict=True))
    changed = [old for old, new in lines if old != new]
    assert len(changed) == 2 and all(b"<inertial" in line or b"<joint" in line for line in changed)
    tree, before = (mujoco.MjModel.from_xml_path(str(one)) for one in (out, path))
    assert tree.body_mass[1 + body] == pytest.approx(1.25 * before.body_mass[1 + body])
    assert sorted(tree.body_inertia[1 + body]) == pytest.approx(sorted(1.5 * before.body_inertia[1 + body]))
    assert tree.body_ipos[1 + body] == pytest.approx(before.body_ipos[1 + body] + [0.0, 0.01, 0.02])
    found = (tree.dof_frictionloss[body], tree.dof_damping[body], tree.dof_armature[body])
    assert found == pytest.approx((0.3, 0.07, 0.02))
    other = 1 - body
    assert tree.body_mass[1 + other] == before.body_mass[1 + other]
    assert tree.dof_damping[other] == before.dof_damping[other]


def test_nothing_changes_where_nothing_was_learned(tmp_path: Path) -> None:
    path = written(tmp_path)
    robot = read_robot(path, None)
    assert contents(robot, robot, tmp_path / "new.xml") == {tmp_path / "new.xml": path.read_bytes()}


def test_a_urdf_keeps_every_other_line(tmp_path: Path) -> None:
    robot = read_robot(URDF, None)
    out = tmp_path / "new.urdf"
    (edited,) = contents(robot, heavier(robot, 2), out).values()
    original = URDF.read_bytes()
    old, new = original.splitlines(), edited.splitlines()
    kept = [line for line in old if line in new]
    assert 0 < len(old) - len(kept) <= 4
    out.write_bytes(edited)
    again = read_robot(out, None)
    assert again.owners[2].own.mass == pytest.approx(1.25 * robot.owners[2].own.mass)
    assert again.owners[2].own.tensor == pytest.approx(1.5 * robot.owners[2].own.tensor, rel=1e-8)
    assert (again.hinges[2].friction, again.hinges[2].damping) == pytest.approx((0.3, 0.07))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<worldbody>", '<worldbody><replicate count="2"><body/></replicate>', "<replicate> makes bodies"),
        ('autolimits="true"', 'settotalmass="3"', "settotalmass of <compiler> scales all masses"),
        ('autolimits="true"', 'inertiafromgeom="true"', "inertiafromgeom of <compiler> replaces inertials"),
        ('<joint name="a &amp; b" class="drive" range="-90 90"/>', "<freejoint/>", "the base floats"),
        ('class="drive" range', 'class="drive" stiffness="3" range', "has a stiffness to the body"),
        ('class="drive" range', 'class="drive" type="slide" range', "has 1 hinges in a chain"),
        ("<worldbody>", "<option viscosity='1'/><worldbody>", "density or viscosity"),
        ("</mujoco>", "", "is not valid XML"),
    ],
)
def test_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = FILE.replace(old, new)
    assert text != FILE
    with pytest.raises(ZygosError, match=said) as refusal:
        read_robot(written(tmp_path, text), None, 2)
    assert "remedy: " in str(refusal.value)


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("new.urdf", "not a name for the corrected MJCF"),
        ("elsewhere/new.xml", "would not find the files that robot.xml includes"),
        ("robot.xml", "robot.xml"),
    ],
)
def test_a_place_where_the_file_would_not_work(
    tmp_path: Path, out: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "elsewhere").mkdir()
    path, table = written(tmp_path), tmp_path / "run.npz"
    before = path.read_bytes()
    write_columns(table, {"t": np.arange(50) / 500.0} | {f"{k}{i}": np.zeros(50) for k in ("q", "tau") for i in (1, 2)})
    assert run("explain", "--simulation", path, "--measured", table, "-o", tmp_path / out) == 2
    err = capsys.readouterr().err.replace("\n", " ")
    assert said in err and "remedy" in err
    assert path.read_bytes() == before and not (tmp_path / "elsewhere" / "new.xml").exists()


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"q1", "q2", "tau1", "tau2"}, "has no column t"),
        ({"t", "q1", "q2", "tau1"}, "has no column tau2"),
        ({"t", "q1", "tau1", "q2", "tau2", "q3", "tau3"}, "has 2 hinges in a chain"),
    ],
)
def test_a_table_that_is_no_run_of_the_robot(
    tmp_path: Path, columns: set[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path, table = written(tmp_path), tmp_path / "run.npz"
    write_columns(table, {name: np.arange(50) / 500.0 for name in columns})
    assert run("explain", "--simulation", path, "--measured", table, "-o", tmp_path / "new.xml") == 2
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "new.xml").exists()


@pytest.mark.slow
def test_the_measured_pendulum_is_corrected(tmp_path: Path) -> None:
    """MuJoCo with the corrected file predicts runs that were kept apart as zygos does, and far better than before."""
    found, learned = learn_pendulum(tmp_path)
    path = tmp_path / "pendulum.xml"
    path.write_bytes(EXAMPLE.read_bytes())
    arm = learned[0].arm
    robot = read_robot(path, arm)
    kept_apart = [one.run for one in found.validated]
    answer = FileExplanation(explain_ground(arm, robot.model(arm), learned, kept_apart), robot)
    delivered, _, corrected = answer.simulator.measured
    for before, after in zip(delivered.runs, corrected.runs, strict=True):
        assert before.ratio == pytest.approx(1.0, abs=0.02), "the file as delivered is the model that zygos reads of it"
        assert after.ratio < 1.1
        assert after.score.arm_energy_share < 0.4 * before.score.arm_energy_share
    (out,) = answer.save(tmp_path / "corrected.xml")
    assert out.read_bytes().decode() == answer.to_mjcf()
    old, new = EXAMPLE.read_bytes().splitlines(), out.read_bytes().splitlines()
    changed = [(a, b) for a, b in zip(old, new, strict=True) if a != b]
    assert len(changed) == 4 and all(b"<inertial" in a or b"<joint" in a for a, _ in changed)


def flown(path: Path, seed: int) -> dict[str, np.ndarray]:
    """A run in MuJoCo of 20 s at 500 Hz with torques of several sines, and encoders of 16 bits."""
    tree = mujoco.MjModel.from_xml_path(str(path))
    data, draw = mujoco.MjData(tree), np.random.default_rng(seed)
    t = np.arange(10_000) / 500.0
    phases, size = draw.uniform(0.0, 2.0 * np.pi, (2, 4)), np.array([[0.7], [0.2]])
    tau = np.array(
        [
            size[i] * sum(np.sin(2 * np.pi * f * t + p) for f, p in zip((0.23, 0.61, 1.1, 1.7), phases[i], strict=True))
            for i in range(2)
        ]
    )
    q = np.empty_like(tau)
    for k in range(len(t)):
        q[:, k] = data.qpos
        data.qfrc_applied[:] = tau[:, k]
        mujoco.mj_step(tree, data)
    step = 2.0 * np.pi / 65536
    q = step * np.round(q / step)
    return {"t": t, "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}


@pytest.mark.slow
def test_friction_of_another_engine_is_found_from_plain_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The plant is MuJoCo with friction and damping that the file as delivered lacks."""
    plant, cad = tmp_path / "plant.xml", tmp_path / "cad.xml"
    text = EXAMPLE.read_text()
    cad.write_text(text)
    plant.write_text(text.replace('frictionloss="0" damping="0"', 'frictionloss="0.1" damping="0.03"'))
    for seed in range(3):
        write_columns(tmp_path / f"{seed}.npz", flown(plant, seed))
    code = run(
        "explain", "--simulation", cad, "--measured", tmp_path / "0.npz", tmp_path / "1.npz",
        "--validate", tmp_path / "2.npz", "-o", tmp_path / "new.xml",
    )  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.out + said.err
    assert "in MuJoCo" in said.out
    tree = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert tree.dof_frictionloss == pytest.approx([0.1, 0.1], abs=0.01)
    assert tree.dof_damping == pytest.approx([0.03, 0.03], abs=0.006)

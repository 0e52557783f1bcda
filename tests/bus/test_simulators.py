# SPDX-License-Identifier: MIT
"""MJCF and URDF as simulations of `zygos explain`: read, corrected in their own bytes, measured in MuJoCo, refused.

MuJoCo is the oracle: it compiles every file that is written, and is the plant of the runs from plain tables.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from cli_support import in_process, run
from telemetry_support import drawn_signals

from conftest import ROOT
from zygos.demo import real
from zygos.demo.real import explained, learn_pendulum
from zygos.errors import ZygosError
from zygos.files.tables import write_columns
from zygos.simulators.explain import FileExplanation
from zygos.simulators.file import contents, for_output, read_robot, write
from zygos.simulators.measure import Simulated
from zygos.simulators.robot import Lump, Robot, at_stops
from zygos.simulators.runs import read_plain
from zygos.simulators.urdf import without_geometry

EXAMPLE = ROOT / "examples" / "pendulum" / "pendulum.xml"
PENDULUM_URDF = EXAMPLE.with_suffix(".urdf")
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


GRIPPER = """
  <link name="foot &quot;left&quot;"><collision><geometry><sphere radius="0.5"/></geometry></collision></link>
  <joint name="stand" type="fixed"><parent link="world"/><child link="foot &quot;left&quot;"/></joint>
  <joint name="mount" type="fixed">
    <origin xyz="0 0.1 0.2" rpy="0.3 -0.2 0.5"/><parent link="foot &quot;left&quot;"/><child link="link0"/>
  </joint>
  <link name="hand">
    <inertial>
      <origin xyz="0.01 0 0.02" rpy="0.4 0.1 -0.7"/><mass value="0.3"/>
      <inertia ixx="0.0011" ixy="0.0002" ixz="-0.0001" iyy="0.0012" iyz="0.0003" izz="0.0009"/>
    </inertial>
    <visual><origin rpy="0 0 1"/><geometry><box size="0.1 0.2 0.3"/></geometry>
      <material name="red"><color rgba="1 0 0 1"/></material></visual>
    <visual><geometry><mesh filename="package://openarm/hand.dae"/></geometry></visual>
    <collision><geometry><mesh filename="hand.obj" scale="2 2 2"/></geometry></collision>
  </link>
  <joint name="wrist" type="fixed">
    <origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/><parent link="link7"/><child link="hand"/>
  </joint>
  <link name="a"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <link name="b"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="finger" type="prismatic">
    <origin xyz="0 0.01 0.05" rpy="0 0.5 0"/><parent link="hand"/><child link="a"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="20" velocity="1"/><dynamics damping="0.3" friction="0.2"/>
  </joint>
  <joint name="other finger" type="prismatic">
    <origin xyz="0 -0.01 0.05"/><parent link="hand"/><child link="b"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" effort="20" velocity="1"/><mimic joint="finger" multiplier="0.5"/>
  </joint>
</robot>
"""
OBJ = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 2 3 4
f 3 1 4
"""


def test_an_mjcf_is_made_of_a_urdf(tmp_path: Path) -> None:
    """MuJoCo's own reading of the URDF is the oracle: torques of both for the same motions."""
    path, out = tmp_path / "arm.urdf", tmp_path / "made" / "new.xml"
    path.write_text(
        URDF.read_text()
        .replace("</robot>", GRIPPER)
        .replace('velocity="16"/>', 'velocity="16"/><dynamics damping="0.4" friction="0.3"/>', 1)
    )
    (tmp_path / "hand.obj").write_text(OBJ)
    out.parent.mkdir()
    names = [f"joint{k}" for k in range(1, 8)]
    robot = for_output(read_robot(path, None, 7), out)
    assert any("package://openarm/hand.dae" in note for note in robot.notes)
    assert any("no largest rate" in note and "joint7" in note for note in robot.notes)
    write(contents(robot, robot, out))
    made = mujoco.MjModel.from_xml_path(str(out))
    plain = without_geometry(path.read_bytes()).decode()
    oracle = mujoco.MjModel.from_xml_string(plain.replace("</robot>", '<link name="world"/></robot>'))
    names += ["finger", "other finger"]
    draw = np.random.default_rng(0)
    motion = draw.normal(size=(20, 3, 9)) * [[0.5], [1.0], [3.0]]
    motion[:, 0, 7:] = 0.02
    torques = []
    for tree in (oracle, made):
        data = mujoco.MjData(tree)
        tree.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        tree.opt.gravity[:] = (0.0, 0.0, -9.81)
        dof = [int(tree.jnt_dofadr[tree.joint(name).id]) for name in names]
        each = []
        for q, qd, qdd in motion:
            data.qpos[dof], data.qvel[dof], data.qacc[dof] = q, qd, qdd
            mujoco.mj_inverse(tree, data)
            each.append(data.qfrc_inverse[dof])
        torques.append(each)
        assert tree.dof_frictionloss[dof] == pytest.approx([0.3, *[0.0] * 6, 0.2, 0.0])
        assert tree.dof_damping[dof] == pytest.approx([0.4, *[0.0] * 6, 0.3, 0.0])
        assert tree.jnt_range[dof[0]] == pytest.approx([-3.2, 3.2])
    assert np.array(torques[1]) == pytest.approx(np.array(torques[0]), rel=1e-7, abs=1e-8)
    assert made.neq == 1 and made.eq_data[0, :2] == pytest.approx([0.0, 0.5])
    assert made.nu == 8 and made.actuator_ctrlrange[0] == pytest.approx([-40.0, 40.0])
    box, mesh = (int(np.flatnonzero(made.geom_type == kind)[0]) for kind in (6, 7))
    assert made.geom_size[box] == pytest.approx([0.05, 0.1, 0.15]) and made.geom_rgba[box] == pytest.approx(
        [1, 0, 0, 1]
    )
    assert (made.geom_contype[box], made.geom_contype[mesh]) == (0, 1)
    assert made.nexclude == 0, "link1, which the first joint carries, has no geometry to collide"


def test_an_mjcf_of_a_urdf_holds_rotors(tmp_path: Path) -> None:
    out = tmp_path / "new.xml"
    robot = for_output(read_robot(URDF, None), out)
    write(contents(robot, heavier(robot, 2), out))
    tree = mujoco.MjModel.from_xml_path(str(out))
    assert (tree.dof_frictionloss[2], tree.dof_damping[2], tree.dof_armature[2]) == pytest.approx((0.3, 0.07, 0.02))
    assert tree.body("link3").mass[0] == pytest.approx(1.25 * 1.073863338)
    assert not tree.dof_armature[[0, 1, 3, 4, 5, 6]].any()


@pytest.mark.parametrize(
    ("count", "said"),
    [(8, "the chain branches: joints finger, other finger; remedy: name the joints"), (7, ""), (6, "")],
)
def test_a_chain_ends_where_the_runs_do(tmp_path: Path, count: int, said: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF.read_text().replace("</robot>", GRIPPER))
    if said:
        with pytest.raises(ZygosError, match=said):
            read_robot(path, None, count)
    else:
        assert [hinge.name for hinge in read_robot(path, None, count).hinges] == [
            f"joint{k}" for k in range(1, count + 1)
        ]
    with pytest.raises(ZygosError, match="has 7 joints in a chain from the base, the runs have 8; remedy"):
        read_robot(URDF, None, 8)


def test_a_urdf_with_a_body_that_cannot_be_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(PENDULUM_URDF.read_text().replace('izz="0.0005"', 'izz="0.05"'))
    robot = read_robot(path, None)
    for name in ("new.urdf", "new.xml"):
        with pytest.raises(ZygosError, match=r"MuJoCo does not read it .*A \+ B >= C.*; remedy: correct"):
            for_output(robot, tmp_path / name)
    assert sorted(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_urdf_of_which_no_mjcf_is_made(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "arm.urdf"
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    loose = f'<link name="l">{mass}</link><joint name="j" type="{kind}">'
    loose += '<parent link="link7"/><child link="l"/></joint></robot>'
    path.write_text(URDF.read_text().replace("</robot>", loose))
    robot = read_robot(path, None, 7)
    with pytest.raises(ZygosError, match=f"joint j is {kind}, for which no MJCF is written; remedy"):
        for_output(robot, tmp_path / "new.xml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<worldbody>", '<worldbody><replicate count="2"><body/></replicate>', "<replicate> makes bodies"),
        ('autolimits="true"', 'settotalmass="3"', "settotalmass of <compiler> scales all masses"),
        ('autolimits="true"', 'inertiafromgeom="true"', "inertiafromgeom of <compiler> replaces inertials"),
        ('<joint name="a &amp; b" class="drive" range="-90 90"/>', "<freejoint/>", "its arm floats or has springs"),
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
    assert run("explain", "--simulation", path, table, "-o", tmp_path / out) == 2
    err = capsys.readouterr().err.replace("\n", " ")
    assert said in err and "remedy" in err
    assert path.read_bytes() == before and not (tmp_path / "elsewhere" / "new.xml").exists()


@pytest.mark.parametrize(
    ("there", "own", "floor", "good"),
    [(0.21, 0.2, 0.001, True), (0.23, 0.2, 0.001, False), (0.009, 0.002, 0.008, True), (0.011, 0.002, 0.008, False)],
)
def test_a_file_is_written_where_mujoco_predicts_as_zygos_does(
    there: float, own: float, floor: float, good: bool
) -> None:
    assert Simulated(there, own, floor, forward=0.0).good is good


def test_a_stop_that_is_reached_is_told(tmp_path: Path) -> None:
    table, angle = tmp_path / "run.npz", 1.6 * np.sin(np.arange(400) / 20.0)
    still = np.zeros(400)
    write_columns(table, {"t": np.arange(400) / 500.0, "q1": angle, "q2": angle, "tau1": still, "tau2": still})
    robot, _, runs = read_plain([table], written(tmp_path))
    (said,) = at_stops(robot, runs)
    assert said.startswith("run.npz: a & b reaches its range of -1.571 .. 1.571 rad in 12 % of the readings")
    hinge = replace(robot.hinges[0], range_rad=(-1.7, 1.7))
    assert at_stops(replace(robot, hinges=(hinge, robot.hinges[1])), runs) == []


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--simulation", "cad.toml"], "is no MJCF or URDF (.xml, .mjcf, .urdf); remedy"),
        (["--simulation", "robot.xml", "--model", "cad.toml"], "--model with --simulation"),
        (["--simulation", "robot.xml", "--since", "cad.toml", "--flight"], "--since, --flight with --simulation"),
        (["--simulation", "robot.xml", "-o", "new.urdf"], "not a name for the corrected MJCF"),
    ],
)
def test_an_estimate_that_no_file_can_have(
    tmp_path: Path, more: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    written(tmp_path)
    write_columns(
        Path("run.npz"), {"t": np.arange(50) / 500.0} | {f"{k}{i}": np.zeros(50) for k in ("q", "tau") for i in (1, 2)}
    )
    assert run("estimate", "run.npz", *(["-o", "new.xml"] if "-o" not in more else []), *more) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert not Path("new.xml").exists() and not Path("new.urdf").exists()


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
    assert run("explain", "--simulation", path, table, "-o", tmp_path / "new.xml") == 2
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "new.xml").exists()


@pytest.mark.slow
def test_the_measured_pendulum_is_corrected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo with the corrected file predicts runs that were kept apart as zygos does, and far better than before."""
    monkeypatch.setattr(real.subprocess, "run", in_process)
    found, learned = learn_pendulum(tmp_path)
    gap, simulator = explained(learned, found, tmp_path)
    arm = learned[0].arm
    delivered, _, corrected = simulator.measured
    for before, after in zip(delivered.runs, corrected.runs, strict=True):
        assert before.ratio == pytest.approx(1.0, abs=0.02), "the file as delivered is the model that zygos reads of it"
        assert after.ratio < 1.1
        assert after.energy < 0.4 * before.energy
    out = tmp_path / "pendulum.xml"
    assert out.read_bytes().decode() == FileExplanation(gap, read_robot(EXAMPLE, arm)).to_mjcf()
    old, new = EXAMPLE.read_bytes().splitlines(), out.read_bytes().splitlines()
    changed = [(a, b) for a, b in zip(old, new, strict=True) if a != b]
    assert len(changed) == 4 and all(b"<inertial" in a or b"<joint" in a for a, _ in changed)
    assert "in recording 03, Nm (MuJoCo)" in (tmp_path / "gap.svg").read_text()
    assert "In MuJoCo" in (tmp_path / "gap.html").read_text()
    of_urdf = FileExplanation(gap, read_robot(PENDULUM_URDF, arm))
    for name in ("corrected.urdf", "from_urdf.xml"):
        own = of_urdf.written_as(tmp_path / name)
        assert own.good and all(one.ratio < 1.1 for one in own.measured[-1].runs), name
        assert all(
            after.energy < (0.4 if name.endswith(".xml") else 0.7) * before.energy
            for before, after in zip(own.measured[0].runs, own.measured[-1].runs, strict=True)
        ), name
    assert of_urdf.written_as(tmp_path / "again.xml").measured is own.measured, "it is measured once"


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
    plant, cad = tmp_path / "plant.xml", tmp_path / "cad.urdf"
    text = EXAMPLE.read_text()
    cad.write_bytes(PENDULUM_URDF.read_bytes())
    plant.write_text(text.replace('frictionloss="0" damping="0"', 'frictionloss="0.1" damping="0.03"'))
    for seed in range(3):
        write_columns(tmp_path / f"{seed}.npz", flown(plant, seed))
    code = run(
        "explain", "--simulation", cad, tmp_path / "0.npz", tmp_path / "1.npz",
        "--validate", tmp_path / "2.npz", "-o", tmp_path / "new.xml", "--mcap", tmp_path / "gap.mcap",
    )  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.out + said.err
    assert "in MuJoCo" in said.out
    code = run(
        "estimate", tmp_path / "0.npz", tmp_path / "1.npz", "--simulation", cad, "--validate", tmp_path / "2.npz",
        "-o", tmp_path / "estimate.xml", "--json", tmp_path / "estimate.json",
    )  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.out + said.err
    runs = (tmp_path / "0.npz", tmp_path / "1.npz", "--validate", tmp_path / "2.npz")
    assert run("estimate", *runs, "--simulation", cad, "-o", "-") == 0
    assert tomllib.loads(capsys.readouterr().out)["parameters"]  # standard output is a model, as that of explain
    own = json.loads((tmp_path / "estimate.json").read_text())["simulator"]
    assert own["good"] and own["integrator"] == "IMPLICITFAST, 1 ms"
    (of_run,) = own["runs"]
    assert of_run["corrected"]["energy"] < 0.1 * of_run["as_delivered"]["energy"]
    for name in ("new.xml", "estimate.xml"):
        tree = mujoco.MjModel.from_xml_path(str(tmp_path / name))
        assert tree.dof_frictionloss == pytest.approx([0.1, 0.1], abs=0.01), name
        assert tree.dof_damping == pytest.approx([0.03, 0.03], abs=0.006), name
    drawn, _ = drawn_signals(tmp_path / "gap.mcap")
    measured, simulated, corrected = (
        np.array([message.effort for _, message in drawn[f"/2_npz/{which}/joint_states"]])
        for which in ("measured", "simulated", "corrected")
    )
    assert np.std(corrected - measured) < 0.3 * np.std(simulated - measured)

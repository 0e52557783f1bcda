# SPDX-License-Identifier: MIT
"""Arms with springs and bases that float in MJCF: accelerations in MuJoCo beside zygos' own equations, and refusals.

Each file is read and corrected by zygos, and compiled and solved by MuJoCo, which shares no code with these equations.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from cli_support import run
from gap_support import example
from spring_support import AXES, FREE_FLYER, IN_SPRINGS, serial

from zygos.arm import Arm, save_arm
from zygos.dynamics.equations import from_parameters
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.gap.ground.predictions import Stage
from zygos.model.model import Model, save_model
from zygos.simulators.correct import corrected
from zygos.simulators.file import contents, read_robot, write
from zygos.simulators.held import snippet
from zygos.simulators.robot import Robot

RATIO = 12.0
EXACT = 1e-8
"""Largest difference of accelerations, as share of the largest one."""


def arm_of(kind: str) -> Arm:
    """The arm of FREE_FLYER, and those of `serial`: `floating` with a rigid joint, `fixed`."""
    arm = example()[0]
    if kind == "planar":
        return arm
    flexible = flexible_of(kind)
    joints = tuple(
        replace(
            arm.joints[0],
            name=f"joint{k}",
            node=k,
            axis=tuple(float(x) for x in axis.split()),
            gear_ratio=RATIO,
            flexible=soft,
        )
        for k, (axis, soft) in enumerate(zip(AXES, flexible, strict=True), start=1)
    )
    base = "free" if kind == "floating" else "fixed"
    gravity = (0.0, 0.0, 0.0) if kind == "floating" else (1.0, -2.0, -9.0)
    return replace(arm, name=kind, base=base, kinetic="spatial", joints=joints, gravity=gravity)  # type: ignore[arg-type]


def flexible_of(kind: str) -> tuple[bool, ...]:
    return (True, False, True) if kind == "floating" else (True, True, True)


def file_of(folder: Path, kind: str) -> Path:
    path = folder / "arm.xml"
    path.write_text(FREE_FLYER if kind == "planar" else serial(kind == "floating", flexible_of(kind), RATIO))
    return path


def heavier(arm: Arm, model: Model) -> Model:
    """With other bodies, rotors, springs, and every effect that a file holds."""
    last = model.bodies[-1]
    bodies = (
        *model.bodies[:-1],
        replace(
            last,
            mass=replace(last.mass, value=1.1 * last.mass.value),
            inertia=tuple(replace(one, value=1.2 * one.value) for one in last.inertia),  # type: ignore[arg-type]
        ),
    )
    joints = tuple(
        replace(
            one,
            rotor_inertia=replace(one.rotor_inertia, value=1.3 * one.rotor_inertia.value),
            stiffness=replace(one.stiffness, value=0.9 * one.stiffness.value),
            damping=replace(one.damping, value=1.4 * one.damping.value),
        )
        for one in model.joints
    )
    stiffness = model.joints[0].stiffness.value
    effects = tuple(
        # a tendon has no offset beside a cubic stiffness
        Effect(
            CATALOGUE[key],
            arm.joints[-1 if key == "spring_offset" else 0].name,
            size * stiffness,
            shape=0.015 if key == "backlash" else None,
        )
        for key, size in zip(IN_SPRINGS, (2e-4, 0.01, 1e-3, 0.02, 10.0, 0.01, 0.6), strict=True)
    )
    return replace(model, bodies=bodies, joints=joints, effects=effects)


def accelerations(path: Path, robot: Robot, states: Sequence[Any]) -> np.ndarray:
    """(m, ·) of base, joints and motors after the gear, in MuJoCo."""
    tree = mujoco.MjModel.from_xml_path(str(path))
    tree.opt.tolerance, tree.opt.iterations, tree.opt.timestep = 1e-14, 200, 1e-6
    tree.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    data, out = mujoco.MjData(tree), []
    links = [tree.joint(hinge.written) for hinge in robot.hinges]
    rotors = [one.spring and tree.joint(one.spring.number) for one in robot.hinges]
    turning = [tree.jnt_dofadr[j] + 3 for j in range(tree.njnt) if tree.jnt_type[j] == 0]
    for q, theta, omega, qd, thetad, tau in states:
        mujoco.mj_resetData(tree, data)
        for j, (link, rotor) in enumerate(zip(links, rotors, strict=True)):
            ratio = RATIO if len(links) == 3 else 50.0
            data.qpos[link.qposadr[0]] += q[j]
            data.qvel[link.dofadr[0]] = qd[j]
            if rotor is None:
                data.qfrc_applied[link.dofadr[0]] = ratio * tau[j]
                continue
            data.qpos[rotor.qposadr[0]] += ratio * theta[j]
            data.qvel[rotor.dofadr[0]] = ratio * thetad[j]
            data.qfrc_applied[rotor.dofadr[0]] = tau[j]
        for at in turning:
            data.qvel[at : at + 3] = omega if np.ndim(omega) else [0.0, 0.0, omega]
        mujoco.mj_forward(tree, data)
        base = [data.qacc[at : at + 3] if np.ndim(omega) else data.qacc[at + 2 : at + 3] for at in turning]
        joints = [data.qacc[link.dofadr[0]] for link in links]
        motors = [data.qacc[r.dofadr[0]] / ratio if r is not None else x for r, x in zip(rotors, joints, strict=True)]
        out.append(np.concatenate([*base, joints, motors]))
    return np.array(out)


@pytest.mark.parametrize("kind", ["planar", "floating", "fixed"])
def test_accelerations_of_a_corrected_file(tmp_path: Path, kind: str) -> None:
    arm, path, out = arm_of(kind), file_of(tmp_path, kind), tmp_path / "new.xml"
    robot = read_robot(path, arm)
    model = heavier(arm, robot.model(arm))
    values = model.base_values(arm)
    found = corrected(robot, arm, Stage("corrected", values, model.effects), [])
    assert found.lost == () and found.left < 1e-4
    write(contents(robot, found.robot, out))
    again = read_robot(out, arm)
    learned = again.model(arm)
    assert learned.base_values(arm) == pytest.approx(values, rel=1e-4, abs=1e-4 * np.abs(values[values < 1e9]).max())
    assert {(one.kind.key, one.joint): one.value for one in learned.effects} == pytest.approx(
        {(one.kind.key, one.joint): one.value for one in model.effects}, rel=1e-6
    )
    assert differ(arm, out, again) < EXACT


def differ(arm: Arm, path: Path, robot: Robot) -> float:
    """Largest difference of accelerations in MuJoCo from those of zygos' equations with the model of the file, as share
    of the largest one."""
    learned = robot.model(arm)
    values = learned.base_values(arm)
    draw, n = np.random.default_rng(0), arm.n
    rigid = np.array([not joint.flexible for joint in arm.joints])
    states = []
    for _ in range(20):
        q, qd, bent, slip, tau = draw.normal(size=(5, n))
        qd += np.sign(qd)  # MuJoCo rounds the sign of friction off near standstill
        theta, thetad = np.where(rigid, q, q + 0.02 * bent), np.where(rigid, qd, qd + 0.05 * slip)
        omega = np.array(0.3) if not arm.spatial else draw.normal(size=3) * 0.5 * arm.free
        states.append((q, theta, omega, qd, thetad, tau * values[-2] / 100.0))
    own = from_parameters(arm, values, learned.effects)
    parts = own.accelerations(*(np.array(column) for column in zip(*states, strict=True)))
    expected = np.concatenate([x.reshape(len(states), -1) for x in parts[0 if arm.free else 1 :]], axis=1)
    return float(np.max(np.abs(accelerations(path, robot, states) - expected)) / np.max(np.abs(expected)))


ACTUATORS = """<actuator>
<motor name="drive" joint="JOINT" gear="6"/><position name="hold" joint="JOINT" kp="3"/>
</actuator>
<keyframe><key name="home" qpos="QPOS" qvel="QVEL"/></keyframe>"""


def without_springs(kind: str) -> tuple[str, str]:
    """The file of `file_of` without springs and rotors, with a motor, a servo and a keyframe; and a flexible joint."""
    if kind == "planar":
        text = re.sub(r'<body name="\w+_rotor".*?</body>\s*|<tendon>.*</tendon>\s*', "", FREE_FLYER, flags=re.DOTALL)
        joint, angles = "elbow", [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.1, 0.2]
    else:
        text = serial(kind == "floating", (False, False, False), RATIO)
        joint = "joint1"
        angles = [*([1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0] if kind == "floating" else []), 0.1, 0.2, 0.3]
    rates = angles[1:] if len(angles) > 3 else angles
    more = ACTUATORS.replace("JOINT", joint)
    for name, values in (("QPOS", angles), ("QVEL", rates)):
        more = more.replace(name, " ".join(map(str, values)))
    return text.replace("</mujoco>", f"{more}</mujoco>"), joint


@pytest.mark.parametrize("kind", ["planar", "floating", "fixed"])
def test_springs_that_a_file_lacks(tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The file then is one of the same arm as that which had them, its motor acts on the rotor with the same power, and
    its keyframe has the rotors at the angles of the joints."""
    arm = arm_of(kind)
    model = heavier(arm, read_robot(file_of(tmp_path, kind), arm).model(arm))
    text, joint = without_springs(kind)
    bare, out = tmp_path / "bare.xml", tmp_path / "springs.xml"
    bare.write_text(text)
    save_arm(arm, tmp_path / "arm.toml")
    save_model(model, tmp_path / "model.toml")
    files = ("--arm", tmp_path / "arm.toml", "--model", tmp_path / "model.toml", "--mjcf", bare)
    assert run("export", *files, "-o", out) == 0
    said = capsys.readouterr()
    assert f"with springs at {joint}" in said.out or kind == "planar"
    assert f"<position> still acts on joint {joint}, behind its spring: let it act on {joint}_motor" in said.err
    robot = read_robot(out, arm)
    assert robot.model(arm).base_values(arm) == pytest.approx(model.base_values(arm), rel=1e-4, abs=1.0)
    assert differ(arm, out, robot) < EXACT
    old, new = (mujoco.MjModel.from_xml_path(str(path)) for path in (bare, out))
    ratio = 50.0 if kind == "planar" else RATIO
    assert new.actuator_gear[0, 0] == pytest.approx(6.0 / ratio)
    assert new.joint(int(new.actuator_trnid[0, 0])).name == f"{joint}_motor"
    motors = {f"{hinge.written}_motor": hinge.written for hinge in robot.hinges if hinge.spring}
    for name in [new.joint(j).name for j in range(new.njnt) if new.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]:
        was, now = old.joint(motors.get(name, name)), new.joint(name)
        turns, zero = (ratio, old.qpos0[was.qposadr[0]]) if name in motors else (1.0, 0.0)
        angle, rate = old.key_qpos[0, was.qposadr[0]] - zero, old.key_qvel[0, was.dofadr[0]]
        assert new.key_qpos[0, now.qposadr[0]] == pytest.approx(turns * angle)
        assert new.key_qvel[0, now.dofadr[0]] == pytest.approx(turns * rate)


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        (('name="shoulder" ', ""), (), "joint joint1 has no name, which its tendon needs; remedy: give it one"),
        (("mujoco", "robot"), (), "is a URDF; remedy: --urdf"),
        ((), ("--cad", "model.toml"), "--cad belongs to --urdf; remedy: leave it out"),
        ((), ("--urdf", "arm.urdf"), "one file is exported at a time; remedy: --urdf"),
    ],
)
def test_springs_are_not_added(
    tmp_path: Path, change: tuple[str, ...], options: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arm, path, out = arm_of("planar"), tmp_path / "bare.xml", tmp_path / "out.xml"
    path.write_text(without_springs("planar")[0].replace(*(change or ("", ""))))
    save_arm(arm, tmp_path / "arm.toml")
    save_model(read_robot(file_of(tmp_path, "planar"), arm).model(arm), tmp_path / "model.toml")
    files = ("--arm", tmp_path / "arm.toml", "--model", tmp_path / "model.toml", "--mjcf", path)
    assert run("export", *files, *options, "-o", out) == 2
    err = " ".join(capsys.readouterr().err.split())
    assert said in err and "remedy: " in err and not out.exists()


def test_only_what_is_learned_changes(tmp_path: Path) -> None:
    arm, path, out = arm_of("planar"), file_of(tmp_path, "planar"), tmp_path / "new.xml"
    robot = read_robot(path, arm)
    values = robot.model(arm).base_values(arm)
    same = corrected(robot, arm, Stage("corrected", values, ()), []).robot
    assert contents(robot, same, out)[out] == path.read_bytes()
    values[list(arm.parameter_names).index("k2")] *= 0.9
    effects = (Effect(CATALOGUE["motor_coulomb"], "elbow", 2.0),)
    new = contents(robot, corrected(robot, arm, Stage("corrected", values, effects), []).robot, out)[out]
    changed = [(a, b) for a, b in zip(path.read_bytes().splitlines(), new.splitlines(), strict=True) if a != b]
    assert [b.strip() for _, b in changed] == [
        b'<joint name="elbow_motor" class="rotor" frictionloss="2"/>',
        b'<fixed name="elbow_spring" stiffness="900" damping="75">',
    ]


SPRING = 'stiffness="1000" damping="75"'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<freejoint/>", "", "the base is fixed, but in arm gap it floats; remedy: give the body"),
        ('gravity="0 0 0"', 'gravity="0 0 -9"', r"in arm gap \[0, 0, 0\]; remedy: <option gravity"),
        ('coef="0.02"/><joint joint="elbow"', 'coef="0.03"/><joint joint="elbow"', "turns 33.3333 times as far"),
        ('coef="0.02"/><joint joint="elbow"', 'coef="-0.02"/><joint joint="elbow"', "turns the other way"),
        (SPRING, 'damping="75"', "is tied by a tendon without stiffness"),
        (SPRING, 'frictionloss="1"', "tendon elbow_spring acts on the joints of the arm, and ties none"),
        (f'<fixed name="elbow_spring" {SPRING}>', '<fixed name="elbow_spring">', "joint elbow is rigid, but flexible"),
        (SPRING, 'stiffness="1000" springlength="0 0.1"', "with a gap .* has no tendon without one"),
        (SPRING, 'stiffness="1000 3"', "is tied by a tendon with a polynomial"),
        (SPRING, 'stiffness="1000 0 3" springlength="0.1"', "a springlength beside a cubic"),
        ('"elbow_motor" class="rotor"', '"elbow_motor" class="rotor" armature="1"', "armature, which takes no part"),
        ('"elbow_motor" class="rotor"', '"elbow_motor" axis="0 1 0"', "does not turn about the axis of the joint"),
        ('"elbow_motor" class="rotor"/>', '"elbow_motor" class="rotor" pos="1 0 0"/>', "does not turn about the axis"),
        (
            '<joint name="elbow_motor" class="rotor"/>\n          <inertial pos="0 0 0"',
            '<joint name="elbow_motor" class="rotor"/>\n          <inertial pos="0.1 0 0"',
            "is not round",
        ),
        ("</worldbody>", '<body name="box"><freejoint/><geom size="1"/></body></worldbody>', "body box floats"),
    ],
)
def test_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert FREE_FLYER.count(old) == 1
    path = tmp_path / "arm.xml"
    path.write_text(FREE_FLYER.replace(old, new))
    with pytest.raises(ZygosError, match=said) as refusal:
        read_robot(path, arm_of("planar"))
    assert "remedy: " in str(refusal.value)


def test_an_arm_that_a_file_alone_does_not_describe(tmp_path: Path) -> None:
    path, arm = file_of(tmp_path, "planar"), arm_of("planar")
    with pytest.raises(ZygosError, match=r"its arm floats or has springs.*; remedy: give the arm file with --arm"):
        read_robot(path, None, 2)
    rigid = replace(arm, joints=tuple(replace(joint, flexible=False) for joint in arm.joints))
    with pytest.raises(ZygosError, match="joint shoulder has a spring, but is rigid in arm gap; remedy"):
        read_robot(path, rigid)
    urdf = Path(__file__).parents[2] / "examples" / "pendulum" / "pendulum.urdf"
    with pytest.raises(ZygosError, match="a URDF holds neither rotors nor springs; remedy: an MJCF with both"):
        read_robot(urdf, replace(arm, joints=tuple(replace(j, name=f"joint{k}") for k, j in enumerate(arm.joints, 1))))


def test_what_a_file_cannot_hold_is_lines_for_the_control_loop() -> None:
    arm = arm_of("planar")
    keys = {"torque_offset": 2.0, "viscous_asymmetry": 3.0, "link_viscous_asymmetry": 4.0, "gyro_bias": 1.0}
    lost = [Effect(CATALOGUE[key], "elbow" if key != "gyro_bias" else None, value) for key, value in keys.items()]
    scope: dict[str, Any] = {}
    exec(snippet(arm, lost), scope)
    torque = scope["extra"](np.zeros(4), np.array([0.0, 0.5, 0.0, 50.0]), np.zeros(4))
    assert torque == pytest.approx([0.0, -4.0 * 0.5, 0.0, -2.0 - 3.0 * 1.0])
    assert "gyro" not in snippet(arm, lost)

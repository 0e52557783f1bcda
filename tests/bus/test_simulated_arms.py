# SPDX-License-Identifier: MIT
"""Arms in MuJoCo with hidden friction and rotors: the file that lacks them is corrected.

Joint frames and inertials are those of MuJoCo Menagerie (google-deepmind/mujoco_menagerie): universal_robots_ur10e at
5f4c663 (BSD-3-Clause, ROS Industrial Consortium), and franka_emika_panda at 1b428b0 without its hand (Apache-2.0,
Franka Emika). Rotors, friction and motions are made up here.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from cli_support import run
from gap_support import example
from spring_support import FREE_FLYER

from zygos.arm import Arm, save_arm
from zygos.can.run import Run, make_run, save_run
from zygos.files.tables import write_columns

HALF = 1.570796326794897
Row = tuple[str, str, str, str, float, str]
UR10E: tuple[Row, ...] = (
    ("0 0 0.181", "0 0 0", "0 0 1", "0 0 0", 7.778, "0.0314743 0.0314743 0.0218756 0 0 0"),
    ("0 0.176 0", f"0 {HALF} 0", "0 1 0", "0 0 0.3065", 12.93, "0.423074 0.423074 0.0363656 0 0 0"),
    ("0 -0.137 0.613", "0 0 0", "0 1 0", "0 0 0.2855", 3.87, "0.11059 0.11059 0.0108844 0 0 0"),
    ("0 0 0.571", f"0 {HALF} 0", "0 1 0", "0 0.135 0", 1.96, "0.00510825 0.00510825 0.0055125 0 0 0"),
    ("0 0.135 0", "0 0 0", "0 0 1", "0 0 0.12", 1.96, "0.00510825 0.0055125 0.00510825 0 0 0"),
    ("0 0 0.12", "0 0 0", "0 1 0", "0 0.092 0", 0.202, "0.000144346 0.000204525 0.000144346 0 0 0"),
)
"""Of each joint: place and attitude (rpy) of its frame, axis; centre, mass and inertia (xx yy zz xy xz yz)."""
PANDA: tuple[Row, ...] = (
    ("0 0 0.333", "0 0 0", "0 0 1", "0.003875 0.002081 -0.04762", 4.970684,
     "0.70337 0.70661 0.0091170 -0.00013900 0.0067720 0.019169"),
    ("0 0 0", f"{-HALF} 0 0", "0 0 1", "-0.003141 -0.02872 0.003495", 0.646926,
     "0.0079620 2.8110e-2 2.5995e-2 -3.925e-3 1.0254e-2 7.04e-4"),
    ("0 -0.316 0", f"{HALF} 0 0", "0 0 1", "2.7518e-2 3.9252e-2 -6.6502e-2", 3.228604,
     "3.7242e-2 3.6155e-2 1.083e-2 -4.761e-3 -1.1396e-2 -1.2805e-2"),
    ("0.0825 0 0", f"{HALF} 0 0", "0 0 1", "-5.317e-2 1.04419e-1 2.7454e-2", 3.587895,
     "2.5853e-2 1.9552e-2 2.8323e-2 7.796e-3 -1.332e-3 8.641e-3"),
    ("-0.0825 0.384 0", f"{-HALF} 0 0", "0 0 1", "-1.1953e-2 4.1065e-2 -3.8437e-2", 1.225946,
     "3.5549e-2 2.9474e-2 8.627e-3 -2.117e-3 -4.037e-3 2.29e-4"),
    ("0 0 0", f"{HALF} 0 0", "0 0 1", "6.0149e-2 -1.4117e-2 -1.0517e-2", 1.666555,
     "1.964e-3 4.354e-3 5.433e-3 1.09e-4 -1.158e-3 3.41e-4"),
    ("0.088 0 0", f"{HALF} 0 0", "0 0 1", "1.0517e-2 -4.252e-3 6.1597e-2", 7.35522e-01,
     "1.2516e-2 1.0027e-2 4.815e-3 -4.28e-4 -1.196e-3 -7.41e-4"),
)  # fmt: skip
HIDDEN = {
    "ur10e": [(0.5, 4.0, 9.0), (0.5, 6.0, 12.0), (0.3, 3.0, 6.0), (0.1, 1.0, 2.0), (0.1, 1.2, 1.5), (0.1, 0.8, 1.0)],
    "panda": [(0.4, 0.8, 0.5), (0.4, 0.9, 0.6), (0.3, 0.7, 0.4), (0.3, 0.8, 0.5), (0.1, 0.5, 0.3), (0.1, 0.4, 0.2),
              (0.1, 0.4, 0.2)],
}  # fmt: skip
"""Armature (kg m^2), friction (Nm) and damping (Nms/rad) of each joint, which the files as delivered lack."""


def mjcf(rows: tuple[Row, ...], hidden: Any = None) -> str:
    hidden = np.zeros((len(rows), 3)) if hidden is None else hidden
    bodies = ""
    for k, (place, turn, axis, centre, mass, inertia) in enumerate(rows, start=1):
        armature, friction, damping = hidden[k - 1]
        bodies += f'<body name="link{k}" pos="{place}" euler="{turn}">\n  <joint name="joint{k}" axis="{axis}"'
        bodies += f' armature="{armature}" frictionloss="{friction}" damping="{damping}"/>\n'
        bodies += f'  <inertial pos="{centre}" mass="{mass}" fullinertia="{inertia}"/>\n'
    motors = "".join(f'<motor joint="joint{k}" gear="101"/>\n' for k in range(1, len(rows) + 1))
    return (
        '<mujoco><compiler angle="radian" eulerseq="XYZ"/><option timestep="0.002" integrator="implicitfast"/>\n'
        f"<worldbody>\n{bodies}{'</body>' * len(rows)}\n</worldbody>\n<actuator>\n{motors}</actuator></mujoco>\n"
    )


def urdf(rows: tuple[Row, ...]) -> str:
    parts = '<robot name="panda"><link name="link0"/>\n'
    for k, (place, turn, axis, centre, mass, inertia) in enumerate(rows, start=1):
        entries = zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), inertia.split(), strict=True)
        parts += f'<link name="link{k}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/><inertia '
        parts += " ".join(f'{key}="{value}"' for key, value in entries) + "/></inertial></link>\n"
        parts += f'<joint name="joint{k}" type="continuous"><parent link="link{k - 1}"/><child link="link{k}"/>'
        parts += f'<origin xyz="{place}" rpy="{turn}"/><axis xyz="{axis}"/></joint>\n'
    return parts + "</robot>\n"


def moved(tree: mujoco.MjModel, seed: int, seconds: float) -> dict[str, np.ndarray]:
    """A run at 250 Hz that follows sums of sines, with encoders of 20 bits and torques with noise of 0.3 %."""
    data, draw, n = mujoco.MjData(tree), np.random.default_rng(seed), tree.nv
    h, count = tree.opt.timestep, round(seconds / tree.opt.timestep)
    size, rate, phase = (
        draw.uniform([0.15], [0.5], (4, n)),
        draw.uniform(0.1, 0.5, (4, n)),
        draw.uniform(0, 6.3, (4, n)),
    )
    t = h * np.arange(count)
    angle = 2.0 * np.pi * rate[:, None] * t[:, None] + phase[:, None]
    wanted = np.einsum("kn,ktn->tn", size, np.sin(angle))
    speed = np.einsum("kn,ktn->tn", size * 2.0 * np.pi * rate, np.cos(angle))
    acceleration = np.einsum("kn,ktn->tn", -size * (2.0 * np.pi * rate) ** 2, np.sin(angle))
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    q, tau, mass = np.empty((count, n)), np.empty((count, n)), np.empty((n, n))
    for k in range(count):
        mujoco.mj_forward(tree, data)
        mujoco.mj_fullM(tree, data, mass)
        pull = acceleration[k] + 100.0 * (wanted[k] - data.qpos) + 20.0 * (speed[k] - data.qvel)
        torque = mass @ pull + data.qfrc_bias - data.qfrc_passive + tree.dof_frictionloss * np.tanh(speed[k] / 0.05)
        q[k], tau[k] = data.qpos, torque
        data.qfrc_applied[:] = torque
        mujoco.mj_step(tree, data)
    step = 2.0 * np.pi / 2**20
    noise = 0.003 * np.sqrt(np.mean(tau**2, axis=0)) * draw.normal(size=tau.shape)
    columns = {"t": t[::2]}
    for j in range(n):
        columns |= {f"q{j + 1}": step * np.round(q[::2, j] / step), f"tau{j + 1}": (tau + noise)[::2, j]}
    return columns


@pytest.mark.slow
@pytest.mark.parametrize(("name", "command"), [("ur10e", "explain"), ("panda", "estimate")])
def test_friction_and_rotors_of_a_whole_arm(
    tmp_path: Path, name: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, hidden = (UR10E if name == "ur10e" else PANDA), np.array(HIDDEN[name])
    cad = tmp_path / ("cad.xml" if name == "ur10e" else "cad.urdf")
    cad.write_text(mjcf(rows) if name == "ur10e" else urdf(rows))
    plant = mujoco.MjModel.from_xml_string(mjcf(rows, hidden))
    for seed in range(3):
        write_columns(tmp_path / f"{seed}.npz", moved(plant, seed, 8.0))
    code = run(
        command, tmp_path / "0.npz", tmp_path / "1.npz", "--simulation", cad, "--validate", tmp_path / "2.npz",
        "-o", tmp_path / "new.xml", "--json", tmp_path / "new.json",
    )  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.out + said.err
    tree = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    assert tree.dof_frictionloss == pytest.approx(hidden[:, 1], rel=0.1)
    assert tree.dof_damping == pytest.approx(hidden[:, 2], rel=0.1)
    (of_run,) = json.loads((tmp_path / "new.json").read_text())["simulator"]["runs"]
    assert of_run["corrected"]["energy"] < 0.05 * of_run["as_delivered"]["energy"]
    assert of_run["corrected"]["forward"] < 0.05


def free_flight(tree: mujoco.MjModel, arm: Arm, seed: int, seconds: float) -> Run:
    """A run of FREE_FLYER whose servo follows sums of sines with its motors."""
    data, draw, h = mujoco.MjData(tree), np.random.default_rng(seed), arm.period_s
    link, motor = (
        np.array([tree.joint(f"{name}{end}").qposadr[0] for name in ("shoulder", "elbow")]) for end in ("", "_motor")
    )
    size, rate = draw.uniform(0.03, 0.07, (3, 2)), draw.uniform(0.6, 1.8, (3, 2))
    phase, middle, n = draw.uniform(0.0, 6.3, (3, 2)), np.array([-0.3, -1.4]), arm.gear_ratios
    per, count = round(h / tree.opt.timestep), round(seconds / h)

    def wanted(t: float) -> tuple[np.ndarray, np.ndarray]:
        angle = rate * t + phase
        return middle + (size * np.sin(angle)).sum(axis=0), (size * rate * np.cos(angle)).sum(axis=0)

    (data.qpos[link], data.qvel[link - 1]) = begin = wanted(0.0)
    (data.qpos[motor], data.qvel[motor - 1]) = n * begin[0], n * begin[1]
    q, theta, tau, omega = (np.empty((count, k)) for k in (2, 2, 2, 3))
    step = 2.0 * np.pi / 2**20
    for k in range(count):
        q[k], theta[k], omega[k] = data.qpos[link], data.qpos[motor] / n, data.qvel[3:6]
        goal, speed = wanted(k * h)
        tau[k] = (4000.0 * (goal - theta[k]) + 3000.0 * (speed - data.qvel[motor - 1] / n)) / n
        data.qfrc_applied[motor - 1] = tau[k]
        mujoco.mj_step(tree, data, per)
    omega += 1e-5 * draw.normal(size=omega.shape)
    return make_run(arm, q=step * np.round(q / step), theta=step * np.round(theta / step), tau=tau, omega=omega)


def test_no_plain_estimate_is_written_into_the_file_of_such_an_arm(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cad, table = tmp_path / "cad.xml", tmp_path / "run.npz"
    cad.write_text(FREE_FLYER)
    save_arm(example()[0], tmp_path / "arm.toml")
    write_columns(table, {"t": np.arange(50) / 100.0})
    assert run("estimate", table, "--simulation", cad, "-o", tmp_path / "new.xml") == 2
    assert "arm gap floats or has flexible joints" in (said := " ".join(capsys.readouterr().err.split()))
    assert "remedy: `zygos explain --simulation" in said and not (tmp_path / "new.xml").exists()


@pytest.mark.slow
def test_an_arm_that_floats_on_springs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arm of examples/gap in MuJoCo with damping at a motor, of which its file says nothing."""
    arm, cad, out = replace(example()[0], period_s=0.01), tmp_path / "cad.xml", tmp_path / "new.xml"
    cad.write_text(FREE_FLYER)
    save_arm(arm, tmp_path / "arm.toml")
    plant = FREE_FLYER.replace('"elbow_motor" class="rotor"', '"elbow_motor" class="rotor" damping="0.6"')
    # the steps of the file itself would skew angles and rates by half a step, which these sensors show
    plant = plant.replace('timestep="0.001" integrator="implicitfast"', 'timestep="0.002" integrator="RK4"')
    tree = mujoco.MjModel.from_xml_string(plant)
    for seed in range(3):
        save_run(free_flight(tree, arm, seed, 24.0), tmp_path / f"{seed}.blf")
    code = run(
        "explain", tmp_path / "0.blf", tmp_path / "1.blf", "--simulation", cad, "--validate", tmp_path / "2.blf",
        "-o", out, "--json", tmp_path / "new.json", "--report", tmp_path / "new.html",
    )  # fmt: skip
    said = capsys.readouterr()
    assert code == 0, said.out + said.err
    assert "named: The simulation lacks viscous friction at the motor (elbow)" in said.out
    assert "in MuJoCo, work predicted wrongly" in said.out and "In MuJoCo" in (tmp_path / "new.html").read_text()
    (of_run,) = json.loads((tmp_path / "new.json").read_text())["simulator"]["runs"]
    before, after = of_run["as_delivered"], of_run["corrected"]
    assert before["energy"] == pytest.approx(before["own"], rel=0.02), "the file is the model that zygos reads of it"
    assert after["energy"] < 0.05 * before["energy"]
    assert after["forward"] < 0.5 * before["forward"]
    corrected = mujoco.MjModel.from_xml_path(str(out))
    motors = [corrected.joint(f"{name}_motor").dofadr[0] for name in ("shoulder", "elbow")]
    assert corrected.dof_damping[motors] == pytest.approx([0.0, 0.6], abs=0.006)
    assert corrected.tendon_stiffness == pytest.approx([3000.0, 1000.0], rel=0.01)
    assert b"<!-- examples/gap: each rotor is a body of its own -->" in out.read_bytes()

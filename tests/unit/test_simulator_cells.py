# SPDX-License-Identifier: MIT
"""What an MJCF holds exactly or approximately: accelerations in MuJoCo beside those of zygos' own equations.

Each file is read by zygos, and compiled and solved by MuJoCo. MuJoCo shares no code with the equations of zygos.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from spring_support import IN_SPRINGS

from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE, Effect
from zygos.simulators.correct import in_joints
from zygos.simulators.file import contents, read_robot, write

FILE = """<mujoco>
  <option gravity="1 -2 -9" timestep="1e-5"/>
  <worldbody><body name="a" pos="0 0 .3">
    <inertial pos=".02 .01 .1" mass="3" fullinertia=".04 .05 .03 .002 .001 -.003"/>
    <joint name="one" axis="0 0 1"/>
    <body name="b" pos=".1 0 .2" euler="40 10 0">
      <inertial pos=".03 -.02 .15" mass="2" fullinertia=".03 .035 .01 .001 -.002 .001"/>
      <joint name="two" axis="0 1 0"/>
      <body name="c" pos="0 0 .4">
        <inertial pos="0 .01 .1" mass="1" fullinertia=".012 .011 .004 0 .001 0"/>
        <joint name="three" axis="1 0 0"/>
      </body>
    </body>
  </body></worldbody>
  <actuator>
    <motor joint="one" gear="120"/><motor joint="two" gear="80"/><motor joint="three" gear="6"/>
  </actuator>
</mujoco>
"""
EXACT = 1e-9
"""Largest difference of accelerations, as share of the largest one that the cell causes."""
EFFECTS = {
    "motor_viscous": 0.004,
    "link_viscous": 0.6,
    "motor_coulomb": 0.02,
    "link_coulomb": 1.5,
    "rotor_coupling": 1.0,
}
"""Sizes by key of the catalogue."""


def test_every_cell_has_its_test() -> None:
    """Those of springs have theirs in test_simulator_springs.py, with those of rotors on hinges of their own."""
    held = {key for key, kind in CATALOGUE.items() if kind.mjcf.holds}
    assert held == set(EFFECTS) | set(IN_SPRINGS)
    assert set(IN_SPRINGS) | {"rotor_coupling"} >= held


def accelerations(path: Path, states: np.ndarray) -> np.ndarray:
    """(m, 3) in MuJoCo at states (m, 3, 3) of angles, rates and torques at the joints."""
    tree = mujoco.MjModel.from_xml_path(str(path))
    tree.opt.tolerance, tree.opt.iterations = 1e-14, 200
    data, out = mujoco.MjData(tree), []
    for q, qd, torque in states:
        mujoco.mj_resetData(tree, data)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, qd, torque
        mujoco.mj_forward(tree, data)
        out.append(data.qacc.copy())
    return np.array(out)


@pytest.mark.parametrize("key", EFFECTS)
def test_accelerations_in_mujoco_are_those_of_the_equations(tmp_path: Path, key: str) -> None:
    size, kind = EFFECTS[key], CATALOGUE[key]
    path, out = tmp_path / "arm.xml", tmp_path / "new.xml"
    path.write_text(FILE)
    plain = read_robot(path, None)
    arm = plain.arm(0.001, [1e-6] * 3)
    rotors = np.array([2e-5, 3e-5, 4e-4])
    armature = (arm.gear_ratios**2 - arm.gear_ratios) * rotors
    effects = [Effect(kind, joint.name, size) for joint in arm.joints[1 if key == "rotor_coupling" else 0 :]]
    drives = in_joints(arm, effects)
    hinges = [
        replace(hinge, armature=float(size), friction=float(friction), damping=float(damping))
        for hinge, size, friction, damping in zip(plain.hinges, armature, drives.friction, drives.damping, strict=True)
    ]
    write(contents(plain, replace(plain, hinges=tuple(hinges)), out))
    again = read_robot(out, arm)
    assert again.rotors(arm) == pytest.approx(rotors)
    model = replace(again.model(arm), effects=tuple(effects))
    draw = np.random.default_rng(0)
    states = draw.normal(size=(40, 3, 3)) * np.array([[0.4] * 3, [1.0] * 3, [10.0, 10.0, 1.0]])
    # MuJoCo's friction has another sign where the joint would turn back within 20 ms
    states[:, 1] += np.sign(states[:, 1])

    def apart() -> float:
        """The largest difference, as share of what the cell causes."""
        q, qd, torque = states[:, 0], states[:, 1], states[:, 2] / arm.gear_ratios
        still = np.zeros((len(q), 3))
        _, expected, _ = from_model(arm, model).accelerations(q, q, still, qd, qd, torque)
        caused = expected
        if key != "rotor_coupling":
            bare = from_model(arm, replace(model, effects=()))
            caused = expected - bare.accelerations(q, q, still, qd, qd, torque)[1]
        assert np.max(np.abs(caused)) > 1e-3
        return float(np.max(np.abs(accelerations(out, states) - expected)) / np.max(np.abs(caused)))

    assert apart() < EXACT
    states[:, 1] *= 2e-3  # slow
    assert (apart() < EXACT) == (kind.mjcf.how == "exact")

# SPDX-License-Identifier: MIT
"""Torques beside the masses of a URDF: MuJoCo computes what the arm needs, and some drives report another scale."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from cli_support import run
from numpy.typing import NDArray

from conftest import EXAMPLE, ROOT
from zygos.arm import Arm
from zygos.audit.findings import Audit
from zygos.audit.weights import beside_masses, weights
from zygos.can.run import Run
from zygos.simulators.file import read_robot
from zygos.simulators.runs import read_plain

URDF = ROOT / "examples" / "openarm" / "openarm.urdf"
COULOMB = np.array([0.306, 0.306, 0.40, 0.166, 0.050, 0.093, 0.172])
PIPER = np.array([4.0, 4.0, 4.0, 1.0, 1.0, 1.0, 1.0])
"""Firmware 1.5-8 of AgileX Piper reports four times the torques of joints 1 to 3 (agilexrobotics/piper_sdk, issue 73,
answer of 2025-10-15)."""


def recorded(folder: Path, scale: NDArray[np.float64]) -> tuple[Arm, Run]:
    """Half a minute of several sines, with friction and noise."""
    tree = mujoco.MjModel.from_xml_path(str(URDF))
    data, draw = mujoco.MjData(tree), np.random.default_rng(1)
    t = np.arange(3000) / 100.0
    phase = draw.uniform(0.0, 2.0 * np.pi, (2, 7))
    q, qd, qdd = np.zeros((3, len(t), 7))
    for k, (f, size) in enumerate(((0.13, 0.6), (0.41, 0.2))):
        w = 2.0 * np.pi * f * (1.0 + 0.07 * np.arange(7))
        angle = np.outer(t, w) + phase[k]
        q, qd, qdd = q + size * np.sin(angle), qd + size * w * np.cos(angle), qdd - size * w**2 * np.sin(angle)
    tau = np.empty_like(q)
    for k in range(len(t)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qd[k], qdd[k]
        mujoco.mj_inverse(tree, data)
        tau[k] = data.qfrc_inverse
    tau += COULOMB * np.sign(qd) + 0.02 * qdd + draw.normal(0.0, 0.01, tau.shape)
    columns = {f"q{j + 1}": q[:, j] for j in range(7)} | {f"tau{j + 1}": (scale * tau)[:, j] for j in range(7)}
    np.savez(folder / "run.npz", t=t, **columns)
    _, arm, (own,) = read_plain([folder / "run.npz"], URDF)
    return arm, own


def test_four_times_the_torque_of_three_joints(tmp_path: Path) -> None:
    arm, own = recorded(tmp_path, PIPER)
    found = weights(own, read_robot(URDF, arm).model(arm))
    factors = {one.joint: one.factor for one in found}
    assert set(factors) == {1, 2, 3, 4, 5, 6}, "gravity does no work on the first joint, whose axis is vertical"
    assert [factors[j] for j in sorted(factors)] == pytest.approx(PIPER[1:], rel=0.05)
    said = beside_masses(own, Audit((), (), ()), found)
    assert [one.signal for one in said.findings] == ["joint2 torque", "joint3 torque"]
    for one in said.findings:
        assert one.fault.startswith("torque scale or masses: ") and "times what the simulation weighs" in one.fault
        assert "friction does not count" in one.evidence and "scale = 0.2" in one.remedy
    assert said.notes == ("joint1 torque: gravity in this run does not tell their scale against the masses",)


def test_right_torques_are_not_accused(tmp_path: Path) -> None:
    arm, own = recorded(tmp_path, np.ones(7))
    found = weights(own, read_robot(URDF, arm).model(arm))
    assert [one.factor for one in found] == pytest.approx(np.ones(len(found)), rel=0.05)
    assert beside_masses(own, Audit((), (), ()), found).findings == ()


def test_an_arm_that_floats_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm, log = ROOT / "examples" / "gap" / "arm.toml", ROOT / "examples" / "gap" / "demo" / "a.blf"
    for simulation, said in (
        (EXAMPLE / "model.toml", "only masses weigh torques in Nm"),
        (URDF, "floats or has flexible joints"),
    ):
        assert run("check-arm", log, "--arm", arm, "--simulation", simulation, "--json", tmp_path / "a.json") == 2
        assert said in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "a.json").exists()

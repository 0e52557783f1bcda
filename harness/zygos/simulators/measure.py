# SPDX-License-Identifier: MIT
"""The gap in MuJoCo: the torques that a file needs for the motion of a run, and where the torques of a run take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.gap.ground.predictions import Prediction, Stage
from zygos.ground.motion import TorqueRows
from zygos.ground.score import Score, beside, scored, scored_torques
from zygos.simulators.mjcf import load_mujoco
from zygos.simulators.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """A run by a file in MuJoCo, beside zygos' own equations with what the file holds."""

    score: Score
    """Of `mj_inverse` on the filtered motion of the run."""
    own: Score
    forward: float
    """Root mean square error of the angles after half a second of the user's integrator with the measured torques, as
    share of the way that the joints went; NaN where it diverges."""

    @property
    def ratio(self) -> float:
        """Error of the work in MuJoCo over that of zygos' own equations."""
        return self.score.arm_energy_share / self.own.arm_energy_share

    @property
    def good(self) -> bool:
        """Whether MuJoCo predicts the work nearly as zygos does."""
        own = self.own.arm_energy_share
        return self.score.arm_energy_share <= max(limits.NOT_WORSE.value * own, own + limits.NEAR_WORK.value)


class Simulator:
    """A compiled MJCF or URDF whose chain is an arm."""

    def __init__(self, tree: Any, robot: Robot, arm: Arm) -> None:
        """tree: compiled, with the joints of the robot by number, or by name where it was a URDF."""
        names = [tree.joint(j).name for j in range(tree.njnt)]
        joints = [one.number if one.number >= 0 else names.index(one.written) for one in robot.hinges]
        self._mujoco, self._tree, self._arm = load_mujoco(), tree, arm
        self._data = self._mujoco.MjData(tree)
        self._q = np.array([int(tree.jnt_qposadr[j]) for j in joints])
        self._dof = np.array([int(tree.jnt_dofadr[j]) for j in joints])
        self._zero = np.array([hinge.zero_rad for hinge in robot.hinges])

    @property
    def integrator(self) -> str:
        """Of the file, with its time step."""
        kind = self._mujoco.mjtIntegrator(int(self._tree.opt.integrator)).name.removeprefix("mjINT_")
        return f"{kind}, {1e3 * float(self._tree.opt.timestep):g} ms"

    def inverse(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """(m, N) torques of the bodies and of friction for a motion (m, N) without contacts and limits, Nm."""
        mujoco, tree, data = self._mujoco, self._tree, self._data
        flags = int(tree.opt.disableflags)
        off = mujoco.mjtDisableBit
        tree.opt.disableflags = flags | int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT) | int(off.mjDSBL_ACTUATION)
        bodies, friction = np.empty_like(q), np.empty_like(q)
        mujoco.mj_resetData(tree, data)
        for k in range(len(q)):
            data.qpos[self._q], data.qvel[self._dof], data.qacc[self._dof] = q[k] + self._zero, qd[k], qdd[k]
            mujoco.mj_inverse(tree, data)
            friction[k] = -(data.qfrc_passive + data.qfrc_constraint)[self._dof]
            bodies[k] = data.qfrc_inverse[self._dof] - friction[k]
        tree.opt.disableflags = flags
        return bodies, friction

    def forward(self, rows: TorqueRows, tau: Array) -> float:
        """Error after half a second, as `Simulated.forward`. tau: (m, N) torques at the joints, Nm."""
        mujoco, tree, data, h = self._mujoco, self._tree, self._data, rows.period_s
        length = max(1, round(limits.STRETCH_S.value / h))
        steps = max(1, round(limits.STRETCH_S.value / float(tree.opt.timestep)))
        lost, gone = [], []
        for start in range(0, len(rows.kept) - length, length):
            end = start + length
            if not rows.kept[start : end + 1].all() or rows.segment[start] != rows.segment[end]:
                continue
            mujoco.mj_resetData(tree, data)
            data.qpos[self._q], data.qvel[self._dof] = rows.state.q[start] + self._zero, rows.state.qd[start]
            at = start + (np.arange(steps) + 0.5) * float(tree.opt.timestep) / h
            for torque in np.array([np.interp(at, np.arange(len(tau)), one) for one in tau.T]).T:
                data.qfrc_applied[self._dof] = torque
                mujoco.mj_step(tree, data)
            lost.append(data.qpos[self._q] - self._zero - rows.state.q[end])
            gone.append(rows.state.q[end] - rows.state.q[start])
        if not lost or not np.isfinite(lost).all():
            return float("nan")
        return float(np.sqrt(np.mean(np.square(lost)) / np.mean(np.square(gone))))


def simulated(simulator: Simulator, one: Prediction, stage: Stage) -> Simulated:
    """An untouched run by a file. stage: what the file holds, for zygos' own equations."""
    rows, arm = one.rows, one.run.arm
    bodies, friction = simulator.inverse(rows.state.q, rows.state.qd, rows.acceleration)
    score = scored_torques(one.run, stage.name, rows, bodies + rows.filtered(friction), bodies + friction, one.motion)
    own = scored(one.run, stage.name, rows, stage.values, stage.effects, one.motion)
    assert arm.torque_at == "joint" or arm.n == len(score.joints)
    offset = np.array([joint.offset_nm for joint in score.joints])
    return Simulated(beside(score, one.plain), beside(own, one.plain), simulator.forward(rows, rows.tau - offset))

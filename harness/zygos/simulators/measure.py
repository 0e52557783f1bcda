# SPDX-License-Identifier: MIT
"""The gap in MuJoCo: the torques that a file needs for the motion of a run, and where the torques of a run take it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.dynamics.equations import from_parameters
from zygos.dynamics.joints import Drives
from zygos.errors import Undecided
from zygos.gap.ground.predictions import Prediction, Stage
from zygos.gap.record import MeasuredRun, smoothed_states, smoothed_torques
from zygos.gap.twin import follow, measure
from zygos.ground.motion import TorqueRows
from zygos.ground.score import Score, beside, rms, scored, scored_torques
from zygos.simulators.mjcf import load_mujoco
from zygos.simulators.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """A run by a file in MuJoCo, beside zygos' own equations with what the file holds."""

    energy: float
    """What `mj_inverse` on the filtered motion of the run leaves of the work in one second, as share of that work."""
    own: float
    """What zygos' own equations leave of it."""
    floor: float
    """What noise, quanta and filters alone leave of the work of a twin of the run."""
    forward: float
    """Root mean square error of the angles after half a second of the user's integrator with the measured torques, as
    share of the way that the joints went; NaN where it diverges."""
    score: Score | None = None
    """Of `mj_inverse` joint by joint, of an arm on the ground."""

    @property
    def ratio(self) -> float:
        """Error of the work in MuJoCo over that of zygos' own equations."""
        return self.energy / self.own

    @property
    def good(self) -> bool:
        """Whether MuJoCo predicts the work nearly as zygos does."""
        return self.energy <= max(limits.NOT_WORSE.value * self.own, self.own + self.floor)


@dataclass(frozen=True)
class Piece:
    """A piece of motion that a simulator goes through, from one measured state to another."""

    start: State
    """(N) angles and rates."""
    tau: Array
    """(m, N) torques, a period apart: at the joints, and at the rotors of flexible ones, Nm."""
    held: bool
    """Whether each of them is held until the next one."""
    end: Array
    """(N,) angles that were measured after m - 1 periods, rad."""


class Course:
    """The smoothed motion of an arm that floats or has flexible joints: A arcs of m instants."""

    def __init__(self, arm: Arm, readings: Readings) -> None:
        """Of the readings of a run."""
        half, rigid = arm.smoother.points // 2, np.array([not joint.flexible for joint in arm.joints])
        # the motor of a rigid joint turns with its link
        self.state, self.change = (
            replace(one, theta=np.where(rigid, one.q, one.theta), thetad=np.where(rigid, one.qd, one.thetad))
            for one in (smoothed_states(arm, readings, derivative) for derivative in (0, 1))
        )
        """The derivative of the state: rates in the place of angles, accelerations in that of rates."""
        self.tau = smoothed_torques(arm, readings)
        """(A, m, N) Nm before the gear."""
        self.driving = np.where(rigid, arm.gear_ratios, 1.0)
        """(N,) by which a torque of a motor is multiplied where it acts."""
        self._held = readings.tau[:, half:-half] * self.driving
        self.arm = arm

    def work(self) -> Array:
        """(windows,) of the motors in each second, J."""
        return self.windows(np.sum(self.arm.gear_ratios * self.tau * self.state.thetad, axis=-1))

    def windows(self, power: Array) -> Array:
        """(windows,) J of a power (A, m)."""
        h = self.arm.period_s
        window = min(power.shape[1], max(2, round(limits.WORK_WINDOW_S.value / h)))
        whole = power.shape[1] // window * window
        return np.asarray(power[:, :whole].reshape(-1, window).sum(axis=1) * h, dtype=np.float64)

    def left(self, own: Drives) -> Array:
        """(windows,) J that zygos' own equations leave of the work."""
        now, then = self.state, self.change
        base, link, motor = own.accelerations(now.q, now.theta, now.base, now.qd, now.thetad, self.tau)
        off = (then.base - base if self.arm.free else now.base, then.qd - link, then.thetad - motor)
        rates = (now.base, now.qd, now.thetad)
        # the power of the forces that are missing, v' M a, from T = v' M v / 2
        both = own.kinetic_energy(now.q, *(v + a for v, a in zip(rates, off, strict=True)))
        return self.windows(both - own.kinetic_energy(now.q, *rates) - own.kinetic_energy(now.q, *off))

    def pieces(self) -> Iterator[Piece]:
        """Of half a second."""
        length = max(1, round(limits.STRETCH_S.value / self.arm.period_s))
        packed = self.state.packed()
        for arc, held, q in zip(packed, self._held, self.state.q, strict=True):
            for start in range(0, len(arc) - length, length):
                end = start + length
                yield Piece(State.unpacked(arc[start]), held[start : end + 1], True, q[end])


def pieces_of(rows: TorqueRows, tau: Array) -> Iterator[Piece]:
    """Of half a second, of an arm on the ground. tau: (m, N) torques at the joints, Nm."""
    length = max(1, round(limits.STRETCH_S.value / rows.period_s))
    state = rows.state
    for start in range(0, len(rows.kept) - length, length):
        end = start + length
        if rows.kept[start : end + 1].all() and rows.segment[start] == rows.segment[end]:
            q, qd = state.q[start], state.qd[start]
            yield Piece(State(q, q, qd, qd, np.zeros(0)), tau[start : end + 1], False, state.q[end])


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
        springs = [(k, one.spring) for k, one in enumerate(robot.hinges) if one.spring is not None]
        self._soft = np.array([k for k, _ in springs], dtype=np.int64)
        rotors = [one.number for _, one in springs]
        self._rotor_q, self._rotor = (
            np.array([int(at[j]) for j in rotors], dtype=np.int64) for at in (tree.jnt_qposadr, tree.jnt_dofadr)
        )
        self._ratio, self._rotor_zero = (
            np.array(values) for values in ([one.ratio for _, one in springs], [one.zero_rad for _, one in springs])
        )
        self._driven = self._dof.copy()
        self._driven[self._soft] = self._rotor
        self._root = int(tree.body_rootid[int(tree.jnt_bodyid[joints[0]])])
        self._base = None if robot.base is None else int(tree.jnt_dofadr[int(tree.body_jntadr[self._root])])

    def _place(self, state: State) -> None:
        """Give the arm a state (N). The mass centre of one that floats is at rest."""
        data = self._data
        data.qpos[self._q], data.qvel[self._dof] = state.q + self._zero, state.qd
        data.qpos[self._rotor_q] = self._ratio * state.theta[self._soft] + self._rotor_zero
        data.qvel[self._rotor] = self._ratio * state.thetad[self._soft]
        if (at := self._base) is not None:
            data.qvel[at : at + 3], data.qvel[at + 3 : at + 6] = 0.0, self._turning(state)
            self._mujoco.mj_fwdPosition(self._tree, data)
            self._mujoco.mj_comVel(self._tree, data)
            self._mujoco.mj_subtreeVel(self._tree, data)
            data.qvel[at : at + 3] = -data.subtree_linvel[self._root]

    def _turning(self, state: State) -> Array:
        """(3,) of a rate or an acceleration of the base."""
        return np.asarray(state.base if self._arm.spatial else float(state.base) * self._arm.axis)

    @property
    def integrator(self) -> str:
        """Of the file, with its time step."""
        kind = self._mujoco.mjtIntegrator(int(self._tree.opt.integrator)).name.removeprefix("mjINT_")
        return f"{kind}, {1e3 * float(self._tree.opt.timestep):g} ms"

    def inverse(self, q: Array, qd: Array, qdd: Array) -> tuple[Array, Array]:
        """(m, N) torques of the bodies and of friction for a motion (m, N) without contacts and limits, Nm."""
        mujoco, tree, data = self._mujoco, self._tree, self._data
        bodies, friction = np.empty_like(q), np.empty_like(q)
        mujoco.mj_resetData(tree, data)
        with self._alone():
            for k in range(len(q)):
                data.qpos[self._q], data.qvel[self._dof], data.qacc[self._dof] = q[k] + self._zero, qd[k], qdd[k]
                mujoco.mj_inverse(tree, data)
                friction[k] = -(data.qfrc_passive + data.qfrc_constraint)[self._dof]
                bodies[k] = data.qfrc_inverse[self._dof] - friction[k]
        return bodies, friction

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Without contacts, limits and actuators."""
        tree, off = self._tree, self._mujoco.mjtDisableBit
        flags = int(tree.opt.disableflags)
        tree.opt.disableflags = flags | int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT) | int(off.mjDSBL_ACTUATION)
        yield
        tree.opt.disableflags = flags

    def left(self, course: Course) -> Array:
        """(windows,) J that `mj_inverse` along a course leaves of the work: the power of all torques that the motion
        needs and nobody applies."""
        tree, data = self._tree, self._data
        state, change = course.state.packed(), course.change.packed()
        power = np.empty(state.shape[:-1])
        self._mujoco.mj_resetData(tree, data)
        with self._alone():
            for k in np.ndindex(*power.shape):
                then = State.unpacked(change[k])
                self._place(State.unpacked(state[k]))
                data.qacc[self._dof], data.qacc[self._rotor] = then.qd, self._ratio * then.thetad[self._soft]
                if (at := self._base) is not None:
                    data.qacc[at : at + 3], data.qacc[at + 3 : at + 6] = 0.0, self._turning(then)
                    self._mujoco.mj_inverse(tree, data)
                    # no force acts on the whole arm
                    data.qacc[at : at + 3] = -data.qfrc_inverse[at : at + 3] / tree.body_subtreemass[self._root]
                self._mujoco.mj_inverse(tree, data)
                needed = np.array(data.qfrc_inverse)
                needed[self._driven] -= course.driving * course.tau[k]
                power[k] = needed @ data.qvel
        return course.windows(power)

    def forward(self, pieces: Iterable[Piece], period_s: float) -> float:
        """Error at the ends of pieces of motion, as `Simulated.forward`. period_s: of their torques."""
        mujoco, tree, data = self._mujoco, self._tree, self._data
        lost, gone = [], []
        for one in pieces:
            mujoco.mj_resetData(tree, data)
            self._place(one.start)
            span = (len(one.tau) - 1) * period_s
            steps = max(1, round(span / float(tree.opt.timestep)))
            at = (np.arange(steps) + 0.5) / steps * (len(one.tau) - 1)
            at = np.floor(at) if one.held else at
            for torque in np.array([np.interp(at, np.arange(len(one.tau)), column) for column in one.tau.T]).T:
                data.qfrc_applied[self._driven] = torque
                mujoco.mj_step(tree, data)
            lost.append(data.qpos[self._q] - self._zero - one.end)
            gone.append(one.end - one.start.q)
        if not lost or not np.isfinite(lost).all():
            return float("nan")
        return float(np.sqrt(np.mean(np.square(lost)) / np.mean(np.square(gone))))


def simulated(simulator: Simulator, one: Prediction | MeasuredRun, stage: Stage, floor: float) -> Simulated:
    """An untouched run by a file. stage: what the file holds, for zygos' own equations; floor: as of `floor_of`."""
    if isinstance(one, MeasuredRun):
        course, model = Course(one.arm, one.readings()), from_parameters(one.arm, stage.values, stage.effects)
        there, here = (rms(left) / rms(course.work()) for left in (simulator.left(course), course.left(model)))
        return Simulated(there, here, floor, simulator.forward(course.pieces(), one.arm.period_s))
    rows, arm = one.rows, one.run.arm
    bodies, friction = simulator.inverse(rows.state.q, rows.state.qd, rows.acceleration)
    score = scored_torques(one.run, stage.name, rows, bodies + rows.filtered(friction), bodies + friction, one.motion)
    own = scored(one.run, stage.name, rows, stage.values, stage.effects, one.motion)
    assert arm.torque_at == "joint" or arm.n == len(score.joints)
    offset = np.array([joint.offset_nm for joint in score.joints])
    error = simulator.forward(pieces_of(rows, rows.tau - offset), rows.period_s)
    score, own = (beside(found, one.plain) for found in (score, own))
    return Simulated(score.arm_energy_share, own.arm_energy_share, floor, error, score)


def floor_of(one: Prediction | MeasuredRun, stage: Stage) -> float:
    """As `Simulated.floor`, with the model that was found; 0 where that does not follow the run."""
    if isinstance(one, Prediction):
        return one.floor.arm_energy_share
    own = from_parameters(one.arm, stage.values, stage.effects)
    try:
        (twin,) = follow(own, [one])
    except Undecided:
        return 0.0
    course = Course(one.arm, measure(twin, 0))
    return rms(course.left(own)) / rms(course.work())

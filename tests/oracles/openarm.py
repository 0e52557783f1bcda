# SPDX-License-Identifier: MIT
"""An OpenArm on its bus: MuJoCo moves the published arm, and its seven drives answer in frames of the MIT mode.

Facts, with their sources. Bodies: examples/openarm/openarm.urdf. Friction: Fc and Fv of config/follower.yaml in
enactic/openarm_teleop a34a949, whose offsets Fo and steepness k are left out. Rotors: the motor pages of
wiki.seeedstudio.com/damiao_series, taken as the inertias before the gear. Gains: kp_ and kd_ of
v10_simple_hardware.hpp in enactic/openarm_ros2 11f2c59; here the master applies them, and commands torques, as the
leader of openarm_teleop 556ddba does. Ranges and the layout of the frames: docs/drives.md.

Made up: noise of the torque of one step of its code (root mean square), and delays and jitter on the bus.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COULOMB_NM = np.array([0.306, 0.306, 0.40, 0.166, 0.050, 0.093, 0.172])
VISCOUS_NMS_RAD = np.array([0.063, 0.063, 0.604, 0.813, 0.029, 0.072, 0.084])
GEAR = np.array([9.0, 9.0, 40.0, 40.0, 10.0, 10.0, 10.0])
ROTOR_KGM2 = np.array([1.95e-4, 1.95e-4, 2e-5, 2e-5, 1.8e-5, 1.8e-5, 1.8e-5])
KP = np.array([70.0, 70.0, 70.0, 60.0, 10.0, 10.0, 10.0])
KD = np.array([2.75, 2.5, 2.0, 2.0, 0.7, 0.6, 0.5])
ANGLE_RAD = 12.5
RATE_RAD_S = np.array([45.0, 45.0, 8.0, 8.0, 30.0, 30.0, 30.0])
TORQUE_NM = np.array([54.0, 54.0, 28.0, 28.0, 10.0, 10.0, 10.0])
PERIOD_S = 0.002
"""Of the master, which asks the seven drives one after the other."""
_STEP_S = 0.0005
_FRAME_S, _ANSWER_S, _JITTER_S = 60e-6, 100e-6, 20e-6
"""Time of a frame on the bus, time until a drive answers, and mean delay until the answer has its stamp."""
_EPOCH_S = 1_790_000_000.0


@dataclass(frozen=True)
class Flight:
    """The exact motion at m instants of 0.5 ms."""

    t: Array
    """(m,) s."""
    q: Array
    """(m, 7) rad."""
    qd: Array
    """(m, 7) rad/s."""
    tau: Array
    """(m, 7) torques of the motors behind the gears, which hold until the next instant, Nm."""


def plant(urdf: Path) -> mujoco.MjModel:
    """The arm with the friction and the rotors that its URDF lacks."""
    tree = mujoco.MjModel.from_xml_path(str(urdf))
    tree.opt.timestep, tree.opt.integrator = _STEP_S, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    tree.opt.iterations, tree.opt.tolerance = 100, 1e-12
    tree.dof_frictionloss[:], tree.dof_damping[:] = COULOMB_NM, VISCOUS_NMS_RAD
    tree.dof_armature[:] = ROTOR_KGM2 * GEAR**2
    tree.dof_solref[:] = (2.0 * _STEP_S, 1.0)
    tree.dof_solimp[:] = (0.99, 0.9999, 0.001, 0.5, 2.0)
    return tree


def fly(urdf: Path, t: Array, motion: Array) -> Flight:
    """Follow a motion (n, 7) at instants t (n,) by a master that commands torques, which the drives hold for a period.

    It knows the angles and rates of the period before as the frames tell them.
    """
    tree = plant(urdf)
    data = mujoco.MjData(tree)
    asked = np.arange(t[0], t[-1], PERIOD_S)
    wanted = np.stack([np.interp(asked, t, one) for one in motion.T], axis=1)
    rate = np.gradient(wanted, PERIOD_S, axis=0)
    steps = round(PERIOD_S / _STEP_S)
    q, qd, tau = np.empty((3, steps * len(asked), 7))
    data.qpos[:] = wanted[0]
    known = (wanted[0], np.zeros(7))
    for k in range(len(q)):
        if k % steps == 0:
            error = KP * (wanted[k // steps] - known[0]) + KD * (rate[k // steps] - known[1])
            data.qfrc_applied[:] = _told(error, TORQUE_NM, 4095)
            known = (_told(data.qpos, ANGLE_RAD, 65535), _told(data.qvel, RATE_RAD_S, 4095))
        q[k], qd[k], tau[k] = data.qpos, data.qvel, data.qfrc_applied
        mujoco.mj_step(tree, data)
    return Flight(np.arange(len(q)) * _STEP_S, q, qd, tau)


def wave(seconds: float) -> Flight:
    """A smooth motion that no torque explains, for those who only count frames."""
    t = np.arange(0.0, seconds, _STEP_S)
    q = 0.5 * np.sin(1.5 * t[:, None] + np.arange(7))
    return Flight(t, q, np.zeros_like(q), np.zeros_like(q))


def candump(flight: Flight, path: Path, seed: int) -> None:
    """Write what `candump -L` records of the answers of the drives. seed: of noise, delays and jitter."""
    draw = np.random.default_rng(seed)
    asked = np.arange(PERIOD_S, flight.t[-1] - PERIOD_S, PERIOD_S)
    stamps, texts = [], []
    for i in range(7):
        at = asked + _FRAME_S * i + _ANSWER_S + draw.uniform(0.0, 0.5 * _ANSWER_S, len(asked))
        stamp = at + _FRAME_S + draw.exponential(_JITTER_S, len(at))
        held = flight.tau[np.floor(at / _STEP_S).astype(int), i]
        torque = held + draw.normal(0.0, 2.0 * TORQUE_NM[i] / 4095, len(at))
        angle = _code(np.interp(at, flight.t, flight.q[:, i]), ANGLE_RAD, 65535)
        rate = _code(np.interp(at, flight.t, flight.qd[:, i]), RATE_RAD_S[i], 4095)
        force = _code(torque, TORQUE_NM[i], 4095)
        parts = np.column_stack(
            [np.full(len(at), i + 1), angle >> 8, angle & 255, rate >> 4, (rate & 15) << 4 | force >> 8, force & 255,
             np.full(len(at), 30), np.full(len(at), 35)]
        )  # fmt: skip
        stamps.append(stamp)
        texts.append([f"can0 {0x11 + i:03X}##1{bytes(row).hex().upper()}" for row in parts.astype(np.uint8).tolist()])
    order = np.argsort(np.concatenate(stamps), kind="stable")
    all_stamps, all_texts = np.concatenate(stamps), [text for one in texts for text in one]
    with path.open("w", encoding="ascii") as out:
        out.writelines(f"({_EPOCH_S + all_stamps[k]:.6f}) {all_texts[k]}\n" for k in order.tolist())


def _code(value: Array, largest: float | Array, codes: int) -> NDArray[np.int64]:
    return np.clip(np.rint((value + largest) / (2.0 * largest) * codes), 0, codes).astype(np.int64)


def _told(value: Array, largest: float | Array, codes: int) -> Array:
    """A value in the steps of its code."""
    return np.asarray(_code(value, largest, codes) * (2.0 * largest) / codes - largest, dtype=np.float64)

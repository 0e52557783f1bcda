# SPDX-License-Identifier: MIT
"""A Panda on the ground whose torques Pinocchio computes from a motion that is known at every instant.

The geometry is the manufacturer's (../shared/data/geometry); inertias, friction and motions are made up here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from zygos.arm import NO_IMU, Arm, Encoder, Joint, Smoother
from zygos.runs.cycles import Cycles

HALF = np.pi / 2
FRAMES = [
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.333)),
    ((-HALF, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((HALF, 0.0, 0.0), (0.0, -0.316, 0.0)),
    ((HALF, 0.0, 0.0), (0.0825, 0.0, 0.0)),
    ((-HALF, 0.0, 0.0), (-0.0825, 0.384, 0.0)),
    ((HALF, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ((HALF, 0.0, 0.0), (0.088, 0.0, 0.0)),
]
MASSES = (3.0, 2.9, 3.1, 2.5, 2.6, 1.6, 1.2)
CENTRES = [
    (0.0, -0.03, -0.07),
    (0.0, -0.07, 0.03),
    (0.04, 0.02, -0.05),
    (-0.04, 0.04, 0.02),
    (0.0, 0.04, -0.11),
    (0.05, 0.0, 0.0),
    (0.01, 0.01, 0.08),
]
POSTURE = np.array([0.0, -0.3, 0.0, -1.8, 0.0, 1.7, 0.6])
GEAR = 100.0
FIRST, HARMONICS = 0.1, 6
"""Frequencies of the motion: FIRST * (1 .. HARMONICS), Hz."""
COULOMB = np.array([0.6, 0.6, 0.5, 0.5, 0.3, 0.25, 0.2])
VISCOUS = np.array([0.8, 0.8, 0.6, 0.6, 0.4, 0.3, 0.2])


def panda(joints: int = 7) -> Arm:
    """The arm file of the first joints: torques before a gear of 100, encoders of 16 bits, cut-off near 5 Hz."""
    encoder = Encoder(2 * np.pi / 2**16, 2**16)
    chain = tuple(
        Joint(f"j{i + 1}", i + 1, (0.0, 0.0, 1.0), rpy, GEAR, encoder, encoder, flexible=False)
        for i, (rpy, _) in enumerate(FRAMES[:joints])
    )
    return Arm(
        "panda", "fixed", "spatial", 0.004, "sampled", "rotor", chain, NO_IMU, smoother=Smoother(31, 4, 15),
        gravity=(0.0, 0.0, -9.81),
    )  # fmt: skip


def _model(joints: int) -> tuple[pin.Model, pin.Data]:
    model = pin.Model()
    parent = 0
    for i, (rpy, xyz) in enumerate(FRAMES[:joints]):
        place = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"j{i + 1}")
        about = MASSES[i] * np.diag([0.012, 0.011, 0.006]) * (1.0 - 0.08 * i)
        model.appendBodyToJoint(parent, pin.Inertia(MASSES[i], np.array(CENTRES[i]), about), pin.SE3.Identity())
    model.armature = np.array([0.6, 0.6, 0.5, 0.4, 0.2, 0.15, 0.1])[:joints]
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return model, model.createData()


@dataclass(frozen=True)
class Recorded:
    """A run, and the torques without noise behind the gear, (n, joints) Nm."""

    cycles: Cycles
    torque: NDArray[np.float64]


def recorded(
    arm: Arm, seed: int, duration_s: float = 20.0, noise: float = 0.01, offset: float = 0.05, amplitude: float = 0.6
) -> Recorded:
    """A multi-sine of each joint. noise: of a torque, as a share of its standard deviation. offset: largest constant
    error of a torque, as a share likewise. amplitude: of each joint's motion, rad."""
    rng = np.random.default_rng(seed)
    model, data = _model(arm.n)
    t = arm.period_s * np.arange(round(duration_s / arm.period_s))
    w = 2 * np.pi * FIRST * np.arange(1, HARMONICS + 1)
    q, qd, qdd = (np.zeros((len(t), arm.n)) for _ in range(3))
    for j in range(arm.n):
        size = rng.uniform(0.3, 1.0, HARMONICS)
        size *= amplitude / size.sum()
        phase = rng.uniform(0, 2 * np.pi, HARMONICS)
        angle = np.outer(t, w) + phase
        q[:, j] = POSTURE[j] + np.sin(angle) @ size
        qd[:, j] = np.cos(angle) @ (size * w)
        qdd[:, j] = -np.sin(angle) @ (size * w**2)
    torque = np.array([pin.rnea(model, data, a, b, c) for a, b, c in zip(q, qd, qdd, strict=True)])
    torque += COULOMB[: arm.n] * np.tanh(qd / 0.01) + VISCOUS[: arm.n] * qd
    spread = torque.std(axis=0)
    read = torque + spread * (noise * rng.standard_normal(torque.shape) + offset * rng.uniform(-1, 1, arm.n))
    quantum = arm.joints[0].motor_encoder.quantum_rad
    theta = quantum * np.rint(q / quantum)
    cycles = Cycles(
        np.arange(len(t), dtype=np.uint64), theta, theta.copy(), read / GEAR, np.zeros((len(t), 3)),
        np.zeros(len(t), dtype=np.uint32),
    )  # fmt: skip
    return Recorded(cycles, torque)

# SPDX-License-Identifier: MIT
"""Arms that differ in all that an arm file can say, and a record of each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from flight_support import balanced, energy_only
from numpy.typing import NDArray

from zygos.arm import Arm, Encoder, Imu, Joint, Smoother, TorqueLaw
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_BEFORE, VOID_SHIFT, Cycles

Floats = NDArray[np.float64]

TURN = 2.0 * np.pi
PERIOD = 0.02
CYCLES = 3000
SIGMA = 4e-5


@dataclass(frozen=True)
class Case:
    """One arm and one record of it. latch_us: joint, link encoder, motor encoder, gyro."""

    joints: int = 2
    points: int = 7
    order: int = 4
    law: TorqueLaw = "applied_from_sync"
    latch_us: tuple[int, int, int, int] = (0, 0, 0, 0)
    signs: tuple[int, int] = (1, 1)
    zeros: tuple[float, float] = (0.0, 0.0)
    mount: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arc_s: float = 60.0
    damaged: bool = False
    far: bool = False
    """8 turns away from zero, where both lose digits to the size of the angles."""


TURNED = (0.1825741858350554, -0.3651483716701107, 0.5477225575051661, 0.7302967433402214)
LATE = (1500, 700, 2300, 900)
CASES = {
    "plain": Case(),
    "one joint": Case(joints=1, points=5, order=2),
    "three joints": Case(joints=3),
    "5/2": Case(points=5, order=2, law="sampled", latch_us=LATE),
    "11/6": Case(points=11, order=6, law="applied_previous_cycle", latch_us=LATE),
    "15/4": Case(points=15, order=4, latch_us=LATE, arc_s=7.3),
    "previous cycle": Case(law="applied_previous_cycle", arc_s=7.3, damaged=True),
    "sampled": Case(law="sampled", arc_s=7.3, damaged=True),
    "over the end": Case(far=True),
    "turned": Case(signs=(-1, 1), zeros=(0.4, -1.1), mount=TURNED, rpy=(0.3, -1.2, 0.7)),
    "turned back": Case(signs=(1, -1), zeros=(-2.2, 0.3), mount=TURNED, rpy=(1.4, 0.2, 0.0), damaged=True),
    "one joint, all": Case(1, 11, 6, "sampled", LATE, (-1, -1), (0.2, 0.9), TURNED, (0.0, 0.5, 1.0), 7.3, True),
    "two joints, all": Case(2, 15, 4, "applied_from_sync", LATE, (-1, -1), (7.2, 0.9), TURNED, damaged=True),
    "three joints, all": Case(
        3, 7, 4, "applied_previous_cycle", LATE, (-1, 1), (0.2, -0.9), TURNED, (0.2, 0.5, 1.0), 7.3, True
    ),
}


def arm_of(case: Case) -> Arm:
    joint_us, link_us, motor_us, gyro_us = case.latch_us
    joints = []
    for i in range(case.joints):
        # The second joint has its encoders' signs exchanged, so that the joints differ.
        link, motor = case.signs if i != 1 else case.signs[::-1]
        quantum = SIGMA * np.sqrt(12.0)
        joints.append(
            Joint(
                name=f"joint{i + 1}",
                node=i + 3,
                axis=(0.0, 0.0, 1.0),
                frame_rpy=case.rpy if i == 0 else (0.0, 0.0, 0.0),
                gear_ratio=50.0 + 30.0 * i,
                link_encoder=Encoder(quantum, sign=link, zero_rad=case.zeros[0] + i, latch_us=link_us + 100 * i),
                motor_encoder=Encoder(quantum, sign=motor, zero_rad=case.zeros[1] - i, latch_us=motor_us),
                latch_us=joint_us + 200 * i,
            )
        )
    half = case.points // 2
    imu = Imu(9, case.mount, rate_sigma=1e-6, bias_walk=0.0, latch_us=gyro_us)
    arm = Arm(
        name="varied",
        base="free",
        kinetic="planar-symmetric",
        period_s=PERIOD,
        torque_law=case.law,
        torque_at="rotor",
        joints=tuple(joints),
        imu=imu,
        smoother=Smoother(case.points, case.order, half),
        arc_max_s=case.arc_s,
    )
    return energy_only(arm, noise=True)


def parameters_of(arm: Arm) -> Floats:
    """A positive definite (a_ij), and Im, k, b of each joint."""
    rng = np.random.default_rng(arm.n)
    root = np.eye(arm.n + 1) * np.sqrt([24.0, 8.0, 4.0, 2.0][: arm.n + 1]) + 0.2 * rng.normal(size=(arm.n + 1,) * 2)
    a = root @ root.T
    drives = [(0.01, 400.0, 3.0), (0.008, 250.0, 2.0), (0.005, 150.0, 2.5)][: arm.n]
    return np.concatenate([a[np.triu_indices(arm.n + 1)], np.ravel(drives)])


def readings(arm: Arm, link: Floats, motor: Floats, base: Floats) -> Cycles:
    """What the sensors say of link and motor angles (n, N) and of base rates (n, 3) in base axes."""
    links = [joint.link_encoder for joint in arm.joints]
    motors = [joint.motor_encoder for joint in arm.joints]
    flags = np.zeros(len(link), dtype=np.uint32)
    flags[0] = BREAK_BEFORE
    return Cycles(
        sync=np.arange(1, len(link) + 1, dtype=np.uint64),
        q=np.array([e.sign for e in links]) * link + np.array([e.zero_rad for e in links]),
        theta=np.array([e.sign for e in motors]) * motor + np.array([e.zero_rad for e in motors]),
        tau=np.zeros_like(link),
        omega=base @ arm.mount,
        flags=flags,
    )


@cache
def record_of(case: Case) -> Cycles:
    """Sums of sines with torques that balance them, and noise on top. Read-only."""
    arm, rng = arm_of(case), np.random.default_rng(7)
    t = PERIOD * np.arange(CYCLES)[:, None]
    i = np.arange(arm.n)
    link = 0.9 * np.sin((0.91 - 0.13 * i) * t + i) + 0.5 * np.cos((1.73 + 0.21 * i) * t)
    if arm.n == 1:
        link = 0.2 * link + 0.6 * (t - t.mean())  # a single motor can do work only while it turns
    motor = link + 0.05 * np.sin((2.3 + 0.37 * i) * t) + 0.03 * np.cos((1.1 + 0.19 * i) * t + 0.5)
    about = 0.35 * np.sin(0.57 * t + 0.2) + 0.2 * np.cos(1.31 * t)
    across = np.cross(rng.normal(size=3), arm.axis)
    base = about * arm.axis + 0.1 * np.cos(0.8 * t) * across  # a rate across the joint axes has no part in the rows
    whole = replace(arm, arc_max_s=PERIOD * CYCLES)
    cycles = balanced(whole, readings(arm, link, motor, base), parameters_of(arm))
    cycles.q[:] += rng.normal(scale=SIGMA, size=cycles.q.shape)
    cycles.theta[:] += rng.normal(scale=SIGMA, size=cycles.theta.shape)
    cycles.omega[:] += rng.normal(scale=1e-6, size=cycles.omega.shape)
    for position in (40, 411, 1203, 2222):
        cycles.q[position, position % arm.n] += 50.0 * SIGMA  # the bandwidth test refuses the instants around
    if case.far:
        # One joint turns over the end of its encoders' range, the motor a little later than the link.
        for reading, end in ((cycles.q, 1700), (cycles.theta, 1703)):
            reading[:end, -1] += 8.0 * TURN
            reading[end:, -1] -= 8.0 * TURN
    return damage(cycles) if case.damaged else cycles


def damage(cycles: Cycles) -> Cycles:
    """Breaks, invalid cycles, lost cycles, wraps and a void arc."""
    flags, joint = cycles.flags, cycles.q.shape[1] - 1
    flags[300] = BREAK_BEFORE
    flags[[500, 507, 2990]] = INVALID
    flags[530] = BREAK_BEFORE  # few instants in between: an arc too short
    flags[700:760:9] = INVALID  # no instant in between
    cycles.tau[900, 0] = np.nan
    cycles.theta[930, joint] = 2e4
    cycles.sync[1000:] += 3
    cycles.sync[1500:] -= 700
    cycles.q[1700, joint] += 9.0 * TURN
    cycles.theta[1800, joint] -= 9.0 * TURN
    # before blocks of several arcs merge, which are dropped together
    flags[640] = BREAK_BEFORE | VOID_BEFORE
    flags[990] = VOID_BEFORE | 300 << VOID_SHIFT
    return cycles

# SPDX-License-Identifier: MIT
"""An arm, a small simulation of it and a recorder, for the tests of the numpy reference and of the methods.

The motion comes from the equations of `zygos.paper.methods.de`, solved for the accelerations. The energy
balance and the momentum share none of their terms with those, so their agreement is a check of all three.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from runs_support import kept
from scipy.integrate import solve_ivp

from zygos.arm import Arm, load_arm
from zygos.balances.state import State
from zygos.paper.methods import Record, de
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]

TRUE = {
    "a00": 24.0, "a01": 4.2, "a02": 0.96, "a11": 8.2, "a12": 1.97, "a22": 1.9,
    "b01": 0.3, "b02": -0.1, "b12": 0.2,
    "Im1": 0.01, "k1": 400.0, "b1": 3.0, "Im2": 0.008, "k2": 250.0, "b2": 2.0,
}  # fmt: skip


def make_arm(
    folder: Path,
    *,
    joints: int = 2,
    kinetic: str = "planar-symmetric",
    law: str = "applied_from_sync",
    period: float = 0.02,
    counts: int = 2_000_000,
    imu: str = "mount_xyzw = [0, 0, 0, 1]",
    encoder: str = "sign = 1",
    joint: str = "",
    head: str = "",
    tail: str = "",
) -> Arm:
    """Write an arm file and load it. imu, joint, head and tail are lines to add, encoder is keys of both encoders."""
    lines = [
        'name = "test"',
        'base = "free"',
        f'kinetic = "{kinetic}"',
        f"period_s = {period}",
        f'torque_law = "{law}"',
        'torque_at = "rotor"',
        head,
        "[imu]",
        "node = 16",
        "rate_sigma = 1.4e-6",
        "bias_walk = 3.2e-10",
        imu,
    ]
    for i in range(1, joints + 1):
        lines += [
            "[[joint]]",
            f'name = "joint{i}"',
            f"node = {i}",
            "axis = [0, 0, 1]",
            "gear_ratio = 50",
            *([] if "torque_gain_sigma" in joint else ["torque_gain_sigma = 0.0"]),
            f"link_encoder = {{ counts = {counts}, {encoder} }}",
            f'motor_encoder = {{ counts = {counts}, side = "output", {encoder} }}',
            joint,
        ]
    path = folder / "arm.toml"
    path.write_text("\n".join([*lines, tail]), encoding="utf-8")
    return load_arm(path)


def true_parameters(arm: Arm) -> Floats:
    """TRUE in the arm's order, (p,)."""
    return np.array([TRUE[name] for name in arm.parameter_names])


@dataclass(frozen=True)
class Motion:
    """Exact motion at the samples, n instants, two joints; momentum is that of the whole arm [Nms]."""

    t: Floats
    q: Floats
    theta: Floats
    qd: Floats
    thetad: Floats
    f0: Floats
    tau: Floats
    slip2: Floats
    momentum: float

    def record(self, exact: bool = True) -> Record:
        """A batch of one, with the exact rates unless told otherwise."""
        return Record(
            q=self.q[None], theta=self.theta[None], tau=self.tau[None], f0=self.f0[None],
            qd=self.qd[None] if exact else None,
            thetad=self.thetad[None] if exact else None,
            slip2=self.slip2[None] if exact else None,
        )  # fmt: skip

    def cycles(self) -> Cycles:
        """What perfect sensors say, the gyro in base axes."""
        n = len(self.t)
        omega = np.zeros((n, 3))
        omega[:, 2] = self.f0
        return Cycles(
            sync=np.arange(1, n + 1, dtype=np.uint64), q=self.q.copy(), theta=self.theta.copy(), tau=self.tau.copy(),
            omega=omega, flags=np.zeros(n, dtype=np.uint32),
        )  # fmt: skip


def move(arm: Arm, duration: float = 4.0, momentum: float = 0.4) -> Motion:
    """Drive the arm by a PD law with a held torque, towards moving targets; it starts undeflected, in slow rotation."""
    motion: Motion = kept(
        lambda: _moved(arm, duration, momentum), ("support.reference_support",), arm, duration, momentum
    )
    return motion


def _moved(arm: Arm, duration: float, momentum: float) -> Motion:
    h = arm.period_s
    n = round(duration / h) + 1
    pi = true_parameters(arm)
    t = h * np.arange(n, dtype=np.float64)
    first = 0.9 * np.sin(0.9 * t) + 0.3 * np.sin(2.1 * t)
    second = -1.1 * np.sin(0.7 * t) + 0.35 * np.cos(1.7 * t) - 0.35
    desired = np.stack([first, second], axis=1)
    inertia = sum(TRUE[x] * w for x, w in (("a00", 1), ("a01", 2), ("a02", 2), ("a11", 1), ("a12", 2), ("a22", 1)))
    state = np.zeros(11)
    state[8] = momentum / inertia
    states = np.zeros((n, 11))
    torque = np.zeros((n, 2))
    for step in range(n):
        states[step] = state
        torque[step] = (6.0 * (desired[step] - state[2:4]) - 1.5 * state[6:8]) / 5.0
        if step == n - 1:
            break
        held = torque[step]

        def rate(_: float, x: Floats, held: Floats = held) -> Floats:
            acceleration = _accelerations(arm, pi, x, held)
            return np.concatenate([x[4:8], acceleration[1:], acceleration[:1], (x[6:8] - x[4:6]) ** 2])

        state = solve_ivp(rate, (0.0, h), state, "DOP853", rtol=1e-9, atol=1e-11, first_step=h).y[:, -1]
    angles, rates = states[:, 0:4], states[:, 4:8]
    return Motion(
        t=t, q=angles[:, :2], theta=angles[:, 2:], qd=rates[:, :2], thetad=rates[:, 2:], f0=states[:, 8], tau=torque,
        slip2=states[:, 9:11], momentum=momentum,
    )  # fmt: skip


def _accelerations(arm: Arm, pi: Floats, x: Floats, held: Floats) -> Floats:
    """(f0', q'', theta'') from the equations of motion, which are linear in them."""
    tries = np.vstack([np.zeros(5), np.eye(5)])
    q, theta, qd, thetad = (np.tile(part, (6, 1)) for part in (x[0:2], x[2:4], x[4:6], x[6:8]))
    state = State(q, theta, qd, thetad, np.full(6, x[8]))
    forces = de.columns(arm, state, tries[:, 1:3], tries[:, 3:5], tries[:, 0]) @ pi
    right = np.concatenate([np.zeros(3), 50.0 * held]) - forces[0]
    return np.asarray(np.linalg.solve((forces[1:] - forces[0]).T, right), dtype=np.float64)

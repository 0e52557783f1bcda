# SPDX-License-Identifier: MIT
"""Runs of a single axis on a fixed base whose torques come from Pinocchio, with laws of friction by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from ground_support import motion, torques
from laboratory_support import laboratory_arm
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.model.model import Model
from zygos.runs.cycles import Cycles

Array = NDArray[np.float64]
Law = Callable[[Array, Array], Array]
"""Torque before the gear as a function of angle and rate, Nm."""
PATHS = (0, 1, 2)
"""Motions of the measured runs and of the untouched one."""


@cache
def axis() -> tuple[Arm, Model]:
    """An axis with gravity, and the model of its body."""
    arm, model = laboratory_arm("UR10e", friction=False, torque_noise=0.003)
    joint = replace(arm.joints[0], axis=(0.0, 1.0, 0.0))
    body = replace(model.bodies[1], origin_xyz=(0.05, 0.0, -0.2), joint_xyz=None)
    return replace(arm, joints=(joint,), torque_law="sampled"), Model("axis", (model.bodies[0], body), model.joints[:1])


@cache
def size() -> float:
    """Root mean square of the torque of a run, Nm before the gear."""
    return float(np.sqrt(np.mean(_ideal(0, rests=False, seconds=20.0)[2] ** 2)))


@cache
def _ideal(path: int, *, rests: bool, seconds: float) -> tuple[Array, Array, Array]:
    arm, model = axis()
    q, qd, qdd = _stops(arm, seconds, path) if rests else motion(arm, seconds, path)
    return q, qd, torques(arm, model, q, qd, qdd)


def _stops(arm: Arm, seconds: float, seed: int) -> tuple[Array, Array, Array]:
    """Angles, rates and accelerations between stops of 2 s, every 5 s."""
    t = np.arange(round(seconds / arm.period_s)) * arm.period_s
    period, rng = 5.0, np.random.default_rng(seed)
    place = np.append(rng.uniform(-1.2, 1.2, 20), 0.0)
    u, k = np.clip((np.mod(t, period) / period - 0.2) / 0.6, 0.0, 1.0), np.floor(t / period).astype(int)
    step, rate = place[k + 1] - place[k], 1.0 / (0.6 * period)
    q = place[k] + step * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    qd = step * 30.0 * u**2 * (1.0 - u) ** 2 * rate
    qdd = step * (60.0 * u - 180.0 * u**2 + 120.0 * u**3) * rate**2
    return q[:, None], qd[:, None], qdd[:, None]


def measured(
    laws: Sequence[Law] | Law,
    *,
    noise: float = 1.0,
    offset: float = 0.0,
    rests: bool = False,
    seconds: float = 20.0,
    seed: int = 0,
) -> list[Run]:
    """Three runs. laws: of each run, or of all. noise: in units of 0.3 % of the typical torque. offset: Nm before the
    gear."""
    arm, _ = axis()
    out = []
    for path in PATHS:
        q, qd, ideal = _ideal(path, rests=rests, seconds=seconds)
        law = laws if callable(laws) else laws[path]
        rng = np.random.default_rng([seed, path])
        tau = ideal + law(q, qd) + offset + noise * arm.joints[0].torque_sigma * rng.normal(size=q.shape)
        step = arm.joints[0].motor_encoder.quantum_rad
        read, count = np.round(q / step) * step, len(q)
        cycles = Cycles(
            sync=np.arange(count, dtype=np.uint64),
            q=read,
            theta=read,
            tau=tau,
            omega=np.zeros((count, 3)),
            flags=np.zeros(count, dtype=np.uint32),
        )
        out.append(Run.of_cycles(arm, cycles))
    return out


def simulated(run: Run, viscous: float = 0.0) -> Run:
    """The motion of the axis under the torques of a run, by SciPy and Pinocchio; viscous: friction in Nms before the
    gear."""
    arm, model = axis()
    h, count = arm.period_s, len(run)
    t, tau = h * np.arange(count), run.cycles.tau[:, 0]
    one = np.ones((1, 1))

    def needed(q: float, acceleration: float) -> float:
        return float(torques(arm, model, q * one, 0.0 * one, acceleration * one)[0, 0])

    unit = needed(0.0, 1.0) - needed(0.0, 0.0)
    grid = np.linspace(-np.pi, np.pi, 2001)
    still = torques(arm, model, grid[:, None], 0.0 * grid[:, None], 0.0 * grid[:, None])[:, 0]

    def slope(time: float, state: Array) -> Array:
        q, qd = state
        held = np.interp((q + np.pi) % (2.0 * np.pi) - np.pi, grid, still)
        return np.array([qd, (np.interp(time, t, tau) - held - viscous * qd) / unit])

    start = run.cycles.q[0, 0]
    path = solve_ivp(slope, (0.0, t[-1]), [start, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=h)
    q = path.y[0][:, None]
    own = run.cycles
    return Run.of_cycles(arm, Cycles(own.sync, q, q, own.tau, own.omega, own.flags))


def sign(rate: Array) -> Array:
    """Sign of a rate, smooth over 0.005 rad/s."""
    return np.asarray(np.tanh(rate / 0.005))


def nothing(q: Array, qd: Array) -> Array:
    """No friction."""
    return np.zeros_like(q + qd)

# SPDX-License-Identifier: MIT
"""Motions of arms on the ground without a simulation: angles are sums of sines, torques are Pinocchio's for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from arm_support import State, random_arm, random_state
from laboratory_support import laboratory_arm
from numpy.typing import NDArray

from zygos.arm import Arm, Encoder, Smoother
from zygos.dynamics.engines.pinocchio import PinocchioEngine
from zygos.effects import Effect, effect, smooth_sign
from zygos.model.model import Model
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]

FLEXIBLE: dict[str, Callable[[int], bool]] = {
    "flexible": lambda _: True,
    "rigid": lambda _: False,
    "mixed": lambda i: i % 2 == 1,
}
"""Which joints of an arm are flexible, by the name of the kind."""


def sampled_arm(joints: int, base: str, kinetic: str, kind: str, states: int = 2) -> tuple[Arm, Model, list[State]]:
    """A random arm whose joints are flexible as `kind` says, and random states of it."""
    flexible = [FLEXIBLE[kind](i) for i in range(joints)]
    arm, model = random_arm(joints, joints, base, kinetic, flexible)  # type: ignore[arg-type]
    rng = np.random.default_rng(joints)
    return arm, model, [random_state(rng, arm) for _ in range(states)]


@dataclass(frozen=True)
class Ground:
    """An arm, its motion at n cycles, and what an estimate should find."""

    arm: Arm
    q: Floats
    """(n, N) rad."""
    tau: Floats
    """(n, N) torque before the gear, friction included, Nm."""
    true: Floats
    """(p,) of the arm, then of `effects`."""
    effects: tuple[Effect, ...] = ()

    def cycles(self, seed: int | None = None, offset: Floats | float = 0.0, torque: float = 1.0) -> Cycles:
        """What sensors read: steps of the encoders, and torque noise of `torque` times what is declared; without a seed
        exact readings. offset: what the reported torque has too much, Nm."""
        q, tau = self.q, self.tau + offset
        if seed is not None:
            rng = np.random.default_rng(seed)
            step = np.array([joint.motor_encoder.quantum_rad for joint in self.arm.joints])
            q = step * np.round(q / step + rng.uniform(-0.5, 0.5, q.shape[1]))
            tau = tau + torque * rng.normal(size=tau.shape) * [joint.torque_sigma for joint in self.arm.joints]
        n = len(q)
        return Cycles(
            np.arange(1, n + 1, dtype=np.uint64), q, q.copy(), tau, np.zeros((n, 3)), np.zeros(n, dtype=np.uint32)
        )


def moved(arm: Arm, model: Model, n: int, speed: float = 1.0, seed: int = 0) -> tuple[Floats, Floats, Floats]:
    """Angles (n, N), rates and torques before the gear of a fixed arm with rigid joints."""
    rng = np.random.default_rng(seed)
    t = arm.period_s * np.arange(n)[:, None]
    q, qd, qdd = np.zeros((3, n, arm.n))
    for k in range(6):
        w = 2.0 * np.pi * speed * (0.08 + 0.11 * k + 0.023 * np.arange(arm.n) + 0.01 * rng.uniform(size=arm.n))
        size, phase = rng.uniform(0.3, 1.0, arm.n) / (1.0 + 0.5 * k), rng.uniform(0.0, 6.28, arm.n)
        q += size * np.sin(w * t + phase)
        qd += size * w * np.cos(w * t + phase)
        qdd -= size * w**2 * np.sin(w * t + phase)
    engine = PinocchioEngine(arm, model)
    still, tau = np.zeros(3), np.zeros_like(q)
    for k in range(n):
        rest, *units = (
            engine.accelerations(q[k], q[k], still, qd[k], qd[k], torque)[1]
            for torque in (np.zeros(arm.n), *np.eye(arm.n))
        )
        tau[k] = np.linalg.solve(np.column_stack(units) - rest[:, None], qdd[k] - rest)
    return q, qd, tau


@cache
def random_ground(joints: int, kinetic: str = "spatial", n: int = 15000) -> Ground:
    """A random arm at 250 Hz with encoders of 16 bits, without friction and declared torque noise."""
    arm, model = random_arm(3, joints, "fixed", kinetic, False)  # type: ignore[arg-type]
    encoder = Encoder(quantum_rad=2.0 * np.pi / 65536)
    hardware = tuple(replace(joint, link_encoder=encoder, motor_encoder=encoder) for joint in arm.joints)
    arm = replace(arm, period_s=0.004, torque_law="sampled", smoother=Smoother(21, 4, 10), joints=hardware)
    q, _, tau = moved(arm, model, n)
    return Ground(arm, q, tau, model.base_values(arm))


@cache
def laboratory(name: str, n: int = 15000) -> Ground:
    """A laboratory arm at 250 Hz, with friction and torque noise of 1 %; its offsets are 0."""
    arm, model = laboratory_arm(name, period_s=0.004, torque_law="sampled")
    arm = replace(arm, smoother=Smoother(21, 4, 10))
    q, qd, tau = moved(arm, replace(model, effects=()), n)
    for one in model.effects:
        i = one.index(arm)
        tau[:, i] += one.value * (smooth_sign(qd[:, i]) if one.kind.key == "motor_coulomb" else qd[:, i])
    effects = (*model.effects, *(effect("torque_offset", joint.name) for joint in arm.joints))
    true = np.concatenate([model.base_values(arm), [one.value for one in effects]])
    return Ground(arm, q, tau, true, effects)


def sines(arm: Arm, n: int) -> Cycles:
    """Any motion and any torques: what the rooms make of them is compared, not whether they belong together."""
    rng = np.random.default_rng(arm.n)
    t = 0.3 * arm.period_s * np.arange(n)[:, None]
    i = np.arange(arm.n)
    q = 0.9 * np.sin((9.1 - 0.7 * i) * t + i) + 0.5 * np.cos((17.3 + 1.1 * i) * t)
    theta = q + 0.05 * np.sin((23.0 + 1.7 * i) * t)
    theta = np.where([joint.flexible for joint in arm.joints], theta, q)
    omega = 0.4 * np.sin(t * [5.7, 7.1, 3.3] + [0.0, 1.0, 2.0])
    return Cycles(
        np.arange(n, dtype=np.uint64), q, theta, rng.normal(size=q.shape), omega, np.zeros(n, dtype=np.uint32)
    )

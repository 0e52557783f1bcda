# SPDX-License-Identifier: MIT
"""Differential equations in batch: the paper's second method (docs/theory, "The other two methods").

The equations of motion are linear in the parameters. They need accelerations, which are computed as second differences
of the angles; the noise of those attenuates every estimate by most of its size.
"""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.state import State, absolute
from zygos.errors import ZygosError
from zygos.paper.methods import Record
from zygos.reference.solver import Rows, solve

Floats = NDArray[np.float64]


def columns(arm: Arm, state: State, qdd: Floats, thetadd: Floats, f0d: Floats) -> Floats:
    """Equations of motion per unit parameter, (..., 2N+1, p) [Nm]: N+1 of the bodies, then N of the rotors.

    qdd, thetadd: (..., N) joint accelerations, f0d: (...) that of the base [rad/s^2]. Body i in its absolute angle:
    a_ii f_i' + sum_j a_ij (cos(phi_j - phi_i) f_j' - sin(phi_j - phi_i) f_j^2) + n Im_i+1 thetadd_i+1 + e_i+1 - e_i = 0
    and for i < j likewise b_ij (sin f_j' + cos f_j^2) in row i, -b_ij (sin f_i' + cos f_i^2) in row j, the angle being
    that of the other body from this one; e = k d + b d', d = theta - q; rotor i:
    n Im_i f_i-1' + n^2 Im_i thetadd_i + e_i = n tau_i.
    """
    joints = state.q.shape[-1]
    bodies = joints + 1
    f, fd, phi = state.f, absolute(f0d, qdd), state.phi
    z = np.zeros((*state.q.shape[:-1], joints + bodies, len(arm.parameter_names)))
    for column, (i, j) in enumerate(combinations_with_replacement(range(bodies), 2)):
        if i == j:
            z[..., i, column] = fd[..., i]
            continue
        for this, other in ((i, j), (j, i)):
            between = phi[..., other] - phi[..., this]
            z[..., this, column] = np.cos(between) * fd[..., other] - np.sin(between) * f[..., other] ** 2
    if arm.kinetic == "planar":
        kinetic = bodies * (bodies + 1) // 2
        for column, (i, j) in enumerate(combinations(range(bodies), 2), start=kinetic):
            for this, other, sense in ((i, j, 1.0), (j, i, -1.0)):
                between = phi[..., other] - phi[..., this]
                z[..., this, column] = sense * (np.sin(between) * fd[..., other] + np.cos(between) * f[..., other] ** 2)
    first = len(arm.parameter_names) - 3 * joints
    for i in range(joints):
        inertia, stiffness, damping = (first + 3 * i + offset for offset in range(3))
        rotor = bodies + i
        z[..., i, inertia] = arm.gear_ratios[i] * thetadd[..., i]
        z[..., rotor, inertia] = arm.gear_ratios[i] * fd[..., i] + arm.gear_ratios[i] ** 2 * thetadd[..., i]
        for column, value in ((stiffness, state.theta - state.q), (damping, state.thetad - state.qd)):
            z[..., i, column] = value[..., i]
            z[..., i + 1, column] = -value[..., i]
            z[..., rotor, column] = value[..., i]
    return z


def regressor(arm: Arm, record: Record, exact: bool = False) -> tuple[Floats, Floats]:
    """Design (B, m, p) and right side (B, m) [Nm] at the inner instants, equations of one instant together.

    exact: rates and accelerations are the record's own, at all instants but the last, whose torque is unknown.
    Otherwise accelerations are second differences of the angles and central differences of the gyro, rates central
    differences. A second difference weights the steps before and after the instant equally, so the torque is the mean
    of both.
    """
    if exact:
        qd, thetad, qdd, thetadd, f0d = record.qd, record.thetad, record.qdd, record.thetadd, record.f0d
        if qd is None or thetad is None or qdd is None or thetadd is None or f0d is None:
            raise ZygosError("what is wrong: the record has no exact accelerations; remedy: use a simulated record")
        state = State(record.q, record.theta, qd, thetad, record.f0)
        return _flat(arm, columns(arm, state, qdd, thetadd, f0d)[:, :-1], record.tau[:, :-1])
    if record.q.shape[1] < 3:
        raise ZygosError("what is wrong: fewer than three samples have no second difference; remedy: a longer record")
    h = arm.period_s
    inner = State(
        q=record.q[:, 1:-1],
        theta=record.theta[:, 1:-1],
        qd=_first(record.q, h),
        thetad=_first(record.theta, h),
        base=record.f0[:, 1:-1],
    )
    z = columns(arm, inner, _second(record.q, h), _second(record.theta, h), _first(record.f0, h))
    return _flat(arm, z, 0.5 * (record.tau[:, 1:-1] + record.tau[:, :-2]))


def _flat(arm: Arm, z: Floats, tau: Floats) -> tuple[Floats, Floats]:
    """The equations of all instants below one another, with their right sides."""
    u = arm.gear_ratios * tau
    right = np.concatenate([np.zeros((*u.shape[:2], arm.n + 1)), u], axis=-1)
    return z.reshape(z.shape[0], -1, z.shape[-1]), right.reshape(right.shape[0], -1)


def estimate(arm: Arm, record: Record, *, exact: bool = False) -> Floats:
    """Estimates of all parameters, (B, p); see regressor(). Raises Undecided if a record does not determine them."""
    z, w = regressor(arm, record, exact)
    return np.stack([solve(Rows.exact(zb, wb)).x for zb, wb in zip(z, w, strict=True)])


def _first(x: Floats, h: float) -> Floats:
    return np.asarray((x[:, 2:] - x[:, :-2]) / (2.0 * h), dtype=np.float64)


def _second(x: Floats, h: float) -> Floats:
    return np.asarray((x[:, 2:] - 2.0 * x[:, 1:-1] + x[:, :-2]) / h**2, dtype=np.float64)

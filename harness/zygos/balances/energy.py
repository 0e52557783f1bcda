# SPDX-License-Identifier: MIT
"""Rows of the energy balance over whole records (docs/theory.md, "The energy balance").

Within an arc, an unbroken run of instants, z_k . pi - W_k is an unknown constant: z_k holds the columns of the kinetic
energy, of the springs' energy and of the dissipation, W_k is the work of the motors since the arc's origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.arcs import FILL_INSTANTS, End, arc_cycles, left_out_arcs, spans, void_arcs, without_row
from zygos.balances.effects import effect_columns
from zygos.balances.kinematics import body_columns
from zygos.balances.quadrature import step_integrals
from zygos.balances.state import State
from zygos.effects import Effect
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class EnergyRows:
    """Rows at every instant from the first arc's origin of each segment on; m instants, p parameters.

    index: (m,) position of the instant in the record of samples. sync: (m,) cycle number. arc: (m,) arc number from 0.
    accepted: (m,) False where the smoother refuses the instant. z: (m, p) columns in `arm.parameter_names` order, then
    those of the effects.
    w: (m,) work since the arc's origin [J], raised by what torque steps add to the kinetic energy as it is read.
    walk: (m,) variance that the noise of the torques adds to the work since the instant before [J^2].
    void: numbers of the arcs in which cycles may be missing unnoticed. left_out: of those that the library left out.
    """

    index: NDArray[np.int64]
    sync: NDArray[np.uint64]
    arc: NDArray[np.int64]
    accepted: NDArray[np.bool_]
    z: Floats
    w: Floats
    walk: Floats
    void: frozenset[int] = frozenset()
    left_out: frozenset[int] = frozenset()


@dataclass(frozen=True)
class DriveColumns:
    """Columns of drives in a balance: of all N (..., N) in that of the energy, of one (..., m) in that of its motor's
    impulse."""

    rotor: Floats
    """Of the rotor's inertia, as far as the rotor alone turns."""
    coupling: Floats
    """Of the rotor's inertia, for what its spin shares with the rotation of the body that carries it."""
    spring: Floats
    damper: Floats


def drive_energy_columns(arm: Arm, state: State, carried: Floats, dissipated: Floats) -> DriveColumns:
    """Columns of rotors, springs and dampers (Nanos & Papadopoulos eqs. (11), (37)).

    carried: (..., N) rate of the carrying body about each joint's axis [rad/s]. dissipated: as of `energy_columns`.
    """
    spin = arm.gear_ratios * state.thetad
    return DriveColumns(0.5 * spin**2, spin * carried, 0.5 * (state.theta - state.q) ** 2, dissipated)


def step_work(arm: Arm, theta: Floats, tau: Floats) -> Floats:
    """Work of all motors over each step [J], (..., m-1), of torques (..., m, N) that are held: n tau_k-1 (theta_k -
    theta_k-1)."""
    total: Floats = np.sum(arm.gear_ratios * tau[..., :-1, :] * np.diff(theta, axis=-2), axis=-1)
    return total


def step_variance(arm: Arm, theta: Floats, tau: Floats) -> Floats:
    """Variance of `step_work` by the noise of the torques [J^2], (..., m-1): the declared noise, at least that of the
    steps of a torque frame, and a share of the torque, which is drawn anew in each period."""
    own = np.array([joint.over_the_wire.torque_sigma for joint in arm.joints])
    share = np.array([joint.torque_relative_sigma for joint in arm.joints]) * tau[..., :-1, :]
    total: Floats = np.sum((arm.gear_ratios * np.hypot(own, share) * np.diff(theta, axis=-2)) ** 2, axis=-1)
    return total


def torque_jump_energy(arm: Arm, thetad: Floats, before: Floats, after: Floats) -> Floats:
    """What a torque that jumps adds to the kinetic energy as it is read [J], (...), from torques (..., N) [Nm]."""
    total: Floats = arm.held_s * np.sum(arm.gear_ratios * (after - before) * thetad, axis=-1)
    return total


def energy_columns(arm: Arm, state: State, dissipated: Floats) -> Floats:
    """Columns of the energy balance, shape (..., p), in `arm.parameter_names` order.

    dissipated: (..., N) integral of (thetad - qd)^2 [rad^2/s]. Nanos & Papadopoulos eq. (37), with the ratio of
    eq. (11).
    """
    return arm.structure.reduced(full_energy_columns(arm, state, dissipated))


def full_energy_columns(arm: Arm, state: State, dissipated: Floats) -> Floats:
    """The same of all `arm.full_parameters`, shape (..., p_full)."""
    bodies, carried = body_columns(arm, state)
    own = drive_energy_columns(arm, state, carried, dissipated)
    of_joint = {"Im": own.rotor + own.coupling, "k": own.spring, "b": own.damper}
    joints = [of_joint[kind][..., i] for kind, i in arm.full_joint_parameters]
    return np.concatenate([bodies, np.stack(joints, axis=-1)] if joints else [bodies], axis=-1)


def energy_rows(arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect] = ()) -> EnergyRows:
    """Rows of a whole record, with a column for each of the effects that `zygos.effects.estimated` names.

    Work of a step: n tau_k-1 (theta_k - theta_k-1), exact for a torque held over the step. Dissipation of a step:
    that of the cubic through the four newest values of (thetad - qd)^2.

    Under a held torque the slope of a smooth curve through the samples is h^2/12 da/dt above the true rate, so the
    kinetic energy reads h/12 n (tau_k - tau_k-1) thetad_k too high; the work of the row is raised by as much.

    A void cycle makes those arcs before it void that reach beyond the last cycle that can be trusted, or the arc that
    it ends where that cycle is not known.
    """
    h = arm.period_s
    longest, without = arc_cycles(arm), without_row(arm, samples, smoothed, "energy")
    work = np.zeros(len(smoothed.index))
    walk = np.zeros_like(work)
    dissipated = np.zeros_like(smoothed.q)
    arc = np.full(len(smoothed.index), -1, dtype=np.int64)
    arcs = 0
    ends: list[End] = []
    for number in np.unique(smoothed.segment):
        of = np.flatnonzero(smoothed.segment == number)
        if len(of) <= FILL_INSTANTS:
            continue
        theta = smoothed.theta[of]
        tau = samples.tau[smoothed.index[of]]
        g = (smoothed.thetad[of] - smoothed.qd[of]) ** 2
        done, spread = step_work(arm, theta, tau), step_variance(arm, theta, tau)
        jumps = torque_jump_energy(arm, smoothed.thetad[of[1:]], tau[:-1], tau[1:])
        step_loss = step_integrals(g, h, axis=0)
        for origin, stop, ended in spans(smoothed.accepted[of], longest, without[of]):
            work[of[origin + 1 : stop]] = np.cumsum(done[origin : stop - 1])
            walk[of[origin + 1 : stop]] = spread[origin : stop - 1]
            work[of[origin:stop]] += jumps[origin - 1 : stop - 1]
            dissipated[of[origin + 1 : stop]] = np.cumsum(step_loss[origin : stop - 1], axis=0)
            arc[of[origin:stop]] = arcs
            ends.append(End(int(smoothed.index[of[stop - 1]]) + arm.smoother.lag, ended))
            arcs += 1
    z = np.hstack(
        [
            energy_columns(arm, State.smoothed(arm, smoothed), dissipated),
            effect_columns(arm, samples, smoothed, arc, effects),
        ]
    )
    kept = arc >= 0
    return EnergyRows(
        index=smoothed.index[kept],
        sync=smoothed.sync[kept],
        arc=arc[kept],
        accepted=smoothed.accepted[kept],
        z=z[kept],
        w=work[kept],
        walk=walk[kept],
        void=void_arcs(samples, ends),
        left_out=left_out_arcs(samples, ends, "energy"),
    )

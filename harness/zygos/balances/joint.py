# SPDX-License-Identifier: MIT
"""Rows of the joints' momentum over whole records (docs/theory.md, "Joint rows").

For the link angle q_j the generalised momentum is p_j = dT/dq'_j, and from t_a to t_b

    p_j(t_b) - p_j(t_a) - int (dT/dq_j - dV/dq_j) dt - (torque of the spring, integrated) + (losses, integrated)
        = n_j int tau_j dt where the joint is rigid, 0 where it is flexible: the motor's torque acts on its rotor there.

It is linear in the same parameters as the energy, and needs no acceleration. There is a row for each joint where the
energy has one. The rotor of a rigid joint turns with its link, so that its impulse balance is part of this row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.arcs import FILL_INSTANTS
from zygos.balances.effects import Signals, joint_column
from zygos.balances.kinematics import Posture, body_rates, crossed, planar_rates, posture
from zygos.balances.quadrature import FromOrigin, step_integrals
from zygos.balances.state import State
from zygos.effects import Effect, estimated
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class JointColumns:
    """Columns of the bodies, and the shares of the rotors, in momentum and force of each joint; N joints, B parameters
    of bodies (`arm.full_body_names`)."""

    momentum: Floats
    """(..., N, B) those of dT/dq'_j."""
    force: Floats
    """(..., N, B) those of dT/dq_j - dV/dq_j."""
    rotor_momentum: Floats
    """(..., N, N) of joint j (first) per unit of the inertia of rotor i (second)."""
    rotor_force: Floats
    """(..., N, N) likewise."""


def in_order(arm: Arm, bodies: Floats, rotors: Floats, joints: dict[str, Floats] | None = None) -> Floats:
    """(..., N, p) columns in the order of `arm.parameter_names`, from those of bodies (..., N, B) and of rotors
    (..., N, N). joints: those of springs "k" and dampers "b", (..., N, N); without them 0."""
    of_joint = {"Im": rotors} | (joints or {})
    none = np.zeros_like(rotors[..., 0])
    listed = [of_joint[kind][..., i] if kind in of_joint else none for kind, i in arm.full_joint_parameters]
    return arm.structure.reduced(np.concatenate([bodies, np.stack(listed, axis=-1)] if listed else [bodies], axis=-1))


def joint_columns(arm: Arm, state: State) -> JointColumns:
    """Columns of momentum and force at states with any leading axes."""
    places = posture(arm, state.q) if arm.spatial or any(arm.feels_gravity) else None
    momentum, force = _spatial(arm, state, places) if arm.spatial else _planar(arm, state)
    if places is not None and any(arm.feels_gravity):
        turned = _turned(places.axis, places.direction, places.body)
        pull = turned @ np.array(arm.gravity)
        force = np.concatenate([force, pull[..., np.repeat(arm.feels_gravity, 2)]], axis=-1)
        momentum = np.concatenate([momentum, np.zeros_like(force[..., momentum.shape[-1] :])], axis=-1)
    rotor_momentum, rotor_force = _rotors(arm, state, places)
    return JointColumns(momentum, force, rotor_momentum, rotor_force)


def gravity_forces(arm: Arm, state: State, moments: Floats) -> Floats:
    """(..., N, 3) forces -dV/dq_j of a gravity of 1 m/s^2 along each axis of the base, Nm, on an arm on a fixed base.

    moments: (2N,) first moments of all bodies, u and v of each, kg m, whether the gravity of the arm file moves them or
    not.
    """
    places = posture(arm, state.q)
    return np.asarray(np.einsum("...jvk,v->...jk", _turned(places.axis, places.direction, places.body), moments))


def _turned(axis: Floats, direction: Floats, body: NDArray[np.int64]) -> Floats:
    """(..., N, V, 3): z_j x d for every direction of a body that joint j carries, otherwise 0."""
    carried = body[None, :] > np.arange(axis.shape[-2])[:, None]
    return crossed(axis[..., :, None, :], direction[..., None, :, :]) * carried[..., None]


def momentum_of_rates(arm: Arm, q: Floats, rates: Floats) -> Floats:
    """(..., N, p) columns of the joints' momentum at angles q (..., N) and link rates (..., N), of an arm with rigid
    joints on a fixed base. They are linear in the rates."""
    state = State(q, q, rates, rates, np.zeros((*q.shape[:-1], 3)) if arm.spatial else np.zeros(q.shape[:-1]))
    places = posture(arm, q) if arm.spatial else None
    momentum = _spatial(arm, state, places, forces=False)[0] if arm.spatial else _planar(arm, state)[0]
    still = np.zeros((*momentum.shape[:-1], 2 * sum(arm.feels_gravity)))
    return in_order(arm, np.concatenate([momentum, still], axis=-1), _rotors(arm, state, places)[0])


def _spatial(arm: Arm, state: State, places: Posture | None, forces: bool = True) -> tuple[Floats, Floats]:
    """Kinetic columns (..., N, K) of a spatial arm: where joint j turns by a small angle, everything beyond it turns
    with it, and its rate vectors change by z_j x v - (z_j x w_j) x d. Without forces the second are empty."""
    places = posture(arm, state.q) if places is None else places
    omega0 = state.base if arm.free else np.zeros((*state.q.shape[:-1], 3))
    omega = body_rates(omega0, places.axis, state.qd)
    rate = crossed(omega[..., places.body, :], places.direction)
    momentum = _products(arm, _turned(places.axis, places.direction, places.body), rate)
    if not forces:
        return momentum, np.zeros(0)
    swung = crossed(places.axis, omega[..., 1:, :])[..., :, None, :]
    carried = places.body[None, :] > np.arange(arm.n)[:, None]
    by_angle = crossed(places.axis[..., :, None, :], rate[..., None, :, :]) - crossed(
        swung, places.direction[..., None, :, :]
    )
    return momentum, _products(arm, by_angle * carried[..., None], rate)


def _products(arm: Arm, change: Floats, rate: Floats) -> Floats:
    """What changes (..., N, V, 3) of the rate vectors (..., V, 3) make of the kinetic columns, (..., N, K)."""
    count = rate.shape[-2]
    first, second = np.triu_indices(count)
    dots = change @ np.swapaxes(rate, -1, -2)[..., None, :, :]
    kept = np.ones(len(first), dtype=np.bool_) if arm.free else (first != second) | (first > 1)
    if not arm.free:
        # as in `spatial_columns`: the first body turns about its axis only
        kept &= (first > 0) | (second != 1)
        kept[0] = True
    first, second = first[kept], second[kept]
    dots = dots.reshape(*dots.shape[:-2], count * count)
    both = np.take(dots, first * count + second, axis=-1) + np.take(dots, second * count + first, axis=-1)
    return np.asarray(both * np.where(first == second, 0.5, 1.0), dtype=np.float64)


def _planar(arm: Arm, state: State) -> tuple[Floats, Floats]:
    """Kinetic columns (..., N, K) of a planar arm, where joint j adds its rate and angle to those of all bodies beyond
    it."""
    begin = 0 if arm.free else 1
    f, phi = planar_rates(arm, state), state.phi
    a, b = np.triu_indices(arm.n + 1 - begin)
    a, b = a + begin, b + begin
    joint = np.arange(arm.n)[:, None]
    has_a, has_b = 1.0 * (a > joint), 1.0 * (b > joint)  # (N, K): body i is carried by the joints before it
    half = np.where(a == b, 0.5, 1.0)
    angle = phi[..., b] - phi[..., a]
    cosine, sine = np.cos(angle)[..., None, :], np.sin(angle)[..., None, :]
    rates = (has_a * f[..., None, b] + has_b * f[..., None, a]) * half
    swings = (has_b - has_a) * (f[..., a] * f[..., b])[..., None, :] * half
    momentum, force = rates * cosine, -swings * sine
    if arm.kinetic == "planar":
        momentum = np.concatenate([momentum, (rates * sine)[..., a < b]], axis=-1)
        force = np.concatenate([force, (swings * cosine)[..., a < b]], axis=-1)
    return momentum, force


def _rotors(arm: Arm, state: State, places: Posture | None = None) -> tuple[Floats, Floats]:
    """Shares of rotors (..., N, N): of the energy n theta'_i a_i . w_(i-1) of each, and of all the energy of the rotor
    of a rigid joint, which turns with its link."""
    spin = arm.gear_ratios * state.thetad
    rigid = np.array([not joint.flexible for joint in arm.joints])
    before = np.arange(arm.n)[:, None] < np.arange(arm.n)[None, :]
    if arm.spatial:
        axis = (posture(arm, state.q) if places is None else places).axis
        omega0 = state.base if arm.free else np.zeros((*state.q.shape[:-1], 3))
        omega = body_rates(omega0, axis, state.qd)
        carried = np.sum(axis * omega[..., :-1, :], axis=-1)
        along = np.einsum("...jk,...ik->...ji", axis, axis)
        turned = crossed(axis[..., :, None, :], axis[..., None, :, :])
        swung = np.einsum("...jik,...jk->...ji", turned, omega[..., 1:, :])
    else:
        carried = planar_rates(arm, state)[..., :-1]
        along = np.ones((*spin.shape[:-1], arm.n, arm.n))
        swung = np.zeros_like(along)
    momentum = along * spin[..., None, :] * before
    own = arm.gear_ratios * (spin + carried) * rigid
    momentum = momentum + own[..., None, :] * np.eye(arm.n)
    return momentum, swung * spin[..., None, :] * before


@dataclass(frozen=True)
class JointRows:
    """Rows of m increments of N joints with p columns: those of `arm.parameter_names`, then those of the effects.

    z . parameters = w up to noise. Neighbouring increments share half of their time.
    """

    z: Floats
    """(m, N, p)"""
    w: Floats
    """(m, N) impulse of the motor, after the gear [Nms]; 0 where the joint is flexible."""
    begin: NDArray[np.int64]
    """(m,) position of the first instant of each increment among the smoothed instants."""
    end: NDArray[np.int64]
    """(m,) position of its last instant."""
    accepted: NDArray[np.bool_]
    """(m,) False where the smoother refuses an instant of the increment."""
    segment: NDArray[np.int64]
    """(m,) number of the unbroken segment of the record."""

    @property
    def count(self) -> int:
        """Number of increments."""
        return len(self.begin)


def increment_instants(arm: Arm, increment_s: float) -> int:
    """Steps of an increment, even and at least 2."""
    return 2 * max(1, round(0.5 * increment_s / arm.period_s))


def joint_rows(
    arm: Arm,
    samples: Samples,
    smoothed: Smoothed,
    increment_s: float,
    effects: Sequence[Effect] = (),
    columns: JointColumns | None = None,
    every: int = 1,
) -> JointRows:
    """Rows of a whole record over increments of that length, half overlapping. columns: `joint_columns` at the smoothed
    instants, where they are known; otherwise those of parameters are computed at every so-many-th instant, a divisor of
    half the steps of an increment. Errors: as `estimated`."""
    steps = increment_instants(arm, increment_s) // every
    instants, begins, count = [], [], 0
    for number in np.unique(smoothed.segment):
        of = np.flatnonzero(smoothed.segment == number)[::every]
        places = np.arange(count, count + len(of))[FILL_INSTANTS:]
        begins.append(places[: max(0, len(places) - steps) : steps // 2])
        instants.append(of)
        count += len(of)
    at, place = (np.concatenate(part or [np.zeros(0, dtype=np.int64)]) for part in (instants, begins))
    begin, end = at[place], at[place + steps]
    state = State.smoothed(arm, smoothed if every == 1 else smoothed.part(at))
    columns = joint_columns(arm, state) if columns is None else columns

    def integrated(g: Floats) -> Floats:
        return np.concatenate([_increments(g, of, steps, every * arm.period_s) for of in begins] or [g[:0]])

    def grown(g: Floats) -> Floats:
        return np.asarray(g[place + steps] - g[place])

    deflection = state.theta - state.q
    single = np.eye(arm.n)
    z = in_order(
        arm,
        grown(columns.momentum) - integrated(columns.force),
        grown(columns.rotor_momentum) - integrated(columns.rotor_force),
        {"k": -integrated(deflection)[..., None] * single, "b": -grown(deflection)[..., None] * single},
    )
    acting = estimated(arm, effects)
    before, after = samples.tau[smoothed.index - 1], samples.tau[smoothed.index]
    if acting:
        state = State.smoothed(arm, smoothed)
        own = [[_effect(arm, state, before, after, e, j, smoothed.segment) for e in acting] for j in range(arm.n)]
        running = np.moveaxis(np.array(own), -1, 0)
        z = np.concatenate([z, running[end] - running[begin]], axis=-1)
    impulse = _impulse(arm, before, after, smoothed.segment)
    refused = np.concatenate([[0], np.cumsum(~smoothed.accepted)])
    return JointRows(
        z=z,
        w=impulse[end] - impulse[begin],
        begin=begin,
        end=end,
        accepted=refused[end + 1] == refused[begin],
        segment=smoothed.segment[begin],
    )


def _increments(g: Floats, begin: NDArray[np.int64], steps: int, period_s: float) -> Floats:
    """(n, ...) integrals of g (m, ...) over so many steps from each instant of begin (n,), at even intervals, by
    `step_integrals`, whose first step also needs the two instants before it."""
    if len(begin) == 0:
        return g[:0]
    weights = step_integrals(np.eye(steps + 3), period_s)[:, 2:].sum(axis=1)
    windows = sliding_window_view(g.reshape(len(g), -1), steps + 3, axis=0)
    grown = windows[begin[0] - 2 : begin[-1] - 1 : steps // 2] @ weights
    return np.asarray(grown, dtype=np.float64).reshape(len(begin), *g.shape[1:])


def _impulse(arm: Arm, before: Floats, after: Floats, segment: NDArray[np.int64]) -> Floats:
    """(m, N) impulse of the motors of rigid joints, after the gear, with what its end needs (`Arm.impulse_s`)."""
    rigid = np.array([not joint.flexible for joint in arm.joints])
    total = np.zeros_like(after)
    for number in np.unique(segment):
        of = np.flatnonzero(segment == number)
        total[of[1:]] = np.cumsum(after[of[:-1]], axis=0)
    jump = np.where(np.isfinite(before), after - before, 0.0)
    return np.asarray(rigid * arm.gear_ratios * (arm.period_s * total + arm.impulse_s * jump), dtype=np.float64)


def _effect(
    arm: Arm, state: State, before: Floats, after: Floats, effect: Effect, joint: int, segment: NDArray[np.int64]
) -> Floats:
    """(m,) running column of an effect in the rows of a joint; 0 of an effect at another joint."""
    if effect.index(arm) != joint:
        return np.zeros(len(before))
    signals = Signals.of(arm, state, before, after, joint, FromOrigin(arm.period_s, segment))
    return joint_column(effect.kind, signals, arm.joints[joint].flexible, effect.shape)

# SPDX-License-Identifier: MIT
"""Rows of a floating arm's angular momentum over whole records (docs/theory.md, "Momentum").

Within an arc, z_k . pi is an unknown constant: the angular momentum about the mass centre, along the axis of a planar
arm, in the axes that the base had at the arc's origin of a spatial one.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.balances.arcs import MIN_ARC_INSTANTS, numbered, unused, without_row
from zygos.balances.kinematics import Posture, body_rates, by_component, crossed, planar_columns, posture
from zygos.balances.quadrature import step_integrals
from zygos.balances.state import State
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed, coefficients

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RateVariances:
    """Variances of the smoothed rates [rad^2/s^2].

    link: (N,). base: about each axis. rotor: (N,) of the motors, 0 where a joint is rigid and its rotor turns with the
    link.
    """

    link: Floats
    base: float
    rotor: Floats


@dataclass(frozen=True)
class Turns:
    """Accepted rows whose turn it was, less the mean of their component in their arc; m rows.

    names: of the columns. z: (m, K + N). arc: (m,) its number. noise: (arcs, K + N, K + N) that the squares of the rows
    of each arc hold on average.
    """

    names: tuple[str, ...]
    z: Floats
    arc: NDArray[np.int64]
    noise: Floats


def momentum_columns(arm: Arm, state: State, places: Posture | None = None, attitude: Floats | None = None) -> Floats:
    """Columns (..., r, K + N) of the K kinetic parameters and of Im_1 .. Im_N in base axes; r is 3 in space, else 1.

    Of N_ab: rho_a x v_b, and rho_b x v_a where a and b differ; of Im_i: n thetad times the axis. In a plane the first
    are `planar_columns` of the sums of two rates. places: the posture, where it is known. attitude: (..., 3, 3) from
    base axes to those in which the columns are stated instead, in space.
    """
    spin = arm.gear_ratios * state.thetad
    if not arm.spatial:
        return np.concatenate([planar_columns(arm, state, np.add), spin], axis=-1)[..., None, :]
    places = posture(arm, state.q) if places is None else places
    rate = crossed(body_rates(state.base, places.axis, state.qd)[..., places.body, :], places.direction)
    # the vectors are turned, which are fewer than the columns; whole rows of one component and direction are copied
    # many times faster than entries
    directions, rates, axes = (_turned(by_component(x), attitude) for x in (places.direction, rate, places.axis))
    first, second = np.triu_indices(len(places.body))
    apart = first != second
    out = np.empty((*state.q.shape[:-1], 3, len(first) + arm.n))
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        x, y, vx, vy = directions[i], directions[j], rates[i], rates[j]
        own = x[first] * vy[second] - y[first] * vx[second]
        own[apart] += x[second[apart]] * vy[first[apart]] - y[second[apart]] * vx[first[apart]]
        out[..., k, : len(first)] = np.moveaxis(own, 0, -1)
        out[..., k, len(first) :] = np.moveaxis(axes[k], 0, -1) * spin
    return out


def _turned(vectors: Floats, attitude: Floats | None) -> Floats:
    """(3, V, ...) vectors in other axes; attitude: (..., 3, 3)."""
    if attitude is None:
        return vectors
    turn = np.moveaxis(attitude, (-2, -1), (0, 1))
    return np.stack([row[0] * vectors[0] + row[1] * vectors[1] + row[2] * vectors[2] for row in turn])


def base_attitudes(arm: Arm, smoothed: Smoothed, arc: NDArray[np.int64]) -> Floats:
    """(m, 3, 3) rotation from base axes to those that the base had at the origin of the arc; identity where there is no
    arc.

    A step turns by the integral of the cubic through the four newest rates, and by what two rates that do not line up
    add: h^2/12 omega_k-1 x omega_k (Bortz 1971, to second order).
    """
    h, omega = arm.period_s, smoothed.omega
    step = step_integrals(omega, h, axis=0) + h * h / 12.0 * np.cross(omega[:-1], omega[1:])
    turn = Rotation.from_rotvec(step).as_matrix() if len(step) else np.zeros((0, 3, 3))
    out = np.tile(np.eye(3), (len(arc), 1, 1))
    for k in np.flatnonzero((arc[1:] >= 0) & (arc[1:] == arc[:-1])) + 1:
        out[k] = out[k - 1] @ turn[k - 1]
    return out


def momentum_rows(arm: Arm, smoothed: Smoothed, arc: NDArray[np.int64]) -> Floats:
    """Rows (m, r, K + N) at m smoothed instants. arc: (m,) number of the arc of each, -1 for none."""
    z = momentum_columns(arm, State.smoothed(arm, smoothed))
    return base_attitudes(arm, smoothed, arc) @ z if arm.spatial else z


def variances(arm: Arm) -> RateVariances:
    """The declared noise of encoders and gyro, over the wire, through the smoother."""
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s

    def size(latch_us: float, derivative: int) -> float:
        weights = coefficients(points, order, -1e-6 * latch_us / h, derivative) / h**derivative
        return float(weights @ weights)

    link, rotor = [], []
    for joint in arm.joints:
        encoder, motor = joint.link_encoder, joint.motor_encoder  # one and the same where the joint is rigid
        link.append(encoder.over_the_wire.sigma_rad**2 * size(joint.latch_us + encoder.latch_us, 1))
        own = motor.over_the_wire.sigma_rad**2 * size(joint.latch_us + motor.latch_us, 1)
        rotor.append(own if joint.flexible else 0.0)
    gyro = arm.imu.over_the_wire.rate_sigma**2 * size(arm.imu.latch_us, 0)
    return RateVariances(np.array(link), gyro, np.array(rotor))


def momentum_noise(arm: Arm, smoothed: Smoothed) -> Floats:
    """What the noise of the rates adds to z' z of the rows of each of m instants on average, (m, K + N, K + N).

    That of the angles and of the attitude is left out.
    """
    size, of_rate, of_rotor = _derivatives(arm, smoothed)
    total: Floats = np.einsum("s,mskp,mskq->mpq", size, of_rate, of_rate)
    total += np.einsum("mikp,mikq->mpq", of_rotor, of_rotor)
    return total


def turns(arm: Arm, samples: Samples, smoothed: Smoothed) -> Turns | None:
    """The rows of a whole record whose turn it was; None if the arm switches them off.

    The components take turns, and so do the sensors whose noise acts on them; each component has a constant of its own
    in each arc. Arcs in which cycles may be missing, or with fewer than MIN_ARC_INSTANTS accepted instants, are left
    out.
    """
    if arm.momentum_arc_s == 0.0:
        return None
    longest = max(1, round(arm.momentum_arc_s / arm.period_s))
    arc = numbered(smoothed, longest, without_row(arm, samples, smoothed, "momentum"))
    void = unused(arm, samples, smoothed, arc, longest, "momentum")
    every, turn = momentum_rows(arm, smoothed, arc), base_attitudes(arm, smoothed, arc)
    count = every.shape[1]
    z, numbers, noise = [every[:0, 0]], [arc[:0]], [np.zeros((0, every.shape[2], every.shape[2]))]
    for number in range(int(arc.max(initial=-1)) + 1):
        of = np.flatnonzero(arc == number)
        place = np.flatnonzero(smoothed.accepted[of])
        if len(place) < MIN_ARC_INSTANTS or number in void:
            continue
        own = every[of[place], place % count]
        for k in np.unique(place % count):
            own[place % count == k] -= own[place % count == k].mean(axis=0)
        z.append(own)
        numbers.append(np.full(len(own), number))
        noise.append(_noise_in_turns(arm, _at(smoothed, of[place]), turn[of[place]], place)[None])
    names = arm.full_body_names + tuple(f"Im{i + 1}" for i in range(arm.n))
    return Turns(names, np.concatenate(z), np.concatenate(numbers), np.concatenate(noise))


def _noise_in_turns(arm: Arm, smoothed: Smoothed, turn: Floats, place: NDArray[np.int64]) -> Floats:
    """(K + N, K + N) in the sum over instants at these places of an arc, whose attitudes are turn (m, 3, 3)."""
    size, of_rate, of_rotor = _derivatives(arm, smoothed)
    if not arm.compensation:
        return np.zeros((of_rate.shape[-1],) * 2)
    every, count = np.arange(len(place)), of_rate.shape[2]
    signal = place // count % len(size)
    slopes = of_rate[every, signal]
    lines = (turn @ slopes if arm.spatial else slopes)[every, place % count]
    rotors = np.einsum("mikp,mikq->pq", of_rotor, of_rotor) / count
    total: Floats = len(size) * (lines.T * size[signal]) @ lines + rotors
    return total


def _at(smoothed: Smoothed, instants: NDArray[np.int64]) -> Smoothed:
    """Some of them."""
    return replace(smoothed, **{one.name: getattr(smoothed, one.name)[instants] for one in fields(smoothed)})


def _derivatives(arm: Arm, smoothed: Smoothed) -> tuple[Floats, Floats, Floats]:
    """Variances (S,) of the rates of links and base, rows (m, S, r, K + N) in base axes for a unit of each, and rows
    (m, N, r, K + N) for a standard deviation of each rotor's rate.

    The columns are linear in the rates, so those of a unit rate are their derivatives.
    """
    state, variance = State.smoothed(arm, smoothed), variances(arm)
    still = replace(state, **{name: np.zeros_like(getattr(state, name)) for name in ("qd", "thetad", "base")})
    links, rotors = [], []
    for i, joint in enumerate(arm.joints):
        unit = np.zeros_like(state.qd)
        unit[..., i] = 1.0
        links.append(momentum_columns(arm, replace(still, qd=unit, thetad=unit * (not joint.flexible))))
        rotors.append(np.sqrt(variance.rotor[i]) * momentum_columns(arm, replace(still, thetad=unit)))
    axes = np.eye(3) if arm.spatial else np.ones(1)
    bases = [momentum_columns(arm, replace(still, base=np.broadcast_to(axis, state.base.shape))) for axis in axes]
    size = np.concatenate([variance.link, np.full(len(bases), variance.base)])
    return size, np.stack([*links, *bases], axis=-3), np.stack(rotors, axis=-3)

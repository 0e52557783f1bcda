# SPDX-License-Identifier: MIT
"""Rate vectors and the columns that bodies have in the balance (docs/theory.md, "Kinetic energy, in closed form").

In space, body i stands at R_i relative to the base and turns at omega_i, all in base axes. Its directions are the two
vectors R_i P_i across its joint axis, those of the base its three axes; a direction d of body i has the rate vector
v = omega_i x d, and the kinetic energy of the bodies is 1/2 sum_ab N_ab v_a . v_b.

Planar arm, all axes parallel: body i turns at f_i about the common axis and stands at phi_i relative to the base.
With v_i = f_i (cos phi_i, sin phi_i) the kinetic energy of the bodies is 1/2 sum_ij a_ij v_i . v_j, and for an arm
whose centres of mass lie off the joint-to-joint lines also sum_i<j b_ij v_i x v_j.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm, across
from zygos.balances.state import State, absolute

Floats = NDArray[np.float64]


def planar_columns(arm: Arm, state: State, of_rates: Callable[[Floats, Floats], Floats]) -> Floats:
    """Columns (..., K) of a_ij, then of b_ij where the arm has them: of_rates(f_i, f_j) times the cosine, or the sine,
    of phi_j - phi_i; half of it where i = j.

    With np.multiply those of the kinetic energy. With np.add those of the angular momentum, which is the derivative of
    the kinetic energy with respect to all rates together.
    """
    first = 0 if arm.free else 1
    f, phi = planar_rates(arm, state), state.phi
    i, j = np.triu_indices(arm.n + 1 - first)
    i, j = i + first, j + first
    rates, angle = of_rates(f[..., i], f[..., j]) * np.where(i == j, 0.5, 1.0), phi[..., j] - phi[..., i]
    columns: Floats = rates * np.cos(angle)
    if arm.kinetic == "planar":
        columns = np.concatenate([columns, (rates * np.sin(angle))[..., i < j]], axis=-1)
    return columns


def planar_rates(arm: Arm, state: State) -> Floats:
    """Absolute rates f (..., N+1) of a planar arm's bodies, rad/s; that of a fixed base is 0."""
    return state.f if arm.free else absolute(np.zeros(state.q.shape[:-1]), state.qd)


@dataclass(frozen=True)
class Posture:
    """Attitudes relative to the base, in base axes; V directions (3 of a free base, 2 of each other body).

    attitude: (..., N+1, 3, 3). axis: (..., N, 3) joint axes. direction: (..., V, 3). body: (V,) whose they are.
    """

    attitude: Floats
    axis: Floats
    direction: Floats
    body: NDArray[np.int64]


def posture(arm: Arm, q: Floats) -> Posture:
    """Where everything points at the joint angles q (..., N) [rad]."""
    attitude = [np.broadcast_to(np.eye(3), (*q.shape[:-1], 3, 3))]
    axes: list[Floats] = []
    directions = [attitude[0]] if arm.free else []
    body = [0, 0, 0] if arm.free else []
    cosine, sine = (x[..., None, None] for x in (np.cos(q), np.sin(q)))
    for i, joint in enumerate(arm.joints):
        axis = np.array(joint.axis)
        mount = Rotation.from_euler("xyz", joint.frame_rpy).as_matrix()
        # Rodrigues' formula: what stays of a rotation about the axis, and the parts of its cosine and sine
        along = np.outer(axis, axis)
        still, even, odd = (mount @ part for part in (along, np.eye(3) - along, np.cross(np.eye(3), axis)))
        attitude.append(attitude[-1] @ (still + cosine[..., i, :, :] * even + sine[..., i, :, :] * odd))
        axes.append(attitude[-1] @ axis)
        directions.append(np.swapaxes(attitude[-1] @ across(axis), -1, -2))
        body += [i + 1, i + 1]
    return Posture(
        np.stack(attitude, axis=-3), np.stack(axes, axis=-2), np.concatenate(directions, axis=-2), np.array(body)
    )


def crossed(a: Floats, b: Floats) -> Floats:
    """a x b of vectors (..., 3); np.cross takes twice as long."""
    shape = np.broadcast_shapes(a.shape, b.shape)
    out = np.empty(shape)
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.subtract(a[..., i] * b[..., j], a[..., j] * b[..., i], out=out[..., k])
    return out


def body_rates(omega0: Floats, axis: Floats, qd: Floats) -> Floats:
    """omega_i of all bodies, shape (..., N+1, 3), from omega0 (..., 3), joint axes (..., N, 3) and rates (..., N)."""
    return np.concatenate([omega0[..., None, :], omega0[..., None, :] + np.cumsum(axis * qd[..., None], -2)], axis=-2)


def body_columns(arm: Arm, state: State, places: Posture | None = None) -> tuple[Floats, Floats]:
    """Columns (..., B) of `arm.full_body_names`, and the rates (..., N) of the carrying bodies about the joint axes.

    A column of a first moment is -g . (R_i P_i), the potential energy it has. places: the posture, where it is known.
    """
    if arm.spatial:
        places = posture(arm, state.q) if places is None else places
        omega0 = state.base if arm.free else np.zeros((*state.q.shape[:-1], 3))
        omega = body_rates(omega0, places.axis, state.qd)
        kinetic = spatial_columns(arm, crossed(omega[..., places.body, :], places.direction))
        carried = np.sum(places.axis * omega[..., :-1, :], axis=-1)
    else:
        kinetic = planar_columns(arm, state, np.multiply)
        carried = planar_rates(arm, state)[..., :-1]
    if any(arm.feels_gravity):
        places = posture(arm, state.q) if places is None else places
        pull = -(places.direction @ np.array(arm.gravity))
        kinetic = np.concatenate([kinetic, pull[..., np.repeat(arm.feels_gravity, 2)]], axis=-1)
    return kinetic, carried


def spatial_columns(arm: Arm, rate: Floats) -> Floats:
    """Columns of N_ab, a <= b, from the rate vectors (..., V, 3) [rad/s].

    With the base fixed, body 1 turns about its axis only: its two rate vectors are of one length and at right angles,
    so N[1u,1u] stands for the sum of both squares' entries, and their product has none.
    """
    first, second = np.triu_indices(rate.shape[-2])
    kept = np.ones(len(first), dtype=np.bool_) if arm.free else (first != second) | (first > 1)
    if not arm.free:
        kept &= (first > 0) | (second != 1)
        kept[0] = True
    first, second = first[kept], second[kept]
    share = np.where(first == second, 0.5, 1.0)
    # whole rows of one component and direction are copied many times faster than entries
    x, y, z = by_component(rate)
    products = x[first] * x[second] + y[first] * y[second] + z[first] * z[second]
    return np.ascontiguousarray(np.moveaxis(products, 0, -1) * share)


def by_component(vectors: Floats) -> Floats:
    """(3, V, ...) of vectors (..., V, 3), copied."""
    return np.ascontiguousarray(np.moveaxis(vectors, (-1, -2), (0, 1)))

# SPDX-License-Identifier: MIT
"""From bodies to the constant matrix of the kinetic energy of a spatial arm (docs/theory.md, "From bodies …").

Every mass point of a body lies at a sum of vectors c_j, each fixed in one body j. The component of c_j along joint axis
j is fixed in body j-1 as well, so it is added to c_j-1. For each body but the base two components remain, along the
directions of `zygos.balances.kinematics`. N_ab is the second moment of the mass over these V coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, across

Array = NDArray[np.float64]


def directions(arm: Arm) -> int:
    """V: 3 directions for a free base and 2 for each other body."""
    return 2 * arm.n + (3 if arm.free else 0)


def folds(arm: Arm) -> list[Array]:
    """For each body 0..N the (V, 3) matrix that maps a vector in its frame to the V coordinates."""
    size = directions(arm)
    fold = np.zeros((size, 3))
    if arm.free:
        fold[:3] = np.eye(3)
    listed = [fold]
    for i, joint in enumerate(arm.joints):
        axis = np.array(joint.axis)
        mount = arm.frames[i].T @ arm.frames[i + 1]
        fold = np.outer(listed[-1] @ mount @ axis, axis)
        place = size - 2 * (arm.n - i)
        fold[place : place + 2] = across(axis).T
        listed.append(fold)
    return listed


def of_bodies(arm: Arm, mass: Array, first: Array, second: Array, reach: Array) -> tuple[Array, Array]:
    """N (V, V), kg m^2, and the first moments (V,), kg m, of bodies that include the rotors they carry.

    mass (N+1,) kg. first (N+1, 3) kg m and second (N+1, 3, 3) kg m^2: moments of the mass about the body's origin.
    reach (N+1, 3) m: the next joint's origin; the last is zero. All in the bodies' frames. With the base fixed the
    reference point is the base, as if its mass were infinite.
    """
    total = mass.sum() if arm.free else np.inf
    beyond = np.append(np.cumsum(mass[::-1])[::-1][1:], 0.0)
    before = np.cumsum(mass) - mass
    pull = first + beyond[:, None] * reach
    near = pull / total
    far = reach - near
    fold = folds(arm)
    matrix = np.zeros((directions(arm),) * 2)
    for j in range(0 if arm.free else 1, arm.n + 1):
        crossed = np.outer(first[j], near[j])
        own = second[j] - crossed - crossed.T + beyond[j] * np.outer(far[j], far[j])
        if arm.free:
            own += (mass[j] + before[j]) * np.outer(near[j], near[j])
        matrix += fold[j] @ own @ fold[j].T
        for k in range(j + 1, arm.n + 1):
            pair = fold[j] @ np.outer(far[j], pull[k]) @ fold[k].T
            matrix += pair + pair.T
    moments = sum((fold[j] @ pull[j] for j in range(1, arm.n + 1)), np.zeros(directions(arm)))
    return matrix, moments


def of_rotors(arm: Arm, rotor_inertia: Array) -> Array:
    """The rotors' contribution to N (V, V): thin disks perpendicular to their axes, each on the body that carries it.

    N minus this matrix is positive semi-definite for every physically possible arm.
    """
    share = np.zeros((directions(arm),) * 2)
    for i, (joint, fold) in enumerate(zip(arm.joints, folds(arm), strict=False)):
        axis = arm.frames[i].T @ arm.frames[i + 1] @ np.array(joint.axis)
        share += 0.5 * rotor_inertia[i] * fold @ (np.eye(3) - np.outer(axis, axis)) @ fold.T
    return share


def pairs(arm: Arm) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Positions (row, column) in N of the kinetic `arm.body_parameters` of a spatial arm."""
    row, column = np.triu_indices(directions(arm))
    if arm.free:
        return row, column
    kept = ~((row < 2) & (column == 1))
    return row[kept], column[kept]


def to_parameters(arm: Arm, matrix: Array) -> Array:
    """The kinetic parameters of a spatial arm from N (V, V), in the order of `arm.body_parameters`."""
    values = matrix[pairs(arm)].copy()
    if not arm.free:
        values[0] += matrix[1, 1]
    return values


def from_parameters(arm: Arm, values: Array) -> Array:
    """A matrix N (V, V) with these kinetic parameters.

    A fixed base determines only the sum of the first two diagonal entries. These entries and the one between them are
    chosen so that N is positive semi-definite if possible: each gets what the other directions require, and half of the
    remainder.
    """
    row, column = pairs(arm)
    matrix = np.zeros((directions(arm),) * 2)
    matrix[row, column] = values
    matrix[column, row] = values
    if not arm.free:
        needed = matrix[:2, 2:] @ np.linalg.pinv(matrix[2:, 2:], hermitian=True) @ matrix[2:, :2]
        matrix[:2, :2] = needed + 0.5 * (values[0] - np.trace(needed)) * np.eye(2)
    return matrix

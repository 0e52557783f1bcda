# SPDX-License-Identifier: MIT
"""The file of a simulator with what was learned: possible bodies nearest to its own, armatures, friction.

An arm has fewer base parameters than its bodies have entries, and those of an estimate contain noise. The inertials are
therefore those possible ones, near those of the file, that predict the torques of the runs as the model does: each body
has the Cholesky factor of its matrix [[S, s], [s', m]] of second moment, first moment and mass as coordinates (Rucker &
Wensing, "Smooth parameterization of rigid-body inertia", RA-L 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import Effect
from zygos.gap.ground.predictions import Stage
from zygos.ground.motion import TorqueRows
from zygos.model.model import Model
from zygos.simulators.held import kept_by
from zygos.simulators.robot import Lump, Robot, armatures, unreflected

Array = NDArray[np.float64]

_PRECISIONS = (1e1, 1e2, 1e3, 1e4)
"""Weights, step by step, of an error of all torques in units of their size, beside a body that is e times another."""
_STEPS = 200
"""Most evaluations for each of these weights."""
_UPPER, _BELOW = np.triu_indices(3), np.tril_indices(4, -1)
_THINNEST = 1e-4
"""Smallest eigenvalue of a body's matrix in the coordinates, as a share of its diagonal."""
_UNCHANGED = 1e-6
"""Relative change up to which an inertial is that of the file."""


@dataclass(frozen=True)
class Corrected:
    """A robot with what was learned."""

    robot: Robot
    values: Array
    """(p,) base parameters that the file is to have: those of the model, and in a URDF, which holds no rotor, those
    that it then has."""
    held: tuple[Effect, ...]
    """Effects that the file holds."""
    lost: tuple[Effect, ...]
    """Effects that it cannot hold."""
    left: float
    """Root mean square of the torques that the bodies of the file predict otherwise than the model, as share of the
    measured torques."""

    def stage(self, name: str) -> Stage:
        """What the file holds, in zygos' own equations."""
        return Stage(name, self.values, self.held)


def corrected(robot: Robot, arm: Arm, stage: Stage, rows: Sequence[TorqueRows]) -> Corrected:
    """The robot with the parameters and effects of a model. rows: of the runs, whose torques say what matters."""
    held, lost = kept_by(robot.format, arm, stage.effects)
    rotors = robot.rotors(arm)
    if robot.format == "MJCF" and arm.torque_at == "rotor":
        for k, parameter in enumerate(arm.parameters):
            if parameter.symbol == "Im" and parameter.joint is not None:
                rotors[parameter.joint] = max(float(stage.values[k]), 0.0)
    lumps, values, left = _nearest(robot, arm, rotors, stage.values, _root(rows))
    armature = armatures(rotors, arm) if arm.torque_at == "rotor" else np.array([h.armature for h in robot.hinges])
    drives = in_joints(arm, held)
    hinges = tuple(
        replace(
            hinge,
            armature=_same(hinge.armature, float(armature[j])),
            friction=_same(hinge.friction, max(float(drives.friction[j]), 0.0)),
            damping=_same(hinge.damping, max(float(drives.damping[j]), 0.0)),
        )
        for j, hinge in enumerate(robot.hinges)
    )
    owners = tuple(replace(owner, own=own) for owner, own in zip(robot.owners, lumps, strict=True))
    wanted = values if robot.format == "URDF" else stage.values
    return Corrected(replace(robot, hinges=hinges, owners=owners), wanted, held, lost, left)


@dataclass(frozen=True)
class InJoints:
    """Effects as a file has them at N joints."""

    friction: Array
    """(N,) Nm."""
    damping: Array
    """(N,) Nms/rad."""


def in_joints(arm: Arm, held: Sequence[Effect]) -> InJoints:
    """Effects that a file holds, behind the gears. The coupling of a rotor is in its armature and the inertials."""
    friction, damping = np.zeros(arm.n), np.zeros(arm.n)
    for one in held:
        if one.kind.place in ("motor", "link"):
            size = one.value * (float(arm.gear_ratios[one.index(arm)]) if one.kind.place == "motor" else 1.0)
            (damping if one.kind.viscous else friction)[one.index(arm)] += size
    return InJoints(friction, damping)


def _same(old: float, new: float) -> float:
    return old if abs(new - old) <= _UNCHANGED * abs(old) else new


def _root(rows: Sequence[TorqueRows]) -> Array:
    """(r, p) R: |R x| is the root mean square of the torques by a change x of the parameters, each joint in units of
    its own."""
    parts = []
    count = sum(int(np.count_nonzero(one.kept)) for one in rows)
    size = np.sqrt(sum((one.tau[one.kept] ** 2).sum(axis=0) for one in rows) / count)
    for one in rows:
        parts.append((one.z[one.kept] / size[:, None]).reshape(-1, one.z.shape[-1]))
    stacked = np.concatenate(parts) / np.sqrt(count * len(size))
    return np.asarray(np.linalg.qr(stacked, mode="r"), dtype=np.float64)


def _nearest(robot: Robot, arm: Arm, rotors: Array, target: Array, root: Array) -> tuple[list[Lump], Array, float]:
    """The inertials of the owners (N), the base parameters that the robot then has, and what is left."""
    from scipy.optimize import least_squares  # noqa: PLC0415  (takes a second to import)

    slope, start = _linear(robot, arm, rotors)
    size = 10 * arm.n
    factors = [_factor(owner.own) for owner in robot.owners]
    first = np.concatenate([owner.own.standard for owner in robot.owners])

    def standard(y: Array) -> Array:
        return np.concatenate(
            [_of_matrix(_moved(factor, own)) for factor, own in zip(factors, y.reshape(-1, 10), strict=True)]
        )

    def values(y: Array) -> Array:
        return np.asarray(start + slope @ (standard(y) - first), dtype=np.float64)

    y = np.zeros(size)
    if float(np.linalg.norm(root @ (start - target))) > _UNCHANGED:
        for weight in _PRECISIONS:

            def residual(y: Array, weight: float = weight) -> Array:
                return np.concatenate([weight * root @ (values(y) - target), y])

            def jacobian(y: Array, weight: float = weight) -> Array:
                own = [_change(factor, one) for factor, one in zip(factors, y.reshape(-1, 10), strict=True)]
                moved = [slope[:, 10 * k : 10 * k + 10] @ one for k, one in enumerate(own)]
                return np.vstack([weight * root @ np.hstack(moved), np.eye(size)])

            y = least_squares(residual, y, jacobian, method="lm", xtol=1e-10, ftol=1e-10, max_nfev=_STEPS).x
    lumps = [
        owner.own if np.max(np.abs(x)) <= _UNCHANGED else Lump.of(own)
        for owner, own, x in zip(robot.owners, standard(y).reshape(-1, 10), y.reshape(-1, 10), strict=True)
    ]
    found = start + slope @ (np.concatenate([one.standard for one in lumps]) - first)
    return lumps, np.asarray(found, dtype=np.float64), float(np.linalg.norm(root @ (found - target)))


def _linear(robot: Robot, arm: Arm, rotors: Array) -> tuple[Array, Array]:
    """(p, 10 N) by how much the base parameters change with the owners' standard parameters, and (p,) those that the
    robot has with these rotors. An arm whose base is fixed is linear in them."""
    frames = robot.frames(arm)[1:]
    drives = robot.model(arm).joints
    drives = tuple(
        replace(one, rotor_inertia=replace(one.rotor_inertia, value=inertia))
        for one, inertia in zip(drives, rotors.tolist(), strict=True)
    )
    drawing = robot.model(arm)

    def base(segments: Sequence[Array]) -> Array:
        bodies = [drawing.bodies[0]]
        for body, own, frame in zip(
            drawing.bodies[1:], unreflected(segments, rotors, arm, robot.hinges), frames, strict=True
        ):
            lump = Lump.of(own).in_frame(*frame)
            x, y, z = (float(v) for v in lump.centre)
            inertia = tuple(
                replace(entry, value=float(v)) for entry, v in zip(body.inertia, lump.tensor[_UPPER], strict=True)
            )
            bodies.append(
                replace(body, mass=replace(body.mass, value=lump.mass), origin_xyz=(x, y, z), inertia=inertia)  # type: ignore[arg-type]
            )
        return Model(drawing.name, tuple(bodies), drives).unchecked_values(arm)

    own = [one.standard for one in robot.segments]
    start = base(own)
    columns = []
    for i, segment in enumerate(own):
        scale = max(float(np.abs(segment).max()), 1e-6)
        for k in range(10):
            step = np.zeros(10)
            step[k] = 0.1 * scale
            one, other = ([*own[:i], segment + sign * step, *own[i + 1 :]] for sign in (1.0, -1.0))
            columns.append((base(one) - base(other)) / (0.2 * scale))
    return np.array(columns).T, start


def _factor(own: Lump) -> Array:
    """(4, 4) Cholesky factor of a body's matrix about its own mass centre, and the way there."""
    second = 0.5 * np.trace(own.tensor) * np.eye(3) - own.tensor
    eigen, vectors = np.linalg.eigh(second)
    least = _THINNEST * max(float(eigen[-1]), 1e-12)
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = (vectors * np.maximum(eigen, least)) @ vectors.T + own.mass * np.outer(own.centre, own.centre)
    matrix[:3, 3] = matrix[3, :3] = own.mass * own.centre
    matrix[3, 3] = own.mass
    # the mass last: a change of the last row moves the centre by radii of gyration
    return np.asarray(np.linalg.cholesky(matrix), dtype=np.float64)


def _lower(y: Array) -> Array:
    """(4, 4) by which coordinates (10,) multiply a factor; they are 0 at the factor itself."""
    lower = np.diag(np.exp(y[:4]))
    lower[_BELOW] = y[4:]
    return lower


def _moved(factor: Array, y: Array) -> Array:
    """(4, 4) a body's matrix at coordinates (10,)."""
    root = factor @ _lower(y)
    return np.asarray(root @ root.T, dtype=np.float64)


def _change(factor: Array, y: Array) -> Array:
    """(10, 10) by how much the standard parameters of a body change with its coordinates."""
    lower = _lower(y)
    entries = np.zeros((10, 4, 4))
    entries[range(4), range(4), range(4)] = np.diag(lower)
    entries[(range(4, 10), *_BELOW)] = 1.0
    half = factor @ entries @ (factor @ lower).T
    return np.array([_of_matrix(one + one.T) for one in half]).T


def _of_matrix(matrix: Array) -> Array:
    """(10,) standard parameters of a body's matrix."""
    second = matrix[:3, :3]
    inertia = np.trace(second) * np.eye(3) - second
    return np.concatenate([[matrix[3, 3]], matrix[:3, 3], inertia[_UPPER]])

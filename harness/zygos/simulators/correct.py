# SPDX-License-Identifier: MIT
"""The file of a simulator with what was learned: possible bodies nearest to its own, armatures, friction.

An arm has fewer base parameters than its bodies have entries, and those of an estimate contain noise. The inertials are
therefore those possible ones, near those of the file, that predict the torques of the runs as the model does: each body
has the Cholesky factor of its matrix [[S, s], [s', m]] of second moment, first moment and mass as coordinates (Rucker &
Wensing, "Smooth parameterization of rigid-body inertia", RA-L 2022). The bodies of
an arm that floats or has flexible joints come as near as possible to the parameters themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import Effect
from zygos.gap.ground.predictions import Stage
from zygos.ground.motion import TorqueRows
from zygos.model.model import Model
from zygos.simulators.held import kept_by
from zygos.simulators.robot import Hinge, Lump, Owner, Robot, armatures, body_of, unreflected

Array = NDArray[np.float64]

_PRECISIONS = (1e1, 1e2, 1e3, 1e4, 1e5)
"""Weights, step by step, of an error of all torques in units of their size, beside a body that is e times another."""
_STEPS = 200
"""Most evaluations for each of these weights."""
_UPPER, _BELOW = np.triu_indices(3), np.tril_indices(4, -1)
_THINNEST = 1e-4
"""Smallest eigenvalue of a body's matrix in the coordinates, as a share of its diagonal."""
_STEP, _LARGE_STEP = 1e-6, 0.1
"""Steps of the numerical differentiation, as share of the largest parameter of a body; the large one is exact where the
values are linear."""
_SMALL = 1e-3
"""A parameter of an arm is weighed as if it had at least this share of the largest one."""
_FLATTEST = 0.5 + 1e-6
"""Inertia of a rotor across its axis, as share of that about it; with half, what ten digits round away is no body."""
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
    measured torques; of an arm that floats or has flexible joints, that of the differences of the parameters, as share
    of these."""

    def stage(self, name: str) -> Stage:
        """What the file holds, in zygos' own equations."""
        return Stage(name, self.values, self.held)


def corrected(robot: Robot, arm: Arm, stage: Stage, rows: Sequence[TorqueRows]) -> Corrected:
    """The robot with the parameters and effects of a model. rows: of runs of an arm on the ground, whose torques say
    what matters."""
    held, lost = kept_by(robot.format, arm, stage.effects)
    if not arm.grounded:
        return _with_springs(robot, arm, stage, held, lost)
    rotors, armature = _rotors(robot, arm, stage.values)
    bodies = _bodies(robot, arm, rotors, robot.hinges)

    def base(own: Array) -> Array:
        return bodies(own).unchecked_values(arm)

    # an arm whose base is fixed is linear in the parameters of its bodies
    lumps, values, left = _nearest(robot.owners, base, stage.values, _root(rows), linear=True)
    hinges = tuple(_hinges(robot, in_joints(arm, held), armature.tolist()))
    owners = tuple(replace(owner, own=own) for owner, own in zip(robot.owners, lumps, strict=True))
    wanted = values if robot.format == "URDF" else stage.values
    return Corrected(replace(robot, hinges=hinges, owners=owners), wanted, held, lost, left)


@dataclass(frozen=True)
class InJoints:
    """Effects as a file has them at N joints, and at the hinges of the rotors of flexible ones."""

    friction: Array
    """(N,) Nm."""
    damping: Array
    """(N,) Nms/rad."""
    rotor_friction: Array
    """(N,) Nm."""
    rotor_damping: Array
    """(N,) Nms/rad, of the rate before the gear."""
    cubic: Array
    """(N,) Nm/rad^3 behind the gear."""
    offset: Array
    """(N,) Nm behind the gear."""
    slack: Array
    """(N,) Nm/rad behind the gear, by which springs are softer within a gap."""
    gap_rad: Array
    """(N,) its half width."""


def in_joints(arm: Arm, held: Sequence[Effect]) -> InJoints:
    """Effects that a file holds: those of the motor of a rigid joint behind its gear. The coupling of a rotor is in its
    armature and the inertials, or in the hinge of the rotor."""
    out = InJoints(*np.zeros((8, arm.n)))
    for one in held:
        i, place = one.index(arm), one.kind.place
        if place not in ("motor", "link", "spring"):
            continue
        ratio = float(arm.gear_ratios[i])
        if one.kind.key == "backlash":
            out.slack[i], out.gap_rad[i] = one.value, one.shape
        elif place == "spring":
            (out.cubic if one.kind.key == "cubic_stiffness" else out.offset)[i] += one.value
        elif place == "motor" and arm.joints[i].flexible:
            # the rate before the gear is n times that of the law
            (out.rotor_damping if one.kind.viscous else out.rotor_friction)[i] += (
                one.value / ratio if one.kind.viscous else one.value
            )
        else:
            size = one.value * (ratio if place == "motor" else 1.0)
            (out.damping if one.kind.viscous else out.friction)[i] += size
    return out


def _rotors(robot: Robot, arm: Arm, values: Array) -> tuple[Array, Array]:
    """(N,) inertias of the rotors with these base parameters (p,), and (N,) armatures of the file, which stay where
    torques are measured behind the gear."""
    rotors = robot.rotors(arm)
    if arm.torque_at == "joint":
        return rotors, np.array([hinge.armature for hinge in robot.hinges])
    if robot.format == "MJCF":
        for parameter, value in zip(arm.parameters, values.tolist(), strict=True):
            if parameter.symbol == "Im" and parameter.joint is not None:
                rotors[parameter.joint] = max(value, 0.0)
    return rotors, armatures(rotors, arm)


def _hinges(robot: Robot, drives: InJoints, armature: Sequence[float]) -> Iterator[Hinge]:
    """The joints with these effects, and with these armatures (N,)."""
    for j, hinge in enumerate(robot.hinges):
        yield replace(
            hinge,
            armature=_same(hinge.armature, armature[j]),
            friction=_same(hinge.friction, max(float(drives.friction[j]), 0.0)),
            damping=_same(hinge.damping, max(float(drives.damping[j]), 0.0)),
        )


def _with_springs(
    robot: Robot, arm: Arm, stage: Stage, held: tuple[Effect, ...], lost: tuple[Effect, ...]
) -> Corrected:
    """The robot of an arm that floats or has flexible joints, whose bodies have the parameters of a model."""
    given = dict(zip(arm.parameter_names, stage.values.tolist(), strict=True))
    rotors, armature = _rotors(robot, arm, stage.values)
    drives, hinges = in_joints(arm, held), []
    for j, hinge in enumerate(_hinges(robot, drives, armature.tolist())):
        if (spring := hinge.spring) is None:
            hinges.append(hinge)
            continue
        inertia = _same(spring.inertia(hinge.axis), float(rotors[j]))
        new = replace(
            spring,
            rotor=_spinning(spring.rotor, hinge.axis, inertia),
            stiffness=_same(spring.stiffness, given[f"k{j + 1}"]),
            damping=_same(spring.damping, max(given[f"b{j + 1}"], 0.0)),
            cubic=_same(spring.cubic, float(drives.cubic[j])),
            offset=_same(spring.offset, float(drives.offset[j])),
            slack=_same(spring.slack, float(drives.slack[j])),
            gap_rad=_same(spring.gap_rad, float(drives.gap_rad[j])),
            friction=_same(spring.friction, max(float(drives.rotor_friction[j]), 0.0)),
            rub=_same(spring.rub, max(float(drives.rotor_damping[j]), 0.0)),
        )
        hinges.append(replace(hinge, armature=0.0, spring=new))
    bodies = _bodies(robot, arm, rotors, hinges)
    # mass centres stay on the lines between the joints of a planar-symmetric arm: every b_ij is 0
    full = replace(arm, kinetic="planar") if arm.kinetic == "planar-symmetric" else arm
    wanted = {name: given[name] for name, _ in arm.body_parameters}
    names = list(arm.parameter_names)
    if full is not arm:
        names = list(full.full_names)
        kinds = zip(names, full.full_parameters, strict=True)
        wanted |= {name: 0.0 for name, one in kinds if one.symbol == "b" and one.joint is None}
    rows = [names.index(name) for name in wanted]

    def base(own: Array) -> Array:
        values = bodies(own).unchecked_values(full)
        return (values if full is arm else full.structure.expanded(values))[rows]

    target = np.array(list(wanted.values()))
    size = np.maximum(np.abs(target), _SMALL * np.abs(target).max())
    lumps, _, left = _nearest(robot.bodies, base, target, np.diag(1.0 / size) / np.sqrt(len(size)), linear=False)
    owners = [replace(owner, own=own) for owner, own in zip(robot.bodies, lumps, strict=True)]
    root = owners.pop(0) if robot.base is not None else None
    found = replace(robot, hinges=tuple(hinges), owners=tuple(owners), base=root)
    return Corrected(found, stage.values, held, lost, left)


def _spinning(rotor: Lump, axis: Array, inertia: float) -> Lump:
    """A round rotor with that inertia about its axis (3,); across it, as it was or as a thin disc has it."""
    was = float(axis @ rotor.tensor @ axis)
    if inertia == was:
        return rotor
    across = max(0.5 * (float(np.trace(rotor.tensor)) - was), _FLATTEST * inertia)
    about = np.outer(axis, axis)
    return replace(rotor, tensor=inertia * about + across * (np.eye(3) - about))


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


def _nearest(
    owners: Sequence[Owner], base: Callable[[Array], Array], target: Array, root: Array, *, linear: bool
) -> tuple[list[Lump], Array, float]:
    """The inertials of owners, the values that they then have, and what is left, |root (values - target)|.

    base: the values of their standard parameters (10 each), one after the other; linear: whether it is linear.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (takes a second to import)

    size = 10 * len(owners)
    factors = [_factor(owner.own) for owner in owners]
    first = np.concatenate([owner.own.standard for owner in owners])
    start = base(first)
    slope = _slope(base, first, start, _LARGE_STEP) if linear else np.zeros(0)

    def standard(y: Array) -> Array:
        return np.concatenate(
            [_of_matrix(_moved(factor, own)) for factor, own in zip(factors, y.reshape(-1, 10), strict=True)]
        )

    def values(own: Array) -> Array:
        return np.asarray(start + slope @ (own - first), dtype=np.float64) if linear else base(own)

    y = np.zeros(size)
    if float(np.linalg.norm(root @ (start - target))) > _UNCHANGED:
        for weight in _PRECISIONS if linear else _PRECISIONS[1::2]:

            def residual(y: Array, weight: float = weight) -> Array:
                return np.concatenate([weight * root @ (values(standard(y)) - target), y])

            def jacobian(y: Array, weight: float = weight) -> Array:
                own = [_change(factor, one) for factor, one in zip(factors, y.reshape(-1, 10), strict=True)]
                here = slope if linear else _slope(base, at := standard(y), base(at), _STEP)
                moved = [here[:, 10 * k : 10 * k + 10] @ one for k, one in enumerate(own)]
                return np.vstack([weight * root @ np.hstack(moved), np.eye(size)])

            y = least_squares(residual, y, jacobian, method="lm", xtol=1e-10, ftol=1e-10, max_nfev=_STEPS).x
    lumps = [
        owner.own if np.max(np.abs(x)) <= _UNCHANGED else Lump.of(own)
        for owner, own, x in zip(owners, standard(y).reshape(-1, 10), y.reshape(-1, 10), strict=True)
    ]
    found = values(np.concatenate([one.standard for one in lumps]))
    return lumps, found, float(np.linalg.norm(root @ (found - target)))


def _bodies(robot: Robot, arm: Arm, rotors: Array, hinges: Sequence[Hinge]) -> Callable[[Array], Model]:
    """The model of zygos with standard parameters (10 each) of the robot's bodies, with these rotors."""
    drawing = robot.model(arm)
    drives = tuple(
        replace(one, rotor_inertia=replace(one.rotor_inertia, value=inertia))
        for one, inertia in zip(drawing.joints, rotors.tolist(), strict=True)
    )
    count = len(robot.bodies)
    frames, beside = robot.frames(arm)[-count:], [sum(one.standard for one in owner.rest) for owner in robot.bodies]

    def model(own: Array) -> Model:
        segments = [mine + other for mine, other in zip(own.reshape(-1, 10), beside, strict=True)]
        bodies = list(drawing.bodies[:-count])
        for body, standard, frame in zip(
            drawing.bodies[-count:], unreflected(segments, rotors, arm, hinges), frames, strict=True
        ):
            moved = body_of(body.name, Lump.of(standard).in_frame(*frame))
            bodies.append(replace(moved, joint_xyz=body.joint_xyz))
        return Model(drawing.name, tuple(bodies), drives)

    return model


def _slope(base: Callable[[Array], Array], own: Array, here: Array, step: float) -> Array:
    """(p, 10 B) by how much values, which are `here` (p,), change with the standard parameters of B bodies. step: as
    share of the largest parameter of a body."""
    columns = []
    for k in range(len(own)):
        scale = step * max(float(np.abs(own[k - k % 10 : k - k % 10 + 10]).max()), 1e-6)
        columns.append((base(own + scale * (np.arange(len(own)) == k)) - here) / scale)
    return np.array(columns).T


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

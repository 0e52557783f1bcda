# SPDX-License-Identifier: MIT
"""Positions and attitudes of the bodies of an arm: their frames at many instants, and the motion in a recorded run.

R_i = R_{i-1} Rpy(frame_rpy_i) Rot(axis_i, q_i) and p_i = p_{i-1} + R_{i-1} joint_xyz_{i-1}: body i's frame is that of
joint i, with its origin on the joint (URDF's convention).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate, usable

Floats = NDArray[np.float64]

_UNIT_M = 1.0
"""Length of every body of unknown dimensions, m."""


@dataclass(frozen=True)
class Skeleton:
    """The lengths of an arm with N joints, each in its body's frame, m."""

    joint_xyz: Floats
    """(N, 3) origin of the joint that body i carries, i = 0 .. N-1."""
    end_xyz: Floats
    """(3,) end of the last body: twice its mass centre, so that the mass centre is in the middle."""
    centre_xyz: Floats
    """(N+1, 3) mass centre of each body with the rotor it carries."""
    mass: Floats | None
    """(N+1,) mass with the rotor, kg; None: the model is unknown and the lengths are schematic."""


@dataclass(frozen=True)
class Poses:
    """Frames of N+1 bodies at n instants."""

    attitude: Floats
    """(n, N+1, 3, 3) columns are the body's axes in the world."""
    position: Floats
    """(n, N+1, 3) origin of the body's frame in the world, m."""


@dataclass(frozen=True)
class RecordedMotion:
    """Motion of the arm in a run, at n cycles."""

    time: Floats
    """(n,) time since the first cycle, s."""
    q: Floats
    """(n, N) link angles, rad."""
    deflection: Floats
    """(n, N) motor angle after the gear minus link angle, rad, within half a turn."""
    base: Floats
    """(n, 3, 3) attitude of the base; the identity at the first cycle."""
    gaps: int
    """Number of gaps in the cycles; within a gap the base is assumed to turn at the mean of the rates on both sides."""


def skeleton(arm: Arm, model: Model | None) -> Skeleton:
    """The lengths given by a model with bodies; without one, unit lengths perpendicular to the joint axes.

    Errors: ZygosError if the model does not fit the arm.
    """
    if model is None or not model.bodies:
        if model is not None:
            model.base_parameters(arm)  # raises an error if the model belongs to another arm
        # the base has no axis of its own; its length is perpendicular to the first joint's axis
        lengths = np.array([_across(axis) for axis in (arm.axes[0], *(np.array(joint.axis) for joint in arm.joints))])
        return Skeleton(lengths[:-1], lengths[-1], np.zeros((arm.n + 1, 3)), None)
    model.check_fits(arm)
    joint_xyz = np.array([body.joint_xyz for body in model.bodies[:-1]], dtype=np.float64)
    own = np.array([body.mass.value for body in model.bodies])
    centre = np.array([body.origin_xyz for body in model.bodies])
    rotor = np.array([joint.rotor_mass.value for joint in model.joints] + [0.0])
    mass = own + rotor
    carried = np.vstack([joint_xyz, np.zeros(3)])
    centre_xyz = (own[:, None] * centre + rotor[:, None] * carried) / mass[:, None]
    return Skeleton(joint_xyz, 2.0 * centre[-1], centre_xyz, mass)


def _across(axis: Floats) -> Floats:
    """(3,) unit vector perpendicular to a joint axis: x where possible, so that an arm is stretched at zero angles."""
    start = np.eye(3)[0] if abs(axis[0]) < 0.9 else np.eye(3)[1]
    direction = start - axis * (axis @ start)
    return np.asarray(_UNIT_M * direction / np.linalg.norm(direction), dtype=np.float64)


def forward(arm: Arm, joint_xyz: Floats, q: Floats, base: Floats, origin: Floats) -> Poses:
    """Frames of all bodies: q (n, N) link angles; attitude `base` (n, 3, 3) and position `origin` (n, 3) of the
    base."""
    n = len(q)
    attitude = np.empty((n, arm.n + 1, 3, 3))
    position = np.empty((n, arm.n + 1, 3))
    attitude[:, 0], position[:, 0] = base, origin
    for i, joint in enumerate(arm.joints):
        frame = Rotation.from_euler("xyz", joint.frame_rpy).as_matrix()
        turn = Rotation.from_rotvec(q[:, i, None] * np.array(joint.axis)).as_matrix()
        attitude[:, i + 1] = attitude[:, i] @ frame @ turn
        position[:, i + 1] = position[:, i] + attitude[:, i] @ joint_xyz[i]
    return Poses(attitude, position)


def mass_centre(lengths: Skeleton, poses: Poses) -> Floats:
    """(n, 3) mass centre of the whole arm, m. The masses must be known."""
    assert lengths.mass is not None
    centres = poses.position + np.einsum("niab,ib->nia", poses.attitude, lengths.centre_xyz)
    return np.asarray(np.einsum("i,nia->na", lengths.mass, centres) / lengths.mass.sum(), dtype=np.float64)


def place(arm: Arm, lengths: Skeleton, q: Floats, base: Floats) -> Poses:
    """Frames of all bodies in a world in which a free-floating arm's mass centre is at rest in the origin.

    For an arm on the ground or with unknown masses, the base's origin is there instead. q (n, N), base (n, 3, 3).
    """
    poses = forward(arm, lengths.joint_xyz, q, base, np.zeros((len(q), 3)))
    if not arm.free or lengths.mass is None:
        return poses
    return Poses(poses.attitude, poses.position - mass_centre(lengths, poses)[:, None])


def integrated_attitudes(time: Floats, rate: Floats) -> Floats:
    """(n, 3, 3) attitude of a body that turns at rate (n, 3) in its own axes, rad/s; the identity at the first instant.

    R_{k+1} = R_k exp((rate_k + rate_{k+1}) / 2 * dt), second order in dt.
    """
    turns = 0.5 * (rate[:-1] + rate[1:]) * np.diff(time)[:, None]
    attitude = np.empty((len(time), 3, 3))
    attitude[0] = np.eye(3)
    for k, step in enumerate(Rotation.from_rotvec(turns).as_matrix() if len(turns) else ()):
        attitude[k + 1] = attitude[k] @ step
    return attitude


def motion(arm: Arm, cycles: Cycles) -> RecordedMotion:
    """Motion of the arm in a run: signs, zeros and the gyro's mount are applied, and unusable cycles are left out.

    Errors: ZygosError if no cycle is usable, or the record has a different number of joints.
    """
    samples = calibrate(arm, cycles)
    use = usable(cycles)
    if not use.any():
        raise ZygosError(
            f"the run has no complete cycle of arm {arm.name}, so there is nothing to show; remedy: give the arm file "
            "with which the run was recorded, or record with every node of the arm on the bus"
        )
    sync = samples.sync[use]
    time = (sync - sync[0]).astype(np.float64) * arm.period_s
    q, deflection = samples.q[use], samples.theta[use] - samples.q[use]
    # after an encoder has passed the end of its range it is wrong by whole turns
    deflection -= 2.0 * np.pi * np.round(deflection / (2.0 * np.pi))
    base = integrated_attitudes(time, samples.omega[use]) if arm.free else np.tile(np.eye(3), (len(time), 1, 1))
    return RecordedMotion(time, q, deflection, base, gaps=int(np.count_nonzero(np.diff(sync) > 1)))

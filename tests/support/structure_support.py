# SPDX-License-Identifier: MIT
"""Arms of known geometry, bodies for them, and the joint torques of their parameters by Pinocchio."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from conftest import ROOT, need
from zygos.arm import NO_IMU, Arm, Base, Encoder, Imu, Joint, Kinetic, TorqueAt
from zygos.model.model import Body, JointModel, Model, Quantity

Floats = NDArray[np.float64]
Frames = list[dict[str, Any]]

PIN_ORDER = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Pinocchio's order of a body's inertial parameters."""
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -9.81)
_UPPER = np.triu_indices(3)


def frames_of(name: str) -> Frames:
    """The joints of a known arm; of "general 6R" and so on axes in any direction, the first one vertical or not."""
    if name.startswith("general"):
        rng = np.random.default_rng(7)
        axes = rng.normal(size=(int(name.split()[1][0]), 3))
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        joints: Frames = [
            {"rpy": rng.uniform(-3.0, 3.0, 3).tolist(), "xyz": rng.normal(size=3).tolist(), "axis": axis.tolist()}
            for axis in axes
        ]
        if "tilted" not in name:
            joints[0] = {"rpy": [0.0, 0.0, 0.0], "xyz": [0.0, 0.0, 0.0], "axis": list(UP)}
        return joints
    file = ROOT.parent / "shared" / "data" / "geometry" / "arms.toml"
    need(file.is_file(), f"the geometry of known arms, {file.name}")
    found: Frames = tomllib.loads(file.read_text())[name]["joints"]
    return found


def arm_of(joints: Frames, **settings: Any) -> Arm:
    """An arm of these joints, on the ground unless `base` says otherwise. Equal ones are the same object, so that its
    structure is computed once."""
    return _arm_of(json.dumps(joints), **settings)


@cache
def _arm_of(
    joints: str,
    *,
    ratio: float = 100.0,
    lengths: bool = True,
    kinetic: Kinetic = "spatial",
    base: Base = "fixed",
    flexible: bool = False,
    torque_at: TorqueAt = "rotor",
    gravity: tuple[float, float, float] = DOWN,
) -> Arm:
    encoder = Encoder(1e-6)
    hardware = tuple(
        Joint(
            f"joint{i}",
            i,
            tuple(one["axis"]),
            tuple(one["rpy"]),
            ratio,
            encoder,
            encoder,
            flexible=flexible,
            position_m=tuple(one["xyz"]) if lengths else None,
        )
        for i, one in enumerate(json.loads(joints), start=1)
    )
    free = base == "free"
    imu = Imu(16, (0.0, 0.0, 0.0, 1.0), 1e-6, 1e-9) if free else NO_IMU
    still = (0.0, 0.0, 0.0)
    return Arm("known", base, kinetic, 0.002, "sampled", torque_at, hardware, imu, gravity=still if free else gravity)


def bodies_of(arm: Arm, joints: Frames, seed: int = 0, *, massive_rotors: bool = True) -> Model:
    """A model of clouds of point masses whose joints lie where the arm has them; those of a planar arm are their own
    mirror images in the plane of motion."""
    rng = np.random.default_rng(seed)
    bodies, drives = [], []
    for i in range(arm.n + 1):
        points, masses = rng.normal(scale=0.3, size=(10, 3)), rng.uniform(1.0, 3.0, 10)
        if not arm.spatial:
            points = np.vstack([points, points - 2.0 * np.outer(points @ arm.axis, arm.axis)])
            masses = np.tile(masses, 2)
        total = masses.sum()
        centre = masses @ points / total
        spread = points - centre
        second = (spread.T * masses) @ spread
        tensor = np.trace(second) * np.eye(3) - second
        ixx, ixy, ixz, iyy, iyz, izz = (Quantity(float(entry)) for entry in tensor[_UPPER])
        x, y, z = centre.tolist()
        reach = tuple(joints[i]["xyz"]) if i < arm.n else None
        bodies.append(Body(f"body{i}", Quantity(float(total)), (x, y, z), (ixx, ixy, ixz, iyy, iyz, izz), reach))
        if i < arm.n:
            soft = arm.joints[i].flexible
            drives.append(
                JointModel(
                    arm.joints[i].name,
                    Quantity(0.5 if massive_rotors else 0.0),
                    Quantity(float(rng.uniform(1e-4, 2e-4))),
                    Quantity(1e4 if soft else np.inf),
                    Quantity(1.0 if soft else 0.0),
                )
            )
    return Model("clouds", tuple(bodies), tuple(drives))


def torque_columns(arm: Arm, joints: Frames, *, rotors: bool, count: int = 40, seed: int = 1) -> tuple[Floats, Floats]:
    """Joint torques at random states by Pinocchio, (count, N, 10 N [+ N]), and the joints' rates (count, N).

    The columns are those of the ten parameters of each link in `PIN_ORDER`, and with `rotors` those of the inertias of
    rotors, which are bodies of their own on the carrying links, that turn n times as fast as the joint.
    """
    tree = pin.Model()
    tree.gravity.linear = np.array(arm.gravity)
    carrier, links, spinning = 0, [], []
    for i, (joint, place) in enumerate(zip(arm.joints, joints, strict=True)):
        pose = pin.SE3(pin.rpy.rpyToMatrix(np.array(place["rpy"])), np.array(place["xyz"]))
        turning = pin.JointModelRevoluteUnaligned(np.array(joint.axis))
        if rotors:
            spinning.append(tree.addJoint(carrier, turning, pose, f"rotor{i}"))
        carrier = tree.addJoint(carrier, turning, pose, f"link{i}")
        links.append(carrier)
    data = tree.createData()
    gear = np.zeros((tree.nv, arm.n))
    for i in range(arm.n):
        gear[tree.joints[links[i]].idx_v, i] = 1.0
        if rotors:
            gear[tree.joints[spinning[i]].idx_v, i] = arm.joints[i].gear_ratio
    rng = np.random.default_rng(seed)
    out, rates = [], []
    for _ in range(count):
        q, qd, qdd = rng.uniform(-np.pi, np.pi, arm.n), rng.normal(size=arm.n), rng.normal(size=arm.n)
        every = gear.T @ pin.computeJointTorqueRegressor(tree, data, gear @ q, gear @ qd, gear @ qdd)
        columns = [every[:, 10 * (k - 1) : 10 * k] for k in links]
        for i, k in enumerate(spinning):
            axis = np.array(arm.joints[i].axis)
            square = np.outer(axis, axis)
            share = np.array([square["xyz".index(s[1]), "xyz".index(s[2])] for s in PIN_ORDER[4:]])
            share[[1, 3, 4]] *= 1.0  # Pinocchio's off-diagonal entries stand for both of a symmetric matrix
            columns.append((every[:, 10 * (k - 1) + 4 : 10 * k] @ share)[:, None])
        out.append(np.hstack(columns))
        rates.append(qd)
    return np.array(out), np.array(rates)


def rank(columns: Floats) -> int:
    """Rank of columns (..., c), each scaled to unit length. A gap of nine powers of ten must make it clear."""
    flat = columns.reshape(-1, columns.shape[-1])
    length = np.linalg.norm(flat, axis=0)
    seen = length > 1e-9 * length.max()
    size = np.linalg.svd(flat[:, seen] / length[seen], compute_uv=False)
    found = int(np.count_nonzero(size > 1e-6 * size[0]))
    assert np.all(size[found:] < 1e-8 * size[0])
    return found

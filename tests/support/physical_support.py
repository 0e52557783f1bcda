# SPDX-License-Identifier: MIT
"""Estimates with a known answer, drawings that are off, and inertia matrices by Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.energy import energy_columns
from zygos.balances.state import State
from zygos.model.model import Body, Model, Quantity

Floats = NDArray[np.float64]

BLOCKS = 32


def estimate_of(arm: Arm, values: Floats, noise_j: float = 0.0, seed: int = 0) -> dict[str, Any]:
    """The JSON that `zygos estimate` would write of 4,000 independent rows with so much noise in the work of each."""
    rng = np.random.default_rng(1000 + seed)
    count = 4000
    q, qd = rng.uniform(-np.pi, np.pi, (count, arm.n)), rng.normal(size=(count, arm.n))
    soft = np.array([joint.flexible for joint in arm.joints])
    theta, thetad = q + soft * rng.normal(scale=0.03, size=q.shape), qd + soft * rng.normal(scale=0.3, size=q.shape)
    base = rng.normal(size=(count, 3) if arm.spatial else count) * arm.free
    lost = np.sort(rng.uniform(0.0, 5.0, q.shape), axis=0) * soft
    z = energy_columns(arm, State(q, theta, qd, thetad, base), lost)
    z -= z.mean(axis=0)
    normal = z.T @ z
    size = np.sqrt(np.diag(normal))
    error = np.linalg.lstsq(z / size, noise_j * rng.normal(size=count), rcond=None)[0] / size
    sigma = max(noise_j, 1e-9) * np.sqrt(np.diag(np.linalg.inv(normal / np.outer(size, size)))) / size
    names = zip(arm.parameter_names, arm.parameter_units, values + error, sigma, strict=True)
    return {
        "arm": arm.name,
        "validity": "valid",
        "reason": None,
        "blocks": BLOCKS,
        "parameters": [{"name": n, "unit": u, "value": float(v), "sigma": float(s)} for n, u, v, s in names],
        "solution": (values + error).tolist(),
        "normal": normal.tolist(),
    }


def drawing_of(model: Model, seed: int, share: float = 0.2, length_m: float = 1e-3) -> Model:
    """Masses, principal second moments and drives off by up to `share`, centres by a part of the body, lengths."""
    rng = np.random.default_rng(seed)
    bodies: list[Body] = []
    for body in model.bodies:
        second = 0.5 * np.trace(body.tensor) * np.eye(3) - body.tensor
        eigen, vectors = np.linalg.eigh(second)
        second = (vectors * (eigen * rng.uniform(1.0 - share, 1.0 + share, 3))) @ vectors.T
        tensor = np.trace(second) * np.eye(3) - second
        mass = body.mass.value * rng.uniform(1.0 - share, 1.0 + share)
        off = 0.3 * share * np.sqrt(np.trace(second) / mass) * rng.normal(size=3)
        reach = body.joint_xyz
        if reach is not None:
            x, y, z = (np.array(reach) + length_m * rng.normal(size=3)).tolist()
            reach = (x, y, z)
        cx, cy, cz = (np.array(body.origin_xyz) + off).tolist()
        ixx, ixy, ixz, iyy, iyz, izz = (Quantity(float(entry)) for entry in tensor[np.triu_indices(3)])
        bodies.append(Body(body.name, Quantity(mass), (cx, cy, cz), (ixx, ixy, ixz, iyy, iyz, izz), reach))
    joints = tuple(
        replace(
            joint,
            **{
                key: Quantity(getattr(joint, key).value * rng.uniform(1.0 - share, 1.0 + share))
                for key in ("rotor_inertia", "stiffness", "damping")
            },
        )
        for joint in model.joints
    )
    return Model("drawing", tuple(bodies), joints)


def inertia_matrices(arm: Arm, model: Model, count: int = 200) -> Floats:
    """(count, U, U) inertia matrices of a free arm for base and joint rates, its mass centre at rest, rotors locked; at
    random joint angles. By Pinocchio, which knows bodies only."""
    multibody = pin.Model()
    at, place = 0, pin.SE3.Identity()
    for i, body in enumerate(model.bodies):
        kind = (
            pin.JointModelFreeFlyer() if i == 0 else pin.JointModelRevoluteUnaligned(np.array(arm.joints[i - 1].axis))
        )
        at = multibody.addJoint(at, kind, place, f"to {body.name}")
        multibody.appendBodyToJoint(
            at, pin.Inertia(body.mass.value, np.array(body.origin_xyz), body.tensor), pin.SE3.Identity()
        )
        if body.joint_xyz is not None:
            place = pin.SE3(pin.rpy.rpyToMatrix(np.array(arm.joints[i].frame_rpy)), np.array(body.joint_xyz))
            rotor, axis = model.joints[i], place.rotation @ np.array(arm.joints[i].axis)
            disk = 0.5 * rotor.rotor_inertia.value * (np.eye(3) + np.outer(axis, axis))
            locked = pin.Inertia(rotor.rotor_mass.value, np.array(body.joint_xyz), disk)
            multibody.appendBodyToJoint(at, locked, pin.SE3.Identity())
    data = multibody.createData()
    matrices = []
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (count, arm.n)):
        upper = np.triu(pin.crba(multibody, data, np.concatenate([[0, 0, 0, 0, 0, 0, 1], q])))
        full = upper + np.triu(upper, 1).T
        matrices.append(full[3:, 3:] - full[3:, :3] @ np.linalg.solve(full[:3, :3], full[:3, 3:]))
    return np.array(matrices)


def inertia_matrices_of(arm: Arm, values: Floats, count: int = 200) -> Floats:
    """The same of base parameters, which may be those of no arm: twice the energy of unit rates."""
    unit = np.eye(3 + arm.n)
    rates = np.array([a + b for a in unit for b in unit])
    qs = np.random.default_rng(0).uniform(-np.pi, np.pi, (count, 1, arm.n))
    q = np.broadcast_to(qs, (count, len(rates), arm.n))
    qd = np.broadcast_to(rates[:, 3:], q.shape)
    still = np.zeros_like(q)
    z = energy_columns(arm, State(q, q, qd, still, np.broadcast_to(rates[:, :3], (*q.shape[:2], 3))), still)
    twice = (2.0 * z @ values).reshape(count, len(unit), len(unit))
    own = np.einsum("nii->ni", twice) / 4.0
    matrices: Floats = 0.5 * (twice - own[:, :, None] - own[:, None, :])
    return matrices


def directional_errors(found: Floats, true: Floats) -> Floats:
    """(count,) largest |u' (found - true) u| / u' true u over all directions u."""
    root = np.linalg.inv(np.linalg.cholesky(true))
    relative = root @ (found - true) @ np.swapaxes(root, -1, -2)
    errors: Floats = np.abs(np.linalg.eigvalsh(relative)).max(axis=-1)
    return errors

# SPDX-License-Identifier: MIT
"""Random serial URDFs, and Pinocchio's model of what was imported; nothing of zygos but its files is used."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

ANSWERS = """
base = "free"
period_s = 0.005
torque_law = "applied_from_sync"
[imu]
node = 31
rate_sigma = 1e-5
bias_walk = 1e-8
[default]
gear_ratio = 100
rotor_inertia = 1e-9
stiffness = 1e4
damping = 10
link_encoder = { counts = 1048576 }
motor_encoder = { counts = 16384, side = "rotor" }
"""


def answers(joints: list[str]) -> str:
    return ANSWERS + "\n".join(f"[joint.{name}]\nnode = {node}" for node, name in enumerate(joints, start=1))


def numbers(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values).ravel())


def inertial(rng: np.random.Generator) -> str:
    """A body of random points: whatever it weighs, it can exist."""
    points, weights = rng.normal(size=(6, 3)) * rng.uniform(0.1, 0.5, 3), rng.uniform(0.1, 3.0, 6)
    points -= weights @ points / weights.sum()
    tensor = np.einsum("i,ijk->jk", weights, [p @ p * np.eye(3) - np.outer(p, p) for p in points])
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    entries = [f'{name}="{float(value)!r}"' for name, value in zip(names, tensor[np.triu_indices(3)], strict=True)]
    return (
        f'<inertial><origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rng.uniform(-3, 3, 3))}"/>'
        f'<mass value="{float(weights.sum())!r}"/>'
        f"<inertia {' '.join(entries)}/></inertial>"
    )


def origin(rng: np.random.Generator) -> str:
    rpy = rng.uniform(-math.pi, math.pi, 3)
    if rng.random() < 0.3:
        rpy[1] = rng.choice([-1, 1]) * rng.choice([math.pi / 2, 1.5707963, 1.57])  # where roll and yaw are one
    return f'<origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rpy)}"/>'


def random_urdf(rng: np.random.Generator, n: int, *, held: bool = False) -> tuple[str, list[str], list[str]]:
    """URDF of n moving joints, their names, and the names of moving joints off the chain."""
    parts: list[str] = []
    links, joints, off = ["l0"], [], []

    def link(name: str, *, heavy: bool) -> None:
        parts.append(f'<link name="{name}">{inertial(rng) if heavy else ""}</link>')

    def joint(name: str, kind: str, parent: str, child: str, axis: str = "") -> None:
        limit = '<limit effort="1" velocity="1" lower="-1" upper="1"/>' if kind in ("revolute", "prismatic") else ""
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{origin(rng)}'
            f"{axis}{limit}</joint>"
        )

    def branch(carrier: str) -> None:
        for k in range(rng.integers(0, 3)):
            name = f"{carrier}_side{k}"
            link(name, heavy=rng.random() < 0.7)
            joint(f"{name}_weld", "fixed", carrier, name)
            if rng.random() < 0.5:
                link(f"{name}_tip", heavy=True)
                joint(f"{name}_tip_weld", "fixed", name, f"{name}_tip")

    link("l0", heavy=True)
    branch("l0")
    for i in range(1, n + 1):
        carrier = links[-1]
        for k in range(rng.integers(0, 3)):  # fixed links on the way to the next joint
            link(f"between{i}_{k}", heavy=rng.random() < 0.5)
            joint(f"between{i}_{k}_weld", "fixed", carrier, f"between{i}_{k}")
            carrier = f"between{i}_{k}"
        link(f"l{i}", heavy=True)
        axis = rng.normal(size=3)
        given = [f'<axis xyz="{numbers(axis)}"/>', '<axis xyz="0 0 1"/>', '<axis xyz="0 -1 0"/>', ""][
            rng.integers(0, 4)
        ]
        joint(f"j{i}", str(rng.choice(["revolute", "continuous"])), carrier, f"l{i}", given)
        joints.append(f"j{i}")
        links.append(f"l{i}")
        branch(f"l{i}")
        if held and i <= 2:
            link(f"finger{i}", heavy=True)
            joint(f"finger{i}_slide", ["prismatic", "revolute"][i - 1], f"l{i}", f"finger{i}", '<axis xyz="0 1 0"/>')
            off.append(f"finger{i}_slide")
    order = rng.permutation(len(parts))  # a URDF has no order
    return f'<robot name="r">{"".join(parts[k] for k in order)}</robot>', joints, off


def attitude(rpy: list[float]) -> NDArray[np.float64]:
    return pin.rpy.rpyToMatrix(np.array(rpy))


def pin_of_import(folder: Path) -> pin.Model:
    """Pinocchio's model of arm.toml and model.toml; rotors are left out."""
    arm = tomllib.loads((folder / "arm.toml").read_text())
    bodies = tomllib.loads((folder / "model.toml").read_text())["body"]
    model = pin.Model()
    at, place = 0, pin.SE3.Identity()
    for i, body in enumerate(bodies):
        if i == 0:
            kind = pin.JointModelFreeFlyer()
        else:
            entry = arm["joint"][i - 1]
            kind = pin.JointModelRevoluteUnaligned(np.array(entry["axis"]))
            place = pin.SE3(attitude(entry["frame_rpy"]), np.array(bodies[i - 1]["joint_xyz"]))
        at = model.addJoint(at, kind, place, body["name"])
        ixx, ixy, ixz, iyy, iyz, izz = (body[key]["value"] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        tensor = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        inertia = pin.Inertia(body["mass"]["value"], np.array(body["origin_xyz"]), tensor)
        model.appendBodyToJoint(at, inertia, pin.SE3.Identity())
    return model


def pin_of_urdf(text: str, held: list[str]) -> pin.Model:
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    if held:
        model = pin.buildReducedModel(model, [model.getJointId(name) for name in held], pin.neutral(model))
    return model


def mass_matrix(model: pin.Model, q: NDArray[np.float64]) -> NDArray[np.float64]:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def posture(rng: np.random.Generator, n: int) -> NDArray[np.float64]:
    """Place, attitude and joint angles; a revolute joint has one number."""
    quaternion = rng.normal(size=4)
    return np.concatenate([rng.normal(size=3), quaternion / np.linalg.norm(quaternion), rng.uniform(-3, 3, n)])

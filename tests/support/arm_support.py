# SPDX-License-Identifier: MIT
"""Random arms that could be built, of any kind that an arm file can describe, and states of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import NO_IMU, Arm, Base, Encoder, Imu, Joint, Kinetic
from zygos.files.output import write_text
from zygos.model.model import Body, JointModel, Model, Quantity

Floats = NDArray[np.float64]

_UPPER = np.triu_indices(3)


class State(NamedTuple):
    """One state of an arm and its motors' torques, in the order in which an engine takes them."""

    q: Floats
    """(N,) rad."""
    theta: Floats
    """(N,) rad after the gear; q at a rigid joint."""
    omega0: Floats
    """(3,) rad/s in base axes; zero on a fixed base, along the joint axes in the plane."""
    qd: Floats
    """(N,) rad/s."""
    thetad: Floats
    """(N,) rad/s after the gear; qd at a rigid joint."""
    tau: Floats
    """(N,) Nm before the gear."""


def with_gain_sigma(arm: Arm, *sigma: float) -> Arm:
    """The arm with declared errors of the torque sensors' gains, of each joint or of all."""
    every = sigma if len(sigma) == arm.n else sigma * arm.n
    joints = [replace(joint, torque_gain_sigma=s) for joint, s in zip(arm.joints, every, strict=True)]
    return replace(arm, joints=tuple(joints))


def exact_torques(arm: Arm) -> Arm:
    """The arm with torque sensors whose gains are exact, so that none is estimated."""
    return with_gain_sigma(arm, 0.0)


def exact_example(folder: Path, copy: Path) -> Path:
    """A copy of an example whose torque sensors are declared to be exact; several processes may ask for it at once."""
    copy.mkdir(parents=True, exist_ok=True)
    for path in sorted(folder.glob("*.toml")):
        text = path.read_text(encoding="utf-8")
        if path.name == "arm.toml":
            text = text.replace("\n[[joint]]\n", "\n[[joint]]\ntorque_gain_sigma = 0.0\n")
        if not (copy / path.name).is_file() or (copy / path.name).read_text(encoding="utf-8") != text:
            write_text(copy / path.name, text)
    return copy


def random_arm(
    seed: int,
    joints: int,
    base: Base,
    kinetic: Kinetic = "spatial",
    flexible: bool | Sequence[bool] = True,
) -> tuple[Arm, Model]:
    """An arm of bodies that are clouds of point masses; a base of 100..1000 kg, links of 1..100 kg, sizes of a metre.

    A joint that is not flexible has an infinite stiffness. In space each joint's axis and frame have any direction. In
    a plane all share one axis of any direction, and every cloud is its own mirror image in the plane of motion, of a
    planar-symmetric arm also in the plane through its joints. A fixed base feels 9.81 m/s^2 in any direction.
    """
    rng = np.random.default_rng(seed)
    springs = [flexible] * joints if isinstance(flexible, bool) else list(flexible)
    plane = Rotation.from_quat(rng.normal(size=4)) if kinetic != "spatial" else Rotation.identity()
    common = tuple(plane.as_matrix()[:, 2].tolist())
    bodies, drives, hardware = [], [], []
    for i in range(joints + 1):
        weight = float(10.0 ** (rng.uniform(2.0, 3.0) if i == 0 else rng.uniform(0.0, 2.0)))
        bodies.append(_body(rng, f"body{i}", weight, kinetic, plane, last=i == joints))
        if i == joints:
            break
        ratio = float(rng.uniform(20.0, 150.0))
        drives.append(_drive(rng, f"joint{i + 1}", ratio, springs[i]))
        encoder = Encoder(quantum_rad=1e-6)
        hardware.append(
            Joint(
                f"joint{i + 1}",
                i + 1,
                _unit(rng) if kinetic == "spatial" else common,
                tuple(rng.uniform(-np.pi, np.pi, 3).tolist()) if kinetic == "spatial" else (0.0, 0.0, 0.0),
                ratio,
                encoder,
                encoder,
                flexible=springs[i],
            )
        )
    free = base == "free"
    arm = Arm(
        "random",
        base,
        kinetic,
        0.002,
        "applied_from_sync",
        "rotor",
        tuple(hardware),
        Imu(16, (0.0, 0.0, 0.0, 1.0), 1e-6, 1e-9) if free else NO_IMU,
        gravity=(0.0, 0.0, 0.0) if free else _unit(rng, 9.81),
    )
    return arm, Model("random", tuple(bodies), tuple(drives))


def random_state(rng: np.random.Generator, arm: Arm) -> State:
    """Rates of about 1 rad/s, springs wound up by a few hundredths; a free arm then has some angular momentum."""
    n = arm.n
    soft = np.array([joint.flexible for joint in arm.joints])
    q, qd = rng.uniform(-np.pi, np.pi, n), rng.normal(size=n)
    omega0 = rng.normal() * arm.axis if not arm.spatial else rng.normal(size=3)
    return State(
        q,
        q + soft * rng.normal(scale=0.03, size=n),
        omega0 if arm.free else np.zeros(3),
        qd,
        qd + soft * rng.normal(scale=0.3, size=n),
        rng.normal(size=n),
    )


def _body(rng: np.random.Generator, name: str, weight: float, kinetic: Kinetic, plane: Rotation, *, last: bool) -> Body:
    """A cloud of ten points, mirrored as the kind of arm asks for."""
    points = rng.normal(scale=0.3, size=(10, 3)) + rng.normal(scale=0.3, size=3)
    reach = rng.normal(size=3)
    if kinetic != "spatial":
        points = np.vstack([points, points * [1.0, 1.0, -1.0]])
        reach[2] = 0.0
    if kinetic == "planar-symmetric":
        points = np.vstack([points, points * [1.0, -1.0, 1.0]])
        reach[1] = 0.0
    reach *= rng.uniform(0.3, 1.5) / np.linalg.norm(reach)
    masses = np.tile(rng.uniform(0.5, 1.5, 10), len(points) // 10)
    masses *= weight / masses.sum()
    points, reach = plane.apply(points), plane.apply(reach)
    centre = masses @ points / weight
    spread = points - centre
    second = (spread.T * masses) @ spread
    tensor = np.trace(second) * np.eye(3) - second
    ixx, ixy, ixz, iyy, iyz, izz = (Quantity(float(entry)) for entry in tensor[_UPPER])
    return Body(
        name,
        Quantity(weight),
        _three(centre),
        (ixx, ixy, ixz, iyy, iyz, izz),
        None if last else _three(reach),
    )


def _drive(rng: np.random.Generator, name: str, ratio: float, flexible: bool) -> JointModel:
    """A rotor of 0.5..20 kg m^2 after the gear, that swings on its spring at 15..60 rad/s, damped by 2..20 %."""
    reflected = 0.5 * 40.0 ** rng.uniform()
    frequency = rng.uniform(15.0, 60.0)
    stiffness = reflected * frequency**2
    damping = 2.0 * rng.uniform(0.02, 0.2) * reflected * frequency
    return JointModel(
        name,
        Quantity(float(rng.uniform(0.2, 5.0))),
        Quantity(float(reflected / ratio**2)),
        Quantity(float(stiffness) if flexible else np.inf),
        Quantity(float(damping) if flexible else 0.0),
    )


def _unit(rng: np.random.Generator, length: float = 1.0) -> tuple[float, float, float]:
    vector = rng.normal(size=3)
    return _three(length * vector / np.linalg.norm(vector))


def _three(vector: Floats) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def arm_of_known_lengths() -> tuple[Arm, NDArray[np.float64]]:
    """Two flexible joints on the ground, and the values (p,) of its independent parameters."""
    arm, model = random_arm(2, 2, "fixed", "spatial", True)
    places = ((0.0, 0.0, 0.3), (0.4, 0.1, 0.2))
    joints = tuple(replace(joint, position_m=place) for joint, place in zip(arm.joints, places, strict=True))
    known = replace(arm, joints=joints)
    full = np.array(model.base_values(arm))
    return known, np.linalg.lstsq(known.structure.basis, full, rcond=None)[0]

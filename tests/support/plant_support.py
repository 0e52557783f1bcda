# SPDX-License-Identifier: MIT
"""The files of examples/lively, and arms made of random bodies, for the tests of the plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from arm_support import exact_torques
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm, Encoder, Imu, Joint, Kinetic, load_arm
from zygos.model.model import Body, JointModel, Model, Quantity, load_model
from zygos.simulation.scenario import Scenario, load_scenario

Floats = NDArray[np.float64]
LIVELY = Path(__file__).parents[2] / "examples" / "lively"


def example(name: str) -> tuple[Arm, Model, Scenario]:
    """Arm, model and scenario of a folder of examples/; the gains of the torque sensors are exact."""
    folder = LIVELY.parent / name
    return (
        exact_torques(load_arm(folder / "arm.toml")),
        load_model(folder / "model.toml"),
        load_scenario(folder / "scenario.toml"),
    )


def lively() -> tuple[Arm, Model, Scenario]:
    return example("lively")


def random_arm(rng: np.random.Generator, joints: int, kinetic: Kinetic = "planar") -> tuple[Arm, Model]:
    """An arm whose joints turn about one random axis, of random bodies; flat ones, as planar motion requires.

    Body 0's plane is turned at random in the base frame; the joint frames of planar-symmetric arms are aligned.
    """
    plane = Rotation.random(random_state=int(rng.integers(2**31)))
    straight = kinetic == "planar-symmetric"
    encoder = Encoder(quantum_rad=1e-6)
    hardware: list[Joint] = []
    bodies: list[Body] = []
    drives: list[JointModel] = []
    for i in range(joints + 1):
        turn = plane if i == 0 else Rotation.identity()
        points = rng.normal(size=(8, 2)) * [1.0, 0.0 if straight else 1.0]
        masses = rng.uniform(0.5, 5.0, 8)
        centre = masses @ points / masses.sum()
        spread = points - centre
        ixx = masses @ spread[:, 1] ** 2 + 0.1
        iyy = masses @ spread[:, 0] ** 2 + 0.1
        ixy = -masses @ (spread[:, 0] * spread[:, 1])
        tensor = turn.as_matrix() @ np.array([[ixx, ixy, 0], [ixy, iyy, 0], [0, 0, ixx + iyy]]) @ turn.as_matrix().T
        entries = [
            Quantity(float(tensor[row, column])) for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        ]
        origin = turn.apply([*centre, 0.0])
        reach = turn.apply([rng.uniform(0.5, 3.0), 0.0 if straight else rng.normal(), 0.0])
        last = i == joints
        bodies.append(
            Body(
                f"body{i}",
                Quantity(float(masses.sum())),
                (origin[0], origin[1], origin[2]),
                (entries[0], entries[1], entries[2], entries[3], entries[4], entries[5]),
                None if last else (reach[0], reach[1], reach[2]),
            )
        )
        if last:
            break
        local = Rotation.identity() if straight else Rotation.from_euler("z", rng.uniform(-3, 3))
        rpy = (turn * local).as_euler("xyz")
        hardware.append(
            Joint(
                f"joint{i + 1}",
                i + 1,
                (0.0, 0.0, 1.0),
                (rpy[0], rpy[1], rpy[2]),
                float(rng.uniform(20, 120)),
                encoder,
                encoder,
            )
        )
        drives.append(
            JointModel(
                f"joint{i + 1}",
                Quantity(float(rng.uniform(0, 2))),
                Quantity(float(rng.uniform(1e-4, 1e-2))),
                Quantity(float(rng.uniform(10, 1000))),
                Quantity(float(rng.uniform(0, 50))),
            )
        )
    arm = Arm(
        "random",
        "free",
        kinetic,
        0.01,
        "applied_from_sync",
        "rotor",
        tuple(hardware),
        Imu(16, (0.0, 0.0, 0.0, 1.0), 1e-6, 1e-9),
    )
    return arm, Model("random", tuple(bodies), tuple(drives))

# SPDX-License-Identifier: MIT
"""Arms as they stand in laboratories: the geometry of real ones, with inertias, drives and friction made up here."""

from __future__ import annotations

import numpy as np

from zygos.arm import NO_IMU, Arm, Encoder, Joint, Smoother, TorqueLaw
from zygos.effects import Effect, effect
from zygos.model.model import Body, JointModel, Model, Quantity

HALF = 1.57079632679
Vector = tuple[float, float, float]

GEOMETRY: dict[str, list[tuple[Vector, Vector, Vector]]] = {
    "UR10e": [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.181), (0.0, 0.0, 1.0)),
        ((0.0, HALF, 0.0), (0.0, 0.176, 0.0), (0.0, 1.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, -0.137, 0.613), (0.0, 1.0, 0.0)),
        ((0.0, HALF, 0.0), (0.0, 0.0, 0.571), (0.0, 1.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.135, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.12), (0.0, 1.0, 0.0)),
    ],
    "Panda": [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.333), (0.0, 0.0, 1.0)),
        ((-HALF, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((HALF, 0.0, 0.0), (0.0, -0.316, 0.0), (0.0, 0.0, 1.0)),
        ((HALF, 0.0, 0.0), (0.0825, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((-HALF, 0.0, 0.0), (-0.0825, 0.384, 0.0), (0.0, 0.0, 1.0)),
        ((HALF, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((HALF, 0.0, 0.0), (0.088, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ],
    "LWR4+": [
        ((0.0, 0.0, 0.0), (-0.25, 0.0, 1.11), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.2005), (0.0, -1.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), (0.0, 1.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.2), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.19), (0.0, -1.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.078), (0.0, 0.0, 1.0)),
    ],
}
"""By name of the arm, for each joint: rpy [rad] and xyz [m] of its frame in that of the joint before, and its axis."""


def laboratory_arm(
    name: str,
    period_s: float = 0.002,
    torque_law: TorqueLaw = "applied_from_sync",
    friction: bool = True,
    torque_noise: float = 0.01,
) -> tuple[Arm, Model]:
    """An arm of `GEOMETRY` on the ground with rigid joints, its links growing lighter towards the tip.

    Encoders have 65536 steps a turn of the joint. torque_noise: standard deviation of a torque, as a share of that
    which the joint typically needs. friction: Coulomb and viscous, at the motors.
    """
    geometry = GEOMETRY[name]
    rng = np.random.default_rng(len(geometry) + int(1e4 * geometry[-1][1][2]))
    count = len(geometry)
    mass = 12.0 * 0.7 ** np.arange(count)
    reach = [np.linalg.norm(xyz) for _, xyz, _ in geometry[1:]] + [0.08]
    joints, drives, effects = [], [], list[Effect]()
    bodies = [
        Body("base_link", Quantity(0.0), (0.0, 0.0, 0.0), tuple([Quantity(0.0)] * 6), geometry[0][1])  # type: ignore[arg-type]
    ]
    for i, (rpy, xyz, axis) in enumerate(geometry):
        onward = np.array(geometry[i + 1][1] if i + 1 < count else (0.0, 0.0, 0.08))
        centre = 0.5 * onward + rng.normal(scale=0.02, size=3)
        size = np.array([0.06, 0.06, 0.06]) + 0.5 * np.abs(onward)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        second = mass[i] / 5.0 * (np.diag(size**2) + 0.1 * 0.06**2 * turn @ np.diag([1.0, 2.0, 3.0]) @ turn.T)
        tensor = np.trace(second) * np.eye(3) - second
        inertia = tuple(Quantity(float(tensor[a, b])) for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
        x, y, z = (float(c) for c in centre)
        bodies.append(
            Body(
                f"link{i + 1}",
                Quantity(float(mass[i])),
                (x, y, z),
                inertia,
                geometry[i + 1][1] if i + 1 < count else None,
            )  # type: ignore[arg-type]
        )
        ratio = 100.0
        beyond = float(mass[i:].sum() * 9.81 * 0.5 * sum(reach[i:]) * 0.5)
        turned = float(mass[i:].sum() * (0.5 * sum(reach[i:])) ** 2 * 0.3 + 0.02)
        joints.append(
            Joint(
                f"joint{i + 1}",
                i + 1,
                axis,
                rpy,
                ratio,
                encoder := Encoder(quantum_rad=2.0 * np.pi / 65536, counts=65536),
                encoder,
                torque_sigma=torque_noise * beyond / ratio,
                flexible=False,
                position_m=xyz,
            )
        )
        drives.append(
            JointModel(f"joint{i + 1}", Quantity(0.0), Quantity(turned / ratio**2), Quantity(np.inf), Quantity(0.0))
        )
        if friction:
            effects.append(effect("motor_coulomb", f"joint{i + 1}", 0.05 * beyond / ratio))
            effects.append(effect("motor_viscous", f"joint{i + 1}", 0.05 * beyond / ratio))
    arm = Arm(
        name,
        "fixed",
        "spatial",
        period_s,
        torque_law,
        "rotor",
        tuple(joints),
        NO_IMU,
        smoother=Smoother(31, 4, 15),
        gravity=(0.0, 0.0, -9.81),
    )
    return arm, Model(name, tuple(bodies), tuple(drives), effects=tuple(effects))

# SPDX-License-Identifier: MIT
"""What the tests of the planar equations share: the arm in Pinocchio, and random states."""

from __future__ import annotations

from typing import Any

import numpy as np
from plant_support import Floats

from zygos.arm import Arm
from zygos.model.model import Model


class Oracle:
    """The arm in Pinocchio: a free flyer whose rotors are bodies on joints of their own, at n * theta."""

    def __init__(self, pin: Any, arm: Arm, model: Model) -> None:
        self.pin, self.arm = pin, arm
        self.model = pin.Model()
        carrier = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        self.links: list[int] = []
        self.rotors: list[int] = []
        for i, body in enumerate(model.bodies):
            inertia = pin.Inertia(body.mass.value, np.array(body.origin_xyz), body.tensor)
            self.model.appendBodyToJoint(carrier, inertia, pin.SE3.Identity())
            if body.joint_xyz is None:
                break
            joint = arm.joints[i]
            place = pin.SE3(pin.rpy.rpyToMatrix(*joint.frame_rpy), np.array(body.joint_xyz))
            turning = pin.JointModelRevoluteUnaligned(*joint.axis)
            drive = model.joints[i]
            spin = drive.rotor_inertia.value
            rotor = self.model.addJoint(carrier, turning, place, f"rotor{i}")
            # the moments across the axis do not act in the plane; any physical ones will do
            shell = pin.Inertia(drive.rotor_mass.value, np.zeros(3), spin * np.eye(3))
            self.model.appendBodyToJoint(rotor, shell, pin.SE3.Identity())
            carrier = self.model.addJoint(carrier, turning, place, f"link{i}")
            self.rotors.append(self.model.joints[rotor].idx_v)
            self.links.append(self.model.joints[carrier].idx_v)
        self.model.gravity.setZero()
        self.data = self.model.createData()

    def place(self, q: Floats, theta: Floats, omega0: float, qd: Floats, thetad: Floats) -> tuple[Floats, Floats]:
        """Configuration and velocity at a random attitude, the mass centre at rest."""
        ratio = self.arm.gear_ratios
        position = self.pin.neutral(self.model)
        position[:3] = [0.3, -0.2, 0.1]
        position[3:7] = np.array([0.1, -0.4, 0.2, 0.9]) / np.linalg.norm([0.1, -0.4, 0.2, 0.9])
        velocity = np.zeros(self.model.nv)
        velocity[3:6] = omega0 * self.arm.axis
        for i in range(self.arm.n):
            position[self.links[i] + 1], position[self.rotors[i] + 1] = q[i], ratio[i] * theta[i]
            velocity[self.links[i]], velocity[self.rotors[i]] = qd[i], ratio[i] * thetad[i]
        momentum = self.pin.computeCentroidalMomentum(self.model, self.data, position, velocity)
        mass = self.pin.computeTotalMass(self.model)
        attitude = self.pin.Quaternion(position[3:7]).toRotationMatrix()
        velocity[:3] -= attitude.T @ momentum.linear / mass
        return position, velocity


def random_state(rng: np.random.Generator, joints: int) -> tuple[Floats, Floats, float, Floats, Floats, Floats]:
    q = rng.uniform(-3, 3, joints)
    return (
        q,
        q + rng.normal(size=joints),
        float(rng.normal()),
        rng.normal(size=joints),
        rng.normal(size=joints),
        rng.normal(size=joints),
    )

# SPDX-License-Identifier: MIT
"""The arm in Pinocchio: a free flyer or a fixed base, links and rotors as bodies on revolute joints.

A gear is a constant matrix G from the rates u = (base, qd, thetad of flexible joints) to Pinocchio's v; a rigid joint
has no thetad, its rotor turns at n qd. With v = G u the equations of motion M dv/dt + bias = force become
(G' M G) du/dt = G' (force - bias).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.model.model import Model

Array = NDArray[np.float64]


class PinocchioEngine:
    """An `Engine`. The base is at the origin in zero attitude: base axes are Pinocchio's world axes."""

    def __init__(self, arm: Arm, model: Model) -> None:
        """Build the tree of bodies from those of the model."""
        n, base = arm.n, 6 if arm.free else 0
        self._tree: Any = pin.Model()
        self._tree.gravity.linear = np.array(arm.gravity)
        carrier = self._tree.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base") if arm.free else 0
        self._link, self._rotor = np.zeros(n, dtype=int), np.zeros(n, dtype=int)
        for i, body in enumerate(model.bodies):
            inertia = pin.Inertia(body.mass.value, np.array(body.origin_xyz), body.tensor)
            self._tree.appendBodyToJoint(carrier, inertia, pin.SE3.Identity())
            if body.joint_xyz is None:
                continue
            joint, drive = arm.joints[i], model.joints[i]
            axis = np.array(joint.axis)
            place = pin.SE3(pin.rpy.rpyToMatrix(*joint.frame_rpy), np.array(body.joint_xyz))
            turning = pin.JointModelRevoluteUnaligned(*joint.axis)
            disc = 0.5 * drive.rotor_inertia.value * (np.eye(3) + np.outer(axis, axis))
            rotor = self._tree.addJoint(carrier, turning, place, f"rotor{i}")
            self._tree.appendBodyToJoint(
                rotor, pin.Inertia(drive.rotor_mass.value, np.zeros(3), disc), pin.SE3.Identity()
            )
            carrier = self._tree.addJoint(carrier, turning, place, f"link{i}")
            self._rotor[i], self._link[i] = self._tree.joints[rotor].idx_v, self._tree.joints[carrier].idx_v
        self._data: Any = self._tree.createData()

        self._stiffness = np.array([drive.stiffness.value for drive in model.joints])
        self._damping = np.array([drive.damping.value for drive in model.joints])
        flexible = np.array([joint.flexible for joint in arm.joints]) & np.isfinite(self._stiffness)
        self._flexible, self._base, self._ratio = np.flatnonzero(flexible), base, arm.gear_ratios
        self._gear = np.zeros((self._tree.nv, base + n + len(self._flexible)))
        self._gear[:base, :base] = np.eye(base)
        self._gear[self._link, base + np.arange(n)] = 1.0
        turned_by = base + np.arange(n)
        turned_by[self._flexible] = base + n + np.arange(len(self._flexible))
        if arm.torque_at == "rotor":
            self._gear[self._rotor, turned_by] = self._ratio
        # a torque behind the gear acts on the link, and the rotor's rotation is none of its causes
        self._driven = self._rotor if arm.torque_at == "rotor" else self._link

    def accelerations(
        self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        """Accelerations, as defined in `Engine`."""
        position, velocity = self._place(q, omega0, qd, thetad)
        soft, n, base = self._flexible, len(q), self._base
        spring = self._stiffness[soft] * (theta - q)[soft] + self._damping[soft] * (thetad - qd)[soft]
        force = np.zeros(self._tree.nv)
        force[self._link[soft]] = spring
        force[self._driven] = tau
        force[self._rotor[soft]] -= spring / self._ratio[soft]
        bias = pin.nonLinearEffects(self._tree, self._data, position, velocity)
        mass = np.triu(pin.crba(self._tree, self._data, position))  # Pinocchio does not guarantee the lower triangle
        mass += np.triu(mass, 1).T
        gear = self._gear
        change = np.linalg.solve(gear.T @ mass @ gear, gear.T @ (force - bias))
        link = change[base : base + n]
        motor = link.copy()
        motor[soft] = change[base + n :]
        return change[3:6] if base else np.zeros(3), link, motor

    def kinetic_energy(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> float:
        """Kinetic energy, as defined in `Engine`."""
        return float(pin.computeKineticEnergy(self._tree, self._data, *self._place(q, omega0, qd, thetad)))

    def potential_energy(self, q: Array) -> float:
        """Potential energy, as defined in `Engine`."""
        rest = np.zeros_like(q)
        return float(pin.computePotentialEnergy(self._tree, self._data, self._place(q, np.zeros(3), rest, rest)[0]))

    def momentum(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """Angular momentum, as defined in `Engine`."""
        assert self._base, "the angular momentum of an arm on a fixed base is not defined"
        placed = self._place(q, omega0, qd, thetad)
        return np.array(pin.computeCentroidalMomentum(self._tree, self._data, *placed).angular)

    def _place(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> tuple[Array, Array]:
        """Pinocchio's configuration and velocity. Rotors stand at zero, because a disc is the same at every angle."""
        position = pin.neutral(self._tree)
        position[self._link + (1 if self._base else 0)] = q  # a quaternion has one number more than a rate
        rates = np.zeros(self._gear.shape[1])
        if self._base:
            rates[3:6] = omega0
        rates[self._base : self._base + len(q)] = qd
        rates[self._base + len(q) :] = thetad[self._flexible]
        velocity = self._gear @ rates
        if self._base:
            pin.centerOfMass(self._tree, self._data, position, velocity)
            velocity[:3] -= self._data.vcom[0]
        return position, velocity

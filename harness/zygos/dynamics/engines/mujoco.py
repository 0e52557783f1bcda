# SPDX-License-Identifier: MIT
"""The arm in MuJoCo: bodies on hinges, a tendon for each spring, and a constraint force for a rigid gear.

A fixed tendon of length theta - q is spring and damper of a flexible joint. MuJoCo's own equality constraints are
slightly soft, so an exact rigid gear is computed here: with the rows C of n qd - (rotor rate) = 0 and MuJoCo's
accelerations a without them, the accelerations are a - M^-1 C' (C M^-1 C')^-1 C a (Gauss' principle of least
constraint).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.model.model import Model

Array = NDArray[np.float64]

_LIGHTEST = 1e-14
"""Mass of the body that represents a rotor's rotation, kg; MuJoCo does not accept zero."""


class MujocoEngine:
    """An `Engine`. The base is at the origin in zero attitude: base axes are MuJoCo's world axes."""

    def __init__(self, arm: Arm, model: Model) -> None:
        """Compile the arm. Errors: ZygosError for bodies that MuJoCo does not accept."""
        drives = zip(arm.joints, model.joints, strict=True)
        rigid = [i for i, (joint, drive) in enumerate(drives) if not joint.flexible or np.isinf(drive.stiffness.value)]
        try:
            self._tree: Any = mujoco.MjModel.from_xml_string(_mjcf(arm, model, rigid))
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise ZygosError(
                f"model {model.name}: MuJoCo rejects it ({reason}); remedy: correct the inertias, or use another engine"
            ) from None
        self._data: Any = mujoco.MjData(self._tree)
        self._free, self._rigid = arm.free, rigid
        # a torque behind the gear acts on the link, and the rotor's rotation is none of its causes
        sees_rotor = arm.torque_at == "rotor"
        self._ratio = arm.gear_ratios * sees_rotor
        self._rotor = np.array([self._tree.joint(f"rotor{i}").dofadr[0] for i in range(arm.n)])
        self._link = np.array([self._tree.joint(f"link{i}").dofadr[0] for i in range(arm.n)])
        self._driven = self._rotor if sees_rotor else self._link
        self._held = np.zeros((len(rigid), self._tree.nv))
        for row, i in enumerate(rigid):
            self._held[row, self._link[i]], self._held[row, self._rotor[i]] = self._ratio[i], -1.0

    def accelerations(
        self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array
    ) -> tuple[Array, Array, Array]:
        """Accelerations, as defined in `Engine`."""
        self._place(q, theta, omega0, qd, thetad, tau)
        change = self._data.qacc.copy()
        if self._rigid:
            yielding = np.empty_like(self._held)  # M^-1 C', transposed
            mujoco.mj_solveM(self._tree, self._data, yielding, self._held)
            change -= yielding.T @ np.linalg.solve(self._held @ yielding.T, self._held @ change)
        link = change[self._link]
        motor = change[self._rotor] / self._ratio if self._driven is self._rotor else link
        return change[3:6] if self._free else np.zeros(3), link, motor

    def kinetic_energy(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> float:
        """Kinetic energy, as defined in `Engine`."""
        self._place(q, q, omega0, qd, thetad, np.zeros_like(q))
        return float(self._data.energy[1])

    def potential_energy(self, q: Array) -> float:
        """Potential energy, as defined in `Engine`."""
        rest = np.zeros_like(q)
        self._place(q, q, np.zeros(3), rest, rest, rest)
        return float(self._data.energy[0])

    def momentum(self, q: Array, omega0: Array, qd: Array, thetad: Array) -> Array:
        """Angular momentum, as defined in `Engine`."""
        assert self._free, "the angular momentum of an arm on a fixed base is not defined"
        self._place(q, q, omega0, qd, thetad, np.zeros_like(q))
        mujoco.mj_subtreeVel(self._tree, self._data)
        return np.array(self._data.subtree_angmom[1])

    def _place(self, q: Array, theta: Array, omega0: Array, qd: Array, thetad: Array, tau: Array) -> None:
        """Set the state of the arm and let MuJoCo compute everything that follows from it."""
        data, shift = self._data, 1 if self._free else 0  # a quaternion has one number more than a rate
        theta, thetad = theta.copy(), thetad.copy()
        theta[self._rigid], thetad[self._rigid] = q[self._rigid], qd[self._rigid]
        data.qpos[self._link + shift], data.qpos[self._rotor + shift] = q, self._ratio * theta
        data.qvel[self._link], data.qvel[self._rotor] = qd, self._ratio * thetad
        data.qfrc_applied[self._driven] = tau
        if self._free:
            data.qvel[:3], data.qvel[3:6] = 0.0, omega0
            mujoco.mj_fwdPosition(self._tree, data)
            mujoco.mj_comVel(self._tree, data)
            mujoco.mj_subtreeVel(self._tree, data)
            data.qvel[:3] = -data.subtree_linvel[1]
        mujoco.mj_forward(self._tree, data)


def _mjcf(arm: Arm, model: Model, rigid: list[int]) -> str:
    """The arm as MJCF."""
    root, tendons = Element("mujoco"), Element("tendon")
    # capital letters: roll, pitch and yaw about fixed axes, as in URDF
    SubElement(root, "compiler", angle="radian", eulerseq="XYZ")
    option = SubElement(root, "option", gravity=_text(*arm.gravity))
    SubElement(option, "flag", constraint="disable", contact="disable", energy="enable")
    carrier, place = SubElement(root, "worldbody"), {"pos": "0 0 0"}
    for i, part in enumerate(model.bodies):
        body = SubElement(carrier, "body", place)
        if i > 0:
            SubElement(body, "joint", name=f"link{i - 1}", type="hinge", axis=_text(*arm.joints[i - 1].axis))
        elif arm.free:
            SubElement(body, "joint", type="free")
        _inertial(body, part.mass.value, part.origin_xyz, part.tensor)
        if part.joint_xyz is None:
            continue
        joint, drive = arm.joints[i], model.joints[i]
        place, carrier = {"pos": _text(*part.joint_xyz), "euler": _text(*joint.frame_rpy)}, body
        # A rotor's mass lies on its axis and moves as a point of the carrying body, so it is attached there. MuJoCo
        # shifts inertias to the arm's mass centre and back; the small moments of a rotor with mass would lose digits.
        weight = SubElement(body, "body", place)
        SubElement(weight, "inertial", pos="0 0 0", mass=_text(drive.rotor_mass.value), diaginertia="0 0 0")
        rotor = SubElement(body, "body", place)
        SubElement(rotor, "joint", name=f"rotor{i}", type="hinge", axis=_text(*joint.axis))
        disc = 0.5 * drive.rotor_inertia.value * (np.eye(3) + np.outer(joint.axis, joint.axis))
        _inertial(rotor, _LIGHTEST, (0.0, 0.0, 0.0), disc)
        if i not in rigid:
            spring = {"stiffness": _text(drive.stiffness.value), "damping": _text(drive.damping.value)}
            tendon = SubElement(tendons, "fixed", spring, springlength="0")
            SubElement(tendon, "joint", joint=f"rotor{i}", coef=_text(1.0 / joint.gear_ratio))
            SubElement(tendon, "joint", joint=f"link{i}", coef="-1")
    root.append(tendons)
    return tostring(root, encoding="unicode")


def _inertial(body: Element, mass: float, centre: Iterable[float], tensor: Array) -> None:
    """Give a body its mass (kg), mass centre (m) and inertia about it (3, 3), kg m^2, as principal moments.

    The largest moment of a flat body is the sum of the other two, and rounding must not make it larger, because MuJoCo
    has no tolerance for it. The directions are given as a quaternion, since some versions read no other form here.
    """
    (least, middle, most), axes = np.linalg.eigh(tensor)
    if most <= (least + middle) * (1 + 1e-9):
        most = min(most, least + middle)
    x, y, z, w = Rotation.from_matrix(axes * np.linalg.det(axes)).as_quat()
    SubElement(
        body,
        "inertial",
        pos=_text(*centre),
        mass=_text(mass),
        quat=_text(w, x, y, z),
        diaginertia=_text(least, middle, most),
    )


def _text(*numbers: float) -> str:
    return " ".join(repr(float(number)) for number in numbers)

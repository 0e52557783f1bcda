# SPDX-License-Identifier: MIT
"""Any arm in MuJoCo: planar or in space, free or on the ground, with flexible or rigid joints, moved by a servo.

MuJoCo integrates (RK4) and its callback of passive forces applies what is hidden. Of the package only the readers of
files are used. A free base has two slides and a hinge in a plane, and a free joint in space. A flexible joint has a
rotor that turns by n theta on the body that carries the joint, and a tendon of length theta - q to its link. The rotor
of a rigid joint of a planar arm is folded into both bodies: with inertia I it has the energy
I/2 (w + n q')^2 = I/2 (1 - n) w^2 + I/2 n (w + q')^2 + I/2 (n^2 - n) q'^2, w the rate of the body that carries it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree.ElementTree import Element, SubElement, tostring

import mujoco
import numpy as np
from numpy.typing import NDArray

from oracles.hidden import Law, LoadFriction, Motion, Now, TidalField
from zygos.arm import Arm
from zygos.model.model import Body, Model
from zygos.simulation.scenario import Scenario

Array = NDArray[np.float64]
Angles = tuple[Array, Array, Array, Array]

STEP_S = 2.5e-3
"""Longest integration step, s."""
TORQUE_STEP = 1e-4
"""A drive of a free arm takes its command in the wire's steps, Nm."""
_LIGHTEST = 1e-9
"""MuJoCo moves no body without mass, kg."""
_ROUND = 1.0 + 1e-7
"""A disc is made thicker by this, so that rounding leaves a body that can be."""


@dataclass(frozen=True)
class Payload:
    """A mass that the last body takes up at an instant, at a point of it, kg, s and m."""

    mass: float
    instant: float
    point: tuple[float, float, float]


@dataclass(frozen=True)
class Swinging:
    """A body on a spring in the base, which no sensor sees: fuel on a slide, or a panel on a hinge."""

    kind: Literal["slide", "hinge"]
    axis: tuple[float, float, float]
    place: tuple[float, float, float]
    """Of its mass centre, m."""
    mass: float
    inertia: float
    """About each axis through its mass centre, kg m^2."""
    frequency: float
    """Of the body on its spring in a base that does not move, Hz."""
    damping: float
    """Ratio."""

    def put(self, base: Element) -> None:
        """Add it to the base."""
        body = SubElement(base, "body", pos=_text(self.place), name="swinging")
        size, omega = (self.mass if self.kind == "slide" else self.inertia), 2.0 * math.pi * self.frequency
        stiffness, damping = repr(size * omega**2), repr(2.0 * self.damping * size * omega)
        SubElement(body, "joint", type=self.kind, axis=_text(self.axis), stiffness=stiffness, damping=damping)
        SubElement(body, "inertial", pos="0 0 0", mass=repr(self.mass), diaginertia=_text([self.inertia] * 3))


class TreePlant:
    """An arm of the bodies and joints of a model."""

    def __init__(self, arm: Arm, model: Model, swinging: Swinging | None = None) -> None:
        """Compile the arm."""
        self.arm, self.drawn = arm, model
        self.model = mujoco.MjModel.from_xml_string(mjcf(arm, model, swinging))
        self.ratio = arm.gear_ratios
        tree = self.model
        self.link = np.array([tree.joint(f"q{i + 1}").dofadr[0] for i in range(arm.n)])
        self.link_at = np.array([tree.joint(f"q{i + 1}").qposadr[0] for i in range(arm.n)])
        self.soft = np.array([i for i, joint in enumerate(arm.joints) if joint.flexible], dtype=int)
        self.rotor = self.link.copy()
        self.rotor_at = self.link_at.copy()
        for i in self.soft:
            self.rotor[i] = tree.joint(f"rotor{i + 1}").dofadr[0]
            self.rotor_at[i] = tree.joint(f"rotor{i + 1}").qposadr[0]
        self.turns = np.where([joint.flexible for joint in arm.joints], self.ratio, 1.0)
        """(N,) angle of the hinge that the motor's angle after the gear is read from."""
        self.spring = np.array([j.stiffness.value if h.flexible else 0.0 for j, h in zip(model.joints, arm.joints)])  # noqa: B905
        self.damper = np.array([j.damping.value if h.flexible else 0.0 for j, h in zip(model.joints, arm.joints)])  # noqa: B905

    def angles(self, data: mujoco.MjData) -> Angles:
        """q, q', theta, theta' (N,) of a state."""
        return (
            data.qpos[self.link_at],
            data.qvel[self.link],
            data.qpos[self.rotor_at] / self.turns,
            data.qvel[self.rotor] / self.turns,
        )

    def base(self, data: mujoco.MjData) -> tuple[Array, float]:
        """Rate of the base in its axes (3,), and its attitude: the angle of a planar one, else that about z."""
        if not self.arm.free:
            return np.zeros(3), 0.0
        if self.arm.spatial:
            w, x, y, z = data.qpos[3:7]
            return data.qvel[3:6].copy(), math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.array(self.arm.axis) * data.qvel[2], float(data.qpos[2])

    def energy(self, data: mujoco.MjData) -> float:
        """Kinetic and potential energy, springs included, J."""
        mujoco.mj_energyPos(self.model, data)
        mujoco.mj_energyVel(self.model, data)
        return float(data.energy.sum())

    def momentum(self, data: mujoco.MjData) -> Array:
        """(3,) angular momentum about the mass centre in world axes, Nms."""
        mujoco.mj_forward(self.model, data)
        mujoco.mj_subtreeVel(self.model, data)
        return np.array(data.subtree_angmom[1])

    def start(self, scenario: Scenario) -> mujoco.MjData:
        """Springs relaxed, joints and mass centre at rest, the angular momentum wanted."""
        data = mujoco.MjData(self.model)
        angles = np.array(scenario.initial_angles_rad or np.zeros(self.arm.n))
        data.qpos[self.link_at] = angles
        data.qpos[self.rotor_at] = self.turns * angles
        if not self.arm.free:
            return data
        wanted = np.atleast_1d(np.asarray(scenario.angular_momentum_nms, dtype=np.float64))
        if self.arm.spatial:
            wanted = wanted if len(wanted) == 3 else np.array([0.0, 0.0, wanted[0]])
            dofs = [3, 4, 5]
        else:
            wanted, dofs = wanted[0] * np.array(self.arm.axis), [2]
        columns = []
        for dof in dofs:
            data.qvel[:] = 0.0
            data.qvel[dof] = 1.0
            columns.append(self.momentum(data))
        data.qvel[:] = 0.0
        data.qvel[dofs] = np.linalg.lstsq(np.column_stack(columns), wanted, rcond=None)[0]
        self.momentum(data)
        drift = data.subtree_linvel[1].copy()
        if self.arm.spatial:
            data.qvel[:3] -= drift
        else:
            first, second = across(np.array(self.arm.axis))
            data.qvel[:2] -= [first @ drift, second @ drift]
        return data

    def direction(self, law: Law) -> Array:
        """(nv,) of a law's torque."""
        out, i = np.zeros(self.model.nv), law.joint
        if law.place == "motor":
            out[self.rotor[i]] = 1.0 if i in self.soft else self.ratio[i]
        elif law.place == "link":
            out[self.link[i]] = 1.0
        elif law.place == "spring":
            assert i in self.soft, "a rigid joint has no spring"
            out[self.link[i]], out[self.rotor[i]] = 1.0, -1.0 / self.ratio[i]
        elif law.place == "base":
            out[5 if self.arm.spatial else 2] = 1.0
        return out

    def tide(self, data: mujoco.MjData, law: TidalField) -> Array:
        """(bodies, 6) what the Earth's gravity does to every body beside the acceleration of the mass centre: a force
        at its own mass centre, and the torque that turns its long axis towards the Earth; world axes."""
        tree, earth, rate = self.model, np.array(law.nadir), law.size / 3.0
        place = data.xipos - tree.body_mass @ data.xipos / tree.body_mass.sum()
        force = rate * tree.body_mass[:, None] * (3.0 * np.outer(place @ earth, earth) - place)
        turn = data.ximat.reshape(-1, 3, 3)
        along = tree.body_inertia * (earth @ turn)
        torque = 3.0 * rate * np.cross(earth, (turn @ along[..., None])[..., 0])
        return np.concatenate([force, torque], axis=1)

    def step_s(self, laws: Sequence[Law]) -> float:
        """Integration step that the stiffest friction allows, a whole part of the period."""
        data = self.start(Scenario("", self.arm_path, self.arm_path, 1.0, {}))
        mujoco.mj_forward(self.model, data)
        inertia = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, inertia)
        mobility = np.linalg.inv(inertia)
        step = STEP_S
        for law in laws:
            along = self.direction(law)
            # a motor's torque acts before the gear, its rate is after it
            slope = law.stiffness() * float(along @ mobility @ along)
            slope /= self.ratio[law.joint] if law.place == "motor" else 1.0
            step = min(step, 1.2 / slope) if slope > 0.0 else step
        return self.arm.period_s / math.ceil(self.arm.period_s / max(step, 5e-5) - 1e-9)

    @property
    def arm_path(self):  # type: ignore[no-untyped-def]
        """A scenario wants paths; nothing reads these."""
        from pathlib import Path

        return Path("arm.toml")

    def run(
        self,
        scenario: Scenario,
        laws: Sequence[Law] = (),
        *,
        quantum: Array | None = None,
        payload: Payload | None = None,
        duration_s: float | None = None,
        step_s: float | None = None,
    ) -> Motion:
        """Move the arm and keep the exact motion.

        Arms whose torques act from SYNC on have a sampled servo (motor angles rounded to `quantum` (N,), if given); in
        arms whose torques are sampled a servo with feed-forward acts at every instant, as the torque of a drive with a
        fast inner loop does.
        """
        arm, period = self.arm, self.arm.period_s
        n = round((duration_s or scenario.duration_s) / period)
        laws = [copy.copy(law) for law in laws]
        step = step_s or self.step_s(laws)
        substeps = round(period / step)
        tree = copy.copy(self.model)
        tree.opt.timestep = period / substeps
        names = [joint.name for joint in arm.joints]
        data = self.start(scenario)
        held = np.zeros(arm.n)
        sampled = arm.torque_law == "sampled"
        follow = _Servo(self, scenario, n, substeps) if sampled else None
        directions = [self.direction(law) for law in laws]
        lasting = [law for law in laws if _lasts(law)]
        load = np.zeros(arm.n)

        def now(law: Law, state: mujoco.MjData, tau: Array, angles: Angles, base: tuple[Array, float]) -> Now:
            i = law.joint
            q, qd, theta, thetad = angles
            return Now(
                state.time, tree.opt.timestep, q.item(i), qd.item(i), theta.item(i), thetad.item(i),
                self.spring.item(i), self.ratio.item(i), tau.item(i), load.item(i), base[0], base[1], qd,
            )  # fmt: skip

        drive_to = np.where([joint.flexible for joint in arm.joints], 1.0, self.ratio)

        def passive(_: mujoco.MjModel, state: mujoco.MjData) -> None:
            angles = self.angles(state)
            tau = held if follow is None else follow.torque(state.time, angles[0], angles[1])
            if follow is not None:
                state.qfrc_passive[self.rotor] += drive_to * tau
            if laws:
                base = of_base(state)
                for law, along in zip(laws, directions, strict=True):
                    if isinstance(law, TidalField):
                        state.xfrc_applied[:] = self.tide(state, law)
                        continue
                    state.qfrc_passive += law.torque(now(law, state, tau, angles, base)) * along

        needs_callback = bool(laws) or follow is not None
        outside = any(law.place == "base" for law in laws)
        still = np.zeros(3), 0.0
        of_base = self.base if outside else lambda _: still
        keep = {name: np.empty((n, arm.n)) for name in ("q", "qd", "theta", "thetad", "tau", "load")}
        omega, attitude, torques = np.empty((n, 3)), np.empty(n), np.empty((n, len(laws)))
        t = period * np.arange(n)
        desired, desired_rate = scenario.desired(names, t) if follow is None else (np.zeros((n, arm.n)),) * 2
        servo, before = scenario.controller, None
        kp, kd = np.broadcast_to(servo.kp, arm.n), np.broadcast_to(servo.kd, arm.n)
        mujoco.set_mjcb_passive(passive if needs_callback else None)
        try:
            for k in range(n):
                q, qd, theta, thetad = self.angles(data)
                if payload is not None and t[k] >= payload.instant:
                    self._take(tree, data, payload)
                    payload = None
                if follow is None:
                    angle = theta if quantum is None else quantum * np.rint(theta / np.where(quantum, quantum, 1.0))
                    slope = np.zeros(arm.n) if before is None else (angle - before) / period
                    before = angle
                    wanted = servo.gain * (kp * (desired[k] - angle) + kd * (desired_rate[k] - slope)) / self.ratio
                    held[:] = TORQUE_STEP * np.rint(wanted / TORQUE_STEP)
                    data.qfrc_applied[self.rotor] = drive_to * held
                    tau = held
                else:
                    tau = follow.torque(data.time, q, qd)
                base = self.base(data)
                for name, value in zip(keep, (q, qd, theta, thetad, tau, load), strict=True):
                    keep[name][k] = value
                omega[k], attitude[k] = base
                for j, law in enumerate(laws):
                    torques[k, j] = law.torque(now(law, data, tau, (q, qd, theta, thetad), base))
                for _ in range(substeps):
                    if lasting:
                        angles, base = self.angles(data), of_base(data)
                        force = held if follow is None else follow.torque(data.time, angles[0], angles[1])
                        for law in lasting:
                            law.begin(now(law, data, force, angles, base))
                    mujoco.mj_step(tree, data)
                    if lasting:
                        angles, base = self.angles(data), of_base(data)
                        load = self._load(data, force, angles)
                        for law in lasting:
                            law.end(now(law, data, force, angles, base))
                if not lasting:
                    load = self._load(data, tau, self.angles(data))
        finally:
            mujoco.set_mjcb_passive(None)
        if not all(np.isfinite(values).all() for values in keep.values()):
            raise FloatingPointError(f"scenario {scenario.name}: the motion diverges")
        return Motion(t, keep["q"], keep["qd"], keep["theta"], keep["thetad"], omega, np.unwrap(attitude), keep["tau"],
                      keep["load"], torques, self.ratio)  # fmt: skip

    def _load(self, data: mujoco.MjData, tau: Array, angles: Angles) -> Array:
        """(N,) torque that passes through each joint: that of the spring, or of the drive where it is rigid."""
        q, qd, theta, thetad = angles
        springs = self.spring * (theta - q) + self.damper * (thetad - qd)
        return np.where([joint.flexible for joint in self.arm.joints], springs, self.ratio * tau)

    def _take(self, tree: mujoco.MjModel, data: mujoco.MjData, payload: Payload) -> None:
        """Add a mass to the last body, without a jerk: it moves with the body already."""
        body = tree.body(f"body{self.arm.n}").id
        mass, centre = tree.body_mass[body], tree.body_ipos[body].copy()
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, tree.body_iquat[body])
        turn = turn.reshape(3, 3)
        point, total = np.array(payload.point), mass + payload.mass
        after = (mass * centre + payload.mass * point) / total
        tensor = turn @ np.diag(tree.body_inertia[body]) @ turn.T
        for m, at in ((mass, centre), (payload.mass, point)):
            lever = at - after
            tensor = tensor + m * (lever @ lever * np.eye(3) - np.outer(lever, lever))
        moments, axes = np.linalg.eigh(tensor)
        axes = axes * np.sign(np.linalg.det(axes))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        tree.body_mass[body], tree.body_ipos[body] = total, after
        tree.body_inertia[body], tree.body_iquat[body] = moments, quat
        tree.body_simple[:] = 0
        tree.body_sameframe[:] = 0
        kept = data.qpos.copy(), data.qvel.copy(), data.time
        mujoco.mj_setConst(tree, data)
        data.qpos[:], data.qvel[:], data.time = kept


def _lasts(law: Law) -> bool:
    """Whether a law depends on the integration step before: on a state of its own, or on the load."""
    return isinstance(law, LoadFriction) or type(law).begin is not Law.begin or type(law).end is not Law.end


class _Servo:
    """Feed-forward along the desired motion, and a continuous feedback: the torque at any instant."""

    def __init__(self, plant: TreePlant, scenario: Scenario, n: int, substeps: int) -> None:
        arm = plant.arm
        self._h = arm.period_s / substeps / 2.0
        t = self._h * np.arange(2 * substeps * n + 3)
        names = [joint.name for joint in arm.joints]
        self._angle, self._rate = scenario.desired(names, t)
        bend = scenario.accelerations(names, t)
        data = mujoco.MjData(plant.model)
        mujoco.set_mjcb_passive(None)
        stride = max(1, round(2e-3 / self._h))
        coarse = np.arange(0, len(t) + stride, stride)
        ahead = np.empty((len(coarse), arm.n))
        for row, k in enumerate(np.minimum(coarse, len(t) - 1)):
            data.qpos[plant.link_at], data.qvel[plant.link] = self._angle[k], self._rate[k]
            data.qacc[plant.link] = bend[k]
            mujoco.mj_inverse(plant.model, data)
            ahead[row] = data.qfrc_inverse[plant.link]
        self._ahead = np.column_stack([np.interp(t, self._h * coarse, ahead[:, i]) for i in range(arm.n)])
        mujoco.mj_forward(plant.model, data)
        inertia = np.zeros((plant.model.nv, plant.model.nv))
        mujoco.mj_fullM(plant.model, data, inertia)
        stiff = np.diag(inertia)[plant.link]
        self._kp, self._kd, self._ratio = 400.0 * stiff, 28.0 * stiff, plant.ratio

    def torque(self, time: float, q: Array, qd: Array) -> Array:
        """(N,) before the gear."""
        k = round(time / self._h)
        wanted = self._ahead[k] + self._kp * (self._angle[k] - q) + self._kd * (self._rate[k] - qd)
        return np.asarray(wanted / self._ratio)


def mjcf(arm: Arm, model: Model, swinging: Swinging | None = None) -> str:
    """The arm as MJCF."""
    axes = [np.array(joint.axis) for joint in arm.joints]
    root, tendons = Element("mujoco"), Element("tendon")
    SubElement(root, "compiler", angle="radian", eulerseq="XYZ")
    option = SubElement(root, "option", gravity=_text(arm.gravity), integrator="RK4")
    SubElement(
        option, "flag", dict.fromkeys("constraint contact equality frictionloss limit warmstart".split(), "disable")
    )
    parent, place = SubElement(root, "worldbody"), {"pos": "0 0 0"}
    for i, part in enumerate(model.bodies):
        body = SubElement(parent, "body", place, name=f"body{i}")
        if i == 0 and arm.free and arm.spatial:
            SubElement(body, "freejoint")
        elif i == 0 and arm.free:
            first, second = across(np.array(arm.axis))
            SubElement(body, "joint", type="slide", axis=_text(first))
            SubElement(body, "joint", type="slide", axis=_text(second))
            SubElement(body, "joint", type="hinge", axis=_text(arm.axis))
        folded = 0.0
        if i > 0:
            joint, drive = arm.joints[i - 1], model.joints[i - 1]
            hinge = SubElement(body, "joint", name=f"q{i}", type="hinge", axis=_text(joint.axis))
            if not joint.flexible and arm.torque_at == "rotor":
                spins, inertia = joint.gear_ratio, drive.rotor_inertia.value
                carried = arm.free or i > 1
                assert not arm.spatial or not carried, "rotors of rigid joints in space are not simulated"
                hinge.set("armature", repr(inertia * (spins**2 - (spins if carried else 0.0))))
                folded += inertia * spins if carried else 0.0
        if (
            part.joint_xyz is not None
            and not arm.joints[i].flexible
            and arm.torque_at == "rotor"
            and (arm.free or i > 0)
        ):
            folded -= model.joints[i].rotor_inertia.value * (arm.joints[i].gear_ratio - 1.0)
        _inertial(body, part, folded)
        if part.joint_xyz is None:
            continue
        joint, drive = arm.joints[i], model.joints[i]
        place, parent = {"pos": _text(part.joint_xyz), "euler": _text(joint.frame_rpy)}, body
        if drive.rotor_mass.value and (i > 0 or arm.free):
            weight = SubElement(body, "body", place)
            SubElement(weight, "inertial", pos="0 0 0", mass=repr(drive.rotor_mass.value), diaginertia="0 0 0")
        if joint.flexible:
            rotor = SubElement(body, "body", place)
            SubElement(rotor, "joint", name=f"rotor{i + 1}", type="hinge", axis=_text(joint.axis))
            disc = 0.5 * drive.rotor_inertia.value * (_ROUND * np.eye(3) + (2.0 - _ROUND) * np.outer(axes[i], axes[i]))
            moments = _text([disc[0, 0], disc[1, 1], disc[2, 2], disc[0, 1], disc[0, 2], disc[1, 2]])
            SubElement(rotor, "inertial", pos="0 0 0", mass=repr(_LIGHTEST), fullinertia=moments)
            spring = {"stiffness": repr(drive.stiffness.value), "damping": repr(drive.damping.value)}
            tendon = SubElement(tendons, "fixed", spring, springlength="0")
            SubElement(tendon, "joint", joint=f"rotor{i + 1}", coef=repr(1.0 / joint.gear_ratio))
            SubElement(tendon, "joint", joint=f"q{i + 1}", coef="-1")
    base = root.find("worldbody/body")
    if swinging is not None and base is not None:
        swinging.put(base)
    if len(tendons):
        root.append(tendons)
    return tostring(root, encoding="unicode")


def _inertial(element: Element, part: Body, folded: float) -> None:
    """Give a body its mass, mass centre and inertia, with what a rotor adds about every axis, kg m^2."""
    if not part.mass.value:
        return
    ixx, ixy, ixz, iyy, iyz, izz = (entry.value for entry in part.inertia)
    moments = _text([ixx + folded, iyy + folded, izz + folded, ixy, ixz, iyz])
    SubElement(element, "inertial", pos=_text(part.origin_xyz), mass=repr(part.mass.value), fullinertia=moments)


def across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed frame with the axis."""
    first = np.cross(np.roll(np.eye(3)[np.argmax(np.abs(axis))], 1), axis)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _text(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)

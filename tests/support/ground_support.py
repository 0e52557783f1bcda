# SPDX-License-Identifier: MIT
"""Recordings of arms on the ground: sums of sines with Pinocchio's inverse dynamics, friction, offsets and noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from laboratory_support import laboratory_arm
from numpy.typing import NDArray

from zygos.arm import Arm, Joint
from zygos.can.run import Run
from zygos.model.model import Body, JointModel, Model, Quantity
from zygos.runs.cycles import Cycles

Array = NDArray[np.float64]
HARMONICS = 5


def short_arm(joints: int = 3, name: str = "UR10e", **keywords: float) -> tuple[Arm, Model]:
    """The first joints of a laboratory arm, for quick tests: rows of few columns."""
    arm, model = laboratory_arm(name, **keywords)  # type: ignore[arg-type]
    own: tuple[Joint, ...] = arm.joints[:joints]
    kept = {joint.name for joint in own}
    bodies: list[Body] = [*model.bodies[:joints], replace(model.bodies[joints], joint_xyz=None)]
    drives: tuple[JointModel, ...] = model.joints[:joints]
    effects = tuple(one for one in model.effects if one.joint in kept)
    return replace(arm, joints=own, torque_law="sampled"), Model("short", tuple(bodies), drives, effects=effects)


def motion(arm: Arm, seconds: float, seed: int) -> tuple[Array, Array, Array]:
    """Angles, rates and accelerations (m, N) at the cycles: sines up to 0.75 Hz, the same for a seed."""
    rng = np.random.default_rng(1000 + seed)
    t = np.arange(round(seconds / arm.period_s)) * arm.period_s
    speed = 2.0 * np.pi * 0.15 * np.arange(1, HARMONICS + 1)
    size = rng.normal(size=(arm.n, HARMONICS)) / np.sqrt(np.arange(1, HARMONICS + 1))
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(arm.n, HARMONICS))
    turn = t[:, None, None] * speed + phase
    q = np.sum(0.5 * size * np.sin(turn), axis=-1) + rng.uniform(-1.0, 1.0, arm.n)
    qd = np.sum(0.5 * size * speed * np.cos(turn), axis=-1)
    qdd = np.sum(-0.5 * size * speed**2 * np.sin(turn), axis=-1)
    return q, qd, qdd


def torques(arm: Arm, model: Model, q: Array, qd: Array, qdd: Array) -> Array:
    """(m, N) rotor torques before the gear by Pinocchio: bodies, rotors, gravity."""
    tree = pin.Model()
    tree.gravity.linear = np.array(arm.gravity)
    carrier, links, rotors = 0, [], []
    for i, joint in enumerate(arm.joints):
        body, drive = model.bodies[i + 1], model.joints[i]
        axis = np.array(joint.axis)
        at = model.bodies[i].joint_xyz
        place = pin.SE3(pin.rpy.rpyToMatrix(*joint.frame_rpy), np.array(at))
        turning = pin.JointModelRevoluteUnaligned(*joint.axis)
        disc = 0.5 * drive.rotor_inertia.value * (np.eye(3) + np.outer(axis, axis))
        rotor = tree.addJoint(carrier, turning, place, f"rotor{i}")
        tree.appendBodyToJoint(rotor, pin.Inertia(0.0, np.zeros(3), disc), pin.SE3.Identity())
        carrier = tree.addJoint(carrier, turning, place, f"link{i}")
        inertia = pin.Inertia(body.mass.value, np.array(body.origin_xyz), body.tensor)
        tree.appendBodyToJoint(carrier, inertia, pin.SE3.Identity())
        rotors.append(tree.joints[rotor].idx_v)
        links.append(tree.joints[carrier].idx_v)
    data, out = tree.createData(), np.zeros_like(q)
    ratio = np.array([joint.gear_ratio for joint in arm.joints])
    for k in range(len(q)):
        v, a, p = np.zeros(tree.nv), np.zeros(tree.nv), np.zeros(tree.nq)
        p[links], v[links], a[links] = q[k], qd[k], qdd[k]
        v[rotors], a[rotors] = ratio * qd[k], ratio * qdd[k]
        force = pin.rnea(tree, data, p, v, a)
        out[k] = force[links] / ratio + force[rotors]
    return out


def torque_of(arm: Arm, model: Model, path: int, seconds: float) -> tuple[Array, Array]:
    """(m, N) angles and torques of a motion with friction, without noise."""
    q, qd, qdd = motion(arm, seconds, path)
    tau = torques(arm, model, q, qd, qdd)
    for effect in model.effects:
        assert effect.kind.torque is not None
        tau[:, effect.index(arm)] += effect.value * effect.kind.torque(qd[:, effect.index(arm)])
    return q, tau


def seen(arm: Arm, q: Array, tau: Array, seed: int) -> Cycles:
    """What the sensors make of it."""
    sigma = np.array([joint.torque_sigma for joint in arm.joints])
    quantum = np.array([joint.motor_encoder.quantum_rad for joint in arm.joints])
    rng = np.random.default_rng(seed)
    begin = quantum * rng.uniform(size=arm.n)
    read = quantum * np.round((q + begin) / quantum) - begin
    noisy = tau + sigma * rng.normal(size=tau.shape)
    m = len(q)
    return Cycles(np.arange(m, dtype=np.uint64), read, read, noisy, np.zeros((m, 3)), np.zeros(m, dtype=np.uint32))


def recorded(
    arm: Arm,
    model: Model,
    *,
    seconds: float = 12.0,
    path: int = 0,
    seed: int = 0,
    offset: Sequence[float] | float = 0.0,
    noise: float = 1.0,
    more: Mapping[str, float] | None = None,
) -> Run:
    """A run as CAN frames. path: which motion. offset: constants that the torque sensors add [Nm, before the gear].

    noise: that of the torques, in units of the declared one. more: "asymmetry" [Nms/rad] and "load" at every joint, and
    "gain" of the second joint's sensor.
    """
    q, qd, qdd = motion(arm, seconds, path)
    ideal = torques(arm, model, q, qd, qdd)
    tau = ideal.copy()
    for effect in model.effects:
        j, kind = effect.index(arm), effect.kind
        assert kind.torque is not None
        tau[:, j] += effect.value * kind.torque(qd[:, j])
    extra = dict(more or {})
    tau += extra.get("asymmetry", 0.0) * np.abs(qd) + extra.get("load", 0.0) * np.abs(ideal) * np.sign(qd)
    if "gain" in extra:
        tau[:, 1] /= 1.0 + extra["gain"]
    rng = np.random.default_rng(seed)
    sigma = noise * np.array([joint.torque_sigma for joint in arm.joints])
    tau = tau + offset + sigma * rng.normal(size=tau.shape)
    quantum = np.array([joint.motor_encoder.quantum_rad for joint in arm.joints])
    read = np.round(q / quantum) * quantum
    m = len(q)
    cycles = Cycles(
        sync=np.arange(m, dtype=np.uint64),
        q=read,
        theta=read,
        tau=tau,
        omega=np.zeros((m, 3)),
        flags=np.zeros(m, dtype=np.uint32),
    )
    return Run.of_cycles(arm, cycles)


def heavier(model: Model, mass: float, at: Sequence[float]) -> Model:
    """The model with a point mass at the last body, in its frame."""
    last = model.bodies[-1]
    own, place = last.mass.value, np.array(at)
    centre = (own * np.array(last.origin_xyz) + mass * place) / (own + mass)

    def shifted(mass: float, far: Array) -> Array:
        return mass * (far @ far * np.eye(3) - np.outer(far, far))

    tensor = last.tensor + shifted(own, np.array(last.origin_xyz) - centre) + shifted(mass, place - centre)
    entries = tuple(Quantity(float(tensor[a, b])) for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    x, y, z = (float(c) for c in centre)
    body = replace(last, mass=Quantity(own + mass), origin_xyz=(x, y, z), inertia=entries)  # type: ignore[arg-type]
    return replace(model, bodies=(*model.bodies[:-1], body))

# SPDX-License-Identifier: MIT
"""docs/conventions.md line by line: zygos and the other tools' own parsers tell of one arm the same numbers.

Every test converts as its line says, finds the number of the other tool, and then converts as is tempting and finds
another one. `close` and `apart` are the two halves.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from conftest import ROOT, need
from zygos.arm import NO_IMU, Arm, Base, Encoder, Imu, Joint, read_joint
from zygos.dynamics.pose import forward, integrated_attitudes
from zygos.dynamics.serial import SpatialDynamics
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.files.toml import Table
from zygos.model.model import Body, JointModel, Model, Quantity
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate

try:
    import mujoco
    import pinocchio as pin

    from zygos.urdf.chain import Chain, Inertial, read_chain
except (ImportError, ZygosError) as reason:
    need(None, f"{reason} (pip install 'zygos[engines,urdf]')")

Floats = NDArray[np.float64]

# an arm of one joint, with nothing along an axis and nothing symmetric
RPY = (0.3, -0.5, 0.7)
XYZ = (0.4, -0.2, 0.3)
AXIS = (1 / 3, 2 / 3, -2 / 3)
BASE_MASS, BASE_CENTRE = 5.0, (0.1, 0.2, -0.1)
BASE_TENSOR = np.array([[0.9, 0.1, -0.05], [0.1, 0.8, 0.07], [-0.05, 0.07, 0.7]])
MASS, CENTRE = 2.0, (0.3, 0.1, 0.2)
TENSOR = np.array([[0.30, 0.04, -0.03], [0.04, 0.40, 0.05], [-0.03, 0.05, 0.25]])
RATIO, ROTOR, STIFFNESS, DAMPING = 3.0, 0.2, 50.0, 4.0
OMEGA = np.array([0.7, -0.4, 0.5])
ANGLE, RATE, TORQUE = np.array([0.6]), np.array([0.9]), np.array([1.3])
ZERO, STILL = np.zeros(1), np.zeros(3)
TURNED = Rotation.from_rotvec([0.4, 1.1, -0.8]).as_matrix()
"""An attitude of the base."""
UPRIGHT = np.eye(3)
GRAVITY = (1.0, -2.0, -9.0)


def close(got: ArrayLike, wanted: ArrayLike, tolerance: float = 1e-9) -> None:
    """Equal as vectors."""
    np.testing.assert_allclose(got, wanted, rtol=0, atol=tolerance * float(np.max(np.abs(wanted))))


def apart(got: ArrayLike, wanted: ArrayLike) -> None:
    """Different by more than a hundredth."""
    assert np.linalg.norm(np.subtract(got, wanted)) > 0.01 * np.linalg.norm(wanted)


def text(values: ArrayLike) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


# zygos


def body(mass: float, centre: Sequence[float], tensor: Floats, joint: Sequence[float] | None = None) -> Body:
    ixx, ixy, ixz, iyy, iyz, izz = (Quantity(float(entry)) for entry in tensor[np.triu_indices(3)])
    x, y, z = (float(value) for value in centre)
    place = None if joint is None else (float(joint[0]), float(joint[1]), float(joint[2]))
    return Body("", Quantity(mass), (x, y, z), (ixx, ixy, ixz, iyy, iyz, izz), place)


BASE = body(BASE_MASS, BASE_CENTRE, BASE_TENSOR, XYZ)
LINK = body(MASS, CENTRE, TENSOR)


def arm_of(base: Base, *, flexible: bool = False, gravity: Sequence[float] = (0.0, 0.0, 0.0)) -> Arm:
    encoder = Encoder(quantum_rad=1e-6)
    joint = Joint("j1", 1, AXIS, RPY, RATIO, encoder, encoder, flexible=flexible)
    imu = Imu(9, (0.0, 0.0, 0.0, 1.0), 1e-6, 1e-9) if base == "free" else NO_IMU
    x, y, z = gravity
    return Arm("a", base, "spatial", 0.01, "applied_from_sync", "rotor", (joint,), imu, gravity=(x, y, z))


def zygos(
    base: Base,
    bodies: tuple[Body, Body] = (BASE, LINK),
    *,
    rotor: float = 0.0,
    rotor_mass: float = 0.0,
    flexible: bool = False,
    gravity: Sequence[float] = (0.0, 0.0, 0.0),
    effects: dict[str, float] | None = None,
) -> SpatialDynamics:
    """The arm; a joint that is not flexible and a rotor without inertia make it two bodies on a hinge."""
    stiffness, damping = (STIFFNESS, DAMPING) if flexible else (np.inf, 0.0)
    drive = JointModel("j1", Quantity(rotor_mass), Quantity(rotor), Quantity(stiffness), Quantity(damping))
    extra = tuple(Effect(CATALOGUE[key], "j1", value) for key, value in (effects or {}).items())
    return SpatialDynamics.from_model(
        arm_of(base, flexible=flexible, gravity=gravity), Model("m", bodies, (drive,), effects=extra)
    )


# the others


def inertial(mass: float, centre: ArrayLike, tensor: Floats, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> str:
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    entries = " ".join(
        f'{key}="{value!r}"' for key, value in zip(keys, tensor[np.triu_indices(3)].tolist(), strict=True)
    )
    return (
        f'<inertial><origin xyz="{text(centre)}" rpy="{text(rpy)}"/><mass value="{mass!r}"/><inertia {entries}/>'
        "</inertial>"
    )


BASE_INERTIAL = inertial(BASE_MASS, BASE_CENTRE, BASE_TENSOR)
LINK_INERTIAL = inertial(MASS, CENTRE, TENSOR)


def urdf(
    *,
    axis: str = f'<axis xyz="{text(AXIS)}"/>',
    kind: str = "revolute",
    base: str = BASE_INERTIAL,
    link: str = LINK_INERTIAL,
    rest: str = "",
) -> str:
    """The arm. `rest` goes into the joint."""
    limit = '<limit effort="6" velocity="2" lower="-9" upper="9"/>' if kind == "revolute" else ""
    return (
        f'<robot name="r"><link name="base">{base}</link><link name="l1">{link}</link>'
        f'<joint name="j1" type="{kind}"><parent link="base"/><child link="l1"/>'
        f'<origin xyz="{text(XYZ)}" rpy="{text(RPY)}"/>{axis}{limit}{rest}</joint></robot>'
    )


def imported(folder: Path, source: str) -> tuple[Chain, tuple[Inertial, ...]]:
    """What `zygos import` reads."""
    (folder / "arm.urdf").write_text(source)
    return read_chain(folder / "arm.urdf")


def pinocchio(base: Base, source: str | None = None) -> Any:
    """Pinocchio's own reading of a URDF, without gravity."""
    root = (pin.JointModelFreeFlyer(),) if base == "free" else ()
    tree = pin.buildModelFromXML(source or urdf(), *root)
    tree.gravity.linear = STILL
    return tree


def mass_matrix(tree: Any, position: Floats) -> Floats:
    upper = np.triu(pin.crba(tree, tree.createData(), position))
    return np.asarray(upper + np.triu(upper, 1).T)


def wxyz(attitude: Floats) -> Floats:
    x, y, z, w = Rotation.from_matrix(attitude).as_quat()
    return np.array([w, x, y, z])


def mj_inertial(mass: float, centre: ArrayLike, tensor: Floats) -> str:
    order = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return f'<inertial pos="{text(centre)}" mass="{mass!r}" fullinertia="{text(order)}"/>'


def hinge(attributes: str = "", name: str = "j1") -> str:
    return f'<joint type="hinge" name="{name}" axis="{text(AXIS)}" {attributes}/>'


PLACE = f'pos="{text(XYZ)}" quat="{text(wxyz(Rotation.from_euler("xyz", RPY).as_matrix()))}"'


def mjcf(
    base: Base,
    *,
    joint: str = hinge(),
    link: str = mj_inertial(MASS, CENTRE, TENSOR),
    weight: str = mj_inertial(BASE_MASS, BASE_CENTRE, BASE_TENSOR),
    beside: str = "",
    rest: str = "",
    gravity: ArrayLike = STILL,
    attitude: Floats = UPRIGHT,
) -> Any:
    """The arm. `weight` is the base's inertial, `beside` goes into its body, `rest` behind the world."""
    root = "<freejoint/>" if base == "free" else ""
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="{text(gravity)}" integrator="RK4">'
        '<flag energy="enable" contact="disable"/></option>'
        f'<worldbody><body name="base" quat="{text(wxyz(attitude))}">{root}'
        f"{weight}{beside}"
        f'<body name="l1" {PLACE}>{joint}{link}</body></body></worldbody>{rest}</mujoco>'
    )


ARMATURE = f'armature="{RATIO**2 * ROTOR!r}"'
MOTOR = f'<actuator><motor joint="j1" gear="{RATIO!r}"/></actuator>'


@dataclass(frozen=True)
class Told:
    """What an engine says of a floating arm whose mass centre rests."""

    energy: float
    momentum: Floats
    """(3,) world axes."""
    base: Floats
    """(3,) angular acceleration of the base as the engine states it."""
    joint: Floats


def of_pinocchio(tree: Any, omega0: Floats, rate: Floats, attitude: Floats = UPRIGHT) -> Told:
    """As the table says: quaternion x y z w, all velocities in base axes. Energy with the armature."""
    data, position, velocity = tree.createData(), pin.neutral(tree), np.zeros(tree.nv)
    position[3:7] = Rotation.from_matrix(attitude).as_quat()
    position[7] = ANGLE[0]
    velocity[3:6], velocity[6:] = omega0, rate
    pin.centerOfMass(tree, data, position, velocity)
    velocity[:3] = -attitude.T @ data.vcom[0]
    energy = 0.5 * velocity @ mass_matrix(tree, position) @ velocity
    momentum = np.array(pin.computeCentroidalMomentum(tree, data, position, velocity).angular)
    change = pin.aba(tree, data, position, velocity, np.zeros(tree.nv))
    return Told(float(energy), momentum, change[3:6], change[6:])


def of_mujoco(tree: Any, omega0: Floats, rate: Floats, attitude: Floats = UPRIGHT) -> Told:
    """As the table says: quaternion w x y z, angular velocity in base axes, linear in world axes."""
    data = mujoco.MjData(tree)
    data.qpos[3:7], data.qpos[7] = wxyz(attitude), ANGLE[0]
    data.qvel[3:6], data.qvel[6:] = omega0, rate
    mujoco.mj_forward(tree, data)
    mujoco.mj_subtreeVel(tree, data)
    data.qvel[:3] = -data.subtree_linvel[1]
    mujoco.mj_forward(tree, data)
    mujoco.mj_subtreeVel(tree, data)
    return Told(float(data.energy[1]), data.subtree_angmom[1].copy(), data.qacc[3:6].copy(), data.qacc[6:].copy())


def acceleration(tree: Any, angle: ArrayLike = 0.0, rate: ArrayLike = 0.0, torque: ArrayLike | None = None) -> Floats:
    """MuJoCo's, of a state on a fixed base. torque: of the actuators."""
    data = mujoco.MjData(tree)
    data.qpos[:], data.qvel[:] = angle, rate
    if torque is not None:
        data.ctrl[:] = torque
    mujoco.mj_forward(tree, data)
    return np.array(data.qacc)


def ours(dynamics: SpatialDynamics, qd: Floats = ZERO, tau: Floats = ZERO) -> Floats:
    """Joint acceleration of a rigid joint on a fixed base."""
    return dynamics.accelerations(ZERO, ZERO, STILL, qd, qd, tau)[1]


# where things are


def test_joint_frame_and_axis(tmp_path: Path) -> None:
    chain, _ = imported(tmp_path, urdf())
    hinge = chain.hinges[0]
    assert (hinge.rpy, hinge.xyz) == (RPY, XYZ)
    close(hinge.axis, AXIS)
    poses = forward(arm_of("fixed"), np.array([XYZ]), ANGLE[None], np.eye(3)[None], STILL[None])
    attitude, origin = poses.attitude[0, 1], poses.position[0, 1]

    tree = pinocchio("fixed")
    data = tree.createData()
    pin.forwardKinematics(tree, data, ANGLE)
    close(data.oMi[1].rotation, attitude)
    close(data.oMi[1].translation, origin)
    engine = mjcf("fixed")
    state = mujoco.MjData(engine)
    state.qpos[:] = ANGLE
    mujoco.mj_forward(engine, state)
    close(state.body("l1").xmat.reshape(3, 3), attitude)
    close(state.body("l1").xpos, origin)

    mount = Rotation.from_euler("xyz", RPY).as_matrix()
    apart(Rotation.from_rotvec(ANGLE * AXIS).as_matrix() @ mount, attitude)  # the axis in the carrying body's frame


def test_axis_left_out(tmp_path: Path) -> None:
    bare = urdf(axis="")
    chain, _ = imported(tmp_path, bare)
    assert chain.hinges[0].axis == (1.0, 0.0, 0.0)
    assert pinocchio("fixed", bare).joints[1].shortname() == "JointModelRX"
    silent = mjcf("fixed", joint='<joint type="hinge"/>')
    close(silent.jnt_axis[0], (0.0, 0.0, 1.0))
    apart(silent.jnt_axis[0], chain.hinges[0].axis)
    with pytest.raises(ZygosError, match="axis"):
        read_joint(Table({key: value for key, value in DRIVE.items() if key != "axis"}, Path("arm.toml")))


def test_roll_pitch_yaw() -> None:
    mount = arm_of("fixed").frames[1]
    roll, pitch, yaw = (Rotation.from_rotvec(angle * np.eye(3)[k]).as_matrix() for k, angle in enumerate(RPY))
    close(mount, yaw @ pitch @ roll)
    close(pin.rpy.rpyToMatrix(*RPY), mount)
    close(pinocchio("fixed").jointPlacements[1].rotation, mount)

    def euler(compiler: str) -> Floats:
        frame = mujoco.MjModel.from_xml_string(
            f'<mujoco><compiler {compiler}/><worldbody><body euler="{text(RPY)}"/></worldbody></mujoco>'
        )
        return Rotation.from_quat(frame.body_quat[1][[1, 2, 3, 0]]).as_matrix()

    close(euler('angle="radian" eulerseq="XYZ"'), mount)
    close(euler('angle="radian"'), roll @ pitch @ yaw)
    apart(euler('angle="radian"'), mount)
    apart(euler('eulerseq="XYZ"'), mount)  # degrees


def test_body_frame_is_the_joints() -> None:
    """MuJoCo's joint may lie off the origin of its body's frame; the numbers move by its `pos`."""
    anchor = np.array([0.2, -0.1, 0.15])
    shifted = mjcf("fixed", joint=hinge(f'pos="{text(anchor)}"'))
    state = mujoco.MjData(shifted)
    state.qpos[:] = ANGLE
    mujoco.mj_forward(shifted, state)
    centre = state.body("l1").xipos

    def of(joint_xyz: Floats, origin_xyz: Floats) -> Floats:
        poses = forward(arm_of("fixed"), joint_xyz[None], ANGLE[None], np.eye(3)[None], STILL[None])
        return np.asarray(poses.position[0, 1] + poses.attitude[0, 1] @ origin_xyz)

    close(of(XYZ + arm_of("fixed").frames[1] @ anchor, CENTRE - anchor), centre)
    apart(of(np.array(XYZ), np.array(CENTRE)), centre)


def test_numbering(tmp_path: Path) -> None:
    """An arm of two joints; the names would sort otherwise."""
    hand = 0.7
    second = (
        f'<link name="a">{inertial(hand, STILL, np.eye(3))}</link><joint name="a" type="revolute"><parent link="l1"/>'
        '<child link="a"/><limit effort="6" velocity="2" lower="-9" upper="9"/></joint></robot>'
    )
    source = urdf().replace("</robot>", second)
    chain, pieces = imported(tmp_path, source)
    assert [piece.mass for piece in pieces] == [BASE_MASS, MASS, hand]
    assert [joint.name for joint in chain.hinges] == ["j1", "a"]
    arm = arm_of("free", flexible=True)
    arm = replace(arm, joints=(*arm.joints, replace(arm.joints[0], name="a")))
    assert [entry[:2] for entry in arm.joint_parameters if entry[0] == "Im"] == [("Im", 0), ("Im", 1)]

    free, fixed = pinocchio("free", source), pinocchio("fixed", source)
    assert [free.inertias[i].mass for i in range(4)] == [0.0, BASE_MASS, MASS, hand]
    assert [fixed.inertias[i].mass for i in range(3)] == [BASE_MASS, MASS, hand]
    assert [(free.joints[i].idx_q, free.joints[i].idx_v) for i in (1, 2, 3)] == [(0, 0), (7, 6), (8, 7)]
    assert [fixed.joints[i].idx_q for i in (1, 2)] == [0, 1]
    link = f"{mj_inertial(MASS, CENTRE, TENSOR)}<body>{hinge(name='a')}{mj_inertial(hand, STILL, np.eye(3))}</body>"
    floating = mjcf("free", link=link)
    assert floating.body_mass.tolist() == [0.0, BASE_MASS, MASS, hand]
    assert [(floating.joint(name).qposadr[0], floating.joint(name).dofadr[0]) for name in ("j1", "a")] == [
        (7, 6),
        (8, 7),
    ]
    # MuJoCo's reading of a URDF makes the root link the world
    assert mujoco.MjModel.from_xml_string(source).body_mass.tolist() == [0.0, MASS, hand]
    apart(free.inertias[1].mass, pieces[1].mass)


def test_unlimited_angle() -> None:
    """Pinocchio keeps the angle of a continuous joint as cosine and sine, and so without its turns."""
    angle = 7.5
    limited, endless = pinocchio("fixed"), pinocchio("fixed", urdf(kind="continuous"))
    assert (limited.nq, endless.nq, endless.nv) == (1, 2, 1)
    data, other = limited.createData(), endless.createData()
    pin.forwardKinematics(limited, data, np.array([angle]))
    pin.forwardKinematics(endless, other, np.array([np.cos(angle), np.sin(angle)]))
    close(other.oMi[1].rotation, data.oMi[1].rotation)
    engine = mujoco.MjModel.from_xml_string(urdf(kind="continuous"))
    assert engine.nq == 1
    position = pin.integrate(endless, pin.neutral(endless), np.array([angle]))
    angle_again = np.arctan2(position[1], position[0])
    close(angle_again + 2 * np.pi, angle)
    dynamics = zygos("fixed", rotor=ROTOR, flexible=True)
    wound = dynamics.spring(np.array([angle]), np.array([angle + 0.01]), ZERO, ZERO)
    close(wound, 0.01 * STIFFNESS)
    apart(dynamics.spring(np.array([angle_again]), np.array([angle + 0.01]), ZERO, ZERO), wound)


def test_joint_zero() -> None:
    """MuJoCo's hinge stands as the file draws it at qpos = ref."""
    ref = 0.4
    engine = mjcf("fixed", joint=hinge(f'ref="{ref}"'))
    state = mujoco.MjData(engine)
    state.qpos[:] = ANGLE
    mujoco.mj_forward(engine, state)
    attitude = state.body("l1").xmat.reshape(3, 3)

    def of(zero: float) -> Floats:
        arm = arm_of("fixed")
        encoder = Encoder(quantum_rad=1e-6, zero_rad=zero)
        arm = replace(arm, joints=(replace(arm.joints[0], link_encoder=encoder, motor_encoder=encoder),))
        samples = calibrate(arm, record(ANGLE[None], TORQUE[None]))
        close(samples.theta, samples.q)
        return forward(arm, np.array([XYZ]), samples.q, np.eye(3)[None], STILL[None]).attitude[0, 1]

    close(of(ref), attitude)
    apart(of(0.0), attitude)
    apart(of(-ref), attitude)


def record(angle: Floats, torque: Floats, omega: Floats | None = None) -> Cycles:
    n = len(angle)
    rate = np.zeros((n, 3)) if omega is None else omega
    return Cycles(np.arange(n, dtype=np.uint64), angle, angle, torque, rate, np.zeros(n, dtype=np.uint32))


# what is heavy


def height(dynamics: SpatialDynamics) -> float:
    """Potential energy at ANGLE above that at zero."""
    return float(dynamics.gravity_energy(ANGLE) - dynamics.gravity_energy(ZERO))


def test_mass_centre(tmp_path: Path) -> None:
    tree = pinocchio("fixed")
    tree.gravity.linear = np.array(GRAVITY)
    data = tree.createData()
    wanted = pin.computePotentialEnergy(tree, data, ANGLE) - pin.computePotentialEnergy(tree, data, ZERO)
    centre = imported(tmp_path, urdf())[1][1].centre
    close(centre, CENTRE)
    close(tree.inertias[1].lever, centre)
    close(height(zygos("fixed", (BASE, body(MASS, centre, TENSOR)), gravity=GRAVITY)), wanted)

    engine = mjcf("fixed", gravity=GRAVITY)
    close(engine.body("l1").ipos, centre)
    state = mujoco.MjData(engine)
    mujoco.mj_forward(engine, state)
    low = state.energy[0]
    state.qpos[:] = ANGLE
    mujoco.mj_forward(engine, state)
    close(state.energy[0] - low, wanted)

    moment = tree.inertias[1].toDynamicParameters()[1:4]
    close(moment, MASS * np.array(CENTRE))
    apart(height(zygos("fixed", (BASE, body(MASS, moment, TENSOR)), gravity=GRAVITY)), wanted)


def energy(tensor: Floats) -> float:
    """Of the link that turns about its joint."""
    return float(zygos("fixed", (BASE, body(MASS, CENTRE, tensor))).kinetic_energy(ANGLE, STILL, RATE, RATE))


def link_energy(tree: Any) -> float:
    data = mujoco.MjData(tree)
    data.qpos[:], data.qvel[:] = ANGLE, RATE
    mujoco.mj_forward(tree, data)
    return float(data.energy[1])


def symmetric(six: ArrayLike) -> Floats:
    """Pinocchio's Symmetric3: xx xy yy xz yz zz."""
    xx, xy, yy, xz, yz, zz = np.asarray(six)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_inertia_reference_point(tmp_path: Path) -> None:
    tree = pinocchio("fixed")
    wanted = pin.computeKineticEnergy(tree, tree.createData(), ANGLE, RATE)
    about_centre = imported(tmp_path, urdf())[1][1].tensor
    close(about_centre, TENSOR)
    close(tree.inertias[1].inertia, TENSOR)
    close(energy(about_centre), wanted)
    close(link_energy(mjcf("fixed")), wanted)
    about_joint = symmetric(tree.inertias[1].toDynamicParameters()[4:])
    shift = MASS * (np.dot(CENTRE, CENTRE) * np.eye(3) - np.outer(CENTRE, CENTRE))
    close(about_joint - shift, TENSOR)
    apart(energy(about_joint), wanted)


def test_inertia_axes(tmp_path: Path) -> None:
    """URDF and MuJoCo may state the inertia in axes of its own."""
    principal, rpy = np.diag([0.2, 0.3, 0.4]), (0.8, -0.3, 1.2)
    axes = Rotation.from_euler("xyz", rpy).as_matrix()
    source = urdf(link=inertial(MASS, CENTRE, principal, rpy))
    tensor = imported(tmp_path, source)[1][1].tensor
    close(tensor, axes @ principal @ axes.T)
    tree = pinocchio("fixed", source)
    close(tree.inertias[1].inertia, tensor)
    wanted = pin.computeKineticEnergy(tree, tree.createData(), ANGLE, RATE)
    close(energy(tensor), wanted)
    stated = f'mass="{MASS}" quat="{text(wxyz(axes))}" diaginertia="{text(np.diag(principal))}"'
    close(link_energy(mjcf("fixed", link=f'<inertial pos="{text(CENTRE)}" {stated}/>')), wanted)
    apart(energy(principal), wanted)
    apart(energy(axes.T @ principal @ axes), wanted)


def test_inertia_entry_order(tmp_path: Path) -> None:
    entries = [entry.value for entry in LINK.inertia]
    assert entries == TENSOR[np.triu_indices(3)].tolist()
    close(imported(tmp_path, urdf())[1][1].tensor, TENSOR)
    close(symmetric(pin.Inertia(MASS, STILL, TENSOR).toDynamicParameters()[4:]), TENSOR)
    apart(symmetric(entries), TENSOR)
    engine = mjcf("fixed")
    axes = Rotation.from_quat(engine.body("l1").iquat[[1, 2, 3, 0]]).as_matrix()
    close(axes @ np.diag(engine.body("l1").inertia) @ axes.T, TENSOR)
    with pytest.raises(ValueError, match="inertia"):
        mjcf("fixed", link=f'<inertial pos="{text(CENTRE)}" mass="{MASS}" fullinertia="{text(entries)}"/>')


def test_products_of_inertia_sign(tmp_path: Path) -> None:
    """ixy = -sum m x y: of point masses, which each tool adds up by itself."""
    places = np.array([[0.3, 0.1, -0.2], [-0.1, 0.4, 0.2], [0.2, -0.3, 0.5], [-0.4, -0.2, -0.5]])
    masses = np.array([0.4, 0.6, 0.5, 0.5])
    spread = places - masses @ places / masses.sum()
    products = (spread.T * masses) @ spread
    tensor = np.trace(products) * np.eye(3) - products
    none = np.zeros((3, 3))
    points = [inertial(mass, place, none) for mass, place in zip(masses.tolist(), places, strict=True)]
    links = "".join(f'<link name="p{k}">{point}</link>' for k, point in enumerate(points[1:]))
    welds = "".join(
        f'<joint name="w{k}" type="fixed"><parent link="l1"/><child link="p{k}"/></joint>' for k in range(3)
    )
    source = urdf(link=points[0]).replace("</robot>", f"{links}{welds}</robot>")
    merged = imported(tmp_path, source)[1][1]
    close(merged.tensor, tensor)
    close(pinocchio("fixed", source).inertias[1].inertia, tensor)
    balls = "".join(
        f'<geom type="sphere" size="1e-4" mass="{mass}" pos="{text(place)}"/>'
        for mass, place in zip(masses.tolist(), places, strict=True)
    )
    engine = mjcf("fixed", link=balls)
    axes = Rotation.from_quat(engine.body("l1").iquat[[1, 2, 3, 0]]).as_matrix()
    close(axes @ np.diag(engine.body("l1").inertia) @ axes.T, tensor, 1e-6)

    def of(entries: Floats) -> float:
        dynamics = zygos("fixed", (BASE, body(float(masses.sum()), merged.centre, entries)))
        return float(dynamics.kinetic_energy(ANGLE, STILL, RATE, RATE))

    wanted = link_energy(engine)
    close(of(tensor), wanted, 1e-6)
    apart(of(2.0 * np.diag(np.diag(tensor)) - tensor), wanted)  # +sum m x y, as some drawings have it


# what drives


def test_angle_after_the_gear() -> None:
    """A rotor that is a body of its own turns n times as far."""
    dynamics = zygos("fixed", rotor=ROTOR, flexible=True)
    wanted = float(dynamics.kinetic_energy(ZERO, STILL, ZERO, RATE))  # the link rests
    thin = np.diag([ROTOR / 2, ROTOR / 2, ROTOR])
    source = urdf(axis='<axis xyz="0 0 1"/>', link=inertial(1.0, STILL, thin))
    tree = pinocchio("fixed", source)
    close(pin.computeKineticEnergy(tree, tree.createData(), ZERO, RATIO * RATE), wanted)
    apart(pin.computeKineticEnergy(tree, tree.createData(), ZERO, RATE), wanted)
    # MuJoCo's transmission counts as an encoder on the rotor
    engine = mjcf("fixed", rest=MOTOR)
    state = mujoco.MjData(engine)
    state.qpos[:], state.qvel[:] = ANGLE, RATE
    mujoco.mj_forward(engine, state)
    close(state.actuator_length, RATIO * ANGLE)
    close(0.5 * ROTOR * state.actuator_velocity**2, wanted)
    on_rotor, at_output = (
        read_joint(Table({**DRIVE, "motor_encoder": {"counts": 1000, "side": side}}, Path("arm.toml"))).motor_encoder
        for side in ("rotor", "output")
    )
    close(on_rotor.quantum_rad * RATIO, at_output.quantum_rad)
    with pytest.raises(ZygosError, match="gear_ratio"):
        read_joint(Table({**DRIVE, "gear_ratio": -RATIO, "motor_encoder": {"counts": 1000}}, Path("arm.toml")))


DRIVE = {
    "name": "j1",
    "node": 1,
    "axis": [0.0, 0.0, 1.0],
    "gear_ratio": RATIO,
    "link_encoder": {"counts": 1000},
}


def own_inertia() -> float:
    """Of the link about the joint's axis, by Pinocchio."""
    return float(mass_matrix(pinocchio("fixed"), ZERO)[0, 0])


def test_torque_before_the_gear() -> None:
    wanted = ours(zygos("fixed", rotor=ROTOR), tau=TORQUE)
    tree = pinocchio("fixed")
    tree.armature[:] = RATIO**2 * ROTOR
    close(pin.aba(tree, tree.createData(), ZERO, ZERO, RATIO * TORQUE), wanted)
    apart(pin.aba(tree, tree.createData(), ZERO, ZERO, TORQUE), wanted)
    close(acceleration(mjcf("fixed", joint=hinge(ARMATURE), rest=MOTOR), torque=TORQUE), wanted)
    direct = MOTOR.replace(repr(RATIO), "1")
    apart(acceleration(mjcf("fixed", joint=hinge(ARMATURE), rest=direct), torque=TORQUE), wanted)
    # URDF's <limit effort="6"> is reached by 2 Nm at the rotor
    limited = mujoco.MjModel.from_xml_string(urdf()).jnt_actfrcrange[0]
    assert tree.effortLimit.tolist() == [6.0] and limited.tolist() == [-6.0, 6.0]
    strongest = ours(zygos("fixed", rotor=ROTOR), tau=np.array([6.0 / RATIO]))
    close(pin.aba(tree, tree.createData(), ZERO, ZERO, tree.effortLimit), strongest)


def test_armature() -> None:
    wanted = ours(zygos("fixed", rotor=ROTOR), tau=TORQUE)
    close(wanted, RATIO * TORQUE / (own_inertia() + RATIO**2 * ROTOR))

    def by_pinocchio(**fields: float) -> Floats:
        tree = pinocchio("fixed")
        for key, value in fields.items():
            getattr(tree, key)[:] = value
        return np.array(pin.aba(tree, tree.createData(), ZERO, ZERO, RATIO * TORQUE))

    def by_mujoco(armature: float) -> Floats:
        return acceleration(mjcf("fixed", joint=hinge(f'armature="{armature}"'), rest=MOTOR), torque=TORQUE)

    close(by_pinocchio(armature=RATIO**2 * ROTOR), wanted)
    close(by_mujoco(RATIO**2 * ROTOR), wanted)
    apart(by_pinocchio(armature=ROTOR), wanted)
    apart(by_mujoco(ROTOR), wanted)
    # these two are kept, and read by no algorithm
    apart(by_pinocchio(rotorInertia=ROTOR, rotorGearRatio=RATIO), wanted)
    close(by_pinocchio(rotorInertia=ROTOR, rotorGearRatio=RATIO), RATIO * TORQUE / own_inertia())
    # nor has the kinetic energy the armature in it
    tree = pinocchio("fixed")
    tree.armature[:] = RATIO**2 * ROTOR
    of_rotor = float(zygos("fixed", rotor=ROTOR).kinetic_energy(ZERO, STILL, RATE, RATE))
    close(0.5 * RATE @ mass_matrix(tree, ZERO) @ RATE, of_rotor)
    apart(pin.computeKineticEnergy(tree, tree.createData(), ZERO, RATE), of_rotor)


def disc(moment: float, across: float | None = None) -> Floats:
    """Inertia of a rotor about AXIS in the frame of the joint; `across` it half of it, as of a thin disc."""
    along = np.outer(AXIS, AXIS)
    half = 0.5 * moment if across is None else across
    return np.asarray(half * (np.eye(3) - along) + moment * along)


MOUNT = Rotation.from_euler("xyz", RPY).as_matrix()
ROTOR_MASS = 0.6


def with_rotor_at_rest() -> tuple[float, Floats, Floats]:
    """Mass, centre and inertia of the base together with its rotor that is held."""
    whole = pin.Inertia(BASE_MASS, np.array(BASE_CENTRE), BASE_TENSOR)
    whole += pin.Inertia(ROTOR_MASS, np.array(XYZ), MOUNT @ disc(ROTOR) @ MOUNT.T)
    return whole.mass, np.array(whole.lever), np.array(whole.inertia)


def test_what_armature_leaves_out() -> None:
    """The rotor's spin meets the rotation of the body that carries it: Im n theta' a . omega of energy."""
    mass, centre, tensor = with_rotor_at_rest()
    tree = pinocchio("free", urdf(base=inertial(mass, centre, tensor)))
    tree.armature[6:] = RATIO**2 * ROTOR
    told = of_pinocchio(tree, OMEGA, RATE)
    engine = mjcf("free", joint=hinge(ARMATURE), weight=mj_inertial(mass, centre, tensor))
    close(of_mujoco(engine, OMEGA, RATE).energy, told.energy)
    real = zygos("free", rotor=ROTOR, rotor_mass=ROTOR_MASS)
    spin = ROTOR * RATIO * RATE[0] * MOUNT @ AXIS
    close(real.kinetic_energy(ANGLE, OMEGA, RATE, RATE) - told.energy, spin @ OMEGA)
    close(real.momentum(ANGLE, OMEGA, RATE, RATE) - told.momentum, spin)
    apart(told.energy, real.kinetic_energy(ANGLE, OMEGA, RATE, RATE))
    apart(told.joint, real.accelerations(ANGLE, ANGLE, OMEGA, RATE, RATE, ZERO)[1])
    # zygos with an armature in place of the rotor
    uncoupled = zygos("free", rotor=ROTOR, rotor_mass=ROTOR_MASS, effects={"rotor_coupling": 0.0})
    close(uncoupled.kinetic_energy(ANGLE, OMEGA, RATE, RATE), told.energy)
    base, link, _ = uncoupled.accelerations(ANGLE, ANGLE, OMEGA, RATE, RATE, ZERO)
    close(base, told.base)
    close(link, told.joint)


def test_rotor_in_the_carriers_inertia() -> None:
    """Others count the rotor at rest in the inertial of the body that carries it, zygos beside it."""
    mass, centre, tensor = with_rotor_at_rest()
    wanted = of_pinocchio(pinocchio("free", urdf(base=inertial(mass, centre, tensor))), OMEGA, RATE).energy

    def held(base: Body, rotor_mass: float) -> float:
        # flexible, so that the rotor can stand while the link turns
        dynamics = zygos("free", (base, LINK), rotor=ROTOR, rotor_mass=rotor_mass, flexible=True)
        return float(dynamics.kinetic_energy(ANGLE, OMEGA, RATE, ZERO))

    rest = pin.Inertia(mass, centre, tensor) - pin.Inertia(ROTOR_MASS, np.array(XYZ), MOUNT @ disc(ROTOR) @ MOUNT.T)
    close(held(body(rest.mass, rest.lever, rest.inertia, XYZ), ROTOR_MASS), wanted)
    light = tensor - MOUNT @ disc(ROTOR) @ MOUNT.T  # its mass may stay where it is
    close(held(body(mass, centre, light, XYZ), 0.0), wanted)
    apart(held(body(mass, centre, tensor, XYZ), ROTOR_MASS), wanted)


def rotor_link(tensor: Floats) -> str:
    """The rotor as a link of its own, and the end of a URDF."""
    return (
        f'<link name="rotor">{inertial(ROTOR_MASS, STILL, tensor)}</link>'
        '<joint name="spin" type="revolute"><parent link="base"/><child link="rotor"/>'
        f'<origin xyz="{text(XYZ)}" rpy="{text(RPY)}"/><axis xyz="{text(AXIS)}"/>'
        '<limit effort="1" velocity="1" lower="-9" upper="9"/></joint></robot>'
    )


def test_rotor_across_its_axis() -> None:
    """A rotor that is no thin disc."""
    across = 0.19
    tree = pinocchio("free", urdf().replace("</robot>", rotor_link(disc(ROTOR, across))))
    assert list(tree.names)[2:] == ["j1", "spin"]
    motor = np.array([1.4])
    wanted = of_pinocchio(tree, OMEGA, np.array([RATE[0], RATIO * motor[0]])).energy

    def of(base_tensor: Floats) -> float:
        bodies = (body(BASE_MASS, BASE_CENTRE, base_tensor, XYZ), LINK)
        dynamics = zygos("free", bodies, rotor=ROTOR, rotor_mass=ROTOR_MASS, flexible=True)
        return float(dynamics.kinetic_energy(ANGLE, OMEGA, RATE, motor))

    spare = MOUNT @ disc(0.0, across - ROTOR / 2) @ MOUNT.T
    close(of(BASE_TENSOR + spare), wanted)
    apart(of(BASE_TENSOR), wanted)


def series() -> str:
    """A flexible joint of MuJoCo as two hinges in series, theta and then q - theta: no rotor, but its armature."""
    spring = hinge(f'stiffness="{STIFFNESS!r}" damping="{DAMPING!r}"', "deflection")
    return hinge(ARMATURE) + spring


def tendon(link: str = "", rotor: str = "") -> Any:
    """A flexible joint of MuJoCo with a rotor and a tendon of length theta - q; attributes of its two hinges."""
    spinning = f'<inertial pos="0 0 0" mass="1" quat="{text(ACROSS)}" diaginertia="0.1 0.1 {ROTOR!r}"/>'
    return mjcf(
        "fixed",
        joint=hinge(link),
        beside=f"<body {PLACE}>{hinge(rotor, 'rotor')}{spinning}</body>",
        rest=f'<tendon><fixed stiffness="{STIFFNESS!r}" damping="{DAMPING!r}" springlength="0">'
        f'<joint joint="rotor" coef="{1 / RATIO!r}"/><joint joint="j1" coef="-1"/></fixed></tendon>',
    )


ACROSS = wxyz(Rotation.align_vectors([AXIS], [[0.0, 0.0, 1.0]])[0].as_matrix())
"""Takes z to AXIS."""
MOTOR_ANGLE, MOTOR_RATE = np.array([0.75]), np.array([1.6])


def flexible_joint(
    angles: tuple[Floats, Floats], rates: tuple[Floats, Floats], effects: dict[str, float] | None = None
) -> tuple[Floats, Floats]:
    """Link's and motor's acceleration on a fixed base; angles and rates of link and motor."""
    dynamics = zygos("fixed", rotor=ROTOR, flexible=True, effects=effects)
    return dynamics.accelerations(*angles, STILL, *rates, ZERO)[1:]


def test_stiffness_is_the_deflections() -> None:
    link, motor = flexible_joint((ANGLE, MOTOR_ANGLE), (ZERO, ZERO))
    close(link * own_inertia(), STIFFNESS * (MOTOR_ANGLE - ANGLE))
    # link and rotor as bodies: the rotor feels 1/n of the spring
    of_rotor, of_link = acceleration(tendon(), [RATIO * MOTOR_ANGLE[0], ANGLE[0]])
    close([of_link, of_rotor / RATIO], [link[0], motor[0]])
    tree = pinocchio("fixed", urdf().replace("</robot>", rotor_link(disc(ROTOR))))
    spring = STIFFNESS * (MOTOR_ANGLE[0] - ANGLE[0])
    force = np.array([spring, -spring / RATIO])
    state = np.array([ANGLE[0], RATIO * MOTOR_ANGLE[0]])
    of_link, of_rotor = pin.aba(tree, tree.createData(), state, np.zeros(2), force)
    close([of_link, of_rotor / RATIO], [link[0], motor[0]])
    # hinges in series: the second coordinate is the deflection
    change = acceleration(mjcf("fixed", joint=series()), [MOTOR_ANGLE[0], ANGLE[0] - MOTOR_ANGLE[0]])
    close([change[0] + change[1], change[0]], [link[0], motor[0]])
    # a stiffness of the link's own hinge pulls the link to zero
    held = acceleration(mjcf("fixed", joint=hinge(f'stiffness="{STIFFNESS}"')), ANGLE)
    close(held * own_inertia(), -STIFFNESS * ANGLE)
    apart(held, link)


def test_damping_is_the_deflection_rates(tmp_path: Path) -> None:
    rates = (RATE, MOTOR_RATE)
    link, motor = flexible_joint((ZERO, ZERO), rates)
    close(link * own_inertia(), DAMPING * (MOTOR_RATE - RATE))
    of_rotor, of_link = acceleration(tendon(), 0.0, [RATIO * MOTOR_RATE[0], RATE[0]])
    close([of_link, of_rotor / RATIO], [link[0], motor[0]])
    change = acceleration(mjcf("fixed", joint=series()), 0.0, [MOTOR_RATE[0], RATE[0] - MOTOR_RATE[0]])
    close([change[0] + change[1], change[0]], [link[0], motor[0]])
    # <dynamics damping> of a URDF brakes the joint, also where nothing is deflected
    damped = urdf(rest=f'<dynamics damping="{DAMPING}"/>')
    engine = mujoco.MjModel.from_xml_string(damped)
    engine.opt.gravity[:] = 0.0
    close(acceleration(engine, 0.0, RATE) * own_inertia(), -DAMPING * RATE, 1e-6)
    close(pinocchio("fixed", damped).damping, [DAMPING])
    # no deflection rate, no torque: but for what is rounded where two equal ones cancel
    alike = flexible_joint((ZERO, ZERO), (RATE, RATE))[0] * own_inertia()
    assert np.max(np.abs(alike)) <= 1e-12 * DAMPING * np.max(np.abs(RATE))
    apart(acceleration(engine, 0.0, RATE), link)
    # zygos takes none of it for its own damping, and says so
    assert any("damping" in note for note in imported(tmp_path, damped)[0].notes)


FRICTION = 0.3


def rigid_with(effect: str, value: float = FRICTION) -> Floats:
    return ours(zygos("fixed", rotor=ROTOR, effects={effect: value}), qd=RATE, tau=TORQUE)


def rigid_of_mujoco(attributes: str) -> Floats:
    engine = mjcf("fixed", joint=hinge(f"{ARMATURE} {attributes}"), rest=MOTOR)
    return acceleration(engine, 0.0, RATE, TORQUE)


def rigid_of_pinocchio(loss: ArrayLike, source: str | None = None) -> Floats:
    tree = pinocchio("fixed", source)
    tree.armature[:] = RATIO**2 * ROTOR
    return np.array(pin.aba(tree, tree.createData(), ZERO, RATE, RATIO * TORQUE - np.asarray(loss)))


def test_viscous_friction() -> None:
    """Torque before the gear, rate after it: n times is a joint's damping."""
    wanted = rigid_with("motor_viscous")
    close(rigid_of_mujoco(f'damping="{RATIO * FRICTION}"'), wanted)
    apart(rigid_of_mujoco(f'damping="{FRICTION}"'), wanted)
    apart(rigid_of_mujoco(f'damping="{RATIO**2 * FRICTION}"'), wanted)
    # friction of a rotor by its own rate, as a motor's data sheet has it
    of_sheet = FRICTION / RATIO
    close(rigid_of_mujoco(f'damping="{RATIO**2 * of_sheet}"'), wanted)
    close(rigid_of_pinocchio(RATIO * FRICTION * RATE), wanted)
    # Pinocchio reads a URDF's damping, and no algorithm uses it
    damped = urdf(rest=f'<dynamics damping="{RATIO * FRICTION}"/>')
    close(pinocchio("fixed", damped).damping, [RATIO * FRICTION])
    close(mujoco.MjModel.from_xml_string(damped).dof_damping, [RATIO * FRICTION])
    close(rigid_of_pinocchio(ZERO, damped), rigid_of_pinocchio(ZERO))
    apart(rigid_of_pinocchio(ZERO, damped), wanted)


def test_coulomb_friction() -> None:
    """At the motor before the gear, at the link after it. MuJoCo's is found by iteration."""
    wanted = rigid_with("motor_coulomb")
    close(rigid_of_mujoco(f'frictionloss="{RATIO * FRICTION}"'), wanted, 1e-6)
    apart(rigid_of_mujoco(f'frictionloss="{FRICTION}"'), wanted)
    close(rigid_of_pinocchio(RATIO * FRICTION), wanted)
    rubbing = urdf(rest=f'<dynamics friction="{RATIO * FRICTION}"/>')
    close(mujoco.MjModel.from_xml_string(rubbing).dof_frictionloss, [RATIO * FRICTION])
    close(pinocchio("fixed", rubbing).friction, [RATIO * FRICTION])
    close(rigid_of_pinocchio(ZERO, rubbing), rigid_of_pinocchio(ZERO))
    # a flexible joint: the rotor's own hinge has the rotor's friction, the link's hinge the link's
    rates, turning = (RATE, MOTOR_RATE), [RATIO * MOTOR_RATE[0], RATE[0]]
    for effect, stated in (("motor_coulomb", {"rotor": FRICTION}), ("link_coulomb", {"link": FRICTION})):
        link, motor = flexible_joint((ZERO, ZERO), rates, {effect: FRICTION})
        engine = tendon(**{place: f'frictionloss="{value}"' for place, value in stated.items()})
        of_rotor, of_link = acceleration(engine, 0.0, turning)
        close([of_link, of_rotor / RATIO], [link[0], motor[0]], 1e-6)
        plain = flexible_joint((ZERO, ZERO), rates)
        apart(np.concatenate(plain), [link[0], motor[0]])


def test_torque_and_instant() -> None:
    """A control is in force from the step that it is set for; a log taken behind the step has it one cycle late."""
    engine = mjcf("fixed", joint=hinge(ARMATURE), rest=MOTOR)
    engine.opt.timestep = 0.01
    state = mujoco.MjData(engine)
    torques = np.random.default_rng(0).normal(size=(20, 1))
    angle, energy = [], []
    for torque in torques:
        state.ctrl[:] = torque
        mujoco.mj_forward(engine, state)
        angle.append(state.qpos.copy())
        energy.append(state.energy[1])
        mujoco.mj_step(engine, state)

    def work(law: str, reported: Floats) -> Floats:
        arm = replace(arm_of("fixed"), torque_law=law)  # type: ignore[arg-type]
        samples = calibrate(arm, record(np.array(angle), reported))
        return RATIO * (samples.tau[:-1] * np.diff(samples.theta, axis=0))[:, 0]

    gained = np.diff(energy)
    before, behind = torques, np.vstack([ZERO, torques[:-1]])
    close(work("applied_from_sync", before), gained)
    close(work("applied_previous_cycle", behind), gained)
    apart(work("applied_from_sync", behind), gained)
    apart(work("applied_previous_cycle", before), gained)


# which way things turn

MOUNTED = Rotation.from_rotvec([-0.5, 0.9, 0.3])
"""Of a sensor on the base."""


def gyro_arm(xyzw: ArrayLike) -> Arm:
    x, y, z, w = np.asarray(xyzw).tolist()
    arm = arm_of("free")
    return replace(arm, imu=replace(arm.imu, mount_xyzw=(x, y, z, w)))


def test_quaternion_order() -> None:
    x, y, z, w = MOUNTED.as_quat()
    wanted = MOUNTED.as_matrix()
    close(gyro_arm([x, y, z, w]).mount, wanted)
    apart(gyro_arm([w, x, y, z]).mount, wanted)
    tree = pinocchio("free")

    def by_pinocchio(quaternion: ArrayLike) -> Floats:
        data, position = tree.createData(), pin.neutral(tree)
        position[3:7] = quaternion
        pin.forwardKinematics(tree, data, position)
        return data.oMi[1].rotation.copy()

    def by_mujoco(quaternion: ArrayLike) -> Floats:
        engine = mjcf("free")
        state = mujoco.MjData(engine)
        state.qpos[3:7] = quaternion
        mujoco.mj_forward(engine, state)
        return state.body("base").xmat.reshape(3, 3).copy()

    close(by_pinocchio([x, y, z, w]), wanted)
    apart(by_pinocchio([w, x, y, z]), wanted)
    close(by_mujoco([w, x, y, z]), wanted)
    apart(by_mujoco([x, y, z, w]), wanted)
    # four numbers to Pinocchio's constructor are in the other order than an array of four
    close(pin.Quaternion(w, x, y, z).matrix(), wanted)
    close(pin.Quaternion(np.array([x, y, z, w])).matrix(), wanted)
    apart(pin.Quaternion(x, y, z, w).matrix(), wanted)
    close(pin.rpy.rpyToMatrix(*MOUNTED.as_euler("xyz")), wanted)


def test_attitude_sense() -> None:
    """From the base's axes to the world's, as a body that turns at a rate in its own axes tells."""
    duration = 1.7
    wanted = integrated_attitudes(np.array([0.0, duration]), np.tile(OMEGA, (2, 1)))[-1]
    tree, engine = pinocchio("free"), mjcf("free")
    first = pin.neutral(tree)
    first[3:7] = Rotation.from_matrix(TURNED).as_quat()
    step = np.concatenate([STILL, OMEGA * duration, ZERO])
    data = tree.createData()
    pin.forwardKinematics(tree, data, pin.integrate(tree, first, step))
    close(data.oMi[1].rotation, TURNED @ wanted)
    state = mujoco.MjData(engine)
    state.qpos[3:7] = wxyz(TURNED)
    mujoco.mj_integratePos(engine, state.qpos, np.concatenate([STILL, OMEGA, ZERO]), duration)
    mujoco.mj_forward(engine, state)
    close(state.body("base").xmat.reshape(3, 3), TURNED @ wanted)
    apart(wanted @ TURNED, TURNED @ wanted)
    apart((TURNED @ wanted).T, TURNED @ wanted)


def test_gyro_mount(tmp_path: Path) -> None:
    """From the sensor's axes to the base's: what a URDF has as the origin of the sensor's link."""
    quaternion = text(wxyz(MOUNTED.as_matrix()))
    engine = mjcf(
        "free",
        beside=f'<site name="imu" quat="{quaternion}"/>',
        rest='<sensor><gyro site="imu"/></sensor>',
        attitude=TURNED,
    )
    state = mujoco.MjData(engine)
    state.qvel[3:6] = OMEGA
    mujoco.mj_forward(engine, state)
    reading = state.sensordata.copy()
    apart(reading, OMEGA)

    def rate(mount: Rotation) -> Floats:
        return calibrate(gyro_arm(mount.as_quat()), record(ZERO[None], ZERO[None], reading[None])).omega[0]

    close(rate(MOUNTED), OMEGA)
    apart(rate(MOUNTED.inv()), OMEGA)
    sensor = (
        '<link name="imu"/><joint name="imu_joint" type="fixed"><parent link="base"/><child link="imu"/>'
        f'<origin xyz="0 0 0" rpy="{text(MOUNTED.as_euler("xyz"))}"/></joint></robot>'
    )
    source = urdf().replace("</robot>", sensor)
    tree = pinocchio("free", source)
    velocity = np.concatenate([STILL, OMEGA, ZERO])
    data = tree.createData()
    pin.forwardKinematics(tree, data, pin.neutral(tree), velocity)
    frame = tree.getFrameId("imu")
    close(pin.getFrameVelocity(tree, data, frame, pin.LOCAL).angular, reading)
    (_, pose), *_ = imported(tmp_path, source)[0].segments[0].riders
    close(rate(Rotation.from_matrix(pose.attitude)), OMEGA)


def test_base_rate() -> None:
    """Angular velocity and acceleration in base axes, whatever the base's attitude."""
    dynamics = zygos("free")
    wanted = float(dynamics.kinetic_energy(ANGLE, OMEGA, RATE, RATE))
    base, link, _ = dynamics.accelerations(ANGLE, ANGLE, OMEGA, RATE, RATE, ZERO)
    for told, wrong in (
        (
            of_pinocchio(pinocchio("free"), OMEGA, RATE, TURNED),
            of_pinocchio(pinocchio("free"), TURNED @ OMEGA, RATE, TURNED),
        ),
        (of_mujoco(mjcf("free"), OMEGA, RATE, TURNED), of_mujoco(mjcf("free"), TURNED @ OMEGA, RATE, TURNED)),
    ):
        close(told.energy, wanted)
        close(told.base, base)
        close(told.joint, link)
        apart(wrong.energy, wanted)
        apart(wrong.base, base)


def test_base_velocity() -> None:
    """In base axes for Pinocchio, in world axes for MuJoCo; zygos has none, its mass centre rests."""
    tree = pinocchio("free")
    data, position, velocity = tree.createData(), pin.neutral(tree), np.zeros(7)
    position[3:7], position[7] = Rotation.from_matrix(TURNED).as_quat(), ANGLE[0]
    velocity[3:6], velocity[6:] = OMEGA, RATE
    pin.centerOfMass(tree, data, position, velocity)
    velocity[:3] = -TURNED.T @ data.vcom[0]
    wanted = float(zygos("free").kinetic_energy(ANGLE, OMEGA, RATE, RATE))
    close(pin.computeKineticEnergy(tree, data, position, velocity), wanted)

    def by_mujoco(linear: Floats) -> float:
        engine = mjcf("free")
        state = mujoco.MjData(engine)
        state.qpos[3:7], state.qpos[7] = wxyz(TURNED), ANGLE[0]
        state.qvel[:] = np.concatenate([linear, OMEGA, RATE])
        mujoco.mj_forward(engine, state)
        return float(state.energy[1])

    close(by_mujoco(TURNED @ velocity[:3]), wanted)
    apart(by_mujoco(velocity[:3]), wanted)
    apart(by_mujoco(STILL), wanted)


def test_gravity() -> None:
    """The acceleration of what falls, in base axes; a base that stands turned turns it."""
    wanted = ours(zygos("fixed", gravity=GRAVITY))
    tree = pinocchio("fixed")
    tree.gravity.linear = np.array(GRAVITY)
    close(pin.aba(tree, tree.createData(), ZERO, ZERO, ZERO), wanted)
    close(acceleration(mjcf("fixed", gravity=GRAVITY)), wanted)
    upwards = tuple(-part for part in GRAVITY)  # as an accelerometer at rest reads it
    apart(ours(zygos("fixed", gravity=upwards)), wanted)

    world = np.array([0.0, 0.0, -9.81])
    assert pin.Model().gravity.linear.tolist() == world.tolist()
    assert mujoco.MjModel.from_xml_string("<mujoco/>").opt.gravity.tolist() == world.tolist()
    turned = acceleration(mjcf("fixed", gravity=world, attitude=TURNED))
    close(ours(zygos("fixed", gravity=(TURNED.T @ world).tolist())), turned)
    apart(ours(zygos("fixed", gravity=world.tolist())), turned)
    apart(ours(zygos("fixed", gravity=(TURNED @ world).tolist())), turned)


def test_angular_momentum() -> None:
    """About the mass centre, in base axes; the others have it in world axes."""
    h = zygos("free").momentum(ANGLE, OMEGA, RATE, RATE)
    tree = pinocchio("free")
    told = of_pinocchio(tree, OMEGA, RATE, TURNED)
    close(TURNED.T @ told.momentum, h)
    close(TURNED.T @ of_mujoco(mjcf("free"), OMEGA, RATE, TURNED).momentum, h)
    apart(told.momentum, h)
    # the base's rows of M v are momentum about the base's origin
    data, position, velocity = tree.createData(), pin.neutral(tree), np.concatenate([STILL, OMEGA, RATE])
    position[7] = ANGLE[0]
    close(pin.ccrba(tree, data, position, velocity)[3:] @ velocity, h)
    apart((mass_matrix(tree, position) @ velocity)[3:6], h)


# the table

TABLE = ROOT / "docs" / "conventions.md"


def test_every_line_has_its_test() -> None:
    rows = [
        [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        for line in TABLE.read_text(encoding="utf-8").splitlines()
        if line.startswith("|")
    ]
    lines = [row for row in rows if re.fullmatch(r"`test_\w+`", row[-1])]
    heads = [row for row in rows if row[-1] == "test" or set("".join(row)) <= set("-|")]
    assert len(lines) + len(heads) == len(rows)
    assert {len(row) for row in lines} == {7}
    assert all(all(row) for row in lines)
    named = [row[-1].strip("`") for row in lines]
    here = [name for name in globals() if name.startswith("test_") and name != "test_every_line_has_its_test"]
    assert sorted(named) == sorted(here)

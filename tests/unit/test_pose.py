# SPDX-License-Identifier: MIT
"""Where the bodies stand: against Pinocchio, the simulator's own attitude, and motions whose answer is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plant_support import lively, random_arm
from scipy.spatial.transform import Rotation

from conftest import need
from zygos.arm import Arm, Encoder, Imu
from zygos.dynamics.pose import forward, integrated_attitudes, mass_centre, motion, place, skeleton
from zygos.errors import ZygosError
from zygos.model.model import Model, Quantity
from zygos.runs.cycles import INVALID, Cycles
from zygos.simulation.plant import Trajectory

Floats = NDArray[np.float64]


def spatial_arm(rng: np.random.Generator, joints: int) -> tuple[Arm, Model]:
    """Random axes, frames, offsets and masses; inertias play no part here."""
    arm, model = random_arm(rng, joints)

    def vector(scale: float = 1.0) -> tuple[float, float, float]:
        x, y, z = rng.normal(size=3) * scale
        return float(x), float(y), float(z)

    def unit() -> tuple[float, float, float]:
        x, y, z = Rotation.random(random_state=int(rng.integers(2**31))).apply([0.0, 0.0, 1.0])
        return float(x), float(y), float(z)

    hardware = tuple(replace(joint, axis=unit(), frame_rpy=vector(2.0)) for joint in arm.joints)
    bodies = tuple(
        replace(body, origin_xyz=vector(), joint_xyz=None if body.joint_xyz is None else vector())
        for body in model.bodies
    )
    return replace(arm, kinetic="spatial", joints=hardware), replace(model, bodies=bodies)


def made(rng: np.random.Generator, kinetic: str, joints: int) -> tuple[Arm, Model]:
    return spatial_arm(rng, joints) if kinetic == "spatial" else random_arm(rng, joints, kinetic)  # type: ignore[arg-type]


def oracle(pin: Any, arm: Arm, model: Model) -> Any:
    """The arm joint by joint behind a free-flyer, with each rotor as a point on the carrying body."""
    built = pin.Model()
    parent = built.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    for i, body in enumerate(model.bodies):
        inertia = pin.Inertia(body.mass.value, np.array(body.origin_xyz), body.tensor)
        built.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        if body.joint_xyz is None:
            break
        joint, at = arm.joints[i], np.array(body.joint_xyz)
        point = pin.Inertia(model.joints[i].rotor_mass.value, at, np.zeros((3, 3)))
        built.appendBodyToJoint(parent, point, pin.SE3.Identity())
        frame = pin.SE3(pin.rpy.rpyToMatrix(np.array(joint.frame_rpy)), at)
        parent = built.addJoint(parent, pin.JointModelRevoluteUnaligned(np.array(joint.axis)), frame, joint.name)
    return built


@pytest.mark.parametrize("joints", range(1, 8))
@pytest.mark.parametrize("kinetic", ["planar-symmetric", "planar", "spatial"])
def test_frames_and_mass_centre_equal_pinocchio(kinetic: str, joints: int) -> None:
    need(find_spec("pinocchio"), "Pinocchio; pip install 'zygos[test]'")
    import pinocchio as pin

    rng = np.random.default_rng(joints)
    arm, model = made(rng, kinetic, joints)
    lengths = skeleton(arm, model)
    n = 20
    q, origin = rng.uniform(-7, 7, (n, joints)), rng.normal(size=(n, 3))
    base = Rotation.random(n, random_state=joints)
    poses = forward(arm, lengths.joint_xyz, q, base.as_matrix(), origin)
    centre = mass_centre(lengths, poses)
    placed = place(arm, lengths, q, base.as_matrix())
    built = oracle(pin, arm, model)
    data = built.createData()
    for k in range(n):
        state = np.concatenate([origin[k], base.as_quat()[k], q[k]])
        expected = pin.centerOfMass(built, data, state)
        size = 1.0 + max(np.linalg.norm(data.oMi[i + 1].translation) for i in range(joints + 1))
        for i in range(joints + 1):
            np.testing.assert_allclose(poses.attitude[k, i], data.oMi[i + 1].rotation, rtol=0, atol=1e-12)
            np.testing.assert_allclose(poses.position[k, i], data.oMi[i + 1].translation, rtol=0, atol=1e-12 * size)
            # the mass centre rests at the origin, and nothing else changes
            np.testing.assert_allclose(
                placed.position[k, i], data.oMi[i + 1].translation - expected, rtol=0, atol=1e-12 * size
            )
        np.testing.assert_allclose(centre[k], expected, rtol=0, atol=1e-12 * size)
    np.testing.assert_array_equal(placed.attitude, poses.attitude)


def test_an_arm_on_the_ground_stands_still() -> None:
    arm, model = random_arm(np.random.default_rng(0), 3)
    arm = replace(arm, base="fixed", imu=Imu(0, (0.0, 0.0, 0.0, 1.0), 0.0, 0.0))
    q = np.random.default_rng(1).normal(size=(5, 3))
    run = motion(arm, cycles(q, omega=np.ones((5, 3))))
    assert np.array_equal(run.base, np.tile(np.eye(3), (5, 1, 1)))
    placed = place(arm, skeleton(arm, model), run.q, run.base)
    assert not placed.position[:, 0].any()


def test_without_a_model_lengths_are_one_across_the_axes() -> None:
    arm, _ = spatial_arm(np.random.default_rng(5), 7)
    lengths = skeleton(arm, None)
    assert lengths.mass is None
    np.testing.assert_allclose(np.linalg.norm(np.vstack([lengths.joint_xyz, lengths.end_xyz]), axis=1), 1.0)
    for joint, reach in zip(arm.joints, [*lengths.joint_xyz[1:], lengths.end_xyz], strict=True):
        assert abs(np.dot(joint.axis, reach)) < 1e-12
    planar = lively()[0]  # stretched at zero angles, as planar arms count theirs
    poses = place(planar, skeleton(planar, None), np.zeros((1, 2)), np.eye(3)[None])
    np.testing.assert_allclose(poses.position[0], [[0, 0, 0], [1, 0, 0], [2, 0, 0]], atol=1e-15)


def test_a_model_of_another_arm_is_refused() -> None:
    arm, model, _ = lively()
    other = replace(arm, joints=(arm.joints[0], replace(arm.joints[1], name="wrist")))
    with pytest.raises(ZygosError, match=r"model lively has joints .*elbow.* arm lively has .*wrist.*remedy"):
        skeleton(other, model)
    with pytest.raises(ZygosError, match="does not fit arm lively"):
        skeleton(arm, Model("few", parameters={"a00": Quantity(1.0)}))


def test_attitude_of_a_body_that_tumbles() -> None:
    """Three Euler angles that run evenly, whose body rate is known in closed form; the error falls with dt^2."""
    spin, nod, wobble = 0.7, 0.4, -1.1

    def error(n: int) -> float:
        t = np.linspace(0.0, 5.0, n)
        exact = Rotation.from_euler("ZXZ", np.stack([spin * t, nod * t, wobble * t], axis=1))
        sine, cosine = np.sin(nod * t), np.cos(nod * t)
        own, own_cosine = np.sin(wobble * t), np.cos(wobble * t)
        rate = np.stack(
            [spin * sine * own + nod * own_cosine, spin * sine * own_cosine - nod * own, spin * cosine + wobble], axis=1
        )
        found = Rotation.from_matrix(integrated_attitudes(t, rate))
        return float((exact[0] * found * exact.inv()).magnitude().max())

    coarse, fine = error(101), error(201)
    assert coarse < 2e-3
    assert coarse / fine == pytest.approx(4.0, rel=0.05)


@pytest.mark.slow
def test_the_base_turns_as_the_simulator_says(clean: Callable[..., Trajectory]) -> None:
    trajectory = clean()
    run = motion(trajectory.arm, trajectory.cycles())
    turned = np.arctan2(run.base[:, 1, 0], run.base[:, 0, 0])
    assert np.ptp(trajectory.attitude[0]) > 0.5
    # the trapezoidal rule at 20 Hz
    np.testing.assert_allclose(turned, trajectory.attitude[0] - trajectory.attitude[0, 0], rtol=0, atol=2e-3)
    np.testing.assert_allclose(run.q, trajectory.q[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.deflection, trajectory.theta[0] - trajectory.q[0], rtol=0, atol=1e-12)


def cycles(q: Floats, *, theta: Floats | None = None, omega: Floats | None = None, sync: Any = None) -> Cycles:
    n = len(q)
    return Cycles(
        sync=np.arange(n, dtype=np.uint64) if sync is None else np.array(sync, dtype=np.uint64),
        q=q,
        theta=q if theta is None else theta,
        tau=np.zeros_like(q),
        omega=np.zeros((n, 3)) if omega is None else omega,
        flags=np.zeros(n, dtype=np.uint32),
    )


def test_signs_zeros_and_mount_are_applied() -> None:
    arm = lively()[0]
    link = Encoder(quantum_rad=1e-6, sign=-1, zero_rad=0.25)
    motor = Encoder(quantum_rad=1e-6, zero_rad=-0.5)
    joint = replace(arm.joints[0], link_encoder=link, motor_encoder=motor)
    # the sensor's x axis is the base's z axis
    imu = replace(arm.imu, mount_xyzw=(0.0, -np.sqrt(0.5), 0.0, np.sqrt(0.5)))
    arm = replace(arm, joints=(joint, arm.joints[1]), imu=imu)
    run = motion(
        arm,
        cycles(
            np.tile([0.05, 0.3], (3, 1)),
            theta=np.tile([-0.2, 0.4 + 32.0 * np.pi], (3, 1)),  # the second once round its range
            omega=np.tile([2.0, 0.0, 0.0], (3, 1)),
        ),
    )
    np.testing.assert_allclose(run.q, np.tile([0.2, 0.3], (3, 1)))
    np.testing.assert_allclose(run.deflection, np.tile([0.1, 0.1], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(run.time, [0.0, 0.05, 0.1])
    expected = Rotation.from_rotvec(np.outer(2.0 * run.time, [0.0, 0.0, 1.0])).as_matrix()
    np.testing.assert_allclose(run.base, expected, atol=1e-12)


def test_cycles_of_no_use_are_left_out_and_gaps_counted() -> None:
    arm = lively()[0]
    record = cycles(np.arange(12.0).reshape(6, 2), sync=[7, 8, 9, 10, 20, 21])
    record.flags[1] = INVALID
    run = motion(arm, record)
    np.testing.assert_allclose(run.time, np.array([0, 2, 3, 13, 14]) * 0.05)
    assert run.gaps == 2
    assert run.q[1].tolist() == [4.0, 5.0]


def test_a_run_without_cycles_is_refused() -> None:
    arm = lively()[0]
    with pytest.raises(ZygosError, match=r"no complete cycle of arm lively.*remedy"):
        motion(arm, cycles(np.zeros((0, 2))))
    record = cycles(np.zeros((3, 2)))
    record.flags[:] = INVALID
    with pytest.raises(ZygosError, match="no complete cycle"):
        motion(arm, record)

# SPDX-License-Identifier: MIT
"""The general kernel: columns, dynamics and conversions of arms of any kind against engines by others."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from arm_support import State as Sample
from arm_support import random_arm
from flight_support import balanced
from motion_support import FLEXIBLE, sampled_arm
from numpy.typing import NDArray
from rows_support import awkward, wandering

from zygos.arm import Arm
from zygos.balances.energy import energy_columns
from zygos.balances.kinematics import across, body_columns
from zygos.balances.state import State
from zygos.dynamics.engines import engine
from zygos.dynamics.serial import SpatialDynamics
from zygos.errors import ZygosError
from zygos.model import gram
from zygos.native.flight import Estimate, Flight, config_of, ffi, lib
from zygos.runs.cycles import Cycles

ARMS = [
    case
    for case in product((1, 3, 7), ("free", "fixed"), ("spatial", "planar", "planar-symmetric"), FLEXIBLE)
    if case[0] < 7 or case[3] == "mixed"
]
SPATIAL = [case for case in ARMS if case[1] == "fixed" or case[2] == "spatial"]


def state_of(arm: Arm, sample: Sample) -> State:
    base = sample.omega0 if arm.spatial else np.asarray(sample.omega0 @ arm.axis)
    return State(sample.q, sample.theta, sample.qd, sample.thetad, base)


@pytest.mark.parametrize(("joints", "base", "kinetic", "kind"), ARMS)
def test_columns_carry_the_energy_of_the_bodies(joints: int, base: str, kinetic: str, kind: str) -> None:
    """Columns times the parameters of the conversion are the kinetic energy, and the potential one up to a constant."""
    arm, model, samples = sampled_arm(joints, base, kinetic, kind)
    oracle = engine("pinocchio", arm, model)
    parameters = model.base_values(arm)
    names = np.array(arm.parameter_names)
    gravity = np.array([name.startswith("G") for name in names])
    spring = np.array([name in {f"{letter}{i + 1}" for letter in "kb" for i in range(joints)} for name in names])
    rows = np.array([energy_columns(arm, state_of(arm, sample), np.zeros(joints)) for sample in samples])
    kinetic_energy = rows[:, ~(gravity | spring)] @ parameters[~(gravity | spring)]
    expected = [oracle.kinetic_energy(s.q, s.omega0, s.qd, s.thetad) for s in samples]
    np.testing.assert_allclose(kinetic_energy, expected, rtol=1e-11)
    if base == "fixed":
        potential = rows[:, gravity] @ parameters[gravity]
        wanted = np.array([oracle.potential_energy(s.q) for s in samples])
        size = np.abs(wanted - wanted[0]).max() + 1.0
        np.testing.assert_allclose(potential - potential[0], wanted - wanted[0], rtol=0, atol=1e-11 * size)


@pytest.mark.parametrize(("joints", "base", "kinetic", "kind"), SPATIAL)
def test_accelerations_and_momentum(joints: int, base: str, kinetic: str, kind: str) -> None:
    arm, model, samples = sampled_arm(joints, base, kinetic, kind)
    ours = SpatialDynamics.from_model(arm, model)
    oracles = [engine(name, arm, model) for name in ("pinocchio", "mujoco")]
    for oracle, sample in product(oracles, samples):
        for got, wanted in zip(ours.accelerations(*sample), oracle.accelerations(*sample), strict=True):
            np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())
        q, _, omega0, qd, thetad, _ = sample
        assert ours.kinetic_energy(q, omega0, qd, thetad) == pytest.approx(
            oracle.kinetic_energy(q, omega0, qd, thetad), rel=1e-11
        )
        if arm.free:
            h = oracle.momentum(q, omega0, qd, thetad)
            assert np.linalg.norm(h) > 0.1
            np.testing.assert_allclose(ours.momentum(q, omega0, qd, thetad), h, rtol=0, atol=1e-11 * np.linalg.norm(h))
            np.testing.assert_allclose(ours.base_rate(q, h, qd, thetad), omega0, atol=1e-10)
        else:
            at = oracle.potential_energy(q) - oracle.potential_energy(0 * q)
            assert ours.gravity_energy(q) - ours.gravity_energy(0 * q) == pytest.approx(at, rel=1e-10, abs=1e-9)


def test_a_batch_is_its_members() -> None:
    arm, model, samples = sampled_arm(3, "free", "spatial", "mixed")
    dynamics = SpatialDynamics.from_model(arm, model)
    stacked = Sample(*(np.stack(parts) for parts in zip(*samples, strict=True)))
    for k, part in enumerate(dynamics.accelerations(*stacked)):
        one_by_one = np.stack([dynamics.accelerations(*sample)[k] for sample in samples])
        np.testing.assert_allclose(part, one_by_one, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("joints", "base", "kinetic", "kind"), ARMS)
def test_c_columns_are_those_of_numpy(joints: int, base: str, kinetic: str, kind: str) -> None:
    arm, _, samples = sampled_arm(joints, base, kinetic, kind)
    config = config_of(arm)
    column_map, geometry = ffi.new("zygos_column_map_t *"), ffi.new("zygos_geometry_t *")
    lib.zygos_balance_column_map(config, column_map)
    lib.zygos_geometry_init(geometry, config)
    assert (column_map.body, column_map.count) == (len(arm.body_parameters), len(arm.parameter_names))
    assert column_map.kinetic == sum(not name.startswith("G") for name, _ in arm.body_parameters)
    motion, state = ffi.new("zygos_motion_t *"), ffi.new("zygos_arm_state_t *")
    for sample in samples:
        state.q[0:joints], state.q_rate[0:joints] = sample.q.tolist(), sample.qd.tolist()
        state.theta[0:joints], state.theta_rate[0:joints] = sample.theta.tolist(), sample.thetad.tolist()
        state.omega = sample.omega0.tolist()
        lib.zygos_kinematics(geometry, config, state, motion)
        columns, carried = body_columns(arm, state_of(arm, sample))
        size = np.abs(columns).max()
        np.testing.assert_allclose(list(motion.column)[: column_map.body], columns, rtol=0, atol=1e-13 * size)
        np.testing.assert_allclose(list(motion.carrier_rate)[:joints], carried, rtol=0, atol=1e-13)


@pytest.mark.parametrize("joints", [1, 3, 7])
@pytest.mark.parametrize("kinetic", ["planar-symmetric", "planar"])
def test_a_planar_arm_is_a_spatial_one_that_moves_in_its_plane(joints: int, kinetic: str) -> None:
    """The general kernel is the special one's oracle: merged columns of the Gram table, in C as well."""
    arm, _, samples = sampled_arm(joints, "free", kinetic, "flexible")
    general = replace(arm, kinetic="spatial")
    names = [name for name, _ in general.body_parameters]
    for sample in samples:
        flat, _ = body_columns(arm, state_of(arm, sample))
        table = dict(zip(names, body_columns(general, state_of(general, sample))[0].tolist(), strict=True))
        value = dict(zip([name for name, _ in arm.body_parameters], flat.tolist(), strict=True))
        for i in range(1, joints + 1):
            for j in range(i, joints + 1):
                merged = table[f"N[{i}u,{j}u]"] + table[f"N[{i}v,{j}v]"]
                # the Gram product of plane vectors of length f is that of either of two directions
                assert value[f"a{i}{j}"] == pytest.approx(0.5 * merged, rel=1e-11, abs=1e-11)
                if kinetic == "planar" and i < j:
                    skew = table[f"N[{i}v,{j}u]"] - table[f"N[{i}u,{j}v]"]
                    assert abs(value[f"b{i}{j}"]) == pytest.approx(0.5 * abs(skew), rel=1e-11, abs=1e-11)


def test_directions_across_an_axis() -> None:
    axes = np.random.default_rng(0).normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    for one in (*axes, *np.eye(3), *-np.eye(3)):
        pair = across(one)
        np.testing.assert_allclose(np.column_stack([pair, one]).T @ np.column_stack([pair, one]), np.eye(3), atol=1e-15)
        u, v = ffi.new("double[3]"), ffi.new("double[3]")
        lib.zygos_perpendicular(ffi.new("double[3]", one.tolist()), u, v)
        np.testing.assert_allclose(np.column_stack([list(u), list(v)]), pair, atol=2e-16)
    np.testing.assert_array_equal(across(np.array([0.0, 0.0, -1.0])), np.eye(3)[:, :2])
    np.testing.assert_array_equal(across(np.array([0.0, 1.0, 0.0])), np.eye(3)[:, [2, 0]])


@pytest.mark.slow(only=["7"])
@pytest.mark.parametrize("joints", [1, 3, 7])
def test_every_column_of_a_free_arm_is_a_parameter(joints: int) -> None:
    """The (N+2)(2N+3) columns are independent, for any axes, and for consecutive axes that are parallel as well."""
    rng = np.random.default_rng(joints)
    for seed in range(3):
        arm, _ = random_arm(seed, joints, "free")
        if seed == 2:
            first = arm.joints[0]
            arm = replace(arm, joints=tuple(replace(j, axis=first.axis, frame_rpy=(0.0, 0.0, 0.0)) for j in arm.joints))
        samples = 4 * len(arm.parameter_names)
        q = rng.uniform(-3.0, 3.0, (samples, joints))
        state = State(q, q, rng.normal(size=q.shape), rng.normal(size=q.shape), rng.normal(size=(samples, 3)))
        columns = energy_columns(arm, state, np.zeros_like(q))[:, [n[0] in "NI" for n in arm.parameter_names]]
        columns /= np.linalg.norm(columns, axis=0)
        assert np.linalg.svd(columns, compute_uv=False)[-1] > 1e-4


@pytest.mark.parametrize("joints", [1, 3, 7])
@pytest.mark.parametrize("base", ["free", "fixed"])
def test_bodies_have_a_matrix_that_could_be_built(joints: int, base: str) -> None:
    arm, model, _ = sampled_arm(joints, base, "spatial", "flexible")
    values = model.base_values(arm)
    kinetic = values[: len(gram.pairs(arm)[0])]
    matrix = gram.from_parameters(arm, kinetic)
    np.testing.assert_allclose(gram.to_parameters(arm, matrix), kinetic, rtol=1e-12, atol=1e-12 * np.abs(kinetic).max())
    rotors = gram.of_rotors(arm, np.array([joint.rotor_inertia.value for joint in model.joints]))
    less = gram.from_parameters(arm, kinetic - gram.to_parameters(arm, rotors))
    assert np.linalg.eigvalsh(less)[0] > -1e-10 * np.abs(less).max()
    broken = values.copy()
    broken[0] = -broken[0]
    with pytest.raises(ZygosError, match="no arm has these N"):
        SpatialDynamics.from_parameters(arm, broken)
    with pytest.raises(ZygosError, match=r"values of shape .* were given"):
        SpatialDynamics.from_parameters(arm, values[1:])


def test_a_stiffness_where_the_arm_is_rigid() -> None:
    arm, model = random_arm(0, 2, "free", flexible=True)
    rigid = replace(arm, joints=tuple(replace(joint, flexible=False) for joint in arm.joints))
    with pytest.raises(ZygosError, match=r"in arm random it is rigid; remedy: write stiffness = inf"):
        model.base_values(rigid)


def estimate_of(arm: Arm, cycles: Cycles, bodies: NDArray[np.float64]) -> Estimate:
    """From torques that balance three flexible joints and bodies of that matrix (V, V), with their rotors on it."""
    rotors = np.array([1.0, 2.0, 3.0])
    drives = {"Im": rotors, "k": np.full(3, 1e3), "b": np.full(3, 50.0)}
    kinetic = gram.to_parameters(arm, bodies + gram.of_rotors(arm, rotors))
    parameters = np.append(kinetic, [drives[kind][i] for kind, i in arm.full_joint_parameters])
    flight = Flight(arm)
    flight.cycles(balanced(arm, cycles, parameters))
    estimate = flight.estimate()
    np.testing.assert_allclose(estimate.value, parameters, rtol=1e-6)
    return estimate


@pytest.mark.slow
def test_bodies_without_their_rotors_must_have_energy_in_every_motion() -> None:
    """A matrix of the bodies with one eigenvalue near zero, with the rotors on it: valid above zero, refused below."""
    arm = replace(awkward(8, 3, "spatial", (True, True, True)), impulse_arc_s=0.0, compensate_every=0)
    cycles = wandering(arm, 1800)
    t = arm.period_s * np.arange(len(cycles))[:, None]
    common = 0.4 * np.sin([0.37, 0.83, 1.9] * t)
    cycles.theta[:] = cycles.q + common + 0.05 * np.sin([2.1, 3.3, 4.7] * t) + 0.03 * np.cos([1.2, 2.6, 3.9] * t)
    cycles.q[:] += common
    rng = np.random.default_rng(0)
    size = gram.directions(arm)
    direction = rng.normal(size=size)
    direction /= np.linalg.norm(direction)
    root = rng.normal(size=(size, size))
    others = np.eye(size) - np.outer(direction, direction)
    for least, verdict in ((0.01, "valid"), (-0.01, "doubtful")):
        bodies = others @ (root @ root.T + size * np.eye(size)) @ others + least * np.outer(direction, direction)
        estimate = estimate_of(arm, cycles, bodies)
        assert estimate.validity == verdict
        assert (least > 0.0) or "not physical" in estimate.reason


@pytest.mark.slow(only=["0.01"])
@pytest.mark.parametrize("least", [0.01, -0.01])
def test_of_two_directions_on_a_fixed_base_the_sum_must_have_energy(least: float) -> None:
    """Only the sum of their squares is known, not each of them, nor what is between them."""
    arm, _ = random_arm(8, 3, "fixed")
    arm = replace(arm, gravity=(0.0, 0.0, 0.0), impulse_arc_s=0.0, compensate_every=0, period_s=0.02)
    cycles = wandering(arm, 1800)
    t = arm.period_s * np.arange(len(cycles))[:, None]
    common = 0.4 * np.sin([0.37, 0.83, 1.9] * t)
    cycles.q[:] += common
    cycles.theta[:] = cycles.q + 0.05 * np.sin([2.1, 3.3, 4.7] * t) + 0.03 * np.cos([1.2, 2.6, 3.9] * t)
    size = gram.directions(arm)
    root = np.random.default_rng(0).normal(size=(size, size))
    bodies = root @ root.T + np.eye(size)
    needed = bodies[:2, 2:] @ np.linalg.solve(bodies[2:, 2:], bodies[2:, :2])
    assert abs(needed[0, 1]) > abs(least)
    bodies[:2, :2] = needed + 0.5 * least * np.eye(2)
    estimate = estimate_of(arm, cycles, bodies)
    assert (estimate.validity == "valid") == (least > 0.0)
    assert (least > 0.0) or "not physical" in estimate.reason

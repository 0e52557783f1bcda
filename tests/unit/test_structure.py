# SPDX-License-Identifier: MIT
"""Which parameters of an arm are independent, by its geometry: their number, their names and what they stand for.

Numbers and groups are compared with the joint torques of Pinocchio's regressor at random states, which share no code
with the columns of the energy, and with the numbers that FIGAROH and SymPyBotics publish.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arm_support import random_arm
from cli_support import run
from physical_support import estimate_of
from structure_support import DOWN, PIN_ORDER, arm_of, bodies_of, frames_of, rank, torque_columns

from conftest import EXAMPLE, ROOT
from zygos import structure as module
from zygos.arm import Arm, load_arm, save_arm
from zygos.balances.energy import energy_columns, full_energy_columns
from zygos.balances.joint import joint_columns
from zygos.balances.momentum import momentum_columns
from zygos.balances.state import State
from zygos.dynamics.compiled import Multibody
from zygos.dynamics.engines import engine
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.model.nearest import nearest_bodies
from zygos.model.physical import fit_bodies, observe
from zygos.reference.compare import sizes
from zygos.reference.noise import Instants, moments, spread

COUNTS = {
    "UR10e": (36, 40, 52, 58, 54),
    "KR300": (36, 40, 52, 58, 54),
    "PUMA560": (36, 40, 52, 58, 54),
    "Panda": (43, 48, 62, 69, 64),
    "LWR4+": (43, 48, 62, 69, 64),
    "general 6R": (36, 41, 53, 59, 54),
    "general 7R": (43, 49, 63, 70, 64),
    "general 6R, tilted": (38, 43, 55, 61, 56),
    "planar2v": (6, 7, 11, 13, 12),
    "SCARA3R": (7, 9, 15, 18, 16),
}
"""Links; + rotors; + Coulomb and viscous friction; + offset; links with friction and offset. Gravity along z."""


def states(arm: Arm, count: int = 50, seed: int = 5) -> State:
    rng = np.random.default_rng(seed)
    shape = (count, arm.n)
    soft = np.array([joint.flexible for joint in arm.joints])
    q, qd = rng.uniform(-np.pi, np.pi, shape), rng.normal(size=shape)
    base = rng.normal(size=(count, 3) if arm.spatial else count) * arm.free
    return State(q, q + soft * rng.normal(scale=0.03, size=shape), qd, qd + soft * rng.normal(size=shape), base)


# ------------------------------------------------------------------------------------------ numbers


@pytest.mark.parametrize("name", COUNTS)
def test_the_number_of_parameters_is_the_rank_of_the_joint_torques(name: str) -> None:
    joints = frames_of(name)
    links, rotors = arm_of(joints, torque_at="joint"), arm_of(joints)
    of_links, qd = torque_columns(links, joints, rotors=False)
    of_all, _ = torque_columns(rotors, joints, rotors=True)
    single = np.eye(links.n)
    friction = [np.sign(qd)[..., None] * single, qd[..., None] * single]
    offset = [np.broadcast_to(single, friction[0].shape)]
    expected = (
        rank(of_links),
        rank(of_all),
        rank(np.concatenate([of_all, *friction], axis=-1)),
        rank(np.concatenate([of_all, *friction, *offset], axis=-1)),
        rank(np.concatenate([of_links, *friction, *offset], axis=-1)),
    )
    n, p, p_links = links.n, len(rotors.parameters), len(links.parameters)
    assert expected == COUNTS[name]
    assert (p_links, p, p + 2 * n, p + 3 * n, p_links + 3 * n) == COUNTS[name]


@pytest.mark.parametrize("name", COUNTS)
def test_at_gear_one_rotors_cannot_be_told_from_links(name: str) -> None:
    joints = frames_of(name)
    arm = arm_of(joints, ratio=1.0)
    assert len(arm.parameters) == COUNTS[name][0] == rank(torque_columns(arm, joints, rotors=True)[0])
    assert not any(one.symbol == "Im" for one in arm.parameters)
    grouped = {one.name for one in arm.structure.grouped}
    assert {f"Im{i + 1}" for i in range(arm.n)} <= grouped


@pytest.mark.parametrize("kinetic", ["planar", "planar-symmetric", "spatial"])
def test_a_planar_arm_on_a_vertical_and_on_a_horizontal_plane(kinetic: Any) -> None:
    joints = frames_of("planar2v")
    upright = arm_of(joints, kinetic=kinetic)
    assert upright.parameter_names == ("my1", "mz1", "Ixx1", "my2", "mz2", "Ixx2", "Im2")
    lying = arm_of(joints, kinetic=kinetic, gravity=(-9.81, 0.0, 0.0))
    names = ("Ixx1", "my2", "mz2", "Ixx2", "Im2")
    assert lying.parameter_names == (names if kinetic != "planar-symmetric" else ("Ixx1", *names[2:]))
    assert rank(torque_columns(lying, joints, rotors=True)[0]) == 5
    without = [arm_of(joints, kinetic=kinetic, gravity=gravity, lengths=False) for gravity in (DOWN, (-9.81, 0.0, 0.0))]
    # without lengths a12 is no product of a known length and a first moment
    counts = {"planar": [9, 5], "planar-symmetric": [8, 4], "spatial": [9, 5]}
    assert [len(arm.parameters) for arm in without] == counts[kinetic]


@pytest.mark.parametrize("name", ["UR10e", "KR300", "PUMA560", "Panda", "LWR4+"])
def test_without_lengths_an_arm_lacks_what_its_axes_leave_out(name: str) -> None:
    """Full parameters less one: the rotor of a second axis that is perpendicular to the first, vertical one."""
    arm = arm_of(frames_of(name), lengths=False)
    full = {6: 91, 7: 121}[arm.n]
    assert (len(arm.full_parameters), len(arm.parameters)) == (full, full - 1)
    assert arm.structure.selects and [one.name for one in arm.structure.grouped] == ["Im2"]
    alone = arm_of(frames_of(name), lengths=False, torque_at="joint")
    assert len(alone.parameters) == {6: 86, 7: 115}[arm.n]


EXAMPLES = {
    **{name: (12, 12) for name in ("gap", "lively", "paper", "telemetry")},
    **{"spatial": (54, 54), "seven": (174, 174), "pendulum": (9, 7)},
}
"""Full and base parameters of each example's arm."""


def test_arms_of_the_examples() -> None:
    """Flexible joints and a free base leave nothing dependent; nor do two parallel axes whose lengths are unknown."""
    files = {file.parent.name: file for file in (ROOT / "examples").glob("*/arm.toml")}
    assert set(files) == set(EXAMPLES)
    for name, file in files.items():
        arm = load_arm(file)
        lengths = all(joint.position_m is not None for joint in arm.joints)
        assert (len(arm.full_parameters), len(arm.parameters)) == EXAMPLES[name], name
        assert arm.structure.reduces == (lengths and not arm.free), name


@pytest.mark.parametrize("kinetic", ["planar-symmetric", "planar", "spatial"])
@pytest.mark.parametrize("base", ["free", "fixed"])
def test_axes_in_general_position_lack_no_rank(base: Any, kinetic: Any) -> None:
    for joints in (1, 2, 3):
        arm, _ = random_arm(0, joints, base, kinetic)
        assert not arm.structure.reduces


def test_figaroh_finds_as_many_for_the_ur10() -> None:
    """The fixture "ur10" of figaroh-examples has the kinematics of the UR10e, no rotors and no friction: its regressor
    has rank 36 of 60 (docs/development/ur10-dynamic-truth-fixture.md at 475b7ff, section 2, and
    deterministic-base-params-check-2026-10-10.md at f108c80)."""
    arm = arm_of(frames_of("UR10e"), torque_at="joint")
    structure = arm.structure
    links = [one for one in structure.candidates if one.joint is None]
    assert (len(arm.parameters), len(links)) == (36, 60)


def test_sympybotics_groups_its_example_in_the_same_way() -> None:
    """README.md of cdsousa/SymPyBotics at 06c545f: two joints, (alpha, a, d, theta) = (-pi/2, 0, 0, q + pi/2) and
    (pi/2, 0, 0, q - pi/2) in the standard convention, has L_1yy + L_2zz, L_2xx - L_2zz, L_2xy, L_2xz, L_2yy, L_2yz,
    l_2x and l_2z beside friction. Its link frames lie at the links' far ends: joint 2 turns about z of frame 1, which
    is y of frame 2, and joint 1 about y of frame 1."""
    joints = [
        {"rpy": [0.0, 0.0, 0.0], "xyz": [0.0, 0.0, 0.0], "axis": [0.0, 1.0, 0.0]},
        {"rpy": [0.0, 0.0, 0.0], "xyz": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0]},
    ]
    # frame 2 is turned by +pi/2 about x at q_2 = 0: y of frame 2 is along the axis of joint 2, z of frame 2 along -y
    # of frame 1
    joints[1] = joints[1] | {"rpy": [np.pi / 2.0, 0.0, 0.0], "axis": [0.0, 1.0, 0.0]}
    arm = arm_of(joints, torque_at="joint", gravity=(0.0, -9.81, 0.0))
    published = {
        "L1yy": {"Iyy1": 1.0, "Izz2": 1.0},
        "L2xx": {"Ixx2": 1.0, "Izz2": -1.0},
        **{key: {key: 1.0} for key in ("Ixy2", "Ixz2", "Iyy2", "Iyz2", "mx2", "mz2")},
    }
    structure = arm.structure
    ours = np.array(
        [[row.get(one.name, 0.0) for one in structure.candidates] for row in published.values()]
    )  # fmt: skip
    assert len(structure.parameters) == len(ours) == 8
    # the same space, whichever member of a group has its name
    np.testing.assert_allclose(ours @ np.linalg.pinv(structure.groups) @ structure.groups, ours, atol=1e-12)


# ------------------------------------------------------------------------------------------ groups


@pytest.mark.parametrize("name", [*COUNTS])
@pytest.mark.parametrize("torque_at", ["rotor", "joint"])
def test_a_group_has_the_torque_of_its_members(name: str, torque_at: Any) -> None:
    """For parameters of any size, physical or not: the torques of Pinocchio's links and rotors are those of the kept
    ones alone, with the values of their groups."""
    joints = frames_of(name)
    arm = arm_of(joints, torque_at=torque_at)
    rotors = torque_at == "rotor"
    columns, _ = torque_columns(arm, joints, rotors=rotors, count=20)
    names = [f"{symbol}{body}" for body in range(1, arm.n + 1) for symbol in PIN_ORDER]
    names += [f"Im{i}" for i in range(1, arm.n + 1)] if rotors else []
    structure = arm.structure
    of_candidate = {one.name: k for k, one in enumerate(structure.candidates)}
    value = np.random.default_rng(3).normal(size=len(structure.candidates))
    grouped = structure.groups @ value
    every = columns @ np.array([value[of_candidate[one]] for one in names])
    kept = columns[..., [names.index(one.name) for one in structure.parameters]] @ grouped
    np.testing.assert_allclose(kept, every, atol=1e-9 * np.abs(every).max())


def test_groups_are_readable() -> None:
    arm = arm_of(frames_of("planar2v"))
    said = dict(zip(arm.parameter_names, arm.structure.grouping, strict=True))
    assert said["Ixx1"] == "Ixx1 + 0.09 m2 + 10000 Im1"
    assert said["mz1"] == "mz1 - 0.3 m2"
    assert said["my2"] == "my2"
    ur10e = arm_of(frames_of("UR10e"))
    said = dict(zip(ur10e.parameter_names, ur10e.structure.grouping, strict=True))
    assert said["Izz6"] == "Izz6 - Ixx6"
    assert said["mz2"] == "mz2 + 0.613 m3 + 0.613 m4 + 0.613 m5 + 0.613 m6"
    assert {one.name for one in ur10e.structure.unseen} >= {"m1", "mx1", "my1", "mz1", "Ixx1", "Iyy1"}


# ------------------------------------------------------------------------------------------ predictions


@pytest.mark.parametrize("name", ["UR10e", "general 6R, tilted", "SCARA3R"])
@pytest.mark.parametrize(
    "settings",
    [{}, {"flexible": True}, {"ratio": 1.0}, {"torque_at": "joint"}, {"lengths": False}, {"base": "free"}],
    ids=lambda settings: next(iter(settings), "rigid"),
)
def test_the_reduction_changes_no_prediction(name: str, settings: dict[str, Any]) -> None:
    """Accelerations and energy of Pinocchio, which has the bodies themselves."""
    joints = frames_of(name)
    kinds: list[Any] = ["spatial", "planar"] if name == "SCARA3R" and "base" not in settings else ["spatial"]
    for kinetic in kinds:
        arm = arm_of(joints, kinetic=kinetic, **settings)
        model = bodies_of(arm, joints)
        ours, theirs = Multibody.from_model(arm, model), engine("pinocchio", arm, model)
        rng, state = np.random.default_rng(2), states(arm, 6)
        tau = rng.normal(size=state.q.shape)
        base = state.base if arm.free else np.zeros((len(tau), 3))
        stored = energy_columns(arm, state, np.zeros_like(state.q)) @ np.nan_to_num(model.base_values(arm))
        energy = []
        for k in range(len(tau)):
            one = (state.q[k], state.theta[k], base[k], state.qd[k], state.thetad[k], tau[k])
            for found, known in zip(ours.accelerations(*one), theirs.accelerations(*one), strict=True):
                np.testing.assert_allclose(found, known, atol=1e-11 * (1.0 + np.abs(known).max()))
            energy.append(
                theirs.kinetic_energy(one[0], one[2], one[3], one[4])
                + (0.0 if arm.free else theirs.potential_energy(one[0]))
                + 0.5 * sum(1e4 * (one[1] - one[0]) ** 2 * arm.joints[0].flexible)
            )
        off = stored - energy
        np.testing.assert_allclose(off, off[0], atol=1e-10 * np.abs(energy).max())


@pytest.mark.parametrize("name", ["UR10e", "general 6R", "SCARA3R"])
def test_every_kind_of_row_is_reduced_by_the_same_basis(name: str) -> None:
    """The rows of a joint's momentum and force, and of the energy, are derivatives of one function."""
    joints = frames_of(name)
    arm = arm_of(joints, flexible=True)
    basis, state = arm.structure.basis, states(arm)
    lost = np.zeros_like(state.q)
    full = full_energy_columns(arm, state, lost)
    np.testing.assert_allclose(energy_columns(arm, state, lost), full @ basis, atol=1e-12 * np.abs(full).max())
    values = np.random.default_rng(1).normal(size=arm.structure.size)
    inner = arm.structure.expanded(values)
    kinetic = joint_columns(arm, state)
    of_joints = [k for k, one in enumerate(arm.full_parameters) if one.symbol == "Im"]
    momentum = kinetic.momentum @ inner[: len(arm.full_body_names)] + kinetic.rotor_momentum @ inner[of_joints]
    step = 1e-5
    for j in range(arm.n):
        shift = step * np.eye(arm.n)[j]
        above, below = (
            energy_columns(arm, replace(state, qd=state.qd + s * shift), lost) @ values for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(momentum[:, j], (above - below) / (2 * step), atol=1e-6 * np.abs(momentum).max())


def test_the_momentum_of_a_floating_arm_needs_no_dropped_parameter() -> None:
    """At gear 1 the rotors of rigid joints are dropped; the columns of the momentum depend on the others alike."""
    joints = frames_of("UR10e")
    arm = arm_of(joints, base="free", ratio=1.0)
    model = bodies_of(arm, joints)
    assert len(arm.parameters) == len(arm.full_parameters) - arm.n and arm.structure.selects
    state = states(arm)
    known = model.base_values(arm)
    names = [*arm.full_body_names, *(f"Im{i + 1}" for i in range(arm.n))]
    kept = [names.index(name) for name in arm.parameter_names]
    found = momentum_columns(arm, state)[..., kept] @ known
    theirs = engine("pinocchio", arm, model)
    every = zip(state.q, state.base, state.qd, state.thetad, strict=True)
    expected = np.array([theirs.momentum(*one) for one in every])
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_the_noise_of_rows_is_reduced_with_them() -> None:
    """Of an arm whose full parameters are all independent where the lengths are not known."""
    joints = frames_of("general 6R")[:3]
    arms = [arm_of(joints, lengths=lengths, flexible=True) for lengths in (False, True)]
    assert not arms[0].structure.reduces and arms[1].structure.reduces
    state = states(arms[0], 40)
    tau = np.random.default_rng(0).normal(size=(2, 40, 3))
    here = Instants(state, tau[0], tau[1])
    full, reduced = (moments(arm, spread(arm), here, np.arange(40)) for arm in arms)
    basis = np.zeros((len(full), len(reduced)))
    basis[:-1, :-1], basis[-1, -1] = arms[1].structure.basis, 1.0
    expected = basis.T @ full @ basis
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(reduced / size / size[:, None], expected / size / size[:, None], atol=1e-9)


# ------------------------------------------------------------------------------------------ the choice


@pytest.mark.parametrize("name", COUNTS)
def test_the_choice_is_that_of_no_random_number(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = arm_of(frames_of(name))
    first, drawn = arm.structure, np.random.default_rng(100)
    monkeypatch.setattr(module.np.random, "default_rng", lambda _: drawn)
    other = replace(arm).structure
    assert other.parameters == first.parameters
    np.testing.assert_array_equal(other.basis, first.basis)
    np.testing.assert_allclose(other.groups, first.groups, atol=1e-9 * np.abs(first.groups).max())
    assert other.grouping == first.grouping


@pytest.mark.parametrize("lengths", [True, False])
def test_angles_of_few_digits_are_taken_as_meant(lengths: bool) -> None:
    exact = frames_of("Panda")
    known = arm_of(exact, lengths=lengths).structure
    for digits in (5, 7, 9):
        rounded = [one | {"rpy": [round(angle, digits) for angle in one["rpy"]]} for one in exact]
        found = arm_of(rounded, lengths=lengths).structure
        assert found.parameters == known.parameters
        assert found.grouping == known.grouping  # no small terms from digits that are missing


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_axes_as_they_were_calibrated_have_the_structure_of_the_drawing(size: float) -> None:
    """The first two axes of a UR10e deviate from a right angle, but no motion shows the second rotor for that."""
    exact, tilted = frames_of("UR10e"), frames_of("UR10e")
    roll, pitch, yaw = tilted[1]["rpy"]
    tilted[1] = tilted[1] | {"rpy": [roll + size, pitch, yaw]}
    arm = arm_of(tilted)
    assert arm.parameters == arm_of(exact).parameters
    model, state = bodies_of(arm, tilted), states(arm, 20)
    stored = energy_columns(arm, state, np.zeros_like(state.q)) @ model.base_values(arm)
    theirs, still = engine("pinocchio", arm, model), np.zeros(3)
    every = zip(state.q, state.qd, strict=True)
    known = np.array([theirs.kinetic_energy(q, still, qd, qd) + theirs.potential_energy(q) for q, qd in every])
    off = stored - known
    assert np.abs(off - off.mean()).max() < 1e-6 * np.abs(known - known.mean()).max()


def unclear() -> Arm:
    """An arm with gear ratios so close to 1 that it depends on digits whether rotors can be told from links."""
    arm = arm_of(frames_of("UR10e"))
    ratios = [100.0, 100.0, 1.0 + 1e-6, 1.0 + 5e-6, 1.0 + 2e-5, 100.0]
    return replace(arm, joints=tuple(replace(j, gear_ratio=r) for j, r in zip(arm.joints, ratios, strict=True)))


def test_a_geometry_that_leaves_the_number_open_is_refused() -> None:
    with pytest.raises(ZygosError, match=r"it is not clear how many parameters it has.*; remedy: ") as refusal:
        _ = unclear().parameters
    assert refusal.value.exit_code == 2


def test_seven_joints_take_less_than_a_third_of_a_second() -> None:
    joints = frames_of("general 7R")
    settings: list[dict[str, Any]] = [{}, {"flexible": True}, {"base": "free", "flexible": True}]
    for arm in (replace(arm_of(joints, **one)) for one in settings):
        begun = time.process_time()
        assert arm.parameters
        assert time.process_time() - begun < 0.3


# ------------------------------------------------------------------------------------------ models


@pytest.mark.parametrize("settings", [{}, {"flexible": True}, {"torque_at": "joint"}])
def test_base_parameters_are_a_model_like_bodies(settings: dict[str, Any]) -> None:
    joints = frames_of("UR10e")[:4]
    arm = arm_of(joints, **settings)
    model = bodies_of(arm, joints)
    named = Model("named", parameters=model.base_parameters(arm))
    assert tuple(named.parameters) == arm.parameter_names
    assert [q.unit for q in named.parameters.values()] == list(arm.parameter_units)
    one = states(arm, 1)
    arguments = (one.q, one.theta, np.zeros((1, 3)), one.qd, one.thetad, np.ones_like(one.q))
    for found, known in zip(
        Multibody.from_model(arm, named).accelerations(*arguments),
        Multibody.from_model(arm, model).accelerations(*arguments),
        strict=True,
    ):
        np.testing.assert_allclose(found, known, rtol=1e-12)
    negative = {name: replace(q, value=-q.value) for name, q in named.parameters.items()}
    with pytest.raises(ZygosError, match=r"negative kinetic energy in some posture.*; remedy: "):
        Multibody.from_model(arm, Model("negative", parameters=negative))


def test_a_model_with_other_lengths_is_refused() -> None:
    joints = frames_of("UR10e")
    arm = arm_of(joints)
    model = bodies_of(arm, joints)
    x, y, z = model.bodies[2].joint_xyz or (0.0, 0.0, 0.0)
    moved = list(model.bodies)
    moved[2] = replace(moved[2], joint_xyz=(x, y + 1e-3, z))
    with pytest.raises(ZygosError, match=r"body2 carries joint joint3 at .*; remedy: correct joint_xyz"):
        replace(model, bodies=tuple(moved)).base_values(arm)
    # where the fixed base carries the arm has no effect
    moved = [replace(model.bodies[0], joint_xyz=(9.0, 9.0, 9.0)), *model.bodies[1:]]
    np.testing.assert_array_equal(replace(model, bodies=tuple(moved)).base_values(arm), model.base_values(arm))


@pytest.mark.slow(only=["planar2v*"])
@pytest.mark.parametrize(
    ("name", "kinetic", "flexible"),
    [
        ("planar2v", "planar", True),
        ("UR10e", "spatial", False),
    ],
)
def test_bodies_come_back_from_base_parameters(name: str, kinetic: Any, flexible: bool) -> None:
    """By `nearest_bodies`, and by `fit_bodies` of an estimate, from drawings that are off."""
    joints = frames_of(name)[:2]
    arm = arm_of(joints, kinetic=kinetic, flexible=flexible)
    built = bodies_of(arm, joints)
    drawing = replace(
        built,
        bodies=tuple(
            replace(body, mass=replace(body.mass, value=body.mass.value * (1.1 if k % 2 else 0.95)))
            for k, body in enumerate(built.bodies)
        ),
        joints=tuple(
            replace(joint, rotor_inertia=replace(joint.rotor_inertia, value=0.9 * joint.rotor_inertia.value))
            for joint in built.joints
        ),
    )
    true = built.base_values(arm)
    size = sizes(arm, true)
    given = Model("given", parameters=built.base_parameters(arm))
    found = nearest_bodies(arm, drawing, given).model.base_values(arm)
    np.testing.assert_allclose(found / size, true / size, atol=1e-7)
    report = estimate_of(arm, true)
    fit = fit_bodies(arm, drawing, observe(arm.parameter_names, report), 1e-3)
    np.testing.assert_allclose(fit.value / size, true / size, atol=1e-5)
    assert fit.explained and not fit.lengths.any()


def test_sizes_of_grouped_parameters_are_not_zero() -> None:
    """A product of inertia of zero is compared with the inertias that it couples."""
    joints = frames_of("UR10e")
    arm = arm_of(joints)
    values = bodies_of(arm, joints).base_values(arm)
    zero = np.where([name == "Ixy6" for name in arm.parameter_names], 0.0, values)
    assert np.all(sizes(arm, zero) > 0.0)
    assert np.all(sizes(arm, values) >= np.abs(values))


# ------------------------------------------------------------------------------------------ files and command


@pytest.mark.parametrize("torque_at", ["rotor", "joint"])
def test_places_of_joints_are_written_and_read(torque_at: Any, tmp_path: Path) -> None:
    arm = arm_of(frames_of("Panda"), torque_at=torque_at)
    save_arm(arm, tmp_path / "arm.toml")
    again = load_arm(tmp_path / "arm.toml")
    assert [joint.position_m for joint in again.joints] == [joint.position_m for joint in arm.joints]
    assert again.torque_at == torque_at and again.parameters == arm.parameters
    np.testing.assert_array_equal(again.gear_ratios, np.full(7, 100.0 if torque_at == "rotor" else 1.0))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda arm: replace(arm, joints=(replace(arm.joints[0], position_m=None), *arm.joints[1:])),
         r"joint\[0\]\.position_m: is absent, but other joints have it; remedy: "),
        (lambda arm: replace(arm, torque_at="joint", joints=tuple(replace(j, flexible=True) for j in arm.joints)),
         "torque_at: a joint is flexible.*; remedy: "),
        (lambda arm: replace(arm, kinetic="planar-symmetric",
                             joints=(*arm.joints[:2], replace(arm.joints[2], position_m=(0.2, 0.1, 0.0)))),
         r"joint\.position_m: the joints of the stretched arm lie on no line.*; remedy: "),
    ],
    ids=["some", "flexible", "off the line"],
)  # fmt: skip
def test_files_that_contradict_themselves_are_refused(change: Any, said: str, tmp_path: Path) -> None:
    save_arm(change(arm_of(frames_of("SCARA3R"), kinetic="planar")), tmp_path / "arm.toml")
    with pytest.raises(ZygosError, match=said):
        load_arm(tmp_path / "arm.toml")


def test_an_arm_under_gravity_is_planar(tmp_path: Path) -> None:
    """No mass centre of it is taken as known; without gravity those on the lines between the joints are."""
    arm = arm_of(frames_of("planar2v"), kinetic="planar")
    for gravity, read in ((arm.gravity, "planar"), ((0.0, 0.0, 0.0), "planar-symmetric")):
        save_arm(replace(arm, kinetic="planar-symmetric", gravity=gravity), tmp_path / "arm.toml")
        assert load_arm(tmp_path / "arm.toml") == replace(arm, kinetic=read, gravity=gravity)
    assert any(arm.gravity)


def test_the_command_lists_groups(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_arm(arm_of(frames_of("planar2v"), kinetic="planar"), tmp_path / "arm.toml")
    assert run("parameters", tmp_path / "arm.toml", "--json", tmp_path / "out.json") == 0
    said = capsys.readouterr().out
    assert "Ixx1 + 0.09 m2 + 10000 Im1" in said
    assert "seen only as parts of these: m2, Im1" in said
    assert "without any effect on the motion: m1, mx1, Ixy1" in said
    assert "7 base parameters" in said and "9 parameters for axes in general position" in said
    content = json.loads((tmp_path / "out.json").read_text())
    assert content["full"] == 9 and content["lengths_known"] and content["grouped"] == ["m2", "Im1"]
    entry = content["parameters"][1]
    assert entry["name"] == "mz1" and entry["terms"] == pytest.approx({"mz1": 1.0, "m2": -0.3})


def test_the_command_refuses_what_it_must(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("parameters", tmp_path / "none.toml") == 2
    assert "no such file; remedy" in capsys.readouterr().err
    save_arm(unclear(), tmp_path / "arm.toml")
    assert run("parameters", tmp_path / "arm.toml", "--json", tmp_path / "out.json") == 2
    assert "it is not clear how many parameters" in capsys.readouterr().err
    assert not (tmp_path / "out.json").exists()


def test_compile_model_tells_the_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("compile-model", EXAMPLE / "arm.toml", "-o", tmp_path, "--json", tmp_path / "out.json") == 0
    assert "12 base parameters of 12, 0 effects" in capsys.readouterr().out
    content = json.loads((tmp_path / "out.json").read_text())
    assert (content["full"], content["base"]) == (12, 12)

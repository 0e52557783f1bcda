# SPDX-License-Identifier: MIT
"""The arm file: derived numbers, and what is refused."""

from __future__ import annotations

import math
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pytest
from plant_support import LIVELY, lively, random_arm

from zygos.arm import Arm, load_arm, save_arm
from zygos.errors import ZygosError

LINK = "link_encoder  = { quantum_rad = 0.003, sign = 1, zero_rad = 0.0, zero_sigma_rad = 0.0, latch_us = 0 }"
MOTOR = 'motor_encoder = { quantum_rad = 0.003, side = "output", sign = 1, zero_rad = 0.0, latch_us = 0 }'


def test_the_papers_arm() -> None:
    arm = lively()[0]
    assert arm.n == 2
    assert arm.parameter_names == ("a00", "a01", "a02", "a11", "a12", "a22", "Im1", "k1", "b1", "Im2", "k2", "b2")
    assert len(arm.parameter_units) == 12
    assert arm.parameter_units[5:9] == ("kg m^2", "kg m^2", "Nm/rad", "Nms/rad")
    assert arm.joints[0].link_encoder.sigma_rad ** 2 == pytest.approx(7.5e-7)
    assert (arm.smoother.points, arm.smoother.order, arm.smoother.lag, arm.arc_max_s) == (11, 6, 5, 60.0)
    np.testing.assert_array_equal(arm.axis, [0, 0, 1])
    # the gyro's densities as the paper prints them, rad/s^(1/2) and rad/s^(3/2)
    assert arm.imu.rate_sigma * math.sqrt(arm.period_s) == pytest.approx(0.31623e-6, rel=1e-4)
    assert arm.imu.bias_walk == pytest.approx(3.1623e-4 * 1e-6)
    with pytest.raises(FrozenInstanceError):
        arm.period_s = 1.0  # type: ignore[misc]


def test_names_of_other_arms() -> None:
    arm = random_arm(np.random.default_rng(0), 3, "planar")[0]
    assert arm.parameter_names == (
        "a00", "a01", "a02", "a03", "a11", "a12", "a13", "a22", "a23", "a33", "b01", "b02", "b03", "b12", "b13", "b23",
        "Im1", "k1", "b1", "Im2", "k2", "b2", "Im3", "k3", "b3")  # fmt: skip
    assert len(arm.parameter_units) == len(arm.parameter_names)


def test_another_period_keeps_the_gyros_density() -> None:
    arm = lively()[0]
    faster = arm.at_period(0.005)
    assert faster.period_s == 0.005
    assert faster.imu.rate_sigma / arm.imu.rate_sigma == pytest.approx(math.sqrt(10.0))
    assert faster.imu.bias_walk == arm.imu.bias_walk
    late = replace(arm, imu=replace(arm.imu, latch_us=6000))
    for period in (0.0, -1.0, 0.006, math.inf, math.nan):
        with pytest.raises(ZygosError, match=r"latch.*remedy"):
            late.at_period(period)


def test_where_the_earth_is_has_a_length_of_1_and_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    text = (LIVELY.parent / "spatial" / "arm.toml").read_text()
    assert load_arm(LIVELY.parent / "spatial" / "arm.toml").nadir is None
    file.write_text(text.replace('kinetic = "spatial"', 'kinetic = "spatial"\nnadir = [0.6, 0, -0.8001]'))
    arm = load_arm(file)
    assert arm.nadir is not None
    assert math.hypot(*arm.nadir) == pytest.approx(1.0, abs=1e-15)
    save_arm(arm, tmp_path / "again.toml")
    assert load_arm(tmp_path / "again.toml").nadir == pytest.approx(arm.nadir, abs=1e-15)
    file.write_text(text.replace('kinetic = "spatial"', 'kinetic = "spatial"\nnadir = [1, 0, -1]'))
    with pytest.raises(ZygosError, match=r"nadir: has length 1\.41421; remedy: give a unit vector"):
        load_arm(file)


@pytest.mark.parametrize(("side", "quantum"), [("output", 2 * math.pi / 4096), ("rotor", 2 * math.pi / 4096 / 50)])
def test_counts_on_either_side_of_the_gear(tmp_path: Path, side: str, quantum: float) -> None:
    file = tmp_path / "arm.toml"
    file.write_text((LIVELY / "arm.toml").read_text().replace(MOTOR, f'motor_encoder = {{counts=4096, side="{side}"}}'))
    encoder = load_arm(file).joints[0].motor_encoder
    assert encoder.quantum_rad == pytest.approx(quantum, rel=1e-15)
    assert encoder.sigma_rad == pytest.approx(quantum / math.sqrt(12), rel=1e-15)


def test_optional_parts(tmp_path: Path) -> None:
    file = tmp_path / "arm.toml"
    file.write_text(
        (LIVELY / "arm.toml").read_text().replace("points = 11\norder = 6\n", "points = 13\norder = 8\n")
        + 'resolution = "coarse"\n[arc]\nmax_s = 10\n'
    )
    arm = load_arm(file)
    assert (arm.imu.resolution, arm.smoother.points, arm.smoother.order, arm.smoother.lag) == ("coarse", 13, 8, 6)
    assert arm.arc_max_s == 10.0


@pytest.mark.parametrize(("find", "put", "key"), [
    ('base = "free"', 'base = "fixe"', "base: 'fixe' is not known; remedy: write \"free\" or \"fixed\""),
    ('base = "free"', 'base = "fixed"', "imu: a fixed base has no rate to measure"),
    ('base = "free"', 'base = "free"\ngravity = [0, 0, -9.81]', "gravity: a free-floating arm feels no gravity"),
    ('base = "free"', 'base = "free"\nnadir = [0, 0, 1]', "nadir: only an arm that floats in space"),
    ("gear_ratio = 50", "gear_ratio = 50\nflexible = false", "a rigid joint has only its motor's encoder"),
    ('kinetic = "planar-symmetric"', 'kinetic = "plane"', "kinetic"),
    ("period_s = 0.05", "period_s = 0", "period_s"),
    ("period_s = 0.05", "period_s = 0.066", "period_s: 0.066 is out of range"),
    ("period_s = 0.05", "period_s = inf", "period_s"),
    ("period_s = 0.05", "period_s = true", "period_s: True is not a number"),
    ("period_s = 0.05", "", "period_s: is missing"),
    ("period_s = 0.05", "period_s = 0.05\nperiod = 1", "period: unknown key"),
    ('torque_law = "applied_from_sync"', "torque_law = 1", "torque_law"),
    ('torque_at = "rotor"', 'torque_at = "link"', "torque_at"),
    ('torque_at = "rotor"', 'torque_at = "rotor"\ntorque_averaged = true', r"torque_averaged: .* sampled torques"),
    ("axis = [0, 0, 1]", "axis = [0, 0, 2]", r"joint\[0\]\.axis: has length 2"),
    ("axis = [0, 0, 1]", "axis = [0, 0, 0]", r"joint\[0\]\.axis"),
    ("axis = [0, 0, 1]", "axis = [0, 1, 0]", "joint: .*not parallel"),
    ("axis = [0, 0, 1]", "axis = [0, 0, -1]", "joint: .*not parallel with the same sense"),
    ("axis = [0, 0, 1]", "axis = 3", r"joint\[0\]\.axis"),
    ("gear_ratio = 50", "gear_ratio = -50", r"joint\[0\]\.gear_ratio"),
    ("gear_ratio = 50", 'gear_ratio = "50"', r"joint\[0\]\.gear_ratio"),
    ("node = 2", "node = 1", "node numbers repeat"),
    ("node = 2", "node = 16", "node numbers repeat"),
    ("node = 2", "node = 2.0", r"joint\[1\]\.node"),
    ("node = 2", "node = 32", r"joint\[1\]\.node: 32 is out of range; remedy: write an integer from 1 to 31"),
    ('name = "elbow"', 'name = "shoulder"', "joint names repeat"),
    (LINK, "", r"joint\[0\]\.link_encoder: is missing"),
    (LINK, "link_encoder = {}", r"joint\[0\]\.link_encoder\.counts: is missing"),
    (LINK, "link_encoder = { counts = 2000, quantum_rad = 0.003 }", r"link_encoder\.quantum_rad: is given with counts"),
    (LINK, "link_encoder = { counts = 0 }", r"joint\[0\]\.link_encoder\.counts"),
    (LINK, "link_encoder = { counts = 2000, sign = 0 }", r"joint\[0\]\.link_encoder\.sign"),
    (LINK, 'link_encoder = { counts = 2000, side = "rotor" }', r"joint\[0\]\.link_encoder\.side: unknown key"),
    (LINK, "link_encoder = { counts = 2000, latch_us = 50000 }", r"joint\[0\]\.link_encoder\.latch_us"),
    (MOTOR, "motor_encoder = { counts = 2000 }", r"joint\[0\]\.motor_encoder\.side: is missing"),
    ("torque_sigma = 0.0", "torque_sigma = -1", r"joint\[0\]\.torque_sigma"),
    ("mount_xyzw = [0, 0, 0, 1]", "mount_xyzw = [0, 0, 0, 0]", r"imu\.mount_xyzw"),
    ("rate_sigma = 1.4142e-6", "rate_sigma = nan", r"imu\.rate_sigma"),
    ("bias_walk = 3.1623e-10", "", r"imu\.bias_walk: is missing"),
    ("[imu]", "[arc]\nmax_s = 0\n[imu]", r"arc\.max_s"),
    ("points = 11", "points = 11\nlag = 0", r"smoother\.lag: 0 would need end-point filters"),
    ("points = 11", "points = 8", r"smoother\.points: 8 is even"),
    ("points = 11", "points = 5", r"smoother\.order"),
    ("[imu]", "[[joint]]\n[imu]", r"joint\[2\]\.gear_ratio: is missing"),
    ("[imu]", "[imu", "not valid TOML"),
    ("[imu]", "[imus]", "imu: is missing"),
])  # fmt: skip
def test_bad_files_are_refused(tmp_path: Path, find: str, put: str, key: str) -> None:
    text = (LIVELY / "arm.toml").read_text()
    assert find in text
    file = tmp_path / "arm.toml"
    file.write_text(text.replace(find, put, 1))
    with pytest.raises(ZygosError, match=rf"arm\.toml: .*{key}") as refusal:
        load_arm(file)
    assert "; remedy: " in str(refusal.value)
    assert refusal.value.exit_code == 2


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="no such file; remedy"):
        load_arm(tmp_path / "arm.toml")
    with pytest.raises(ZygosError, match=r"is a folder; remedy: give an arm file in it"):
        load_arm(tmp_path)
    for content in (b"\xff\xfe", b"a = " + b"9" * 5000, b"a = " + b"[" * 50_000):
        (tmp_path / "arm.toml").write_bytes(content)
        with pytest.raises(ZygosError, match="remedy"):
            load_arm(tmp_path / "arm.toml")


def spatial(tmp_path: Path, base: str, *joints: str) -> Arm:
    imu = "[imu]\nnode = 16\nrate_sigma = 0\nbias_walk = 0\n" if 'base = "free"' in base else ""
    blocks = "".join(
        f'[[joint]]\nname = "j{i}"\nnode = {i}\ngear_ratio = 100\n{joint}'
        'motor_encoder = {counts = 4096, side = "rotor"}\n'
        for i, joint in enumerate(joints, start=1)
    )
    file = tmp_path / "arm.toml"
    file.write_text(
        f'name = "s"\n{base}\nkinetic = "spatial"\nperiod_s = 0.01\ntorque_law = "applied_from_sync"\n'
        f'torque_at = "rotor"\n{blocks}{imu}'
    )
    return load_arm(file)


FLEXIBLE, RIGID = "link_encoder = {counts=4096}\n", "flexible = false\n"
UP, ACROSS = "axis = [0, 0, 1]\n", "axis = [1, 0, 0]\n"


@pytest.mark.parametrize("joints", [1, 2, 3, 7])
def test_spatial_parameters_are_counted_as_theory_says(tmp_path: Path, joints: int) -> None:
    free = spatial(tmp_path, 'base = "free"', *[FLEXIBLE + ACROSS] * joints)
    assert len(free.full_body_names) == (joints + 2) * (2 * joints + 3)
    assert len(free.full_names) == (joints + 2) * (2 * joints + 3) + 3 * joints
    fixed = spatial(tmp_path, 'base = "fixed"\ngravity = [0, 0, -9.81]', *[FLEXIBLE + ACROSS] * joints)
    assert len(fixed.full_body_names) == 2 * joints**2 + joints - 2 + 2 * joints
    upright = spatial(
        tmp_path, 'base = "fixed"\ngravity = [0, 0, -9.81]', FLEXIBLE + UP, *[FLEXIBLE + ACROSS] * (joints - 1)
    )
    assert len(upright.full_body_names) == len(fixed.full_body_names) - 2


def test_names_of_a_rigid_arm_on_the_ground(tmp_path: Path) -> None:
    arm = spatial(tmp_path, 'base = "fixed"\ngravity = [0, 0, -9.81]', RIGID + UP, RIGID + ACROSS)
    assert arm.full_names == (
        *("N[1u,1u]", "N[1u,2u]", "N[1u,2v]", "N[1v,2u]", "N[1v,2v]", "N[2u,2u]", "N[2u,2v]", "N[2v,2v]"),
        *("G[2u]", "G[2v]", "Im2"),
    )
    # the second axis is perpendicular to the first: its rotor turns with its link alone, too
    assert arm.parameter_names == arm.full_names[:-1]
    assert arm.parameter_units[-3:] == ("kg m^2", "kg m", "kg m")
    assert arm.joints[0].link_encoder == arm.joints[0].motor_encoder
    assert arm.imu.node == 0

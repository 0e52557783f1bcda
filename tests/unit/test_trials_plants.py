# SPDX-License-Identifier: MIT
"""The plants of the trials move as Pinocchio says, hide what they say they hide, and write what the product reads."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

if not os.environ.get("CI"):  # there, a missing tool is a failure
    pytest.importorskip("mujoco")
    pytest.importorskip("pinocchio")

import mujoco

from oracles import hidden
from oracles.arms import ARMS, NADIR, Plant, as_built
from oracles.cells import Cell, Hidden, case, cell_named, cells, is_dirty, seed_of
from oracles.hidden import Law, Motion
from oracles.score import projected
from oracles.tree import Payload, TreePlant
from oracles.trials import make, spread
from zygos.arm import load_arm
from zygos.balances.field import pull
from zygos.balances.kinematics import posture
from zygos.can.run import read_run
from zygos.dynamics.engines import engine
from zygos.dynamics.joints import by_name
from zygos.model import gram
from zygos.model.model import load_model

NAMES = list(ARMS)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "coarse"])
def test_accelerations_are_those_of_pinocchio(name: str) -> None:
    """Two engines: with rotors on springs, folded rotors of rigid gears, and torques behind the gear."""
    trial = ARMS[name]()
    arm, model = trial.arm, as_built(trial, 3)
    motion = TreePlant(arm, model).run(trial.scenarios[0], duration_s=1.2)
    oracle, h = engine("pinocchio", arm, model), arm.period_s
    for k in (60, 120, 180):
        if arm.torque_law == "sampled":
            slope = (8.0 * (motion.qd[k + 1] - motion.qd[k - 1]) - motion.qd[k + 2] + motion.qd[k - 2]) / (12.0 * h)
            ends = (k,)
        else:
            # held from k to k + 1
            slope, ends = (motion.qd[k + 1] - motion.qd[k]) / h, (k, k + 1)
        wanted = np.mean([oracle.accelerations(*_state(motion, end), motion.tau[k])[1] for end in ends], axis=0)
        np.testing.assert_allclose(slope, wanted, rtol=0, atol=1e-3 * np.abs(motion.qd).max())


def _state(motion: Motion, k: int) -> tuple[np.ndarray, ...]:
    return motion.q[k], motion.theta[k], motion.omega[k], motion.qd[k], motion.thetad[k]


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_a_free_arm_keeps_its_angular_momentum(name: str) -> None:
    trial = ARMS[name]()
    wanted = 3.0 if name == "planar" else (2.0, -1.0, 1.5)
    plant = TreePlant(trial.arm, as_built(trial, 0))
    data = plant.start(replace(trial.scenarios[0], angular_momentum_nms=wanted))
    expected = np.array([0.0, 0.0, 3.0]) if name == "planar" else np.array(wanted)
    np.testing.assert_allclose(plant.momentum(data), expected, atol=1e-9)
    np.testing.assert_allclose(data.subtree_linvel[1], 0.0, atol=1e-12)


LAWS = [
    hidden.MotorCoulomb(1, 0.02),
    hidden.TanhCoulomb(1, 0.02),
    hidden.LuGre(1, 0.02),
    hidden.Stribeck(1, 0.02),
    hidden.StribeckLorentz(1, 0.02),
    hidden.MotorViscous(1, 0.02),
    hidden.BentViscous(1, 0.02),
    hidden.AsymmetricViscous(1, 0.02),
    hidden.SmoothAsymmetry(1, 0.02),
    hidden.LinkCoulomb(1, 0.1),
    hidden.DahlLink(1, 0.1),
    hidden.LinkViscous(1, 0.1),
    hidden.Cubic(1, 30.0),
    hidden.Hardening(1, 30.0),
]


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_a_size_is_that_of_the_column(law: Law) -> None:
    """A law with the column's form has its own size; another form has one near it, and not the same."""
    trial = ARMS["planar"]()
    motion = TreePlant(trial.arm, as_built(trial, 0)).run(trial.scenarios[0], (law,), duration_s=2.0)
    found = projected(law, [motion], 0) / law.size
    if law.exact:
        assert found == pytest.approx(1.0, abs=1e-9)
    else:
        assert 0.3 < found < 1.6
        assert abs(found - 1.0) > 1e-4
    if type(law) is hidden.TanhCoulomb:
        # a rounded reversal does hardly any work
        assert abs(projected(law, [motion], 0, power=True) / law.size - 1.0) < 0.3 * abs(found - 1.0)


@pytest.mark.slow
def test_every_law_is_felt_and_declares_how_far_it_may_be_stepped() -> None:
    """Of every cell: the motion differs from that of the null, and stays finite."""
    plain: dict[str, Motion] = {}
    for cell in cells():
        # the first of each law on each arm
        if cell.group not in {"law", "outside"} or (cell.group == "law" and not cell.name.endswith("x30")):
            continue
        one = case(cell, 0)
        if not one.plant.laws or cell.arm not in {"planar", "pendulum"}:
            continue
        name = cell.arm
        if name not in plain:
            plain[name] = Plant(one.plant.trial, as_built(one.plant.trial, 0)).run(0, 0, 0.4)[1]
        motion = replace(one.plant, model=as_built(one.plant.trial, 0)).run(0, 0, 0.4)[1]
        assert np.abs(motion.torques).max() > 0.0 or "leak" in cell.name, cell.name
        assert np.isfinite(motion.q).all()


def test_a_tide_on_every_body_is_the_pull_of_the_balances() -> None:
    """Forces and torques on the bodies of MuJoCo against what the columns make of the matrix of the kinetic energy."""
    trial, law = ARMS["spatial"](), hidden.TidalField(0, 2.0, nadir=NADIR)
    arm, model = trial.arm, as_built(trial, 3)
    plant, random = TreePlant(arm, model), np.random.default_rng(5)
    data = plant.start(trial.scenarios[0])
    values = by_name(arm, model.base_values(arm))
    matrix = gram.from_parameters(arm, np.array([values[name] for name in arm.full_body_names]))
    for _ in range(5):
        data.qpos[:] = random.standard_normal(len(data.qpos))
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        mujoco.mj_forward(plant.model, data)
        forces = np.zeros(plant.model.nv)
        for body, own in enumerate(plant.tide(data, law)):
            mujoco.mj_applyFT(plant.model, data, own[:3], own[3:], data.xipos[body], body, forces)
        back = Rotation.from_quat(data.qpos[[4, 5, 6, 3]]).inv()
        one = pull(posture(arm, data.qpos[plant.link_at]), law.size * matrix, back.apply(np.array(NADIR)))
        size = np.abs(one.base).max()
        np.testing.assert_allclose(forces[3:6], one.base, rtol=0, atol=1e-9 * size)
        np.testing.assert_allclose(forces[plant.link], one.joints, rtol=0, atol=1e-9 * size)
        # the field pulls at no mass centre, and turns no rotor
        np.testing.assert_allclose(forces[[0, 1, 2, *plant.rotor]], 0.0, atol=1e-9 * size)


def test_a_payload_comes_without_a_jerk_and_stays() -> None:
    trial = ARMS["pendulum"]()
    model = as_built(trial, 0)
    last = model.bodies[-1]
    point = (0.0, 0.0, -0.2)
    plant = TreePlant(trial.arm, model)
    motion = plant.run(trial.scenarios[0], payload=Payload(0.3, 0.4, point), duration_s=1.2)
    assert np.abs(np.diff(motion.qd, axis=0)).max() < 0.5
    mass = last.mass.value + 0.3
    centre = (last.mass.value * np.array(last.origin_xyz) + 0.3 * np.array(point)) / mass
    tensor = last.tensor
    for m, at in ((last.mass.value, np.array(last.origin_xyz)), (0.3, np.array(point))):
        lever = at - centre
        tensor = tensor + m * (lever @ lever * np.eye(3) - np.outer(lever, lever))
    entries = [replace(last.inertia[0], value=float(tensor[a, b])) for a, b in zip(*np.triu_indices(3), strict=True)]
    loaded = replace(
        last, mass=replace(last.mass, value=mass), origin_xyz=tuple(centre.tolist()), inertia=tuple(entries)
    )
    oracle = engine("pinocchio", trial.arm, replace(model, bodies=(*model.bodies[:-1], loaded)))
    k, h = 250, trial.arm.period_s
    slope = (8.0 * (motion.qd[k + 1] - motion.qd[k - 1]) - motion.qd[k + 2] + motion.qd[k - 2]) / (12.0 * h)
    np.testing.assert_allclose(slope, oracle.accelerations(*_state(motion, k), motion.tau[k])[1], atol=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_case_of_each_arm_is_read_by_the_product(name: str, tmp_path: Path) -> None:
    """What is given away are three runs, an arm file and the drawing, and nothing of the truth."""
    cell = next(c for c in cells() if c.name.startswith(f"{name}/motor_viscous"))
    one = case(cell, 0)
    true = make(one, tmp_path, 1.0)
    suffix = "csv" if one.plant.trial.table else "blf"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        f"a.{suffix}", "arm.toml", f"b.{suffix}", f"c.{suffix}", "simulation.toml",
    ]  # fmt: skip
    arm, drawn = load_arm(tmp_path / "arm.toml"), load_model(tmp_path / "simulation.toml")
    drawn.base_parameters(arm)
    run = read_run(tmp_path / f"a.{suffix}", arm)
    assert len(run.cycles) == round(1.0 / arm.period_s)
    (effect,) = true.effects
    assert (effect.key, effect.joint) == ("motor_viscous", arm.joints[one.plant.laws[0].joint].name)
    texts = (tmp_path / "arm.toml").read_text() + (tmp_path / "simulation.toml").read_text()
    assert "viscous" not in texts


@pytest.mark.slow
def test_half_of_the_nulls_have_torque_sensors_that_err() -> None:
    for name in NAMES:
        cell = cell_named(f"{name}/null")
        assert sum(is_dirty(cell, draw) for draw in range(cell.draws)) == cell.draws // 2
    assert sum(cell_named(f"{name}/null").draws for name in NAMES) >= 150
    one = case(cell_named("six/null"), 1)
    dirt = one.plant.dirt
    assert dirt is not None
    cycles, motion = one.plant.run(0, one.seed, 4.0)
    rms = np.sqrt(np.mean(motion.tau**2, axis=0))
    error = (cycles.tau - (1.0 + dirt.gain) * motion.tau) / rms
    np.testing.assert_allclose(error.std(axis=0), dirt.noise, rtol=0.1)
    np.testing.assert_allclose(error.mean(axis=0), dirt.offset, atol=6e-4)
    assert np.all((dirt.noise >= 0.001) & (dirt.noise <= 0.005))
    assert dirt.gain[0] == 0.0 and np.all((np.abs(dirt.gain[1:]) >= 0.01) & (np.abs(dirt.gain[1:]) <= 0.02))
    declared = [any(j.torque_sigma for j in case(cell_named("six/null"), draw).arm.joints) for draw in range(4)]
    assert declared == [False, False, False, True]


def test_half_of_the_laws_have_another_form_than_the_column() -> None:
    listed = [one.law for cell in cells() if cell.group == "law" for one in cell.hidden]
    laws = [law for law in listed if isinstance(law, Law)]
    assert sum(not law.exact for law in laws) >= 0.5 * len(laws)


def test_cells_have_names_and_seeds_of_their_own() -> None:
    names = [cell.name for cell in cells()]
    assert len(set(names)) == len(names)
    assert seed_of(cells()[0], 0) != seed_of(cells()[0], 1) != seed_of(cells()[1], 1)
    assert seed_of(Cell("planar/null", "six", "law", (Hidden(hidden.Offset, 0, 3.0),)), 2) == seed_of(cells()[0], 2)
    jobs = spread([], None, 0)
    assert len(jobs) == sum(cell.draws for cell in cells()) == len(set(jobs))
    # the first jobs are one of every cell
    assert len({name for name, _ in jobs[: len(names)]}) == len(names)

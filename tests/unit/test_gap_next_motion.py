# SPDX-License-Identifier: MIT
"""The motion that tells a set apart: it is flown in the simulator, and the answer then has a name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap_support import effect, example
from ground_gap_support import Array, axis, measured, sign, size
from runs_support import trajectory_of

from zygos.arm import save_arm
from zygos.can.run import Run
from zygos.effects import CATALOGUE, Effect, Kind, laws
from zygos.errors import Undecided, ZygosError
from zygos.gap.explain import explain
from zygos.gap.findings import undecided
from zygos.gap.ground.explain import explain_ground
from zygos.gap.record import MeasuredRun, read_measured_run
from zygos.gap.runs import plan_next
from zygos.model.model import save_model
from zygos.native.flight import encode
from zygos.plan.limits import Limits, limits_of
from zygos.simulation.scenario import Controller, Motion, Scenario, Sine, load_scenario, save_scenario

MEAN, HALF = 0.09, 0.03
"""Mean Coulomb friction, and half of its difference between the directions, as shares of the torque."""


def one_sided(q: Array, qd: Array) -> Array:
    return np.where(qd > 0.0, MEAN + HALF, MEAN - HALF) * size() * sign(qd)


def _free() -> Limits:
    return limits_of(axis()[0], None, None, None)


@pytest.mark.slow
def test_the_planned_motion_tells_an_offset_from_a_friction_that_differs_between_the_directions(tmp_path: Path) -> None:
    arm, model = axis()
    save_arm(arm, tmp_path / "arm.toml")
    save_model(model, tmp_path / "cad.toml")
    runs = measured(one_sided)
    found = explain_ground(arm, model, runs[:2], runs[2:])
    assert undecided(found.findings), found.sentence
    planned = plan_next(found, _free(), tmp_path / "arm.toml", tmp_path / "cad.toml")
    assert "stop" in planned.form
    assert planned.z > 20.0
    save_scenario(planned.scenario, tmp_path / "next.toml")
    scenario = load_scenario(tmp_path / "next.toml")
    reached = np.concatenate([run.cycles.q for run in runs[:2]])
    law = Kind("differs", "", "Nm", "motor", lambda motion, _: np.abs(np.tanh(motion.rate / 0.005)), positive=False)
    with laws(law):
        joint = arm.joints[0].name
        hidden = (
            Effect(CATALOGUE["motor_coulomb"], joint, MEAN * size()),
            Effect(CATALOGUE["differs"], joint, HALF * size()),
        )
        moved = trajectory_of(arm, replace(model, effects=hidden), scenario, rtol=1e-5, atol=1e-8)
    # within what the measured runs reached
    assert moved.q.min() > reached.min() - 0.01
    assert moved.q.max() < reached.max() + 0.01
    named = explain_ground(arm, model, [runs[0], Run.of_cycles(arm, moved.cycles())], runs[2:])
    assert named.answer == "named", named.sentence
    assert not undecided(named.findings)
    values = {one.kind: one.value for one in named.findings}
    assert values["motor_coulomb"] == pytest.approx(MEAN * size(), rel=0.03)
    assert values["coulomb_asymmetry"] == pytest.approx(HALF * size(), rel=0.15)


def test_nothing_is_planned_where_nothing_has_to_be_told_apart_or_no_motion_can(tmp_path: Path) -> None:
    arm, model = axis()
    runs = measured(lambda q, qd: MEAN * size() * sign(qd), seconds=10.0)
    named = explain_ground(arm, model, runs[:2], runs[2:])
    with pytest.raises(ZygosError, match="the answer is 'named': no effects have to be told apart"):
        plan_next(named, _free(), tmp_path / "arm.toml", tmp_path / "cad.toml")
    runs = measured(one_sided, seconds=10.0)
    found = explain_ground(arm, model, runs[:2], runs[2:])
    with pytest.raises(Undecided, match=r"none of [0-9]+ motions can be flown; the last one: the torque of joint"):
        plan_next(found, limits_of(arm, None, None, "0.001"), tmp_path / "arm.toml", tmp_path / "cad.toml")


RATE = 0.1
"""Of both joints of the floating arm, rad/s, in either direction: Coulomb and viscous friction are the same there."""


def _there_and_back(period_s: float, offset: float) -> Motion:
    """A triangle of constant rate with round corners, from rest."""
    size, omega = 2.0 * RATE * period_s / np.pi**2, 2.0 * np.pi / period_s
    orders = [1, 3, 5, 7, 9, 11]
    return Motion(offset, tuple(Sine(-size / k**2, k * omega, 0.5 * np.pi) for k in orders))


def _flown(scenario: Scenario, seed: int) -> MeasuredRun:
    """A run of examples/gap with a faint Coulomb friction at the elbow."""
    arm, model, _ = example()
    plant = replace(model, effects=(*model.effects, effect(arm, "motor_coulomb", 1, 0.002)))
    run = trajectory_of(arm, plant, scenario, seeds=[seed], rtol=1e-7, atol=1e-9)
    return read_measured_run(arm, Path(f"{scenario.name}-{seed}.blf"), encode(arm, run.cycles()))


@pytest.mark.slow
def test_the_planned_motion_of_a_floating_arm_tells_coulomb_from_viscous_friction(tmp_path: Path) -> None:
    """Three runs show too little; the motion that is planned for what they leave open tells it."""
    arm, model, scenario = example()
    files = tmp_path / "arm.toml", tmp_path / "cad.toml"
    save_arm(arm, files[0])
    save_model(model, files[1])
    records = []
    for seed, periods in enumerate(((5.0, 7.0), (6.0, 4.5), (5.5, 6.3))):
        moves = [_there_and_back(period, offset) for period, offset in zip(periods, (-0.3, -1.4), strict=True)]
        slow = replace(
            scenario,
            duration_s=15.0,
            manoeuvre=dict(zip(("shoulder", "elbow"), moves, strict=True)),
            initial_angles_rad=tuple(float(one.desired(0.0)[0]) for one in moves),
            controller=Controller(30000.0, 60000.0),
        )
        records.append(_flown(slow, seed))
    found = explain(arm, model, records[:2], records[2:])
    assert found.answer == "cannot tell", found.sentence
    (friction,) = found.findings
    assert {friction.kind, *friction.instead} == {"motor_coulomb", "motor_viscous2"}
    limits = limits_of(arm, None, None, None)
    planned = plan_next(found, limits, *files)
    assert planned.z > 4.5
    save_scenario(planned.scenario, tmp_path / "next.toml")
    assert load_scenario(tmp_path / "next.toml").duration_s == planned.scenario.duration_s
    named = explain(arm, model, [records[0], _flown(planned.scenario, 7)], records[2:])
    assert named.answer == "named", named.sentence
    assert [(one.kind, one.joint) for one in named.findings] == [("motor_coulomb", "elbow")]
    assert named.findings[0].value == pytest.approx(0.002, rel=0.1)
    with pytest.raises(ZygosError, match="no effects have to be told apart"):
        plan_next(named, limits, *files)

# SPDX-License-Identifier: MIT
"""A single rigid axis on a fixed base: MuJoCo moves it with friction, and the simulation has none."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

if not os.environ.get("CI"):  # there, a missing tool is a failure
    pytest.importorskip("mujoco")

from oracles.arms import Dirt, Plant, Trial, as_built, pendulum
from oracles.hidden import WIDTH, AsymmetricViscous, Law, MotorCoulomb, MotorViscous, Now, TanhCoulomb
from zygos.can.run import Run
from zygos.gap.ground.explain import explain_ground
from zygos.gap.ground.explanation import GroundExplanation
from zygos.model.model import Model
from zygos.simulation.scenario import Motion, Ramp

COULOMB, VISCOUS, ASYMMETRY = 0.03, 0.008, 0.003
SECONDS = 20.0
RUNS = pytest.mark.parametrize(("stops", "seed"), [(False, 1), (True, 0)], ids=["sines", "stops"])


@dataclass
class OneSidedCoulomb(Law):
    """Coulomb friction that is larger in one direction and smaller in the other, by `size`."""

    def torque(self, now: Now) -> float:
        return -self.size * min(1.0, abs(self._rate(now)) / WIDTH)

    def stiffness(self) -> float:
        return self.size / WIDTH


@cache
def _axis(stops: bool) -> Trial:
    """The upper half of the pendulum; stops: of 1.5 s, between ramps in both directions."""
    trial = pendulum()
    arm = replace(trial.arm, joints=trial.arm.joints[:1])
    model = trial.drawn
    drawn = Model("axis", (model.bodies[0], replace(model.bodies[1], joint_xyz=None)), model.joints[:1])
    runs = []
    for k, scenario in enumerate(trial.scenarios):
        motion = scenario.manoeuvre["shoulder"]
        if stops:
            changes = np.random.default_rng([5, k]).uniform(0.5, 1.6, 13) * (-1.0) ** np.arange(13)
            motion = Motion(0.2 * k, ramps=tuple(Ramp(3.0 * i + 0.5, 1.5, float(x)) for i, x in enumerate(changes)))
        start = (float(motion.desired(np.zeros(1))[0][0]),)
        runs.append(replace(scenario, manoeuvre={"shoulder": motion}, initial_angles_rad=start))
    return Trial(arm, drawn, (runs[0], runs[1], runs[2]), table=True)


def _explained(laws: tuple[Law, ...], stops: bool, seed: int, offset: float = 0.0) -> GroundExplanation:
    trial = _axis(stops)
    dirt = Dirt(noise=np.array([0.002]), gain=np.zeros(1), offset=np.array([offset]))
    plant = Plant(trial, as_built(trial, seed), laws, dirt=dirt)
    runs = [Run.of_cycles(trial.arm, plant.run(k, seed, SECONDS)[0]) for k in range(3)]
    return explain_ground(trial.arm, trial.drawn, runs[:2], runs[2:])


@pytest.mark.slow
@RUNS
def test_coulomb_friction_then_viscous_friction_that_differs_between_the_directions(stops: bool, seed: int) -> None:
    laws = (TanhCoulomb(0, COULOMB), MotorViscous(0, VISCOUS), AsymmetricViscous(0, ASYMMETRY))
    x = _explained(laws, stops, seed)
    assert x.answer in ("named", "part named"), x.sentence
    kinds = [f.kind for f in x.findings]
    assert set(kinds) == {"motor_coulomb", "motor_viscous", "viscous_asymmetry"}, x.sentence
    assert kinds.index("motor_coulomb") < kinds.index("viscous_asymmetry")
    sizes = {f.kind: f.value for f in x.findings}
    assert sizes["motor_coulomb"] == pytest.approx(COULOMB, rel=0.03)
    assert sizes["motor_viscous"] == pytest.approx(VISCOUS, rel=0.03)
    assert sizes["viscous_asymmetry"] == pytest.approx(ASYMMETRY, rel=0.03)


@pytest.mark.slow
@RUNS
def test_no_friction_has_no_name(stops: bool, seed: int) -> None:
    x = _explained((), stops, seed, offset=0.02 * seed)
    assert x.answer in ("nothing missing", "values differ"), x.sentence


@pytest.mark.slow
@RUNS
def test_an_offset_and_a_friction_of_one_direction_are_one_set(stops: bool, seed: int) -> None:
    """A servo lets the axis stick at any torque up to its friction, so that its stops need not tell them apart."""
    x = _explained((MotorCoulomb(0, COULOMB), OneSidedCoulomb(0, 0.3 * COULOMB)), stops, seed)
    coulomb, constant = x.findings
    assert (coulomb.kind, coulomb.value) == ("motor_coulomb", pytest.approx(COULOMB, rel=0.02)), x.sentence
    assert constant.value == pytest.approx(0.3 * COULOMB, rel=0.06)
    assert (constant.kind, constant.instead) == ("torque_offset", ("coulomb_asymmetry1",)), x.sentence
    assert "cannot tell apart" in x.sentence


@pytest.mark.slow
def test_what_creeps_before_a_stop_is_not_compared_with_a_law_of_friction() -> None:
    """The servo brings the axis to rest slowly, and the plant's friction there is a tanh of the rate."""
    laws = (TanhCoulomb(0, COULOMB), MotorViscous(0, VISCOUS))
    x = _explained(laws, stops=True, seed=0)
    sizes = {f.kind: f.value for f in x.findings}
    wanted = {"motor_coulomb": pytest.approx(COULOMB, rel=0.02), "motor_viscous": pytest.approx(VISCOUS, rel=0.04)}
    assert sizes == wanted, x.sentence

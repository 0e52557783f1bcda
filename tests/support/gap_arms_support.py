# SPDX-License-Identifier: MIT
"""An arm with flexible joints on the ground, as plant of MuJoCo, and the twin study that begins with its true model."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from oracles.arms import Trial, pendulum
from zygos.arm import Smoother
from zygos.dynamics.equations import from_model
from zygos.gap.balances import Acting, Layout
from zygos.gap.record import MeasuredRun
from zygos.gap.study import Study, begin, read_hypothesis
from zygos.model.model import Quantity
from zygos.simulation.scenario import Controller

SECONDS = 16.0


@cache
def standing() -> Trial:
    """Two flexible joints in a vertical plane on the ground."""
    trial = pendulum()
    joints = tuple(replace(joint, flexible=True, gear_ratio=50.0) for joint in trial.arm.joints)
    arm = replace(trial.arm, joints=joints, torque_law="applied_from_sync", smoother=Smoother(13, 4, 6), arc_max_s=8.0)
    drives = tuple(
        replace(one, rotor_inertia=Quantity(1e-4), stiffness=Quantity(500.0), damping=Quantity(2.0))
        for one in trial.drawn.joints
    )
    controller = Controller(kp=60.0, kd=12.0)
    a, b, c = (replace(one, controller=controller) for one in trial.scenarios)
    return Trial(arm, replace(trial.drawn, joints=drives), (a, b, c), True)


def begun(trial: Trial, runs: tuple[MeasuredRun, ...], own: tuple[Acting, ...]) -> Study:
    """The true model's equations, without effects, fitted to runs, with columns of these entries in any case."""
    model = replace(trial.drawn, effects=())
    hypothesis = read_hypothesis(Layout(trial.arm), model)
    wide = replace(hypothesis, layout=replace(hypothesis.layout, own=own))
    return begin(runs, wide, from_model(trial.arm, model))

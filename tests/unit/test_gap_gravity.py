# SPDX-License-Identifier: MIT
"""Gravity that the arm file does not state, or states along another direction, is a matter of the arm file."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from trial_support import runs_of

from oracles.arms import Plant, Trial, pendulum, six
from zygos.can.run import Run
from zygos.gap.ground.explain import explain_ground
from zygos.gap.verdicts import WrongGravity

SECONDS = 4.0
WEIGHT = (0.0, 0.0, -9.81)
TRIALS = {"pendulum": pendulum, "six": six}


@cache
def recorded(name: str, gravity: tuple[float, float, float]) -> tuple[Trial, tuple[Run, Run, Run]]:
    """Three runs of an arm in MuJoCo in which gravity is this."""
    trial = TRIALS[name]()
    trial = replace(trial, arm=replace(trial.arm, gravity=gravity))
    a, b, c = runs_of(Plant(trial, trial.drawn), 3, SECONDS, (0, 1, 2))
    return trial, (a, b, c)


def verdict(name: str, real: tuple[float, float, float], stated: tuple[float, float, float]) -> object:
    trial, runs = recorded(name, real)
    arm = replace(trial.arm, gravity=stated)
    a, b, c = (replace(run, arm=arm) for run in runs)
    found = explain_ground(arm, trial.drawn, (a, b), (c,))
    print(found.sentence)
    return found.verdict


@pytest.mark.slow(but=["pendulum-none"])
@pytest.mark.parametrize(
    ("name", "real", "stated"),
    [
        pytest.param("pendulum", WEIGHT, (0.0, 0.0, 0.0), id="pendulum-none"),
        pytest.param("six", WEIGHT, (0.0, 0.0, 0.0), id="six-none"),
        # the foot stands on a slope of 10 degrees
        pytest.param("six", (1.703, 0.0, -9.661), WEIGHT, id="six-slope"),
    ],
)
def test_another_gravity_is_found(
    name: str, real: tuple[float, float, float], stated: tuple[float, float, float]
) -> None:
    found = verdict(name, real, stated)
    assert isinstance(found, WrongGravity)
    np.testing.assert_allclose(found.found, real, atol=0.15)


def test_the_gravity_of_the_arm_file_is_left_alone() -> None:
    assert not isinstance(verdict("pendulum", WEIGHT, WEIGHT), WrongGravity)

# SPDX-License-Identifier: MIT
"""The twin moves as the arm did, although the torque sensors are off: their offsets and gains act on no arm."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from trial_support import runs_of, sampled

from oracles.arms import Plant, Trial, planar
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.gap.balances import Layout
from zygos.gap.runs import record_of
from zygos.gap.study import Study, begin, read_hypothesis

SECONDS = 8.0
NOISE = 0.02
OFFSET, GAIN = (0.4, -0.4), (0.0, 0.015)


@cache
def recorded() -> tuple[Trial, tuple[Run, ...]]:
    """The arm at 50 Hz, and two runs of it."""
    trial = sampled(planar(), 0.02, 7)
    return trial, runs_of(Plant(trial, replace(trial.drawn, effects=())), 5, SECONDS)


def noisy(arm: Arm) -> Arm:
    return replace(arm, joints=tuple(replace(joint, torque_sigma=NOISE) for joint in arm.joints))


def study(offset: tuple[float, float], gain: tuple[float, float]) -> Study:
    (trial, runs), random = recorded(), np.random.default_rng(1)
    arm, model = noisy(trial.arm), replace(trial.drawn, effects=())
    records = []
    for run in runs:
        exact = run.cycles.tau
        tau = exact * (1.0 + np.array(gain)) + np.array(offset) + NOISE * random.standard_normal(exact.shape)
        records.append(record_of(replace(run, arm=arm, table=replace(run.cycles, tau=tau))))
    return begin(records, read_hypothesis(Layout(arm), model), from_model(arm, model))


def strayed(found: Study) -> float:
    """Largest root mean square by which a twin's joint angle is off the measured one, rad."""
    each = [
        np.sqrt(np.mean((twin.exact.q - record.readings().q) ** 2, axis=(0, 1)))
        for twin, record in zip(found.twins, found.records, strict=True)
    ]
    return float(np.max(each))


@pytest.mark.slow
def test_torque_sensors_that_are_off_do_not_lead_the_twin_astray() -> None:
    right, off = study((0.0, 0.0), (0.0, 0.0)), study(OFFSET, GAIN)
    at = [off.layout.zeros.index(f"torque_zero{i + 1}") for i in (0, 1)]
    print(strayed(right), strayed(off), off.zeros[:, at], off.excess.round(2))
    assert off.zeros[:, at] == pytest.approx(np.tile(OFFSET, (2, 1)), abs=0.02)
    assert strayed(off) < 1.5 * strayed(right)

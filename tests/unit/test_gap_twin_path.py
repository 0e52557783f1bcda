"""The twin moves as the arm did, although the torque sensors are off: their offsets and gains act on no arm."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from oracles.arms import Plant, planar
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.gap.balances import Layout
from zygos.gap.runs import record_of
from zygos.gap.study import Study, begin, read_hypothesis
from zygos.runs.cycles import Cycles

SECONDS = 16.0
NOISE = 0.02
OFFSET, GAIN = (0.4, -0.4), (0.0, 0.015)


@cache
def recorded() -> tuple[Cycles, ...]:
    trial = planar()
    plant = Plant(trial, replace(trial.drawn, effects=()))
    return tuple(plant.run(which, 5, SECONDS)[0] for which in (0, 1))


def noisy(arm: Arm) -> Arm:
    return replace(arm, joints=tuple(replace(joint, torque_sigma=NOISE) for joint in arm.joints))


def study(offset: tuple[float, float], gain: tuple[float, float]) -> Study:
    trial, random = planar(), np.random.default_rng(1)
    arm, model = noisy(trial.arm), replace(trial.drawn, effects=())
    records = []
    for cycles, name in zip(recorded(), "ab", strict=True):
        tau = cycles.tau * (1.0 + np.array(gain)) + np.array(offset) + NOISE * random.standard_normal(cycles.tau.shape)
        records.append(record_of(Run(arm, table=replace(cycles, tau=tau), path=Path(name))))
    return begin(records, read_hypothesis(Layout(arm), model), from_model(arm, model))


def strayed(found: Study) -> float:
    """Largest root mean square by which a twin's joint angle is off the measured one, rad."""
    each = [
        np.sqrt(np.mean((twin.exact.q - record.readings().q) ** 2, axis=(0, 1)))
        for twin, record in zip(found.twins, found.records, strict=True)
    ]
    return float(np.max(each))


def test_torque_sensors_that_are_off_do_not_lead_the_twin_astray() -> None:
    right, off = study((0.0, 0.0), (0.0, 0.0)), study(OFFSET, GAIN)
    at = [off.layout.zeros.index(f"torque_zero{i + 1}") for i in (0, 1)]
    print(strayed(right), strayed(off), off.zeros[:, at], off.excess.round(2))
    assert off.zeros[:, at] == pytest.approx(np.tile(OFFSET, (2, 1)), abs=0.02)
    assert strayed(off) < 1.5 * strayed(right)

# SPDX-License-Identifier: MIT
"""Runs of plants of MuJoCo, as an explanation reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from oracles.arms import Plant, Trial, planar
from zygos.can.run import Run
from zygos.gap.record import MeasuredRun
from zygos.gap.runs import record_of


@cache
def planar_trial() -> Trial:
    """The planar arm of the trials with cycles of 10 ms: half as many as the arm file says, which is enough."""
    trial = planar()
    return replace(trial, arm=trial.arm.at_period(0.01))


def records(plant: Plant, seconds: Sequence[float], seed: int = 5) -> tuple[MeasuredRun, ...]:
    """Runs a, b and c, or the first of them, of so many seconds each. seed: of the sensors."""
    return tuple(
        record_of(Run(plant.trial.arm, table=plant.run(which, seed, duration)[0], path=Path("abc"[which])))
        for which, duration in enumerate(seconds)
    )

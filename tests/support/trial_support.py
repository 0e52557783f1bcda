# SPDX-License-Identifier: MIT
"""Runs of the trials' plants in MuJoCo, each computed once (runs_support)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from runs_support import kept

from oracles.arms import Plant, Trial
from zygos.arm import Smoother
from zygos.can.run import Run
from zygos.runs.cycles import Cycles


def sampled(trial: Trial, period_s: float, points: int) -> Trial:
    """The trial with another SYNC period and a smoother of so many points: at a long one, runs have few instants."""
    return replace(trial, arm=replace(trial.arm.at_period(period_s), smoother=Smoother(points, 4, points // 2)))


def runs_of(plant: Plant, seed: int, duration_s: float, which: Sequence[int] = (0, 1)) -> tuple[Run, ...]:
    """What is recorded of some of a plant's runs. seed: of the sensors."""

    def recorded(k: int) -> Cycles:
        found: Cycles = kept(lambda: plant.run(k, seed, duration_s)[0], ("oracles.arms",), plant, k, seed, duration_s)
        return found

    return tuple(Run(plant.trial.arm, table=recorded(k), path=Path("abc"[k])) for k in which)

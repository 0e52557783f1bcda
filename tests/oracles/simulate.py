# SPDX-License-Identifier: MIT
"""Runs of the MuJoCo plant, and their logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from oracles.laws import Law
from oracles.plant import STEP_S, MujocoPlant
from zygos.arm import Arm
from zygos.can.bus import write_log
from zygos.model.model import Model
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Scenario


def run(arm: Arm, model: Model, scenario: Scenario, seed: int, law: Law | Sequence[Law] | None = None) -> Cycles:
    """What the sensors record of one run; `law` is a hidden effect, several, or none."""
    laws = () if law is None else (law,) if isinstance(law, Law) else law
    # coarse encoders at a long period do not see what a step of a fifth of it does
    step = max(STEP_S, arm.period_s / 5.0)
    return MujocoPlant(arm, model).run(scenario, laws, seed=seed, noise=scenario.noise, step_s=step).cycles


def write(cycles: Cycles, arm: Arm, path: Path) -> None:
    """Write a run as the log of a bus, in the format of the suffix."""
    write_log(path, encode(arm, cycles), arm.period_s)

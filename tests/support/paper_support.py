# SPDX-License-Identifier: MIT
"""The run of the paper's example that several folders share."""

from __future__ import annotations

from runs_support import trajectory_of

from conftest import PAPER
from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import load_scenario

SEEDS = 16


def paper_run() -> Trajectory:
    """60 s with noise, of seeds 0 .. 15, at a tolerance that is fine enough for what sensors see."""
    arm, model, scenario = load_arm(PAPER / "arm.toml"), load_model(PAPER / "model.toml"), PAPER / "scenario.toml"
    return trajectory_of(arm, model, load_scenario(scenario), seeds=range(SEEDS), noise=True, rtol=1e-9, atol=1e-11)

# SPDX-License-Identifier: MIT
"""Runs in many short arcs, with rows of every kind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from flight_support import joined, part
from motion_support import random_ground
from rows_support import run as simulated
from soak_support import again, stored

from conftest import EXAMPLE
from zygos.arm import Arm, load_arm
from zygos.model.model import load_model
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

KINDS = ("planar", "spatial", "ground")
"""Arms with rows of every kind."""


@cache
def recording() -> tuple[Arm, Cycles]:
    """A minute of the example without noise."""
    arm = load_arm(EXAMPLE / "arm.toml")
    return arm, stored(arm, load_model(EXAMPLE / "model.toml"), load_scenario(EXAMPLE / "scenario.toml"))


@cache
def run(kind: str) -> tuple[Arm, Cycles]:
    """Cycles in arcs of which several are closed and one is open; joint rows on the ground."""
    if kind == "ground":
        known = random_ground(3, "spatial", 2600)
        return known.arm, known.cycles(0)
    if kind == "spatial":
        arm, motion, _, _ = simulated("spatial")
        rng = np.random.default_rng(0)
        arm = replace(arm, arc_max_s=1.2, impulse_arc_s=0.4, momentum_max_s=0.6)
        return arm, joined(*(again(arm, motion, 1 + lap * len(motion), rng) for lap in range(2)))
    arm, motion = recording()
    arm = replace(arm, arc_max_s=6.0, impulse_arc_s=2.0, momentum_max_s=4.0, memory_s=600.0)
    return arm, part(again(arm, motion, 1, np.random.default_rng(0)), 0, 1000)

# SPDX-License-Identifier: MIT
"""States whose solution is counted: a motion with the sensors' noise that determines every parameter.

The cycles that are counted are random, so that each of them is among the most expensive ones. Their estimate would be
refused early, which costs less than one that is made.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from ground_support import seen, torque_of
from laboratory_support import laboratory_arm
from runs_support import trajectory_of

from bench import callgrind, cortex
from bench.configurations import GROUND_PERIOD_S, Configuration, random_cycles, write_run
from bench.counting import Count
from conftest import ROOT
from zygos.errors import ZygosError
from zygos.model.model import load_model
from zygos.native.flight import lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

DURATION_S = {"paper": 120.0, "spatial": 30.0, "seven": 60.0}
"""Of the example's motion, so that blocks have merged and no parameter is left out."""
GROUND_S = 60.0
_KNOWN: dict[str, Cycles] = {}


def motion(one: Configuration) -> Cycles:
    """The motion of a configuration's arm, simulated once in a process."""
    if one.example not in _KNOWN:
        if one.example:
            place = ROOT / "examples" / one.example
            plant, scenario = load_model(place / "model.toml"), load_scenario(place / "scenario.toml")
            run = trajectory_of(
                one.arm, plant, scenario, noise=True, duration_s=DURATION_S[one.example], rtol=1e-6, atol=1e-8
            )
            _KNOWN[one.example] = run.cycles()
        else:
            q, tau = torque_of(one.arm, laboratory_arm("UR10e", period_s=GROUND_PERIOD_S)[1], 0, GROUND_S)
            _KNOWN[one.example] = seen(one.arm, q, tau, 0)
    return _KNOWN[one.example]


def write_state(one: Configuration, program: Path) -> None:
    """Fly the motion here, in the driver for this machine, and write state.bin beside it. zygos_arm_t is the same on
    every target."""
    place = program.parent / "flown"
    write_run(one, motion(one), place / "run.bin")
    subprocess.run([program.resolve()], cwd=place, check=True)
    (place / "end.bin").replace(program.with_name("state.bin"))
    shutil.rmtree(place)


def count(target: str, one: Configuration, inputs: int, folder: Path) -> Count:
    """The cost of so many random cycles, and of a solution with every parameter. Errors: ZygosError where that was
    refused or leaves some out."""
    write_run(one, random_cycles(one.arm, inputs), folder / "run.bin")
    write_state(one, callgrind.build(folder, one.capacities))
    if target == "x86-64":
        return full(callgrind.count(folder))
    cortex.build(target, folder, one.capacities)
    return full(cortex.count(target, folder))


def full(count: Count) -> Count:
    """The count, of a solution with every parameter. Errors: ZygosError where it was refused or leaves some out."""
    if count.validity < lib.ZYGOS_PARTIAL or count.rank != count.sizes["parameters"]:
        raise ZygosError(
            f"the solution that was counted has rank {count.rank} of {count.sizes['parameters']}, validity "
            f"{count.validity}; remedy: a longer motion in bench/flown.py"
        )
    return count

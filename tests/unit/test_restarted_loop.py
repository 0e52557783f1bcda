# SPDX-License-Identifier: MIT
"""What zygos_restart() ends in the memory of the background."""

from __future__ import annotations

from loop_support import Loop, native_cycles
from runs_support import trajectory_of

from conftest import ROOT
from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.native.flight import config_of, ffi, lib
from zygos.simulation.scenario import load_scenario


def test_a_change_of_the_arm_before_is_not_one_of_the_arm_after() -> None:
    """The comparison that has found a change is forgotten."""
    folder = ROOT / "examples" / "paper"
    arm = load_arm(folder / "arm.toml")
    scenario = load_scenario(folder / "scenario.toml")
    cycles = native_cycles(trajectory_of(arm, load_model(folder / "model.toml"), scenario).cycles())
    loop = Loop(config_of(arm))
    changed = []
    for k in range(len(cycles)):
        assert loop.cycle(ffi.addressof(cycles, k)) >= 0
        if k == len(cycles) // 2:
            loop.memory.changed = 1
            assert lib.zygos_restart(loop.native, 0) == 1
        if loop.solve() == 1 and k > len(cycles) // 2:
            changed.append(loop.estimate.changed)
    assert changed
    assert not any(changed)

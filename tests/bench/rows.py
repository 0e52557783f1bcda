# SPDX-License-Identifier: MIT
"""The rows of out/bench.json: a stage of a configuration on a target."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench import flown
from bench.configurations import CONFIGURATIONS, JOINT_ROWS
from bench.counting import STAGES, TOGETHER, Count, spread_by_data
from bench.footprint import LIBRARY, footprints
from bench.profile import profile

FOLDER = Path("out/bench")
TARGETS = ("x86-64", "m7", "m4f")


def inputs(target: str, name: str) -> int:
    """Random cycles that are fed: 10,000 but where counting them takes minutes. Joint rows need 2 s for a segment."""
    return (2000 if name.endswith(JOINT_ROWS) else 1000) if target == "m4f" else 2000 if name == "seven" else 10_000


def measure(target: str, name: str) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """The rows of a configuration on a target, and its profile."""
    folder, one = FOLDER / target / name.replace(", ", "-"), CONFIGURATIONS[name]()
    count = flown.count(target, one, inputs(target, name), folder)
    bytes_of = footprints(target, folder / "objects", one.capacities)
    rows = []
    for stage in (*STAGES, TOGETHER, LIBRARY):
        size = bytes_of[stage if stage != TOGETHER else LIBRARY]
        rows.append(
            {
                "target": target,
                "configuration": name,
                "parameters": count.sizes["parameters"],
                "stage": stage,
                **_costs(count, stage),
                "bytes_code": None if stage == TOGETHER else size.code,
                "bytes_state": None if stage == TOGETHER else _state(count, stage),
                "bytes_stack": None if stage == TOGETHER else size.stack,
            }
        )
    return rows, profile(count)


def _costs(count: Count, stage: str) -> dict[str, Any]:
    """Instructions: the mean of ordinary cycles; how far they are apart; and the most of any cycle, of those in which
    an arc waits until the one before it is closed, and of those in which sums are copied or an estimate is adopted."""
    if stage in ("solver", "solve", LIBRARY):
        solved = None if stage == LIBRARY else count.tally.solve
        return {
            "instructions": solved,
            "spread": None,
            "spread_by_place": None,
            "most": solved,
            "waits": None,
            "hands": None,
            "inputs": 1,
        }
    chosen, counted, waits, hands = count.ordinary(), count.stage(stage), count.waits(), count.hands()
    return {
        "instructions": round(float(counted[chosen].mean()), 1),
        "spread": spread_by_data(count, stage),
        "spread_by_place": int(counted[chosen].max() - counted[chosen].min()),
        "most": int(counted.max()),
        "waits": int(counted[waits].max()) if waits.any() else None,
        "hands": int(counted[hands].max()) if hands.any() else None,
        "inputs": int(chosen.sum()),
    }


def _state(count: Count, stage: str) -> int:
    """Bytes of state."""
    whole = {"frame": "whole", "step": "whole", "solve": "solver"}
    if stage == LIBRARY:
        return count.sizes["whole"] + count.sizes["solver"]
    return count.sizes.get(whole.get(stage, stage), 0)

# SPDX-License-Identifier: MIT
"""Where the instructions of a full cycle go, function by function.

python -m bench.profile ["paper, bare" [INPUTS [x86-64|m7|m4f]]]
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench import callgrind, cortex
from bench.configurations import CONFIGURATIONS, random_cycles, write_run
from bench.counting import RELEVANT, TOGETHER, Count, spread_by_data
from zygos.files.output import say, table


def profile(count: Count) -> dict[str, float]:
    """Mean instructions of each function in an ordinary cycle, most first: its own, not those of what it calls."""
    chosen = count.ordinary()
    means = {name: float(calls[chosen].mean()) for name, calls in count.tally.functions.items()}
    return dict(sorted(((k, v) for k, v in means.items() if v > 0.0), key=lambda item: -item[1]))


def show(count: Count) -> None:
    """Print stages and functions."""
    chosen = count.ordinary()
    rows = []
    for stage in (*RELEVANT, "step", TOGETHER):
        counted = count.stage(stage)[chosen]
        spread = str(spread_by_data(count, stage))
        rows.append((stage, f"{counted.mean():,.1f}", f"{counted.min():,}", f"{counted.max():,}", spread))
    table(("stage", "instructions", "least", "most", "by data"), rows)
    say("")
    found = profile(count)
    share = sum(found.values())
    table(("function", "own", "%"), [(k, f"{v:,.1f}", f"{100 * v / share:.1f}") for k, v in found.items()])


if __name__ == "__main__":
    name, inputs, target = (sys.argv[1:] + ["paper, bare", "1000", "x86-64"][len(sys.argv) - 1 :])[:3]
    targets = ("x86-64", *cortex.firmware.TARGETS)
    if name not in CONFIGURATIONS or target not in targets or not inputs.isdecimal():
        say(f"usage: bench.profile CONFIGURATION INPUTS TARGET; {' · '.join(CONFIGURATIONS)}; {' · '.join(targets)}")
        sys.exit(2)
    folder = Path("out/bench/profile")
    one = CONFIGURATIONS[name]()
    write_run(one, random_cycles(one.arm, int(inputs)), folder / "run.bin")
    if target == "x86-64":
        callgrind.build(folder, one.capacities)
        show(callgrind.count(folder))
    else:
        cortex.build(target, folder, one.capacities)
        show(cortex.count(target, folder))

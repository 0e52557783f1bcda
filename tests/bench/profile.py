"""Where the instructions of a full cycle go, function by function, on the host.

    python -m bench.profile ["paper, bare"] [INPUTS]
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench import callgrind
from bench.configurations import CONFIGURATIONS, random_cycles, write_run
from bench.counting import STAGES, WHOLE, Count, spread_by_data
from zygos.output import say, table


def profile(count: Count) -> dict[str, float]:
    """Mean instructions of each function in an ordinary cycle, most first: its own, not those of what it calls."""
    chosen = count.ordinary()
    means = {name: float(calls[chosen].mean()) for name, calls in count.tally.functions.items()}
    return dict(sorted(((k, v) for k, v in means.items() if v > 0.0), key=lambda item: -item[1]))


def show(count: Count) -> None:
    """Print stages and functions."""
    chosen = count.ordinary()
    rows = []
    for k, stage in enumerate(STAGES):
        counted = count.tally.stages[chosen, k]
        if stage not in ("solver", "solve"):
            spread = str(spread_by_data(count, stage))
            rows.append((stage, f"{counted.mean():,.1f}", f"{counted.min():,}", f"{counted.max():,}", spread))
    full = count.tally.stages[chosen][:, [STAGES.index(one) for one in WHOLE[:2]]].sum(axis=1)
    rows.append(("frame + step", f"{full.mean():,.1f}", f"{full.min():,}", f"{full.max():,}", ""))
    table(("stage", "instructions", "least", "most", "by data"), rows)
    say("")
    found = profile(count)
    share = sum(found.values())
    table(("function", "own", "%"), [(k, f"{v:,.1f}", f"{100 * v / share:.1f}") for k, v in found.items()])


if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else "paper, bare"
    inputs = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    folder = Path("out/bench/profile")
    one = CONFIGURATIONS[name]()
    callgrind.build(folder, one.capacities)
    write_run(one, random_cycles(one.arm, inputs), folder / "run.bin")
    show(callgrind.count(folder))

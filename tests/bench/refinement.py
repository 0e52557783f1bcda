# SPDX-License-Identifier: MIT
"""How good `zygos refine` is, and what it refuses: the tables of docs/results.md.

    python -m bench.refinement [SEEDS [NAME ...]]

A name is one of those in the first column; without names all but those in space are measured. Every run passes through
CAN frames. Prints the rows of the tables; the quotient of rms error and bound is a mean over the parameters.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from refine_support import Case, Score, drawing, runs, score

CASES = {
    "complete, steps of the frames": Case(noise=0.0),
    "complete, 0.1 %": Case(noise=0.001),
    "complete, 0.5 %": Case(),
    "complete, 1 %": Case(noise=0.01),
    "complete, 0.5 %, declared 2 %": Case(declared=0.02),
    "complete, mounted to a step, steps of the frames": Case(noise=0.0, mounted=True),
    "complete, mounted to a step, 0.5 %": Case(mounted=True),
    **{f"delay of {ms} ms": Case(effects=(("torque_lag", 1e-3 * ms),)) for ms in (1, 2, 5, 10, 20)},
    **{f"gain of the elbow {100 * x:g} % higher": Case(gain=1.0 + x) for x in (0.001, 0.002, 0.005, 0.02, 0.05)},
    **{f"cubic springs, {x:g} Nm/rad³": Case(effects=(("cubic_stiffness", x),)) for x in (0.3, 1.0, 3.0, 10.0, 30.0)},
    **{f"friction of motors, {x:g} Nm": Case(effects=(("motor_coulomb", x),)) for x in (0.005, 0.01, 0.1, 0.3)},
    **{f"viscous friction of motors, {x:g} Nms": Case(effects=(("motor_viscous", x),)) for x in (0.01, 0.1, 1.0)},
    **{f"friction of joints, {x:g} Nm": Case(effects=(("link_coulomb", x),)) for x in (0.3, 2.0, 5.0)},
    **{
        f"declared 5 %, {name}": Case(declared=0.05, **more)
        for name, more in {
            "gain of the elbow 5 % higher": {"gain": 1.05},
            "delay of 10 ms": {"effects": (("torque_lag", 0.01),)},
            "cubic springs, 10 Nm/rad³": {"effects": (("cubic_stiffness", 10.0),)},
            "friction of motors, 0.3 Nm": {"effects": (("motor_coulomb", 0.3),)},
            "friction of joints, 5 Nm": {"effects": (("link_coulomb", 5.0),)},
            "viscous friction of motors, 0.1 Nms": {"effects": (("motor_viscous", 0.1),)},
        }.items()
    },
    "space, steps of the frames": Case("spatial", 0.0),
    "space, 0.5 %": Case("spatial"),
    "space, mounted to a step, steps of the frames": Case("spatial", 0.0, mounted=True),
}


def row(name: str, scores: list[Score], seconds: float) -> str:
    """A row of the table."""
    useful = [one for one in scores if one.found is not None]
    cells = [name, str(len(scores)), str(sum(one.published for one in scores)), str(sum(one.harmful for one in scores))]
    if useful:
        error, sigma = (np.array([getattr(one, key) for one in useful]) for key in ("error", "sigma"))
        rms = np.sqrt(np.mean(error**2, axis=0))
        bounds = [one.found.limit.sigma / one.found.size for one in useful if one.found and one.found.limit]
        ratio = float(np.mean(rms / np.mean(bounds, axis=0))) if bounds else float("nan")
        within = float(np.mean(np.abs(error) < 1.959964 * sigma))
        level = float(np.mean([max(one.found.level) for one in useful if one.found]))
        cells += [f"{100 * level:.2g}", f"{100 * rms.mean():.2g}", f"{100 * rms.max():.2g}", f"{ratio:.3g}"]
        cells += [f"{100 * within:.0f}"]
        inertia = [one.inertia for one in useful if one.inertia]
        cells += [" / ".join(f"{x:.2g}" for x in np.sqrt(np.mean(np.square(inertia), axis=0)))] if inertia else [""]
        failed = [rule.key for one in useful if one.found for rule in one.found.rules if not rule.holds]
    else:
        cells += [""] * 6
        failed = []
    failed += ["no start"] * (len(scores) - len(useful))
    cells += [", ".join(f"{key} {failed.count(key)}" for key in dict.fromkeys(failed)), f"{seconds / len(scores):.3g}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Measure, and print."""
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
    heads = ("case", "runs", "published", "harmful", "level %", "mean rms %", "worst rms %", "× bound", "within 95 %")
    print("| " + " | ".join((*heads, "H(q) worst / median %", "rules that failed", "s")) + " |")
    for name in sys.argv[2:] or [name for name, case in CASES.items() if case.example != "spatial"]:
        case = CASES[name]
        scores, seconds = [], 0.0
        for seed in seeds:
            run = runs(case, [seed])[seed]
            begun = time.process_time()
            scores.append(score(case, run, drawing(case.example, seed) if case.example == "spatial" else None))
            seconds += time.process_time() - begun
        print(row(name, scores, seconds), flush=True)


if __name__ == "__main__":
    main()

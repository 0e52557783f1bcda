# SPDX-License-Identifier: MIT
"""What an arm in space costs to simulate: with the compiled equations of motion beside numpy's, and what it errs by.

    PYTHONPATH=tests:tests/support python -m bench.simulator [out/simulator.json]

Both ways follow the same scenario with the same integrator, tolerance and servo, in turns, in one process; of each the
least CPU time counts. The error is the largest difference from numpy's equations at a tenth of the tolerance, of the
size of each signal.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from conftest import ROOT
from zygos.arm import Arm, load_arm
from zygos.dynamics.compiled import Multibody
from zygos.dynamics.serial import SpatialDynamics
from zygos.files.output import errors_end_the_program, number, say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import Model, load_model
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario, load_scenario

PERIOD_S = 0.01
TURNS = 2
TIGHT = {"rtol": 1e-13, "atol": 1e-15}
SIGNALS = ("attitude", "omega0", "q", "qd", "theta", "thetad", "tau", "slip2")


def example(name: str) -> tuple[Arm, Model, Scenario]:
    """An example at the rate at which it is measured here."""
    folder = ROOT / "examples" / name
    arm = load_arm(folder / "arm.toml").at_period(PERIOD_S)
    return arm, load_model(folder / "model.toml"), load_scenario(folder / "scenario.toml")


def six() -> tuple[Arm, Model, Scenario]:
    """The arm of seven joints without the last of them."""
    arm, model, scenario = example("seven")
    last = arm.joints[-1].name
    control = scenario.controller
    assert isinstance(control.kp, tuple) and isinstance(control.kd, tuple)
    return (
        replace(arm, joints=arm.joints[:-1]),
        replace(
            model,
            bodies=(*model.bodies[:-2], replace(model.bodies[-2], joint_xyz=None)),
            joints=model.joints[:-1],
        ),
        replace(
            scenario,
            manoeuvre={name: motion for name, motion in scenario.manoeuvre.items() if name != last},
            initial_angles_rad=(),
            controller=replace(control, kp=control.kp[:-1], kd=control.kd[:-1]),
        ),
    )


CASES: dict[str, tuple[Callable[[], tuple[Arm, Model, Scenario]], float]] = {
    "spatial": (lambda: example("spatial"), 0.3),
    "seven without wrist roll": (six, 0.1),
    "seven": (lambda: example("seven"), 0.1),
}
"""By name: arm, model and scenario, and the seconds that are simulated."""


@dataclass(frozen=True)
class Cost:
    """What a case costs."""

    name: str
    joints: int
    period_s: float
    simulated_s: float
    evaluations: float
    """Of the equations of motion in a SYNC period."""
    numpy_s: float
    """CPU seconds a simulated second."""
    compiled_s: float
    ratio: float
    error: float


def far(got: Trajectory, wanted: Trajectory) -> float:
    """The largest difference of two motions, of the size of its signal."""
    pairs = [(getattr(got, name), getattr(wanted, name)) for name in SIGNALS]
    return max(float(np.abs(one - other).max() / np.abs(other).max()) for one, other in pairs)


def measure(name: str, simulated_s: float | None = None, turns: int = TURNS) -> Cost:
    """Simulate a case both ways, in turns: `turns` times each."""
    make, usual_s = CASES[name]
    arm, model, scenario = make()
    duration = usual_s if simulated_s is None else simulated_s
    calls = 0

    class Counted(Multibody):
        def accelerations(self, *state: Any) -> Any:
            nonlocal calls
            calls += 1
            return super().accelerations(*state)

    def run(law: type[SpatialDynamics], **tolerance: float) -> tuple[float, Trajectory]:
        dynamics = law.from_model(arm, model)
        begin = time.process_time()
        motion = simulate(arm, model, scenario, dynamics=dynamics, noise=False, duration_s=duration, **tolerance)
        return time.process_time() - begin, motion

    _, compiled = run(Counted)
    spent: dict[type[SpatialDynamics], list[float]] = {SpatialDynamics: [], Multibody: []}
    for _ in range(turns):
        for law, seconds in spent.items():
            seconds.append(run(law)[0])
    old, new = min(spent[SpatialDynamics]), min(spent[Multibody])
    error = far(compiled, run(SpatialDynamics, **TIGHT)[1])
    periods = len(compiled.t)
    return Cost(name, arm.n, PERIOD_S, duration, calls / periods, old / duration, new / duration, old / new, error)


def main(path: str | None) -> None:
    """Measure all cases and print a table."""
    found = []
    with progress() as bar:
        task = bar.add_task("simulating", total=len(CASES))
        for name in CASES:
            found.append(measure(name))
            bar.advance(task)
    rows = [
        (
            one.name,
            str(one.joints),
            number(one.evaluations, 3),
            number(one.numpy_s, 3),
            number(one.compiled_s, 3),
            number(one.ratio, 3),
            number(one.error, 1),
        )
        for one in found
    ]
    table(("arm", "joints", "evaluations a period", "numpy", "compiled", "ratio", "error"), rows)
    say(f"CPU seconds a simulated second at {1 / PERIOD_S:.0f} Hz; error as a share of each signal's size")
    if path:
        write_json(path, {"cases": [asdict(one) for one in found]})


if __name__ == "__main__":
    with errors_end_the_program():
        main(sys.argv[1] if len(sys.argv) > 1 else None)

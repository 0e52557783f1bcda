# SPDX-License-Identifier: MIT
"""The dynamics of a flexible-joint space arm, learned from its CAN frames: the Python interface.

    import zygos

    folder = zygos.example("paper")
    arm, model = zygos.load_arm(folder / "arm.toml"), zygos.load_model(folder / "model.toml")
    run = zygos.simulate(arm, model, zygos.load_scenario(folder / "scenario.toml"), seed=1)
    found = zygos.estimate(run)
    print(found)

Files       load_arm save_arm load_model save_model load_run save_run load_scenario example write_example
Runs        Run make_run simulate simulate_with_truth
Questions   estimate refine estimate_ground payload check check_arm explain predict bound
Answers     Estimation Refinement GroundEstimate Payload Score Check ArmCheck Explanation Prediction Bound write_report
Errors      ZygosError Undecided

docs/python.md has each of them with an example. Quantities are in SI units; arrays are numpy's. What is listed here is
the interface; the sub-packages behind it may change from version to version.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zygos.arm import Arm, load_arm, save_arm
    from zygos.audit.check import ArmCheck, check_arm
    from zygos.can.run import Run, load_run, make_run, save_run
    from zygos.effects import Effect, effect
    from zygos.errors import Undecided, ZygosError
    from zygos.estimation.estimate import Estimation, estimate
    from zygos.files.examples import example, write_example
    from zygos.gap.explanation import Explanation
    from zygos.gap.predict import Prediction, predict
    from zygos.ground.estimate import GroundEstimate, estimate_ground
    from zygos.ground.payload import Payload, payload
    from zygos.ground.score import Score
    from zygos.model.model import Model, Quantity, load_model, save_model
    from zygos.reference.check import Check, check
    from zygos.refinement.bound import Bound, bound
    from zygos.refinement.refine import Refinement
    from zygos.refinement.refine import refine_runs as refine
    from zygos.reports import write_report
    from zygos.runs.cycles import Cycles
    from zygos.simulation.run import Simulation, simulate, simulate_with_truth
    from zygos.simulation.scenario import Scenario, load_scenario
    from zygos.simulators.explain import explain as explain

    __version__: str

_HOMES = {
    "Arm": "arm",
    "ArmCheck": "audit.check",
    "Bound": "refinement.bound",
    "Check": "reference.check",
    "Cycles": "runs.cycles",
    "Effect": "effects",
    "Estimation": "estimation.estimate",
    "Explanation": "gap.explain",
    "GroundEstimate": "ground.estimate",
    "Model": "model.model",
    "Payload": "ground.payload",
    "Prediction": "gap.predict",
    "Quantity": "model.model",
    "Refinement": "refinement.refine",
    "Run": "can.run",
    "Scenario": "simulation.scenario",
    "Score": "ground.score",
    "Simulation": "simulation.run",
    "Undecided": "errors",
    "ZygosError": "errors",
    "bound": "refinement.bound",
    "check": "reference.check",
    "check_arm": "audit.check",
    "effect": "effects",
    "estimate": "estimation.estimate",
    "estimate_ground": "ground.estimate",
    "example": "files.examples",
    "explain": "simulators.explain:explain",
    "load_arm": "arm",
    "load_model": "model.model",
    "load_run": "can.run",
    "load_scenario": "simulation.scenario",
    "make_run": "can.run",
    "payload": "ground.payload",
    "predict": "gap.predict",
    "refine": "refinement.refine:refine_runs",
    "save_arm": "arm",
    "save_model": "model.model",
    "save_run": "can.run",
    "simulate": "simulation.run",
    "simulate_with_truth": "simulation.run",
    "write_example": "files.examples",
    "write_report": "reports",
}
"""Where each name is written. It is loaded when it is first used: the command line must not wait for scipy."""

__all__ = [
    "Arm",
    "ArmCheck",
    "Bound",
    "Check",
    "Cycles",
    "Effect",
    "Estimation",
    "Explanation",
    "GroundEstimate",
    "Model",
    "Payload",
    "Prediction",
    "Quantity",
    "Refinement",
    "Run",
    "Scenario",
    "Score",
    "Simulation",
    "Undecided",
    "ZygosError",
    "__version__",
    "bound",
    "check",
    "check_arm",
    "effect",
    "estimate",
    "estimate_ground",
    "example",
    "explain",
    "load_arm",
    "load_model",
    "load_run",
    "load_scenario",
    "make_run",
    "payload",
    "predict",
    "refine",
    "save_arm",
    "save_model",
    "save_run",
    "simulate",
    "simulate_with_truth",
    "write_example",
    "write_report",
]


if not TYPE_CHECKING:  # else every misspelled name would have a type

    def __getattr__(name: str) -> object:
        """A name of the interface, loaded when it is first used."""
        if name == "__version__":
            found = import_module("importlib.metadata").version("zygos")
        elif name in _HOMES:
            home, _, inside = _HOMES[name].partition(":")
            found = getattr(import_module(f"zygos.{home}"), inside or name)
        else:
            raise AttributeError(f"module 'zygos' has no attribute {name!r}")
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    """The interface."""
    return list(__all__)

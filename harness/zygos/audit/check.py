# SPDX-License-Identifier: MIT
"""A run compared with the description of its own arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from zygos.audit.auditor import audit
from zygos.audit.findings import Audit, Signal, SignalFault
from zygos.audit.sections import as_json
from zygos.audit.traffic import traffic_of
from zygos.audit.weights import beside_masses, weights
from zygos.can.run import Run
from zygos.model.model import Model


@dataclass(frozen=True, eq=False, repr=False)
class ArmCheck:
    """Whether a run agrees with the description of its arm."""

    run: Run
    audit: Audit
    """Everything that was found, with the measured properties of each signal."""

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong, and the sign and the place of every signal are confirmed."""
        return self.audit.ok

    @property
    def findings(self) -> tuple[SignalFault, ...]:
        """What is wrong: signal, fault, evidence and remedy of each finding."""
        return self.audit.findings

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Range, step, noise and verdict of each signal."""
        return self.audit.signals

    @property
    def notes(self) -> tuple[str, ...]:
        """What could not be decided, and why."""
        return self.audit.notes

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was found and is no fault."""
        return self.audit.remarks

    def as_dict(self) -> dict[str, Any]:
        """The result in numbers, texts, lists and dictionaries, as `zygos check-arm --json` writes it."""
        return {"arm": self.run.arm.name, "ok": self.ok, "faults": self.run.faults, **as_json(self.audit)}

    def __repr__(self) -> str:
        """A line for each signal and for each finding."""
        lines = [f"{signal.name:<26}{signal.verdict}" for signal in self.signals]
        lines += [f"{f.signal}: {f.fault} ({f.evidence}); remedy: {f.remedy}" for f in self.findings]
        return "\n".join(lines)


def check_arm(
    run: Run, *, simulation: Model | None = None, progress: Callable[[float], None] | None = None
) -> ArmCheck:
    """Check whether a run agrees with the description of its arm: finds signals that are swapped, inverted, scaled,
    stuck or skewed, and gives the numbers that show it. No model is needed.

    simulation: a model given by bodies, whose masses say how large the torques of an arm on the ground have to be.
    progress is called now and then with the share that is done. Errors: ZygosError if the run has another number of
    joints than its arm; with a simulation, as `zygos.audit.weights.weights`.
    """
    weighed = None if simulation is None else weights(run, simulation)
    traffic = None if run.frames is None else traffic_of(run.arm, run.frames)
    found = audit(run.arm, run.cycles, traffic, progress)
    return ArmCheck(run, found if weighed is None else beside_masses(run, found, weighed))

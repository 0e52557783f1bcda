# SPDX-License-Identifier: MIT
"""A run through the C library and through numpy, and both compared stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from zygos.can.run import Run
from zygos.effects import Effect
from zygos.estimation.remedies import remedy
from zygos.native.flight import Flight
from zygos.reference.compare import Room, check_cycles, check_frames


@dataclass(frozen=True, eq=False, repr=False)
class Check:
    """The comparison of all stages, from the wire to the solution."""

    run: Run
    flight: Flight
    """The C library after the run."""
    stages: tuple[Room, ...]
    """One comparison each: name, numbers compared, largest difference, its cycle, the tolerance, and whether it is
    kept. A run without frames has no stages of the wire."""

    @property
    def equal(self) -> bool:
        """Whether every stage is equal within its tolerance."""
        return all(stage.equal for stage in self.stages)

    @property
    def solved(self) -> bool:
        """Whether the run determines a solution that could be compared."""
        return self.stages[-1].name == "solution"

    @property
    def unsolved(self) -> str:
        """Why there is no solution to compare, and what to do; empty where there is one."""
        return "" if self.solved else "; remedy: ".join(self._unsolved())

    @property
    def undecided(self) -> tuple[str, str] | None:
        """What differs or is missing, and the remedy; None where all stages are equal."""
        failed = [stage.name for stage in self.stages if not stage.equal]
        if failed:
            return f"C and numpy differ in: {', '.join(failed)}", "report this run as a defect of zygos"
        return None if self.solved else self._unsolved()

    def _unsolved(self) -> tuple[str, str]:
        result = self.flight.estimate()
        return f"no solution to compare, {result.validity}: {result.reason}", remedy(result, self.flight)

    def as_dict(self) -> dict[str, Any]:
        """All of it in numbers, texts, lists and dictionaries: as `zygos self-test --json` has it."""
        return {"arm": self.flight.arm.name, "rooms": [stage.as_json() for stage in self.stages]}

    def __repr__(self) -> str:
        """A line for each stage."""
        return "\n".join(
            f"{stage.name:<26}{stage.difference:>9.2g} of {stage.tolerance:<9.2g}"
            f"{'equal' if stage.equal else 'differs'}"
            for stage in self.stages
        )


def check(run: Run, *, effects: Sequence[Effect] = ()) -> Check:
    """Compare the C library with numpy on a run, stage by stage. The two sides share no code.

    effects: also compare their columns. A run that determines no solution is no error: see `Check.solved`.

    Errors: ZygosError where an effect does not fit the arm, or the library refuses the arm.
    """
    flight = Flight(run.arm, effects)
    if run.frames is None:
        return Check(run, flight, tuple(check_cycles(run.arm, run.cycles, flight)))
    return Check(run, flight, tuple(check_frames(run.arm, run.frames, flight)))

# SPDX-License-Identifier: MIT
"""Planning a motion, and ranking motions, for any arm: with rows of its joints on the ground, else by simulation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm, Joint
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Model
from zygos.plan.expected import Expectation, expected_on_ground, scenario_of
from zygos.plan.limits import Limits
from zygos.plan.rows import Grounded
from zygos.plan.search import search
from zygos.plan.simulated import By, expected_by_simulation, search_by_simulation
from zygos.refinement.bound import bounded
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Motion:
    """What is sought: periodic motions of so many harmonics, repeated until the run ends."""

    period_s: float = 10.0
    harmonics: int = 5
    duration_s: float | None = None
    """Whole periods on the ground; None: two periods there, the duration of the given scenario otherwise."""
    seed: int = 0
    """Of the random motions with which the search begins."""
    simulated: int = 24
    """Number of motions that are simulated, where the arm floats or has springs."""


class Planner:
    """Expectations and searches for an arm with its model."""

    def __init__(self, arm: Arm, model: Model, limits: Limits, torque_sigma: Floats, by: By = "energy") -> None:
        """torque_sigma: (N,) standard deviation of the reported torques, Nm. by: whether motions are ranked by what the
        estimate will tell, or by what their frames tell at most. Errors: as `Grounded`, and ZygosError if the model
        does not fit the arm, or if the bound is asked for and arm or model have none."""
        self.arm, self.limits = replace(arm, joints=_noisy(arm, torque_sigma)), limits
        self.model, self.by = model, by
        model.base_parameters(arm)
        if by == "bound":
            try:
                bounded(self.arm, model)
            except ZygosError as error:
                raise ZygosError(f"{error}, or leave out --by bound") from error
        self.grounded = Grounded(arm, model, torque_sigma) if arm.grounded else None

    def expected(self, scenario: Scenario, progress: Progress = lambda share: None) -> Expectation:
        """What one run of a scenario tells. Errors: ZygosError if it does not fit the arm."""
        if self.grounded is not None:
            return expected_on_ground(self.grounded, scenario, self.limits, progress)
        return expected_by_simulation(self.arm, self.model, scenario, self.limits, progress, by=self.by)

    def plan(
        self,
        name: str,
        sought: Motion,
        arm_file: Path,
        model_file: Path,
        template: Scenario | None,
        progress: Progress = lambda share: None,
    ) -> tuple[Scenario, Expectation]:
        """A motion that tells much, as a scenario of that name, and what it tells.

        template: on the ground not used; otherwise all but the desired angles is taken from it. Limits of angles and
        rates that are not given are assumed. Errors: ZygosError if no motion within the limits is found, if the run
        would not end at rest, or if a template is needed and missing.
        """
        if self.grounded is not None:
            duration = 2.0 * sought.period_s if sought.duration_s is None else sought.duration_s
            repeats = duration / sought.period_s
            if abs(repeats - round(repeats)) > 1e-9 or round(repeats) < 1:
                raise ZygosError(
                    f"{duration:g} s are not a whole number of periods of {sought.period_s:g} s, so that the motion "
                    "would not end at rest; remedy: give a multiple of --period as --duration"
                )
            found = search(
                self.grounded,
                self.limits.assumed,
                sought.period_s,
                sought.harmonics,
                seed=sought.seed,
                progress=progress,
            )
            scenario = scenario_of(self.grounded, found.motion, name, arm_file, model_file, duration, sought.seed)
            return scenario, self.expected(scenario)
        if template is None:
            raise ZygosError(
                f"arm {self.arm.name} floats or has springs, and how well it follows a motion depends on its servo; "
                "remedy: give a scenario whose controller and angular momentum are kept"
            )
        template = replace(template, name=name, arm=arm_file, plant=model_file)
        if sought.duration_s is not None:
            template = replace(template, duration_s=sought.duration_s)
        chosen = search_by_simulation(
            self.arm,
            self.model,
            template,
            self.limits.assumed,
            sought.period_s,
            sought.harmonics,
            seed=sought.seed,
            count=sought.simulated,
            by=self.by,
            progress=progress,
        )
        return chosen.scenario, chosen.expectation


def ranked(expectations: Sequence[Expectation]) -> list[Expectation]:
    """The motion that tells most first; then those that leave something open, and those that exceed a limit last.

    Errors: ZygosError if all exceed a limit; Undecided if all others leave something open.
    """
    order = sorted(expectations, key=lambda one: (one.excess is not None, one.measure))
    if order[0].open and not order[0].excess:
        raise Undecided(
            f"motion {order[0].name}: {order[0].open}; remedy: a motion that moves all joints, or a longer duration_s"
        )
    if order[0].excess:
        raise ZygosError(
            f"motion {order[0].name}: {order[0].excess}; remedy: a smaller motion, or the right limits (--angle, "
            "--rate, --torque)"
        )
    return order


def _noisy(arm: Arm, torque_sigma: Floats) -> tuple[Joint, ...]:
    return tuple(
        replace(joint, torque_sigma=float(sigma)) for joint, sigma in zip(arm.joints, torque_sigma, strict=True)
    )

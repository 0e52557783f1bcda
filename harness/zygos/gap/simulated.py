# SPDX-License-Identifier: MIT
"""The model of another simulator, estimated from a run that it made from the torques of a measured run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import TORQUE_STEP
from zygos.can.run import Run
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import Estimation, estimate
from zygos.ground.estimate import GroundEstimate, estimate_ground
from zygos.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """Where the values of a simulation come from that is known by a run alone."""

    run: Path | None
    torques_of: Path | None
    """The measured run whose torques acted in it."""

    @property
    def sentence(self) -> str:
        """The same in words."""
        run = self.run.name if self.run else "its run"
        of = self.torques_of.name if self.torques_of else "a measured run"
        return (
            f"the values of the simulation are estimated from {run}, which it made from the torques of {of}; an effect "
            "that this run does not show is taken as missing in the simulation"
        )


def model_of_simulator(run: Run, measured: Sequence[Run]) -> tuple[Model, Simulated]:
    """The model of the simulator that made a run, by the estimator that learns an arm from its runs.

    measured: runs of the real arm, of one of which it has the torques. Effects that its run does not show are left out.

    Errors: ZygosError where no measured run has these torques, or it is one of them; Undecided where the run does not
    tell the parameters apart, or the equations of the arm file are not those of the simulator.
    """
    name = run.path.name if run.path else "the simulated run"
    like = next((one for one in measured if _same_torques(run, one)), None)
    if like is None:
        raise ZygosError(
            f"{name}: its torques are those of none of the measured runs, so that it says nothing of the gap; remedy: "
            "simulate with the torques that a measured run recorded, cycle by cycle, or give the simulator's "
            "model.toml"
        )
    unsettled = f"{name}: the simulator's run does not tell its parameters apart"
    found: GroundEstimate | Estimation
    try:
        if run.arm.grounded:
            found = estimate_ground([run])
            # residuals of exact sensors are those of the integration, and no noise
            settled = found.validity == "valid" or (found.validity == "partial" and bool(found.determined.all()))
        else:
            found = estimate(run)
            settled = found.validity == "valid"
    except Undecided as error:
        raise Undecided(f"{unsettled}: {error}") from error
    if not settled:
        raise Undecided(
            f"{unsettled}: {found.reason or found.validity}; remedy: "
            f"{found.remedy or 'simulate a run that moves every joint'}"
        )
    model = found.to_model()
    shown = tuple(one for one in model.effects if abs(one.value) > limits.SHOWN_Z.value * one.sigma)
    return replace(model, name=f"the simulator of {name}", effects=shown), Simulated(run.path, like.path)


def _same_torques(run: Run, other: Run) -> bool:
    """Whether the torques of a simulated run are those of a measured one, cycle by cycle from its start."""
    one, two = run.cycles, other.cycles
    if len(one.sync) == 0 or len(two.sync) == 0:
        return False
    first, second = (cycles.sync.astype(np.int64) - int(cycles.sync[0]) for cycles in (one, two))
    _, at, there = np.intersect1d(first, second, return_indices=True)
    if len(at) < limits.COMMON.value * len(one.sync):
        return False
    # a log rounds torques
    apart = np.abs(one.tau[at] - two.tau[there])
    return bool(np.all((apart <= TORQUE_STEP) | ~np.isfinite(apart)))

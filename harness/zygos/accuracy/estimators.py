# SPDX-License-Identifier: MIT
"""The estimators that are compared, in a table with one entry each.

Every estimator gets the arm file, the CAN frames of a run, and the prior knowledge; none gets a true parameter value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.errors import Undecided, ZygosError
from zygos.native.flight import Flight
from zygos.paper.methods import Record, amc, de, eb, record_of
from zygos.refinement.refine import refine_runs
from zygos.runs.samples import calibrate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """Knowledge of an estimator besides arm file and frames."""

    momentum_nms: float | tuple[float, float, float]
    """Angular momentum of the arm, as the scenario sets it."""
    rest_s: float = 0.0
    """Time for which the arm is at rest at the start, s."""


@dataclass(frozen=True)
class EstimatorResult:
    """The answer of an estimator for one run; p parameters."""

    validity: str
    reason: str = ""
    value: Floats | None = None
    """(p,) values, NaN where a parameter has none; None if the whole estimate is refused."""
    half95: Floats | None = None
    """(p,) half widths of the 95 % intervals; None for an estimator that gives none."""
    sigma: Floats | None = None
    """(p,) standard deviations; None for an estimator that gives none."""
    solution: Floats | None = None
    """(p,) solution for all parameters, which is meaningful only as a whole; None if there is none."""


EstimateFunction = Callable[[Arm, NDArray[Any], Prior], EstimatorResult]


@dataclass(frozen=True)
class Estimator:
    """An entry of the table."""

    name: str
    description: str
    estimate: EstimateFunction
    ours: bool
    """Whether it works for every arm and gives intervals; the paper's methods are planar and give none."""
    redrawn: bool = False
    """Whether it is applied to every draw of sensor noise, which gives the coverage of its intervals."""
    planar: bool = False
    """Whether it is only applied to planar arms, because it costs much."""
    seeds: int | None = None
    """It is only applied to so many seeds, the first ones; None: to all."""

    def fits(self, arm: Arm) -> bool:
        """Whether it can be applied to this arm."""
        return not (self.planar and arm.spatial) and (self.ours or (arm.free and not arm.spatial))

    def takes(self, seed: int, draw: int) -> bool:
        """Whether it is applied to these sensor errors."""
        return (draw == 0 or self.redrawn) and (self.seeds is None or seed < self.seeds)


def flight(arm: Arm, frames: NDArray[Any], _: Prior) -> EstimatorResult:
    """The C library, fed with CAN frames."""
    chain = Flight(arm)
    chain.frames(frames)
    found = chain.estimate()
    if found.validity == "refused":
        return EstimatorResult(found.validity, found.reason)
    own = len(arm.parameter_names)  # the effects come after these
    return EstimatorResult(
        found.validity, found.reason, found.value[:own], found.half95[:own], found.sigma[:own], found.solution[:own]
    )


def refined(arm: Arm, frames: NDArray[Any], _: Prior) -> EstimatorResult:
    """The filter of `zygos refine`, with its rules: what it does not publish is refused."""
    trace = Flight(arm).frames(frames, trace=True)
    assert trace is not None
    try:
        found = refine_runs(Run.of_cycles(arm, trace.cycles))
    except ZygosError as error:
        return EstimatorResult("refused", str(error).partition(";")[0])
    if not found.published:
        names = ", ".join(rule.key for rule in found.rules if not rule.holds)
        return EstimatorResult("refused", f"rules that failed: {names}")
    return EstimatorResult("valid", "", found.value, found.half95, found.sigma, found.value)


def _with(**settings: Any) -> EstimateFunction:
    """The C library with other settings of the arm file."""
    return lambda arm, frames, prior: flight(replace(arm, **settings), frames, prior)


def _batch(method: Callable[[Arm, Record, Prior], Floats]) -> EstimateFunction:
    """A method of the paper, applied to the cycles that the receiver completed before the first missing one."""

    def estimate(arm: Arm, frames: NDArray[Any], prior: Prior) -> EstimatorResult:
        trace = Flight(arm).frames(frames, trace=True)
        assert trace is not None
        try:
            return EstimatorResult("valid", value=method(arm, record_of(arm, calibrate(arm, trace.cycles)), prior)[0])
        except Undecided:
            return EstimatorResult("refused", "the unbroken record does not determine the parameters")
        except ZygosError as error:
            return EstimatorResult("refused", str(error))

    return estimate


def _amc(arm: Arm, record: Record, prior: Prior) -> Floats:
    assert isinstance(prior.momentum_nms, float)
    return amc.estimate(arm, record, momentum_nms=prior.momentum_nms)


ESTIMATORS: tuple[Estimator, ...] = (
    Estimator(
        "DE", "equations of motion, second differences (the paper)", _batch(lambda a, r, _: de.estimate(a, r)), False
    ),
    Estimator("AMC", "angular momentum, known to be h (the paper)", _batch(_amc), False),
    Estimator(
        "EB", "energy balance, backward differences (the paper)", _batch(lambda a, r, _: eb.estimate(a, r)), False
    ),
    Estimator(
        "flight, plain",
        "the C library, from CAN frames: energy rows, without noise compensation",
        _with(compensate_every=0, impulse_arc_s=0.0),
        True,
    ),
    Estimator(
        "flight, energy",
        "the C library, from CAN frames: energy rows, with noise compensation",
        _with(impulse_arc_s=0.0),
        True,
    ),
    Estimator("flight", "the C library, from CAN frames, with default settings", flight, True, True),
    Estimator("refined", "from CAN frames, where zygos estimate refines", refined, True, planar=True, seeds=10),
)

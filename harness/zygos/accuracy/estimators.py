"""The estimators that are compared: one table, one entry each.

Every estimator is given the arm file and the CAN frames of a run, and what else it is told; none sees a true value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import Undecided, ZygosError
from zygos.native.flight import Flight
from zygos.paper.methods import Record, amc, de, eb, record_of
from zygos.runs.samples import calibrate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Told:
    """What an estimator knows beside arm file and frames."""

    momentum_nms: float | tuple[float, float, float]
    """Angular momentum of the arm, as the scenario sets it."""
    rest_s: float = 0.0
    """How long the arm rests at the start."""


@dataclass(frozen=True)
class EstimatorResult:
    """What an estimator says of one run; p parameters."""

    validity: str
    reason: str = ""
    value: Floats | None = None
    """(p,) NaN where nothing is published; None where the whole is refused."""
    half95: Floats | None = None
    """(p,) half widths of the 95 % intervals; None of an estimator that gives none."""
    sigma: Floats | None = None
    """(p,) likewise."""
    solution: Floats | None = None
    """(p,) numbers for all parameters, of which only the whole means something; None where there are none."""


EstimateFunction = Callable[[Arm, NDArray[Any], Told], EstimatorResult]


@dataclass(frozen=True)
class Estimator:
    """An entry of the table."""

    name: str
    said: str
    estimate: EstimateFunction
    ours: bool
    """Works for every arm and gives intervals; the paper's methods are for the plane and give none."""
    redrawn: bool = False
    """Whether it is asked about every draw of sensor noise, so that the coverage of its intervals is known."""

    def fits(self, arm: Arm) -> bool:
        """Whether it can be asked about this arm."""
        return self.ours or (arm.free and not arm.spatial)


def flight(arm: Arm, frames: NDArray[Any], _: Told) -> EstimatorResult:
    """The C library over its CAN door."""
    chain = Flight(arm)
    chain.frames(frames)
    found = chain.estimate()
    if found.validity == "refused":
        return EstimatorResult(found.validity, found.reason)
    own = len(arm.parameter_names)  # effects follow
    return EstimatorResult(
        found.validity, found.reason, found.value[:own], found.half95[:own], found.sigma[:own], found.solution[:own]
    )


def _with(**settings: Any) -> EstimateFunction:
    """The C library with other settings of the arm file."""
    return lambda arm, frames, told: flight(replace(arm, **settings), frames, told)


def _batch(method: Callable[[Arm, Record, Told], Floats]) -> EstimateFunction:
    """A method of the paper on the cycles that the receiver completed, up to the first that is missing."""

    def estimate(arm: Arm, frames: NDArray[Any], told: Told) -> EstimatorResult:
        trace = Flight(arm).frames(frames, trace=True)
        assert trace is not None
        try:
            return EstimatorResult("valid", value=method(arm, record_of(arm, calibrate(arm, trace.cycles)), told)[0])
        except Undecided:
            return EstimatorResult("refused", "the unbroken record does not determine the parameters")
        except ZygosError as error:
            return EstimatorResult("refused", str(error))

    return estimate


def _amc(arm: Arm, record: Record, told: Told) -> Floats:
    assert isinstance(told.momentum_nms, float)
    return amc.estimate(arm, record, momentum_nms=told.momentum_nms)


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
        "the C library, from CAN frames: energy rows, the noise in them left as it is",
        _with(compensate_every=0, impulse_arc_s=0.0),
        True,
    ),
    Estimator(
        "flight, energy",
        "the C library, from CAN frames: energy rows, the noise taken off",
        _with(impulse_arc_s=0.0),
        True,
    ),
    Estimator("flight", "the C library, from CAN frames, as it comes", flight, True, True),
)

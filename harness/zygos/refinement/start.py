# SPDX-License-Identifier: MIT
"""What the solutions begin with: the estimate from energy rows, and a model where these determine nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.effects import GAIN, Effect
from zygos.errors import Undecided
from zygos.estimation.estimate import Estimation
from zygos.model.model import Model
from zygos.refinement.follow import Start
from zygos.refinement.motion import FlexibleMotion
from zygos.refinement.record import Record
from zygos.refinement.rivals import EXPECTED, typical_torque

Floats = NDArray[np.float64]

LEARNED = ("motor_coulomb", "torque_offset", GAIN)
"""Effects that are estimated as constants beside the parameters, in the order of `Start.beside`."""
_ADDED = 0.005
"""What is added to the standard deviations of the energy estimate at the start, in units of the sizes."""
_WIDER = 2.0
"""Standard deviations at the start, as a multiple of those of the energy estimate."""
_ASSUMED = 0.01
"""Standard deviation of values that come from a model which states none, in units of the sizes."""


def begin(
    arm: Arm, energy: Estimation, model: Model | None, effects: Sequence[Effect], record: Record
) -> tuple[Start, Floats, Floats]:
    """The start, the covariance (p, p) within which a solution stays around the parameters that it begins with, SI
    units, and the deviations (5N,) of the constants beside them; 0: known.

    Errors: Undecided where the record is too short, or energy rows determine too little.
    """
    if not record.pieces:
        raise Undecided(
            "the runs have no unbroken piece of 20 cycles; remedy: record again, and look at the faults with "
            "`zygos estimate`"
        )
    if energy.validity == "refused":
        raise Undecided(f"energy rows give no start: {energy.reason}; remedy: {energy.remedy}")
    p = len(arm.parameters)
    value = energy.value[:p].copy()
    missing = ~np.isfinite(value)
    if missing.any() and model is None:
        names = ", ".join(name for name, one in zip(arm.parameter_names, missing, strict=True) if one)
        raise Undecided(
            f"energy rows determine no value of {names}, from which a refinement could start; remedy: give values with "
            "--model, or record a motion that moves all joints"
        )
    covariance = np.where(np.isfinite(energy.covariance[:p, :p]), energy.covariance[:p, :p], 0.0)
    given = {} if model is None else model.base_parameters(arm)
    if missing.any():
        value = np.where(missing, [one.value for one in given.values()], value)
        covariance[missing] = covariance[:, missing] = 0.0
    size = FlexibleMotion(arm, value).size
    scaled = covariance / np.outer(size, size)
    # what energy rows say of the covariance need not be positive definite
    scaled = _WIDER**2 * within(scaled, math.inf) + _ADDED**2 * np.eye(p)
    if missing.any():
        own = np.array([one.sigma for one in given.values()]) / size
        scaled += np.diag(np.where(missing, np.where(own > 0.0, own, _ASSUMED) ** 2, 0.0))
    typical = typical_torque(record)
    known = [joint.link_encoder for joint in arm.joints] + [joint.motor_encoder for joint in arm.joints]
    beside, sigma = np.zeros((3, arm.n)), np.zeros((3, arm.n))
    spread_of_gains = np.sqrt(np.diag(arm.relative_gain_covariance))
    for one in effects:
        kind, joint = LEARNED.index(one.kind.key), one.index(arm)
        place = energy.names.index(one.column(arm))
        found, spread = float(energy.value[place]), float(energy.sigma[place])
        least = EXPECTED * float(typical[joint])
        known_well = math.isfinite(found + spread)
        beside[kind, joint] = found if known_well else 0.0
        if one.kind.gain:
            sigma[kind, joint] = spread_of_gains[arm.relative_gains.index(joint)]
        else:
            sigma[kind, joint] = math.hypot(_WIDER * spread, least) if known_well else least
    zeros = np.array([one.zero_uncertainty_rad for one in known])
    return (
        Start(value, np.concatenate([beside.ravel(), np.zeros_like(zeros)])),
        within(scaled, limits.START_MOST.value) * np.outer(size, size),
        np.concatenate([sigma.ravel(), zeros]),
    )


def within(covariance: Floats, most: float) -> Floats:
    """The covariance (p, p) with standard deviations from 0 to `most` along its principal axes."""
    weights, axes = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((axes * np.clip(weights, 0.0, most**2)) @ axes.T, dtype=np.float64)

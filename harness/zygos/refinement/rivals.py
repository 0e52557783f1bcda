# SPDX-License-Identifier: MIT
"""Tests of a fit against models that have one thing more.

The torques are taken as they are reported. If the readings are followed better once all torques are delayed a little,
once those of one joint are a little larger, or once there is friction or an offset, then the model of the fit lacks
something, and its values have errors that their deviations do not show. How far each of these moves the innovations is
known, so that the fall of the deviance, which is the square of a number of standard deviations, follows from the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.refinement.follow import Pass, Prior
from zygos.refinement.record import Record

Floats = NDArray[np.float64]

EXPECTED = 0.003
"""Standard deviation of friction and offsets before the first reading, as a share of the typical torque. Much more
leads the solution out of the range in which the motion is linear."""


@dataclass(frozen=True)
class Rival:
    """A model with one thing more."""

    title: str
    """What it has, in words."""
    value: float
    """Its estimate, as far as the motion is linear."""
    unit: str
    sigmas: float
    """By how many standard deviations the readings favour it."""


def rivals(arm: Arm, found: Pass, prior: Prior) -> tuple[Rival, ...]:
    """Each rival of a solution; what it has solved for is none."""
    p, n = len(found.value), arm.n
    delay, gain = p + 5 * n, p + 2 * n
    listed = [(delay, "a delay of the torques", "ms", 1e3 * arm.period_s)]
    # nobody can tell the gain of all joints together
    listed += [(gain + k, f"a larger torque of {arm.joints[k].name}", "%", 100.0) for k in range(1, n)]
    listed += [(p + k, f"Coulomb friction of the motor of {arm.joints[k].name}", "Nm", 1.0) for k in range(n)]
    listed += [(p + n + k, f"an offset of the torque of {arm.joints[k].name}", "Nm", 1.0) for k in range(n)]
    answers = []
    for place, title, unit, factor in listed:
        if place in prior.solved:
            continue
        # its own row of the triangle: what no other constant explains
        size, left = prior.beside(found.triangle, [place])[-2, -2:]
        if size != 0.0:
            answers.append(Rival(title, float(-left / size * prior.unit[place] * factor), unit, abs(float(left))))
    return tuple(answers)


def typical_torque(record: Record) -> Floats:
    """(N,) root mean square of the torques of a record, Nm before the gear."""
    torque = np.concatenate([piece.tau for piece in record.pieces])
    return np.asarray(np.sqrt(np.mean(torque**2, axis=0)), dtype=np.float64)

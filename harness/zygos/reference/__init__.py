# SPDX-License-Identifier: MIT
"""The numpy reference: one stage for each stage of the flight library, for whole records and in matrix form.

It computes the same results as the C library by different methods (convolution instead of ring buffers, design matrices
instead of accumulators, orthogonal least squares instead of normal equations), so that their agreement is evidence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from zygos.arm import Arm
from zygos.balances.energy import EnergyRows, energy_rows
from zygos.balances.momentum import turns
from zygos.effects import Effect, with_gains
from zygos.reference.accumulator import Design, design
from zygos.reference.combination import combine, motors
from zygos.reference.joints import groups
from zygos.reference.noise import noise_of
from zygos.reference.solver import Solution
from zygos.runs.cycles import Cycles
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth

__all__ = [
    "ReferenceStages",
    "calibrate",
    "chain",
    "combine",
    "design",
    "energy_rows",
    "groups",
    "motors",
    "noise_of",
    "smooth",
    "turns",
]


@dataclass(frozen=True)
class ReferenceStages:
    """The results of every stage for a record, for a comparison stage by stage."""

    samples: Samples
    smoothed: Smoothed
    balance: EnergyRows
    design: Design
    solution: Solution


def chain(
    arm: Arm, cycles: Cycles, effects: Sequence[Effect] = (), waited: Mapping[str, frozenset[int]] | None = None
) -> ReferenceStages:
    """Apply all stages to a record, with a column for each of a model's effects that has one in the balance.

    waited: as of `Samples`: what the library made no row of, because an arc waited for its end (`Trace.waited`). Here
    arcs close at once.

    Gains of torque sensors are held at 0, because their prior needs blocks (`zygos.reference.gains`).

    Raises ZygosError for input that does not fit the arm, Undecided for a record that does not determine the
    parameters.
    """
    samples = replace(calibrate(arm, cycles), waited=waited or {})
    smoothed = smooth(arm, samples)
    effects = with_gains(arm, effects)
    raw = energy_rows(arm, samples, smoothed, effects)
    added = noise_of(arm, samples, smoothed, raw, effects)
    balance = replace(raw, z=raw.z - added.mean)
    accumulated = design(balance, added.moment)
    of_motors, momentum = motors(arm, samples, smoothed, effects), turns(arm, samples, smoothed)
    joints = groups(arm, samples, smoothed, effects)
    solution = combine(arm, accumulated, of_motors, momentum, joints, effects).solution
    return ReferenceStages(samples, smoothed, balance, accumulated, solution)

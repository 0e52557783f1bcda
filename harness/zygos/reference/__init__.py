"""The numpy reference: one room for each room of the flight library, whole-record and in matrix form.

It computes what the C library computes by other means (convolution for rings, design matrices for accumulators,
orthogonal least squares for normal equations), so that an agreement of the two means something.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from zygos.arm import Arm
from zygos.balances.energy import EnergyRows, energy_rows
from zygos.balances.momentum import turns
from zygos.effects import Effect
from zygos.reference.accumulator import Design, design
from zygos.reference.combination import motors, solve_with_others
from zygos.reference.noise import noise_of
from zygos.reference.solver import Solution
from zygos.runs.cycles import Cycles
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth

__all__ = [
    "ReferenceStages",
    "calibrate",
    "chain",
    "design",
    "energy_rows",
    "motors",
    "noise_of",
    "smooth",
    "solve_with_others",
    "turns",
]


@dataclass(frozen=True)
class ReferenceStages:
    """What every room makes of a record, for a comparison room by room."""

    samples: Samples
    smoothed: Smoothed
    balance: EnergyRows
    design: Design
    solution: Solution


def chain(arm: Arm, cycles: Cycles, effects: Sequence[Effect] = ()) -> ReferenceStages:
    """Take a record through all rooms, with columns for those of a model's effects that have one in the balance.

    Raises ZygosError for what does not fit the arm, Undecided for a record that does not determine the parameters.
    """
    samples = calibrate(arm, cycles)
    smoothed = smooth(arm, samples)
    raw = energy_rows(arm, samples, smoothed, effects)
    added = noise_of(arm, samples, smoothed, raw, effects)
    balance = replace(raw, z=raw.z - added.mean)
    accumulated = design(balance, added.moment)
    of_motors, momentum = motors(arm, samples, smoothed, effects), turns(arm, samples, smoothed)
    solution = solve_with_others(arm, accumulated, of_motors, momentum, effects)
    return ReferenceStages(samples, smoothed, balance, accumulated, solution)

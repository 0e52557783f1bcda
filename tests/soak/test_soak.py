# SPDX-License-Identifier: MIT
"""Weeks of flight at an accelerated pace: the sums of every kind of row stay whole, and their blocks alike.

A stored motion of the example is repeated, and the sensors' noise is drawn anew each time. Cycles come in through the
door in SI.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from soak_support import fly, instants, stored, with_all_rows

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native import snapshot
from zygos.native.flight import Estimate, Flight
from zygos.reference.solver import SYSTEMATIC
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

LARGEST = {"energy": 1.0 / 8.0, "motors": 1.0 / 6.0, "momentum": 1.0 / 3.0}
"""Share of the instants in the largest block: twice the target, which doubles only where three quarters of all blocks
hold more than it in pairs, and some more while the oldest arcs are few."""


@pytest.fixture(scope="module")
def floating(arm: Arm) -> Arm:
    """The example's arm with rows of all kinds."""
    return with_all_rows(arm)


@pytest.fixture(scope="module")
def motion(floating: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(floating, model, scenario)


def resumed(flight: Flight, file: Path) -> Flight:
    """The same state from a file, in another struct."""
    snapshot.write(file, "state", flight.native)
    other = Flight(flight.arm)
    snapshot.resume(other, file)
    return other


@dataclass(frozen=True)
class Look:
    """What was seen after so many cycles."""

    cycles: int
    blocks: dict[str, list[float]]
    estimate: Estimate


def soak(arm: Arm, motion: Cycles, looks: list[int], file: Path) -> list[Look]:
    """Look when so many motions have passed, each time through a file."""
    flight, rng, seen = Flight(arm), np.random.default_rng(0), []
    for number in range(looks[-1]):
        fly(flight, motion, 1, rng)
        if number + 1 in looks:
            flight = resumed(flight, file)
            seen.append(Look((number + 1) * len(motion), instants(flight), flight.estimate()))
    return seen


def scatter(arm: Arm, look: Look) -> Floats:
    """Sigmas by the scatter of the blocks alone, (p,): without the floor, which no number of arcs averages out."""
    systematic = max(SYSTEMATIC, 1.0 - 1.0 / look.estimate.noise_ratio)
    arcs = look.estimate.accepted * arm.period_s / arm.arc_max_s
    out: Floats = look.estimate.sigma / np.sqrt(1.0 + systematic * arcs)
    return out


def test_weeks_of_flight(floating: Arm, motion: Cycles, tmp_path: Path) -> None:
    """1e7 cycles, six days at 20 Hz: 8,000 arcs of the energy, 50,000 of the motors and of the momentum."""
    times = -(-(10**7) // len(motion))
    assert times >= 5000
    looks = soak(floating, motion, [times // 16, times // 8, times // 4, times // 2, times], tmp_path / "state.zyg")
    for look in looks:
        print(look.cycles, {kind: (len(part), max(part) / sum(part)) for kind, part in look.blocks.items()})
        assert (look.estimate.validity, look.estimate.reason) == ("valid", "")
        assert look.estimate.accepted > 0.95 * look.cycles
        for kind, part in look.blocks.items():
            assert len(part) >= {"energy": 24, "motors": 16, "momentum": 8}[kind]
            assert max(part) < LARGEST[kind] * sum(part)
            assert sum(part) > 0.95 * look.cycles
    first, last = looks[0], looks[-1]
    ratio = scatter(floating, last) / scatter(floating, first)
    print("sigmas to those of a sixteenth:", np.round(ratio, 2))
    # A spread of some twenty blocks is known to a sixth: a factor of two is three deviations of the quotient. What the
    # noise may hide does not average out, and is in the sigmas too; of the springs it is little.
    springs = [last.estimate.names.index(name) for name in ("k1", "b1", "k2", "b2")]
    assert (ratio > 0.25 / 2.0).all()
    assert (ratio < 1.0).all()
    assert (ratio[springs] < 0.25 * 2.0).all()

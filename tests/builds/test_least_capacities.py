# SPDX-License-Identifier: MIT
"""A build of the least capacities that the manual allows: it answers at any time, and its intervals hold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from build_support import capacities
from flight_support import part
from numpy.typing import NDArray
from soak_support import fly, instants, stored, with_all_rows

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native import flight
from zygos.native.flight import Flight
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario

pytestmark = pytest.mark.slow

Floats = NDArray[np.float64]

LEAST = (
    *("-DZYGOS_MAX_BLOCKS=11", "-DZYGOS_MAX_MOTOR_BLOCKS=4", "-DZYGOS_MAX_MOMENTUM_BLOCKS=4"),
    *("-DZYGOS_MAX_JOINTS=2", "-DZYGOS_SPATIAL=0"),
)
LEAST_BLOCKS, LEAST_ARCS = 6, 3


@pytest.fixture
def small() -> Iterator[None]:
    """The library of these capacities, in place of the one that is loaded."""
    with capacities(*LEAST):
        assert flight.lib.ZYGOS_MAX_BLOCKS_VALUE == 11
        yield


@pytest.mark.usefixtures("small")
def test_it_answers_at_any_time(arm: Arm, noisy: Trajectory) -> None:
    """Every second, once the first few have told enough, and with rows of all kinds."""
    run = Flight(with_all_rows(arm))
    cycles, looks = noisy.cycles(0), 0
    for first in range(0, len(cycles), 20):
        run.cycles(part(cycles, first, first + 20))
        if first < 400:
            continue
        estimate, looks = run.estimate(), looks + 1
        assert (estimate.validity, estimate.reason) == ("valid", "")
        assert estimate.blocks >= LEAST_BLOCKS
        assert np.isfinite(estimate.half95).all()
    assert looks >= 30


@pytest.mark.usefixtures("small")
def test_it_answers_for_hours(arm: Arm, model: Model, scenario: Scenario) -> None:
    floating, rng = with_all_rows(arm), np.random.default_rng(0)
    run, motion = Flight(floating), stored(floating, model, scenario)
    for _ in range(40):
        fly(run, motion, 7, rng)
        blocks = instants(run)
        estimate = run.estimate()
        assert (estimate.validity, estimate.reason) == ("valid", "")
        assert estimate.blocks >= LEAST_BLOCKS  # with those of an arc that is closing
        for kind in ("motors", "momentum"):
            assert len(blocks[kind]) >= LEAST_ARCS
            # of three blocks that hold whole arcs, where the next one begins
            assert max(blocks[kind]) < 0.75 * sum(blocks[kind])
    assert run.native.sums.energy.store.arcs >= 280


def estimated(arm: Arm, runs: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Values and half widths of all runs."""
    found = []
    for frames in runs:
        run = Flight(arm)
        run.frames(frames)
        estimate = run.estimate()
        assert estimate.validity == "valid"
        found.append((estimate.value, estimate.half95))
    values, widths = zip(*found, strict=True)
    return np.stack(values), np.stack(widths)


def test_its_intervals_hold(arm: Arm, noisy: Trajectory, true: Floats) -> None:
    """Seeds 0 .. 49: 95 % of all, give or take three standard errors of fifty runs, or more of them; and the intervals
    are not half as wide again as those of the usual capacities."""
    runs = [flight.encode(arm, noisy.cycles(seed)) for seed in range(50)]
    usual = estimated(arm, runs)[1]
    with capacities(*LEAST):
        values, widths = estimated(arm, runs)
    hits = np.abs(values - true) <= widths
    ratio = np.median(widths / usual, axis=0)
    print("covered", hits.mean(), hits.mean(axis=0), "width to the usual one", np.median(widths / usual), ratio)
    # parameters of one run err together: a run counts once
    assert hits.mean() >= 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 50)
    assert 1.0 < np.median(widths / usual) < 1.5

"""What is dropped is dropped whole: blocks, their checksums and counts, and where the next ones go."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from flight_support import copy_of
from soak_support import fly, settle, stored, with_all_rows

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import Flight, ffi, lib
from zygos.simulation.scenario import Scenario


@pytest.fixture(scope="module")
def flown(arm: Arm, model: Model, scenario: Scenario) -> Flight:
    """A few arcs of every kind; no task is open."""
    out = Flight(with_all_rows(arm))
    fly(out, stored(arm, model, scenario), 2, np.random.default_rng(0))
    settle(out)
    return out


@pytest.fixture
def flight(flown: Flight) -> Flight:
    """A copy that may be changed."""
    return copy_of(flown)


def member(flight: Flight, name: str) -> Any:
    return ffi.addressof(flight.native, name)


def test_before_the_first_cycle_there_is_no_block_of_motor_rows(flight: Flight) -> None:
    sums = member(flight, "motor_sums")
    assert sums.count > 1
    lib.zygos_motor_sums_drop_after(sums, 0)
    assert sums.count == 0 and lib.zygos_motor_sums_check(sums, member(flight, "config")) <= 1.0


def test_without_the_oldest_blocks_the_sums_of_momentum_still_match(flight: Flight) -> None:
    sums = member(flight, "momentum_sums")
    assert sums.count > 2
    newest = sums.block[sums.count - 1].end
    assert lib.zygos_momentum_sums_drop_until(sums, sums.block[0].end) >= 1
    assert lib.zygos_momentum_sums_check(sums) <= 1.0
    assert sums.count >= 1 and sums.block[sums.count - 1].end == newest


def test_open_sums_of_motors_that_do_not_match_are_counted(flight: Flight) -> None:
    sums, config = member(flight, "motor_sums"), member(flight, "config")
    flight.native.motor_sums.open.joint[0].sum[0] += 1.0
    assert sums.quarantined == 0
    assert lib.zygos_motor_sums_scrub(sums, config)
    assert sums.quarantined == 1 and sums.open.instants[0] == pytest.approx(0.0)


def test_a_segment_that_may_hold_a_void_cycle_is_counted() -> None:
    sums = ffi.new("zygos_joint_sums_t *")
    lib.zygos_joint_sums_clear(sums)
    sums.segments, sums.end = 1, 500
    lib.zygos_joint_sums_drop_after(sums, 500)
    assert sums.doubtful == 0
    lib.zygos_joint_sums_drop_after(sums, 499)
    assert sums.doubtful == 1


def test_blocks_that_are_forgotten_have_all_places(flight: Flight) -> None:
    """Two places that are changed at once cannot be told, so that the sums begin anew."""
    sums = flight.native.accumulator
    places = len(sums.block)
    sums.order[3], sums.order[7] = sums.order[7] ^ 1, sums.order[3] ^ 2
    sums.count ^= 5
    assert lib.zygos_restart(flight.native, lib.ZYGOS_KEEP_NOTHING) == 1
    assert sorted(sums.order[k] for k in range(places)) == list(range(places))
    assert flight.native.scrubbed == flight.native.cycle > 0

"""What is dropped is dropped whole: blocks, their checksums and counts, and where the next ones go."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from soak_support import fly, settle, stored, with_all_rows

from zygos.arm import Arm
from zygos.effects import effect
from zygos.model.model import Model
from zygos.native.flight import Flight, ffi, lib
from zygos.simulation.scenario import Scenario

BYTES = 40
"""Of a memory under a checksum: five words."""


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
    out = Flight(flown.arm)
    ffi.memmove(out.native, flown.native, ffi.sizeof("zygos_t"))
    return out


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


@pytest.mark.parametrize("place", ["head", "tail"])
def test_the_queue_has_one_place_more_than_cycles(flight: Flight, place: str) -> None:
    receiver = member(flight, "receiver")
    last = len(receiver.queue.slot) - 1
    setattr(receiver.queue, place, last)
    assert lib.zygos_receiver_intact(receiver)
    setattr(receiver.queue, place, last + 1)
    assert not lib.zygos_receiver_intact(receiver)


@pytest.mark.parametrize("size", range(BYTES - 8, BYTES + 1))
def test_every_byte_is_under_the_checksum(size: int) -> None:
    memory = ffi.new("uint8_t[]", BYTES)
    before = lib.zygos_checksum_memory(1, memory, size)
    for place in range(BYTES):
        memory[place] ^= 4
        assert (lib.zygos_checksum_memory(1, memory, size) != before) == (place < size)
        memory[place] ^= 4


def test_noise_is_taken_from_every_column_however_often_it_is_computed(arm: Arm) -> None:
    """Where it is computed for one signal in each instant, or for all of them."""
    viscous = (effect("motor_viscous", "elbow"),)
    for every in (1, 2, 5):
        noise = Flight(replace(arm, compensate_every=every), viscous).native
        bias = noise.noise.integral_bias
        assert bias.effect[0] > 0.0 and min(bias.dissipation[i] for i in range(arm.n)) > 0.0
    none = Flight(replace(arm, compensate_every=0), viscous).native
    assert none.noise.integral_bias.effect[0] == pytest.approx(0.0)

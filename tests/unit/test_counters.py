# SPDX-License-Identifier: MIT
"""Counters after years of flight, and what forgetting leaves after as long."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flight_support import part
from numpy.typing import NDArray
from soak_support import again, fly, instants, stored, with_all_rows, with_short_arcs

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native import snapshot
from zygos.native.flight import Estimate, Flight, encode, ffi, lib
from zygos.runs.cycles import VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

WORD, HALF, DIGITS = 2**64, 2**32, 2**53


@pytest.fixture(scope="module")
def motion(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(arm, model, scenario)


def same(found: Estimate, expected: Estimate) -> bool:
    """All that does not count."""
    return all(
        np.array_equal(getattr(found, name), getattr(expected, name), equal_nan=True)
        for name in (
            "value",
            "sigma",
            "half95",
            "covariance",
            "condition",
            "residual",
            "signal_to_noise",
            "blocks",
            "rank",
        )
    )


def flown_from(arm: Arm, motion: Cycles, begin: int) -> tuple[Estimate, dict[str, list[float]]]:
    """What two minutes from this cycle on give, and an outage that is found late."""
    flight, rng = Flight(with_short_arcs(arm)), np.random.default_rng(0)
    for number in range(2):
        part_of = again(arm, motion, 1, rng)
        sync = np.uint64(begin + number * len(motion)) + np.arange(len(motion), dtype=np.uint64)
        flight.cycles(replace(part_of, sync=sync))
    late = part(again(arm, motion, 1, rng), 0, 400)  # the newest arcs are void, those before are kept
    late.flags[0] = VOID_BEFORE | 100 << VOID_SHIFT
    flight.cycles(replace(late, sync=np.uint64(begin + 2 * len(motion)) + np.arange(400, dtype=np.uint64)))
    estimate = flight.estimate()
    assert estimate.validity == "valid"
    assert estimate.cycle == begin + 2 * len(motion) + 399
    return estimate, instants(flight)


def test_the_number_of_a_cycle_may_be_any(arm: Arm, motion: Cycles) -> None:
    """Across the place where 32 bits, the digits of a double or the sign end: no bit of the estimate."""
    expected, expected_instants = flown_from(arm, motion, 1)
    for first in (HALF - 1300, DIGITS - 1300, WORD // 2 - 1300):
        found, found_instants = flown_from(arm, motion, first)
        assert same(found, expected)
        assert found_instants == expected_instants


def accept_more(flight: Flight, instants: int) -> None:
    """As if so many instants more had been accepted in closed arcs: the number is under a checksum."""
    store = flight.native.sums.energy.store
    store.accepted += instants
    store.checksum = lib.zygos_checksum_memory(0, ffi.addressof(store), ffi.offsetof("zygos_store_t", "checksum"))


def aged(flight: Flight, file: Path) -> Flight:
    """The state after years, through a file: every counter stands shortly before its end."""
    image = flight.native
    for name in (name for name, _ in ffi.typeof("zygos_faults_t").fields):
        setattr(image.receiver.faults, name, HALF - 2)
    for name in ("cycles", "gaps", "invalid", "wraps", "apart"):
        setattr(image, name, HALF - 2)
    later = (HALF - 600) // 240 * 240
    image.sums.cycle += later
    image.receiver.assembly.sync += later
    image.receiver.assembly.time_sync += later
    accept_more(flight, DIGITS - 100)
    snapshot.write(file, "state", image)
    other = Flight(flight.arm)
    snapshot.resume(other, file)
    return other


def test_every_counter_goes_on(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    """From frames: those of 64 bits count on, those of 32 start again at 0, and the estimate does not see it."""
    cycles = noisy.cycles(0)
    young = Flight(arm)
    young.frames(encode(arm, part(cycles, 0, 500)))
    old = aged(young, tmp_path / "old.zyg")
    young = Flight(arm)
    young.frames(encode(arm, part(cycles, 0, 500)))
    snapshot.write(tmp_path / "young.zyg", "state", young.native)
    snapshot.resume(young, tmp_path / "young.zyg")
    rest = encode(arm, part(cycles, 500, 1200))
    broken = rest.copy()
    broken["data"][100::160, 3] ^= 1  # wrong CRCs, lost cycles
    before = {flight: (dict(flight.faults), dict(flight.counts)) for flight in (young, old)}
    for flight in (young, old):
        flight.frames(broken)
        flight.frames(rest)  # the counters of SYNC jump, and FTIME too
    for name, count in young.faults.items():
        assert (old.faults[name] - before[old][0][name]) % HALF == count - before[young][0][name], name
    assert old.faults["crc"] < HALF - 2
    assert old.faults["dropped"] < HALF - 2
    for name in ("cycles", "gaps", "accepted", "refused"):
        assert old.counts[name] - before[old][1][name] == young.counts[name] - before[young][1][name], name
    assert old.counts["gaps"] > HALF
    assert old.counts["accepted"] > DIGITS
    assert old.native.sums.cycle > HALF
    assert (old.estimate().validity, old.estimate().reason) == ("valid", "")
    assert same(old.estimate(), young.estimate())


@pytest.mark.slow(but=["0.9", "0.9999"])
@pytest.mark.parametrize("keep", [0.9, 0.99, 0.9999])
def test_what_was_forgotten_long_ago_is_nothing_and_not_corrupt(arm: Arm, motion: Cycles, keep: float) -> None:
    """Hours of arcs that are too short to count: all that was known fades, below what doubles can hold."""
    flight, rng = Flight(with_all_rows(arm)), np.random.default_rng(0)
    flight.native.sums.config.forgetting_factor = keep
    assert lib.zygos_arm_init(flight.native, ffi.addressof(flight.native, "sums", "config")) == 1
    fly(flight, motion, 2, rng)
    short = part(again(flight.arm, motion, 1, rng), 0, 25)
    seen = set()
    for number in range(2500):
        flight.cycles(replace(short, sync=short.sync + np.uint64(int(flight.native.sums.cycle) + 2)))
        if number % 100 == 0:
            seen.add(flight.estimate().reason)
    assert "the accumulated sums are corrupt: memory was changed from outside" not in seen
    left = [number for part_of in instants(flight).values() for number in part_of]
    assert max(left) < (1.0 if keep > 0.999 else 1e-300)
    fly(flight, motion, 40, rng)
    estimate = flight.estimate()
    assert "corrupt" not in estimate.reason
    if keep > 0.999:  # a memory of several arcs
        assert (estimate.validity, estimate.reason) == ("valid", "")


def test_forgetting_goes_on_for_as_long_as_the_arm_flies(arm: Arm, motion: Cycles) -> None:
    """A memory of ten minutes, five hours on: as sharp as after one, and the older half of the blocks is not empty."""
    flight, rng = Flight(replace(with_all_rows(arm), memory_s=600.0)), np.random.default_rng(0)
    sigmas = []
    for _ in range(10):
        fly(flight, motion, 30, rng)
        estimate = flight.estimate()
        assert (estimate.validity, estimate.reason) == ("valid", "")
        for part_of in instants(flight).values():
            assert max(part_of) < 0.5 * sum(part_of)
        sigmas.append(estimate.sigma)
    ratio = np.median(sigmas[5:], axis=0) / np.median(sigmas[:5], axis=0)
    assert (ratio > 0.5).all()
    assert (ratio < 2.0).all()

# SPDX-License-Identifier: MIT
"""A bit of the state that flips, and nobody scrubs it: an estimate is refused as corrupt, or hardly another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_support import copy_of, part
from motion_support import random_ground
from soak_support import again, fly, stored, with_short_arcs
from state_support import Place, beside_sums, config_of_its_own, one_of_each, sums

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import REASONS, Estimate, Flight, cycles_to_native, ffi, lib
from zygos.runs.cycles import BREAK_BEFORE, VOID_BEFORE, VOID_SHIFT, Cycles
from zygos.simulation.scenario import Scenario

CORRUPT = REASONS[lib.ZYGOS_REASON_CORRUPT]
MOVED, FACTOR = 0.5, 1.5
"""What a flip that is not noticed may do: move a value by so many sigmas, and change a sigma by this factor."""
SIZE = ffi.sizeof("zygos_arm_t")


@pytest.fixture(scope="module")
def motion(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(arm, model, scenario)


@pytest.fixture(scope="module")
def flight(arm: Arm, motion: Cycles) -> Flight:
    """Many arcs of each kind of rows, of which blocks have merged, and some of the next ones."""
    out, rng = Flight(with_short_arcs(arm)), np.random.default_rng(0)
    fly(out, motion, 4, rng)
    out.cycles(part(again(out.arm, motion, int(out.native.sums.cycle) + 1, rng), 0, 570))  # where no arc is closing
    assert out.estimate().validity == "valid"
    assert len(out.blocks().motors) < 35 < out.native.sums.cycle / out.native.sums.config.impulse_arc_cycles
    return out


@pytest.fixture(scope="module")
def energy_alone(arm: Arm, motion: Cycles) -> Flight:
    out = Flight(replace(arm, arc_max_s=20.0, impulse_arc_s=0.0))
    fly(out, motion, 2, np.random.default_rng(0))
    assert out.estimate().validity == "valid"
    return out


@pytest.fixture(scope="module")
def ground() -> tuple[Flight, Cycles]:
    """Rigid joints on the ground with joint rows beside energy rows, and what follows."""
    known = random_ground(3, "spatial", 4500)
    out, cycles = Flight(known.arm), known.cycles(0)
    out.cycles(part(cycles, 0, 3500))
    return out, part(cycles, 3500, 4500)


def harmless(found: Estimate, before: Estimate) -> bool:
    if found.validity in ("refused", "doubtful"):
        return found.validity == before.validity
    moved = np.abs(found.value - before.value) / before.sigma
    changed = np.abs(np.log(found.sigma / before.sigma))
    return bool((moved <= MOVED).all() and (changed <= np.log(FACTOR)).all())


def in_tables(flight: Flight, place: Place, bit: int) -> bool:
    other = copy_of(flight)
    place.flip(other.native, bit)
    return bool(lib.zygos_arm_scrub(other.native, config_of_its_own(flight)) & lib.ZYGOS_SCRUBBED_TABLES)


@pytest.mark.slow(but=["0-flight"])
@pytest.mark.parametrize("name", ["flight", "energy_alone"])
@pytest.mark.parametrize("seed", range(4))
def test_a_flipped_bit_of_any_member_is_refused_or_does_no_harm(
    seed: int, name: str, request: pytest.FixtureRequest
) -> None:
    """And zygos_arm_check() finds what the solver finds. A single number may be a count that leaves no answer; of what
    follows from the configuration zygos_arm_scrub() tells."""
    flight: Flight = request.getfixturevalue(name)
    rng, own, work = np.random.default_rng(seed), config_of_its_own(flight), ffi.new("zygos_work_t *")
    before, wrong, refused = flight.estimate(), [], 0
    listed = one_of_each(flight.native, rng, without=("config", "receiver", "smoother", "noise", "geometry"))
    for place in listed:
        bit = place.bits(rng, 2)[seed % 2]
        place.flip(flight.native, bit)
        found = flight.estimate()
        verdict = lib.zygos_arm_check(flight.native, own, work)
        place.flip(flight.native, bit)
        refused += found.reason == CORRUPT
        silent = place.leaf.count == 1 and found.validity in ("refused", "doubtful")
        if not (found.reason == CORRUPT or silent or harmless(found, before) or in_tables(flight, place, bit)):
            wrong.append(f"{place} bit {bit}: {found.validity} {found.reason}")
        if (found.reason == CORRUPT) > (verdict < 0):
            wrong.append(f"{place} bit {bit}: not found by zygos_arm_check()")
    assert wrong == []
    assert refused > 0.15 * len(listed)
    assert lib.zygos_arm_check(flight.native, own, work) == 1


@pytest.mark.parametrize("bit", [40, 51, 52, 62, 63])
def test_a_flipped_bit_of_the_largest_sum_is_refused(flight: Flight, bit: int) -> None:
    """In blocks, in what waits to go into them, and in the noise; what is no sum of the estimate does no harm."""
    before, refused, places = flight.estimate(), 0, sums(flight.native, np.random.default_rng(bit))
    for place in places:
        place.flip(flight.native, bit)
        found = flight.estimate()
        place.flip(flight.native, bit)
        refused += found.reason == CORRUPT
        assert found.reason == CORRUPT or harmless(found, before), place
        assert found.reason != CORRUPT or np.isnan(found.value).all()
    assert refused > 0.5 * len(places)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_sum_that_is_not_a_number_is_refused(flight: Flight, value: float) -> None:
    before = flight.estimate()
    for place in sums(flight.native, np.random.default_rng(0)):
        number = place.values(flight.native)
        kept = number[0]
        number[0] = value
        found = flight.estimate()
        number[0] = kept
        assert found.reason == CORRUPT or harmless(found, before), place


@pytest.mark.slow(but=["-1.0-flight"])
@pytest.mark.parametrize("name", ["flight", "ground"])
@pytest.mark.parametrize("value", [-1.0, np.nan, 1e300])
def test_an_impossible_number_beside_sums_is_refused(value: float, name: str, request: pytest.FixtureRequest) -> None:
    """Such as a count of rows. What is loaded may have any number, and zygos_arm_check() finds what is refused."""
    fixture = request.getfixturevalue(name)
    flight: Flight = fixture if name == "flight" else fixture[0]
    own, work = config_of_its_own(flight), ffi.new("zygos_work_t *")
    before, found = flight.estimate(), 0
    places = beside_sums(flight.native, np.random.default_rng(0))
    for place in places:
        number = place.values(flight.native)
        kept = number[0]
        number[0] = value
        after, verdict = flight.estimate(), lib.zygos_arm_check(flight.native, own, work)
        number[0] = kept
        assert after.validity == "refused" or harmless(after, before), place
        assert verdict < 0 or after.reason != CORRUPT, place
        found += verdict < 0
    assert found > 0.4 * len(places)


def resting(flight: Flight, next_ones: Cycles, places: list[Place], cycles: int) -> list[bool]:
    """Which of the places keep their value for so many cycles, none of which is void."""
    later, few = copy_of(flight), part(next_ones, 0, cycles)
    later.cycles(replace(few, flags=few.flags & BREAK_BEFORE))
    return [bool(one.values(later.native) == one.values(flight.native)) for one in places]


@pytest.mark.slow(only=["ground-*"])
@pytest.mark.parametrize(("name", "keep"), [("flight", True), ("flight", False), ("ground", True)])
def test_a_flip_is_remembered_when_its_block_changes(
    name: str, keep: bool, motion: Cycles, request: pytest.FixtureRequest
) -> None:
    """Blocks that merge and fade, and arcs that are dropped behind them, do not hide what was changed before. The
    products of forgetting factors, which stand beside all sums, are under no check."""
    rng = np.random.default_rng(0)
    if name == "ground":
        flight, later = request.getfixturevalue("ground")
    else:
        flight = request.getfixturevalue("flight")
        later = again(flight.arm, motion, int(flight.native.sums.cycle) + 1, np.random.default_rng(2))
    if not keep:
        later.flags[0] = VOID_BEFORE | 100 << VOID_SHIFT
    unused = ("config", "receiver", "smoother", "noise", "geometry", "guard", "joint")
    places = [*one_of_each(flight.native, rng, without=unused), *sums(flight.native, rng)]
    native, expected, damaged, refused = cycles_to_native(later), copy_of(flight), copy_of(flight), 0
    assert lib.zygos_batch_cycles(expected.native, native, len(later), ffi.NULL) == len(later)
    before, rests = expected.estimate(), resting(flight, later, places, 200)
    assert before.validity == "valid"
    for place, keeps in zip(places, rests, strict=True):
        ffi.memmove(damaged.native, flight.native, SIZE)
        place.flip(damaged.native, bit := place.bits(rng, 2)[1])
        forgets = "." not in place.leaf.path and place.leaf.kind == "double"
        in_use = keeps and place.values(flight.native) != 0 and not forgets
        if in_use and lib.zygos_batch_cycles(damaged.native, native, len(later), ffi.NULL) == len(later):
            found = damaged.estimate()
            refused += found.reason == CORRUPT
            noticed = found.reason == CORRUPT or found.validity == "doubtful"
            assert noticed or harmless(found, before) or in_tables(flight, place, bit), place
    assert refused > (5 if name == "ground" else 15)


@pytest.mark.parametrize("bit", [52, 62])
def test_an_open_arc_that_does_not_match_is_dropped_when_it_closes(flight: Flight, motion: Cycles, bit: int) -> None:
    """It is counted; what closed before it and what comes behind it are used."""
    damaged, ended, dropped = copy_of(flight), copy_of(flight), 0
    before, places = flight.estimate(), sums(flight.native, np.random.default_rng(0))
    later = again(flight.arm, motion, int(flight.native.sums.cycle) + 1, np.random.default_rng(1))
    soon, late = (resting(flight, later, places, cycles) for cycles in (3, 18))
    assert lib.zygos_arm_end_arcs(ended.native) == 1
    for place, rests, rests_long in zip(places, soon, late, strict=True):
        if not rests or (not rests_long and place.values(ended.native) == 0):  # what comes in turn changes seldom
            ffi.memmove(damaged.native, flight.native, SIZE)
            place.flip(damaged.native, bit)
            corrupt = damaged.estimate().reason == CORRUPT
            fly(damaged, motion, 1, np.random.default_rng(1))
            estimate = damaged.estimate()
            assert estimate.validity == "valid", place
            found = lib.zygos_arm_scrub(damaged.native, config_of_its_own(flight))
            assert not corrupt or (found, damaged.native.quarantined) == (lib.ZYGOS_SCRUBBED_BLOCKS, 1), place
            dropped += corrupt
            assert (np.abs(estimate.value - before.value) < 3.0 * before.half95).all(), place
    assert dropped >= 3


@pytest.mark.parametrize("size", [32, 35, 40])
def test_every_byte_is_under_the_checksum(size: int) -> None:
    memory = ffi.new("uint8_t[]", 40)
    before = lib.zygos_checksum_memory(1, memory, size)
    for place in range(len(memory)):
        memory[place] ^= 4
        assert (lib.zygos_checksum_memory(1, memory, size) != before) == (place < size)
        memory[place] ^= 4


@pytest.mark.parametrize("words", [2, 16, 40])
def test_the_same_bit_of_two_words_does_not_cancel(words: int) -> None:
    """Of any two, the top bit as well; and one is not mistaken for one of the checksum."""
    rng, memory = np.random.default_rng(words), ffi.new("uint64_t[]", words)
    for k in range(words):
        memory[k] = int(rng.integers(2**63))
    before = lib.zygos_checksum_words(0, memory, words)
    for bit in range(64):
        for first in range(words):
            memory[first] ^= 1 << bit
            assert (lib.zygos_checksum_words(0, memory, words) ^ before).bit_count() >= 2
            for other in range(first + 1, words):
                memory[other] ^= 1 << bit
                assert lib.zygos_checksum_words(0, memory, words) != before, (bit, first, other)
                memory[other] ^= 1 << bit
            memory[first] ^= 1 << bit


def test_a_flipped_bit_of_words_or_of_their_checksum_is_turned_back() -> None:
    """And two are not."""
    rng, words = np.random.default_rng(0), 12
    memory, right = ffi.new("uint64_t[]", words), rng.integers(2**63, size=words).tolist()
    for k, word in enumerate(right):
        memory[k] = word
    checksum = lib.zygos_checksum_words(0, memory, words)
    for bit in range(64):
        assert lib.zygos_checksum_repair(memory, 8 * words, checksum ^ (1 << bit)) and list(memory) == right
        at = int(rng.integers(words))
        memory[at] ^= 1 << bit
        assert lib.zygos_checksum_repair(memory, 8 * words, checksum) and list(memory) == right
        memory[at] ^= 1 << bit
        memory[(at + 1) % words] ^= 1 << bit
        wrong = list(memory)
        assert not lib.zygos_checksum_repair(memory, 8 * words, checksum) and list(memory) == wrong
        memory[at], memory[(at + 1) % words] = right[at], right[(at + 1) % words]

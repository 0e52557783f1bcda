# SPDX-License-Identifier: MIT
"""zygos_arm_scrub(): what memory errors change is found, and repaired or left out.

A bit flips in every member of the state in turn, whatever the members are; what must hold then holds for all of them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flight_support import bytes_of, copy_of, part
from ground_support import seen, short_arm, torque_of
from soak_support import again, fly, stored, with_short_arcs
from state_support import Place, config_of_its_own, lose_the_way, one_of_each, sums

from conftest import EXAMPLE
from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.native.flight import Estimate, Flight, cycles_to_native, encode, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

CONFIG, TABLES, PLACES, BLOCKS, SUMS = (
    lib.ZYGOS_SCRUBBED_CONFIG, lib.ZYGOS_SCRUBBED_TABLES, lib.ZYGOS_SCRUBBED_PLACES, lib.ZYGOS_SCRUBBED_BLOCKS,
    lib.ZYGOS_SCRUBBED_SUMS,
)  # fmt: skip
SIZE = ffi.sizeof("zygos_arm_t")
FURTHER = 450
"""Cycles in which arcs of every kind end."""
FEW = 90
STEP = 30


@dataclass(frozen=True)
class Start:
    """A flight that nothing has changed, and what comes next."""

    flight: Flight
    rest: Any
    """Cycles, or frames of so many cycles each."""
    frames: int = 0

    @property
    def own(self) -> Any:
        """The caller's own configuration."""
        return config_of_its_own(self.flight)

    def feed(self, flight: Flight, first: int, last: int) -> int:
        """These of the next cycles; below 0 where one is refused."""
        if not self.frames:
            return int(lib.zygos_batch_cycles(flight.native, self.rest + first, last - first, ffi.NULL))
        pointer, verdict = ffi.cast("zygos_frame_t *", self.rest.ctypes.data), 0
        for k in range(self.frames * first, self.frames * last):
            verdict = lib.zygos_arm_frame(flight.native, pointer + k)
            while verdict >= 0 and (verdict := lib.zygos_arm_step(flight.native)) == 1:
                pass
            if verdict < 0:
                break
        return int(verdict)

    def fly(self, flight: Flight, own: Any, begin: int = 0) -> bool:
        """The rest, as the manual asks: where a call refuses, scrub and go on. Returns whether none did."""
        quiet = True
        for first in range(begin, self.count, STEP):
            if self.feed(flight, first, min(first + STEP, self.count)) < 0:
                quiet = False
                assert lib.zygos_arm_scrub(flight.native, own) != 0
        return quiet

    @property
    def count(self) -> int:
        """How many cycles come next: arcs of every kind end in them, but for frames, which take longer to feed."""
        return FEW if self.frames else FURTHER


@cache
def recording() -> Cycles:
    """A minute without noise."""
    arm, model = load_arm(EXAMPLE / "arm.toml"), load_model(EXAMPLE / "model.toml")
    return stored(arm, model, load_scenario(EXAMPLE / "scenario.toml"))


def flown(*, frames: bool = False) -> tuple[Flight, Cycles]:
    """Rows of energy, motors and momentum in short arcs, a factor of forgetting and a running solution; and the next
    cycles, all verified up to there."""
    arm, rng = with_short_arcs(load_arm(EXAMPLE / "arm.toml")), np.random.default_rng(0)
    gyro = replace(arm.imu, rate_sigma=1e-3 if frames else arm.imu.rate_sigma)  # its noise counts, too
    flight = Flight(replace(arm, imu=gyro, compensate_every=1))
    if frames:
        motion = replace(recording(), sync=np.arange(len(recording()), dtype=np.uint64))
        flight.frames(encode(flight.arm, again(flight.arm, motion, 0, rng)))
    else:
        fly(flight, recording(), 2, rng)
    assert lib.zygos_arm_scrub(flight.native, config_of_its_own(flight)) == 0
    assert flight.estimate().validity == "valid"
    assert flight.adopt()
    rest = again(flight.arm, recording(), int(flight.native.sums.cycle) + 1 + frames, rng)  # of frames one is open
    rest.flags[0] = 0
    return flight, rest


@cache
def start(name: str) -> Start:
    """ "open arcs" of each kind; "amid tasks", where an arc waits until the one before it is closed; "reception", where
    cycles wait in the queue; "ground", where joint rows stand beside the energy rows."""
    if name == "ground":
        arm, model = short_arm(2)
        cycles = seen(arm, *torque_of(arm, model, 0, 36.0), 0)
        flight, at = Flight(arm, model.effects), round(31.0 / arm.period_s)
        flight.cycles(part(cycles, 0, at))
        assert lib.zygos_arm_scrub(flight.native, config_of_its_own(flight)) == 0
        flight.estimate()
        assert flight.adopt()
        flight.cycles(part(cycles, at, at + 100))
        return Start(flight, cycles_to_native(part(cycles, at + 100, at + 100 + FURTHER)))
    flight, rest = flown(frames=name == "reception")
    if name == "reception":
        frames = encode(flight.arm, part(rest, 0, FEW + 6))
        first = frames[frames["id"] != 0x3A0]  # without FTIME every cycle has as many
        of_a_cycle = int(np.flatnonzero(first["id"] == 0x080)[1])
        pointer = ffi.cast("zygos_frame_t *", first.ctypes.data)
        for k in range(3 * of_a_cycle + 2):
            assert lib.zygos_arm_frame(flight.native, pointer + k) == lib.ZYGOS_ACCEPTED
        return Start(flight, first[3 * of_a_cycle + 2 :], of_a_cycle)
    if name == "open arcs":
        flight.cycles(part(rest, 0, 150))
        return Start(flight, cycles_to_native(part(rest, 150, 150 + FURTHER)))
    at = 0
    while flight.native.waited[0] == 0:  # arcs are ended by gaps until one has to wait
        gap = part(again(flight.arm, recording(), int(flight.native.sums.cycle) + 2, np.random.default_rng(at)), 0, 45)
        for k in range(len(gap)):
            flight.cycles(part(gap, k, k + 1))
            if flight.native.waited[0]:
                break
        at += 1
    rest = replace(rest, sync=rest.sync - rest.sync[0] + np.uint64(int(flight.native.sums.cycle) + 1))
    return Start(flight, cycles_to_native(part(rest, 0, FURTHER)))


def off(found: Estimate, before: Estimate) -> float:
    """How far values are from those before at most, in sigmas of these."""
    return float(np.nan_to_num(np.abs(found.value - before.value) / before.sigma, nan=0.0).max(initial=0.0))


def told(flight: Flight, estimate: Estimate) -> tuple[object, ...]:
    """All that a caller sees beside the values."""
    counts = (flight.faults, flight.counts, int(flight.native.quarantined))
    return (*counts, estimate.validity, estimate.reason, estimate.left_out)


def scrubbed(flight: Flight, own: Any, what: object) -> int:
    """What zygos_arm_scrub() finds, and no second call finds again; a state that it refuses stays refused."""
    found = int(lib.zygos_arm_scrub(flight.native, own))
    assert lib.zygos_arm_scrub(flight.native, own) == (found if found < 0 else 0), what
    return found


STARTS = ("open arcs", "amid tasks", "reception", "ground")


def damages(name: str, seed: int) -> list[tuple[Place, int]]:
    """A bit of every second member: of the others in every second seed, or of all of them in the other starts. In half
    of the seeds it is the highest of the exponent of doubles."""
    rng, native = np.random.default_rng(seed), start(name).flight.native
    listed = one_of_each(native, rng)[(seed + STARTS.index(name)) % 2 :: 2]
    return [(place, place.bits(rng, 2)[seed // 2]) for place in listed]


@pytest.mark.slow(but=["0-open arcs", "2-ground"])
@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize("seed", range(4))
def test_a_flipped_bit_of_any_member_costs_no_more_than_was_found(seed: int, name: str) -> None:
    """What was found tells what is lost: nothing, open arcs, those that are not verified, blocks, sums of a kind. The
    values stay, or there are none; what follows from the configuration is right again; and the next cycles fly."""
    begin = start(name)
    flight, own, before, wrong = copy_of(begin.flight), begin.own, begin.flight.estimate(), []
    found: Counter[int] = Counter()
    for place, bit in damages(name, seed):
        ffi.memmove(flight.native, begin.flight.native, SIZE)
        place.flip(flight.native, bit)
        verdict = scrubbed(flight, own, (place, bit))
        found[verdict] += 1
        estimate, right = flight.estimate(), place.values(begin.flight.native)
        rebuilt = verdict & (CONFIG | TABLES)
        holds = estimate.validity == "refused" or off(estimate, before) < 3.0
        if rebuilt:
            holds &= bool(place.values(flight.native) == right or right == 0)
        elif not verdict & SUMS and estimate.validity != "refused":
            holds &= (
                estimate.arcs >= before.arcs - 2
            )  # one that is open, and one that waits or a block of which was bad
        if begin.feed(flight, 0, 2) < 0:  # by readings that wait, which only a cycle checks
            holds &= lib.zygos_arm_scrub(flight.native, own) > 0 and begin.feed(flight, 2, 4) >= 0
        if not holds:
            wrong.append(f"{place}, bit {bit}: {verdict}, {estimate.validity}")
    assert wrong == []
    assert {CONFIG, TABLES, PLACES, BLOCKS} <= set(found)
    assert found[0] < 0.7 * found.total()


@pytest.mark.slow(but=["0-reception", "2-amid tasks"])
@pytest.mark.parametrize("name", STARTS)
@pytest.mark.parametrize("seed", range(4))
def test_no_flipped_bit_of_any_member_moves_an_estimate_in_silence(seed: int, name: str) -> None:
    """Arcs end before the next call. A cycle that is refused changes nothing; the flight goes on in any case."""
    begin = start(name)
    flight, own, wrong, refused = copy_of(begin.flight), begin.own, [], 0
    assert begin.fly(flight, own)
    assert lib.zygos_arm_scrub(flight.native, own) == 0
    expected = flight.estimate()
    expected_told = told(flight, expected)
    for place, bit in damages(name, seed):
        ffi.memmove(flight.native, begin.flight.native, SIZE)
        place.flip(flight.native, bit)
        holds = True
        if begin.feed(flight, 0, 1) < 0 and not begin.frames:
            place.flip(flight.native, bit)
            holds = ffi.buffer(flight.native) == ffi.buffer(begin.flight.native)
            place.flip(flight.native, bit)
        quiet = begin.fly(flight, own, 1)
        refused += not quiet
        if scrubbed(flight, own, (place, bit)) == 0 and quiet:
            estimate = flight.estimate()
            holds &= told(flight, estimate) != expected_told or off(estimate, expected) < 3.0
        if begin.feed(flight, begin.count - 2, begin.count) < 0:
            holds &= lib.zygos_arm_scrub(flight.native, own) > 0
        if not holds:
            wrong.append(f"{place}, bit {bit}")
    assert wrong == []
    assert refused > 0.1 * len(damages(name, seed))


@pytest.mark.slow(but=["0-*"])
@pytest.mark.parametrize("name", ["open arcs", "ground"])
@pytest.mark.parametrize("seed", range(4))
def test_what_two_flipped_bits_change_is_not_used(seed: int, name: str) -> None:
    """They cannot be flipped back: an estimate is refused, or nothing that counts has changed."""
    begin, rng = start(name), np.random.default_rng(seed)
    flight, own, before = copy_of(begin.flight), begin.own, begin.flight.estimate()
    listed, refused = one_of_each(begin.flight.native, rng, without=("config", "receiver")), 0
    for k in range(80):
        ffi.memmove(flight.native, begin.flight.native, SIZE)
        first = int(rng.integers(len(listed) - 8))
        for place in (listed[first], listed[first + int(rng.integers(1, 8))]):  # of one struct, mostly
            place.flip(flight.native, place.bits(rng, 2)[1])
        if k % 2:
            begin.fly(flight, own)
        estimate = flight.estimate()
        refused += estimate.validity == "refused"
        assert estimate.validity != "valid" or off(estimate, before) < 6.0
        scrubbed(flight, own, k)
        assert begin.feed(flight, 0, 2) >= 0 or lib.zygos_arm_scrub(flight.native, own) > 0
    assert refused > 10


@pytest.mark.parametrize("bit", [0, 2, 5, 31])
def test_the_same_bit_of_two_places_is_refused_as_that_of_one(bit: int) -> None:
    """Counts and places that the next cycle refuses when one of them is changed: two of them do not cancel."""
    begin, rng = start("open arcs"), np.random.default_rng(bit)
    flight, own = copy_of(begin.flight), begin.own

    def refused(*places: Place) -> bool:
        ffi.memmove(flight.native, begin.flight.native, SIZE)
        for place in places:
            place.flip(flight.native, bit)
        return begin.feed(flight, 0, 1) == lib.ZYGOS_E_STATE and lib.zygos_arm_scrub(flight.native, own) > 0

    listed = [place for place in one_of_each(begin.flight.native, rng) if place.leaf.size == 4 and refused(place)]
    assert len(listed) > 30
    pairs = [(a, b) for k, a in enumerate(listed) for b in listed[k + 1 :]]
    chosen = [pairs[k] for k in rng.permutation(len(pairs))[:150]]
    assert [f"{a} and {b}" for a, b in chosen if not refused(a, b)] == []


def test_much_of_what_changes_from_cycle_to_cycle_is_under_a_check() -> None:
    """Integrals, counts and places: the next cycle is refused, and only open arcs are lost."""
    begin, states, stopped, of_all = start("open arcs"), [], 0, 0
    flight = copy_of(begin.flight)
    for k in range(4):
        states.append(copy_of(flight))
        begin.feed(flight, k, k + 1)
    for place in one_of_each(begin.flight.native, np.random.default_rng(0), without=("config", "receiver")):
        if len({place.values(state.native)[0] for state in states}) >= 3:
            ffi.memmove(flight.native, begin.flight.native, SIZE)
            place.flip(flight.native, place.bits(np.random.default_rng(1), 2)[1])
            of_all += 1
            if begin.feed(flight, 0, 1) < 0:
                stopped += 1
                assert scrubbed(flight, begin.own, place) & PLACES
    assert stopped >= 0.25 * of_all > 5


@pytest.mark.parametrize("seed", range(3))
def test_no_flipped_bit_of_what_joint_rows_leave_to_the_next_cycle_reaches_the_sums(seed: int) -> None:
    """It is counted, or the sums are bit by bit what they are without it."""
    begin, rng, told_of = start("ground"), np.random.default_rng(seed), 0
    flight, own = copy_of(begin.flight), begin.own
    used = np.frombuffer(ffi.buffer(ffi.addressof(begin.flight.native, "joint")), dtype=np.uint64).nonzero()[0]

    def flown_on(bit: int | None) -> tuple[bytes, int]:
        ffi.memmove(flight.native, begin.flight.native, SIZE)
        if bit is not None:
            memory = ffi.buffer(ffi.addressof(flight.native, "joint"))
            memory[bit // 8] = bytes([memory[bit // 8][0] ^ (1 << bit % 8)])
        found = 0
        for k in range(FURTHER):
            if begin.feed(flight, k, k + 1) < 0:
                found += lib.zygos_arm_scrub(flight.native, own) > 0
        counted = lib.zygos_arm_count_quarantined(flight.native)
        return bytes(ffi.buffer(ffi.addressof(flight.native, "sums", "joints"))), found + counted

    expected, none = flown_on(None)
    assert none == 0
    for word in rng.choice(used, 30):
        sums, counted = flown_on(64 * int(word) + int(rng.integers(64)))
        assert counted or sums == expected, f"word {word}"
        told_of += bool(counted)
    assert told_of > 10


def test_sums_that_do_not_match_are_left_out_and_no_others() -> None:
    begin = start("open arcs")
    flight, own, before, dropped = copy_of(begin.flight), begin.own, begin.flight.estimate(), 0
    for place in sums(begin.flight.native, np.random.default_rng(0)):
        ffi.memmove(flight.native, begin.flight.native, SIZE)
        place.flip(flight.native, 52)
        if scrubbed(flight, own, place) == BLOCKS:
            dropped += 1
            estimate = flight.estimate()
            assert flight.native.quarantined == 1, place
            assert (estimate.validity, off(estimate, before) < 3.0) == (before.validity, True), place
    assert dropped > 8


def test_arcs_that_a_changed_table_may_have_spoiled_are_dropped() -> None:
    """All that ended behind the last call."""
    flight, rng = (
        Flight(replace(with_short_arcs(load_arm(EXAMPLE / "arm.toml")), memory_s=None)),
        np.random.default_rng(0),
    )
    fly(flight, part(recording(), 0, 600), 1, rng)
    own = config_of_its_own(flight)
    assert lib.zygos_arm_end_arcs(flight.native) == 1
    assert lib.zygos_arm_scrub(flight.native, own) == 0
    verified, damaged, tables = flight.counts["accepted"], copy_of(flight), 0
    for place in one_of_each(flight.native, rng, without=("config",)):
        if place.leaf.kind == "double" and tables < 5:
            ffi.memmove(damaged.native, flight.native, SIZE)
            place.flip(damaged.native, 30)
            if lib.zygos_arm_scrub(damaged.native, own) == TABLES:
                tables += 1
                place.flip(damaged.native, 30)
                fly(damaged, part(recording(), 0, 900), 1, rng)
                assert damaged.counts["accepted"] >= verified
                assert lib.zygos_arm_scrub(damaged.native, own) & TABLES, place
                assert damaged.counts["accepted"] == verified, place
    assert tables == 5


def test_memory_that_nothing_has_changed_is_left_as_it_is() -> None:
    for name in ("open arcs", "ground"):
        begin = start(name)
        flight = copy_of(begin.flight)
        assert lib.zygos_arm_scrub(flight.native, begin.own) == 0
        settled = copy_of(flight)
        assert lib.zygos_arm_scrub(flight.native, begin.own) == 0
        assert ffi.buffer(flight.native) == ffi.buffer(settled.native)
        assert flight.native.scrubbed == flight.native.sums.cycle
        assert flight.counts == begin.flight.counts


def test_of_three_configurations_two_must_agree() -> None:
    """The caller's, the one in the state, and the checksum there: where all differ, none is taken."""
    begin = start("open arcs")
    flight, own = copy_of(begin.flight), begin.own
    flight.native.sums.config.period_s *= 2.0
    assert scrubbed(flight, own, "that of the state") == CONFIG
    assert flight.native.sums.config.period_s == own.period_s
    for of_state, of_caller in ((1.0, 2.0), (3.0, 2.0)):
        flight, other = copy_of(begin.flight), begin.own
        flight.native.sums.config.period_s *= of_state
        other.period_s *= of_caller
        before = bytes_of(flight.native)
        assert lib.zygos_arm_scrub(flight.native, other) == lib.ZYGOS_E_CONFIG
        assert lib.zygos_arm_scrub(flight.native, ffi.addressof(flight.native, "sums", "config")) == lib.ZYGOS_E_CONFIG
        assert bytes_of(flight.native) == before


def test_the_magic_number_is_repaired_where_one_bit_is_wrong() -> None:
    begin = start("open arcs")
    flight = copy_of(begin.flight)
    flight.native.magic ^= 1 << 5
    assert lib.zygos_arm_step(flight.native) == lib.ZYGOS_E_ORDER
    assert scrubbed(flight, begin.own, "magic") == PLACES
    assert lib.zygos_arm_step(flight.native) == 0
    flight.native.magic ^= 3
    assert lib.zygos_arm_scrub(flight.native, begin.own) == lib.ZYGOS_E_ORDER


def test_a_state_that_lost_its_way_does_nothing_before_it_is_scrubbed() -> None:
    begin = start("open arcs")
    flight, own = copy_of(begin.flight), begin.own
    begin.flight.estimate()
    lose_the_way(flight)
    before = bytes_of(flight.native)
    for frame in encode(flight.arm, part(recording(), 0, 3)):
        lib.zygos_arm_frame(flight.native, ffi.from_buffer("zygos_frame_t *", frame.tobytes()))
    assert lib.zygos_arm_step(flight.native) == lib.zygos_arm_cycle(flight.native, begin.rest) == lib.ZYGOS_E_STATE
    assert lib.zygos_arm_end_arcs(flight.native) == lib.ZYGOS_E_STATE
    solver, out = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
    assert lib.zygos_arm_solve(flight.native, solver, out) == lib.ZYGOS_E_STATE
    assert lib.zygos_arm_adopt(flight.native, begin.flight._estimate) == lib.ZYGOS_E_STATE
    assert lib.zygos_arm_scrub(ffi.NULL, own) == lib.zygos_arm_scrub(flight.native, ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_scrub(flight.native, own) > 0
    assert lib.zygos_arm_step(flight.native) == 1
    assert bytes_of(flight.native) != before


@pytest.mark.parametrize("keep", [0, lib.ZYGOS_KEEP_FAULTS, lib.ZYGOS_KEEP_JOINTS])
def test_a_restart_makes_an_impossible_queue_possible(keep: int) -> None:
    """Whatever its indices are, and those of the motor sums that would be kept: the next cycles are processed."""
    begin = start("reception")
    for name, members in (("queue", ("tail", "head")), ("motors", ("count", "pair"))):
        for member in members:
            flight = copy_of(begin.flight)
            place = flight.native.receiver.queue if name == "queue" else flight.native.sums.motors.store
            setattr(place, member, 2**31 + 5)
            assert lib.zygos_arm_restart(flight.native, keep) == 1
            assert begin.feed(flight, 4, 8) >= 0 and flight.native.cycles > begin.flight.native.cycles, member

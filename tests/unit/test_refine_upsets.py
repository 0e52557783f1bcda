# SPDX-License-Identifier: MIT
"""Memory errors in the refinement on board: what is refused, repaired, abandoned and counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refine_support import Case, flown, learned, selected

from zygos.native.flight import Flight, config_of, cycles_to_native, ffi, lib
from zygos.native.refine import OnboardRefiner
from zygos.runs.cycles import Cycles

CONFIG, TABLES, PLACES, SUMS = (
    lib.ZYGOS_SCRUBBED_CONFIG, lib.ZYGOS_SCRUBBED_TABLES, lib.ZYGOS_SCRUBBED_PLACES, lib.ZYGOS_SCRUBBED_SUMS
)  # fmt: skip
SIZE = ffi.sizeof("zygos_refine_t")


@pytest.fixture(scope="module")
def begun() -> tuple[Flight, OnboardRefiner, Cycles]:
    """A refinement of some cycles, and those that follow."""
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm)
    task.start(flight)
    task.cycles(selected(rest, slice(0, 30)))
    return flight, task, selected(rest, slice(30, 80))


def copy_of(task: OnboardRefiner) -> OnboardRefiner:
    out = OnboardRefiner(task.arm)
    ffi.memmove(out.native, task.native, SIZE)
    return out


def scrub(task: OnboardRefiner) -> int:
    return int(lib.zygos_refine_scrub(task.native, task._config))


def step(task: OnboardRefiner, config: Any = None) -> int:
    return int(lib.zygos_refine_step(task.native, config or task._config))


def hand(task: OnboardRefiner, cycles: Cycles, k: int = 0) -> int:
    return int(lib.zygos_refine_cycle(task.native, cycles_to_native(selected(cycles, slice(k, k + 1)))))


def test_memory_that_nothing_has_changed_is_left_as_it_is(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    _, task, rest = begun
    damaged = copy_of(task)
    for k in range(2):
        before = bytes(ffi.buffer(damaged.native))
        assert scrub(damaged) == 0 and bytes(ffi.buffer(damaged.native)) == before
        hand(damaged, rest, k)
        for _ in range(20):  # amid the slices of a cycle
            assert step(damaged) == 1


PLACES_OF = {
    "filter.joints": (0, 3, 31), "filter.entries": (1, 12, 30), "filter.fast": (0, 4, 31),
    "filter.settings.steps": (30,), "filter.propagation.moving": (2, 20), "settings.every": (3, 31),
    "work.leads": (1, 30), "cursor": (2, 31), "intervals": (31,), "started": (0,), "used": (40,),
    "queue.tail": (1, 31),
}  # fmt: skip


@pytest.mark.parametrize("path", PLACES_OF)
def test_a_place_or_count_that_was_changed_is_refused(path: str, begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    """Nothing is changed by the refusal; the next start repairs it, and counts what was abandoned."""
    flight, task, rest = begun
    for bit in PLACES_OF[path]:
        damaged = copy_of(task)
        hand(damaged, rest)
        *way, name = path.split(".")
        place = damaged.native
        for one in way:
            place = getattr(place, one)
        setattr(place, name, getattr(place, name) ^ (1 << bit))
        before = bytes(ffi.buffer(damaged.native))
        assert step(damaged) == lib.ZYGOS_E_STATE, bit
        answer = damaged.judge(flight)
        assert not answer.published and answer.reason == lib.ZYGOS_REFINE_CORRUPT
        assert bytes(ffi.buffer(damaged.native)) == before
        damaged.start(flight)
        assert damaged.native.abandoned == (path not in ("started", "settings.every"))  # which is repaired
        damaged.cycles(selected(rest, slice(1, 30)))
        assert damaged.native.moving == 1 and damaged.native.filter.failed == 0 and scrub(damaged) == 0


def test_an_impossible_head_of_the_queue_is_refused(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    """The head belongs to the other task, and is under no seal."""
    _, task, rest = begun
    damaged = copy_of(task)
    damaged.native.queue.head ^= 1 << 31
    assert step(damaged) == lib.ZYGOS_E_STATE and hand(damaged, rest) == lib.ZYGOS_E_STATE
    assert scrub(damaged) == PLACES and scrub(damaged) == 0
    damaged.cycles(rest)
    assert damaged.native.abandoned == 0 and damaged.native.used > task.native.used + 40


def test_a_head_that_goes_elsewhere_brings_no_old_cycle_back(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    _, task, rest = begun
    damaged = copy_of(task)
    damaged.native.queue.head = (damaged.native.queue.head + 3) % 9
    steps = [step(damaged) for _ in range(5)]
    assert steps == [1, 1, 1, 0, 0] and damaged.native.spoiled == 3
    damaged.cycles(rest)
    assert damaged.native.restarts == task.native.restarts and damaged.native.used > task.native.used + 40


def test_a_cycle_that_was_changed_while_it_waited_is_not_used(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    _, task, rest = begun
    damaged = copy_of(task)
    hand(damaged, rest)
    damaged.native.queue.slot[damaged.native.queue.tail].tau[1] *= 2.0
    while step(damaged) == 1:
        pass
    assert damaged.native.spoiled == 1 and damaged.native.used == task.native.used
    damaged.cycles(selected(rest, slice(1, 20)))
    assert damaged.native.lost == task.native.lost + 1 and damaged.native.filter.failed == 0


@pytest.mark.parametrize("what", ["root", "x", "level", "previous"])
def test_values_that_were_changed_end_the_refinement(what: str, begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    flight, task, rest = begun
    damaged = copy_of(task)
    native = damaged.native
    if what in ("root", "x"):
        getattr(native.filter, what)[15] += 1e-9
    elif what == "level":
        native.level *= 1.0 + 1e-9
    else:
        native.previous.q[1] += 1e-9
    assert damaged.judge(flight).reason == lib.ZYGOS_REFINE_CORRUPT
    scrubbed = copy_of(damaged)
    assert scrub(scrubbed) == SUMS and scrubbed.native.abandoned == 1 and scrub(scrubbed) == 0
    damaged.cycles(rest)
    assert native.abandoned == 1 and native.filter.failed == 1
    answer = damaged.judge(flight)
    np.testing.assert_array_equal(answer.value, np.array(list(flight._estimate.value)[: len(answer.value)]))
    assert not answer.published and answer.reason == lib.ZYGOS_REFINE_CORRUPT
    damaged.start(flight)
    damaged.cycles(rest)
    assert native.filter.failed == 0 and native.used > 40 and native.corrupt == 0


def test_a_flipped_bit_of_the_settings_is_turned_back(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    """Without the refinement being abandoned; the top bit of the last word, too. Two bits are beyond repair."""
    flight, task, rest = begun
    damaged, settings = copy_of(task), ffi.addressof(task.native, "settings")
    memory = ffi.cast("unsigned char *", ffi.addressof(damaged.native, "settings"))
    size, before = ffi.sizeof("zygos_refine_settings_t"), bytes(ffi.buffer(task.native))
    for at in (0, 13, size - 1):
        memory[at] ^= 1 << (at % 8)
        assert scrub(damaged) == CONFIG and bytes(ffi.buffer(damaged.native)) == before
    memory[13] ^= 1
    memory[size - 1] ^= 0x80
    assert scrub(damaged) == lib.ZYGOS_E_STATE
    assert lib.zygos_refine_start(damaged.native, damaged._config, flight._estimate, ffi.NULL) == lib.ZYGOS_E_STATE
    assert lib.zygos_refine_init(damaged.native, damaged._config, settings) == 1
    damaged.start(flight)
    damaged.cycles(rest)
    assert damaged.native.used > 40


def test_tables_are_computed_again(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    flight, task, rest = begun
    damaged, again = copy_of(task), copy_of(task)
    damaged.native.filter.propagation.sign[3] *= 2.0
    hand(damaged, rest)
    assert step(damaged) == lib.ZYGOS_E_STATE
    assert scrub(damaged) == TABLES and damaged.native.abandoned == 1
    again.start(flight)
    damaged.start(flight)
    for name in ("propagation", "settings", "x", "root"):
        mine, theirs = (ffi.addressof(one.native.filter, name) for one in (damaged, again))
        assert bytes(ffi.buffer(mine)) == bytes(ffi.buffer(theirs)), name


def test_another_configuration_is_refused(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    flight, task, rest = begun
    damaged, config, out = copy_of(task), config_of(task.arm), ffi.new("zygos_refined_t *")
    config.joint[0].gear_ratio += 1.0
    hand(damaged, rest)
    before = bytes(ffi.buffer(damaged.native))
    assert step(damaged, config) == lib.ZYGOS_E_CONFIG
    assert lib.zygos_refine_scrub(damaged.native, config) == lib.ZYGOS_E_CONFIG
    assert lib.zygos_refine_start(damaged.native, config, flight._estimate, ffi.NULL) == lib.ZYGOS_E_CONFIG
    assert lib.zygos_refine_judge(damaged.native, config, flight._estimate, out) == lib.ZYGOS_E_CONFIG
    assert bytes(ffi.buffer(damaged.native)) == before
    damaged.native.config_seal ^= 1 << 17
    assert step(damaged) == lib.ZYGOS_E_CONFIG
    assert scrub(damaged) == PLACES and bytes(ffi.buffer(damaged.native)) == before


def test_a_task_that_was_never_prepared_is_refused(begun: tuple[Flight, OnboardRefiner, Cycles]) -> None:
    """Also one in random memory, and one whose magic number has two wrong bits; one wrong bit is repaired."""
    flight, task, rest = begun
    damaged, out = copy_of(task), ffi.new("zygos_refined_t *")
    cycle, config = cycles_to_native(selected(rest, slice(0, 1))), task._config
    for content in (bytes(SIZE), np.random.default_rng(0).bytes(SIZE)):
        ffi.memmove(damaged.native, content, SIZE)
        for verdict in (
            lib.zygos_refine_start(damaged.native, config, flight._estimate, ffi.NULL),
            lib.zygos_refine_cycle(damaged.native, cycle),
            lib.zygos_refine_step(damaged.native, config),
            lib.zygos_refine_scrub(damaged.native, config),
            lib.zygos_refine_judge(damaged.native, config, flight._estimate, out),
        ):
            assert verdict == lib.ZYGOS_E_ORDER
        assert bytes(ffi.buffer(damaged.native)) == content
    damaged = copy_of(task)
    damaged.native.magic ^= 1 << 9
    assert step(damaged) == lib.ZYGOS_E_ORDER and scrub(damaged) == PLACES
    assert bytes(ffi.buffer(damaged.native)) == bytes(ffi.buffer(task.native))
    damaged.native.magic ^= 5
    assert scrub(damaged) == lib.ZYGOS_E_ORDER


@pytest.mark.parametrize(("member", "value", "code"), [
    ("joints", 0, "JOINTS"), ("joints", 8, "JOINTS"), ("joints", 2**31, "JOINTS"), ("period_s", 0.0, "PERIOD"),
    ("period_s", 1e300, "PERIOD"), ("period_s", float("nan"), "PERIOD"),
])  # fmt: skip
def test_a_configuration_that_cannot_be_gives_no_settings(member: str, value: float, code: str) -> None:
    config, settings = config_of(Case().arm), ffi.new("zygos_refine_settings_t *")
    task = ffi.new("zygos_refine_t *")
    assert lib.zygos_refine_defaults(settings, config) == 1
    before = bytes(ffi.buffer(settings))
    setattr(config, member, value)
    assert lib.zygos_refine_defaults(settings, config) == getattr(lib, f"ZYGOS_E_{code}")
    assert bytes(ffi.buffer(settings)) == before
    assert lib.zygos_refine_init(task, config, settings) == getattr(lib, f"ZYGOS_E_{code}")
    assert lib.zygos_refine_step(task, config) == lib.ZYGOS_E_ORDER

# SPDX-License-Identifier: MIT
"""zygos_arm_solve(): the same estimate as from a copy, and a state that flies on as if its arcs had ended."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from arcs_support import KINDS, run
from flight_support import copy_of, part
from state_support import config_of_its_own, lose_the_way, sums

from zygos.native.flight import REASONS, Estimate, Flight, config_of, ffi, lib

CORRUPT = REASONS[lib.ZYGOS_REASON_CORRUPT]


@cache
def flown(kind: str, cycles: int, memory_s: float | None) -> Flight:
    arm, motion = run(kind)
    flight = Flight(replace(arm, memory_s=memory_s))
    flight.cycles(part(motion, 0, cycles))
    return flight


def state_of(kind: str, cycles: int | None = None, memory_s: float | None = None) -> Flight:
    """A copy that may be changed."""
    return copy_of(flown(kind, cycles or len(run(kind)[1]), memory_s))


def in_place(flight: Flight) -> tuple[int, Any]:
    solver, out = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
    return int(lib.zygos_arm_solve(flight.native, solver, out)), out


def same(out: Any, copied: Estimate) -> None:
    p = len(copied.names)
    for name in ("value", "sigma", "half95", "solution"):
        np.testing.assert_allclose(list(getattr(out, name))[:p], getattr(copied, name), rtol=1e-9, err_msg=name)
    for name in ("cycle", "accepted", "refused", "blocks", "rank"):
        assert getattr(out, name) == getattr(copied, name)
    assert REASONS[out.reason] == copied.reason


@pytest.mark.slow(only=["ground-*"])
@pytest.mark.parametrize(
    ("kind", "left", "memory_s"),
    [("planar", 0, None), ("planar", 100, None), ("planar", 7, 40.0), ("spatial", 7, None), ("ground", 0, None)],
)
def test_the_estimate_is_that_of_a_copy(kind: str, left: int, memory_s: float | None) -> None:
    """Also where cycles wait in buffers, where an arc is closing, and where the sums fade when it ends."""
    flight = state_of(kind, len(run(kind)[1]) - left, memory_s)
    ended = copy_of(flight)
    if memory_s is not None:
        assert lib.zygos_arm_end_arcs(ended.native) == 1
    copied = ended.estimate()
    answer, out = in_place(flight)
    assert answer == 1
    assert copied.validity != "refused"
    same(out, copied)


@pytest.mark.parametrize(("kind", "memory_s"), [("planar", None), ("planar", 40.0), ("spatial", None)])
def test_it_leaves_what_the_end_of_the_arcs_leaves(kind: str, memory_s: float | None) -> None:
    """What is left of the solver's matrices is not read, whatever it is: also where the next arc ends with a buffer
    that is not full. Where nothing is open there is nothing to end."""
    motion = run(kind)[1]
    first = 3 * len(motion) // 4
    solved, ended = state_of(kind, first, memory_s), state_of(kind, first, memory_s)
    assert in_place(solved)[0] == 1
    assert lib.zygos_arm_end_arcs(ended.native) == 1
    again_ended = copy_of(ended)
    assert lib.zygos_arm_end_arcs(again_ended.native) == 1
    assert ffi.buffer(again_ended.native) == ffi.buffer(ended.native)
    if memory_s is None:  # otherwise sums have faded, too
        numbers, others = (np.frombuffer(ffi.buffer(one.native), np.float64) for one in (solved, ended))
        numbers[numbers.view(np.uint64) != others.view(np.uint64)] = np.nan
    for one in (solved, ended):
        one.cycles(part(motion, first, len(motion) - 3))
    expected = ended.estimate()
    found = solved.estimate()
    assert np.isfinite(found.value).any()
    np.testing.assert_allclose(found.value, expected.value, rtol=1e-9)
    np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-9)
    for one, other in zip(solved.normal_equations(), ended.normal_equations(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13 * np.abs(other).max())
    assert found.accepted == expected.accepted


def test_arcs_of_rows_that_are_not_configured_need_no_end() -> None:
    """Of joint rows alone there are no arcs, and the sums of other rows stay empty."""
    arm, motion = run("ground")
    config = config_of(arm)
    config.arc_cycles = config.impulse_arc_cycles = 0
    flight = Flight(arm)
    assert lib.zygos_arm_init(flight.native, config) == 1
    flight.cycles(part(motion, 0, 3000))
    before = flight.blocks()
    assert (before.energy, before.motors, before.momentum) == ([], [], [])
    assert sum(count for _, count in before.joints) > 0.0
    assert lib.zygos_arm_end_arcs(flight.native) == 1
    for (found, count), (sums_before, count_before) in zip(flight.blocks().joints, before.joints, strict=True):
        np.testing.assert_array_equal(found, sums_before)
        assert count == count_before
    assert in_place(flight)[0] == 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_flight_goes_on(kind: str) -> None:
    """Ending the arcs in between loses their constants and no more: the estimates agree within their intervals."""
    motion = run(kind)[1]
    first = 3 * len(motion) // 4
    flight, straight = state_of(kind, first), state_of(kind)
    assert in_place(flight)[0] == 1
    flight.cycles(part(motion, first, len(motion)))
    assert lib.zygos_arm_scrub(flight.native, config_of_its_own(flight)) == 0
    answer, out = in_place(flight)
    whole = straight.estimate()
    assert answer == 1
    assert whole.accepted - 20 < out.accepted <= whole.accepted  # the last arc may be too short to be of use
    p = len(flight.names)
    known = np.isfinite(whole.value) & np.isfinite(list(out.value)[:p])
    assert known.sum() >= 0.8 * np.isfinite(whole.value).sum() > 9
    off = (np.array(list(out.value)[:p]) - whole.value)[known] / whole.half95[known]
    assert np.abs(off).max() < 1.0


def test_the_guard_leaves_an_arc_out_as_when_it_ends() -> None:
    motion = run("planar")[1]
    flight = state_of("planar", 700)
    assert flight.estimate().validity == "valid"
    assert flight.adopt()
    wrong = part(motion, 700, 800)
    flight.cycles(replace(wrong, tau=3.0 * wrong.tau))
    left_out = flight.left_out[0]
    answer, out = in_place(flight)
    assert answer == 1
    assert sum(out.left_out) == flight.left_out[0] > left_out
    # the arc is too short to be compared by itself, and no estimate is adopted before that
    assert lib.zygos_arm_adopt(flight.native, out) == 0


def test_misuse_is_refused() -> None:
    flight = state_of("planar")
    solver, out = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
    for arguments in ((ffi.NULL, solver, out), (flight.native, ffi.NULL, out), (flight.native, solver, ffi.NULL)):
        assert lib.zygos_arm_solve(*arguments) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_end_arcs(ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_arm_solve(ffi.new("zygos_arm_t *"), solver, out) == lib.ZYGOS_E_ORDER
    lose_the_way(flight)
    before = copy_of(flight)
    assert lib.zygos_arm_end_arcs(flight.native) == lib.ZYGOS_E_STATE
    assert in_place(flight)[0] == lib.ZYGOS_E_STATE
    assert ffi.buffer(flight.native) == ffi.buffer(before.native)


def test_too_little_data_is_said() -> None:
    flight = Flight(run("planar")[0])
    answer, out = in_place(flight)
    assert (answer, out.validity, REASONS[out.reason]) == (0, lib.ZYGOS_REFUSED, REASONS[lib.ZYGOS_REASON_NO_DATA])
    assert np.isnan(list(out.value)[: len(flight.names)]).all()


@pytest.mark.parametrize("wrong", ["bit", np.nan, np.inf])
def test_sums_that_changed_are_noticed_or_cost_the_open_arc(wrong: Any) -> None:
    """Those of closed arcs are refused until they are scrubbed; an open arc that does not match, or whose noise is no
    number, is dropped and counted, and the others are solved."""
    begun = state_of("planar", 800)
    before, damaged, answers = begun.estimate(), copy_of(begun), {0: 0, 1: 0}
    for place in sums(begun.native, np.random.default_rng(0)):
        ffi.memmove(damaged.native, begun.native, ffi.sizeof("zygos_arm_t"))
        if wrong == "bit":
            place.flip(damaged.native, 52)
        else:
            place.values(damaged.native)[0] = wrong
        corrupt = damaged.estimate().reason == CORRUPT
        answer, out = in_place(damaged)
        if answer == lib.ZYGOS_E_STATE:  # an impossible number beside sums, which a scrub removes
            lib.zygos_arm_scrub(damaged.native, config_of_its_own(begun))
            assert in_place(damaged)[0] == 1, place
            continue
        answers[answer] += corrupt
        p = out.parameters
        if answer == 0:
            assert corrupt and REASONS[out.reason] == CORRUPT, place
            assert lib.zygos_arm_scrub(damaged.native, config_of_its_own(begun)) > 0, place
        else:
            assert (np.abs(np.array(list(out.value)[:p]) - before.value) < 3.0 * before.half95).all(), place
            found = lib.zygos_arm_scrub(damaged.native, config_of_its_own(begun))
            if found == lib.ZYGOS_SCRUBBED_TABLES:  # no sum
                continue
            assert found in (0, lib.ZYGOS_SCRUBBED_BLOCKS) and (found > 0) == corrupt, place
            assert damaged.native.quarantined == corrupt
        assert lib.zygos_arm_scrub(damaged.native, config_of_its_own(begun)) == 0
    assert min(answers.values()) >= 3

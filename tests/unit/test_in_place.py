"""zygos_solve_in_place(): the same estimate as from a copy, and a state that flies on as if its arcs had ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from flight_support import part
from motion_support import random_ground
from runs_support import trajectory_of

from conftest import EXAMPLE
from zygos.arm import Arm, load_arm
from zygos.model.model import load_model
from zygos.native.flight import REASONS, Flight, config_of, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

KINDS = ("planar", "spatial", "ground")


@cache
def run(kind: str) -> tuple[Arm, Cycles]:
    """Rows of every kind, in arcs of which several are closed and one is open; joint rows on the ground."""
    if kind == "ground":
        known = random_ground(3, "spatial", 6000)
        return known.arm, known.cycles(0)
    folder = EXAMPLE if kind == "planar" else EXAMPLE.parent / "spatial"
    arm = load_arm(folder / "arm.toml")
    arm = replace(arm, arc_max_s=6.0, impulse_arc_s=2.0, momentum_max_s=4.0)
    scenario = replace(load_scenario(folder / "scenario.toml"), duration_s=50.0 if kind == "planar" else 20.0)
    return arm, trajectory_of(arm, load_model(folder / "model.toml"), scenario, seeds=[0], noise=True).cycles(0)


@cache
def flown(kind: str, cycles: int) -> bytes:
    arm, motion = run(kind)
    flight = Flight(arm)
    flight.cycles(part(motion, 0, cycles))
    return bytes(ffi.buffer(flight.native))


def again(kind: str, cycles: int | None = None) -> Flight:
    arm, motion = run(kind)
    flight = Flight(arm)
    ffi.memmove(flight.native, flown(kind, cycles or len(motion)), ffi.sizeof("zygos_t"))
    return flight


def in_place(flight: Flight) -> tuple[int, Any]:
    solver, out = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
    return int(lib.zygos_solve_in_place(flight.native, solver, out)), out


def memory(flight: Flight) -> bytes:
    """Of the state, but for rows that waited in buffers."""
    copy = ffi.new("zygos_t *", flight.native[0])
    fill_rows(copy, 0.0)
    return bytes(ffi.buffer(copy))


def fill_rows(native: Any, value: float) -> None:
    for buffer in native.accumulator.buffer:
        ffi.memmove(buffer.pair, np.full(ffi.sizeof(buffer.pair) // 8, value), ffi.sizeof(buffer.pair))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("left", [0, 7, 100])
def test_the_estimate_is_that_of_a_copy(kind: str, left: int) -> None:
    """Also where cycles wait in buffers, and where an arc is closing."""
    flight = again(kind, len(run(kind)[1]) - left)
    copied = flight.estimate()
    answer, out = in_place(flight)
    p = len(flight.names)
    assert answer == 1
    assert copied.validity != "refused"
    for name in ("value", "sigma", "half95", "solution"):
        np.testing.assert_allclose(list(getattr(out, name))[:p], getattr(copied, name), rtol=1e-9, err_msg=name)
    assert (out.cycle, out.accepted, out.refused, out.blocks, out.rank) == (
        copied.cycle,
        copied.accepted,
        copied.refused,
        copied.blocks,
        copied.rank,
    )
    assert REASONS[out.reason] == copied.reason


@pytest.mark.parametrize("kind", KINDS)
def test_it_leaves_what_the_end_of_the_arcs_leaves(kind: str) -> None:
    """Nothing is left of the solver's matrices, so that the next rows are added to empty buffers."""
    solved, ended = again(kind), again(kind)
    assert in_place(solved)[0] == 1
    assert lib.zygos_end_arcs(ended.native) == 1
    native = ended.native
    lib.zygos_accumulator_apply_fade(ffi.addressof(native, "accumulator"))
    lib.zygos_motor_sums_apply_fade(ffi.addressof(native, "motor_sums"))
    lib.zygos_momentum_sums_apply_fade(ffi.addressof(native, "momentum_sums"))
    assert memory(solved) == memory(ended)
    sums = solved.native.accumulator
    assert sums.count == sums.fresh == sums.open
    assert lib.zygos_end_arcs(ended.native) == 1  # nothing is open
    assert memory(solved) == memory(ended)


@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_what_the_solver_leaves_where_rows_wait_is_not_read(kind: str) -> None:
    """Whatever there is when an arc begins: also where the next one ends with a buffer that is not full."""
    motion = run(kind)[1]
    first, rest = len(motion) // 2, len(motion) - 3
    flights = [again(kind, first), again(kind, first)]
    for flight, value in zip(flights, (0.0, np.nan), strict=True):
        assert in_place(flight)[0] == 1
        fill_rows(flight.native, value)
        flight.cycles(part(motion, first, rest))
    assert memory(flights[0]) == memory(flights[1])
    found = [flight.estimate() for flight in flights]
    assert np.isfinite(found[1].value).any()
    np.testing.assert_array_equal(found[0].value, found[1].value)


def test_every_entry_fades_that_waits_for_it() -> None:
    """What the end of an arc leaves to do for the next solution: one half is exact."""
    flight = again("spatial")
    assert lib.zygos_end_arcs(flight.native) == 1
    sums = flight.native.accumulator
    lib.zygos_accumulator_apply_fade(ffi.addressof(sums))
    rows = sums.width - 1
    entries = rows * (rows + 1) // 2
    gram, total = list(sums.noise_closed.gram)[:entries], list(sums.noise_closed.sum)[:rows]
    assert gram[0] > 0.0
    sums.noise_fade = 0.5
    lib.zygos_accumulator_apply_fade(ffi.addressof(sums))
    assert list(sums.noise_closed.gram)[:entries] == [0.5 * x for x in gram]
    assert list(sums.noise_closed.sum)[:rows] == [0.5 * x for x in total]
    assert sums.noise_fade == 1.0


FADING = {
    "accumulator": ("instants", "square", "overlap"),
    "motor_sums": ("instants", "total"),
    "momentum_sums": ("instants",),
}


def numbers(block: object, member: str) -> list[float]:
    found = getattr(block, member)
    return [found] if isinstance(found, float) else list(found)


@pytest.mark.parametrize("name", FADING)
def test_every_number_of_a_block_fades_that_waits_for_it(name: str) -> None:
    flight = again("spatial")
    sums = getattr(flight.native, name)
    block = sums.block[sums.order[1] if name == "accumulator" else 1]
    rows = block.joint[0] if name == "motor_sums" else block.rows if name == "momentum_sums" else block
    read = [(block, member) for member in FADING[name]] + [(rows, member) for member in ("gram", "sum")]
    before = [numbers(*one) for one in read]
    assert all(any(values) for values in before)
    block.fade = 0.5
    getattr(lib, f"zygos_{name}_apply_fade")(ffi.addressof(sums))
    assert block.fade == 1.0
    assert [numbers(*one) for one in read] == [[0.5 * value for value in values] for values in before]


@pytest.mark.parametrize("share", [0.3, 0.9, 1.0])
def test_what_counts_blocks_counts_those_that_are_left(share: float) -> None:
    """After the oldest blocks were dropped, of which those of an arc may end together."""
    flight = again("planar")
    assert lib.zygos_end_arcs(flight.native) == 1
    sums = flight.native.accumulator
    pointer = ffi.addressof(sums)
    before = {name: int(getattr(sums, name)) for name in ("open", "newest", "window", "arcs")}
    until = lib.zygos_accumulator_at(pointer, int(share * before["open"]) - 1).end
    ends = [lib.zygos_accumulator_at(pointer, k).end for k in range(before["open"])]
    assert sorted(ends) == ends
    drop = sum(end <= until for end in ends)
    arcs = lib.zygos_accumulator_drop_until(pointer, until)
    assert sums.open == sums.count == before["open"] - drop
    assert sums.arcs == before["arcs"] - arcs
    assert 0 < before["newest"] < before["open"]
    assert sums.newest == max(before["newest"] - drop, 0)
    assert sums.window == max(before["window"] - drop, 0)


def test_arcs_of_rows_that_are_not_configured_need_no_end() -> None:
    """Of joint rows alone there are no arcs, and the sums of other rows stay empty."""
    arm, motion = run("ground")
    config = config_of(arm)
    config.arc_cycles = config.impulse_arc_cycles = 0
    flight = Flight(arm)
    assert lib.zygos_init(flight.native, config) == 1
    flight.cycles(part(motion, 0, 3000))
    sums = flight.native
    assert (sums.accumulator.open, sums.motor_sums.count) == (0, 0)
    assert sums.joint_sums.weight[0] > 0.0
    kinds = ("accumulator", "motor_sums", "momentum_sums")
    before = [bytes(ffi.buffer(ffi.addressof(sums, kind))) for kind in kinds]
    assert lib.zygos_end_arcs(flight.native) == 1
    assert [bytes(ffi.buffer(ffi.addressof(sums, kind))) for kind in kinds] == before
    assert in_place(flight)[0] == 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_flight_goes_on(kind: str) -> None:
    """Ending the arcs in between loses their constants and no more: the estimates agree within their intervals."""
    motion = run(kind)[1]
    half = len(motion) // 2
    flight, straight = again(kind, half), again(kind)
    assert in_place(flight)[0] == 1
    flight.cycles(part(motion, half, len(motion)))
    assert lib.zygos_scrub(flight.native, ffi.new("zygos_config_t *", flight.native.config)) == 0
    answer, out = in_place(flight)
    whole = straight.estimate()
    assert answer == 1
    assert whole.accepted - 20 < out.accepted <= whole.accepted  # the last arc may be too short to be of use
    p = len(flight.names)
    known = np.isfinite(whole.value) & np.isfinite(list(out.value)[:p])
    assert known.sum() >= 0.8 * p
    off = (np.array(list(out.value)[:p]) - whole.value)[known] / whole.half95[known]
    assert np.abs(off).max() < 1.0


def test_forgetting_is_that_of_arcs_that_end() -> None:
    arm, motion = run("planar")
    flights = [Flight(arm), Flight(arm)]
    for flight in flights:
        config = ffi.new("zygos_config_t *", flight.native.config)
        config.forgetting_factor = 0.999
        assert lib.zygos_init(flight.native, config) == 1
        flight.cycles(part(motion, 0, 700))
    answer, out = in_place(flights[0])
    assert answer == 1
    assert lib.zygos_end_arcs(flights[1].native) == 1
    copied = flights[1].estimate()
    p = len(flights[0].names)
    np.testing.assert_allclose(list(out.value)[:p], copied.value, rtol=1e-9)
    np.testing.assert_allclose(list(out.sigma)[:p], copied.sigma, rtol=1e-9)


def test_the_guard_leaves_an_arc_out_as_when_it_ends() -> None:
    motion = run("planar")[1]
    flight = again("planar", 700)
    assert flight.estimate().validity == "valid"
    assert flight.adopt()
    wrong = part(motion, 700, 800)
    flight.cycles(replace(wrong, tau=3.0 * wrong.tau))
    left_out = flight.native.guard.left_out[0]
    answer, out = in_place(flight)
    assert answer == 1
    assert out.left_out[0] == flight.native.guard.left_out[0] > left_out
    assert lib.zygos_adopt(flight.native, out) == 1


def test_the_integrals_of_motor_rows_begin_anew_behind_the_end_of_an_arc() -> None:
    flight, motion = again("planar", 700), run("planar")[1]
    joints = slice(0, flight.arm.n)
    assert np.all(np.array(list(flight.native.impulse.impulse))[joints] != 0.0)
    assert lib.zygos_end_arcs(flight.native) == 1
    flight.cycles(part(motion, 700, 701))
    assert list(flight.native.impulse.impulse)[joints] == [0.0] * flight.arm.n
    assert list(flight.native.impulse.deflection_integral)[joints] == [0.0] * flight.arm.n


def test_misuse_is_refused() -> None:
    flight = again("planar")
    solver, out = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
    for arguments in ((ffi.NULL, solver, out), (flight.native, ffi.NULL, out), (flight.native, solver, ffi.NULL)):
        assert lib.zygos_solve_in_place(*arguments) == lib.ZYGOS_E_NULL
    assert lib.zygos_end_arcs(ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_solve_in_place(ffi.new("zygos_t *"), solver, out) == lib.ZYGOS_E_ORDER
    flight.native.accumulator.count ^= 1 << 20
    before = memory(flight)
    assert lib.zygos_end_arcs(flight.native) == lib.ZYGOS_E_STATE
    assert in_place(flight)[0] == lib.ZYGOS_E_STATE
    assert memory(flight) == before


def test_too_little_data_is_said() -> None:
    flight = Flight(run("planar")[0])
    answer, out = in_place(flight)
    assert (answer, out.validity, REASONS[out.reason]) == (0, lib.ZYGOS_REFUSED, REASONS[lib.ZYGOS_REASON_NO_DATA])
    assert np.isnan(list(out.value)[: len(flight.names)]).all()


def test_changed_memory_is_noticed_and_scrubbed() -> None:
    flight = again("planar")
    config = ffi.new("zygos_config_t *", flight.native.config)
    sums = flight.native.accumulator
    sums.block[sums.order[0]].gram[3] *= 1.5
    answer, out = in_place(flight)
    assert (answer, REASONS[out.reason]) == (0, REASONS[lib.ZYGOS_REASON_CORRUPT])
    assert lib.zygos_scrub(flight.native, config) == lib.ZYGOS_SCRUBBED_BLOCKS
    answer, out = in_place(flight)
    assert answer == 1
    assert out.validity == lib.ZYGOS_VALID


def test_an_open_arc_that_does_not_match_is_dropped_and_the_others_are_solved() -> None:
    flight = again("planar", 800)
    sums = flight.native.accumulator
    sums.block[sums.order[sums.count - 1]].gram[3] += 1e3
    answer, out = in_place(flight)
    assert answer == 1
    assert sums.quarantined == 1
    assert out.validity == lib.ZYGOS_VALID


def _energy_noise(native: Any) -> Any:
    return native.accumulator.noise_open[native.accumulator.parity].gram


def _momentum_noise(native: Any) -> Any:
    return native.momentum_sums.noise_arc[native.momentum_sums.parity].gram


@pytest.mark.parametrize("noise", [_energy_noise, _momentum_noise])
@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_noise_that_is_no_number_costs_one_arc(noise: Callable[[Any], Any], value: float) -> None:
    """What is rejected is not added with a factor of 0, which would be no number either."""
    flight = again("spatial", len(run("spatial")[1]) - 100)
    noise(flight.native)[4] = value
    answer, out = in_place(flight)
    assert answer == 1
    assert REASONS[out.reason] != REASONS[lib.ZYGOS_REASON_CORRUPT]
    assert flight.native.accumulator.quarantined + flight.native.momentum_sums.quarantined == 1
    config = ffi.new("zygos_config_t *", flight.native.config)
    assert lib.zygos_scrub(flight.native, config) == lib.ZYGOS_SCRUBBED_BLOCKS
    assert lib.zygos_scrub(flight.native, config) == 0


def test_noise_of_the_wrong_arc_is_not_resumed() -> None:
    flight = again("planar")
    flight.native.accumulator.parity ^= 1
    own = ffi.new("zygos_config_t *", flight.native.config)
    assert lib.zygos_resume(flight.native, own) == lib.ZYGOS_E_STATE
    assert in_place(flight)[0] == lib.ZYGOS_E_STATE

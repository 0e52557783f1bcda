"""zygos_scrub(): what memory errors change is found, and repaired or left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest
from flight_support import bytes_of, copy_of, part
from ground_support import seen, short_arm, torque_of
from soak_support import again, fly, resealed, settle, stored, with_all_rows

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import REASONS, Flight, encode, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Scenario

CONFIG, TABLES, PLACES, BLOCKS, SUMS = (
    lib.ZYGOS_SCRUBBED_CONFIG, lib.ZYGOS_SCRUBBED_TABLES, lib.ZYGOS_SCRUBBED_PLACES, lib.ZYGOS_SCRUBBED_BLOCKS,
    lib.ZYGOS_SCRUBBED_SUMS,
)  # fmt: skip
FLIPS = 2000
MOTION_ARCS = 3
"""Before the last call that finds nothing."""


@pytest.fixture(scope="module")
def motion(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(arm, model, scenario)


@pytest.fixture(scope="module")
def flown(arm: Arm, motion: Cycles) -> Flight:
    """A few arcs, verified, and half of another; no task is open."""
    out, rng = Flight(with_all_rows(arm)), np.random.default_rng(0)
    fly(out, motion, MOTION_ARCS, rng)
    pristine = ffi.new("zygos_config_t *", out.native.config)
    assert lib.zygos_scrub(out.native, pristine) == 0
    out.cycles(part(again(out.arm, motion, int(out.native.cycle) + 1, rng), 0, len(motion) // 2 + 37))
    settle(out)
    return out


@pytest.fixture
def flight(flown: Flight) -> Flight:
    """A copy that may be damaged."""
    return copy_of(flown)


def flip(struct: Any, member: str, bit: int, index: int = 0) -> None:
    """One bit of a member, or of an element of a member."""
    struct = struct[0] if ffi.typeof(struct).kind == "pointer" else struct
    kind = dict(ffi.typeof(struct).fields)[member].type
    size = ffi.sizeof(kind.item if kind.kind == "array" else kind)
    memory = ffi.buffer(ffi.addressof(struct, member))
    at = index * size + bit // 8
    memory[at] = bytes([memory[at][0] ^ 1 << bit % 8])


@pytest.fixture
def pristine(flown: Flight) -> Any:
    """The caller's own configuration."""
    return ffi.new("zygos_config_t *", flown.native.config)


def test_memory_that_nothing_has_changed_is_left_as_it_is(flight: Flight, pristine: Any) -> None:
    before = bytearray(bytes_of(flight.native))
    assert lib.zygos_scrub(flight.native, pristine) == 0
    place = next(field.offset for name, field in ffi.typeof("zygos_t").fields if name == "scrubbed")
    after = bytearray(bytes_of(flight.native))
    assert flight.native.scrubbed == flight.native.cycle
    before[place : place + 8] = after[place : place + 8]
    assert before == after


def test_the_configuration_is_that_of_the_caller_again(flight: Flight, pristine: Any) -> None:
    flip(flight.native.config, "period_s", 40)
    assert lib.zygos_scrub(flight.native, pristine) == CONFIG
    assert flight.native.config.period_s == pristine.period_s
    assert lib.zygos_scrub(flight.native, pristine) == 0


def test_a_configuration_of_the_caller_that_is_another_is_refused(flight: Flight, pristine: Any) -> None:
    before = bytes_of(flight.native)
    flip(pristine, "period_s", 40)
    assert lib.zygos_scrub(flight.native, pristine) == lib.ZYGOS_E_CONFIG
    assert lib.zygos_scrub(flight.native, ffi.addressof(flight.native, "config")) == lib.ZYGOS_E_CONFIG
    assert bytes_of(flight.native) == before


def test_where_no_two_configurations_agree_none_is_taken(flight: Flight, pristine: Any) -> None:
    """The caller's, the one in the state, and the checksum there are all different."""
    flip(pristine, "period_s", 40)
    flip(flight.native.config, "period_s", 41)
    before = bytes_of(flight.native)
    assert lib.zygos_scrub(flight.native, pristine) == lib.ZYGOS_E_CONFIG
    assert bytes_of(flight.native) == before


def test_a_checksum_that_changed_is_computed_again(flight: Flight, pristine: Any) -> None:
    flip(flight.native, "config_checksum", 40)
    assert lib.zygos_scrub(flight.native, pristine) == TABLES
    assert lib.zygos_scrub(flight.native, pristine) == 0


def _layout(native: Any) -> None:
    flip(native.column_map, "count", 3)


def _axes(native: Any) -> None:
    flip(native.geometry, "handedness", 62)


def _taps(native: Any) -> None:
    flip(native.smoother.taps[1][4], "slope", 50)


def _limit(native: Any) -> None:
    flip(native.smoother, "limit", 55)


def _list(native: Any) -> None:
    flip(native.noise.signal[0], "place", 6)


def _variance(native: Any) -> None:
    flip(native.noise, "rate_variance", 52)


def _motors(native: Any) -> None:
    flip(native.motor_sums, "noise", 51)


def _momentum(native: Any) -> None:
    flip(native.momentum_sums, "deviation", 51)


TABLE: tuple[Callable[[Any], None], ...] = (_layout, _axes, _taps, _limit, _list, _variance, _motors, _momentum)


@pytest.mark.parametrize("damage", TABLE)
def test_what_follows_from_the_configuration_is_computed_again(
    flight: Flight, flown: Flight, pristine: Any, damage: Callable[[Any], None]
) -> None:
    """And arcs are dropped that ended behind the last call: here, the open one of the energy."""
    damage(flight.native)
    assert lib.zygos_scrub(flight.native, pristine) & TABLES
    for name in ("column_map", "geometry", "noise"):
        assert bytes_of(ffi.addressof(flight.native, name)) == bytes_of(ffi.addressof(flown.native, name))
    for name in ("taps", "limit", "gyro"):
        ours, theirs = (ffi.buffer(getattr(one.native.smoother, name))[:] for one in (flight, flown))
        assert ours == theirs
    sums = flight.native.accumulator
    assert sums.count == sums.open
    assert all(sums.block[place].end <= flown.native.scrubbed for place in sums.order[0 : sums.open])
    assert lib.zygos_scrub(flight.native, pristine) == 0
    assert flight.estimate().validity in ("valid", "partial")


def test_arcs_that_a_changed_table_may_have_spoiled_are_dropped(flight: Flight, motion: Cycles, pristine: Any) -> None:
    verified = int(flight.native.scrubbed)
    _variance(flight.native)
    fly(flight, motion, 2, np.random.default_rng(1))
    sums = flight.native.accumulator
    assert sums.block[sums.order[sums.open - 1]].end > verified
    assert lib.zygos_scrub(flight.native, pristine) & TABLES
    assert sums.block[sums.order[sums.open - 1]].end <= verified


PLACE = (
    ("config", "joints", 0), ("column_map", "body", 0), ("smoother", "window", 0), ("smoother", "position", 0),
    ("balance", "torque_at", 0), ("accumulator", "count", 0), ("accumulator", "open", 0), ("accumulator", "width", 0),
    ("accumulator", "filling", 0), ("momentum_sums", "columns", 0),
    *((struct, member, joint) for joint in (0, 1) for struct, member in (
        ("column_map", "joint"), ("column_map", "rotor"), ("motor_sums.column_map", "count"),
    )),
)  # fmt: skip


@pytest.mark.parametrize(("struct", "member", "index"), PLACE)
@pytest.mark.parametrize("bit", [4, 31])
def test_no_cycle_is_processed_with_an_impossible_place(
    flight: Flight, motion: Cycles, pristine: Any, struct: str, member: str, index: int, bit: int
) -> None:
    flip(attrgetter(struct)(flight.native), member, bit, index)
    before = bytes_of(flight.native)
    cycle = ffi.new("zygos_cycle_t *")
    assert lib.zygos_cycle(flight.native, cycle) == lib.ZYGOS_E_STATE
    assert bytes_of(flight.native) == before
    assert lib.zygos_scrub(flight.native, pristine) > 0
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 1, np.random.default_rng(1))
    assert flight.estimate().validity == "valid"


MOVING = (
    ("", "arc", 3), ("", "ending", 0), ("smoother", "position", 1), ("smoother", "filled", 2), ("balance", "work", 40),
    ("balance", "dissipation", 50), ("balance", "theta", 20), ("balance", "dissipation_rate", 52),
    ("impulse", "impulse", 45), ("impulse", "deflection_integral", 51), ("impulse", "past", 30),
    ("momentum", "attitude", 48), ("momentum", "past", 35), ("motor_sums", "cycles", 2), ("momentum_sums", "cycles", 2),
    ("previous", "reported", 40), ("previous", "q", 41), ("previous", "theta", 42),
    ("accumulator", "length", 51), ("accumulator", "segment", 50),
)  # fmt: skip


@pytest.mark.parametrize(("struct", "member", "bit"), MOVING)
def test_no_cycle_is_processed_with_an_integral_or_a_count_that_changed(
    flight: Flight, motion: Cycles, pristine: Any, struct: str, member: str, bit: int
) -> None:
    """Only the open arcs are dropped."""
    flip(getattr(flight.native, struct) if struct else flight.native, member, bit)
    before, arcs = bytes_of(flight.native), flight.native.accumulator.arcs
    assert lib.zygos_cycle(flight.native, ffi.new("zygos_cycle_t *")) == lib.ZYGOS_E_STATE
    assert bytes_of(flight.native) == before
    assert lib.zygos_scrub(flight.native, pristine) & PLACES
    assert flight.native.accumulator.count == flight.native.accumulator.open
    assert flight.native.accumulator.arcs == arcs
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 1, np.random.default_rng(1))
    assert flight.estimate().validity == "valid"


@pytest.mark.parametrize("copy", [0, 1])
def test_a_torque_that_changed_while_it_waited_stops_the_cycles(
    flight: Flight, motion: Cycles, pristine: Any, copy: int
) -> None:
    balance = flight.native.balance
    at = (balance.torque_at + 2) % (flight.native.config.smoother_half_width + 1)
    place = 7 + ffi.sizeof(balance.torque[0][0]) * (copy * len(balance.torque[0]) + at)
    memory = ffi.buffer(ffi.addressof(balance, "torque"))
    memory[place] = bytes([memory[place][0] ^ 64])
    rest = part(again(flight.arm, motion, int(flight.native.cycle) + 1, np.random.default_rng(1)), 0, 10)
    flight.cycles(replace(rest, flags=np.zeros(len(rest), dtype=np.uint32)))
    assert lib.zygos_scrub(flight.native, pristine) & TABLES
    assert flight.native.accumulator.count == flight.native.accumulator.open


@pytest.mark.parametrize("member", ["count", "open", "newest", "window", "target", "arcs", "checksum"])
@pytest.mark.parametrize("bit", [0, 2, 30])
def test_what_tells_which_blocks_there_are_is_flipped_back(
    flight: Flight, flown: Flight, pristine: Any, member: str, bit: int
) -> None:
    """Nothing is lost."""
    flip(flight.native.accumulator, member, bit)
    lib.zygos_scrub(flight.native, pristine)
    assert bytes_of(ffi.addressof(flight.native, "accumulator")) == bytes_of(ffi.addressof(flown.native, "accumulator"))


@pytest.mark.parametrize("kind", ["motor_sums", "momentum_sums"])
@pytest.mark.parametrize("member", ["count", "target"])
def test_what_tells_which_blocks_of_other_rows_there_are_is_flipped_back(
    flight: Flight, flown: Flight, pristine: Any, kind: str, member: str
) -> None:
    for bit in (0, 2, 30):
        flip(getattr(flight.native, kind), member, bit)
        lib.zygos_scrub(flight.native, pristine)
        assert bytes_of(ffi.addressof(flight.native, kind)) == bytes_of(ffi.addressof(flown.native, kind))


@pytest.mark.parametrize("kind", ["accumulator", "motor_sums", "momentum_sums"])
@pytest.mark.parametrize(("change", "value"), [("forget", 0.5), ("drop_until", 0), ("drop_after", 1 << 40)])
def test_it_is_flipped_back_before_the_blocks_change(
    flight: Flight, flown: Flight, kind: str, change: str, value: float
) -> None:
    """The checksum that is made behind a change must not confirm what was wrong before it."""
    whole = copy_of(flown)
    flip(getattr(flight.native, kind), "target", 2)
    for one in (whole, flight):
        getattr(lib, f"zygos_{kind}_{change}")(ffi.addressof(one.native, kind), value)
    assert bytes_of(ffi.addressof(flight.native, kind)) == bytes_of(ffi.addressof(whole.native, kind))


def closed_block(native: Any) -> Any:
    """The third block of the energy rows."""
    return native.accumulator.block[native.accumulator.order[2]]


def _energy(native: Any) -> None:
    flip(closed_block(native), "gram", 52, 7)


def _deviation(native: Any) -> None:
    last_row = native.accumulator.width * (native.accumulator.width - 1) // 2
    flip(closed_block(native), "gram", 52, last_row + 3)


def _motor(native: Any) -> None:
    flip(native.motor_sums.block[1].joint[0], "gram", 52, 2)


def _rows(native: Any) -> None:
    flip(native.momentum_sums.block[1].rows, "gram", 52, 2)


@pytest.mark.parametrize("damage", [_energy, _deviation, _motor, _rows])
def test_a_block_that_does_not_match_is_dropped_and_no_other(
    flight: Flight, flown: Flight, pristine: Any, damage: Callable[[Any], None]
) -> None:
    def blocks(one: Flight) -> int:
        native = one.native
        return int(native.accumulator.open + native.motor_sums.count + native.momentum_sums.count)

    damage(flight.native)
    assert flight.estimate().validity == "refused"
    assert lib.zygos_scrub(flight.native, pristine) == BLOCKS
    assert blocks(flight) == blocks(flown) - 1
    assert flight.native.quarantined == 1
    assert lib.zygos_scrub(flight.native, pristine) == 0
    there, before = flight.estimate(), flown.estimate()
    assert there.validity == before.validity
    assert (np.abs(there.value - before.value) < 3.0 * before.sigma).all()


def test_a_block_shares_no_instants_with_one_that_was_dropped(flight: Flight, pristine: Any) -> None:
    sums = flight.native.accumulator
    before = sums.block[sums.order[1]]
    assert before.overlap > 0.0
    _energy(flight.native)
    assert lib.zygos_scrub(flight.native, pristine) == BLOCKS
    assert before.overlap == 0.0


IMPOSSIBLE = (
    ("accumulator", "width", 13), ("accumulator", "count", 65), ("accumulator", "open", 60),
    ("accumulator", "newest", 60), ("accumulator", "window", 60), ("accumulator", "target", 0.5),
    ("accumulator", "target", float("nan")), ("motor_sums", "count", 33), ("momentum_sums", "count", 17),
)  # fmt: skip


@pytest.mark.parametrize(("kind", "member", "value"), IMPOSSIBLE)
def test_a_count_that_cannot_be_is_found_also_where_its_checksum_matches(
    kind: str, member: str, value: float, flight: Flight, motion: Cycles, pristine: Any
) -> None:
    """Sums of that kind begin anew, those of the other kinds stay."""
    sums = getattr(flight.native, kind)
    others = {name: bytes_of(ffi.addressof(flight.native, name)) for name in PARTS[:3] if name != kind}
    assert resealed(sums) == sums.checksum  # as the library computes it
    setattr(sums, member, value)
    sums.checksum = resealed(sums)
    assert lib.zygos_scrub(flight.native, pristine) & SUMS
    assert sums.count == 0 and sums.corrupt == 0
    if member != "width":  # a place, with which the open arcs of all kinds are dropped
        assert others == {name: bytes_of(ffi.addressof(flight.native, name)) for name in others}
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 3, np.random.default_rng(1))
    assert flight.estimate().validity == "valid"


def _energy_instants(native: Any, instants: float) -> None:
    sums = native.accumulator
    block = closed_block(native)
    assert checksum_of(sums, block) == block.checksum  # as the library computes it
    block.instants = instants
    block.checksum = checksum_of(sums, block)


def checksum_of(sums: Any, block: Any) -> int:
    deviation = lib.zygos_accumulator_deviation(ffi.addressof(sums), ffi.addressof(block))
    checksum = lib.zygos_checksum_doubles(1, deviation, sums.width)
    for number in (block.instants, block.square, block.overlap, block.fade, *block.variance):
        checksum = lib.zygos_checksum_doubles(checksum, ffi.new("double *", number), 1)
    return int(lib.zygos_checksum_number(checksum, block.end))


def _motor_total(native: Any, instants: float) -> None:
    block = native.motor_sums.block[1]
    block.total = instants
    checksum = lib.zygos_checksum_doubles(1, block.instants, len(block.instants))
    checksum = lib.zygos_checksum_doubles(checksum, ffi.new("double[]", [block.total, block.fade]), 2)
    block.checksum = lib.zygos_checksum_number(checksum, block.end)


def _momentum_instants(native: Any, instants: float) -> None:
    block = native.momentum_sums.block[1]
    block.instants = instants
    checksum = lib.zygos_checksum_doubles(1, ffi.new("double[]", [instants, block.fade]), 2)
    block.checksum = lib.zygos_checksum_number(checksum, block.end)


@pytest.mark.parametrize("change", [_energy_instants, _motor_total, _momentum_instants])
@pytest.mark.parametrize("instants", [-1.0, 1e300, float("nan")])
def test_instants_that_cannot_be_are_found_also_where_their_checksum_matches(
    change: Callable[[Any, float], None], instants: float, flight: Flight, flown: Flight, pristine: Any
) -> None:
    change(flight.native, instants)
    assert lib.zygos_scrub(flight.native, pristine) == BLOCKS
    assert flight.native.quarantined == 1
    assert lib.zygos_scrub(flight.native, pristine) == 0
    there, before = flight.estimate(), flown.estimate()
    assert there.validity == before.validity
    assert (np.abs(there.value - before.value) < 3.0 * before.sigma).all()


@pytest.mark.parametrize("kind", ["accumulator", "momentum_sums"])
def test_where_no_block_is_left_the_noise_of_all_is_left_out(
    kind: str, flight: Flight, motion: Cycles, pristine: Any
) -> None:
    sums = getattr(flight.native, kind)
    for b in sums.order[0 : sums.open] if kind == "accumulator" else range(sums.count):
        sums.block[b].instants = float("nan")
    assert lib.zygos_scrub(flight.native, pristine) > 0
    assert sums.count == 0
    assert not any(sums.noise_closed.gram) and not any(sums.noise_closed.sum)
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 3, np.random.default_rng(1))
    assert flight.estimate().validity == "valid"


@pytest.mark.parametrize("instants", [-1.0, 1e300, float("nan")])
def test_an_open_arc_of_momentum_rows_with_impossible_instants_is_dropped(
    instants: float, flight: Flight, flown: Flight, pristine: Any
) -> None:
    arc = flight.native.momentum_sums.arc
    arc.instants = instants
    assert lib.zygos_scrub(flight.native, pristine) == BLOCKS
    assert flight.native.quarantined == 1
    assert flight.native.momentum_sums.count == flown.native.momentum_sums.count
    assert arc.instants == 0.0
    assert lib.zygos_scrub(flight.native, pristine) == 0


OPEN = (("segment", -1.0), ("segment", float("nan")), ("segment", 1e300), ("arc", "checksum"), ("arc", -1.0),
        ("arc", float("nan")), ("arc", 1e300), ("variance", -1.0), ("variance", float("nan")), ("variance", 1e-9),
        ("buffer", -1.0), ("buffer", float("nan")))  # fmt: skip


@pytest.mark.parametrize(("member", "value"), OPEN)
def test_an_open_arc_of_energy_rows_with_impossible_numbers_is_dropped(
    member: str, value: Any, flight: Flight, flown: Flight, pristine: Any
) -> None:
    """Of the instants of its segment, of a block that has yet to get its checksum, or of a buffer; or two copies that
    differ."""
    sums = flight.native.accumulator
    block = sums.block[sums.order[sums.fresh]]
    if value == "checksum":
        block.checksum = 1
    elif member == "variance":
        block.variance[1] = value
    elif member == "buffer":
        sums.buffer[sums.filling].variance = value
    else:
        setattr(*((sums, "segment") if member == "segment" else (block, "instants")), value)
    # the accepted instants of the segment are also under what one cycle leaves to the next
    found = BLOCKS | (PLACES if member == "segment" else 0)
    assert lib.zygos_scrub(flight.native, pristine) == found
    assert sums.count == sums.open == flown.native.accumulator.open
    assert flight.native.quarantined == 1
    assert {(buffer.places, buffer.instants) for buffer in sums.buffer} == {(0, 0.0)}
    assert lib.zygos_scrub(flight.native, pristine) == 0


@pytest.mark.parametrize("copy", [0, 1])
def test_a_closed_block_whose_copies_differ_is_dropped(flight: Flight, pristine: Any, copy: int) -> None:
    block = closed_block(flight.native)
    block.variance[copy] *= 2.0
    assert lib.zygos_scrub(flight.native, pristine) == BLOCKS
    assert lib.zygos_scrub(flight.native, pristine) == 0


def test_a_block_is_dropped_where_no_arc_is_open(flight: Flight, pristine: Any) -> None:
    for left in (1, 2):
        flip(closed_block(flight.native), "gram", 52, 7)
        assert lib.zygos_scrub(flight.native, pristine) == BLOCKS
        assert flight.native.quarantined == left
        assert flight.native.accumulator.count == flight.native.accumulator.open
    assert lib.zygos_scrub(flight.native, pristine) == 0


@pytest.mark.parametrize("column", ["body", "rotor", "spring"])
def test_a_parameter_whose_place_cannot_be_leads_to_no_other_memory(
    column: str, flight: Flight, motion: Cycles, pristine: Any
) -> None:
    """With a running solution, whose places it has."""
    rng = np.random.default_rng(1)
    flight.estimate()
    assert flight.adopt()
    assert lib.zygos_scrub(flight.native, pristine) == 0
    places = flight.native.column_map
    places.place[0 if column == "body" else places.joint[1] + (column == "spring")] = 2**31
    fly(flight, motion, 2, rng)
    assert lib.zygos_scrub(flight.native, pristine) & TABLES
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 2, rng)
    assert flight.estimate().validity == "valid"


@pytest.mark.parametrize("member", ["forgetting", "motors_forgetting", "momentum_forgetting"])
@pytest.mark.parametrize("product", [-1.0, 1.5, float("nan")])
def test_sums_fade_by_no_product_of_factors_that_cannot_be(
    member: str, product: float, arm: Arm, motion: Cycles
) -> None:
    """The first block stays as it is where an arc ends, until the product is that of the factors again."""
    out = Flight(replace(with_all_rows(arm), memory_s=600.0))
    fly(out, motion, 2, np.random.default_rng(0))
    kind = {"forgetting": "accumulator", "motors_forgetting": "motor_sums"}.get(member, "momentum_sums")
    block = ffi.addressof(getattr(out.native, kind).block, 0)
    first = bytes_of(block)
    setattr(out.native, member, product)
    out.cycles(part(again(out.arm, motion, int(out.native.cycle) + 1, np.random.default_rng(1)), 0, 1))
    assert bytes_of(block) == first
    assert getattr(out.native, member) == pytest.approx(out.native.config.forgetting_factor)
    fly(out, motion, 2, np.random.default_rng(2))
    assert bytes_of(block) != first
    assert out.estimate().validity == "valid"


def test_momentum_rows_without_components_are_not_formed(flight: Flight, motion: Cycles, pristine: Any) -> None:
    """Where the number of the places was changed so that it matches."""
    sums = flight.native.momentum_sums
    flight.native.places ^= sums.components
    sums.components = 0
    before = bytes_of(ffi.addressof(sums, "arc"))
    rest = part(again(flight.arm, motion, int(flight.native.cycle) + 1, np.random.default_rng(1)), 0, 100)
    flight.cycles(replace(rest, flags=np.zeros(len(rest), dtype=np.uint32)))
    assert flight.native.cycle == rest.sync[-1] and bytes_of(ffi.addressof(sums, "arc")) == before
    assert flight.estimate().validity == "refused"
    assert lib.zygos_scrub(flight.native, pristine) > 0
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 3, np.random.default_rng(1))
    assert flight.estimate().validity == "valid"


def crowded(flight: Flight, kind: str, motion: Cycles) -> Any:
    """The sums, as many blocks of which are in use as can be; and the arc behind them, still open."""
    sums, rng, step = getattr(flight.native, kind), np.random.default_rng(0), 10
    most, shortest = len(sums.block) - 1, 50
    while sums.count < most:
        rest = again(flight.arm, motion, int(flight.native.cycle) + 1, rng)
        for first in range(0, len(rest), step):
            flight.cycles(part(rest, first, first + step))
            if sums.count == most and sums.cycles > shortest:
                break
    return sums


@pytest.mark.parametrize("kind", ["motor_sums", "momentum_sums"])
def test_where_some_blocks_merge_there_is_room(kind: str, flight: Flight, motion: Cycles) -> None:
    """For the arcs of a minute; an estimate is refused for the sake of the others."""
    sums = crowded(flight, kind, motion)
    huge = "total" if kind == "motor_sums" else "instants"
    for b in range(4, sums.count):
        setattr(sums.block[b], huge, 1e300)
    fly(flight, part(motion, 0, 100), 1, np.random.default_rng(1))
    assert sums.corrupt == 0 and 3 * len(sums.block) // 4 < sums.count < len(sums.block)
    assert flight.estimate().reason == REASONS[5]


def test_a_place_in_the_queue_that_cannot_be(flight: Flight, motion: Cycles, pristine: Any) -> None:
    """The queue is empty then, and the frames of the cycle that was being received are not completed by later ones."""
    cycles = part(again(flight.arm, motion, int(flight.native.cycle) + 1, np.random.default_rng(0)), 0, 1)
    receiver = flight.native.receiver
    for member in ("head", "tail"):
        flight.frames(encode(flight.arm, cycles)[:2])
        assert receiver.assembly.received
        flip(receiver.queue, member, 20)
        assert lib.zygos_step(flight.native) == lib.ZYGOS_E_STATE
        assert lib.zygos_scrub(flight.native, pristine) & PLACES
        assert receiver.queue.head == receiver.queue.tail == receiver.assembly.received == 0


def test_the_magic_number_is_repaired_where_one_bit_is_wrong(flight: Flight, pristine: Any) -> None:
    flip(flight.native, "magic", 5)
    assert lib.zygos_step(flight.native) == lib.ZYGOS_E_ORDER
    assert lib.zygos_scrub(flight.native, pristine) == PLACES
    assert lib.zygos_step(flight.native) == 0
    assert lib.zygos_scrub(ffi.new("zygos_t *"), pristine) == lib.ZYGOS_E_ORDER


@pytest.mark.parametrize("bit", [40, 62])
@pytest.mark.parametrize(("member", "index"), [("angle", 0), ("omega", 0), ("omega", 2)])
def test_a_sample_that_changed_in_the_window_stops_the_cycles(
    flight: Flight, motion: Cycles, pristine: Any, member: str, index: int, bit: int
) -> None:
    """Also where it changes by little."""
    assert flight.native.smoother.filled == flight.native.smoother.window
    flip(flight.native.smoother.sample[1], member, bit, index)
    rng = np.random.default_rng(1)
    flight.cycles(part(again(flight.arm, motion, int(flight.native.cycle) + 1, rng), 0, 60))
    assert lib.zygos_scrub(flight.native, pristine) & TABLES
    assert flight.native.accumulator.count == flight.native.accumulator.open


def found_once(flight: Flight, pristine: Any, what: object) -> int:
    """What zygos_scrub() finds, and no second call finds again; one that cannot be mended may be refused again."""
    first = int(lib.zygos_scrub(flight.native, pristine))
    assert lib.zygos_scrub(flight.native, pristine) in ((0,) if first >= 0 else (0, first)), what
    return first


@pytest.mark.slow
def test_after_any_flipped_bit_a_second_call_finds_nothing_more(
    flight: Flight, flown: Flight, motion: Cycles, pristine: Any
) -> None:
    """Bits anywhere in what is used of the state: what the first call repairs or drops is not found again, and the
    flight goes on."""
    rng, size = np.random.default_rng(0), ffi.sizeof("zygos_t")
    memory, found = ffi.buffer(flight.native), 0
    used = np.flatnonzero(np.frombuffer(bytes(memory), dtype=np.uint8))
    few = part(again(flown.arm, motion, int(flown.native.cycle) + 1, rng), 0, 40)
    for k in range(FLIPS):
        ffi.memmove(flight.native, flown.native, size)
        at, bit = int(rng.choice(used)), int(rng.integers(8))
        memory[at] = bytes([memory[at][0] ^ 1 << bit])
        found += found_once(flight, pristine, (at, bit)) != 0
        if k % 10 == 0:
            flight.cycles(few)
            flight.estimate()
    assert found > FLIPS // 10


@pytest.fixture(scope="module")
def ground() -> tuple[Flight, Cycles]:
    """Two rigid joints on the ground, with joint rows beside energy rows and an adopted estimate; and what follows."""
    arm, model = short_arm(2)
    q, tau = torque_of(arm, model, 0, 40.0)
    out, cycles = Flight(arm, model.effects), seen(arm, q, tau, 0)
    config = ffi.new("zygos_config_t *", out.native.config)
    at, later = (round(seconds / arm.period_s) for seconds in (20.0, 33.0))
    out.cycles(part(cycles, 0, at))
    assert lib.zygos_scrub(out.native, config) == 0
    out.cycles(part(cycles, at, later))
    out.estimate()
    out.adopt()
    assert out.native.joint_sums.segments > 4
    return out, part(cycles, later, len(cycles))


@pytest.fixture
def grounded(ground: tuple[Flight, Cycles]) -> Flight:
    """A copy that may be damaged."""
    return copy_of(ground[0])


def scalars(struct: Any) -> list[tuple[str, int]]:
    """Members that are numbers, and their bits."""
    fields = ffi.typeof(struct).fields
    return [(name, 8 * ffi.sizeof(field.type)) for name, field in fields if field.type.kind == "primitive"]


PARTS = ("accumulator", "motor_sums", "momentum_sums", "joint_sums", "guard", "smoother", "balance", "impulse",
         "momentum", "joint")  # fmt: skip


@pytest.mark.slow(only=["*-True"])
@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("where", ["space", "ground"])
def test_after_a_flipped_bit_of_any_member_a_second_call_finds_nothing_more(
    where: str, late: bool, flight: Flight, flown: Flight, motion: Cycles, ground: tuple[Flight, Cycles], request: Any
) -> None:
    """Also where cycles are processed and an estimate is made (late) before the first call."""
    if where == "ground":
        flight, (flown, motion) = request.getfixturevalue("grounded"), ground
        rest = part(motion, 0, 300)
    else:
        rest = part(again(flown.arm, motion, int(flown.native.cycle) + 1, np.random.default_rng(1)), 0, 300)
    pristine = ffi.new("zygos_config_t *", flown.native.config)
    rng, found = np.random.default_rng(0), 0
    for name in PARTS:
        for member, bits in scalars(getattr(flown.native, name)):
            for bit in {0, bits - 2, *map(int, rng.integers(bits, size=3))}:
                ffi.memmove(flight.native, flown.native, ffi.sizeof("zygos_t"))
                flip(getattr(flight.native, name), member, bit)
                if late:
                    flight.cycles(rest)
                    flight.estimate()
                found += found_once(flight, pristine, (member, bit)) != 0
                flight.cycles(part(rest, 0, 20))
                assert flight.estimate().validity in ("valid", "partial", "doubtful", "refused"), (member, bit)
    assert found > 50


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("name", PARTS[:4])
def test_what_two_flipped_bits_change_is_not_used(
    name: str, late: bool, flight: Flight, flown: Flight, motion: Cycles, pristine: Any
) -> None:
    """They cannot be flipped back: an estimate is refused, or nothing that counts has changed."""
    rng = np.random.default_rng(0)
    rest = part(again(flown.arm, motion, int(flown.native.cycle) + 1, rng), 0, 300)
    members = scalars(getattr(flown.native, name))
    before, refused = flown.estimate(), 0
    for _ in range(150):
        ffi.memmove(flight.native, flown.native, ffi.sizeof("zygos_t"))
        for member, bits in (members[k] for k in rng.integers(len(members), size=2)):
            flip(getattr(flight.native, name), member, int(rng.integers(bits)))
        if late:
            flight.cycles(rest)
        there = flight.estimate()
        refused += there.validity == "refused"
        if there.validity == "valid":
            assert (np.abs(there.value - before.value) < 3.0 * before.half95).all()
        found_once(flight, pristine, name)
        flight.cycles(part(rest, 0, 20))
        assert flight.estimate().validity in ("valid", "partial", "doubtful", "refused")
    assert refused > 10 or name == "joint_sums"


@pytest.mark.parametrize("name", ["accumulator", "motor_sums", "momentum_sums"])
def test_blocks_that_never_merge_are_bounded(
    name: str, flight: Flight, flown: Flight, motion: Cycles, pristine: Any
) -> None:
    """A target that was changed to next to nothing: room is made, the sums are refused, and a scrub begins anew."""
    rng, refused = np.random.default_rng(0), 0
    for _ in range(30):
        getattr(flight.native, name).target = 1e-300
        fly(flight, motion, 1, rng)
        refused += flight.estimate().validity == "refused"
    assert refused == 30
    assert lib.zygos_scrub(flight.native, pristine) > 0
    assert lib.zygos_scrub(flight.native, pristine) == 0
    fly(flight, motion, 2, rng)
    assert flight.estimate().validity == "valid"


def test_a_list_that_changed_stops_the_cycles(flight: Flight, motion: Cycles, pristine: Any) -> None:
    rng = np.random.default_rng(1)
    flip(flight.native.noise.signal[1], "place", 1)
    flight.cycles(part(again(flight.arm, motion, int(flight.native.cycle) + 1, rng), 0, 100))
    assert lib.zygos_cycle(flight.native, ffi.new("zygos_cycle_t *")) == lib.ZYGOS_E_STATE
    assert lib.zygos_scrub(flight.native, pristine) & TABLES
    assert lib.zygos_scrub(flight.native, pristine) == 0


@pytest.mark.parametrize("signals", [(), (0,), (0, 1), (3,)])
def test_changed_lists_of_sensors_that_speak_in_every_cycle_stop_them(
    signals: tuple[int, ...], arm: Arm, motion: Cycles
) -> None:
    """Also that of a gyro whose noise counts (no signal), alone or behind others."""
    loud = replace(arm, imu=replace(arm.imu, rate_sigma=1e-3), compensate_every=1)
    out, rng = Flight(loud), np.random.default_rng(0)
    fly(out, motion, 1, rng)
    pristine = ffi.new("zygos_config_t *", out.native.config)
    assert out.native.noise.gyro_variance > 0.0
    assert lib.zygos_scrub(out.native, pristine) == 0
    for signal in signals:
        flip(out.native.noise.signal[signal], "place", 1)
    if len(signals) != 1:
        flip(out.native.noise.gyro, "place", 1)
    out.cycles(part(again(loud, motion, int(out.native.cycle) + 1, rng), 0, 100))
    assert lib.zygos_cycle(out.native, ffi.new("zygos_cycle_t *")) == lib.ZYGOS_E_STATE
    assert lib.zygos_scrub(out.native, pristine) & TABLES
    assert lib.zygos_scrub(out.native, pristine) == 0


def test_what_is_not_steady_is_neither_stepped_nor_adopted(
    flight: Flight, flown: Flight, motion: Cycles, pristine: Any
) -> None:
    cycles = part(again(flight.arm, motion, int(flight.native.cycle) + 1, np.random.default_rng(0)), 0, 3)
    flip(flight.native.smoother, "position", 20)
    for one in encode(flight.arm, cycles):
        frame = ffi.new("zygos_frame_t *")
        ffi.memmove(frame, one.tobytes(), ffi.sizeof("zygos_frame_t"))
        lib.zygos_frame(flight.native, frame)
    assert lib.zygos_step(flight.native) == lib.ZYGOS_E_STATE
    assert lib.zygos_adopt(flight.native, flown._estimate) == lib.ZYGOS_E_STATE
    assert lib.zygos_scrub(ffi.NULL, pristine) == lib.zygos_scrub(flight.native, ffi.NULL) == lib.ZYGOS_E_NULL
    assert lib.zygos_scrub(flight.native, pristine) & PLACES


@pytest.mark.parametrize(("member", "most"), [("joint", 6), ("place", 31), ("count", 32)])
def test_places_of_motor_rows_have_bounds(flight: Flight, member: str, most: int) -> None:
    sums = flight.native.motor_sums
    setattr(sums, member, most)
    assert lib.zygos_motor_sums_steady(ffi.addressof(sums))
    setattr(sums, member, most + 1)
    assert not lib.zygos_motor_sums_steady(ffi.addressof(sums))


@pytest.mark.parametrize(("struct", "member", "bit"), [("joint", "halves", 9), ("joint_sums", "filling", 9)])
def test_no_cycle_is_processed_with_an_impossible_place_of_joint_rows(
    grounded: Flight, ground: tuple[Flight, Cycles], struct: str, member: str, bit: int
) -> None:
    flip(getattr(grounded.native, struct), member, bit)
    assert lib.zygos_cycle(grounded.native, ffi.new("zygos_cycle_t *")) == lib.ZYGOS_E_STATE
    assert lib.zygos_scrub(grounded.native, ffi.new("zygos_config_t *", ground[0].native.config)) & PLACES


def _group(native: Any) -> None:
    flip(native.joint_sums.group[1].rows, "gram", 53, 4)


def _segment(native: Any) -> None:
    flip(native.joint_sums.segment[native.joint_sums.filling].rows, "gram", 61, 4)


def _segment_noise(native: Any) -> None:
    flip(native.joint_sums.segment[native.joint_sums.filling].noise, "gram", 61, 4)


@pytest.mark.parametrize("damage", [_group, _segment, _segment_noise])
def test_a_group_or_a_segment_of_joint_rows_that_does_not_match_is_dropped(
    grounded: Flight, ground: tuple[Flight, Cycles], damage: Callable[[Any], None]
) -> None:
    flown, _ = ground
    pristine = ffi.new("zygos_config_t *", flown.native.config)
    damage(grounded.native)
    assert lib.zygos_scrub(grounded.native, pristine) == BLOCKS
    assert grounded.native.quarantined == 1
    assert lib.zygos_scrub(grounded.native, pristine) == 0
    there, before = grounded.estimate(), flown.estimate()
    assert there.validity == before.validity == "valid"
    assert (np.abs(there.value - before.value) < 3.0 * there.half95).all()


@pytest.mark.parametrize("member", ["count", "fade"])
def test_the_weight_of_each_group_is_under_the_checksum(member: str, grounded: Flight) -> None:
    for number in range(lib.ZYGOS_JOINT_GROUPS_VALUE + 1):  # the last one holds segments that are set aside
        group = grounded.native.joint_sums.group[number]
        flip(group, member, 40)
        assert "corrupt" in grounded.estimate().reason
        flip(group, member, 40)
        assert grounded.estimate().validity == "valid"


def joints_resealed(sums: Any) -> int:
    """The checksum over what weighs the groups of joint rows, once more."""
    checksum = 1
    for number in (sums.segments, sums.end, sums.filling):
        checksum = lib.zygos_checksum_number(checksum, number)
    for double in (sums.apart_sums, sums.keep, sums.keep_group):
        checksum = lib.zygos_checksum_doubles(checksum, ffi.new("double *", double), 1)
    checksum = lib.zygos_checksum_number(checksum, sums.target)
    for number in range(lib.ZYGOS_JOINT_GROUPS_VALUE + 1):
        weights = ffi.new("double[]", [sums.group[number].count, sums.group[number].fade])
        checksum = lib.zygos_checksum_doubles(checksum, weights, 2)
    return int(checksum)


@pytest.mark.parametrize("number", [0, 3, lib.ZYGOS_JOINT_GROUPS_VALUE])
@pytest.mark.parametrize(
    ("member", "value"),
    [("count", -1.0), ("count", 1e300), ("count", float("nan")), ("fade", -0.1), ("fade", 1.5), ("fade", float("nan"))],
)
def test_a_weight_of_a_group_that_cannot_be_is_found_also_where_the_checksum_matches(
    member: str, value: float, number: int, grounded: Flight, ground: tuple[Flight, Cycles]
) -> None:
    sums, names = grounded.native.joint_sums, ("joint_sums", "config", "column_map")
    assert joints_resealed(sums) == sums.checksum  # as the library computes it
    assert lib.zygos_joint_sums_intact(*(ffi.addressof(grounded.native, name) for name in names))
    setattr(sums.group[number], member, value)
    sums.checksum = joints_resealed(sums)
    assert not lib.zygos_joint_sums_intact(*(ffi.addressof(grounded.native, name) for name in names))
    assert "corrupt" in grounded.estimate().reason
    pristine = ffi.new("zygos_config_t *", ground[0].native.config)
    assert lib.zygos_scrub(grounded.native, pristine) & (SUMS | BLOCKS)
    assert lib.zygos_scrub(grounded.native, pristine) == 0
    assert grounded.estimate().validity in ("valid", "refused")


@pytest.mark.parametrize("member", ["noise", "apart"])
def test_where_what_all_groups_share_does_not_match_joint_rows_begin_anew(
    member: str, grounded: Flight, ground: tuple[Flight, Cycles]
) -> None:
    """Their noise, and the sums of each joint's rows."""
    flown, rest = ground
    pristine = ffi.new("zygos_config_t *", flown.native.config)
    flip(getattr(grounded.native.joint_sums, member), "gram", 53, 4)
    assert lib.zygos_scrub(grounded.native, pristine) == SUMS
    assert grounded.native.joint_sums.segments == 0
    assert lib.zygos_scrub(grounded.native, pristine) == 0
    grounded.cycles(rest)
    assert grounded.native.joint_sums.segments > 0


def test_joint_rows_behind_a_changed_table_are_dropped_whole(grounded: Flight, ground: tuple[Flight, Cycles]) -> None:
    """Segments cannot be taken out of a group."""
    pristine = ffi.new("zygos_config_t *", ground[0].native.config)
    flip(grounded.native.joint_sums, "slice", 4)
    assert lib.zygos_scrub(grounded.native, pristine) & TABLES
    assert grounded.native.joint_sums.segments == 0
    assert lib.zygos_scrub(grounded.native, pristine) == 0

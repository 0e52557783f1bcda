"""A bit of the sums that flips: the estimate is refused as corrupt, or hardly another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from flight_support import copy_of, part
from soak_support import again, fly, settle, stored, with_all_rows

from zygos.arm import Arm
from zygos.model.model import Model
from zygos.native.flight import REASONS, Estimate, Flight, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import Scenario

CORRUPT = REASONS[5]
MOVED, FACTOR = 0.5, 1.5
"""What a flip that is not noticed may do: move a value by so many sigmas, and change a sigma by this factor."""
BITS = (0, 10, 20, 28, 36, 40, 44, 46, 48, 49, 50, 51, 52, 53, 54, 57, 60, 61, 62, 63)
FEW_BITS = (30, 46, 51, 53, 62, 63)

Word = tuple[str, int, int]
"""Name, place in the state, bytes."""


@pytest.fixture(scope="module")
def motion(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    """A minute without noise."""
    return stored(arm, model, scenario)


@pytest.fixture(scope="module")
def flight(arm: Arm, motion: Cycles) -> Flight:
    """Eight arcs of the energy, of which blocks have merged in each kind of sums, and two thirds of the ninth."""
    floating, rng = with_all_rows(arm), np.random.default_rng(0)
    out = Flight(floating)
    fly(out, motion, 8, rng)
    out.cycles(part(again(floating, motion, int(out.native.cycle) + 1, rng), 0, 2 * len(motion) // 3 + 37))
    sums = out.native
    assert sums.accumulator.target > 24.0  # the least segment
    assert sums.motor_sums.block[0].total > sums.config.impulse_arc_cycles
    assert sums.momentum_sums.block[0].instants > sums.config.momentum_arc_cycles
    assert sums.accumulator.count >= sums.accumulator.fresh + 2
    return out


def words(flight: Flight, name: str, struct: Any, members: Sequence[str]) -> Iterator[Word]:
    """The members of a struct inside the state: numbers, or arrays of them."""
    start = int(ffi.cast("uintptr_t", flight.native))
    for member in members:
        place = int(ffi.cast("uintptr_t", ffi.addressof(struct, member))) - start
        kind = dict(ffi.typeof(struct).fields)[member].type
        one = kind.item if kind.kind == "array" else kind
        count = kind.length if kind.kind == "array" else 1
        for k in range(count):
            yield f"{name}.{member}[{k}]", place + k * ffi.sizeof(one), ffi.sizeof(one)


def flipped(flight: Flight, word: Word, bit: int) -> Estimate:
    """The estimate with that bit the other way round, which it is only for so long."""
    memory = ffi.buffer(flight.native)
    at = word[1] + bit // 8
    memory[at] = bytes([memory[at][0] ^ 1 << bit % 8])
    try:
        return flight.estimate()
    finally:
        memory[at] = bytes([memory[at][0] ^ 1 << bit % 8])


def harmless(found: Estimate, before: Estimate) -> bool:
    if (found.validity, found.reason) != (before.validity, before.reason):
        return False
    moved = np.abs(found.value - before.value) / before.sigma
    changed = np.abs(np.log(found.sigma / before.sigma))
    return bool((moved <= MOVED).all() and (changed <= np.log(FACTOR)).all())


def flip(flight: Flight, listed: Sequence[Word], bits: Sequence[int], *, silent: bool = False) -> None:
    """Every one of these bits. silent: to have no values for another reason than corruption will do as well."""
    before = flight.estimate()
    assert before.validity == "valid"
    refused, wrong = 0, []
    for word in listed:
        for bit in (bit for bit in bits if bit < 8 * word[2]):
            found = flipped(flight, word, bit)
            refused += found.reason == CORRUPT
            mute = silent and found.validity in ("refused", "doubtful")
            if found.reason != CORRUPT and not harmless(found, before) and not mute:
                wrong.append(f"{word[0]} bit {bit}: {found.validity} {found.reason}")
    assert wrong == []
    assert refused > 0


def blocks(flight: Flight, kind: str) -> list[tuple[str, Any]]:
    """The first, one in the middle and the last of the closed arcs; and those of the open arc."""
    sums = getattr(flight.native, kind)
    if kind != "accumulator":
        listed = [(f"{kind}.block[{b}]", sums.block[b]) for b in (0, sums.count // 2, sums.count - 1)]
        name = "open" if kind == "motor_sums" else "arc"
        return [*listed, (f"{kind}.{name}", getattr(sums, name))]
    ranks = (0, sums.open // 2, sums.open - 1, sums.fresh, sums.fresh + 1, sums.count - 1)
    return [(f"{kind}.block[{sums.order[r]}]", sums.block[sums.order[r]]) for r in ranks]


SMALL = {
    "accumulator": ("instants", "square", "overlap", "variance", "fade", "end", "checksum"),
    "motor_sums": ("instants", "total", "end", "checksum"),
    "momentum_sums": ("instants", "end", "checksum"),
}


@pytest.mark.parametrize("kind", SMALL)
def test_what_stands_beside_the_sums_of_a_block(flight: Flight, kind: str) -> None:
    listed = [word for name, block in blocks(flight, kind) for word in words(flight, name, block, SMALL[kind])]
    flip(flight, [word for word in listed if "instants[" not in word[0] or word[0][-2] in "01"], BITS)


def test_the_deviations_of_a_block(flight: Flight) -> None:
    p = flight.native.column_map.count
    listed = []
    for name, block in blocks(flight, "accumulator"):
        last = (p + 1) * (p + 2) // 2
        listed += list(words(flight, name, block, ["gram"]))[last : last + p + 2]
    flip(flight, listed, FEW_BITS)


@pytest.mark.parametrize("kind", SMALL)
def test_the_sums_of_a_block(flight: Flight, kind: str) -> None:
    """Every fifth entry, and every row sum."""
    p = flight.native.column_map.count
    listed: list[Word] = []
    for name, block in (blocks(flight, kind)[0], blocks(flight, kind)[-1]):
        if kind == "motor_sums":
            listed += list(words(flight, name, block.joint[0], ["gram"]))[:14]
            listed += list(words(flight, name, block.joint[1], ["sum"]))[:4]
            continue
        sums = block.rows if kind == "momentum_sums" else block
        width = flight.native.momentum_sums.columns if kind == "momentum_sums" else p + 1
        listed += list(words(flight, name, sums, ["gram"]))[: width * (width + 1) // 2 : 5]
        listed += list(words(flight, name, sums, ["sum"]))[:width]
    flip(flight, listed, FEW_BITS)


def test_what_says_which_blocks_there_are(flight: Flight) -> None:
    """Of places and lengths, and of the segment and the step that fill."""
    energy, motors, momentum = (getattr(flight.native, kind) for kind in SMALL)
    listed = [
        *words(flight, "accumulator", energy, ["width", "count", "open", "fresh", "newest", "window"]),
        *words(flight, "accumulator", energy, ["ready", "arcs", "arc_instants", "task", "places", "order"]),
        *words(flight, "accumulator", energy, ["noise_fade"]),
        *words(
            flight, "accumulator", energy, ["corrupt", "filled", "filling", "parity", "enough", "target", "segment"]
        ),
        *words(flight, "accumulator", energy, ["length", "accepted", "refused", "checksum"]),
        *(
            word
            for b in range(3)
            for name in ("instants", "variance", "early", "late", "places", "shared")
            for word in words(flight, "accumulator", energy.buffer[b], [name])
        ),
        *words(flight, "motor_sums", motors, ["count", "corrupt", "instants", "cycles", "target", "checksum"]),
        *words(flight, "momentum_sums", momentum, ["columns", "components", "signals", "count", "corrupt"]),
        *words(flight, "momentum_sums", momentum, ["cycles", "target", "checksum"]),
    ]
    flip(flight, listed, (0, 1, 2, 5, 9, 20, 31, 40, 51, 52, 55, 62, 63), silent=True)


def test_places_that_cannot_be_are_given_anew(flight: Flight, motion: Cycles) -> None:
    """A place that no block has, and one that several have: each rank gets one of its own, and the sums are refused."""
    damaged = copy_of(flight)
    sums = damaged.native.accumulator
    places = len(sums.order)
    sums.order[0] = places
    for rank in range(1, places):
        sums.order[rank] = 1
    damaged.cycles(part(motion, 0, 300))
    assert sorted(sums.order) == list(range(places))
    assert sums.corrupt
    assert damaged.estimate().reason == CORRUPT


@pytest.mark.parametrize("keep", [1.0, 1.0 - 1e-5])
def test_a_flip_is_remembered_when_its_block_changes(flight: Flight, motion: Cycles, keep: float) -> None:
    """Blocks that merge or fade, and an arc that closes, do not hide what was changed before."""

    def other() -> Flight:
        out = copy_of(flight)
        out.native.config.forgetting_factor = keep
        return out

    def refused(changed: Flight) -> bool:
        fly(changed, motion, 7, np.random.default_rng(2))
        return changed.estimate().reason == CORRUPT

    assert not refused(other())
    for member in ("instants", "square", "overlap", "variance", "fade", "end"):
        closed, behind, opened = other(), other(), other()
        order = list(closed.native.accumulator.order)
        first = closed.native.accumulator.block[order[0]]
        second = behind.native.accumulator.block[order[1]]
        last = opened.native.accumulator.block[order[opened.native.accumulator.count - 1]]
        for block in (first, second, last):
            if member == "variance":
                block.variance[0] += 1.0
            else:
                setattr(block, member, getattr(block, member) + 1)
        assert refused(closed)
        assert refused(behind)
        assert not refused(opened)  # the arc is dropped when it closes, which is when it gets its end and its factor
        assert opened.native.accumulator.quarantined == (member not in ("fade", "end"))
    for kind, member in (("motor_sums", "total"), ("motor_sums", "end"), ("momentum_sums", "instants")):
        for place in (0, 1):
            changed = other()
            block = getattr(changed.native, kind).block[place]
            setattr(block, member, getattr(block, member) + 1)
            assert refused(changed)


def test_a_flip_is_remembered_when_the_arcs_behind_it_are_dropped(flight: Flight) -> None:
    """The block before them shares nothing any more, for which it gets another checksum."""
    for damaged in (False, True):
        out = copy_of(flight)
        sums = ffi.addressof(out.native, "accumulator")
        order = list(sums.order[0 : sums.open])
        arcs = sorted({int(sums.block[place].end) for place in order})
        last = max(r for r, place in enumerate(order) if sums.block[place].end == arcs[-2])
        sums.block[order[last]].square += damaged
        lib.zygos_accumulator_drop_after(sums, arcs[-2])
        assert (sums.open, sums.block[order[last]].overlap) == (last + 1, 0.0)
        assert (lib.zygos_accumulator_check(sums) > 1.0) == damaged
        assert (out.estimate().reason == CORRUPT) == damaged


@pytest.mark.parametrize(("kind", "member"), [("motor_sums", "total"), ("momentum_sums", "instants")])
def test_a_block_whose_numbers_cannot_be_is_refused_whatever_its_checksum_is(
    flight: Flight, kind: str, member: str
) -> None:
    sums = getattr(flight.native, kind)
    intact = getattr(lib, f"zygos_{kind}_intact")
    wrong = [("fade", -1e-9), ("fade", 1.0 + 1e-9), ("fade", np.nan), (member, -1.0), (member, 1e16), (member, np.nan)]
    for block in (sums.block[0], sums.block[sums.count - 1]):
        for name, value in wrong:
            before = getattr(block, name)
            assert intact(ffi.addressof(sums), ffi.addressof(flight.native, "config"))
            setattr(block, name, value)
            assert not intact(ffi.addressof(sums), ffi.addressof(flight.native, "config")), (name, value)
            setattr(block, name, before)


@pytest.mark.parametrize("kind", ["motor_sums", "momentum_sums"])
@pytest.mark.parametrize(("target", "good"), [(0.99, False), (1.0, True), (2.0**53, True), (1e16, False)])
def test_the_length_from_which_blocks_merge_has_bounds(arm: Arm, kind: str, target: float, good: bool) -> None:
    native = Flight(with_all_rows(arm)).native
    sums = getattr(native, kind)
    sums.target = target
    assert getattr(lib, f"zygos_{kind}_intact")(ffi.addressof(sums), ffi.addressof(native, "config")) == good


@pytest.mark.parametrize("member", ["count", "instants"])
def test_motor_rows_that_are_switched_off_have_no_sums(arm: Arm, member: str) -> None:
    off = Flight(replace(arm, impulse_arc_s=0.0)).native
    sums, config = ffi.addressof(off, "motor_sums"), ffi.addressof(off, "config")
    assert lib.zygos_motor_sums_intact(sums, config)
    setattr(sums, member, 1)
    assert not lib.zygos_motor_sums_intact(sums, config)


def _counted(sums: Any, off: float) -> None:
    """The number of instants in the sums, whose row sums match."""
    width = sums.width
    block = sums.block[sums.order[sums.fresh]]
    block.gram[width * (width + 1) // 2 - 1] += off
    block.sum[width - 1] += off


def _noise(sums: Any, off: float) -> None:
    sums.noise_open[sums.parity].gram[4] += off


def _motors_counted(sums: Any, off: float) -> None:
    width = sums.column_map.count[0] + 2
    sums.open.joint[0].gram[width * (width + 1) // 2 - 1] += off
    sums.open.joint[0].sum[width - 1] += off


def _motor_sum(sums: Any, off: float) -> None:
    sums.open.joint[1].gram[4] += off


def _motor_turns(sums: Any, off: float) -> None:
    sums.instants += int(off)


def _momentum_counted(sums: Any, off: float) -> None:
    width = sums.columns + 1
    rows = sums.arc.rows
    rows.gram[width * (width + 1) // 2 - 1] += off
    rows.sum[width - 1] += off


def _momentum_sum(sums: Any, off: float) -> None:
    sums.arc.rows.gram[4] += off


DAMAGE = (
    ("accumulator", _counted), ("accumulator", _noise), ("motor_sums", _motors_counted), ("motor_sums", _motor_sum),
    ("motor_sums", _motor_turns), ("momentum_sums", _momentum_counted), ("momentum_sums", _momentum_sum),
)  # fmt: skip


@pytest.mark.parametrize(("kind", "damage"), DAMAGE)
@pytest.mark.parametrize("off", [-3.0, 3.0])
def test_an_open_arc_that_does_not_match_is_dropped_when_it_closes(
    kind: str, damage: Callable[[Any, float], None], off: float, flight: Flight, motion: Cycles
) -> None:
    """It is counted; what closed before it and what comes behind it are used."""
    out = copy_of(flight)
    sums = getattr(out.native, kind)

    def closed() -> list[tuple[int, int]]:
        ranks = sums.order[0 : sums.open] if kind == "accumulator" else range(sums.count)
        return [(sums.block[b].end, sums.block[b].checksum) for b in ranks]

    settle(out)
    before = closed()
    damage(sums, off)
    out.cycles(part(again(out.arm, motion, int(out.native.cycle) + 1, np.random.default_rng(1)), 0, 1))
    settle(out)
    assert sums.quarantined == 1
    assert closed() == before
    fly(out, motion, 1, np.random.default_rng(2))
    assert sums.quarantined == 1
    assert out.estimate().validity == "valid"


@pytest.mark.parametrize("size", range(32, 41))
def test_every_byte_is_under_the_checksum(size: int) -> None:
    memory = ffi.new("uint8_t[]", 40)
    before = lib.zygos_checksum_memory(1, memory, size)
    for place in range(len(memory)):
        memory[place] ^= 4
        assert (lib.zygos_checksum_memory(1, memory, size) != before) == (place < size)
        memory[place] ^= 4

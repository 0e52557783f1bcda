# SPDX-License-Identifier: MIT
"""The four calls of a flight computer: copies for solutions, adoption, repairs, refusals, and the age of sums."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from arcs_support import KINDS, recording, run
from flight_support import joined, part
from loop_support import ASKED, GIVEN, IDLE, SOLVED, Loop, frames_of, native_cycles
from soak_support import again, stored

from conftest import EXAMPLE
from zygos.arm import Arm
from zygos.model.model import load_model
from zygos.native.flight import Flight, accepted, closed_blocks, config_of, encode, ffi, lib
from zygos.runs.cycles import Cycles
from zygos.simulation.scenario import load_scenario

CUT = {
    lib.ZYGOS_ENERGY_ROWS: ("energy", "arc"), lib.ZYGOS_MOTOR_ROWS: ("motors",),
    lib.ZYGOS_MOMENTUM_ROWS: ("momentum",), 3: ("joints",), 4: ("guard", "cycle", "checksum"),
}  # fmt: skip
"""What each cut of the hand-over is of, by ``zygos_handover_t.kind``."""
BACKGROUND = 3
"""Which word of ``zygos_given_t`` says that the memory holds a copy of the sums."""
WRITTEN = ("value", "sigma", "half95", "covariance", "solution")


def flown(arm: Arm, cycles: Cycles, *, in_place: bool = False) -> tuple[Loop, list[Any]]:
    """A loop behind these cycles, and its estimates."""
    loop, found = Loop(config_of(arm), in_place=in_place), []
    array = native_cycles(cycles)
    for k in range(len(cycles)):
        loop.cycle(array + k)
        if loop.solve() == 1:
            found.append(ffi.new("zygos_estimate_t *", loop.estimate[0]))
    return loop, found


def bits(estimate: Any) -> bytes:
    return b"".join(bytes(ffi.buffer(getattr(estimate, name))) for name in WRITTEN)


# ---------------------------------------------------------------- the copy


@pytest.mark.slow(but=["spatial"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_copy_by_parts_is_that_of_one_moment(kind: str) -> None:
    """At the cut of a kind of rows zygos_arm_take() copies its sums at once: the solution of both has the same bits,
    although arcs end, tasks are open and rows are added while the parts are copied."""
    arm, cycles = run(kind)
    loop, array = Loop(config_of(arm)), native_cycles(cycles)
    now, whole = ffi.new("zygos_work_t *"), ffi.new("zygos_work_t *")
    compared = valid = 0
    for k in range(len(cycles)):
        handover = loop.native.handover
        before, cuts = int(handover.kind), loop.native.stage == ASKED and handover.cut == 0
        if cuts:
            lib.zygos_arm_take(loop.sums, now)
        loop.cycle(array + k)
        if cuts and handover.cut == 1 and handover.kind == before:
            for name in CUT[before]:
                setattr(whole.sums, name, getattr(now.sums, name))
            if before in range(lib.ZYGOS_KINDS_OF_ROWS):
                whole.sums.ending = (whole.sums.ending & ~(1 << before)) | (now.sums.ending & (1 << before))
                for name in ("ended", "ended_forgetting"):
                    getattr(whole.sums, name)[before] = getattr(now.sums, name)[before]
            if before < len(now.sums.forgetting):
                whole.sums.forgetting[before] = now.sums.forgetting[before]
        if loop.native.stage == GIVEN:
            whole.sums.config = loop.config[0]
            once = ffi.new("zygos_estimate_t *")
            lib.zygos_work_solve(whole, once)
            assert loop.solve() == 1
            assert bits(loop.estimate) == bits(once)
            assert (loop.estimate.accepted, loop.estimate.cycle) == (once.accepted, once.cycle)
            compared, valid = compared + 1, valid + (once.validity >= lib.ZYGOS_PARTIAL)
        elif k >= len(cycles) // 2 or kind != "ground":
            loop.solve()
    assert compared >= 3
    assert kind == "spatial" or valid >= 1
    assert (loop.native.repairs, loop.native.losses) == (0, 0)


def test_the_loop_learns_what_one_solution_of_all_does() -> None:
    """Every minute: the estimate of the loop, with what it has adopted, beside that of the sums at once."""
    arm, motion = recording()
    cycles = again(arm, motion, 1, np.random.default_rng(1))
    loop, found = flown(arm, cycles)
    flight = Flight(arm)
    flight.cycles(part(cycles, 0, int(found[-1].cycle)))
    once = flight.estimate()
    last = found[-1]
    assert last.validity == lib.ZYGOS_VALID
    assert loop.state.sums.guard.known == 1
    value, sigma = (np.array(list(getattr(last, name)))[: len(once.value)] for name in ("value", "sigma"))
    true = load_model(EXAMPLE / "model.toml").base_values(arm)
    assert np.all(np.abs(value - true) < 3.0 * sigma)
    assert np.all(np.abs(value - once.value) < 2.0 * sigma)
    assert sigma == pytest.approx(once.sigma, rel=0.5), "blocks that end elsewhere scatter otherwise"
    kept = accepted(loop.state) / max(accepted(flight.native), 1)
    assert kept > 0.98, "arcs that waited for the copies have cost few rows"


def test_frames_give_what_cycles_give() -> None:
    """The door of the bus: decoded in the task, whenever they came."""
    arm, motion = recording()
    cycles = part(again(arm, motion, 1, np.random.default_rng(2)), 0, 300)
    flight = Flight(arm)
    frames, n = frames_of(flight, cycles)
    loop, rng, k, taken = Loop(config_of(arm)), np.random.default_rng(0), 0, 0
    while k < n:
        for _ in range(int(rng.integers(1, 40))):
            if k < n:
                assert loop.receive(frames + k) == 1
                k += 1
        while loop.step() == 1:
            taken += 1
    plain = Flight(arm)
    plain.frames(encode(arm, cycles))
    assert taken == plain.native.cycles == loop.state.cycles
    ours, other = (ffi.buffer(ffi.addressof(one, "sums", "energy"))[:] for one in (loop.state, plain.native))
    assert ours == other


def test_what_is_no_frame_of_this_arm_is_not_stored_and_what_is_too_many_is_counted() -> None:
    loop = Loop(config_of(recording()[0]))
    other = ffi.new("zygos_frame_t *", {"id": 0x7F0, "length": 1})
    assert loop.receive(other) == 0
    assert loop.native.head == 0
    sync = ffi.new("zygos_frame_t *", {"id": 0x80, "length": 1})
    ring = len(loop.native.ring)
    assert [loop.receive(sync) for _ in range(ring + 3)] == [1] * ring + [0] * 3
    assert loop.native.overrun == 3
    loop.step()
    assert loop.state.receiver.faults.overrun == 3
    assert loop.receive(sync) == 1


def test_solutions_in_place_are_those_of_the_ended_arcs() -> None:
    arm, cycles = run("planar")
    _, found = flown(arm, cycles, in_place=True)
    assert 2 <= len(found) <= len(cycles) * arm.period_s / arm.arc_max_s + 2, "once in an arc"
    assert found[-1].validity >= lib.ZYGOS_PARTIAL
    flight, first = Flight(arm), int(found[0].cycle)
    flight.cycles(part(cycles, 0, first))
    solver, once = ffi.new("zygos_solver_t *"), ffi.new("zygos_estimate_t *")
    lib.zygos_arm_solve(flight.native, solver, once)
    assert bits(found[0]) == bits(once)


def test_no_cycle_is_taken_while_a_solution_in_place_is_under_way() -> None:
    arm, cycles = run("planar")
    loop, array = Loop(config_of(arm), in_place=True), native_cycles(cycles)
    assert [loop.cycle(array + k) for k in range(20)] == [1] * 20
    assert loop.solve() == 0
    assert loop.cycle(array + 20) == 0
    assert loop.native.stage == GIVEN
    before = loop.state.cycles
    assert loop.cycle(array + 20) == 0
    assert lib.zygos_restart(loop.native, lib.ZYGOS_KEEP_FAULTS) == 0
    assert lib.zygos_seal(loop.native, ffi.new("uint8_t[24]")) == 0
    assert loop.state.cycles == before
    assert loop.solve() == 1
    assert loop.cycle(array + 20) == 1


# ---------------------------------------------------------------- another arm


def test_an_estimate_of_the_sums_before_a_restart_is_not_returned() -> None:
    arm, motion = recording()
    cycles = again(arm, motion, 1, np.random.default_rng(3))
    loop, array, k = Loop(config_of(arm)), native_cycles(cycles), 0
    while not (loop.native.stage == GIVEN and k > 900):
        loop.cycle(array + k)
        k += 1
        if k < 900 or loop.native.stage != GIVEN:
            loop.solve()
    assert lib.zygos_restart(loop.native, lib.ZYGOS_KEEP_FAULTS | lib.ZYGOS_KEEP_JOINTS) == 1
    assert loop.solve() == 0
    assert loop.native.stage == SOLVED
    for further in range(2):  # verified in one cycle, adopted in the next
        loop.cycle(array + k + further)
    assert loop.native.stage == IDLE
    assert loop.state.sums.guard.known == 0
    assert lib.zygos_restart(loop.native, 64) == lib.ZYGOS_E_KEEP


def test_a_payload_is_told() -> None:
    """The comparison of the newest arc with those before is done in the background."""
    arm, motion = recording()
    model = load_model(EXAMPLE / "model.toml")
    *others, last = model.bodies
    heavy = replace(last, mass=replace(last.mass, value=1.6 * last.mass.value))
    arm = replace(arm, arc_max_s=20.0)
    rng = np.random.default_rng(4)
    light = [again(arm, motion, 1 + lap * len(motion), rng) for lap in range(2)]
    loaded = stored(arm, replace(model, bodies=(*others, heavy)), load_scenario(EXAMPLE / "scenario.toml"))
    before = flown(arm, joined(*light))[1]
    after = flown(arm, joined(*light, again(arm, loaded, 1 + 2 * len(motion), rng)))[1]
    assert not any(one.changed for one in before)
    assert any(one.changed for one in after)


def test_sums_to_which_nothing_is_added_grow_old() -> None:
    """The torques stop, and the SYNCs go on."""
    arm, motion = recording()
    arm = replace(arm, arc_max_s=20.0)
    loop, found = flown(arm, again(arm, motion, 1, np.random.default_rng(5)))
    assert found[-1].validity == lib.ZYGOS_VALID
    assert found[-1].unused <= 1
    gone = native_cycles(replace(motion, sync=np.arange(2000, 2000 + len(motion), dtype=np.uint64)))
    old = []
    for k in range(len(motion)):
        gone[k].flags = lib.ZYGOS_CYCLE_INVALID
        gone[k].sync = 1201 + k
        loop.state.receiver.assembly.sync = 1201 + k  # as SYNC frames count
        loop.cycle(gone + k)
        if loop.solve() == 1:
            old.append((int(loop.estimate.unused), int(loop.estimate.validity), int(loop.estimate.reason)))
    arc = round(arm.arc_max_s / arm.period_s)
    for unused, validity, reason in old:
        if unused > arc:
            assert (validity, reason) == (lib.ZYGOS_DOUBTFUL, lib.ZYGOS_REASON_OLD)
        else:
            assert validity == lib.ZYGOS_VALID
    assert old[-1][0] > arc


# ---------------------------------------------------------------- stored states


def stored_state(loop: Loop) -> tuple[Any, bytes]:
    head = ffi.new("uint8_t[]", lib.ZYGOS_SNAPSHOT_HEAD_VALUE)
    assert lib.zygos_seal(loop.native, head) == 1
    return head, bytes(ffi.buffer(loop.sums))


def resumed(loop: Loop, head: Any, image: bytes, *, length: int | None = None) -> int:
    ffi.buffer(loop.sums)[:] = image
    bytes_in_all = lib.ZYGOS_SNAPSHOT_HEAD_VALUE + len(image) if length is None else length
    memory = ffi.sizeof(loop.memory[0])
    return int(lib.zygos_resume(loop.native, loop.config, loop.memory, memory, head, bytes_in_all))


def test_a_stored_state_goes_on_and_says_so() -> None:
    arm, motion = recording()
    cycles = again(arm, motion, 1, np.random.default_rng(6))
    loop, _ = flown(arm, part(cycles, 0, 800))
    known = accepted(loop.state)
    head, image = stored_state(loop)
    further = Loop(config_of(arm))
    assert resumed(further, head, image) == 1
    assert accepted(further.state) == known
    array, last = native_cycles(cycles), None
    for k in range(800, len(cycles)):
        further.cycle(array + k)
        if further.solve() == 1:
            last = (int(further.estimate.validity), int(further.estimate.restored))
    assert last == (lib.ZYGOS_VALID, 1)


def test_a_state_that_cannot_be_used_is_refused() -> None:
    arm, motion = recording()
    loop, _ = flown(arm, part(again(arm, motion, 1, np.random.default_rng(7)), 0, 400))
    head, image = stored_state(loop)
    other = Loop(config_of(replace(arm, arc_max_s=30.0)))
    assert resumed(other, head, image) == lib.ZYGOS_E_CONFIG
    fresh = Loop(config_of(arm))
    assert resumed(fresh, head, image, length=len(image)) == lib.ZYGOS_E_LENGTH
    spoilt = bytearray(image)
    spoilt[len(image) // 2] ^= 1
    assert resumed(fresh, head, bytes(spoilt)) == lib.ZYGOS_E_CRC
    assert lib.zygos_step(fresh.native) == lib.ZYGOS_E_ORDER, "it has to be initialised"
    # changed before it was sealed: the CRC is right, and the sums are not
    damaged = ffi.new("zygos_arm_t *")
    ffi.buffer(damaged)[:] = image
    damaged.sums.energy.block[damaged.sums.energy.store.order[0]].gram[3] *= 2.0
    lib.zygos_snapshot_seal(lib.ZYGOS_SNAPSHOT_STATE, damaged, head)
    assert resumed(fresh, head, bytes(ffi.buffer(damaged))) == lib.ZYGOS_E_SUMS


# ---------------------------------------------------------------- misuse, and memory that was changed


def test_misuse_is_refused() -> None:
    config, arm = config_of(recording()[0]), ffi.new("zygos_t *")
    memory, frame, out = ffi.new("zygos_background_t *"), ffi.new("zygos_frame_t *"), ffi.new("zygos_estimate_t *")
    null, size = ffi.NULL, ffi.sizeof("zygos_background_t")
    least = ffi.sizeof("zygos_in_place_t")
    for arguments in ((null, config, memory), (arm, null, memory), (arm, config, null)):
        assert lib.zygos_init(*arguments, size) == lib.ZYGOS_E_NULL
    for call in (
        lambda: lib.zygos_frame(arm, frame), lambda: lib.zygos_step(arm), lambda: lib.zygos_solve(arm, out),
        lambda: lib.zygos_restart(arm, 0), lambda: lib.zygos_seal(arm, ffi.new("uint8_t[24]")),
        lambda: lib.zygos_cycle(arm, ffi.new("zygos_cycle_t *")),
    ):  # fmt: skip
        assert call() == lib.ZYGOS_E_ORDER
    assert lib.zygos_init(arm, config, memory, least - 1) == lib.ZYGOS_E_MEMORY
    assert lib.zygos_init(arm, config, memory, least) == 1
    assert arm.given[0].word[BACKGROUND] == 0
    assert lib.zygos_init(arm, config, memory, size) == 1
    assert arm.given[0].word[BACKGROUND] == 1
    assert lib.zygos_frame(arm, null) == lib.zygos_solve(arm, null) == lib.zygos_seal(arm, null) == lib.ZYGOS_E_NULL
    assert lib.zygos_step(null) == lib.zygos_restart(null, 0) == lib.zygos_cycle(arm, null) == lib.ZYGOS_E_NULL
    config.joints = 0
    assert lib.zygos_init(arm, config, memory, size) == lib.ZYGOS_E_JOINTS


@pytest.fixture
def begun() -> tuple[Loop, Any, int]:
    """A loop behind 300 cycles, the cycles, and the next one."""
    arm, motion = recording()
    cycles = again(arm, motion, 1, np.random.default_rng(8))
    loop, array = Loop(config_of(arm)), native_cycles(cycles)
    for k in range(300):
        loop.cycle(array + k)
    return loop, array, 300


def patrol(loop: Loop, array: Any, first: int) -> list[int]:
    """As many cycles as one pass of the patrol takes."""
    cycles = int(lib.zygos_patrol_cycles())
    found = []
    for k in range(cycles):
        array[first].sync = first + 1 + k
        found.append(loop.cycle(array + first))
    return found


@pytest.mark.parametrize("where", ["configuration", "tables"])
def test_the_patrol_repairs_what_was_changed(begun: tuple[Loop, Any, int], where: str) -> None:
    loop, array, k = begun
    if where == "configuration":
        loop.state.sums.config.joint[0].motor_zero_rad += 0.25
        changed = loop.state.sums.config.joint[0]
        right = float(loop.config.joint[0].motor_zero_rad)
    else:
        before = bytes(ffi.buffer(ffi.addressof(loop.state, "noise")))
        ffi.buffer(ffi.addressof(loop.state, "noise"))[9] = bytes([before[9] ^ 4])
    assert min(patrol(loop, array, k)) >= 0
    assert loop.native.repairs == 1
    if where == "configuration":
        assert float(changed.motor_zero_rad) == right
    else:
        assert bytes(ffi.buffer(ffi.addressof(loop.state, "noise"))) == before
    assert loop.native.losses == 0


def test_a_reference_that_was_changed_is_told(begun: tuple[Loop, Any, int]) -> None:
    """The caller's configuration contradicts both the copy and its checksum: which is right, the caller knows."""
    loop, array, k = begun
    loop.config.joint[1].gear_ratio *= 2.0
    found = patrol(loop, array, k)
    assert lib.ZYGOS_E_CONFIG in found
    assert loop.state.sums.config.joint[1].gear_ratio != loop.config.joint[1].gear_ratio
    assert lib.zygos_seal(loop.native, ffi.new("uint8_t[24]")) == lib.ZYGOS_E_CONFIG


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("copy", [0, 1, 2])
def test_what_was_given_is_voted(begun: tuple[Loop, Any, int], word: int, copy: int) -> None:
    loop, array, k = begun
    for bit in (0, 4, 31):
        before = bytes(ffi.buffer(loop.native.given))
        loop.native.given[copy].word[word] ^= 1 << bit
        assert loop.cycle(array + k) >= 0
        assert bytes(ffi.buffer(loop.native.given)) == before


def test_places_of_the_ring_and_stages_that_cannot_be_do_no_harm(begun: tuple[Loop, Any, int]) -> None:
    loop, array, k = begun
    for _ in range(3):
        loop.native.head ^= 1 << 30
        loop.native.stage ^= 1 << 17
        assert loop.step() == 0
        assert loop.native.head == loop.native.tail
        assert loop.solve() == 0, "one bit is not another stage: a copy is asked for"
        assert loop.native.stage == ASKED
        loop.native.stage = IDLE
    loop.native.magic ^= 8
    assert loop.cycle(array + k) == 1
    assert loop.native.magic == 0x5A59474F


@pytest.mark.parametrize(
    ("path", "in_place"),
    [
        ("copied", False),
        ("state.sums.momentum.store.arc_instants", True),
        ("state.sums.motors.store.arc_instants", True),
    ],
)
@pytest.mark.parametrize("bit", [7, 12, 30])
def test_a_flipped_bit_does_not_end_the_estimates_in_silence(path: str, in_place: bool, bit: int) -> None:
    """The length of a pause, and sums of rows that the configuration does not have."""
    arm, motion = recording()
    arm = replace(arm, arc_max_s=6.0, impulse_arc_s=0.0, momentum_max_s=0.0)
    loop, array = (
        Loop(config_of(arm), in_place=in_place),
        native_cycles(again(arm, motion, 1, np.random.default_rng(8))),
    )
    for k in range(200):
        loop.cycle(array + k)
    *structs, member = path.split(".")
    place = loop.native
    for name in structs:
        place = getattr(place, name)
    words = np.frombuffer(ffi.buffer(ffi.addressof(place, member)), dtype=np.uint32)
    words[0] ^= np.uint32(1 << bit)
    given = 0
    for k in range(200, 800):
        loop.cycle(array + k)
        given += loop.solve() == 1
    assert given > 1


def test_corrupt_sums_are_dropped_and_the_next_estimate_has_values() -> None:
    arm, motion = recording()
    arm = replace(arm, arc_max_s=10.0)
    rng = np.random.default_rng(9)
    cycles = joined(*(again(arm, motion, 1 + lap * len(motion), rng) for lap in range(2)))
    loop, array, reasons = Loop(config_of(arm)), native_cycles(cycles), []
    for k in range(len(cycles)):
        loop.cycle(array + k)
        if k == 800:
            closed_blocks(loop.state.sums.energy)[0].gram[5] *= 1.5
        if loop.solve() == 1:
            reasons.append((k, int(loop.estimate.reason), int(loop.estimate.validity)))
    corrupt = [k for k, reason, _ in reasons if reason == lib.ZYGOS_REASON_CORRUPT]
    assert len(corrupt) == 1
    assert reasons[-1][2] == lib.ZYGOS_VALID
    assert (loop.native.repairs, loop.native.losses) == (1, 0)


@pytest.mark.parametrize("seed", range(3))
def test_random_memory_is_refused_or_survived(seed: int) -> None:
    """Bytes that are no loop are refused; where the magic number happens to be right, nothing crashes."""
    rng = np.random.default_rng(seed)
    loop = Loop(config_of(recording()[0]))
    given = bytes(ffi.buffer(loop.native.given))
    view = ffi.buffer(loop.native)
    view[:] = rng.bytes(len(view))
    assert loop.step() == lib.ZYGOS_E_ORDER
    loop.native.magic = 0x5A59474F
    ffi.buffer(loop.native.given)[:] = given
    array = native_cycles(recording()[1])
    for k in range(20):
        loop.cycle(array + k)
        loop.step()
        loop.solve()
    assert loop.native.losses + loop.native.repairs >= 1

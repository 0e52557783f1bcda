# SPDX-License-Identifier: MIT
"""Reception: frames to complete cycles. Every counter is made to count, and alone wherever it can be alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flight_support import Bus, balanced, bytes_of, chosen, copy_of, masked, part, sines
from reference_support import make_arm

from zygos.arm import Arm
from zygos.native.flight import FRAME, Flight, _field_names, config_of, encode, ffi, lib
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_SHIFT

QUEUE = int(lib.ZYGOS_CYCLE_QUEUE_VALUE)
REJECTED, ACCEPTED, FOREIGN = lib.ZYGOS_REJECTED, lib.ZYGOS_ACCEPTED, lib.ZYGOS_FOREIGN
INVALID_ANGLE = -8388608
VOID = BREAK_BEFORE | int(lib.ZYGOS_CYCLE_VOID)
"""Flags of a cycle before which an unknown number of cycles may be missing somewhere in the open arc."""
TIMED_EVERY = 50
"""encode() sends FTIME in cycles whose number is a multiple of this."""


@pytest.fixture
def arm(tmp_path: Path) -> Arm:
    return make_arm(tmp_path, joint="latch_us = 300")


@pytest.fixture
def bus(arm: Arm) -> Bus:
    return Bus(arm)


@pytest.fixture
def coarse(tmp_path: Path) -> Bus:
    return Bus(make_arm(tmp_path, imu='resolution = "coarse"'))


def close(bus: Bus, counter: int) -> list[tuple[int, int]]:
    """The SYNC that closes the open cycle, and what came out of the queue."""
    assert bus.send(bus.sync(counter)) == [ACCEPTED]
    return bus.drain()


def spoilt(bus: Bus, index: int, bad: Any, **expected: int) -> None:
    """Frame `index` of a cycle is replaced; that cycle alone is lost, and exactly these counters count."""
    bus.cycles(1)
    frames = bus.data(2)
    frames[index] = bad
    verdicts = bus.send(bus.sync(2), *frames)
    assert verdicts.pop(index + 1) == REJECTED
    assert set(verdicts) == {ACCEPTED}
    bus.cycles(3)
    assert close(bus, 4) == [(0, BREAK_BEFORE), (2, 0)]
    assert bus.faults() == expected


# ---------------------------------------------------------------- what a good cycle becomes


def test_good_cycles_come_out_in_order_with_their_values(bus: Bus) -> None:
    """Codes in the wire's units; the first cycle after the start continues nothing."""
    turn = 2.0 * np.pi
    bus.send(
        bus.sync(239), bus.angles(0, 239, 1048576, -2097152), bus.torque(0, 239, 123456), *bus.rates(239, (5, 6, -7))
    )
    bus.send(bus.angles(1, 239, -5, 8388607), bus.torque(1, 239, -1), bus.sync(240))
    cycle = lib.zygos_receiver_front(ffi.addressof(bus.flight.native, "receiver"))
    assert (cycle.sync, cycle.flags) == (0, BREAK_BEFORE)
    np.testing.assert_allclose(list(cycle.q[0:2]), [turn, -5 * turn / 2**20], rtol=1e-15)
    np.testing.assert_allclose(list(cycle.theta[0:2]), [-2 * turn, 8388607 * turn / 2**20], rtol=1e-15)
    np.testing.assert_allclose(list(cycle.tau[0:2]), [12.3456, -1e-4], rtol=1e-15)
    assert list(cycle.omega) == [5 / 2**21, 6 / 2**21, -7 / 2**21]
    assert bus.faults() == {}


def test_coarse_gyro(coarse: Bus) -> None:
    frames = [coarse.angles(0, 1), coarse.torque(0, 1), coarse.angles(1, 1), coarse.torque(1, 1)]
    coarse.send(coarse.sync(1), *frames, *coarse.rates(1, (-32767, 32766, 8192)), coarse.sync(2))
    cycle = lib.zygos_receiver_front(ffi.addressof(coarse.flight.native, "receiver"))
    assert list(cycle.omega) == [-32767 / 8192, 32766 / 8192, 1.0]
    assert coarse.faults() == {}


def test_the_counter_wraps_after_240_without_a_break(bus: Bus) -> None:
    bus.cycles(236, 8)
    assert close(bus, 4) == [(0, BREAK_BEFORE), *((i, 0) for i in range(1, 8))]
    assert bus.faults() == {}


def test_the_number_of_the_cycle_goes_on_past_many_wraps(bus: Bus) -> None:
    for k in range(1000):
        counter = k % 240 + 1
        bus.cycles(counter)
        bus.send(bus.ftime(counter, round(k * bus.arm.period_s * 1e6)))
        out = bus.drain()
        assert out == ([(k - 1, BREAK_BEFORE if k == 1 else 0)] if k else [])
    assert bus.faults() == {}


def test_an_incomplete_open_cycle_is_not_given_out(bus: Bus) -> None:
    bus.cycles(1)
    assert bus.drain() == []
    assert lib.zygos_arm_step(bus.flight.native) == 0


def test_nothing_is_at_the_front_of_an_empty_queue(bus: Bus) -> None:
    receiver = ffi.addressof(bus.flight.native, "receiver")
    assert lib.zygos_receiver_front(receiver) == ffi.NULL
    bus.cycles(1, 2)
    assert lib.zygos_receiver_front(receiver).sync == 0
    lib.zygos_receiver_pop(receiver)
    assert lib.zygos_receiver_front(receiver) == ffi.NULL


# ---------------------------------------------------------------- what a lost, late or doubled frame becomes


@pytest.mark.parametrize("missing", range(6))
def test_missing_frame(bus: Bus, missing: int) -> None:
    bus.cycles(1)
    frames = bus.data(2)
    del frames[missing]
    bus.send(bus.sync(2), *frames)
    bus.cycles(3)
    assert close(bus, 4) == [(0, BREAK_BEFORE), (2, 0)]
    assert bus.faults() == {"incomplete": 1, "dropped": 1}


@pytest.mark.parametrize("again", range(6))
def test_repeated_frame(bus: Bus, again: int) -> None:
    """Even the same frame twice: which of the two is right is unknown when they differ, and rare when they do not."""
    bus.cycles(1)
    bus.cycles(2)
    assert bus.send(bus.data(2)[again]) == [REJECTED]
    bus.cycles(3)
    assert close(bus, 4) == [(0, BREAK_BEFORE), (2, 0)]
    assert bus.faults() == {"repeated": 1, "dropped": 1}


@pytest.mark.parametrize("slow", range(6))
def test_late_frame(bus: Bus, slow: int) -> None:
    """It counts as late, its own cycle is incomplete, and the cycle in which it comes is not harmed."""
    frames = bus.data(1)
    late = frames.pop(slow)
    bus.send(bus.sync(1), *frames, bus.sync(2))
    assert bus.send(late) == [REJECTED]
    assert set(bus.send(*bus.data(2))) == {ACCEPTED}
    assert close(bus, 3) == [(1, BREAK_BEFORE)]
    assert bus.faults() == {"late": 1, "incomplete": 1, "dropped": 1}


def test_late_frame_across_the_wrap(bus: Bus) -> None:
    bus.cycles(240)
    bus.send(bus.sync(1))
    assert bus.send(bus.angles(0, 240)) == [REJECTED]
    assert bus.faults() == {"late": 1}


@pytest.mark.parametrize("offset", range(1, 15))
def test_wrong_counter(bus: Bus, offset: int) -> None:
    """Every counter but the cycle's own and the one before: rejected, and no harm to the cycle."""
    bus.cycles(20)
    assert bus.send(*(frame for frame in bus.data(20 + offset))) == [REJECTED] * 6
    assert close(bus, 21) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {"counter": 6}


@pytest.mark.parametrize("counter", [19, 21, 36, 228])
def test_time_of_another_cycle(bus: Bus, counter: int) -> None:
    """The whole SYNC counter must agree, not its last four bits alone."""
    bus.cycles(20)
    assert bus.send(bus.ftime(counter)) == [REJECTED]
    assert close(bus, 21) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {"late" if counter == 19 else "counter": 1}


def test_frames_before_the_first_sync(bus: Bus) -> None:
    assert bus.send(*bus.data(1), bus.ftime(1)) == [REJECTED] * 7
    bus.cycles(1, 2)
    assert close(bus, 3) == [(0, BREAK_BEFORE), (1, 0)]
    assert bus.faults() == {"unsynced": 7}


# ---------------------------------------------------------------- what the SYNC can do wrong


def test_lost_sync(bus: Bus) -> None:
    """The frames of the cycle that was not opened have a wrong counter, the next SYNC jumps, the number skips one."""
    bus.cycles(1, 2)
    assert bus.send(*bus.data(3)) == [REJECTED] * 6
    bus.cycles(4, 2)
    assert close(bus, 6) == [(0, BREAK_BEFORE), (1, 0), (3, BREAK_BEFORE), (4, 0)]
    assert bus.faults() == {"counter": 6, "sync_jumped": 1}


@pytest.mark.parametrize("jump", [2, 17, 100, 239])
def test_sync_that_jumps(bus: Bus, jump: int) -> None:
    bus.cycles(10)
    bus.cycles((9 + jump) % 240 + 1)
    expected = {"sync_jumped": 1} | ({"time_lost": 1} if jump > 120 else {})
    assert close(bus, (10 + jump) % 240 + 1) == [(0, BREAK_BEFORE), (jump, BREAK_BEFORE)]
    assert bus.faults() == expected


def test_repeated_sync(bus: Bus) -> None:
    """Rejected; its cycle is dropped, for a frame could belong to either of the two."""
    bus.cycles(1, 2)
    assert bus.send(bus.sync(2)) == [REJECTED]
    bus.cycles(3)
    assert close(bus, 4) == [(0, BREAK_BEFORE), (2, 0)]
    assert bus.faults() == {"sync_repeated": 1, "dropped": 1}


def test_repeated_sync_between_the_frames_of_its_cycle(bus: Bus) -> None:
    frames = bus.data(1)
    bus.send(bus.sync(1), *frames[:3], bus.sync(1), *frames[3:])
    bus.cycles(2)
    assert close(bus, 3) == [(1, BREAK_BEFORE)]
    assert bus.faults() == {"sync_repeated": 1, "dropped": 1}


# ---------------------------------------------------------------- status bits, codes, latch delay

ENABLED, TORQUE, MOTOR, LINK = 7, 11, 13, 14
"""Status nibbles with one bit cleared."""

SPOILT: dict[str, tuple[int, Callable[[Bus], Any], str]] = {
    "link bit": (0, lambda bus: bus.angles(0, 2, status=LINK), "link_invalid"),
    "link bit of joint 2": (2, lambda bus: bus.angles(1, 2, status=LINK), "link_invalid"),
    "link code": (0, lambda bus: bus.angles(0, 2, link=INVALID_ANGLE), "link_invalid"),
    "motor bit": (0, lambda bus: bus.angles(0, 2, status=MOTOR), "motor_invalid"),
    "motor code": (2, lambda bus: bus.angles(1, 2, motor=INVALID_ANGLE), "motor_invalid"),
    "torque bit": (1, lambda bus: bus.torque(0, 2, status=TORQUE), "torque_invalid"),
    "disabled, angles": (0, lambda bus: bus.angles(0, 2, status=ENABLED), "disabled"),
    "disabled, torque": (3, lambda bus: bus.torque(1, 2, status=ENABLED), "disabled"),
    "rate xy bit": (4, lambda bus: bus.rates(2, status=2)[0], "gyro_invalid"),
    "rate z bit": (5, lambda bus: bus.rates(2, status=14)[1], "gyro_invalid"),
    "torque high": (1, lambda bus: bus.torque(0, 2, 8388607), "saturated"),
    "torque low": (3, lambda bus: bus.torque(1, 2, -8388608), "saturated"),
    "rate x high": (4, lambda bus: bus.rates(2, (8388607, 0, 0))[0], "saturated"),
    "rate x low": (4, lambda bus: bus.rates(2, (-8388608, 0, 0))[0], "saturated"),
    "rate y high": (4, lambda bus: bus.rates(2, (0, 8388607, 0))[0], "saturated"),
    "rate z low": (5, lambda bus: bus.rates(2, (0, 0, -8388608))[1], "saturated"),
    "latch early": (1, lambda bus: bus.torque(0, 2, latch=249), "latch"),
    "latch late": (3, lambda bus: bus.torque(1, 2, latch=351), "latch"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_a_frame_that_says_its_value_is_bad(bus: Bus, case: str) -> None:
    """One counter for each cause; the frame does not count as received, so its cycle is also incomplete."""
    index, bad, counter = SPOILT[case]
    spoilt(bus, index, bad(bus), **{counter: 1, "incomplete": 1, "dropped": 1})


def test_a_good_frame_after_a_bad_one_does_not_heal_the_cycle(bus: Bus) -> None:
    bus.send(bus.sync(1), bus.angles(0, 1, status=LINK), *bus.data(1))
    assert close(bus, 2) == []
    assert bus.faults() == {"link_invalid": 1, "dropped": 1}


@pytest.mark.parametrize("codes", [(32767, 0, 0), (-32768, 0, 0), (0, 32767, 0), (0, 0, -32768)])
def test_saturated_coarse_gyro(coarse: Bus, codes: tuple[int, int, int]) -> None:
    spoilt(coarse, 4, coarse.rates(2, codes)[0], saturated=1, incomplete=1, dropped=1)


def test_a_coarse_gyro_that_says_its_rates_are_bad(coarse: Bus) -> None:
    spoilt(coarse, 4, coarse.rates(2, status=14)[0], gyro_invalid=1, incomplete=1, dropped=1)


def test_codes_beside_the_outermost_are_values(bus: Bus) -> None:
    frames = [
        bus.angles(0, 1, 8388607, -8388607),
        bus.torque(0, 1, 8388606),
        bus.angles(1, 1),
        bus.torque(1, 1, -8388607),
    ]
    bus.send(bus.sync(1), *frames, *bus.rates(1, (8388606, -8388607, 8388606)))
    assert close(bus, 2) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {}


@pytest.mark.parametrize("latch", [250, 350])
def test_latch_delay_within_fifty_microseconds(bus: Bus, latch: int) -> None:
    frames = bus.data(1)
    frames[1] = bus.torque(0, 1, latch=latch)
    bus.send(bus.sync(1), *frames)
    assert close(bus, 2) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {}


# ---------------------------------------------------------------- frames that are not what they should be


def damaged(frame: Any, **fields: int) -> Any:
    out = ffi.new("zygos_frame_t *", frame[0])
    for name, value in fields.items():
        setattr(out, name, value)
    return out


def all_messages(bus: Bus, counter: int) -> list[Any]:
    return [*bus.data(counter), bus.ftime(counter)]


def test_wrong_length(bus: Bus) -> None:
    """Each message at each length but its own, and above 8; the cycle goes on as if the frame had not been there."""
    bus.cycles(1)
    bad = [
        damaged(frame, length=length)
        for frame in [*all_messages(bus, 1), bus.sync(2)]
        for length in (*range(9), 15, 64, 255)
        if length != frame.length
    ]
    assert set(bus.send(*bad)) == {REJECTED}
    assert close(bus, 2) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {"length": len(bad)}


def test_every_flipped_bit_fails_the_crc(bus: Bus) -> None:
    bus.send(bus.sync(1))
    count = 0
    for frame in all_messages(bus, 1):
        for bit in range(8 * frame.length):
            bad = damaged(frame)
            bad.data[bit // 8] ^= 1 << bit % 8
            assert bus.send(bad) == [REJECTED]
            count += 1
    bus.send(*bus.data(1))
    assert close(bus, 2) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {"crc": count}


def test_a_frame_under_another_identifier_fails_the_crc(bus: Bus) -> None:
    """The data identifier stands for message and node: a frame of joint 1 is none of joint 2, an angle is no torque."""
    bus.send(bus.sync(1))
    ours = bus.data(1)[:5]  # those of 8 bytes
    identifiers = [frame.id for frame in ours]
    count = 0
    for frame in ours:
        for other in identifiers:
            if other != frame.id:
                assert bus.send(damaged(frame, id=other)) == [REJECTED]
                count += 1
    assert bus.faults() == {"crc": count}


def out_of_range(bus: Bus, counter: int) -> list[Any]:
    """SYNC and FTIME with a counter that the encoder refuses to send, the CRC right."""
    sync, ftime = damaged(bus.sync(1)), damaged(bus.ftime(1))
    sync.data[0] = ftime.data[2] = counter
    ftime.data[0] = lib.zygos_wire_crc(ftime.data, ftime.length, 2, 32)
    return [sync, ftime]


@pytest.mark.parametrize("counter", [0, 241, 255])
def test_counter_out_of_range(bus: Bus, counter: int) -> None:
    bus.cycles(1)
    assert bus.send(*out_of_range(bus, counter)) == [REJECTED] * 2
    assert close(bus, 2) == [(0, BREAK_BEFORE)]
    assert bus.faults() == {"range": 2}


def test_foreign_frames_change_nothing_at_all(bus: Bus) -> None:
    bus.cycles(1, 3)
    bus.send(bus.angles(0, 3))  # a fault and a spoilt cycle, which must stay as they are
    ours = [bus.sync(4), *all_messages(bus, 3)]
    known = {frame.id for frame in ours}
    before = bytes_of(bus.flight.native)
    for flag in (lib.ZYGOS_FRAME_EXTENDED, lib.ZYGOS_FRAME_REMOTE, lib.ZYGOS_FRAME_FD):
        assert bus.send(*(damaged(frame, flags=flag) for frame in ours)) == [FOREIGN] * len(ours)
    others = [damaged(ours[1], id=i) for i in range(0x800) if i not in known]
    assert set(bus.send(*others)) == {FOREIGN}
    assert bus.send(damaged(ours[1], id=ours[1].id + 0x800), damaged(ours[1], id=0xFFFFFFFF)) == [FOREIGN] * 2
    assert bytes_of(bus.flight.native) == before


def test_a_fine_gyro_does_not_pass_for_a_coarse_one(coarse: Bus) -> None:
    """Its first frame looks like a coarse gyro's, its second one gives it away; another's frame there is foreign."""
    z = coarse.frame(lib.ZYGOS_MSG_RATE_Z, coarse.config.imu_node, 1, status=1)
    assert coarse.send(z) == [REJECTED]
    assert coarse.faults() == {"unsynced": 1}
    coarse.cycles(1)
    assert coarse.send(damaged(z, data=bytes(5)), damaged(z, length=4)) == [FOREIGN] * 2
    assert close(coarse, 2) == [(0, BREAK_BEFORE)]
    assert set(coarse.send(*coarse.data(2))) == {ACCEPTED}
    assert coarse.send(coarse.frame(lib.ZYGOS_MSG_RATE_Z, coarse.config.imu_node, 2, status=1)) == [REJECTED]
    assert close(coarse, 3) == []
    assert coarse.faults() == {"unsynced": 1, "gyro_invalid": 1, "dropped": 1}


def test_a_clock_that_starts_anew_voids_nothing(bus: Bus) -> None:
    """Time that runs backwards is a restart of its producer, not an outage of 71 minutes."""
    timed(bus, [1, 2], start=1000.0)
    out = timed(bus, [3, 4], start=0.0)
    assert [flag for _, flag in out + close(bus, 5)] == [0, BREAK_BEFORE, 0]
    assert bus.faults() == {"time_jumped": 1}


REJECTIONS: dict[str, Callable[[Bus], Any]] = {
    "length": lambda bus: damaged(bus.angles(0, 3), length=7),
    "crc": lambda bus: damaged(bus.angles(0, 3), data=bytes(8)),
    "range": lambda bus: out_of_range(bus, 241)[0],
    "range of FTIME": lambda bus: out_of_range(bus, 241)[1],
    "late": lambda bus: bus.angles(0, 2),
    "counter": lambda bus: bus.torque(1, 9),
    "time of another cycle": lambda bus: bus.ftime(4, 99),
    "repeated": lambda bus: bus.angles(0, 3, 7, 8),
    "sync repeated": lambda bus: bus.sync(3),
    **{case: (lambda bus, make=make: retold(make(bus))) for case, (_, make, _) in SPOILT.items()},
}


def retold(frame: Any) -> Any:
    """The frame of cycle 2 as one of cycle 3."""
    out = damaged(frame)
    family, node = {0x180: (0, 0x180), 0x280: (1, 0x280), 0x380: (2, 0x380)}[frame.id & 0x780]
    out.data[1] = (frame.data[1] & 0xF0) | 3
    out.data[0] = lib.zygos_wire_crc(out.data, out.length, family, frame.id - node)
    return out


@pytest.mark.parametrize("all_have_come", [False, True])
def test_a_rejected_frame_changes_faults_and_status_only(bus: Bus, all_have_come: bool) -> None:
    """Every other byte of zygos_arm_t stays: the half-filled cycle, queue, clock, filters and sums. In the repeated
    cases every frame of cycle 3 has come; otherwise none, so the bad one is the first of its kind."""
    bus.cycles(1, 2)
    bus.send(bus.sync(3), *(bus.data(3) if all_have_come else []))
    before, receiver = copy_of(bus.flight), bus.flight.native.receiver
    for case, frame in REJECTIONS.items():
        if (case in ("repeated", "sync repeated")) != all_have_come:
            continue
        assert bus.send(frame(bus)) == [REJECTED]
        assert sum(bus.faults().values()) == sum(before.faults.values()) + 1, case
        assert receiver.status.last_verdict == REJECTED
        receiver.faults, receiver.status = before.native.receiver.faults, before.native.receiver.status
        assert ffi.buffer(bus.flight.native) == ffi.buffer(before.native), case


def test_an_unsynced_frame_changes_faults_and_status_only(bus: Bus) -> None:
    for frame in all_messages(bus, 1):
        before = masked(bus.flight)
        assert bus.send(frame) == [REJECTED]
        assert masked(bus.flight) == before


# ---------------------------------------------------------------- error frames, overrun


@pytest.mark.parametrize("error_class", [0x40, 0x44, 0x1FF])
def test_bus_off_ends_the_arc(bus: Bus, error_class: int) -> None:
    """The cycle in which it falls can still be whole, but continues nothing."""
    bus.cycles(1, 2)
    assert bus.send(damaged(bus.sync(3), flags=lib.ZYGOS_FRAME_ERROR, id=error_class)) == [ACCEPTED]
    bus.cycles(3)
    assert close(bus, 4) == [(0, BREAK_BEFORE), (1, BREAK_BEFORE), (2, 0)]
    assert bus.faults() == {"bus_error": 1}


@pytest.mark.parametrize("error_class", [0x01, 0x80, 0x181])
def test_other_error_frames_are_counted_only(bus: Bus, error_class: int) -> None:
    """An error frame is no data frame, whatever its identifier and length look like."""
    bus.cycles(1, 2)
    before = masked(bus.flight)
    assert bus.send(damaged(bus.sync(3), flags=lib.ZYGOS_FRAME_ERROR, id=error_class)) == [ACCEPTED]
    assert masked(bus.flight) == before
    bus.cycles(3)
    assert close(bus, 4) == [(0, BREAK_BEFORE), (1, 0), (2, 0)]
    assert bus.faults() == {"bus_error": 1}


@pytest.mark.parametrize("resolution", ["bus", "coarse"])
def test_frames_stay_inside_the_queue_where_its_place_was_changed(
    resolution: str, request: pytest.FixtureRequest
) -> None:
    """They are stored in the first place, and no step is made before zygos_arm_scrub()."""
    bus: Bus = request.getfixturevalue(resolution)
    bus.cycles(1, 2)
    bus.drain()
    native = bus.flight.native
    native.receiver.queue.head = 2**31
    native.receiver.queue.slot[0].q[1] = native.receiver.queue.slot[0].omega[0] = 99.0
    behind = bytes(ffi.buffer(native.receiver.queue.slot[1:3]))
    bus.cycles(3, 2)
    assert bytes(ffi.buffer(native.receiver.queue.slot[1:3])) == behind
    first = native.receiver.queue.slot[0]
    assert 0.0 < first.q[1] < 1.0 and 0.0 < first.omega[0] < 1.0
    assert lib.zygos_arm_step(native) == lib.ZYGOS_E_STATE
    pristine = ffi.new("zygos_config_t *", native.sums.config)
    assert lib.zygos_arm_scrub(native, pristine) & lib.ZYGOS_SCRUBBED_PLACES
    assert lib.zygos_arm_step(native) == 0


@pytest.mark.parametrize("resolution", ["bus", "coarse"])
@pytest.mark.parametrize("waits", [False, True])
@pytest.mark.parametrize("member", ["q", "theta", "tau", "omega", "sync", "flags"])
def test_a_cycle_is_not_used_if_its_readings_change_before_it_is_processed(
    resolution: str, waits: bool, member: str, request: pytest.FixtureRequest
) -> None:
    """A bit flips in the open cycle, or in one that waits. The cycle counts as invalid and ends the arc."""
    bus: Bus = request.getfixturevalue(resolution)
    native = bus.flight.native
    for counter in range(1, 13):
        bus.cycles(counter)
        lib.zygos_arm_step(native)
    bus.send(bus.sync(13))
    assert lib.zygos_arm_step(native) == 1
    bus.send(*bus.data(13))
    if waits:
        bus.send(bus.sync(14))
    queue, gaps, number = native.receiver.queue, int(native.gaps), int(native.sums.cycle)
    slot = queue.slot[queue.tail]
    place = ffi.cast("uint8_t *", ffi.addressof(slot, member))
    place[0] ^= 8
    if not waits:
        bus.send(bus.sync(14))  # which gives it its number and flags
    spoilt = waits or member not in ("sync", "flags")
    assert lib.zygos_arm_step(native) == 1
    assert (native.invalid, native.gaps - gaps, native.sums.cycle - number) == ((1, 1, 0) if spoilt else (0, 0, 1))
    bus.send(*bus.data(14))
    bus.cycles(15, 2)
    while lib.zygos_arm_step(native) == 1:
        pass
    assert (native.invalid, native.sums.cycle - number) == (1 if spoilt else 0, 3)
    assert bus.faults() == {}


@pytest.mark.parametrize("joints", [0, 8, 18, 2**31, 2**31 + 2])
def test_no_cycle_is_complete_with_an_impossible_number_of_joints(bus: Bus, joints: int) -> None:
    """Frames of joints are foreign then, and those of the gyro alone make no cycle."""
    bus.cycles(1)
    bus.config.joints = joints
    for counter in (2, 3):
        expected = [ACCEPTED] + [FOREIGN] * 4 + [ACCEPTED] * 2
        assert bus.send(bus.sync(counter), *bus.data(counter)) == expected
    bus.config.joints = bus.arm.n
    bus.cycles(4)
    assert close(bus, 5) == [(3, BREAK_BEFORE)]
    assert bus.faults() == {"incomplete": 3, "dropped": 3}


def test_cycles_that_came_with_a_changed_number_of_joints_are_dropped(bus: Bus) -> None:
    """They are complete without the joints that are not counted, whose readings are those of an older cycle."""
    pristine = ffi.new("zygos_config_t *", bus.config)
    bus.cycles(1, 12)
    while lib.zygos_arm_step(bus.flight.native) == 1:
        pass
    bus.config.joints = 1
    for counter in (13, 14, 15):
        bus.send(bus.sync(counter), *bus.data(counter))
    assert lib.zygos_arm_step(bus.flight.native) == lib.ZYGOS_E_STATE
    assert lib.zygos_arm_scrub(bus.flight.native, pristine) & lib.ZYGOS_SCRUBBED_CONFIG
    assert lib.zygos_arm_step(bus.flight.native) == 0
    bus.cycles(16, 2)
    assert [number for number, _ in close(bus, 18)] == [15, 16]


def test_overrun(bus: Bus) -> None:
    """The queue keeps its oldest cycles; those that did not fit are counted, and the next one is a break."""
    bus.cycles(1, QUEUE + 4)
    out = close(bus, QUEUE + 5)
    assert out == [(0, BREAK_BEFORE), *((i, 0) for i in range(1, QUEUE))]
    assert bus.faults() == {"overrun": 4, "dropped": 4}
    bus.send(*bus.data(QUEUE + 5))
    bus.cycles(QUEUE + 6)
    assert close(bus, QUEUE + 7) == [(QUEUE + 4, BREAK_BEFORE), (QUEUE + 5, 0)]
    assert bus.faults() == {"overrun": 4, "dropped": 4}


def test_overrun_after_the_queue_has_gone_round_many_times(bus: Bus) -> None:
    """Wherever in the ring it happens."""
    bus.cycles(1)
    for round_ in range(QUEUE + 1):
        first = round_ * (QUEUE + 3)
        bus.cycles((first + 1) % 240 + 1, QUEUE + 2)
        assert [number for number, _ in bus.drain()] == list(range(first, first + QUEUE))
        assert bus.faults() == {"overrun": 2 * round_ + 2, "dropped": 2 * round_ + 2}
        bus.cycles((first + QUEUE + 3) % 240 + 1)
        assert len(bus.drain()) == 1


# ---------------------------------------------------------------- FTIME


def timed(bus: Bus, counters: list[int], period: float = 1.0, start: float = 0.0) -> list[tuple[int, int]]:
    """Good cycles, each with an FTIME; k-th time = start + k period, in SYNC periods."""
    out = []
    for k, counter in enumerate(counters):
        bus.cycles(counter)
        out += bus.drain()
        assert bus.send(bus.ftime(counter, round((start + k * period) * bus.arm.period_s * 1e6))) == [ACCEPTED]
    return out


@pytest.mark.parametrize(("period", "jumps"), [(1.49, 0), (1.51, 1), (0.51, 0), (0.49, 1)])
def test_time_must_agree_to_half_a_cycle(bus: Bus, period: float, jumps: int) -> None:
    timed(bus, [1, 2], period)
    flags = (VOID | 1 << VOID_SHIFT if period > 1.0 else BREAK_BEFORE) if jumps else 0
    assert close(bus, 3) == [(1, flags)]
    assert bus.faults() == ({"time_jumped": 1} if jumps else {})


def test_time_wraps_after_71_minutes(bus: Bus) -> None:
    start = (2**32 - 30_000) / (bus.arm.period_s * 1e6)
    timed(bus, [1, 2, 3, 4], 1.0, start)
    assert bus.faults() == {}


def test_time_that_jumped_is_the_reference_from_then_on(bus: Bus) -> None:
    timed(bus, [1, 2])
    timed(bus, [3, 4, 5], 1.0, 500.0)
    assert bus.faults() == {"time_jumped": 1}


@pytest.mark.parametrize(
    ("error", "flags"), [(0.0, BREAK_BEFORE), (240.0, VOID | 129 << VOID_SHIFT), (-120.0, BREAK_BEFORE)]
)
def test_more_than_120_cycles_without_time(bus: Bus, error: float, flags: int) -> None:
    """After 120 cycles every cycle stands alone, counted once; an FTIME ends that, and a second silence counts again.

    The FTIME that ends the silence still tells whether cycles were lost meanwhile.
    """
    bus.cycles(1)
    bus.send(bus.ftime(1))
    out = []
    for k in range(1, 130):
        bus.cycles(k + 1)
        out += bus.drain()
    assert [flag for _, flag in out[1:121]] == [0] * 120
    assert [flag for _, flag in out[121:]] == [BREAK_BEFORE] * 8
    assert bus.faults() == {"time_lost": 1}
    bus.send(bus.ftime(130, round((129 + error) * bus.arm.period_s * 1e6)))
    bus.cycles(131, 3)
    assert [flag for _, flag in bus.drain()] == [flags, 0, 0]
    for k in range(133, 252):
        bus.cycles(k % 240 + 1)
        bus.drain()
    assert bus.faults() == {"time_lost": 2} | ({"time_jumped": 1} if error else {})


def test_no_time_at_all_is_lost_after_120_cycles(bus: Bus) -> None:
    for k in range(122):
        bus.cycles(k + 1)
        assert bus.faults() == ({"time_lost": 1} if k > 120 else {})
        bus.drain()


def test_a_silence_without_end_is_counted_once(bus: Bus) -> None:
    """The number of cycles without time does not grow past what it can hold, where it would begin at 0 again."""
    bus.cycles(1)
    bus.flight.native.receiver.assembly.since_time = 2**32 - 1
    bus.cycles(2, 4)
    assert [flag for _, flag in bus.drain()] == [BREAK_BEFORE] * 4
    assert bus.flight.native.receiver.assembly.since_time == 2**32 - 1
    assert bus.faults() == {}


def test_an_outage_of_exactly_240_cycles_is_not_bridged(arm: Arm) -> None:
    """The SYNC counter goes on as if nothing had been; FTIME tells, and the arc that holds the outage is dropped."""
    before, after = sines(arm, 130, first=1), sines(arm, 130, first=131 + 240)
    flight = Flight(arm)
    flight.frames(encode(arm, before)[:-1])
    trace = flight.frames(encode(arm, after), trace=True)
    assert trace is not None
    assert {name: count for name, count in flight.faults.items() if count} == {"time_jumped": 1}
    assert flight.counts["gaps"] == 1
    assert flight.counts["arcs_dropped"] == 1
    assert flight.estimate().arcs == 1  # that behind the outage
    # The first cycle of the trace is the last one before the outage.
    first_timed = next(i for i in range(130) if (371 + i) % TIMED_EVERY == 0)
    assert trace.cycles.flags.tolist() == [
        *[0] * (first_timed + 1),
        VOID | 60 << VOID_SHIFT,
        *[0] * (129 - first_timed),
    ]
    # What counts is what came after, and nothing else.
    assert flight.counts["accepted"] == np.count_nonzero(trace.accepted[first_timed + 1 :]) > 0
    fresh = Flight(arm)
    fresh.cycles(part(trace.cycles, first_timed + 1, len(trace.cycles)))
    np.testing.assert_array_equal(flight.normal_equations()[0], fresh.normal_equations()[0])


def test_arcs_that_closed_before_an_outage_are_kept(arm: Arm) -> None:
    flight = Flight(arm)
    early = sines(arm, 120)
    early.flags[60] = 2  # a lost cycle closes the first arc
    flight.frames(encode(arm, early)[:-1])
    closed = flight.blocks().energy[0]
    flight.frames(encode(arm, sines(arm, 100, first=121 + 240)))
    assert flight.faults["time_jumped"] == 1
    assert flight.estimate().arcs == 2  # with that behind the outage
    assert flight.counts["arcs_dropped"] == 1
    np.testing.assert_array_equal(flight.blocks().energy[0][0], closed[0])


@pytest.mark.parametrize("how", ["a lost cycle", "its greatest length"])
def test_an_arc_that_ends_between_an_outage_and_the_next_time_is_dropped_too(arm: Arm, how: str) -> None:
    """It holds the outage, and nothing says so until FTIME does."""
    before, after = sines(arm, 130), sines(arm, 130, first=131 + 240)
    if how == "a lost cycle":
        after.flags[8] = INVALID
    else:
        arm = replace(arm, arc_max_s=130 * arm.period_s)
    flight = Flight(arm)
    flight.frames(encode(arm, before)[:-1])
    flight.frames(encode(arm, after)[:140])
    assert flight.faults["time_jumped"] == flight.counts["arcs_dropped"] == 0
    trace = flight.frames(encode(arm, after)[140:], trace=True)
    assert trace is not None
    assert flight.faults["time_jumped"] == 1
    assert flight.counts["arcs_dropped"] > 0
    fresh = Flight(arm)
    fresh.cycles(part(trace.cycles, int(np.argmax(trace.cycles.flags > 0)), len(trace.cycles)))
    np.testing.assert_array_equal(flight.normal_equations()[0], fresh.normal_equations()[0])


# ---------------------------------------------------------------- the order of frames, and the record of a run


def shuffled(frames: Any, seed: int) -> Any:
    """Frames in another order within each cycle; SYNC stays first."""
    rng = np.random.default_rng(seed)
    starts = [*np.flatnonzero(frames["id"] == 0x080).tolist(), len(frames)]
    order = []
    for start, stop in pairwise(starts):
        order += [start, *(start + 1 + rng.permutation(stop - start - 1)).tolist()]
    return frames[order]


@pytest.mark.parametrize("resolution", ["fine", "coarse"])
def test_order_within_a_cycle_changes_no_bit(tmp_path: Path, resolution: str) -> None:
    arm = make_arm(tmp_path, imu=f'resolution = "{resolution}"')
    frames = encode(arm, balanced(arm, sines(arm, 400), chosen(arm)))
    images = []
    for seed in range(4):
        flight = Flight(arm)
        flight.frames(shuffled(frames, seed) if seed else frames)
        assert flight.counts["cycles"] == 400
        images.append(bytes_of(flight.native))
    assert len(set(images)) == 1


def test_feeding_frames_one_by_one_or_at_once_changes_no_bit(arm: Arm) -> None:
    """Stepping late, up to the length of the queue, is the same as stepping at once."""
    frames = encode(arm, sines(arm, 300))
    at_once = Flight(arm)
    at_once.frames(frames)
    late = Flight(arm)
    pointer = ffi.cast("zygos_frame_t *", frames.ctypes.data)
    syncs = 0
    for i in range(len(frames)):
        lib.zygos_arm_frame(late.native, pointer + i)
        syncs += int(frames["id"][i] == 0x080)
        if syncs % (QUEUE - 1) == 0:
            while lib.zygos_arm_step(late.native) == 1:
                pass
    while lib.zygos_arm_step(late.native) == 1:
        pass
    assert bytes_of(late.native) == bytes_of(at_once.native)


def test_invalid_cycles_sent_as_such_are_dropped(arm: Arm) -> None:
    """encode() clears all status bits of a cycle that is flagged invalid."""
    cycles = sines(arm, 60)
    cycles.flags[30] = 2
    flight = Flight(arm)
    flight.frames(encode(arm, cycles))
    assert flight.counts["cycles"] == 59
    assert flight.faults["dropped"] == 1
    assert flight.counts["gaps"] == 1


def test_every_counter_is_exercised_in_this_file() -> None:
    text = Path(__file__).read_text()
    assert [name for name in _field_names("zygos_faults_t") if f'"{name}"' not in text] == []


# ---------------------------------------------------------------- calibration


@pytest.mark.parametrize(
    ("law", "share"), [("applied_from_sync", 0.0), ("applied_previous_cycle", 1.0), ("sampled", 0.5)]
)
def test_calibration(tmp_path: Path, law: str, share: float) -> None:
    """Signs, zeros, mounting, and the torque in force during the cycle that ends with this SYNC."""
    half = np.sqrt(0.5)
    arm = make_arm(tmp_path, law=law, imu=f"mount_xyzw = [{half}, 0, 0, {half}]", encoder="sign = -1, zero_rad = 0.25")
    rng = np.random.default_rng(7)
    previous = ffi.new("zygos_previous_cycle_t *")
    signal, tau, cycle = ffi.new("double[]", 17), ffi.new("double[]", 7), ffi.new("zygos_cycle_t *")
    past = np.zeros(2)
    for _ in range(3):
        q, theta, reported = rng.normal(size=(3, 2))
        omega = rng.normal(size=3)
        cycle.q[0:2], cycle.theta[0:2] = q.tolist(), theta.tolist()
        cycle.tau[0:2], cycle.omega = reported.tolist(), omega.tolist()
        lib.zygos_cycle_calibrate(previous, config_of(arm), cycle, signal, tau)
        expected = [*(0.25 - q), *(0.25 - theta), omega[0], -omega[2], omega[1]]
        np.testing.assert_allclose(list(signal[0:7]), expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(list(tau[0:2]), (1.0 - share) * past + share * reported, rtol=1e-15)
        past = reported


def test_frame_records_match_the_c_struct() -> None:
    assert FRAME.itemsize == ffi.sizeof("zygos_frame_t")
    assert {name: FRAME.fields[name][1] for name in FRAME.names} == {
        name: field.offset for name, field in ffi.typeof("zygos_frame_t").fields
    }


@pytest.mark.parametrize("place", ["head", "tail"])
def test_the_queue_has_one_place_more_than_cycles(place: str) -> None:
    receiver = ffi.new("zygos_receiver_t *")
    lib.zygos_receiver_init(receiver)
    last = len(receiver.queue.slot) - 1
    setattr(receiver.queue, place, last)
    assert lib.zygos_receiver_intact(receiver)
    setattr(receiver.queue, place, last + 1)
    assert not lib.zygos_receiver_intact(receiver)

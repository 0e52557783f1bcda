# SPDX-License-Identifier: MIT
"""The whole-log reading of CAN frames: a good log, and each fault by itself."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from e2e.p02 import e2e_p02_protect
from reference_support import make_arm

from zygos.arm import Arm
from zygos.can.wire import ERROR, EXTENDED, FD, REMOTE, Frame, data_ids, database, identifiers
from zygos.reference.wire import receive_log


@pytest.fixture
def arm(tmp_path: Path) -> Arm:
    return make_arm(tmp_path, joint="latch_us = 300")


def encode(arm: Arm, identifier: int, **codes: int) -> Frame:
    """A frame of the arm from the codes of its signals, CRC included."""
    kind = identifiers(arm)[identifier]
    data = bytearray(kind.message.encode(codes, scaling=False, strict=True))
    if kind.family is not None:
        e2e_p02_protect(data, data_ids(kind.family, kind.node), increment_counter=False)
    return Frame(identifier, bytes(data))


def value(cycle: int, signal: int) -> int:
    """A code that belongs to one cycle and signal only."""
    return 1000 * cycle + signal - 20_000


def frames_of(arm: Arm, cycle: int) -> list[Frame]:
    """One cycle; SYNC counters start at 231, so that they wrap in the tenth cycle."""
    counter = (230 + cycle) % 240 + 1
    head = {"Crc": 0, "Counter": counter % 16, "Status": 15}
    out = [Frame(0x080, bytes([counter]))]
    if cycle % 50 == 0:
        time = (2**32 - 70_000 + round(cycle * arm.period_s * 1e6)) % 2**32
        out.append(encode(arm, 0x3A0, **head, Sync=counter, Time=time))
    for i, joint in enumerate(arm.joints):
        angles = {"LinkAngle": value(cycle, 3 * i), "MotorAngle": value(cycle, 3 * i + 1)}
        torque = {"Torque": value(cycle, 3 * i + 2), "Latch": joint.latch_us + 20, "Temperature": -5}
        out.append(encode(arm, 0x180 + joint.node, **head, **angles))
        out.append(encode(arm, 0x280 + joint.node, **head, **torque))
    node = arm.imu.node
    if arm.imu.resolution == "coarse":
        rates = {f"Rate{axis}": cycle + i for i, axis in enumerate("XYZ")}
        out.append(encode(arm, 0x180 + node, **head, **rates))
    else:
        out.append(encode(arm, 0x180 + node, **head, RateX=value(cycle, 7), RateY=value(cycle, 8)))
        out.append(encode(arm, 0x380 + node, **head, RateZ=value(cycle, 9)))
    return out


def log_of(arm: Arm, cycles: int) -> list[list[Frame]]:
    return [frames_of(arm, cycle) for cycle in range(cycles)]


def flat(log: list[list[Frame]]) -> list[Frame]:
    return [frame for cycle in log for frame in cycle]


def recode(arm: Arm, frame: Frame, **codes: int) -> Frame:
    """The frame with other codes in some signals and a CRC that fits."""
    raw = identifiers(arm)[frame.id].message.decode(frame.data, decode_choices=False, scaling=False)
    assert isinstance(raw, dict)
    return encode(arm, frame.id, **{**raw, **codes})  # type: ignore[arg-type]


def test_a_good_log(arm: Arm) -> None:
    log = log_of(arm, 60)
    reception = receive_log(arm, flat(log))
    cycles = reception.cycles
    assert reception.faults == {}
    assert set(reception.verdicts) == {"accepted"}
    np.testing.assert_array_equal(cycles.sync, np.arange(59))
    np.testing.assert_array_equal(cycles.flags, [1] + 58 * [0])
    codes = 1000.0 * np.arange(59)[:, None] - 20_000 + np.arange(10)
    turn = 2.0 * np.pi / 2**20
    np.testing.assert_allclose(cycles.q, codes[:, [0, 3]] * turn, rtol=1e-15)
    np.testing.assert_allclose(cycles.theta, codes[:, [1, 4]] * turn, rtol=1e-15)
    np.testing.assert_allclose(cycles.tau, codes[:, [2, 5]] * 1e-4, rtol=1e-15)
    np.testing.assert_allclose(cycles.omega, codes[:, 7:] / 2**21, rtol=1e-15)


def test_a_coarse_gyro_and_other_nodes(tmp_path: Path) -> None:
    text = (make_arm(tmp_path), (tmp_path / "arm.toml").read_text())[1]
    text = text.replace("node = 1\n", "node = 9\n").replace("[[joint]]", 'resolution = "coarse"\n[[joint]]', 1)
    (tmp_path / "arm.toml").write_text(text)
    from zygos.arm import load_arm

    arm = load_arm(tmp_path / "arm.toml")
    reception = receive_log(arm, flat(log_of(arm, 20)))
    assert reception.faults == {}
    np.testing.assert_allclose(reception.cycles.omega, (np.arange(19)[:, None] + np.arange(3)) / 2**13)


def test_order_within_a_cycle_does_not_matter(arm: Arm) -> None:
    log = log_of(arm, 30)
    rng = np.random.default_rng(0)
    mixed = [[cycle[0], *(cycle[1 + i] for i in rng.permutation(len(cycle) - 1))] for cycle in log]
    one, other = receive_log(arm, flat(log)).cycles, receive_log(arm, flat(mixed)).cycles
    for name in ("sync", "q", "theta", "tau", "omega", "flags"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_foreign_frames_have_no_effect(arm: Arm) -> None:
    log = log_of(arm, 10)
    log[4][3:3] = [
        Frame(0x123, b"12345678"),
        Frame(0x185, b"12345678"),
        log[4][2]._replace(flags=EXTENDED),
        log[4][2]._replace(flags=REMOTE),
        log[4][2]._replace(flags=FD),
    ]
    reception = receive_log(arm, flat(log))
    assert reception.faults == {}
    assert reception.verdicts.count("foreign") == 5
    assert len(reception.cycles) == 9


Break = Callable[[Arm, list[Frame]], list[Frame]]


def at(position: int, **codes: int) -> Break:
    return lambda arm, c: [recode(arm, f, **codes) if i == position else f for i, f in enumerate(c)]


# Positions in a cycle: 0 SYNC, 1 and 2 angles and torque of joint 1, 3 and 4 of joint 2, 5 rate x y, 6 rate z.
DROPPING: dict[str, tuple[Break, dict[str, int]]] = {
    "missing": (lambda _, c: c[:3] + c[4:], {"incomplete": 1}),
    "twice": (lambda _, c: [*c, c[2]], {"repeated": 1}),
    "short": (lambda _, c: [*c[:1], c[1]._replace(data=c[1].data[:7]), *c[2:]], {"length": 1, "incomplete": 1}),
    "bit": (
        lambda _, c: [*c[:1], c[1]._replace(data=c[1].data[:5] + bytes([c[1].data[5] ^ 4]) + c[1].data[6:]), *c[2:]],
        {"crc": 1, "incomplete": 1},
    ),
    "masquerade": (lambda _, c: [*c[:1], c[1]._replace(data=c[3].data), *c[2:]], {"crc": 1, "incomplete": 1}),
    "link": (at(3, Status=14), {"link_invalid": 1, "incomplete": 1}),
    "motor": (at(3, Status=13), {"motor_invalid": 1, "incomplete": 1}),
    "torque by the angles": (at(3, Status=11), {"torque_invalid": 1, "incomplete": 1}),
    "disabled by the angles": (at(1, Status=7), {"disabled": 1, "incomplete": 1}),
    "link by the torque": (at(2, Status=14), {"link_invalid": 1, "incomplete": 1}),
    "motor by the torque": (at(4, Status=13), {"motor_invalid": 1, "incomplete": 1}),
    "all bits": (at(1, Status=0), {"disabled": 1, "incomplete": 1}),
    "three bits": (at(4, Status=8), {"link_invalid": 1, "incomplete": 1}),
    "two bits": (at(4, Status=9), {"motor_invalid": 1, "incomplete": 1}),
    "bit before code": (at(1, Status=13, LinkAngle=-(2**23)), {"motor_invalid": 1, "incomplete": 1}),
    "link code": (at(1, LinkAngle=-(2**23)), {"link_invalid": 1, "incomplete": 1}),
    "motor code": (at(1, MotorAngle=-(2**23)), {"motor_invalid": 1, "incomplete": 1}),
    "disabled": (at(4, Status=7), {"disabled": 1, "incomplete": 1}),
    "torque": (at(4, Status=11), {"torque_invalid": 1, "incomplete": 1}),
    "torque high": (at(4, Torque=2**23 - 1), {"saturated": 1, "incomplete": 1}),
    "torque low": (at(2, Torque=-(2**23)), {"saturated": 1, "incomplete": 1}),
    "latch": (at(2, Latch=351), {"latch": 1, "incomplete": 1}),
    "gyro": (at(6, Status=14), {"gyro_invalid": 1, "incomplete": 1}),
    "rate": (at(5, RateY=2**23 - 1), {"saturated": 1, "incomplete": 1}),
    "late": (lambda arm, c: at(2, Counter=_before(c))(arm, c), {"late": 1, "incomplete": 1}),
    "other cycle": (lambda arm, c: at(2, Counter=(_before(c) - 1) % 16)(arm, c), {"counter": 1, "incomplete": 1}),
    "sync twice": (lambda _, c: [*c, c[0]], {"sync_repeated": 1}),
}


def _before(cycle: list[Frame]) -> int:
    return (cycle[0].data[0] - 1) % 16


@pytest.mark.parametrize("name", DROPPING)
def test_a_fault_drops_its_cycle_and_no_other(arm: Arm, name: str) -> None:
    damage, faults = DROPPING[name]
    log = log_of(arm, 20)
    log[11] = damage(arm, log[11])
    reception = receive_log(arm, flat(log))
    assert reception.faults == {**faults, "dropped": 1}
    np.testing.assert_array_equal(reception.cycles.sync, [i for i in range(19) if i != 11])
    np.testing.assert_array_equal(reception.cycles.flags, [1] + 17 * [0])


@pytest.mark.parametrize("name", ["link code", "torque high", "latch"])
def test_values_next_to_the_refused_ones_pass(arm: Arm, name: str) -> None:
    near = {
        "link code": at(1, LinkAngle=-(2**23) + 1),
        "torque high": at(4, Torque=2**23 - 2),
        "latch": at(2, Latch=350),
    }
    log = log_of(arm, 20)
    log[11] = near[name](arm, log[11])
    assert receive_log(arm, flat(log)).faults == {}


def test_a_lost_sync_is_a_jump(arm: Arm) -> None:
    """Frames of the cycle whose SYNC is lost carry another counter than the cycle that is open."""
    log = log_of(arm, 20)
    log[12] = log[12][1:]
    reception = receive_log(arm, flat(log))
    assert reception.faults == {"counter": 6, "sync_jumped": 1}
    np.testing.assert_array_equal(reception.cycles.sync, [i for i in range(19) if i != 12])
    assert [int(s) for s in reception.cycles.sync[reception.cycles.flags == 1]] == [0, 13]


def test_a_late_frame_does_not_harm_the_cycle_it_falls_into(arm: Arm) -> None:
    log = log_of(arm, 20)
    log[8].insert(3, log[7].pop(4))
    reception = receive_log(arm, flat(log))
    assert reception.faults == {"late": 1, "incomplete": 1, "dropped": 1}
    np.testing.assert_array_equal(reception.cycles.sync, [i for i in range(19) if i != 7])


def test_frames_before_the_first_sync(arm: Arm) -> None:
    log = log_of(arm, 5)
    log[0] = log[0][1:]
    reception = receive_log(arm, flat(log))
    assert reception.faults == {"unsynced": 7}
    np.testing.assert_array_equal(reception.cycles.sync, [0, 1, 2])


def test_an_outage_of_240_cycles_is_not_bridged(arm: Arm) -> None:
    """The SYNC counter goes on as if nothing had happened; FTIME knows better."""
    log = log_of(arm, 320)
    reception = receive_log(arm, flat(log[:50] + log[290:]))
    assert reception.faults == {"time_jumped": 1}
    np.testing.assert_array_equal(reception.cycles.flags, [1] + 59 * [0] + [5 | 60 << 8] + 18 * [0])


def test_a_void_in_a_dropped_cycle_waits_for_the_next_one(arm: Arm) -> None:
    log = log_of(arm, 320)
    reception = receive_log(arm, flat([*log[:50], *log[290:300], log[300][:-1], *log[301:]]))
    assert reception.faults == {"time_jumped": 1, "incomplete": 1, "dropped": 1}
    assert {int(s): int(f) for s, f in zip(reception.cycles.sync, reception.cycles.flags, strict=True) if f} == {
        0: 1,
        61: 5 | 61 << 8,
    }


def test_silence_of_the_fine_time_leaves_every_cycle_alone(arm: Arm) -> None:
    log = [[f for f in cycle if f.id != 0x3A0 or i in (0, 200)] for i, cycle in enumerate(log_of(arm, 220))]
    reception = receive_log(arm, flat(log))
    assert reception.faults == {"time_lost": 1}
    broken = [int(s) for s in np.flatnonzero(reception.cycles.flags)]
    assert broken == [0, *range(121, 201)]
    assert set(reception.cycles.flags) == {0, 1}


@pytest.mark.slow
def test_a_silence_does_not_forget_the_last_fine_time(arm: Arm) -> None:
    """An outage of 240 cycles within a silence is found by the FTIME that ends it."""
    log = [[f for f in cycle if f.id != 0x3A0 or i in (0, 400)] for i, cycle in enumerate(log_of(arm, 450))]
    reception = receive_log(arm, flat(log[:60] + log[300:]))
    assert reception.faults == {"time_lost": 1, "time_jumped": 1}
    assert [int(s) for s in np.flatnonzero(reception.cycles.flags & 4)] == [160]
    assert [int(s) for s in np.flatnonzero(reception.cycles.flags & 1)] == [0, *range(121, 161)]


def test_a_false_fine_time_is_refused(arm: Arm) -> None:
    log = log_of(arm, 60)
    log[50][1] = recode(arm, log[50][1], Sync=40)
    assert receive_log(arm, flat(log)).faults == {"counter": 1}


@pytest.mark.parametrize("counter", [0, 241, 255])
def test_a_sync_out_of_range_is_refused(arm: Arm, counter: int) -> None:
    log = log_of(arm, 6)
    log[3].append(Frame(0x080, bytes([counter])))
    reception = receive_log(arm, flat(log))
    assert reception.faults == {"range": 1}
    assert len(reception.cycles) == 5


@pytest.mark.parametrize(("identifier", "broken"), [(0x004, [0]), (0x13F, [0]), (0x040, [0, 6]), (0x1FF, [0, 6])])
def test_an_error_frame_is_counted_and_bus_off_ends_the_arc(arm: Arm, identifier: int, broken: list[int]) -> None:
    log = log_of(arm, 10)
    log[6].insert(2, Frame(identifier, bytes(8), ERROR))
    reception = receive_log(arm, flat(log))
    assert reception.faults == {"bus_error": 1}
    assert set(reception.verdicts) == {"accepted"}
    np.testing.assert_array_equal(np.flatnonzero(reception.cycles.flags), broken)


def test_a_break_in_a_dropped_cycle_waits_for_the_next_one(arm: Arm) -> None:
    log = log_of(arm, 10)
    log[6] = [*log[6][:4], Frame(0x040, bytes(8), ERROR)]
    cycles = receive_log(arm, flat(log)).cycles
    assert [int(s) for s in cycles.sync[cycles.flags == 1]] == [0, 7]


def test_no_frame_and_no_sync(arm: Arm) -> None:
    for log in ([], log_of(arm, 1)[0][1:]):
        reception = receive_log(arm, log)
        assert reception.cycles.q.shape == (0, 2)
        assert reception.cycles.omega.shape == (0, 3)


def test_data_identifiers_agree_with_the_dbc_and_never_coincide() -> None:
    """Each message of the DBC states family and node; at each counter no two messages share an identifier."""
    lists = []
    for message in database().messages:
        assert message.dbc is not None
        attributes = message.dbc.attributes
        if "E2EFamily" in attributes:
            family, node = int(attributes["E2EFamily"].value), int(attributes["E2ENode"].value)
            assert message.frame_id == {0: 0x180, 1: 0x280, 2: 0x380, 3: 0x180}[family] + node
            lists.append(data_ids(family, node))
    assert len(lists) == 19
    assert list(data_ids(1, 3)[:3]) == [35, 52, 69]
    assert data_ids(2, 32)[15] == (96 + 255) - 251
    for counter in range(16):
        assert len({ids[counter] for ids in lists}) == len(lists)

# SPDX-License-Identifier: MIT
"""zygos.dbc is the single truth of the wire: its identifiers, layouts and scales, and data identifiers that differ."""

from __future__ import annotations

import math
from pathlib import Path

import cantools
import pytest
from cantools.database.can import Database, Message, Signal

INCLUDE = Path(__file__).resolve().parents[2] / "include" / "zygos"

TURN = 2.0 * math.pi
I24 = 2**23
I16 = 2**15
# Signal: first bit, bits, signed, LSB, unit, lowest and highest code that is a value.
Layout = tuple[int, int, bool, float, str, int, int]
HEADER: dict[str, Layout] = {
    "Crc": (0, 8, False, 1, "", 0, 255),
    "Counter": (8, 4, False, 1, "", 0, 15),
    "Status": (12, 4, False, 1, "", 0, 15),
}


def angle(start: int) -> Layout:
    return (start, 24, True, TURN / 2**20, "rad", 1 - I24, I24 - 1)


def rate_fine(start: int) -> Layout:
    return (start, 24, True, 2.0**-21, "rad/s", 1 - I24, I24 - 2)


def rate_coarse(start: int) -> Layout:
    return (start, 16, True, 2.0**-13, "rad/s", 1 - I16, I16 - 2)


def small(start: int) -> Layout:
    return (start, 15, True, 1.0 / (math.sqrt(2.0) * 16383), "", -16383, 16383)


FLOAT_MAX = 3.4028234663852886e38
PARAMETERS = {
    "a00": "kg m^2", "a01": "kg m^2", "a02": "kg m^2", "a11": "kg m^2", "a12": "kg m^2", "a22": "kg m^2",
    "Im1": "kg m^2", "k1": "Nm/rad", "b1": "Nms/rad", "Im2": "kg m^2", "k2": "Nm/rad", "b2": "Nms/rad",
}  # fmt: skip

# Message: identifier, DLC, signals besides the header, E2E family and node (None: the message has no header).
MESSAGES: dict[str, tuple[int, int, dict[str, Layout], tuple[int, int] | None]] = {
    "SYNC": (0x080, 1, {"Counter": (0, 8, False, 1, "", 1, 240)}, None),
    "FTIME": (
        0x3A0,
        7,
        {"Sync": (16, 8, False, 1, "", 1, 240), "Time": (24, 32, False, 1, "us", 0, 2**32 - 1)},
        (2, 32),
    ),
    "IMU_RATE_XY": (0x190, 8, {"RateX": rate_fine(16), "RateY": rate_fine(40)}, (0, 16)),
    "IMU_RATE_Z": (0x390, 5, {"RateZ": rate_fine(16)}, (2, 16)),
    "IMU_ATTITUDE": (
        0x290,
        8,
        {"Largest": (16, 2, False, 1, "", 0, 3), "SmallA": small(18), "SmallB": small(33), "SmallC": small(48)},
        (1, 16),
    ),
}
for node in range(1, 8):
    MESSAGES[f"JOINT{node}_ANGLES"] = (0x180 + node, 8, {"LinkAngle": angle(16), "MotorAngle": angle(40)}, (0, node))
    MESSAGES[f"JOINT{node}_TORQUE"] = (
        0x280 + node,
        8,
        {
            "Torque": (16, 24, True, 1e-4, "Nm", 1 - I24, I24 - 2),
            "Latch": (40, 16, False, 1, "us", 0, 65535),
            "Temperature": (56, 8, True, 1, "degC", -128, 127),
        },
        (1, node),
    )


@pytest.fixture(scope="module")
def database() -> Database:
    loaded = cantools.database.load_file(INCLUDE / "zygos.dbc", strict=True)
    assert isinstance(loaded, Database)
    return loaded


@pytest.fixture(scope="module")
def coarse() -> Database:
    loaded = cantools.database.load_file(INCLUDE / "zygos-coarse-gyro.dbc", strict=True)
    assert isinstance(loaded, Database)
    return loaded


def check_signal(signal: Signal, layout: Layout) -> None:
    start, length, signed, scale, unit, lowest, highest = layout
    assert (signal.start, signal.length, signal.is_signed, signal.unit or "") == (start, length, signed, unit)
    assert signal.byte_order == "little_endian"
    assert not signal.is_float
    assert (signal.scale, signal.offset) == (scale, 0)
    assert signal.minimum == pytest.approx(lowest * scale, rel=1e-15)
    assert signal.maximum == pytest.approx(highest * scale, rel=1e-15)


def check_message(
    message: Message, identifier: int, dlc: int, signals: dict[str, Layout], e2e: tuple[int, int] | None
) -> None:
    assert (message.frame_id, message.length, message.is_extended_frame) == (identifier, dlc, False)
    layouts = signals if e2e is None else HEADER | signals
    assert {signal.name for signal in message.signals} == set(layouts)
    for name, layout in layouts.items():
        check_signal(message.get_signal_by_name(name), layout)
    assert e2e_of(message) == e2e
    assert message.cycle_time is not None and message.cycle_time > 0


def e2e_of(message: Message) -> tuple[int, int] | None:
    """E2E family f and node of a message, as its DBC attributes state them; None for a message without a CRC."""
    assert message.dbc is not None and message.dbc.attributes is not None
    attributes = message.dbc.attributes
    if "E2EFamily" not in attributes:
        return None
    return int(attributes["E2EFamily"].value), int(attributes["E2ENode"].value)


def test_every_message_and_no_other(database: Database) -> None:
    assert {message.name for message in database.messages} == set(MESSAGES) | {"TELEMETRY", "HEARTBEAT"}


@pytest.mark.parametrize("name", MESSAGES)
def test_layout(database: Database, name: str) -> None:
    identifier, dlc, signals, e2e = MESSAGES[name]
    check_message(database.get_message_by_name(name), identifier, dlc, signals, e2e)


def test_coarse_gyro_takes_the_place_of_the_fine_one(database: Database, coarse: Database) -> None:
    (message,) = coarse.messages
    assert message.name == "IMU_RATE"
    rates = {"RateX": rate_coarse(16), "RateY": rate_coarse(32), "RateZ": rate_coarse(48)}
    check_message(message, 0x190, 8, rates, (0, 16))
    assert message.frame_id == database.get_message_by_name("IMU_RATE_XY").frame_id


COUNTERS = (
    *("length", "crc", "range", "late", "counter", "repeated", "unsynced", "latch", "link_invalid", "motor_invalid"),
    *("torque_invalid", "disabled", "gyro_invalid", "saturated", "incomplete", "dropped", "sync_repeated"),
    *("sync_jumped", "time_lost", "time_jumped", "overrun", "bus_error"),
)
COUNTS = ("cycles", "gaps", "invalid", "wraps", "accepted", "refused", "arcs", "arcs_dropped")
NODE = ("overflow", "misshapen", "down", "unsent", "corrupt", "unsaved")
VERDICTS = (
    *("validity", "reason", "cycle", "accepted", "refused", "arcs", "blocks", "rank", "condition", "cluster"),
    *("residual", "noise_ratio", "gate", "left_out"),
)
REFINEMENT = (
    *("reason", "cycle", "used", "lost", "restarts", "rejected", "farthest", "distance", "level", "level_error"),
    *("nis_link", "nis_motor", "nis_gyro", "ratio_link", "ratio_motor", "ratio_gyro"),
)
ITEMS = {
    **{i: (name, unit) for i, (name, unit) in enumerate(PARAMETERS.items())},
    **{256 + i: (f"{name}_sigma", unit) for i, (name, unit) in enumerate(PARAMETERS.items())},
    **{512 + i: (f"fault_{name}", "") for i, name in enumerate(COUNTERS)},
    **{534 + i: (f"count_{name}", "") for i, name in enumerate(COUNTS)},
    **{542 + i: (f"node_{name}", "") for i, name in enumerate(NODE)},
    548: ("count_apart", ""),
    549: ("count_waited", ""),
    **{768 + i: (f"verdict_{name}", "J" if name == "residual" else "") for i, name in enumerate(VERDICTS)},
    **{1024 + i: (f"{name}_half95", unit) for i, (name, unit) in enumerate(PARAMETERS.items())},
    **{1280 + i: (f"{name}_refined", unit) for i, (name, unit) in enumerate(PARAMETERS.items())},
    **{1536 + i: (f"{name}_refined_sigma", unit) for i, (name, unit) in enumerate(PARAMETERS.items())},
    **{1792 + i: (f"refined_{name}", "") for i, name in enumerate(REFINEMENT)},
}
"""What the telemetry sends: index + 256 kind, name and unit."""


def test_telemetry_names_each_item(database: Database) -> None:
    message = database.get_message_by_name("TELEMETRY")
    assert (message.frame_id, message.length, e2e_of(message)) == (0x1A0, 8, (3, 32))
    for name, layout in HEADER.items():
        check_signal(message.get_signal_by_name(name), layout)
    item = message.get_signal_by_name("Item")
    check_signal(item, (16, 16, False, 1, "", 0, 65535))
    assert item.is_multiplexer
    assert {signal.name for signal in message.signals} == {*HEADER, "Item", *(name for name, _ in ITEMS.values())}
    assert set(item.choices or {}) == set(ITEMS)
    for place, (name, unit) in ITEMS.items():
        signal = message.get_signal_by_name(name)
        assert (signal.start, signal.length, signal.is_float, signal.unit or "") == (32, 32, True, unit)
        assert (signal.minimum, signal.maximum) == (-FLOAT_MAX, FLOAT_MAX)
        assert signal.multiplexer_ids == [place]


def test_telemetry_is_plotted_by_name(database: Database) -> None:
    message = database.get_message_by_name("TELEMETRY")
    for place, (name, _) in ITEMS.items():
        data = message.encode({"Crc": 1, "Counter": 2, "Status": 0, "Item": place, name: 0.5 + place})
        assert data[2:4] == bytes([place % 256, place // 256])
        decoded = message.decode(data)
        assert isinstance(decoded, dict)
        assert decoded[name] == 0.5 + place
        assert str(decoded["Item"]).replace(" ", "_") == name


def test_heartbeat_is_that_of_canopen(database: Database) -> None:
    message = database.get_message_by_name("HEARTBEAT")
    assert (message.frame_id, message.length, message.cycle_time) == (0x700 + 32, 1, 1000)
    for state, name in {0: "boot_up", 4: "stopped", 5: "operational", 127: "pre_operational"}.items():
        decoded = message.decode(bytes([state]))
        assert isinstance(decoded, dict)
        assert str(decoded["State"]) == name


def test_codes_without_a_value_have_a_name(database: Database, coarse: Database) -> None:
    angles = database.get_message_by_name("JOINT1_ANGLES").decode(bytes([0, 0xF0, 0, 0, 0x80, 0, 0, 0]))
    assert isinstance(angles, dict)
    assert (str(angles["LinkAngle"]), angles["MotorAngle"], str(angles["Status"])) == ("invalid", 0.0, "ready")
    torque = database.get_message_by_name("JOINT2_TORQUE").decode(bytes([0, 0, 0xFF, 0xFF, 0x7F, 0, 0, 0]))
    assert isinstance(torque, dict)
    assert str(torque["Torque"]) == "saturated_high"
    rates = coarse.messages[0].decode(bytes([0, 0x10, 0, 0x80, 0xFF, 0x7F, 1, 0]))
    assert isinstance(rates, dict)
    assert (str(rates["RateX"]), str(rates["RateY"]), rates["RateZ"]) == ("saturated_low", "saturated_high", 2.0**-13)


def test_cycle_times_follow_the_sync(database: Database) -> None:
    period = database.get_message_by_name("SYNC").cycle_time
    assert period == 50
    assert database.get_message_by_name("FTIME").cycle_time == 50 * period


def test_comments_and_senders(database: Database, coarse: Database) -> None:
    for message in [*database.messages, *coarse.messages]:
        assert message.comment, message.name
        assert len(message.senders) == 1
        for signal in message.signals:
            assert signal.name == "Crc" or signal.comment, f"{message.name}.{signal.name}"


def data_id(family: int, node: int, counter: int) -> int:
    return (32 * family + node + 17 * counter) % 251


def test_data_identifiers_are_distinct_on_every_network() -> None:
    """Any node 1..32 may send any of the four families: no two of them share a data identifier at any counter."""
    for counter in range(16):
        identifiers = [data_id(family, node, counter) for family in range(4) for node in range(1, 33)]
        assert len(set(identifiers)) == len(identifiers) == 128
        assert all(0 <= identifier <= 250 for identifier in identifiers)


def test_data_identifiers_of_a_message_are_distinct(database: Database) -> None:
    """A message's own list has no value twice, so that a frame of another counter fails its CRC."""
    pairs = [pair for message in database.messages if (pair := e2e_of(message)) is not None]
    assert len(set(pairs)) == len(pairs) == len(database.messages) - 2  # SYNC and the heartbeat have no header
    for family, node in pairs:
        assert len({data_id(family, node, counter) for counter in range(16)}) == 16

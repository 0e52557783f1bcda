# SPDX-License-Identifier: MIT
"""The flight codec against three oracles that share no code with it: cantools, its generated C, and autosar-e2e."""

from __future__ import annotations

import math
import os
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cantools
import e2e.p02
import numpy as np
import pytest
from cantools.database.can import Database, Message, c_source
from cffi import FFI

from zygos.arm import load_arm
from zygos.native.flight import Flight, ffi, lib

ROOT = Path(__file__).resolve().parents[2]
INCLUDE = ROOT / "include" / "zygos"
TURN = 2.0 * math.pi
I24 = 2**23
I16 = 2**15
INVALID = -I24
SYNC_NODE = 0


@dataclass(frozen=True)
class Kind:
    """One message of the DBC as the codec knows it."""

    name: str
    message: int
    node: int
    family: int
    signals: tuple[str, ...]
    """Signals in `zygos_record_t.code`, in order."""
    bits: int = 24


KINDS = (
    *(Kind(f"JOINT{n}_ANGLES", lib.ZYGOS_MSG_ANGLES, n, 0, ("LinkAngle", "MotorAngle")) for n in range(1, 8)),
    *(Kind(f"JOINT{n}_TORQUE", lib.ZYGOS_MSG_TORQUE, n, 1, ("Torque",)) for n in range(1, 8)),
    Kind("IMU_RATE_XY", lib.ZYGOS_MSG_RATE_XY, 16, 0, ("RateX", "RateY")),
    Kind("IMU_RATE_Z", lib.ZYGOS_MSG_RATE_Z, 16, 2, ("RateZ",)),
    Kind("IMU_RATE", lib.ZYGOS_MSG_RATE_COARSE, 16, 0, ("RateX", "RateY", "RateZ"), bits=16),
    Kind("FTIME", lib.ZYGOS_MSG_FTIME, 32, 2, ()),
)
BY_NAME = {kind.name: kind for kind in KINDS}
every_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)


def load(name: str) -> Database:
    database = cantools.database.load_file(INCLUDE / name)
    assert isinstance(database, Database)
    return database


DATABASE = load("zygos.dbc")
COARSE = load("zygos-coarse-gyro.dbc")


def message_of(kind: Kind) -> Message:
    database = COARSE if kind.name == "IMU_RATE" else DATABASE
    return database.get_message_by_name(kind.name)


def raw_values(kind: Kind, count: int, seed: int) -> Iterator[dict[str, int]]:
    """Raw signal values of a message: the edges of each signal first, then random ones. Crc is left out."""
    rng = np.random.default_rng(seed)
    ranges: dict[str, tuple[int, int]] = {"Counter": (0, 15), "Status": (0, 15)}
    half = 2 ** (kind.bits - 1)
    ranges |= {name: (-half, half - 1) for name in kind.signals}
    if kind.message == lib.ZYGOS_MSG_TORQUE:
        ranges |= {"Latch": (0, 65535), "Temperature": (-128, 127)}
    if kind.message == lib.ZYGOS_MSG_FTIME:
        ranges |= {"Sync": (1, 240), "Time": (0, 2**32 - 1)}
    middle = {name: (low + high) // 2 for name, (low, high) in ranges.items()}
    for name, (low, high) in ranges.items():
        edges = {low, low + 1, high - 1, high} | {value for value in (-1, 0, 1) if low <= value <= high}
        yield from (middle | {name: value} for value in sorted(edges))
    for _ in range(count):
        yield {name: int(rng.integers(low, high, endpoint=True)) for name, (low, high) in ranges.items()}


def record_of(kind: Kind, values: dict[str, int]) -> Any:
    record = ffi.new("zygos_record_t *")
    record.counter = values["Counter"]
    record.status = values["Status"]
    record.sync = values.get("Sync", 0)
    record.time_us = values.get("Time", 0)
    record.latch_us = values.get("Latch", 0)
    record.temperature = values.get("Temperature", 0)
    for i, name in enumerate(kind.signals):
        record.code[i] = values[name]
    return record


def values_of(kind: Kind, record: Any) -> dict[str, int]:
    values = {"Counter": record.counter, "Status": record.status}
    values |= {name: record.code[i] for i, name in enumerate(kind.signals)}
    if kind.message == lib.ZYGOS_MSG_TORQUE:
        values |= {"Latch": record.latch_us, "Temperature": record.temperature}
    if kind.message == lib.ZYGOS_MSG_FTIME:
        values |= {"Sync": record.sync, "Time": record.time_us}
    return values


def encode(kind: Kind, values: dict[str, int]) -> Any:
    frame = ffi.new("zygos_frame_t *")
    assert lib.zygos_wire_encode(record_of(kind, values), kind.message, kind.node, frame) == 1
    return frame


def decode(kind: Kind, frame: Any) -> tuple[int, dict[str, int]]:
    """Fault and values. Checks that a record that must not be filled is not touched."""
    record = ffi.new("zygos_record_t *")
    ffi.buffer(record)[:] = b"\xa5" * ffi.sizeof("zygos_record_t")
    fault = lib.zygos_wire_decode(frame, kind.message, kind.node, record)
    if fault != lib.ZYGOS_WIRE_OK:
        assert bytes(ffi.buffer(record)) == b"\xa5" * ffi.sizeof("zygos_record_t")
    return fault, values_of(kind, record)


def data_of(frame: Any) -> bytes:
    return bytes(ffi.buffer(frame.data))[: frame.length]


def frame_of(identifier: int, data: bytes, length: int | None = None) -> Any:
    """A frame; the bytes beyond its data are filled, since nobody may read them."""
    frame = ffi.new("zygos_frame_t *")
    frame.id, frame.length = identifier, len(data) if length is None else length
    frame.data = data.ljust(8, b"\x5a")
    return frame


def data_ids(family: int, node: int) -> bytes:
    return bytes((32 * family + node + 17 * counter) % 251 for counter in range(16))


def reseal(kind: Kind, data: bytes) -> bytes:
    """The same data with the CRC that autosar-e2e computes."""
    sealed = bytearray(data)
    e2e.p02.e2e_p02_protect(sealed, data_ids(kind.family, kind.node), increment_counter=False)
    return bytes(sealed)


# cantools


@every_kind
def test_same_bytes_as_cantools(kind: Kind) -> None:
    message = message_of(kind)
    for values in raw_values(kind, 300, seed=kind.node):
        frame = encode(kind, values)
        data = data_of(frame)
        assert (frame.id, frame.flags) == (message.frame_id, 0)
        assert data == message.encode(values | {"Crc": data[0]}, scaling=False, strict=False)
        assert message.decode(data, scaling=False, decode_choices=False) == values | {"Crc": data[0]}
        assert decode(kind, frame_of(frame.id, data)) == (lib.ZYGOS_WIRE_OK, values)


def test_sync_as_cantools() -> None:
    message = DATABASE.get_message_by_name("SYNC")
    for counter in range(1, 241):
        record = ffi.new("zygos_record_t *", {"sync": counter})
        frame = ffi.new("zygos_frame_t *")
        assert lib.zygos_wire_encode(record, lib.ZYGOS_MSG_SYNC, SYNC_NODE, frame) == 1
        assert (frame.id, data_of(frame)) == (message.frame_id, message.encode({"Counter": counter}))
        decoded = ffi.new("zygos_record_t *")
        assert lib.zygos_wire_decode(frame, lib.ZYGOS_MSG_SYNC, SYNC_NODE, decoded) == lib.ZYGOS_WIRE_OK
        assert (decoded.sync, decoded.counter) == (counter, counter % 16)


SCALES: dict[str, tuple[Callable[[int], float], Callable[[float], int], float, int, str, str]] = {
    # decode, encode, LSB, half the number of codes, a message and signal of that scale
    "angle": (lib.zygos_wire_angle, lib.zygos_wire_angle_code, TURN / 2**20, I24, "JOINT1_ANGLES", "LinkAngle"),
    "torque": (lib.zygos_wire_torque, lib.zygos_wire_torque_code, 1e-4, I24, "JOINT1_TORQUE", "Torque"),
    "rate-fine": (lib.zygos_wire_rate_fine, lib.zygos_wire_rate_fine_code, 2.0**-21, I24, "IMU_RATE_Z", "RateZ"),
    "rate-coarse": (lib.zygos_wire_rate_coarse, lib.zygos_wire_rate_coarse_code, 2.0**-13, I16, "IMU_RATE", "RateZ"),
}
every_scale = pytest.mark.parametrize("scale", SCALES)


def codes(half: int, seed: int = 0) -> list[int]:
    rng = np.random.default_rng(seed)
    return [1 - half, 2 - half, -1, 0, 1, half - 2, *rng.integers(1 - half, half - 1, 1000).tolist()]


@every_scale
def test_same_units_as_cantools(scale: str) -> None:
    to_si, to_code, lsb, half, name, signal_name = SCALES[scale]
    signal = message_of(BY_NAME[name]).get_signal_by_name(signal_name)
    rng = np.random.default_rng(5)
    for code in codes(half):
        assert to_si(code) == pytest.approx(signal.raw_to_scaled(code, decode_choices=False), rel=3e-16, abs=0)
        assert to_code(to_si(code)) == code
        assert signal.scaled_to_raw(to_si(code)) == code
        value = (code + float(rng.uniform(-0.499, 0.499))) * lsb
        assert to_code(value) == signal.scaled_to_raw(value) == code


@every_scale
def test_rounds_to_nearest_ties_to_even(scale: str) -> None:
    _, to_code, lsb, half, _, _ = SCALES[scale]
    if scale.startswith("rate"):  # a tie has an exact double
        for code in codes(half):
            assert to_code((code + 0.5) * lsb) == code + (code % 2)
    for value in np.random.default_rng(6).uniform(-0.999, 0.999, 1000) * half * lsb:
        assert abs(to_code(value) - value / lsb) <= 0.5 + 1e-8


@pytest.mark.parametrize("scale", ["torque", "rate-fine", "rate-coarse"])
def test_saturates(scale: str) -> None:
    _, to_code, lsb, half, _, _ = SCALES[scale]
    low, high = -half, half - 1
    for factor in (1.0, 1.0000001, 2.0, 1e6, 1e300, math.inf):
        assert to_code(half * lsb * factor) == high
        assert to_code(-half * lsb * factor) == low
    assert to_code(math.nan) == low
    assert to_code(-math.nan) == low
    assert to_code((high - 0.6) * lsb) == high - 1
    assert to_code((low + 0.6) * lsb) == low + 1


def test_angles_wrap_and_are_never_the_invalid_code() -> None:
    code_of, lsb = lib.zygos_wire_angle_code, TURN / 2**20
    for value in (math.nan, math.inf, -math.inf, 1e9, -1e9, 1e300):
        assert code_of(value) == INVALID
    rng = np.random.default_rng(7)
    for value in [*rng.uniform(-8 * TURN, 8 * TURN, 2000), *rng.uniform(-1e6, 1e6, 2000)]:
        code = code_of(value)
        assert INVALID < code < I24
        turns = (value - code * lsb) / (16 * TURN)
        # Near -8 turns the invalid code gives way to its neighbour.
        assert abs(turns - round(turns)) * 2**24 <= 1.0 + 1e-3
    for k in range(-20, 21):
        assert code_of(1.0 + 16 * TURN * k) == code_of(1.0)
        assert code_of(8 * TURN * (2 * k + 1)) == INVALID + 1


@every_kind
def test_codes_outside_the_field_saturate(kind: Kind) -> None:
    half = 2 ** (kind.bits - 1)
    for i, name in enumerate(kind.signals):
        for code, expected in ((half, half - 1), (2**31 - 1, half - 1), (-half - 1, -half), (-(2**31), -half)):
            values = next(raw_values(kind, 1, seed=1))
            record = record_of(kind, values)
            record.code[i] = code
            frame = ffi.new("zygos_frame_t *")
            assert lib.zygos_wire_encode(record, kind.message, kind.node, frame) == 1
            assert decode(kind, frame) == (lib.ZYGOS_WIRE_OK, values | {name: expected})


# The C that cantools generates


def snake(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


class GeneratedC:
    """The generated C of both DBCs, compiled and loaded. Only IMU_RATE is in that of the coarse gyro alone."""

    def __init__(self, folder: Path) -> None:
        headers = []
        for prefix, name in (("fine", "zygos.dbc"), ("coarse", "zygos-coarse-gyro.dbc")):
            files = (f"{prefix}.h", f"{prefix}.c", f"{prefix}_fuzzer.c")
            header, source, *_ = c_source.generate(load(name), prefix, *files)
            (folder / files[0]).write_text(header, encoding="ascii")
            (folder / files[1]).write_text(source, encoding="ascii")
            headers.append(re.sub(r"/\*.*?\*/", "", header, flags=re.DOTALL))
        library = folder / "wire.so"
        command = [*shlex.split(os.environ.get("CC", "cc")), "-shared", "-fPIC", "-O0", "-o", str(library)]
        subprocess.run([*command, str(folder / "fine.c"), str(folder / "coarse.c")], check=True)
        declaration = r"^struct \w+ \{.*?^\};|^(?:int|double|bool|u?int\d+_t|float) \w+\([^;]*;"
        declarations = re.findall(declaration, "\n".join(headers), re.M | re.S)
        self.ffi = FFI()
        self.ffi.cdef("\n".join(declarations))
        self.lib = self.ffi.dlopen(str(library))

    def _symbol(self, name: str) -> str:
        return f"{'coarse' if name == 'IMU_RATE' else 'fine'}_{snake(name)}"

    def pack(self, name: str, values: dict[str, Any]) -> bytes:
        """Bytes of a message from its raw values."""
        symbol = self._symbol(name)
        struct = self.ffi.new(f"struct {symbol}_t *", {snake(key): value for key, value in values.items()})
        data = self.ffi.new("uint8_t[8]")
        length = getattr(self.lib, f"{symbol}_pack")(data, struct, 8)
        assert length > 0
        return bytes(self.ffi.buffer(data))[:length]

    def unpack(self, name: str, data: bytes, names: list[str]) -> dict[str, Any]:
        """Raw values of the named signals."""
        symbol = self._symbol(name)
        struct = self.ffi.new(f"struct {symbol}_t *")
        assert getattr(self.lib, f"{symbol}_unpack")(struct, data, len(data)) == 0
        return {key: getattr(struct, snake(key)) for key in names}

    def scaled(self, name: str, signal: str, code: int) -> float:
        """SI value of a code."""
        return float(getattr(self.lib, f"{self._symbol(name)}_{snake(signal)}_decode")(code))


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> GeneratedC:
    return GeneratedC(tmp_path_factory.mktemp("generated"))


@every_kind
def test_same_bytes_as_generated_c(kind: Kind, generated: GeneratedC) -> None:
    for values in raw_values(kind, 300, seed=100 + kind.node):
        data = data_of(encode(kind, values))
        assert data == generated.pack(kind.name, values | {"Crc": data[0]})
        assert generated.unpack(kind.name, data, list(values)) == values


@every_scale
def test_same_units_as_generated_c(scale: str, generated: GeneratedC) -> None:
    to_si, _, _, half, name, signal = SCALES[scale]
    for code in codes(half):
        assert to_si(code) == pytest.approx(generated.scaled(name, signal, code), rel=3e-16, abs=0)


def test_generated_c_has_the_sync(generated: GeneratedC) -> None:
    assert generated.pack("SYNC", {"Counter": 240}) == b"\xf0"


# autosar-e2e


@every_kind
def test_same_crc_as_autosar_e2e(kind: Kind) -> None:
    for values in raw_values(kind, 200, seed=200 + kind.node):
        data = data_of(encode(kind, values))
        assert data == reseal(kind, data)
        assert e2e.p02.e2e_p02_check(data, data_ids(kind.family, kind.node), length=len(data))
        assert data[0] == lib.zygos_wire_crc(data, len(data), kind.family, kind.node)


def test_crc_of_every_length_family_and_node() -> None:
    rng = np.random.default_rng(8)
    for family in range(4):
        for node in range(1, 33):
            for length in range(2, 9):
                data = bytearray(rng.bytes(length))
                crc = lib.zygos_wire_crc(bytes(data), length, family, node)
                e2e.p02.e2e_p02_protect(data, data_ids(family, node), increment_counter=False)
                assert crc == data[0]


# Rejection


@every_kind
def test_a_wrong_length_is_rejected(kind: Kind) -> None:
    good = data_of(encode(kind, next(raw_values(kind, 1, seed=3))))
    for length in range(256):
        frame = frame_of(message_of(kind).frame_id, good, length)
        expected = lib.ZYGOS_WIRE_OK if length == len(good) else lib.ZYGOS_WIRE_LENGTH
        assert decode(kind, frame)[0] == expected


@every_kind
def test_up_to_three_wrong_bits_are_found(kind: Kind) -> None:
    """Hamming distance 4 over all 64 bits; bits of the counter apart, which choose another data identifier."""
    values = next(raw_values(kind, 1, seed=4)) | {"Counter": 5}
    good = int.from_bytes(data := data_of(encode(kind, values)), "little")
    frame = frame_of(message_of(kind).frame_id, data)
    view = ffi.buffer(frame.data)
    record = ffi.new("zygos_record_t *")
    bits = [bit for bit in range(8 * len(data)) if not 8 <= bit < 12]
    for count in (1, 2, 3):
        for chosen in combinations(bits, count):
            mask = sum(1 << bit for bit in chosen)
            view[: len(data)] = (good ^ mask).to_bytes(len(data), "little")
            assert lib.zygos_wire_decode(frame, kind.message, kind.node, record) == lib.ZYGOS_WIRE_CRC


@every_kind
def test_a_single_wrong_bit_in_the_counter_is_found(kind: Kind) -> None:
    for counter in range(16):
        data = bytearray(data_of(encode(kind, next(raw_values(kind, 1, seed=4)) | {"Counter": counter})))
        for bit in range(4):
            wrong = bytearray(data)
            wrong[1] ^= 1 << bit
            assert decode(kind, frame_of(message_of(kind).frame_id, bytes(wrong)))[0] == lib.ZYGOS_WIRE_CRC


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.message != lib.ZYGOS_MSG_FTIME], ids=lambda k: k.name)
def test_a_frame_of_another_message_is_rejected(kind: Kind) -> None:
    """A frame under a wrong identifier: its data identifier gives it away, at every counter."""
    for values in raw_values(kind, 50, seed=9):
        frame = encode(kind, values)
        for other in KINDS:
            if (other.family, other.node) != (kind.family, kind.node):
                assert decode(other, frame)[0] in (lib.ZYGOS_WIRE_CRC, lib.ZYGOS_WIRE_LENGTH)


def test_sync_counters_outside_their_range_are_rejected() -> None:
    time = BY_NAME["FTIME"]
    values = next(raw_values(time, 1, seed=10))
    record = ffi.new("zygos_record_t *")
    for counter in range(256):
        expected = lib.ZYGOS_WIRE_OK if 1 <= counter <= 240 else lib.ZYGOS_WIRE_RANGE
        assert decode(time, encode(time, values | {"Sync": counter}))[0] == expected
        sync = frame_of(0x080, bytes([counter]))
        assert lib.zygos_wire_decode(sync, lib.ZYGOS_MSG_SYNC, SYNC_NODE, record) == expected
    for length in (0, 2, 8, 255):
        sync = frame_of(0x080, b"\x01", length)
        assert lib.zygos_wire_decode(sync, lib.ZYGOS_MSG_SYNC, SYNC_NODE, record) == lib.ZYGOS_WIRE_LENGTH


@pytest.mark.parametrize("message", [0, 8, 255, 2**32 - 1])
def test_what_is_no_message_is_not_encoded(message: int) -> None:
    frame = frame_of(0x123, b"untouche")
    before = bytes(ffi.buffer(frame))
    assert lib.zygos_wire_encode(ffi.new("zygos_record_t *"), message, 1, frame) == 0
    assert bytes(ffi.buffer(frame)) == before


# Telemetry


def decode_telemetry(frame: Any) -> tuple[int, int, int, int, float]:
    counter, index, kind = (ffi.new("uint8_t *", 0xA5) for _ in range(3))
    value = ffi.new("float *", 0.125)
    fault = lib.zygos_wire_decode_telemetry(frame, counter, index, kind, value)
    return fault, counter[0], index[0], kind[0], value[0]


def test_telemetry_against_all_three(generated: GeneratedC) -> None:
    message = DATABASE.get_message_by_name("TELEMETRY")
    names = {next(iter(s.multiplexer_ids)): s.name for s in message.signals if s.multiplexer_ids}
    places = sorted(names)
    assert len(places) == 5 * 12 + 38 + 14 + 16
    rng = np.random.default_rng(11)
    largest = float(np.finfo(np.float32).max)
    numbers = [0.0, -0.0, 1.0, largest, -largest, 1e-45, 1.17549435e-38, *rng.normal(size=200).astype(np.float32)]
    for i, number in enumerate(map(float, numbers)):
        place, counter = places[i % len(places)], i % 16
        kind, index = divmod(place, 256)
        frame = ffi.new("zygos_frame_t *")
        lib.zygos_wire_encode_telemetry(counter, index, kind, number, frame)
        data = data_of(frame)
        value = float(np.float32(number))
        values = {"Crc": data[0], "Counter": counter, "Status": 0, "Item": place, names[place]: value}
        assert frame.id == message.frame_id
        assert data == message.encode(values, strict=False)
        assert message.decode(data, decode_choices=False) == values
        assert data == generated.pack("TELEMETRY", values)
        assert e2e.p02.e2e_p02_check(data, data_ids(3, 32), length=8)
        assert decode_telemetry(frame) == (lib.ZYGOS_WIRE_OK, counter, index, kind, value)


def test_telemetry_that_is_no_number_is_rejected() -> None:
    frame = ffi.new("zygos_frame_t *")
    untouched = (0xA5, 0xA5, 0xA5, 0.125)
    for value in (math.nan, math.inf, -math.inf):
        lib.zygos_wire_encode_telemetry(3, 4, 0, value, frame)
        assert decode_telemetry(frame) == (lib.ZYGOS_WIRE_RANGE, *untouched)
    lib.zygos_wire_encode_telemetry(3, 4, 0, 1.0, frame)
    frame.data[5] ^= 1
    assert decode_telemetry(frame) == (lib.ZYGOS_WIRE_CRC, *untouched)
    frame.data[5] ^= 1
    frame.length = 7
    assert decode_telemetry(frame) == (lib.ZYGOS_WIRE_LENGTH, *untouched)


# What the receiver does with it


@pytest.fixture
def flight() -> Flight:
    return Flight(load_arm(ROOT / "examples" / "paper" / "arm.toml"))


def give(flight: Flight, frame: Any) -> str | None:
    """Hands a frame over. Returns None when it was accepted, "foreign", or the one fault that was counted."""
    before = flight.faults
    verdict = lib.zygos_arm_frame(flight.native, frame)
    risen = [name for name, count in flight.faults.items() if count != before[name]]
    if verdict == lib.ZYGOS_REJECTED:
        (fault,) = risen
        return fault
    assert not risen
    return "foreign" if verdict == lib.ZYGOS_FOREIGN else None


def sync(counter: int) -> Any:
    return frame_of(0x080, bytes([counter]))


def joint_values(counter: int, **values: int) -> dict[str, int]:
    return {"Counter": counter, "Status": 15, "LinkAngle": 1, "MotorAngle": 2, "Torque": 3} | values


def test_faults_have_names(flight: Flight) -> None:
    angles, torque, time = BY_NAME["JOINT1_ANGLES"], BY_NAME["JOINT1_TORQUE"], BY_NAME["FTIME"]
    assert give(flight, encode(angles, joint_values(5))) == "unsynced"
    assert give(flight, sync(5)) is None
    assert give(flight, encode(angles, joint_values(4))) == "late"
    for counter in (0, 3, 6, 15):
        assert give(flight, encode(angles, joint_values(counter))) == "counter"
    assert give(flight, encode(time, {"Counter": 6, "Status": 0, "Sync": 6})) == "counter"
    assert give(flight, encode(time, {"Counter": 5, "Status": 0, "Sync": 5, "Time": 7})) is None
    wrong = encode(angles, joint_values(5))
    wrong.data[0] ^= 0xFF
    assert give(flight, wrong) == "crc"
    assert give(flight, frame_of(0x181, b"")) == "length"
    assert give(flight, sync(0)) == "range"
    assert give(flight, sync(241)) == "range"
    assert give(flight, encode(angles, joint_values(5))) is None
    assert give(flight, encode(angles, joint_values(5))) == "repeated"
    assert give(flight, encode(torque, joint_values(5, Status=15 - 4))) == "torque_invalid"
    assert give(flight, encode(torque, joint_values(5, Status=15 - 8))) == "disabled"
    for code in (-I24, I24 - 1):
        assert give(flight, encode(torque, joint_values(5, Torque=code))) == "saturated"
    assert give(flight, encode(torque, joint_values(5, Latch=60000))) == "latch"
    second = BY_NAME["JOINT2_ANGLES"]
    assert give(flight, encode(second, joint_values(5, LinkAngle=INVALID))) == "link_invalid"
    assert give(flight, encode(second, joint_values(5, MotorAngle=INVALID))) == "motor_invalid"
    assert give(flight, encode(second, joint_values(5, Status=15 - 1))) == "link_invalid"
    assert give(flight, encode(second, joint_values(5, Status=15 - 2))) == "motor_invalid"
    assert give(flight, sync(5)) == "sync_repeated"


def test_not_ours(flight: Flight) -> None:
    frame = encode(BY_NAME["JOINT1_ANGLES"], joint_values(5))
    assert give(flight, sync(5)) is None
    for flag in (lib.ZYGOS_FRAME_EXTENDED, lib.ZYGOS_FRAME_REMOTE, lib.ZYGOS_FRAME_FD):
        frame.flags = flag
        assert give(flight, frame) == "foreign"
    frame.flags = 0
    for identifier in (0x081, 0x180, 0x183, 0x1A0, 0x381, 0x10000181, 0xFFFFFFFF):
        frame.id = identifier
        assert give(flight, frame) == "foreign"
    frame.id = 0x181
    assert give(flight, frame) is None

# SPDX-License-Identifier: MIT
"""`zygos dbc`: what an arm's DBC says of its frames is what the C library says, and two parsers read it alike."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import canmatrix.formats
import cantools
import numpy as np
import pytest
from cantools.database.can import Database
from cli_support import run
from e2e.p02 import e2e_p02_check
from numpy.typing import NDArray
from wire_support import SEVEN_NODES, arm_text, wandering

from conftest import EXAMPLE
from zygos.arm import Arm, load_arm
from zygos.can.dbc import joint_names
from zygos.model.model import load_model
from zygos.native.flight import FRAME, Flight, encode, ffi, lib
from zygos.simulation.plant import Trajectory

Log = NDArray[Any]
SEVEN = ("yaw", "pitch", "roll", "elbow", "w1", "w2", "w3")
ANGLE, TORQUE = 2.0 * math.pi / 2**20, 1e-4


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str | Path], tuple[Arm, Path]]:
    """Writes the DBC of an arm file, or of the text of one, by the command."""

    def write(source: str | Path) -> tuple[Arm, Path]:
        path = source if isinstance(source, Path) else tmp_path / "arm.toml"
        if isinstance(source, str):
            path.write_text(source, encoding="utf-8")
        out = tmp_path / "arm.dbc"
        assert run("dbc", "--arm", path, "-o", out) == 0
        return load_arm(path), out

    return write


def database(path: Path) -> Database:
    loaded = cantools.database.load_file(path, strict=True)
    assert isinstance(loaded, Database)
    return loaded


def matrix(path: Path) -> Any:
    (found,) = canmatrix.formats.loadp(str(path)).values()
    assert not found.load_errors
    return found


def values_of(dbc: Database, frame: Any) -> dict[tuple[str, str], float]:
    """The value of each signal by message and name. The frame must be known and pass its E2E check.

    The data identifiers are those that the comment of the Crc signal lists.
    """
    message = dbc.get_message_by_frame_id(int(frame["id"]))
    data = bytes(frame["data"][: frame["length"]])
    assert len(data) == message.length
    values = message.decode(data, decode_choices=False)
    assert isinstance(values, Mapping)
    if message.name != "SYNC":
        listed = (message.get_signal_by_name("Crc").comment or "").split(": ")[-1].rstrip(".")
        assert e2e_p02_check(data, bytes(map(int, listed.split())), length=0)
    return {(message.name, name): float(value) for name, value in values.items()}


def decoded(dbc: Database, frames: Log) -> list[dict[tuple[str, str], float]]:
    """`values_of` the frames of each cycle together."""
    cycles: list[dict[tuple[str, str], float]] = []
    for frame in frames:
        if frame["id"] == 0x080:
            cycles.append({})
        cycles[-1].update(values_of(dbc, frame))
    return cycles


def signals_of(arm: Arm, names: tuple[str, ...]) -> dict[str, list[tuple[str, str]]]:
    """Message and signal of each column that the receiver fills; names are those of the joints in the DBC."""
    coarse = arm.imu.resolution == "coarse"
    gyro = ["IMU_RATE"] * 3 if coarse else ["IMU_RATE_XY", "IMU_RATE_XY", "IMU_RATE_Z"]
    return {
        "q": [(f"{name}_ANGLES", f"{name}_LinkAngle") for name in names],
        "theta": [(f"{name}_ANGLES", f"{name}_MotorAngle") for name in names],
        "tau": [(f"{name}_TORQUE", f"{name}_Torque") for name in names],
        "omega": [(message, f"Rate{axis}") for message, axis in zip(gyro, "XYZ", strict=True)],
    }


def check_run(arm: Arm, path: Path, names: tuple[str, ...], frames: Log) -> None:
    """What the DBC makes of a run is what the C receiver makes of it."""
    flight = Flight(arm)
    trace = flight.frames(frames, trace=True)
    assert trace is not None
    assert not any(flight.faults.values())
    read = decoded(database(path), frames)[:-1]  # no SYNC closes the last one
    assert len(read) == len(trace.cycles) > 100
    step = 2.0**-13 if arm.imu.resolution == "coarse" else 2.0**-21
    for (column, signals), lsb in zip(signals_of(arm, names).items(), (ANGLE, ANGLE, TORQUE, step), strict=True):
        found = np.array([[cycle[signal] for signal in signals] for cycle in read])
        expected = getattr(trace.cycles, column)
        assert np.abs(expected).max() > 1000 * lsb
        assert np.abs(found - expected).max() < 1e-6 * lsb
    latches = [[cycle[f"{name}_TORQUE", f"{name}_Latch"] for name in names] for cycle in read]
    assert np.array_equal(latches, [[joint.latch_us for joint in arm.joints]] * len(read))
    seconds = [cycle["FTIME", "Time"] * 1e-6 for cycle in read if ("FTIME", "Time") in cycle]
    assert np.allclose(np.diff(seconds), 50 * arm.period_s, atol=1.1e-6)
    assert len(seconds) == math.ceil(len(read) / 50)


@pytest.mark.slow
def test_the_example_is_decoded_as_the_receiver_does(
    written: Callable[[str | Path], tuple[Arm, Path]], noisy: Trajectory
) -> None:
    arm, path = written(EXAMPLE / "arm.toml")
    check_run(arm, path, ("shoulder", "elbow"), encode(arm, noisy.cycles(0)))


@pytest.mark.slow
@pytest.mark.parametrize("gyro", ["fine", "coarse"])
def test_seven_joints_are_decoded_as_the_receiver_does(
    written: Callable[[str | Path], tuple[Arm, Path]], gyro: str
) -> None:
    arm, path = written(arm_text(SEVEN, SEVEN_NODES, gyro=gyro))
    check_run(arm, path, SEVEN, encode(arm, wandering(arm, 300, 0)))


@pytest.mark.slow
def test_a_fixed_base_is_decoded_as_the_library_does(written: Callable[[str | Path], tuple[Arm, Path]]) -> None:
    _, path = written(arm_text(SEVEN, SEVEN_NODES, gyro=None, kinetic="spatial"))
    dbc = database(path)
    kinds = {"SYNC": (lib.ZYGOS_MSG_SYNC, 0), "FTIME": (lib.ZYGOS_MSG_FTIME, 32)}
    for name, node in zip(SEVEN, SEVEN_NODES, strict=True):
        kinds[f"{name}_ANGLES"] = (lib.ZYGOS_MSG_ANGLES, node)
        kinds[f"{name}_TORQUE"] = (lib.ZYGOS_MSG_TORQUE, node)
    assert {message.name for message in dbc.messages} == {*kinds, "TELEMETRY", "HEARTBEAT"}
    rng = np.random.default_rng(0)
    record, answer, frame = ffi.new("zygos_record_t *"), ffi.new("zygos_record_t *"), ffi.new("zygos_frame_t *")
    for counter in range(1, 241):
        record.counter, record.sync, record.status = counter % 16, counter, 15
        record.time_us, record.latch_us = int(rng.integers(2**32)), int(rng.integers(2**16))
        record.temperature = int(rng.integers(-128, 128))
        for message, node in kinds.values():
            record.code = rng.integers(1 - 2**23, 2**23 - 1, 3).tolist()
            assert lib.zygos_wire_encode(record, message, node, frame) == 1
            assert lib.zygos_wire_decode(frame, message, node, answer) == lib.ZYGOS_WIRE_OK
            found = values_of(dbc, np.frombuffer(ffi.buffer(frame), dtype=FRAME)[0])
            own = {signal.split("_")[-1]: value for (_, signal), value in found.items()}
            expected: dict[str, float] = {"Counter": answer.counter, "Status": answer.status, "Crc": frame.data[0]}
            if message == lib.ZYGOS_MSG_ANGLES:
                expected["LinkAngle"] = lib.zygos_wire_angle(answer.code[0])
                expected["MotorAngle"] = lib.zygos_wire_angle(answer.code[1])
            elif message == lib.ZYGOS_MSG_TORQUE:
                expected["Torque"] = lib.zygos_wire_torque(answer.code[0])
                expected |= {"Latch": answer.latch_us, "Temperature": answer.temperature}
            elif message == lib.ZYGOS_MSG_FTIME:
                expected |= {"Sync": answer.sync, "Time": answer.time_us}
            else:
                expected = {"Counter": answer.sync}
            assert own == pytest.approx(expected, rel=1e-12, abs=0.0)


@pytest.mark.slow
def test_two_parsers_agree(written: Callable[[str | Path], tuple[Arm, Path]]) -> None:
    """cantools and canmatrix share no code: same frames, and the same values of every signal of a run. Two names have
    marks that comments must escape."""
    arm, path = written(arm_text(('the "left"', "back\\slash\nline;", *SEVEN[2:]), SEVEN_NODES))
    first, second = database(path), matrix(path)
    assert {(f.name, f.arbitration_id.id, f.size) for f in second.frames} == {
        (message.name, message.frame_id, message.length) for message in first.messages
    }
    assert sorted(ecu.name for ecu in second.ecus) == sorted(
        ["COMPUTER", "IMU", "the_left", "back_slash_line", *SEVEN[2:]]
    )
    for message in first.messages:
        frame = second.frame_by_name(message.name)
        assert frame.transmitters == message.senders
        assert frame.cycle_time == message.cycle_time
        assert frame.comment == message.comment
        for signal in message.signals:
            other = frame.signal_by_name(signal.name)
            assert (other.unit, float(other.factor)) == (signal.unit or "", signal.scale)
            assert (float(other.min), float(other.max)) == (signal.minimum, signal.maximum)
            assert other.comment == signal.comment
            assert {k: str(v) for k, v in other.values.items()} == {
                k: str(v) for k, v in (signal.choices or {}).items()
            }
            assert sorted(other.receivers) == sorted(set(signal.receivers) - {"Vector__XXX"})
    for record in encode(arm, wandering(arm, 60, 1)):
        message = first.get_message_by_frame_id(int(record["id"]))
        data = bytes(record["data"][: record["length"]])
        values = message.decode(data, decode_choices=False)
        assert isinstance(values, dict)
        others = second.frame_by_name(message.name).decode(data)
        assert {name: float(found.phys_value) for name, found in others.items()} == pytest.approx(values, rel=1e-12)


@pytest.mark.slow
def test_messages_are_those_of_the_arm(written: Callable[[str | Path], tuple[Arm, Path]]) -> None:
    _, path = written(arm_text(SEVEN, SEVEN_NODES, gyro="coarse", imu_node=2))
    expected = {"SYNC": 0x080, "FTIME": 0x3A0, "TELEMETRY": 0x1A0, "HEARTBEAT": 0x720}
    expected |= {"IMU_RATE": 0x182, "IMU_ATTITUDE": 0x282}
    for name, node in zip(SEVEN, SEVEN_NODES, strict=True):
        expected |= {f"{name}_ANGLES": 0x180 + node, f"{name}_TORQUE": 0x280 + node}
    assert {message.name: message.frame_id for message in database(path).messages} == expected


def test_units_ranges_times_and_tables(written: Callable[[str | Path], tuple[Arm, Path]]) -> None:
    _, path = written(arm_text(("base yaw", "elbow"), (4, 30), period_s=0.0125))
    dbc = database(path)
    angles, torque = dbc.get_message_by_name("base_yaw_ANGLES"), dbc.get_message_by_name("elbow_TORQUE")
    assert (angles.senders, angles.receivers) == (["base_yaw"], {"COMPUTER"})
    assert dbc.get_message_by_name("SYNC").receivers == {"base_yaw", "elbow", "IMU"}
    link, latch = angles.get_signal_by_name("base_yaw_LinkAngle"), torque.get_signal_by_name("elbow_Latch")
    assert (link.unit, link.scale, link.maximum) == ("rad", pytest.approx(ANGLE), pytest.approx(16 * math.pi, rel=1e-6))
    assert (link.minimum, latch.unit) == (pytest.approx(-16 * math.pi, rel=1e-6), "us")
    assert {k: str(v) for k, v in (link.choices or {}).items()} == {-(2**23): "invalid"}
    moment = torque.get_signal_by_name("elbow_Torque")
    assert (moment.unit, moment.minimum, moment.maximum) == ("Nm", -838.8607, 838.8606)
    assert {k: str(v) for k, v in (moment.choices or {}).items()} == {
        -(2**23): "saturated_low",
        2**23 - 1: "saturated_high",
    }
    status = torque.get_signal_by_name("Status").choices
    assert status is not None and str(status[15]) == "ready" and str(status[7]) == "disabled"
    times = {message.name: message.cycle_time for message in dbc.messages}
    assert (times["SYNC"], times["elbow_TORQUE"], times["FTIME"]) == (12, 12, 625)
    assert times["HEARTBEAT"] == 1000
    assert "12.5 ms" in (dbc.get_message_by_name("SYNC").comment or "")
    assert "-1 * (reading - 0.25 rad)" in (dbc.get_message_by_name("elbow_ANGLES").signals[3].comment or "")
    assert latch.comment is not None and "10 us" in latch.comment
    for message in dbc.messages:
        assert message.comment
        assert all(signal.comment for signal in message.signals)
        node = {"COMPUTER": 32, "base_yaw": 4, "elbow": 30, "IMU": 9}[message.senders[0]]
        attributes = message.dbc.attributes if message.dbc is not None else {}
        if message.name not in ("SYNC", "HEARTBEAT"):
            assert attributes["E2ENode"].value == node
            assert message.frame_id == (0x180, 0x280, 0x380, 0x180)[attributes["E2EFamily"].value] + node


@pytest.mark.slow
@pytest.mark.parametrize(("kinetic", "gyro"), [("planar-symmetric", "fine"), ("planar", None), ("spatial", "coarse")])
def test_telemetry_names_each_parameter(
    written: Callable[[str | Path], tuple[Arm, Path]], kinetic: str, gyro: str | None
) -> None:
    """A value that the C library sends is found under the parameter's name, and no other."""
    arm, path = written(arm_text(SEVEN, SEVEN_NODES, gyro=gyro, kinetic=kinetic))
    gains = [(f"torque_gain{i + 1}", "1") for i in arm.relative_gains]
    assert len(gains) == arm.n - 1
    check_telemetry(path, [*zip(arm.parameter_names, arm.parameter_units, strict=True), *gains], len(gains))


def check_telemetry(path: Path, parameters: list[tuple[str, str]], effects: int = 0) -> None:
    """All that a library with these parameters sends is found by name: parameters as values, sigmas and half95, and all
    but the last of them, effects, also as refined values and their sigmas."""
    estimated = ((0, ""), (1, "_sigma"), (4, "_half95"))
    refined = ((5, "_refined"), (6, "_refined_sigma"))
    message, other = database(path).get_message_by_name("TELEMETRY"), matrix(path).frame_by_name("TELEMETRY")
    frame = ffi.new("zygos_frame_t *")
    seen = {"Crc", "Counter", "Status", "Item"}
    for index, (name, unit) in enumerate(parameters):
        plain = "_".join(re.findall("[A-Za-z0-9]+", name))
        for kind, end in (*estimated, *(refined if index < len(parameters) - effects else ())):
            value = 0.5 + index + kind
            lib.zygos_wire_encode_telemetry(3, index, kind, value, frame)
            data = bytes(frame.data)
            values = message.decode(data)
            assert isinstance(values, dict)
            assert set(values) == {"Crc", "Counter", "Status", "Item", plain + end}
            assert (values[plain + end], str(values["Item"])) == (
                value,
                (name + end).replace(end, end.replace("_", " ")),
            )
            assert message.get_signal_by_name(plain + end).unit == unit
            assert float(other.decode(data)[plain + end].phys_value) == value
            seen.add(plain + end)
    rest = {signal.name for signal in message.signals} - seen
    assert rest == {
        *(f"fault_{name}" for name, _ in ffi.typeof("zygos_faults_t").fields),
        *(f"count_{name}" for name in "cycles gaps invalid wraps accepted refused arcs arcs_dropped".split()),
        *(f"count_{name}" for name in "apart waited".split()),
        *(f"node_{name}" for name in "overflow misshapen down unsent corrupt unsaved".split()),
        *(f"verdict_{name}" for name in "validity reason cycle accepted refused arcs blocks rank condition".split()),
        *(f"verdict_{name}" for name in "cluster residual noise_ratio gate left_out".split()),
        *(f"refined_{name}" for name in "reason cycle used lost restarts rejected farthest distance level".split()),
        *(f"refined_{name}" for name in "level_error nis_link nis_motor nis_gyro".split()),
        *(f"refined_ratio_{name}" for name in "link motor gyro".split()),
    }


@pytest.mark.slow
def test_telemetry_names_effects(tmp_path: Path) -> None:
    """Those of a model, and the offsets that an unsure zero asks for."""
    text = (EXAMPLE / "arm.toml").read_text()
    assert "zero_sigma_rad = 0.0" in text
    (tmp_path / "arm.toml").write_text(text.replace("zero_sigma_rad = 0.0", "zero_sigma_rad = 1e-3", 1))
    lag = '\n[[effect]]\nkind = "torque_lag"\njoint = "elbow"\nvalue = 0.002\n'
    (tmp_path / "model.toml").write_text((EXAMPLE / "model.toml").read_text() + lag)
    command = ("dbc", "--arm", tmp_path / "arm.toml", "--model", tmp_path / "model.toml", "-o", tmp_path / "arm.dbc")
    assert run(*command) == 0
    flight = Flight(load_arm(tmp_path / "arm.toml"), load_model(tmp_path / "model.toml").effects)
    assert flight.names[12:] == ("torque_lag2", "spring_offset1")
    check_telemetry(tmp_path / "arm.dbc", list(zip(flight.names, flight.units, strict=True)), effects=2)
    dbc = database(tmp_path / "arm.dbc").get_message_by_name("TELEMETRY")
    assert dbc.get_signal_by_name("torque_lag2").comment == "Torque lag, joint 2, elbow."
    sigma = dbc.get_signal_by_name("torque_lag2_sigma").comment or ""
    assert sigma.endswith(" |torque_lag2| divided by it is the significance of the effect.")
    assert "significance" not in (dbc.get_signal_by_name("k1_sigma").comment or "")


FORTY = "the second joint of the arm on the left "
NAMES = [
    (("shoulder yaw", "elbow/pitch"), ("shoulder_yaw", "elbow_pitch")),
    (("Händchen", "Çubuk é"), ("Handchen", "Cubuk_e")),
    ((FORTY, "x"), ("the_second_joint_of", "x")),
    ((FORTY + "1", FORTY + "2"), ("the_second_joint_4", "the_second_joint_30")),
    (("a b", "a-b"), ("a_b_4", "a_b_30")),
    (("Elbow", "elbow"), ("Elbow_4", "elbow_30")),
    (("a_30", "a!"), ("a_30", "a")),
    (("7th", "42"), ("J7th", "J42")),
    (("плечо", "肘"), ("JOINT4", "JOINT30")),
    (("joint30", "肘"), ("joint30_4", "JOINT30_30")),
    (("IMU", "computer"), ("IMU_4", "computer_30")),
    (("BO_", "Vector__XXX"), ("BO", "Vector_XXX")),
    (('the "left"', "back\\slash\nline;"), ("the_left", "back_slash_line")),
]


@pytest.mark.parametrize(("names", "expected"), NAMES)
def test_names(names: tuple[str, str], expected: tuple[str, str], tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(arm_text(names, (4, 30)), encoding="utf-8")
    assert joint_names(load_arm(tmp_path / "arm.toml")) == expected


@pytest.mark.parametrize(("names", "expected"), [NAMES[3], NAMES[8]], ids=["long", "no letters"])
def test_names_in_the_dbc(
    written: Callable[[str | Path], tuple[Arm, Path]], names: tuple[str, str], expected: tuple[str, str]
) -> None:
    _, path = written(arm_text(names, (4, 30)))
    path.read_bytes().decode("ascii")
    first = database(path)
    assert [node.name for node in first.nodes] == ["COMPUTER", *expected, "IMU"]
    for name, node in zip(expected, (4, 30), strict=True):
        message = first.get_message_by_frame_id(0x180 + node)
        assert message.name == f"{name}_ANGLES"
        assert {signal.name for signal in message.signals} >= {f"{name}_LinkAngle", f"{name}_MotorAngle"}
    for message in first.messages:
        for word in (message.name, *message.senders, *(signal.name for signal in message.signals)):
            assert re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,31}", word)


def test_a_rigid_joint_says_so(written: Callable[[str | Path], tuple[Arm, Path]]) -> None:
    text = arm_text(("stiff", "soft"), (4, 30))
    start = text.index("link_encoder")
    text = text[:start] + "flexible = false\n" + text[text.index("motor_encoder") :]
    arm, path = written(text)
    dbc = database(path)
    rigid = dbc.get_message_by_name("stiff_ANGLES").get_signal_by_name("stiff_LinkAngle").comment
    assert rigid is not None and "rigid" in rigid
    assert "rigid" not in (dbc.get_message_by_name("soft_ANGLES").get_signal_by_name("soft_LinkAngle").comment or "")
    telemetry = {signal.name for signal in dbc.get_message_by_name("TELEMETRY").signals}
    assert telemetry >= set(arm.parameter_names)
    assert "k1" not in telemetry
    assert not any("refined" in name for name in telemetry)


def test_json_is_all_there_is_on_stdout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = tmp_path / "arm.toml"
    arm.write_text(arm_text(("Händchen", "x"), (4, 30)), encoding="utf-8")
    assert run("dbc", "--arm", arm, "-o", tmp_path / "new" / "arm.dbc", "--json", "-") == 0
    content = json.loads(capsys.readouterr().out)
    assert content["joints"] == {"Händchen": "Handchen", "x": "x"}
    assert [entry["name"] for entry in content["messages"]] == [
        message.name for message in database(tmp_path / "new" / "arm.dbc").messages
    ]


def many() -> str:
    return arm_text([f"j{i}" for i in range(10)], range(11, 21), kinetic="spatial")


@pytest.mark.parametrize(
    ("text", "out", "said"),
    [
        (None, "arm.dbc", "no such file"),
        ("name = ", "arm.dbc", "not valid TOML"),
        (arm_text(("a", "b"), (4, 4)), "arm.dbc", "node numbers repeat"),
        (many(), "arm.dbc", "parameters, but the telemetry can report at most 256"),
        (arm_text(("a", "b"), (4, 5)), "arm.txt", "give it the suffix .dbc"),
        (arm_text(("a", "b"), (4, 5)), "folder.dbc", "not a regular file"),
    ],
)
def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str | None, out: str, said: str) -> None:
    arm = tmp_path / "arm.toml"
    (tmp_path / "folder.dbc").mkdir()
    if text is not None:
        arm.write_text(text)
    before = sorted(tmp_path.rglob("*"))
    assert run("dbc", "--arm", arm, "-o", tmp_path / out) == 2
    message = capsys.readouterr().err
    assert said in message.replace("\n", " ")
    assert "; remedy: " in message
    assert sorted(tmp_path.rglob("*")) == before


def test_inputs_and_outputs_are_not_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arm = tmp_path / "arm.dbc"
    arm.write_text(text := arm_text(("a", "b"), (4, 5)))
    assert run("dbc", "--arm", arm, "-o", arm) == 2
    assert run("dbc", "--arm", arm, "-o", tmp_path / "new.dbc", "--json", tmp_path / "new.dbc") == 2
    assert run("dbc", "--arm", arm, "-o", tmp_path / "new.dbc", "--json", arm) == 2
    assert capsys.readouterr().err.count("would replace") == 3
    assert arm.read_text() == text
    assert not (tmp_path / "new.dbc").exists()

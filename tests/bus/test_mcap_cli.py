# SPDX-License-Identifier: MIT
"""`zygos convert` of MCAP files with messages of ROS 2, which are encoded here byte by byte (CDR, little endian)."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run
from mcap.writer import CompressionType, Writer
from runs_support import trajectory_of
from telemetry_support import drawn_signals

from conftest import EXAMPLE, ROOT, need
from zygos.arm import Arm, load_arm
from zygos.model.model import Model
from zygos.runs.cycles import Cycles
from zygos.runs.tables import read_cycles
from zygos.simulation.scenario import Scenario

HEADER = "std_msgs/Header header\n"
STD = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
JOINT_STATE = HEADER + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n" + STD
IMU = (
    HEADER
    + "geometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n"
    + "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n"
    + "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n"
    + STD
    + "=" * 80
    + "\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
)
BEGIN_NS = 1_700_000_000_123_456_789
MAP = """
[time]
source = "header"
interpolation = "cubic"

[[joint]]
name = "shoulder"
motor  = { topic = "/motor_states", unit = "rad", side = "output" }
link   = { topic = "/joint_states", unit = "rad" }
torque = { topic = "/motor_states", unit = "Nm" }

[[joint]]
name = "elbow"
motor  = { topic = "/motor_states", joint = "elbow_joint", unit = "rad", side = "output" }
link   = { topic = "/joint_states", joint = "elbow_joint", unit = "rad" }
torque = { topic = "/motor_states", joint = "elbow_joint", unit = "Nm" }

[gyro]
x = { topic = "/imu", unit = "rad/s" }
y = { topic = "/imu", unit = "rad/s" }
z = { topic = "/imu", unit = "rad/s" }
"""


class Cdr:
    """Bytes of a message; numbers are aligned to their size after the four bytes of the encapsulation."""

    def __init__(self) -> None:
        self.bytes = bytearray()

    def put(self, form: str, *values: float) -> Cdr:
        for value in values:
            self.bytes += b"\0" * (-len(self.bytes) % struct.calcsize(form))
            self.bytes += struct.pack(f"<{form}", value)
        return self

    def text(self, text: str) -> Cdr:
        self.put("I", len(text) + 1)
        self.bytes += text.encode() + b"\0"
        return self

    def head(self, stamp_ns: int, frame: str = "base") -> Cdr:
        return self.put("i", stamp_ns // 10**9).put("I", stamp_ns % 10**9).text(frame)

    def all(self) -> bytes:
        return b"\0\1\0\0" + bytes(self.bytes)


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    position: Sequence[float],
    effort: Sequence[float] | None = None,
    frame: str = "base",
) -> bytes:
    out = Cdr().head(stamp_ns, frame).put("I", len(names))
    for name in names:
        out.text(name)
    for values in (position, [0.0] * len(names), position if effort is None else effort):
        out.put("I", len(values)).put("d", *values)
    return out.all()


def imu(stamp_ns: int, rate: Sequence[float]) -> bytes:
    return Cdr().head(stamp_ns).put("d", 0, 0, 0, 1, *[0] * 9, *rate, *[0] * 9, *[0] * 12).all()


def stamped(k: int) -> int:
    return BEGIN_NS + 25_000_000 * k


def write(
    path: Path,
    run: Cycles,
    stamp: Callable[[int], int] = stamped,
    effort: bool = True,
    offered: str = "",
    ghost: str | None = None,
    ghost_late_s: float = 0.0,
    **form: Any,
) -> Path:
    """The cycles as messages; the joints are listed from the elbow to the shoulder. offered: the metadata of rosbag2.
    ghost: frame_id of a second node that sends zeros as joint states, "" if it has a channel of its own. form: of the
    file."""
    names, elbow_first = ("elbow_joint", "shoulder"), slice(None, None, -1)
    with path.open("wb") as stream:
        writer = Writer(stream, **form)
        writer.start("ros2")
        schema = {
            name: writer.register_schema(f"sensor_msgs/msg/{name}", "ros2msg", text.encode())
            for name, text in (("JointState", JOINT_STATE), ("Imu", IMU))
        }
        channel = {
            topic: writer.register_channel(topic, "cdr", schema[kind], {"offered_qos_profiles": offered})
            for topic, kind in (("/joint_states", "JointState"), ("/motor_states", "JointState"), ("/imu", "Imu"))
        }
        other = writer.register_channel("/rosout", "json", 0)
        second = writer.register_channel("/joint_states", "cdr", schema["JointState"]) if ghost == "" else 1
        writer.add_message(other, BEGIN_NS, b"{}", BEGIN_NS)
        for k in range(len(run)):
            at = stamped(k) + 3_000_000 + 1_000_000 * (k % 3)  # received late, and not evenly
            tau = run.tau[k, elbow_first] if effort else []
            said = stamp(k)
            for topic, data in (
                ("/joint_states", joint_state(said, names, run.q[k, elbow_first], frame="arm")),
                ("/motor_states", joint_state(said, names, run.theta[k, elbow_first], tau)),
                ("/imu", imu(said, run.omega[k])),
            ):
                writer.add_message(channel[topic], at, data, at)
            if ghost is not None:
                late = stamped(k) + round(ghost_late_s * 1e9)
                zeros = joint_state(late, names, [0.0, 0.0], frame=ghost)
                writer.add_message(channel["/joint_states"] if ghost else second, late, zeros, late)
        writer.finish()
    return path


def convert(source: Path, out: Path, *more: object, text: str = MAP) -> int:
    map_file = source.parent / "map.toml"
    map_file.write_text(text)
    return run("convert", source, "--map", map_file, "--arm", EXAMPLE / "arm.toml", "-o", out, *more)


@pytest.fixture(scope="module")
def recorded(arm: Arm, model: Model, scenario: Scenario) -> Cycles:
    options = {"noise": True, "period_s": 0.025, "duration_s": 10.0, "rtol": 1e-8}
    return trajectory_of(arm, model, scenario, seeds=[3], **options).cycles()


def test_every_value_comes_to_its_place(recorded: Cycles, tmp_path: Path) -> None:
    """Recorded twice in a period: a grid instant is a message, and a held torque the mean of two."""
    source = write(tmp_path / "my.mcap", recorded)
    out = tmp_path / "out" / "run.npz"
    assert convert(source, out, "--json", tmp_path / "c.json") == 0
    content = json.loads((tmp_path / "c.json").read_text())
    assert (content["time"], content["interpolation"], content["breaks"]) == ("header", "cubic", 0)
    assert content["signals"][4]["from"] == "/motor_states:elbow_joint.position"
    got = read_cycles(out, load_arm(out.parent / "arm.toml"))
    assert len(got) == 200
    np.testing.assert_allclose(got.q, recorded.q[::2], atol=1e-8)
    np.testing.assert_allclose(got.theta, recorded.theta[::2], atol=1e-8)
    np.testing.assert_allclose(got.omega, recorded.omega[::2], atol=1e-8)
    np.testing.assert_allclose(got.tau, 0.5 * (recorded.tau[::2] + recorded.tau[1::2]), atol=1e-8)


@pytest.mark.slow
def test_the_time_of_reception_jitters(recorded: Cycles, tmp_path: Path) -> None:
    """The other clock: its stamps are 1 ms apart from even ones, and the noise says so."""
    source = write(tmp_path / "my.mcap", recorded)
    for clock in ("header", "receive"):
        text = MAP.replace('"header"', f'"{clock}"')
        assert convert(source, tmp_path / clock / "run.npz", "--json", tmp_path / f"{clock}.json", text=text) == 0
    even, jittered = (json.loads((tmp_path / f"{clock}.json").read_text()) for clock in ("header", "receive"))
    assert even["bandwidth"]["stamps_sigma_s"] < 1e-8
    assert 0.5e-3 < jittered["bandwidth"]["stamps_sigma_s"] < 1.5e-3
    assert jittered["signals"][0]["added_by_interpolation"] > even["signals"][0]["added_by_interpolation"]


REFUSED = [
    (
        "topic",
        ('"/imu", unit = "rad/s" }\ny', '"/imo", unit = "rad/s" }\ny'),
        'gyro.x.topic: there is no "/imo" in my.mcap; remedy: did you mean "/imu"?',
    ),
    (
        "joint",
        ('joint = "elbow_joint", unit = "rad" }', 'joint = "elbow_joynt", unit = "rad" }'),
        'remedy: did you mean "elbow_joint"?',
    ),
    (
        "type",
        ('link   = { topic = "/joint_states", unit', 'link   = { topic = "/imu", unit'),
        "/imu has messages of type sensor_msgs/msg/Imu, not sensor_msgs/msg/JointState",
    ),
    (
        "column",
        ('topic = "/imu", unit = "rad/s" }\ny', 'column = "x", unit = "rad/s" }\ny'),
        "the input is an MCAP, which has topics; remedy: name a topic",
    ),
    ("clock", ('"header"', '"sync"'), 'time.source: \'sync\' is not known; remedy: write "header" or "receive"'),
]


@pytest.mark.parametrize(("change", "message"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED])
def test_maps_that_do_not_fit(
    recorded: Cycles, tmp_path: Path, change: tuple[str, str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write(tmp_path / "my.mcap", recorded)
    assert change[0] in MAP
    assert convert(source, tmp_path / "out" / "run.npz", text=MAP.replace(*change, 1)) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "out").exists()


def test_recordings_that_are_refused(recorded: Cycles, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = write(tmp_path / "my.mcap", recorded)
    cases = {
        "have no time; remedy: write source = \"receive\"": write(tmp_path / "a.mcap", recorded, stamp=lambda _: 0),
        "have 2 joints and 0 values of effort": write(tmp_path / "b.mcap", recorded, effort=False),
        "cannot be read beyond byte 8, where it is cut or damaged); remedy: record it again": tmp_path / "c.mcap",
        "does not begin as an MCAP": tmp_path / "e.mcap",
        "no such file": tmp_path / "d.mcap",
    }  # fmt: skip
    (tmp_path / "c.mcap").write_bytes(whole.read_bytes()[:20])
    (tmp_path / "e.mcap").write_bytes(whole.read_bytes()[8:])
    for message, source in cases.items():
        assert convert(source, tmp_path / "out" / "run.npz") == 2
        assert message in capsys.readouterr().err.replace("\n", " ")
    assert convert(whole, tmp_path / "out" / "run.npz", "--dbc", tmp_path / "my.dbc") == 2
    assert "an MCAP needs no --dbc" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


FORMS: list[dict[str, Any]] = [
    {"compression": CompressionType.ZSTD},
    {"compression": CompressionType.LZ4, "chunk_size": 50_000},
    {"compression": CompressionType.NONE},
    {"use_chunking": False},
]


@pytest.mark.slow(only=["no chunks"])
@pytest.mark.parametrize("form", FORMS, ids=["zstd", "lz4", "stored", "no chunks"])
def test_a_cut_mcap_is_read_as_far_as_it_goes(
    recorded: Cycles, form: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a log: exit code 4, and the values up to the cut are those of the whole file."""
    whole = write(tmp_path / "whole.mcap", recorded, **form)
    assert convert(whole, tmp_path / "whole" / "run.npz") == 0
    (tmp_path / "my.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size * 3 // 5])
    capsys.readouterr()
    out, numbers = tmp_path / "out" / "run.npz", tmp_path / "c.json"
    assert convert(tmp_path / "my.mcap", out, "--json", numbers) == 4
    (said,) = json.loads(numbers.read_text())["damage"]
    assert "my.mcap cannot be read beyond byte" in said and f"warning: {said}" in capsys.readouterr().err
    arm = load_arm(EXAMPLE / "arm.toml")
    got, expected = (read_cycles(file, arm) for file in (out, tmp_path / "whole" / "run.npz"))
    n = len(got) - 4  # the spline and the last mean know what follows
    assert 60 < n < len(expected) - 20
    np.testing.assert_allclose(got.q[:n], expected.q[:n], atol=1e-5)
    np.testing.assert_allclose(got.tau[:n], expected.tau[:n], atol=1e-8)


def test_a_recording_that_was_never_finished(recorded: Cycles, tmp_path: Path) -> None:
    """All messages are there, but neither the mark of the end nor the summary."""
    whole = write(tmp_path / "whole.mcap", recorded, use_chunking=False)
    content = whole.read_bytes()
    end = content.rindex(b"\x0f\x04\x00\x00\x00\x00\x00\x00\x00")  # DataEnd of the specification: kind, length
    (tmp_path / "my.mcap").write_bytes(content[:end])
    assert convert(tmp_path / "my.mcap", tmp_path / "a" / "run.npz", "--json", tmp_path / "c.json") == 4
    (said,) = json.loads((tmp_path / "c.json").read_text())["damage"]
    assert said.endswith("my.mcap ends without its end mark, because its recorder was stopped")


def test_a_chunk_that_is_damaged_is_skipped(recorded: Cycles, tmp_path: Path) -> None:
    """Its checksum is wrong; the run breaks there, and what follows is read."""
    whole = write(tmp_path / "whole.mcap", recorded, chunk_size=20_000, compression=CompressionType.NONE)
    content = bytearray(whole.read_bytes())
    content[len(content) // 3] ^= 1
    (tmp_path / "my.mcap").write_bytes(content)
    assert convert(tmp_path / "my.mcap", tmp_path / "a" / "run.npz", "--json", tmp_path / "c.json") == 4
    report = json.loads((tmp_path / "c.json").read_text())
    assert "is damaged in the record at byte" in report["damage"][0]
    got = read_cycles(tmp_path / "a" / "run.npz", load_arm(EXAMPLE / "arm.toml"))
    assert report["breaks"] == 1 and got.sync[-1] == 199 and 150 < len(got) < 199


@pytest.mark.slow
def test_a_second_publisher_without_effort_is_left_out(tmp_path: Path) -> None:
    """The zeros of its positions are no samples of the arm."""
    cases = ROOT.parent / "shared" / "cases"
    case = cases / "jointstate_two_publishers_empty_effort.mcap"
    need(case.is_file(), case.name)
    files = ("--map", cases / "jointstate_map.toml", "--arm", ROOT / "examples" / "pendulum" / "arm.toml")
    run("convert", case, *files, "-o", tmp_path / "run.npz", "--json", tmp_path / "c.json")
    report = json.loads((tmp_path / "c.json").read_text())
    assert report["left_out"]["messages without a value"] == 100
    assert [signal["samples"] for signal in report["signals"]] == [4997] * 4
    # "jointstate_two_publishers_zeros.mcap" has a sigma of 0.022 rad from the zeros
    assert max(signal["sigma"] for signal in report["signals"] if signal["unit"] == "rad") < 2e-4


@pytest.mark.slow(only=["True*"])
@pytest.mark.parametrize(("own_channel", "names"), [(True, ('"arm"', '"5"')), (False, ('"arm"', '"ghost"'))])
def test_two_publishers_of_one_topic_are_named_and_chosen(
    own_channel: bool, names: tuple[str, str], recorded: Cycles, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By their channels or by their frame_id; the remedy that is proposed is taken, and the zeros are gone."""
    source = write(tmp_path / "my.mcap", recorded, ghost="" if own_channel else "ghost", ghost_late_s=0.011)
    out = tmp_path / "out" / "run.npz"
    assert convert(source, out) == 2
    said = capsys.readouterr().err.replace("\n", " ")
    assert all(f"{name} (400 messages)" in said for name in names)
    (key,) = re.findall(r'remedy: choose one, for instance with (publisher = ".*")', said)
    assert key == f"publisher = {names[0]}"
    link = 'link   = { topic = "/joint_states"'
    assert convert(source, out, text=MAP.replace(link, f"{link}, {key}")) == 0
    got = read_cycles(out, load_arm(out.parent / "arm.toml"))
    np.testing.assert_allclose(got.q, recorded.q[::2], atol=1e-8)
    assert convert(source, out, text=MAP.replace(link, f'{link}, publisher = "arn"')) == 2
    assert 'has no "arn" in my.mcap; remedy: did you mean "arm"?' in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.slow
def test_a_publisher_that_started_again_is_one(recorded: Cycles, tmp_path: Path) -> None:
    """Two channels one after the other, as of a node that was restarted."""
    source = write(tmp_path / "my.mcap", recorded, ghost="", ghost_late_s=20.0)
    assert convert(source, tmp_path / "a" / "run.npz", "--json", tmp_path / "c.json") in (0, 3)
    assert json.loads((tmp_path / "c.json").read_text())["signals"][0]["samples"] == 800


@pytest.mark.slow(only=["1*"])
@pytest.mark.parametrize(("offered", "warned"), [(1, False), (2, True)])
def test_publishers_that_cannot_be_told_apart(offered: int, warned: bool, recorded: Cycles, tmp_path: Path) -> None:
    """rosbag2 writes the quality of service of each publisher that it met, and not who sent a message."""
    profile = "- history: 3\n  depth: 0\n  reliability: 1\n"
    source = write(tmp_path / "my.mcap", recorded, offered=offered * profile)
    assert convert(source, tmp_path / "a" / "run.npz", "--json", tmp_path / "c.json") == 0
    said = json.loads((tmp_path / "c.json").read_text())["warnings"]
    assert any("/imu had 2 publishers when it was recorded" in line for line in said) is warned


@pytest.mark.slow
def test_messages_without_time_are_counted(recorded: Cycles, tmp_path: Path) -> None:
    source = write(tmp_path / "my.mcap", recorded, stamp=lambda k: 0 if k == 7 else stamped(k))
    assert convert(source, tmp_path / "a" / "run.npz", "--json", tmp_path / "c.json") == 0
    assert json.loads((tmp_path / "c.json").read_text())["left_out"]["messages without time"] == 3


def test_signals_for_programs_that_draw_them(
    recorded: Cycles, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The decoder of the package mcap-ros2-support reads back what was written, with units."""
    source, out, drawn = write(tmp_path / "my.mcap", recorded), tmp_path / "out" / "run.npz", tmp_path / "drawn.mcap"
    assert convert(source, out, "--mcap", drawn) == 0
    arm = load_arm(out.parent / "arm.toml")
    cycles = read_cycles(out, arm)
    messages, units = drawn_signals(drawn)
    assert units == {"position": "rad", "velocity": "rad/s", "effort": "Nm"}
    assert set(messages) == {"/measured/joint_states", "/measured/motor_states"}
    times, states = zip(*messages["/measured/joint_states"], strict=True)
    assert len(states) == len(cycles) and np.diff(times) == pytest.approx(arm.period_s * 1e9)
    assert states[0].name == ["shoulder", "elbow"] and list(states[0].velocity) == []
    signs, zeros = (
        np.array([getattr(joint.link_encoder, key) for joint in arm.joints]) for key in ("sign", "zero_rad")
    )
    angles = np.array([state.position for state in states])
    np.testing.assert_allclose(angles, signs * (cycles.q - zeros), atol=1e-12)
    ratios = np.array([joint.gear_ratio for joint in arm.joints])
    efforts = np.array([state.effort for state in states])
    np.testing.assert_allclose(efforts[1:-1], (ratios * cycles.tau)[1:-1], atol=1e-9)
    assert convert(source, out, "--mcap", tmp_path / "drawn.bag") == 2
    assert "give it the suffix .mcap" in capsys.readouterr().err

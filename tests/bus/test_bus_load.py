# SPDX-License-Identifier: MIT
"""`zygos bus-load`: figures by hand, the longest frame that exists, and stuff bits counted a second way."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cli_support import run
from numpy.typing import NDArray
from wire_support import SEVEN_NODES, arm_text, wandering

from conftest import EXAMPLE, ROOT, need
from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.can.load import OTHERS, exact_bits, plan, usage, worst_bits
from zygos.errors import ZygosError
from zygos.native.flight import FRAME, encode
from zygos.simulation.plant import Trajectory

Log = NDArray[Any]
STRANGERS = Path(ROOT).parent / "shared" / "data" / "foreign-can" / "savvycan-candump.log"
SEVEN = ("yaw", "pitch", "roll", "elbow", "w1", "w2", "w3")
EXTENDED, REMOTE, ERROR, FD = 1, 2, 4, 8


def frame(identifier: int, data: bytes, flags: int = 0) -> Log:
    record = np.zeros(1, dtype=FRAME)
    record["id"], record["length"], record["flags"] = identifier, len(data), flags
    record["data"][0, : len(data)] = list(data)
    return record


def with_stuffing(text: str) -> str:
    """Bits with a bit of the other kind behind each five alike, by search and replace."""
    sent = ""
    while found := re.search("00000|11111", text):
        # the stuff bit is the first of what follows
        sent += text[: found.end()]
        text = ("1" if found.group()[0] == "0" else "0") + text[found.end() :]
    return sent + text


def longhand(record: Any) -> int:
    """Bits of a frame, written out as text; its CRC by long division."""
    data = bytes(record["data"][: record["length"]])
    remote = "1" if record["flags"] & REMOTE else "0"
    if record["flags"] & EXTENDED:
        identifier = f"{record['id']:029b}"
        head = f"0{identifier[:11]}11{identifier[11:]}{remote}00"
    else:
        head = f"0{record['id']:011b}{remote}00"
    body = head + f"{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    rest = int(body + 15 * "0", 2)
    while rest.bit_length() > 15:
        rest ^= 0b1100010110011001 << (rest.bit_length() - 16)  # x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1
    return len(with_stuffing(body + f"{rest:015b}")) + 13


def random_frames(count: int, seed: int) -> Log:
    """Data frames of every length, half with long identifiers; half of the bytes are 0x00 or 0xFF, which stuff most."""
    rng = np.random.default_rng(seed)
    frames = np.zeros(count, dtype=FRAME)
    frames["flags"] = rng.choice([0, EXTENDED, REMOTE], count, p=[0.5, 0.45, 0.05])
    frames["id"] = rng.integers(0, np.where(frames["flags"] == EXTENDED, 2**29, 2**11))
    frames["length"] = np.where(frames["flags"] == REMOTE, 0, rng.integers(0, 9, count))
    extreme = rng.random((count, 8)) < 0.5
    frames["data"] = np.where(extreme, rng.choice([0, 255], (count, 8)), rng.integers(0, 256, (count, 8)))
    return frames


Step = tuple[NDArray[np.int32], NDArray[np.int8]]


@cache
def steps() -> tuple[Step, Step, NDArray[np.int8]]:
    """States of a frame that is being sent: the CRC so far, the last bit, and how many alike precede. For a bit 0 and a
    bit 1: the state behind it, and whether a stuff bit comes; and how many come within the CRC itself."""
    crc, last, alike = (part.ravel() for part in np.meshgrid(np.arange(2**15), [0, 1], [1, 2, 3, 4], indexing="ij"))

    def stuffed(last: Any, alike: Any, bit: Any) -> tuple[Any, Any, Any]:
        alike = np.where(bit == last, alike + 1, 1)
        full = alike == 5
        return np.where(full, 1 - bit, bit), np.where(full, 1, alike), full

    within, before, count = np.zeros(len(crc), np.int8), last, alike
    for k in reversed(range(15)):
        before, count, full = stuffed(before, count, crc >> k & 1)
        within += full
    out = []
    for bit in (0, 1):
        after, count, full = stuffed(last, alike, bit)
        divided = crc * 2 % 2**15 ^ np.where(crc // 2**14 == bit, 0, 0x4599)
        out.append(((8 * divided + 4 * after + count - 1).astype(np.int32), full.astype(np.int8)))
    return out[0], out[1], within


def stuff_bits(value: NDArray[np.int8], bits: Sequence[int]) -> NDArray[np.int8]:
    """How many stuff bits can still come before one of these bits, from how many can behind it."""
    choices = [steps()[bit] for bit in bits]
    return np.max([full + value[after] for after, full in choices], axis=0)


@cache
def of_data(count: int) -> NDArray[np.int8]:
    """How many stuff bits can still come before so many bits of data."""
    return stuff_bits(of_data(count - 1), (0, 1)) if count else steps()[2]


def longest(length: int) -> tuple[int, int, bytes]:
    """The largest number of bits a data frame of this length can take, and identifier and data of one that does: by
    dynamic programming over all 2^(11 + 8 length) frames."""
    head = [(0, 1)] * 11 + [(0,)] * 3 + [(length >> k & 1,) for k in (3, 2, 1, 0)]
    values = [of_data(8 * length)]
    for choices in reversed(head):
        values.append(stuff_bits(values[-1], choices))
    values = [*reversed(values), *(of_data(count) for count in reversed(range(8 * length)))]
    state, bits = 0, []  # behind the start of frame
    for choices, value in zip([*head, *[(0, 1)] * (8 * length)], values[1:], strict=True):
        reached = [(int(full[state] + value[after[state]]), bit, after[state]) for bit in choices
                   for after, full in (steps()[bit],)]  # fmt: skip
        _, bit, state = max(reached)
        bits.append(bit)
    text = "".join(map(str, bits))
    data = bytes(int(text[18 + 8 * k : 26 + 8 * k], 2) for k in range(length))
    return 34 + 8 * length + int(values[0][0]) + 13, int(text[:11], 2), data


@pytest.mark.parametrize("length", range(9))
def test_no_frame_is_longer_than_the_worst(length: int) -> None:
    """The longest of all frames comes within three bits of the bound: the bits that are not free spoil the pattern."""
    bits, identifier, data = longest(length)
    assert exact_bits(frame(identifier, data))[0] == longhand(frame(identifier, data)[0]) == bits
    assert worst_bits(length) - 3 <= bits <= worst_bits(length)


def test_the_worst_is_what_stuffing_makes_of_its_worst_pattern() -> None:
    """Five alike, then four of each kind in turn: each run fills up with the stuff bit before it."""
    for length in range(9):
        pattern = ("0" * 5 + ("1" * 4 + "0" * 4) * 13)[: 34 + 8 * length]
        assert worst_bits(length) == len(with_stuffing(pattern)) + 13
    assert [worst_bits(length) for length in (0, 1, 5, 7, 8)] == [55, 65, 105, 125, 135]


def test_bits_are_counted_as_longhand_and_never_above_the_worst() -> None:
    frames = random_frames(6000, 0)
    bits = exact_bits(frames)
    assert np.array_equal(bits, [longhand(record) for record in frames])
    short = frames["flags"] == 0
    worst = np.array([worst_bits(int(length)) for length in frames["length"]])
    assert np.all(bits[short] <= worst[short])
    assert np.all(bits[short] >= 47 + 8 * frames["length"][short].astype(int))


def test_bits_of_known_frames() -> None:
    """As can-utils' canframelen counts them (its exact mode)."""
    known = [
        (0x000, "", 0, 53),
        (0x080, "01", 0, 59),
        (0x181, "0000000000000000", 0, 126),
        (0x3A0, "12340501020304", 0, 110),
        (0x7FF, "ffffffffffffffff", 0, 126),
        (0x7FE, "3e0f0f0f0f0f0fbe", 0, 133),
        (0x1FFFFFFF, "00ff00ff00ff00ff", EXTENDED, 147),
    ]
    for identifier, data, flags, bits in known:
        assert exact_bits(frame(identifier, bytes.fromhex(data), flags))[0] == bits


def test_error_and_fd_frames_count_nothing() -> None:
    frames = np.concatenate([frame(0x40, bytes(8), ERROR), frame(0x181, bytes(8), FD), frame(0x181, bytes(8))])
    assert exact_bits(frames).tolist() == [0, 0, longhand(frames[2])]


@pytest.fixture
def seven(tmp_path: Path) -> Callable[[str | None], Arm]:
    def load(gyro: str | None) -> Arm:
        path = tmp_path / "seven.toml"
        path.write_text(arm_text(SEVEN, SEVEN_NODES, gyro=gyro))
        return load_arm(path)

    return load


def test_the_example_by_hand(arm: Arm) -> None:
    """20 Hz: SYNC 65, four frames of 135, rates 135 + 105 bits a cycle; FTIME 125 every fifty; 100 Hz twice 135;
    heartbeat 65 a second."""
    planned = plan(arm, 500_000)
    assert planned.load == pytest.approx(
        (20 * (65 + 4 * 135 + 135 + 105 + 125 / 50) + 200 * 135 + 65) / 500_000, rel=1e-12
    )
    assert planned.largest_sync_hz == pytest.approx((350_000 - 27_065) / 847.5, rel=1e-12)
    assert {share.name: (share.bits, share.rate_hz) for share in planned.shares} == {
        "SYNC": (65, pytest.approx(20)),
        "FTIME": (125, pytest.approx(0.4)),
        "shoulder_ANGLES": (135, pytest.approx(20)),
        "shoulder_TORQUE": (135, pytest.approx(20)),
        "elbow_ANGLES": (135, pytest.approx(20)),
        "elbow_TORQUE": (135, pytest.approx(20)),
        "IMU_RATE_XY": (135, pytest.approx(20)),
        "IMU_RATE_Z": (105, pytest.approx(20)),
        "IMU_ATTITUDE": (135, 100),
        "TELEMETRY": (135, 100),
        "HEARTBEAT": (65, 1),
    }


def test_figures_of_the_protocol(arm: Arm, seven: Callable[[str | None], Arm]) -> None:
    """At 1 Mbit/s 909 Hz with two joints and 322 Hz with seven, for the coarse gyro and without FTIME.

    FTIME costs 2.5 bits a cycle, the fine gyro's second frame 105.
    """
    two = replace(arm, imu=replace(arm.imu, resolution="coarse"))
    for whole, without_ftime, with_ftime in ((two, 909, 906), (seven("coarse"), 322, 321)):
        planned = plan(whole, 1_000_000)
        cycle = sum(share.bits for share in planned.shares if share.rate_hz == pytest.approx(1 / whole.period_s))
        assert math.floor((700_000 - 200 * 135) / cycle) == without_ftime
        assert math.floor(planned.largest_sync_hz) == with_ftime
    assert math.floor(plan(arm, 1_000_000).largest_sync_hz) == 794
    assert math.floor(plan(seven("fine"), 1_000_000).largest_sync_hz) == 306


def test_a_full_bus_is_9009_frames_a_second() -> None:
    """Of eight bytes, none of which makes a stuff bit; 7407 at worst."""
    frames = np.repeat(frame(0, bytes(8)), 4096)
    frames["id"], frames["data"] = np.arange(4096) % 2048, np.repeat([0x55, 0xAA], 2048)[:, None]
    shortest = exact_bits(frames).min()
    assert (1_000_000 // shortest, 1_000_000 // worst_bits(8)) == (9009, 7407)


def test_at_the_largest_sync_rate_the_bus_is_loaded_to_the_limit(arm: Arm, seven: Callable[[str | None], Arm]) -> None:
    for whole, bitrate in ((arm, 125_000), (seven("fine"), 500_000), (seven(None), 1_000_000)):
        fastest = plan(whole, bitrate).largest_sync_hz
        assert plan(replace(whole, period_s=1 / fastest), bitrate).load == pytest.approx(0.7, rel=1e-12)


def test_a_fixed_base_has_no_gyro_and_no_attitude(seven: Callable[[str | None], Arm]) -> None:
    fixed = seven(None)
    assert not [share.name for share in plan(fixed, 1_000_000).shares if share.name.startswith("IMU")]
    assert plan(fixed, 10**6).load == pytest.approx((50 * (65 + 14 * 135 + 2.5) + 100 * 135 + 65) / 10**6, rel=1e-12)
    assert plan(fixed, 10**6, 0.0).load == plan(fixed, 10**6).load
    with pytest.raises(ZygosError, match=r"a fixed base has no gyro .*; remedy: "):
        plan(fixed, 10**6, 10.0)


@pytest.fixture(scope="module")
def recorded(arm: Arm, noisy: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> tuple[Log, Path]:
    frames = encode(arm, noisy.cycles(0))
    path = tmp_path_factory.mktemp("load") / "run.log"
    bus.write_log(path, frames, arm.period_s)
    return frames, path


def test_a_log_is_counted_bit_by_bit(recorded: tuple[Log, Path], arm: Arm, tmp_path: Path) -> None:
    frames, path = recorded
    numbers = tmp_path / "load.json"
    assert run("bus-load", path, "--arm", EXAMPLE / "arm.toml", "--bitrate", 125000, "--json", numbers) == 0
    content = json.loads(numbers.read_text())
    found = content["run"]
    inside = frames[:-1]  # the last SYNC only closes a cycle
    expected = {name: 0 for name in found["bits"]}
    names = {share["id"]: share["name"] for share in content["messages"]}
    for record in inside:
        expected[names[int(record["id"])]] += longhand(record)
    assert found["bits"] == expected
    assert sum(found["frames"].values()) == len(inside)
    cycles = int(np.sum(inside["id"] == 0x080))
    assert found["duration_s"] == pytest.approx(cycles * arm.period_s)
    assert found["load"] == pytest.approx(sum(expected.values()) / (125_000 * cycles * arm.period_s))
    worst = {share["name"]: share["bits"] for share in content["messages"]}
    for name, bits in expected.items():
        assert bits <= worst.get(name, 0) * found["frames"][name]
    assert found["load"] < found["busiest"] < (65 + 4 * 135 + 240 + 125) / (125_000 * arm.period_s)


def test_strangers_in_a_log_are_others(recorded: tuple[Log, Path], arm: Arm) -> None:
    need(STRANGERS.is_file(), f"the recorded traffic of a road vehicle, {STRANGERS.name}")
    frames, strangers = recorded[0], bus.read_log(STRANGERS).frames[:5000]
    both = np.concatenate([frames[:100], strangers, frames[100:]])
    alone = usage(arm, 10**6, frames, exact_bits(frames))
    found = usage(arm, 10**6, both, exact_bits(both))
    assert (alone.frames[OTHERS], found.frames[OTHERS]) == (0, 5000)
    assert found.bits[OTHERS] == sum(longhand(record) for record in strangers)
    assert {**found.bits, OTHERS: 0} == alone.bits
    assert found.load == pytest.approx(alone.load + found.bits[OTHERS] / (10**6 * found.duration_s))
    assert found.busiest > 100 * alone.busiest / 10


def test_lost_and_repeated_syncs_do_not_change_the_time(recorded: tuple[Log, Path], arm: Arm) -> None:
    frames = recorded[0]
    whole = usage(arm, 10**6, frames, exact_bits(frames))
    syncs = np.flatnonzero(frames["id"] == 0x080)
    damaged = np.insert(np.delete(frames, syncs[10:20]), 0, frames[syncs[:1]])
    found = usage(arm, 10**6, damaged, exact_bits(damaged))
    assert found.duration_s == whole.duration_s
    assert found.frames["SYNC"] == whole.frames["SYNC"] - 9
    assert found.busiest <= whole.busiest


@pytest.mark.parametrize("bitrate", [1_000_000, 62_000])
def test_the_remedies_help(tmp_path: Path, capsys: pytest.CaptureFixture[str], bitrate: int) -> None:
    """Seven joints at 1 kHz: refused with the table shown; with what the message says, 70 % are kept."""
    path, text = tmp_path / "arm.toml", arm_text(SEVEN, SEVEN_NODES, period_s=0.001)
    path.write_text(text)
    command = ("bus-load", "--arm", path, "--attitude-hz", 1, "--telemetry-hz", 1, "--bitrate")
    assert run(*command, bitrate) == 3
    out, err = capsys.readouterr()
    assert "IMU_RATE_XY" in out
    assert "exceeds the bus" in err
    period = re.search(r"a period_s of at least ([0-9.]+)", err)
    assert period is not None
    path.write_text(text.replace("period_s = 0.001", f"period_s = {period[1]}"))
    assert run(*command, bitrate) == 0
    path.write_text(text.replace("period_s = 0.001", f"period_s = {0.999 * float(period[1])}"))
    assert run(*command, bitrate) == 3
    err = capsys.readouterr().err
    assert "is above 70 %" in err
    enough = re.search(r"at least ([0-9,]+) bit/s", err)
    assert (enough is None) == (bitrate == 1_000_000)
    if enough is not None:
        assert run(*command, enough[1].replace(",", "")) == 0


def test_what_no_period_can_help(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("bus-load", "--arm", EXAMPLE / "arm.toml", "--bitrate", 20000) == 3
    err = capsys.readouterr().err
    assert "period_s" not in err
    enough = re.search(r"at least ([0-9,]+) bit/s", err)
    assert enough is not None
    assert run("bus-load", "--arm", EXAMPLE / "arm.toml", "--bitrate", enough[1].replace(",", "")) == 0


def test_a_full_log_is_refused(recorded: tuple[Log, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arm's own frames fit; those of others in the log do not."""
    frames = np.insert(recorded[0][:701], 5, np.repeat(frame(0x7FF, bytes(8)), 5_000))
    bus.write_log(tmp_path / "full.blf", frames, 0.05)
    command = ("bus-load", "--arm", EXAMPLE / "arm.toml", "--bitrate", 125_000, "--run", tmp_path / "full.blf")
    assert run(*command, "--json", "-") == 3
    out, err = capsys.readouterr()
    assert "others included" in err
    content = json.loads(out)
    assert content["load"] < 0.7 < content["run"]["load"]


def test_uncounted_frames_are_told(
    recorded: tuple[Log, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.blf"
    with can.Logger(str(path)) as logger:
        for message in bus.to_messages(recorded[0][:40], 0.05):
            message.channel = 0
            logger.on_message_received(message)
            if message.arbitration_id == 0x182:
                error = can.Message(timestamp=message.timestamp, is_error_frame=True, channel=0)
                logger.on_message_received(error)
    assert run("bus-load", path, "--arm", EXAMPLE / "arm.toml", "--json", tmp_path / "load.json") == 0
    assert "error or CAN FD frames" in capsys.readouterr().err
    found = json.loads((tmp_path / "load.json").read_text())["run"]
    assert (found["uncounted"], found["frames"][OTHERS]) == (5, 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--arm", "none.toml"), "no such file"),
        (("--arm", EXAMPLE / "model.toml"), "remedy"),
        (("--arm", EXAMPLE / "arm.toml", "--run", "none.blf"), "no such file"),
        (("--arm", EXAMPLE / "arm.toml", "--run", EXAMPLE / "arm.toml"), "not a known kind of CAN log"),
        (("--arm", EXAMPLE / "arm.toml", "--json", EXAMPLE / "arm.toml"), "would replace"),
        (("--arm", EXAMPLE / "arm.toml", "--bitrate", 2_000_000), "--bitrate"),
        (("--arm", EXAMPLE / "arm.toml", "--telemetry-hz", -1), "--telemetry-hz"),
    ],
)
def test_refusals(arguments: tuple[object, ...], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("bus-load", *arguments) == 2
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.out == ""


def test_a_log_without_syncs_is_refused(
    recorded: tuple[Log, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = recorded[0]
    bus.write_log(tmp_path / "run.blf", frames[frames["id"] != 0x080], 0.05)
    assert run("bus-load", tmp_path / "run.blf", "--arm", EXAMPLE / "arm.toml") == 2
    assert "no two different SYNCs" in capsys.readouterr().err


def test_frames_of_seven_joints_stay_below_the_plan(seven: Callable[[str | None], Arm]) -> None:
    whole = seven("fine")
    frames = encode(whole, wandering(whole, 400, 0))
    found = usage(whole, 10**6, frames, exact_bits(frames))
    planned = plan(whole, 10**6, 0.0, 0.0)
    assert 0.8 * planned.load < found.load < planned.load

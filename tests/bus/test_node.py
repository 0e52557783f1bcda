"""zygos-node over a pair of sockets: what it learns, saves and answers is what the library through cffi says."""

from __future__ import annotations

import math
import signal
import socket
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from cantools.database.can import Database
from node_support import ERROR, EXTENDED, FD, REMOTE, Node, build, frame_of, hear, packet
from numpy.typing import NDArray
from round_support import round_of, told
from runs_support import trajectory_of

from conftest import EXAMPLE, ROOT
from zygos.arm import Arm
from zygos.can.dbc import arm_database
from zygos.can.rounds import rounds
from zygos.cli import main
from zygos.effects import effect
from zygos.model.model import Model
from zygos.native import snapshot
from zygos.native.flight import Flight, encode, ffi
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario

SYNC, TELEMETRY, HEARTBEAT = 0x080, 0x1A0, 0x720
NODE = ("overflow", "misshapen", "down", "unsent", "corrupt", "unsaved")
"""Counters of the node itself."""
Log = NDArray[Any]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("onboard")
    with pytest.raises(SystemExit) as end:
        main(["compile-model", str(EXAMPLE / "arm.toml"), "-o", str(folder)])
    assert not end.value.code
    return folder / "arm.zyg"


@pytest.fixture(scope="module")
def frames(noisy: Trajectory, arm: Arm) -> Log:
    return encode(arm, noisy.cycles(0))


def image(flight: Flight) -> bytes:
    return bytes(ffi.buffer(flight.native))


def saved(path: Path) -> bytes:
    return bytes(ffi.buffer(snapshot.read(path, "state")))


def starts(frames: Log) -> NDArray[np.int64]:
    return np.flatnonzero(frames["id"] == SYNC)


def damaged(frames: Log) -> Log:
    """A bad day: frames lost, repeated, late, corrupt, cut off, foreign, remote, extended, FD, and error frames."""
    at = starts(frames)
    out = list(frames[: at[400]])
    for k in (int(at[50]) + 2, int(at[100]) + 1):
        del out[k]
    out.insert(int(at[150]) + 3, out[int(at[150]) + 2])
    for swapped in (int(at[200]) - 1, int(at[210]) - 2):  # early: before its SYNC; late: behind the next
        out[swapped], out[swapped + 1] = out[swapped + 1], out[swapped]
    broken = out[int(at[250]) + 3].copy()
    broken["data"][4] ^= 0x10
    out[int(at[250]) + 3] = broken
    short = out[int(at[300]) + 3].copy()
    short["length"] = 7
    out[int(at[300]) + 3] = short
    strays = [
        frame_of(0x7FF, b"foreign"),
        frame_of(0x181, b"12345678", EXTENDED),
        frame_of(0x181, b"", REMOTE),
        frame_of(0x181, b"12345678", FD),
        frame_of(0x40, b"busoff..", ERROR),
        frame_of(0x04, b"ctrl....", ERROR),
        frame_of(0x1A0, b"not ours"),
        frame_of(0x080, b"\xf1"),
    ]
    for k, stray in enumerate(strays):
        out.insert(int(at[320 + 5 * k]), stray)
    return np.concatenate([np.array(out, dtype=frames.dtype), frames[at[400] :]])


@pytest.mark.slow(only=["good"])
@pytest.mark.parametrize("day", ["good", "bad"])
def test_what_is_saved_is_the_librarys_own_memory(
    day: str, arm: Arm, config: Path, frames: Log, tmp_path: Path
) -> None:
    sent = frames if day == "good" else damaged(frames)
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--state", state) as node:
        node.send(sent)
        counters = node.end()
    flight = Flight(arm)
    hear(flight, sent)
    assert saved(state) == image(flight)
    faults = {name.removeprefix("fault_"): n for name, n in counters.items() if name.startswith("fault_")}
    counts = {name.removeprefix("count_"): n for name, n in counters.items() if name.startswith("count_")}
    assert faults == flight.faults
    assert counts == flight.counts | {"arcs": flight.native.accumulator.arcs}
    assert {name for name, n in faults.items() if n} == (
        set()
        if day == "good"
        else {"length", "crc", "range", "late", "repeated", "incomplete", "dropped", "bus_error", "counter"}
    )
    assert [counters[f"node_{name}"] for name in NODE] == 6 * [0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.zyg"]


@pytest.mark.parametrize("every", [50, 200])
def test_telemetry_is_the_estimate(every: int, arm: Arm, config: Path, frames: Log) -> None:
    """Each round of so many SYNCs tells the estimate at its first; decoded by the arm's DBC and checked by its CRC."""
    dbc = arm_database(arm)
    with Node("--config", config, "--every", every) as node:
        node.send(frames)
        node.end()
        rounds = [told(dbc, data) for data in node.of(TELEMETRY)]
    at = starts(frames)
    flight, done = Flight(arm), 0
    items, share = 14 + 38 + 36, math.ceil((14 + 38 + 36) / every)
    for begin in range(0, len(at), every):
        flight.frames(frames[done : at[begin] + 1])
        done = int(at[begin]) + 1
        complete = begin + math.ceil(items / share) <= len(at)
        expected = round_of(flight)
        found = {name: value for name, value, _ in rounds[: len(expected)]}
        if complete:
            assert found == expected
        else:
            assert found.items() <= expected.items()
        del rounds[: len(expected)]
    assert rounds == []
    assert expected["verdict_validity"] == 3.0


@pytest.mark.parametrize("there", [True, False])
def test_an_effect_tells_its_significance(
    there: bool, arm: Arm, model: Model, scenario: Scenario, frames: Log, tmp_path: Path
) -> None:
    """Value and sigma of the column of a compiled effect are in the telemetry. Their ratio is large where the plant has
    the effect, and that of chance where it has not."""
    asked = tmp_path / "model.toml"
    asked.write_text(
        (EXAMPLE / "model.toml").read_text() + '\n[[effect]]\nkind = "motor_viscous"\njoint = "elbow"\nvalue = 0\n'
    )
    with pytest.raises(SystemExit) as end:
        main(["compile-model", str(EXAMPLE / "arm.toml"), "--model", str(asked), "-o", str(tmp_path)])
    assert not end.value.code
    friction = effect("motor_viscous", "elbow", 10.0)
    if there:
        frames = encode(arm, trajectory_of(arm, replace(model, effects=(friction,)), scenario).cycles())
    with Node("--config", tmp_path / "arm.zyg", "--every", 100) as node:
        node.send(frames)
        node.end()
        sent = [can.Message(arbitration_id=name, data=data, is_extended_id=False) for name, data in node.answers]
    complete = rounds(arm_database(arm, [friction]), sent)
    last, flight = complete[-1], Flight(arm, [friction])
    hear(flight, frames[: starts(frames)[100 * (len(complete) - 1)] + 1])
    own = flight.estimate()
    significance = abs(last["motor_viscous2"]) / last["motor_viscous2_sigma"]
    assert own.names[-1] == "motor_viscous2"
    assert significance == pytest.approx(own.significance[-1], rel=1e-6)
    assert significance > 20.0 if there else significance < 5.0


def test_telemetry_depends_on_the_frames_alone(config: Path, frames: Log) -> None:
    """The same frames at another pace give the same answers, each with the counter of its SYNC."""
    sent = frames[: starts(frames)[300]]
    answers = []
    for pause in (False, True):
        with Node("--config", config, "--every", "40") as node:
            node.send(sent[:1000])
            if pause:
                time.sleep(0.3)
            node.send(sent[1000:])
            assert node.end()["node_unsent"] == 0
            answers.append(node.of(TELEMETRY))
    assert answers[0] == answers[1]
    counters = [data[1] & 0x0F for data in answers[0]]
    syncs = [int(frame["data"][0]) & 0x0F for frame in sent if frame["id"] == SYNC]
    assert [c for k, c in enumerate(counters) if k == 0 or c != counters[k - 1]][:16] == syncs[:16]


@pytest.mark.parametrize("cut", [0, 3])
def test_killed_and_resumed(cut: int, arm: Arm, config: Path, frames: Log, tmp_path: Path) -> None:
    """The saved state, the resumed one and the one after it are those of the library, also cut within a cycle."""
    at, state = starts(frames), tmp_path / "state.zyg"
    first, second = frames[: at[600] + cut], frames[at[650] :]
    with Node("--config", config, "--state", state) as node:
        node.send(first)
        node.end()
    flight = Flight(arm)
    hear(flight, first)
    assert saved(state) == image(flight)
    with Node("--config", config, "--state", state) as node:
        assert f"goes on behind cycle {flight.native.cycle}" in node.first
        node.send(second)
        counters = node.end()
    snapshot.write(tmp_path / "own.zyg", "state", flight.native)
    again = Flight(arm)
    snapshot.resume(again, tmp_path / "own.zyg")
    hear(again, second)
    assert saved(state) == image(again)
    assert counters["count_accepted"] > 1050
    assert counters["fault_sync_jumped"] == 1
    assert again.native.cycle == 1199


def wait_for(path: Path, cycle: int) -> None:
    """Until a state is stored that knows of this cycle."""
    deadline = time.monotonic() + 30.0
    while not path.exists() or snapshot.read(path, "state").cycle < cycle:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_killed_without_warning(arm: Arm, config: Path, frames: Log, tmp_path: Path) -> None:
    """SIGKILL costs what came since the last save, and no more."""
    at, state = starts(frames), tmp_path / "state.zyg"
    with Node("--config", config, "--state", state, "--save-every", 100) as node:
        node.send(frames[: at[650]])
        wait_for(state, 598)
        node.process.kill()
        assert node.process.wait() == -signal.SIGKILL
    flight = Flight(arm)
    hear(flight, frames[: at[599] + 1])  # up to the 600th SYNC
    assert saved(state) == image(flight)
    with Node("--config", config, "--state", state) as node:
        node.send(frames[at[655] :])
        node.end()
    snapshot.write(tmp_path / "own.zyg", "state", flight.native)
    again = Flight(arm)
    snapshot.resume(again, tmp_path / "own.zyg")
    hear(again, frames[at[655] :])
    assert saved(state) == image(again)
    assert again.native.cycle == 1199


@pytest.mark.parametrize("seed", range(4))
def test_killed_while_it_saves(seed: int, arm: Arm, config: Path, frames: Log, tmp_path: Path) -> None:
    """Whenever the kill comes, the file is whole: the state behind some SYNC."""
    at, state = starts(frames), tmp_path / "state.zyg"
    with Node("--config", config, "--state", state, "--save-every", 1) as node:
        node.send(frames[: at[40] + 1])
        wait_for(state, 3)
        time.sleep(float(np.random.default_rng(seed).uniform(0.0, 0.2)))
        node.process.kill()
        node.process.wait()
    flight = Flight(arm)
    stored = snapshot.read(state, "state")
    syncs = int(stored.receiver.assembly.sync)
    hear(flight, frames[: at[syncs] + 1])
    assert saved(state) == image(flight)
    with Node("--config", config, "--state", state) as node:
        node.end()


@pytest.mark.slow
def test_told_to_end_where_frames_always_wait(config: Path) -> None:
    """Each of these SYNCs is answered by a solution, so that there is never nothing to read."""
    with Node("--config", config, "--every", 1) as node:
        node.near.setblocking(False)
        told_at = time.monotonic() + 1.0
        told = False
        k = 0
        while node.process.poll() is None:
            try:
                node.near.send(packet(frame_of(SYNC, bytes([k % 240 + 1]))))
                k += 1
            except BlockingIOError:
                node.listen()
            except (BrokenPipeError, ConnectionResetError):
                break
            if not told and time.monotonic() > told_at:
                node.process.send_signal(signal.SIGTERM)
                told = True
            assert time.monotonic() < told_at + 20.0
        assert told
        assert node.process.wait() == 0


def refused(*arguments: object) -> str:
    """What a node says that does not start."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far:
        command = [str(build()), *(str(far.fileno()) if one == "FD" else str(one) for one in arguments)]
        done = subprocess.run(command, pass_fds=[far.fileno()], capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stdout) == (2, "")
    assert "remedy: " in done.stderr
    return done.stderr


REGIONS = {
    "magic": (range(0, 8), "is no snapshot"),
    "format": (range(8, 10), "of a format that this node does not read"),
    "kind": (range(10, 11), "of the other kind"),
    "byte order": (range(11, 12), "of the other byte order"),
    "layout": (range(12, 16), "other capacities, structs or version"),
    "length": (range(16, 20), "is cut off, or has more bytes"),
    "crc": (range(20, 24), "is damaged"),
}


def damages(good: bytes) -> list[tuple[bytes, str]]:
    """Contents that a file may have instead of these, and what is then said of it."""
    image_places = np.linspace(24, len(good) - 1, 12).astype(int)
    regions = REGIONS | {"image": ([int(place) for place in image_places], "is damaged")}
    cases = [(place, reason) for places, reason in regions.values() for place in places]
    contents = [(good[:at] + bytes([good[at] ^ 0x20]) + good[at + 1 :], reason) for at, reason in cases]
    contents += [(b"", "is no snapshot"), (good[:23], "is no snapshot"), (good[:24], "is cut off")]
    contents += [(good[:-1], "is cut off"), (good + b"\0", "has more bytes"), (b"\0" * len(good), "is no snapshot")]
    return contents


def test_a_damaged_configuration_is_refused_with_a_reason(config: Path, tmp_path: Path) -> None:
    path = tmp_path / "damaged.zyg"
    for content, reason in damages(config.read_bytes()):
        path.write_bytes(content)
        said = refused("--config", path, "--fd", "FD")
        assert f"{path}: " in said
        assert reason in said
        assert path.read_bytes() == content


@pytest.mark.slow
def test_a_damaged_state_is_put_aside_with_a_reason(arm: Arm, config: Path, tmp_path: Path) -> None:
    """It ends no start, and is not lost: the complaint names the file and what to do about it."""
    path, aside = tmp_path / "damaged.zyg", tmp_path / "damaged.zyg.unusable"
    for content, reason in damages(snapshot.seal("state", Flight(arm).native)):
        path.write_bytes(content)
        with Node("--config", config, "--state", path) as node:
            assert "starts at cycle 0" in node.first
            assert node.end()["count_cycles"] == 0
        why, consequence = node.complaints.splitlines()
        assert f"{path}: " in why
        assert reason in why
        assert why.endswith(str(aside))
        assert "remedy: " in why
        assert consequence.startswith(f"zygos-node: {path}: no state can be used, starts from nothing; remedy: ")
        assert aside.read_bytes() == content
        assert saved(path) == image(Flight(arm))
        aside.unlink()


def test_a_state_of_another_arm_is_put_aside(config: Path, tmp_path: Path) -> None:
    """It may be the work of a month: the first one is kept, whatever follows."""
    other = tmp_path / "arm.toml"
    other.write_text((EXAMPLE / "arm.toml").read_text().replace("gear_ratio = 50", "gear_ratio = 51", 1))
    with pytest.raises(SystemExit):
        main(["compile-model", str(other), "-o", str(tmp_path)])
    state, aside = tmp_path / "state.zyg", tmp_path / "state.zyg.unusable"
    with Node("--config", tmp_path / "arm.zyg", "--state", state) as node:
        node.end()
    long_work = state.read_bytes()
    with Node("--config", config, "--state", state) as node:
        node.end()
    assert f"{state}: is the state of another configuration; kept as {aside}; remedy: " in node.complaints
    assert aside.read_bytes() == long_work
    with Node("--config", tmp_path / "arm.zyg", "--state", state) as node:
        node.end()
    assert f"{state}: is the state of another configuration; a later save replaces it; remedy: " in node.complaints
    assert aside.read_bytes() == long_work
    assert state.read_bytes() == long_work  # that of an arm that has not moved is always the same
    assert "is a snapshot of the other kind" in refused("--config", state, "--fd", "FD")
    assert "is a snapshot of the other kind" in refused("--config", config, "--state", config, "--fd", "FD")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((), "no configuration"),
        (("--config", "CONFIG"), "either an interface or a descriptor"),
        (("--config", "CONFIG", "-i", "vcan0", "--fd", "FD"), "either an interface or a descriptor"),
        (("--config", "nowhere.zyg", "--fd", "FD"), "nowhere.zyg: no such file"),
        (("--config", ROOT, "--fd", "FD"), "cannot be read"),
        (("--config", "CONFIG", "--fd", "99"), "no socket of packets"),
        (("--config", "CONFIG", "--fd", "0"), "no socket of packets"),
        (("--config", "CONFIG", "--fd", "x"), "--fd x: no number"),
        (("--config", "CONFIG", "--fd", "FD", "--every", "0"), "--every 0: no number"),
        (("--config", "CONFIG", "--fd", "FD", "--every", "1.5"), "--every 1.5: no whole number"),
        (("--config", "CONFIG", "--fd", "FD", "--exit-idle", "nan"), "--exit-idle nan: no number"),
        (("--config", "CONFIG", "--fd", "FD", "--refine", "-0.1"), "--refine -0.1: no number"),
        (("--config", "CONFIG", "--fd", "FD", "--refine", "2"), "--refine 2: no number"),
        (("--config", "CONFIG", "--fd", "FD", "more"), "more: not an option"),
        (("--config", "CONFIG", "--fd", "FD", "--speed", "9"), "--speed"),
        (("--config", "CONFIG", "--fd", "FD", "--state", "/nowhere/at/all/state"), "could not be saved (No such file"),
        (("--config", "CONFIG", "--fd", "FD", "--state", 2100 * "./" + "s"), "could not be saved (File name too long"),
        (("--config", "CONFIG", "--fd", "FD", "--state", ROOT), "cannot be read (Is a directory"),
        (("--config", "CONFIG", "--fd", "FD", "--save-every", "9"), "--save-every without a file"),
        (("--config", "CONFIG", "-i", "nothere0"), "here"),  # no such interface, or no CAN in this kernel
    ],
)
def test_refusals_of_the_command_line(arguments: tuple[object, ...], word: str, config: Path) -> None:
    assert word in refused(*(config if one == "CONFIG" else one for one in arguments))


def test_help() -> None:
    done = subprocess.run([build(), "--help"], capture_output=True, text=True, check=True)
    assert all(
        word in done.stdout for word in ("--config", "--fd", "--state", "--every", "--refine", "--exit-idle", "0x720")
    )


def test_a_state_that_cannot_be_saved_is_no_success(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    with Node("--config", config, "--state", folder / "state.zyg") as node:
        folder.rmdir()
        node.process.send_signal(signal.SIGTERM)
        code, counters, said = node.wait()
    assert code == 2
    assert "cannot be saved" in said
    assert len(counters) == 38


def test_what_is_no_frame_is_rejected_and_counted(arm: Arm, config: Path, frames: Log, tmp_path: Path) -> None:
    """13 bytes, nothing (in a socket of datagrams), and more than the longest frame; FD frames are foreign."""
    state = tmp_path / "state.zyg"
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with Node("--config", config, "--state", state, pair=pair) as node:
        for k, frame in enumerate(frames[:400]):
            whole = packet(frame)
            if k % 40 == 0:
                for wrong in (whole[:13], b"", whole + bytes(1), whole + bytes(57), bytes(2000)):
                    node.near.send(wrong)
                fd = frame.copy()
                fd["flags"] = FD
                node.near.send(packet(fd))
            node.near.send(whole)
            node.listen()
        counters = node.end()
    assert counters["node_misshapen"] == 50
    flight = Flight(arm)
    hear(flight, frames[:400])
    assert saved(state) == image(flight)


def test_frames_that_the_kernel_drops_are_counted(arm: Arm, config: Path, frames: Log) -> None:
    """A receive buffer that overflows, in a socket of datagrams that drops as a CAN socket does."""
    near, far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for one in (near, far):
        one.bind(("127.0.0.1", 0))
    near.connect(far.getsockname())
    far.connect(near.getsockname())
    at = starts(frames)
    with Node("--config", config, pair=(near, far)) as node:
        node.send(frames[: at[100]])
        node.process.send_signal(signal.SIGSTOP)
        flood = packet(frame_of(0x7FF, b"flood"))
        sent = 0
        for _ in range(60):
            for _ in range(1000):
                near.send(flood)
            sent += 1000
        node.process.send_signal(signal.SIGCONT)
        time.sleep(0.5)
        node.send(frames[at[100] : at[200]])
        counters = node.end()
    assert 1000 < counters["node_overflow"] < sent
    assert counters["count_cycles"] == 199
    assert not any(n for name, n in counters.items() if name.startswith("fault_"))


def test_heartbeat_tells_whether_sync_comes(config: Path, frames: Log) -> None:
    """By clock, and also when nothing comes at all."""
    with Node("--config", config) as node:
        time.sleep(1.3)
        begin = time.monotonic()
        for cycle in np.split(frames, starts(frames)[1:31]):
            node.send(cycle[:7])
            time.sleep(0.05)
        assert time.monotonic() - begin > 1.5
        time.sleep(2.2)
        node.end()
        states = [data[0] for data in node.of(HEARTBEAT)]
    assert states[:2] == [0, 127]
    assert states[-1] == 4
    assert set(states[2:-2]) == {5, 127} or set(states[2:-1]) == {5, 127}
    assert 5 <= len(states) <= 8


def test_silence_ends_it_where_asked(config: Path, frames: Log, tmp_path: Path) -> None:
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--exit-idle", "0.5", "--state", state) as node:
        for cycle in np.split(frames[: starts(frames)[15] + 1], starts(frames)[1:16]):
            node.send(cycle)
            time.sleep(0.1)
        code, counters, _ = node.wait()
    assert (code, counters["count_cycles"]) == (0, 15)
    assert state.exists()


@pytest.mark.parametrize("heard", [True, False])
def test_the_other_end_closes(heard: bool, config: Path, frames: Log, arm: Arm, tmp_path: Path) -> None:
    """What it has sent is worked off, whether or not it has read what it was sent."""
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--state", state) as node:
        node.process.send_signal(signal.SIGSTOP)
        for frame in frames[:200]:
            node.near.send(packet(frame))
        if heard:
            node.near.shutdown(socket.SHUT_WR)
        else:
            node.near.close()
        node.process.send_signal(signal.SIGCONT)
        out, said = node.process.communicate(timeout=60)
    assert (node.process.returncode, said) == (0, "")
    assert "fault_crc" in out
    flight = Flight(arm)
    hear(flight, frames[:200])
    assert saved(state) == image(flight)


def test_what_is_printed_is_called_as_on_the_bus(config: Path) -> None:
    dbc = cantools.database.load_file(ROOT / "include" / "zygos" / "zygos.dbc")
    assert isinstance(dbc, Database)
    with Node("--config", config) as node:
        counters = node.end()
    named = {
        next(iter(signal.multiplexer_ids)): signal.name
        for signal in dbc.get_message_by_name("TELEMETRY").signals
        if signal.multiplexer_ids
    }
    assert list(counters) == [named[512 + k] for k in range(len(counters))]

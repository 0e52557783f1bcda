# SPDX-License-Identifier: MIT
"""zygos-node over a pair of sockets: what it learns, saves and answers is what the library through cffi says."""

from __future__ import annotations

import math
import shutil
import signal
import socket
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from cantools.database.can import Database
from node_support import (
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    SYNC,
    TELEMETRY,
    Log,
    Node,
    Teller,
    build,
    compiled,
    frame_of,
    image,
    packet,
    saved,
)
from numpy.typing import NDArray
from round_support import round_of, told
from runs_support import trajectory_of

from conftest import EXAMPLE, ROOT
from zygos.arm import Arm
from zygos.can.dbc import arm_database
from zygos.can.rounds import rounds
from zygos.effects import effect
from zygos.model.model import Model
from zygos.native import snapshot
from zygos.native.flight import encode
from zygos.simulation.scenario import Scenario
from zygos.testing.twin import Twin

HEARTBEAT = 0x720
NODE = ("overflow", "misshapen", "down", "unsent", "corrupt", "unsaved")
"""Counters of the node itself."""


def damaged(frames: Log, at: NDArray[np.int64]) -> Log:
    """A bad day: frames lost, repeated, late, corrupt, cut off, foreign, remote, extended, FD, and error frames."""
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


def test_what_is_saved_is_the_librarys_own_memory(
    arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """Of a day on which everything went wrong, and with all counters."""
    sent, state = damaged(frames, syncs), tmp_path / "state.zyg"
    sent = sent[: np.flatnonzero(sent["id"] == 0x080)[600]]
    with Node("--config", config, "--state", state) as node:
        node.send(sent)
        counters = node.end()
    flight = Twin(arm)
    flight.hear(sent)
    assert saved(state) == image(flight)
    faults = {name.removeprefix("fault_"): n for name, n in counters.items() if name.startswith("fault_")}
    counts = {name.removeprefix("count_"): n for name, n in counters.items() if name.startswith("count_")}
    assert faults == flight.faults
    assert counts == flight.counts | {"arcs": flight.native.sums.energy.store.arcs}
    expected = {"length", "crc", "range", "late", "repeated", "incomplete", "dropped", "bus_error", "counter"}
    assert {name for name, n in faults.items() if n} == expected
    assert [counters[f"node_{name}"] for name in NODE] == 6 * [0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["state.zyg", "state.zyg.lock"]


@pytest.mark.parametrize("every", [50, 200])
def test_telemetry_is_the_estimate(every: int, arm: Arm, config: Path, frames: Log, syncs: Log) -> None:
    """Each round of so many SYNCs tells the estimate at its first; decoded by the arm's DBC and checked by its CRC."""
    dbc = arm_database(arm)
    with Node("--config", config, "--every", every) as node:
        node.send(frames)
        node.end()
        rounds = [told(dbc, data) for data in node.of(TELEMETRY)]
    flight = Twin(arm, every=every)
    flight.hear(frames)
    items, share = 14 + 38 + 36, math.ceil((14 + 38 + 36) / every)
    assert len(flight.answers) == math.ceil(len(syncs) / every)
    for begin, answer in zip(range(0, len(syncs), every), flight.answers, strict=True):
        assert answer.syncs == begin + 1
        complete = begin + math.ceil(items / share) <= len(syncs)
        expected = round_of(answer, flight.names)
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
    there: bool, arm: Arm, model: Model, scenario: Scenario, frames: Log, syncs: Log, tmp_path: Path
) -> None:
    """Value and sigma of the column of a compiled effect are in the telemetry. Their ratio is large where the plant has
    the effect, and that of chance where it has not."""
    asked = tmp_path / "model.toml"
    asked.write_text(
        (EXAMPLE / "model.toml").read_text() + '\n[[effect]]\nkind = "motor_viscous"\njoint = "elbow"\nvalue = 0\n'
    )
    friction = effect("motor_viscous", "elbow", 10.0)
    if there:
        rubbing = replace(model, effects=(friction,))
        frames = encode(arm, trajectory_of(arm, rubbing, scenario, duration_s=30.0, rtol=1e-8).cycles())
    with Node("--config", compiled(tmp_path, EXAMPLE / "arm.toml", "--model", asked), "--every", 100) as node:
        node.send(frames)
        node.end()
        sent = [can.Message(arbitration_id=name, data=data, is_extended_id=False) for name, data in node.answers]
    complete = rounds(arm_database(arm, [friction]), sent)
    last, flight = complete[-1], Twin(arm, [friction])
    flight.hear(frames[: syncs[100 * (len(complete) - 1)] + 1])
    expected, k = flight.answers[-1].estimate, len(flight.names) - 1
    significance = abs(last["motor_viscous2"]) / last["motor_viscous2_sigma"]
    assert flight.names[-1] == "motor_viscous2"
    assert significance == pytest.approx(abs(expected.value[k]) / expected.sigma[k], rel=1e-6)
    assert significance > 20.0 if there else significance < 5.0


def test_telemetry_depends_on_the_frames_alone(arm: Arm, config: Path, frames: Log, syncs: Log) -> None:
    """The same frames at another pace give the same answers, each with the counter of its SYNC, and every bit is what
    the library in this process says."""
    sent = frames[: syncs[300]]
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
    twin = Teller(arm, every=40)
    twin.hear(sent)
    assert answers[0] == twin.sent
    counters = [data[1] & 0x0F for data in answers[0]]
    expected = [int(frame["data"][0]) & 0x0F for frame in sent if frame["id"] == SYNC]
    assert [c for k, c in enumerate(counters) if k == 0 or c != counters[k - 1]][:16] == expected[:16]


def goes_on(arm: Arm, config: Path, state: Path, second: Log) -> tuple[Twin, dict[str, int]]:
    """Let a node go on from a stored state, as the library does. Returns its flight, and the counters of the node."""
    flight = Twin(arm)
    flight.resume(shutil.copy(state, state.with_name("first.zyg")))
    with Node("--config", config, "--state", state) as node:
        assert f"goes on behind cycle {flight.native.sums.cycle}" in node.first
        node.send(second)
        counters = node.end()
    flight.hear(second)
    assert saved(state) == image(flight)
    return flight, counters


def test_ended_and_resumed(arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    """The saved state and the one after it are those of the library, also cut within a cycle."""
    first, state = frames[: syncs[600] + 3], tmp_path / "state.zyg"
    with Node("--config", config, "--state", state) as node:
        node.send(first)
        node.end()
    flight = Twin(arm)
    flight.hear(first)
    assert saved(state) == image(flight)
    again, counters = goes_on(arm, config, state, frames[syncs[650] :])
    assert counters["count_accepted"] > 1050
    assert counters["fault_sync_jumped"] == 1
    assert again.native.sums.cycle == 1199


def test_killed_without_warning(arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    """SIGKILL costs what came since the last save, and no more."""
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--state", state, "--save-every", 200) as node:
        node.send(frames[: syncs[450]])
        node.worked_off(450)
        node.process.kill()
        assert node.process.wait() == -signal.SIGKILL
    flight = Twin(arm, save_every=200)
    flight.hear(frames[: syncs[450]])  # the newest is that of the 400th SYNC
    assert state.read_bytes() == flight.saved
    again, _ = goes_on(arm, config, state, frames[syncs[455] :])
    assert again.native.sums.cycle == 1199


@pytest.mark.slow(but=["0"])
@pytest.mark.parametrize("seed", range(4))
def test_killed_while_it_saves(seed: int, arm: Arm, config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    """Whenever the kill comes, the file is whole: the state behind some SYNC."""
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--state", state, "--save-every", 1) as node:
        node.send(frames[: syncs[40] + 1])
        deadline = time.monotonic() + 30.0
        while not state.with_name("state.zyg.previous").exists():
            assert time.monotonic() < deadline
            time.sleep(0.002)
        time.sleep(float(np.random.default_rng(seed).uniform(0.0, 0.2)))
        node.process.kill()
        assert node.process.wait() == -signal.SIGKILL
    flight = Twin(arm, save_every=1)
    stored = snapshot.read(state, "state")
    flight.hear(frames[: syncs[int(stored.receiver.assembly.sync)] + 1])
    assert state.read_bytes() == flight.saved
    with Node("--config", config, "--state", state) as node:
        assert node.complaints == ""


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
        command = [str(build()), *(str(far.fileno()) if word == "FD" else str(word) for word in arguments)]
        done = subprocess.run(command, pass_fds=[far.fileno()], capture_output=True, text=True, check=False, timeout=20)
    assert (done.returncode, done.stdout) == (2, "")
    assert "remedy: " in done.stderr
    return done.stderr


REGIONS = [
    ((0, 7), "is no snapshot"),
    ((8, 9), "of a format that this node does not read"),
    ((10,), "of the other kind"),
    ((11,), "of the other byte order"),
    ((12, 15), "other capacities, structs or version"),
    ((16, 19), "is cut off, or has more bytes"),
    ((20, 23), "is damaged"),
    ((24, 300, -1), "is damaged"),
]
"""First and last byte of each entry of the head, and bytes behind it; and what is said where they are wrong."""


def damages(good: bytes) -> list[tuple[bytes, str]]:
    """Contents that a file may have instead of these, and what is then said of it."""
    contents = []
    for at, reason in [(place % len(good), reason) for places, reason in REGIONS for place in places]:
        contents.append((good[:at] + bytes([good[at] ^ 0x20]) + good[at + 1 :], reason))
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
    for content, reason in damages(Twin(arm).seal()):
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
        assert saved(path) == image(Twin(arm))
        aside.unlink()


def test_a_state_of_another_arm_is_put_aside(config: Path, tmp_path: Path) -> None:
    """It may be the work of a month: the first one is kept, whatever follows."""
    other = tmp_path / "arm.toml"
    other.write_text((EXAMPLE / "arm.toml").read_text().replace("gear_ratio = 50", "gear_ratio = 51", 1))
    compiled(tmp_path, other)
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
    assert word in refused(*(config if word == "CONFIG" else word for word in arguments))


def test_help() -> None:
    done = subprocess.run([build(), "--help"], capture_output=True, text=True, check=True)
    assert all(
        word in done.stdout for word in ("--config", "--fd", "--state", "--every", "--refine", "--exit-idle", "0x720")
    )


def test_a_state_that_cannot_be_saved_is_no_success(config: Path, tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    with Node("--config", config, "--state", folder / "state.zyg") as node:
        shutil.rmtree(folder)
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
    flight = Twin(arm)
    flight.hear(frames[:400])
    assert saved(state) == image(flight)


def test_frames_that_the_kernel_drops_are_counted(config: Path, frames: Log, syncs: Log) -> None:
    """A receive buffer that overflows, in a socket of datagrams that drops as a CAN socket does."""
    near, far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    for end in (near, far):
        end.bind(("127.0.0.1", 0))
    near.connect(far.getsockname())
    far.connect(near.getsockname())
    with Node("--config", config, pair=(near, far)) as node:
        node.send(frames[: syncs[100]])
        node.process.send_signal(signal.SIGSTOP)
        flood = packet(frame_of(0x7FF, b"flood"))
        sent = 0
        for _ in range(60):
            for _ in range(1000):
                near.send(flood)
            sent += 1000
        node.process.send_signal(signal.SIGCONT)
        time.sleep(0.5)
        node.send(frames[syncs[100] : syncs[200]])
        counters = node.end()
    assert 1000 < counters["node_overflow"] < sent
    assert counters["count_cycles"] == 199
    assert not any(n for name, n in counters.items() if name.startswith("fault_"))


def test_heartbeat_tells_whether_sync_comes(config: Path, frames: Log, syncs: Log) -> None:
    """By clock, and also when nothing comes at all."""
    with Node("--config", config) as node:
        time.sleep(1.3)
        begin = time.monotonic()
        for cycle in np.split(frames, syncs[1:31]):
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


def test_silence_ends_it_where_asked(config: Path, frames: Log, syncs: Log, tmp_path: Path) -> None:
    state = tmp_path / "state.zyg"
    with Node("--config", config, "--exit-idle", "0.5", "--state", state) as node:
        for cycle in np.split(frames[: syncs[15] + 1], syncs[1:16]):
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
    flight = Twin(arm)
    flight.hear(frames[:200])
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

# SPDX-License-Identifier: MIT
"""Firmware that runs by itself, spoken to by python-can through slcan: frames in an interrupt, cycles in a task."""

from __future__ import annotations

import itertools
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from build_support import capacities
from cantools.database.can import Database
from numpy.typing import NDArray
from round_support import round_of, told

from pil.conftest import Agree
from pil.live_support import PATIENCE_S, Live, Settled, lines_of, running
from pil.pil_support import HASTY, PAPER, TARGETS, Comparison, Record, compare, recorded
from zygos.arm import Arm
from zygos.can import bus
from zygos.can.dbc import arm_database
from zygos.native import flight
from zygos.native.flight import Flight, encode
from zygos.testing.twin import Twin

EVERY = 100
"""SYNCs from one estimate to the next, as c/ports/cortex-m/live.c has it."""


def the_run() -> tuple[Arm, NDArray[Any]]:
    """The paper's as frames."""
    arm, cycles = recorded("paper")
    return arm, encode(arm, cycles)


def same(arm: Arm, frames: NDArray[Any], found: Settled) -> Comparison:
    """Compare with zygos_arm_t of the host behind these frames in order, of which each zygos_step() takes as many as it
    took on the target, less those that were lost there because the ring was full."""
    ffi, lib = flight.ffi, flight.lib
    assert len(found.stored) == len(frames)
    kept = frames[np.array(found.stored)]
    native = ffi.from_buffer("zygos_frame_t[]", kept.tobytes())
    twin, first = Twin(arm, every=EVERY), 0
    for taken in found.taken:
        for k in range(first, first + taken):
            assert lib.zygos_frame(twin.loop, native + k) == 1
        first += taken
        assert lib.zygos_step(twin.loop) >= 0
        for _ in twin.told():
            pass
    assert first == len(kept)
    twin.native.receiver.faults.overrun += found.stored.count(False)
    return compare([Record("image", bytes(ffi.buffer(twin.native)))], [Record("image", found.state)])


class Listener:
    """Takes what the firmware sends, in a thread of its own."""

    def __init__(self, line: can.BusABC) -> None:
        self.messages: list[can.Message] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, args=(line,))
        self._thread.start()

    def _listen(self, line: can.BusABC) -> None:
        while not self._over.is_set():
            message = line.recv(timeout=0.1)
            if message is not None:
                self.messages.append(message)

    def stop(self) -> list[can.Message]:
        self._over.set()
        self._thread.join()
        return self.messages


@contextmanager
def listening(live: Live) -> Iterator[tuple[can.BusABC, Listener]]:
    line = live.bus()
    listener = Listener(line)
    try:
        yield line, listener
    finally:
        listener.stop()
        line.shutdown()


@pytest.mark.parametrize("target", TARGETS)
def test_a_run_through_the_interrupt(target: str, tmp_path: Path, agree: Agree) -> None:
    """All frames at once: the interrupt takes them while the task works off cycles. The same bits as in order."""
    with capacities(*PAPER.defines):
        arm, frames = the_run()
        with running(tmp_path, target, PAPER, Flight(arm)) as live, listening(live) as (line, _):
            for message in bus.to_messages(frames, arm.period_s):
                line.send(message)
            found = live.settle(len(frames))
            assert live.lines() == (len(frames), 0)
            assert live.word("uart", 1) == live.word("uart", 2) == 0
        agree(target, "paper, live", "zygos_arm_t behind a run", same(arm, frames, found))


@pytest.mark.parametrize("target", TARGETS)
def test_the_estimate_comes_back(target: str, tmp_path: Path) -> None:
    """Telemetry by name, as cantools reads it: each round is the host's estimate behind the same SYNC."""
    with capacities(*PAPER.defines):
        arm, frames = the_run()
        at = np.flatnonzero(frames["id"] == 0x080)
        begins = at[: 9 * EVERY : EVERY]
        host, done, expected, database = Twin(arm, every=EVERY), 0, [], arm_database(arm)
        with running(tmp_path, target, PAPER, Flight(arm)) as live, listening(live) as (line, listener):
            for begin, end in itertools.pairwise(begins):
                for message in bus.to_messages(frames[done : begin + 1], arm.period_s):
                    line.send(message)
                host.hear(frames[done : begin + 1])
                expected.append(round_of(host.answers[-1], host.names))
                # the estimate is of what came up to here: nothing may follow before its first value is there
                wait_for(lambda: len(rounds(database, listener.messages)) == len(expected))
                for message in bus.to_messages(frames[begin + 1 : end], arm.period_s):
                    line.send(message)
                host.hear(frames[begin + 1 : end])
                done = end
            wait_for(lambda: len(rounds(database, listener.messages)[-1]) == len(expected[-1]))
        assert rounds(database, listener.messages) == expected
        assert expected[-1]["verdict_validity"] >= 2.0
        assert set(arm.parameter_names) <= set(expected[-1])


def rounds(database: Database, messages: list[can.Message]) -> list[dict[str, float]]:
    """What each estimate's telemetry says; the verdict comes first."""
    out: list[dict[str, float]] = []
    for message in list(messages):
        assert message.arbitration_id == 0x1A0
        name, value, _ = told(database, bytes(message.data))
        if name == "verdict_validity":
            out.append({})
        out[-1][name] = value
    return out


def wait_for(there: Callable[[], bool]) -> None:
    limit = time.monotonic() + PATIENCE_S
    while not there():
        assert time.monotonic() < limit, "the target does not answer"
        time.sleep(0.005)


def spoiled(rng: np.random.Generator, line: bytes) -> bytes:
    """A line that is none any more, as noise on the wire and hasty hosts make them."""
    match rng.integers(0, 6):
        case 0:
            return line[: rng.integers(1, len(line) - 1)] + b"\r"  # cut off
        case 1:
            return line[:-1] + b"0" * int(rng.integers(1, 300)) + b"\r"  # too long
        case 2:
            noise = rng.integers(0, 256, rng.integers(1, 60), dtype=np.uint8)
            return b"\xff" + bytes(noise[noise != 13]) + b"\r"
        case 3:
            at = int(rng.integers(1, len(line) - 1))
            return line[:at] + b"g" + line[at + 1 :]  # no digit
        case 4:
            return line[:4] + b"9" + line[5:]  # more bytes than a frame has
        case _:
            return b"t8" + line[2:]  # no identifier of 11 bits


def test_spoiled_lines(tmp_path: Path, agree: Agree) -> None:
    """Garbage, cut and overlong lines: each is answered by BEL, counted and without effect on the frames around it."""
    rng = np.random.default_rng(3)
    with capacities(*PAPER.defines):
        arm, frames = the_run()
        frames = frames[:1400]
        stream, bad = [b"\r\r\rC\rS8\rO\r"], 0
        for line in lines_of(bus.to_messages(frames, arm.period_s)):
            if rng.random() < 0.3:
                stream.append(spoiled(rng, line))
                bad += 1
            stream.append(line)
        with running(tmp_path, "m7", PAPER, Flight(arm)) as live:
            answers = exchange(live, b"".join(stream), len(frames) + bad)
            found = live.settle(len(frames) + bad)
            assert live.lines() == (len(frames), bad)
            assert b"F80\r" in exchange(live, b"F\r", 0)
            assert b"F00\r" in exchange(live, b"F\r", 0)
        assert answers.count(b"\a") == bad
        assert answers.count(b"z\r") == len(frames)
        agree("m7", "paper, spoiled lines", f"{bad} of them", same(arm, frames, found))


def test_lost_characters(tmp_path: Path, agree: Agree) -> None:
    """What an overrun of the UART does to the lines: they are refused, their cycles are incomplete, nothing else."""
    rng = np.random.default_rng(4)
    with capacities(*PAPER.defines):
        arm, frames = the_run()
        frames = frames[:2800]
        text = np.frombuffer(b"".join(lines_of(bus.to_messages(frames, arm.period_s))), np.uint8)
        kept = bytes(text[rng.random(len(text)) > 2e-3])
        *lines, rest = kept.split(b"\r")
        good = np.array([well_formed(line) for line in lines])
        survived = [read(line) for line, ok in zip(lines, good, strict=True) if ok]
        with running(tmp_path, "m7", PAPER, Flight(arm)) as live:
            exchange(live, b"O\r" + kept, len(lines))
            found = live.settle(len(lines))
            assert live.lines() == (int(good.sum()), int((~good).sum()))
        assert rest == b""
        left = np.array(survived, dtype=flight.FRAME)
        state = flight.ffi.from_buffer("zygos_arm_t *", found.state)
        assert state.receiver.faults.incomplete > 30
        assert state.gaps > 10
        agree("m7", "paper, lost characters", "what survived", same(arm, left, found))


def well_formed(line: bytes) -> bool:
    """A frame with an 11-bit identifier, as the manual of slcan describes it."""
    match = re.fullmatch(rb"t[0-7][0-9A-F]{2}([0-8])((?:[0-9A-F]{2})*)", line)
    return match is not None and len(match[2]) == 2 * int(match[1])


def read(line: bytes) -> tuple[int, int, int, list[int], list[int]]:
    """The frame of a well-formed line, as a `FRAME` record."""
    data = bytes.fromhex(line[5:].decode())
    return int(line[1:4], 16), int(line[4:5]), 0, [0, 0], list(data.ljust(8, b"\0"))


def exchange(live: Live, text: bytes, lines: int) -> bytes:
    """Send characters; what came back until so many frames and refused lines are through and the line is quiet."""
    host, port = live.channel.removeprefix("socket://").split(":")
    out = bytearray()
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as line:
        sender = threading.Thread(target=line.sendall, args=(text,))
        sender.start()
        limit = time.monotonic() + PATIENCE_S
        line.settimeout(0.3)
        while time.monotonic() < limit:
            try:
                out += line.recv(65536)
            except TimeoutError:
                if sum(live.lines()) >= lines and not sender.is_alive():
                    break
        sender.join()
    return bytes(out)


def test_a_task_that_is_held_up(tmp_path: Path, agree: Agree) -> None:
    """The ring runs over: the frames that were lost are counted, the arc ends, and the rest is as on the host."""
    with capacities(*HASTY.defines):
        arm, frames = the_run()
        frames = frames[: np.flatnonzero(frames["id"] == 0x080)[100] + 1]
        with (
            running(tmp_path, "m7", HASTY, Flight(arm), drills=("drill_stall",)) as live,
            listening(live) as (line, _),
        ):
            for k, message in enumerate(bus.to_messages(frames, arm.period_s)):
                line.send(message)
                # no faster than the task, or it would lose cycles elsewhere too
                while k % 14 == 13 and sum(live.lines()) < k - 14:
                    time.sleep(0.001)
            found = live.settle(len(frames))
        state = flight.ffi.from_buffer("zygos_arm_t *", found.state)
        lost = state.receiver.faults.overrun
        assert lost >= 5
        assert lost == found.stored.count(False)
        number = np.cumsum(frames["id"] == 0x080)
        assert 0 < 100 - state.cycles <= len(set(number[~np.array(found.stored)])) + 1
        assert state.gaps >= 1
        agree("m7", "paper, task held up", f"{lost} frames lost", same(arm, frames, found))


def test_a_pseudo_terminal(tmp_path: Path) -> None:
    """The other way to a serial line, and what adapters say of themselves."""
    with capacities(*PAPER.defines):
        arm, frames = the_run()
        frames = frames[:350]
        with running(tmp_path, "m7", PAPER, Flight(arm), line="pty") as live:
            line: Any = live.bus()
            line.set_bitrate(500_000)
            assert line.get_serial_number(timeout=10) == "ZYGO"
            assert line.get_version(timeout=10) == (0, 2)
            for message in bus.to_messages(frames, arm.period_s):
                line.send(message)
            found = live.settle(len(frames))
            line.shutdown()
        assert not same(arm, frames, found).first


def test_a_closed_channel(tmp_path: Path) -> None:
    """Before O and behind C no frame comes in, and none goes out."""
    with capacities(*PAPER.defines):
        arm, frames = the_run()
        text = b"".join(lines_of(bus.to_messages(frames[:70], arm.period_s)))
        with running(tmp_path, "m7", PAPER, Flight(arm)) as live:
            assert exchange(live, text, 70) == b"\a" * 70
            untouched = live.memory("arm")
            assert exchange(live, b"S9\rO\rS8\rC\r", 72) == b"\a\r\a\r"
            assert exchange(live, text, 142) == b"\a" * 70
            assert live.memory("arm") == untouched

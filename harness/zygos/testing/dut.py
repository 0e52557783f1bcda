# SPDX-License-Identifier: MIT
"""The device under test: zygos-node in a separate process, or an external device on the channel."""

from __future__ import annotations

import math
import os
import shutil
import signal
import socket
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import can
import pytest
from cantools.database.can import Database

from zygos.arm import Arm
from zygos.can.bus import open_bus
from zygos.can.dbc import arm_database
from zygos.can.rounds import TELEMETRY, rounds
from zygos.errors import ZygosError
from zygos.files.names import ascii_name
from zygos.native import snapshot
from zygos.native.flight import Estimate
from zygos.testing.latency import Answers, answers
from zygos.testing.oracle import disagreement, fault_counts
from zygos.testing.stream import SYNC, Stream
from zygos.testing.twin import Twin

EXTERNAL = "external"
"""Value of the command for an external device: it runs already, and the bench does not start or stop it."""
HEARTBEAT = 0x720
EVERY = 12
"""SYNCs between two estimates of zygos-node. The first SYNC is answered; values that are not finite are not sent."""
PATIENCE_S = 30.0
"""Longest time for a process to start or to end, s; an emulated device is slow."""
_MODULUS = 2**24
"""Counters below this are exact in telemetry, which sends single floats."""
_SO_RCVBUFFORCE, _ROOM = 33, 8 * 1024 * 1024
"""Option of Linux, which Python does not name, and bytes of the socket: frames that wait until this process runs."""
QUIET_S = 0.3
"""A device that has sent nothing for that long has finished, s."""


class Dut:
    """The device, and a model of it: the C library in this process (`twin`), which is fed with the same frames.

    A test that requires our own device ends as *not evaluated* with an external one (`own`).
    """

    def __init__(self, arm: Arm, channel: str, command: str, folder: Path) -> None:
        """command: starts the device, or EXTERNAL. folder: place of its files. The device is not started yet."""
        self.arm, self.channel, self.command, self.folder = arm, channel, command, folder
        self.every = EVERY
        self.twin = Twin(arm, every=EVERY)
        self._heard: list[can.Message] = []
        self.record: dict[str, Any] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._database: Database = arm_database(arm)

    def __enter__(self) -> Dut:
        """Start to listen."""
        self._bus = open_bus("socketcan", self.channel)
        identifiers = (SYNC, TELEMETRY, HEARTBEAT)
        self._bus.set_filters([{"can_id": i, "can_mask": 0x7FF, "extended": False} for i in identifiers])
        with suppress(OSError):  # needs the right; otherwise the room is as large as the kernel makes it by itself
            room: Any = self._bus  # of SocketCAN, whose socket python-can does not declare
            room.socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _ROOM)
        self._notifier = can.Notifier(self._bus, [self._heard.append], timeout=0.2)
        return self

    def __exit__(self, *_: object) -> None:
        """Stop listening, and end our own device."""
        self._notifier.stop()
        self._bus.shutdown()
        self._end()

    def renew(self) -> None:
        """Reset all results; also our own device and its state. An external one continues unchanged."""
        self._heard.clear()
        self.record = {"frames": 0, "expected": None, "found": None}
        if not self.external:
            self._end()
            for path in self.folder.glob(f"{self.state.name}*"):  # also the previous generation
                path.unlink()
            self.twin = Twin(self.arm, every=self.every)

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    @property
    def external(self) -> bool:
        """Whether the device is external."""
        return self.command == EXTERNAL

    def own(self, why: str) -> None:
        """State why a test needs our own device; with an external one the test ends here, not evaluated."""
        if self.external:
            pytest.skip(f"not evaluated: {why}")

    @property
    def state(self) -> Path:
        """The file of its saved state."""
        return self.folder / "state.zyg"

    def start(self, every: int = EVERY) -> None:
        """Start the device, from its saved state if there is one. Nothing happens for an external one.

        every: SYNCs from one of its estimates to the next. Errors: ZygosError if there is no such command, or it ends
        at once.
        """
        if self.external:
            return
        self.every = every
        node = shutil.which(self.command)
        if node is None:
            raise ZygosError(f"there is no {self.command}; remedy: run make node, or use --zygos-dut {EXTERNAL}")
        blob, errors_file = self.folder / "arm.zyg", self.folder / "stderr"
        self.twin = Twin(self.arm, every=every)
        snapshot.write(blob, "configuration", self.twin.config)
        if self.state.exists():
            self.twin.resume(self.state)  # as the device will do
        files = ["--config", str(blob), "--state", str(self.state)]
        command = [node, "-i", self.channel, *files, "--every", str(every)]
        with errors_file.open("wb") as errors, (self.folder / "stdout").open("wb") as out:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=errors)
        deadline = time.monotonic() + PATIENCE_S
        while b"listening on" not in errors_file.read_bytes():
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.kill()
                printed = errors_file.read_text(errors="replace").strip() or "it printed nothing"
                raise ZygosError(
                    f"{self.command} does not listen: {printed}; remedy: check that interface {self.channel} is up"
                )
            time.sleep(0.002)

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The process. Errors: ZygosError if it was not started."""
        if self._process is None:
            raise ZygosError("the device under test is not running; remedy: call dut.start()")
        return self._process

    def stop(self) -> dict[str, int]:
        """End the device in order (SIGTERM), so that it saves its state. Returns the counters that it prints.

        Errors: ZygosError if it does not end, or not in order.
        """
        self.own("an external device cannot be ended by the bench")
        self.process.send_signal(signal.SIGTERM)
        try:
            status = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise ZygosError(f"{self.command} does not end; remedy: read {self.folder}") from None
        self._process = None
        if status:
            message = (self.folder / "stderr").read_text(errors="replace").strip()
            raise ZygosError(f"{self.command} ended with status {status}: {message}; remedy: see {self.folder}")
        return dict(_counters((self.folder / "stdout").read_text(encoding="utf-8")))

    def kill(self) -> None:
        """End the device at once (SIGKILL)."""
        self.own("an external device cannot be killed by the bench")
        self.process.kill()
        self._end()

    def telemetry(self) -> list[can.Message]:
        """The device's telemetry frames so far."""
        return [message for message in self._heard if message.arbitration_id == TELEMETRY]

    def heartbeats(self) -> list[can.Message]:
        """The device's heartbeats so far."""
        return [message for message in self._heard if message.arbitration_id == HEARTBEAT]

    def answers(self, period_s: float, first: int = 0) -> Answers:
        """How long the device took to answer the SYNCs on the bus, from number `first` since the test began.

        period_s: time from one SYNC to the next as they were sent, s. The time stamps are the kernel's.
        """
        syncs = 0
        for at, message in enumerate(self._heard):
            syncs += message.arbitration_id == SYNC
            if syncs > first:
                return answers(self._heard[at:], period_s)
        return answers([], period_s)

    def settle(self) -> None:
        """Wait until the device has sent nothing for a while, so that it has processed everything."""
        known = -1
        while known < len(self.telemetry()):
            known = len(self.telemetry())
            time.sleep(QUIET_S)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stop the device temporarily (SIGSTOP), like a task that gets no processor time."""
        self.own("an external device cannot be paused by the bench")
        os.kill(self.process.pid, signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)
        try:
            yield
        finally:
            os.kill(self.process.pid, signal.SIGCONT)

    def rounds(self) -> list[dict[str, float]]:
        """The device's answers so far, decoded by the arm's DBC: a round for each complete estimate.

        Names are those of the signals: k1, k1_sigma, fault_crc, verdict_cycle. Values that were not finite are missing.
        A round begins with verdict_validity.
        """
        return rounds(self._database, self.telemetry())

    def judge(self, *streams: Stream, **expected: int) -> None:
        """Compare the device with the expected results after it received the last of the streams since its start.

        expected: the number of each fault that the drill causes, 0 where not named. streams: those on which the
        estimate is based, in order; the device received those before the last one in earlier starts.

        The library in this process must count the expected faults, and for a single stream the numpy reference as well;
        its estimate must be numpy's over the cycles that survived. The last answers of the device must be those
        counters, and the library's estimate at that cycle. Our own device is stopped, and its saved state must be equal
        to the library's in each byte. Raises AssertionError.
        """
        wanted = +Counter(expected)
        self.record |= {"frames": sum(map(len, streams)), "expected": dict(wanted)}
        if self._process is not None:
            self.stop()
        self.settle()
        rounds = self.rounds()
        assert rounds and "verdict_cycle" in rounds[-1], "the device has not answered with a complete estimate"
        answer = rounds[-1]
        before = Counter(self.twin.faults) if self.external else Counter()
        estimate = self._hear(streams[-1], int(answer["verdict_cycle"]))
        prefix = "fault_"
        counts = {name.removeprefix(prefix): int(x) for name, x in answer.items() if name.startswith(prefix)}
        found = Counter(counts) - before
        self.record["found"] = dict(found)
        if self.external:  # its counters include faults at the transition between the runs of two drills
            assert found == Counter(self.twin.faults) - before, f"the device counts {dict(found)} more than before"
        else:
            assert found == wanted, f"the device counts {dict(found)}, not {dict(wanted)}"
            assert self.state.read_bytes() == self.twin.seal(), "the state is not the library's"
        if len(streams) == 1:
            reference = fault_counts(streams[0])
            assert reference == wanted, f"the reference counts {reference}, not {dict(wanted)}"
        for k, name in enumerate(self.twin.names):
            of = ascii_name(name)
            for item, x in ((of, float(estimate.value[k])), (f"{of}_sigma", float(estimate.sigma[k]))):
                same = abs(answer.get(item, math.nan) - x) <= 1e-6 * abs(x)
                assert same or (math.isnan(x) and item not in answer), f"{item} is {answer.get(item)}, not {x}"
        off = disagreement(self._learned(streams), *streams)
        assert off <= 1.0, f"the estimate is off by {off:.3g} tolerances"

    def _hear(self, stream: Stream, cycle: int) -> Any:
        """Feed the twin with a stream. Returns its estimate at a cycle, given by its number modulo 2^24, a
        ``zygos_estimate_t *``."""
        first = len(self.twin.answers)
        self.twin.hear(stream.passed())
        told = {int(answer.estimate.cycle) % _MODULUS: answer.estimate for answer in self.twin.answers[first:]}
        assert cycle in told, f"the device answers with cycle {cycle}, at which none was due"
        return told[cycle]

    def _learned(self, streams: Sequence[Stream]) -> Estimate:
        """The library's estimate from these streams."""
        if not self.external:
            return self.twin.estimate()
        alone = Twin(self.arm, every=self.every)
        alone.hear(streams[-1].passed())
        return alone.estimate()


def _counters(text: str) -> Iterator[tuple[str, int]]:
    """Names and values of lines that consist of a name and a number."""
    for line in text.splitlines():
        words = line.split()
        if len(words) == 2 and words[1].isdigit():
            yield words[0], int(words[1])

"""The device under test: zygos-node in a process of its own, or whatever answers on the channel."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cantools.database.can import Database
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.bus import open_bus
from zygos.can.dbc import arm_database
from zygos.errors import ZygosError
from zygos.files.names import ascii_name
from zygos.native import snapshot
from zygos.native.flight import Estimate, Flight, ffi, lib
from zygos.testing.oracle import disagreement, fault_counts
from zygos.testing.stream import SYNC, Stream

EXTERNAL = "external"
"""Instead of a command: the device is there already, and is not ours to start and stop."""
TELEMETRY, HEARTBEAT = 0x1A0, 0x720
EVERY = 12
"""SYNCs from one estimate of zygos-node to the next. The first of them is answered; what is not finite is not sent."""
PATIENCE_S = 30.0
"""For a process to start or to end. A guest in emulation is slow."""
_MODULUS = 2**24
"""Counters in telemetry stay whole numbers as single floats."""
QUIET_S = 0.3
"""A device that has not answered for so long has no more to say."""


def hear(flight: Flight, frames: NDArray[Any], every: int = 100, syncs: int = 0) -> Iterator[None]:
    """Give frames to a flight as zygos-node does, which has heard so many SYNCs before; pauses behind each SYNC.

    At the first SYNC and every so many behind it the node solves; its arcs are judged by the solution from there on.
    """
    first = 0
    for at in np.flatnonzero((frames["id"] == SYNC) & (frames["flags"] == 0)):
        flight.frames(frames[first:at])
        first = int(at) + 1
        verdict = lib.zygos_frame(flight.native, ffi.from_buffer("zygos_frame_t[]", frames[at : at + 1].tobytes()))
        while lib.zygos_step(flight.native) == 1:
            pass
        if verdict != lib.ZYGOS_ACCEPTED:  # a SYNC that comes twice is none
            continue
        if syncs % every == 0:
            flight.estimate()
            flight.adopt()
        syncs += 1
        yield
    flight.frames(frames[first:])


class Dut:
    """The device, and a twin of it: the C library in this process, which is given the same frames.

    What a test asks for that needs a device of our own ends the test as *not evaluated* (`own`).
    """

    def __init__(self, arm: Arm, channel: str, command: str, folder: Path) -> None:
        """Command: what starts the device, or EXTERNAL. folder: where its files are. It is not started."""
        self.arm, self.channel, self.command, self.folder = arm, channel, command, folder
        self.twin = Flight(arm)
        self._answers: list[can.Message] = []
        self.record: dict[str, Any] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._database: Database = arm_database(arm)

    def __enter__(self) -> Dut:
        """Begin to listen."""
        self._bus = open_bus("socketcan", self.channel)
        self._bus.set_filters([{"can_id": i, "can_mask": 0x7FF, "extended": False} for i in (TELEMETRY, HEARTBEAT)])
        self._notifier = can.Notifier(self._bus, [self._answers.append], timeout=0.2)
        return self

    def __exit__(self, *_: object) -> None:
        """Listen no more, and end a device of our own."""
        self._notifier.stop()
        self._bus.shutdown()
        self._end()

    def renew(self) -> None:
        """Forget what was; a device of our own and its state as well. An external one goes on as it is."""
        self._answers.clear()
        self.record = {"frames": 0, "expected": None, "found": None}
        if not self.external:
            self._end()
            for path in self.folder.glob(f"{self.state.name}*"):  # the generation before, too
                path.unlink()
            self.twin = Flight(self.arm)

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    @property
    def external(self) -> bool:
        """Whether it is somebody else's."""
        return self.command == EXTERNAL

    def own(self, why: str) -> None:
        """Say why a test needs a device of our own; with an external one the test ends here, not evaluated."""
        if self.external:
            pytest.skip(f"not evaluated: {why}")

    @property
    def state(self) -> Path:
        """The file of its saved state."""
        return self.folder / "state.zyg"

    def start(self) -> None:
        """Start it, from its saved state if there is one. An external one is there: nothing happens.

        Errors: ZygosError if there is no such command, or it ends at once.
        """
        if self.external:
            return
        node = shutil.which(self.command)
        if node is None:
            raise ZygosError(f"there is no {self.command}; remedy: make node, or --zygos-dut {EXTERNAL}")
        blob, said = self.folder / "arm.zyg", self.folder / "stderr"
        self.twin = Flight(self.arm)
        snapshot.write(blob, "configuration", ffi.addressof(self.twin.native, "config"))
        if self.state.exists():
            snapshot.resume(self.twin, self.state)  # as the device will
        files = ["--config", str(blob), "--state", str(self.state)]
        command = [node, "-i", self.channel, *files, "--every", str(EVERY)]
        with said.open("wb") as errors, (self.folder / "stdout").open("wb") as out:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=errors)
        deadline = time.monotonic() + PATIENCE_S
        while b"listening on" not in said.read_bytes():
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.kill()
                raise ZygosError(
                    f"{self.command} does not listen: {said.read_text(errors='replace').strip() or 'it says nothing'}; "
                    f"remedy: see whether interface {self.channel} is up"
                )
            time.sleep(0.002)

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The process. Errors: ZygosError if it was not started."""
        if self._process is None:
            raise ZygosError("the device under test does not run; remedy: dut.start()")
        return self._process

    def stop(self) -> dict[str, int]:
        """End it in order (SIGTERM): it saves its state. Returns the counters that it then says.

        Errors: ZygosError if it does not end, or not in order.
        """
        self.own("an external device is not ours to end")
        self.process.send_signal(signal.SIGTERM)
        try:
            status = self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise ZygosError(f"{self.command} does not end; remedy: see {self.folder}") from None
        self._process = None
        if status:
            said = (self.folder / "stderr").read_text(errors="replace").strip()
            raise ZygosError(f"{self.command} ended with status {status}: {said}; remedy: see {self.folder}")
        return dict(_counters((self.folder / "stdout").read_text(encoding="utf-8")))

    def kill(self) -> None:
        """End it at once (SIGKILL)."""
        self.own("an external device is not ours to kill")
        self.process.kill()
        self._end()

    def telemetry(self) -> list[can.Message]:
        """Its telemetry frames so far."""
        return [message for message in self._answers if message.arbitration_id == TELEMETRY]

    def heartbeats(self) -> list[can.Message]:
        """Its heartbeats so far."""
        return [message for message in self._answers if message.arbitration_id == HEARTBEAT]

    def settle(self) -> None:
        """Wait until it has said nothing new for a while: it has worked off what it was sent."""
        known = -1
        while known < len(self.telemetry()):
            known = len(self.telemetry())
            time.sleep(QUIET_S)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Let it stand still (SIGSTOP) for a while, as a task does that is kept from running."""
        self.own("an external device is not ours to hold")
        os.kill(self.process.pid, signal.SIGSTOP)
        os.waitpid(self.process.pid, os.WUNTRACED)
        try:
            yield
        finally:
            os.kill(self.process.pid, signal.SIGCONT)

    def rounds(self) -> list[dict[str, float]]:
        """Its answers so far, decoded by the DBC of the arm: a round for each estimate, but for the one under way.

        Names are those of the signals: k1, k1_sigma, fault_crc, verdict_cycle. What was not finite is not sent. A round
        begins with verdict_validity.
        """
        rounds: list[dict[str, float]] = []
        for message in self.telemetry():
            decoded = self._database.decode_message(TELEMETRY, bytes(message.data), decode_choices=False)
            assert isinstance(decoded, dict)
            name, value = next(reversed(decoded.items()))
            assert isinstance(value, float | int)
            if name == "verdict_validity":
                rounds.append({})
            if rounds:
                rounds[-1][name] = value
        return rounds[:-1]

    def judge(self, *streams: Stream, **expected: int) -> None:
        """Hold the device against what it must be, having heard the last of the streams since its start.

        expected: the faults that the drill makes by its own reckoning, 0 where not named. streams: what the estimate
        rests on, in order; those before the last one were heard by the device in earlier lives.

        The library in this process must count the expected faults, for a single stream the numpy reference as well;
        its estimate must be numpy's over the cycles that survived. The last answers of the device must be those
        counters, and the library's estimate at that cycle. A device of our own is stopped, and its saved state must be
        the library's in each byte. Raises AssertionError.
        """
        wanted = +Counter(expected)
        self.record |= {"frames": sum(map(len, streams)), "expected": dict(wanted)}
        if self._process is not None:
            self.stop()
        self.settle()
        rounds = self.rounds()
        assert rounds and "verdict_cycle" in rounds[-1], "the device has not answered with a whole estimate"
        answer = rounds[-1]
        before = Counter(self.twin.faults) if self.external else Counter()
        estimate = self._hear(streams[-1], int(answer["verdict_cycle"]))
        prefix = "fault_"
        counts = {name.removeprefix(prefix): int(x) for name, x in answer.items() if name.startswith(prefix)}
        found = Counter(counts) - before
        self.record["found"] = dict(found)
        if self.external:  # it counts, too, how the runs of two drills meet
            assert found == Counter(self.twin.faults) - before, f"the device counts {dict(found)} more than before"
        else:
            assert found == wanted, f"the device counts {dict(found)}, not {dict(wanted)}"
            assert self.state.read_bytes() == snapshot.seal("state", self.twin.native), "the state is not the library's"
        if len(streams) == 1:
            reference = fault_counts(streams[0])
            assert reference == wanted, f"the reference counts {reference}, not {dict(wanted)}"
        for name, value, sigma in zip(estimate.names, estimate.value, estimate.sigma, strict=True):
            for item, x in ((ascii_name(name), value), (f"{ascii_name(name)}_sigma", sigma)):
                same = abs(answer.get(item, math.nan) - x) <= 1e-6 * abs(x)
                assert same or (math.isnan(x) and item not in answer), f"{item} is {answer.get(item)}, not {x}"
        off = disagreement(self._learned(streams), *streams)
        assert off <= 1.0, f"the estimate is off by {off:.3g} tolerances"

    def _hear(self, stream: Stream, cycle: int) -> Estimate:
        """Tell the twin of a stream. Returns its estimate as of a cycle, by its number modulo 2^24."""
        estimate = None
        for _ in hear(self.twin, stream.frames, EVERY):
            if estimate is None and int(self.twin.native.cycle) % _MODULUS == cycle:
                estimate = self.twin.estimate()
        assert estimate is not None, f"the device answers with cycle {cycle}, which was not in the stream"
        return estimate

    def _learned(self, streams: Sequence[Stream]) -> Estimate:
        """The library's estimate from these streams."""
        if not self.external:
            return self.twin.estimate()
        alone = Flight(self.arm)
        for _ in hear(alone, streams[-1].frames, EVERY):
            pass
        return alone.estimate()


def _counters(text: str) -> Iterator[tuple[str, int]]:
    """Lines that consist of a name and a number."""
    for line in text.splitlines():
        words = line.split()
        if len(words) == 2 and words[1].isdigit():
            yield words[0], int(words[1])

# SPDX-License-Identifier: MIT
"""zygos-node as a child of the test, its bus one end of a pair of sockets."""

from __future__ import annotations

import fcntl
import math
import os
import signal
import socket
import struct
import subprocess
import tempfile
import termios
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from cli_support import run
from numpy.typing import NDArray

from conftest import EXAMPLE, ROOT
from zygos.native import snapshot
from zygos.native.flight import FRAME, ffi, lib
from zygos.testing.twin import HEAD, Answer, Event, Twin

NODE = ROOT / "build" / "zygos-node"
SYNC, TELEMETRY = 0x080, 0x1A0
Log = NDArray[Any]

EXTENDED, REMOTE, ERROR, FD = 1, 2, 4, 8
"""Bits of a frame's flags."""


@cache
def build() -> Path:
    """The node of this tree. Several processes may ask at once."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    with (Path(tempfile.gettempdir()) / "zygos-node.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        subprocess.run(["make", "--silent", "node"], cwd=ROOT, env=environment, check=True)
    return NODE


@cache
def _symbol(name: str) -> int:
    """Where in the program one of its variables is."""
    symbols = subprocess.run(["nm", NODE], capture_output=True, text=True, check=True).stdout.splitlines()
    (symbol,) = (int(line.split()[0], 16) for line in symbols if line.split()[1:] == ["b", name])
    return symbol


def compiled(folder: Path, arm_file: Path = EXAMPLE / "arm.toml", *more: object) -> Path:
    """The configuration of an arm file for the node."""
    assert run("compile-model", arm_file, "-o", folder, *more) == 0
    return folder / "arm.zyg"


def image(twin: Twin) -> bytes:
    """The zygos_arm_t of a twin, as it is saved now."""
    return twin.seal()[HEAD:]


def saved(path: Path) -> bytes:
    """The zygos_arm_t of a stored state."""
    return bytes(ffi.buffer(snapshot.read(path, "state")))


def packet(frame: Any) -> bytes:
    """A `FRAME` record as the struct can_frame or canfd_frame of a socket."""
    bits = sum(bit for flag, bit in ((EXTENDED, 1 << 31), (REMOTE, 1 << 30), (ERROR, 1 << 29)) if frame["flags"] & flag)
    head = struct.pack("=IB3x", int(frame["id"]) | bits, int(frame["length"]))
    return head + bytes(frame["data"]) + (bytes(56) if frame["flags"] & FD else b"")


def frame_of(identifier: int, data: bytes = b"", flags: int = 0) -> Any:
    """One `FRAME` record."""
    out = np.zeros(1, FRAME)
    out["id"], out["length"], out["flags"] = identifier, len(data), flags
    out["data"][0, : len(data)] = np.frombuffer(data, np.uint8)
    return out[0]


def flip(twin: Twin, place: int, bit: int) -> None:
    """The upset of `Node.flip` in a twin."""
    memory = ffi.buffer(twin.native)
    memory[place] = bytes([memory[place][0] ^ 1 << bit])


class Teller(Twin):
    """A twin that also writes the telemetry, as docs/wire.md and docs/node.md have it."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.sent: list[bytes] = []
        """The data of the frames 0x1A0."""
        self.waiting: list[tuple[int, int, float]] = []
        """Kind, index and value of what is still to be sent."""

    def hear(self, frames: Log) -> None:
        for event in self.events(frames):
            behind = (self.syncs - 1) % self.every
            if event is Event.ANSWER:
                self.waiting = items_of(self.answers[-1])
                self._send(self.every - behind)
            elif event is Event.JUDGED:
                self.waiting += refined_items_of(self.answers[-1].refined)
                self._send(1 if self._wanted else 0)
            else:
                self._send(self.every - behind if behind > 0 else 1)

    def _send(self, syncs: int) -> None:
        """An equal portion at each of so many SYNCs; all where the next estimate may come before the next SYNC."""
        share = -(-len(self.waiting) // syncs) if syncs else 0
        frame = ffi.new("zygos_frame_t *")
        for kind, index, value in self.waiting[:share]:
            if math.isfinite(value):
                lib.zygos_wire_encode_telemetry(self._counter & 15, index, kind, value, frame)
                self.sent.append(bytes(frame.data))
        del self.waiting[:share]


def items_of(answer: Answer) -> list[tuple[int, int, float]]:
    """Kind, index and value of all that the telemetry has of an answer, in its order."""
    out = answer.estimate
    verdict = [out.validity, out.reason, out.cycle, out.accepted, out.refused, out.arcs, out.blocks, out.rank]
    verdict += [out.condition, out.cluster, out.residual, out.noise_ratio, out.signal_to_noise, out.left_out[0]]
    counts = answer.counts
    names = ("cycles", "gaps", "invalid", "wraps", "accepted", "refused", "arcs", "arcs_dropped")
    counters = [*answer.faults.values(), *(counts[name] for name in names), 0, 0, 0, 0, answer.corrupt, 0]
    counters += [counts["apart"], counts["waited"]]
    items = [(3, k, float(value)) for k, value in enumerate(verdict)]
    items += [(2, k, float(value)) for k, value in enumerate(counters)]
    for k in range(out.parameters):
        items += [(0, k, out.value[k]), (1, k, out.sigma[k]), (4, k, out.half95[k])]
    return items


def refined_items_of(out: Any) -> list[tuple[int, int, float]]:
    """The same of a verdict on the refinement."""
    told = [out.reason, out.cycle, out.used, out.lost, out.restarts, out.rejected, out.farthest, out.distance]
    told += [out.level, out.level_error, *out.nis, *out.ratio]
    items = [(7, k, float(value)) for k, value in enumerate(told)]
    for k in range(out.parameters if out.published else 0):
        items += [(5, k, out.value[k]), (6, k, out.sigma[k])]
    return items


class Node:
    """A running node. `answers` has the (identifier, data) of what it sent, `complaints` what it said before `first`,
    the line that tells that it listens."""

    def __init__(
        self,
        *arguments: object,
        pair: tuple[socket.socket, socket.socket] | None = None,
        environment: dict[str, str] | None = None,
        through: tuple[str, ...] = (),
        program: Path | None = None,
    ) -> None:
        self.near, far = pair or socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.answers: list[tuple[int, bytes]] = []
        command = [*through, str(program or build()), *map(str, arguments), "--fd", str(far.fileno())]
        self.process = subprocess.Popen(
            command,
            pass_fds=[far.fileno()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | (environment or {}),
        )
        far.close()
        assert self.process.stderr is not None
        self.complaints = ""
        self.first = self.process.stderr.readline()
        while self.first and "listening on" not in self.first:
            self.complaints += self.first
            self.first = self.process.stderr.readline()

    def __enter__(self) -> Node:
        assert self.first.startswith("zygos-node: listening on --fd"), self.complaints + self.first
        return self

    def __exit__(self, *error: object) -> None:
        self.process.kill()
        self.process.communicate()
        self.near.close()

    def listen(self) -> None:
        """Take what has been sent until now."""
        while True:
            try:
                data = self.near.recv(100, socket.MSG_DONTWAIT)
            except (BlockingIOError, ConnectionResetError):
                return
            if not data:
                return
            identifier, length = struct.unpack_from("=IB", data)
            assert len(data) == 16
            self.answers.append((identifier, data[8 : 8 + length]))

    def send(self, frames: Log) -> None:
        """Send `FRAME` records, listening meanwhile."""
        for frame in frames:
            self.near.send(packet(frame))
            if frame["id"] == SYNC:
                self.listen()

    def wait(self) -> tuple[int, dict[str, int], str]:
        """Exit code, counters and what else was said, once the node has ended."""
        out, said = self.process.communicate(timeout=60)
        self.listen()
        counters = dict(line.split() for line in out.splitlines())
        return self.process.returncode, {name: int(value) for name, value in counters.items()}, said

    def end(self) -> dict[str, int]:
        """Tell it to end, in order. Returns its counters."""
        self.process.send_signal(signal.SIGTERM)
        code, counters, said = self.wait()
        assert (code, said) == (0, "")
        return counters

    def worked_off(self, syncs: int) -> None:
        """Wait until it has received so many SYNCs since its first start, and waits for more."""
        place = ffi.offsetof("zygos_arm_t", "receiver") + ffi.offsetof("zygos_receiver_t", "assembly")
        deadline = time.monotonic() + 30.0
        while int.from_bytes(self.memory(place, 8), "little") < syncs - 1 or not self._waits():
            assert time.monotonic() < deadline
            self.listen()
            time.sleep(0.005)

    def _waits(self) -> bool:
        """Whether it sleeps, with nothing left to receive."""
        state = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        waiting = fcntl.ioctl(self.near.fileno(), termios.TIOCOUTQ, bytes(4))
        return state == "S" and waiting == bytes(4)

    def memory(self, place: int, size: int) -> bytes:
        """Bytes of the zygos_arm_t of the running node."""
        with Path(f"/proc/{self.process.pid}/mem").open("rb", buffering=0) as memory:
            memory.seek(self._arm() + place)
            return memory.read(size)

    def flip(self, place: int, bit: int) -> None:
        """An upset: one bit of the zygos_arm_t of the running node changes."""
        self._flip(self._arm() + place, bit)

    def flip_config(self, place: int, bit: int) -> None:
        """The same of its own copy of the configuration."""
        self._flip(self._variable("config") + place, bit)

    def _flip(self, address: int, bit: int) -> None:
        with Path(f"/proc/{self.process.pid}/mem").open("r+b", buffering=0) as memory:
            memory.seek(address)
            changed = memory.read(1)[0] ^ 1 << bit
            memory.seek(address)
            memory.write(bytes([changed]))

    def _arm(self) -> int:
        """Address of its zygos_arm_t."""
        return self._variable("arm") + int(ffi.offsetof("zygos_t", "state"))

    def _variable(self, name: str) -> int:
        """Address of a variable: where the program was loaded, and where in it that is."""
        maps = Path(f"/proc/{self.process.pid}/maps").read_text().splitlines()
        begin = next(int(line.split("-")[0], 16) for line in maps if line.endswith(str(NODE)))
        return begin + _symbol(name)

    def of(self, identifier: int) -> list[bytes]:
        """The data of all answers with an identifier."""
        return [data for sent, data in self.answers if sent == identifier]

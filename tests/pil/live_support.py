# SPDX-License-Identifier: MIT
"""A target that runs by itself: its serial line on a TCP port or a pseudo-terminal, its memory through QEMU."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import can

from pil.pil_support import Build, build_firmware, firmware
from zygos.native import flight as native
from zygos.native import header as compiled
from zygos.native.flight import Flight

_MOST = 65536
"""Calls that steps.c can hold."""
PATIENCE_S = 60.0
"""Longest that a test waits for a target."""
LINES = {
    "tcp": "socket,id=line,host=127.0.0.1,port=0,server=on,wait=off",
    "pty": "pty,id=line",
}
"""QEMU's character devices."""


@cache
def symbols(elf: Path) -> dict[str, tuple[int, int]]:
    """Address and size of each symbol of an image that has one."""
    text = subprocess.run(["arm-none-eabi-nm", "-S", str(elf)], capture_output=True, text=True, check=True).stdout
    found = re.findall(r"^([0-9a-f]+) ([0-9a-f]+) \w (\S+)$", text, re.M)
    return {name: (int(address, 16), int(size, 16)) for address, size, name in found}


@dataclass(frozen=True)
class Settled:
    """What firmware that has nothing more to do has come to: zygos_arm_t, whether each frame was stored, and how many
    frames each zygos_step() took."""

    state: bytes
    stored: tuple[bool, ...]
    taken: tuple[int, ...]


class Live:
    """Firmware of c/ports/cortex-m/live.c that is running."""

    def __init__(self, process: subprocess.Popen[str], elf: Path, folder: Path) -> None:
        self._process = process
        self._elf = elf
        self._folder = folder
        self._answer()  # a greeting
        self.ask("qmp_capabilities")
        device = next(one for one in self.ask("query-chardev") if one["label"] == "line")["filename"]
        port = re.search(r"tcp:127\.0\.0\.1:(\d+)", device)
        self.channel = f"socket://127.0.0.1:{port[1]}" if port else device.removeprefix("pty:")

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        while True:
            line = self._process.stdout.readline()
            assert line, "QEMU has ended"
            if line.startswith("{") and "event" not in (said := json.loads(line)):
                return said

    def ask(self, command: str, **arguments: Any) -> Any:
        """Have QEMU's monitor do something."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"execute": command, "arguments": arguments}) + "\n")
        self._process.stdin.flush()
        return self._answer()["return"]

    def memory(self, symbol: str) -> bytes:
        """What a variable of the firmware holds."""
        address, size = symbols(self._elf)[symbol]
        path = self._folder / "memory.bin"
        self.ask("pmemsave", val=address, size=size, filename=str(path))
        return path.read_bytes()

    def word(self, symbol: str, index: int = 0) -> int:
        """One of the 32-bit words of a variable; negative indices count from its end."""
        data = self.memory(symbol)
        return int(struct.unpack(f"<{len(data) // 4}I", data)[index])

    def lines(self) -> tuple[int, int]:
        """Frames that came and lines that were refused."""
        return self.word("line", -3), self.word("line", -2)

    def settle(self, lines: int) -> Settled:
        """Wait until so many frames and refused lines have come and the task has nothing more to do."""
        limit, before = time.monotonic() + PATIENCE_S, b""
        while time.monotonic() < limit:
            now = self.memory("arm") + self.memory("memory")  # the solver works in the latter
            if sum(self.lines()) >= lines and now == before:
                assert sum(self.lines()) == lines
                calls = self.memory("calls")
                frames, steps = struct.unpack_from("<2I", calls)
                assert max(frames, steps) <= _MOST
                taken = struct.unpack_from(f"<{steps}H", calls, 8)
                stored = calls[8 + 2 * _MOST : 8 + 2 * _MOST + frames]
                end = symbols(self._elf)["arm"][1]
                state = now[end - native.ffi.sizeof("zygos_arm_t") : end]  # the last member of zygos_t
                return Settled(state, tuple(map(bool, stored)), taken)
            before = now
            time.sleep(0.1)
        raise AssertionError(f"{self.lines()} frames and refused lines of {lines} came")

    def bus(self) -> can.BusABC:
        """Its CAN bus, opened by python-can."""
        return can.Bus(interface="slcan", channel=self.channel, sleep_after_open=0.0)


def compiled_in(folder: Path, flight: Flight) -> tuple[str, ...]:
    """Compiler options by which firmware finds an arm's configuration, `zygos compile-model`'s, in a folder."""
    header = folder / "arm_config.h"
    header.write_text(compiled.header(flight, "a test"))
    return ("-I", str(header.parent))


@contextmanager
def running(
    folder: Path,
    target: str,
    build: Build,
    flight: Flight,
    line: str = "tcp",
    drills: tuple[str, ...] = (),
) -> Iterator[Live]:
    """The firmware for an arm, until the context ends. The library in use must be that of the build."""
    elf = firmware(target, "live", build, compiled_in(folder, flight), ("steps", *drills))
    command = [*build_firmware.run(target, elf), "-chardev", LINES[line], "-serial", "chardev:line", "-qmp", "stdio"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield Live(process, elf, folder)
    finally:
        process.kill()
        process.communicate()


def lines_of(messages: Iterable[can.Message]) -> list[bytes]:
    """Frames in slcan's words, as python-can has them."""
    with can.Bus(interface="slcan", channel="loop://", sleep_after_open=0.0) as line:
        port: Any = line.serialPortOrig  # type: ignore[attr-defined]
        port.timeout = PATIENCE_S
        assert port.read_until(b"\r") == b"O\r"
        out = []
        for message in messages:
            line.send(message)
            out.append(bytes(port.read_until(b"\r")))
    return out


def parsed(text: bytes) -> can.Message:
    """The frame that python-can makes of a line."""
    with can.Bus(interface="slcan", channel="loop://", sleep_after_open=0.0) as line:
        port: Any = line.serialPortOrig  # type: ignore[attr-defined]
        port.write(text)
        message = line.recv(timeout=PATIENCE_S)
    assert message is not None
    return message

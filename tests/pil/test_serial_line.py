# SPDX-License-Identifier: MIT
"""The slcan parser and the UART's buffer on the host, under sanitizers: whatever comes on the line, and what the UART
of QEMU cannot do, which never loses a character."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path

import can
import numpy as np
import pytest

from pil.live_support import lines_of, parsed
from pil.pil_support import HERE, PORT, build_firmware

SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-Werror"]
LINES = 20_000
VALID = re.compile(
    rb"(?:(?P<id>[tr])(?P<standard>[0-7][0-9A-Fa-f]{2})|(?P<long>[TR])(?P<extended>[01][0-9A-Fa-f]{7}))"
    rb"(?P<length>[0-8])(?P<data>(?:[0-9A-Fa-f]{2})*)"
)
"""A frame, as the manual of slcan describes it; the data must be as long as it says, of a remote request empty."""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("host") / "serial_line"
    compiler = shlex.split(os.environ.get("CC", "cc"))
    sources = [HERE / "serial_line.c", PORT / "slcan.c", PORT / "uart.c", PORT.parent.parent / "loop" / "capacities.c"]
    flags = [*build_firmware.HOUSE, *SANITIZED, *build_firmware.INCLUDES]
    subprocess.run([*compiler, *flags, *map(str, sources), "-o", str(path)], check=True)
    return path


def said(program: Path, mode: str, text: bytes) -> bytes:
    done = subprocess.run([str(program), mode], input=text, capture_output=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


def answer(line: bytes) -> bytes:
    """What a line without its end is to be answered with while the channel is open, and its frame."""
    match = VALID.fullmatch(line)
    if match is None:
        known = {b"": b"\r", b"O": b"\r", b"V": b"V0002\r", b"N": b"NZYGO\r"}
        return known.get(line, b"\a")
    remote = line[:1] in b"rR"
    if len(match["data"]) != (0 if remote else 2 * int(match["length"])):
        return b"\a"
    return (b"z\r" if line[:1] in b"tr" else b"Z\r") + b">" + line[:1] + line[1:].upper() + b"\r"


def random_line(rng: np.random.Generator) -> bytes:
    """A frame, a frame with a mistake, a command, or noise."""
    kind = rng.choice(list("tTrR"))
    digits = 3 if kind in "tr" else 8
    length = int(rng.integers(0, 9))
    number = int(rng.integers(0, 2**11 if digits == 3 else 2**29))
    data = "" if kind in "rR" else rng.bytes(length).hex()
    line = f"{kind}{number:0{digits}{rng.choice(['x', 'X'])}}{length}{data}".encode()
    match rng.integers(0, 8):
        case 0:
            at = int(rng.integers(0, len(line)))
            return line[:at] + rng.bytes(1).replace(b"\r", b"x") + line[at + 1 :]
        case 1:
            return line[: rng.integers(0, len(line))]
        case 2:
            return line + rng.bytes(int(rng.integers(1, 400))).replace(b"\r", b"x")
        case 3:
            return bytes(rng.choice([b"", b"O", b"V", b"N", b"S5", b"Z1", b"L", b"X", b"OO", b"s0014", b"t", b"T"]))
        case 4:
            return rng.bytes(int(rng.integers(0, 40))).replace(b"\r", b"x").replace(b"C", b"x").replace(b"F", b"x")
        case _:
            return line


def test_any_line(program: Path) -> None:
    """Each has one answer; a frame comes back as it was written, and nothing else passes for one."""
    rng = np.random.default_rng(5)
    lines = [line for line in (random_line(rng) for _ in range(LINES)) if line not in (b"C", b"F")]
    found = said(program, "lines", b"O\r" + b"\r".join(lines) + b"\r")
    *_, numbers = found.splitlines()
    expected = [answer(line) for line in lines]
    frames, refused = sum(b">" in one for one in expected), expected.count(b"\a")
    assert min(frames, refused) > LINES / 5
    assert found == b"\r" + b"".join(expected) + f"\n{frames} {refused} 128\n".encode()
    assert numbers == f"{frames} {refused} 128".encode()


def test_python_can_agrees(program: Path) -> None:
    """Every kind of frame, in python-can's words, and back."""
    rng = np.random.default_rng(6)
    messages = []
    for _ in range(500):
        extended, remote = bool(rng.random() < 0.5), bool(rng.random() < 0.2)
        number, length = int(rng.integers(0, 2**29 if extended else 2**11)), int(rng.integers(0, 9))
        data = None if remote else rng.bytes(length)
        messages.append(
            can.Message(arbitration_id=number, is_extended_id=extended, is_remote_frame=remote, dlc=length, data=data)
        )
    lines = lines_of(messages)
    found = said(program, "lines", b"O\r" + b"".join(lines))
    assert re.findall(rb">([^\r]*\r)", found) == lines
    for message, line in zip(messages, lines, strict=True):
        assert parsed(line).equals(message, timestamp_delta=None, check_channel=False)


def test_a_full_buffer_leaves_out_whole_texts(program: Path) -> None:
    """Nobody waits for the line; what does not fit is left out and counted."""
    steps = ["s ab", "s c", "t", "t", "t", *["s " + "x" * 200] * 6, *["t"] * 1000, "s yz", "t", "t"]
    found = said(program, "uart", "\n".join(steps).encode()).decode().splitlines()
    sent = "".join(line[5:] for line in found if line.startswith("sent "))
    taken = [line for line in found if line in ("taken", "left out")]
    assert taken == ["taken"] * 2 + ["taken"] * 5 + ["left out"] + ["taken"]
    assert sent == "abc" + "x" * 1000 + "yz"
    assert found[-1] == "0 1"


def test_a_lost_character_is_counted(program: Path) -> None:
    found = said(program, "uart", b"c a\no\nc b\no\no\nc c").decode().splitlines()
    assert found == ["received a", "lost", "received b", "lost", "lost", "received c", "3 0"]

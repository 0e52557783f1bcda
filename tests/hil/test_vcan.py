# SPDX-License-Identifier: MIT
"""Frames through the kernel's own CAN code. Runs under tools/with-vcan; without an interface these tests fail."""

from __future__ import annotations

import socket
import subprocess
import time
from pathlib import Path

import can
import numpy as np
import pytest
from vcan_support import CHANNEL, listeners, wait_for_listeners

from zygos.can import vcan
from zygos.can.vcan import KernelCounts, kernel_counts, transfer
from zygos.errors import ZygosError


def random_frames(count: int, seed: int) -> list[can.Message]:
    """Classical frames of every length, standard and extended, some of them remote requests."""
    rng = np.random.default_rng(seed)
    frames = []
    for _ in range(count):
        extended = bool(rng.random() < 0.1)
        remote = bool(rng.random() < 0.05)
        length = int(rng.integers(0, 9))
        frames.append(
            can.Message(
                arbitration_id=int(rng.integers(0, 2**29 if extended else 2**11)),
                is_extended_id=extended,
                is_remote_frame=remote,
                dlc=length,
                data=None if remote else rng.bytes(length),
            )
        )
    return frames


def assert_same(came: list[can.Message], sent: list[can.Message]) -> None:
    assert len(came) == len(sent)
    for i, (one, other) in enumerate(zip(came, sent, strict=True)):
        assert one.equals(other, timestamp_delta=None, check_channel=False), f"frame {i}: {one} is not {other}"


def test_every_frame_comes_back_in_order_and_the_kernel_counted_it() -> None:
    sent = random_frames(10_000, seed=1)
    before = kernel_counts(CHANNEL)
    came = transfer(sent, CHANNEL)
    assert kernel_counts(CHANNEL) - before == KernelCounts(sent=len(sent), received=len(sent), dropped=0)
    assert_same(came, sent)


def test_candump_saw_the_same(tmp_path: Path) -> None:
    """can-utils is the third party: it shares no code with either end."""
    sent = random_frames(2_000, seed=2)
    log = tmp_path / "candump.log"
    before, already = kernel_counts(CHANNEL), listeners()
    with log.open("w", encoding="ascii") as file:
        candump = subprocess.Popen(["candump", "-L", "-r", "4000000", "-n", str(len(sent)), CHANNEL], stdout=file)
        try:
            wait_for_listeners(already + 1)
            transfer(sent, CHANNEL)
            assert candump.wait(timeout=20) == 0
        finally:
            candump.kill()
            candump.wait()
    assert (kernel_counts(CHANNEL) - before).sent == len(sent)
    with can.CanutilsLogReader(log) as reader:
        assert_same(list(reader), sent)


def test_a_lost_frame_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without flow control the socket's buffer overflows: the transfer must say so, not return less."""
    frames = random_frames(3_000, seed=3)
    read_frame = vcan.read_frame

    def slow(receiver: socket.socket) -> can.Message:
        time.sleep(0.001)
        return read_frame(receiver)

    monkeypatch.setattr(vcan, "WINDOW", len(frames))
    monkeypatch.setattr(vcan, "PATIENCE_S", 1.0)
    monkeypatch.setattr(vcan, "read_frame", slow)
    with pytest.raises(ZygosError, match="of 3000 frames came"):
        transfer(frames, CHANNEL)


def test_no_such_interface() -> None:
    with pytest.raises(ZygosError, match="no interface nothere0; remedy"):
        kernel_counts("nothere0")
    with pytest.raises(ZygosError, match="no interface nothere0; remedy"):
        transfer([], "nothere0")

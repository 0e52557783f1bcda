# SPDX-License-Identifier: MIT
"""A run through the in-process bus and every format of log: the same bits in the estimate."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from pathlib import Path

import can
import numpy as np
import pytest
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can import bus, vcan
from zygos.errors import ZygosError
from zygos.native.flight import FRAME, Flight, encode
from zygos.simulation.plant import Trajectory


def bits(arm: Arm, frames: NDArray[np.void]) -> bytes:
    flight = Flight(arm)
    flight.frames(frames)
    result = flight.estimate()
    assert result.validity == "valid"
    return result.value.tobytes() + result.sigma.tobytes() + result.covariance.tobytes()


@pytest.fixture(scope="module")
def frames(arm: Arm, noisy: Trajectory) -> NDArray[np.void]:
    return encode(arm, noisy.cycles(0))


@pytest.mark.slow
@pytest.mark.parametrize("suffix", bus.LOG_SUFFIXES)
def test_logs(arm: Arm, frames: NDArray[np.void], tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    bus.write_log(path, frames, arm.period_s)
    assert list(tmp_path.iterdir()) == [path]
    log = bus.read_log(path)
    assert log.damage == ()
    again = log.frames
    assert again.tobytes() == frames.tobytes()
    assert bits(arm, again) == bits(arm, frames)


def test_in_process_bus(arm: Arm, frames: NDArray[np.void]) -> None:
    arrived = bus.transferred(frames, arm.period_s, "virtual", "test_same_bits")
    assert bits(arm, arrived) == bits(arm, frames)


def stranger(number: int) -> can.Message:
    return can.Message(arbitration_id=0x500, data=number.to_bytes(8, "little"), is_extended_id=False)


@pytest.mark.slow
def test_frames_of_others_do_not_count_as_ours(arm: Arm, frames: NDArray[np.void]) -> None:
    over = threading.Event()

    def chatter() -> None:
        with bus.open_bus("virtual", "test_others") as other:
            for number in range(10**9):
                if over.is_set():
                    return
                other.send(stranger(number))
                time.sleep(1e-5)

    talker = threading.Thread(target=chatter)
    talker.start()
    try:
        arrived = bus.transferred(frames, arm.period_s, "virtual", "test_others")
    finally:
        over.set()
        talker.join()
    assert arrived.tobytes() == frames.tobytes()


@pytest.mark.parametrize("lost", [None, 700])
def test_frames_of_others_on_socketcan(
    lost: int | None, arm: Arm, frames: NDArray[np.void], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel's socket is played by a queue, which others write to as well; they go on when ours are through."""
    wire: queue.Queue[can.Message] = queue.Queue()

    class Sender(contextlib.nullcontext[None]):
        sent = 0

        def __init__(self, **_: object) -> None:
            super().__init__()

        def __enter__(self) -> Sender:  # type: ignore[override]
            return self

        def send(self, message: can.Message) -> None:
            wire.put(stranger(self.sent))
            if self.sent != lost:
                wire.put(message)
            self.sent += 1

    def read_frame(_: object) -> can.Message:
        try:
            return wire.get(timeout=0.01)
        except queue.Empty:
            return stranger(0)

    monkeypatch.setattr(vcan, "open_receiver", lambda _: contextlib.nullcontext())
    monkeypatch.setattr(vcan, "read_frame", read_frame)
    monkeypatch.setattr(vcan.can, "Bus", Sender)
    monkeypatch.setattr(vcan, "PATIENCE_S", 0.5)
    if lost is None:
        assert bus.transferred(frames, arm.period_s, "socketcan", "vcan0").tobytes() == frames.tobytes()
    else:
        with pytest.raises(ZygosError, match=f"{lost} of {len(frames)} frames came"):
            bus.transferred(frames, arm.period_s, "socketcan", "vcan0")


def test_order_within_a_cycle_is_free(arm: Arm, frames: NDArray[np.void]) -> None:
    shuffled = frames.copy()
    random = np.random.default_rng(0)
    starts = np.flatnonzero(frames["id"] == 0x080)
    for first, last in zip(starts[:-1] + 1, starts[1:], strict=True):
        shuffled[first:last] = shuffled[first + random.permutation(last - first)]
    assert shuffled.tobytes() != frames.tobytes()
    assert bits(arm, shuffled) == bits(arm, frames)


def test_foreign_frames_change_nothing(arm: Arm, frames: NDArray[np.void]) -> None:
    random = np.random.default_rng(1)
    foreign = np.zeros(len(frames), dtype=FRAME)
    foreign["id"] = random.integers(0x400, 0x700, len(frames))
    foreign["length"] = random.integers(0, 9, len(frames))
    foreign["data"] = random.integers(0, 256, (len(frames), 8))
    mixed = np.stack([frames, foreign], axis=1).ravel()
    assert bits(arm, mixed) == bits(arm, frames)


@pytest.mark.parametrize(("name", "content"), [("run.csv", "a,b"), ("run.blf", "not a blf"), ("run.log", "")])
def test_logs_that_are_none(tmp_path: Path, name: str, content: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ZygosError, match="remedy"):
        bus.read_log(path)


def test_missing_log(tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match="no such file"):
        bus.read_log(tmp_path / "none.blf")

"""The node as a process: killed, resumed, kept from running, at its true pace, beside a babbling node."""

from __future__ import annotations

import subprocess
import time

import numpy as np
import pytest

from zygos.testing import Dut, Plant
from zygos.testing.stream import SYNC, Stream
from zygos.vcan import kernel_counts

FULL_BUS = 9_009
"""Frames a second that a classical bus at 1 Mbit/s carries at most: of eight bytes, without stuffing."""


def test_real_pace(plant: Plant, dut: Dut) -> None:
    """Ten seconds as they pass; the node's heart beats every second."""
    stream = plant.run(200)
    dut.start()
    sent = plant.send(stream, "real")
    assert 0.0 <= sent.seconds - stream.due_s()[-1] < 5.0
    dut.settle()
    beats = [message.data[0] for message in dut.heartbeats()]
    assert beats.count(5) >= 7  # operational
    dut.judge(stream)


def test_ended_and_resumed(plant: Plant, dut: Dut) -> None:
    """What it knows survives an end in order; 20 cycles pass before it is there again.

    The cycle that is open when it ends is lost; then the counter skips.
    """
    stream = plant.run(400)
    first, second = stream.part(0, 180), stream.part(200)
    dut.start()
    plant.send(first)
    dut.stop()
    dut.start()
    plant.send(second)
    dut.judge(first, second, incomplete=1, dropped=1, sync_jumped=1)


def test_killed_and_resumed(plant: Plant, dut: Dut) -> None:
    """Lost is what came after the last save, and nothing else."""
    stream = plant.run(500)
    first, lost, second = stream.part(0, 180), stream.part(180, 240), stream.part(250)
    dut.start()
    plant.send(first)
    dut.stop()
    saved = dut.state.read_bytes()
    dut.start()
    plant.send(lost)
    dut.kill()
    assert dut.state.read_bytes() == saved
    dut.start()
    plant.send(second)
    dut.judge(first, second, incomplete=1, dropped=1, sync_jumped=1)


def test_killed_without_a_state(plant: Plant, dut: Dut) -> None:
    stream = plant.run(400)
    dut.start()
    plant.send(stream.part(0, 100))
    dut.kill()
    assert not dut.state.exists()
    dut.start()
    plant.send(stream.part(100))
    dut.judge(stream.part(100))


def stuffed(stream: Stream) -> Stream:
    """Behind each SYNC 250 frames that the device has to read, and to reject for their length."""
    at = np.repeat(np.flatnonzero(stream.frames["id"] == SYNC) + 1, 250)
    empty = np.zeros(len(at), dtype=stream.frames.dtype)
    empty["id"] = 0x180 + stream.arm.joints[0].node
    return Stream(
        stream.arm, np.insert(stream.frames, at, empty), np.insert(stream.cycle, at, stream.cycle[at - 1])
    )


def test_receive_buffer_overflow(plant: Plant, dut: Dut) -> None:
    """The device stands still for 100 cycles: its socket keeps the first frames of them, the kernel counts the rest."""
    stream = plant.run(400)
    first, flood, rest = stream.part(0, 100), stream.part(100, 200).through(stuffed), stream.part(200)
    dut.start()
    plant.send(first)
    with dut.paused():
        plant.send(flood, "flood")
    dut.settle()
    plant.send(rest)
    lost = dut.stop()["node_overflow"]
    assert 0 < lost < len(flood)
    kept = Stream(plant.arm, flood.frames[: len(flood) - lost], flood.cycle[: len(flood) - lost])
    broken = int(kept.cycle[-1] == flood.cycle[len(kept)])  # unless the buffer was full just before a SYNC
    rejected = int(np.sum(kept.frames["length"] == 0))
    assert rejected > 100
    dut.judge(first + kept + rest, length=rejected, incomplete=broken, dropped=broken, sync_jumped=1)


@pytest.mark.parametrize("who", ["extended", "ours by name"])
def test_babbling_node_at_full_load(who: str, plant: Plant, dut: Dut) -> None:
    """cangen sends as fast as it can: extended frames, or remote ones that bear the identifier of joint 1."""
    stream = plant.run(600)
    dut.start()
    how = ["-e", "-I", "r"] if who == "extended" else ["-R", "-I", "181"]
    before, began = kernel_counts(plant.channel), time.monotonic()
    babbler = subprocess.Popen(["cangen", plant.channel, "-g", "0", "-i", *how])
    try:
        plant.send(stream)
    finally:
        babbler.kill()
        babbler.wait()
    sent, took = (kernel_counts(plant.channel) - before).sent, time.monotonic() - began
    assert sent / took > FULL_BUS
    dut.judge(stream)

# SPDX-License-Identifier: MIT
"""The node as a process: killed, resumed, kept from running, at its true pace, beside a babbling node."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from conftest import need
from zygos.can.vcan import kernel_counts
from zygos.native import snapshot
from zygos.native.flight import Flight, ffi
from zygos.testing import Dut, Plant
from zygos.testing.stream import SYNC, Stream

LEAST_LOAD = 10.0
"""Frames on the loaded bus, as a multiple of those of the arm: how many more there are depends on the machine."""
OPERATIONAL = 5


def test_real_pace_beside_a_babbling_node(plant: Plant, dut: Dut) -> None:
    """Twelve seconds as they pass, while cangen loads the bus as fast as this machine can: with extended frames of any
    identifier, and with remote ones that bear that of joint 1's angles. The device's heart beats every second."""
    stream = plant.run(240)
    dut.start()
    before = kernel_counts(plant.channel)
    cangen = ["cangen", plant.channel, "-g", "0", "-i"]
    babblers = [subprocess.Popen([*cangen, "-e", "-I", "r"]), subprocess.Popen([*cangen, "-R", "-I", "181"])]
    try:
        sent = plant.send(stream, "real")
    finally:
        for babbler in babblers:
            babbler.kill()
            babbler.wait()
    assert dut.external or (kernel_counts(plant.channel) - before).sent > LEAST_LOAD * len(stream)
    assert 0.0 <= sent.seconds - stream.due_s()[-1] < 5.0
    dut.settle()
    assert [message.data[0] for message in dut.heartbeats()].count(OPERATIONAL) >= 9
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
    return Stream(stream.arm, np.insert(stream.frames, at, empty), np.insert(stream.cycle, at, stream.cycle[at - 1]))


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


@pytest.fixture
def own_interface() -> Iterator[str]:
    """An interface that nobody else uses, and may be taken away."""
    name = f"vcan{os.getpid() % 10_000}"
    made = subprocess.run(["ip", "link", "add", name, "type", "vcan"], capture_output=True, check=False)
    need(made.returncode == 0, "the right to make an interface")
    subprocess.run(["ip", "link", "set", name, "up"], check=True)
    yield name
    subprocess.run(["ip", "link", "del", name], capture_output=True, check=False)


def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_the_interface_goes_down_and_away_and_comes_back(own_interface: str, plant: Plant, dut: Dut) -> None:
    """As an adapter that is unplugged and plugged in again: the node waits, and goes on with what it knows."""
    dut.own("its interface is not ours to remove")
    blob, said, out = dut.folder / "own.zyg", dut.folder / "own.stderr", dut.folder / "own.stdout"
    flight = Flight(plant.arm)
    snapshot.write(blob, "configuration", ffi.addressof(flight.native, "sums", "config"))
    with said.open("wb") as errors, out.open("wb") as output:
        node = subprocess.Popen(
            [Path(dut.command).resolve(), "-i", own_interface, "--config", blob], stdout=output, stderr=errors
        )
    try:
        until(lambda: b"listening" in said.read_bytes())

        def heart_beats_after_syncs(begin: int) -> None:
            with can.Bus(own_interface, "socketcan") as bus:
                for k in range(10):
                    bus.send(can.Message(arbitration_id=SYNC, data=[begin + k], is_extended_id=False))
                until(lambda: (message := bus.recv(1.0)) and message.data == bytes([OPERATIONAL]))

        heart_beats_after_syncs(1)
        for state in ("down", "up"):
            subprocess.run(["ip", "link", "set", own_interface, state], check=True)
        heart_beats_after_syncs(11)
        subprocess.run(["ip", "link", "del", own_interface], check=True)
        until(lambda: f"{own_interface}: was removed".encode() in said.read_bytes())
        subprocess.run(["ip", "link", "add", own_interface, "type", "vcan"], check=True)
        subprocess.run(["ip", "link", "set", own_interface, "up"], check=True)
        until(lambda: f"{own_interface}: is back".encode() in said.read_bytes())
        heart_beats_after_syncs(21)
        node.send_signal(signal.SIGTERM)
        assert node.wait(30.0) == 0
    finally:
        node.kill()
        node.wait()
    assert said.read_text().count("\n") == 3  # it listens, removed, back
    counters = dict(line.split() for line in out.read_text().splitlines())
    assert counters["fault_sync_jumped"] == "0"
    assert 2 <= int(counters["node_down"]) <= 4  # a removal may show as going down, too, and so may the return

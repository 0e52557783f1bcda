# SPDX-License-Identifier: MIT
"""The whole example across an AF_CAN socket: the kernel counts its frames, and the estimate has the same bits."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from vcan_support import CHANNEL, listeners, wait_for_listeners

from conftest import PAPER
from zygos.arm import Arm
from zygos.can import bus, vcan
from zygos.demo.demonstration import choose_bus
from zygos.model.model import Model, load_model
from zygos.native.flight import Flight, encode
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import Scenario


@pytest.fixture(scope="module")
def frames(arm: Arm, model: Model, scenario: Scenario) -> NDArray[np.void]:
    return encode(arm, simulate(arm, model, scenario).cycles())


def bits(arm: Arm, frames: NDArray[np.void]) -> bytes:
    flight = Flight(arm)
    flight.frames(frames)
    result = flight.estimate()
    assert result.validity == "valid"
    assert sum(flight.faults.values()) == 0
    return result.value.tobytes() + result.sigma.tobytes() + result.covariance.tobytes()


def test_same_bits_from_vcan_from_logs_and_in_process(arm: Arm, frames: NDArray[np.void], tmp_path: Path) -> None:
    before = vcan.kernel_counts(CHANNEL)
    arrived = bus.transferred(frames, arm.period_s, "socketcan", CHANNEL)
    assert vcan.kernel_counts(CHANNEL) - before == vcan.KernelCounts(len(frames), len(frames), 0)
    expected = bits(arm, frames)
    assert bits(arm, arrived) == expected
    assert bits(arm, bus.transferred(frames, arm.period_s, "virtual", "hil")) == expected
    for name in ("run.blf", "run.log"):
        bus.write_log(tmp_path / name, arrived, arm.period_s)
        assert bits(arm, bus.read_log(tmp_path / name).frames) == expected


def test_the_demo_takes_vcan_where_there_is_one() -> None:
    assert choose_bus() == ("socketcan", CHANNEL)


def test_listen(arm: Arm, frames: NDArray[np.void], tmp_path: Path) -> None:
    """A second process listens while the first one sends, a little faster than life."""
    already = listeners()
    out = tmp_path / "live.toml"
    command = [sys.executable, "-m", "zygos.cli", "listen", "-i", "socketcan", "-c", CHANNEL, "--idle", "2"]
    listener = subprocess.Popen([*command, "--arm", str(PAPER / "arm.toml"), "-o", str(out)])
    try:
        wait_for_listeners(already + 1)
        with bus.open_bus("socketcan", CHANNEL) as sender:
            for k, message in enumerate(bus.to_messages(frames, arm.period_s)):
                sender.send(message)
                if k % 50 == 49:
                    time.sleep(0.04)
        assert listener.wait(timeout=60) == 0
    finally:
        listener.kill()
        listener.wait()
    flight = Flight(arm)
    flight.frames(frames)
    assert np.array_equal(load_model(out).base_values(arm), flight.estimate().value)

# SPDX-License-Identifier: MIT
"""The loop closed over a real bus: what `make loop` does beside a pair of sockets, with the kernel's CAN and candump.

A MuJoCo plant recorded the frames with a hidden effect (`oracles.demo_log`); they are sent as fast as the node answers.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vcan_support import GUEST, candump

from conftest import ROOT
from zygos.arm import load_arm
from zygos.can import bus
from zygos.demo.loop import EVERY, GAP, close_loop, errors
from zygos.simulation.scenario import load_scenario
from zygos.testing import Dut, Plant
from zygos.testing.stream import Stream

CYCLES = 6000
"""Of each run: 30 s."""
BAND = 2.5
"""Largest ratio of the factor that was promised to that of the next run, either way: how much a wrong model mispredicts
depends on the motion."""


@pytest.mark.skipif(
    GUEST and not os.environ.get("ZYGOS_HIL_LOOP"),
    reason="explaining two runs takes ten minutes in a User-Mode Linux guest; remedy: ZYGOS_HIL_LOOP=1 (docs/hil.md)",
)
@pytest.mark.timeout(1500)
def test_what_was_explained_from_the_bus_flies_on_it(
    plant: Plant, dut: Dut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five flights of one node after the other: three with the simulation's model, which lacks the friction of the
    elbow's motor, one with the model that was explained from their captures, and the same motion with the old one."""
    dut.own("the loop compiles the configuration of its own")
    monkeypatch.chdir(ROOT)
    arm = load_arm(GAP / "arm.toml")
    sender = replace(plant, scenario=load_scenario(GAP / "d.toml"))
    flights: list[tuple[Path, NDArray[Any]]] = []

    def fly(config: Path, frames: NDArray[Any], log: Path) -> None:
        said = tmp_path / "stderr"
        with candump(plant.channel, log), said.open("wb") as err:
            node = subprocess.Popen(
                [Path(dut.command).resolve(), "-i", plant.channel, "--config", config, "--every", str(EVERY)],
                stdout=subprocess.PIPE,
                stderr=err,
                text=True,
            )
            try:
                while b"listening on" not in said.read_bytes():
                    assert node.poll() is None, said.read_text()
                    time.sleep(0.01)
                sender.send(Stream.recorded(arm, frames))
                node.send_signal(signal.SIGTERM)
                out = node.communicate(timeout=60)[0]
            finally:
                node.kill()
                node.wait()
        assert node.returncode == 0
        counters = dict(line.split() for line in out.splitlines())
        assert {
            name for name, count in counters.items() if name.startswith(("fault_", "node_")) and int(count)
        } == set()
        flights.append((log, frames))

    content = close_loop(tmp_path / "loop", fly, cycles=CYCLES).content

    assert len(flights) == 5
    for log, frames in flights:
        heard = bus.read_log(log).frames
        assert np.array_equal(heard[~np.isin(heard["id"], [0x1A0, 0x720])], frames)

    assert content["named"] == content["hidden"]
    promised, flown = content["promised"], content["flown"]
    assert promised["shrinks"] > 10.0
    assert promised["shrinks"] / BAND < flown["shrinks"] < promised["shrinks"] * BAND
    assert flown["closed"] < 1.5 * flown["floor"]

    before, after = np.abs(errors(content, "before")), np.abs(errors(content, "after"))
    assert np.max(before) > 0.02
    assert np.max(after) < 0.001
    inside = [abs(p["after"]["value"] - p["true"]) <= p["after"]["half95"] for p in content["parameters"]]
    assert np.count_nonzero(inside) >= len(inside) - 1
    (effect,) = content["effects"]
    assert abs(effect["value"] - effect["explained"]) <= effect["half95"]
    assert effect["significance"] > 100.0

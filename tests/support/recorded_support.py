# SPDX-License-Identifier: MIT
"""Fixtures that tests of commands and of the node share: a recorded run of the example, and its frames.

A module asks for them with pytest_plugins = ["recorded_support"], and does not import this one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run
from node_support import SYNC, compiled
from numpy.typing import NDArray

from conftest import EXAMPLE
from zygos.arm import Arm
from zygos.can import bus
from zygos.native.flight import encode
from zygos.simulation.plant import Trajectory

Log = NDArray[Any]
BRIEF = 400
"""Cycles of the brief recording: enough for a valid estimate."""


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 60 s with noise, in a folder with its arm file. Nobody writes into this folder."""
    path = tmp_path_factory.mktemp("recording") / "run.blf"
    assert run("simulate", EXAMPLE / "scenario.toml", "-o", path, "--seed", 3) == 0
    return path


@pytest.fixture(scope="session")
def brief_recording(recording: Path, arm: Arm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first 20 s of that run, in a folder with the arm file. Nobody writes into this folder."""
    path = tmp_path_factory.mktemp("brief") / "run.blf"
    frames = bus.read_log(recording).frames
    bus.write_log(path, frames[: np.flatnonzero(frames["id"] == SYNC)[BRIEF] + 1], arm.period_s)
    path.with_name("arm.toml").write_bytes(recording.with_name("arm.toml").read_bytes())
    return path


@pytest.fixture(scope="session")
def frames(noisy: Trajectory, arm: Arm) -> Log:
    """A run of 60 s with noise, in memory."""
    return encode(arm, noisy.cycles(0))


@pytest.fixture(scope="session")
def syncs(frames: Log) -> NDArray[np.int64]:
    """Where the SYNCs are in `frames`."""
    return np.flatnonzero(frames["id"] == SYNC)


@pytest.fixture(scope="session")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's arm as the node takes it."""
    return compiled(tmp_path_factory.mktemp("onboard"))

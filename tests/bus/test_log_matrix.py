# SPDX-License-Identifier: MIT
"""One recording in every format gives one estimate, whatever its stamps, its direction, and lines made for CAN FD."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dialect_support import FORMATS, write_dialect
from numpy.typing import NDArray

from conftest import EXAMPLE
from zygos.arm import Arm
from zygos.can import bus
from zygos.can.run import load_run
from zygos.can.wire import FD
from zygos.errors import ZygosError
from zygos.estimation.estimate import estimate
from zygos.native.flight import encode
from zygos.runs.span import reading
from zygos.simulation.plant import Trajectory

Log = NDArray[Any]
CYCLES = 60
CUT_S = (0.975, 2.025)
"""Between two cycles."""
MATRIX = [
    (name, stamps, tx)
    for name, kind in FORMATS.items()
    for stamps, tx in product(kind.stamps, (False, True) if kind.directions else (False,))
]


@pytest.fixture(scope="module")
def frames(arm: Arm, noisy: Trajectory) -> Log:
    whole = encode(arm, noisy.cycles(0))
    return whole[: np.flatnonzero(whole["id"] == 0x080)[CYCLES] + 1]


@pytest.fixture(scope="module")
def times(arm: Arm, frames: Log) -> list[float]:
    """Of each frame, s; a slcan adapter tells 1 ms apart."""
    cycle = np.cumsum(frames["id"] == 0x080) - 1
    first = np.maximum.accumulate(np.where(frames["id"] == 0x080, np.arange(len(frames)), 0))
    found: list[float] = (cycle * arm.period_s + 1e-3 * (np.arange(len(frames)) - first)).tolist()
    return found


@pytest.mark.slow(only=["candump -L-from zero-False"])
@pytest.mark.parametrize(("name", "stamps", "tx"), MATRIX)
def test_frames_and_times(name: str, stamps: str, tx: bool, frames: Log, times: list[float], tmp_path: Path) -> None:
    """Bit for bit, which makes the estimate the same; and the same part of it where only a part is read."""
    path = write_dialect(tmp_path, name, frames, times, stamps=stamps, tx=tx)
    log = bus.read_log(path)
    assert (log.damage, log.remarks) == ((), ())
    np.testing.assert_array_equal(log.frames, frames)
    if stamps == "none":
        with reading(*CUT_S), pytest.raises(ZygosError, match="no times at which it could be cut; remedy"):
            bus.read_log(path)
        return
    found = [message.timestamp for message in bus.read_messages(path, [])]
    # errors of rounded differences add up
    tolerance_s = 2.0 * FORMATS[name].step_s * len(times) ** 0.5
    assert np.max(np.abs(np.subtract(found, found[0]) - times)) < tolerance_s
    with reading(*CUT_S):
        part = bus.read_log(path).frames
    inside = [CUT_S[0] <= time < CUT_S[1] for time in times]
    np.testing.assert_array_equal(part, frames[inside])


def test_stamps_of_slcan_start_again_every_minute(frames: Log, times: list[float], tmp_path: Path) -> None:
    late = [40.0 * time for time in times]
    path = write_dialect(tmp_path, "slcan", frames, late, stamps="from zero")
    found = [message.timestamp for message in bus.read_messages(path, [])]
    assert np.max(np.abs(np.subtract(found, late))) < 1e-3
    assert late[-1] == pytest.approx(120.0)


@pytest.mark.parametrize("name", [name for name, kind in FORMATS.items() if kind.fd])
def test_frames_of_can_fd(name: str, arm: Arm, frames: Log, times: list[float], tmp_path: Path) -> None:
    """Whatever their stamps and direction, they are marked, count as rejected, and the message says what they are."""
    for stamps, tx in [(stamps, tx) for own, stamps, tx in MATRIX if own == name]:
        path = write_dialect(tmp_path, name, frames, times, stamps=stamps, tx=tx, fd=True)
        log = bus.read_log(path)
        assert log.damage == ()
        assert set(log.frames["flags"].tolist()) == {FD}
        assert log.frames["id"].tolist() == frames["id"].tolist()
    run = load_run(path, arm)
    found = estimate(run)
    assert found.watch.flight.fd_frames == len(frames)
    with pytest.raises(ZygosError, match=r"only frames of CAN FD came.*; remedy: [0-9]+ frames of this arm are CAN FD"):
        run.check_cycles()


@pytest.mark.slow
def test_one_estimate(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    """Of a run that is long enough, from two formats that share nothing but their frames."""
    whole = encode(arm, noisy.cycles(0))[:4000]
    stamps = [0.01 * k for k in range(len(whole))]
    answers = []
    for name, kind in (("asc, CANFD lines", "negative"), ("BUSMASTER", "relative")):
        path = write_dialect(tmp_path, name, whole, stamps, stamps=kind, tx=True)
        answers.append(estimate(load_run(path, EXAMPLE / "arm.toml")).result)
    assert answers[0].validity == "valid"
    np.testing.assert_array_equal(answers[0].value, answers[1].value)
    np.testing.assert_array_equal(answers[0].covariance, answers[1].covariance)

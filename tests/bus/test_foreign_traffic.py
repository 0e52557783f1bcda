# SPDX-License-Identifier: MIT
"""Traffic of a road vehicle on the arm's bus: without effect, and refused where it bears the arm's identifiers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run as zygos
from numpy.typing import NDArray
from runs_support import trajectory_of

from conftest import EXAMPLE, ROOT, need
from zygos.arm import Arm
from zygos.can import bus
from zygos.can.wire import identifiers
from zygos.estimation.remedies import NO_FRAMES
from zygos.model.model import Model
from zygos.native.flight import Flight, encode, ffi, lib
from zygos.runs.cycles import BREAK_BEFORE, Cycles
from zygos.simulation.scenario import Scenario

Log = NDArray[Any]

LOG = Path(ROOT).parent / "shared" / "data" / "foreign-can" / "savvycan-candump.log"
SYNC = 0x080
ACCEPTED, REJECTED = 1, 2


@pytest.fixture(scope="module")
def strangers() -> Log:
    need(LOG.is_file(), f"the recorded traffic of a road vehicle, {LOG.name}")
    frames = bus.read_log(LOG).frames
    assert (len(frames), len(np.unique(frames["id"]))) == (12_974, 180)
    return frames


@pytest.fixture(scope="module")
def ours(arm: Arm, model: Model, scenario: Scenario) -> Log:
    return encode(arm, trajectory_of(arm, model, scenario, seeds=[0], noise=True).cycles(0))


class Run:
    """Frames through the flight library. stranger: (n,) which of the frames are not of the arm."""

    def __init__(self, arm: Arm, frames: Log, stranger: NDArray[np.bool_]) -> None:
        self.flight = Flight(arm)
        frames = np.ascontiguousarray(frames)
        verdicts = np.zeros(len(frames), dtype=np.uint8)
        pointers = ffi.cast("zygos_frame_t *", frames.ctypes.data), ffi.cast("uint8_t *", verdicts.ctypes.data)
        lib.zygos_batch_frames(self.flight.native, pointers[0], len(frames), pointers[1], ffi.NULL)
        self.verdicts = verdicts[stranger]
        self.faults = {name: count for name, count in self.flight.faults.items() if count}
        trace = Flight(arm).frames(frames, trace=True)
        assert trace is not None
        self.cycles: Cycles = trace.cycles

    def bits(self) -> bytes:
        """Of all that an estimate says."""
        estimate = self.flight.estimate()
        numbers = estimate.value.tobytes() + estimate.sigma.tobytes() + estimate.covariance.tobytes()
        return numbers + repr(replace(estimate, value=None, sigma=None, covariance=None)).encode()


def mixed(ours: Log, strangers: Log, seed: int) -> tuple[Log, NDArray[np.bool_]]:
    """Both logs in their own order, interleaved at random; and which frames are the strangers'."""
    stranger = np.zeros(len(ours) + len(strangers), dtype=np.bool_)
    stranger[np.random.default_rng(seed).choice(len(stranger), len(strangers), replace=False)] = True
    frames = np.zeros(len(stranger), dtype=ours.dtype)
    frames[stranger], frames[~stranger] = strangers, ours
    return frames, stranger


@pytest.fixture(scope="module")
def alone(arm: Arm, ours: Log) -> Run:
    run = Run(arm, ours, np.zeros(len(ours), dtype=np.bool_))
    assert run.faults == {}
    assert run.flight.estimate().validity == "valid"
    return run


@pytest.mark.slow
def test_foreign_traffic_changes_no_bit(arm: Arm, ours: Log, strangers: Log, alone: Run) -> None:
    assert not set(np.unique(strangers["id"])) & set(identifiers(arm))
    for seed in range(3):
        run = Run(arm, *mixed(ours, strangers, seed))
        assert set(run.verdicts) == {0}
        assert run.faults == {}
        assert run.bits() == alone.bits()


def renamed(strangers: Log, arm: Arm, seed: int, takes: list[int]) -> tuple[Log, NDArray[np.bool_]]:
    """20 of the log's identifiers become ours, those of `takes` in turn; and which frames that are."""
    found = np.random.default_rng(seed).choice(np.unique(strangers["id"]), 20, replace=False)
    out = strangers.copy()
    for i, identifier in enumerate(found):
        out["id"][strangers["id"] == identifier] = takes[i % len(takes)]
    return out, np.isin(strangers["id"], found)


@pytest.mark.parametrize("seed", range(8))
def test_what_bears_our_identifiers_is_refused_and_counted(
    arm: Arm, ours: Log, strangers: Log, alone: Run, seed: int
) -> None:
    takes = [identifier for identifier in identifiers(arm) if identifier != SYNC]
    impostors, ours_by_name = renamed(strangers, arm, seed, takes)
    run = Run(arm, *mixed(ours, impostors, seed))
    assert np.sum(ours_by_name) > 100
    assert set(run.verdicts[ours_by_name]) == {REJECTED}
    assert set(run.verdicts[~ours_by_name]) == {0}
    spoilt = run.faults.pop("dropped", 0)
    run.faults.pop("incomplete", 0)
    assert sum(run.faults.values()) == np.sum(ours_by_name)
    # A frame that passes the CRC and the counter by chance, and then says that it is invalid, costs its cycle.
    assert spoilt <= len(strangers) / (256 * 16)
    if spoilt == 0:
        assert run.bits() == alone.bits()


def with_syncs(ours: Log, strangers: Log, seed: int, every: int) -> tuple[Log, NDArray[np.bool_], NDArray[np.bool_]]:
    """20 identifiers become SYNC, all those of one-byte frames among them; of the latter every n-th frame only.

    Returns the mixed log, which of its frames are the strangers', and which of the strangers' are called SYNC.
    """
    one_byte = strangers["length"] == 1
    short = np.unique(strangers["id"][one_byte])
    others = np.setdiff1d(np.unique(strangers["id"]), short)
    others = np.random.default_rng(seed).choice(others, 20 - len(short), replace=False)
    called = np.isin(strangers["id"], np.concatenate([short, others]))
    called &= ~one_byte | (np.cumsum(one_byte) % every == 0)
    impostors = strangers.copy()
    impostors["id"][called] = SYNC
    return *mixed(ours, impostors, seed), called


@pytest.mark.parametrize("every", [1, 40])
@pytest.mark.parametrize("seed", range(4))
def test_spurious_syncs_end_the_arc_and_do_no_other_harm(
    arm: Arm, ours: Log, strangers: Log, alone: Run, seed: int, every: int
) -> None:
    """No value is false, and no arc goes on across a spurious SYNC."""
    frames, stranger, called = with_syncs(ours, strangers, seed, every)
    run = Run(arm, frames, stranger)
    counter = strangers["data"][:, 0]
    possible = called & (strangers["length"] == 1) & (counter >= 1) & (counter <= 240)
    assert set(run.verdicts[called & ~possible]) == {REJECTED}
    assert set(run.verdicts[~called]) == {0}
    assert run.faults["length"] == np.sum(called & (strangers["length"] != 1))
    assert run.faults["range"] == np.sum(called & (strangers["length"] == 1) & ~possible)
    spurious = int(np.sum(run.verdicts[possible] == ACCEPTED))
    assert spurious >= (50 if every == 1 else 1)
    assert spurious <= run.faults["sync_jumped"] <= 2 * spurious

    # Every cycle that is used is one of the run as it was, and neighbours are neighbours of that run.
    values = np.hstack([alone.cycles.q, alone.cycles.theta, alone.cycles.tau, alone.cycles.omega])
    number = {row.tobytes(): i for i, row in enumerate(values)}
    got = np.hstack([run.cycles.q, run.cycles.theta, run.cycles.tau, run.cycles.omega])
    origin = np.array([number[row.tobytes()] for row in got])
    assert len(values) - 2 * int(np.sum(possible)) <= len(origin) <= len(values)
    joined = (np.diff(run.cycles.sync.astype(np.int64)) == 1) & ((run.cycles.flags[1:] & BREAK_BEFORE) == 0)
    assert np.sum(~joined) >= (20 if every == 1 else 1)
    np.testing.assert_array_equal(np.diff(origin)[joined], 1)
    # Few of them leave an estimate, and the same one to within its spread.
    if every == 1:
        return
    estimate, expected = run.flight.estimate(), alone.flight.estimate()
    assert estimate.arcs >= 2
    assert estimate.validity in ("partial", "valid")
    known = np.isfinite(estimate.value)
    assert np.all(np.abs(estimate.value - expected.value)[known] < 6.0 * estimate.sigma[known])


@pytest.mark.parametrize("seed", range(4))
def test_all_of_our_identifiers_at_once(arm: Arm, ours: Log, strangers: Log, seed: int) -> None:
    """SYNC among them: every impostor is rejected and counted but for what passes as a SYNC, and that ends arcs."""
    impostors, named = renamed(strangers, arm, seed, list(identifiers(arm)))
    run = Run(arm, *mixed(ours, impostors, seed))
    counter = impostors["data"][:, 0]
    sync = named & (impostors["id"] == SYNC) & (impostors["length"] == 1) & (counter >= 1) & (counter <= 240)
    assert np.sum(named & (impostors["id"] == SYNC)) > 10
    assert set(run.verdicts[named & ~sync]) == {REJECTED}
    assert set(run.verdicts[~named]) == {0}
    rejected = sum(count for name, count in run.faults.items() if name not in NO_FRAMES)
    assert rejected >= np.sum(named & ~sync)
    assert run.faults.get("sync_jumped", 0) >= np.sum(run.verdicts[sync] == ACCEPTED)


def estimated(path: Path, folder: Path) -> dict[str, Any]:
    """What `zygos estimate` says of a log of the example's arm, but for the log's name."""
    arguments = [
        "estimate",
        "--energy",
        path,
        "--arm",
        EXAMPLE / "arm.toml",
        "-o",
        folder / "m.toml",
        "--json",
        folder / "m.json",
    ]
    assert zygos(*arguments) == 0
    answer: dict[str, Any] = json.loads((folder / "m.json").read_text())
    assert answer.pop("run") == str(path)
    return answer


@pytest.mark.slow
def test_on_the_command_line(arm: Arm, ours: Log, strangers: Log, tmp_path: Path) -> None:
    """The same from our frames alone, among strangers, and but for the fault counters among impostors."""
    path = tmp_path / "run.log"
    bus.write_log(path, ours, arm.period_s)
    alone = estimated(path, tmp_path)
    assert set(alone["faults"].values()) == {0}
    strangers = strangers[::4]
    bus.write_log(path, mixed(ours, strangers, 0)[0], arm.period_s)
    assert estimated(path, tmp_path) == alone
    impostors, named = renamed(strangers, arm, 0, [identifier for identifier in identifiers(arm) if identifier != SYNC])
    bus.write_log(path, mixed(ours, impostors, 0)[0], arm.period_s)
    answer = estimated(path, tmp_path)
    faults = answer.pop("faults")
    assert sum(faults.values()) == np.sum(named)
    assert faults["crc"] > 0 and faults["length"] > 0
    del alone["faults"]
    assert answer == alone

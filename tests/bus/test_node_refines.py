"""zygos-node --refine: what it tells of the refinement is what the library through cffi says."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from node_support import Node
from numpy.typing import NDArray
from round_support import round_of, told

from conftest import EXAMPLE
from zygos.arm import Arm, save_arm
from zygos.can.dbc import arm_database
from zygos.cli import main
from zygos.model.model import Model
from zygos.native.flight import CHANNELS, Flight, encode, ffi, lib
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import Scenario

SYNC, FTIME, TELEMETRY = 0x080, 0x3A0, 0x1A0
EVERY = 100
Log = NDArray[Any]
Round = dict[str, float]


def compiled(arm_file: Path, folder: Path, *more: object) -> Path:
    """The configuration of an arm file."""
    with pytest.raises(SystemExit) as end:
        main([str(one) for one in ("compile-model", arm_file, "-o", folder, *more)])
    assert not end.value.code
    return folder / "arm.zyg"


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled(EXAMPLE / "arm.toml", tmp_path_factory.mktemp("onboard"))


@pytest.fixture(scope="module")
def frames(arm: Arm, model: Model, scenario: Scenario) -> Log:
    return encode(arm, simulate(arm, model, scenario, seeds=[0], noise=True, duration_s=75.0).cycles(0))


class Twin:
    """What a node does with frames, by calls of the library: the refinement takes every cycle before the estimator."""

    def __init__(self, arm: Arm, share: float) -> None:
        self.flight = Flight(arm)
        self.native = ffi.new("zygos_refine_t *")
        self.config = ffi.addressof(self.flight.native, "config")
        settings = ffi.new("zygos_refine_settings_t *")
        lib.zygos_refine_defaults(settings, self.config)
        for i in range(arm.n):
            settings.filter.torque_relative_sigma[i] = share
        assert lib.zygos_refine_init(self.native, self.config, settings) == 1
        self.refined = ffi.new("zygos_refined_t *")
        self.rounds: list[Round] = []
        self.reasons: list[int] = []

    def hear(self, frames: Log) -> None:
        """Take frames. Every estimate adds a round."""
        syncs = 0
        receiver = ffi.addressof(self.flight.native, "receiver")
        for frame in frames:
            lib.zygos_frame(self.flight.native, ffi.from_buffer("zygos_frame_t[]", frame.tobytes()))
            stepped = 1
            while stepped == 1:
                lib.zygos_refine_cycle(self.native, lib.zygos_receiver_front(receiver))
                while lib.zygos_refine_step(self.native, self.config) == 1:
                    pass
                stepped = lib.zygos_step(self.flight.native)
            if frame["id"] == SYNC:
                if syncs % EVERY == 0:
                    self.rounds.append(self.judge())
                syncs += 1

    def judge(self) -> Round:
        """What the node tells of the estimate that is due."""
        told = round_of(self.flight)
        self.flight.adopt()
        estimate, out = self.flight._estimate, self.refined
        lib.zygos_refine_judge(self.native, self.config, estimate, out)
        self.reasons.append(out.reason)
        if (self.native.started == 0 or out.reason == lib.ZYGOS_REFINE_FAILED) and estimate.validity == lib.ZYGOS_VALID:
            lib.zygos_refine_start(self.native, self.config, estimate, ffi.NULL)
        names = ("reason", "cycle", "used", "lost", "restarts", "rejected", "farthest", "distance", "level")
        told |= {f"refined_{name}": getattr(out, name) for name in (*names, "level_error")}
        told |= {f"refined_nis_{name}": out.nis[c] for c, name in enumerate(("link", "motor", "gyro"))}
        told |= {f"refined_ratio_{name}": out.ratio[c] for c, name in enumerate(("link", "motor", "gyro"))}
        for k, name in enumerate(self.flight.names) if out.published else ():
            told |= {f"{name}_refined": out.value[k], f"{name}_refined_sigma": out.sigma[k]}
        return {name: float(np.float32(value)) for name, value in told.items() if math.isfinite(value)}


def heard(node: Node, arm: Arm) -> list[Round]:
    """The rounds that a node has told, decoded by the arm's DBC and checked by their CRC; the last may be cut off."""
    dbc, rounds = arm_database(arm), list[Round]()
    for name, value, _ in (told(dbc, data) for data in node.of(TELEMETRY)):
        if name == "verdict_validity":
            rounds.append({})
        rounds[-1][name] = value
    return rounds


@pytest.mark.parametrize("share", [0.0, 0.005])
def test_it_tells_what_the_library_judges(share: float, arm: Arm, model: Model, config: Path, frames: Log) -> None:
    """Every value to the last bit of a float: refined ones and their deviations while they are published, always why,
    and the innovations. The first valid estimate is the start."""
    assert len(CHANNELS) == lib.ZYGOS_KINDS_OF_CHANNEL == 3
    twin = Twin(arm, share)
    twin.hear(frames)
    with Node("--config", config, "--every", EVERY, "--refine", share) as node:
        node.send(frames)
        node.end()
        rounds = heard(node, arm)
    assert len(rounds) == len(twin.rounds) == 16
    assert rounds[:-1] == twin.rounds[:-1]
    assert rounds[-1].items() <= twin.rounds[-1].items()
    published = [one for one in rounds if one.get("refined_reason") == 0.0]
    assert all(sum(name.endswith("_refined") for name in one) == 12 for one in published)
    assert not any("k1_refined" in one for one in rounds if one.get("refined_reason", 0.0) > 0.0)
    if share == 0.0:
        assert published
        values = np.array([rounds[-2][f"{name}_refined"] for name in twin.flight.names])
        sigmas = np.array([rounds[-2][f"{name}_refined_sigma"] for name in twin.flight.names])
        assert np.all(np.abs(values - model.base_values(arm)) < 5.0 * sigmas)
    else:
        assert rounds[-2]["refined_level"] < 0.5  # of a noise that the plant has not


def test_without_the_option_nothing_is_told_of_it(arm: Arm, config: Path, frames: Log) -> None:
    with Node("--config", config, "--every", EVERY) as node:
        node.send(frames[:2500])
        node.end()
        assert not any("refined" in name for one in heard(node, arm) for name in one)


def test_it_begins_again_after_a_failure(arm: Arm, config: Path, frames: Log) -> None:
    """A clock that has jumped makes cycles void that were used already: the refinement has failed, and begins again
    with the next valid estimate."""
    sent = frames.copy()
    for at in np.flatnonzero((sent["id"] == FTIME) & (np.cumsum(sent["id"] == SYNC) > 560)):
        data = sent["data"][at]
        later = int.from_bytes(bytes(data[3:7]), "little") + 100_000
        data[3:7] = np.frombuffer(later.to_bytes(4, "little"), dtype=np.uint8)
        data[0] = lib.zygos_wire_crc(ffi.from_buffer("uint8_t[]", data.tobytes()), 7, 2, 32)
    twin = Twin(arm, 0.0)
    twin.hear(sent)
    with Node("--config", config, "--every", EVERY, "--refine", 0) as node:
        node.send(sent)
        node.end()
        rounds = heard(node, arm)
    assert rounds[:-1] == twin.rounds[:-1]
    failed = [k for k, reason in enumerate(twin.reasons) if reason == lib.ZYGOS_REFINE_FAILED]
    assert failed == [7, 8]
    assert [rounds[k]["verdict_validity"] == 3.0 for k in (7, 8)] == [False, True]
    assert [rounds[k]["refined_used"] for k in (8, 9)] == [297.0, 97.0]
    assert rounds[-2]["refined_reason"] == 0.0


def test_it_begins_again_where_memory_was_changed(arm: Arm, config: Path, frames: Log) -> None:
    """A sum of the estimator is corrupt: nothing that was refined beside it is kept."""
    middle = np.flatnonzero(frames["id"] == SYNC)[420] + 1
    entry = ffi.offsetof("zygos_t", "accumulator", "block", 0, "gram", 0)
    with Node("--config", config, "--every", EVERY, "--refine", 0) as node:
        node.send(frames[:middle])
        node.worked_off(421)
        node.flip(entry + 7, 4)
        node.send(frames[middle:])
        node.process.send_signal(signal.SIGTERM)
        code, counters, _ = node.wait()
        rounds = heard(node, arm)
    assert (code, counters["node_corrupt"]) == (0, 1)
    corrupt = [one["verdict_reason"] for one in rounds].index(lib.ZYGOS_REASON_CORRUPT)
    assert [rounds[corrupt + k].get("refined_used") for k in (-1, 0, 1)] == [97.0, None, 0.0]
    assert rounds[-2]["refined_used"] > 0.0


def sampled(arm: Arm) -> Arm:
    return replace(arm, torque_law="sampled")


def rigid(arm: Arm) -> Arm:
    first, *others = arm.joints
    return replace(arm, joints=(replace(first, flexible=False), *others))


def late(arm: Arm) -> Arm:
    return replace(arm, imu=replace(arm.imu, latch_us=100))


@pytest.mark.parametrize("change", [sampled, rigid, late, None])
def test_arms_that_cannot_be_refined_are_refused(change: Callable[[Arm], Arm] | None, arm: Arm, tmp_path: Path) -> None:
    """None: one with an effect, of which the filter knows nothing. Without the option, each of them is accepted."""
    more: tuple[object, ...] = ()
    if change is None:
        effect = '\n[[effect]]\nkind = "motor_viscous"\njoint = "elbow"\nvalue = 0\n'
        (tmp_path / "model.toml").write_text((EXAMPLE / "model.toml").read_text() + effect)
        more = ("--model", tmp_path / "model.toml")
    save_arm(change(arm) if change else arm, tmp_path / "arm.toml")
    path = compiled(tmp_path / "arm.toml", tmp_path, *more)
    with Node("--config", path) as node:
        node.end()
    node = Node("--config", path, "--refine", 0)
    assert node.process.wait(20.0) == 2
    node.__exit__()
    assert f"{path}: --refine cannot refine this arm; remedy: no effects, flexible joints" in node.complaints

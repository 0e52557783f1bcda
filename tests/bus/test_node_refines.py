# SPDX-License-Identifier: MIT
"""zygos-node --refine: what it tells of the refinement is what the library through cffi says."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bus_support import playing
from cli_support import run
from node_support import SYNC, TELEMETRY, Log, Node, Teller, compiled, flip, frame_of
from round_support import round_of, told
from runs_support import trajectory_of
from schema_support import hold

from conftest import EXAMPLE
from zygos.arm import Arm, save_arm
from zygos.can.bus import write_log
from zygos.can.dbc import arm_database
from zygos.can.rounds import refined_of
from zygos.model.model import Model
from zygos.native.flight import CHANNELS, encode, ffi, lib, text_of
from zygos.simulation.scenario import Scenario

FTIME = 0x3A0
EVERY = 100
SENSORS = ("link", "motor", "gyro")
"""Kinds of sensors in the names of signals, in the order of the innovations."""
Round = dict[str, float]


@pytest.fixture(scope="module")
def frames(arm: Arm, model: Model, scenario: Scenario) -> Log:
    """A run that is long enough for refined values."""
    return encode(arm, trajectory_of(arm, model, scenario, seeds=[0], noise=True, duration_s=75.0, rtol=1e-8).cycles(0))


def rounds_of(twin: Teller) -> list[Round]:
    """What the node tells of each answer, the refinement included."""
    rounds = []
    for answer in twin.answers:
        told, out = round_of(answer, twin.names), answer.refined
        if out is not None:
            names = ("reason", "cycle", "used", "lost", "restarts", "rejected", "farthest", "distance", "level")
            told |= {f"refined_{name}": getattr(out, name) for name in (*names, "level_error")}
            told |= {f"refined_nis_{name}": out.nis[c] for c, name in enumerate(SENSORS)}
            told |= {f"refined_ratio_{name}": out.ratio[c] for c, name in enumerate(SENSORS)}
            for k, name in enumerate(twin.names) if out.published else ():
                told |= {f"{name}_refined": out.value[k], f"{name}_refined_sigma": out.sigma[k]}
        rounds.append({name: float(np.float32(value)) for name, value in told.items() if math.isfinite(value)})
    return rounds


def twin_of(arm: Arm, share: float, frames: Log) -> Teller:
    """A twin that has heard the frames."""
    twin = Teller(arm, every=EVERY, refine=share)
    twin.hear(frames)
    return twin


def heard(node: Node, arm: Arm) -> list[Round]:
    """The rounds that a node has told, decoded by the arm's DBC and checked by their CRC; the last may be cut off."""
    dbc, rounds = arm_database(arm), list[Round]()
    for name, value, _ in (told(dbc, data) for data in node.of(TELEMETRY)):
        if name == "verdict_validity":
            rounds.append({})
        rounds[-1][name] = value
    return rounds


@pytest.mark.slow(only=["0.0"])
@pytest.mark.parametrize("share", [0.0, 0.005])
def test_it_tells_what_the_library_judges(share: float, arm: Arm, model: Model, config: Path, frames: Log) -> None:
    """Every value to the last bit of a float: refined ones and their deviations while they are published, always why,
    and the innovations. The first valid estimate is the start."""
    assert len(CHANNELS) == lib.ZYGOS_KINDS_OF_CHANNEL == 3
    twin = twin_of(arm, share, frames)
    expected = rounds_of(twin)
    with Node("--config", config, "--every", EVERY, "--refine", share) as node:
        node.send(frames)
        node.end()
        rounds = heard(node, arm)
        assert node.of(TELEMETRY) == twin.sent
    assert len(rounds) == len(expected) == 16
    assert rounds[:-1] == expected[:-1]
    assert rounds[-1].items() <= expected[-1].items()
    published = [one for one in rounds if one.get("refined_reason") == 0.0]
    assert all(sum(name.endswith("_refined") for name in one) == 12 for one in published)
    assert not any("k1_refined" in one for one in rounds if one.get("refined_reason", 0.0) > 0.0)
    if share == 0.0:
        assert published
        values = np.array([rounds[-2][f"{name}_refined"] for name in twin.names])
        sigmas = np.array([rounds[-2][f"{name}_refined_sigma"] for name in twin.names])
        assert np.all(np.abs(values - model.base_values(arm)) < 5.0 * sigmas)
    else:
        assert rounds[-2]["refined_level"] < 0.5  # of a noise that the plant has not


@pytest.mark.parametrize("published", [True, False])
def test_listen_shows_it(
    published: bool, arm: Arm, config: Path, frames: Log, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The newest complete round, as numbers in the JSON and as tables; damaged telemetry beside it changes nothing."""
    sent = frames if published else frames[: np.flatnonzero(frames["id"] == SYNC)[730]]
    twin = twin_of(arm, 0.0, sent)
    with Node("--config", config, "--every", EVERY, "--refine", 0) as node:
        node.send(sent)
        node.end()
        answers = np.array([frame_of(TELEMETRY, data) for data in node.of(TELEMETRY)])
    damaged = np.concatenate([answers[:1], [frame_of(TELEMETRY, b"short")], answers[:1]])
    damaged["data"][0, 7] ^= 1
    damaged[2] = telemetry_of(200, 9)
    write_log(tmp_path / "run.log", np.concatenate([sent[:-1], answers, damaged, sent[-1:]]), arm.period_s)
    options = ("-i", "virtual", "-c", f"test_refined_{published}", "--idle", 1, "-o", tmp_path / "live.toml")
    with playing(f"test_refined_{published}", tmp_path / "run.log"):
        assert run("listen", "--arm", EXAMPLE / "arm.toml", *options, "--json", tmp_path / "live.json") == 0
    content = json.loads((tmp_path / "live.json").read_text())
    hold("estimate", content)
    found, told = content["refined"], rounds_of(twin)[-2]
    assert found["published"] == published == (told["refined_reason"] == 0.0)
    assert (found["reason"] is None) == published
    for name in ("cycle", "used", "lost", "restarts", "rejected", "level", "level_error", "distance"):
        assert found[name] == told[f"refined_{name}"]
    assert found["farthest"] == twin.names[int(told["refined_farthest"])]
    assert [one["channel"] for one in found["innovations"]] == list(CHANNELS)
    assert [one["mean"] for one in found["innovations"]] == [told[f"refined_nis_{name}"] for name in SENSORS]
    assert [one["ratio"] for one in found["innovations"]] == [told[f"refined_ratio_{name}"] for name in SENSORS]
    for one in found["parameters"]:
        assert one["value"] == told.get(f"{one['name']}_refined")
        assert one["sigma"] == told.get(f"{one['name']}_refined_sigma")
    said = capsys.readouterr().out
    assert ("refined on board" in said) == published
    assert "innovations on board" in said
    assert f"on board: {text_of(lib.zygos_refine_text, int(told['refined_reason']))}" in said


def telemetry_of(index: int, kind: int) -> Any:
    """A telemetry frame with an item, sound by its CRC."""
    frame = ffi.new("zygos_frame_t *")
    lib.zygos_wire_encode_telemetry(0, index, kind, 1.0, frame)
    return frame_of(TELEMETRY, bytes(frame.data))


def test_a_round_that_lost_frames_tells_nothing_wrong(arm: Arm) -> None:
    """Without a count, or with an index that no parameter has, there is no result; a lost value is NaN."""
    names = ("reason", "cycle", "used", "lost", "restarts", "rejected", "farthest")
    told = {f"refined_{name}": 0.0 for name in names} | {"k1_refined": 2.0}
    whole = refined_of(told, arm.parameter_names)
    assert whole is not None and whole.published
    assert whole.value[arm.parameter_names.index("k1")] == 2.0
    assert np.isnan(whole.value).sum() == 11 and np.isnan([whole.level, *whole.nis]).all()
    for name in names:
        assert refined_of({key: x for key, x in told.items() if key != f"refined_{name}"}, arm.parameter_names) is None
    assert refined_of(told | {"refined_farthest": 12.0}, arm.parameter_names) is None
    assert refined_of(told | {"refined_reason": 2.0**32}, arm.parameter_names) is None
    assert refined_of({}, arm.parameter_names) is None


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
    twin = twin_of(arm, 0.0, sent)
    with Node("--config", config, "--every", EVERY, "--refine", 0) as node:
        node.send(sent)
        node.end()
        rounds = heard(node, arm)
    assert rounds[:-1] == rounds_of(twin)[:-1]
    failed = [k for k, one in enumerate(twin.answers[:-1]) if one.refined.reason == lib.ZYGOS_REFINE_FAILED]
    assert failed == [7]
    assert [rounds[k]["verdict_validity"] == 3.0 for k in (7, 8)] == [False, True]
    assert [rounds[k]["refined_used"] for k in (7, 8, 9)] == [297.0, 0.0, 97.0]
    assert rounds[-2]["refined_reason"] == 0.0


def test_it_goes_on_where_memory_was_changed(arm: Arm, config: Path, frames: Log) -> None:
    """A sum of the estimator is corrupt: the library drops what is, and the refinement, which has sums of its own, goes
    on as that of the library in this process."""
    middle = np.flatnonzero(frames["id"] == SYNC)[420] + 1
    entry = ffi.offsetof("zygos_arm_t", "sums", "energy", "block", 0, "gram", 0)
    twin = Teller(arm, every=EVERY, refine=0.0)
    with Node("--config", config, "--every", EVERY, "--refine", 0) as node:
        node.send(frames[:middle])
        node.worked_off(421)
        node.flip(entry + 7, 4)
        node.send(frames[middle:])
        node.process.send_signal(signal.SIGTERM)
        code, counters, _ = node.wait()
        rounds = heard(node, arm)
    assert (code, counters["node_corrupt"]) == (0, 1)
    twin.hear(frames[:middle])
    flip(twin, entry + 7, 4)
    twin.hear(frames[middle:])
    assert node.of(TELEMETRY) == twin.sent
    corrupt = [one.get("verdict_reason") for one in rounds].index(lib.ZYGOS_REASON_CORRUPT)
    used = [one["refined_used"] for one in rounds[corrupt - 1 : corrupt + 2]]
    assert used == sorted(used) and used[0] > 90.0
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
    path = compiled(tmp_path, tmp_path / "arm.toml", *more)
    with Node("--config", path) as node:
        node.end()
    node = Node("--config", path, "--refine", 0)
    assert node.process.wait(20.0) == 2
    node.__exit__()
    assert f"{path}: --refine cannot refine this arm; remedy: no effects, flexible joints" in node.complaints

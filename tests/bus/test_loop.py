# SPDX-License-Identifier: MIT
"""`make loop`: from what a node heard to the model that flies, and what it says where it cannot go on."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli_support import run
from numpy.typing import NDArray

from conftest import ROOT
from zygos.arm import load_arm
from zygos.demo import loop
from zygos.errors import ZygosError
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles


@pytest.fixture(autouse=True)
def in_the_repository(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> NDArray[Any]:
    """Ten cycles of an arm at rest, which every log holds, and commands in this process."""
    arm = load_arm(loop.GAP / "arm.toml")
    still = np.zeros((10, arm.n))
    cycles = Cycles(np.arange(10, dtype=np.uint64), still, still, still, np.zeros((10, 3)), np.zeros(10, np.uint32))
    frames = encode(arm, cycles)
    monkeypatch.setattr(loop.bus, "read_log", lambda *_: SimpleNamespace(frames=frames))
    monkeypatch.setattr(loop, "run_zygos", run)
    return frames


@pytest.mark.slow
def test_the_loop_closes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two thirds of a minute of processor time. tests/hil/test_loop.py says more about what is right."""
    loop.run_loop(tmp_path / "loop")
    content = json.loads((tmp_path / "loop.json").read_text())
    assert content["named"] == content["hidden"]
    assert np.max(np.abs(loop.errors(content, "after"))) < 0.001 < 0.02 < np.max(np.abs(loop.errors(content, "before")))
    assert content["effects"][0]["significance"] > 100.0
    picture = (tmp_path / "loop" / "loop.svg").read_text()
    assert picture.startswith("<?xml")
    assert "motor_coulomb2: told on board 0.02989" in capsys.readouterr().out
    assert (tmp_path / "loop" / "new.toml").read_bytes() != (loop.GAP / "cad.toml").read_bytes()


@pytest.mark.usefixtures("brief")
def test_nothing_is_adopted_that_was_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[str] = []

    def unknown(*_: object) -> dict[str, Any]:
        return {"answer": "unknown", "sentence": "No effect of the catalogue explains the gap."}

    monkeypatch.setattr(loop, "explained", unknown)
    with pytest.raises(ZygosError, match=r"unknown: No effect .*; remedy: read .*new\.json"):
        loop.close_loop(tmp_path, lambda config, frames, log: flown.append(log.name), cycles=100)
    assert flown == ["a.log", "b.log", "c.log"]


def test_a_node_that_is_missing_or_has_told_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, brief: NDArray[Any]
) -> None:
    frames = loop.first(brief, 9)
    assert 0 < len(frames) < len(brief)
    config = loop.compiled(loop.GAP / "cad.toml", tmp_path)
    loop.fly_beside(config, frames, tmp_path / "short.log")
    with pytest.raises(ZygosError, match=r"short\.log: the node has told no complete estimate; remedy"):
        loop.told(loop.GAP / "cad.toml", tmp_path / "short.log")
    (tmp_path / "arm.zyg").write_bytes(b"nonsense")
    with pytest.raises(ZygosError, match=r"ended with status 2: .*; remedy"):
        loop.fly_beside(config, frames, tmp_path / "short.log")
    monkeypatch.setattr(loop, "NODE", tmp_path / "none")
    with pytest.raises(ZygosError, match=r"there is no .*none; remedy: make node"):
        loop.fly_beside(config, frames, tmp_path / "short.log")

# SPDX-License-Identifier: MIT
"""Logs cut and with bits flipped, at seeded places: an answer or a refusal, and never a frame too many."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cli_support import run
from converter_support import logconvert
from log_support import KINDS, write

from conftest import EXAMPLE
from zygos.arm import Arm
from zygos.can import bus
from zygos.can import damaged as salvage
from zygos.native.flight import encode
from zygos.simulation.plant import Trajectory

PLACES = 25


# Its server has one thread. A fork of this process, in which a thread reports the progress, may inherit a locked lock.
SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["can.logconvert", "asammdf"])


def forked(source: Path, target: Path) -> str:
    """`salvage._convert` in the fork of a process that has loaded everything: a new one takes a second to do so."""
    child = SERVER.Process(target=logconvert, args=(str(source), str(target)))
    child.start()
    child.join(60.0)
    assert child.exitcode is not None, f"the converter did not end on {source}"
    return "" if child.exitcode == 0 else "died"


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["cut", "flipped"])
@pytest.mark.parametrize("kind", KINDS)
def test_damage_anywhere(
    kind: str,
    damage: str,
    arm: Arm,
    clean: Callable[..., Trajectory],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    # without noise, and without any declared to be taken off, a piece of a run is enough for an answer
    frames = encode(arm, clean().cycles())[:2200]
    exact = tmp_path / "exact.toml"
    exact.write_text((EXAMPLE / "arm.toml").read_text() + "\n[compensation]\nevery = 0\n")
    path = write(tmp_path, kind, frames, arm.period_s)
    sound = path.read_bytes()
    rng = np.random.default_rng(["cut", "flipped"].index(damage))
    logs: list[bus.Log] = []
    read = bus.read_log

    def remembered(*arguments: object) -> bus.Log:
        logs.append(read(*arguments))  # type: ignore[arg-type]
        return logs[-1]

    monkeypatch.setattr(bus, "read_log", remembered)
    monkeypatch.setattr(salvage, "_convert", forked)
    codes: Counter[int] = Counter()
    for _ in range(PLACES):
        at = int(rng.integers(len(sound)))
        spoilt = bytearray(sound[:at] if damage == "cut" else sound)
        if damage == "flipped":
            spoilt[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(spoilt)
        logs.clear()
        code = run("estimate", "--energy", path, "--arm", exact, "-o", tmp_path / "m.toml")
        said = capfd.readouterr().err
        assert "Traceback" not in said
        codes[code] += 1
        assert (code == 2) == (not logs)
        for log in logs:
            assert 0 < len(log.frames) <= len(frames)
            assert all(text in said for text in log.damage)
            assert code in ({3, 4} if log.damage else {0, 3})
            if damage == "cut":  # the first frames are left, each as it was
                assert log.frames.tobytes() == frames[: len(log.frames)].tobytes()
    # the table of contents of an .mf4 stands at its end, and a short one is compressed in one block
    assert codes[2 if kind == ".mf4" else 4] > PLACES / 20

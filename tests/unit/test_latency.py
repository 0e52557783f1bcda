# SPDX-License-Identifier: MIT
"""Times from SYNC to answer: which answer belongs to which SYNC, what waits for what, and what is told of it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import can
import numpy as np
import pytest

from conftest import tool_module
from zygos.testing.latency import EDGES_MS, KINDS, answers

PERIOD_S = 0.01


def sync(number: int, at_s: float) -> can.Message:
    return can.Message(arbitration_id=0x080, data=[number % 240 + 1], timestamp=at_s, is_extended_id=False)


def told(number: int, at_s: float, index: int = 7, kind: int = 2) -> can.Message:
    """A telemetry frame: CRC, header with the counter, index, kind, value. Index 0 of kind 3 begins an estimate."""
    data = [0x55, (number % 240 + 1) % 16, index, kind, 0, 0, 0, 0]
    return can.Message(arbitration_id=0x1A0, data=data, timestamp=at_s, is_extended_id=False)


def test_the_first_frame_with_the_counter_of_a_sync_answers_it() -> None:
    heartbeat = can.Message(arbitration_id=0x720, data=[5], timestamp=0.0, is_extended_id=False)
    first = [heartbeat, sync(0, 0.000), told(0, 0.002, 0, 3), told(0, 0.003)]
    second = [sync(1, 0.010), told(0, 0.0105), told(1, 0.011)]
    others = [sync(2, 0.020), sync(3, 0.030), told(3, 0.0405), sync(4, 0.050)]
    found = answers([*first, *second, *others], PERIOD_S)
    assert found.latency_s == pytest.approx([0.002, 0.001, math.nan, 0.0105, math.nan], nan_ok=True)
    assert found.solves.tolist() == [True, False, False, False, False]
    assert found.behind.tolist() == [-1] * 5
    assert found.misses == 3  # two without an answer, and one late


def test_more_than_sixteen_syncs_may_wait() -> None:
    """Twenty SYNCs come before the answer to the first one, which solves; the one behind them finds the node idle."""
    syncs = [sync(k, PERIOD_S * k) for k in range(20)]
    late = [told(0, 0.2, 0, 3), *(told(k, 0.2 + 1e-4 * k) for k in range(1, 20))]
    found = answers([*syncs, *late, sync(20, 0.25), told(20, 0.251)], PERIOD_S)
    assert np.isfinite(found.latency_s).all()
    assert found.behind.tolist() == [-1] + [0] * 19 + [-1]
    assert [KINDS[k] for k in found.kind] == ["solves"] + ["waits for one that solves"] * 19 + ["accumulates"]
    assert found.misses == 20  # also the last of them, which took 11.9 ms


def test_the_distribution_counts_every_cycle_once() -> None:
    rng = np.random.default_rng(0)
    latency = rng.uniform(1e-4, 9e-3, 300)
    messages = [m for k in range(300) for m in (sync(k, 0.01 * k), told(k, 0.01 * k + latency[k], 0, 3 - k % 2))]
    found = answers(messages, PERIOD_S).as_json()
    idle, solving, *waiting = found["cycles"]
    assert [one["count"] for one in (idle, solving, *waiting)] == [150, 150, 0, 0]
    for one, own in ((idle, latency[1::2]), (solving, latency[::2])):
        assert one["histogram"] == np.histogram(1e3 * own, [0.0, *EDGES_MS, np.inf])[0].tolist()
        assert one["median_ms"] == pytest.approx(1e3 * np.median(own), abs=1e-3)
        assert one["largest_ms"] == pytest.approx(1e3 * own.max(), abs=1e-3)
        assert one["unanswered"] == one["misses"] == 0
    assert waiting[0]["median_ms"] is None


@pytest.mark.slow
def test_the_table_and_the_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tool = tool_module("latency")
    page, drawn, measured = tmp_path / "hil.md", tmp_path / "latency.svg", tmp_path / "hil.json"
    page.write_text(f"before\n{tool.BEGIN}old\n{tool.END}after\n")
    measured.write_text(json.dumps({"channel": "vcan0", "drills": [{"drill": "clean"}]}))
    assert tool.main(measured, page, drawn) == 2
    assert "remedy: make hil" in capsys.readouterr().err
    messages = [m for k in range(5) for m in (sync(k, 0.01 * k), told(k, 0.01 * k + 0.004 * (k + 1)))]
    case = {"arm": "2 joints, p = 12", "load": "alone", "machine": "a clock", "frames_per_s": 12_345}
    case |= answers(messages, PERIOD_S).as_json()
    measured.write_text(
        json.dumps({"channel": "vcan0", "drills": [{"drill": "clean"}, {"drill": "x", "latency": case}]})
    )
    assert tool.main(measured, page, drawn) == 0
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert "| 2 joints, p = 12 | 100 Hz, alone (12,345) | accumulates | 3 |" in text
    assert "Measured on: a clock" in text and "Of 5 SYNCs, 5 were answered." in text
    assert "deadline" in drawn.read_text()
    page.write_text("no marks\n")
    assert tool.main(measured, page, drawn) == 2

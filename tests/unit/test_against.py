# SPDX-License-Identifier: MIT
"""Answers of two states of the code are compared: what is worse is told, and what cannot be compared is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import ROOT
from zygos.accuracy import cell
from zygos.accuracy.__main__ import main
from zygos.accuracy.against import against, check_draws, read_cells
from zygos.accuracy.cases import BLOCK, Case, all_cases, chosen
from zygos.errors import ZygosError

SEEDS, DRAWS = 2 * BLOCK, 20
SIGMA = 1e-3


@pytest.fixture(scope="module")
def case() -> Case:
    (found,) = chosen(all_cases(ROOT / "examples"), ["paper-60"])
    return found


def cells(case: Case, bias: float = 0.0, spread: float = 1.0, width: float = 1.0, draws: int = DRAWS) -> list[Any]:
    """Answers with normal errors, relative to SIGMA; the same draws of them for every state of the code."""
    true = case.model.base_values(case.arm)
    size = SIGMA * np.abs(true)
    errors = np.random.default_rng(0).standard_normal((SEEDS, draws, len(true)))
    lines = []
    for first in range(0, SEEDS, BLOCK):
        own = errors[first : first + BLOCK].reshape(-1, len(true))
        column = {
            "seed": np.repeat(np.arange(first, first + BLOCK), draws).tolist(),
            "draw": np.tile(np.arange(draws), BLOCK).tolist(),
            "validity": ["valid"] * len(own),
            "reason": [""] * len(own),
            "value": (true + size * (bias + spread * own)).tolist(),
            "half95": (width * 1.96 * np.tile(size, (len(own), 1))).tolist(),
            "sigma": (width * np.tile(size, (len(own), 1))).tolist(),
        }
        lines.append({"case": case.name, "answers": {"flight": column}})
    return lines


def found(case: Case, **changes: float) -> dict[str, Any]:
    (entry,) = against(
        [case],
        cells(case, changes.get("bias", 0.0), changes.get("spread", 1.0), changes.get("width", 1.0)),
        cells(case),
    )
    return entry


def test_two_equal_states(case: Case) -> None:
    entry = found(case)
    assert (entry["seeds"], entry["draws"], entry["worse"]) == (SEEDS, SEEDS * DRAWS, [])
    assert entry["published"] == entry["published_other"] == SEEDS * DRAWS * len(case.arm.parameters)
    assert entry["spread_ratio"] == pytest.approx(1.0)
    assert entry["half95_ratio"] == pytest.approx(1.0)
    assert entry["coverage95"] == entry["coverage95_other"] == pytest.approx(0.95, abs=0.01)
    assert entry["bias"] == pytest.approx(entry["bias_other"])
    assert entry["bias"] < 3.0 / (SEEDS * DRAWS) ** 0.5
    assert entry["wild"] == entry["wild_other"] == 0


@pytest.mark.slow(only=["changes0*"])
@pytest.mark.parametrize(
    ("changes", "worse"),
    [
        ({"width": 1.4}, ["coverage"]),
        ({"width": 1.6}, ["coverage", "half widths"]),
        ({"width": 0.8}, ["coverage"]),
        ({"bias": 2.0}, ["coverage"]),
        ({"bias": 30.0}, ["coverage", "wild values"]),
        ({"spread": 1.2}, ["coverage"]),
    ],
)
def test_what_is_worse_is_told(case: Case, changes: dict[str, float], worse: list[str]) -> None:
    entry = found(case, **changes)
    assert entry["worse"] == worse
    assert entry["bias"] == pytest.approx(changes.get("bias", 0.0), rel=0.05, abs=0.1)
    assert entry["spread_ratio"] == pytest.approx(changes.get("spread", 1.0))
    assert entry["half95_ratio"] == pytest.approx(changes.get("width", 1.0))


def test_only_values_that_both_publish_are_compared(case: Case) -> None:
    own, other = cells(case, bias=30.0), cells(case)
    for line in own:
        column = line["answers"]["flight"]
        column["validity"] = ["refused" if draw else "valid" for draw in column["draw"]]
    (entry,) = against([case], own, other)
    assert entry["published"] == SEEDS * len(case.arm.parameters)
    assert entry["published_other"] == SEEDS * DRAWS * len(case.arm.parameters)
    assert entry["coverage95"] == 0
    assert entry["bias"] == pytest.approx(30.0, rel=0.35)


def test_a_case_that_the_other_state_does_not_have_is_left_out(case: Case) -> None:
    assert against([case], cells(case), [{**line, "case": "another"} for line in cells(case)]) == []


def test_other_draws_are_refused(case: Case) -> None:
    with pytest.raises(ZygosError, match=r"case 'paper-60': the other cells have other seeds or draws .*--seeds"):
        against([case], cells(case), cells(case, draws=DRAWS + 1))


@pytest.mark.parametrize("text", [None, "{", "", '{"figure": 4}\n', "[1]\n"])
def test_a_file_without_cells_is_refused(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "cells.jsonl"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ZygosError, match=r"cells.jsonl: .*remedy: .*out/accuracy/cells.jsonl"):
        read_cells(path)


def test_cells_of_a_file(tmp_path: Path, case: Case) -> None:
    path = tmp_path / "cells.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in [*cells(case, draws=2), {"limit": "paper-60"}]))
    assert read_cells(path) == cells(case, draws=2)


def test_the_file_of_the_own_cells_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells of other states are removed from it."""
    monkeypatch.chdir(ROOT)
    path = tmp_path / "cells.jsonl"
    path.write_text("{}\n")
    outputs = [f"--json={tmp_path / 'a.json'}", f"--page={tmp_path / 'a.html'}"]
    with pytest.raises(SystemExit) as end:
        main(["paper-60", f"--lines={path}", f"--against={path}", *outputs])
    assert end.value.code == 2
    assert "would replace" in capsys.readouterr().err
    assert path.read_text() == "{}\n"


def test_other_draws_are_refused_before_anything_is_computed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, case: Case
) -> None:
    monkeypatch.chdir(ROOT)
    path, outputs = tmp_path / "other.jsonl", [tmp_path / name for name in ("cells.jsonl", "a.json", "a.html")]
    path.write_text("".join(json.dumps(line) + "\n" for line in cells(case, draws=2)))
    options = [f"--{name}={file}" for name, file in zip(("lines", "json", "page"), outputs, strict=True)]
    with pytest.raises(SystemExit) as end:
        main(["paper-60", "--seeds=2", "--draws=4", f"--against={path}", *options])
    assert end.value.code == 2
    assert "remedy: run both with the same --seeds and --draws" in " ".join(capsys.readouterr().err.split())
    assert not any(file.exists() for file in outputs)


def test_cells_of_the_same_draws_are_taken(case: Case) -> None:
    jobs = cell.cells([case], SEEDS, SEEDS * DRAWS)
    check_draws(jobs, cells(case))
    check_draws(jobs, [{**line, "case": "another"} for line in cells(case, draws=DRAWS + 1)])
    with pytest.raises(ZygosError, match="other seeds or draws"):
        check_draws(jobs, cells(case)[1:])

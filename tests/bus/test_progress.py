# SPDX-License-Identifier: MIT
"""How far a long command is where stderr is no terminal: a log file, a pipe, CI."""

from __future__ import annotations

import json
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cli_support import run
from rich.progress import Task

from conftest import ROOT
from zygos.files import progress as lines
from zygos.files.progress import progress
from zygos.simulation.plant import simulate

PAPER = ROOT / "examples" / "paper" / "scenario.toml"
LINE = re.compile(r"simulating · (\d+) % · (\d+):(\d\d):(\d\d) elapsed( · about \d+:\d\d:\d\d left)?")


def seconds_of(folder: Path, duration_s: int) -> Path:
    """The scenario of a copy of the paper's example that lasts so long."""
    shutil.copytree(PAPER.parent, folder)
    path = folder / PAPER.name
    path.write_text(re.sub(r"^duration_s = .*$", f"duration_s = {duration_s}", PAPER.read_text(), flags=re.M))
    return path


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lines, "FIRST_S", 1e-3)
    monkeypatch.setattr(lines, "EVERY_S", 2e-3)


def test_a_long_simulation_says_how_far_it_is(
    impatient: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def simulated(*arguments: Any, progress: Callable[[float], None], **options: Any) -> Any:
        """Takes its time: a step of the progress lasts 10 ms."""

        def slowly(share: float) -> None:
            progress(share)
            time.sleep(0.01)

        return simulate(*arguments, progress=slowly, **options)

    monkeypatch.setattr("zygos.cli.simulate.simulate", simulated)
    scenario = seconds_of(tmp_path / "example", 5)
    assert run("simulate", scenario, "-o", tmp_path / "run.blf", "--json", "-") == 0
    out, error = capfd.readouterr()
    said = [match for match in map(LINE.fullmatch, error.splitlines()) if match]
    assert len(said) >= 2, error
    assert len(said) == len(error.splitlines())
    shares = [int(match[1]) for match in said]
    assert shares == sorted(shares) and shares[0] < shares[-1] <= 100
    assert said[-1][5]
    assert json.loads(out)["run"] == str(tmp_path / "run.blf")


def test_a_short_one_says_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run("simulate", seconds_of(tmp_path / "example", 1), "-o", tmp_path / "run.blf") == 0
    out, error = capfd.readouterr()
    assert error == ""
    assert "20 cycles" in out


def test_what_fails_ends_at_once(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """The thread that watches does not keep a failed command alive, and says nothing after it."""
    monkeypatch.setattr(lines, "FIRST_S", 60.0)
    begin = time.monotonic()
    with pytest.raises(ZeroDivisionError), progress() as bar:
        bar.add_task("dividing")
        1 / 0  # noqa: B018
    assert time.monotonic() - begin < 10.0
    assert capfd.readouterr() == ("", "")


def test_lines() -> None:
    clock = [0.0]
    with progress() as bar:
        assert isinstance(bar, lines.LineProgress)
        bar.get_time = lambda: clock[0]
        unknown = task(bar, "reading run.blf", None)
        known = task(bar, "fitting", 10)
        clock[0] = 61.4
        assert lines.line(unknown) == "reading run.blf · 0:01:01 elapsed"
        assert lines.line(known) == "fitting · 0 % · 0:01:01 elapsed"
        bar.advance(known.id, 1)
        clock[0] = 3661.4
        bar.advance(known.id, 1)
        assert lines.line(known) == "fitting · 20 % · 1:01:01 elapsed · about 8:00:00 left"
        bar.update(known.id, completed=10)
        assert known.finished


def task(bar: lines.LineProgress, name: str, total: float | None) -> Task:
    bar.add_task(name, total=total)
    return bar.tasks[-1]


def test_other_commands_too(
    impatient: None, recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Whatever draws a bar on a terminal; here an estimate, which reads and then works."""
    assert run("estimate", "--energy", recording, "-o", tmp_path / "model.toml") == 0
    assert re.search(r"^reading run\.blf.* · 0:00:0\d elapsed$", capfd.readouterr().err, re.M)

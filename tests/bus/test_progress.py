"""How far a long command is where stderr is no terminal: a log file, a pipe, CI."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.progress import Task

from conftest import ROOT
from zygos.cli import main
from zygos.files import progress as lines
from zygos.files.progress import progress

PAPER = ROOT / "examples" / "paper" / "scenario.toml"
LINE = re.compile(r"simulating · (\d+) % · (\d+):(\d\d):(\d\d) elapsed( · about \d+:\d\d:\d\d left)?")

IMPATIENT = """
import sys
from zygos.files import progress as lines
from zygos.cli import main
lines.FIRST_S, lines.EVERY_S = 0.1, 0.2
main(sys.argv[1:])
"""


def in_a_pipe(program: list[str], *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)


def test_a_long_simulation_says_how_far_it_is(tmp_path: Path) -> None:
    done = in_a_pipe(["-c", IMPATIENT], "simulate", PAPER, "-o", tmp_path / "run.blf", "--json", "-")
    said = [match for match in map(LINE.fullmatch, done.stderr.splitlines()) if match]
    assert len(said) >= 2, done.stderr
    assert len(said) == len(done.stderr.splitlines())
    shares = [int(match[1]) for match in said]
    assert shares == sorted(shares) and shares[0] < shares[-1] <= 100
    assert said[-1][5]
    assert json.loads(done.stdout)["run"] == str(tmp_path / "run.blf")


def test_a_short_one_says_nothing(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.toml"
    text = re.sub(r"^duration_s = .*$", "duration_s = 1", PAPER.read_text(), flags=re.M)
    for name in ("arm.toml", "model.toml"):
        (tmp_path / name).write_text((PAPER.parent / name).read_text())
    scenario.write_text(text)
    done = in_a_pipe(["-m", "zygos.cli"], "simulate", scenario, "-o", tmp_path / "run" / "run.blf")
    assert done.stderr == ""
    assert "20 cycles" in done.stdout


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


def test_other_commands_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """Whatever draws a bar on a terminal; here an estimate, which reads and then works."""
    run = tmp_path / "run.blf"
    with pytest.raises(SystemExit, match="0"):
        main(["simulate", str(PAPER), "-o", str(run)])
    capfd.readouterr()
    monkeypatch.setattr(lines, "FIRST_S", 1e-3)
    monkeypatch.setattr(lines, "EVERY_S", 0.05)
    with pytest.raises(SystemExit):
        main(["estimate", str(run), "-o", str(tmp_path / "model.toml")])
    assert re.search(r"^reading run\.blf.* · 0:00:0\d elapsed$", capfd.readouterr().err, re.M)

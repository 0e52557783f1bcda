# SPDX-License-Identifier: MIT
"""The report pages of `zygos estimate`, `self-test` and `check-arm`: whole in one file, and for refused runs too."""

from __future__ import annotations

import hashlib
import html
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from html.parser import HTMLParser
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run

from conftest import EXAMPLE, ROOT
from zygos.arm import load_arm
from zygos.audit import sections as audit
from zygos.audit.findings import Audit, SignalFault
from zygos.can import bus
from zygos.can.run import Run
from zygos.effects import CATALOGUE, Effect
from zygos.estimation import sections as estimation
from zygos.estimation.estimate import Estimation
from zygos.estimation.ledger import balance
from zygos.estimation.watch import Watch
from zygos.model.model import load_model
from zygos.native.flight import Drift, Flight, LeftOut
from zygos.reference import compare
from zygos.reference import sections as reference
from zygos.reference.check import Check
from zygos.reference.compare import Room
from zygos.report.html import write_page
from zygos.report.provenance import Provenance
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed, smooth

ARM = EXAMPLE / "arm.toml"
HOSTILE = "</script><script>alert(1)</script>\"'&"
NOWHERE = Provenance("zygos", "1.2.3", ())


def command_of(name: str, log: Path, out: Path) -> list[object]:
    return {
        "estimate": ["estimate", log, "--arm", ARM, "-o", out / "model.toml"],
        "self-test": ["self-test", log, "--arm", ARM],
        "check-arm": ["check-arm", log, "--arm", ARM],
    }[name]


class Page(HTMLParser):
    """What a page says, and what its charts draw."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.figures: list[str] = []
        self.source = source
        self._said: list[str] = []
        self._silent = False
        self.feed(source)
        self.text = " ".join(" ".join(self._said).split())
        content = re.search(r'<script type="application/json" id="data">(.*?)</script>', source, re.DOTALL)
        assert content
        self.data: dict[str, Any] = json.loads(content[1], parse_constant=self._no_constant)

    @staticmethod
    def _no_constant(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    def handle_starttag(self, tag: str, attrs: Sequence[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._silent = tag in {"script", "style"}
        self.figures += [value or "" for key, value in attrs if key == "data-chart"]

    def handle_endtag(self, tag: str) -> None:
        self._silent = self._silent and tag not in {"script", "style"}

    def handle_data(self, data: str) -> None:
        if not self._silent:
            self._said.append(data)


def sound(page: Page) -> Page:
    """What holds of every page."""
    assert not re.search(r"https?:|//[a-z]|\bsrc\s*=|@import|url\(|\bimport\b|fetch\(|XMLHttp", page.source)
    assert not re.search(r"\b(nan|inf|True|False|None(?!:| was))\b", page.text)
    assert page.tags.count("script") == 3  # the labels of narrow tables, the numbers, the charts
    assert sorted(page.figures) == sorted(page.data["charts"])
    assert len(page.source) < 500_000
    for chart in page.data["charts"].values():
        assert chart["series"]
        assert all(len(line["y"]) == len(page.data["times"][chart["time"]]) for line in chart["series"])
    return page


@pytest.mark.slow(only=["check-arm", "self-test"])
@pytest.mark.parametrize("name", ["estimate", "self-test", "check-arm"])
def test_a_page_is_whole_and_says_where_it_comes_from(name: str, brief_recording: Path, tmp_path: Path) -> None:
    log, file = brief_recording, tmp_path / "new" / "page.html"
    given = [*command_of(name, log, tmp_path), "--report", file]
    assert run(*given) == 0
    page = sound(Page(file.read_text(encoding="utf-8")))
    assert " ".join(["zygos", *map(str, given)]) in page.text
    assert f"zygos {version('zygos')}." in page.text
    for path in (log, ARM):
        assert hashlib.sha256(path.read_bytes()).hexdigest() in page.text
    verdict = {
        "estimate": "valid 12 of 12 parameters learned from 400 cycles",
        "self-test": "equal C and numpy agree in all 11 stages",
        "check-arm": "signals confirmed, not everything decided Signs and places of the signals are confirmed, but not "
        "decided: torque_law",
    }[name]
    assert verdict in page.text
    assert "Remedy" not in page.text
    assert page.data["charts"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["estimate", "self-test", "check-arm"])
def test_a_table_of_cycles_has_a_page(name: str, brief_recording: Path, tmp_path: Path) -> None:
    """Its cycles are numbered as they are in the table; a refinement counts the seconds of its readings."""
    cycles = watched(load_arm(ARM), bus.read_log(brief_recording).frames).trace().cycles
    np.savez(tmp_path / "run.npz", **asdict(replace(cycles, sync=cycles.sync + np.uint64(100_000))))
    file = tmp_path / "page.html"
    assert run(*command_of(name, tmp_path / "run.npz", tmp_path), "--report", file) == 0
    page = sound(Page(file.read_text(encoding="utf-8")))
    assert page.data["charts"]
    begins = {name: min(x for x in times if x is not None) for name, times in page.data["times"].items()}
    assert all(begin > 100_000 * 0.049 for name, begin in begins.items() if not name.startswith("refined")), begins


@pytest.mark.slow
def test_an_estimate_is_the_same_with_a_page(brief_recording: Path, tmp_path: Path) -> None:
    for folder, more in (("plain", []), ("page", ["--report", tmp_path / "page.html"])):
        out = tmp_path / folder
        assert run(*command_of("estimate", brief_recording, out), "--json", out / "a.json", *more) == 0
    for file in ("model.toml", "a.json"):
        assert (tmp_path / "page" / file).read_bytes() == (tmp_path / "plain" / file).read_bytes()


@pytest.mark.slow
def test_the_page_of_an_estimate_has_its_numbers_and_no_true_value(recording: Path, tmp_path: Path) -> None:
    file, answer = tmp_path / "page.html", tmp_path / "answer.json"
    given = command_of("estimate", recording, tmp_path)
    assert run(*given, "--energy", "--report", file, "--json", answer) == 0
    page, found = Page(file.read_text(encoding="utf-8")), json.loads(answer.read_text())
    arm, rows = load_arm(ARM), re.findall(r"<tr><td><span.*?</tr>", page.source, re.DOTALL)
    for row, parameter in zip(rows, found["parameters"], strict=True):
        inside = re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)
        cells = [html.unescape(re.sub(r"<[^>]*>", "", cell)) for cell in inside]
        value, half = (float(cells[k].replace(",", "")) for k in (2, 3))
        assert cells[0] == parameter["name"]
        assert value == pytest.approx(parameter["value"], abs=0.06 * parameter["half95"])
        assert half == pytest.approx(parameter["half95"], rel=0.06)
        low, high = (float(text.replace(",", "")) for text in cells[5].split(" … "))
        assert high - low == pytest.approx(2.0 * half, rel=0.1)
    for name in ("angles", "rates", "torque", "base", "energy", "residual"):
        assert name in page.data["charts"]
    # the inertias of the plant are no round numbers, so that no other number is one by accident
    true = load_model(EXAMPLE / "model.toml").base_values(arm)
    for value in true[: len(arm.body_parameters)].tolist():
        for text in (f"{value:.6g}", f"{value:,.0f}", f"{value:,.1f}", f"{value:.7g}"):
            assert not re.search(rf"(?<![\d.,]){re.escape(text)}(?![\d])", page.source)
    assert "model.toml" not in page.text.replace(str(tmp_path / "model.toml"), "")


@pytest.mark.parametrize("name", ["estimate", "self-test", "check-arm"])
def test_a_refused_run_has_a_page_with_reason_and_remedy(
    name: str, brief_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short, file = tmp_path / "short.blf", tmp_path / "page.html"
    bus.write_log(short, bus.read_log(brief_recording).frames[:200], 0.05)
    assert run(*command_of(name, short, tmp_path), "--report", file) == 3
    said = " ".join(capsys.readouterr().err.split())
    page = sound(Page(file.read_text(encoding="utf-8")))
    reason = {
        "estimate": "too few accepted instants",
        "self-test": "no solution to compare, refused: too few accepted instants",
        "check-arm": "nothing confirms",
    }[name]
    assert reason in said and reason in page.text.replace("No solution", "no solution")
    remedy = said.split("remedy: ")[1]
    assert f"Remedy: {remedy}" in page.text
    assert not (tmp_path / "model.toml").exists()


@pytest.mark.parametrize("name", ["estimate", "check-arm"])
def test_a_log_of_another_arm_has_a_page(name: str, brief_recording: Path, tmp_path: Path) -> None:
    log, arm, file = brief_recording, tmp_path / "arm.toml", tmp_path / "page.html"
    arm.write_text(ARM.read_text().replace("node = 16", "node = 17"))
    given = [arm if part == ARM else part for part in command_of(name, log, tmp_path)]
    assert run(*given, "--report", file) == 3
    page = sound(Page(file.read_text(encoding="utf-8")))
    assert "no whole cycle of this arm came" in page.text


@pytest.mark.slow
def test_an_arm_file_that_is_wrong_is_told_what_to_write(brief_recording: Path, tmp_path: Path) -> None:
    arm, file = tmp_path / "arm.toml", tmp_path / "page.html"
    arm.write_text(ARM.read_text().replace('side = "output", sign = 1', 'side = "output", sign = -1', 1))
    assert run("check-arm", brief_recording, "--arm", arm, "--report", file) == 3
    page = sound(Page(file.read_text(encoding="utf-8")))
    assert "1 finding, the first: shoulder motor angle inverted" in page.text
    assert "Remedy: sign = 1 of the motor_encoder" in page.text
    assert {"angle-0", "torque-1", "gyro"} <= set(page.data["charts"])


@pytest.mark.slow
def test_a_stage_that_differs_is_marked_and_drawn(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def bent(arm: Any, samples: Samples) -> Smoothed:
        straight = smooth(arm, samples)
        qd = straight.qd.copy()
        qd[700] *= 1.0 + 1e-6
        return replace(straight, qd=qd)

    monkeypatch.setattr(compare, "smooth", bent)
    file = tmp_path / "page.html"
    assert run(*command_of("self-test", recording, tmp_path), "--report", file) == 3
    page = sound(Page(file.read_text(encoding="utf-8")))
    assert "C and numpy differ in: smoother" in page.text
    (chart,) = [chart for chart in page.data["charts"].values() if chart["title"] == "smoother"]
    (line,) = chart["series"]
    cycle = page.data["times"][chart["time"]][int(np.argmax([y or 0.0 for y in line["y"]]))]
    assert cycle == 705  # the instant 700 belongs to the cycle five later, where the smoother's window is full


@pytest.mark.slow(but=["self-test"])
@pytest.mark.parametrize("name", ["estimate", "self-test", "check-arm"])
def test_a_page_on_standard_output_is_alone_there(
    name: str, brief_recording: Path, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    given = command_of(name, brief_recording, tmp_path)
    assert run(*given, "--report", "-") == 0
    said = capfdbinary.readouterr().out.decode()
    assert said.startswith("<!doctype html>") and said.rstrip().endswith("</html>")
    assert run(*given, "--report", "-", "--json", "-") == 2
    captured = capfdbinary.readouterr()
    assert captured.out == b""
    assert b"standard output more than once" in captured.err


def watched(arm: Any, frames: Any, effects: Sequence[Effect] = ()) -> Watch:
    watch = Watch(Flight(arm, effects), trace=True)
    watch.frames(frames)
    return watch


def test_a_change_and_arcs_that_were_left_out_are_told(recording: Path, tmp_path: Path) -> None:
    arm = load_arm(ARM)
    watch = watched(arm, bus.read_log(recording).frames)
    deviation = np.where([name == "k2" for name in arm.parameter_names], 9.0, 0.5)
    drift = Drift(arm.parameter_names, deviation, "", 640)
    watch.left_out.append(LeftOut("energy", 100, 310))
    result = replace(watch.flight.estimate(), left_out=(1, 0, 0), validity="doubtful", reason="the arm changed")
    file = tmp_path / "page.html"
    found = Estimation(watch, result, drift)
    answer = estimation.answer_of(found, written="nothing", damage=("a frame is missing",), draw=True)
    write_page(file, answer, NOWHERE)
    page = sound(Page(file.read_text(encoding="utf-8")))
    assert "the arm changed after 32 s, in standard deviations: k2 by 9" in page.text
    assert "Remedy: read the warning: the arm changed" in page.text
    assert "k2 stiffness, elbow 9" in page.text
    assert "energy 5.0 15.5" in page.text
    assert "Warning: a frame is missing" in page.text


def test_names_cannot_break_the_pages(brief_recording: Path, tmp_path: Path) -> None:
    plain = load_arm(ARM)
    joints = tuple(replace(joint, name=joint.name + HOSTILE) for joint in plain.joints)
    arm = replace(plain, name=HOSTILE, joints=joints)
    source = Provenance(HOSTILE, "1", ((HOSTILE, HOSTILE, "0"),))
    watch = watched(arm, bus.read_log(brief_recording).frames)
    files = [tmp_path / f"{k}.html" for k in range(3)]
    hostile_run = Run(arm, table=watch.trace().cycles, damage=(HOSTILE,))
    result = replace(watch.flight.estimate(), validity="doubtful", reason=HOSTILE)
    estimate = Estimation(watch, result, None)
    write_page(files[0], estimation.answer_of(estimate, written=HOSTILE, damage=(HOSTILE,), draw=True), source)
    found = Check(hostile_run, watch.flight, (Room(HOSTILE, 1, 1.0, None, 0.0),))
    write_page(files[1], reference.answer_of(found, draw=True), source)
    seen = Audit((), (SignalFault(HOSTILE, HOSTILE, HOSTILE, HOSTILE),), (), {HOSTILE: 1.0}, (HOSTILE,))
    write_page(files[2], audit.answer_of(hostile_run, seen, draw=True), source)
    for file in files:
        page = sound(Page(file.read_text(encoding="utf-8")))
        assert HOSTILE not in page.source
        assert page.text.count(HOSTILE) >= 5


@pytest.mark.slow
def test_the_ledger_leaves_over_what_the_estimate_says(recording: Path) -> None:
    """With the column of an effect, which is among the losses."""
    arm = load_arm(ARM)
    effects = (Effect(CATALOGUE["motor_coulomb"], "elbow", 0.0), Effect(CATALOGUE["cubic_stiffness"], "elbow", 0.0))
    watch = watched(arm, bus.read_log(recording).frames, effects)
    trace, result = watch.trace(), watch.flight.estimate()
    found = balance(arm, trace, result.solution, effects)
    parts = found.kinetic + found.elastic + found.dissipated + found.residual
    np.testing.assert_allclose(parts[trace.instant], found.supplied[trace.instant], rtol=1e-9)
    left = found.residual[trace.accepted & trace.instant]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(result.residual, rel=0.05)
    assert found.arcs == result.arcs


@pytest.mark.slow
def test_the_ledger_has_a_constant_for_each_arc() -> None:
    """Arcs of 10 s at 200 Hz: at the origin of each the slip of the springs begins at zero anew. Of the run, the first
    30 s."""
    arm = load_arm(ROOT / "examples" / "gap" / "arm.toml")
    frames = bus.read_log(ROOT / "examples" / "gap" / "demo" / "a.blf").frames
    watch = watched(arm, frames[: len(frames) // 2])
    trace, result = watch.trace(), watch.flight.estimate()
    found = balance(arm, trace, result.solution, watch.flight.effects)
    origins = trace.instant & (trace.row[:, list(arm.parameter_names).index("b1")] == 0.0)
    assert found.arcs == result.arcs == np.count_nonzero(origins) == 3
    left = found.residual[trace.accepted & trace.instant]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(result.residual, rel=0.05)
    for arc in np.split(found.residual, np.flatnonzero(origins))[1:]:
        assert abs(np.nanmean(arc)) < 1e-9 * np.nanmax(found.supplied)

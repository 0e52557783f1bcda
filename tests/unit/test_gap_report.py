# SPDX-License-Identifier: MIT
"""The page of an explained gap: whole in one file, every number in its place, and no name that can break it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gap_support import effect, example
from runs_support import trajectory_of

from zygos.arm import Smoother
from zygos.gap.experiment import Experiment
from zygos.gap.explain import explain
from zygos.gap.explanation import Explanation
from zygos.gap.findings import Deflection, Gap
from zygos.gap.record import read_measured_run
from zygos.gap.remainder import far_off
from zygos.gap.residuals import as_delivered
from zygos.gap.sections import answer_of
from zygos.gap.sentences import motion
from zygos.gap.torque import joint_torques
from zygos.gap.verdicts import (
    BrokenRun,
    Inseparable,
    Lacking,
    NoFloor,
    NothingMissing,
    NotPredicted,
    SkewedEncoders,
    Unexplained,
    Unpredicted,
    ValuesDiffer,
)
from zygos.native.flight import encode
from zygos.report.figures import figure
from zygos.report.html import write_page
from zygos.report.provenance import Provenance

HASHES = tuple(f"{k:x}" * 64 for k in range(1, 6))
PROVENANCE = Provenance(
    "zygos explain A.blf B.blf --simulation cad.toml --validate C.blf -o new.toml",
    "1.2.3",
    tuple(zip(("simulation", "arm", "measured", "measured", "validate"), "vwxyz", HASHES, strict=True)),
)
HOSTILE = "</script><script>alert(1)</script>\"'&"


@pytest.fixture(scope="module")
def friction() -> Explanation:
    """Coulomb friction at the elbow, in 10 s of each run at 50 Hz."""
    arm, model, _ = example()
    arm = replace(arm.at_period(0.02), smoother=Smoother(7, 4, 3))
    plant = replace(model, effects=(*model.effects, effect(arm, "motor_coulomb", 1, 0.05)))
    runs = []
    for k, name in enumerate("abc"):
        run = trajectory_of(arm, plant, example(name)[2], seeds=[k], noise=True, duration_s=10.0, rtol=1e-9, atol=1e-11)
        runs.append(read_measured_run(arm, Path(f"run-{name}.blf"), encode(arm, run.cycles())))
    found = explain(arm, model, runs[:2], runs[2:])
    assert found.answer == "named"
    return found


def nothing(found: Explanation) -> Explanation:
    """The same runs, as if nothing stood out."""
    assert found.search is not None
    assert found.gap is not None
    search = replace(found.search, after=found.search.before, named=(), rounds=found.search.rounds[:1], sets=())
    gap = replace(found.gap, closed=found.gap.refit, wrong=None, wrong_name="")
    return replace(
        found,
        verdict=NothingMissing(),
        findings=(),
        search=search,
        gap=gap,
        local=np.ones_like(found.local),
    )


class Page(HTMLParser):
    """What a page says and shows."""

    def __init__(self, folder: Path, found: Explanation, provenance: Provenance = PROVENANCE) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.said: list[str] = []
        self.figures: list[str] = []
        self.gap: list[tuple[str, str]] = []
        self._numbers = False
        self._silent = False
        path = folder / "gap.html"
        write_page(path, answer_of(found, draw=True), provenance)
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)
        self.text = " ".join(" ".join(self.said).split())
        content = re.search(r'<script type="application/json" id="data">(.*?)</script>', self.source, re.DOTALL)
        assert content
        self.data: dict[str, Any] = json.loads(content[1], parse_constant=self._no_constant)

    @staticmethod
    def _no_constant(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._silent = tag in {"script", "style"}
        attributes = dict(attrs)
        if "data-chart" in attributes:
            self.figures.append(attributes["data-chart"] or "")
        if "data-key" in attributes:
            self.gap.append((attributes["data-key"] or "", ""))
            self._numbers = True

    def handle_endtag(self, tag: str) -> None:
        if tag in {"script", "style"}:
            self._silent = False

    def handle_data(self, data: str) -> None:
        if self._silent:
            return
        self.said.append(data)
        if self._numbers:
            self.gap[-1] = (self.gap[-1][0], data)
            self._numbers = False


def sound(page: Page) -> None:
    """What holds of every page."""
    assert not re.search(r"https?:|//[a-z]|\bsrc\s*=|@import|url\(|\bimport\b|fetch\(|XMLHttp", page.source)
    assert not re.search(r"\b(nan|inf|True|False|None(?! of it))\b", page.text)
    assert page.tags.count("script") == 3  # the labels of narrow tables, the numbers, the charts
    assert sorted(page.figures) == sorted(page.data["charts"])
    assert len(page.source) < 500_000
    for chart in page.data["charts"].values():
        assert chart["series"]
        lines = [line for line in chart["series"] if "x" not in line]
        assert all(len(line["y"]) == len(page.data["times"][chart["time"]]) for line in lines)
        assert sum(len(line["x"]) for line in chart["series"] if "x" in line) <= 1500
        assert any(y is not None for line in chart["series"] for y in line["y"])
    for text in (PROVENANCE.command, PROVENANCE.version, *HASHES):
        assert text in page.text


@pytest.mark.slow
def test_named(tmp_path: Path, friction: Explanation) -> None:
    page = Page(tmp_path, friction)
    sound(page)
    assert friction.sentence in page.text
    assert friction.where in page.text
    gap, search = friction.gap, friction.search
    assert gap is not None
    assert search is not None
    expected = [("delivered", gap.delivered), ("refit", gap.refit), ("closed", gap.closed), ("floor", gap.floor)]
    assert page.gap == [(name, f"{figure(one.gap)} σ") for name, one in expected]
    for _, one in expected:
        assert f"median {figure(one.median)} 90th percentile {figure(one.tenth)}" in page.text
    assert f"{figure(gap.refit.gap / gap.closed.gap)} × refit / closed" in page.text
    for candidate in search.rounds[0]:
        joint = "the base" if candidate.joint < 0 else friction.arm.joints[candidate.joint].name
        assert f"{candidate.kind.title}, {joint}" in page.text
    for value in friction.values:
        assert f"<code>{value.name}</code>" in page.source
    # friction is a step over the rate of its motor: against the motion on either side
    chart = page.data["charts"]["rate-1"]
    bare = next(line for line in chart["series"] if line["colour"] == "without")
    rate, torque = np.array(page.data["times"]["rate-1"]), np.array([np.nan if y is None else y for y in bare["y"]])
    np.testing.assert_allclose(np.nanmedian(torque[rate < -0.02]), 0.05, rtol=0.1)
    np.testing.assert_allclose(np.nanmedian(torque[rate > 0.02]), -0.05, rtol=0.1)


@pytest.mark.slow
def test_torques_of_the_untouched_run_and_run_against_run(tmp_path: Path, friction: Explanation) -> None:
    """Friction at the elbow is the torque that the delivered model lacks there, against the motion on either side."""
    page = Page(tmp_path, friction)
    (left,) = [*joint_torques(friction.validated[0], [as_delivered(friction), friction.closed])][1:]
    delivered, closed = (left.measured - needed for needed in left.needed if needed is not None)
    for side in (left.rate > 0.02, left.rate < -0.02):
        sign = np.sign(left.rate[side][0])
        np.testing.assert_allclose(np.nanmedian(delivered[side]), 0.05 * sign, rtol=0.15)
        assert abs(np.nanmedian(closed[side])) < 0.01
    # the mean of the reported torque over the windows
    record = friction.validated[0]
    assert np.nanstd(left.measured) == pytest.approx(np.nanstd(record.readings().tau[..., 1]), rel=0.05)
    wanted = {"torque-1", "torque-1-left", "torque-1-rate", "torque-1-angle", "torque-1-deflection"}
    assert wanted <= set(page.data["charts"])
    assert "Run against run" in page.text
    assert page.text.count("motor_coulomb2") >= 1


def test_nothing_missing_leads_with_the_limits(tmp_path: Path, friction: Explanation) -> None:
    page = Page(tmp_path, nothing(friction))
    sound(page)
    assert page.text.index("What would have been seen") < page.text.index("Where ρ")
    assert "detection limit" in page.text
    assert friction.search is not None
    for candidate in friction.search.rounds[0]:
        assert figure(candidate.limit, 2) in page.text


def test_values_differ_leads_with_the_values(tmp_path: Path, friction: Explanation) -> None:
    found = nothing(friction)
    names = [value.name for value in found.values]
    values = list(found.values)
    k = names.index("k1")
    values[k] = replace(values[k], found=0.8 * values[k].delivered)
    page = Page(tmp_path, replace(found, verdict=ValuesDiffer((values[k],)), values=tuple(values)))
    sound(page)
    assert page.text.index("Which values differ") < page.text.index("Where ρ")
    assert "−20.00 ◂" in page.text
    assert page.text.count("◂") == 1


def test_unknown_adopts_nothing(tmp_path: Path, friction: Explanation) -> None:
    verdict = Unexplained(3.0, ("motor_coulomb2",), 0.7, friction.findings)
    found = replace(friction, verdict=verdict, findings=(), adopted=None, remarks=(NoFloor("a remark"),))
    page = Page(tmp_path, found)
    sound(page)
    assert "Part of it looks like Coulomb friction at the motor (elbow)" in page.text
    assert "a remark" in page.text
    assert "None of it is adopted" in page.source
    assert "best guess, not adopted" in page.text


def test_a_run_that_is_not_predicted_is_unknown_though_every_balance_closes(
    tmp_path: Path, friction: Explanation
) -> None:
    lost = Unpredicted("run_c.blf", 67.7, 9.25)
    found = replace(nothing(friction), verdict=lost, adopted=None)
    page = Page(tmp_path, found)
    sound(page)
    assert found.answer == "unknown"
    assert "run_c.blf is predicted with a median error of 67.7 σ, where noise" in page.text
    assert "make at most 9.25 σ" in page.text
    assert "see which signal is predicted worst, and when" in found.remedy


def test_far_off_is_what_the_twin_with_redrawn_values_does_not_reach(friction: Explanation) -> None:
    gap = friction.gap
    assert gap is not None and far_off(gap) is None
    least = max(one.median for one in (gap.floor, *gap.reach))

    def of(ratio: float) -> Gap:
        return replace(gap, closed=replace(gap.floor, residual=gap.floor.residual * (ratio * least / gap.floor.median)))

    assert far_off(of(4.9)) is None
    found = far_off(of(5.1))
    assert found is not None
    assert found.run == gap.runs[0]
    assert found.median / found.allowed == pytest.approx(5.1)


def test_cannot_tell_names_the_set_and_the_experiment(tmp_path: Path, friction: Explanation) -> None:
    finding = replace(friction.findings[0], instead=("motor_viscous2",))
    experiments = (Experiment(0.5, 1.5, 31.0, 2.5),)
    assert friction.search is not None
    search = replace(friction.search, sets=(("motor_coulomb2", "motor_viscous2"),))
    found = replace(
        friction,
        verdict=Inseparable((finding,)),
        findings=(finding,),
        search=search,
        experiments=experiments,
        adopted=None,
    )
    page = Page(tmp_path, found)
    sound(page)
    assert "cannot tell it from viscous friction at the motor (elbow)" in page.text
    assert f"{motion(experiments[0])} 31.0 2.50" in page.text


def test_timing_first_and_no_untouched_run(tmp_path: Path, friction: Explanation) -> None:
    bent = Deflection("elbow", 1e-4, 1e-6, 0.003, 0.99)
    skewed = SkewedEncoders("elbow", 0.003)
    found = replace(nothing(friction), verdict=skewed, search=None, gap=None, adopted=None, deflections=(bent,))
    page = Page(tmp_path, found)
    sound(page)
    assert page.gap == []
    assert "No run was kept apart" in page.text
    assert "No candidate was tried" in page.text
    assert "as if one encoder latched 3.00 ms after the other" in page.text


def test_rigid_joints_and_predictions_that_run_away(tmp_path: Path, friction: Explanation) -> None:
    values = [replace(v, delivered=np.inf, delivered_sigma=0.0) if v.name == "k1" else v for v in friction.values]
    values = [replace(v, delivered=0.0, delivered_sigma=0.0) if v.name == "b1" else v for v in values]
    gap = friction.gap
    assert gap is not None
    lost = gap.delivered.residual.copy()
    lost[0] = np.inf
    gap = replace(gap, delivered=replace(gap.delivered, residual=lost))
    page = Page(tmp_path, replace(friction, values=tuple(values), gap=gap))
    sound(page)
    assert "k1 rigid" in page.text
    assert "was rigid" in page.text
    assert page.gap[0] == ("delivered", "diverges")


@pytest.mark.parametrize("adopted", [True, False])
def test_names_cannot_break_the_page(tmp_path: Path, friction: Explanation, adopted: bool) -> None:
    was = friction.simulation
    arm = replace(
        friction.arm, name=HOSTILE, joints=tuple(replace(j, name=j.name + HOSTILE) for j in friction.arm.joints)
    )
    model = replace(was, name=HOSTILE, joints=tuple(replace(j, name=j.name + HOSTILE) for j in was.joints))
    findings = tuple(replace(f, joint=f"{f.joint}{HOSTILE}") for f in friction.findings)
    records = tuple(replace(r, path=Path(f"r{HOSTILE}")) for r in friction.refit.records)
    found = replace(
        friction,
        arm=arm,
        simulation=model,
        refit=replace(friction.refit, records=records),
        findings=findings,
        verdict=Lacking(findings) if adopted else NotPredicted(findings, 2.0, 1.0),
        whereabouts=replace(friction.whereabouts, named=findings),
        remarks=(NoFloor(HOSTILE), BrokenRun(HOSTILE, 0.5)),
    )
    files = tuple((HOSTILE, HOSTILE, digest) for digest in HASHES)
    page = Page(tmp_path, found, replace(PROVENANCE, command=PROVENANCE.command + HOSTILE, files=files))
    sound(page)
    assert HOSTILE not in page.source
    assert page.text.count(HOSTILE) > 12


def test_figures() -> None:
    assert [figure(x) for x in (0.9995, 20.017, 73564.4, 0.0, -0.0001147, np.nan, np.inf)] == [
        "1.00",
        "20.0",
        "73,564",
        "0",
        "−1.15·10⁻⁴",
        "–",
        "–",
    ]
    assert figure(0.0012, 2) == "0.0012"
    assert figure(-5.0, 3) == "−5.00"

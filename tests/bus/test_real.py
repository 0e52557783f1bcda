# SPDX-License-Identifier: MIT
"""`make real`: measured runs, from the frames of their drives to a validated model, within the limits that are set."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from cli_support import in_process

from conftest import ROOT, need
from zygos.demo import real
from zygos.demo.kr300 import write_kr300
from zygos.errors import ZygosError

KR300 = ROOT.parent / "shared" / "data" / "kr300" / "run_a.mat"

Content = dict[str, Any]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Content, int]:
    """The folder, the JSON and the exit code."""
    folder = tmp_path_factory.mktemp("real")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.delenv("CI", raising=False)
        patch.setattr(real.subprocess, "run", in_process)
        code = 0
        try:
            real.main(["--folder", str(folder), "--kr300", str(KR300)])
        except SystemExit as end:
            code = int(end.code or 0)
    return folder, json.loads((folder / "real.json").read_text()), code


def held_out(content: Content, recording: str, joint: str) -> Content:
    (one,) = [x for x in content["held_out"] if (x["recording"], x["joint"]) == (recording, joint)]
    return dict(one)


CASES = [("03", "shoulder", 0.27), ("03", "elbow", 0.20), ("11", "shoulder", 0.70), ("11", "elbow", 0.14)]


@pytest.mark.slow
@pytest.mark.parametrize(("recording", "joint", "limit"), CASES)
def test_held_out_torques_are_predicted(
    made: tuple[Path, Content, int], recording: str, joint: str, limit: float
) -> None:
    one = held_out(made[1], recording, joint)
    assert one["limit"] == limit
    assert one["zygos"] <= limit


@pytest.mark.slow
@pytest.mark.parametrize(("recording", "joint"), [case[:2] for case in CASES])
def test_held_out_torques_are_predicted_as_by_batch_least_squares(
    made: tuple[Path, Content, int], recording: str, joint: str
) -> None:
    one = held_out(made[1], recording, joint)
    assert one["zygos"] <= 1.05 * one["batch"]


@pytest.mark.slow
def test_values_are_those_of_the_publication(made: tuple[Path, Content, int]) -> None:
    values = {one["name"]: one for one in made[1]["values"]}
    for name in ("mz1", "Ixx1", "mz2", "Ixx2"):
        one = values[name]
        assert one["value"] == pytest.approx(one["published"], rel=0.05)
        assert abs(one["value"] - one["published"]) <= 1.2 * one["half95"]
    assert values["Ixx1"]["published"] == pytest.approx(0.05347 + 0.60435 * 0.3**2 + 36 * 7.6593e-05, rel=1e-4)
    assert values["Ixx1"]["stands_for"] == "Ixx1 + 0.09 m2 + 36 Im1"


@pytest.mark.slow
def test_the_answer_says_what_it_cannot_and_ends_accordingly(made: tuple[Path, Content, int]) -> None:
    _, content, code = made
    assert content["validity"] == "partial"
    assert "what is left is not noise" in content["reason"]
    assert code == (0 if content["good"] else 3)
    assert content["good"] == all(one["good"] for one in content["held_out"])


@pytest.mark.slow
def test_what_the_published_model_lacks_without_friction_is_told(made: tuple[Path, Content, int]) -> None:
    folder, _, _ = made
    assert "Coulomb friction" in (folder / "gap.html").read_text()
    picture = (folder / "gap.svg").read_text()
    assert "torque of the elbow in recording 03" in picture and "with what was found" in picture


@pytest.mark.slow
def test_the_page_is_whole(made: tuple[Path, Content, int]) -> None:
    folder, content, _ = made
    text = (folder / "real.html").read_text()
    assert not re.search(r'(?:src|href)="(?:https?:)?//', text)
    for part in ("compared", "values", "kr300", "parameters", "joints", "runs", "run-1", "run-2"):
        assert f'id="{part}"' in text
    assert content["reason"] in text
    data = json.loads(text[text.index('id="data">') + 10 : text.index("</script>", text.index('id="data">'))])
    assert set(data["charts"]) == {
        f"{kind}-{run}-{joint}" for kind in ("torque", "error") for run in "01" for joint in "01"
    }
    for chart in data["charts"].values():
        assert all(len(line["y"]) == len(data["times"][chart["time"]]) > 100 for line in chart["series"])
        assert f'data-chart="{chart["id"]}"' in text


def test_the_encoders_of_the_kr300_are_skewed(made: tuple[Path, Content, int]) -> None:
    need(KR300.is_file(), f"{KR300}, a run of a KUKA KR300 (docs/check-arm.md)")
    skews = made[1]["kr300"]
    assert [one["axis"] for one in skews] == ["a1", "a2", "a3"]
    assert all(one["reported"] and one["skew_ms"] == pytest.approx(3.05, abs=0.15) for one in skews)


def test_a_missing_run_is_said_and_in_ci_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CI", raising=False)
    assert real.audited(tmp_path / "run_a.mat", tmp_path) is None
    monkeypatch.setenv("CI", "1")
    with pytest.raises(ZygosError, match="missing in CI; remedy"):
        real.audited(tmp_path / "run_a.mat", tmp_path)
    (tmp_path / "bad.mat").write_text("no matrix")
    with pytest.raises(ZygosError, match="not the run of the KR300"):
        write_kr300(tmp_path / "bad.mat", tmp_path)


def test_outside_a_checkout_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        real.main([])
    assert end.value.code == 2
    assert "remedy: run inside a checkout" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())

# SPDX-License-Identifier: MIT
"""A short form of `make soak`, and what it says of a library that does not do what it should."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from soak.__main__ import main, others
from soak.endurance import SOAKS, Outcome, fly
from soak.page import page
from verify.result import digest


@pytest.fixture(scope="module")
def seven_hours(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Half a million cycles of two joints, with a snapshot every hour."""
    soak = replace(SOAKS["two"], resumed_s=3600.0)
    return fly(soak, 0.01, tmp_path_factory.mktemp("soak"), 1, lambda _: None)


def test_seven_hours_of_frames(seven_hours: Outcome) -> None:
    assert seven_hours.failures == []
    assert seven_hours.resumed == 7
    assert seven_hours.lost > 200
    assert seven_hours.stale > 10
    assert [look.validity for look in seven_hours.looks] == ["valid"] * 10
    assert {"counter", "dropped", "incomplete", "late", "sync_jumped", "cycles"} == set(seven_hours.found)
    assert f"| {seven_hours.looks[-1].covered} of 12 | exact | pass |" in page([seven_hours])


def test_what_does_not_hold_is_named(seven_hours: Outcome) -> None:
    last = seven_hours.looks[-1]

    def failures(**changes: object) -> list[str]:
        return replace(seven_hours, **changes).failures  # type: ignore[arg-type]

    (counters,) = failures(found=seven_hours.found | {"late": 0})
    assert "'late': 0" in counters
    (validity,) = failures(looks=[replace(last, validity="refused", reason="too few"), last])
    assert "is refused: too few" in validity
    (partial,) = failures(wanted="partial", looks=[last])
    assert "is valid" in partial
    (coverage,) = failures(looks=[replace(last, covered=8)])
    assert coverage.startswith("8 of 12 intervals contain the true value, which is below 76 %")
    (wrong,) = failures(looks=[replace(last, wrong=1), last])
    assert "more than 5 sigmas and 0.5 %" in wrong


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["two", "--share", "0.0005", "--json", str(tmp_path / "soak.json")])
    assert ended.value.code == 0
    (one,) = json.loads((tmp_path / "soak.json").read_text())["soaks"]
    assert one["failures"] == []
    assert "exact" in capsys.readouterr().out
    with pytest.raises(SystemExit) as ended:
        main(["three"])
    assert ended.value.code == 2
    assert "there is no soak 'three'; remedy: use some of two, seven" in capsys.readouterr().err


def test_results_of_other_sources_do_not_stay(seven_hours: Outcome, tmp_path: Path) -> None:
    file = tmp_path / "soak.json"
    assert others(file) == []
    stored = {"sources": digest(), "soaks": [seven_hours.as_json()]}
    file.write_text(json.dumps(stored))
    assert others(file) == [seven_hours]
    file.write_text(json.dumps(stored | {"sources": "of another library"}))
    assert others(file) == []


@pytest.mark.parametrize("content", ["{", '{"soaks": [{"name": "two"}]}', '{"soaks": [1]}', "[]", "{}"])
def test_a_damaged_file_of_results_is_refused(content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "soak.json"
    file.write_text(content)
    with pytest.raises(SystemExit) as ended:
        main(["two", "--json", str(file)])
    assert ended.value.code == 2
    assert "soak.json: no results of a soak; remedy: remove the file" in capsys.readouterr().err
    assert file.read_text() == content

# SPDX-License-Identifier: MIT
"""The pages of estimates on the ground and of predictions."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ground_support import recorded, short_arm

from zygos.gap.predict import predict
from zygos.gap.prediction import answer_of
from zygos.ground.estimate import GroundEstimate, estimate_ground
from zygos.ground.sections import estimate_answer
from zygos.model.model import Model
from zygos.report.html import write_page
from zygos.report.provenance import Provenance

NOWHERE = Provenance("zygos estimate", "1.2.3", ())


@cache
def _found() -> tuple[GroundEstimate, Model]:
    arm, model = short_arm(2)
    runs = [recorded(arm, model, path=k, seed=k, seconds=8.0) for k in range(2)]
    return estimate_ground(runs, validate=[recorded(arm, model, path=2, seed=2, seconds=8.0)]), model


def _data(text: str) -> dict[str, Any]:
    begin = text.index('id="data">') + 10
    return dict(json.loads(text[begin : text.index("</script>", begin)]))


@pytest.mark.slow
def test_an_estimate_shows_what_it_says(tmp_path: Path) -> None:
    found, _ = _found()
    write_page(tmp_path / "page.html", estimate_answer(found, written="learned.toml written", draw=True), NOWHERE)
    text = (tmp_path / "page.html").read_text()
    assert f'<span class="tag {"good" if found.validity == "valid" else "open"}">{found.validity}</span>' in text
    assert "learned.toml written" in text
    for name in found.names:
        assert f"<code>{name}</code>" in text
    for joint in found.arm.joints:
        assert joint.name in text
    assert text.count("<td>from ") == 2, "run against run"
    validated = found.validated[0]
    chart = _data(text)["charts"]["torque-0-1"]
    times = _data(text)["times"]["run0"]
    at = [int(np.argmin(np.abs(validated.t - t))) for t in times]
    measured, predicted = (np.array(line["y"]) for line in chart["series"])
    assert np.allclose(measured, validated.measured[at, 1], rtol=1e-5, atol=1e-6)
    assert np.allclose(predicted, validated.predicted[at, 1], rtol=1e-5, atol=1e-6)
    error = np.array(_data(text)["charts"]["error-0-1"]["series"][0]["y"])
    assert np.allclose(error, measured - predicted, atol=1e-3)  # six digits are drawn


def test_a_refusal_has_its_reason_and_no_values(tmp_path: Path) -> None:
    found, _ = _found()
    solution = replace(found.solution, held_out=3.0 * found.solution.measured, seen=np.zeros_like(found.solution.seen))
    refused = replace(found, solution=solution, validated=(), doubtful=False)
    assert refused.validity == "refused"
    write_page(tmp_path / "page.html", estimate_answer(refused, written="no model written", draw=True), NOWHERE)
    text = (tmp_path / "page.html").read_text()
    assert "worse than none would" in text
    assert "<b>Remedy:</b> check units, signs" in text
    assert "There are no values." in text
    assert _data(text)["charts"] == {}


def test_a_hostile_name_stays_text(tmp_path: Path) -> None:
    found, _ = _found()
    hostile = "</script><script>alert(1)</script>"
    arm = replace(found.arm, name=hostile)
    write_page(tmp_path / "page.html", estimate_answer(replace(found, arm=arm), written=hostile, draw=True), NOWHERE)
    assert hostile not in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_predictions_of_two_runs(tmp_path: Path) -> None:
    found, model = _found()
    write_page(tmp_path / "page.html", answer_of([predict(model, run) for run in found.runs], draw=True), NOWHERE)
    text = (tmp_path / "page.html").read_text()
    assert 'id="run-1"' in text
    assert 'id="run-2"' in text
    assert 'id="parameters"' not in text
    assert len(_data(text)["charts"]) == 4 * found.arm.n


def test_currents_have_no_kilograms_and_newton_metres(tmp_path: Path) -> None:
    arm, model = short_arm(2)
    amperes = replace(arm, torque_unit="A")
    runs = [replace(recorded(arm, model, path=k, seed=k, seconds=8.0), arm=amperes) for k in range(2)]
    found = estimate_ground(runs[:1], validate=runs[1:])
    write_page(tmp_path / "page.html", estimate_answer(found, draw=True), NOWHERE)
    text = (tmp_path / "page.html").read_text()
    for unit in ("N m", "kg", "Nm"):
        assert not re.search(rf"(?<![\w]){unit}(?![\w])", text.replace("_nm", "")), unit
    assert {unit for unit in found.units if "N" in unit or "kg" in unit} == set()
    assert found.validated[0].as_dict()["unit"] == "A"

# SPDX-License-Identifier: MIT
"""Answers on arms whose plant is MuJoCo's: single cells of `make gap`, most of them with runs of half the length."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from oracles.cells import case, cell_named
from oracles.trials import ask, make

pytestmark = pytest.mark.slow


def _asked(cell: str, folder: Path, draw: int = 0, part: float = 0.5) -> tuple[dict[str, Any], float]:
    """The verdict on the first part of the cell's runs, and the size of what was hidden."""
    one = case(cell_named(cell), draw)
    true = make(one, folder, part * one.plant.trial.scenarios[0].duration_s)
    verdict, message = ask(one, folder)
    assert verdict, message
    return verdict, true.effects[0].size if true.effects else 0.0


def test_a_ripple_is_found_where_the_usual_entries_leave_something_over(tmp_path: Path) -> None:
    verdict, size = _asked("pendulum/ripple/shoulder/x3", tmp_path)
    # a weak third harmonic is hidden beside it
    assert verdict["answer"] == "part named", verdict["sentence"]
    ((effect, joint, value),) = [(f["effect"], f["joint"], f["value"]) for f in verdict["findings"]]
    assert (effect, joint) == ("ripple_sin", "shoulder")
    assert value == pytest.approx(size, rel=0.03)


def test_nothing_is_missing_where_the_twin_leaves_as_much(tmp_path: Path) -> None:
    verdict, _ = _asked("pendulum/null", tmp_path, draw=26)
    assert verdict["answer"] == "nothing missing", verdict["sentence"]


def test_where_nothing_is_missing_the_whole_catalogue_has_limits(tmp_path: Path) -> None:
    verdict, _ = _asked("planar/null", tmp_path)
    assert verdict["answer"] == "nothing missing"
    assert all(one["limit"] > 0.0 for one in verdict["limits"])
    limits = {one["name"].partition("@")[0] for one in verdict["limits"]}
    assert {"motor_stribeck1", "motor_stribeck2", "ripple_sin1", "ripple_cos2"} <= limits
    assert {"load_friction1", "backlash2", "torque_gain2", "link_scale1", "base_torque", "gyro_scale"} <= limits


def test_a_zero_of_an_encoder_is_stated_as_such(tmp_path: Path) -> None:
    verdict, size = _asked("planar/motor_zero/elbow/x30", tmp_path)
    assert verdict["answer"] == "nothing missing", verdict["sentence"]
    (zero,) = verdict["zeros"]
    assert (zero["name"], zero["unit"]) == ("motor_zero2", "rad")
    assert zero["value"] == pytest.approx(size, rel=0.05)


def test_on_the_ground_nothing_is_named_in_whole_while_more_than_noise_is_left(tmp_path: Path) -> None:
    """Predictions close, because what is hidden is small; increments show it."""
    verdict, _ = _asked("pendulum/without/torque_lag/elbow", tmp_path)
    assert verdict["answer"] == "plain estimate", verdict["sentence"]


def test_coarse_encoders_do_not_hide_what_torque_sensors_do_to_predictions(tmp_path: Path) -> None:
    """Offsets of up to 3 % and a gain of up to 2 %, of which nobody declared anything; the balances show no noise."""
    verdict, size = _asked("coarse/motor_viscous/shoulder/x30", tmp_path)
    assert verdict["answer"] == "named", verdict["sentence"]
    (found,) = verdict["findings"]
    assert (found["effect"], found["joint"]) == ("motor_viscous", "shoulder")
    assert found["value"] == pytest.approx(size, rel=0.005)
    assert any("an offset and a gain of each torque sensor" in one for one in verdict["remarks"])


@pytest.mark.parametrize(
    ("cell", "draw", "part", "answer"), [("null", 5, 0.5, "nothing missing"), ("values", 0, 1.0, "values differ")]
)
def test_an_offset_that_noisy_torques_may_have_is_nothing_that_is_missing(
    cell: str, draw: int, part: float, answer: str, tmp_path: Path
) -> None:
    verdict, _ = _asked(f"coarse/{cell}", tmp_path, draw, part)
    assert verdict["answer"] == answer, verdict["sentence"]

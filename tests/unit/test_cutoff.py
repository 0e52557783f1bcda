# SPDX-License-Identifier: MIT
"""The cut-off of the smoother's rates, against the response of the filter to sines, and the arm files that state it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from zygos.arm import Arm, load_arm, save_arm
from zygos.cutoff import HALF_WIDTH_MAX, ORDERS, periods, rate_cutoff, window
from zygos.errors import ZygosError
from zygos.runs.smoother import coefficients


def gain(points: int, order: int, f: float) -> float:
    """Of the rate of a sine of f cycles per sample, by the smoother's own weights."""
    at = np.arange(points) - points // 2
    return float(coefficients(points, order, 0.0, 1) @ np.sin(2 * math.pi * f * at)) / (2 * math.pi * f)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("half", [3, 7, 15, HALF_WIDTH_MAX])
def test_rates_at_the_cutoff_are_3_db_down(half: int, order: int) -> None:
    f = rate_cutoff(half, order)
    assert gain(2 * half + 1, order, f) == pytest.approx(math.sqrt(0.5), abs=2e-4)
    assert all(gain(2 * half + 1, order, share * f) > math.sqrt(0.5) for share in np.linspace(0.01, 0.99, 50))


def arm_with(tmp_path: Path, smoother: str, period_s: float = 0.01) -> Arm:
    text = (ROOT / "examples" / "telemetry" / "arm.toml").read_text()
    text = text.replace("period_s = 0.05", f"period_s = {period_s}")
    assert "[smoother]" not in text
    (tmp_path / "arm.toml").write_text(f"{text}\n[smoother]\n{smoother}\n")
    return load_arm(tmp_path / "arm.toml")


@pytest.mark.parametrize(("cutoff", "order"), [(5.0, 4), (2.1, 4), (9.5, 4), (1.5, 2)])
def test_points_and_order_follow_from_the_cutoff(cutoff: float, order: int, tmp_path: Path) -> None:
    """No neighbouring window of that order is nearer."""
    arm = arm_with(tmp_path, f"cutoff_hz = {cutoff}")
    points = arm.smoother.points
    assert (arm.smoother.order, arm.smoother.lag) == (order, points // 2)
    miss = {p: abs(math.log(rate_cutoff(p // 2, order) * 100.0 / cutoff)) for p in (points - 2, points, points + 2)}
    assert min(miss, key=lambda p: miss[p]) == points
    save_arm(arm, tmp_path / "again.toml")
    assert load_arm(tmp_path / "again.toml") == arm
    assert arm.at_period(0.02).smoother == arm_with(tmp_path, f"cutoff_hz = {cutoff}", 0.02).smoother


def test_the_periods_named_are_the_limits() -> None:
    shortest, longest = periods(5.0)
    for period in (shortest * 1.0001, longest * 0.9999):
        assert window(5.0, period) is not None
    assert window(5.0, shortest * 0.999) is not None  # of order 2
    assert window(5.0, longest * 1.001) is None


REFUSED = [
    (
        "cutoff_hz = 0.5",
        r"smoother\.cutoff_hz: cut-off 0\.5 Hz needs a period of at least 39\.\d ms with 63 points, not 10",
    ),
    ("cutoff_hz = 30.0", r"cut-off 30 Hz needs a period of at most 6\.47 ms with 7 points.*remedy: change period_s"),
    ("cutoff_hz = 5.0\npoints = 7", r"smoother\.points: is given with cutoff_hz.*remedy: state one of the two"),
    ("cutoff_hz = 5.0\norder = 4", r"smoother\.order: is given with cutoff_hz"),
    ("cutoff_hz = 0.0", r"smoother\.cutoff_hz: 0 is out of range"),
]


@pytest.mark.parametrize(("smoother", "message"), REFUSED)
def test_cutoffs_that_are_refused(smoother: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ZygosError, match=message):
        arm_with(tmp_path, smoother)


def test_another_period_that_does_not_allow_the_cutoff_is_refused(tmp_path: Path) -> None:
    arm = arm_with(tmp_path, "cutoff_hz = 5.0")
    with pytest.raises(ZygosError, match="cut-off 5 Hz needs a period of at most 38"):
        arm.at_period(0.05)

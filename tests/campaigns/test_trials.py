"""Answers on arms whose plant is MuJoCo's: single cells of `make gap`."""

from __future__ import annotations

from pathlib import Path

import pytest

from oracles.cells import case, cell_named
from oracles.trials import ask, make

pytestmark = pytest.mark.slow


def _asked(cell: str, draw: int, folder: Path) -> dict:  # type: ignore[type-arg]
    make(case(cell_named(cell), draw), folder)
    verdict, message = ask(case(cell_named(cell), draw), folder)
    assert verdict, message
    return verdict


def test_a_ripple_is_found_where_the_usual_entries_leave_something_over(tmp_path: Path) -> None:
    verdict = _asked("pendulum/ripple/shoulder/x3", 0, tmp_path)
    assert verdict["answer"] == "named", verdict["sentence"]
    ((effect, joint, value),) = [(f["effect"], f["joint"], f["value"]) for f in verdict["findings"]]
    assert (effect, joint) == ("ripple_sin", "shoulder")
    assert value == pytest.approx(0.0036, rel=0.03)


def test_a_payload_that_is_taken_up_in_the_second_run_is_found_in_kg(tmp_path: Path) -> None:
    verdict = _asked("pendulum/payload", 0, tmp_path)
    assert verdict["answer"] == "changed", verdict["sentence"]
    (size,) = [one["new"] for one in verdict["change"]["coefficients"] if one["name"] == "m2"]
    assert size == pytest.approx(0.055, rel=0.02)


def test_nothing_changed_where_noise_is_all_that_is_left(tmp_path: Path) -> None:
    assert _asked("pendulum/null", 26, tmp_path)["answer"] == "nothing missing"


@pytest.mark.parametrize(("place", "size"), [("viscous_asymmetry/elbow", 0.31), ("load_friction/elbow", 0.003)])
def test_a_law_of_the_second_round_is_named(place: str, size: float, tmp_path: Path) -> None:
    verdict = _asked(f"planar/{place}/x30", 0, tmp_path)
    assert verdict["answer"] in {"named", "part named"}, verdict["sentence"]
    first = verdict["findings"][0]
    assert f"{first['effect']}/{first['joint']}" == place
    assert first["value"] == pytest.approx(size, rel=0.05)

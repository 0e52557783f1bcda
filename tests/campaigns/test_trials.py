"""Answers on arms whose plant is MuJoCo's: single cells of `make gap`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from oracles.cells import case, cell_named
from oracles.trials import ask, make

pytestmark = pytest.mark.slow


def _asked(cell: str, draw: int, folder: Path) -> tuple[dict[str, Any], float]:
    """The verdict, and the size of what was hidden."""
    true = make(case(cell_named(cell), draw), folder)
    verdict, message = ask(case(cell_named(cell), draw), folder)
    assert verdict, message
    return verdict, true.effects[0].size if true.effects else 0.0


def test_a_ripple_is_found_where_the_usual_entries_leave_something_over(tmp_path: Path) -> None:
    verdict, size = _asked("pendulum/ripple/shoulder/x3", 0, tmp_path)
    # a weak third harmonic is hidden beside it
    assert verdict["answer"] == "part named", verdict["sentence"]
    ((effect, joint, value),) = [(f["effect"], f["joint"], f["value"]) for f in verdict["findings"]]
    assert (effect, joint) == ("ripple_sin", "shoulder")
    assert value == pytest.approx(size, rel=0.03)


def test_a_payload_that_is_taken_up_in_the_second_run_is_found_in_kg(tmp_path: Path) -> None:
    verdict, _ = _asked("pendulum/payload", 0, tmp_path)
    assert verdict["answer"] == "changed", verdict["sentence"]
    (size,) = [one["new"] for one in verdict["change"]["coefficients"] if one["name"] == "m2"]
    assert size == pytest.approx(0.055, rel=0.02)


@pytest.mark.parametrize(("cell", "draw"), [("pendulum/null", 26), ("six/null", 11)])
def test_nothing_is_missing_where_the_twin_leaves_as_much(cell: str, draw: int, tmp_path: Path) -> None:
    """Smoothing and quadrature leave twice as much as noise does at a joint of the second."""
    verdict, _ = _asked(cell, draw, tmp_path)
    assert verdict["answer"] == "nothing missing", verdict["sentence"]


@pytest.mark.parametrize("joint", ["shoulder", "elbow"])
def test_friction_that_falls_with_the_rate_is_named_in_part_on_the_ground(joint: str, tmp_path: Path) -> None:
    """What is hidden falls otherwise than the column, and at the elbow a wrong gain of the torques is beside it."""
    verdict, _ = _asked(f"pendulum/motor_stribeck/{joint}/x30", 0, tmp_path)
    assert verdict["answer"] == "part named", verdict["sentence"]
    assert [(one["effect"], one["joint"]) for one in verdict["findings"]] == [("motor_stribeck", joint)]


@pytest.mark.parametrize("cell", ["planar/null", "pendulum/null"])
def test_where_nothing_is_missing_the_whole_catalogue_has_limits(cell: str, tmp_path: Path) -> None:
    verdict, _ = _asked(cell, 0, tmp_path)
    assert verdict["answer"] == "nothing missing"
    assert all(one["limit"] > 0.0 for one in verdict["limits"])
    limits = {one["name"].partition("@")[0] for one in verdict["limits"]}
    assert {"motor_stribeck1", "motor_stribeck2", "ripple_sin1", "ripple_cos2"} <= limits
    if cell == "planar/null":
        assert {"load_friction1", "backlash2", "torque_gain2", "link_scale1", "base_torque", "gyro_scale"} <= limits


@pytest.mark.parametrize("cell", ["planar/torque_gain/elbow/x3", "planar/viscous_asymmetry/shoulder/x3"])
def test_a_small_effect_is_not_taken_for_noise_of_the_torques(cell: str, tmp_path: Path) -> None:
    """What is hidden is three times the limit that the nulls state."""
    verdict, size = _asked(cell, 0, tmp_path)
    assert verdict["answer"] in {"named", "part named"}, verdict["sentence"]
    (found,) = verdict["findings"]
    assert f"planar/{found['effect']}/{found['joint']}/x3" == cell
    assert found["value"] == pytest.approx(size, rel=0.03)


def test_chatter_near_rest_is_not_taken_for_noise_of_the_torques(tmp_path: Path) -> None:
    verdict, size = _asked("planar/motor_stribeck/shoulder/x10", 0, tmp_path)
    assert verdict["answer"] == "named", verdict["sentence"]
    (found,) = verdict["findings"]
    assert (found["effect"], found["joint"]) == ("motor_stribeck", "shoulder")
    assert found["value"] == pytest.approx(size, rel=0.05)


def test_a_zero_of_an_encoder_is_stated_as_such(tmp_path: Path) -> None:
    verdict, size = _asked("planar/motor_zero/elbow/x30", 0, tmp_path)
    assert verdict["answer"] == "nothing missing", verdict["sentence"]
    (zero,) = verdict["zeros"]
    assert (zero["name"], zero["unit"]) == ("motor_zero2", "rad")
    assert zero["value"] == pytest.approx(size, rel=0.05)


@pytest.mark.parametrize(
    ("without", "answer"), [("torque_lag", "unknown"), ("motor_viscous", "part named"), ("motor_coulomb", "part named")]
)
def test_on_the_ground_nothing_is_named_in_whole_while_more_than_noise_is_left(
    without: str, answer: str, tmp_path: Path
) -> None:
    """Predictions close, because what is hidden is small; increments show it."""
    verdict, _ = _asked(f"pendulum/without/{without}/elbow", 0, tmp_path)
    assert verdict["answer"] == answer, verdict["sentence"]


def test_a_drive_that_is_late_by_more_than_a_period_is_named_in_part(tmp_path: Path) -> None:
    """A low pass at one joint: the torque law of the arm file holds for all joints."""
    verdict, size = _asked("planar/torque_lag/shoulder/x30", 0, tmp_path)
    assert verdict["answer"] == "part named", verdict["sentence"]
    (found,) = verdict["findings"]
    assert (found["effect"], found["joint"]) == ("torque_lag", "shoulder")
    assert found["value"] == pytest.approx(size, rel=0.03)


@pytest.mark.parametrize("place", ["viscous_asymmetry/elbow", "load_friction/elbow"])
def test_a_law_of_the_second_round_is_named(place: str, tmp_path: Path) -> None:
    verdict, size = _asked(f"planar/{place}/x30", 0, tmp_path)
    assert verdict["answer"] in {"named", "part named"}, verdict["sentence"]
    first = verdict["findings"][0]
    assert f"{first['effect']}/{first['joint']}" == place
    assert first["value"] == pytest.approx(size, rel=0.05)


def test_what_only_the_untouched_run_shows_is_unknown(tmp_path: Path) -> None:
    """A cable that pulls towards an angle, beside torques whose noise, gains and offsets nobody declared: in two runs
    they take it up."""
    verdict, _ = _asked("planar/outside/cable_spring/shoulder", 0, tmp_path)
    assert verdict["answer"] == "unknown", verdict["sentence"]
    assert "every balance closes" in verdict["sentence"]


def test_a_friction_that_fades_is_not_taken_for_another_one(tmp_path: Path) -> None:
    """Viscous friction explains most, but is another in each run; Coulomb friction is the same, and explains less."""
    verdict, _ = _asked("planar/outside/warming_friction/elbow", 0, tmp_path)
    assert verdict["answer"] == "unknown", verdict["sentence"]
    assert "viscous friction at the motor (elbow)" in verdict["sentence"]


def test_a_law_that_is_left_out_does_not_come_back_at_the_end_of_a_shape(tmp_path: Path) -> None:
    """Friction of bristles that slide after 1e-4 rad is Coulomb friction, as is a peak that is wider than all rates."""
    verdict, _ = _asked("planar/without/motor_coulomb/elbow", 0, tmp_path)
    assert verdict["answer"] == "unknown", verdict["sentence"]


def test_two_laws_of_which_one_would_create_energy_are_no_name(tmp_path: Path) -> None:
    """A peak of friction below zero beside Coulomb friction looks like the viscous friction that is left out."""
    verdict, _ = _asked("planar/without/motor_viscous/elbow", 0, tmp_path)
    assert verdict["answer"] in {"part named", "unknown"}, verdict["sentence"]
    assert {found["effect"] for found in verdict["findings"]} <= {"motor_coulomb"}


def test_a_shape_that_no_run_tells_from_a_parameter_is_no_refusal(tmp_path: Path) -> None:
    """The gap next to the one that is found is wider than the spring ever bends."""
    verdict, _ = _asked("planar/backlash/elbow/x3", 0, tmp_path)
    assert verdict["answer"] in {"named", "part named", "nothing missing", "cannot tell"}, verdict["sentence"]


@pytest.mark.parametrize("cell", ["cubic_stiffness/elbow", "cubic_stiffness/shoulder", "motor_viscous/shoulder"])
def test_coarse_encoders_do_not_hide_what_torque_sensors_do_to_predictions(cell: str, tmp_path: Path) -> None:
    """Offsets of up to 3 % and a gain of up to 2 %, of which nobody declared anything; the balances show no noise."""
    verdict, size = _asked(f"coarse/{cell}/x30", 0, tmp_path)
    assert verdict["answer"] == "named", verdict["sentence"]
    (found,) = verdict["findings"]
    assert f"{found['effect']}/{found['joint']}" == cell
    assert found["value"] == pytest.approx(size, rel=0.005)
    assert any("an offset and a gain of each torque sensor" in one for one in verdict["remarks"])


@pytest.mark.parametrize(("cell", "draw", "answer"), [("null", 5, "nothing missing"), ("values", 0, "values differ")])
def test_an_offset_that_noisy_torques_may_have_is_nothing_that_is_missing(
    cell: str, draw: int, answer: str, tmp_path: Path
) -> None:
    verdict, _ = _asked(f"coarse/{cell}", draw, tmp_path)
    assert verdict["answer"] == answer, verdict["sentence"]


def test_a_large_error_of_a_sensor_is_found_with_its_size(tmp_path: Path) -> None:
    """To first order, the scale of the gyro would be 6 % larger than it is."""
    verdict, size = _asked("spatial/gyro_scale/base/x30", 0, tmp_path)
    assert verdict["answer"] == "named", verdict["sentence"]
    (found,) = verdict["findings"]
    assert found["effect"] == "gyro_scale"
    assert found["value"] == pytest.approx(size, rel=2e-3)


def test_what_the_untouched_run_refutes_stood_for_two_others(tmp_path: Path) -> None:
    """Coulomb friction at the yaw by itself explains 99.5 % of what is left over."""
    verdict, _ = _asked("spatial/pair/TanhCoulomb@yaw+LinkViscous@elbow", 0, tmp_path)
    assert verdict["answer"] == "named", verdict["sentence"]
    found = [(one["effect"], one["joint"]) for one in verdict["findings"]]
    assert found == [("motor_coulomb", "yaw"), ("link_viscous", "elbow")]


def test_limits_are_stated_beside_gains_of_torque_sensors(tmp_path: Path) -> None:
    verdict, _ = _asked("pendulum/motor_stribeck/shoulder/x10", 0, tmp_path)
    assert verdict["answer"] == "nothing missing", verdict["sentence"]
    assert any("torque sensors read differently" in one for one in verdict["remarks"])
    assert {"motor_stribeck1", "ripple_sin2"} <= {one["name"].partition("@")[0] for one in verdict["limits"]}


def test_a_small_joint_shows_friction_beside_a_large_one(tmp_path: Path) -> None:
    """Noise of the shoulder leaves more Nm than what is hidden at the elbow."""
    verdict, _ = _asked("pendulum/motor_stribeck/elbow/x3", 0, tmp_path)
    assert verdict["answer"] in {"named", "part named"}, verdict["sentence"]
    assert [(one["effect"], one["joint"]) for one in verdict["findings"]] == [("motor_stribeck", "elbow")]

# SPDX-License-Identifier: MIT
"""Plants with which explanations went wrong, in MuJoCo: what is right today, and what is not yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import pytest
from plant_runs_support import planar_trial
from trial_support import runs_of

from oracles.arms import Plant
from oracles.hidden import DahlLink, Law, LuGre, MotorCoulomb, Offset, SensorError, link_scale
from zygos.can.run import Run
from zygos.gap.adopted import possible
from zygos.gap.explanation import Explanation
from zygos.gap.runs import explain_runs
from zygos.gap.verdicts import ZerosOff

pytestmark = pytest.mark.slow
TRIAL = planar_trial()
ELBOW, SEED, SECONDS = 1, 11, 30.0


def runs(laws: Sequence[Law] = (), sensors: Sequence[SensorError] = (), seconds: float = SECONDS) -> tuple[Run, ...]:
    """Three runs of the arm as drawn, with what is hidden."""
    plant = Plant(TRIAL, replace(TRIAL.drawn, effects=()), tuple(laws), tuple(sensors))
    return runs_of(plant, SEED, seconds, (0, 1, 2))


def explained(recorded: Sequence[Run]) -> Explanation:
    """The last run is kept apart."""
    found = explain_runs(TRIAL.drawn, recorded[:2], validate=recorded[2:])
    assert isinstance(found, Explanation)
    return found


def named(found: Explanation) -> set[tuple[str, str | None]]:
    return {(finding.kind, finding.joint) for finding in found.findings}


@pytest.mark.parametrize("size", [0.02, 0.3])
def test_a_gyro_with_a_quadratic_error_gives_no_absurd_model(size: float) -> None:
    """No entry of the catalogue is like it, and the parameters that fit best are those of no arm."""
    wrong = [
        replace(run, table=replace(run.cycles, omega=run.cycles.omega + size * run.cycles.omega**2))
        for run in runs(seconds=20.0)
    ]
    found = explained(wrong)
    assert found.answer in {"unknown", "plain estimate"}, found.sentence
    assert found.adopted is None or all(check.holds for check in found.adopted.checks)
    assert found.model is None or all(check.holds for check in possible(found.arm, found.model))


@cache
def with_offset() -> Explanation:
    return explained(runs([MotorCoulomb(ELBOW, 0.5), Offset(ELBOW, 0.3)]))


@cache
def with_scale() -> Explanation:
    return explained(runs([LuGre(ELBOW, 0.1)], [link_scale(ELBOW, 0.003)]))


def test_a_friction_beside_an_offset_is_found() -> None:
    assert ("motor_coulomb", "elbow") in named(with_offset()), with_offset().sentence


def test_an_offset_beside_a_friction_is_found() -> None:
    assert ("torque_offset", "elbow") in named(with_offset()), with_offset().sentence


def test_an_encoder_that_reads_too_much_is_found_beside_a_friction() -> None:
    assert ("link_scale", "elbow") in named(with_scale()), with_scale().sentence


def test_zeros_that_are_right_are_not_said_to_be_off() -> None:
    """They would take up what is left over beside a friction, but pay for it."""
    assert not [remark for remark in with_scale().remarks if isinstance(remark, ZerosOff)]


def test_a_friction_that_bends_before_it_slides_is_told_by_its_own_law() -> None:
    found = explained(runs([DahlLink(ELBOW, 2.0, 5e-3)]))
    assert {kind for kind, _ in named(found)} == {"link_dahl"}, found.sentence

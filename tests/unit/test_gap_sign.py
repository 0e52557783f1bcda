# SPDX-License-Identifier: MIT
"""What is named in part has a size whose sign is certain; what has not is left out, or the answer is unknown. Errors of
sensors compete with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plant_runs_support import planar_trial, records

from oracles.arms import Plant
from oracles.hidden import MotorCoulomb
from zygos import limits
from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE
from zygos.gap import explain as module
from zygos.gap.balances import Layout, corrected
from zygos.gap.findings import Finding, Significance
from zygos.gap.null import chance
from zygos.gap.record import MeasuredRun
from zygos.gap.search import Search, _freed, candidates, struck
from zygos.gap.sentences import verdict as said
from zygos.gap.study import Study, again, begin, read_hypothesis
from zygos.gap.verdicts import Lacking, PartNamed, Unexplained, Verdict

REAL, SPURIOUS = "motor_coulomb2", "motor_viscous1"
TRIAL = planar_trial()
ARM, MODEL = TRIAL.arm, TRIAL.drawn


def finding(key: str, joint: str, value: float, sigma: float, assumed: float | None = None) -> Finding:
    """An effect with an interval."""
    return Finding(key, joint, value, sigma, "Nm", Significance(9.0, 0.9), assumed=assumed, entry=CATALOGUE[key])


@pytest.mark.parametrize(
    ("value", "sigma", "assumed", "signed"),
    [(1.0, 0.5, None, True), (1.0, 0.52, None, False), (-1.0, 0.5, None, True), (-1.0, 0.52, None, False),
     (5.0, 0.5, 4.0, True), (5.0, 0.52, 4.0, False), (5.0, 2.0, 0.0, True)],
)  # fmt: skip
def test_the_interval_says_a_sign(value: float, sigma: float, assumed: float | None, signed: bool) -> None:
    assert finding("angular_momentum", "elbow", value, sigma, assumed).signed == signed


def test_no_friction_may_be_negative() -> None:
    """Its interval ends where values end that it may have, and then does not say a sign."""
    unsure = finding("motor_coulomb", "elbow", 2.0, 1.7)
    assert unsure.interval == (0.0, pytest.approx(2.0 + limits.INTERVAL_Z.value * 1.7))
    assert not unsure.signed
    assert finding("torque_offset", "elbow", 2.0, 1.7).interval[0] < 0.0


@pytest.fixture(scope="module")
def runs() -> tuple[MeasuredRun, ...]:
    """Coulomb friction at the elbow, in 5 s of each of two runs."""
    return records(Plant(TRIAL, replace(MODEL, effects=()), (MotorCoulomb(1, 0.05),)), (5.0, 5.0))


@pytest.fixture(scope="module")
def before(runs: tuple[MeasuredRun, ...]) -> Study:
    """The model's own equations."""
    return begin(runs, read_hypothesis(Layout(ARM), MODEL), from_model(ARM, MODEL))


def freed(study: Study) -> tuple[str, ...]:
    """Errors of sensors that a search would free first."""
    found = _freed(study, candidates(study, study, limits.NAMED_Z.value))
    return () if found is None else found.layout.loose


def test_a_friction_is_no_error_of_a_sensor(before: Study) -> None:
    """Although it makes them look large."""
    assert np.abs(before.pulls).max() > 10.0
    assert not freed(before)


def test_an_encoder_whose_zero_is_off(before: Study) -> None:
    layout = before.layout
    wrong = np.where(np.array(layout.zeros) == "motor_zero2", -0.01, 0.0)
    read = [corrected(one, layout, wrong) for one in before.records]
    off = begin(read, before.hypothesis, from_model(ARM, MODEL))
    assert freed(off) == ("motor_zero2",)


@pytest.fixture(scope="module")
def found(before: Study) -> Search:
    """A search that named the friction, and another effect beside it."""
    listed = {one.name: one for one in candidates(before, before, limits.NAMED_Z.value)}
    effects = (*before.hypothesis.effects, REAL, SPURIOUS)
    after = again(before, replace(before.hypothesis, effects=effects))
    names = (listed[REAL], listed[SPURIOUS])
    return Search(before, after, names, ((),), (0.9, 0.9), ((REAL,), (SPURIOUS,)), chance(before, [REAL, SPURIOUS]))


def judged(search: Search, findings: tuple[Finding, ...], runs: tuple[MeasuredRun, ...]) -> Verdict:
    return module._Explainer(MODEL, runs, (), lambda *_: None, ())._how_much(search, findings, None)


SURE = finding("motor_coulomb", "elbow", 0.05, 0.001)
UNSURE = finding("motor_viscous", "shoulder", 0.02, 0.015)


def test_a_part_is_named_only_where_its_sign_is_certain(found: Search, runs: tuple[MeasuredRun, ...]) -> None:
    assert isinstance(judged(found, (SURE,), runs), PartNamed)
    one = judged(found, (SURE, UNSURE), runs)
    assert isinstance(one, Unexplained)
    assert one.unsigned == (UNSURE,)
    assert one.guess == (REAL, SPURIOUS)
    text = said(ARM, one)
    assert "not even the sign is certain of viscous friction at the motor (shoulder), 0.020 ± 0.029 Nm." in text
    # where nothing is left over, the untouched run or the balances say that the law is this one
    whole = replace(found, completeness=(0.99, 0.99))
    assert isinstance(judged(whole, (SURE, UNSURE), runs), Lacking)


@pytest.mark.parametrize(
    ("sizes", "left"),
    [((SURE, UNSURE), (REAL,)),
     ((replace(SURE, sigma=0.1), UNSURE), (REAL, SPURIOUS)),
     ((SURE, replace(UNSURE, sigma=0.001)), (REAL, SPURIOUS))],
)  # fmt: skip
def test_a_name_without_a_sign_is_left_out_beside_one_that_has_it(
    found: Search, runs: tuple[MeasuredRun, ...], sizes: tuple[Finding, ...], left: tuple[str, ...]
) -> None:
    own = dict(zip((REAL, SPURIOUS), sizes, strict=True))
    explainer = module._Explainer(MODEL, runs, (), lambda *_: None, ())

    def told(search: Search) -> module._Told:
        # by itself either effect looks certain, also one of two that only make up for each other
        findings = tuple(own[one.name] for one in search.named) if len(search.named) > 1 else (SURE,)
        share = replace(search, completeness=(0.9, 0.9))
        return module._Told(search, None, findings, (), explainer._how_much(share, findings, None))

    answer = explainer._with_fewer_names(told(found), told)
    assert answer.found is not None
    assert tuple(one.name for one in answer.found.named) == left
    assert answer.found.after.hypothesis.effects[-len(left) :] == left
    assert isinstance(answer.verdict, PartNamed) == all(one.signed for one in answer.findings)


@pytest.mark.slow
def test_a_name_is_struck_with_all_that_stood_beside_it(found: Search) -> None:
    less = struck(found, found.named[1])
    assert [one.name for one in less.named] == [REAL]
    assert less.sets == ((REAL,),)
    assert min(less.completeness) > 0.99
    assert SPURIOUS not in less.after.hypothesis.names
    without = struck(found, found.named[0])
    assert [one.name for one in without.named] == [SPURIOUS]
    assert max(without.completeness) < 0.1

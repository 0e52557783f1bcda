# SPDX-License-Identifier: MIT
"""A payload that is taken up within a run or between two: what was recorded before and after it, the arc that holds
the instant, the errors of sensors that stood for it, and the momentum that it brings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plant_runs_support import planar_trial, records

from oracles.arms import Plant
from oracles.tree import Payload
from zygos.dynamics.equations import from_model
from zygos.errors import Undecided
from zygos.gap.balances import Layout
from zygos.gap.changes import BODIES, find_change, settled
from zygos.gap.content import change_json
from zygos.gap.explain import explain
from zygos.gap.record import MeasuredRun
from zygos.gap.study import begin, part_of, read_hypothesis
from zygos.gap.verdicts import Changed
from zygos.model.model import Model

MASS, REACH = 100.0, 5.0
SECONDS = (11.0, 31.0, 11.0)
"""Of each run; in arcs of 10 s the second run has one before, one with and one after the payload."""
TRIAL = planar_trial()
MODEL = replace(TRIAL.drawn, effects=())
ASSUMING = TRIAL.drawn
"""It assumes that the arm has no angular momentum."""


@cache
def flown(instant: float) -> tuple[MeasuredRun, ...]:
    """Three runs: the arm takes a point mass up at an instant of the second, and keeps it."""
    return records(Plant(TRIAL, MODEL, payload=Payload(MASS, instant, (REACH, 0.0, 0.0))), SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("simulation", "instant", "when"),
    [
        pytest.param(ASSUMING, 12.0, "in b, between 10 and 21 s", id="early"),
        pytest.param(ASSUMING, 20.0, "in b, between 10 and 31 s", id="between two arcs"),
        pytest.param(MODEL, 0.0, "between a and b", id="between two runs"),
    ],
)
def test_a_payload_that_is_taken_up_by_the_arm(simulation: Model, instant: float, when: str) -> None:
    first, second, kept = flown(instant)
    answer = explain(TRIAL.arm, simulation, (first, second), (kept,))
    assert isinstance(answer.verdict, Changed), answer.sentence
    assert f"took on or lost a payload {when}: " in answer.sentence
    sizes = {value.name: value for value in answer.verdict.payload}
    wanted = {"m2": MASS, "mx2": MASS * REACH, "Izz2": MASS * REACH**2}
    assert sizes.keys() == wanted.keys()
    for name, size in wanted.items():
        low, high = sizes[name].interval
        assert low < size < high
        assert high - low < 0.02 * size
    change = change_json(answer.verdict)
    assert change is not None
    assert [value["name"] for value in change["payload"]] == list(wanted)
    # what the arm is after it: nobody knows the momentum of what it took up
    assert answer.model is not None
    assert [effect.kind.key for effect in ASSUMING.effects] == ["angular_momentum"]
    assert not answer.model.effects


def test_too_little_after_it() -> None:
    """In the last arc nothing is left that could say what the arm is since then."""
    first, second, _ = flown(12.0)
    short = first, replace(second, starts=second.starts[:2])
    study = begin(short, read_hypothesis(Layout(TRIAL.arm), MODEL), from_model(TRIAL.arm, MODEL))
    # the runs as if nothing had changed, with errors of sensors that stand for what did
    study = replace(study, records=short, applied=np.zeros_like(study.applied))
    change = find_change(study, [])
    assert change is not None
    assert change.what == BODIES
    with pytest.raises(Undecided, match="no arc"):
        part_of(study, [slice(0), slice(2, None)], study.hypothesis)
    assert settled(study, change, 1.5) is None

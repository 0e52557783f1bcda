# SPDX-License-Identifier: MIT
"""Shapes of laws are refined between those of the catalogue, also where the best of a finer grid lies at its end."""

from __future__ import annotations

from dataclasses import replace

import pytest
from plant_runs_support import planar_trial, records

from oracles.arms import Plant
from oracles.hidden import Leak
from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE
from zygos.gap.balances import Acting, Layout
from zygos.gap.null import chance
from zygos.gap.search import Candidate, Search, completeness, polished
from zygos.gap.study import Study, again, begin, read_hypothesis

SECONDS = 12.0
ONSET_S, SIZE = 6.5, 5.0
"""Of the leak that is hidden, Nm."""
FINER = (4.8, 5.3, 5.8)
"""Onsets, s, of a finer grid below the true one; the catalogue has 4.74 and 7.96 s beside it."""


@pytest.fixture(scope="module")
def leaking() -> Study:
    """The arm's own equations, fitted to two runs of an arm whose base is pushed from an instant on, with the columns
    of a leak on the finer grid."""
    trial = planar_trial()
    model = replace(trial.drawn, effects=())
    runs = records(Plant(trial, model, laws=(Leak(-1, SIZE, onset=ONSET_S),)), (SECONDS, SECONDS))
    hypothesis = read_hypothesis(Layout(trial.arm), model)
    own = tuple(Acting(CATALOGUE["base_leak"], -1, shape=onset) for onset in FINER)
    layout = replace(hypothesis.layout, own=own, shapes=(("base_leak", FINER),))
    return begin(runs, replace(hypothesis, layout=layout), from_model(trial.arm, model))


@pytest.mark.slow
def test_the_best_of_a_finer_grid_may_lie_at_its_end(leaking: Study) -> None:
    """The search named the last onset of a finer grid, beyond which the true one lies."""
    name = f"base_leak@{FINER[-1]:.6g}"
    kind = CATALOGUE["base_leak"]
    after = again(leaking, replace(leaking.hypothesis, effects=(name,)))
    share = completeness(leaking, after.excess * leaking.noise)
    value = float(after.fit.of(name))
    one = Candidate(name, kind, -1, FINER[-1], value, (), (), 0.0, share, 0.0, 0.0, 0.0, 0.0, 0.0, "")
    found = polished(Search(leaking, after, (one,), (), share, ((name,),), chance(leaking, [name])))
    (named,) = found.named
    # the leak grows to its size within a third of a second
    assert named.shape == pytest.approx(ONSET_S + 0.15, abs=0.3)
    assert named.value == pytest.approx(SIZE, rel=0.05)
    assert found.sets == ((named.name,),)
    assert min(found.completeness) > min(share)

# SPDX-License-Identifier: MIT
"""What a name has to stand: every entry of the catalogue in its place, and one size in each run and in all of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from trial_support import runs_of, sampled

from oracles.arms import Plant, planar
from oracles.hidden import BaseDrag, Law, LinkCoulomb, LinkViscous
from zygos import limits
from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE
from zygos.gap.balances import Acting, Layout
from zygos.gap.null import chance
from zygos.gap.runs import record_of
from zygos.gap.search import Candidate, Search, _inseparable, candidates, completeness, rivals, unsteady
from zygos.gap.study import Study, again, begin, laid_out, read_hypothesis

COULOMB, VISCOUS, DRAG = "link_coulomb1", "link_viscous1", "drag on the base"
HIDDEN: dict[str, Law] = {COULOMB: LinkCoulomb(0, 0.5), VISCOUS: LinkViscous(0, 2.0), DRAG: BaseDrag(0, 20.0)}
SECONDS = {COULOMB: 12.0, VISCOUS: 12.0, DRAG: 16.0}


@cache
def before(hidden: str) -> Study:
    """The arm's own equations, fitted to two runs at 50 Hz of one that hides a friction."""
    trial = sampled(planar(), 0.02, 7)
    model = replace(trial.drawn, effects=())
    runs = runs_of(Plant(trial, model, laws=(HIDDEN[hidden],)), 5, SECONDS[hidden])
    hypothesis = read_hypothesis(Layout(trial.arm), model)
    return begin([record_of(run) for run in runs], hypothesis, from_model(trial.arm, model))


def tried(study: Study, name: str) -> Candidate:
    """A usual entry as it is judged."""
    (one,) = (c for c in candidates(study, study, limits.NAMED_Z.value) if c.name == name)
    return one


@cache
def named(hidden: str, name: str) -> Search:
    """A search that named this usual entry where something else is hidden."""
    study = before(hidden)
    one = tried(study, name)
    after = again(study, replace(study.hypothesis, effects=(name,)))
    share = completeness(study, after.excess * study.noise)
    return Search(study, after, (one,), (), share, ((name,),), chance(study, [name]))


@pytest.mark.slow(only=["link_viscous1*"])
@pytest.mark.parametrize(("hidden", "instead"), [(VISCOUS, [VISCOUS]), (COULOMB, [])])
def test_what_is_taken_for_a_usual_entry_is_found_in_the_catalogue(hidden: str, instead: list[str]) -> None:
    found = named(hidden, COULOMB)
    print(found.before.excess.round(2), found.after.excess.round(2), found.completeness)
    last = [Acting(CATALOGUE["link_viscous"], i) for i in (0, 1)]
    last += [Acting(CATALOGUE["link_dahl"], 0, shape=0.001), Acting(CATALOGUE["load_friction"], 0)]
    every = laid_out(found.after, replace(found.after.layout, own=tuple(last)), limits.FEW_DRAWS.value)
    # friction that bends over a short distance becomes Coulomb friction, and is no other law
    assert [one.name for one in rivals(found, every)] == instead


@pytest.mark.slow
def test_which_law_of_a_family_is_nearest_is_open_where_none_is_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coulomb friction that is taken for one that bends, and that would be told from it if the balances closed."""
    study = before(COULOMB)
    bent = Acting(CATALOGUE["link_dahl"], 0, shape=3e-3)
    wider = laid_out(study, replace(study.layout, own=(bent,)))
    after = again(wider, replace(wider.hypothesis, effects=(bent.name,)))
    one = replace(named(COULOMB, COULOMB).named[0], name=bent.name, kind=bent.kind, shape=bent.shape)
    monkeypatch.setattr(limits, "NAMED_Z", replace(limits.NAMED_Z, value=0.0))
    rho = np.nanmax(after.excess) / limits.CLOSED_BALANCE.value
    closed, opened = (_inseparable(one, replace(after, noise=after.noise * rho * k), study) for k in (1.01, 0.99))
    assert closed == (bent.name,)
    assert opened == (bent.name, COULOMB)


@pytest.mark.slow
def test_a_law_whose_size_differs_between_runs_is_not_exactly_what_was_named() -> None:
    (other,) = unsteady(named(VISCOUS, COULOMB))
    assert (other.name, other.first) == (COULOMB, pytest.approx(0.60, abs=0.02))
    assert other.second < 0.9 * other.first
    assert unsteady(named(COULOMB, COULOMB)) == ()


@pytest.mark.slow
def test_runs_that_agree_on_a_size_must_agree_with_all_of_them_together() -> None:
    """Drag on the base looks like friction at the link of each run, whose other coefficients make up for the rest."""
    study = before(DRAG)
    one = tried(study, COULOMB)
    print(one.each, one.value, one.z)
    assert max(one.each) - min(one.each) < limits.AGREE_SHARE.value * one.value
    assert one.value < (1.0 - limits.AGREE_SHARE.value) * min(one.each)
    assert one.against == "inconsistent"
    assert not tried(before(COULOMB), COULOMB).against

"""What a name has to stand: every entry of the catalogue in its place, and one size in each run and in all of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from oracles.arms import Plant, planar
from oracles.hidden import BaseDrag, Law, LinkCoulomb, LinkViscous
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE
from zygos.gap.balances import Acting, Layout
from zygos.gap.null import FLOOR, chance
from zygos.gap.runs import record_of
from zygos.gap.search import AGREEMENT, Candidate, Search, candidates, completeness, rivals, unsteady
from zygos.gap.study import FEW, Study, again, begin, laid_out, read_hypothesis

SECONDS = 16.0
COULOMB, VISCOUS, DRAG = "link_coulomb1", "link_viscous1", "drag on the base"
HIDDEN: dict[str, Law] = {COULOMB: LinkCoulomb(0, 0.5), VISCOUS: LinkViscous(0, 2.0), DRAG: BaseDrag(0, 20.0)}


@cache
def before(hidden: str) -> Study:
    """The arm's own equations, fitted to two runs of one that hides a friction."""
    trial = planar()
    model = replace(trial.drawn, effects=())
    plant = Plant(trial, model, laws=(HIDDEN[hidden],))
    runs = [Run(trial.arm, table=plant.run(which, 5, SECONDS)[0], path=Path("abc"[which])) for which in (0, 1)]
    hypothesis = read_hypothesis(Layout(trial.arm), model)
    return begin([record_of(run) for run in runs], hypothesis, from_model(trial.arm, model))


def tried(study: Study, name: str) -> Candidate:
    """A usual entry as it is judged."""
    (one,) = (c for c in candidates(study, study, FLOOR) if c.name == name)
    return one


def named(study: Study, name: str) -> Search:
    """A search that named this usual entry."""
    one = tried(study, name)
    after = again(study, replace(study.hypothesis, effects=(name,)))
    share = completeness(study, after.excess * study.noise)
    return Search(study, after, (one,), (), share, ((name,),), chance(study, [name]))


@pytest.mark.parametrize(("hidden", "instead"), [(VISCOUS, [VISCOUS]), (COULOMB, [])])
def test_what_is_taken_for_a_usual_entry_is_found_in_the_catalogue(hidden: str, instead: list[str]) -> None:
    study = before(hidden)
    found = named(study, COULOMB)
    print(study.excess.round(2), found.after.excess.round(2), found.completeness)
    last = [Acting(CATALOGUE["link_viscous"], i) for i in (0, 1)]
    last += [Acting(CATALOGUE["link_dahl"], 0, shape=0.001), Acting(CATALOGUE["load_friction"], 0)]
    every = laid_out(found.after, replace(found.after.layout, own=tuple(last)), FEW)
    # friction that bends over a short distance becomes Coulomb friction, and is no other law
    assert [one.name for one in rivals(found, every)] == instead


def test_a_law_whose_size_differs_between_runs_is_not_exactly_what_was_named() -> None:
    (other,) = unsteady(named(before(VISCOUS), COULOMB))
    assert (other.name, other.first) == (COULOMB, pytest.approx(0.60, abs=0.02))
    assert other.second < 0.9 * other.first
    assert unsteady(named(before(COULOMB), COULOMB)) == ()


def test_runs_that_agree_on_a_size_must_agree_with_all_of_them_together() -> None:
    """Drag on the base looks like friction at the link of each run, whose other coefficients make up for the rest."""
    study = before(DRAG)
    one = tried(study, COULOMB)
    print(one.each, one.value, one.z)
    assert max(one.each) - min(one.each) < AGREEMENT * one.value
    assert one.value < (1.0 - AGREEMENT) * min(one.each)
    assert one.against == "inconsistent"
    assert not tried(before(COULOMB), COULOMB).against

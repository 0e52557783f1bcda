"""A payload that is taken up within a run: what was recorded before and after it, the arc that holds the instant, the
errors of sensors that stood for it, and the momentum that it brings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oracles.arms import Plant, planar
from oracles.tree import Payload
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.errors import Undecided
from zygos.gap.balances import Layout
from zygos.gap.changes import BODIES, find_change, settled
from zygos.gap.explain import explain
from zygos.gap.record import MeasuredRun
from zygos.gap.runs import record_of
from zygos.gap.study import Study, begin, part_of, read_hypothesis, zeroed
from zygos.gap.verdicts import Changed
from zygos.model.model import Model

SECONDS, MASS, REACH = 40.0, 100.0, 5.0
TRIAL = planar()
MODEL = replace(TRIAL.drawn, effects=())
ASSUMING = TRIAL.drawn
"""It assumes that the arm has no angular momentum."""


def flown(instant: float) -> tuple[MeasuredRun, ...]:
    """Three runs with arcs of 10 s: the arm takes a point mass up at an instant of the second, and keeps it."""
    plant = Plant(TRIAL, MODEL, payload=Payload(MASS, instant, (REACH, 0.0, 0.0)))
    return tuple(
        record_of(Run(TRIAL.arm, table=plant.run(which, 5, SECONDS)[0], path=Path(f"run-{'abc'[which]}")))
        for which in range(3)
    )


@pytest.mark.parametrize(
    ("simulation", "instant", "within"),
    [(MODEL, 12.0, (10, 20)), (MODEL, 18.0, (10, 20)), (ASSUMING, 20.0, (10, 30))],
)
def test_a_payload_that_is_taken_up_within_a_run(simulation: Model, instant: float, within: tuple[int, int]) -> None:
    first, second, kept = flown(instant)
    found = explain(TRIAL.arm, simulation, (first, second), (kept,))
    assert isinstance(found.verdict, Changed), found.sentence
    assert "took on or lost a payload in run-b, between {} and {} s".format(*within) in found.sentence
    sizes = {one.name: one for one in found.verdict.payload}
    wanted = {"m2": MASS, "mx2": MASS * REACH, "Izz2": MASS * REACH**2}
    assert sizes.keys() == wanted.keys()
    for name, size in wanted.items():
        low, high = sizes[name].interval
        assert low < size < high
        assert high - low < 0.02 * size
    # what the arm is after it: nobody knows the momentum of what it took up
    assert found.model is not None
    assert [effect.kind.key for effect in ASSUMING.effects] == ["angular_momentum"]
    assert not found.model.effects


def studied(records: tuple[MeasuredRun, ...]) -> Study:
    """The study of runs as if nothing had changed, with errors of sensors that stand for what did."""
    study = zeroed(begin(records, read_hypothesis(Layout(TRIAL.arm), MODEL), from_model(TRIAL.arm, MODEL)))
    return replace(study, records=records, applied=np.zeros_like(study.applied))


def test_too_little_after_it() -> None:
    """In the last arc nothing is left that could say what the arm is since then."""
    first, second, _ = flown(12.0)
    short = replace(second, starts=second.starts[:2])
    study = studied((first, short))
    change = find_change(study, [])
    assert change is not None
    assert change.what == BODIES
    with pytest.raises(Undecided, match="no arc"):
        part_of(study, [slice(0), slice(2, None)], study.hypothesis)
    assert settled(study, change, 1.5) is None

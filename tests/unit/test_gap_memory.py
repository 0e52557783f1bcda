"""Laws with a memory and an eccentric encoder, hidden in MuJoCo in another form: their columns find them.

Columns and simulator are tested against each other in `test_catalogue.py`; here neither is the plant's.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from oracles.arms import Plant, planar
from oracles.hidden import BoucWen, Sliders, motor_eccentricity
from oracles.tree import Swinging
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.effects import CATALOGUE, Kind, Memory, Motion
from zygos.effects.memory import at_rest
from zygos.errors import ZygosError
from zygos.gap.balances import Acting, Layout
from zygos.gap.findings import Finding, Significance
from zygos.gap.fit import Hypothesis
from zygos.gap.null import FLOOR, null_sigmas
from zygos.gap.record import MeasuredRun
from zygos.gap.runs import record_of
from zygos.gap.search import completeness, polished, search
from zygos.gap.sentences import listed
from zygos.gap.study import Study, again, begin, read_hypothesis

SECONDS = 16.0
SIZE, DISTANCE = 0.05, 0.01
INERTIA, FREQUENCY = 20.0, 0.5
BASE = (0.0, 0.0, 0.0)
OWN = (
    Acting(CATALOGUE["motor_dahl"], 1, shape=0.008),
    Acting(CATALOGUE["motor_maxwell"], 1, shape=DISTANCE),
    Acting(CATALOGUE["motor_coulomb"], 1),
    Acting(CATALOGUE["base_oscillator"], -1, shape=FREQUENCY),
    Acting(CATALOGUE["motor_eccentricity_sin"], 1),
)
PLANTS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "motor_dahl2@0.008": {"laws": (BoucWen(1, SIZE, DISTANCE),)},
    "motor_maxwell2@0.01": {"laws": (Sliders(1, SIZE, DISTANCE),)},
    "base_oscillator@0.5": {"swinging": Swinging("hinge", (0.0, 0.0, 1.0), BASE, 20.0, INERTIA, FREQUENCY, 0.01)},
    "base_oscillator@0.5 (fuel)": {
        "swinging": Swinging("slide", (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), INERTIA, 0.1, 0.5, 0.01)
    },
    "motor_eccentricity_sin2": {"sensors": (motor_eccentricity(1, 1e-4, 50.0),)},
}
TRUE = {"base_oscillator@0.5": INERTIA, "motor_eccentricity_sin2": 1e-4}


@cache
def records(name: str) -> tuple[MeasuredRun, ...]:
    trial = planar()
    plant = Plant(trial, replace(trial.drawn, effects=()), **PLANTS[name])
    runs = [Run(trial.arm, table=plant.run(which, 3, SECONDS)[0], path=Path("abc"[which])) for which in (0, 1)]
    return tuple(record_of(run) for run in runs)


@cache
def study(name: str) -> Study:
    """The true model's equations, without what is hidden, fitted to two runs."""
    trial = planar()
    model = replace(trial.drawn, effects=())
    hypothesis = read_hypothesis(Layout(trial.arm), model)
    wide = replace(hypothesis, layout=replace(hypothesis.layout, own=OWN))
    return begin(records(name), wide, from_model(trial.arm, model))


def scores(found: Study, name: str) -> tuple[float, float, list[float]]:
    """Coefficient on both runs together, its deviation, and its scores on each."""
    wider = replace(found.hypothesis, effects=(*found.hypothesis.effects, name))
    null = [found.of_twin(wider, [run]).of(name) for run in (0, 1)]
    each = [float(found.of(wider, [run]).of(name)) for run in (0, 1)]
    z = [float((x - draw.mean()) / draw.std(ddof=1)) for x, draw in zip(each, null, strict=True)]
    return float(found.of(wider).of(name)), float(null_sigmas(found, [name])[0]), z


def test_nothing_stands_out_where_nothing_is_hidden() -> None:
    found = study("nothing")
    print(found.layout.balances, found.excess.round(2))
    assert np.all(np.abs(found.excess**2 - 1.0) < np.maximum(0.3, 4.0 * found.wobble))
    for one in OWN:
        _, _, z = scores(found, one.name)
        print(one.name, z)
        assert min(abs(x) for x in z) < FLOOR


@pytest.mark.slow(but=["motor_eccentricity_sin2"])
@pytest.mark.parametrize("name", [name for name in PLANTS if name != "nothing"])
def test_what_is_hidden_stands_out_with_its_size(name: str) -> None:
    found = study(name)
    assert np.nanmax(found.excess) > 2.0
    name = name.partition(" ")[0]
    got, sigma, z = scores(found, name)
    print(got, sigma, z, found.excess.round(1))
    assert min(abs(x) for x in z) > 3.0 * FLOOR
    assert got == pytest.approx(TRUE.get(name, SIZE), rel=0.1 if "oscillator" in name else 0.02)
    share = {one.name: min(completeness(found, found.of(of(found, one.name)).rms)) for one in OWN}
    print({key: round(value, 3) for key, value in share.items()})
    # laws that bend before they slide are twins
    assert all(share[name] > share[one.name] + 0.02 for one in OWN if not same_family(found, one.name, name))
    assert share[name] > 0.8
    after = again(found, of(found, name))
    print(after.excess.round(2))
    assert np.nanmax(after.excess) < 0.35 * np.nanmax(found.excess)


def same_family(found: Study, other: str, name: str) -> bool:
    first, second = (found.layout.find(one).kind for one in (other, name))
    return first == second or {first.key, second.key} == {"motor_dahl", "motor_maxwell"}


def of(found: Study, name: str) -> Hypothesis:
    """The hypothesis of a study, with an effect more."""
    return replace(found.hypothesis, effects=(*found.hypothesis.effects, name))


def test_states_follow_all_at_once_as_step_by_step() -> None:
    rng = np.random.default_rng(0)
    rate = rng.normal(size=(2, 3, 50)).cumsum(axis=-1)
    time = 0.01 * np.arange(150).reshape(3, 50) + np.array([[0.0], [0.0], [5.0]])
    for key in ("motor_dahl", "motor_maxwell", "base_oscillator"):
        memory, shape = CATALOGUE[key].memory, 0.05
        assert memory is not None
        seen = memory.along(Motion(rate=rate, time=time), shape, 0.01).memory
        b, a = memory.rates(Motion(rate=rate), shape)
        for draw in range(2):
            for arc in range(3):
                for k in range(50):
                    now = (draw, arc, k)
                    before = (draw, arc, k - 1) if k else (draw, arc - 1, 49)
                    if (arc, k) in ((0, 0), (2, 0)):
                        state = at_rest(b[now], a[now])
                    else:
                        state = memory.advanced(state, 0.5 * (b[now] + b[before]), 0.5 * (a[now] + a[before]), 0.01)
                    np.testing.assert_allclose(seen[now], state, rtol=1e-9, atol=1e-12)


def test_a_memory_at_a_site_without_one_is_refused() -> None:
    memory = Memory(lambda motion, _: (motion.rate[..., None], 0.0 * motion.rate[..., None]))
    with pytest.raises(ZygosError, match="a law at the site torque has no memory; remedy"):
        replace(CATALOGUE["torque_gain"], memory=memory)


def test_a_finding_with_a_law_of_ones_own_is_spoken_of_anywhere() -> None:
    own = Kind("motor_drag", "quadratic drag", "Nms^2/rad^2", "motor", lambda motion, _: motion.rate * abs(motion.rate))
    found = Finding(own.key, "elbow", 0.3, 0.01, own.unit, Significance(9.0, 1.0), entry=own)
    assert listed([found]) == "quadratic drag (elbow), 0.300 ± 0.020 Nms^2/rad^2"


@pytest.mark.slow
def test_the_shape_of_a_law_is_found_between_those_of_the_search() -> None:
    trial = planar()
    model = replace(trial.drawn, effects=())
    hypothesis = read_hypothesis(Layout(trial.arm), model)
    own = (
        *(Acting(CATALOGUE["motor_maxwell"], 1, shape=shape) for shape in (0.00464, 0.0215)),
        Acting(CATALOGUE["motor_dahl"], 1, shape=0.00215),
    )
    wide = replace(hypothesis, layout=replace(hypothesis.layout, own=own))
    first = search(begin(records("motor_maxwell2@0.01"), wide, from_model(trial.arm, model)))
    found = polished(first)
    print([(one.name, one.value) for one in (*first.named, *found.named)], found.after.excess)
    (one,) = found.named
    assert one.kind.key == "motor_maxwell"
    # ten elements begin to slide earlier than four
    assert one.shape == pytest.approx(0.88 * DISTANCE, rel=0.1)
    assert one.value == pytest.approx(SIZE, rel=0.01)

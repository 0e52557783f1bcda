# SPDX-License-Identifier: MIT
"""Laws with a memory and an eccentric encoder, hidden in MuJoCo in another form: their columns find them.

Columns and simulator are tested against each other in `test_catalogue.py`; here neither is the plant's.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from gap_arms_support import begun
from plant_runs_support import planar_trial, records

from oracles.arms import Plant
from oracles.hidden import BoucWen, Sliders, motor_eccentricity
from oracles.tree import Swinging
from zygos import limits
from zygos.effects import CATALOGUE, Kind, Memory, Motion
from zygos.effects.memory import at_rest
from zygos.errors import ZygosError
from zygos.gap.balances import Acting
from zygos.gap.findings import Finding, Significance
from zygos.gap.fit import Hypothesis
from zygos.gap.record import MeasuredRun
from zygos.gap.search import completeness, polished, search
from zygos.gap.sentences import listed
from zygos.gap.study import Study, again

SECONDS = 12.0
SIZE, DISTANCE = 0.05, 0.01
INERTIA, FREQUENCY = 20.0, 0.5
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
    "base_oscillator@0.5": {
        "swinging": Swinging("hinge", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 20.0, INERTIA, FREQUENCY, 0.01)
    },
    "base_oscillator@0.5 (fuel)": {
        "swinging": Swinging("slide", (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), INERTIA, 0.1, FREQUENCY, 0.01)
    },
    "motor_eccentricity_sin2": {"sensors": (motor_eccentricity(1, 1e-4, 50.0),)},
}
TRIAL = planar_trial()
TRUE = {"base_oscillator@0.5": INERTIA, "motor_eccentricity_sin2": 1e-4}


@cache
def flown(name: str) -> tuple[MeasuredRun, ...]:
    """Two runs of a plant."""
    return records(Plant(TRIAL, replace(TRIAL.drawn, effects=()), **PLANTS[name]), (SECONDS, SECONDS), seed=3)


def scores(found: Study, name: str) -> tuple[float, list[float]]:
    """Coefficient on both runs together, and its scores on each."""
    wider = replace(found.hypothesis, effects=(*found.hypothesis.effects, name))
    null = [found.of_twin(wider, [run]).of(name) for run in (0, 1)]
    each = [float(found.of(wider, [run]).of(name)) for run in (0, 1)]
    z = [float((x - draw.mean()) / draw.std(ddof=1)) for x, draw in zip(each, null, strict=True)]
    return float(found.of(wider).of(name)), z


@pytest.mark.slow
def test_nothing_stands_out_where_nothing_is_hidden() -> None:
    found = begun(TRIAL, flown("nothing"), OWN)
    assert np.all(np.abs(found.excess**2 - 1.0) < np.maximum(0.3, 4.0 * found.wobble))
    for one in OWN:
        _, z = scores(found, one.name)
        assert min(abs(x) for x in z) < limits.NAMED_Z.value


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PLANTS if name != "nothing"])
def test_what_is_hidden_stands_out_with_its_size(name: str) -> None:
    found = begun(TRIAL, flown(name), OWN)
    assert np.nanmax(found.excess) > 2.0
    name = name.partition(" ")[0]
    got, z = scores(found, name)
    assert min(abs(x) for x in z) > 3.0 * limits.NAMED_Z.value
    assert got == pytest.approx(TRUE.get(name, SIZE), rel=0.1 if "oscillator" in name else 0.02)
    share = {one.name: min(completeness(found, found.of(of(found, one.name)).rms)) for one in OWN}
    # laws that bend before they slide are twins
    assert all(share[name] > share[one.name] + 0.02 for one in OWN if not same_family(found, one.name, name))
    assert share[name] > 0.8
    after = again(found, of(found, name))
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
    own = (
        *(Acting(CATALOGUE["motor_maxwell"], 1, shape=shape) for shape in (0.00464, 0.0215)),
        Acting(CATALOGUE["motor_dahl"], 1, shape=0.00215),
    )
    found = polished(search(begun(TRIAL, flown("motor_maxwell2@0.01"), own)))
    (one,) = found.named
    assert one.kind.key == "motor_maxwell"
    # ten elements begin to slide earlier than four
    assert one.shape == pytest.approx(0.88 * DISTANCE, rel=0.1)
    assert one.value == pytest.approx(SIZE, rel=0.01)

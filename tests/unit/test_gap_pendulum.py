# SPDX-License-Identifier: MIT
"""Explanations of a measured arm: whatever the runs, the model that is written predicts as well as `zygos estimate`."""

from __future__ import annotations

from itertools import combinations

import pytest
from pendulum_support import NAMES, PENDULUM, recordings

from zygos.can.run import Run
from zygos.gap.ground.explain import explain_ground
from zygos.ground.estimate import estimate_ground
from zygos.ground.score import score
from zygos.simulators.file import read_robot

NO_WORSE = 1.1


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """The five recordings."""
    return recordings(tmp_path_factory.mktemp("pendulum"))


CHOICES = [" ".join(names) for count in (2, 3, 4) for names in combinations(NAMES, count)]


@pytest.mark.slow
@pytest.mark.parametrize("choice", CHOICES)
def test_every_choice_of_runs_ends_with_a_model_that_predicts_the_others(choice: str, recorded: dict[str, Run]) -> None:
    measured = [recorded[name] for name in choice.split()]
    apart = [recorded[name] for name in NAMES if name not in choice.split()]
    arm = measured[0].arm
    x = explain_ground(arm, read_robot(PENDULUM / "pendulum.xml", arm).model(arm), measured, apart)
    assert x.model is not None, x.sentence
    if len(measured) > 2:
        # more runs never give fewer names
        assert x.answer == "part named", x.sentence
    plain = estimate_ground(measured, doubtful=True).to_model()
    for one in apart:
        found, beside = score(one, x.model), score(one, plain)
        assert found.arm_energy_share < NO_WORSE * beside.arm_energy_share, x.sentence
        assert found.share < NO_WORSE * beside.share, x.sentence

"""Explanations of a measured arm: whatever the runs, the model that is written predicts as well as `zygos estimate`."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import pytest
from cli_support import run

from zygos.arm import load_arm
from zygos.can.run import Run
from zygos.gap.ground.explain import explain_ground
from zygos.ground.estimate import estimate_ground
from zygos.ground.score import score
from zygos.model.model import load_model
from zygos.runs.tables import read_cycles

PENDULUM = Path(__file__).parents[2] / "examples" / "pendulum"
NAMES = ("00", "01", "02", "03", "11")
NO_WORSE = 1.1


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    """The five recordings."""
    folder, out = tmp_path_factory.mktemp("pendulum"), {}
    for name in NAMES:
        table = folder / name / "run.npz"
        table.parent.mkdir()
        options = ("--dbc", PENDULUM / "arm.dbc", "--map", PENDULUM / "map.toml", "-o", table)
        assert run("convert", PENDULUM / f"{name}.blf", *options) == 0
        arm = load_arm(table.parent / "arm.toml")
        out[name] = Run(arm, table=read_cycles(table, arm), path=table)
    return out


CHOICES = [" ".join(names) for count in (2, 3, 4) for names in combinations(NAMES, count)]


@pytest.mark.slow(but=["02 11", "00 02 03"])
@pytest.mark.parametrize("choice", CHOICES)
def test_every_choice_of_runs_ends_with_a_model_that_predicts_the_others(choice: str, recorded: dict[str, Run]) -> None:
    measured = [recorded[name] for name in choice.split()]
    apart = [recorded[name] for name in NAMES if name not in choice.split()]
    x = explain_ground(measured[0].arm, load_model(PENDULUM / "frictionless.toml"), measured, apart)
    assert x.model is not None, x.sentence
    plain = estimate_ground(measured, doubtful=True).to_model()
    for one in apart:
        found, beside = score(one, x.model), score(one, plain)
        assert found.arm_energy_share < NO_WORSE * beside.arm_energy_share, x.sentence
        assert found.share < NO_WORSE * beside.share, x.sentence

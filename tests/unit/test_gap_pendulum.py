# SPDX-License-Identifier: MIT
"""Explanations of a measured arm: whatever the runs, the model that is written predicts as well as `zygos estimate`."""

from __future__ import annotations

import gzip
from itertools import combinations
from pathlib import Path

import pytest
from cli_support import run
from pendulum_support import NAMES, PENDULUM, recordings

from conftest import ROOT, need
from zygos.arm import load_arm
from zygos.can.run import Run
from zygos.gap.ground.explain import explain_ground
from zygos.ground.estimate import estimate_ground
from zygos.ground.score import score
from zygos.model.model import load_model
from zygos.runs.tables import read_cycles
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


OTHER = ROOT.parent / "shared" / "data" / "dfki-double-pendulum-c0"


@pytest.mark.slow
def test_more_runs_of_another_pendulum_name_more(tmp_path: Path) -> None:
    """In the untouched run its elbow has hardly any torque, so that little can be told by its predictions."""
    need((OTHER / "arm.toml").is_file(), f"{OTHER}, recordings of a double pendulum")
    recorded = []
    for k in range(7):
        source, table = tmp_path / f"{k}.csv", tmp_path / str(k) / "run.npz"
        source.write_bytes(gzip.decompress((OTHER / f"trajectory_{k:02d}.csv.gz").read_bytes()))
        table.parent.mkdir()
        assert run("convert", source, "--map", OTHER / "map.toml", "--arm", OTHER / "arm.toml", "-o", table) == 0
        arm = load_arm(table.parent / "arm.toml")
        recorded.append(Run(arm, table=read_cycles(table, arm), path=table))
    arm, simulation = recorded[0].arm, load_model(OTHER / "cad.toml")
    few, all_of_them = (explain_ground(arm, simulation, recorded[:count], recorded[6:]) for count in (3, 6))
    assert all_of_them.answer == "part named", all_of_them.sentence
    found = {(one.kind, one.joint): one for one in all_of_them.findings}
    rotor, elbow = ("rotor_inertia", "elbow"), ("motor_coulomb", "elbow")
    assert {(one.kind, one.joint) for one in few.findings} <= set(found) >= {rotor, elbow}
    # an analysis without viscous friction, by other means
    assert 36 * found[rotor].value == pytest.approx(0.0034, rel=0.35)
    assert 6 * found[elbow].value == pytest.approx(0.137, rel=0.35)
    assert all_of_them.gap is not None
    assert all_of_them.gap.closed < NO_WORSE * all_of_them.gap.plain < 0.1

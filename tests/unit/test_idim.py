# SPDX-License-Identifier: MIT
"""Batch least squares on filtered accelerations, on torques from Pinocchio, and the campaign that compares with it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from ground_support import recorded, short_arm

from conftest import ROOT
from zygos.accuracy import ground
from zygos.accuracy.idim import idim
from zygos.accuracy.laboratory import Laboratory
from zygos.accuracy.laboratory import recorded as with_errors
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import CATALOGUE
from zygos.errors import ZygosError
from zygos.ground.rows import friction
from zygos.model.model import Model

OFFSETS = ([0.01, -0.02, 0.005], [-0.01, 0.01, 0.02])


@cache
def _setup() -> tuple[Arm, Model, Run, Run]:
    arm, model = short_arm()
    first, second = (recorded(arm, model, path=k, seed=k, offset=offset) for k, offset in enumerate(OFFSETS))
    return arm, model, first, second


@pytest.mark.slow
def test_batch_least_squares_finds_arm_and_offsets() -> None:
    arm, model, first, second = _setup()
    effects = friction(arm, [CATALOGUE[key] for key in ("motor_coulomb", "motor_viscous")])
    found = idim([first, second], effects, 8.0)
    known = {one.column(arm): one.value for one in model.effects}
    truth = np.concatenate([model.base_values(arm), [known[one.column(arm)] for one in effects]])
    size = np.abs(truth) + 0.05 * np.abs(truth[: len(arm.parameter_names)]).max()
    assert np.max(np.abs(found.value - truth) / size) < 0.1
    assert np.abs(found.offset / arm.gear_ratios - OFFSETS).max() < 2e-3
    assert all(joint.share < 0.05 for joint in found.score(second).joints)


def test_effects_without_a_column_are_refused() -> None:
    arm, _, first, _ = _setup()
    with pytest.raises(ZygosError, match="batch least squares has no column"):
        idim([first], friction(arm, [CATALOGUE["load_friction"]]), 8.0)


def _line(error: float, **more: object) -> dict[str, object]:
    line: dict[str, object] = {
        "arm": "panda", "variant": "as declared", "validity": "valid", "reason": "",
        "true": [1.0, 2.0, 3.0], "value": [1.0 + error, 2.0, 3.0], "half95": [0.1, 0.1, 0.1],
        "half999": [0.2, 0.2, 0.2], "determined": [True, True, False],
        "error_nm": [1.1, 2.0], "idim_nm": [1.0, 2.0], "floor_nm": [1.0, 1.0],
    }  # fmt: skip
    return {**line, **more}


def test_the_summary_counts_what_is_given() -> None:
    (one,) = ground.summarised([_line(0.0), _line(0.15), _line(0.3), _line(0.05)])
    assert one["coverage95"] == pytest.approx(6 / 8)
    assert (one["beyond999"], one["intervals"], one["least_determined"]) == (1, 8, 2)
    assert one["of_batch"]["joints"] == pytest.approx([1.1, 1.0])
    assert one["of_floor"]["largest"] == pytest.approx(2.0)
    assert "| Panda | as declared | 4 | 4 | 2 of 3 | 75.0 ± " in ground.ground_table([one])


def test_an_unknown_arm_and_a_page_without_a_place_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        ground.main(["puma"])
    assert end.value.code == 2
    assert "there is no arm 'puma'; remedy" in capsys.readouterr().err
    with pytest.raises(ZygosError, match="remedy: run inside a checkout"):
        Laboratory.of("ur10e", tmp_path)
    (tmp_path / "page.md").write_text("no mark")
    with pytest.raises(ZygosError, match="has no place for the table"):
        ground._written(tmp_path / "page.md", "")


def test_a_draw_changes_errors_and_nothing_else(tmp_path: Path) -> None:
    arm = Laboratory.of("ur10e", ROOT / "examples").arm
    exact = np.random.default_rng(0).uniform(-1.0, 1.0, size=(2, 400, arm.n))
    np.savez(tmp_path / "exact.npz", theta=exact[0], tau=exact[1])
    readings = [with_errors(arm, tmp_path / "exact.npz", np.random.default_rng(k), "as declared") for k in (0, 1)]
    step = 2.0 * np.pi / 65536
    for run in readings:
        error = run.cycles.theta - exact[0]
        assert np.abs(error).max() < 0.51 * step + 2.0**-20 * np.pi
        assert error.std() == pytest.approx(step / np.sqrt(12.0), rel=0.1)
        noise = run.cycles.tau - exact[1]
        assert noise[:, 0].std() == pytest.approx(arm.joints[0].torque_sigma, rel=0.15)
    assert np.any(readings[0].cycles.theta != readings[1].cycles.theta)
    shifted = with_errors(arm, tmp_path / "exact.npz", np.random.default_rng(0), "offset")
    mean = np.abs((shifted.cycles.tau - exact[1]).mean(axis=0))
    assert np.all((mean > 0.008) & (mean < 0.052))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_intervals_of_a_laboratory_arm_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import json

    monkeypatch.chdir(ROOT)
    ground.ground(["ur10e"], draws=4, others=1, workers=1, folder=tmp_path, page=None)
    usual, offset, noise = json.loads((tmp_path / "ground.json").read_text())["draws"]
    assert usual["valid"] == 4
    assert usual["beyond999"] <= 2
    # 4 draws of 52 intervals that are not independent
    assert 0.88 < usual["coverage95"] <= 1.0
    assert max(usual["of_floor"]["joints"]) <= 1.1
    assert max(usual["of_batch"]["joints"]) <= 1.05
    for one in (offset, noise):
        assert one["least_determined"] >= 0.95 * one["parameters"]
        assert one["coverage95"] > 0.85

# SPDX-License-Identifier: MIT
"""Intervals that hold however long an arm flies: what no number of arcs averages out stays in them."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_support import paper_run

from conftest import ROOT
from zygos.accuracy import mission
from zygos.accuracy import missions as command
from zygos.accuracy.mission import LENGTHS, MISSING, Length, Mission, flown_mission, sensed_motions
from zygos.accuracy.missions import case_of, summarised
from zygos.balances.arcs import arc_cycles
from zygos.native.flight import ffi, lib
from zygos.reference.solver import SYSTEMATIC
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]
PAPER = case_of("paper", ROOT / "examples")
TRUE = PAPER.model.base_values(PAPER.arm)
STORED, REPEATED = 12, 4
HELD = 0.92
"""Share of intervals that must hold, of each parameter."""
SECONDS = 60.0
"""Length of a motion here, a fifth of that of the campaign's."""
MINUTES, HOURS = Length("300s", 300.0, 0, "cycles"), Length("3h", 10_800.0, 0, "cycles")


@cache
def stored() -> list[Cycles]:
    """Runs of the paper's arm as perfect sensors see them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mission, "simulate", lambda *_, **__: paper_run())
        return mission.simulated(PAPER, STORED)


def numbered(length: Length, number: int) -> tuple[Mission, list[Cycles]]:
    """A mission and the motions that it repeats."""
    return Mission(PAPER, length, number, Path(), ""), [stored()[(number + k) % STORED] for k in range(REPEATED)]


def held(length: Length, draws: int) -> Floats:
    """(p,) share of the intervals that hold the true value, of missions that end valid, which nearly all do."""
    holds = []
    for number in range(draws):
        flight, _, _ = flown_mission(*numbered(length, number))
        found = flight.estimate()
        if found.validity == "valid":
            holds.append(np.abs(found.value - TRUE) <= found.half95)
    assert len(holds) >= 0.9 * draws
    shares: Floats = np.mean(holds, axis=0)
    print(dict(zip(PAPER.arm.parameter_names, shares.round(3).tolist(), strict=True)))
    return shares


def least(draws: int) -> float:
    """Three standard errors below the share that must hold."""
    return float(HELD - 3.0 * np.sqrt(HELD * (1.0 - HELD) / draws))


@pytest.mark.slow
def test_intervals_hold_after_five_minutes() -> None:
    assert (held(MINUTES, 60) >= least(0.9 * 60)).all()


@pytest.mark.slow
def test_intervals_hold_after_three_hours() -> None:
    """By then the noise has averaged out, and what the smoother makes of fast motion is the larger part."""
    assert (held(HOURS, 6) >= least(0.9 * 6)).all()


@pytest.mark.slow
def test_what_stays_grows_with_the_arcs_beside_a_scatter_that_falls_with_them() -> None:
    """Sums that have all faded to a ten thousandth have the same scatter, and count as so much fewer arcs."""
    flight, _, _ = flown_mission(*numbered(MINUTES, 0))
    state = flight.native
    assert lib.zygos_arm_end_arcs(state) == 1
    long = flight.estimate()
    fade = 1e-4
    lib.zygos_store_forget(ffi.addressof(state, "sums", "energy", "store"), lib.ZYGOS_ENERGY_ROWS, fade)
    lib.zygos_store_forget(ffi.addressof(state, "sums", "motors", "store"), lib.ZYGOS_MOTOR_ROWS, fade)
    short = flight.estimate()
    np.testing.assert_allclose(long.value, short.value, rtol=1e-9)
    stays = max(SYSTEMATIC, 1.0 - 1.0 / long.noise_ratio) * long.accepted / arc_cycles(PAPER.arm)
    factor = (1.0 + stays) / (1.0 + fade * stays)
    off = ~np.eye(len(TRUE), dtype=bool)  # on the diagonal is also what undeclared noise may hide
    size = np.outer(long.sigma, long.sigma)
    np.testing.assert_allclose((long.covariance / size)[off], (factor * short.covariance / size)[off], atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(long.covariance)), long.sigma, rtol=1e-12)


@pytest.mark.slow
def test_sensor_errors_are_those_declared_and_new_each_time() -> None:
    job, motions = numbered(HOURS, 3)
    parts = list(sensed_motions(PAPER.arm, motions, round(1300.0 / PAPER.arm.period_s), job.number))
    cycles = round(SECONDS / PAPER.arm.period_s)
    assert [len(part) for part in parts] == [cycles] * 21 + [800]
    assert [int(part.sync[0]) for part in parts] == [k * (cycles + MISSING) for k in range(22)]
    errors = [part.q - motions[k % REPEATED].q[: len(part)] for k, part in enumerate(parts)]
    sigma = PAPER.arm.joints[0].link_encoder.sigma_rad
    # 52,000 draws: a standard error of 0.3 %
    assert np.std(np.concatenate(errors)) == pytest.approx(sigma, rel=0.01)
    assert abs(np.corrcoef(errors[0].ravel(), errors[4].ravel())[0, 1]) < 3.0 / np.sqrt(2 * cycles)


@pytest.mark.parametrize("door", ["frames", "cycles"])
def test_a_mission_goes_on_from_snapshots_and_loses_little(door: str, monkeypatch: pytest.MonkeyPatch) -> None:
    lost = 5e-3
    monkeypatch.setattr(mission, "RESUMED_S", 200.0)
    monkeypatch.setattr(mission, "LOST", lost)
    flight, sent, resumed = flown_mission(*numbered(Length("10min", 600.0, 0, door), 5))
    assert (sent, resumed) == (12_000, 2)
    assert flight.estimate().validity == "valid"
    missing = sent - flight.counts["cycles"]
    # a frame in so many, of seven a cycle, each the end of a cycle
    expected = sent * lost * (7 if door == "frames" else 1)
    assert abs(missing - expected) < 4.0 * np.sqrt(expected) + 2.0 * (
        resumed + 600.0 / SECONDS if door == "frames" else 0
    )


# ---------------------------------------------------------------- the command


def status(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as end:
        command.main(arguments)
    return int(end.value.code or 0)


def test_what_a_mission_cannot_be_is_refused(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    for arguments, words in (
        (["5min"], "there is no length '5min'"),
        (["60s", "--door=window"], "'window' is not a value of --door"),
        (["60s", "--example=nothing"], "no such file"),
    ):
        assert status(arguments) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert words in said
        assert "remedy" in said


def test_truth_meets_the_answers_in_the_summary() -> None:
    """Of four answers one interval is too narrow, and one is withheld."""
    lines = []
    for number, off in enumerate((0.5, -0.5, 2.0, 0.0)):
        flat = np.ones(len(TRUE))
        value = TRUE + off * flat
        lines.append(
            {
                "case": "paper", "length": "60s", "mission": number, "cycles": 1200, "resumed": 0, "seconds": 0.1,
                "validity": "valid" if number else "partial", "reason": "", "value": value.tolist(),
                "sigma": (0.5 * flat).tolist(), "half95": flat.tolist(),
            }
        )  # fmt: skip
    lines[3]["half95"] = [None, *lines[3]["half95"][1:]]
    (entry,) = summarised(PAPER, lines)
    assert (entry["missions"], entry["valid"]) == (4, 3)
    assert entry["parameters"]["a00"]["coverage95"] == pytest.approx(2.0 / 3.0)
    assert entry["parameters"]["b2"]["coverage95"] == pytest.approx(0.75)
    assert entry["parameters"]["k2"]["bias_percent"] == pytest.approx(100.0 * 0.5 / TRUE[-2])
    assert entry["coverage95"] == pytest.approx(0.75)
    assert {length.name for length in LENGTHS} == {"60s", "300s", "3h", "30d"}


def test_the_command_writes_numbers_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its motions are put where it looks for them."""
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(mission, "simulated", lambda *_: stored() * 2)
    monkeypatch.setattr(
        command.campaign, "executor", lambda *_: __import__("concurrent.futures").futures.ThreadPoolExecutor(1)
    )
    arguments = ["60s", "--draws=3", f"--folder={tmp_path}", f"--json={tmp_path / 'm.json'}"]
    assert status(arguments) == 0
    before = (tmp_path / "lines.jsonl").read_text()
    assert status(arguments) == 0
    assert (tmp_path / "lines.jsonl").read_text() == before
    (entry,) = json.loads((tmp_path / "m.json").read_text())["missions"]
    assert (entry["missions"], entry["cycles"], entry["door"]) == (3, 1200, "frames")
    page = (tmp_path / "m.md").read_text()
    assert "## paper, 60s" in page
    assert all(f"| {name} |" in page for name in PAPER.arm.parameter_names)

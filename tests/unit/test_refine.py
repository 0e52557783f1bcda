# SPDX-License-Identifier: MIT
"""`zygos refine`: pieces of records, the level of the torque noise, several runs, and what is published or refused.

The simulator that makes the runs shares no code with the filter, and the truth is known to the tests alone.
"""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
from arm_support import random_arm
from cli_support import run as command
from refine_support import Case, plant, runs, scenario_of, score, zeros
from runs_support import trajectory_of

import zygos
from zygos.arm import save_arm
from zygos.can.run import Run, save_run
from zygos.effects import effect
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Model, load_model, save_model
from zygos.native.refiner import Refiner, Settings
from zygos.refinement import blocks, refine
from zygos.refinement.bound import bound, bound_along
from zygos.refinement.motion import FlexibleMotion
from zygos.refinement.record import LONGEST_GAP, record_of, start_of
from zygos.refinement.refine import Refinement, check_supported, refine_runs
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_BEFORE, VOID_SHIFT, Cycles

SCENARIO = scenario_of("lively")
SHORT = Case("lively", duration_s=16.0)
"""The beginning of examples/lively, with torque noise of 0.5 %, as the arm file declares."""
DELAYED = replace(SHORT, effects=(("torque_lag", 5e-3),))
TRUTH = plant("lively")


@cache
def short() -> Run:
    return runs(SHORT, [0])[0]


@dataclass(frozen=True, eq=False)
class Answer:
    """What `zygos refine` makes of a run."""

    code: int
    said: str
    refinement: Refinement
    model: Model | None
    json: dict[str, Any]
    page: str


@cache
def answer_to(case: Case) -> Answer:
    """The command, with all that it can write."""
    said, refinements = io.StringIO(), []

    def refined(*arguments: Any, **named: Any) -> Refinement:
        refinements.append(refine_runs(*arguments, **named))
        return refinements[-1]

    with tempfile.TemporaryDirectory() as name, mock.patch("zygos.cli.refine.refine_runs", refined):
        folder = Path(name)
        save_arm(case.arm, folder / "arm.toml")
        save_run(runs(case, [0])[0], folder / "run.blf")
        out, written, page = (folder / name for name in ("better.toml", "x.json", "x.html"))
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = command("refine", folder / "run.blf", "-o", out, "--json", written, "--report", page)
        model = load_model(out) if out.exists() else None
        return Answer(code, said.getvalue(), refinements[0], model, json.loads(written.read_text()), page.read_text())


def found() -> Refinement:
    return answer_to(SHORT).refinement


def table(run: Run, keep: Sequence[bool] | np.ndarray | None = None, **changed: object) -> Run:  # type: ignore[type-arg]
    """A run as a table of cycles, of which some are left out or changed."""
    cycles = replace(run.cycles, **changed)  # type: ignore[arg-type]
    if keep is not None:
        cycles = Cycles(*(getattr(cycles, name)[keep] for name in ("sync", "q", "theta", "tau", "omega", "flags")))
    return Run(run.arm, table=cycles)


def away(answer: Refinement) -> np.ndarray:  # type: ignore[type-arg]
    """(p,) errors in standard deviations."""
    return np.asarray((answer.value - TRUTH.base_values(answer.arm)) / answer.sigma)


# ------------------------------------------------------------------------------------------ a complete model


def test_a_complete_model_is_published_near_the_bound() -> None:
    answer = found()
    assert answer.published, answer.reason
    assert np.abs(away(answer)).max() < 4.0
    assert np.all(answer.sigma < 0.6 * answer.energy.sigma[: len(answer.names)])
    assert answer.level[0] == pytest.approx(0.005, rel=4.0 * answer.level_error)
    assert answer.times_bound is not None
    np.testing.assert_allclose(answer.times_bound, 1.0, rtol=0.1)
    assert not answer.effects
    assert "zygos" in {one.source for one in answer.to_model().parameters.values()}


@pytest.mark.slow
def test_the_bound_of_a_followed_motion_is_that_of_the_true_one() -> None:
    half = len(short()) // 2
    (best,) = bound(SHORT.arm, TRUTH, replace(SCENARIO, duration_s=half * SHORT.arm.period_s))
    level = np.array([joint.torque_relative_sigma for joint in SHORT.arm.joints])
    motion = FlexibleMotion(SHORT.arm, found().value)
    states, tau = found().final.states, found().record.pieces[0].tau  # a block is a cycle
    begun = [(states[: half + 1], tau[:half])]
    along = bound_along(motion, begun, level)
    np.testing.assert_allclose(along.sigma, best.sigma, rtol=0.05)
    # that of the solution is at the level that it has found
    at_level = bound_along(motion, [(states, tau)], np.array(found().level))
    assert found().limit is not None
    np.testing.assert_allclose(found().limit.sigma, at_level.sigma, rtol=0.003)
    # two runs of the same motion tell twice as much
    twice = bound_along(motion, 2 * begun, level)
    np.testing.assert_allclose(twice.sigma, along.sigma / np.sqrt(2.0), rtol=1e-6)


@pytest.mark.slow
def test_several_runs_give_one_estimate_also_with_lost_cycles_and_long_gaps() -> None:
    """Two parts of a run know as much as the whole, but for the state with which each piece begins. Lost cycles are
    bridged, and a long gap begins a piece."""
    keep = np.random.default_rng(0).random(len(short())) > 0.005
    keep[40 : 40 + LONGEST_GAP + 1] = False
    second = np.arange(len(keep)) >= 120
    answer = refine_runs([table(short(), keep & part) for part in (~second, second)])
    pieces = [(piece.run, piece.first) for piece in answer.record.pieces]
    assert pieces == [(0, 0), (0, 40 + LONGEST_GAP + 1), (1, 120)]
    assert answer.record.lost == np.sum(~keep) - LONGEST_GAP - 1 > 0
    assert answer.published, answer.reason
    assert np.abs(away(answer)).max() < 4.0
    ratio = answer.sigma / found().sigma
    assert np.all(ratio > 0.99) and np.all(ratio < 1.5)


@pytest.mark.slow
def test_the_torque_law_says_when_a_torque_acted_and_a_stated_momentum_says_nothing() -> None:
    """Torques that are reported a cycle later, for the cycle before, give the same estimate. A model that
    `zygos explain` wrote states a momentum; the rates of the base are followed, whatever momentum they have."""
    run = short()
    arm = replace(run.arm, torque_law="applied_previous_cycle")
    later = np.vstack([run.tau[:1], run.tau[:-1]])
    model = replace(TRUTH, effects=(effect("angular_momentum", None, 0.5),))
    answer = refine_runs(Run(arm, table=replace(run.cycles, tau=later)), model=model)
    assert answer.published, answer.reason
    np.testing.assert_allclose(answer.value, found().value, rtol=1e-9)
    assert [one.kind.key for one in answer.to_model().effects] == ["angular_momentum"]
    wrong = score(SHORT, Run(run.arm, table=replace(run.cycles, tau=later)))
    assert not wrong.published


@pytest.mark.slow
def test_friction_zeros_and_a_level_below_the_declared_one_are_found() -> None:
    """The friction of the model, the zeros that the arm file calls uncertain, and the noise of the torques."""
    case = replace(SHORT, noise=0.001, declared=0.02, effects=(("motor_coulomb", 0.3),), duration_s=18.0)
    run, off = runs(case, [0])[0], np.array([1e-3, -2e-3])
    joints = tuple(replace(one, link_encoder=replace(one.link_encoder, zero_sigma_rad=2e-3)) for one in run.arm.joints)
    effects = tuple(effect("motor_coulomb", joint.name, 0.0) for joint in joints)
    moved = Run(replace(run.arm, joints=joints), table=replace(run.cycles, q=run.q + off))
    answer = refine_runs([moved], model=replace(TRUTH, effects=effects))
    assert answer.published, answer.reason
    assert np.abs(away(answer)).max() < 4.0
    for one in answer.to_model().effects:
        assert abs(one.value - 0.3) < 4.0 * one.sigma < 0.02
    zeros, sigma = answer.final.beside[6:8], answer.final.beside_sigma[6:8]
    assert np.all(np.abs(zeros - off) < 4.0 * sigma)
    assert np.all(sigma < 1e-3)
    assert answer.level[0] == pytest.approx(0.001, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_encoders_that_are_mounted_to_a_step_do_no_harm(noise: float) -> None:
    """Zeros that are off by up to half of a step, of which the arm file says nothing. Torques without noise are found
    to have none."""
    case = replace(SHORT, noise=noise, mounted=True)
    answer = refine_runs([runs(case, [0])[0]])
    assert answer.published, answer.reason
    assert noise or max(answer.level) < 3e-5
    assert np.abs(away(answer)).max() < 4.0
    at = 3 * case.arm.n
    off = (answer.final.beside[at:] - zeros(case.arm, 0).ravel()) / answer.final.beside_sigma[at:]
    assert np.abs(off).max() < 4.0


# ------------------------------------------------------------------------------------------ records


def cycles(n: int = 200) -> Cycles:
    still = np.zeros((n, 2))
    return Cycles(
        np.arange(n, dtype=np.uint64), still, still, np.arange(2 * n).reshape(n, 2) * 1.0, np.zeros((n, 3)),
        np.zeros(n, np.uint32),
    )  # fmt: skip


def flagged(at: int, *listed: int) -> np.ndarray:  # type: ignore[type-arg]
    flags = np.zeros(200, np.uint32)
    flags[at : at + len(listed)] = listed
    return flags


@pytest.mark.parametrize(
    ("flags", "firsts", "used"),
    [
        (flagged(100, 0), [0], 200),
        (flagged(100, INVALID), [0], 199),
        (flagged(100, BREAK_BEFORE), [0, 100], 200),
        (flagged(100, VOID_BEFORE | 10 << VOID_SHIFT), [0], 191),
        (flagged(100, VOID_BEFORE), [100], 100),
        (flagged(10, BREAK_BEFORE), [10], 190),
        (flagged(99, INVALID, BREAK_BEFORE), [0, 100], 199),
    ],
)
def test_pieces_are_what_can_be_followed(flags: np.ndarray, firsts: list[int], used: int) -> None:  # type: ignore[type-arg]
    arm = SHORT.arm
    record = record_of(arm, [Run(arm, table=replace(cycles(), flags=flags))])
    assert [piece.first for piece in record.pieces] == firsts
    assert record.cycles == used
    assert sum(int(piece.read.sum()) for piece in record.pieces) == used


def test_torques_nobody_reported_lie_between_those_around_them() -> None:
    arm = SHORT.arm
    keep = np.ones(200, bool)
    keep[50:53] = False
    piece = record_of(arm, [table(Run(arm, table=cycles()), keep)]).pieces[0]
    np.testing.assert_allclose(piece.tau, cycles().tau[:-1])  # they rise steadily
    assert np.flatnonzero(piece.lost).tolist() == [50, 51, 52]
    assert np.flatnonzero(~piece.read).tolist() == [50, 51, 52]
    # a torque for the cycle before is missing for the cycle before the gap
    before = replace(arm, torque_law="applied_previous_cycle")
    piece = record_of(before, [table(Run(before, table=cycles()), keep)]).pieces[0]
    assert np.flatnonzero(piece.lost).tolist() == [49, 50, 51, 52]
    np.testing.assert_allclose(piece.tau[:49], cycles().tau[1:50])


@pytest.mark.slow
def test_the_state_at_the_start_of_a_piece_is_within_its_deviations() -> None:
    run = trajectory_of(SHORT.arm, TRUTH, SCENARIO, seeds=[0], duration_s=10.0)
    whole = Run.of_cycles(SHORT.arm, run.cycles())
    for first in range(0, 150, 10):
        keep = np.arange(200) >= first
        x, sigma = start_of(SHORT.arm, record_of(SHORT.arm, [table(whole, keep)]).pieces[0])
        angles = [part[0][first] for part in (run.q, run.theta, run.qd, run.thetad)]
        truth = np.concatenate([[run.omega0[0][first]], *angles, [0.0]])
        assert np.all(np.abs(x - truth) < 3.0 * sigma)
        assert np.all(sigma < 1.0)


def test_a_filter_that_resumes_keeps_what_does_not_move() -> None:
    arm, record = SHORT.arm, found().record
    motion = FlexibleMotion(arm, found().value)
    refiner = Refiner(arm, Settings(motion.size, 5, [0.005] * arm.n, friction=True))
    x, sigma = start_of(arm, record.pieces[0])
    p = len(found().value)
    more = np.full(arm.n, 0.1)
    refiner.start(
        np.concatenate([x, found().value, 0.0 * more]), np.concatenate([sigma, np.zeros(p), more]),
        np.diag((1e-3 * motion.size) ** 2),
    )  # fmt: skip
    for k in range(40):
        refiner.read(record.pieces[0].q[k], record.pieces[0].theta[k], record.pieces[0].omega[k])
        refiner.advance(record.pieces[0].tau[k])
    before = refiner.x, refiner.root @ refiner.root.T
    refiner.resume(x, sigma)
    after = refiner.x, refiner.root @ refiner.root.T
    fast = refiner.fast
    np.testing.assert_array_equal(after[0][:fast], x)
    np.testing.assert_array_equal(after[0][fast:], before[0][fast:])
    np.testing.assert_allclose(after[1][fast:, fast:], before[1][fast:, fast:], rtol=1e-14)
    np.testing.assert_allclose(after[1][:fast, :fast], np.diag(sigma**2), rtol=1e-14)
    assert not after[1][:fast, fast:].any()


# ------------------------------------------------------------------------------------------ refusals


@pytest.mark.slow(but=["noisier*"])
@pytest.mark.parametrize(
    ("case", "rule"),
    [
        (DELAYED, "level"),
        (replace(SHORT, declared=0.05, gain=1.02), "rivals"),
        (Case(declared=0.05, effects=(("motor_coulomb", 0.05),)), "rivals"),
        (replace(SHORT, declared=0.05, effects=(("cubic_stiffness", 30.0),)), "innovations"),
        (replace(SHORT, noise=0.01, declared=0.005), "level"),
    ],
    ids=["delay", "gain of a joint", "friction", "cubic springs", "noisier than declared"],
)
def test_a_model_that_lacks_something_is_not_published(case: Case, rule: str) -> None:
    answer = answer_to(case).refinement
    assert not answer.published
    failed = {one.key: one.sentence for one in answer.rules if not one.holds}
    assert rule in failed
    assert all(failed.values())
    with pytest.raises(Undecided, match="zygos explain"):
        answer.to_model()


def test_what_disagrees_with_energy_rows_is_not_published() -> None:
    rule = {one.key: one for one in found().rules}
    assert rule["agreement"].holds
    shifted = found().value + 0.05 * found().size
    again = replace(found(), final=replace(found().final, value=shifted))

    failed = refine._agreement(again)
    assert not failed.holds
    assert "energy rows say" in failed.sentence


@pytest.mark.parametrize(("part", "times", "holds"), [(slice(53, 80), 4.0, False), (slice(0, 320), 1.05, True)])
def test_large_innovations_of_a_while_are_noticed(part: slice, times: float, holds: bool) -> None:
    squares = found().final.squares.copy()
    squares[:, 1] *= 2 * len(squares) / squares[:, 1].sum()  # two joints, 1 on average
    squares[part, 1] *= times
    again = replace(found(), final=replace(found().final, squares=squares))
    rule = refine._innovations(again)
    assert rule.holds is holds
    assert holds or "motor encoders are too large: the mean normalised square of readings 53 to 80" in rule.sentence


@pytest.mark.slow
def test_innovations_of_a_complete_model_fail_once_in_a_thousand() -> None:
    """Chi square sums of all channels, in the whole record and its windows, as they would be without _EXCESS."""
    answer, rng, draws = found(), np.random.default_rng(0), 10_000
    edges = [0, *(part.stop for part, _ in answer.windows)]
    sums = np.array([rng.chisquare(np.diff(edges)[:, None] * answer.final.counts) for _ in range(draws)])
    lengths = np.diff(edges)
    limits = np.array([(answer.band(int(n)) - 0.1) * n * answer.final.counts for n in lengths])
    whole = (answer.band(edges[-1]) - 0.1) * edges[-1] * answer.final.counts
    failed = np.any(sums > limits, axis=(1, 2)) | np.any(sums.sum(axis=1) > whole, axis=1)
    assert np.mean(failed) < 1e-3 + 3.0 * np.sqrt(1e-3 / draws)
    assert np.mean(failed) > 0.5e-3 - 3.0 * np.sqrt(0.5e-3 / draws)


def test_what_the_filter_does_not_know_is_refused() -> None:
    arm = SHORT.arm
    with pytest.raises(ZygosError, match=r"does not know \(cubic_stiffness\); remedy"):
        check_supported(arm, [effect("cubic_stiffness", "elbow", 1.0)])
    with pytest.raises(ZygosError, match=r"held from SYNC to SYNC.*remedy"):
        check_supported(replace(arm, torque_law="sampled"), [])
    with pytest.raises(ZygosError, match=r"motor currents.*remedy"):
        check_supported(replace(arm, torque_unit="A"), [])
    with pytest.raises(ZygosError, match=r"gyro latches.*remedy"):
        check_supported(replace(arm, imu=replace(arm.imu, latch_us=100)), [])
    exact = tuple(replace(one, link_encoder=replace(one.link_encoder, quantum_rad=0.0)) for one in arm.joints)
    with pytest.raises(ZygosError, match=r"noise of a sensor is 0; remedy"):
        check_supported(replace(arm, joints=exact), [])
    rigid, _ = random_arm(1, 2, "free", "planar", False)
    with pytest.raises(ZygosError, match=r"is rigid.*remedy"):
        check_supported(rigid, [])
    check_supported(arm, [effect("motor_coulomb", "elbow", 1.0), effect("torque_offset", "elbow", 0.1)])


def test_where_energy_rows_give_no_start_nothing_is_refined() -> None:
    arm = SHORT.arm
    still = Run(arm, table=cycles())
    with pytest.raises(Undecided, match="remedy"):
        refine_runs([still])
    with pytest.raises(Undecided, match="no unbroken piece"):
        refine_runs([Run(arm, table=replace(cycles(), flags=np.full(200, BREAK_BEFORE, np.uint32)))])


# ------------------------------------------------------------------------------------------ the command


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_arm(SHORT.arm, tmp_path / "arm.toml")
    save_run(short(), tmp_path / "run.blf")
    return tmp_path


def test_the_command_writes_model_page_and_answer() -> None:
    answer = answer_to(SHORT)
    assert answer.code == 0 and answer.model is not None
    np.testing.assert_array_equal(answer.model.base_values(SHORT.arm), found().value)
    assert answer.json["published"] and answer.json["times_bound"] == pytest.approx(1.0, abs=0.1)
    assert [one["value"] for one in answer.json["parameters"]] == pytest.approx(found().value.tolist())
    assert {one["channel"] for one in answer.json["innovations"]} == {"link encoders", "motor encoders", "gyro"}
    assert "published" in answer.page and '"parameter-0"' in answer.page and '"level"' in answer.page
    assert '"channel-2"' in answer.page
    assert "published: " in answer.said


def test_a_refusal_writes_no_model() -> None:
    answer = answer_to(DELAYED)
    assert answer.code == 3 and answer.model is None
    assert "torque_relative_sigma" in answer.said and "a delay of the torques" in answer.said
    assert "zygos explain" in answer.said and "no model written" in answer.said
    assert not answer.json["published"]
    assert all(one["value"] is None for one in answer.json["parameters"])
    assert "Nothing is published" in answer.page


@pytest.mark.slow
def test_of_runs_that_are_too_long_for_the_memory_the_beginning_is_refined(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = zygos.load_run(folder / "run.blf")
    whole = refine_runs(run)
    monkeypatch.setattr(blocks, "MOST_BYTES", 1e6)
    found = refine_runs(run)
    assert whole.part == "" and found.part.startswith("the first ")
    assert 100 < found.record.cycles < whole.record.cycles
    assert found.record.cycles + found.record.left_out == whole.record.cycles + whole.record.left_out
    assert found.published and np.all(np.abs(found.value - TRUTH.base_values(run.arm)) < 5.0 * found.sigma)
    assert np.all(found.sigma > whole.sigma)


def test_a_model_with_other_effects_is_bad_input(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_model(replace(TRUTH, effects=(effect("cubic_stiffness", "elbow", 1.0),)), folder / "m.toml")
    assert command("refine", folder / "run.blf", "--model", folder / "m.toml", "-o", folder / "b.toml") == 2
    assert "does not know (cubic_stiffness); remedy" in capsys.readouterr().err
    assert not (folder / "b.toml").exists()


@pytest.mark.slow
def test_in_space_what_energy_rows_leave_open_needs_a_model() -> None:
    case = Case("spatial", duration_s=40.0)
    with pytest.raises(Undecided, match="--model"):
        refine_runs([runs(case, [0])[0]])

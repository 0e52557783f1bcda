# SPDX-License-Identifier: MIT
"""The campaign behind `make accuracy`: what its cases are, what it counts, and that it goes on where it was stopped."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from paper_support import paper_run
from runs_support import trajectory_of

from conftest import ROOT
from zygos.accuracy import __main__ as command
from zygos.accuracy import campaign
from zygos.accuracy.cases import Case, all_cases, chosen
from zygos.accuracy.cell import Cell, cells, sensed
from zygos.accuracy.estimators import ESTIMATORS, Prior, refined
from zygos.accuracy.figure4 import PRINTED, Figure4
from zygos.accuracy.limit import Limit
from zygos.accuracy.page import write_accuracy_report
from zygos.accuracy.summary import compare, summarise
from zygos.arm import Arm
from zygos.dynamics.engines import engine
from zygos.effects import effect
from zygos.errors import ZygosError
from zygos.model.model import Model
from zygos.native.flight import Flight
from zygos.paper import printed, response
from zygos.paper.methods import eb
from zygos.paper.tables import flight_estimates, noisy_record
from zygos.refinement.bound import bound
from zygos.refinement.inertia import inertia
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]
CASES = {case.name: case for case in all_cases(ROOT / "examples")}


@pytest.fixture(scope="session")
def arm() -> Arm:
    return CASES["paper-60"].arm


@pytest.fixture(scope="session")
def model() -> Model:
    return CASES["paper-60"].model


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return CASES["paper-60"].scenario


@pytest.fixture(scope="session")
def true(arm: Arm, model: Model) -> Floats:
    """Its own: the one of all tests may have been computed for another example by then."""
    return model.base_values(arm)


@pytest.fixture(autouse=True)
def checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def outputs(folder: Path) -> list[str]:
    return [f"--lines={folder / 'cells.jsonl'}", f"--json={folder / 'a.json'}", f"--page={folder / 'a.html'}"]


def status(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as end:
        command.main(arguments)
    return int(end.value.code or 0)


# the whole of it, small


def campaign_of(case: str, workers: int, folder: Path) -> Path:
    """A campaign of one case with two seeds in a folder of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        assert status([case, "--seeds=2", "--draws=6", f"--workers={workers}", *outputs(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the case whose figure the page shows."""
    return campaign_of("paper-60", 2, tmp_path_factory.mktemp("pictured"))


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return campaign_of("paper-30", 1, tmp_path_factory.mktemp("tiny"))


TINY = ["paper-30", "--seeds=2", "--draws=6"]


@pytest.mark.slow
def test_a_small_campaign_says_what_the_methods_say_by_themselves(
    pictured: Path, arm: Arm, model: Model, scenario: Scenario, true: Floats
) -> None:
    content = json.loads((pictured / "a.json").read_text())
    entries = {entry["estimator"]: entry for entry in content["cases"]}
    assert set(entries) == {one.name for one in ESTIMATORS}
    run = trajectory_of(arm, model, scenario, seeds=range(2), duration_s=60.0, noise=True)
    # the wire rounds what EB is given in the campaign
    expected = {
        "flight": (flight_estimates(arm, run), 1e-5),
        "EB": (eb.estimate(arm, noisy_record(arm, run)), 0.02),
    }
    for name, (values, close) in expected.items():
        entry = entries[name]
        assert entry["case"] == "paper-60"
        error = 100.0 * (values / true - 1.0)
        assert entry["seeds"] == 2
        assert entry["refused"] == 0
        for k, parameter in enumerate(arm.parameter_names):
            own = entry["per_parameter"][parameter]
            assert own["rms_percent"] == pytest.approx(np.sqrt(np.mean(error[:, k] ** 2)), abs=close)
            assert own["bias_percent"] == pytest.approx(error[:, k].mean(), abs=close)
            assert own["spread_percent"] == pytest.approx(error[:, k].std(ddof=1), abs=close)
        rms = [own["rms_percent"] for own in entry["per_parameter"].values()]
        assert entry["mean_rms_percent"] == pytest.approx(np.mean(rms))
        assert entry["max_rms_percent"] == max(rms)
    assert entries["EB"]["coverage95"] is None
    assert entries["flight"]["draws"] == 6
    # its other settings and the methods are asked about each seed's own draw
    assert {entry["draws"] for entry in content["cases"] if entry["estimator"] != "flight"} == {2}
    assert entries["flight, energy"]["coverage95"] is None
    # two seeds of three draws each
    assert all(6 * share == pytest.approx(round(6 * share)) for share in entries["flight"]["coverage95"].values())


@pytest.mark.slow
def test_the_page_is_one_small_file_with_all_numbers(pictured: Path) -> None:
    text = (pictured / "a.html").read_text()
    assert len(text) < 500_000
    assert "http" not in text
    entries = json.loads((pictured / "a.json").read_text())["cases"]
    for entry in entries:
        assert f'<td class="c">{entry["mean_rms_percent"]:.3g}</td>' in text or entry["mean_rms_percent"] is None
    # a dot for each bias and interval, a bar for each spread
    errors = [errors for entry in entries for errors in entry["per_parameter"].values()]
    for keys, stroke in ((("bias_percent", "coverage95"), "0"), (("spread_percent",), "6")):
        drawn = [each[key] for each in errors for key in keys if each[key] is not None]
        assert len(drawn) > 60
        assert len(re.findall(rf"M[0-9.]+ [0-9.]+h{stroke}(?=[M\"])", text)) == len(drawn)


# going on


@dataclass(frozen=True)
class Sum:
    key: str
    code: str = "one"
    fails: bool = False

    def run(self) -> dict[str, Any]:
        if self.fails:
            raise ZygosError("this job fails")
        return {"answer": f"answer {self.key}", "when": time.perf_counter()}


def test_what_was_finished_is_not_done_again(tmp_path: Path) -> None:
    file = tmp_path / "cells.jsonl"

    def one() -> ThreadPoolExecutor:
        return ThreadPoolExecutor(1)

    with pytest.raises(ZygosError, match="this job fails"):
        campaign.run([Sum("a"), Sum("b", fails=True), Sum("c")], file, one)
    kept = json.loads(file.read_text().splitlines()[0])
    assert kept["answer"] == "answer a"
    with file.open("a") as stream:
        stream.write('{"key":"b","code":"one","answer":"cut sh')
    lines = campaign.run([Sum("a"), Sum("b"), Sum("c")], file, one)
    assert [line["answer"] for line in lines] == ["answer a", "answer b", "answer c"]
    assert lines[0]["when"] == kept["when"]
    assert len(file.read_text().splitlines()) == 3
    # other code, other numbers
    again = campaign.run([Sum("a", code="two")], file, one)
    assert again[0]["when"] != kept["when"]
    assert len(file.read_text().splitlines()) == 1


@pytest.mark.slow
def test_a_campaign_that_is_killed_goes_on(tiny: Path, tmp_path: Path) -> None:
    """The same numbers as without the interruption, and the cell that was finished is kept."""
    words = [*TINY, *outputs(tmp_path)]
    file = tmp_path / "cells.jsonl"
    process = subprocess.Popen(
        [sys.executable, "-m", "zygos.accuracy", "--workers=1", *words], cwd=ROOT, start_new_session=True
    )
    try:
        limit = time.monotonic() + 120.0
        while not (file.exists() and file.read_text().endswith("\n")):
            assert process.poll() is None
            assert time.monotonic() < limit
            time.sleep(0.02)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    first = file.read_text()
    assert not (tmp_path / "a.json").exists()
    assert status(["--workers=1", *words]) == 0
    assert file.read_text().startswith(first)
    assert (tmp_path / "a.json").read_text() == (tiny / "a.json").read_text()


@pytest.mark.slow
def test_a_cluster_says_the_same(tiny: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed") if not os.environ.get("CI") else __import__("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tcp://")
        assert status([*TINY, f"--scheduler={address}", *outputs(tmp_path)]) == 0
    assert (tmp_path / "a.json").read_text() == (tiny / "a.json").read_text()


# refusals


def test_an_unknown_case_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["paper-31", *outputs(tmp_path)]) == 2
    assert "no case 'paper-31'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x"])
def test_a_scheduler_that_does_not_answer_is_refused(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign, "_CONNECT_S", 1)
    assert status(["paper-30", "--seeds=2", f"--scheduler={address}", *outputs(tmp_path)]) == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err
    assert not (tmp_path / "a.json").exists()


def test_a_worker_with_other_code_is_refused() -> None:
    with pytest.raises(ZygosError, match="a different version of zygos"):
        Cell(CASES["paper-30"], (0,), 1, "other").run()


# counting


def test_what_is_counted(arm: Arm, true: Floats) -> None:
    """Four seeds of one draw and another: errors, refusals, coverage and wild values as they were put in."""
    case = CASES["paper-30"]

    def column(errors: list[float | None], validity: list[str], sigma: float) -> dict[str, Any]:
        value = [None if e is None else (true * (1.0 + e)).tolist() for e in errors]
        return {
            "seed": [0, 0, 1, 1, 2, 2, 3, 3],
            "draw": [0, 1] * 4,
            "validity": validity,
            "reason": ["" if v == "valid" else f"because {v}" for v in validity],
            "value": value,
            "half95": [None if v is None else (2.5 * sigma * true).tolist() for v in value],
            "sigma": [None if v is None else (sigma * true).tolist() for v in value],
        }

    none: list[float | None] = [None] * 8
    fine = ["valid"] * 8
    mixed = ["valid", "valid", "valid", "valid", "doubtful", "valid", "refused", "valid"]
    line = {
        "case": case.name,
        "answers": {name: column(none, ["refused"] * 8, 0.0) for name in ("DE", "AMC")}
        | {one.name: column([0.0] * 8, fine, 0.01) for one in ESTIMATORS if one.ours}
        | {"EB": column([0.1] * 8, fine, 0.0) | {"half95": none, "sigma": none}}
        | {"flight": column([0.01, 0.021, -0.03, 0.0049, 9.0, 0.018, None, 0.003], mixed, 0.002)},
    }
    entries = {entry["estimator"]: entry for entry in summarise([case], [line])}
    found = entries["flight"]
    assert found["seeds"] == 4
    assert found["refused"] == 2
    assert found["validity"] == {"valid": 2, "doubtful": 1, "refused": 1}
    assert found["reasons"] == {"because doubtful": 1, "because refused": 1}
    assert found["draws_refused"] == 2
    own = found["per_parameter"]["k1"]
    assert own["published"] == 2
    assert own["bias_percent"] == pytest.approx(-1.0)
    assert own["rms_percent"] == pytest.approx(np.sqrt((1.0 + 9.0) / 2))
    assert own["spread_percent"] == pytest.approx(np.sqrt(8.0))
    # of 0.01, 0.021, -0.03, 0.0049, 0.018, 0.003 with half widths of 0.005
    assert found["coverage95"]["k1"] == pytest.approx(2 / 6)
    # five sigmas are 0.01: 0.021 and -0.03 are beyond them and beyond 2 %, for each of the 12
    assert found["wild"] == 24
    assert entries["DE"]["refused"] == 4
    assert entries["DE"]["mean_rms_percent"] is None
    assert entries["EB"]["mean_rms_percent"] == pytest.approx(10.0)
    assert entries["EB"]["coverage95"] is None
    assert entries["EB"]["wild"] is None


def test_cases_with_the_same_runs_are_compared_where_both_publish(tmp_path: Path) -> None:
    """Errors of 1 % and 3 % beside half of them; a draw that one refuses and a parameter that one leaves out count
    nowhere. The intervals of 2 % hold one of two there, both here."""
    one = CASES["paper-60"]
    case = replace(one, name="other", beside=one.name)
    true = one.model.base_values(one.arm)

    def line(name: str, errors: list[float], validity: list[str], missing: int | None) -> dict[str, Any]:
        values = [(true * (1.0 + error)).tolist() for error in errors]
        for value in values if missing is not None else []:
            value[missing] = None
        sizes = {"half95": 0.02, "sigma": 0.01 if name == one.name else 0.008}
        column = {"seed": [0, 1, 2], "draw": [0] * 3, "validity": validity, "reason": [""] * 3, "value": values}
        column |= {key: [(size * np.abs(true)).tolist()] * 3 for key, size in sizes.items()}
        return {"case": name, "answers": {each.name: column for each in ESTIMATORS}}

    lines = [
        line(one.name, [0.01, 0.03, 0.5], ["valid"] * 3, None),
        line("other", [0.005, 0.015, 0.0], ["valid", "partial", "refused"], 2),
    ]
    (found,) = compare([one, case], lines)
    assert (found["case"], found["beside"], found["seeds"]) == ("other", one.name, 3)
    assert found["parameters"] == len(true) - 1
    assert found["error_ratio"] == pytest.approx(0.5)
    assert found["sigma_ratio"] == pytest.approx(0.8)
    assert (found["coverage95_beside"], found["coverage95"]) == (pytest.approx(0.5), pytest.approx(1.0))
    assert compare([case], lines) == []
    page = tmp_path / "a.html"
    write_accuracy_report(page, [one, case], summarise([one, case], lines), [found], None, 3)
    assert "the median ratio of the errors of a parameter that both publish is 0.5," in page.read_text()


def test_the_page_of_refusals_only(tmp_path: Path) -> None:
    case = CASES["paper-30"]
    column = {key: [None] for key in ("value", "half95")} | {"seed": [0], "draw": [0], "validity": ["refused"]}
    line = {"case": case.name, "answers": {one.name: column | {"reason": ["why <not>"]} for one in ESTIMATORS}}
    write_accuracy_report(tmp_path / "a.html", [case], summarise([case], [line]), [], None, 1)
    assert "why &lt;not&gt;" in (tmp_path / "a.html").read_text()


def test_inertia_matrices_carry_the_energy_of_pinocchio() -> None:
    case = CASES["spatial"]
    oracle = engine("pinocchio", case.arm, case.model)
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, (5, 3))
    u = rng.normal(size=(5, 6))
    matrices = inertia(case.arm, q, case.model.base_values(case.arm))
    got = 0.5 * np.einsum("pi,pij,pj->p", u, matrices, u)
    wanted = [oracle.kinetic_energy(a, b[:3], b[3:], np.zeros(3)) for a, b in zip(q, u, strict=True)]
    np.testing.assert_allclose(got, wanted, rtol=1e-10)


# cases


def read_back(case: Case, trajectory: Trajectory, number: int) -> Any:
    """What the receiver made of the frames, and the arm file that goes with them."""
    arm, frames = sensed(case, trajectory, 0, number)
    trace = Flight(arm).frames(frames, trace=True)
    assert trace is not None
    return arm, trace.cycles


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    return paper_run()


def angle_errors(case: Case, motion: Trajectory, number: int) -> tuple[Arm, Floats]:
    """(n, 4) of the angles that the estimator takes the readings for, rad."""
    arm, cycles = read_back(case, motion, number)
    at = cycles.sync.astype(int)
    zeros = np.array(
        [[j.link_encoder.zero_rad for j in arm.joints], [j.motor_encoder.zero_rad for j in arm.joints]]
    ).ravel()
    read = np.hstack([cycles.q, cycles.theta]) - zeros
    return arm, read - np.hstack([motion.q[0], motion.theta[0]])[at]


@pytest.mark.slow
def test_declared_sigmas_are_what_the_case_says(motion: Trajectory) -> None:
    for name, factor in (("paper-60", 1.0), ("sigma-half", 2.0), ("sigma-double", 0.5)):
        arm, error = angle_errors(CASES[name], motion, 5)
        declared = arm.joints[0].link_encoder.sigma_rad
        # 4 x 1,200 draws: a standard error of 1 %
        assert error.std() / declared == pytest.approx(factor, rel=0.03)


@pytest.mark.slow
def test_draws_differ_and_are_the_same_again(motion: Trajectory) -> None:
    for name in ("paper-60", "quantised", "zeros", "lost"):
        one, same, other = (sensed(CASES[name], motion, 0, number)[1].tobytes() for number in (7, 7, 1_000_007))
        assert one == same
        assert one != other


def test_quantised_readings_lie_within_half_a_quantum(motion: Trajectory) -> None:
    arm, error = angle_errors(CASES["quantised"], motion, 3)
    quantum = arm.joints[0].link_encoder.quantum_rad
    assert 0.49 * quantum < np.abs(error).max() < 0.505 * quantum


def test_encoder_zeros_are_off_by_a_milliradian(motion: Trajectory) -> None:
    signs = set()
    for number in range(4):
        arm, error = angle_errors(CASES["zeros"], motion, number)
        mean = error.mean(axis=0)
        # the mean of 1,200 readings has 2.5e-5 rad
        np.testing.assert_allclose(np.abs(mean), 1e-3, atol=1.5e-4)
        assert all(joint.link_encoder.zero_rad == 0.0 for joint in arm.joints)
        signs.add(tuple(np.sign(mean)))
    assert len(signs) > 1


@pytest.mark.slow
def test_one_joint_is_lost_in_one_of_a_hundred_cycles(motion: Trajectory) -> None:
    lost = []
    for number in range(20):
        _, whole = sensed(CASES["paper-60"], motion, 0, number)
        _, frames = sensed(CASES["lost"], motion, 0, number)
        missing = len(whole) - len(frames)
        assert missing % 2 == 0
        lost.append(missing // 2)
        _, cycles = read_back(CASES["lost"], motion, number)
        assert len(cycles) == 1200 - lost[-1]
    # 24,000 cycles: a standard error of 15
    assert abs(sum(lost) - 240) < 46


def test_the_arm_rests_and_then_moves_along_a_sine() -> None:
    case = CASES["rest"]
    run = trajectory_of(case.plant, case.model, case.scenario, noise=False, duration_s=case.rest_s + 5.0)
    still = run.t < case.rest_s
    np.testing.assert_allclose(run.qd[0, still], 0.0, atol=1e-9)
    t = run.t[~still, None] - case.rest_s
    wanted = np.array([1.25, -2.0]) - np.array([0.9, 0.8]) * np.cos(np.array([0.6, 1.1]) * t)
    np.testing.assert_allclose(run.desired[~still], wanted, atol=1e-9)
    np.testing.assert_allclose(run.desired[still], run.desired[[0] * int(still.sum())])


def test_every_case_of_the_issue_is_there() -> None:
    assert len(CASES) == 29
    assert [name for name, case in CASES.items() if not case.benign] == [
        *("paper-30", "gain-50", "sigma-half", "sigma-double", "torque-0.1", "torque-0.5", "torque-1"),
        *("scale", "gain", "lag", "cubic", "friction", "backlash", "snap"),
    ]
    hidden = {name: [one.kind.key for one in case.model.effects] for name, case in CASES.items() if case.model.effects}
    assert hidden == {
        "scale": ["torque_gain"],
        "gain": ["torque_gain"],
        "lag": ["torque_lag"] * 2,
        "cubic": ["cubic_stiffness"] * 2,
        "friction": ["motor_coulomb"] * 2,
        "backlash": ["backlash"],
    }
    assert not CASES["fixed"].arm.free and CASES["fixed"].arm.gravity == (0.0, 0.0, 0.0)
    assert {name: case.scenario.duration_s for name, case in CASES.items() if name.startswith("paper")} == {
        "paper-30": 30.0,
        "paper-60": 60.0,
        "paper-120": 120.0,
        "paper-300": 300.0,
    }
    assert CASES["modern-500"].plant.period_s == pytest.approx(0.002)
    assert CASES["modern-200"].plant.joints[0].link_encoder.quantum_rad == 2.0 * np.pi / 2**20
    assert chosen(list(CASES.values()), []) == tuple(CASES.values())


def test_the_bound_of_a_case_is_what_errors_are_divided_by(arm: Arm, true: Floats) -> None:
    case = replace(CASES["torque-0.5"], scenario=replace(CASES["torque-0.5"].scenario, duration_s=4.0))
    line = Limit(case, "").run()
    (found,) = bound(case.plant, case.model, case.scenario)
    np.testing.assert_allclose(line["percent"], found.percent, rtol=1e-9)
    assert found.torque_relative_sigma == (0.005, 0.005)
    value = (true * (1.0 + 0.03 * np.array(line["percent"]) / 100.0)).tolist()
    column = {"seed": [0], "draw": [0], "validity": ["valid"], "reason": [""], "value": [value],
              "half95": [value], "sigma": [value]}  # fmt: skip
    answers = {one.name: column for one in ESTIMATORS}
    entries = summarise([case], [{"case": case.name, "answers": answers}, line])
    assert [entry["times_bound"] for entry in entries] == pytest.approx([0.03] * len(ESTIMATORS))
    without = summarise([case], [{"case": case.name, "answers": answers}])
    assert all(entry["times_bound"] is None for entry in without)


def test_a_case_with_effects_has_no_bound() -> None:
    case = CASES["paper-60"]
    friction = effect("motor_coulomb", case.arm.joints[0].name, 0.1)
    line = Limit(replace(case, model=replace(case.model, effects=(friction,))), "").run()
    assert line["percent"] is None and "not for effects" in line["why"]


def test_refinement_is_asked_of_the_first_seeds_of_planar_arms() -> None:
    (one,) = (each for each in ESTIMATORS if each.name == "refined")
    assert one.fits(CASES["paper-60"].arm) and not one.fits(CASES["spatial"].arm)
    assert [seed for seed in range(20) if one.takes(seed, 0)] == list(range(10)) and not one.takes(0, 1)


@pytest.mark.slow
def test_what_refinement_does_not_publish_is_refused() -> None:
    """Torques that are noisier than declared: the rule is named, and nothing is counted."""
    case = CASES["torque-1"]
    motion = trajectory_of(case.plant, case.model, case.scenario, seeds=[0], duration_s=20.0, noise=True)
    _, frames = sensed(case, motion, 0, 0)
    answer = refined(CASES["paper-60"].arm, frames, Prior(0.0))
    assert (answer.validity, answer.value) == ("refused", None)
    assert "level" in answer.reason or "start" in answer.reason


def test_a_campaign_has_at_least_so_many_draws() -> None:
    """50 seeds, and 1,000 draws of each case by default."""
    work = cells([CASES["paper-60"]], 60, 1000)
    assert [seed for cell in work for seed in cell.seeds] == list(range(60))
    assert sum(len(cell.seeds) * cell.draws for cell in work) >= 1000
    assert len({cell.key for cell in work}) == len(work)


# Figure 4


@pytest.mark.slow
def test_figure_4_predicts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(response, "DURATION_S", 20.0)
    case = CASES["lively"]
    short = replace(case.scenario, duration_s=30.0)
    figure = Figure4(replace(case, scenario=short), 0, "").run()
    # two integrators
    assert figure["servo_rms_rad"]["true"] < 1e-4
    at = figure["horizon_s"].index(pytest.approx(2.0))
    apart = {name: error[at] for name, error in figure["arcs_rad"].items()}
    assert apart["true"] < 1e-5
    assert apart["true"] < 0.1 * apart["flight"]
    assert apart["flight"] < 0.5 * min(apart["+10 %"], apart["−10 %"], apart["EB"])
    assert figure["missing"] == {}


@pytest.mark.slow
def test_figure_4_has_the_torques_of_the_paper(pictured: Path, arm: Arm, model: Model) -> None:
    """The curves of the response to (50), the paper's own estimates among them."""
    lines = map(json.loads, (pictured / "cells.jsonl").read_text().splitlines())
    figure = next(line for line in lines if line.get("figure"))
    assert figure["missing"] == {}
    true = model.base_values(arm)
    for name, values in (
        ("true", true),
        (PRINTED, printed.eb_values(true, arm.parameter_names)),
        ("+10 %", 1.1 * true),
    ):
        wanted = response.respond(arm, values, 1.0)
        np.testing.assert_allclose(np.array(figure["free"][name]).T, wanted, atol=1e-5)
    assert len(figure["time_s"]) == len(figure["free"]["true"][0])
    assert 1.0 <= figure["parting"] < response.PARTING
    off = figure["free_rms_percent"]
    assert off["flight"] < 0.1 * min(off[PRINTED], off["+10 %"], off["−10 %"])


def test_figure_4_says_what_it_cannot_draw(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    """In ten seconds the arm does not show all its parameters."""
    monkeypatch.setattr(response, "DURATION_S", 20.0)
    short = replace(CASES["paper-60"], scenario=replace(scenario, duration_s=10.0))
    figure = Figure4(short, 0, "").run()
    assert figure["missing"]["flight"] == "not all parameters are known"
    assert "flight" not in figure["free"]

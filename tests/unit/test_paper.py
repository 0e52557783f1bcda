# SPDX-License-Identifier: MIT
"""The paper's own run: what it prints, what the methods and the flight chain reach on it, and the response to (50)."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run
from numpy.typing import NDArray
from paper_support import SEEDS, paper_run
from runs_support import trajectory_of
from scipy.integrate import solve_ivp

from conftest import PAPER
from zygos.arm import Arm, load_arm
from zygos.dynamics.equations import equations
from zygos.errors import ZygosError
from zygos.model.model import Model, load_model
from zygos.paper import printed, readings, response, tables
from zygos.paper.methods import Record, de, eb, exact_record, noisy_states
from zygos.paper.tables import flight_estimates, load_example, noisy_record
from zygos.simulation.plant import Trajectory
from zygos.simulation.scenario import Scenario, load_scenario

Floats = NDArray[np.float64]


@cache
def hardware() -> tuple[Arm, Floats]:
    arm = load_arm(PAPER / "arm.toml")
    return arm, load_model(PAPER / "model.toml").base_values(arm)


def exact() -> Record:
    model, scenario = load_model(PAPER / "model.toml"), load_scenario(PAPER / "scenario.toml")
    return exact_record(simulated(hardware()[0], model, scenario, seeds=[0], noise=False))


def simulated(arm: Arm, model: Model, scenario: Scenario, *, noise: bool, **options: Any) -> Trajectory:
    """A run; one with noise at a tolerance that is fine enough for all comparisons here."""
    tolerance = {"rtol": 1e-9, "atol": 1e-11} if noise else {}
    return trajectory_of(arm, model, scenario, noise=noise, **(options | tolerance))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs come from the cache, and the response to (50) takes a sixth of its time: 20 s."""
    monkeypatch.setattr(tables, "simulate", simulated)
    monkeypatch.setattr(readings, "simulate", simulated)
    monkeypatch.setattr(response, "DURATION_S", response.DURATION_S / 6.0)
    monkeypatch.setattr(tables, "INSTANTS_S", tuple(instant / 6.0 for instant in tables.INSTANTS_S))


def errors(value: Floats) -> dict[str, Floats]:
    """Of each parameter, per cent, over the seeds."""
    arm, true = hardware()
    return dict(zip(arm.parameter_names, (100.0 * (value / true - 1.0)).T, strict=True))


def expect(found: Floats, mean: float, error: float) -> None:
    """The mean over the seeds is a known one, measured over other seeds with that standard error, within three."""
    own = float(np.std(found, ddof=1)) / math.sqrt(len(found))
    assert abs(float(np.mean(found)) - mean) <= 3.0 * math.hypot(own, error), (np.mean(found), own)


# what is printed


def test_the_example_is_the_paper_s() -> None:
    """Table I and II, (47), (49), h and T, written out a second time."""
    arm, model, scenario = hardware()[0], load_model(PAPER / "model.toml"), load_scenario(PAPER / "scenario.toml")
    assert [body.mass.value for body in model.bodies] == [4000.0, 200.0, 1000.0]
    assert [body.inertia[5].value for body in model.bodies] == [666.7, 33.3, 50.0]
    assert [joint.stiffness.value for joint in model.joints] == [1000.0, 1000.0]
    assert [joint.damping.value for joint in model.joints] == [85.0, 75.0]
    assert [joint.rotor_inertia.value for joint in model.joints] == [1.0, 1.0]
    assert [joint.gear_ratio for joint in arm.joints] == [50.0, 50.0]
    assert arm.period_s == 0.05
    assert scenario.angular_momentum_nms == 1.0
    assert (scenario.controller.kp, scenario.controller.kd) == (1000.0, 250.0)
    t = np.linspace(0.0, 60.0, 601)
    desired, rate = scenario.desired([joint.name for joint in arm.joints], t)
    amplitude, omega = np.radians([20.0, 40.0]), np.array([0.25, 0.5])
    np.testing.assert_allclose(desired, amplitude * np.sin(t[:, None] * omega), atol=1e-15)
    np.testing.assert_allclose(rate, amplitude * omega * np.cos(t[:, None] * omega), atol=1e-15)


def test_the_true_values_are_the_printed_ones_to_all_digits() -> None:
    arm, true = hardware()
    for name, value in zip(arm.parameter_names, true, strict=True):
        assert abs(value - printed.ACTUAL[name]) <= 0.5 * (1.0 + 1e-9), name


def test_table_3_agrees_with_table_4_but_for_the_sign_of_de() -> None:
    """The last digit of an estimate is 1 in SI units, for the rotors 0.1."""
    for name, actual in printed.ACTUAL.items():
        step = 0.5 * (0.1 if name.startswith("Im") else 1.0)
        for method, sign in (("EB", 1.0), ("DE", -1.0)):
            error = sign * printed.ERRORS[method][name] / 100.0
            off = printed.ESTIMATES[method][name] - actual * (1.0 + error)
            assert abs(off) <= step + 0.5 * abs(1.0 + error) + 1e-9, (method, name)
    assert all(printed.ESTIMATES["DE"][n] > a and printed.ERRORS["DE"][n] < 0.0 for n, a in printed.ACTUAL.items())


def test_agreement() -> None:
    assert printed.agreement(-3.0, -5.0) == "sign, size"
    assert printed.agreement(-3.0, -6.1) == "sign"
    assert printed.agreement(3.0, -5.0) == "size"
    assert printed.agreement(0.0, -5.0) == "–"
    assert printed.agreement(-1e-11, 1e-9) == "rounding"


# Table IV


def test_the_equations_of_motion_fail_as_printed() -> None:
    """Signs all as in Table IV; b1 is printed as -143.8 %."""
    found = errors(de.estimate(hardware()[0], noisy_record(hardware()[0], paper_run())))
    for name, error in printed.ERRORS["DE"].items():
        assert np.all(np.sign(found[name]) == np.sign(error)), name
    for name in ("a00", "a01", "a02", "a11", "a12", "a22"):
        assert np.all(np.abs(found[name] - printed.ERRORS["DE"][name]) < 1.5), name
    expect(found["b1"], -144.08, 0.09)
    expect(found["b2"], -57.23, 0.05)
    expect(found["Im1"], -91.81, 0.07)
    expect(found["Im2"], -82.07, 0.15)
    expect(found["k1"], -89.13, 0.08)
    expect(found["k2"], -74.08, 0.03)
    assert abs(np.mean(found["b1"]) - printed.ERRORS["DE"]["b1"]) < 2.0


def test_the_energy_balance_with_backward_differences() -> None:
    arm = hardware()[0]
    found = errors(eb.estimate(arm, noisy_record(arm, paper_run())))
    expect(np.mean(np.abs(list(found.values())), axis=0), 15.43, 0.13)
    expect(found["a00"], -23.24, 0.29)
    expect(found["b1"], 10.49, 0.27)


@pytest.mark.slow
def test_the_energy_balance_with_the_noise_of_32() -> None:
    """Independent noise on exact states: half the error of differences, and nearer to the printed sizes."""
    arm = hardware()[0]
    found = errors(eb.estimate(arm, noisy_states(arm, exact(), range(SEEDS)), rates="exact"))
    size = np.mean(np.abs(list(found.values())), axis=0)
    expect(size, 8.17, 0.17)
    assert np.mean(np.abs(list(printed.ERRORS["EB"].values()))) < np.mean(size) < 11.0


def test_exact_data_leave_the_energy_at_the_start() -> None:
    """Sizes as in the column for exact data; they are those of T(0), and vanish where it is subtracted."""
    arm = hardware()[0]
    record = exact()
    left = np.abs(list(errors(eb.estimate(arm, record, rates="exact")).values()))
    shown = np.abs(list(printed.ERRORS["EB, exact data"].values()))
    assert 0.3 * np.mean(shown) < np.mean(left) < 3.0 * np.mean(shown)
    assert np.max(left) < 3.0 * np.max(shown)
    without = np.abs(list(errors(eb.estimate(arm, record, rates="exact", start="first")).values()))
    assert np.max(without) < 1e-3 * np.mean(left)
    assert np.max(np.abs(list(errors(de.estimate(arm, record, exact=True)).values()))) < printed.ROUNDING


def test_the_flight_chain_on_the_paper_s_own_motion() -> None:
    """From CAN frames: no bias that shows over the seeds, and a spread that is a hundredth of EB's error."""
    found = errors(flight_estimates(hardware()[0], paper_run()))
    expect(np.mean(np.abs(list(found.values())), axis=0), 0.1765, 0.0132)
    rms = [math.sqrt(np.mean(each**2)) for each in found.values()]
    assert np.mean(rms) <= 0.30
    for name, each in found.items():
        assert abs(np.mean(each)) <= 3.0 * np.std(each, ddof=1) / math.sqrt(SEEDS) + 0.05, name


def test_noise_of_32_has_the_printed_variances() -> None:
    """q = 0.003 rad, T = 0.05 s: q²/12, 2 q²/12/T², 4 q²/12/T⁴, nothing in common."""
    arm = hardware()[0]
    n = 4000
    zero = np.zeros((1, n, 2))
    still = Record(zero, zero, zero, zero[..., 0], zero, zero, zero, zero, zero, zero[..., 0])
    noisy = noisy_states(arm, still, [0])
    assert noisy.qd is not None and noisy.thetad is not None and noisy.qdd is not None and noisy.thetadd is not None
    kinds = [(noisy.q, 7.5e-7), (noisy.theta, 7.5e-7), (noisy.qd, 6e-4), (noisy.thetad, 6e-4)]
    kinds += [(noisy.qdd, 0.48), (noisy.thetadd, 0.48)]
    for values, variance in kinds:
        assert abs(np.var(values) / variance - 1.0) <= 3.0 * math.sqrt(2.0 / (2 * n))
    columns = np.concatenate([values[0] for values, _ in kinds], axis=1)
    together = np.corrcoef(columns.T) - np.eye(columns.shape[1])
    assert np.max(np.abs(together)) <= 5.0 / math.sqrt(n)
    np.testing.assert_array_equal(noisy_states(arm, still, [1, 0]).q[1], noisy.q[0])
    with pytest.raises(ZygosError, match="no exact rates"):
        noisy_states(arm, replace(still, qdd=None), [0])
    with pytest.raises(ZygosError, match="no exact accelerations"):
        de.estimate(arm, replace(still, f0d=None), exact=True)


# Figure 4


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_the_response_is_that_of_pinocchio_and_another_integrator() -> None:
    """Under (50), written out a second time."""
    arm, true = hardware()
    motion = equations(arm, load_model(PAPER / "model.toml"), "pinocchio")
    ours = response.respond(arm, true, 1.0)
    # all of the arm turns as one: h over the inertia of the stretched arm about its centre of mass
    names = list(arm.parameter_names)
    whole = sum(
        true[names.index(n)] * (1.0 if n[1] == n[2] else 2.0) for n in ("a00", "a01", "a02", "a11", "a12", "a22")
    )

    def rate(t: float, x: Floats) -> Floats:
        tau = np.array([[0.5 * math.cos(t), 0.1 * math.cos(0.1 * t)]])
        base = np.array([[0.0, 0.0, x[0]]])
        turn, q, m = motion.accelerations(x[None, 1:3], x[None, 3:5], base, x[None, 5:7], x[None, 7:9], tau)
        return np.concatenate([np.ravel(turn)[-1:], x[5:9], q[0], m[0]])

    start = np.array([1.0 / whole, *np.zeros(8)])
    end = solve_ivp(rate, (0.0, 20.0), start, method="LSODA", rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(ours[-1], end[1:3], atol=1e-7)


@pytest.mark.slow
def test_copies_of_the_arm_stay_together_under_50() -> None:
    """So the responses differ by their parameters; and the paper's own do not beat a common error of 10 %."""
    arm, true = hardware()
    straight = response.respond(arm, true, 1.0)
    aside = response.respond(arm, true, 1.0, 1e-3)
    assert np.max(np.abs(aside - straight)) < response.PARTING * 1e-3
    sets = {"printed": printed.eb_values(true, arm.parameter_names), "up": 1.1 * true, "down": 0.9 * true}
    rms = {
        name: math.sqrt(np.mean(response.apart_percent(response.respond(arm, values, 1.0), straight) ** 2))
        for name, values in sets.items()
    }
    assert 0.5 < rms["printed"] / rms["up"] < 1.0
    assert rms["up"] < rms["down"]
    flight = flight_estimates(arm, replace(paper_run(), seeds=(0,)))[0]
    ours = response.apart_percent(response.respond(arm, flight, 1.0), straight)
    assert math.sqrt(np.mean(ours**2)) < 0.1 * rms["printed"]


def test_apart_is_relative_to_the_largest_angle_so_far() -> None:
    true = np.array([[0.0, 1.0], [-2.0, 0.5], [1.0, 0.0]])
    found = response.apart_percent(true + 0.01, true)
    np.testing.assert_allclose(found, [[0.0, 1.0], [0.5, 1.0], [0.5, 1.0]])


# the command


@pytest.mark.usefixtures("short")
def test_paper_prints_what_the_paper_prints(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("paper", "--seeds", SEEDS, "--example", PAPER, "--json", tmp_path / "paper.json") == 0
    said = capsys.readouterr().out
    heads = {*printed.PARAMETERS, "shoulder", "elbow"}
    rows = [line for line in said.splitlines() if line.partition(" ")[0] in heads]
    assert len(rows) == 4 * 12 + 2 * 7
    assert max(map(len, rows)) <= 80
    assert "opposite sign of their error" in said
    content = json.loads((tmp_path / "paper.json").read_text())
    assert content["printed"]["errors_percent"]["EB"]["b2"] == -5.4391
    assert content["printed"]["agreement"]["DE"]["b1"] == "sign, size"
    assert set(content["printed"]["agreement"]) == {"DE", "EB", "DE, exact data", "EB, exact data"}
    figure = content["figure4b"]
    assert set(figure["error_percent"]) == {"EB printed", "EB", "flight", "+10 %", "-10 %"}
    assert figure["parting"] < response.PARTING
    assert all(len(joint) == len(figure["time_s"]) for each in figure["error_percent"].values() for joint in each)


@pytest.mark.usefixtures("short")
def test_readings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    every = readings.READINGS
    monkeypatch.setattr(readings, "READINGS", every[-1:])
    out = tmp_path / "r.json"
    assert run("paper", "--readings", "--seeds", SEEDS, "--example", PAPER, "--json", out) == 0
    said = capsys.readouterr().out
    assert "one row in ten" in said
    assert max(len(line) for line in said.splitlines() if line.startswith((" ", "printed", "one row"))) <= 80
    assert max(len(reading.description) for reading in every) <= len("servo: tau, not n tau")
    (found,) = json.loads(out.read_text())["readings"]
    assert found["DE"]["signs"] == 12
    assert -20.0 < found["EB"]["error_percent"]["a00"] < -13.0  # all rows give -23 %


def test_readings_of_another_arm_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("paper", "--readings", "--example", PAPER.parent / "spatial") == 2
    for name in ("arm.toml", "model.toml", "scenario.toml"):
        text = (PAPER / name).read_text()
        (tmp_path / name).write_text(text.replace('"planar-symmetric"', '"planar"'))
    assert run("paper", "--readings", "--example", tmp_path) == 2
    assert "not those of the paper's Table III" in capsys.readouterr().err
    assert run("paper", "--readings", "--example", PAPER.parent / "lively") == 2
    assert run("paper", "--readings", "--example", PAPER, "--json", PAPER / "arm.toml") == 2
    assert load_example(PAPER).arm.name == "paper"

# SPDX-License-Identifier: MIT
"""The demo's page: whole in one file, honest about what is missing, and its ledger adds up."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plant_support import lively

from zygos.arm import Arm
from zygos.demo.page import Convergence, write_report
from zygos.estimation.ledger import balance
from zygos.native.flight import Estimate, Trace
from zygos.runs.cycles import Cycles

TRUE = np.array([24e3, 42e3, 9.6e3, 82e3, 20e3, 5e3, 1.0, 3000.0, 85.0, 1.0, 1000.0, 75.0])
N = 120
GAP, ORIGIN = 60, 70  # a SYNC is missing before cycle 60; the next arc begins at cycle 70
REFUSED = [30, 31, 90]


def make_trace(arm: Arm, value: NDArray[np.float64] = TRUE) -> Trace:
    """Two arcs whose rows satisfy the balance exactly; refused rows are off by 1e6 J."""
    rng = np.random.default_rng(1)
    sync = np.arange(N, dtype=np.uint64)
    sync[GAP:] += 5
    instant = np.ones(N, bool)
    instant[:9] = instant[GAP:ORIGIN] = False
    accepted = instant.copy()
    accepted[REFUSED] = False
    row = rng.uniform(0.1, 2.0, (N, len(value) + 1))
    for first, last in ((9, GAP), (ORIGIN, N)):
        for k in (8, 11):
            row[first:last, k] = np.cumsum(row[first:last, k]) - row[first, k]
        work = row[first:last, :-1] @ value
        row[first:last, -1] = work - work[0]
    row[REFUSED, -1] += 1e6
    state = rng.normal(size=(N, 4 * arm.n + 3))
    row[~instant] = state[~instant] = 1e300
    q, theta, tau = (rng.normal(size=(N, arm.n)) for _ in range(3))
    cycles = Cycles(sync=sync, q=q, theta=theta, tau=tau, omega=rng.normal(size=(N, 3)), flags=np.zeros(N, np.uint32))
    return Trace(cycles, instant, accepted, state, row, np.zeros(N, bool))


def make_estimate(arm: Arm, value: NDArray[np.float64], **changes: Any) -> Estimate:
    p = len(value)
    estimate = Estimate(
        names=arm.parameter_names,
        units=arm.parameter_units,
        solution=value,
        value=value,
        sigma=0.005 * np.abs(value),
        half95=0.01 * np.abs(value),
        covariance=np.diag((0.005 * value) ** 2),
        validity="valid",
        reason="",
        cycle=N + 4,
        accepted=98,
        refused=3,
        arcs=2,
        blocks=30,
        rank=p,
        condition=5e4,
        cluster=0.3,
        residual=20.0,
        noise_ratio=1.0,
        signal_to_noise=50.0,
    )
    return replace(estimate, **changes)


def page_of(
    folder: Path, arm: Arm, trace: Trace, estimate: Estimate, m: int = 8, faults: dict[str, int] | None = None
) -> tuple[str, dict[str, Any]]:
    """The page and the data its charts draw."""
    p = len(estimate.value)
    value = estimate.value * (1.0 + 1.0 / np.arange(1, m + 1)[:, None])
    value[:2] = np.nan
    convergence = Convergence(np.arange(m, dtype=float), value, np.full((m, p), 0.1))
    content = {"bus": "virtual test", "cycles": len(trace.cycles), "faults": faults or {"crc": 0, "sync_jumped": 0}}
    write_report(folder / "report.html", arm, trace, estimate, 1.001 * estimate.value, TRUE, convergence, content)
    text = (folder / "report.html").read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found

    def no_constant(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    return text, json.loads(found[1], parse_constant=no_constant)


def test_page_is_self_contained_and_names_every_parameter(tmp_path: Path) -> None:
    arm = lively()[0]
    text, data = page_of(tmp_path, arm, make_trace(arm), make_estimate(arm, 1.01 * TRUE))
    # a favicon in the page keeps the browser from asking for one
    assert re.findall(r"<link[^>]*>", text) == ['<link rel="icon" href="data:,">']
    assert not re.search(r"https?:|//[a-z]|\bsrc\s*=|@import|url\(|\bimport\b|fetch\(|XMLHttp", text)
    for name in arm.parameter_names:
        assert f"<code>{name}</code>" in text
        assert name in {chart["title"] for chart in data["charts"].values()}
    assert "12 parameters learned from 120 cycles over CAN (virtual test), with a mean error of 1 %" in text
    assert {f'data-chart="{name}"' for name in data["charts"]} == set(re.findall(r'data-chart="[^"]*"', text))
    assert len(text) < 500_000


def test_refused_instants_and_gaps(tmp_path: Path) -> None:
    arm = lively()[0]
    trace = make_trace(arm)
    text, data = page_of(tmp_path, arm, trace, make_estimate(arm, TRUE), faults={"crc": 2, "sync_jumped": 1})
    assert data["refused"] == REFUSED
    absent = np.flatnonzero(~trace.instant).tolist()
    for name in ("angles", "deflection", "base", "energy", "residual"):
        for series in data["charts"][name]["series"]:
            assert [k for k, y in enumerate(series["y"]) if y is None] == absent
    assert [k for k, y in enumerate(data["charts"]["torque"]["series"][0]["y"]) if y is None] == [GAP]
    # smoothed states lie one lag behind the cycle that completed them
    lag = arm.smoother.lag * arm.period_s
    np.testing.assert_allclose(data["times"]["cycle"][GAP], 65 * arm.period_s)
    np.testing.assert_allclose(data["times"]["state"], np.array(data["times"]["cycle"]) - lag, atol=1e-5)
    assert "3 frames or cycles were rejected" in text
    assert "None: every frame" not in text


def test_page_with_parameters_that_are_not_identifiable(tmp_path: Path) -> None:
    arm = lively()[0]
    value = TRUE.copy()
    value[[3, 11]] = np.nan
    reason = "the motion so far does not excite every parameter"
    estimate = make_estimate(arm, value, validity="partial", reason=reason, rank=10)
    text, data = page_of(tmp_path, arm, make_trace(arm), estimate)
    assert "10 of 12 parameters learned" in text
    assert "Not identifiable from this run: a11, b2." in text
    assert "The motion so far does not excite every parameter." in text
    assert "energy" not in data["charts"]
    assert "residual" not in data["charts"]
    assert "angles" in data["charts"]
    assert not re.search(r"\bnan\b", text, re.IGNORECASE)
    for name in arm.parameter_names:
        assert f"<code>{name}</code>" in text


@pytest.mark.parametrize("cycles", [0, N])
def test_page_of_a_run_that_gave_nothing(tmp_path: Path, cycles: int) -> None:
    arm = lively()[0]
    full = make_trace(arm)
    c = full.cycles
    trace = Trace(
        Cycles(c.sync[:cycles], c.q[:cycles], c.theta[:cycles], c.tau[:cycles], c.omega[:cycles], c.flags[:cycles]),
        np.zeros(cycles, bool),
        np.zeros(cycles, bool),
        full.state[:cycles],
        full.row[:cycles],
        full.waited[:cycles],
    )
    nothing = np.full(12, np.nan)
    estimate = make_estimate(arm, nothing, validity="refused", reason="too few accepted instants", residual=np.nan)
    text, _ = page_of(tmp_path, arm, trace, estimate, m=2 if cycles else 0)
    assert f"No parameter could be learned from {cycles} cycles" in text
    assert "Too few accepted instants." in text


def test_names_cannot_break_the_page(tmp_path: Path) -> None:
    arm = lively()[0]
    bad = "</script><script>x"
    arm = replace(arm, joints=(replace(arm.joints[0], name=bad), arm.joints[1]))
    text, data = page_of(tmp_path, arm, make_trace(arm), make_estimate(arm, TRUE))
    assert bad not in text
    assert data["charts"]["deflection"]["series"][0]["label"] == bad


def test_ledger_adds_up() -> None:
    arm = lively()[0]
    trace = make_trace(arm)
    ledger = balance(arm, trace, TRUE)
    used = trace.accepted
    assert ledger.arcs == 2
    np.testing.assert_allclose(ledger.residual[used], 0.0, atol=1e-8)
    np.testing.assert_allclose(ledger.residual[REFUSED], 1e6)
    stored = ledger.kinetic + ledger.elastic + ledger.dissipated
    np.testing.assert_allclose(ledger.supplied[used], stored[used])
    row = trace.row[used]
    np.testing.assert_allclose(ledger.kinetic[used], row[:, [0, 1, 2, 3, 4, 5, 6, 9]] @ TRUE[[0, 1, 2, 3, 4, 5, 6, 9]])
    np.testing.assert_allclose(ledger.elastic[used], row[:, [7, 10]] @ TRUE[[7, 10]])
    np.testing.assert_allclose(ledger.dissipated[used], row[:, [8, 11]] @ TRUE[[8, 11]])
    assert np.isnan(ledger.supplied[~trace.instant]).all()

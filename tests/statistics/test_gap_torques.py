# SPDX-License-Identifier: MIT
"""Torque sensors with noise and wrong gains, which the arm file says nothing of."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from gap_support import example, noisy

from zygos.gap.explain import explain
from zygos.gap.forecast import Forecast
from zygos.gap.record import MeasuredRun, read_measured_run
from zygos.gap.torques import with_torque_noise
from zygos.native.flight import encode

NOISE = np.array([0.04, 0.02])
"""Nm."""
JITTER = 0.03
"""Nm: of a servo that reads its encoders otherwise than they are recorded."""


@cache
def clean(name: str, duration_s: float = 16.0) -> MeasuredRun:
    """A run of the example's arm, whose torques have no error."""
    run = noisy(name, duration_s)
    return read_measured_run(run.arm, Path(f"{name}.blf"), encode(run.arm, run.cycles()))


def changed(run: MeasuredRun, seed: int, noise: float = 1.0, gain: float = 0.0, jitter: float = 0.0) -> MeasuredRun:
    """The run with noise of its torque sensors, and a wrong gain of the second one."""
    random = np.random.default_rng(seed)
    tau = run.samples.tau.copy()
    tau[:, 1] *= 1.0 + gain
    tau += noise * NOISE * random.standard_normal(tau.shape)
    # the differences of a rounding error, whose impulse stays small
    tau += jitter * np.diff(random.standard_normal((len(tau) + 1, tau.shape[1])), axis=0) / np.sqrt(2.0)
    return replace(run, samples=replace(run.samples, tau=tau))


def found(*runs: MeasuredRun) -> tuple[np.ndarray, np.ndarray]:
    """Likely and largest noise, Nm."""
    arms = with_torque_noise(runs[0].arm, runs)
    likely, most = (np.array([joint.torque_sigma for joint in arm.joints]) for arm in arms)
    return likely, most


def test_noise_is_found() -> None:
    likely, most = found(changed(clean("a"), 0), changed(clean("b"), 1))
    np.testing.assert_allclose(likely, NOISE, rtol=0.25)
    assert np.all(most > 0.9 * NOISE)


@pytest.mark.slow
def test_jitter_that_acts_is_no_noise() -> None:
    likely, _ = found(*(changed(clean(name), k, noise=0.0, jitter=JITTER) for k, name in enumerate("ab")))
    # the fast part of the torques alone says 0.03 Nm
    assert np.all(likely < 0.4 * JITTER)


def test_noise_beside_jitter_is_found() -> None:
    likely, most = found(*(changed(clean(name), k, jitter=JITTER) for k, name in enumerate("ab")))
    assert likely[0] == pytest.approx(NOISE[0], rel=0.3)
    # of a quarter of a minute, 0.02 Nm are not told from none
    assert likely[1] < 1.3 * NOISE[1] < 1.5 * most[1]


def test_torques_without_noise_have_none() -> None:
    likely, most = found(clean("a"), clean("b"))
    assert not likely.any()
    assert not most.any()


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "answer"), [(0.0, ""), (0.03, "remark"), (0.2, "named")])
def test_a_wrong_gain_is_said(gain: float, answer: str) -> None:
    runs = [changed(clean(name, 30.0 if answer == "named" else 16.0), k, gain=gain) for k, name in enumerate("abc")]
    verdict = explain(runs[0].arm, example()[1], runs[:2], runs[2:])
    gains = [finding for finding in verdict.findings if finding.kind == "torque_gain"]
    assert bool(gains) == (answer == "named")
    assert ("gain" in verdict.sentence) == bool(gains)
    assert any("gain" in note for note in verdict.notes) or answer != "remark"
    if gains:
        assert verdict.answer == "named"
        assert gains[0].joint == "elbow"
        assert gains[0].value == pytest.approx(1.0 / (1.0 + gain) - 1.0, abs=0.002)
    else:
        assert verdict.answer in {"nothing missing", "values differ"}


def test_predictions_are_told_apart_by_run() -> None:
    values, solver = np.arange(4.0)[:, None, None], np.zeros((4, 1, 1))
    both = Forecast(values, np.zeros((4, 1, 1)), solver, np.array([0, 0, 1, 1]))
    assert both.of_run(0).median == pytest.approx(0.5)
    assert both.of_run(1).median == pytest.approx(2.5)

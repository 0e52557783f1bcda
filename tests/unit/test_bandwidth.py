# SPDX-License-Identifier: MIT
"""The bandwidth test of an arm on the ground at several cut-offs, against numpy and the response of the filter."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from ground_support import short_arm
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from zygos.arm import Arm, smoother_at
from zygos.errors import ZygosError
from zygos.native.flight import Estimate, Flight
from zygos.runs.cycles import Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth

Floats = NDArray[np.float64]
CUTOFFS = [(5.0, 0.01), (5.0, 0.02), (10.0, 0.01), (20.0, 0.003)]
"""Cut-off, Hz, and period, s."""


def arm_at(cutoff_hz: float, period_s: float) -> Arm:
    arm, _ = short_arm(2)
    return replace(arm, period_s=period_s, smoother=smoother_at(cutoff_hz, period_s))


def cycles_of(angles: Floats) -> Cycles:
    """(m, 2) angles as the encoders read them, without torques."""
    m = len(angles)
    still = np.zeros((m, 2))
    return Cycles(np.arange(m, dtype=np.uint64), angles, angles, still, np.zeros((m, 3)), np.zeros(m, dtype=np.uint32))


def refused(arm: Arm, angles: Floats) -> tuple[float, Estimate]:
    """Share of the instants that the library refuses, which must be numpy's, and the estimate."""
    cycles = cycles_of(angles)
    flight = Flight(arm)
    flight.cycles(cycles)
    sums = flight.native.sums.joints
    accepted = smooth(arm, calibrate(arm, cycles)).accepted
    assert (sums.accepted, sums.refused) == (accepted.sum(), (~accepted).sum())
    return float(np.mean(~accepted)), flight.estimate()


def sines(arm: Arm, cycles_per_s: float, size: float, m: int = 6000) -> Floats:
    turn = 2.0 * math.pi * cycles_per_s * arm.period_s * np.arange(m)
    return size * np.column_stack([np.sin(turn), np.cos(turn + 1.0)])


@pytest.mark.parametrize(("cutoff", "period"), CUTOFFS)
def test_a_motion_within_the_cutoff_passes_and_one_beyond_it_is_too_fast(cutoff: float, period: float) -> None:
    arm = arm_at(cutoff, period)
    quantum = np.array([joint.motor_encoder.quantum_rad for joint in arm.joints])
    share, _ = refused(arm, quantum * np.round(sines(arm, 0.1 * cutoff, 0.3) / quantum))
    by_chance = 2 * math.erfc(4.0 / math.sqrt(2.0))  # of two joints
    assert share <= by_chance + 3.0 * math.sqrt(by_chance / 6000)
    share, estimate = refused(arm, quantum * np.round(sines(arm, 1.5 * cutoff, 0.3) / quantum))
    assert share > 0.98
    assert (estimate.validity, estimate.reason[:15]) == ("refused", "motion too fast")


@pytest.mark.parametrize(("cutoff", "period"), CUTOFFS)
def test_the_size_of_a_sine_from_which_it_is_refused_follows_from_the_response(cutoff: float, period: float) -> None:
    """Of a sine whose slopes differ by at most twice the limit, a third of each half turn is below it."""
    arm = arm_at(cutoff, period)
    points, order = arm.smoother.points, arm.smoother.order
    probe = savgol_coeffs(points, order, deriv=1, use="dot")
    probe -= np.pad(savgol_coeffs(points - 2, order, deriv=1, use="dot"), 1)
    f = 0.5 * cutoff
    at = np.arange(points) - points // 2
    response = abs(float(probe @ np.sin(2.0 * math.pi * f * period * at)))
    sigma = arm.joints[0].motor_encoder.over_the_wire.sigma_rad
    limit = 4.0 * sigma * float(np.linalg.norm(probe))
    angles = sines(arm, f * math.sqrt(0.98), 2.0 * limit / response)
    angles[:, 1] = 0.0
    # the response at the frequency that is fed, which is no divisor of the sampling rate
    fed = abs(float(probe @ np.sin(2.0 * math.pi * f * math.sqrt(0.98) * period * at))) / response
    share, _ = refused(arm, angles)
    assert 1.0 - share == pytest.approx(2.0 / math.pi * math.asin(0.5 / fed), abs=0.01)


def test_a_motion_that_is_refused_is_still_smoothed_well() -> None:
    """At three tenths of the cut-off, with 16-bit encoders: all is refused, and rates are right to one percent."""
    arm = arm_at(5.0, 0.01)
    share, _ = refused(arm, sines(arm, 1.5, 0.3))
    weights = savgol_coeffs(arm.smoother.points, arm.smoother.order, deriv=1, use="dot")
    turn = 2.0 * math.pi * 1.5 * arm.period_s
    gain = float(weights @ np.sin(turn * (np.arange(len(weights)) - arm.smoother.lag))) / turn
    assert share > 0.9
    assert abs(gain - 1.0) < 0.01


def test_a_window_that_the_build_does_not_hold_is_named() -> None:
    said = r"a smoother of \d+ points, this build holds 31; remedy: a period_s of at least 0.01925 .*MAX_HALF_WIDTH"
    with pytest.raises(ZygosError, match=said):
        Flight(arm_at(2.1, 0.01))
    Flight(arm_at(2.1, 0.01925))

# SPDX-License-Identifier: MIT
"""How the onboard refinement begins with a state, and what of a state cannot be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refine_support import Case, flown, learned, selected

from zygos.native.flight import Flight, ffi
from zygos.native.refine import Onboard, OnboardRefiner
from zygos.runs.cycles import Cycles

Floats = NDArray[np.float64]
FRESH_RATE = np.sqrt(530.0) / 6.0
"""Deviation of a rate by a parabola through the newest of four readings, in one, for readings with a deviation of 1:
(11, -18, 9, -2)/6."""


def started(apart: int | None = None) -> tuple[Case, OnboardRefiner, Flight, Cycles]:
    case = Case()
    flight, rest = learned(case.arm, flown(case, 0))
    task = OnboardRefiner(case.arm, Onboard(apart=apart))
    task.start(flight)
    return case, task, flight, rest


def deviations(native: Any) -> Floats:
    """(entries,) of a state that has just begun, whose rates have no covariances."""
    entries = native.filter.entries
    root = np.frombuffer(ffi.buffer(native.filter.root), dtype=np.float64)
    return np.abs([root[k * (k + 3) // 2] for k in range(entries)])


def begin(task: OnboardRefiner, rest: Cycles) -> int:
    """Cycles until the state has begun. The readings of that cycle tell nothing about rates."""
    for k in range(len(rest)):
        task.cycles(selected(rest, slice(k, k + 1)))
        if task.native.moving:
            return k + 1
    raise AssertionError("no state")


@pytest.mark.parametrize("apart", [1, 3])
def test_a_state_begins_with_four_readings_that_are_apart(apart: int) -> None:
    case, task, _, rest = started(apart)
    assert begin(task, rest) == 3 * apart + 1
    n, arm = case.arm.n, case.arm
    base = task.native.filter.propagation.moving - 4 * n
    stated = deviations(task.native)[base + 2 * n : base + 4 * n]
    encoders = [joint.link_encoder for joint in arm.joints] + [joint.motor_encoder for joint in arm.joints]
    noise = np.array([encoder.over_the_wire.sigma_rad for encoder in encoders])
    least = FRESH_RATE * noise / (apart * arm.period_s)
    readings = np.concatenate([rest.q, rest.theta], axis=1)[: 3 * apart + 1 : apart]
    parabola = np.array([0.0, 1.0, -4.0, 3.0]) @ readings / (2.0 * apart * arm.period_s)
    cubic = np.array([-2.0, 9.0, -18.0, 11.0]) @ readings / (6.0 * apart * arm.period_s)
    np.testing.assert_allclose(stated, np.abs(cubic - parabola) + least, rtol=1e-6)


@pytest.mark.parametrize("place", range(9))
def test_a_member_of_a_state_that_is_too_large_ends_the_refinement(place: int) -> None:
    _, task, _, rest = started()
    task.cycles(selected(rest, slice(0, 20)))
    assert task.native.filter.propagation.moving == 9 and task.native.filter.failed == 0
    task.native.filter.x[place] += 3e6
    task.cycles(selected(rest, slice(20, 22)))
    assert task.native.filter.failed == 1


@pytest.mark.slow
def test_what_is_told_is_what_was_found() -> None:
    _, task, flight, rest = started()
    task.cycles(selected(rest, slice(0, 1000)))
    flight.cycles(selected(rest, slice(0, 1000)))
    told = task.judge(flight)
    native = task.native
    assert told.used == native.used > 0
    np.testing.assert_array_equal(told.ratio, list(native.ratio)[: len(told.ratio)])
    np.testing.assert_array_equal(told.nis, list(native.nis)[: len(told.nis)])
    assert np.all(told.ratio > 0.0) and np.all(told.nis > 0.0)

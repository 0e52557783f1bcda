# SPDX-License-Identifier: MIT
"""Runs with one fault each, whose truth is known because it was put in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.native.flight import Flight, encode
from zygos.runs.cycles import Cycles

Fault = Callable[[Cycles], Cycles]


def over_the_bus(arm: Arm, cycles: Cycles) -> Cycles:
    """The cycles that the receiver makes of a run's frames."""
    trace = Flight(arm).frames(encode(arm, cycles), trace=True)
    assert trace is not None
    return trace.cycles


def with_column(cycles: Cycles, kind: str, i: int, values: NDArray[Any]) -> Cycles:
    readings = getattr(cycles, kind).copy()
    readings[:, i] = values
    return replace(cycles, **{kind: readings})


def scaled(kind: str, i: int, factor: float) -> Fault:
    return lambda c: with_column(c, kind, i, factor * getattr(c, kind)[:, i])


def inverted(kind: str, i: int) -> Fault:
    return scaled(kind, i, -1.0)


def swapped(kind: str, i: int, j: int) -> Fault:
    def swap(cycles: Cycles) -> Cycles:
        readings = getattr(cycles, kind)
        return with_column(with_column(cycles, kind, i, readings[:, j]), kind, j, readings[:, i])

    return swap


def exchanged(i: int) -> Fault:
    return lambda c: with_column(with_column(c, "q", i, c.theta[:, i]), "theta", i, c.q[:, i])


def stuck(kind: str, i: int, start: float, stop: float) -> Fault:
    """The signal keeps its reading from one share of the run to another."""

    def stick(cycles: Cycles) -> Cycles:
        values = getattr(cycles, kind)[:, i].copy()
        a, b = int(start * len(values)), int(stop * len(values))
        values[a:b] = values[a]
        return with_column(cycles, kind, i, values)

    return stick


def clipped(kind: str, i: int, share: float) -> Fault:
    """The signal ends at a share of its range about its mean."""

    def clip(cycles: Cycles) -> Cycles:
        values = getattr(cycles, kind)[:, i]
        middle, half = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return with_column(cycles, kind, i, np.clip(values, middle - half, middle + half))

    return clip


def shifted(kind: str, i: int, by: float) -> Fault:
    return lambda c: with_column(c, kind, i, getattr(c, kind)[:, i] + by)


def rounded(kind: str, i: int, step: float) -> Fault:
    return lambda c: with_column(c, kind, i, step * np.rint(getattr(c, kind)[:, i] / step))


def noisy(kind: str, i: int, sigma: float) -> Fault:
    return lambda c: with_column(
        c, kind, i, getattr(c, kind)[:, i] + sigma * np.random.default_rng(0).standard_normal(len(c))
    )


def both(*faults: Fault) -> Fault:
    def apply(cycles: Cycles) -> Cycles:
        for fault in faults:
            cycles = fault(cycles)
        return cycles

    return apply


def late(arm: Arm, joint: int, side: str, latch_us: int) -> Arm:
    """The arm with one encoder that latches later."""
    joints = list(arm.joints)
    joints[joint] = replace(joints[joint], **{side: replace(getattr(joints[joint], side), latch_us=latch_us)})
    return replace(arm, joints=tuple(joints))

# SPDX-License-Identifier: MIT
"""Angles of a run that start again after a turn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_BEFORE, Cycles
from zygos.runs.outliers import GAP, Floats, steps_off, unwrapped


@dataclass(frozen=True)
class Wraps:
    """What an angle does at the end of its range."""

    turn: float
    """After how much it starts again, in the unit of the readings."""
    half: str
    whole: str
    """What half of a turn and the whole are called."""
    at: NDArray[np.int64]
    """Positions of the cycles before which it did."""
    readings: Floats
    """(n,) the readings without that."""


def wraps_of(arm: Arm, cycles: Cycles, kind: str, i: int) -> Wraps | None:
    """The wraps of an angle, "q" or "theta"; None where it has none.

    All steps that no motion makes must be of one turn (2π, that of the rotor, 360, 1, or a power of two), and the angle
    must move so slowly that its turns can be counted.
    """
    joint = arm.joints[i]
    encoder = joint.link_encoder if kind == "q" else joint.motor_encoder
    readings: Floats = getattr(cycles, kind)[:, i]
    valid = np.flatnonzero(np.isfinite(readings) & ((cycles.flags & INVALID) == 0))
    if len(valid) < 3:
        return None
    x = readings[valid]
    intervals = np.diff(cycles.sync[valid].astype(np.int64)).astype(np.float64)
    broken = (cycles.flags[valid[1:]] & (BREAK_BEFORE | VOID_BEFORE)) != 0
    intervals[broken] = np.maximum(intervals[broken], 2.0 * GAP)
    jumps = np.where(intervals < GAP, steps_off(x, intervals, encoder.sigma_rad), 0.0)  # a gap hides what happened
    at = np.flatnonzero(jumps)
    if not len(at):
        return None
    size = float(np.median(np.abs(jumps[at])))
    turn, half, whole = min(_turns(arm, kind, i, encoder.counts), key=lambda one: abs(math.log(one[0] / size)))
    turned = unwrapped(x, turn, intervals)
    moved = np.abs(np.diff(turned))[intervals < GAP]
    near = limits.TURN_NEAR.value * turn
    if np.any(np.abs(np.abs(jumps[at]) - turn) > near) or np.ptp(x) > turn + near:
        return None
    if len(moved) == 0 or moved.max() > limits.TURN_SURE.value * turn:
        return None
    out = readings.copy()
    out[valid] = turned
    return Wraps(turn, half, whole, valid[np.flatnonzero(np.round(np.diff(turned - x) / turn)) + 1], out)


def _turns(arm: Arm, kind: str, i: int, counts: int | None) -> list[tuple[float, str, str]]:
    """Turns after which angles start again, and what half of each and the whole are called."""
    ratio = float(arm.joints[i].gear_ratio)
    turns = [(2.0 * math.pi, "π", "2π"), (32.0 * math.pi, "16π", "32π")]
    turns += [(turn, f"{turn / 2.0:g} {unit}", f"{turn:g} {unit}") for turn, unit in ((360.0, "deg"), (1.0, "turn"))]
    if kind == "theta" and ratio != 1.0:
        turns.append((2.0 * math.pi / ratio, f"{math.pi / ratio:.4g}", f"{2.0 * math.pi / ratio:.4g}"))
    counted = {counts, *(2**k for k in range(8, 33))} - {None}
    return turns + [(float(n), f"{n / 2.0:g} counts", f"{n} counts") for n in counted if n is not None]

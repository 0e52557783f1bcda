"""Both sides of the energy balance of a run, split by what the parameters stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import Effect
from zygos.native.flight import Trace

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Ledger:
    """Both sides of the energy balance at n cycles in J; NaN where a cycle completed no instant.

    work + constant of the arc = kinetic + elastic + dissipated + residual
    """

    kinetic: Floats
    """(n,) with the energy of position under gravity."""
    elastic: Floats
    """(n,)"""
    dissipated: Floats
    """(n,) since the origin of the arc."""
    supplied: Floats
    """(n,) work of the motors since the origin of the arc, plus the energy that was there: the arc's constant."""
    residual: Floats
    """(n,)"""
    arcs: int


def balance(arm: Arm, trace: Trace, value: Floats, effects: Sequence[Effect] = ()) -> Ledger:
    """Split each row by what its parameters, value (p,), stand for; the effects' values are the last of them.

    The constant of an arc is the mean of W - row . value over its accepted instants, as least squares has it.
    """
    row = np.where(trace.instant[:, None], trace.row, np.nan)
    terms, work = row[:, :-1] * value, row[:, -1]
    kinds = ["body"] * len(arm.body_parameters) + [kind for kind, _, _ in arm.joint_parameters]
    kinds += ["k" if effect.kind.place == "spring" else "b" for effect in effects]
    stored, lost = np.array([kind == "k" for kind in kinds]), np.array([kind == "b" for kind in kinds])
    kinetic = terms[:, ~(stored | lost)].sum(axis=1)
    elastic = terms[:, stored].sum(axis=1)
    dissipated = terms[:, lost].sum(axis=1)
    left = work - kinetic - elastic - dissipated
    # work and losses are exactly zero at the origin of an arc
    origin = trace.instant & (work == 0.0) & np.all(row[:, :-1][:, lost] == 0.0, axis=1)
    arc = np.cumsum(origin)
    arcs = int(arc[-1]) + 1 if len(arc) else 0
    of_arc = np.bincount(arc[trace.instant], minlength=arcs)
    used = trace.instant & trace.accepted
    in_use = np.bincount(arc[used], minlength=arcs)
    every = np.bincount(arc[trace.instant], left[trace.instant], minlength=arcs)
    accepted = np.bincount(arc[used], left[used], minlength=arcs)
    # an arc of which no instant was accepted has the mean of all of them
    mean = np.where(in_use > 0, accepted, every) / np.maximum(np.where(in_use > 0, in_use, of_arc), 1)
    constant = np.where(trace.instant, mean[arc] if arcs else 0.0, np.nan)
    return Ledger(kinetic, elastic, dissipated, work - constant, left - constant, int(origin.sum()))

# SPDX-License-Identifier: MIT
"""Both sides of the energy balance of a run, split by what the parameters stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.arcs import FILL_INSTANTS, arc_cycles, spans
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
    constant, arcs = np.full(len(work), np.nan), 0
    edges = np.flatnonzero(np.diff(trace.instant, prepend=False, append=False))
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        # the instants that only fill the integrals of a segment have no row
        accepted = np.concatenate([np.ones(FILL_INSTANTS, np.bool_), trace.accepted[first:last]])
        for begin, end, _ in spans(accepted, arc_cycles(arm)):
            of_arc = slice(first + begin - FILL_INSTANTS, first + end - FILL_INSTANTS)
            used = accepted[begin:end]
            constant[of_arc] = left[of_arc][used if used.any() else ~used].mean()
            arcs += 1
    return Ledger(kinetic, elastic, dissipated, work - constant, left - constant, arcs)

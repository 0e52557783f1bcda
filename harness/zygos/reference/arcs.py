"""Which arc an instant belongs to, over whole records (docs/theory.md, "Arcs and the constant that drops out")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.reference.balance import FILL_INSTANTS, End, left_out_arcs, void_arcs
from zygos.reference.cycle import Samples
from zygos.reference.smoother import Smoothed


def numbered(smoothed: Smoothed, longest: int) -> NDArray[np.int64]:
    """Number from 0 of the arc of each of m smoothed instants, (m,), -1 for those that only fill the integrals.

    An arc lies within one segment and holds at most `longest` instants.
    """
    arc = np.full(len(smoothed.index), -1, dtype=np.int64)
    arcs = 0
    for number in np.unique(smoothed.segment):
        of = np.flatnonzero(smoothed.segment == number)[FILL_INSTANTS:]
        arc[of] = arcs + np.arange(len(of)) // longest
        arcs += -(-len(of) // longest)
    return arc


def unused(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], longest: int, rows: str
) -> frozenset[int]:
    """Numbers of the arcs of `numbered` in which cycles may be missing, or which the library left out.

    rows: their kind, "motor" or "momentum".
    """
    ends = []
    for number in range(int(arc.max(initial=-1)) + 1):
        of = np.flatnonzero(arc == number)
        ends.append(End(int(smoothed.index[of[-1]]) + arm.smoother.lag, len(of) == longest))
    return void_arcs(samples, ends) | left_out_arcs(samples, ends, rows)

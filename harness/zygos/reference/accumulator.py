# SPDX-License-Identifier: MIT
"""Normal equations of the arcs (docs/theory.md, "Arcs and the constant that drops out").

The unknown constant of an arc is eliminated by subtracting the mean of its accepted rows from each of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.balances.arcs import MIN_ARC_INSTANTS
from zygos.balances.energy import EnergyRows

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Design:
    """Accepted rows of all arcs in use, minus each arc's mean; m rows, p parameters.

    z: (m, p). w: (m,) [J]. arc: (m,) arc number. sync: (m,) cycle number.
    noise: (p+1, p+1) mean contribution of noise to the squares of [z, w]. arcs: number of arcs in use. dropped_arcs:
    arcs that are too short, void, or left out. refused: number of instants that failed the bandwidth test. walk:
    variance that the noise of torques adds to the work over these arcs [J^2], refused instants included.
    """

    z: Floats
    w: Floats
    arc: NDArray[np.int64]
    sync: NDArray[np.uint64]
    arcs: int
    dropped_arcs: int
    refused: int
    noise: Floats
    walk: float

    def normal(self) -> tuple[Floats, Floats]:
        """A = Z' Z, shape (p, p), and b = Z' w, shape (p,), minus the mean contribution of noise."""
        return self.z.T @ self.z - self.noise[:-1, :-1], self.z.T @ self.w - self.noise[-1, :-1]


def design(balance: EnergyRows, moment: Floats | None = None) -> Design:
    """Collect the accepted rows of a record, arc by arc, and subtract each arc's mean.

    moment: (arcs, p+1, p+1) mean contribution of noise to the sums of each arc; None: none.
    """
    width = balance.z.shape[1] + 1
    noise = np.zeros((width, width))
    z: list[Floats] = []
    w: list[Floats] = []
    kept: list[NDArray[np.int64]] = []
    dropped, walk = 0, 0.0
    for arc in np.unique(balance.arc):
        of = np.flatnonzero((balance.arc == arc) & balance.accepted)
        if len(of) < MIN_ARC_INSTANTS or arc in balance.void | balance.left_out:
            dropped += 1
            continue
        z.append(balance.z[of] - balance.z[of].mean(axis=0))
        w.append(balance.w[of] - balance.w[of].mean())
        kept.append(of)
        walk += float(balance.walk[balance.arc == arc].sum())
        noise += 0.0 if moment is None else moment[arc]
    positions = np.concatenate(kept) if kept else np.zeros(0, dtype=np.int64)
    return Design(
        z=np.concatenate(z) if z else np.zeros((0, balance.z.shape[1])),
        w=np.concatenate(w) if w else np.zeros(0),
        arc=balance.arc[positions],
        sync=balance.sync[positions],
        arcs=len(kept),
        dropped_arcs=dropped,
        refused=int(np.sum(~balance.accepted)),
        noise=noise,
        walk=walk,
    )

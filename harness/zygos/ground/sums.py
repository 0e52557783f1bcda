# SPDX-License-Identifier: MIT
"""The sums of a run's rows: one matrix for each block of time and each joint. They add, over blocks and over runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.ground.rows import RunRows

Floats = NDArray[np.float64]

BLOCK_INCREMENTS = 12
"""Least number of increments of a block: the rows of shorter ones would not be independent of their neighbours'."""
MOST_BLOCKS = 40
"""Blocks of a run at most."""


@dataclass(frozen=True)
class Sums:
    """K blocks of consecutive increments, N joints; c = p + 2 columns: shared ones, offset, impulse."""

    gram: Floats
    """(K, N, c, c) sums of products of the columns, with the expected products of the sensors' noise subtracted."""
    noise: Floats
    """(K, N, c, c) what was subtracted."""
    total: Floats
    """(K, N, c) sums of the columns over every second increment, which do not overlap."""
    count: NDArray[np.int64]
    """(K, N) rows."""
    apart: NDArray[np.int64]
    """(K, N) rows that do not overlap."""
    gains: tuple[tuple[int, int], ...] = ()
    """Joint and column of each torque sensor whose gain is estimated; the column is the negative impulse."""
    currents: bool = False
    """Whether torques are motor currents, of which only products with unknown torque constants are torques."""

    @property
    def blocks(self) -> int:
        """K."""
        return len(self.count)


def sums_of(run: RunRows, blocks: int) -> Sums:
    """The sums of a run's rows, in at most that many blocks of equal length."""
    rows = run.rows.accepted[:, None] & ~run.lingers
    used = np.flatnonzero(rows.any(axis=1))
    wide = run.augmented * rows[..., None]
    k = int(max(1, min(blocks, MOST_BLOCKS, len(used) // BLOCK_INCREMENTS)))
    grams, noises, totals, counts, aparts = [], [], [], [], []
    for part in np.array_split(used, k):
        z, every = wide[part], wide[part[::2]]
        noise = run.noise(part) * (rows[part].sum(axis=0) / max(len(part), 1))[:, None, None]
        gram = np.einsum("mjp,mjq->jpq", z, z, optimize=True)
        gram -= noise
        grams.append(gram)
        noises.append(noise)
        totals.append(every.sum(axis=0))
        counts.append(rows[part].sum(axis=0))
        aparts.append(rows[part[::2]].sum(axis=0))
    return Sums(
        np.stack(grams),
        np.stack(noises),
        np.stack(totals),
        np.array(counts),
        np.array(aparts),
        run.gains,
        run.motion.arm.torque_unit == "A",
    )

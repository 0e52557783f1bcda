"""Least squares on the centred rows, and sigmas by leaving out blocks (docs/theory.md, "Solver" and "Sigmas …")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.errors import Undecided

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """Least-squares parameters of p columns.

    x: (p,) estimate. condition: 1-norm condition of the normal matrix scaled to a unit diagonal.
    residual: root mean square of the rows' residuals [unit of w].
    """

    x: Floats
    condition: float
    residual: float


def solve(z: Floats, w: Floats) -> Solution:
    """Minimise |z x - w|^2 by an orthogonal method on the rows themselves, columns scaled to unit length.

    z: (m, p). w: (m,). Raises Undecided where a column is zero, or the rows are fewer than the columns or dependent.
    """
    m, p = z.shape
    scale = np.linalg.norm(z, axis=0)
    if m < p or not np.all(scale > 0.0):
        raise Undecided(
            f"what is wrong: {m} rows do not determine {p} parameters; remedy: a longer record that moves every joint"
        )
    scaled = z / scale
    x, _, rank, _ = np.linalg.lstsq(scaled, w, rcond=None)
    if rank < p:
        raise Undecided(
            f"what is wrong: the motion determines {rank} of {p} parameters; remedy: a record that moves every joint"
        )
    return Solution(
        x=x / scale,
        condition=float(np.linalg.cond(scaled.T @ scaled, 1)),
        residual=float(np.sqrt(np.mean((scaled @ x - w) ** 2))),
    )


def jackknife(z: Floats, w: Floats, blocks: Sequence[NDArray[np.int64]]) -> Floats:
    """Standard deviation of each parameter by leaving out one block of rows at a time, shape (p,).

    z: (m, p) and w: (m,) are centred rows; blocks: K sets of their positions. var = (K-1)/K sum (x_-B - mean)^2,
    Efron & Stein 1981. Blocks long against the rows' correlation are honest where s^2 A^-1 is not.
    Raises Undecided for fewer than two blocks, or where the rest of the rows does not determine the parameters.
    """
    count = len(blocks)
    if count < 2:
        raise Undecided(f"what is wrong: {count} blocks have no spread; remedy: a longer record")
    estimates = []
    for block in blocks:
        rest = np.ones(len(w), dtype=np.bool_)
        rest[block] = False
        estimates.append(solve(z[rest], w[rest]).x)
    stacked = np.stack(estimates)
    variance: Floats = (count - 1) / count * np.sum((stacked - stacked.mean(axis=0)) ** 2, axis=0)
    return np.sqrt(variance)

# SPDX-License-Identifier: MIT
"""Least squares on the centred rows, and sigmas from blocks left out (docs/theory.md, "Solver" and "Sigmas …")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from zygos.errors import Undecided

Floats = NDArray[np.float64]

MIN_SIGNAL_TO_NOISE = 2.0
"""For any combination of columns, at most its sum of squares divided by this is subtracted as noise."""
OVERDECLARED = 0.6
"""If the residuals' square is below this share of the declared noise's square, it determines how much is subtracted."""
LEAST_FREEDOM = 2.0
SYSTEMATIC = 0.125
"""Smallest share of the residuals' square that is treated as systematic, since no deviation is declared exactly, and
products of noise with itself do not show in the residuals."""


@dataclass(frozen=True)
class Solution:
    """Least-squares parameters of p columns.

    x: (p,) estimate. condition: 1-norm condition of the solved matrix in the scale that gives Z' Z a unit diagonal.
    residual: root mean square of the rows' residuals [unit of w].
    noise_scale: share of the declared noise that was subtracted. signal_to_noise: smallest ratio of the rows'
    squares to the noise in them over all combinations of columns; infinite without noise.
    """

    x: Floats
    condition: float
    residual: float
    noise_scale: float = 1.0
    signal_to_noise: float = float("inf")


@dataclass(frozen=True)
class _Triangle:
    """Rows in triangular form: z = Q r scale, and the noise of such rows, divided likewise.

    r: (p, p). x: (p,) plain least squares, scaled. noise: (p, p) R^-T K R^-1. work: (p,) R^-T k.
    """

    scale: Floats
    r: Floats
    x: Floats
    noise: Floats
    work: Floats

    @classmethod
    def of(cls, z: Floats, w: Floats, noise: Floats) -> _Triangle:
        m, p = z.shape
        scale = np.linalg.norm(z, axis=0)
        if m < p:
            raise Undecided(
                f"what is wrong: {m} rows do not determine {p} parameters; remedy: a longer record, or fewer gaps in it"
            )
        if not np.all(scale > 0.0):
            raise Undecided(
                f"what is wrong: {np.count_nonzero(~(scale > 0.0))} of {p} columns are empty, the motion does not "
                "excite them; remedy: a record that moves every joint"
            )
        scaled = z / scale
        x, _, rank, _ = np.linalg.lstsq(scaled, w, rcond=None)
        if rank < p:
            raise Undecided(
                f"what is wrong: the motion determines {rank} of {p} parameters; "
                "remedy: a record that moves every joint"
            )
        r = np.asarray(np.linalg.qr(scaled, mode="r"), dtype=np.float64)
        half = solve_triangular(r, noise[:p, :p] / np.outer(scale, scale), trans="T")
        share = solve_triangular(r, half.T, trans="T")
        work = solve_triangular(r, noise[p, :p] / scale, trans="T")
        return cls(scale, r, x, 0.5 * (share + share.T), work)

    def solve(self, noise_scale: float) -> Floats:
        """x of (Z'Z - noise_scale K) x = Z'w - noise_scale k."""
        left = np.eye(len(self.x)) - noise_scale * self.noise
        y = np.linalg.solve(left, self.r @ self.x - noise_scale * self.work)
        return np.asarray(solve_triangular(self.r, y) / self.scale, dtype=np.float64)

    def inverse(self, noise_scale: float) -> Floats:
        """(Z'Z - noise_scale K)^-1."""
        half = solve_triangular(self.r, np.eye(len(self.x))) / self.scale[:, None]
        middle = np.linalg.inv(np.eye(len(self.x)) - noise_scale * self.noise)
        return np.asarray(half @ middle @ half.T, dtype=np.float64)


@dataclass(frozen=True)
class Rows:
    """Centred rows. z: (m, p). w: (m,). noise: (p+1, p+1) mean contribution of noise to the squares of [z, w]."""

    z: Floats
    w: Floats
    noise: Floats

    @classmethod
    def exact(cls, z: Floats, w: Floats) -> Rows:
        """Rows without noise."""
        return cls(z, w, np.zeros((z.shape[1] + 1, z.shape[1] + 1)))

    def times(self, weight: float) -> Rows:
        """The same rows with a weight on their squares."""
        return Rows(np.sqrt(weight) * self.z, np.sqrt(weight) * self.w, weight * self.noise)


def solve(energy: Rows, beside: Sequence[Rows] = ()) -> Solution:
    """Minimise |z x - w|^2 by an orthogonal method on the rows themselves, columns scaled to unit length.

    The noise is subtracted: as much as the residuals of the energy rows show if that is clearly less than declared, and
    for no combination of columns more than its sum of squares over `MIN_SIGNAL_TO_NOISE`. beside: other rows that are
    solved together with them. Raises Undecided if a column is zero, or the rows are fewer than the columns or
    dependent.
    """
    every = [energy, *beside]
    p = energy.z.shape[1]
    noise = np.sum([rows.noise for rows in every], axis=0)
    rows = _Triangle.of(np.concatenate([r.z for r in every]), np.concatenate([r.w for r in every]), noise)
    share = float(np.linalg.eigvalsh(rows.noise)[-1]) if noise.any() else 0.0
    noise_scale, seen, signal_to_noise = 1.0, 1.0, float("inf")
    for repeat in range(3 if share > 0.0 else 0):
        if repeat > 0:
            x = rows.solve(noise_scale)
            ratio = np.sum((energy.z @ x - energy.w) ** 2) / explained(energy.noise, x)
            seen = float(ratio) if ratio < OVERDECLARED else 1.0
        noise_scale, signal_to_noise = min(seen, 1.0 / (MIN_SIGNAL_TO_NOISE * share)), 1.0 / (share * seen)
    x = rows.solve(noise_scale) if share > 0.0 else rows.x / rows.scale
    scaled = rows.r.T @ (np.eye(p) - noise_scale * rows.noise) @ rows.r
    return Solution(
        x=x,
        condition=float(np.linalg.cond(scaled, 1)),
        residual=float(np.sqrt(np.mean((energy.z @ x - energy.w) ** 2))),
        noise_scale=noise_scale,
        signal_to_noise=signal_to_noise,
    )


def explained(noise: Floats, x: Floats) -> float:
    """Square of the residuals that the declared noise causes by itself."""
    ahead = np.append(x, -1.0)
    return float(ahead @ noise @ ahead)


def that_stays(energy: Rows, solution: Solution, longest: int) -> float:
    """Relative amount by which the blocks' scatter is too small for an error that is the same in every arc.

    The part of the residuals' square that the declared noise does not explain affects the estimate as much as it does
    in one arc of `longest` instants; more arcs do not average it out.
    """
    square = float(np.sum((energy.z @ solution.x - energy.w) ** 2))
    share = 1.0 - solution.noise_scale * explained(energy.noise, solution.x) / square
    return max(SYSTEMATIC, share) * len(energy.w) / longest


@dataclass(frozen=True)
class Scatter:
    """Result of the blocks' scatter for an estimate.

    covariance: (p, p). freedom: (p,) degrees of freedom, the number of blocks that contribute to a parameter.
    """

    covariance: Floats
    freedom: Floats


def scatter(z: Floats, w: Floats, weights: Floats, noise: Floats | None = None, noise_scale: float = 1.0) -> Scatter:
    """Covariance from blocks of rows: the change of the estimate when one is left out, times the block's own influence.

    Let s_b = Z' W_b (w - z x) be the residual gradient of a block b. x_(-b) - x = -(A - A_b)^-1 s_b is too large by the
    block's leverage and A^-1 s_b is too small by it; the expectation of their product is neither (Kauermann & Carroll
    2001). Overlapping blocks count by sum(w)/sum(w^2).

    z: (m, p) and w: (m,) centred rows. weights: (K, m) of each row in each block, with sum 1 over the blocks. noise:
    (K, p+1, p+1) mean contribution of noise to each block's squares. Raises Undecided for fewer than two blocks, or if
    the remaining rows do not determine the parameters.
    the rows does not determine the parameters.
    """
    count, p = len(weights), z.shape[1]
    if count < 2:
        raise Undecided(f"what is wrong: {count} blocks have no spread; remedy: a longer record")
    parts = np.zeros((count, p + 1, p + 1)) if noise is None else noise
    whole = _Triangle.of(z, w, parts.sum(axis=0))
    x, inverse = whole.solve(noise_scale), whole.inverse(noise_scale)
    gains, influences = [], []
    for weight, part in zip(weights, parts, strict=True):
        root = np.sqrt(1.0 - weight)
        rest = _Triangle.of(root[:, None] * z, root * w, parts.sum(axis=0) - part)
        pull = z.T @ (weight * (w - z @ x)) + noise_scale * (part[:p, :p] @ x - part[p, :p])
        left_out, alone = x - rest.solve(noise_scale), inverse @ pull
        influences.append((1.0, pull, alone, left_out))
        gains.append(np.diag(rest.inverse(noise_scale)) - np.diag(inverse))
    gain = np.maximum(gains, 0.0)
    freedom = np.maximum(gain.sum(axis=0) ** 2 / (gain**2).sum(axis=0), LEAST_FREEDOM)
    return Scatter(squares_of_blocks(influences) * np.sum(weights) / np.sum(weights**2), freedom)


def squares_of_blocks(influences: Sequence[tuple[float, Floats, Floats, Floats]]) -> Floats:
    """Covariance (p, p) from the factor of each block, its pull (p,), its own influence (p,) and the change of the
    solution (p,) without it.

    The variances are the products of influence and change, and at least the squares of the influences. A matrix of
    products need not be positive semi-definite; the correlations are those of squares of the influences, each enlarged
    by what it is too small by along the pull.
    """
    factors = np.array([factor for factor, *_ in influences])
    pulls, alone, change = (np.array(part) for part in zip(*((b, c, d) for _, b, c, d in influences), strict=True))
    own, whole = np.sum(pulls * alone, axis=1), np.sum(pulls * change, axis=1)
    enlarged = np.where((own > 0.0) & (whole > own), whole / np.where(own > 0.0, own, 1.0), 1.0)
    covariance = (alone.T * (factors * enlarged)) @ alone
    # with few blocks the product may by chance be too small, even negative; the square of one factor cannot
    variances = np.maximum(factors @ (change * alone), factors @ alone**2)
    share = np.sqrt(variances / np.diag(covariance))
    return np.asarray(covariance * np.outer(share, share), dtype=np.float64)

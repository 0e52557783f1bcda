# SPDX-License-Identifier: MIT
"""Weighted least squares of a hypothesis on the sums of all runs, and the score of every column beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.gap.ground.columns import Table
from zygos.quantiles import normal_isf, student_sf

Floats = NDArray[np.float64]
Places = tuple[int, ...]


@dataclass(frozen=True)
class Fit:
    """The columns of a hypothesis, fitted."""

    free: Places
    x: Floats
    """(W-1,) difference from the simulation; 0 of columns that are held."""
    sigma: Floats
    """(N,) standard deviation of the residual of an increment, Nms."""


@dataclass(frozen=True)
class Scores:
    """The coefficients of C columns, each alone beside the columns of a fit; R runs."""

    columns: Places
    value: Floats
    """(C,)"""
    sigma: Floats
    """(C,) from leaving out one block of time after the other, and from what the runs disagree beyond that."""
    freedom: Floats
    """(C,) degrees of freedom of sigma."""
    gain: Floats
    """(C,) reduction of the weighted squared residual."""
    alone: Floats
    """(R, C) on each run by itself; NaN where it does not show it."""
    alone_sigma: Floats
    """(R, C)"""
    before: Floats
    """(R, N) mean square residual of each run with the values that the other runs give, Nms^2."""
    after: Floats
    """(R, C, N) the same with the column beside."""

    @property
    def z(self) -> Floats:
        """(C,) deviations from 0 of a normal variable with the same probability."""
        with np.errstate(divide="ignore", invalid="ignore"):
            t = self.value / self.sigma
        z = normal_isf(np.maximum(student_sf(np.abs(t), self.freedom), 1e-300))
        return np.asarray(np.where(np.isfinite(t), np.sign(t) * z, 0.0), dtype=np.float64)


def fit(table: Table, free: Sequence[int], sigma: Floats | None = None) -> Fit:
    """Solve for the free columns, each joint weighted by its residual. sigma: weights to begin with."""
    whole, noise = table.gram.sum(axis=0), table.noise.sum(axis=0)
    rows = np.maximum(table.counts.sum(axis=0), 1.0)
    prior = table.layout.prior()
    square = np.maximum(whole[:, -1, -1] + noise[:, -1, -1], 1e-300)
    sigma = np.sqrt(square / rows) if sigma is None else sigma
    lost = min(0.5, len(free) / float(rows.sum()))
    x = np.zeros(table.layout.width - 1)
    of = np.array(free)
    for _ in range(limits.WEIGHT_ROUNDS.value):
        if any(place in free for _, place in table.layout.gains):
            table = table.with_gains(x)
            whole, noise = table.gram.sum(axis=0), table.noise.sum(axis=0)
        total = np.einsum("j,jpq->pq", 1.0 / sigma**2, whole)
        x = np.zeros_like(x)
        x[of] = solve(total[np.ix_(of, of)], prior[of], total[of, -1:])[:, 0]
        left = forms(whole + noise, x)
        sigma = np.sqrt(np.maximum(left, limits.LEAST_RESIDUAL.value * square) / (rows * (1.0 - lost)))
    return Fit(tuple(int(k) for k in of), x, sigma)


def score(table: Table, fitted: Fit, columns: Sequence[int]) -> Scores:
    """Score columns, each alone beside those of a fit."""
    if any(place in (*fitted.free, *columns) for _, place in table.layout.gains):
        table = table.with_gains(fitted.x)
    of, tried = np.array(fitted.free), np.array(columns, dtype=np.int64)
    runs = table.layout.runs
    weighted = np.einsum("j,bjpq->bpq", 1.0 / fitted.sigma**2, table.gram)
    total = weighted.sum(axis=0)
    each = np.stack([weighted[table.owner == run].sum(axis=0) for run in range(runs)])
    prior = table.layout.prior()[of]
    value, inverse, *_ = _beside(total[None], of, tried, prior)
    without, inverse_without, *_ = _beside(total - weighted, of, tried, prior)
    blocks = table.blocks
    shift = without - value
    sigma = np.sqrt((blocks - 1) / blocks * np.nansum(shift**2, axis=0))
    sigma = np.fmax(sigma, _over_runs(each, of, tried, prior))
    gains = np.maximum(np.nan_to_num(inverse_without - inverse), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = gains.sum(axis=0) ** 2 / (gains**2).sum(axis=0)
    freedom = np.clip(np.nan_to_num(freedom, nan=2.0), 2.0, blocks - 1)
    alone, alone_sigma = _alone(table, weighted, each, of, tried, prior)
    before, after = _transferred(table, total, each, of, tried, prior)
    gain = np.nan_to_num(value[0] ** 2 / inverse[0])
    return Scores(
        tuple(int(k) for k in tried),
        np.nan_to_num(value[0]),
        np.where(np.isfinite(value[0]), np.maximum(sigma, 1e-300), np.inf),
        freedom,
        gain,
        alone,
        alone_sigma,
        before,
        after,
    )


def gains(table: Table, fitted: Fit, columns: Sequence[int]) -> Floats:
    """(C,) reduction of the weighted squared residual by each column alone beside those of a fit."""
    if any(place in (*fitted.free, *columns) for _, place in table.layout.gains):
        table = table.with_gains(fitted.x)
    of, tried = np.array(fitted.free), np.array(columns, dtype=np.int64)
    total = np.einsum("j,bjpq->pq", 1.0 / fitted.sigma**2, table.gram, optimize=True)
    value, inverse, *_ = _beside(total[None], of, tried, table.layout.prior()[of])
    return np.asarray(np.nan_to_num(value[0] ** 2 / inverse[0]), dtype=np.float64)


def jackknife(table: Table, fitted: Fit) -> tuple[Floats, Floats, Floats]:
    """(f, f) covariance of the free columns of a fit from leaving out blocks, (f,) its degrees of freedom, and (f,)
    standard deviations where the coefficients are others in each run."""
    if any(place in fitted.free for _, place in table.layout.gains):
        table = table.with_gains(fitted.x)
    of = np.array(fitted.free)
    prior = table.layout.prior()[of]
    weighted = np.einsum("j,bjpq->bpq", 1.0 / fitted.sigma**2, table.gram)
    total = weighted.sum(axis=0)
    blocks = table.blocks
    values, variances = [], []
    for own in weighted:
        matrix = (total - own)[np.ix_(of, of)]
        values.append(solve(matrix, prior, (total - own)[of, -1:])[:, 0])
        variances.append(np.diag(_inverse(matrix, prior)))
    shift = np.array(values) - fitted.x[of]
    gains = np.maximum(np.array(variances) - np.diag(_inverse(total[np.ix_(of, of)], prior)), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = gains.sum(axis=0) ** 2 / (gains**2).sum(axis=0)
    each = np.stack([weighted[table.owner == run].sum(axis=0) for run in range(table.layout.runs)])
    matrix = total[np.ix_(of, of)]
    x = solve(matrix, prior, total[of, -1:])
    pulls = _inverse(matrix, prior) @ (each[:, of, -1:] - each[:, of[:, None], of] @ x)[..., 0].T
    covariance = (blocks - 1) / blocks * shift.T @ shift
    return covariance, np.clip(np.nan_to_num(freedom, nan=2.0), 2.0, blocks - 1), _spread(pulls.T)


def unknown(table: Table, fitted: Fit) -> Floats:
    """(f, f) what the priors of the columns of a fit, which hold them, may hide of them, as covariance."""
    of = np.array(fitted.free)
    prior = table.layout.prior()[of]
    total = np.einsum("j,bjpq->pq", 1.0 / fitted.sigma**2, table.gram, optimize=True)
    lost = _inverse(total[np.ix_(of, of)], prior) * np.sqrt(prior)
    return np.asarray(lost @ lost.T, dtype=np.float64)


def forms(gram: Floats, x: Floats) -> Floats:
    """(...) sums of squared residuals of each (W, W) with the values x (W-1,)."""
    full = np.append(-x, 1.0)
    return np.asarray(np.maximum(np.einsum("p,...pq,q->...", full, gram, full, optimize=True), 0.0), dtype=np.float64)


def residual(table: Table, x: Floats) -> Floats:
    """(R, N) mean square residual of each run's increments with the values x, each run with its own best offsets."""
    runs = table.layout.runs
    out = []
    for run in range(runs):
        mine = table.owner == run
        gram = (table.gram[mine] + table.noise[mine]).sum(axis=0)
        rows = np.maximum(table.counts[mine].sum(axis=0), 1.0)
        out.append(_with_offset(table, gram, x[None], run)[0] / rows)
    return np.array(out)


def _beside(
    grams: Floats, of: NDArray[np.int64], tried: NDArray[np.int64], prior: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Of each of K matrices: value (K, C) of each column beside the others, its variance (K, C), what the others change
    by with it (K, f, C), and the others without it (K, f). NaN where the motion does not show the column."""
    values, variances, slopes, starts = [], [], [], []
    for gram in grams:
        inner = gram[np.ix_(of, tried)]
        right = gram[of, -1]
        solved = solve(gram[np.ix_(of, of)], prior, np.column_stack([inner, right]))
        slope, start = solved[:, :-1], solved[:, -1]
        own = gram[tried, tried]
        square = own - np.sum(inner * slope, axis=0)
        seen = square > limits.UNSEEN.value * np.maximum(own, 1e-300)
        with np.errstate(divide="ignore", invalid="ignore"):
            values.append(np.where(seen, (gram[tried, -1] - inner.T @ start) / square, np.nan))
            variances.append(np.where(seen, 1.0 / square, np.nan))
        slopes.append(slope)
        starts.append(start)
    return np.array(values), np.array(variances), np.array(slopes), np.array(starts)


def _alone(
    table: Table, weighted: Floats, each: Floats, of: NDArray[np.int64], tried: NDArray[np.int64], prior: Floats
) -> tuple[Floats, Floats]:
    """(R, C) each column on each run by itself, and its standard deviation over the blocks of the run."""
    values, sigmas = [], []
    for run, whole in enumerate(each):
        mine = weighted[table.owner == run]
        value = _beside(whole[None], of, tried, prior)[0][0]
        others = _beside(whole - mine, of, tried, prior)[0]
        blocks = len(mine)
        values.append(value)
        # the median of a few blocks would hide the one that says something else
        sigmas.append(np.sqrt((blocks - 1) / blocks * np.nansum((others - value) ** 2, axis=0)))
    return np.array(values), np.array(sigmas)


def _over_runs(each: Floats, of: NDArray[np.int64], tried: NDArray[np.int64], prior: Floats) -> Floats:
    """(C,) standard deviation of each column beside the others where its coefficient is another one in each run.

    each: (R, W, W) sums of the runs.
    """
    total = each.sum(axis=0)
    value, inverse, slope, start = (one[0] for one in _beside(total[None], of, tried, prior))
    pulls = np.zeros((len(each), len(tried)))
    for k in np.flatnonzero(np.isfinite(value)):
        at, direction = np.append(of, tried[k]), np.append(-slope[:, k], 1.0)
        x = np.append(start - slope[:, k] * value[k], value[k])
        pulls[:, k] = (each[:, at, -1] - each[:, at[:, None], at] @ x) @ direction * inverse[k]
    return _spread(pulls)


def _spread(pulls: Floats) -> Floats:
    """(C,) standard deviation of the mean of coefficients that are random over runs, from how far each of R runs pulls
    it (R, C): a run counts as much as it shows. 0 of a single run."""
    runs = len(pulls)
    return np.asarray(np.sqrt(runs / max(runs - 1, 1) * np.sum(pulls**2, axis=0)) * (runs > 1), dtype=np.float64)


def _transferred(
    table: Table, total: Floats, each: Floats, of: NDArray[np.int64], tried: NDArray[np.int64], prior: Floats
) -> tuple[Floats, Floats]:
    """(R, N) mean square residuals of each run with the values that the other runs give, and (R, C, N) with each column
    beside."""
    before, after = [], []
    width = table.layout.width - 1
    for run, own in enumerate(each):
        mine = table.owner == run
        gram = (table.gram[mine] + table.noise[mine]).sum(axis=0)
        rows = np.maximum(table.counts[mine].sum(axis=0), 1.0)
        value, _, slope, start = (one[0] for one in _beside((total - own)[None], of, tried, prior))
        value = np.nan_to_num(value)
        x = np.zeros((len(tried) + 1, width))
        x[:, of] = start
        for c, column in enumerate(tried):
            x[c, of] -= value[c] * slope[:, c]
            x[c, column] = value[c]
        left = _with_offset(table, gram, x, run) / rows
        before.append(left[-1])
        after.append(left[:-1])
    return np.array(before), np.array(after)


def _with_offset(table: Table, gram: Floats, x: Floats, run: int) -> Floats:
    """(K, N) sums of squared residuals of a run with K sets of values (K, W-1), with the best offset of each torque."""
    joints, shared = table.layout.arm.n, table.layout.shared
    out = np.zeros((len(x), joints))
    at = [*range(shared), table.layout.width - 1]
    full = np.column_stack([-x[:, :shared], np.ones(len(x))])
    for j in range(joints):
        k = shared + run * joints + j
        cross = full @ gram[j][at, k]
        square = np.einsum("kp,pq,kq->k", full, gram[j][np.ix_(at, at)], full, optimize=True)
        out[:, j] = np.maximum(square - cross**2 / max(float(gram[j][k, k]), 1e-300), 0.0)
    return out


def _scaled(matrix: Floats, prior: Floats) -> tuple[Floats, Floats]:
    diagonal = np.diag(matrix) + prior
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = (matrix + np.diag(prior)) * scale * scale[:, None]
    return scale, scaled + limits.RIDGE.value * np.eye(len(scale)) + np.diag(1.0 * (diagonal <= 0.0))


def solve(matrix: Floats, prior: Floats, right: Floats) -> Floats:
    """Solution of normal equations (f, f) with weights of a prior on the diagonal."""
    scale, scaled = _scaled(matrix, prior)
    return np.asarray(scale[:, None] * np.linalg.solve(scaled, scale[:, None] * right), dtype=np.float64)


def _inverse(matrix: Floats, prior: Floats) -> Floats:
    scale, scaled = _scaled(matrix, prior)
    return np.asarray(np.linalg.inv(scaled) * scale * scale[:, None], dtype=np.float64)

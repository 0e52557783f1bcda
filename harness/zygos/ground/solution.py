# SPDX-License-Identifier: MIT
"""Weighted least squares on the sums of one or several runs, with intervals from leaving out one block at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import Undecided
from zygos.ground.sums import Sums
from zygos.quantiles import student_factor

Floats = NDArray[np.float64]

_ROUNDS = 8
_PRIOR_ROUNDS = 3


@dataclass(frozen=True)
class Solution:
    """p shared parameters of R runs with N joints."""

    value: Floats
    """(p,)"""
    offset: Floats
    """(R, N) offset of each torque, as reported [Nm]."""
    covariance: Floats
    """(p, p) from the scatter over blocks."""
    freedom: Floats
    """(p,) degrees of freedom of the standard deviations."""
    sigma_w: Floats
    """(N,) standard deviation of the residuals of an increment [Nms]."""
    residual: Floats
    """(R, N) root mean square of the residuals of each run's increments [Nms]."""
    measured: Floats
    """(R, N) root mean square of the impulse of each run's increments, without its offset [Nms]."""
    held_out: Floats
    """(R, N) root mean square of the residuals with the parameters of all other blocks [Nms]."""
    cluster: Floats
    """(N,) mean square of the sums of the residuals of a block, in units of what independent ones would give."""
    seen: NDArray[np.bool_]
    """(p,) False for a parameter that the motion does not determine at all."""
    size: Floats
    """(p,) root mean square of the columns' share in the impulse at unit value [in units of sigma_w]."""

    @property
    def sigma(self) -> Floats:
        """(p,) standard deviations."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), dtype=np.float64)

    def half(self, confidence: float) -> Floats:
        """(p,) half widths of the intervals of that confidence, with as many degrees of freedom as there are."""
        return np.asarray(student_factor(confidence, self.freedom) * self.sigma, dtype=np.float64)

    @property
    def share(self) -> Floats:
        """(N,) held-out residual of each joint as share of its impulse."""
        return np.asarray(
            np.sqrt((self.held_out**2).mean(axis=0) / np.maximum((self.measured**2).mean(axis=0), 1e-300))
        )


def solve(runs: Sequence[Sums], prior_weight: Floats | None = None) -> Solution:
    """Solve the runs together: shared parameters, and an offset of each torque in each run.

    Each joint is weighted by its own residual, found in a few rounds. Residuals are those of the torque as it is
    reported: a gain g of its sensor divides the torque of the model by 1 + g, and has a prior. prior_weight: (N,)
    standard deviation of an increment's residual to begin with. Errors: Undecided where there are fewer increments than
    unknowns.
    """
    joints = runs[0].gram.shape[1]
    p = runs[0].gram.shape[-1] - 2
    unknown = p + len(runs) * joints
    rows = sum(int(run.count.sum()) for run in runs)
    if rows < 2 * unknown:
        raise Undecided(f"{rows} joint rows for {unknown} unknowns are too few; remedy: a longer run, or several runs")
    parts = [_embedded(run, number, len(runs)) for number, run in enumerate(runs)]
    gram = np.concatenate([part[0] for part in parts])  # (blocks, N, P+1, P+1)
    noise = np.concatenate([part[1] for part in parts])
    sums = np.concatenate([part[2] for part in parts])  # (blocks, N, P+1)
    counts = np.concatenate([run.count for run in runs]).astype(np.float64)
    owner = np.concatenate([np.full(run.blocks, number) for number, run in enumerate(runs)])
    square = gram.sum(axis=0)[:, -1, -1]
    of_joint = np.maximum(counts.sum(axis=0), 1.0)
    sigma = np.sqrt(np.maximum(square, 1e-300) / of_joint) if prior_weight is None else prior_weight
    lost = unknown / rows
    x = np.zeros(unknown)
    reported, prior = gram, np.zeros((unknown + 1, unknown + 1))
    apart = np.maximum(np.concatenate([run.apart for run in runs]).astype(np.float64), 1.0)
    if runs[0].gains:
        free = of_joint * max(1.0 - lost, 0.1)
        gram, noise, sums, prior = _linear(runs[0], gram, noise, sums, apart, free)
    whole = gram.sum(axis=0)
    seen = np.ones(unknown, dtype=np.bool_)
    for _ in range(_ROUNDS):
        x, seen = _solved(np.einsum("j,jpq->pq", 1.0 / sigma**2, whole) + prior)
        left = _forms(whole + noise.sum(axis=0), x)
        sigma = np.sqrt(np.maximum(left, 1e-30 * square + 1e-300) / (of_joint * max(1.0 - lost, 0.1)))
    weighted = np.einsum("j,bjpq->bpq", 1.0 / sigma**2, gram)
    total = weighted.sum(axis=0) + prior
    others = np.stack([_solved(total - own, seen)[0] for own in weighted])
    inverse = np.diag(_inverse(total, seen))
    gains = np.stack([np.diag(_inverse(total - own, seen)) for own in weighted]) - inverse
    gains = np.maximum(gains, 0.0)
    blocks = len(weighted)
    shift = others - x
    covariance = (blocks - 1) / blocks * shift.T @ shift
    if runs[0].gains:  # the prior pulls a gain to 0 that may be another by its deviation
        pulled = _inverse(total, seen) @ prior[:-1, :-1]
        covariance = covariance + pulled @ np.linalg.pinv(_prior(runs[0], unknown)[:-1, :-1]) @ pulled.T
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = gains.sum(axis=0) ** 2 / (gains**2).sum(axis=0)
    freedom = np.clip(np.nan_to_num(freedom, nan=2.0), 2.0, blocks - 1)
    left_out = np.stack([_forms(g + n, o) for g, n, o in zip(gram, noise, others, strict=True)])
    kept = _forms_of(gram + noise, x)
    without_offset = _without_offset(reported, x, p)
    sizes = [owner == number for number in range(len(runs))]
    instants = np.maximum(np.stack([counts[of].sum(axis=0) for of in sizes]), 1.0)

    def per_run(values: Floats) -> Floats:
        return np.asarray(np.sqrt(np.stack([values[of].sum(axis=0) for of in sizes]) / instants), dtype=np.float64)

    return Solution(
        value=x[:p],
        offset=x[p:].reshape(len(runs), joints),
        covariance=covariance[:p, :p],
        freedom=freedom[:p],
        sigma_w=sigma,
        residual=per_run(kept),
        measured=per_run(without_offset),
        held_out=per_run(left_out),
        cluster=_cluster(sums, x, apart, sigma),
        seen=seen[:p],
        size=np.asarray(np.sqrt(np.maximum(np.diag(total)[:p], 0.0) / rows)),
    )


def _prior(run: Sums, unknown: int) -> Floats:
    """(P+1, P+1) normal equations of what is known of gains before any run."""
    known = limits.CURRENT_GAIN_PRIOR.value if run.currents else limits.GAIN_PRIOR.value
    out = np.zeros((unknown + 1, unknown + 1))
    for _, column in run.gains:
        out[column, column] = 1.0 / known**2
    return out


def _linear(
    run: Sums, gram: Floats, noise: Floats, sums: Floats, apart: Floats, free: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Products, their noise and sums of columns with which the torques as they are reported are linear in the unknowns
    about their values, and the normal equations of the prior. free: (N,) rows of each joint less its part of the
    unknowns."""
    unknown, p = gram.shape[-1] - 1, run.gram.shape[-1] - 2
    known = prior = _prior(run, unknown)
    about = np.zeros(0)
    for _ in range(_PRIOR_ROUNDS):
        x, sigma = _with_gains(gram, noise, run.gains, prior, free, p)
        about = _about(x, run.gains, gram.shape[1], p)
        # where residuals are not noise, rows tell less than as many independent ones
        cluster = _cluster(np.einsum("jap,bja->bjp", about, sums), x, apart, sigma)
        prior = max(1.0, float(cluster.mean())) * known
    products = (np.einsum("jap,bjac,jcq->bjpq", about, one, about, optimize=True) for one in (gram, noise))
    return *products, np.einsum("jap,bja->bjp", about, sums), prior


def _with_gains(
    gram: Floats, noise: Floats, gains: Sequence[tuple[int, int]], prior: Floats, free: Floats, p: int
) -> tuple[Floats, Floats]:
    """(P,) the unknowns with gains of torque sensors, by Gauss and Newton's method about the values before, first
    without gains; and (N,) standard deviations of the residuals. p: number of shared columns."""
    columns = [column for _, column in gains]
    whole, with_noise = gram.sum(axis=0), (gram + noise).sum(axis=0)
    weighted = np.einsum("j,jpq->pq", free / np.maximum(whole[:, -1, -1], 1e-300), whole)
    weighted[columns], weighted[:, columns] = 0.0, 0.0
    x, _ = _solved(weighted)
    for _ in range(limits.GAIN_ROUNDS.value):
        about = _about(x, gains, len(whole), p)
        now = np.einsum("jap,jac,jcq->jpq", about, whole, about, optimize=True)
        left = _forms(np.einsum("jap,jac,jcq->jpq", about, with_noise, about, optimize=True), x)
        sigma = np.sqrt(np.maximum(left, 1e-300) / free)
        found, _ = _solved(np.einsum("j,jpq->pq", 1.0 / sigma**2, now) + prior)
        step = (1.0 + found[columns]) / (1.0 + x[columns])
        most = limits.GAIN_STEP.value
        share = min(1.0, *(_toward(float(one), most) for one in step))
        moved = float(np.abs(found[columns] - x[columns]).max())
        x = x + share * (found - x)
        if moved < 1e-9:
            break
    return x, sigma


def _cluster(sums: Floats, x: Floats, apart: Floats, sigma: Floats) -> Floats:
    """(N,) mean square of the sums of the residuals of a block, in units of what independent ones would give."""
    mean = sums[..., -1] - sums[..., :-1] @ x
    return np.asarray((mean**2 / (apart * sigma**2)).mean(axis=0), dtype=np.float64)


def _toward(step: float, most: float) -> float:
    """How much of a change of 1 + g by a factor may be made, so that it changes by a ratio of `most` at the most."""
    wanted = min(max(step, 1.0 / most), most)
    return 1.0 if wanted == step else (wanted - 1.0) / (step - 1.0)


def _about(x: Floats, gains: Sequence[tuple[int, int]], joints: int, p: int) -> Floats:
    """(N, P+1, P+1) of each joint, what its columns become about the values x: those of the model are divided by 1 + g,
    the gain's is what it changes of the torque that is reported, and a constant of it is taken off the impulse. p:
    number of shared columns, behind which are the offsets of the torque as it is reported."""
    out = np.tile(np.eye(len(x) + 1), (joints, 1, 1))
    model = np.zeros(len(x) + 1)
    model[:p] = x[:p]
    model[[column for _, column in gains]] = 0.0
    for joint, column in gains:
        inverse = 1.0 / (1.0 + x[column])
        own = out[joint]
        own[range(p), range(p)] = inverse
        own[:, column] = -(inverse**2) * model
        own[:, -1] -= x[column] * inverse**2 * model
    return out


def _embedded(run: Sums, number: int, runs: int) -> tuple[Floats, Floats, Floats]:
    """Sums of a run in the columns of all: shared ones, then N offsets of each run, then the impulse."""
    joints, p = run.gram.shape[1], run.gram.shape[-1] - 2
    wide = p + runs * joints + 1
    gram, noise = np.zeros((run.blocks, joints, wide, wide)), np.zeros((run.blocks, joints, wide, wide))
    total = np.zeros((run.blocks, joints, wide))
    for j in range(joints):
        places = np.array([*range(p), p + number * joints + j, wide - 1])
        gram[:, j, places[:, None], places] = run.gram[:, j]
        noise[:, j, places[:, None], places] = run.noise[:, j]
        total[:, j, places] = run.total[:, j]
    return gram, noise, total


def _forms(gram: Floats, x: Floats) -> Floats:
    """(N,) sums of squared residuals of each joint."""
    full = np.append(-x, 1.0)
    return np.asarray(np.maximum(np.einsum("p,jpq,q->j", full, gram, full), 0.0), dtype=np.float64)


def _forms_of(gram: Floats, x: Floats) -> Floats:
    """(blocks, N) likewise of each block."""
    return np.stack([_forms(own, x) for own in gram])


def _without_offset(gram: Floats, x: Floats, p: int) -> Floats:
    """(blocks, N) sums of the squared impulse less the offset."""
    return _forms_of(gram, np.concatenate([np.zeros(p), x[p:]]))


def _factor(matrix: Floats, seen: NDArray[np.bool_]) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Scale, and Cholesky factor of the scaled matrix of the unknowns that are seen, with their places."""
    places = np.flatnonzero(seen)
    diagonal = np.diag(matrix)[places]
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    return scale, matrix[np.ix_(places, places)] * scale * scale[:, None], places


def _solved(augmented: Floats, seen: NDArray[np.bool_] | None = None) -> tuple[Floats, NDArray[np.bool_]]:
    """Solution of the normal equations (P+1, P+1), and which unknowns the motion determines; the others are 0."""
    matrix, right = augmented[:-1, :-1], augmented[:-1, -1]
    found = _independent(matrix) if seen is None else seen
    scale, scaled, places = _factor(matrix, found)
    x = np.zeros(len(right))
    x[places] = scale * np.linalg.lstsq(scaled, scale * right[places], rcond=1e-14)[0]
    return x, found


def _inverse(augmented: Floats, seen: NDArray[np.bool_]) -> Floats:
    matrix = augmented[:-1, :-1]
    scale, scaled, places = _factor(matrix, seen)
    out = np.zeros_like(matrix)
    out[np.ix_(places, places)] = np.linalg.pinv(scaled, hermitian=True, rcond=1e-14) * scale * scale[:, None]
    return out


def _independent(matrix: Floats) -> NDArray[np.bool_]:
    """Unknowns that are part of no combination that the motion leaves open."""
    diagonal = np.diag(matrix)
    present = diagonal > 0.0
    scale = np.where(present, 1.0 / np.sqrt(np.where(present, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(matrix * scale * scale[:, None])
    open_ones = vectors[:, values < limits.RANK.value]
    touched = np.sum(open_ones**2, axis=1) > 1e-6
    return np.asarray(present & ~touched, dtype=np.bool_)

# SPDX-License-Identifier: MIT
"""Sigmas and 95 % intervals from the sums of blocks (docs/theory.md, "Sigmas and intervals").

The blocks are the library's own; their evaluation is independent. Matrices are inverted directly, one for each block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zygos.quantiles import student_factor
from zygos.reference.solver import LEAST_FREEDOM, SYSTEMATIC, explained, squares_of_blocks

if TYPE_CHECKING:
    from zygos.reference.gains import Prior

Floats = NDArray[np.float64]

CLUSTER_LIMIT = 5.0
"""Cluster statistic of joint rows that noise of torques does not exceed."""
SYSTEMATIC_S = 60.0
"""Time in which the systematic part of the residuals of joint rows counts once, s."""


@dataclass(frozen=True)
class Block:
    """Sums of some rows, p parameters.

    sums: (p+1, p+1) squares of [z, w], weighted, with the noise subtracted. deviation: (p+1,) sum of [z, w] minus the
    means of their arcs. instants, square: sums of the rows' shares in the block and of their squares; 0 for motor and
    momentum rows, whose blocks are arcs. variance: what the noise of torques adds to the variance of the work, J^2.
    """

    sums: Floats
    deviation: Floats
    instants: float = 0.0
    square: float = 0.0
    variance: float = 0.0


@dataclass(frozen=True)
class Intervals:
    """covariance: (p, p). half95: (p,) half widths of the 95 % intervals."""

    covariance: Floats
    half95: Floats

    @property
    def sigma(self) -> Floats:
        """(p,)"""
        root: Floats = np.sqrt(np.diag(self.covariance))
        return root


def intervals(
    energy: Sequence[Block],
    arcs: Sequence[Block],
    noise: Floats,
    own: Floats,
    noise_scale: float,
    longest: int,
    prior: Prior | None = None,
) -> Intervals:
    """Intervals of the estimate from the blocks of the energy rows and the arcs of the others.

    noise: (p+1, p+1) all noise that was subtracted. own: (p+1, p+1) its part in the energy rows. noise_scale: share of
    the declared noise that was subtracted. longest: number of instants of the longest arc of the energy rows. prior: of
    the last parameters, the gains.
    """
    p = len(noise) - 1
    total = np.sum([block.sums for block in [*energy, *arcs]], axis=0)
    instants, square = sum(block.instants for block in energy), sum(block.square for block in energy)
    back = (1.0 - noise_scale) * noise
    scale = 1.0 / np.sqrt(np.diag(total + noise)[:p])
    known = np.zeros((p, p)) if prior is None else prior.placed(p)

    def solved(sums: Floats, added: float = 0.0) -> tuple[Floats, Floats]:
        scaled = (sums[:p, :p] + known) * np.outer(scale, scale) + added * np.eye(p)
        inverse = np.asarray(np.linalg.inv(scaled), dtype=np.float64)
        return scale * (inverse @ (scale * sums[p, :p])), inverse

    x, inverse = solved(total + back)
    ahead = np.append(x, -1.0)
    square_left = float(ahead @ np.sum([block.sums for block in energy], axis=0) @ ahead) + explained(own, x)
    gains, influences = [], []
    for block in [*energy, *arcs]:
        share = block.instants / instants
        without, rest = solved(total - block.sums + (1.0 - share) * back)
        mine = block.sums + (1.0 - noise_scale) * share * own
        pull = mine[p, :p] - mine[:p, :p] @ x
        alone = scale * (inverse @ (scale * pull))
        factor = instants / square if block.instants > 0.0 else 1.0
        influences.append((factor, pull, alone, x - without))
        gains.append(np.maximum(np.diag(rest) - np.diag(inverse), 0.0))
    covariance = squares_of_blocks(influences)
    adds_up = float(np.mean([float(block.deviation @ ahead) ** 2 / block.square for block in energy]))
    alike = max(0.0, 1.0 - square_left / instants / adds_up)
    excess = max(0.0, square_left - noise_scale * explained(own, x))
    stays = instants / longest * max(SYSTEMATIC, excess / square_left)
    covariance *= 1.0 + max(stays, (len(energy) - 1) * alike)
    covariance += np.outer(scale, scale) * (inverse @ walk(energy, scale) @ inverse.T)
    hidden, _ = solved(total + back, excess / float(x**2 @ np.diag(total)[:p]))
    covariance += np.diag((hidden - x) ** 2)
    freedom = np.maximum(np.sum(gains, axis=0) ** 2 / np.sum(np.square(gains), axis=0), LEAST_FREEDOM)
    return _with_prior(covariance, freedom, np.outer(scale, scale) * inverse, prior)


def _with_prior(covariance: Floats, freedom: Floats, inverse: Floats, prior: Prior | None) -> Intervals:
    """The intervals from the scatter (p, p) with its degrees of freedom (p,), and from the prior of the gains."""
    if prior is None:
        return Intervals(covariance, np.sqrt(np.diag(covariance)) * student_factor(0.95, freedom))
    error = prior.error(inverse)
    certain = student_factor(0.95, np.array([np.inf])) ** 2 * np.diag(error)
    half95 = np.sqrt(student_factor(0.95, freedom) ** 2 * np.diag(covariance) + certain)
    return Intervals(covariance + error, half95)


def walk(energy: Sequence[Block], scale: Floats) -> Floats:
    """(p, p) covariance of the scaled right side by the noise of torques, which walks in the work of an arc.

    A step of the walk counts with the sum of all rows behind it. Where the sums of all blocks do not end at 0, the rest
    is shared out to the instants. Within a block the sums change evenly; Simpson's rule is exact for their squares.
    """
    step = np.array([scale * block.deviation[: len(scale)] for block in energy])
    share = np.array([block.instants for block in energy])
    bridge = np.cumsum(step - np.outer(share / share.sum(), step.sum(axis=0)), axis=0)
    begin = np.vstack([np.zeros(len(scale)), bridge[:-1]])
    variance = np.array([block.variance for block in energy])
    ends = np.einsum("b,bi,bj->ij", variance, begin, begin) + np.einsum("b,bi,bj->ij", variance, bridge, bridge)
    middle = np.einsum("b,bi,bj->ij", variance, begin + bridge, begin + bridge)
    return np.asarray((ends + middle) / 6.0, dtype=np.float64)


def joint_intervals(
    groups: Sequence[Floats],
    counts: Floats,
    noise: Floats,
    apart: tuple[Floats, int],
    segments: float,
    elapsed_s: float,
    prior: Prior | None = None,
) -> Intervals:
    """Intervals of the estimate from the groups of joint rows alone, all of whose declared noise was subtracted.

    groups: (p+1, p+1) sums of each. counts: (groups,) rows of each. noise: (p+1, p+1) what was subtracted. apart:
    squared sums of rows in segments, and their number. segments: their number for a joint. elapsed_s: their time.
    prior: as of `intervals`.
    """
    total = np.sum(groups, axis=0)
    p = len(total) - 1
    scale = 1.0 / np.sqrt(np.diag(total + noise)[:p])

    known = np.zeros((p, p)) if prior is None else prior.placed(p)

    def solved(sums: Floats) -> tuple[Floats, Floats]:
        inverse = np.asarray(np.linalg.inv((sums[:p, :p] + known) * np.outer(scale, scale)), dtype=np.float64)
        return scale * (inverse @ (scale * sums[p, :p])), inverse

    x, inverse = solved(total)
    ahead = np.append(x, -1.0)
    gains, influences = [], []
    for sums in groups:
        without, rest = solved(total - sums)
        pull = sums[p, :p] - sums[:p, :p] @ x
        alone = scale * (inverse @ (scale * pull))
        influences.append((1.0, pull, alone, x - without))
        gains.append(np.maximum(np.diag(rest) - np.diag(inverse), 0.0))
    covariance = squares_of_blocks(influences)
    residual = (float(ahead @ total @ ahead) + float(x @ noise[:p, :p] @ x)) / float(np.sum(counts))
    cluster = float(ahead @ apart[0] @ ahead) / apart[1] / residual
    alike = max(0.0, 1.0 - CLUSTER_LIMIT / cluster)
    covariance *= 1.0 + max(SYSTEMATIC * elapsed_s / SYSTEMATIC_S, (segments - 1.0) * alike)
    freedom = np.sum(gains, axis=0) ** 2 / np.sum(np.square(gains), axis=0) - 1.0
    return _with_prior(covariance, np.maximum(freedom, LEAST_FREEDOM), np.outer(scale, scale) * inverse, prior)

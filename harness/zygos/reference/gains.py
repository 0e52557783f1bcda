# SPDX-License-Identifier: MIT
"""The prior of the torque sensors' gains beside the rows, and its part in the intervals (docs/theory.md, "Gains").

With errors e of the sensors' gains, independent and of the declared deviations s, gain j relative to the reference r is
e_r - e_j up to squares, so that P_ij = s_r^2 + d_ij s_j^2. In the unit of the rows the prior is D^(1/2) P^-1 D^(1/2): D
is what a unit of information on each gain costs in variance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.reference.sigmas import Block, walk
from zygos.reference.solver import Rows, Solution, solve

Floats = NDArray[np.float64]

LEAST_PRIOR = 1e-9
"""Smallest share of a gain's own information that its prior is given, so that it leaves the rank full."""


@dataclass(frozen=True)
class Sums:
    """Sums of blocks of rows with p columns, from which scatter follows.

    energy, others: blocks of the energy rows and of all others, weighted. noise: (p+1, p+1) all noise that was
    subtracted. own: (p+1, p+1) its part in the energy rows.
    """

    energy: Sequence[Block]
    others: Sequence[Block]
    noise: Floats
    own: Floats

    @property
    def total(self) -> Floats:
        """(p+1, p+1)"""
        return np.asarray(np.sum([block.sums for block in (*self.energy, *self.others)], axis=0), dtype=np.float64)


@dataclass(frozen=True)
class Prior:
    """What the prior of g gains adds to the equations of p parameters, of which they are the last ones.

    weight: (g, g). covariance: (g, g) P.
    """

    weight: Floats
    covariance: Floats

    def rows(self, p: int) -> Rows:
        """The prior as rows beside others."""
        z = np.zeros((len(self.weight), p))
        z[:, p - len(self.weight) :] = np.linalg.cholesky(self.weight).T
        return Rows.exact(z, np.zeros(len(self.weight)))

    def placed(self, p: int) -> Floats:
        """(p, p) the weight, zero outside the gains."""
        out = np.zeros((p, p))
        out[p - len(self.weight) :, p - len(self.weight) :] = self.weight
        return out

    def error(self, inverse: Floats) -> Floats:
        """(p, p) covariance of what errors of the gains make of the solution, from (A + prior)^-1 (p, p)."""
        shift = inverse[:, len(inverse) - len(self.weight) :] @ self.weight
        return np.asarray(shift @ self.covariance @ shift.T, dtype=np.float64)


def prior(arm: Arm, cost: Floats, scale: Floats) -> Prior:
    """The prior for what a unit of information costs in variance, (g,), at least so much that the rank stays full.

    scale: (g,) inverse lengths of the gains' columns.
    """
    sigma = np.array([arm.joints[i].torque_gain_sigma for i in arm.relative_gains])
    root = np.sqrt(np.maximum(cost, LEAST_PRIOR * (sigma / scale) ** 2))
    p = arm.relative_gain_covariance
    return Prior(np.outer(root, root) * np.linalg.inv(p), p)


def held(rows: Rows, gains: int) -> Rows:
    """The rows without the columns of the gains."""
    if not gains:
        return rows
    p = rows.z.shape[1] - gains
    kept = [*range(p), p + gains]
    return Rows(rows.z[:, :p], rows.w, rows.noise[np.ix_(kept, kept)])


def solve_held(energy: Rows, beside: Sequence[Rows], gains: int) -> Solution:
    """`solve` with gains of 0. Errors: as `solve`."""
    found = solve(held(energy, gains), [held(rows, gains) for rows in beside])
    return replace(found, x=np.append(found.x, np.zeros(gains)))


def prior_of(arm: Arm, still: Solution, sums: Sums) -> Prior:
    """The prior of the gains. still: the solution with gains of 0; sums: of the blocks, weighted as for it."""
    g = len(arm.relative_gains)
    scale = 1.0 / np.sqrt(np.diag(sums.total + sums.noise)[-1 - g : -1])
    sigma = np.array([arm.joints[i].torque_gain_sigma for i in arm.relative_gains])
    wide = prior(arm, still.residual**2 * sigma**2, scale)
    return prior(arm, _costs(sums, wide, still.noise_scale, g), scale)


def _costs(sums: Sums, wide: Prior, noise_scale: float, gains: int) -> Floats:
    """(g,) what a unit of information on each gain costs in variance, from the scatter of the blocks."""
    total, p = sums.total, len(sums.noise) - 1
    back = (1.0 - noise_scale) * sums.noise
    scale = 1.0 / np.sqrt(np.diag(total + sums.noise)[:p])
    normal = total + back
    scaled = (normal[:p, :p] + wide.placed(p)) * np.outer(scale, scale)
    inverse = np.outer(scale, scale) * np.linalg.inv(scaled)
    x = inverse @ normal[p, :p]
    instants = sum(block.instants for block in sums.energy)
    factor = instants / sum(block.square for block in sums.energy) if sums.energy else 1.0
    variance = np.zeros(p)
    for block in (*sums.energy, *sums.others):
        share = block.instants / instants if block.instants else 0.0
        mine = block.sums + (1.0 - noise_scale) * share * sums.own
        alone = inverse @ (mine[p, :p] - mine[:p, :p] @ x)
        variance += (factor if block.instants else 1.0) * alone**2
    if sums.energy:
        variance += np.diag(inverse @ walk(sums.energy, np.ones(p)) @ inverse.T)
    return np.asarray((variance / np.diag(inverse))[p - gains :], dtype=np.float64)

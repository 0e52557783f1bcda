# SPDX-License-Identifier: MIT
"""When an arc contradicts the running solution, once more and in numpy: as include/zygos/guard.h says it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from zygos.arm import Arm
from zygos.balances.impulse import impulse_names
from zygos.native.flight import Blocks, Estimate, Flight

Floats = NDArray[np.float64]
MARGIN, SIGMAS, SHARE, LEAST_CLUSTER = 1.25, 6.0, 1e-3, 0.25


@dataclass(frozen=True)
class Running:
    """An adopted estimate, the blocks that it came from, and those without the noise subtracted."""

    arm: Arm
    estimate: Estimate
    blocks: Blocks
    plain: Blocks

    @property
    def covariance(self) -> Floats:
        """(p, p) as wide as the 95 % intervals."""
        wider = self.estimate.half95 / (stats.norm.isf(0.025) * self.estimate.sigma)
        return np.asarray(self.estimate.covariance * np.outer(wider, wider))

    def energy(self, arc: Blocks, noise: Floats) -> tuple[float, float]:
        """Residuals of an arc of energy rows over their limit: of its rows, and of their sums in its blocks. arc: its
        own blocks alone; noise: what was subtracted from them, (p+1, p+1)."""
        x, running = np.append(self.estimate.solution, -1.0), self.estimate.residual**2
        p = len(x) - 1
        sums = np.sum([block[0] for block in arc.energy], axis=0)
        n = sum(block[2] for block in arc.energy)
        known = sum(block[2] for block in self.blocks.energy)
        spread = sum(block[0][p, p] for block in self.blocks.energy) / known
        expected = self.estimate.noise_ratio * float(x @ noise @ x)
        uncertain = float(np.sum(sums[:p, :p] * self.covariance))
        most = _limit((expected, uncertain, sums[p, p]), (running, spread), n, n / self.arm.smoother.points)
        rows = float(x @ (sums + noise) @ x) / most
        deviation, instants, square = (np.array([block[k] for block in arc.energy]) for k in (1, 2, 3))
        walk = np.einsum("bi,ij,bj->b", deviation[:, :p], self.covariance, deviation[:, :p])
        count, cluster = len(square), max(self.estimate.cluster, LEAST_CLUSTER)
        most = quantile(0.5 * count) * cluster * max(expected / n, running) * count
        most += SIGMAS**2 * float(np.sum(walk / square)) + SHARE**2 * spread * float(np.sum(instants**2 / square))
        return rows, float(np.sum((deviation @ x) ** 2 / square)) / most

    def motors(self, arc: Blocks, plain: Blocks) -> list[float]:
        """The same of an arc of motor rows, of each joint. plain: its blocks without the noise subtracted."""
        out, arm = [], self.arm
        arc_s = round(arm.impulse_arc_s / arm.period_s) * arm.period_s
        for i, joint in enumerate(arm.joints):
            at = [self.estimate.names.index(name) for name in impulse_names(arm, i)]
            x = np.append(self.estimate.solution[at], -1.0)
            (sums, n), (noisy, _) = arc.motors[-1][i], plain.motors[-1][i]
            all_n = sum(block[i][1] for block in self.blocks.motors)
            residual = sum(float(x @ block[i][0] @ x) for block in self.plain.motors) / all_n
            spread = sum(float(block[i][0][-1, -1]) for block in self.blocks.motors) / all_n
            reading = joint.link_encoder.over_the_wire.sigma_rad**2 + joint.motor_encoder.over_the_wire.sigma_rad**2
            expected = float(x @ (noisy - sums) @ x) + n * x[1] ** 2 * reading * arc_s**2 / 10.0
            uncertain = float(np.sum(sums[:-1, :-1] * self.covariance[np.ix_(at, at)]))
            most = _limit((expected, uncertain, float(sums[-1, -1])), (residual, spread), n, 1.0)
            out.append(float(x @ noisy @ x) / most)
        return out


def quantile(freedom: float) -> float:
    """The 6-sigma quantile of chi-square over its degrees of freedom, by the cube root that is nearly normal."""
    u = 2.0 / (9.0 * max(freedom, 1.0))
    return float(MARGIN * (1.0 - u + SIGMAS * np.sqrt(u)) ** 3)


def _limit(found: Sequence[float], run: tuple[float, float], n: float, freedom: float) -> float:
    """found: expected residuals, their uncertainty and the spread of the right side; run: mean squares of residuals and
    of the right side."""
    expected, uncertain, own_spread = found
    spread = max(own_spread, n * run[1])
    alike = max(n * run[0], run[0] / run[1] * spread)
    return quantile(freedom) * max(expected, alike) + SIGMAS**2 * max(uncertain, 0.0) + SHARE**2 * spread


def contradiction(flight: Flight) -> Floats:
    """(3,) residuals of the newest arc of each kind of rows over their limit. No other test knows where they are."""
    return np.array(list(flight.native.sums.guard.contradiction))

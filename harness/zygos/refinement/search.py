# SPDX-License-Identifier: MIT
"""The noise of the torques that the readings favour: solutions at several levels of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from zygos import limits
from zygos.arm import Arm
from zygos.errors import Undecided, ZygosError
from zygos.native.propagation import Propagation
from zygos.refinement.blocks import Blocks, Linear, linearise
from zygos.refinement.bound import steps_of
from zygos.refinement.follow import Pass, Prior, Start, follow, triangle_of
from zygos.refinement.motion import FlexibleMotion
from zygos.refinement.rivals import EXPECTED, typical_torque

Floats = NDArray[np.float64]
Progress = Callable[[float], None]

REMEDY = (
    "find what the model lacks with `zygos explain`, and until then use the values of `zygos estimate`, which need no "
    "complete model"
)
FIRST_LEVEL = 0.05
"""Noise of the torques in the first solutions, as a share of their size."""
_MOST = 10
"""Largest number of times that the motion is taken anew around the last solution, at the first level and after it."""
_NEAR, _SETTLED = 5.0, 3.0
"""By how many standard deviations (rms) the last solution may move the values, at the first level and after it. The
next one would move them by a few per cent of that."""
_FINEST = 1e-5
"""The smallest level above 0 that is tried."""
_RATIO = 10.0
"""Between the levels that are tried first."""
_HALVINGS = 3
"""How often the ratio is halved, in powers, around the best level."""
_SHARE = 0.01
"""Unit of a delay, in periods, and of a gain, where they are tested only."""


@dataclass(frozen=True)
class Found:
    """What a search has found."""

    level: float
    """Noise of the torques, as a share of their size, of the joint with the most."""
    error: float
    """Standard error of its logarithm; 0 where the level is 0."""
    final: Pass
    """The solution at this level."""
    prior: Prior
    """What was known without the readings when it was computed."""
    tried: tuple[tuple[float, float], ...]
    """Levels that were tried around the same motion, and their deviances."""


class Search:
    """Solutions for a record at several levels of torque noise. A level is that of the joint with the most."""

    def __init__(
        self, arm: Arm, blocks: Blocks, start: Start, around: Floats, beside: Floats, progress: Progress
    ) -> None:
        """Begin at a start. around: (p, p) covariance within which a solution stays around the parameters it begins
        with, SI units; beside: (5N,) deviations of the constants beside them. Nothing is computed yet."""
        self.arm, record, self.start, self.around, self.beside = arm, blocks.record, start, around, beside
        self.progress, self.tried = progress, dict[float, Pass]()
        declared = np.array([joint.torque_relative_sigma for joint in arm.joints])
        self.declared = float(declared.max())
        self.shape = declared / self.declared if self.declared > 0.0 else np.ones(arm.n)
        steps = steps_of(
            FlexibleMotion(arm, start.value), np.concatenate([piece.q[piece.read] for piece in record.pieces])
        )
        self.propagation = Propagation(arm, steps, friction=True)
        self.blocks, self.states = blocks, blocks.states
        self.typical = typical_torque(record)
        self.linear: Linear

    def levels(self, level: float) -> tuple[float, ...]:
        """(N,) noise of each joint."""
        return tuple((level * self.shape).tolist())

    def run(self) -> Found:
        """The level that the readings favour, and the solution at it. Errors: Undecided where there is none."""
        first = max(FIRST_LEVEL, 4.0 * self.declared)
        self._approach(first)
        levels = _down_from(first)
        for k in range(_MOST):
            self.progress(0.3 + 0.6 * k / _MOST)
            self._linearise()
            level = self._best_of(levels)
            if self._moved(self.tried[level]) < _SETTLED:
                level, error = self._refined()
                final = self._follow(level, keep=True)
                tried = sorted(((one, found.deviance) for one, found in self.tried.items()), reverse=True)
                return Found(level, error, final, self._prior(), tuple(tried))
            self._take(self._follow(level, keep=True))
            # around better values the motion errs less, so that torques may turn out to be better as well
            levels = _down_from(max(level, _FINEST))
        raise Undecided(f"the values do not settle from solution to solution; remedy: {REMEDY}")

    def _approach(self, level: float) -> None:
        """Move the start into the range in which the motion is linear."""
        for k in range(_MOST):
            self.progress(0.3 * k / _MOST)
            self._linearise()
            found = self._follow(level, keep=True)
            moved = self._moved(found)
            self._take(found)
            if moved < _NEAR:
                return
        raise Undecided(f"the values do not settle from solution to solution; remedy: {REMEDY}")

    def _linearise(self) -> None:
        """The motion around the start and the states."""
        start, self.tried = self.start, {}
        try:
            self.linear = linearise(self.blocks, self.propagation, start.value, start.beside, self.states)
        except ZygosError as left:
            raise Undecided(f"the estimate from energy rows is too far off as a start; remedy: {REMEDY}") from left

    def _prior(self) -> Prior:
        """What is known without the readings."""
        size, n = self.linear.size, self.arm.n
        p = len(size)
        torque = EXPECTED * self.typical
        expected = np.concatenate([torque, torque, np.full(n, _SHARE), np.zeros(2 * n)])
        unit = np.concatenate([size, np.where(self.beside > 0.0, self.beside, expected), [_SHARE]])
        free = np.flatnonzero(self.beside > 0.0)
        root = np.eye(p + len(free))
        own = np.linalg.cholesky(self.around / np.outer(size, size))
        root[:p, :p] = triangle_of(solve_triangular(own, np.eye(p), lower=True))
        gains = p + np.flatnonzero((free >= 2 * n) & (free < 3 * n))
        if len(gains):
            spread = np.linalg.cholesky(
                self.arm.relative_gain_covariance
                / np.outer(unit[p + free], unit[p + free])[np.ix_(gains - p, gains - p)]
            )
            root[np.ix_(gains, gains)] = triangle_of(solve_triangular(spread, np.eye(len(gains)), lower=True))
        # a value may move from solution to solution, but a gain or a zero is known to be near 0
        pull = np.zeros(len(root))
        known = p + np.flatnonzero(free >= 2 * n)
        pull[known] = root[np.ix_(known, known)] @ (self.start.beside[free] / self.beside[free])[known - p]
        return Prior(unit, np.concatenate([np.arange(p), p + free]), root, pull)

    def _follow(self, level: float, *, keep: bool = False) -> Pass:
        return follow(self.linear, np.array(self.levels(level)), self.start, self._prior(), keep=keep)

    def _moved(self, found: Pass) -> float:
        """How far a solution moves the values, in their deviations, rms."""
        return float(np.sqrt(np.mean((found.value - self.start.value) ** 2 / np.diag(found.covariance))))

    def _take(self, found: Pass) -> None:
        """Take a solution as the next start."""
        self.start, self.states = Start(found.value, found.beside), found.states

    def _best_of(self, levels: Sequence[float]) -> float:
        """The level with the least deviance, of those before the first one that is worse than the one before it."""
        before = math.inf
        for level in levels:
            self.tried[level] = self._follow(level)
            if self.tried[level].deviance > before:
                break
            before = self.tried[level].deviance
        return self._best()

    def _refined(self) -> tuple[float, float]:
        """The level with the least deviance around the best one, and the standard error of its logarithm."""
        ratio = _RATIO
        for _ in range(_HALVINGS):
            ratio, around = math.sqrt(ratio), self._best()
            for level in (around * ratio, around / ratio):
                if around > 0.0:
                    self.tried[level] = self._follow(level)
        best = self._best()
        none = self.tried.get(0.0)
        if best > 0.0 and (none is None or none.deviance > self.tried[best].deviance + limits.SIMPLER.value):
            return self._between(best, ratio)
        return 0.0, 0.0

    def _best(self) -> float:
        return min(self.tried, key=lambda level: self.tried[level].deviance)

    def _nearest(self, level: float) -> float:
        """The level that was tried nearest to one."""
        return min(self.tried, key=lambda one: abs(one - level))

    def _between(self, best: float, ratio: float) -> tuple[float, float]:
        """The lowest point of the curve through three deviances, by the logarithm u of the level, and its standard
        error. Of innovations that are due to the torques alone, it is a + b u + c exp(-2u)."""
        near = [best / ratio, best, best * ratio]
        known = [self._nearest(level) for level in near]
        below, at, above = (self.tried[level].deviance for level in known)
        step = math.log(ratio)
        fall = (above - 2.0 * at + below) / (2.0 * math.cosh(2.0 * step) - 2.0)
        rise = (0.5 * (above - below) + fall * math.sinh(2.0 * step)) / step
        if len(set(known)) < len(near) or fall <= 0.0 or rise <= 0.0:
            return best, 0.0
        return best * math.sqrt(2.0 * fall / rise), 1.0 / math.sqrt(rise)


def _down_from(level: float) -> list[float]:
    """The levels that are tried, from the largest to none."""
    count = max(1, math.ceil(math.log(level / _FINEST) / math.log(_RATIO)))
    return [*(level / _RATIO**k for k in range(count)), 0.0]

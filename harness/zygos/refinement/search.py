"""The noise of the torques that the readings favour: passes over a record at several levels of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import TORQUE_STEP, Arm
from zygos.errors import Undecided, ZygosError
from zygos.native.refiner import Settings
from zygos.refinement.bound import steps_of
from zygos.refinement.follow import Beside, Pass, Start, follow
from zygos.refinement.motion import FlexibleMotion
from zygos.refinement.record import Record
from zygos.refinement.rivals import Rival, rivals, typical_torque
from zygos.refinement.start import MOST, within

Floats = NDArray[np.float64]
Progress = Callable[[float], None]

REMEDY = (
    "find what the model lacks with `zygos explain`, and until then use the values of `zygos estimate`, which need no "
    "complete model"
)
FIRST_LEVEL = 0.05
"""Noise of the torques in the first pass, as a share of their size."""
_APPROACHES = 8
"""Largest number of passes at the first level: each begins from the result of the one before, until it moves the values
by less than their standard deviations."""
_FINEST = 1e-5
"""The smallest level above 0 that is tried."""
_RATIO = 3.0
"""Between the levels that are tried first."""
_HALVINGS = 2
"""How often the ratio is halved, in powers, around the best level."""
_AGAIN = 3.0
"""Standard deviations at the start of the following passes, as a multiple of those that the first one found."""
_FAR, _NEAR = 100.0, 10.0
"""Where the standard deviations shrink more than _FAR times from the start of a search, it is repeated from the result
of its best pass, with deviations _NEAR times as large as that one's."""
_SIMPLER = 9.0
"""Deviance by which noise in proportion to the torques must be better than none."""
STEPS = 10.0
"""Noise of the torques that passes though none in proportion is declared, as a multiple of the constant one: so much
the filter takes for noise that is its own error of linearisation."""


class Search:
    """Passes over a record at several levels of torque noise. A level is that of the joint with the most."""

    def __init__(self, arm: Arm, record: Record, start: Start, beside: Beside, progress: Progress) -> None:
        """Begin at a start; nothing is computed yet."""
        self.arm, self.record, self.start, self.beside = arm, record, start, beside
        self.progress, self.tried = progress, dict[float, Pass]()
        self.earlier = dict[float, Pass]()
        declared = np.array([joint.torque_relative_sigma for joint in arm.joints])
        self.declared = float(declared.max())
        self.shape = declared / self.declared if self.declared > 0.0 else np.ones(arm.n)
        motion = FlexibleMotion(arm, start.value)
        self.size = motion.size
        self.steps = steps_of(motion, np.concatenate([piece.q[piece.read] for piece in record.pieces]))

    def levels(self, level: float) -> tuple[float, ...]:
        """(N,) noise of each joint."""
        return tuple((level * self.shape).tolist())

    def follow(self, level: float, record: Record | None = None, beside: Beside | None = None, **more: Any) -> Pass:
        """One pass."""
        settings = Settings(
            self.size,
            self.steps,
            self.levels(level),
            friction=(beside or self.beside).friction is not None,
            offsets=(beside or self.beside).offsets is not None,
            zeros=(beside or self.beside).zeros is not None,
        )
        return follow(record or self.record, settings, self.start, beside or self.beside, **more)

    def run(self) -> tuple[float, float]:
        """The level that the readings favour, and the standard error of its logarithm."""
        first = max(FIRST_LEVEL, 4.0 * self.declared)
        self._approach(first)
        level, error = self._search(first, 0.2, 0.7)
        best = self.tried[self._best()]
        # from the start of the search, torques that are far better lead a linear filter slightly astray
        if np.trace(best.covariance) < np.trace(self.start.covariance) / _FAR**2:
            self.start = Start(best.value, _NEAR**2 * best.covariance)
            self.earlier, self.tried = self.tried, {}
            level, error = self._search(max(_RATIO * level, _FINEST), 0.7, 1.0)
        return level, error

    def _approach(self, level: float) -> None:
        """Move the start into the range in which the motion is linear, with as many passes as that takes."""
        scale = np.outer(self.size, self.size)
        for k in range(_APPROACHES):
            try:
                rough = self.follow(level)
            except ZygosError as left:
                raise Undecided(f"the estimate from energy rows is too far off as a start; remedy: {REMEDY}") from left
            moved = float(np.sqrt(np.mean((rough.value - self.start.value) ** 2 / np.diag(rough.covariance))))
            covariance = scale * within(_AGAIN**2 * rough.covariance / scale, MOST)
            self.start = Start(rough.value, covariance)
            self.progress(0.2 * (k + 1) / _APPROACHES)
            if moved < 1.0:
                return
        raise Undecided(f"the values do not settle from pass to pass; remedy: {REMEDY}")

    def _search(self, first: float, begin: float, end: float) -> tuple[float, float]:
        """As `run`, from the level `first` on, which is the largest."""
        count = math.ceil(math.log(first / _FINEST) / math.log(_RATIO)) + 2
        rises = 0
        for k, level in enumerate([*(first / _RATIO**k for k in range(count - 1)), 0.0]):
            before = min((one.deviance for one in self.tried.values()), default=math.inf)
            rises = rises + 1 if not self._try(level) < before else 0
            self.progress(begin + (end - begin) * (k + 1) / count)
            if rises > 1:
                break
        ratio = _RATIO
        for _ in range(_HALVINGS):
            ratio, around = math.sqrt(ratio), self._best()
            for level in (around * ratio, around / ratio):
                if around > 0.0:
                    self._try(level)
        best = self._best()
        none = self.tried.get(0.0)
        if best > 0.0 and (none is None or none.deviance > self.tried[best].deviance + _SIMPLER):
            return self._between(best, ratio)
        return 0.0, 0.0

    def final(self, level: float) -> Pass:
        """The pass at the level that was found, with all that is drawn."""
        found = self.follow(level, keep=True)
        self.tried[level] = found
        return found

    def rivals(self, level: float, progress: Progress) -> tuple[Rival, ...]:
        """Models with one thing more, at the level that was found."""
        typical = float(typical_torque(self.record).max())
        least = STEPS * TORQUE_STEP / math.sqrt(12.0) / typical if typical > 0.0 else _FINEST

        def again(record: Record, beside: Beside) -> Pass:
            return self.follow(level, record, beside)

        return rivals(self.record, self.beside, self.tried[level], max(level, least), again, progress)

    def _try(self, level: float) -> float:
        try:
            self.tried[level] = self.follow(level)
        except ZygosError:  # the torques cannot be as good as that
            return math.inf
        return self.tried[level].deviance

    def _best(self) -> float:
        if not self.tried:
            raise Undecided(f"the filter finds no motion that fits the readings; remedy: {REMEDY}")
        return min(self.tried, key=lambda level: self.tried[level].deviance)

    def _nearest(self, level: float) -> float:
        """The level that was tried nearest to one."""
        return min(self.tried, key=lambda one: abs(one - level))

    def _between(self, best: float, ratio: float) -> tuple[float, float]:
        """The lowest point of the parabola through three deviances, by the logarithm of the level."""
        near = [best / ratio, best, best * ratio]
        known = [self._nearest(level) for level in near]
        below, at, above = (self.tried[level].deviance for level in known)
        bend = 0.5 * (below + above) - at
        if len(set(known)) < len(near) or bend <= 0.0:
            return best, 0.0
        step = math.log(ratio)
        move = 0.25 * (below - above) / bend
        return best * math.exp(move * step), step / math.sqrt(bend)

# SPDX-License-Identifier: MIT
"""The gap of an arm on the ground: how well torques and energies of untouched runs are predicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import Effect
from zygos.gap.adopted import Check, no_worse
from zygos.gap.record import MeasuredRun
from zygos.gap.remainder import explained_share
from zygos.gap.verdicts import Remainder
from zygos.ground.motion import Motion, TorqueRows, cutoff_hz, torque_rows
from zygos.ground.score import Score, beside, scored, with_floor
from zygos.ground.twin import floor
from zygos.model.model import Model

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Stage:
    """A model: parameters in the order of the arm, and effects with their values."""

    name: str
    values: Floats
    effects: tuple[Effect, ...]

    @classmethod
    def of(cls, name: str, model: Model, arm: Arm) -> Stage:
        """A model under a name of its own. Errors: ZygosError where it does not fit the arm."""
        return cls(name, model.base_values(arm), model.effects)


@dataclass(frozen=True)
class Prediction:
    """An untouched run, predicted by the baselines and by the model that was found; m instants, N joints."""

    run: Run
    motion: Motion
    rows: TorqueRows
    delivered: Score
    refit: Score
    plain: Score
    """By the estimate of `zygos estimate`."""
    closed: Score
    floor: Score
    """Of the baseline that predicts best, on its own twin: noise, quanta and filters alone."""

    @property
    def baselines(self) -> tuple[tuple[str, Score], ...]:
        """The predictions that the model found must not be worse than, by name."""
        return (("as delivered", self.delivered), ("refit", self.refit), ("plain estimate", self.plain))

    @property
    def scores(self) -> tuple[tuple[str, Score], ...]:
        """By name."""
        return (*self.baselines, ("closed", self.closed), ("floor", self.floor))

    @property
    def floor_nm(self) -> Floats:
        """(N,) root mean square of the error of the torque that noise alone causes, Nm."""
        return np.array([joint.error_nm for joint in self.floor.joints])

    @property
    def evaluated(self) -> NDArray[np.bool_]:
        """(N,) which joints have torques that are large enough to say something of a model."""
        return np.array([joint.evaluated for joint in self.closed.joints])

    @property
    def error(self) -> Floats:
        """(m, N) torque that the closed model leaves, less its mean, Nm."""
        return np.asarray(self.closed.measured - self.closed.predicted, dtype=np.float64)

    @property
    def ratio(self) -> Floats:
        """(N,) error of the closed model over the floor; NaN at joints that are not evaluated."""
        errors = np.array([joint.error_nm for joint in self.closed.joints])
        return np.where(self.evaluated, errors / self.floor_nm, np.nan)

    @property
    def worst(self) -> float:
        """The largest ratio; 0 where no joint is evaluated."""
        return float(np.nanmax(self.ratio, initial=0.0))

    @property
    def closes(self) -> bool:
        """Whether noise alone is left."""
        return self.worst <= limits.CLOSED.value

    def closed_by(self, stage: Stage) -> Prediction:
        """With another model as the one that was found."""
        found = scored(self.run, stage.name, self.rows, stage.values, stage.effects, self.motion)
        return replace(self, closed=beside(with_floor(found, self.floor_nm), self.plain))

    def comparisons(self) -> tuple[Check, ...]:
        """The model found beside the best baseline: torques in units of their floors, in the median over stretches
        and in what a tenth of them exceeds, and the work in one second."""
        checks = []
        if self.evaluated.any():
            for percent, said in (
                (50, "the median error of the torques"),
                (limits.TAIL_PERCENT.value, "the 90th percentile of the error"),
            ):
                name = f"{said} in {run_name(self.run)}"
                each = [(which, self._percentile(score, percent)) for which, score in self.baselines]
                limit = limits.CLOSED.value * self._percentile(self.floor, percent)
                checks.append(no_worse(name, "floors", self._percentile(self.closed, percent), each, limit))
        if not (self.closes and self.evaluated.all()):
            # the floor of the work is known less well than those of torques: where these do not close, it is no excuse
            name = f"the error of the work in one second in {run_name(self.run)}"
            shares = [(which, 100.0 * score.arm_energy_share) for which, score in self.baselines]
            checks.append(no_worse(name, "% of it", 100.0 * self.closed.arm_energy_share, shares))
        return tuple(checks)

    def _percentile(self, score: Score, percent: float) -> float:
        """Percentile over stretches of half a second of the root mean square over the evaluated joints, in floors."""
        left = np.where(score.resting, np.nan, score.measured - score.predicted)
        square = (left[:, self.evaluated] / self.floor_nm[self.evaluated]) ** 2
        length = max(1, round(limits.STRETCH_S.value / self.rows.period_s))
        parts = np.array_split(square, max(1, len(square) // length))
        each = [np.nanmean(part) for part in parts if np.isfinite(part).any()]
        return float(np.percentile(np.sqrt(each), percent))


def _squares(score: Score) -> float:
    """The squared errors of all joints that move, added, Nm^2."""
    return float(np.nansum([one.error_nm**2 for one in score.joints]))


def predict(run: Run, delivered: Stage, refit: Stage, plain: Stage) -> Prediction:
    """Predict a run with the baselines; the plain estimate stands for the model that is not yet found.

    Errors: ZygosError for a run that is too short.
    """
    motion = Motion.of(run)
    rows = torque_rows(motion.arm, motion.samples, min(cutoff_hz(run.arm), limits.HIGHEST_CUTOFF_HZ.value))
    stages = (delivered, refit, plain)
    first, second, third = scores = [scored(run, one.name, rows, one.values, one.effects, motion) for one in stages]
    best, _ = min(zip(stages, scores, strict=True), key=lambda each: _squares(each[1]))
    least = floor(motion, rows, best.values, best.effects)
    closed = with_floor(third, np.array([joint.error_nm for joint in least.joints]))
    first, second = beside(first, third), beside(second, third)
    return Prediction(run, motion, rows, first, second, third, closed, least)


def share_of_energy(predictions: Sequence[Prediction], name: str) -> float:
    """Root mean square over runs of the share of the work in one second that a model does not predict."""
    shares = [dict(one.scores)[name].arm_energy_share for one in predictions]
    return float(np.sqrt(np.mean(np.square(shares))))


def remainders(predictions: Sequence[Prediction]) -> tuple[Remainder, ...]:
    """What the closed model leaves of the torques of untouched runs, joint by joint, the largest first."""
    out = []
    for one in predictions:
        arm = one.run.arm
        for j, joint in enumerate(arm.joints):
            if not one.ratio[j] > limits.CLOSED.value:
                continue
            over, share = varies_with(one, j)
            name = f"the {joint.name} in {run_name(one.run)}"
            out.append(Remainder(name, one.closed.joints[j].error_nm, "Nm", float(one.floor_nm[j]), over, share))
    return tuple(sorted(out, key=lambda rest: -rest.size))


def varies_with(one: Prediction, joint: int) -> tuple[str, float]:
    """The quantity that says most about the error at a joint, and its share of the square; empty where none does."""
    error = one.error[:, joint]
    share, name = max((explained_share(x[None], error[None]), name) for name, x in quantities(one, joint))
    return (name, share) if share > limits.TELLS.value else ("", 0.0)


def quantities(one: Prediction, joint: int) -> list[tuple[str, Floats]]:
    """(m,) what the error at a joint may vary with."""
    state, kept = one.rows.state, one.rows.kept
    return [
        ("rate", state.qd[kept, joint]),
        ("angle", np.mod(state.q[kept, joint], 2.0 * np.pi)),
        ("load", one.closed.predicted[:, joint]),
        ("time", one.closed.t),
    ]


def run_name(run: Run | MeasuredRun, number: int = 0) -> str:
    """Short name of a run: its folder where the file's own name does not tell runs apart. number: among the measured
    ones, from 1."""
    if run.path is None:
        return f"run {number}" if number else "the untouched run"
    return run.path.parent.name if run.path.stem == "run" else run.path.name

"""The gap of an arm on the ground: how well torques and energies of untouched runs are predicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.can.run import Run
from zygos.effects import Effect
from zygos.gap.ground.twin import floor
from zygos.gap.remainder import explained_share
from zygos.gap.verdicts import Remainder
from zygos.ground.motion import HIGHEST_CUTOFF_HZ, Motion, TorqueRows, cutoff_hz, torque_rows
from zygos.ground.score import Score, scored

Floats = NDArray[np.float64]

CLOSED = 3.0
"""Error of the predicted torques over what noise causes, up to which a run closes."""
TELLS = 0.2
"""Share of the squared error that must go with a quantity for it to be said."""


@dataclass(frozen=True)
class Prediction:
    """An untouched run, predicted by four models; m instants, N joints."""

    run: Run
    rows: TorqueRows
    delivered: Score
    refit: Score
    closed: Score
    floor: Score
    """Of the closed model on its own twin: noise, quanta and filters alone."""

    @property
    def scores(self) -> tuple[tuple[str, Score], ...]:
        """By name."""
        return (
            ("as delivered", self.delivered),
            ("refit", self.refit),
            ("closed", self.closed),
            ("floor", self.floor),
        )

    @property
    def floor_nm(self) -> Floats:
        """(N,) root mean square of the error of the torque that noise alone causes, Nm."""
        return np.array([joint.error_nm for joint in self.floor.joints])

    @property
    def error(self) -> Floats:
        """(m, N) torque that the closed model leaves, less its mean, Nm."""
        return np.asarray(self.closed.measured - self.closed.predicted, dtype=np.float64)

    @property
    def ratio(self) -> Floats:
        """(N,) error of the closed model over the floor."""
        errors = np.array([joint.error_nm for joint in self.closed.joints])
        return np.asarray(errors / self.floor_nm, dtype=np.float64)

    @property
    def closes(self) -> bool:
        """Whether noise alone is left."""
        return bool(np.all(self.ratio <= CLOSED))


@dataclass(frozen=True)
class Stage:
    """A model: parameters in the order of the arm, and effects with their values."""

    name: str
    values: Floats
    effects: tuple[Effect, ...]


def predict(run: Run, stages: Sequence[Stage]) -> Prediction:
    """Predict a run with the model as delivered, refit and closed.

    Errors: ZygosError for a run that is too short.
    """
    motion = Motion.of(run)
    rows = torque_rows(motion.arm, motion.samples, min(cutoff_hz(run.arm), HIGHEST_CUTOFF_HZ))
    scores = [scored(run, one.name, rows, one.values, one.effects, motion) for one in stages]
    delivered, refit, closed = scores
    return Prediction(run, rows, delivered, refit, closed, floor(motion, rows, stages[-1].values, stages[-1].effects))


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
            if one.ratio[j] <= CLOSED:
                continue
            over, share = varies_with(one, j)
            name = f"the {joint.name} in {run_name(one.run)}"
            out.append(Remainder(name, one.closed.joints[j].error_nm, "Nm", float(one.floor_nm[j]), over, share))
    return tuple(sorted(out, key=lambda rest: -rest.size))


def varies_with(one: Prediction, joint: int) -> tuple[str, float]:
    """The quantity that says most about the error at a joint, and its share of the square; empty where none does."""
    error = one.error[:, joint]
    share, name = max((explained_share(x[None], error[None]), name) for name, x in quantities(one, joint))
    return (name, share) if share > TELLS else ("", 0.0)


def quantities(one: Prediction, joint: int) -> list[tuple[str, Floats]]:
    """(m,) what the error at a joint may vary with."""
    state, kept = one.rows.state, one.rows.kept
    return [
        ("rate", state.qd[kept, joint]),
        ("angle", np.mod(state.q[kept, joint], 2.0 * np.pi)),
        ("load", one.closed.predicted[:, joint]),
        ("time", one.closed.t),
    ]


def run_name(run: Run, number: int = 0) -> str:
    """Short name of a run: its folder where the file's own name does not tell runs apart. number: among the measured
    ones, from 1."""
    if run.path is None:
        return f"run {number}" if number else "the untouched run"
    return run.path.parent.name if run.path.stem == "run" else run.path.name

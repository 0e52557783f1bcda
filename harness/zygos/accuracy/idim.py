# SPDX-License-Identifier: MIT
"""Batch least squares of torques on filtered accelerations (IDIM): what estimates on the ground are compared with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.can.run import Run
from zygos.effects import Effect
from zygos.errors import ZygosError
from zygos.ground.motion import Motion, torque_rows
from zygos.ground.rows import torque_columns
from zygos.ground.score import Score, scored

Floats = NDArray[np.float64]

_ROUNDS = 8


@dataclass(frozen=True)
class Idim:
    """p parameters in the order of `zygos.ground.rows.columns_of`, from R runs of an arm with N joints."""

    value: Floats
    """(p,)"""
    offset: Floats
    """(R, N) offset of each torque behind the gear, Nm."""
    sigma: Floats
    """(N,) root mean square of the residuals, Nm."""
    effects: tuple[Effect, ...]
    cutoff_hz: float

    def score(self, run: Run) -> Score:
        """The prediction of a run, through the filter of the estimate. Errors: ZygosError if the run is too short."""
        motion = Motion.of(run)
        rows = torque_rows(run.arm, motion.samples, self.cutoff_hz)
        own = len(run.arm.parameter_names)
        effects = [replace(one, value=float(x)) for one, x in zip(self.effects, self.value[own:], strict=True)]
        return scored(run, "IDIM", rows, self.value[:own], effects, motion)


def idim(runs: Sequence[Run], effects: Sequence[Effect], cutoff_hz: float) -> Idim:
    """Weighted least squares with the terms of an estimate on the ground: the arm's parameters, effects that are
    functions of the motion, and an offset of each torque in each run.

    Angles and torques pass a filter without delay at cutoff_hz; rates and accelerations are derivatives of the filtered
    angles. Each joint is weighted by its own residual, found in a few rounds.

    Errors: ZygosError for an effect that needs a predicted or a reported torque, and for a run that is too short.
    """
    for one in effects:
        if one.kind.on_ground:
            raise ZygosError(
                f"effect {one.kind.key}: batch least squares has no column for it; remedy: leave it out of both"
            )
    arm = runs[0].arm
    z, tau, owner = [], [], []
    for number, run in enumerate(runs):
        rows = torque_rows(arm, Motion.of(run).samples, cutoff_hz)
        z.append(torque_columns(arm, rows, effects)[rows.kept])
        tau.append(rows.tau[rows.kept])
        owner.append(np.full(int(rows.kept.sum()), number))
    columns, torque, place = np.concatenate(z), np.concatenate(tau), np.concatenate(owner)
    p, joints = columns.shape[-1], arm.n
    full = np.zeros((len(torque), joints, p + len(runs) * joints))
    full[..., :p] = columns
    for j in range(joints):
        full[np.arange(len(torque)), j, p + place * joints + j] = 1.0
    sigma = torque.std(axis=0)
    x = np.zeros(full.shape[-1])
    scale = 1.0 / np.maximum(np.sqrt(np.einsum("mjp,mjp->p", full, full)), 1e-300)
    for _ in range(_ROUNDS):
        rows_of_all = (full * scale / sigma[:, None]).reshape(-1, full.shape[-1])
        x = scale * np.linalg.lstsq(rows_of_all, (torque / sigma).ravel(), rcond=1e-10)[0]
        left = torque - full @ x
        sigma = np.sqrt(np.mean(left**2, axis=0))
    return Idim(x[:p], x[p:].reshape(len(runs), joints), sigma, tuple(effects), cutoff_hz)

# SPDX-License-Identifier: MIT
"""Whether the torques act later or earlier than the arm file says, and the constants of motors whose currents are
reported."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.effects import CATALOGUE
from zygos.gap.ground.columns import Table
from zygos.gap.ground.fit import fit, jackknife, residual
from zygos.ground.estimate import DEFAULT_FRICTION
from zygos.ground.motion import Motion
from zygos.ground.rows import friction, run_rows
from zygos.model.model import Model
from zygos.quantiles import normal_sf, student_isf

Floats = NDArray[np.float64]


def lateness(table: Table) -> float | None:
    """Periods by which the torques of all joints act later than the arm file says; None where they are in time, or the
    joints do not agree."""
    layout = table.layout
    usual = [one for one in layout.candidates if one.key in DEFAULT_FRICTION]
    lags = [layout.at(one.name) for one in layout.candidates if one.effect is not None and one.effect.kind.lags]
    if not lags:
        return None
    fitted = fit(table, [*layout.basis, *(layout.at(one.name) for one in usual), *lags])
    covariance, freedom, _ = jackknife(table, fitted)
    at = [fitted.free.index(k) for k in lags]
    value, sigma = fitted.x[lags], np.sqrt(np.maximum(np.diag(covariance)[at], 1e-300))
    weight = 1.0 / sigma**2
    mean = float(np.sum(weight * value) / np.sum(weight))
    limit = student_isf(normal_sf(limits.AGREE_Z.value), freedom[at]) * sigma
    same = np.all(np.abs(value - mean) <= np.maximum(limit, limits.AGREE_SHARE.value * abs(mean)))
    sure = abs(mean) * np.sqrt(np.sum(weight)) > student_isf(
        normal_sf(limits.NAMED_Z.value), float(np.min(freedom[at]))
    )
    # a run that hardly shows a lag agrees with any
    shown = np.all(np.abs(value) > 2.0 * sigma)
    periods = mean / layout.arm.period_s
    if not (same and sure and shown and abs(periods) > limits.LATE.value):
        return None
    without = fit(table, [*layout.basis, *(layout.at(one.name) for one in usual)])
    before, after = residual(table, without.x) / without.sigma**2, residual(table, fitted.x) / without.sigma**2
    rest = np.maximum(before - limits.NOISE.value * table.floor**2 / without.sigma**2, 0.0).sum(axis=1)
    return periods if np.all((before - after).sum(axis=1) > limits.LATE_EXPLAINS.value * rest) else None


def torque_constants(motions: Sequence[Motion], simulation: Model, span_s: float) -> Floats:
    """(N,) Nm for each unit of the reported currents, with which the simulation's torques fit best beside friction and
    an offset; 1 where the currents have nothing of them."""
    arm = motions[0].arm
    values = simulation.base_values(arm)
    own = [run_rows(motion, span_s, friction(arm, [CATALOGUE[key] for key in DEFAULT_FRICTION])) for motion in motions]
    out = np.ones(arm.n)
    p = len(values)
    for j in range(arm.n):
        parts = []
        for k, rows in enumerate(own):
            offsets = np.zeros((len(rows.w), len(own)))
            offsets[:, k] = 1.0
            rubbed = rows.z[:, j, [p + j, p + arm.n + j]]
            parts.append(
                np.column_stack([rows.z[:, j, :p] @ values, rubbed, offsets, rows.w[:, j]])[~rows.lingers[:, j]]
            )
        whole = np.concatenate(parts)
        slope = float(np.linalg.lstsq(whole[:, :-1], whole[:, -1], rcond=None)[0][0])
        out[j] = 1.0 / slope if slope > 0.0 else 1.0
    return out

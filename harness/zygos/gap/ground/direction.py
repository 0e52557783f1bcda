# SPDX-License-Identifier: MIT
"""Whether a constant torque is an offset of its sensor or a Coulomb friction that differs between the directions.

Both are the same while a joint moves. At rest the offset stays, and the difference of friction goes; a joint that
sticks may hold any torque up to its friction, so that several phases at rest must agree.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.balances.state import State
from zygos.gap.ground.columns import Table
from zygos.gap.ground.fit import Fit
from zygos.ground.rows import RunRows, resting_share
from zygos.quantiles import normal_isf, normal_sf, student_isf, student_sf

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OneSided:
    """A constant torque at a joint with Coulomb friction, the same in all runs."""

    joint: int
    value: float
    """Nm before the gear."""
    sigma: float
    z: float
    each: tuple[float, ...]
    """By run."""
    answer: Literal["either", "offset", "friction"]


def one_sided(
    table: Table, fitted: Fit, variance: Mapping[int, tuple[float, float]], friction: Mapping[int, float]
) -> Iterator[OneSided]:
    """The constant torques that friction may explain. friction: Nm by joint; variance: standard deviation and degrees
    of freedom of the free columns."""
    layout, runs = table.layout, table.layout.runs
    for j, coulomb in friction.items():
        places = [layout.shared + run * layout.arm.n + j for run in range(runs)]
        if coulomb <= 0.0 or any(k not in variance for k in places):
            continue
        each = fitted.x[places]
        sigma = np.array([variance[k][0] for k in places])
        freedom = min(variance[k][1] for k in places)
        weight = 1.0 / np.maximum(sigma, 1e-300) ** 2
        value = float(np.sum(weight * each) / np.sum(weight))
        wide = float(1.0 / np.sqrt(np.sum(weight)))
        z = float(normal_isf(max(float(student_sf(abs(value) / wide, freedom)), 1e-300)))
        limit = student_isf(normal_sf(limits.AGREE_Z.value), max(2.0, freedom)) * sigma
        same = np.all(np.abs(each - value) <= np.maximum(limit, limits.AGREE_SHARE.value * abs(value)))
        if z < limits.NAMED_Z.value or not same or not limits.ASYMMETRY.value * coulomb <= abs(value) <= coulomb:
            continue
        # a constant torque of a sensor cannot be larger than friction, if it is to be friction
        yield OneSided(j, value, wide, z, tuple(each.tolist()), _at_rest(table, fitted, j, value))


def _at_rest(table: Table, fitted: Fit, joint: int, value: float) -> Literal["either", "offset", "friction"]:
    """What the phases say in which the joint does not move."""
    means = np.array([mean for rows in table.rows for mean in phases(table, rows, fitted, joint)])
    if len(means) < limits.PHASES.value:
        return "either"
    if np.all(np.abs(means - value) < 0.5 * abs(value)):
        return "offset"
    return "friction" if np.all(np.abs(means) < 0.5 * abs(value)) else "either"


def phases(table: Table, rows: RunRows, fitted: Fit, joint: int) -> Iterator[float]:
    """Constant torque that is left over in each phase at rest, Nm before the gear."""
    motion, layout = rows.motion, table.layout
    state = State.smoothed(motion.arm, motion.smoothed)
    rests = resting_share(motion.arm, state, rows.rows)[:, joint] > limits.RESTS.value
    values = layout.start + fitted.x[: layout.shared]
    left = (rows.w[:, joint] - rows.z[:, joint] @ values) / rows.offset[joint]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rests.astype(np.int8), [0]])))
    for begin, end in edges.reshape(-1, 2):
        yield float(left[begin:end].mean())

# SPDX-License-Identifier: MIT
"""Torques that models need for the motion of a run, beside those that were measured.

This is inverse dynamics along the smoothed motion, from the joints' own balances, so that no acceleration is needed.

At a flexible joint the balance of the motor is taken, at a rigid one that of the link angle's momentum. Over a window
the change of what a model leaves over of it is the torque by which the model exceeds the measured one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.balances.state import State
from zygos.gap.balances import BalanceRows, balance_rows, kept_rows
from zygos.gap.record import MeasuredRun, followed, smoothed_states
from zygos.gap.study import Study, base_values

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointTorques:
    """Torques of one joint before the gear, Nm, over windows of the A arcs of a run."""

    joint: int
    """From 0."""
    window_s: float
    time: Array
    """(A, m) s since the start of the run."""
    measured: Array
    """(A, m) mean of the reported torque; NaN where the smoother does not follow the motion."""
    needed: tuple[Array | None, ...]
    """(A, m) what each model needs for the same motion; None for a model that takes a flexible joint as rigid."""
    rate: Array
    """(A, m) of the motor, after the gear, rad/s."""
    angle: Array
    """(A, m) of the link, rad."""
    deflection: Array | None
    """(A, m) rad; None at a rigid joint."""


def joint_torques(record: MeasuredRun, studies: Sequence[Study]) -> Iterator[JointTorques]:
    """Of every joint, in order. studies: the models, as fits to other runs."""
    readings = record.readings()
    kept, state = followed(record.arm, readings), smoothed_states(record.arm, readings)
    tables = [balance_rows(one.layout, readings, base_values(one.model, one.layout)) for one in studies]
    for i, joint in enumerate(record.arm.joints):
        name = f"M{i + 1}" if joint.flexible else f"L{i + 1}"
        yield _torques(record, list(zip(studies, tables, strict=True)), i, name, kept, state)


def _torques(
    record: MeasuredRun,
    models: Sequence[tuple[Study, BalanceRows]],
    i: int,
    name: str,
    kept: NDArray[np.bool_],
    state: State,
) -> JointTorques:
    arm = record.arm
    study, table = models[0]
    rows = table.balances[study.layout.balances.index(name)]
    whole = kept_rows(rows, kept)
    if rows.begin is None:
        window = max(2, round(limits.SLOPE_WINDOW_S.value / arm.period_s))
        begin, end = np.arange(0, len(rows.end) - window, window), np.arange(window, len(rows.end), window)
        ratio, good = 1.0, whole[:, begin] & whole[:, end]
    else:
        window = int(rows.end[0] - rows.begin[0])
        begin, end = rows.begin, rows.end
        ratio, good = arm.joints[i].gear_ratio, whole
    span = window * arm.period_s

    def torque(impulse: Array) -> Array:
        grown = impulse if rows.begin is not None else impulse[:, end] - impulse[:, begin]
        return np.where(good, grown / (ratio * span), np.nan)

    middle = (begin + end) // 2
    needed: list[Array | None] = []
    for one, own in models:
        k = one.layout.balances.index(name)
        if k not in one.hypothesis.balances:
            needed.append(None)
            continue
        full = np.concatenate([np.zeros(len(one.layout.zeros)), one.value, [-1.0]])
        mix = one.hypothesis.basis() @ full
        # the right side of a hypothesis may hold what the simulation takes as known
        left = own.balances[k].left @ mix[one.layout.used[k]] + own.balances[k].right * mix[-1]
        needed.append(torque(left + own.balances[k].right))
    flexible = arm.joints[i].flexible
    return JointTorques(
        i,
        span,
        record.time_s[:, middle],
        torque(rows.right),
        tuple(needed),
        state.thetad[..., i][:, middle],
        state.q[..., i][:, middle],
        (state.theta - state.q)[..., i][:, middle] if flexible else None,
    )

"""The equations of one run: joint rows with columns of the arm, of friction and of the torque sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.joint import JointRows, joint_rows, momentum_of_rates
from zygos.balances.momentum import variances
from zygos.balances.state import State
from zygos.effects import Effect, EffectColumn, Kind
from zygos.ground.motion import Motion, TorqueRows

Floats = NDArray[np.float64]

_NOISE_SAMPLES = 6
"""Increments of a block at which the expected products of noise are computed."""


@dataclass(frozen=True)
class RunRows:
    """m increments of N joints, with p shared columns and one offset of the torque for each joint."""

    motion: Motion
    rows: JointRows
    """With the columns of the arm and of the effects that are functions of the motion."""
    z: Floats
    """(m, N, p) the shared columns: those of the arm, then those of the effects."""
    w: Floats
    """(m, N) impulse of the motors, Nms."""
    offset: Floats
    """(N,) what an offset of 1 Nm (as reported) adds to an increment, Nms."""
    span_s: float
    """Length of the increments, s."""

    @property
    def augmented(self) -> Floats:
        """(m, N, p+2) the shared columns, that of the offset, and the impulse."""
        own = np.broadcast_to(self.offset, self.w.shape)[..., None]
        return np.concatenate([self.z, own, self.w[..., None]], axis=-1)

    def noise(self, increments: NDArray[np.int64]) -> Floats:
        """(N, p, p) expected products of the sensors' noise in the columns, summed over increments.

        A few increments stand for their neighbours, in which the arm has nearly the same posture. The momentum at both
        ends is linear in the rates, so that its columns at a unit rate are its derivatives. The noise of angles is of
        second order here, and integrals average it out.
        """
        arm, every = self.motion.arm, increments[:: max(1, len(increments) // _NOISE_SAMPLES)]
        sigma = np.sqrt(variances(arm).link)
        p, own = self.z.shape[-1], len(arm.parameter_names)
        out = np.zeros((arm.n, p, p))
        q = self.motion.smoothed.q[np.concatenate([self.rows.begin[every], self.rows.end[every]])]
        for i in range(arm.n):
            slope = momentum_of_rates(arm, q, np.broadcast_to(sigma[i] * np.eye(arm.n)[i], q.shape))
            out[:, :own, :own] += np.einsum("mjp,mjq->jpq", slope, slope, optimize=True)
        return out * len(increments) / max(len(every), 1)


def columns_of(arm: Arm, effects: Sequence[Effect]) -> tuple[str, ...]:
    """Names of the shared columns."""
    return (*arm.parameter_names, *(effect.column(arm) for effect in effects))


def run_rows(motion: Motion, span_s: float, effects: Sequence[Effect], predicted: Floats | None = None) -> RunRows:
    """The equations of a run.

    predicted: (instants, N) torque after the gear that a model predicts at the smoothed instants, which friction in
    proportion to the load needs; None: there is none yet, and its columns are 0.
    """
    arm = motion.arm
    moving = [effect for effect in effects if not effect.kind.on_ground]
    rows = joint_rows(arm, motion.samples, motion.smoothed, span_s, moving)
    state = State.smoothed(arm, motion.smoothed)
    p = len(arm.parameter_names)
    z = [rows.z[..., :p]]
    place = 0
    for effect in effects:
        if effect.kind.on_ground:
            z.append(_sensed(arm, motion, rows, state, effect, predicted)[..., None])
        else:
            z.append(rows.z[..., p + place, None])
            place += 1
    steps = rows.end[0] - rows.begin[0] if rows.count else 0
    return RunRows(
        motion=motion,
        rows=rows,
        z=np.concatenate(z, axis=-1),
        w=rows.w,
        offset=arm.gear_ratios * float(steps) * arm.period_s,
        span_s=float(steps) * arm.period_s,
    )


def _sensed(
    arm: Arm, motion: Motion, rows: JointRows, state: State, effect: Effect, predicted: Floats | None
) -> Floats:
    """(m, N) column of an effect that needs a torque: friction with the load, or the gain of a torque sensor."""
    column, joint = np.zeros_like(rows.w), effect.index(arm)
    if effect.kind.place == "sensor":
        column[:, joint] = -rows.w[:, joint]
    elif predicted is not None:
        total = np.concatenate([[0.0], np.cumsum(load_law(state.qd[:, joint], predicted[:, joint]))]) * arm.period_s
        column[:, joint] = total[rows.end] - total[rows.begin]
    return column


def load_law(rate: Floats, torque: Floats) -> Floats:
    """Torque (...) of friction in proportion to the load per unit of its coefficient, against the motion.

    The sign of the rate is blurred over 0.01 rad/s, because a small rate does not show its sign.
    """
    return np.asarray(np.tanh(rate / 0.01) * np.abs(torque), dtype=np.float64)


def torque_columns(arm: Arm, rows: TorqueRows, effects: Sequence[Effect], predicted: Floats | None = None) -> Floats:
    """(m, N, p) columns of the torque after the gear at each instant, in the order of `columns_of`.

    predicted: (m, N) torque that a model without friction in proportion to the load predicts, Nm.
    """
    extra = []
    for effect in effects:
        joint, column = effect.index(arm), np.zeros_like(rows.tau)
        column[:, joint] = rows.filtered(_law(arm, rows, effect.kind, joint, predicted))
        extra.append(column)
    return np.concatenate([rows.z, np.stack(extra, axis=-1)], axis=-1) if extra else rows.z


def _law(arm: Arm, rows: TorqueRows, kind: Kind, joint: int, predicted: Floats | None) -> Floats:
    rate, ratio = rows.state.qd[:, joint], arm.gear_ratios[joint]
    if kind.place == "sensor":
        return -rows.tau[:, joint]
    if kind.place == "load":
        return load_law(rate, predicted[:, joint]) if predicted is not None else np.zeros_like(rate)
    if kind.place == "torque":
        after = np.gradient(rows.tau[:, joint], rows.period_s)
        return np.asarray(after, dtype=np.float64)
    assert kind.torque is not None
    return np.asarray(kind.torque(rate) * (ratio if kind.place == "motor" else 1.0), dtype=np.float64)


def friction(arm: Arm, kinds: Sequence[Kind]) -> tuple[Effect, ...]:
    """An effect of each kind at each joint."""
    return tuple(Effect(kind, joint.name, 0.0) for kind in kinds for joint in arm.joints)


def column_at(names: Sequence[str], kind: Kind, joint: int) -> int:
    """Place of the column of a kind at a joint (from 0). Errors: ValueError where there is none."""
    return list(names).index(EffectColumn(kind.key, joint).name)

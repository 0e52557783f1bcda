# SPDX-License-Identifier: MIT
"""The equations of one run: joint rows with columns of the arm, of friction and of the torque sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.balances.joint import JointRows, joint_rows, momentum_of_rates
from zygos.balances.momentum import variances
from zygos.balances.state import State
from zygos.effects import SLOWEST_RATE, Effect, EffectColumn, Kind
from zygos.effects import Motion as JointMotion
from zygos.ground.motion import Motion, TorqueRows, torque_noise
from zygos.ground.rest import at_rest

Floats = NDArray[np.float64]

_WITHIN = 16
"""Number of parts of half a period in which friction is evaluated."""
_SIGNED = ("motor_coulomb", "link_coulomb", "load_friction")
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
    lingers: NDArray[np.bool_]
    """(m, N) increments in which a joint with friction hardly moves: nobody knows the friction of a joint at rest."""
    gains: tuple[tuple[int, int], ...] = ()
    """Joint and column of each torque sensor whose gain is estimated."""

    @property
    def augmented(self) -> Floats:
        """(m, N, p+2) the shared columns, that of the offset, and the impulse."""
        own = np.broadcast_to(self.offset, self.w.shape)[..., None]
        return np.concatenate([self.z, own, self.w[..., None]], axis=-1)

    @cached_property
    def _impulse_noise(self) -> Floats:
        """(N,) standard deviation of an increment's impulse by the noise of the torque, Nms. A declared noise may be
        that of other runs or contain what is not white; no more must be subtracted than the readings show."""
        reading = np.minimum(torque_noise(self.motion), torque_noise(self.motion, declared=False))
        arm = self.motion.arm
        return np.asarray(reading * arm.gear_ratios * np.sqrt(arm.period_s * self.span_s), dtype=np.float64)

    def noise(self, increments: NDArray[np.int64]) -> Floats:
        """(N, c, c) expected products of the sensors' noise in the columns, offset and impulse included, summed over
        increments.

        A few increments stand for their neighbours, in which the arm has nearly the same posture. The momentum at both
        ends is linear in the rates, so that its columns at a unit rate are its derivatives. The noise of angles is of
        second order here, and integrals average it out. The noise of a torque has a part only where its gain is
        estimated: the impulse is then a column itself.
        """
        arm, every = self.motion.arm, increments[:: max(1, len(increments) // _NOISE_SAMPLES)]
        sigma = np.sqrt(variances(arm).link)
        p, own = self.z.shape[-1], len(arm.parameter_names)
        out = np.zeros((arm.n, p + 2, p + 2))
        q = self.motion.smoothed.q[np.concatenate([self.rows.begin[every], self.rows.end[every]])]
        # the rates of all joints at once: single calls take long for a few increments
        each = np.broadcast_to((sigma * np.eye(arm.n))[:, None], (arm.n, *q.shape))
        slope = momentum_of_rates(arm, np.broadcast_to(q, each.shape), each).reshape(-1, arm.n, own)
        out[:, :own, :own] = np.einsum("mjp,mjq->jpq", slope, slope, optimize=True)
        out *= len(increments) / max(len(every), 1)
        for joint, column in self.gains:
            own = len(increments) * self._impulse_noise[joint] ** 2
            out[joint, column, column] += own
            out[joint, column, -1] -= own
            out[joint, -1, column] -= own
        return out


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
    rows = joint_rows(arm, motion.samples, motion.smoothed, span_s, moving, motion.columns)
    state = State.smoothed(arm, motion.smoothed)
    p = len(arm.parameter_names)
    z = [rows.z[..., :p]]
    place = 0
    for effect in effects:
        if effect.kind.on_ground:
            z.append(_sensed(arm, motion, rows, state, effect, predicted)[..., None])
        else:
            of_means = _of_means(arm, motion, rows, state, effect) if arm.torque_averaged else None
            z.append((rows.z[..., p + place] if of_means is None else of_means)[..., None])
            place += 1
    steps = rows.end[0] - rows.begin[0] if rows.count else 0
    return RunRows(
        motion=motion,
        rows=rows,
        z=np.concatenate(z, axis=-1),
        w=rows.w,
        offset=arm.gear_ratios * float(steps) * arm.period_s,
        span_s=float(steps) * arm.period_s,
        lingers=_lingers(arm, motion, state, rows, effects),
        gains=tuple((one.index(arm), p + k) for k, one in enumerate(effects) if one.kind.gain),
    )


def _lingers(arm: Arm, motion: Motion, state: State, rows: JointRows, effects: Sequence[Effect]) -> NDArray[np.bool_]:
    share = np.maximum(
        resting_share(arm, state, rows), _share(rows, at_rest(state.qd, motion.smoothed.segment, arm.period_s))
    )
    signed = {effect.index(arm) for effect in effects if effect.kind.key in _SIGNED}
    return np.asarray((share > limits.LINGERING.value) & [j in signed for j in range(arm.n)], dtype=np.bool_)


def resting_share(arm: Arm, state: State, rows: JointRows) -> Floats:
    """(m, N) share of each increment in which the rate of a joint does not show its sign."""
    slow = np.maximum(limits.SLOW_Z.value * np.sqrt(variances(arm).link), SLOWEST_RATE)
    return _share(rows, np.abs(state.qd) < slow)


def _share(rows: JointRows, of: NDArray[np.bool_]) -> Floats:
    """(m, N) share of each increment that consists of some instants."""
    total = np.vstack([np.zeros(of.shape[1]), np.cumsum(of, axis=0)])
    return np.asarray((total[rows.end] - total[rows.begin]) / np.maximum(rows.end - rows.begin, 1)[:, None])


def _of_means(arm: Arm, motion: Motion, rows: JointRows, state: State, effect: Effect) -> Floats | None:
    """(m, N) the column of friction whose torque is the mean over the period about each instant: a reversal is
    somewhere in its period, and the rate is linear between the instants. None for other effects."""
    joint, law = effect.index(arm), effect.kind.torque
    if law is None or effect.kind.place not in ("motor", "link"):
        return None
    rate, segment = state.qd[:, joint], motion.smoothed.segment

    def neighbours(x: Floats) -> tuple[Floats, Floats]:
        before = np.where(np.roll(segment, 1) == segment, np.roll(x, 1), x)
        return before, np.where(np.roll(segment, -1) == segment, np.roll(x, -1), x)

    last, after = neighbours(rate)
    share = (np.arange(_WITHIN) + 0.5) / _WITHIN * 0.5  # of the way to the neighbours' instants
    mean = np.zeros_like(rate)
    for part in share.tolist():
        mean += law(rate + part * (last - rate)) + law(rate + part * (after - rate))
    mean /= 2 * _WITHIN
    before, behind = neighbours(mean)
    total = np.cumsum(0.5 * (before + mean)) * arm.period_s + arm.impulse_s * 0.5 * (behind - before)
    column = np.zeros_like(rows.w)
    ratio = float(arm.gear_ratios[joint]) if effect.kind.place == "motor" else 1.0
    column[:, joint] = ratio * (total[rows.end] - total[rows.begin])
    return column


def _sensed(
    arm: Arm, motion: Motion, rows: JointRows, state: State, effect: Effect, predicted: Floats | None
) -> Floats:
    """(m, N) column of an effect that needs a torque: friction with the load, or the gain of a torque sensor."""
    column, joint = np.zeros_like(rows.w), effect.index(arm)
    if effect.kind.gain:
        column[:, joint] = -rows.w[:, joint]
    elif predicted is not None:
        torque = effect.law(
            JointMotion(rate=state.qd[:, joint], angle=state.q[:, joint], load=predicted[:, joint]), arm.period_s
        )
        total = np.concatenate([[0.0], np.cumsum(torque)]) * arm.period_s
        column[:, joint] = total[rows.end] - total[rows.begin]
    return column


def torque_columns(
    arm: Arm, rows: TorqueRows, effects: Sequence[Effect], predicted: Floats | None = None, filtered: bool = True
) -> Floats:
    """(m, N, p) columns of the torque after the gear at each instant, in the order of `columns_of`.

    predicted: (m, N) torque that a model without friction in proportion to the load predicts, Nm. filtered: whether the
    torques of the effects, which jump where a rate changes its sign, pass the filter as well.
    """
    extra = []
    for effect in effects:
        joint, column = effect.index(arm), np.zeros_like(rows.tau)
        law = _law(arm, rows, effect, joint, predicted)
        column[:, joint] = rows.filtered(law) if filtered else law
        extra.append(column)
    return np.concatenate([rows.z, np.stack(extra, axis=-1)], axis=-1) if extra else rows.z


def _law(arm: Arm, rows: TorqueRows, effect: Effect, joint: int, predicted: Floats | None) -> Floats:
    kind, rate, ratio = effect.kind, rows.state.qd[:, joint], float(arm.gear_ratios[joint])
    if kind.gain:
        return -rows.tau[:, joint]
    if kind.place == "load" and predicted is None:
        return np.zeros_like(rate)
    if kind.lags:
        after = np.gradient(rows.tau[:, joint], rows.period_s)
        return np.asarray(after, dtype=np.float64)
    none = np.zeros_like(rate)
    own = effect.law(
        JointMotion(
            rate=rate,
            angle=rows.state.q[:, joint],
            deflection=none,
            slip=none,
            applied=rows.tau[:, joint] / ratio,
            load=none if predicted is None else predicted[:, joint],
            time=np.asarray(np.arange(len(rate)) * rows.period_s, dtype=np.float64),
            ratio=ratio,
        ),
        rows.period_s,
    )
    factor = {"motor": ratio, "torque": -ratio}.get(kind.place, 1.0)
    return np.asarray(own * factor, dtype=np.float64)


def friction(arm: Arm, kinds: Sequence[Kind]) -> tuple[Effect, ...]:
    """An effect of each kind at each joint."""
    return tuple(Effect(kind, joint.name, 0.0) for kind in kinds for joint in arm.joints)


def column_at(names: Sequence[str], kind: Kind, joint: int) -> int:
    """Place of the column of a kind at a joint (from 0). Errors: ValueError where there is none."""
    return list(names).index(EffectColumn(kind.key, joint).name)

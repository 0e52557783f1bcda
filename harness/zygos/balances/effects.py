"""Columns of the catalogue's effects in the balances of energy and of motor impulse (docs/theory.md, "Effects").

A balance is linear in the coefficients of effects; the column of an effect is what a unit of its coefficient adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.quadrature import FromOrigin
from zygos.balances.state import State
from zygos.effects import Effect, Kind, estimated
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Signals:
    """What the columns of a joint's effects are made of, at m instants with any leading axes."""

    deflection: Floats
    """(..., m) theta - q, rad."""
    link_rate: Floats
    """(..., m) rad/s."""
    motor_angle: Floats
    """(..., m) after the gear, rad."""
    motor_rate: Floats
    """(..., m) after the gear, rad/s."""
    before: Floats
    """(..., m) rotor torque of the cycle before the instant, Nm."""
    after: Floats
    """(..., m) rotor torque from the instant on, Nm."""
    gear_ratio: float
    totals: FromOrigin

    @classmethod
    def of(cls, arm: Arm, state: State, before: Floats, after: Floats, joint: int, totals: FromOrigin) -> Signals:
        """Of a joint (from 0); states and torques (..., m, N)."""
        return cls(
            state.theta[..., joint] - state.q[..., joint],
            state.qd[..., joint],
            state.theta[..., joint],
            state.thetad[..., joint],
            before[..., joint],
            after[..., joint],
            float(arm.gear_ratios[joint]),
            totals,
        )


def energy_column(kind: Kind, signals: Signals) -> Floats:
    """Column (..., m) in the energy balance, J per unit: what the effect stored or took away since the arc's origin."""
    s = signals
    if kind.place == "torque":
        step = s.gear_ratio * (s.after - s.before) * s.motor_rate
        # a motor that is late by T misses step T of each torque step; of the one at the instant half of it shows
        return s.totals.sum_before(step) + 0.5 * step
    assert kind.torque is not None
    if kind.place == "spring":
        if kind.potential is not None:
            return kind.potential(s.deflection)
        return s.totals.integral(kind.torque(s.deflection) * (s.motor_rate - s.link_rate))
    rate, factor = (s.motor_rate, s.gear_ratio) if kind.place == "motor" else (s.link_rate, 1.0)
    return s.totals.integral(factor * kind.torque(rate) * rate)


def impulse_column(kind: Kind, signals: Signals) -> Floats:
    """Column (..., m) in the balance of the motor's impulse, before the gear, Nms per unit, up to a constant in each
    arc; 0 of what acts on the link alone."""
    s = signals
    if kind.impulse is not None:
        return kind.impulse(s.motor_angle)
    if kind.place == "torque":
        return np.asarray(0.5 * (s.before + s.after), dtype=np.float64)
    assert kind.torque is not None
    if kind.place == "spring":
        return s.totals.integral(kind.torque(s.deflection)) / s.gear_ratio
    if kind.place == "motor":
        return s.totals.integral(kind.torque(s.motor_rate))
    return np.zeros_like(s.link_rate)


def joint_column(kind: Kind, signals: Signals, flexible: bool) -> Floats:
    """Column (..., m) in the row of the joint, Nms per unit, up to a constant in each arc.

    The motor of a flexible joint does not act on the link.
    """
    s = signals
    if kind.place == "spring":
        assert kind.torque is not None
        return -s.totals.integral(kind.torque(s.deflection))
    if kind.place == "link":
        assert kind.torque is not None
        return s.totals.integral(kind.torque(s.link_rate))
    return np.zeros_like(s.link_rate) if flexible else s.gear_ratio * impulse_column(kind, s)


def effect_columns(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], effects: Sequence[Effect]
) -> Floats:
    """Columns (m, E) of the E effects that `estimated` names at the m smoothed instants, in J per unit of each.

    arc: (m,) number of the arc that an instant belongs to, -1 for none. Integrals and sums begin with their arc; what
    stands where there is no arc means nothing. Errors: as `estimated`, and ZygosError for an effect at no joint.
    """
    state, totals = State.smoothed(arm, smoothed), FromOrigin(arm.period_s, arc)
    before, after = samples.tau[smoothed.index - 1], samples.tau[smoothed.index]
    columns = [
        energy_column(effect.kind, Signals.of(arm, state, before, after, effect.index(arm), totals))
        for effect in estimated(arm, effects)
    ]
    return np.stack(columns, axis=1) if columns else np.zeros((len(arc), 0))

"""Columns of the catalogue's effects in the energy balance, over whole records (docs/theory.md, "Effects")."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.quadrature import integral, since_origin
from zygos.effects import Effect, estimated
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]


def effect_columns(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], effects: Sequence[Effect]
) -> Floats:
    """Columns (m, E) of the E effects that `estimated` names at the m smoothed instants, in J per unit of each.

    arc: (m,) number of the arc that an instant belongs to, -1 for none. Integrals and sums begin with their arc; what
    stands where there is no arc means nothing. Errors: as `estimated`, and ZygosError for an effect at no joint.
    """
    columns = [_column(arm, samples, smoothed, arc, effect) for effect in estimated(arm, effects)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(arc), 0))


def _column(arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], effect: Effect) -> Floats:
    kind, i = effect.kind, effect.index(arm)
    ratio, motor_rate, link_rate = arm.joints[i].gear_ratio, smoothed.thetad[:, i], smoothed.qd[:, i]
    if kind.potential is not None:
        return kind.potential(smoothed.theta[:, i] - smoothed.q[:, i])
    if kind.place == "torque":
        tau, at = samples.tau[:, i], smoothed.index
        step = ratio * (tau[at] - tau[at - 1]) * motor_rate
        # a motor that is late by T misses step T of each torque step; of the one at the instant half of it shows
        return since_origin(np.cumsum(step) - step, arc) + 0.5 * step
    assert kind.torque is not None
    rate, factor = (motor_rate, ratio) if kind.place == "motor" else (link_rate, 1.0)
    power = factor * kind.torque(rate) * rate
    return since_origin(integral(power, arm.period_s), arc)

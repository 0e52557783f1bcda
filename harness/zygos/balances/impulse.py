# SPDX-License-Identifier: MIT
"""Rows of the motors' impulse over whole records (docs/theory.md, "Motor impulse").

Within an arc, z_k . pi - w_k is an unknown constant for each flexible joint: z_k holds n^2 thetad + n (rate of the
carrying body about the axis), int d, d and the effects at the joint, with d = theta - q, w_k is n int tau.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.effects import Signals, impulse_column, motor_impulse
from zygos.balances.energy import DriveColumns
from zygos.balances.kinematics import body_columns
from zygos.balances.quadrature import FromOrigin
from zygos.balances.state import State
from zygos.effects import Effect, estimated
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed, coefficients

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ImpulseRows:
    """Rows of one joint at m smoothed instants, c columns; what stands where there is no arc means nothing."""

    joint: int
    """From 0."""
    names: tuple[str, ...]
    """(c,) of the parameters: Im, k, b, then the effects at the joint that act on its rotor."""
    z: Floats
    """(m, c)"""
    w: Floats
    """(m,) impulse of the motor since the arc's origin, after the gear, raised by what a torque step adds to the rate
    that is read [Nms]."""


def joint_effects(arm: Arm, joint: int, effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """The effects with a column in the row of a joint (from 0), in their order. Errors: as `estimated`."""
    return tuple(
        effect for effect in estimated(arm, effects) if effect.index(arm) == joint and effect.kind.place != "link"
    )


def impulse_names(arm: Arm, joint: int, effects: Sequence[Effect] = ()) -> tuple[str, ...]:
    """Names of the columns in the row of a joint (from 0). Errors: as `estimated`."""
    acting = joint_effects(arm, joint, effects)
    return (*(f"{kind}{joint + 1}" for kind in ("Im", "k", "b")), *(effect.column(arm) for effect in acting))


def impulse_rows(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], effects: Sequence[Effect] = ()
) -> tuple[ImpulseRows, ...]:
    """Rows of every flexible joint. arc: (m,) number of the arc of each instant, -1 for none.

    The smoothed rate is h/12 times the jump of the acceleration above the true one where a held torque steps (as in
    the energy balance), and Im n^2 times that jump is n (tau_k - tau_k-1). Errors: as `estimated`.
    """
    state, totals = State.smoothed(arm, smoothed), FromOrigin(arm.period_s, arc)
    carried = body_columns(arm, state)[1]
    before, after = samples.tau[smoothed.index - 1], samples.tau[smoothed.index]
    out = []
    for i, joint in enumerate(arm.joints):
        if not joint.flexible:
            continue
        signals = Signals.of(arm, state, before, after, i, totals)
        own = drive_impulse_columns(signals, carried[:, i])
        columns = [own.rotor + own.coupling, own.spring, own.damper]
        columns += [impulse_column(effect.kind, signals, effect.shape) for effect in joint_effects(arm, i, effects)]
        z, w = np.stack(columns, axis=1), motor_impulse(signals)
        out.append(ImpulseRows(i, impulse_names(arm, i, effects), signals.gear_ratio * z, signals.gear_ratio * w))
    return tuple(out)


def drive_impulse_columns(signals: Signals, carried: Floats) -> DriveColumns:
    """Columns of rotor, spring and damper, before the gear.

    carried: (..., m) rate of the carrying body about the joint's axis [rad/s].
    """
    s = signals
    spring = s.totals.integral(s.deflection) / s.gear_ratio
    return DriveColumns(s.gear_ratio * s.motor_rate, carried, spring, s.deflection / s.gear_ratio)


def impulse_noise(arm: Arm, joint: int, effects: Sequence[Effect] = ()) -> Floats:
    """What the noise of the samples adds to z' z of one row of a flexible joint on average, (c, c).

    The declared noise of encoders and gyro, over the wire, passes through the smoother. Integrals average it
    out: they have none here. The carrying body's rate is taken as if all axes were parallel. Errors: as `estimated`.
    """
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s
    own, n = arm.joints[joint], float(arm.gear_ratios[joint])
    acting = joint_effects(arm, joint, effects)

    def weights(latch_us: float, derivative: int) -> Floats:
        return coefficients(points, order, -1e-6 * latch_us / h, derivative) / h**derivative

    def column(*places: tuple[int, float, Floats]) -> Floats:
        """(c, points) share of each sample in each column."""
        share = np.zeros((3 + len(acting), points))
        for place, factor, weight in places:
            share[place] += factor * weight
        return share

    late = own.latch_us + own.motor_encoder.latch_us
    angle = weights(late, 0)
    viscous = [(3 + c, n, angle) for c, effect in enumerate(acting) if effect.kind.impulse is not None]
    shares = [
        (own.motor_encoder.over_the_wire.sigma_rad, column((0, n**2, weights(late, 1)), (2, 1.0, angle), *viscous)),
        (
            own.link_encoder.over_the_wire.sigma_rad,
            column((2, -1.0, weights(own.latch_us + own.link_encoder.latch_us, 0))),
        ),
    ]
    for before in arm.joints[:joint]:
        link = before.link_encoder  # of a rigid joint the motor's
        shares.append((link.over_the_wire.sigma_rad, column((0, n, weights(before.latch_us + link.latch_us, 1)))))
    if arm.free:
        shares.append((arm.imu.over_the_wire.rate_sigma, column((0, n, weights(arm.imu.latch_us, 0)))))
    total: Floats = np.sum([sigma**2 * share @ share.T for sigma, share in shares], axis=0)
    return total

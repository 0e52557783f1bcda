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
from zygos.balances.kinematics import State, body_columns
from zygos.balances.quadrature import integral, since_origin
from zygos.effects import Effect, estimated
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed, coefficients

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Impulse:
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


def joint_names(arm: Arm, joint: int, effects: Sequence[Effect] = ()) -> tuple[str, ...]:
    """Names of the columns in the row of a joint (from 0). Errors: as `estimated`."""
    acting = joint_effects(arm, joint, effects)
    return (*(f"{kind}{joint + 1}" for kind in ("Im", "k", "b")), *(effect.column(arm) for effect in acting))


def rows(
    arm: Arm, samples: Samples, smoothed: Smoothed, arc: NDArray[np.int64], effects: Sequence[Effect] = ()
) -> tuple[Impulse, ...]:
    """Rows of every flexible joint. arc: (m,) number of the arc of each instant, -1 for none.

    The smoothed rate is h/12 times the jump of the acceleration above the true one where a held torque steps (as in
    the energy balance), and Im n^2 times that jump is n (tau_k - tau_k-1). Errors: as `estimated`.
    """
    h = arm.period_s
    base = smoothed.omega if arm.spatial else smoothed.omega @ arm.axis
    carried = body_columns(arm, State(smoothed.q, smoothed.theta, smoothed.qd, smoothed.thetad, base))[1]
    held = 0.0 if arm.torque_law == "sampled" else h / 12.0

    def of_arc(g: Floats) -> Floats:
        return since_origin(integral(g, h), arc)

    out = []
    for i, joint in enumerate(arm.joints):
        if not joint.flexible:
            continue
        n, theta, thetad = joint.gear_ratio, smoothed.theta[:, i], smoothed.thetad[:, i]
        deflection = theta - smoothed.q[:, i]
        before, after = samples.tau[smoothed.index - 1, i], samples.tau[smoothed.index, i]
        columns = [n**2 * thetad + n * carried[:, i], of_arc(deflection), deflection]
        acting = joint_effects(arm, i, effects)
        for effect in acting:
            if effect.kind.place == "torque":
                columns.append(0.5 * n * (before + after))
            elif effect.kind.key == "motor_viscous":
                columns.append(n * theta)  # the integral of the rate
            else:
                assert effect.kind.torque is not None
                spring = effect.kind.place == "spring"
                torque = effect.kind.torque(deflection if spring else thetad)
                columns.append(of_arc(torque if spring else n * torque))
        names = joint_names(arm, i, effects)
        w = n * (h * since_origin(np.cumsum(before), arc) + held * (after - before))
        out.append(Impulse(i, names, np.stack(columns, axis=1), w))
    return tuple(out)


def noise(arm: Arm, joint: int, effects: Sequence[Effect] = ()) -> Floats:
    """What the noise of the samples adds to z' z of one row of a flexible joint on average, (c, c).

    The declared noise of encoders and gyro, over the wire, passes through the smoother. Integrals average it
    out: they have none here. The carrying body's rate is taken as if all axes were parallel. Errors: as `estimated`.
    """
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s
    own, n = arm.joints[joint], arm.joints[joint].gear_ratio
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
    viscous = [(3 + c, n, angle) for c, effect in enumerate(acting) if effect.kind.key == "motor_viscous"]
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

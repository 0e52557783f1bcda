# SPDX-License-Identifier: MIT
"""The two encoders of a joint: skew in time, zero, and the stiffness that their difference implies."""

from __future__ import annotations

import math
from dataclasses import replace

from zygos.arm import Arm, Encoder
from zygos.audit.delays import Group, shifted
from zygos.audit.findings import Pair
from zygos.audit.means import Array, Means, jackknifed, smooth_direction
from zygos.runs.cycles import Cycles


def pair(means: Means, joint: int, stiff: bool) -> Pair:
    """Skew, zero and apparent stiffness of a joint's two encoders.

    theta - q = s/k - (b/k)(thetad - qd) + skew * qd + zero, with s the torque in the spring. For a stiff joint, s is
    the torque that accelerates the links, so that friction in the motor is not part of it; friction on the link side
    that grows with the rate is, and looks like a skew. For a soft joint, the links' motion is not a linear function of
    their accelerations, and s = n tau - Im n^2 thetadd.
    """
    m, ratio = means, float(means.arm.gear_ratios[joint])
    q, theta, (torque, torque_rate) = m.q[joint], m.theta[joint], (ratio * x for x in m.tau[joint])
    difference, slip = theta[0] - q[0], theta[1] - q[1]
    loads = [other[2] for other in m.q]
    # the torque may be early or late itself, and the rotor also reacts to the rotation of the body that carries it
    motor = [torque, torque_rate, theta[2], slip, smooth_direction(theta[1])]
    rest = loads if stiff else [*motor, *loads, *m.spin]
    value, sigma = jackknifed([m.one, q[1], *rest], difference)
    carried = [torque, theta[2]] if stiff else motor
    zero, zero_sigma = jackknifed([m.one, q[1], *carried], difference)

    def stiffness(columns: list[Array]) -> float:
        per, error = jackknifed(columns, difference)
        return 1.0 / float(per[-1]) if per[-1] > 3.0 * error[-1] else math.nan

    return Pair(
        joint=means.arm.joints[joint].name,
        skew_s=float(value[1]),
        skew_sigma_s=float(sigma[1]),
        zero_rad=float(zero[0]),
        zero_sigma_rad=float(zero_sigma[0]),
        stiffness=stiffness([m.one, *carried[1:], torque]),
        stiffness_unskewed=stiffness([m.one, q[1], *carried[1:], torque]),
        stiff=stiff,
    )


def unskewed(arm: Arm, cycles: Cycles, skews: dict[int, float]) -> tuple[Arm, Cycles]:
    """The arm with later latches for the newer encoders, and the run with newer readings of the older ones where the
    period has no room for the latch: skews in s by joint, as `Pair.skew_s`."""
    joints = list(arm.joints)
    for i, skew in skews.items():
        side = "motor_encoder" if skew > 0.0 else "link_encoder"
        encoder: Encoder = getattr(joints[i], side)
        if 1e-6 * (joints[i].latch_us + encoder.latch_us) + abs(skew) >= arm.period_s:
            cycles = shifted(cycles, Group("q" if skew > 0.0 else "theta", (i,)), abs(skew) / arm.period_s)
            continue
        late = replace(encoder, latch_us=encoder.latch_us + round(1e6 * abs(skew)))
        joints[i] = replace(joints[i], motor_encoder=late) if skew > 0.0 else replace(joints[i], link_encoder=late)
    return replace(arm, joints=tuple(joints)), cycles

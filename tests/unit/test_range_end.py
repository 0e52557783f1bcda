# SPDX-License-Identifier: MIT
"""A joint that works around the end of its encoders' range: one of its angles goes over it before the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_support import waits
from numpy.typing import NDArray

from zygos import reference
from zygos.arm import Arm
from zygos.native.flight import Flight, encode
from zygos.runs.cycles import Cycles
from zygos.runs.samples import HALF_RANGE_RAD
from zygos.simulation.plant import Trajectory

Floats = NDArray[np.float64]

TURN = 2.0 * np.pi
END = 8.0 * TURN


def mounted(arm: Arm, zero_rad: float, sign: int = 1) -> Arm:
    """The arm with both encoders of the shoulder reading that where its angle is 0."""
    joint = arm.joints[0]
    link = replace(joint.link_encoder, zero_rad=zero_rad, sign=sign)
    motor = replace(joint.motor_encoder, zero_rad=zero_rad, sign=sign)
    return replace(arm, joints=(replace(joint, link_encoder=link, motor_encoder=motor), *arm.joints[1:]))


def sent(arm: Arm, cycles: Cycles) -> Cycles:
    """What the encoders of `mounted` read of the plain arm's cycles. The wire wraps it."""
    link, motor = arm.joints[0].link_encoder, arm.joints[0].motor_encoder
    q, theta = cycles.q.copy(), cycles.theta.copy()
    q[:, 0] = link.sign * q[:, 0] + link.zero_rad
    theta[:, 0] = motor.sign * theta[:, 0] + motor.zero_rad
    return replace(cycles, q=q, theta=theta)


def wrapped(cycles: Cycles) -> Cycles:
    """The same readings as the wire has them."""
    return replace(cycles, q=(cycles.q + END) % (2.0 * END) - END, theta=(cycles.theta + END) % (2.0 * END) - END)


def apart(arm: Arm, cycles: Cycles) -> NDArray[np.bool_]:
    joint = arm.joints[0]
    q = joint.link_encoder.sign * (cycles.q[:, 0] - joint.link_encoder.zero_rad)
    theta = joint.motor_encoder.sign * (cycles.theta[:, 0] - joint.motor_encoder.zero_rad)
    out: NDArray[np.bool_] = np.abs(theta - q) > HALF_RANGE_RAD
    return out


@pytest.mark.parametrize("sign", [1, -1])
def test_no_deflection_of_sixteen_turns_enters_an_arc(arm: Arm, noisy: Trajectory, true: Floats, sign: int) -> None:
    """The shoulder goes over the end near where it turns back, so that both sides are seen for many cycles."""
    cycles = noisy.cycles(0)
    turning = float(np.quantile(cycles.q[:, 0], 0.97))
    other = mounted(arm, sign * (END - turning), sign)
    readings = sent(other, cycles)
    plain, far = Flight(arm), Flight(other)
    plain.frames(encode(arm, cycles))
    far.frames(encode(other, readings))
    both_sides = int(np.count_nonzero(apart(other, wrapped(readings))))
    print("cycles on both sides", both_sides, "counted", far.counts)
    assert far.counts["apart"] == both_sides >= 10
    assert far.counts["wraps"] >= 8
    assert plain.counts["apart"] == 0
    expected, found = plain.estimate(), far.estimate()
    assert (found.validity, found.reason) == (expected.validity, expected.reason) == ("valid", "")
    # arcs are short here, which costs some sharpness; the intervals still hold
    assert (np.abs(found.value - true) < 2.0 * found.half95).all()
    assert (found.sigma < 4.0 * expected.sigma).all()


def test_c_is_numpy_where_a_run_begins_on_both_sides(arm: Arm, noisy: Trajectory) -> None:
    """Also behind a lost cycle, where there is no cycle before to compare with."""
    cycles = noisy.cycles(1)
    other = mounted(arm, END - float(np.quantile(cycles.q[:, 0], 0.97)))
    readings = wrapped(sent(other, cycles))
    inside = np.flatnonzero(apart(other, readings))
    readings.sync[inside[len(inside) // 2] :] += 3
    flight = Flight(other)
    trace = flight.cycles(readings, trace=True)
    assert trace is not None
    chain = reference.chain(other, readings, waited=waits(readings, trace))
    assert flight.counts["wraps"] == chain.samples.wraps
    assert flight.counts["apart"] == len(inside)
    instants = np.flatnonzero(trace.instant)
    np.testing.assert_array_equal(instants - other.smoother.lag, chain.balance.index)
    rows = np.column_stack([chain.balance.z, chain.balance.w])
    assert np.max(np.abs(trace.row[instants] - rows) / np.abs(rows).max(axis=0)) <= 1e-10
    np.testing.assert_allclose(flight.estimate().value, chain.solution.x, rtol=1e-6)

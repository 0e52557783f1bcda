# SPDX-License-Identifier: MIT
"""From sensor readings to joint motion, for whole records (docs/theory.md, "What belongs to which instant").

Signs, zeros and the gyro's mounting are applied, the torque record is shifted to the interval in which it acted, and
the record is cut into segments: unbroken runs of usable cycles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.runs.cycles import BREAK_BEFORE, INVALID, VOID_BEFORE, VOID_SHIFT, Cycles

Floats = NDArray[np.float64]

TORQUE_WEIGHTS = {
    "applied_from_sync": (1.0, 0.0),
    "applied_previous_cycle": (0.0, 1.0),
    "sampled": (0.5, 0.5),
}
"""Weights of the torques reported in cycles k and k+1 in the torque that acts on [t_k, t_k+1)."""


HALF_RANGE_RAD = 16.0 * np.pi
"""Half the range of a multi-turn angle, 8 turns, in rad. A reading that jumps by more has passed the end of the range;
if link and motor angle differ by more, only one of them has passed it.
"""

LARGEST_ANGLE_RAD, LARGEST_VALUE = 1e4, 1e6
"""Larger readings (angles in rad; torques in Nm and rates in rad/s) are treated as a fault of the sensor."""


@dataclass(frozen=True)
class Segments:
    """A record cut into unbroken runs.

    ranges: half-open ranges of positions. voids: for each void cycle its position, and the number of the last cycle
    before it that can be trusted; None if this is unknown, and the arc that it ends is discarded. wraps: how often an
    angle passed the end of its range.
    """

    ranges: tuple[tuple[int, int], ...]
    voids: tuple[tuple[int, int | None], ...]
    wraps: int


@dataclass(frozen=True)
class Samples:
    """Calibrated record; n cycles, N joints. Unusable cycles stay in the arrays but belong to no segment.

    sync: (n,) cycle number. q, theta: (n, N) [rad]. tau: (n, N) rotor torque that acts on [t_k, t_k+1) [Nm], NaN where
    the torque law needs a cycle that the segment does not have. omega: (n, 3) base rate in base axes [rad/s].
    segments: half-open ranges of positions in these arrays. voids, wraps: as in `Segments`.
    left_out: by kind of rows, the last cycles of the arcs that the library left out of its sums, so that the reference
    leaves out the same arcs. waited: by kind of rows, positions in these arrays of the cycles with which an instant was
    complete that the library made no row of, because an arc waited for its end.
    """

    sync: NDArray[np.uint64]
    q: Floats
    theta: Floats
    tau: Floats
    omega: Floats
    segments: tuple[tuple[int, int], ...]
    voids: tuple[tuple[int, int | None], ...]
    wraps: int
    left_out: Mapping[str, frozenset[int]] = field(default_factory=dict)
    waited: Mapping[str, frozenset[int]] = field(default_factory=dict)


def usable(cycles: Cycles) -> NDArray[np.bool_]:
    """(n,) whether a cycle is usable: not flagged invalid, and with finite values of plausible size."""
    angles = np.hstack([cycles.q, cycles.theta])
    others = np.hstack([cycles.tau, cycles.omega])
    sane = np.all(np.abs(angles) <= LARGEST_ANGLE_RAD, axis=1) & np.all(np.abs(others) <= LARGEST_VALUE, axis=1)
    out: NDArray[np.bool_] = ((cycles.flags & INVALID) == 0) & sane
    return out


def segments(cycles: Cycles, apart: NDArray[np.bool_] | None = None) -> Segments:
    """Cut a record into runs of usable cycles whose numbers rise by one, without a break flag or a wrap of an angle.

    apart: (n,) cycles in which link and motor angle lie on different sides of the end of their range. They belong to no
    run.
    """
    n = len(cycles)
    out = np.zeros(n, dtype=np.bool_) if apart is None else apart
    use = usable(cycles)
    follows = np.zeros(n, dtype=np.bool_)
    follows[1:] = use[1:] & use[:-1] & (cycles.sync[1:] - cycles.sync[:-1] == 1)
    follows &= (cycles.flags & (BREAK_BEFORE | VOID_BEFORE)) == 0
    wraps = np.zeros(n, dtype=np.bool_)
    for reading in (cycles.q, cycles.theta):
        with np.errstate(invalid="ignore"):
            wraps[1:] |= np.any(np.abs(np.diff(reading, axis=0)) > HALF_RANGE_RAD, axis=1)
    wraps &= follows
    joined = follows & ~wraps & ~out
    joined[1:] &= ~out[:-1]
    starts = np.flatnonzero(use & ~out & ~joined)
    ends = np.flatnonzero(use & ~out & ~np.append(joined[1:], False)) + 1
    voids = []
    for at in np.flatnonzero(cycles.flags & VOID_BEFORE):
        doubtful = int(cycles.flags[at]) >> VOID_SHIFT
        voids.append((int(at), int(cycles.sync[at]) - doubtful if doubtful else None))
    return Segments(
        ranges=tuple((int(a), int(b)) for a, b in zip(starts, ends, strict=True)),
        voids=tuple(voids),
        wraps=int(np.sum(wraps)),
    )


def calibrate(arm: Arm, cycles: Cycles) -> Samples:
    """Apply the arm file to a record.

    angle = sign (reading - zero); base rate = R rate, R the attitude of the sensor's axes in the base (`mount_xyzw`);
    tau_k = alpha r_k + beta r_k+1 by the torque law. Raises ZygosError for a record of another number of joints.
    """
    joints = len(arm.joints)
    if cycles.q.shape[1] != joints:
        raise ZygosError(
            f"what is wrong: the record has {cycles.q.shape[1]} joints, arm '{arm.name}' has {joints}; "
            "remedy: give the arm file with which the record was made"
        )
    # the motor's encoder measures both angles of a rigid joint
    cycles = replace(cycles, q=np.where([joint.flexible for joint in arm.joints], cycles.q, cycles.theta))
    if not arm.free:
        cycles = replace(cycles, omega=np.zeros_like(cycles.omega))
    links = [joint.link_encoder for joint in arm.joints]
    motors = [joint.motor_encoder for joint in arm.joints]
    q = np.array([e.sign for e in links]) * (cycles.q - np.array([e.zero_rad for e in links]))
    theta = np.array([e.sign for e in motors]) * (cycles.theta - np.array([e.zero_rad for e in motors]))
    runs = segments(cycles, np.any(np.abs(theta - q) > HALF_RANGE_RAD, axis=1))
    alpha, beta = TORQUE_WEIGHTS[arm.torque_law]
    tau = np.full(cycles.tau.shape, np.nan)
    for start, stop in runs.ranges:
        reported = cycles.tau[start:stop]
        if beta == 0.0:
            tau[start:stop] = reported
        else:
            tau[start : stop - 1] = alpha * reported[:-1] + beta * reported[1:]
    return Samples(
        sync=cycles.sync,
        q=q,
        theta=theta,
        tau=tau,
        omega=cycles.omega @ arm.mount.T,
        segments=runs.ranges,
        voids=runs.voids,
        wraps=runs.wraps,
    )

"""From what the sensors say to what the joints do, over whole records (docs/interfaces, `arm.toml`).

Signs, zeros and the gyro's mounting are applied, the torque record is shifted to the interval it was in force, and the
record is cut into segments: unbroken runs of valid cycles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.cycles import BREAK_BEFORE, INVALID, Cycles
from zygos.errors import ZygosError

Floats = NDArray[np.float64]

TORQUE_WEIGHTS = {
    "applied_from_sync": (1.0, 0.0),
    "applied_previous_cycle": (0.0, 1.0),
    "sampled": (0.5, 0.5),
}
"""Weights of the torques reported in cycles k and k+1 in the torque in force on [t_k, t_k+1)."""


@dataclass(frozen=True)
class Samples:
    """Calibrated record; n cycles, N joints. Invalid cycles stay in the arrays and lie in no segment.

    sync: (n,) cycle number. q, theta: (n, N) [rad]. tau: (n, N) rotor torque in force on [t_k, t_k+1) [Nm], NaN where
    the torque law needs a cycle that the segment does not have. omega: (n, 3) base rate in base axes [rad/s].
    segments: half-open ranges of positions in these arrays.
    """

    sync: NDArray[np.uint64]
    q: Floats
    theta: Floats
    tau: Floats
    omega: Floats
    segments: tuple[tuple[int, int], ...]


def segments(sync: NDArray[np.uint64], flags: NDArray[np.uint32]) -> tuple[tuple[int, int], ...]:
    """Half-open ranges of unbroken runs: cycle numbers rise by one, no break flag within, no invalid cycle."""
    n = len(sync)
    valid = (flags & INVALID) == 0
    joined = np.zeros(n, dtype=np.bool_)
    joined[1:] = (sync[1:] - sync[:-1] == 1) & valid[1:] & valid[:-1] & ((flags[1:] & BREAK_BEFORE) == 0)
    starts = np.flatnonzero(valid & ~joined)
    ends = np.flatnonzero(valid & ~np.append(joined[1:], False)) + 1
    return tuple((int(a), int(b)) for a, b in zip(starts, ends, strict=True))


def calibrate(arm: Arm, cycles: Cycles) -> Samples:
    """Apply the arm file to a record.

    angle = sign (reading - zero); base rate = R rate, R the attitude of the sensor's axes in the base (`mount_xyzw`);
    tau_k = alpha r_k + beta r_k+1 by the torque law. Raises ZygosError for a record of another number of joints.
    """
    joints = len(arm.joints)
    if cycles.q.shape[1] != joints:
        raise ZygosError(
            f"what is wrong: the record has {cycles.q.shape[1]} joints, arm '{arm.name}' has {joints}; "
            "remedy: give the arm file the record was made with"
        )
    links = [joint.link_encoder for joint in arm.joints]
    motors = [joint.motor_encoder for joint in arm.joints]
    q = np.array([e.sign for e in links]) * (cycles.q - np.array([e.zero_rad for e in links]))
    theta = np.array([e.sign for e in motors]) * (cycles.theta - np.array([e.zero_rad for e in motors]))
    runs = segments(cycles.sync, cycles.flags)
    alpha, beta = TORQUE_WEIGHTS[arm.torque_law]
    tau = np.full(cycles.tau.shape, np.nan)
    for start, stop in runs:
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
        segments=runs,
    )

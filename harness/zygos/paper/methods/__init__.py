# SPDX-License-Identifier: MIT
"""The three methods of Nanos & Papadopoulos, over whole records in batch.

Each module has estimate(arm, record, ...) -> (B, p) array in `arm.parameter_names` order, NaN where the method cannot
determine a parameter: `eb` energy balance, `amc` angular momentum conservation, `de` differential equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.state import State
from zygos.errors import ZygosError
from zygos.runs.samples import Samples
from zygos.simulation.plant import Trajectory

__all__ = ["Record", "by_backward_difference", "exact_record", "noisy_states", "record_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """Calibrated samples of B seeds, n instants, N joints, from a known start.

    q, theta: (B, n, N) [rad]. tau: (B, n, N) rotor torque that acts on [t_k, t_k+1) [Nm]; the last one is not used.
    f0: (B, n) base rate about the common axis [rad/s].
    qd, thetad: (B, n, N) exact rates [rad/s], or None. slip2: (B, n, N) exact integral of (thetad - qd)^2 from the
    first instant on [rad^2/s], or None. qdd, thetadd: (B, n, N) accelerations just after each instant [rad/s^2], f0d:
    (B, n) that of the base, or None. Exact data allow a method to be tested without its rate estimate.
    """

    q: Floats
    theta: Floats
    tau: Floats
    f0: Floats
    qd: Floats | None = None
    thetad: Floats | None = None
    slip2: Floats | None = None
    qdd: Floats | None = None
    thetadd: Floats | None = None
    f0d: Floats | None = None

    def __post_init__(self) -> None:
        """Raises ZygosError if the shapes are inconsistent."""
        shape = self.q.shape
        given = (self.qd, self.thetad, self.slip2, self.qdd, self.thetadd)
        joints = [self.theta, self.tau, *(x for x in given if x is not None)]
        base = [self.f0, *([] if self.f0d is None else [self.f0d])]
        if len(shape) != 3 or any(x.shape != shape for x in joints) or any(x.shape != shape[:2] for x in base):
            raise ZygosError(
                "what is wrong: the arrays of a record differ in shape; remedy: (B, n, N) for joints, (B, n) for f0"
            )


def record_of(arm: Arm, *samples: Samples) -> Record:
    """The first segments of calibrated records of equal length, one seed each.

    Raises ZygosError if a record has no segment, or the first segments differ in length: the batch methods need
    unbroken records.
    """
    if not samples or any(not record.segments for record in samples):
        raise ZygosError("what is wrong: a record has no valid cycle; remedy: check the log with `zygos self-test`")
    runs = [(record, slice(*record.segments[0])) for record in samples]
    if len({run.stop - run.start for _, run in runs}) > 1:
        raise ZygosError("what is wrong: the records differ in length; remedy: give each to the method separately")
    return Record(
        q=np.stack([record.q[run] for record, run in runs]),
        theta=np.stack([record.theta[run] for record, run in runs]),
        tau=np.stack([record.tau[run] for record, run in runs]),
        f0=np.stack([record.omega[run] @ arm.axis for record, run in runs]),
    )


def exact_record(trajectory: Trajectory) -> Record:
    """A simulation as read by perfect sensors, with its exact rates, accelerations and dissipation."""
    f0d, qdd, thetadd = trajectory.accelerations()
    return Record(
        q=trajectory.q,
        theta=trajectory.theta,
        tau=trajectory.tau,
        f0=trajectory.omega0,
        qd=trajectory.qd,
        thetad=trajectory.thetad,
        slip2=trajectory.slip2,
        qdd=qdd,
        thetadd=thetadd,
        f0d=f0d,
    )


def noisy_states(arm: Arm, exact: Record, seeds: Sequence[int]) -> Record:
    """Exact states with white noise of the paper's variances (32) added to each, one run for each seed.

    exact: one run of `exact_record`. Angles get the encoders' variance s^2, rates 2 s^2 / T^2, accelerations
    4 s^2 / T^4, all independent of one another, which differences of angles cannot be; the gyro gets its white noise,
    and its derivative that of a backward difference. The dissipation is that of the noisy rates. Raises ZygosError if
    the record is not exact.
    """
    if exact.qd is None or exact.thetad is None or exact.qdd is None or exact.thetadd is None or exact.f0d is None:
        raise ZygosError("what is wrong: the record has no exact rates; remedy: use a simulated record")
    h, gyro = arm.period_s, arm.imu.rate_sigma
    link = np.array([joint.link_encoder.sigma_rad for joint in arm.joints])
    motor = np.array([joint.motor_encoder.sigma_rad for joint in arm.joints])
    runs: list[list[Floats]] = []
    for seed in seeds:
        rng = np.random.default_rng(seed)

        def noisy(x: Floats, sigma: Floats | float, rng: np.random.Generator = rng) -> Floats:
            return np.asarray(x[0] + sigma * rng.standard_normal(x.shape[1:]), dtype=np.float64)

        qd, thetad = noisy(exact.qd, np.sqrt(2.0) * link / h), noisy(exact.thetad, np.sqrt(2.0) * motor / h)
        runs.append(
            [
                noisy(exact.q, link),
                noisy(exact.theta, motor),
                exact.tau[0],
                noisy(exact.f0, gyro),
                qd,
                thetad,
                np.cumsum(h * (thetad - qd) ** 2, axis=0),
                noisy(exact.qdd, 2.0 * link / h**2),
                noisy(exact.thetadd, 2.0 * motor / h**2),
                noisy(exact.f0d, np.sqrt(2.0) * gyro / h),
            ]
        )
    return Record(*(np.stack(column) for column in zip(*runs, strict=True)))


def by_backward_difference(arm: Arm, record: Record) -> State:
    """States at all instants but the first, (B, n-1, N), rates by backward difference as in the paper."""
    qd = np.diff(record.q, axis=1) / arm.period_s
    thetad = np.diff(record.theta, axis=1) / arm.period_s
    return State(record.q[:, 1:], record.theta[:, 1:], qd, thetad, record.f0[:, 1:])

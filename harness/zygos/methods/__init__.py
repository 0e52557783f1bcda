"""The three methods of Nanos & Papadopoulos, over whole records in batch.

Each module has estimate(arm, record, ...) -> (B, p) array in `arm.parameter_names` order, NaN where the method cannot
see a parameter: `eb` energy balance, `amc` angular momentum conservation, `de` differential equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.plant import Trajectory
from zygos.reference.cycle import Samples
from zygos.reference.kinematics import State

__all__ = ["Record", "by_backward_difference", "exact_record", "record_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """Calibrated samples of B seeds, n instants, N joints, from a known start.

    q, theta: (B, n, N) [rad]. tau: (B, n, N) rotor torque in force on [t_k, t_k+1) [Nm]; the last one is not used.
    f0: (B, n) base rate about the common axis [rad/s].
    qd, thetad: (B, n, N) exact rates [rad/s], or None. slip2: (B, n, N) exact integral of (thetad - qd)^2 from the
    first instant on [rad^2/s], or None. Exact data let a method be tried without its rate estimate.
    """

    q: Floats
    theta: Floats
    tau: Floats
    f0: Floats
    qd: Floats | None = None
    thetad: Floats | None = None
    slip2: Floats | None = None

    def __post_init__(self) -> None:
        """Raises ZygosError where the shapes do not belong together."""
        shape = self.q.shape
        joints = [self.theta, self.tau, *(x for x in (self.qd, self.thetad, self.slip2) if x is not None)]
        if len(shape) != 3 or any(x.shape != shape for x in joints) or self.f0.shape != shape[:2]:
            raise ZygosError(
                "what is wrong: the arrays of a record differ in shape; remedy: (B, n, N) for joints, (B, n) for f0"
            )


def record_of(arm: Arm, *samples: Samples) -> Record:
    """The first segments of calibrated records of equal length, one seed each.

    Raises ZygosError where a record has no segment, or the first segments differ in length: the batch methods need
    unbroken records.
    """
    if not samples or any(not record.segments for record in samples):
        raise ZygosError("what is wrong: a record has no valid cycle; remedy: check the log with `zygos check`")
    runs = [(record, slice(*record.segments[0])) for record in samples]
    if len({run.stop - run.start for _, run in runs}) > 1:
        raise ZygosError("what is wrong: the records differ in length; remedy: give each to the method by itself")
    return Record(
        q=np.stack([record.q[run] for record, run in runs]),
        theta=np.stack([record.theta[run] for record, run in runs]),
        tau=np.stack([record.tau[run] for record, run in runs]),
        f0=np.stack([record.omega[run] @ arm.axis for record, run in runs]),
    )


def exact_record(trajectory: Trajectory) -> Record:
    """A simulation as perfect sensors would see it, with its exact rates and dissipation."""
    return Record(
        q=trajectory.q,
        theta=trajectory.theta,
        tau=trajectory.tau,
        f0=trajectory.omega0,
        qd=trajectory.qd,
        thetad=trajectory.thetad,
        slip2=trajectory.slip2,
    )


def by_backward_difference(arm: Arm, record: Record) -> State:
    """States at all instants but the first, (B, n-1, N), rates by backward difference as in the paper."""
    qd = np.diff(record.q, axis=1) / arm.period_s
    thetad = np.diff(record.theta, axis=1) / arm.period_s
    return State(record.q[:, 1:], record.theta[:, 1:], qd, thetad, record.f0[:, 1:])

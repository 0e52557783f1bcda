# SPDX-License-Identifier: MIT
"""A measured run, cut into arcs of equal length that are looked at one by one.

All arcs of a run, and all draws of its twin, go through the same smoother and the same balances as one batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from zygos import limits
from zygos.arm import Arm
from zygos.balances.field import nadir_along
from zygos.balances.readings import Readings
from zygos.balances.state import State
from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import BANDWIDTH_SIGMAS, bandwidth_coefficients, coefficients

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TableArm(Arm):
    """An arm whose readings come from a table: no frame has rounded them."""

    @property
    def over_the_wire(self) -> Arm:
        """The arm itself."""
        return self

    @classmethod
    def of(cls, arm: Arm) -> TableArm:
        """The same arm."""
        return cls(**{one.name: getattr(arm, one.name) for one in fields(Arm)})


def letter(run: int) -> str:
    """Short name of a measured run (from 0)."""
    return chr(ord("A") + run % 26)


@dataclass(frozen=True)
class MeasuredRun:
    """A run that the C library decoded."""

    arm: Arm
    path: Path
    samples: Samples
    omega0: Array
    """Base rate, rad/s: (n,) about the axis of a planar arm, (n, 3) in base axes of a spatial one."""
    faults: dict[str, int]
    starts: NDArray[np.int64]
    """(A,) position of the first sample of each arc."""
    instants: int
    """Smoothed instants in each arc."""

    @property
    def half(self) -> int:
        """Cycles that the smoother needs on either side of an instant."""
        return self.arm.smoother.points // 2

    @property
    def cycles(self) -> int:
        """Samples of each arc."""
        return self.instants + 2 * self.half

    @property
    def share(self) -> float:
        """Share of the run's cycles that lies in arcs."""
        return len(self.starts) * self.instants / len(self.samples.sync)

    @property
    def time_s(self) -> Array:
        """(A, instants) time of the smoothed instants since the run's first cycle, s."""
        at = self.starts[:, None] + self.half + np.arange(self.instants)
        return np.asarray((self.samples.sync[at] - self.samples.sync[0]) * self.arm.period_s, dtype=np.float64)

    @property
    def clock_s(self) -> Array:
        """(n,) time since the run's first cycle, s."""
        return np.asarray((self.samples.sync - self.samples.sync[0]) * self.arm.period_s, dtype=np.float64)

    @property
    def turned(self) -> Array:
        """(n,) angle that the base of a planar arm has turned since then, rad; 0 of others."""
        if self.arm.spatial or not self.arm.free:
            return np.zeros(len(self.samples.sync))
        steps = 0.5 * (self.omega0[1:] + self.omega0[:-1]) * np.diff(self.clock_s)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def nadir(self) -> Array | None:
        """(n, 3) unit vector to the Earth in base axes, by the gyro; None of an arm that does not know it."""
        known = self.arm.nadir
        return None if known is None else nadir_along(np.array(known), self.omega0, self.clock_s)

    def readings(self) -> Readings:
        """The samples of all arcs."""
        at = self.starts[:, None] + np.arange(self.cycles)
        s = self.samples
        nadir = None if self.nadir is None else self.nadir[at]
        return Readings(s.q[at], s.theta[at], self.omega0[at], s.tau[at], self.clock_s[at], self.turned[at], nadir)


def read_measured_run(arm: Arm, path: Path, frames: NDArray[Any]) -> MeasuredRun:
    """The frames of a log as `measured_run` has them. Errors: likewise."""
    return measured_run(Run(arm, frames, path=path), path)


def measured_run(run: Run, path: Path) -> MeasuredRun:
    """Cut the cycles of a run, which the C library decodes where it has frames, into arcs. Errors: ZygosError where no
    arc of 2 s is unbroken."""
    arm, cycles = run.arm if run.table is None else TableArm.of(run.arm), run.cycles
    samples = calibrate(arm, cycles)
    half = arm.smoother.points // 2
    # the smoother's windows of an arc, and of a twin's start before it and its path behind it; and a torque law that
    # looks one cycle ahead has no torque for the last sample
    lengths = [stop - start - 1 - 4 * half for start, stop in samples.segments]
    longest = max(lengths, default=0)
    instants = _arc_length(lengths, arm.period_s)
    run.check_cycles()
    if instants * arm.period_s < 2.0:
        raise ZygosError(
            f"{path}: no stretch of 2 s in which every cycle arrived (the longest has {max(0, longest)} cycles); "
            "remedy: repair the bus, or check the arm file against the log with `zygos estimate`"
        )
    starts = [
        start + half + i * instants
        for (start, _), length in zip(samples.segments, lengths, strict=True)
        for i in range(max(0, length) // instants)
    ]
    omega0 = samples.omega if arm.spatial else samples.omega @ arm.axis
    return MeasuredRun(arm, path, samples, omega0, run.faults, np.array(starts), instants)


def _arc_length(lengths: Sequence[int], period_s: float) -> int:
    """Instants of an arc: as long as limits.ARCS_S allows without losing much of the stretches that are shorter."""
    longest = max(lengths, default=0)
    if longest <= 0:
        return 0
    sizes = [longest // max(1, round(longest * period_s / wanted)) for wanted in limits.ARCS_S.value]
    covered = [sum(length // size * size for length in lengths if length > 0) for size in sizes]
    return next(
        size for size, found in zip(sizes, covered, strict=True) if found >= limits.COVERED.value * max(covered)
    )


def smoothed_states(arm: Arm, readings: Readings, derivative: int = 0) -> State:
    """Smoothed states (..., A, instants, N) of arcs (docs/theory.md, "Smoother and bandwidth test").

    The base rate of a fixed base is (..., A, instants, 0). derivative: 1 for the changes of the states, which are rates
    and accelerations.
    """
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s
    parts: list[Array] = []
    for signals, offsets in ((readings.q, _late(arm, "link")), (readings.theta, _late(arm, "motor"))):
        for further in (derivative, derivative + 1):
            weights = [coefficients(points, order, offset, further) / h**further for offset in offsets]
            parts.append(np.stack([_filter(signals[..., i], w) for i, w in enumerate(weights)], axis=-1))
    q, qd, theta, thetad = parts
    if not arm.free:
        return State(q, theta, qd, thetad, q[..., :0])
    of_gyro = coefficients(points, order, -1e-6 / h * arm.imu.latch_us, derivative) / h**derivative
    return State(q, theta, qd, thetad, _filter(readings.omega0, of_gyro, -2 if arm.spatial else -1))


def smoothed_torques(arm: Arm, readings: Readings) -> Array:
    """(..., A, instants, N) torques at the instants of `smoothed_states`, smoothed likewise, Nm before the gear."""
    # what is in force from SYNC to SYNC is that of the middle
    return _filter(readings.tau, coefficients(arm.smoother.points, arm.smoother.order, -0.5), -2)


def followed(arm: Arm, readings: Readings) -> NDArray[np.bool_]:
    """(..., A, instants) where the smoother follows every joint: the bandwidth test of the flight library."""
    points, order = arm.smoother.points, arm.smoother.order
    good: NDArray[np.bool_] | None = None
    for signals, side in ((readings.q, "link"), (readings.theta, "motor")):
        for i, offset in enumerate(_late(arm, side)):
            joint = arm.over_the_wire.joints[i]
            sigma = (joint.link_encoder if side == "link" else joint.motor_encoder).sigma_rad
            weights = bandwidth_coefficients(points, order, offset)
            spread = sigma * float(np.linalg.norm(weights))
            kept = np.abs(_filter(signals[..., i], weights)) <= (BANDWIDTH_SIGMAS * spread if spread else np.inf)
            good = kept if good is None else good & kept
    assert good is not None
    return good


def _late(arm: Arm, side: str) -> list[float]:
    """Where the polynomial of each joint is read, in samples."""
    encoders = [joint.link_encoder if side == "link" else joint.motor_encoder for joint in arm.joints]
    return [-1e-6 / arm.period_s * (j.latch_us + e.latch_us) for j, e in zip(arm.joints, encoders, strict=True)]


def _filter(x: Array, weights: Array, axis: int = -1) -> Array:
    half = len(weights) // 2
    out = np.moveaxis(correlate1d(x, weights, axis=axis), axis, -1)[..., half:-half]
    return np.asarray(np.moveaxis(out, -1, axis), dtype=np.float64)

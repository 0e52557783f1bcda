# SPDX-License-Identifier: MIT
"""The results of an audit."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from zygos.arm import Arm, TorqueLaw
from zygos.audit.remedies import Kind, Setting


@dataclass(frozen=True)
class SignalFault:
    """A fault of a signal."""

    signal: str
    fault: str
    """For instance "inverted", "swapped with elbow link angle", "stuck", "skewed 3.0 ms ± 0.1"."""
    evidence: str
    """The number on which the finding is based."""
    remedy: str
    settings: tuple[Setting, ...] = ()
    """The keys that the remedy proposes; empty where no key helps."""


@dataclass(frozen=True)
class Signal:
    """Properties of a signal. Numbers are NaN where they are unknown."""

    name: str
    unit: str
    share: float
    """Cycles received, as a share of those expected."""
    low: float
    high: float
    step: float
    """Smallest step of the readings, if they lie on a grid."""
    quantum: float
    """The declared step of the readings."""
    noise: float
    """Standard deviation of the random changes from cycle to cycle."""
    declared: float
    """The declared value of the noise."""
    decided: bool
    """Whether the signal's sign and place are confirmed."""
    verdict: str


@dataclass(frozen=True)
class Pair:
    """Results for the two encoders of a flexible joint."""

    joint: str
    skew_s: float
    """Time by which the motor encoder's reading is newer than the link encoder's, s, after the latches of the arm
    file."""
    skew_sigma_s: float
    zero_rad: float
    """theta - q without torque in the spring, rad."""
    zero_sigma_rad: float
    stiffness: float
    """Stiffness, Nm/rad, from the encoders' difference as it is read; NaN where it is not determined."""
    stiffness_unskewed: float
    """Stiffness, Nm/rad, after correction of the skew."""
    stiff: bool
    """Whether the deflection is so small that its skew is determined from the load's accelerations."""


@dataclass(frozen=True)
class Audit:
    """All results for a run."""

    signals: tuple[Signal, ...]
    findings: tuple[SignalFault, ...]
    pairs: tuple[Pair, ...]
    laws: dict[TorqueLaw, float] = field(default_factory=dict)
    """rms residual of the energy balance in J under each torque law; empty where the C library has no columns."""
    notes: tuple[str, ...] = ()
    """What could not be decided, and the reasons."""
    remarks: tuple[str, ...] = ()
    """What was found and is no fault."""
    still: tuple[str, ...] = ()
    """Joints that do not move."""
    short: bool = False
    """Whether the run, or its longest stretch without a gap, is too short to decide."""

    @property
    def ok(self) -> bool:
        """Whether there is no fault and every signal's sign and place is confirmed."""
        return not self.findings and all(signal.decided for signal in self.signals)


@dataclass(frozen=True)
class Traffic:
    """Information that only the frames contain. The keys are signal names as in `signal_names`."""

    share: dict[str, float] = field(default_factory=dict)
    saturated: dict[str, int] = field(default_factory=dict)
    """Number of frames with the largest or smallest code that the protocol can carry."""
    period_s: float = math.nan
    """SYNC period by the SYNC producer's own clock (FTIME), s."""


def signal_names(arm: Arm) -> list[tuple[str, Kind, int]]:
    """Name, field of `Cycles` and column of each signal. A rigid joint has only one angle."""
    out: list[tuple[str, Kind, int]] = []
    for i, joint in enumerate(arm.joints):
        if joint.flexible:
            out.append((f"{joint.name} link angle", "q", i))
        out += [(f"{joint.name} motor angle", "theta", i), (f"{joint.name} torque", "tau", i)]
    if arm.free:
        out += [(f"gyro {axis}", "omega", i) for i, axis in enumerate("xyz")]
    return out

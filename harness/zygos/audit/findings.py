"""What an audit says."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from zygos.arm import Arm


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a signal."""

    signal: str
    fault: str
    """For instance "inverted", "swapped with elbow link angle", "stuck", "skewed 3.0 ms ± 0.1"."""
    evidence: str
    """The number that says how sure it is."""
    remedy: str


@dataclass(frozen=True)
class Signal:
    """What a signal is like. Numbers are NaN where there are none."""

    name: str
    unit: str
    share: float
    """Cycles received of those expected."""
    low: float
    high: float
    step: float
    """Smallest step of the readings where they lie on a grid."""
    quantum: float
    """The declared step."""
    noise: float
    """Standard deviation of what changes from cycle to cycle without rhyme."""
    declared: float
    """Its declared value."""
    decided: bool
    """Whether its sign and its place were confirmed."""
    verdict: str


@dataclass(frozen=True)
class Pair:
    """The two encoders of a flexible joint."""

    joint: str
    skew_s: float
    """By how much the motor encoder's reading is newer than the link encoder's, after the latches of the arm file."""
    skew_sigma_s: float
    zero_rad: float
    """theta - q where the spring carries nothing."""
    zero_sigma_rad: float
    stiffness: float
    """Nm/rad, of the difference as it is read; NaN where it is not determined."""
    stiffness_unskewed: float
    """Nm/rad, with the skew taken out."""
    stiff: bool
    """Whether the deflection is a small difference, whose skew is told from the load's accelerations."""


@dataclass(frozen=True)
class Audit:
    """All that is found in a run."""

    signals: tuple[Signal, ...]
    findings: tuple[Finding, ...]
    pairs: tuple[Pair, ...]
    laws: dict[str, float] = field(default_factory=dict)
    """rms residual of the energy balance in J under each torque law; empty where the C library has no columns."""
    notes: tuple[str, ...] = ()
    """What could not be decided, and why."""
    still: tuple[str, ...] = ()
    """Joints that do not move."""
    short: bool = False
    """Whether the run, or its longest stretch without a gap, is too short to decide."""

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong and every signal's sign and place is confirmed."""
        return not self.findings and all(signal.decided for signal in self.signals)


@dataclass(frozen=True)
class Traffic:
    """What only the frames show. The keys are signal names as in `signal_names`."""

    share: dict[str, float] = field(default_factory=dict)
    saturated: dict[str, int] = field(default_factory=dict)
    """Frames with the outermost code of the wire."""
    period_s: float = math.nan
    """Of the SYNC producer's own clock (FTIME)."""


def signal_names(arm: Arm) -> list[tuple[str, str, int]]:
    """Name, field of `Cycles` and column of each signal. A rigid joint has one angle."""
    out = []
    for i, joint in enumerate(arm.joints):
        if joint.flexible:
            out.append((f"{joint.name} link angle", "q", i))
        out += [(f"{joint.name} motor angle", "theta", i), (f"{joint.name} torque", "tau", i)]
    if arm.free:
        out += [(f"gyro {axis}", "omega", i) for i, axis in enumerate("xyz")]
    return out

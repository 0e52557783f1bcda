# SPDX-License-Identifier: MIT
"""An audit in progress: the run as it is corrected step by step, and what was found so far."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from zygos.arm import ANGLE_STEP, Arm, Encoder, rounded
from zygos.audit.findings import SignalFault, Traffic, signal_names
from zygos.audit.means import Array
from zygos.audit.readings import grid_step, noise_beside, white_noise
from zygos.audit.remedies import ANGLES, Kind, Remedy
from zygos.runs.cycles import Cycles
from zygos.runs.samples import segments

GROUPS: dict[Kind, str] = {"q": "link angles", "theta": "motor angles", "tau": "torques", "omega": "gyro"}
"""What all readings of a kind are called."""


class Case:
    """A run, its arm file, and what was found."""

    def __init__(self, arm: Arm, cycles: Cycles, traffic: Traffic) -> None:
        """Begin with the run as it was read."""
        self.arm, self.traffic = arm, traffic
        self.read = cycles
        """The run as it was read."""
        self.cycles = cycles
        """The run with the units and wraps corrected that were found."""
        self.names: list[tuple[str, Kind, int]] = signal_names(arm)
        self.findings: list[SignalFault] = []
        self.notes: list[str] = []
        """What is open."""
        self.remarks: list[str] = []
        """What is no fault."""
        self.still: list[str] = []
        self.short = False
        self.undecided: set[str] = set()
        self._grid: dict[tuple[str, int], float] = {}

    def correct(self, cycles: Cycles) -> None:
        """Go on with a corrected run."""
        self.cycles = cycles
        self._grid.clear()
        self.__dict__.pop("ranges", None)

    @cached_property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """Half-open ranges of cycles without a gap."""
        return segments(self.cycles).ranges

    @cached_property
    def zeros(self) -> dict[str, Array]:
        """(N,) readings at which the angles are 0, rad."""
        return {
            "q": np.array([j.link_encoder.zero_rad for j in self.arm.joints]),
            "theta": np.array([j.motor_encoder.zero_rad for j in self.arm.joints]),
        }

    def name(self, kind: str, index: int) -> str:
        """Name of a signal."""
        return next(n for n, k, i in self.names if (k, i) == (kind, index))

    def find(self, signal: str, fault: str, evidence: str, remedy: Remedy) -> None:
        """Note a fault."""
        self.findings.append(SignalFault(signal, fault, evidence, remedy.text, remedy.settings))

    def faulty(self, signal: str, *begins: str) -> bool:
        """Whether a signal has a fault, or one that begins with one of these texts."""
        return any(f.signal == signal and f.fault.startswith(begins or ("",)) for f in self.findings)

    def beside_counts(self, kind: Kind, i: int) -> bool:
        """Whether the other angle of the joint is in counts, whose number in a turn is known only from the arm file."""
        others = [name for name, one, j in self.names if j == i and one in ANGLES and one != kind and kind in ANGLES]
        return any(self.faulty(name, "in counts") for name in others)

    def late(self, kind: Kind, i: int) -> bool:
        """Whether a reading is late or early, alone or with all others of its kind."""
        signals = (self.name(kind, i), GROUPS[kind], *(["angles"] if kind in ANGLES else []))
        return any(self.faulty(signal, "late", "early") for signal in signals)

    def readings(self, kind: str, index: int) -> Array:
        """(n,) readings of a signal."""
        values: Array = getattr(self.cycles, kind)[:, index]
        return values

    def valid(self, kind: str, index: int) -> Array:
        """Those of its readings that belong to a range."""
        readings = self.readings(kind, index)
        return np.concatenate([readings[a:b] for a, b in self.ranges] or [np.full(1, math.nan)])

    def share(self, name: str) -> float:
        """Share of the expected cycles in which a signal came."""
        if name in self.traffic.share:
            return self.traffic.share[name]
        if not self.ranges:
            return 0.0
        used = sum(b - a for a, b in self.ranges)
        first, last = int(self.cycles.sync[self.ranges[0][0]]), int(self.cycles.sync[self.ranges[-1][1] - 1])
        return used / max(last - first + 1, 1)

    def encoder(self, kind: str, i: int) -> Encoder:
        """The encoder of an angle."""
        joint = self.arm.joints[i]
        return joint.link_encoder if kind == "q" else joint.motor_encoder

    def seen_step(self, kind: str, i: int) -> float:
        """Step of the grid on which the readings of an angle lie, rad; NaN if there is none."""
        if (kind, i) not in self._grid:
            self._grid[kind, i] = grid_step(self.readings(kind, i), self.ranges, ANGLE_STEP)
        return self._grid[kind, i]

    def noise(self, kind: str, i: int) -> float:
        """Noise of a signal; for a torque without the part that a controller derives from the noise of encoders and
        gyro."""
        readings = self.readings(kind, i)
        if kind != "tau":
            return white_noise(readings, self.ranges)
        return noise_beside(readings, np.hstack([self.cycles.theta, self.cycles.q, self.cycles.omega]), self.ranges)

    def declared_noise(self, kind: str, i: int) -> float:
        """The noise that the arm file declares of a signal."""
        if kind == "tau":
            return self.arm.joints[i].torque_sigma
        if kind == "omega":
            return self.arm.over_the_wire.imu.rate_sigma
        # readings need not lie on the grid that the arm file declares
        return rounded(self.encoder(kind, i).sigma_rad, ANGLE_STEP)

    def used_axis(self, axis: int) -> bool:
        """Whether the arm turns about this axis of the gyro."""
        if not self.arm.free:
            return False
        return self.arm.spatial or abs(float((self.arm.mount.T @ self.arm.axis)[axis])) > 1e-6

    def open_gyro(self) -> None:
        """Note that the gyro's signs and axes are not decided."""
        self.undecided |= {name for name, kind, i in self.names if kind == "omega" and self.used_axis(i)}

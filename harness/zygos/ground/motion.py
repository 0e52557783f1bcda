# SPDX-License-Identifier: MIT
"""What a run says about the motion of an arm with rigid joints: smoothed states, and the torques that acted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import TORQUE_STEP, Arm, Smoother
from zygos.balances.joint import JointColumns, in_order, joint_columns
from zygos.balances.state import State
from zygos.can.run import Run
from zygos.cutoff import HALF_WIDTH_MAX, rate_cutoff
from zygos.errors import ZygosError
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth

Floats = NDArray[np.float64]

_ORDER = 4
_TWICE = float((np.sqrt(2.0) - 1.0) ** (-1.0 / (2 * _ORDER)))
"""Cut-off of a filter that is applied twice, in units of that of both together."""
_SHORTEST = 64
_SETTLING = 1.5
"""Periods of the cut-off over which the filter settles."""


def _smoothed_widely(arm: Arm) -> Arm:
    """The arm with a smoother of about 10 Hz where its file does not choose one: the default one is for arms whose
    motion is as fast as their cycles permit."""
    if arm.smoother != Smoother():
        return arm
    half = next(h for h in range(3, HALF_WIDTH_MAX + 1) if h == HALF_WIDTH_MAX or _is_low(h, arm.period_s))
    return replace(arm, smoother=Smoother(2 * half + 1, 4, half))


def _is_low(half_width: int, period_s: float) -> bool:
    return rate_cutoff(half_width, 4) <= limits.HIGHEST_CUTOFF_HZ.value * period_s


@dataclass(frozen=True)
class Motion:
    """A run in the form that the rows need."""

    run: Run
    samples: Samples
    smoothed: Smoothed

    @property
    def arm(self) -> Arm:
        """The arm of the run."""
        return self.run.arm

    @cached_property
    def columns(self) -> JointColumns:
        """At the smoothed instants."""
        return joint_columns(self.arm, State.smoothed(self.arm, self.smoothed))

    @classmethod
    def of(cls, run: Run, arm: Arm | None = None) -> Motion:
        """Calibrate and smooth a run; arm: with another smoother.

        The bandwidth test is not applied: the smoother's cut-off is a choice there, and what an estimate owes to it is
        measured by other cut-offs. Errors: ZygosError for a run without a whole cycle, or without an unbroken piece
        that fills the smoother's window.
        """
        own = _smoothed_widely(arm or run.arm)
        if not own.grounded:
            raise ZygosError(
                f"arm {own.name}: joint rows alone determine only an arm with a fixed base and rigid joints; remedy: "
                "estimate it with the flight library (without --validate, --since, --friction)"
            )
        run.check_cycles()
        samples = calibrate(own, run.cycles)
        smoothed = smooth(own, samples)
        smoothed = replace(smoothed, accepted=np.ones_like(smoothed.accepted))
        if len(smoothed.index) == 0:
            raise ZygosError(
                f"{run.path or 'the run'}: no unbroken piece is longer than the smoother's window of "
                f"{own.smoother.points} cycles; remedy: record without interruptions"
            )
        return cls(replace(run, arm=own), samples, smoothed)

    @property
    def duration_s(self) -> float:
        """Time that the smoothed instants cover, s."""
        return len(self.smoothed.index) * self.arm.period_s


def cutoff_hz(arm: Arm) -> float:
    """Frequency at which the smoother passes 1/sqrt(2) of a rate, Hz."""
    smoother = _smoothed_widely(arm).smoother
    return rate_cutoff(smoother.points // 2, smoother.order) / arm.period_s


LEAST_NOISE = 1e-6
"""Noise that a torque has at least, as a share of its root mean square, where none is declared and none is seen."""


def torque_noise(motion: Motion, declared: bool = True) -> Floats:
    """(N,) standard deviation of the noise of one torque reading, Nm: the declared one; where none is declared, or
    where the declared one does not count, what neighbouring readings show.

    The motion is slow compared with a period, so that fourth differences contain little else; their median is taken
    because a torque that steps would count otherwise. Readings that lie on the steps of the CAN frame have the error of
    its rounding; a table need not have it.
    """
    arm, tau = motion.arm, motion.run.cycles.tau
    found = np.zeros(arm.n)
    for j, joint in enumerate(arm.joints):
        stepped = _on_grid(tau[:, j], TORQUE_STEP)
        if declared and joint.torque_sigma > 0.0:
            found[j] = joint.over_the_wire.torque_sigma if stepped else joint.torque_sigma
            continue
        fourth = [np.diff(tau[start:stop, j], n=4) for start, stop in motion.samples.segments]
        whole = np.concatenate(fourth) if fourth else np.zeros(0)
        noise = np.median(np.abs(whole)) / 0.6745 / np.sqrt(70.0) if len(whole) else 0.0
        typical = float(np.sqrt(np.mean(np.nan_to_num(tau[:, j]) ** 2)))
        found[j] = max(noise, TORQUE_STEP / np.sqrt(12.0) if stepped else LEAST_NOISE * typical)
    return np.asarray(found, dtype=np.float64)


def _on_grid(readings: Floats, step: float) -> bool:
    """Whether all readings are multiples of a step, as far as their number format shows it."""
    multiples = readings[np.isfinite(readings)] / step
    return bool(np.all(np.abs(multiples - np.rint(multiples)) < 1e-6 + 1e-9 * np.abs(multiples)))


@dataclass(frozen=True)
class TorqueRows:
    """Rows of the torque itself, at m instants of N joints, with accelerations: for scores, never for an estimate.

    Angles and torques have passed the same filter without delay.
    """

    state: State
    z: Floats
    """(m, N, p) columns in the order of `arm.parameter_names`."""
    tau: Floats
    """(m, N) measured torque after the gear, Nm."""
    period_s: float
    cutoff_hz: float
    taps: tuple[Floats, Floats]
    """Of the filter, one direction."""
    segment: NDArray[np.int64]
    """(m,) number of the unbroken segment."""
    kept: NDArray[np.bool_]
    """(m,) False at the ends of a segment, where the filter settles."""

    @property
    def acceleration(self) -> Floats:
        """(m, N) of the filtered motion, rad/s^2."""
        out = np.zeros_like(self.state.qd)
        for number in np.unique(self.segment):
            of = self.segment == number
            out[of] = np.gradient(self.state.qd[of], self.period_s, axis=0)
        return out

    def filtered(self, column: Floats) -> Floats:
        """A column (m, ...) of an effect, through the filter of the torques."""
        out = np.zeros_like(column)
        for number in np.unique(self.segment):
            of = self.segment == number
            out[of] = both_ways(self.taps, column[of])
        return out


def both_ways(taps: tuple[Floats, Floats], signal: Floats) -> Floats:
    """A signal (m, ...) through a filter in both directions, so that nothing is delayed."""
    from scipy.signal import filtfilt  # noqa: PLC0415  (takes a second to import)

    return np.asarray(filtfilt(*taps, signal, axis=0), dtype=np.float64)


def torque_rows(arm: Arm, samples: Samples, cutoff: float) -> TorqueRows:
    """Rows of the torque through a Butterworth filter of fourth order in both directions.

    cutoff: Hz, at which both directions together pass 1/sqrt(2), as the smoother does. Errors: ZygosError for a run
    that is too short for the filter.
    """
    from scipy.signal import butter  # noqa: PLC0415  (takes a second to import)

    h = arm.period_s
    cutoff = min(cutoff, 0.4 / h)
    taps = butter(_ORDER, min(cutoff * _TWICE, 0.45 / h), fs=1.0 / h)
    settle = max(1, round(_SETTLING / (cutoff * h)))
    parts: list[tuple[NDArray[Any], ...]] = []
    for number, (start, stop) in enumerate(samples.segments):
        good = np.flatnonzero(np.all(np.isfinite(samples.tau[start:stop]), axis=1))
        if len(good) < max(_SHORTEST, 3 * settle):
            continue
        of = slice(start + int(good[0]), start + int(good[-1]) + 1)
        q = both_ways(taps, samples.theta[of])
        qd = np.gradient(q, h, axis=0)
        columns = joint_columns(arm, _resting_base(arm, q, qd))
        z = in_order(
            arm,
            np.gradient(columns.momentum, h, axis=0) - columns.force,
            np.gradient(columns.rotor_momentum, h, axis=0) - columns.rotor_force,
        )
        # a torque is held for a period, so that the filter sees the mean of those before and after an instant
        tau = samples.tau[of]
        held = 0.5 * (tau + np.vstack([tau[:1], tau[:-1]]))
        measured = both_ways(taps, held * arm.gear_ratios)
        place = np.arange(len(q))
        kept = (place >= settle) & (place < len(q) - settle)
        parts.append((q, qd, z, measured, np.full(len(q), number), kept))
    if not parts:
        raise ZygosError(
            f"arm {arm.name}: no unbroken piece of the run is long enough for torques at {cutoff:g} Hz; remedy: record "
            f"at least {max(_SHORTEST, 3 * settle) * h:.1f} s without interruptions"
        )
    q, qd, z, measured, segment, kept = (np.concatenate([part[k] for part in parts]) for k in range(6))
    state = _resting_base(arm, q, qd)
    return TorqueRows(state, z, measured, h, cutoff, taps, segment.astype(np.int64), kept.astype(np.bool_))


def _resting_base(arm: Arm, q: Floats, qd: Floats) -> State:
    """Rigid joints on a base that does not move."""
    return State(q, q, qd, qd, np.zeros((len(q), 3)) if arm.spatial else np.zeros(len(q)))

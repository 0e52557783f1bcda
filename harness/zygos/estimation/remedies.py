# SPDX-License-Identifier: MIT
"""The measured values that explain why an estimate is not valid, and the remedy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zygos.arm import Arm
from zygos.can.run import of_fd, without_cycle
from zygos.effects import GAIN
from zygos.files.output import counted, number
from zygos.native.flight import MAX_REFUSED_SHARE, MIN_SIGNAL_TO_NOISE, REASONS, Estimate, Flight

NO_FRAMES = frozenset({"incomplete", "dropped", "sync_jumped", "time_lost", "time_jumped", "overrun", "bus_error"})
"""Fault counters that do not count rejected frames."""
MANY_DROPPED = 0.02
"""Share of dropped cycles above which the loss is reported before any other cause."""
REFUSED_SEEN = 0.02
"""Share of the instants that fail the bandwidth test above which a faster motion or a longer window of the smoother
would make the motion too fast."""
LEAST_BLOCKS, INSTANTS_PER_PARAMETER = 8, 3
"""Minimum numbers of blocks and of instants per parameter for a solution, as in the C library."""
(
    NO_DATA,
    NOT_IDENTIFIABLE,
    TOO_FAST,
    NOT_PHYSICAL,
    _,
    UNCLOSED,
    NOISE,
    DECLARED,
    CHANGED,
    UNEXPLAINED,
    GAIN_DIFFERS,
    _,
) = REASONS[1:]
_NEGATIVE_SIGMAS = 3.0
_LISTED = 6
"""Largest number of names in a sentence."""


@dataclass(frozen=True)
class Known:
    """Number of determined parameters at some time of a run."""

    cycles: int
    parameters: int
    """Number of parameters with a value."""


def measured(result: Estimate, flight: Flight) -> str:
    """The measured value that explains the reason; empty if the reason has none."""
    if flight.counts["cycles"] == 0:
        return "no complete cycle of this arm was received"
    share = flight.unexplained(result)
    explained = {
        NOT_IDENTIFIABLE: f"rank {result.rank} of {len(result.names)}",
        UNEXPLAINED: f"{100 * share:.3g} % of the variance of the work is unexplained, rank {result.rank} of "
        f"{len(result.names)}",
        UNCLOSED: f"{100 * share:.3g} % of the variance of the work is unexplained, and residuals add up "
        f"{number(result.cluster, 3)} times in a block, where noise would once",
        NOISE: f"in some combination the motion's square is {number(result.signal_to_noise, 2)} times that of the "
        "noise, "
        f"at least {MIN_SIGNAL_TO_NOISE:g} is needed",
        GAIN_DIFFERS: _gains(result, flight.arm),
        DECLARED: f"the sum of squared residuals is {number(result.noise_ratio, 2)} of that of the declared noise",
    }
    return explained.get(result.reason, "") if result.rank else ""


def remedy(result: Estimate, flight: Flight, known: Sequence[Known] = ()) -> str:
    """The remedy. Faults of the bus come first, because they affect everything that follows.

    known: number of determined parameters earlier in the run, which shows whether a longer run helps.
    """
    of_the_bus = _bus(flight)
    if of_the_bus:
        return of_the_bus
    if result.reason == NO_DATA:
        return _more(result, flight)
    if result.reason in (NOISE, NOT_IDENTIFIABLE, TOO_FAST) and _refused(result) > MAX_REFUSED_SHARE:
        return _too_fast(result)
    buried = result.rank == len(result.names) and result.signal_to_noise < MIN_SIGNAL_TO_NOISE
    if result.reason == NOISE or (result.reason == NOT_IDENTIFIABLE and buried):
        return _noise(result)
    if result.reason == NOT_PHYSICAL:
        return _unphysical(result, flight)
    return _FIXED.get(result.reason) or _motion(result, flight, known)


def _gains(result: Estimate, arm: Arm) -> str:
    """What was found of each gain, and what is declared of it."""
    reference = arm.joints[arm.gain_reference]
    listed = []
    for i in arm.relative_gains:
        joint, k = arm.joints[i], result.names.index(f"{GAIN}{i + 1}")
        reported = 1.0 / (1.0 + result.solution[k])
        declared = math.hypot(joint.torque_gain_sigma, reference.torque_gain_sigma)
        listed.append(
            f"{joint.name} reports {number(float(reported), 4)} times the torque that fits {reference.name}'s, "
            f"declared 1 ± {number(1.96 * declared, 2)}"
        )
    return "; ".join(listed)


_CHECK = "check units, signs, delays, gear ratios and zeros with `zygos check-arm`"
_CLOSE = (
    f"{_CHECK}; friction, cubic springs and torque lag are part of the balance only if --model names them, noise of "
    "the torques and torques on the base are never part of it"
)
_FIXED = {
    UNCLOSED: _CLOSE,
    UNEXPLAINED: _CLOSE,
    GAIN_DIFFERS: "calibrate that torque sensor, or correct its scale or gear_ratio; if its gain is that uncertain, "
    "declare it (torque_gain_sigma in the arm file); if it is exact, the model lacks an effect that looks like it",
    DECLARED: "state the sensors of the arm file as they are: counts or quantum_rad, rate_sigma",
    CHANGED: "split the log where the arm changed, or let old arcs fade ([arc] memory_min); on board call "
    "zygos_arm_restart()",
}


def _bus(flight: Flight) -> str:
    faults, cycles = flight.faults, flight.counts["cycles"]
    largest = sorted(((count, name) for name, count in faults.items() if count and name != "dropped"), reverse=True)
    seen = ", ".join(f"{name} {count:,}" for count, name in largest[:3])
    fd = flight.fd_frames
    if cycles == 0 and fd:
        return without_cycle(faults, fd)
    if cycles == 0:
        if flight.counts["invalid"]:
            seen = f"{counted(flight.counts['invalid'], 'cycle')} invalid, not finite or implausibly large"
        came = f"the fault counters show {seen}" if seen else "no frame of this arm came"
        return f"no cycle was complete and {came}: {without_cycle(faults, fd)}"
    found = [of_fd(fd)] if fd else []
    if faults["dropped"] > MANY_DROPPED * (cycles + faults["dropped"]):
        found.append(f"the bus loses or damages frames, or some do not match the arm file ({seen}): repair that")
    if flight.counts["apart"] > MANY_DROPPED * cycles:
        found.append("link and motor angle of a joint read more than 8 turns apart: check unit, side, sign and zeros")
    if faults["time_lost"]:
        found.append("FTIME (0x3A0) must come at least every 100 cycles")
    if faults["time_jumped"]:
        found.append("period_s of the arm file disagrees with the clock of the bus, or SYNCs are lost")
    return "; ".join(found)


def _refused(result: Estimate) -> float:
    """Share of the instants that fail the bandwidth test."""
    return result.refused / max(result.accepted + result.refused, 1)


def _too_fast(result: Estimate) -> str:
    return (
        f"a higher SYNC rate, a shorter smoother window, or a slower motion: {result.refused:,} of "
        f"{counted(result.accepted + result.refused, 'instant')} failed the bandwidth test"
    )


def _noise(result: Estimate) -> str:
    """Remedy for noise as large as the motion."""
    declared = "sensors declared as they are (counts or quantum_rad, rate_sigma)"
    if _refused(result) > REFUSED_SEEN:
        return (
            f"a higher SYNC rate with the same window in seconds, or {declared}: {result.refused:,} of "
            f"{counted(result.accepted + result.refused, 'instant')} fail the bandwidth test already, so that neither "
            "a faster motion nor a longer window helps"
        )
    return (
        "a longer window of the smoother ([smoother] points, or a lower cutoff_hz), a larger or faster motion of every "
        f"joint, or {declared}; more of the same motion does not change that ratio"
    )


def _more(result: Estimate, flight: Flight) -> str:
    """Remedy for too few instants."""
    cycles, needed = flight.counts["cycles"], INSTANTS_PER_PARAMETER * len(result.names)
    if result.accepted + result.refused == 0:
        return (
            f"longer unbroken stretches: {counted(cycles, 'cycle')} in {counted(flight.counts['gaps'] + 1, 'piece')} "
            f"gave no instant; the smoother needs {flight.arm.smoother.points} cycles without interruption, the "
            "balance three more"
        )
    if result.refused > result.accepted:
        return _too_fast(result)
    if result.accepted < needed:
        return f"a longer run: {counted(result.accepted, 'instant')} were accepted, {needed} are needed"
    if _refused(result) > MAX_REFUSED_SHARE:
        return _too_fast(result)
    return (
        f"a longer run, or shorter arcs ([arc] max_s): its {counted(result.accepted, 'instant')} make "
        f"{counted(result.blocks, 'block')}, {LEAST_BLOCKS} are needed to estimate the standard deviations"
    )


def _unphysical(result: Estimate, flight: Flight) -> str:
    found = dict(zip(result.names, zip(result.value, result.sigma, strict=True), strict=True))
    never_negative = [name for _, _, name in _joint_names(flight.arm)] + [
        effect.column(flight.arm) for effect in flight.effects if effect.kind.positive
    ]
    below = {name: found[name] for name in never_negative if name in found and found[name][0] <= 0.0}
    if not below:
        return f"{_CHECK}; no body can have the estimated matrix of the inertias"
    listed = ", ".join(f"{name} = {value:.3g} ± {sigma:.2g}" for name, (value, sigma) in list(below.items())[:_LISTED])
    if all(value > -_NEGATIVE_SIGMAS * sigma for value, sigma in below.values()):
        return f"a longer run, or a motion that determines it better: {listed} is negative within its deviation"
    return f"{_CHECK}; {listed} is negative by more than its deviation"


def _joint_names(arm: Arm) -> list[tuple[str, int, str]]:
    return [(kind, i, f"{kind}{i + 1}") for kind, i, _ in arm.joint_parameters]


def _motion(result: Estimate, flight: Flight, known: Sequence[Known]) -> str:
    """Remedy for parameters that the motion does not determine."""
    arm = flight.arm
    missing = [name for name, there in zip(result.names, np.isfinite(result.value), strict=True) if not there]
    listed = ", ".join(missing[:_LISTED]) + (" …" if len(missing) > _LISTED else "")
    every = "a motion that moves every joint, at different speeds and together"
    if result.rank < len(result.names):
        left = listed or "some"
        return f"{every}, because this one leaves {left} undetermined; more of the same data does not help"
    now = int(np.count_nonzero(np.isfinite(result.value)))
    cycles = flight.counts["cycles"]
    before = [one for one in known if one.cycles <= 0.6 * cycles]
    if before:
        h, then = arm.period_s, before[-1]
        grew = f"{then.parameters} parameters had a value after {h * then.cycles:.0f} s, {now} after {h * cycles:.0f} s"
        if now > then.parameters:
            return f"a longer run: {grew}"
        return f"{every}, larger than this one; more of the same motion adds little ({grew})"
    return f"{every}: {listed or 'some'} has a standard deviation above a quarter of its size"

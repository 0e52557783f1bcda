# SPDX-License-Identifier: MIT
"""`zygos convert`: converts telemetry of other systems to a run of zygos, with a report on each signal."""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import ANGLE_STEP, TORQUE_STEP, Arm
from zygos.can import bus
from zygos.cutoff import HALF_WIDTH_MAX, rate_cutoff
from zygos.errors import ZygosError
from zygos.files.inputs import local
from zygos.files.output import cannot_be_written, counted, write_text
from zygos.files.tables import is_table
from zygos.native.flight import MAX_REFUSED_SHARE, WINDOW_MAX, Flight, fits_window, longer_period
from zygos.runs.cycles import INVALID, Cycles
from zygos.runs.samples import LARGEST_ANGLE_RAD
from zygos.runs.tables import write_cycles
from zygos.simulation.sensors import encoder_angle
from zygos.telemetry.grid import (
    Noise,
    Track,
    bridged,
    decimated,
    declared_sigma,
    grid_noise,
    instants,
    noisier,
    regrid,
    synchronous,
    times_of,
    tracks,
    tracks_of,
)
from zygos.telemetry.map import SI_UNIT, UNITS, Channel, Map, Recording
from zygos.telemetry.mend import Mended, mended

_FTIME_CYCLES = 50
"""`encode` sends FTIME with every cycle whose number is a multiple of this."""


_ANGLE_MAX, _TORQUE_MAX, _RATE_MAX = 16 * math.pi, (2**23 - 1) * TORQUE_STEP, 4.0
"""Largest angle, torque and rate that the CAN frames can carry, SI units (docs/wire.md)."""


_PEAK, _MOTION = 100.0, 20.0
"""Ratio to the median from which power in a spectrum is that of a vibration, and to noise from which it is motion."""
SPARSE = 10.0
"""Periods of the arm between two samples from which a warning is given."""
UNLIKE = 5.0
"""Ratio of the motions of motor and link angle of a joint from which a warning is given."""


def cycles_of(recording: Recording, mapping: Map, arm: Arm) -> tuple[list[Track], Cycles, dict[str, int]]:
    """Tracks, cycles, and the number of values left out for each reason."""
    if mapping.clock.kind == "sync":
        run = synchronous(recording, mapping, arm)
        lost = {"incomplete cycles": run.incomplete, "repeated cycles": run.repeated}
        return tracks_of(run.cycles, arm, mapping), run.cycles, dict(recording.left_out) | lost
    found = tracks(recording, mapping)
    at = instants(found, arm, mapping)
    found = [bridged(track, at, arm, mapping) for track in found]
    cycles = regrid(found, arm, mapping)
    missing = int(cycles.sync[-1]) + 1 - len(cycles)
    lost = {
        "instants in holes": missing,
        "repeated stamps": sum(track.repeated for track in found),
        "missing values": sum(int(np.count_nonzero(~np.isfinite(one.value))) for one in recording.sources.values()),
    }
    return found, cycles, dict(recording.left_out) | lost


def noise_of(found: Sequence[Track], mapping: Map, arm: Arm, scatter: bool = False) -> list[Noise]:
    """What becomes of the noise of each channel; scatter: as of `grid_noise`."""
    if mapping.clock.kind == "sync":
        return [Noise()] * len(found)
    at = instants(found, arm, mapping)
    return [grid_noise(track, at, arm, mapping, scatter) for track in found]


def check_noise(arm: Arm, found: Sequence[Track], noise: Sequence[Noise]) -> None:
    """Refuse readings that are no angles, and samples between which the angle is uncertain by more than a radian."""
    for track, change in zip(found, noise, strict=True):
        channel = track.channel
        largest = float(np.nanmax(np.abs(track.x), initial=0.0))
        if channel.quantity == "angle" and largest > LARGEST_ANGLE_RAD:
            raise ZygosError(
                f"{channel.where}: {channel.source} reads up to {largest:.4g} rad, which no angle does; remedy: "
                'unit = "counts" and counts_per_turn, or the unit that it has'
            )
        if channel.quantity == "angle" and math.sqrt(12.0) * declared_sigma(arm, channel) > 1.0:
            raise ZygosError(
                f"{channel.where}: between the samples of {channel.source} the angle is uncertain by "
                f"{change.added:.2g} rad: {_cause(track, change, arm)}, or check its unit and that of the time"
            )


def noise_warnings(
    arm: Arm, found: Sequence[Track], noise: Sequence[Noise], jumping: Collection[str] = ()
) -> list[str]:
    """Warnings of values whose noise on the grid is many times that of the sensor, with the cause. arm: as declared.
    jumping: sources whose jumps are the cause."""
    warnings = []
    for track, change in zip(found, noise, strict=True):
        sigma = change.kept * declared_sigma(arm, track.channel)
        if sigma > 0.0 and change.added > limits.NOISE_ADDED.value * sigma:
            if track.channel.source in jumping:
                known = "it jumps, as said above; remedy: cut the recording between the jumps (--from, --to)"
            else:
                known = _unit_of_noise(track.channel, math.hypot(change.added, sigma) / sigma, arm)
            warnings.append(
                f"{track.channel.label}: conversion makes the noise {change.added / sigma:.3g} times as large as that "
                f"of the arm file: {known or _cause(track, change, arm)}"
            )
    return warnings


def _unit_of_noise(channel: Channel, ratio: float, arm: Arm) -> str:
    """What a noise says that is larger than the declared one by the factor of another unit; empty where it is none."""
    if channel.quantity != "angle" or channel.unit != "rad":
        return ""
    gear = float(arm.joints[channel.index].gear_ratio)
    known = {f'unit = "{unit}"': 1.0 / factor for unit, factor in UNITS["angle"].items() if math.isfinite(factor)}
    for key, factor in (known | {'side = "rotor"': gear}).items():
        if factor > limits.NOISE_ADDED.value and abs(ratio / factor - 1.0) <= limits.STEP_OFF.value:
            return f"as of an encoder whose map lacks {key}; remedy: write that if it is so, else declare the noise"
    return ""


def _cause(track: Track, change: Noise, arm: Arm) -> str:
    """Why the values of a track on the grid are noisy, and the remedy."""
    if change.kept * track.rate_rms * track.stamp_sigma_s > math.sqrt(0.5) * change.added:
        return (
            f"its time stamps jitter by {1e3 * track.stamp_sigma_s:.3g} ms while it moves; remedy: a cycle counter, or "
            "a time that is taken with the sample (recording faster does not help)"
        )
    if change.by_motion:
        return "it changes much from sample to sample; remedy: record it faster"
    peak = _vibration_hz(track)
    most = f", most at {peak:.3g} Hz," if peak else ""
    return (
        f"its samples scatter{most} about a smooth motion by {change.added / change.kept:.3g} "
        f"{SI_UNIT[track.channel.quantity]}, more than the arm file says; remedy: "
        + ("avoid that vibration" if peak else "declare the noise of the sensor in the arm file")
    )


def _vibration_hz(track: Track) -> float | None:
    """Frequency of a vibration that stands out from what is faster than a tenth of the samples' rate, Hz."""
    run = max(track.runs, key=lambda one: one.stop - one.start)
    x = np.diff(track.x[run])
    power = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2
    power[: len(x) // 10] = 0.0
    fast = power[len(x) // 10 :]
    if len(fast) < 8 or fast.max() < _PEAK * np.median(fast):
        return None
    return float(np.argmax(power) / (len(x) * track.interval_s))


def motion_hz(cycles: Cycles, arm: Arm) -> float | None:
    """Frequency below which 99 % of the square of each joint's rate lies, without the noise that the arm file states,
    Hz; None where the longest piece of the run has fewer than 64 cycles, or nothing moves."""
    edges = np.flatnonzero(np.concatenate([[1], np.diff(cycles.sync.astype(np.int64)) != 1, [1]]))
    k = int(np.argmax(np.diff(edges)))
    piece = slice(int(edges[k]), int(edges[k + 1]))
    n = piece.stop - piece.start - 1
    if n < 63:
        return None
    window = np.hanning(n)
    hz = np.fft.rfftfreq(n, arm.period_s)
    found = 0.0
    for readings, encoders in (
        (cycles.q, [joint.link_encoder for joint in arm.joints]),
        (cycles.theta, [joint.motor_encoder for joint in arm.joints]),
    ):
        for angle, encoder in zip(readings[piece].T, encoders, strict=True):
            power = np.abs(np.fft.rfft(np.diff(angle) * window)) ** 2
            white = 2.0 * encoder.sigma_rad**2 * np.sum(window**2) * (1.0 - np.cos(2.0 * np.pi * hz * arm.period_s))
            total = np.cumsum(np.where(power > _MOTION * white, power, 0.0))
            if total[-1] > 0.0:
                found = max(found, float(hz[np.searchsorted(total, 0.99 * total[-1])]))
    return found or None


def fitting_cutoff_hz(cycles: Cycles, arm: Arm) -> float | None:
    """A cut-off that suits the motion, twice the frequency of `motion_hz`, if the period allows it; Hz."""
    motion = motion_hz(cycles, arm)
    if motion is None:
        return None
    shortest, longest = (rate_cutoff(width, 4) / arm.period_s for width in (HALF_WIDTH_MAX, 3))
    return float(f"{min(max(2.0 * motion, 1.01 * shortest), 0.99 * longest):.2g}")


@dataclass(frozen=True)
class Converted:
    """A recording on the grid of an arm."""

    mended: Mended
    """The recording without impossible samples."""
    found: list[Track]
    cycles: Cycles
    lost: dict[str, int]
    """The number of values left out for each reason."""
    noise: list[Noise]
    """What becomes of the noise of each channel."""
    arm: Arm
    """With the noise that the cycles have; the very arm that was given where they have no other."""
    declared: Arm
    """The arm that was given."""
    scatter: bool
    """As of `converted`."""

    @property
    def warnings(self) -> list[str]:
        """About samples that were left out, and about noise that nobody declared."""
        told = [
            (track, change)
            for track, change in zip(self.found, self.noise, strict=True)
            if not (self.scatter and track.channel.field == "tau")
        ]
        tracks, noise = [track for track, _ in told], [change for _, change in told]
        return [*self.mended.warnings, *noise_warnings(self.declared, tracks, noise, self.mended.jumping)]


def converted(recording: Recording, mapping: Map, arm: Arm, scatter: bool = False) -> Converted:
    """Bring a recording to the grid of an arm. scatter: whether the arm knows no more of its torques than their steps,
    so that their noise is what the samples show. Errors: ZygosError for samples that cannot be those of the arm."""
    sigma = {channel.source: declared_sigma(arm, channel) for channel in mapping.channels}
    whole = mended(recording, times_of(recording, mapping), mapping, sigma)
    found, cycles, lost = cycles_of(whole.recording, mapping, arm)
    noise = noise_of(found, mapping, arm, scatter)
    averaged = averages_torques(found, arm)
    described = arm
    if averaged or any(one != Noise() for one in noise):
        described = replace(noisier(arm, mapping.channels, noise), torque_averaged=averaged or arm.torque_averaged)
    check_noise(described, found, noise)
    return Converted(whole, found, cycles, lost, noise, described, arm, scatter)


def averages_torques(found: Sequence[Track], arm: Arm) -> bool:
    """Whether sampled torques of the run are means over a period, because the recording is faster than the grid."""
    return arm.torque_law == "sampled" and any(
        track.channel.field == "tau" and decimated(track, arm.period_s) for track in found
    )


def noisier_arm_text(file: Path, arm: Arm) -> str:
    """Text of the arm file with the noise of `arm`, and with what its torques are."""
    document = tomlkit.parse(local(file).read_text(encoding="utf-8"))
    for entry, joint in zip(document["joint"], arm.joints, strict=True):
        for key, encoder in (("link_encoder", joint.link_encoder), ("motor_encoder", joint.motor_encoder)):
            if key in entry and encoder.counts is None:
                entry[key].pop("counts", None)
                geared = joint.gear_ratio if encoder.side == "rotor" else 1.0
                entry[key]["quantum_rad"] = encoder.quantum_rad * geared
        entry["torque_sigma"] = joint.torque_sigma
    if arm.free:
        document["imu"]["rate_sigma"] = arm.imu.rate_sigma
    if arm.torque_averaged:
        document["torque_averaged"] = True
    return tomlkit.dumps(document)


_MARK = "# zygos convert wrote this arm file for "
"""Begin of the first line of the arm file beside a converted run; the names of the runs follow."""
_TO = "; its noise is that of their values."


def _beside(out: Path, text: str, source: Path) -> tuple[Path, str | None]:
    """The arm file beside a run, and what it is to hold; None: it stays as it is.

    The file of an earlier conversion is replaced, unless another run beside it needs the noise that it declares.
    Errors: ZygosError for that, and for a file that `convert` did not write.
    """
    beside = out.parent / "arm.toml"
    if not beside.exists():
        return beside, f"{_MARK}{out.name}{_TO}\n{text}"
    present = beside.read_text(encoding="utf-8")
    head, _, body = present.partition("\n")
    if not (head.startswith(_MARK) and head.endswith(_TO)) or beside.samefile(source):
        if text == present:
            return beside, None
        raise ZygosError(
            f"{beside} is not the arm file of this run, and `zygos convert` did not write it; remedy: write the run "
            "into another folder"
        )
    others = [name for name in head[len(_MARK) : -len(_TO)].split(", ") if name != out.name]
    others = [name for name in others if (out.parent / name).exists()]
    if others and body != text:
        raise ZygosError(
            f"{beside} is the arm file of {', '.join(others)}, whose noise is not that of this run; remedy: write each "
            "run into a folder of its own"
        )
    return beside, f"{_MARK}{', '.join([*others, out.name])}{_TO}\n{text}"


def write_run(out: Path, cycles: Cycles, frames: NDArray[Any] | None, period_s: float, text: str, source: Path) -> None:
    """Write the run, as frames if there are any, and the arm file next to it; both or none.

    text: of the arm file. source: the file from which it comes, which is not replaced. Errors: ZygosError if the arm
    file that is already there belongs to something else, or if a file cannot be written.
    """
    beside, content = _beside(out, text, source)
    staged = beside.with_name(f".{os.getpid()}.staged.toml")
    try:
        if content is not None:
            write_text(staged, content)
        if frames is None:
            write_cycles(out, cycles)
        else:
            bus.write_log(out, frames, period_s)
        if content is not None:
            staged.replace(beside)
    except OSError as error:
        raise cannot_be_written(beside, error) from error
    finally:
        staged.unlink(missing_ok=True)


def with_time(cycles: Cycles) -> Cycles:
    """The cycles, and invalid ones where no other can carry FTIME: a receiver loses its time after 120 cycles."""
    ticks = np.arange(0, int(cycles.sync[-1]), _FTIME_CYCLES, dtype=np.uint64)
    sync = np.union1d(cycles.sync, ticks)
    at = np.searchsorted(sync, cycles.sync)

    def spread(values: Any) -> Any:
        out = np.zeros((len(sync), *values.shape[1:]), dtype=values.dtype)
        out[at] = values
        return out

    flags = np.full(len(sync), INVALID, dtype=np.uint32)
    flags[at] = cycles.flags
    return replace(
        cycles,
        sync=sync,
        q=spread(cycles.q),
        theta=spread(cycles.theta),
        tau=spread(cycles.tau),
        omega=spread(cycles.omega),
        flags=flags,
    )


def refused_share(arm: Arm, cycles: Cycles, frames: NDArray[Any] | None) -> float | None:
    """Share of the run's instants that the flight library's bandwidth test refuses; None if there is no instant, or if
    the library does not hold the smoother's window."""
    if not fits_window(arm):
        return None
    flight = Flight(arm)
    if frames is None:
        flight.cycles(cycles)
    else:
        flight.frames(frames)
    accepted, refused = flight.counts["accepted"], flight.counts["refused"]
    return refused / (accepted + refused) if accepted + refused else None


def _wire_step(channel: Channel, arm: Arm) -> float:
    """Resolution of the channel in a CAN frame, SI units."""
    if channel.field == "omega":
        return arm.imu.step
    return TORQUE_STEP if channel.field == "tau" else ANGLE_STEP


def signal_rows(
    samples: dict[str, int],
    mended: Mended,
    found: Sequence[Track],
    cycles: Cycles,
    arm: Arm,
    noise: Sequence[Noise],
) -> list[dict[str, Any]]:
    """The results for each signal, as in the table and the JSON of a conversion. samples: by source, their number in
    the recording."""
    rows: list[dict[str, Any]] = []
    for track, change in zip(found, noise, strict=True):
        channel = track.channel
        values = getattr(cycles, channel.field)[:, channel.index]
        rows.append(
            {
                "signal": channel.label,
                "from": channel.source,
                "from_unit": channel.unit,
                "samples": samples[channel.source],
                "left_out": mended.left_out[channel.source],
                "turns": mended.turns[channel.source],
                "rate_hz": 1.0 / track.interval_s if len(track.t) > 1 else math.nan,
                "holes": int(track.holes.sum()) if len(track.t) > 1 else 0,
                "bridged": int((track.gaps_s <= track.bridge_s).sum()),
                "longest_bridged_s": float(max(track.gaps_s[track.gaps_s <= track.bridge_s], default=0.0)),
                "unit": arm.torque_unit if channel.quantity == "torque" else SI_UNIT[channel.quantity],
                "smallest": float(values.min()),
                "largest": float(values.max()),
                "sigma": declared_sigma(arm, channel),
                "added_by_interpolation": change.added,
                "wire_step": _wire_step(channel, arm),
            }
        )
    return rows


def _smoother_warnings(arm: Arm, refused: float | None) -> list[str]:
    warnings = []
    cutoff = arm.smoother.cutoff_hz
    if cutoff is not None and refused is not None and refused > MAX_REFUSED_SHARE:
        warnings.append(
            f"at {refused:.0%} of the instants, the smoother with its cut-off of {cutoff:g} Hz takes more from the "
            "motion than the noise of the encoders hides (bandwidth test); what they add depends on the cut-off"
        )
    if not fits_window(arm):
        warnings.append(
            f"the smoother's window of {arm.smoother.points} points is longer than the flight library's, which holds "
            f"{WINDOW_MAX} in this build; `zygos estimate` takes it on the ground, and on board: {longer_period(arm)}"
        )
    elif refused is None:
        warnings.append(
            f"no unbroken piece of the run is as long as the smoother's window of {arm.smoother.points} cycles, so "
            "nothing can be estimated from it: check the unit of the time, period_s of the arm file, and the holes"
        )
    return warnings


def warnings_of(
    arm: Arm,
    cycles: Cycles,
    described: Arm,
    recording: Recording,
    found: Sequence[Track],
    out: Path,
    refused: float | None,
) -> list[str]:
    """Warnings that a person should check."""
    warnings = _smoother_warnings(arm, refused)
    slow = max(found, key=lambda track: track.interval_s if len(track.t) > 1 else 0.0)
    if len(slow.t) > 1 and slow.interval_s > SPARSE * arm.period_s:
        warnings.append(
            f"{slow.channel.label}: one sample in {slow.interval_s / arm.period_s:,.0f} periods of the arm; the values "
            "between them are interpolated: check the unit of the time, or make period_s of the arm file longer"
        )
    warnings += recording.warnings
    if recording.damaged:
        warnings.append(f"{counted(recording.damaged, 'frame')} could not be decoded by the DBC")
    q = encoder_angle([joint.link_encoder for joint in arm.joints], cycles.q)
    theta = encoder_angle([joint.motor_encoder for joint in arm.joints], cycles.theta)
    for i, joint in enumerate(arm.joints):
        motor, link = float(np.std(theta[:, i])), float(np.std(q[:, i]))
        together = float(np.mean((theta[:, i] - theta[:, i].mean()) * (q[:, i] - q[:, i].mean())))
        if together < 0.0 or motor > UNLIKE * link or link > UNLIKE * motor:
            warnings.append(
                f"{joint.name}: motor and link angle do not move alike (after signs and zeros {motor:.3g} and "
                f"{link:.3g} rad rms{', in opposite directions' if together < 0.0 else ''}): check unit, side, sign "
                "and counts_per_turn of both"
            )
    if is_table(out):
        return warnings
    outside = [
        ("angles beyond ±8 turns wrap", np.abs(np.hstack([cycles.q, cycles.theta])) > _ANGLE_MAX),
        ("torques beyond ±838.8606 Nm saturate", np.abs(cycles.tau) >= _TORQUE_MAX),
        ("rates beyond ±4 rad/s saturate", np.abs(cycles.omega) >= _RATE_MAX),
    ]
    for what, where in outside:
        bad = int(np.any(where, axis=1).sum())
        if bad:
            warnings.append(
                f"{counted(bad, 'cycle')}: in CAN frames {what}; a cycle table (-o RUN.npz) stores them fully"
            )
    for track in found:
        channel = track.channel
        step = _wire_step(channel, arm)
        if channel.quantity == "angle":
            own = math.sqrt(12.0) * declared_sigma(described, channel)
            if step > own * (1 + 1e-9):
                warnings.append(
                    f"{channel.label}: the CAN frame's step of {step:.3g} rad is coarser than the quantum of "
                    f"{own:.3g} rad; a cycle table (-o RUN.npz) stores it fully"
                )
    return warnings


def stamps_sigma(found: Sequence[Track]) -> float:
    """Deviation of the worst signal's stamps from equal spacing, s."""
    return max(track.stamp_sigma_s for track in found)

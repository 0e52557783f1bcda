"""From telemetry to cycles: by its own cycle counter, or on a fixed grid, whose interpolation errs and says how much.

Without a SYNC each signal has stamps of its own. Angles and rates are interpolated at t_k = k * period; a torque that
is held between its messages is averaged over the period that the arm's `torque_law` speaks of. Nothing is interpolated
over a hole. docs/telemetry.md has the method and its limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from zygos.arm import Arm, Encoder
from zygos.errors import ZygosError
from zygos.runs.cycles import BREAK_BEFORE, Cycles
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth
from zygos.telemetry.map import Channel, Field, Map, Recording

Floats = NDArray[np.float64]
InterpolationMethod = Literal["hold", "linear", "cubic", "quintic"]

HOLE = 2.5
"""A signal that is silent for longer than that many of its usual intervals has a hole."""
MANY_REPEATED = 0.05
"""Share of repeated stamps above which a clock is too coarse for its signal."""
SPAN_MAX = 50
"""A recording may span that many times what it has samples for; a clock that jumped spans more."""
REFUSED_MAX = 0.05
"""Share of instants that the bandwidth test may refuse (the flight library's own limit)."""
DOUBLINGS = 6

_ORDER: dict[InterpolationMethod, int] = {"hold": 1, "linear": 2, "cubic": 4}
"""Order of the interpolation's error in the spacing of the samples."""
_PASSED: dict[InterpolationMethod, float] = {"hold": 1.0, "linear": 0.5, "cubic": 0.75}
"""Share of the variance of white noise that the interpolation passes halfway between two samples."""
_DEGREE: dict[InterpolationMethod, int] = {"linear": 1, "cubic": 3, "quintic": 5}


@dataclass(frozen=True)
class Track:
    """One reading of the arm over time: n samples in SI, stamps that rise."""

    channel: Channel
    t: Floats
    """(n,) s."""
    x: Floats
    """(n,)"""
    repeated: int = 0
    """Samples that were left out because a later one has the same stamp."""

    @property
    def interval_s(self) -> float:
        """The usual interval between samples, s."""
        return float(np.median(np.diff(self.t)))

    @property
    def holes(self) -> NDArray[np.bool_]:
        """(n-1,) intervals that are holes."""
        gaps = np.diff(self.t)
        out: NDArray[np.bool_] = gaps > HOLE * np.median(gaps)
        return out

    @property
    def runs(self) -> list[slice]:
        """Stretches without a hole."""
        edges = [0, *(np.flatnonzero(self.holes) + 1).tolist(), len(self.t)]
        return [slice(a, b) for a, b in pairwise(edges)]

    @property
    def stamp_sigma_s(self) -> float:
        """Standard deviation of a stamp about an even train, s: intervals of such stamps vary twice as much."""
        gaps = np.diff(self.t)
        usual = gaps[~self.holes]
        return float(np.std(usual) / math.sqrt(2.0)) if len(usual) else 0.0

    @property
    def evened(self) -> Track:
        """The same samples with even stamps between holes: the motion, if it is the stamps that lie."""
        t = self.t.copy()
        for run in self.runs:
            if run.stop - run.start > 1:
                at = np.arange(run.stop - run.start)
                slope, start = np.polyfit(at, self.t[run], 1)
                t[run] = start + slope * at
        return replace(self, t=t)

    @property
    def rate_rms(self) -> float:
        """Root mean square of the samples' rate of change, SI/s."""
        usual = np.diff(self.x)[~self.holes]
        return float(np.sqrt(np.mean(usual**2)) / self.interval_s) if len(usual) else 0.0


# -- by the cycle counter -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Synchronous:
    """Cycles by their counter, and those that were left out."""

    cycles: Cycles
    incomplete: int
    """Cycles that lack a value."""
    repeated: int
    """Cycles of which a value, or the number itself, came more than once."""


def synchronous(recording: Recording, mapping: Map, arm: Arm) -> Synchronous:
    """One record a cycle, nothing interpolated: what follows a count belongs to it.

    Errors: ZygosError for a counter that does not count cycles, stamps that contradict its period, or no whole cycle.
    """
    clock, per_cycle = mapping.clock, round(arm.period_s / mapping.clock.unit_s)
    counts = unwrap(recording.clock, recording.modulo, recording.clock_stamp / clock.unit_s)
    steps = np.diff(counts)
    if np.any(steps < 0):
        at = int(np.flatnonzero(steps < 0)[0])
        raise ZygosError(
            f"{clock.where}: counter {clock.source} falls after value {at + 1}; remedy: state its modulo, or cut the "
            "recording there"
        )
    uneven = np.flatnonzero(np.abs(steps / per_cycle - np.round(steps / per_cycle)) > 1e-6)
    if len(uneven):
        raise ZygosError(
            f"{clock.where}: counter {clock.source} steps by {steps[uneven[0]]:g} at value {uneven[0] + 2}, a cycle "
            f"has {per_cycle} counts; remedy: correct modulo or period_s, or use another time source"
        )
    numbers = np.round(counts / per_cycle).astype(np.int64)
    with np.errstate(invalid="ignore", divide="ignore"):
        periods = np.diff(recording.clock_stamp) / np.diff(numbers)
    known = periods[np.isfinite(periods)]
    if len(known) >= 8 and abs(np.median(known) / arm.period_s - 1.0) > 0.05:
        raise ZygosError(
            f"{clock.where}: by the log's stamps a cycle of {clock.source} lasts {np.median(known):.4g} s, by the arm "
            f"file {arm.period_s:g} s; remedy: correct period_s of the arm file, or what one count lasts here"
        )
    m = len(numbers)
    values = np.full((m, len(mapping.channels)), np.nan)
    times = np.zeros((m, len(mapping.channels)), dtype=np.int64)
    for column, channel in enumerate(mapping.channels):
        samples = recording.sources[channel.source]
        values[samples.group, column] = channel.gain * samples.value + channel.offset
        times[:, column] = np.bincount(samples.group, minlength=m)
    alone = np.ones(m, dtype=np.bool_)
    same = numbers[1:] == numbers[:-1]
    alone[1:] &= ~same
    alone[:-1] &= ~same
    once = alone & np.all(times <= 1, axis=1)
    whole = once & np.all(np.isfinite(values), axis=1)
    if not whole.any():
        lost = [f"{c.source} {n / m:.3g}" for c, n in zip(mapping.channels, times.sum(axis=0), strict=True) if n != m]
        raise ZygosError(
            f"{clock.where}: no cycle of {clock.source} has each signal once; values a cycle: "
            f"{', '.join(lost) or 'each once, but not finite'}; remedy: a time source other than sync where signals "
            "come at rates of their own"
        )
    check_span(float(numbers[-1] - numbers[0]), m, mapping)
    return Synchronous(
        _cycles(arm, mapping.channels, numbers[whole], values[whole]), int((once & ~whole).sum()), int((~once).sum())
    )


def unwrap(values: Floats, modulo: float | None, stamps: Floats) -> Floats:
    """Counts (m,) from 0 on of a counter that starts anew at modulo, whole turns lost in an outage included.

    stamps: (m,) receive stamps in counts, NaN where there are none.
    """
    steps = np.diff(values)
    if modulo is not None:
        steps = np.mod(steps, modulo)
        turns = np.round((np.diff(stamps) - steps) / modulo)
        steps = steps + modulo * np.where(turns > 0, turns, 0.0)
    counts: Floats = np.concatenate([[0.0], np.cumsum(steps)])
    return counts


def check_span(spanned: float, held: float, mapping: Map) -> None:
    """Refuse a recording that spans absurdly more time than it has samples for, both in the same unit."""
    if spanned > SPAN_MAX * held:
        raise ZygosError(
            f"{mapping.clock.where}: the recording spans {spanned / held:.0f} times what it has samples for; remedy: "
            "check the unit of the time, or cut the recording where its clock jumps"
        )


def _cycles(arm: Arm, channels: Sequence[Channel], numbers: NDArray[np.int64], values: Floats) -> Cycles:
    """Cycles of rows (n, channels); numbers count from that of the first row."""
    n = len(numbers)
    blocks: dict[Field, Floats] = {
        "q": np.zeros((n, arm.n)),
        "theta": np.zeros((n, arm.n)),
        "tau": np.zeros((n, arm.n)),
        "omega": np.zeros((n, 3)),
    }
    for column, channel in enumerate(channels):
        blocks[channel.field][:, channel.index] = values[:, column]
    for i, joint in enumerate(arm.joints):
        if not joint.flexible:
            blocks["q"][:, i] = blocks["theta"][:, i]
    flags = np.zeros(n, dtype=np.uint32)
    flags[1:][np.diff(numbers) != 1] = BREAK_BEFORE
    return Cycles(
        sync=(numbers - numbers[0]).astype(np.uint64),
        q=blocks["q"],
        theta=blocks["theta"],
        tau=blocks["tau"],
        omega=blocks["omega"],
        flags=flags,
    )


# -- on a grid ------------------------------------------------------------------------------------------------------


def tracks(recording: Recording, mapping: Map) -> list[Track]:
    """Each channel of a map over time.

    Errors: ZygosError for stamps that go backwards or repeat often, and for a channel of fewer than 8 samples.
    """
    clock = mapping.clock
    times = np.zeros(0)
    if clock.kind != "receive":
        counts = unwrap(recording.clock, recording.modulo, recording.clock_stamp / clock.unit_s)
        if recording.modulo is not None:
            # a small step backwards looks like nearly a whole turn forwards
            raw = np.diff(recording.clock)
            _forwards(clock.source, clock.where, (raw < 0) & (np.mod(raw, recording.modulo) > 0.5 * recording.modulo))
        times = counts * clock.unit_s
    out = []
    for channel in mapping.channels:
        samples = recording.sources[channel.source]
        t = samples.stamp if clock.kind == "receive" else times[samples.group]
        x = channel.gain * samples.value + channel.offset
        t, x = t[np.isfinite(x)], x[np.isfinite(x)]
        _forwards(channel.source, channel.where, np.diff(t) < 0)
        last = np.append(np.diff(t) > 0, True)
        repeated = int(len(t) - last.sum())
        if repeated > MANY_REPEATED * len(t):
            raise ZygosError(
                f"{channel.where}: {repeated} of {len(t)} stamps of {channel.source} repeat the one before; remedy: a "
                "time source of finer steps, or sync"
            )
        if last.sum() < 8:
            raise ZygosError(
                f"{channel.where}: {channel.source} has {last.sum()} samples; remedy: a recording with at least 8"
            )
        out.append(Track(channel, t[last], x[last], repeated))
    return out


def _forwards(source: str, where: str, falls: NDArray[np.bool_]) -> None:
    """Refuse stamps that fall."""
    at = np.flatnonzero(falls)
    if len(at):
        raise ZygosError(
            f"{where}: the time of {source} goes backwards at sample {at[0] + 2} ({len(at)} times in all); remedy: "
            "sort the recording, state the clock's modulo, or cut the recording there"
        )


def kind_of(channel: Channel, mapping: Map, arm: Arm) -> InterpolationMethod:
    """How a channel comes to the grid: a torque is held between its messages, unless the arm's drives sample it."""
    if channel.field == "tau":
        return "linear" if arm.torque_law == "sampled" else "hold"
    assert mapping.clock.interpolation is not None
    return mapping.clock.interpolation


def interpolate(track: Track, at: Floats, kind: InterpolationMethod) -> Floats:
    """Values (m,) of a track at times (m,); NaN in holes, outside, and where a run is too short for the spline."""
    out = np.full(len(at), np.nan)
    for run in track.runs:
        t, x = track.t[run], track.x[run]
        inside = (at >= t[0]) & (at <= t[-1])
        if kind == "hold":
            out[inside] = x[np.searchsorted(t, at[inside], side="right") - 1]
        elif len(t) > _DEGREE[kind] and inside.any():
            out[inside] = make_interp_spline(t, x, k=_DEGREE[kind])(at[inside])
    return out


def held_mean(track: Track, begin: Floats, period_s: float) -> Floats:
    """Mean (m,) of a held signal over [begin, begin + period); NaN where that touches a hole or leaves the track."""
    out = np.full(len(begin), np.nan)
    for run in track.runs:
        t, x = track.t[run], track.x[run]
        ends = np.append(t, t[-1] + track.interval_s)  # the last value holds as long as the others
        integral = np.concatenate([[0.0], np.cumsum(x * np.diff(ends))])
        slack = 1e-9 * period_s
        inside = (begin >= t[0] - slack) & (begin + period_s <= ends[-1] + slack)
        low, high = (np.interp(begin[inside] + shift, ends, integral) for shift in (0.0, period_s))
        out[inside] = (high - low) / period_s
    return out


def regrid(found: Sequence[Track], arm: Arm, mapping: Map, *, kind: InterpolationMethod | None = None) -> Cycles:
    """Tracks on the grid of the arm's period, which begins with the first instant that all of them know.

    Readings that no track gives are zero. kind: another interpolation than the map's. Errors: ZygosError if no
    instant is known.
    """
    h = arm.period_s
    begin = max(track.t[0] for track in found)
    end = min(track.t[-1] for track in found)
    if end <= begin:
        raise ZygosError(
            f"{mapping.clock.where}: no instant at which every signal is known; remedy: a recording in which all of "
            "them come at the same time"
        )
    check_span(end - begin, max(len(track.t) * track.interval_s for track in found), mapping)
    at = begin + h * np.arange(math.floor((end - begin) / h + 1e-9) + 1)
    values = np.zeros((len(at), len(found)))
    for column, track in enumerate(found):
        chosen = kind or kind_of(track.channel, mapping, arm)
        if chosen == "hold":
            shift = h if arm.torque_law == "applied_previous_cycle" else 0.0
            values[:, column] = held_mean(track, at - shift, h)
        else:
            values[:, column] = interpolate(track, at, chosen)
    known = np.isfinite(values)
    whole = np.all(known, axis=1)
    if not whole.any():
        worst = found[int(np.argmin(known.sum(axis=0)))].channel
        raise ZygosError(
            f"{worst.where}: {worst.source} has holes everywhere, no instant is known; remedy: record it evenly"
        )
    return _cycles(arm, [track.channel for track in found], np.flatnonzero(whole), values[whole])


# -- what the grid costs --------------------------------------------------------------------------------------------


def interpolation_sigma(track: Track, kind: InterpolationMethod, sigma: float) -> float:
    """Standard deviation that a value on the grid has beyond the declared sigma of its sensor, SI.

    Samples are left out and predicted from the others, once from every second and once from every fourth. What grows
    with the spacing as the order of the interpolation says is its own error; it is smaller by that factor where all
    samples are used. What does not is noise of the samples and their stamps; what exceeds sigma is added.
    """
    order, passed = _ORDER[kind], _PASSED[kind]
    two, four = (_left_out(track, kind, step) for step in (2, 4))
    growth = 4.0**order
    own = max(0.0, (four - two) / (growth - 1.0))
    own = min(own, two)
    noise = (two - own) / (1.0 + passed)
    return math.sqrt(own / growth + max(0.0, noise - sigma**2))


def _left_out(track: Track, kind: InterpolationMethod, step: int) -> float:
    """Mean square of samples halfway between every step-th one, less what those predict."""
    errors = []
    for run in track.runs:
        t, x = track.t[run], track.x[run]
        kept = replace(track, t=t[::step], x=x[::step])
        if len(kept.t) > 8:
            asked = slice(step // 2, None, step)
            errors.append(x[asked] - interpolate(kept, t[asked], kind))
    if not errors:
        return 0.0
    all_errors = np.concatenate(errors)
    known = all_errors[np.isfinite(all_errors)]
    return float(np.mean(known**2)) if len(known) else 0.0


def declared_sigma(arm: Arm, channel: Channel) -> float:
    """The standard deviation that the arm file states of a reading, SI."""
    if channel.field == "omega":
        return arm.imu.rate_sigma
    joint = arm.joints[channel.index]
    if channel.field == "tau":
        return joint.torque_sigma
    return (joint.link_encoder if channel.field == "q" else joint.motor_encoder).sigma_rad


def noisier(arm: Arm, channels: Sequence[Channel], added: Sequence[float]) -> Arm:
    """The arm whose sensors err by so much more, in the order of the channels; the gyro as its worst axis."""
    by = {(c.field, c.index): sigma for c, sigma in zip(channels, added, strict=True)}

    def encoder(one: Encoder, sigma: float) -> Encoder:
        if sigma == 0.0:
            return one
        return replace(one, quantum_rad=math.sqrt(12.0) * math.hypot(one.sigma_rad, sigma), counts=None)

    joints = []
    for i, joint in enumerate(arm.joints):
        motor = encoder(joint.motor_encoder, by.get(("theta", i), 0.0))
        link = encoder(joint.link_encoder, by.get(("q", i), 0.0)) if joint.flexible else motor
        torque = math.hypot(joint.torque_sigma, by.get(("tau", i), 0.0))
        joints.append(replace(joint, motor_encoder=motor, link_encoder=link, torque_sigma=torque))
    gyro = max((by.get(("omega", i), 0.0) for i in range(3)), default=0.0)
    imu = replace(arm.imu, rate_sigma=math.hypot(arm.imu.rate_sigma, gyro)) if gyro else arm.imu
    return replace(arm, joints=tuple(joints), imu=imu)


# -- whether it is fast enough --------------------------------------------------------------------------------------


def tracks_of(cycles: Cycles, arm: Arm, mapping: Map) -> list[Track]:
    """Cycles as tracks of the map's channels."""
    t = cycles.sync.astype(np.float64) * arm.period_s
    return [Track(channel, t, getattr(cycles, channel.field)[:, channel.index]) for channel in mapping.channels]


def needed_rate(found: Sequence[Track], arm: Arm, mapping: Map) -> tuple[float, float | None]:
    """The rate of the telemetry on the grid, Hz, and the rate that its motion needs, Hz; None: beyond the search.

    Quintic splines through the angles reconstruct the motion; sampled at the slower of grid and telemetry, and at
    twice, four times, … that rate, it is put to the bandwidth test, until the test refuses few instants. Where the
    telemetry is too slow to show the motion at all, that is a lower bound. The noise is the declared one and that of
    the stamps, not what the interpolation added.
    """
    angles = [track for track in found if track.channel.quantity == "angle"]
    if min(max(run.stop - run.start for run in track.runs) for track in angles) < 6:
        return 0.0, 0.0  # too short for a spline, and for a smoother
    jitter = [track.rate_rms * track.stamp_sigma_s for track in angles]
    steady = noisier(arm, [track.channel for track in angles], jitter)
    slowest = max(arm.period_s, *(track.interval_s for track in angles))
    for k in range(DOUBLINGS + 1):
        at_rate = replace(steady, period_s=slowest / 2**k)
        smoothed = smooth(at_rate, calibrate(at_rate, regrid(angles, at_rate, mapping, kind="quintic")))
        if len(smoothed.accepted) == 0 or np.mean(~smoothed.accepted) <= REFUSED_MAX:
            return 1.0 / slowest, 2**k / slowest
    return 1.0 / slowest, None

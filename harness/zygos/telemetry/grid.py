# SPDX-License-Identifier: MIT
"""From telemetry to cycles: by the telemetry's own cycle counter, or by interpolation on a fixed grid.

Without a SYNC each signal has its own time stamps. Angles and rates are interpolated at t_k = k * period; a torque that
is held between its messages is averaged over the period to which the arm's `torque_law` refers. Of a signal that is
recorded several times in a period, the values are averages, so that what is faster than the grid does not appear as
slow motion. No value is taken over a hole, and its error is estimated. docs/telemetry.md describes the method and its
limits.
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

from zygos import limits
from zygos.arm import Arm, Encoder
from zygos.cutoff import periods
from zygos.errors import ZygosError
from zygos.files.output import counted
from zygos.native.flight import MAX_REFUSED_SHARE
from zygos.runs.cycles import BREAK_BEFORE, Cycles
from zygos.runs.outliers import GAP
from zygos.runs.samples import calibrate
from zygos.runs.smoother import smooth
from zygos.telemetry.map import Channel, Field, Map, Recording

Floats = NDArray[np.float64]
InterpolationMethod = Literal["hold", "linear", "cubic", "quintic"]

MANY_REPEATED = 0.05
"""Share of repeated stamps above which a clock is too coarse for its signal."""
SPAN_MAX = 50
"""Largest ratio of a recording's time span to the time of its samples; a larger one shows that a clock jumped."""
DOUBLINGS = 6
DECIMATED = 2.5
"""Number of samples in a period from which a signal is averaged."""
_REACH = 2.0
"""Half width of an average of angles or rates, in periods."""
_FEWEST = 6
"""Fewest samples in an average."""
_PIECES = 40
"""Least length of a recording, in lengths of a gap, from which it is known whether the gap can be bridged."""
_BRIDGED_Z = 2.0
"""Root mean square of what values in a gap may err, in standard deviations of their noise: noise alone reaches 1.5."""
_ON_GRID = 1e-3
"""Share of the usual interval by which a sample may miss an instant of the grid of which it is the value."""
_CHUNK = 20_000
"""Number of averages that are computed together."""

_ORDER: dict[InterpolationMethod, int] = {"hold": 1, "linear": 2, "cubic": 4}
"""Order in which the interpolation's error grows with the spacing of the samples."""
_PASSED: dict[InterpolationMethod, float] = {"hold": 1.0, "linear": 0.5, "cubic": 0.75}
"""Share of the variance of white noise that the interpolation passes halfway between two samples."""
_DEGREE: dict[InterpolationMethod, int] = {"linear": 1, "cubic": 3, "quintic": 5}


@dataclass(frozen=True)
class Track:
    """One reading of the arm over time: n samples in SI units, with increasing time stamps."""

    channel: Channel
    t: Floats
    """(n,) time stamps, s."""
    x: Floats
    """(n,)"""
    repeated: int = 0
    """Number of samples that were left out because a later one has the same stamp."""
    bridge_s: float = 0.0
    """Longest gap that is bridged, s."""

    @property
    def interval_s(self) -> float:
        """The usual interval between samples, s."""
        return float(np.median(np.diff(self.t)))

    @property
    def holes(self) -> NDArray[np.bool_]:
        """(n-1,) whether each interval is a hole."""
        gaps = np.diff(self.t)
        out: NDArray[np.bool_] = gaps > max(GAP * float(np.median(gaps)), self.bridge_s)
        return out

    @property
    def gaps(self) -> NDArray[np.bool_]:
        """(n-1,) whether each interval is a gap: a hole, or a bridged one."""
        intervals = np.diff(self.t)
        out: NDArray[np.bool_] = intervals > GAP * (float(np.median(intervals)) if len(intervals) else 0.0)
        return out

    @property
    def gaps_s(self) -> Floats:
        """Lengths of the gaps, s."""
        return np.diff(self.t)[self.gaps]

    @property
    def runs(self) -> list[slice]:
        """Index ranges of the samples between holes."""
        edges = [0, *(np.flatnonzero(self.holes) + 1).tolist(), len(self.t)]
        return [slice(a, b) for a, b in pairwise(edges)]

    @property
    def stamp_sigma_s(self) -> float:
        """Standard deviation of the stamps from equal spacing, s; the variance of intervals between them is twice as
        large."""
        gaps = np.diff(self.t)
        usual = gaps[~self.holes]
        return float(np.std(usual) / math.sqrt(2.0)) if len(usual) else 0.0

    @property
    def evened(self) -> Track:
        """The same samples with equally spaced stamps between holes: the true motion, if the stamps are inaccurate."""
        t = self.t.copy()
        for run in self.runs:
            if run.stop - run.start > 1:
                at = np.arange(run.stop - run.start)
                slope, start = np.polyfit(at, self.t[run], 1)
                t[run] = start + slope * at
                if run.start:  # a short pause may vanish with its stamps, but samples keep their order
                    t[run] += max(0.0, t[run.start - 1] + slope - t[run.start])
        return replace(self, t=t)

    @property
    def rate_rms(self) -> float:
        """Root mean square of the samples' rate of change, SI/s."""
        usual = np.diff(self.x)[~self.holes]
        return float(np.sqrt(np.mean(usual**2)) / self.interval_s) if len(usual) else 0.0


# -- by the cycle counter -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Synchronous:
    """Cycles found by their counter, and the numbers of those that were left out."""

    cycles: Cycles
    incomplete: int
    """Number of cycles that lack a value."""
    repeated: int
    """Number of cycles in which a value, or the number itself, came more than once."""


def synchronous(recording: Recording, mapping: Map, arm: Arm) -> Synchronous:
    """One record per cycle, without interpolation: the values after a count belong to that count.

    Errors: ZygosError for a counter that does not count cycles, stamps that contradict its period, or no complete
    cycle.
    """
    clock, per_cycle = mapping.clock, round(arm.period_s / mapping.clock.unit_s)
    counts = unwrap(recording.clock, recording.modulo, recording.clock_stamp / clock.unit_s)
    steps = np.diff(counts)
    if np.any(steps < 0):
        at = int(np.flatnonzero(steps < 0)[0])
        raise ZygosError(
            f"{clock.where}: counter {clock.source} decreases after value {at + 1}; remedy: state its modulo, or cut "
            "the recording there"
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
            f"{clock.where}: by the log's time stamps a cycle of {clock.source} lasts {np.median(known):.4g} s, by "
            f"the arm file {arm.period_s:g} s; remedy: correct period_s of the arm file, or that of one count in the "
            "map"
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
            f"{clock.where}: no cycle of {clock.source} has each signal once; values per cycle: "
            f"{', '.join(lost) or 'each once, but not finite'}; remedy: use a time source other than sync for signals "
            "with different rates"
        )
    check_span(float(numbers[-1] - numbers[0]), m, mapping)
    return Synchronous(
        _cycles(arm, mapping.channels, numbers[whole], values[whole]), int((once & ~whole).sum()), int((~once).sum())
    )


def unwrap(values: Floats, modulo: float | None, stamps: Floats) -> Floats:
    """Counts (m,) from 0 of a counter that starts again at modulo, including whole turns lost in an outage.

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
    """Refuse a recording whose time span is implausibly long for its samples; both are in the same unit."""
    if spanned > SPAN_MAX * held:
        raise ZygosError(
            f"{mapping.clock.where}: the recording spans {spanned / held:.0f} times the time of its samples; remedy: "
            "check the unit of the time, remove samples whose times are wrong, at the beginning for instance, or cut "
            "the recording where its clock jumps"
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


def times_of(recording: Recording, mapping: Map) -> dict[str, Floats]:
    """By source: when its samples were taken, s, as the clock says. Errors: ZygosError for a clock that decreases."""
    clock, sources = mapping.clock, recording.sources
    if clock.stamped:
        return {source: samples.stamp for source, samples in sources.items()}
    counts = unwrap(recording.clock, recording.modulo, recording.clock_stamp / clock.unit_s)
    if recording.modulo is not None and clock.kind != "sync":
        # a small step backwards looks like nearly a full turn forwards
        raw = np.diff(recording.clock)
        back = (raw < 0) & (np.mod(raw, recording.modulo) > 0.5 * recording.modulo)
        _forwards(clock.source, clock.where, recording.clock, back)
    return {source: (counts * clock.unit_s)[samples.group] for source, samples in sources.items()}


def tracks(recording: Recording, mapping: Map) -> list[Track]:
    """Each channel of a map over time, by its stamps without its delay.

    Errors: ZygosError for stamps that decrease or often repeat, and for a channel of fewer than 8 samples.
    """
    times = times_of(recording, mapping)
    out = []
    for channel in mapping.channels:
        samples = recording.sources[channel.source]
        t = times[channel.source] - channel.delay_s
        x = channel.gain * samples.value + channel.offset
        t, x = t[np.isfinite(x)], x[np.isfinite(x)]
        _forwards(channel.source, channel.where, t, np.diff(t) < 0)
        last = np.append(np.diff(t) > 0, len(t) > 0)[: len(t)]
        repeated = int(len(t) - last.sum())
        differing = int(np.count_nonzero((np.diff(t) == 0.0) & (np.diff(x) != 0.0)))  # the others are copies
        if differing > MANY_REPEATED * len(t):
            raise ZygosError(
                f"{channel.where}: {differing} of {len(t)} time stamps of {channel.source} are repeated, "
                "with other values; remedy: use a time source with finer steps, or sync"
            )
        if last.sum() < 8:
            raise ZygosError(
                f"{channel.where}: {channel.source} has {counted(int(last.sum()), 'sample')}; remedy: a recording "
                "with at least 8"
            )
        out.append(Track(channel, t[last], x[last], repeated))
    return out


def _forwards(source: str, where: str, t: Floats, falls: NDArray[np.bool_]) -> None:
    """Refuse time stamps (n,) that decrease. falls: (n-1,) where they do."""
    at = np.flatnonzero(falls)
    if len(at):
        few = len(at) <= MANY_REPEATED * len(falls)  # the stamps are in order but for some that are wrong
        wrong = "remove the samples there whose times are wrong" if few else "sort the recording"
        if few and t[: at[0] + 1].min() > t[at[0] + 1 :].max():  # before a clock was set
            wrong = f"remove the first {counted(int(at[0]) + 1, 'sample')}, whose times are later than all others"
        raise ZygosError(
            f"{where}: the time of {source} goes backwards at sample {at[0] + 2} ({counted(len(at), 'time')} in all); "
            f"remedy: {wrong}, state the clock's modulo, or cut the recording there"
        )


def kind_of(channel: Channel, mapping: Map, arm: Arm) -> InterpolationMethod:
    """Interpolation of a channel: a torque is held between its messages, unless the arm's drives sample it."""
    if channel.field == "tau":
        return "linear" if arm.torque_law == "sampled" else "hold"
    assert mapping.clock.interpolation is not None
    return mapping.clock.interpolation


def interpolate(track: Track, at: Floats, kind: InterpolationMethod) -> Floats:
    """Values (m,) of a track at times (m,); NaN in holes, outside the track, and where it is too short for the
    spline."""
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
    """Mean (m,) of a held signal over [begin, begin + period); NaN if this interval overlaps a hole or leaves the
    track."""
    out = np.full(len(begin), np.nan)
    for run in track.runs:
        t, x = track.t[run], track.x[run]
        ends = np.append(t, t[-1] + track.interval_s)  # the last value is held as long as the others
        integral = np.concatenate([[0.0], np.cumsum(x * np.diff(ends))])
        slack = 1e-9 * period_s
        inside = (begin >= t[0] - slack) & (begin + period_s <= ends[-1] + slack)
        low, high = (np.interp(begin[inside] + shift, ends, integral) for shift in (0.0, period_s))
        out[inside] = (high - low) / period_s
    return out


def decimated(track: Track, period_s: float) -> bool:
    """Whether a signal is recorded so often in a period that it is averaged."""
    return track.interval_s * DECIMATED <= period_s * (1.0 + 1e-6)


@dataclass(frozen=True)
class Averages:
    """Averages of a track at m instants."""

    value: Floats
    """(m,) NaN where holes or the ends of the track leave too few samples."""
    variance: Floats
    """(m,) of the samples about the polynomial; NaN likewise."""


def averaged(track: Track, at: Floats, period_s: float) -> Averages:
    """Averages of a track at times (m,): the values of cubic polynomials that are fitted to the samples within two
    periods, weighted by (1 - (t / 2 periods)^2)^2.

    Motion up to a tenth of the grid's rate keeps its size to 0.3 %; what is near a multiple of that rate, and would
    appear as slow motion, is reduced to less than 4 %. The stamps may be uneven. About a bridged gap, the samples come
    from as much longer a time.
    """
    out = Averages(np.full(len(at), np.nan), np.full(len(at), np.nan))
    least = _REACH * period_s
    far = least + 0.5 * _silent(track, at - least, at + least)
    for run in track.runs:
        t, x = track.t[run], track.x[run]
        inside = np.flatnonzero((at >= t[0] + least) & (at <= t[-1] - least))
        for begin in range(0, len(inside), _CHUNK):
            chosen = inside[begin : begin + _CHUNK]
            low = np.searchsorted(t, at[chosen] - far[chosen], side="left")
            high = np.searchsorted(t, at[chosen] + far[chosen], side="right")
            chosen, low, high = (values[high - low >= _FEWEST] for values in (chosen, low, high))
            if len(chosen) == 0:
                continue
            index = low[:, None] + np.arange(int((high - low).max()))
            of = np.minimum(index, len(t) - 1)
            s = (t[of] - at[chosen][:, None]) / far[chosen][:, None]
            weight = np.where(index < high[:, None], np.maximum(1.0 - s**2, 0.0) ** 2, 0.0)
            powers = s[..., None] ** np.arange(4)
            normal = np.einsum("ni,nij,nik->njk", weight, powers, powers)
            fit = np.linalg.solve(normal, np.einsum("ni,nij,ni->nj", weight, powers, x[of])[..., None])[..., 0]
            rest = x[of] - np.einsum("nij,nj->ni", powers, fit)
            taken = np.linalg.solve(normal, np.einsum("ni,nij,nik->njk", weight**2, powers, powers))
            freedom = weight.sum(axis=1) - np.trace(taken, axis1=1, axis2=2)
            out.value[chosen] = fit[:, 0]
            out.variance[chosen] = np.sum(weight * rest**2, axis=1) / freedom
    return out


def _silent(track: Track, begin: Floats, end: Floats) -> Floats:
    """(m,) how much of each span belongs to gaps, s."""
    edges = np.column_stack([track.t[:-1][track.gaps], track.t[1:][track.gaps]]).ravel()
    if not len(edges):
        return np.zeros(len(begin))
    before = np.repeat(np.concatenate([[0.0], np.cumsum(track.gaps_s)]), 2)[1:-1]
    out: Floats = np.interp(end, edges, before) - np.interp(begin, edges, before)
    return out


def linear_mean(track: Track, at: Floats, period_s: float) -> Floats:
    """Mean (m,) over a period about each of the times (m,) of a signal that varies linearly between its samples; NaN if
    the period overlaps a hole or leaves the track."""
    out = np.full(len(at), np.nan)
    for run in track.runs:
        t, x = track.t[run], track.x[run]
        inside = (at - 0.5 * period_s >= t[0]) & (at + 0.5 * period_s <= t[-1])
        if len(t) > 1 and inside.any():
            integral = make_interp_spline(t, x, k=1).antiderivative()
            out[inside] = (integral(at[inside] + 0.5 * period_s) - integral(at[inside] - 0.5 * period_s)) / period_s
    return out


def instants(found: Sequence[Track], arm: Arm, mapping: Map) -> Floats:
    """(m,) the instants of the grid, s: from the first at which all tracks have begun. Errors: ZygosError if there is
    none."""
    h = arm.period_s
    begin = max(track.t[0] for track in found)
    end = min(track.t[-1] for track in found)
    if end <= begin:
        raise ZygosError(
            f"{mapping.clock.where}: there is no instant at which every signal has a value; remedy: use a recording "
            "in which all of them are present at the same time"
        )
    check_span(end - begin, max(len(track.t) * track.interval_s for track in found), mapping)
    at: Floats = begin + h * np.arange(math.floor((end - begin) / h + 1e-9) + 1)
    return at


def resampled(track: Track, at: Floats, arm: Arm, mapping: Map, *, kind: InterpolationMethod | None = None) -> Floats:
    """(m,) values of a track at instants of the grid; NaN in holes and where it is unknown. A sample that lies on an
    instant is its value. kind: as in `regrid`."""
    h = arm.period_s
    chosen = kind or kind_of(track.channel, mapping, arm)
    if kind is None and decimated(track, h) and chosen != "hold":
        torque = track.channel.field == "tau"
        return linear_mean(track, at, h) if torque else averaged(track, at, h).value
    if chosen == "hold":
        at = at - h if arm.torque_law == "applied_previous_cycle" else at
        out, as_it_is = held_mean(track, at, h), track.interval_s > h * (1.0 - _ON_GRID)
    else:
        out, as_it_is = interpolate(track, at, chosen), True
    if as_it_is:
        nearest, on = _on_grid(track, at)
        out[on] = track.x[nearest[on]]
    return out


def _on_grid(track: Track, at: Floats) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(m,) the sample that is nearest to each instant, and whether it lies on it."""
    after = np.clip(np.searchsorted(track.t, at), 1, len(track.t) - 1)
    nearest = np.where(at - track.t[after - 1] < track.t[after] - at, after - 1, after)
    return nearest, np.abs(track.t[nearest] - at) <= _ON_GRID * track.interval_s


def regrid(found: Sequence[Track], arm: Arm, mapping: Map, *, kind: InterpolationMethod | None = None) -> Cycles:
    """Tracks on the grid of the arm's period, which begins with the first instant at which all of them have a value.

    Readings without a track are zero. kind: an interpolation that replaces the map's. Errors: ZygosError if there is no
    such instant.
    """
    at = instants(found, arm, mapping)
    values = np.column_stack([resampled(track, at, arm, mapping, kind=kind) for track in found])
    known = np.isfinite(values)
    whole = np.all(known, axis=1)
    if not whole.any():
        track = found[int(np.argmin(known.sum(axis=0)))]
        worst = track.channel
        raise ZygosError(
            f"{worst.where}: {worst.source} has holes everywhere, so no instant is known; remedy: check the unit of "
            f"the time (its samples are {track.interval_s:.3g} s apart), or record "
            "it at even intervals"
        )
    return _cycles(arm, [track.channel for track in found], np.flatnonzero(whole), values[whole])


def bridged(track: Track, at: Floats, arm: Arm, mapping: Map) -> Track:
    """The track with the longest gap over which its values at the instants (m,) are as good as the others.

    As long a piece is left out elsewhere, everywhere in turn, and the values in it must remain within what their noise
    allows, those of a torque within a tenth of its variation. So the motion decides, by all frequencies that it has.
    """
    lengths = np.unique(np.ceil(track.gaps_s / track.interval_s - 0.25)).astype(int)
    lengths = lengths[lengths * _PIECES <= len(track.t)]
    if not len(lengths):
        return track
    change = grid_noise(track, at, arm, mapping)
    allowed = _BRIDGED_Z * math.hypot(change.kept * declared_sigma(arm, track.channel), change.added)
    if track.channel.field == "tau":  # whose noise is seldom known
        allowed = max(allowed, limits.TORQUE_NOISE.value * float(np.std(track.x)))
    for length in lengths:
        longer = replace(track, bridge_s=(length + 0.5) * track.interval_s)
        errors = np.concatenate([_bridging_errors(longer, at, arm, mapping, length, shift) for shift in range(4)])
        if len(errors) == 0 or math.sqrt(float(np.mean(errors**2))) > allowed:
            break
        track = longer
    return track


def _bridging_errors(track: Track, at: Floats, arm: Arm, mapping: Map, length: int, shift: int) -> Floats:
    """(k,) by how much values inside of gaps change that are made in every fourth stretch of as many intervals, but for
    those near a hole or another gap; infinite where they become unknown."""
    index = (np.arange(len(track.t)) - shift * length) % (4 * length)
    kept = (index == 0) | (index >= length)
    thinned = replace(track, t=track.t[kept], x=track.x[kept])
    before = np.searchsorted(track.t, at, side="right") - 1
    reach = _REACH * arm.period_s
    near = _near(thinned, thinned.holes, at, reach) | _near(track, track.gaps, at, reach)
    near |= (at - reach < thinned.t[0]) | (at + reach > thinned.t[-1])
    inside = at[(index[before] < length) & ~near]
    whole = resampled(track, inside, arm, mapping)
    errors = np.abs(resampled(thinned, inside, arm, mapping) - whole)[np.isfinite(whole)]
    return np.where(np.isfinite(errors), errors, np.inf)


def _near(track: Track, chosen: NDArray[np.bool_], at: Floats, reach: float) -> NDArray[np.bool_]:
    """(m,) whether one of these intervals (n-1,) of a track is within reach of the times (m,)."""
    begin, end = track.t[:-1][chosen], track.t[1:][chosen]
    found: NDArray[np.bool_] = np.searchsorted(begin, at + reach) > np.searchsorted(end, at - reach, side="right")
    return found


# -- the error of the grid ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Noise:
    """What becomes of the noise of a channel on the grid."""

    kept: float = 1.0
    """Factor of the declared standard deviation."""
    added: float = 0.0
    """Standard deviation in addition to that, SI units."""
    by_motion: bool = False
    """Whether most of it is the error of the interpolation, which a faster recording reduces."""


def grid_noise(track: Track, at: Floats, arm: Arm, mapping: Map, scatter: bool = False) -> Noise:
    """The noise of a track's values at instants (m,) of the grid of the arm's period.

    An average keeps the density of the noise, so that its standard deviation is multiplied by sqrt(interval / period).
    If the samples scatter more than the arm file says about the polynomials through them, the excess is added. The
    average of a torque has its integral, to which nothing is added, because torques may really change from sample to
    sample; with scatter, that counts as noise all the same. Interpolation adds nothing to samples on the grid.
    """
    channel, sigma = track.channel, declared_sigma(arm, track.channel)
    kind = kind_of(channel, mapping, arm)
    if kind == "hold" or not decimated(track, arm.period_s):
        own, rest = interpolation_variance(track, kind, sigma, at)
        return Noise(1.0, math.sqrt(own + rest), own > rest)
    kept = math.sqrt(track.interval_s / arm.period_s)
    if channel.field == "tau" and not scatter:
        return Noise(kept)
    variance = averaged(track, at, arm.period_s).variance
    known = variance[np.isfinite(variance)]
    return Noise(kept, kept * math.sqrt(max(0.0, float(np.mean(known)) - sigma**2)) if len(known) else 0.0)


def interpolation_variance(
    track: Track, kind: InterpolationMethod, sigma: float, at: Floats | None = None
) -> tuple[float, float]:
    """Variance of a value on the grid in addition to that of the declared sigma of its sensor, SI units: what the
    interpolation errs, and the rest.

    Samples are left out and predicted from the others, once from every second and once from every fourth. The part that
    grows with the spacing by the order of the interpolation is its own error; with all samples it is smaller by that
    factor. The rest is noise of the samples and their stamps; the part that exceeds sigma is added.

    at: (m,) instants of the grid. Towards a sample the error decreases at least like 4 f (1 - f), with the share f of
    the interval; at an instant on a sample it is zero. So is the rest, where stamps are even: it is then part of the
    signal. Without `at`, values lie halfway between samples.
    """
    order, passed = _ORDER[kind], _PASSED[kind]
    two, four = (_left_out(track, kind, step) for step in (2, 4))
    growth = 4.0**order
    own = max(0.0, (four - two) / (growth - 1.0))
    own = min(own, two)
    noise = (two - own) / (1.0 + passed)
    near = 1.0 if at is None else _between(track, at, kind)
    even = track.stamp_sigma_s <= _ON_GRID * track.interval_s
    return near * own / growth, (near if even else 1.0) * max(0.0, noise - sigma**2)


def _between(track: Track, at: Floats, kind: InterpolationMethod) -> float:
    """Mean square of the interpolation's error at instants (m,), in units of that halfway between two samples. That of
    a held value grows with the time to the nearest stamp, as far as the stamps tell it."""
    _, on = _on_grid(track, at)
    after = np.clip(np.searchsorted(track.t, at), 1, len(track.t) - 1)
    share = np.clip((at - track.t[after - 1]) / (track.t[after] - track.t[after - 1]), 0.0, 1.0)
    error = 4.0 * share * (1.0 - share)
    if kind == "hold":
        error = np.minimum(2.0 * np.minimum(share, 1.0 - share) + 2.0 * track.stamp_sigma_s / track.interval_s, 1.0)
    return float(np.mean(np.where(on, 0.0, error) ** 2))


def _left_out(track: Track, kind: InterpolationMethod, step: int) -> float:
    """Mean square difference of the samples halfway between every step-th one from their predictions by those."""
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
    """The standard deviation of a reading that the arm file states, SI units."""
    if channel.field == "omega":
        return arm.imu.rate_sigma
    joint = arm.joints[channel.index]
    if channel.field == "tau":
        return joint.torque_sigma
    return (joint.link_encoder if channel.field == "q" else joint.motor_encoder).sigma_rad


def noisier(arm: Arm, channels: Sequence[Channel], noise: Sequence[Noise]) -> Arm:
    """The arm with the noise that its sensors have on the grid, in the order of the channels; the gyro gets that of its
    worst axis."""
    by = {(c.field, c.index): one for c, one in zip(channels, noise, strict=True)}
    same = Noise()

    def encoder(one: Encoder, change: Noise) -> Encoder:
        if change == same:
            return one
        sigma = math.hypot(change.kept * one.sigma_rad, change.added)
        return replace(one, quantum_rad=math.sqrt(12.0) * sigma, counts=None)

    joints = []
    for i, joint in enumerate(arm.joints):
        motor = encoder(joint.motor_encoder, by.get(("theta", i), same))
        link = encoder(joint.link_encoder, by.get(("q", i), same)) if joint.flexible else motor
        change = by.get(("tau", i), same)
        torque = math.hypot(change.kept * joint.torque_sigma, change.added)
        joints.append(replace(joint, motor_encoder=motor, link_encoder=link, torque_sigma=torque))
    rates = [math.hypot(one.kept * arm.imu.rate_sigma, one.added) for (field, _), one in by.items() if field == "omega"]
    imu = replace(arm.imu, rate_sigma=max(rates)) if rates else arm.imu
    return replace(arm, joints=tuple(joints), imu=imu)


# -- whether the telemetry is fast enough ---------------------------------------------------------------------------


def tracks_of(cycles: Cycles, arm: Arm, mapping: Map) -> list[Track]:
    """Cycles as tracks of the map's channels."""
    t = cycles.sync.astype(np.float64) * arm.period_s
    return [Track(channel, t, getattr(cycles, channel.field)[:, channel.index]) for channel in mapping.channels]


def needed_rate(found: Sequence[Track], arm: Arm, mapping: Map) -> tuple[float, float | None]:
    """The rate of the telemetry on the grid, Hz, and the rate that its motion needs, Hz; None: above the searched
    range.

    Quintic splines through the angles reconstruct the motion. It is sampled at the slower rate of grid and telemetry,
    and at twice, four times, … that rate, until the bandwidth test refuses few instants. If the telemetry is too slow
    to show the motion at all, the result is a lower bound. The noise is the declared one and that of the stamps,
    without what the interpolation added. An arm file with a cut-off decides what is motion: then the rate is needed at
    which a smoother has that cut-off.
    """
    angles = [track for track in found if track.channel.quantity == "angle"]
    if min(max(run.stop - run.start for run in track.runs) for track in angles) < 6:
        return 0.0, 0.0  # too short for a spline and for a smoother
    slowest = max(arm.period_s, *(track.interval_s for track in angles))
    if arm.smoother.cutoff_hz is not None:
        return 1.0 / slowest, 1.0 / periods(arm.smoother.cutoff_hz)[1]
    jitter = [Noise(1.0, track.rate_rms * track.stamp_sigma_s) for track in angles]
    steady = noisier(arm, [track.channel for track in angles], jitter)
    for k in range(DOUBLINGS + 1):
        at_rate = replace(steady, period_s=slowest / 2**k)
        smoothed = smooth(at_rate, calibrate(at_rate, regrid(angles, at_rate, mapping, kind="quintic")))
        if len(smoothed.accepted) == 0 or np.mean(~smoothed.accepted) <= MAX_REFUSED_SHARE:
            return 1.0 / slowest, 2**k / slowest
    return 1.0 / slowest, None

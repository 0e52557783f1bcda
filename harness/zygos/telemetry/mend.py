"""Samples of a recording that no arm could have produced between their neighbours.

Angles that start again are unwrapped. Samples that lie off are left out, with the rest of their message or row. What
neither explains is refused, because it would be averaged with the others. docs/telemetry.md, "Impossible samples".
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import ZygosError
from zygos.files.output import counted
from zygos.runs.outliers import outliers, steps_off, two_courses
from zygos.telemetry.map import Channel, Map, Recording, SourceSamples

Floats = NDArray[np.float64]
Places = NDArray[np.int64]

_GAP = 2.5
"""Usual intervals above which a step is that of a gap, whose motion is not small."""
_SAME = 3
"""Samples of one value from which a value is that of a second source."""


@dataclass(frozen=True)
class Mended:
    """A recording without impossible samples."""

    recording: Recording
    turns: dict[str, int]
    """By source: how often its angle started again."""
    left_out: dict[str, int]
    """By source: number of samples that were left out."""
    warnings: tuple[str, ...]


def mended(recording: Recording, times: dict[str, Floats], mapping: Map, sigma: dict[str, float]) -> Mended:
    """Unwrap angles, and leave out samples that lie off, with the rest of their message or row.

    times: by source, when its samples were taken, s. sigma: by source, the declared standard deviation, SI units.
    Errors: ZygosError for steps of an angle that no motion and no modulo explain, for turns that cannot be counted, and
    where so many samples lie off that two sources seem to send them.
    """
    off: dict[str, Places] = {}
    warnings: list[str] = []
    for channel in mapping.channels:
        signal = _Signal(channel, recording.sources[channel.source], times[channel.source], sigma[channel.source])
        off[channel.source] = signal.off()
        warnings += signal.warnings
    out = dict(recording.sources)
    left_out: dict[str, int] = {}
    for channels in _messages(mapping):
        keys = {c.source: _keys(recording.sources[c.source]) for c in channels}
        gone = np.unique(np.concatenate([keys[source][off[source]] for source in keys]))
        gone = _of_second_source(recording, keys, gone)
        for source, key in keys.items():
            kept = ~np.isin(key, gone)
            left_out[source] = int((~kept).sum())
            one = out[source]
            out[source] = replace(one, value=one.value[kept], group=one.group[kept], stamp=one.stamp[kept])
            times = times | {source: times[source][kept]}
    turns: dict[str, int] = {}
    for channel in mapping.channels:
        samples = out[channel.source]
        signal = _Signal(channel, samples, times[channel.source], sigma[channel.source])
        values, turns[channel.source] = signal.unwrapped()
        out[channel.source] = replace(samples, value=values)
    return Mended(replace(recording, sources=out), turns, left_out, tuple(warnings))


def _messages(mapping: Map) -> Iterator[list[Channel]]:
    """The channels of each message, topic or table."""
    by: dict[str, list[Channel]] = {}
    for channel in mapping.channels:
        name = channel.place.topic if channel.place else channel.source.partition(".")[0] if channel.in_message else ""
        by.setdefault(name, []).append(channel)
    yield from by.values()


def _keys(samples: SourceSamples) -> Floats:
    """(n,) what the samples of one message or row have in common: its stamp, or its number."""
    return np.where(np.isfinite(samples.stamp), samples.stamp, samples.group)


def _of_second_source(recording: Recording, keys: dict[str, Floats], gone: Floats) -> Floats:
    """The keys of messages that are left out, and those of other messages with the same values: a second source that
    always sends the same is not seen while the arm is there."""
    if len(gone) < _SAME:
        return gone
    alike: Floats | None = None
    for source, key in keys.items():
        values = recording.sources[source].value
        sent = np.unique(values[np.isin(key, gone)])
        if len(sent) != 1:
            return gone
        same = key[values == sent[0]]
        alike = same if alike is None else np.intersect1d(alike, same)
    assert alike is not None
    return np.union1d(gone, alike) if len(alike) <= 2 * len(gone) else gone


class _Signal:
    """The samples of one channel, in the unit of the source."""

    def __init__(self, channel: Channel, samples: SourceSamples, times: Floats, sigma: float) -> None:
        self.channel = channel
        self.samples = samples
        self.warnings: list[str] = []
        self.finite = np.flatnonzero(np.isfinite(samples.value))
        self.x = samples.value[self.finite]
        gaps = np.diff(times[self.finite])
        usual = float(np.median(gaps)) if len(gaps) else 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            counts = np.round(gaps / usual)
        self.intervals = np.where(np.isfinite(counts) & (counts > 1.0), counts, 1.0)
        self.floor = sigma / abs(channel.gain)
        self.modulo = (channel.modulo or samples.width) if channel.quantity == "angle" else None

    def off(self) -> Places:
        """Positions of the samples that lie off, or that mean no value. Errors: ZygosError where these are many."""
        channel = self.channel
        none = np.zeros(len(self.x), dtype=np.bool_)
        if channel.missing is not None:
            none = np.isclose(self.x, channel.missing, rtol=1e-9, atol=0.0)
        valid = np.flatnonzero(~none)
        x = self.x[valid]
        if channel.quantity == "angle":
            if self.modulo is not None:
                x = _unwrap(x, self.modulo, np.ones(max(len(x) - 1, 0)))
            found = outliers(x, self.floor, channel.turn)
            found = np.union1d(found, self._ends(np.delete(x, found)))
        else:
            found = _far(x, outliers(x, self.floor))
        found = valid[found]
        self._judge(found, x)
        return self.finite[np.union1d(np.flatnonzero(none), found)]

    def _ends(self, x: Floats) -> Places:
        """Positions of the first or last two samples, if the others are somewhere else."""
        n = len(x)
        at = np.flatnonzero(steps_off(x, np.ones(max(n - 1, 0)), self.floor))
        at = at[~self._turns(np.diff(x)[at])]
        return np.concatenate(
            [*[np.arange(k + 1) for k in at if k < 2], *[np.arange(k + 1, n) for k in at if k >= n - 3], []]
        ).astype(np.int64)

    def _judge(self, found: Places, x: Floats) -> None:
        """Name what lies off, and refuse it where it is much."""
        channel, many = self.channel, len(found) > limits.SECOND_SOURCE.value * len(self.x)
        if channel.quantity == "angle" and not many:
            second = two_courses(x, self.floor)
            if len(second):
                found, many = second, True
        if not len(found):
            return
        values, times = np.unique(self.x[found], return_counts=True)
        usual = float(values[np.argmax(times)])
        same = len(found) >= _SAME and times.max() >= 0.8 * len(found)
        said = (
            f"{channel.source}: {counted(len(found), 'sample')} of {len(self.x):,} far from what the neighbours say, "
            f"first {self._at(found[0])} ({self.x[found[0]]:.6g}{f'; {times.max():,} are {usual:.6g}' if same else ''})"
        )
        if not many:
            what = "a second source, or a code for no value, sends this value; " if same else ""
            rest = "row" if channel.place is None and not channel.in_message else "message"
            self.warnings.append(f"{said}; {what}left out, with the rest of the {rest}")
            return
        remedy = "stop one of them and record again"
        if same:
            remedy += f", or write missing = {usual:.10g} there if one of them always sends this value"
        raise ZygosError(f"{channel.where}: {said}, as if two sources sent it; remedy: {remedy}")

    def unwrapped(self) -> tuple[Floats, int]:
        """(n,) the values without starting again, and how often they did.

        Errors: ZygosError for a step that no motion and no modulo explain, and for turns that cannot be counted.
        """
        values = self.samples.value
        if self.channel.quantity != "angle" or len(self.x) < 2:
            return values, 0
        x, modulo = self.x, self.modulo
        jumps = steps_off(x, self.intervals, self.floor)
        if modulo is not None:
            turned = _unwrap(x, modulo, self.intervals)
            left = np.where(jumps != 0.0, steps_off(turned, self.intervals, self.floor), 0.0)
            if not np.any(self._turns(jumps) & (np.abs(left) > limits.TURN_NEAR.value * modulo)):
                count = int(np.count_nonzero(np.round(np.diff(turned - x) / modulo)))
                if not count:
                    return values, 0
                self._check_turns(turned, modulo)
                out = values.copy()
                out[self.finite] = turned
                return out, count
        self._check_jumps(x, jumps)
        return values, 0

    def _turns(self, steps: Floats) -> NDArray[np.bool_]:
        """(m,) whether steps are those of an angle that starts again."""
        near = [np.abs(np.abs(steps) - one) <= limits.TURN_NEAR.value * one for one in self._periods()]
        out: NDArray[np.bool_] = np.any(near, axis=0)
        return out

    def _periods(self) -> list[float]:
        """Numbers at which the angle may start again, in the unit of the source, the likeliest first."""
        counts = [2.0**k / self.channel.scale for k in range(8, 33)] if self.channel.unit == "counts" else []
        return [one for one in (self.modulo, self.channel.turn, self.samples.width) if one is not None] + counts

    def _check_jumps(self, x: Floats, jumps: Floats) -> None:
        """Refuse steps of an angle that no motion explains: those of an angle that starts again, and those of more than
        a turn at once that are far above all others."""
        fast = np.percentile(np.abs(np.diff(x)) / self.intervals, 90)
        large = (np.abs(jumps) > self.channel.turn) & (np.abs(jumps) > limits.OUTLIER.value * fast)
        at = np.flatnonzero(self._turns(jumps) | large)
        if not len(at):
            return
        channel = self.channel
        size = float(np.median(np.abs(jumps[at])))
        near = [one for one in self._periods() if abs(size - one) <= limits.TURN_NEAR.value * one]
        period = near[0] if near else size
        times = int(np.count_nonzero(np.abs(np.abs(np.diff(x)) - period) <= limits.TURN_NEAR.value * period))
        stated = f", and modulo = {channel.modulo * channel.scale:.10g} does not explain it" if channel.modulo else ""
        k = int(at[0])
        raise ZygosError(
            f"{channel.where}: {channel.source} jumps by about {period * channel.scale:.6g} {channel.unit} in "
            f"{counted(max(times, 1), 'place')}, first {self._at(k + 1)} ({x[k]:.6g}, then {x[k + 1]:.6g}), which no "
            f"motion does{stated}; remedy: write modulo = {period * channel.scale:.12g} there if the angle starts "
            "again after that, else cut the recording before it"
        )

    def _check_turns(self, turned: Floats, modulo: float) -> None:
        """Refuse turns that cannot be counted, because the angle moves too far between two samples."""
        far = np.abs(np.diff(turned)) > limits.TURN_SURE.value * modulo * np.maximum(1.0, self.intervals / _GAP)
        slopes = np.where(self.intervals > _GAP, 0.0, np.diff(turned))
        reach = float(np.percentile(np.abs(slopes), 99))
        far |= (self.intervals > _GAP) & (self.intervals * reach > modulo)
        if np.any(far):
            k = int(np.flatnonzero(far)[0])
            raise ZygosError(
                f"{self.channel.where}: {self.channel.source} moves so far {self._at(k + 1)}, since the sample before, "
                "that its turns cannot be counted; remedy: record faster, record an angle that does not start again, "
                "or cut the recording at the gap"
            )

    def _at(self, k: int) -> str:
        """Where the k-th of the finite samples is in the recording."""
        place = self.finite[k]
        stamp = self.samples.stamp[place]
        return f"at {stamp:.6g} s" if math.isfinite(stamp) else f"in row {int(self.samples.group[place]) + 1}"


def _unwrap(x: Floats, modulo: float, intervals: Floats) -> Floats:
    """(n,) an angle that does not start again: each step is the shortest, in a gap the one nearest to the motion on
    both sides."""
    steps = np.diff(x)
    short = steps - modulo * np.round(steps / modulo)
    for k in np.flatnonzero(intervals > _GAP):
        sides = [part for part in (short[max(k - 5, 0) : k], short[k + 1 : k + 6]) if len(part)]
        moved = intervals[k] * float(np.mean([np.median(part) for part in sides])) if sides else 0.0
        short[k] = steps[k] - modulo * np.round((steps[k] - moved) / modulo)
    turns = np.concatenate([[0.0], np.cumsum(np.round((short - steps) / modulo))])
    out: Floats = x + modulo * turns
    return out


def _far(x: Floats, found: Places) -> Places:
    """Of samples of a torque or a rate that lie off: those far outside of the range of all others, and those that have
    one and the same value, as a code or a second source sends it. Others may be short strokes."""
    if not len(found):
        return found
    others = np.delete(x, found)
    low, high = float(others.min()), float(others.max())
    outside = (x[found] < low - (high - low)) | (x[found] > high + (high - low))
    _, which, times = np.unique(x[found], return_inverse=True, return_counts=True)
    return found[outside | (times[which] >= max(_SAME, 0.8 * len(found)))]

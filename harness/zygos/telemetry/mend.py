# SPDX-License-Identifier: MIT
"""Samples of a recording that no arm could have produced between their neighbours.

Angles that start again are unwrapped. Samples that lie off are left out, with the rest of their message or row. What
neither explains is refused, because it would be averaged with the others. docs/telemetry.md, "Impossible samples".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import ZygosError
from zygos.files.output import counted
from zygos.runs.outliers import GAP, code_of, far_off, outliers, steps_off, two_courses, unwrapped
from zygos.telemetry.map import Channel, Map, Recording, SourceSamples

Floats = NDArray[np.float64]
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Mended:
    """A recording without impossible samples."""

    recording: Recording
    turns: dict[str, int]
    """By source: how often its angle started again."""
    left_out: dict[str, int]
    """By source: number of samples that were left out."""
    warnings: tuple[str, ...]
    jumping: frozenset[str]
    """Sources of angles that jump in places, of which a warning tells."""


def mended(recording: Recording, times: dict[str, Floats], mapping: Map, sigma: dict[str, float]) -> Mended:
    """Unwrap angles, and leave out samples that lie off or mean no value, with the rest of their message or row: first
    those of angles, whose course is the surest.

    times: by source, when its samples were taken, s. sigma: by source, the declared standard deviation, SI units.
    Errors: ZygosError for steps of an angle that no motion and no modulo explain, for turns that cannot be counted, and
    where so many samples lie off that two sources seem to send them.
    """
    out, times = dict(recording.sources), dict(times)
    warnings: list[str] = []
    jumping = set[str]()

    def signal_of(channel: Channel) -> _Signal:
        return _Signal(channel, out[channel.source], times[channel.source], sigma[channel.source])

    def leave_out(channel: Channel, places: Places) -> None:
        """Leave out samples of a channel with the rest of their message or row."""
        if len(places):
            gone = _keys(out[channel.source])[places]
            for other in mapping.channels:
                if _message(other) == _message(channel):
                    samples = out[other.source]
                    kept = ~np.isin(_keys(samples), gone)
                    out[other.source] = replace(
                        samples, value=samples.value[kept], group=samples.group[kept], stamp=samples.stamp[kept]
                    )
                    times[other.source] = times[other.source][kept]

    for channel in mapping.channels:
        leave_out(channel, signal_of(channel).missing())
    for channel in mapping.channels:
        signal = signal_of(channel)
        leave_out(channel, signal.silent())
        warnings += signal.warnings
    for channel in sorted(mapping.channels, key=lambda channel: channel.quantity != "angle"):
        signal = signal_of(channel)
        leave_out(channel, signal.off())
        warnings += signal.warnings
    left_out = {source: len(samples.value) - len(out[source].value) for source, samples in recording.sources.items()}
    turns: dict[str, int] = {}
    for channel in mapping.channels:
        signal = signal_of(channel)
        values, turns[channel.source] = signal.unwrapped()
        if signal.jumps:
            jumping.add(channel.source)
        warnings += signal.warnings
        out[channel.source] = replace(out[channel.source], value=values)
        if turns[channel.source] and signal.modulo is not None:
            warnings += _first_turn(channel, float(values[signal.finite[0]]), signal.modulo)
    return Mended(replace(recording, sources=out), turns, left_out, tuple(warnings), frozenset(jumping))


def _first_turn(channel: Channel, first: float, modulo: float) -> list[str]:
    """A warning where the angle of an arm depends on the turn in which a recording begins: an encoder before the gear,
    or one that starts again within a turn."""
    step = abs(modulo * channel.gain)
    turns = step / (2.0 * math.pi)
    if abs(turns - round(turns)) < 1e-6 and round(turns):
        return []
    return [
        f"{channel.source}: its turns are counted from the first sample, and the recording does not say which one that "
        f"is: if the angle did not begin at {channel.gain * first + channel.offset:.4g} rad, it is wrong by a multiple "
        f"of {step:.4g} rad; remedy: write offset = {modulo * channel.scale:.10g} in the map for each turn that is "
        "missing"
    ]


def _message(channel: Channel) -> str:
    """Message or topic of a channel; empty for a table, whose rows have all channels."""
    if channel.place:
        return channel.place.topic
    return channel.source.partition(".")[0] if channel.in_message else ""


def _keys(samples: SourceSamples) -> Floats:
    """(n,) what the samples of one message or row have in common: its stamp, or its number."""
    return np.where(np.isfinite(samples.stamp), samples.stamp, samples.group)


class _Signal:
    """The samples of one channel, in the unit of the source."""

    def __init__(self, channel: Channel, samples: SourceSamples, times: Floats, sigma: float) -> None:
        self.channel = channel
        self.samples = samples
        self.warnings: list[str] = []
        self.jumps = False
        self.finite = np.flatnonzero(np.isfinite(samples.value))
        self.x = samples.value[self.finite]
        gaps = np.diff(times[self.finite])
        usual = float(np.median(gaps)) if len(gaps) else 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            counts = np.round(gaps / usual)
        self.intervals = np.where(np.isfinite(counts) & (counts > 1.0), counts, 1.0)
        self.floor = sigma / abs(channel.gain)
        self.modulo = (channel.modulo or samples.width) if channel.quantity == "angle" else None

    def missing(self) -> Places:
        """Positions of the samples that mean no value."""
        if self.channel.missing is None:
            return np.zeros(0, dtype=np.int64)
        return self.finite[np.isclose(self.x, self.channel.missing, rtol=1e-9, atol=0.0)]

    def silent(self) -> Places:
        """Positions of the samples before an angle begins or after it ends: one and the same value, and then a step
        that no motion makes."""
        x = self.x
        changes = np.flatnonzero(np.diff(x))
        if self.channel.quantity != "angle" or len(changes) < 2:
            return np.zeros(0, dtype=np.int64)
        jumps = steps_off(x, self.intervals, self.floor)
        jumps[self._turns(jumps) | (self.intervals > GAP)] = 0.0
        found = np.zeros(0, dtype=np.int64)
        for name, at, of in (
            ("first", int(changes[0]), np.arange(changes[0] + 1)),
            ("last", int(changes[-1]), np.arange(changes[-1] + 1, len(x))),
        ):
            if len(of) > limits.OUTLIER_BURST.value and jumps[at] != 0.0:
                found = np.concatenate([found, self.finite[of]])
                self.warnings.append(
                    f"{self.channel.source}: is {x[of[0]]:.6g} in its {name} {counted(len(of), 'sample')}, with a jump "
                    f"of {abs(x[at + 1] - x[at]):.6g}, as a sensor that does not measure; left out"
                )
        return found

    def off(self) -> Places:
        """Positions of the samples that lie off. Errors: ZygosError where these are many."""
        x = self.x
        if self.channel.quantity == "angle":
            if self.modulo is not None:
                x = unwrapped(x, self.modulo, np.ones(max(len(x) - 1, 0)))
            found = outliers(x, self.floor, self._periods())
            found = np.union1d(found, self._ends(x, np.delete(np.arange(len(x)), found)))
        else:
            found = far_off(x, outliers(x, self.floor))
        if len(found) <= limits.SECOND_SOURCE.value * len(x):
            second = two_courses(x, self.floor)
            sent = code_of(x[second]) is not None and code_of(np.delete(x, second)) is None
            found = second if len(second) and (sent or self.channel.quantity == "angle") else found
            often = _most_frequent(x)
            if len(second) and 2 * len(often) > len(second):  # both courses have it where they cross
                found = often
        code = code_of(self.x[found])
        if code is not None:
            found = np.union1d(found, _short(self.x == code))  # also where the arm has this value
        self._judge(found, code)
        return self.finite[found]

    def _ends(self, x: Floats, kept: Places) -> Places:
        """The first or the last of the kept samples, if the others are somewhere else."""
        n, size = len(kept), limits.OUTLIER_BURST.value
        x = x[kept]
        at = np.flatnonzero(steps_off(x, np.ones(max(n - 1, 0)), self.floor))
        at = at[~self._turns(np.diff(x)[at])]
        begin, end = at[at < size], at[at >= n - 1 - size]
        return np.concatenate(
            [kept[: begin.max() + 1] if len(begin) else kept[:0], kept[end.min() + 1 :] if len(end) else kept[:0]]
        )

    def _judge(self, found: Places, code: float | None) -> None:
        """Name what lies off, and refuse it where it is much. code: the value of nearly all of it, if it is one."""
        if not len(found):
            return
        channel = self.channel
        said = (
            f"{channel.source}: {counted(len(found), 'sample')} of {len(self.x):,} far from what the neighbours say, "
            f"first {self._at(found[0])} ({self.x[found[0]]:.6g})"
        )
        constant = "" if code is None else f", most are {code:.6g}, as a second source or a code for no value sends it"
        if len(found) <= limits.SECOND_SOURCE.value * len(self.x):
            rest = "message" if channel.place or channel.in_message else "row"
            self.warnings.append(f"{said}{constant}; left out, with the rest of the {rest}")
            return
        remedy = (
            "stop one of them and record again"
            if code is None
            else f"write missing = {code:.10g} there, or record again"
        )
        raise ZygosError(f"{channel.where}: {said}{constant or ', as if two sources sent them'}; remedy: {remedy}")

    def unwrapped(self) -> tuple[Floats, int]:
        """(n,) the values without starting again, and how often they did.

        Errors: ZygosError for a step that no motion and no modulo explain, and for turns that cannot be counted.
        """
        values = self.samples.value
        if self.channel.quantity != "angle" or len(self.x) < 2:
            return values, 0
        x, modulo = self.x, self.modulo
        jumps = steps_off(x, self.intervals, self.floor)
        # what moved in a gap is not known: only a whole turn is a jump there
        jumps[(self.intervals > GAP) & ~(self._turns(jumps) & self._turns(np.diff(x)))] = 0.0
        if modulo is not None:
            turned = unwrapped(x, modulo, self.intervals)
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
        a turn at once that are far above all others. Smaller ones are named."""
        fast = np.percentile(np.abs(np.diff(x)) / self.intervals, 90)
        near = self._turns(jumps)
        far = (np.abs(jumps) > limits.OUTLIER.value * fast) & (jumps != 0.0)
        at = np.flatnonzero(near | far)
        if not len(at):
            return
        channel, k = self.channel, int(at[0])
        size = float(np.median(np.abs(jumps[near] if near.any() else jumps[at])))
        said = (
            f"{channel.source} jumps in {counted(len(at), 'place')}, first {self._at(k + 1)} ({x[k]:.6g}, then "
            f"{x[k + 1]:.6g}), which no motion does"
        )
        if not near.any() and np.all(np.abs(jumps[at]) < channel.turn):
            self.jumps = True
            self.warnings.append(f"{said}: check whether the angle was set anew there, or stood still before")
            return
        alike = np.all(np.abs(np.abs(jumps[at]) - size) < limits.TURN_NEAR.value * size)
        remedy = "cut the recording there (--from, --to)"
        if near.any() or alike:
            period = next((one for one in self._periods() if abs(size - one) <= limits.TURN_NEAR.value * one), size)
            remedy = f"write modulo = {period * channel.scale:.12g} there if the angle starts again, else {remedy}"
        stated = f" and modulo = {channel.modulo * channel.scale:.10g} does not explain" if channel.modulo else ""
        raise ZygosError(f"{channel.where}: {said}{stated}; remedy: {remedy}")

    def _check_turns(self, turned: Floats, modulo: float) -> None:
        """Refuse turns that cannot be counted, because the angle moves too far between two samples."""
        far = np.abs(np.diff(turned)) > limits.TURN_SURE.value * modulo * np.maximum(1.0, self.intervals / GAP)
        slopes = np.where(self.intervals > GAP, 0.0, np.diff(turned))
        reach = float(np.percentile(np.abs(slopes), 99))
        far |= (self.intervals > GAP) & (self.intervals * reach > modulo)
        if np.any(far):
            k = int(np.flatnonzero(far)[0])
            raise ZygosError(
                f"{self.channel.where}: {self.channel.source} moves so far {self._at(k + 1)}, since the sample before, "
                "that its turns cannot be counted; remedy: record faster, record an angle that does not start again, "
                "or cut the recording at the gap (--from, --to)"
            )

    def _at(self, k: int) -> str:
        """Where the k-th of the finite samples is in the recording."""
        place = self.finite[k]
        stamp = self.samples.stamp[place]
        return (
            f"at {stamp:.6g} s"
            if math.isfinite(stamp)
            else f"in row {int(self.samples.group[place]) + self.samples.first_row}"
        )


def _most_frequent(x: Floats) -> Places:
    """Positions of the most frequent value, in runs that are no longer than a burst."""
    sent, times = np.unique(x, return_counts=True)
    return _short(x == sent[np.argmax(times)]) if len(x) else np.zeros(0, dtype=np.int64)


def _short(same: NDArray[np.bool_]) -> Places:
    """Positions in runs of equal values (n,) that are no longer than a burst."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    runs = [
        np.arange(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a <= limits.OUTLIER_BURST.value
    ]
    return np.concatenate(runs) if runs else np.zeros(0, dtype=np.int64)

# SPDX-License-Identifier: MIT
"""Signals in the frames of a bus: those that a map names are taken from messages one by one, live or of a log, and the
cycles of a run become the messages that carry them."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can import bus
from zygos.errors import ZygosError
from zygos.files.output import number
from zygos.runs.cycles import INVALID, Cycles
from zygos.telemetry.dictionary import Dictionary, sentence
from zygos.telemetry.map import (
    SPELLINGS,
    UNITS,
    Channel,
    Clock,
    Floats,
    Map,
    Recording,
    SourceSamples,
)

_CLASSICAL_BYTES = 8
"""Of the longest frame that is not CAN FD."""


@dataclass
class _Samples:
    """The values of a source so far."""

    value: array[float] = field(default_factory=lambda: array("d"))
    group: array[int] = field(default_factory=lambda: array("q"))
    stamp: array[float] = field(default_factory=lambda: array("d"))


class Decoder:
    """Takes the messages of a bus one by one, and keeps the values of the signals that a map names."""

    def __init__(self, dictionary: Dictionary, mapping: Map) -> None:
        """Errors: ZygosError for a signal that is missing in the DBC, has another unit there, or cannot be read."""
        self.damaged = 0
        """Number of messages that the DBC could not decode."""
        self.taken = 0
        """Number of messages that had signals of the map."""
        self._dictionary, self._clock = dictionary, mapping.clock
        self._channels = mapping.channels
        self._identifying = ~dictionary.ignored_bits
        self._modulo = mapping.clock.modulo
        self._wanted: dict[tuple[int, bool], tuple[Message, set[str]]] = {}
        self._widths: dict[str, float | None] = {}
        for channel in mapping.channels:
            signal = self._want(channel.source, channel.where)
            _check_unit(channel, signal)
            self._widths[channel.source] = _width(signal)
        if self._clock.source:
            width = _width(self._want(self._clock.source, self._clock.where))
            self._modulo = self._modulo or width
        self._needed = {key: _only(message, names) for key, (message, names) in self._wanted.items()}
        # the clock is read before the other signals of its message
        self._names = {
            key: sorted(
                ((name, f"{message.name}.{name}") for name in names), key=lambda one: one[1] != self._clock.source
            )
            for key, (message, names) in self._wanted.items()
        }
        self._values = {channel.source: _Samples() for channel in mapping.channels}
        self._ticks, self._tick_stamps = array("d"), array("d")
        self._begin: float | None = None

    def _want(self, source: str, where: str) -> Any:
        message, signal = self._dictionary.find(source, where)
        key = (message.frame_id & self._identifying, message.is_extended_frame)
        other = self._wanted.setdefault(key, (message, set()))
        if other[0] is not message:
            raise ZygosError(
                f"{where}: messages {other[0].name} and {message.name} have the same identifier 0x{key[0]:X} in the "
                "DBC; remedy: correct one of them"
            )
        other[1].add(signal.name)
        return signal

    def take(self, message: can.Message) -> bool:
        """Take a message. Returns whether it had signals of the map; others are passed over."""
        key = (message.arbitration_id & self._identifying, message.is_extended_id)
        if key not in self._needed or message.is_error_frame or message.is_remote_frame:
            return False
        decoded = _decode(self._needed[key], message)
        if decoded is None:
            self.damaged += 1
            return False
        self.taken += 1
        self._begin = message.timestamp if self._begin is None else self._begin
        stamp = message.timestamp - self._begin
        for name, source in self._names[key]:
            if name not in decoded:
                continue
            value = float(decoded[name])
            if source == self._clock.source:
                self._ticks.append(value)
                self._tick_stamps.append(stamp)
            samples = self._values.get(source)
            if samples is not None and (self._ticks or not self._clock.source):
                samples.value.append(value)
                samples.group.append(max(len(self._ticks) - 1, 0))
                samples.stamp.append(stamp)
        return True

    def newest(self) -> list[tuple[Channel, int, float | None]]:
        """Each channel, the number of its values, and the newest one in SI units; None: there is none."""
        kept = [(channel, self._values[channel.source].value) for channel in self._channels]
        return [
            (channel, len(values), channel.gain * values[-1] + channel.offset if values else None)
            for channel, values in kept
        ]

    def recording(self, path: Path, *, missing: Sequence[str] = (), remarks: Sequence[str] = ()) -> Recording:
        """What was taken so far. path: of the log, or the name of the bus. missing, remarks: sentences that go on after
        it.

        Errors: ZygosError for a signal that never came, and where stamps are the clock but there are none.
        """
        clock = self._clock
        if clock.source and not self._ticks:
            raise ZygosError(
                f"{clock.where}: {path.name} has no {clock.source}; remedy: compare the identifiers of the DBC, or "
                "--nodes, with the log"
            )
        for channel in self._channels:
            if not self._values[channel.source].value:
                raise ZygosError(
                    f"{channel.where}: {path.name} has no {channel.source}"
                    + (f" ({self.damaged} frames could not be decoded)" if self.damaged else "")
                    + "; remedy: compare the identifiers of the DBC, or --nodes, with the log"
                )
        _check_stamps(path, clock, self._begin)
        first = self._ticks[0] if self._ticks else 0.0
        return Recording(
            {
                source: SourceSamples(
                    np.array(samples.value),
                    np.array(samples.group, dtype=np.int64),
                    np.array(samples.stamp),
                    self._widths[source],
                )
                for source, samples in self._values.items()
            },
            np.array(self._ticks) - first,
            np.array(self._tick_stamps),
            self._modulo,
            self.damaged,
            tuple(f"{path} {text}" for text in missing),
            tuple(f"{path} {text}" for text in remarks),
            warnings=tuple(self._dictionary.warnings({message.name for message, _ in self._wanted.values()})),
        )


def read_can(
    path: Path, dictionary: Dictionary, mapping: Map, progress: Callable[[int], None] | None = None
) -> Recording:
    """Read the signals that a map names from a CAN log.

    Errors: ZygosError for a signal that is missing in the DBC or in the log, or a log that cannot be read.
    """
    decoder = Decoder(dictionary, mapping)
    missing: list[str] = []
    remarks: list[str] = []
    for message in bus.read_messages(path, missing, progress, remarks):
        decoder.take(message)
    return decoder.recording(path, missing=missing, remarks=remarks)


class Encoder:
    """Makes the messages that carry the readings of a map; the signals that it does not name are 0."""

    def __init__(self, dictionary: Dictionary, mapping: Map) -> None:
        """Errors: ZygosError for a signal that is missing in the DBC."""
        self._of: dict[str, tuple[Message, list[tuple[Channel, Any]]]] = {}
        for channel in mapping.channels:
            message, signal = dictionary.find(channel.source, channel.where)
            self._of.setdefault(message.name, (message, []))[1].append((channel, signal))

    def messages(self, cycles: Cycles, arm: Arm) -> list[can.Message]:
        """The messages of n cycles; those of a cycle have its instant as time stamp. Frames of more than 8 bytes are
        CAN FD.

        Errors: ZygosError for a reading that does not fit into its signal.
        """
        valid = np.flatnonzero((cycles.flags & INVALID) == 0)
        columns = [
            (message, _rest(message, [signal for _, signal in carried]), {
                signal.name: _raw(channel, signal, getattr(cycles, channel.field)[valid, channel.index]).tolist()
                for channel, signal in carried
            })
            for message, carried in self._of.values()
        ]  # fmt: skip
        return [
            can.Message(
                timestamp=float(cycles.sync[at]) * arm.period_s,
                arbitration_id=message.frame_id,
                is_extended_id=message.is_extended_frame,
                is_fd=message.length > _CLASSICAL_BYTES,
                data=message.encode(
                    rest | {name: values[k] for name, values in raw.items()}, scaling=False, strict=False
                ),
            )
            for k, at in enumerate(valid.tolist())
            for message, rest, raw in columns
        ]


def _raw(channel: Channel, signal: Any, reading: Floats) -> NDArray[Any]:
    """The codes (n,) of a signal for the readings (n,) of a channel."""
    physical = (reading - channel.offset) / channel.gain
    exact = (physical - float(signal.offset)) / float(signal.scale)
    if signal.is_float:
        return exact
    low = -(2 ** (signal.length - 1)) if signal.is_signed else 0
    high = low + 2**signal.length - 1
    raw = np.rint(exact)
    if np.any((raw < low) | (raw > high)):
        reached, carried = (
            number(float(np.abs(one).max()) * channel.scale, 4)
            for one in (physical, float(signal.offset) + float(signal.scale) * np.array([low, high]))
        )
        raise ZygosError(
            f"{channel.label} reaches {reached} {channel.unit}, but {channel.source} of the drives carries at most "
            f"{carried}; remedy: name the motors that the arm has (--drive), or let the scenario move less"
        )
    return raw.astype(np.int64)


def _rest(message: Message, carried: Sequence[Any]) -> dict[str, float]:
    """The codes of all signals of a message that go with these: 0 in their units, and the multiplexers as needed."""
    chosen = {one.multiplexer_signal: one.multiplexer_ids[0] for one in carried if one.multiplexer_ids}
    codes: dict[str, float] = {}
    for signal in message.signals:
        if signal.multiplexer_ids and chosen.get(signal.multiplexer_signal) not in signal.multiplexer_ids:
            continue
        codes[signal.name] = 0.0 if signal.is_float else round(-float(signal.offset) / float(signal.scale))
    return codes | chosen


def _check_unit(channel: Channel, signal: Any) -> None:
    """Refuse a unit that contradicts that in the DBC."""
    spelled = SPELLINGS.get(signal.unit or "", signal.unit or "")
    known = {unit for units in UNITS.values() for unit in units}
    if channel.bare and spelled in known and spelled != channel.unit:
        raise ZygosError(
            f'{channel.where}.unit: the map says "{channel.unit}", the DBC says "{signal.unit}" for {channel.source}; '
            "remedy: write the DBC's unit, or, if the DBC is wrong, add scale = 1.0 to yours"
        )


def _check_stamps(path: Path, clock: Clock, begin: float | None) -> None:
    """Refuse a log without time stamps where these are the clock."""
    if clock.stamped and math.isnan(begin or 0.0):
        raise ZygosError(
            f"{path}: has no time stamps, which [time] of the map asks for; remedy: record them (candump -L; slcan: "
            "Z1), or name a time or a counter in the telemetry"
        )


def _only(message: Message, names: Collection[str]) -> Message:
    """A message with these signals, and with the multiplexers. Errors: ZygosError for a signal that is too long, or for
    two that overlap."""
    signals = [signal for signal in message.signals if signal.name in names or signal.is_multiplexer]
    try:
        return Message(
            message.frame_id, message.name, message.length, signals, is_extended_frame=message.is_extended_frame
        )
    except cantools.Error as error:
        raise ZygosError(f"the DBC is wrong: {sentence(error)}; remedy: correct that message in the DBC") from error


def _width(signal: Any) -> float | None:
    """Number after which an integer signal starts again, in its unit; None for a float."""
    return None if signal.is_float else 2.0**signal.length * abs(float(signal.scale))


def _decode(message: Message, frame: can.Message) -> dict[str, Any] | None:
    """Values by signal, of which a frame with other multiplexed signals has none; None: it does not match the DBC."""
    try:
        decoded = message.decode(bytes(frame.data), decode_choices=False)
    except Exception as error:  # cantools and bitstruct raise different errors
        return {} if "multiplexer id" in str(error).lower() else None  # such a frame has other signals
    return decoded if isinstance(decoded, dict) else None

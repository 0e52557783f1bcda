# SPDX-License-Identifier: MIT
"""Messages of ROS 2 in an MCAP: joint states and rates of a gyro, as a `Recording`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from zygos.errors import ZygosError, installs
from zygos.files.inputs import check_file, suffix
from zygos.runs.span import span
from zygos.telemetry.map import Channel, Clock, Map, Recording, SourceSamples, closest

_TYPES = {"JointState": "sensor_msgs/msg/JointState", "Imu": "sensor_msgs/msg/Imu"}


def is_mcap(path: Path) -> bool:
    """Whether an input is an MCAP: by its suffix, or for standard input by its first bytes."""
    return suffix(path) == ".mcap"


def check_mcap(path: Path) -> None:
    """Refuse an MCAP that does not exist."""
    check_file(path, "give an MCAP that exists")


@dataclass(frozen=True)
class _Publisher:
    """Who sent a message, as far as an MCAP says it."""

    channel: int
    """Number of the channel in the MCAP; a recorder may open one for each publisher of a topic."""
    frame: str
    """frame_id in the header of the message."""

    @property
    def names(self) -> tuple[str, str, str]:
        """What the map may call it."""
        return self.frame, str(self.channel), f"{self.channel}:{self.frame}"


@dataclass(frozen=True)
class _Row:
    """A value of one source."""

    logged: int
    """Time of reception, ns."""
    stamp: int
    """Time by the map's clock, ns."""
    value: float
    publisher: _Publisher


@dataclass
class _Topic:
    """A topic that the map names."""

    channels: list[Channel]
    """The readings that are taken from it."""
    publishers: int = 0
    """Number of publishers that the recorder met; 0: not known."""
    lists: set[tuple[str, ...]] = field(default_factory=set)
    """Lists of joints in its messages."""

    def meet(self, path: Path, kind: str, metadata: Mapping[str, str]) -> None:
        """Take note of a channel of this topic. Errors: ZygosError for messages of another type."""
        # rosbag2 lists the quality of service of each publisher
        offered = re.findall(r"^- ", metadata.get("offered_qos_profiles", ""), re.MULTILINE)
        self.publishers = max(self.publishers, len(offered))
        for channel in self.channels:
            expected = _TYPES["Imu" if channel.quantity == "rate" else "JointState"]
            if kind != expected:
                assert channel.place is not None
                raise ZygosError(
                    f"{channel.where}.topic: {channel.place.topic} has messages of type {kind}, not {expected}; "
                    f"remedy: name a topic of that type"
                )


@dataclass
class _Taken:
    """What was taken from the messages."""

    rows: dict[str, list[_Row]]
    """By the source."""
    left_out: Counter[str] = field(default_factory=Counter)
    """Number of messages that were left out, by the reason."""
    lacking: dict[str, str] = field(default_factory=dict)
    """What a message lacked that was left out, and a remedy, by the source."""

    def take(self, topic: _Topic, clock: Clock, record: Any, message: Any) -> None:
        """The values of one message, all of a joint or none."""
        stamp = int(record.log_time)
        if clock.kind == "header":
            header = message.header.stamp
            stamp = int(header.sec) * 1_000_000_000 + int(header.nanosec)
        if stamp == 0:
            self.left_out["messages without time"] += 1
            for channel in topic.channels:
                self.lacking[channel.source] = 'have no time; remedy: write source = "receive"'
            return
        names = tuple(getattr(message, "name", ()))
        topic.lists.add(names)
        publisher = _Publisher(record.channel_id, message.header.frame_id)
        values: dict[str, dict[str, float | None]] = {}
        lacking: dict[str, str] = {}
        for channel in topic.channels:
            place = channel.place
            assert place is not None
            if not place.joint:
                values.setdefault("", {})[channel.source] = float(getattr(message.angular_velocity, place.field))
            elif place.joint in names:
                listed = getattr(message, place.field)
                value = float(listed[names.index(place.joint)]) if len(listed) == len(names) else None
                values.setdefault(place.joint, {})[channel.source] = value
                if value is None:
                    lacks = f"have {len(names)} joints and {len(listed)} values of {place.field}; remedy: record the "
                    lacking[place.joint] = f"{lacks}{place.field} of every joint"
        self.left_out["messages without a value"] += bool(lacking)
        for joint, found in values.items():
            if joint in lacking:
                self.lacking |= dict.fromkeys(found, lacking[joint])
                continue
            for source, value in found.items():
                assert value is not None
                self.rows[source].append(_Row(int(record.log_time), stamp, value, publisher))


def read_mcap(path: Path, mapping: Map, progress: Callable[[int], None] | None = None) -> Recording:
    """Read the values that a map names; times are those of the headers, or of the reception, as the map's clock says.
    A message that lacks its time, or one of the values that the map takes of a joint, is left out. Of a damaged MCAP,
    what can be read is read.

    progress is called from time to time with the number of messages. Errors: ZygosError for an MCAP that cannot be
    read, a topic or joint that is missing, a message of another type, several publishers of one reading, or values
    that all messages lack.
    """
    check_mcap(path)
    try:
        from mcap.records import Message, Schema  # noqa: PLC0415  (an extra: only MCAP needs it)
        from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415

        from zygos.telemetry.records import read_records  # noqa: PLC0415
    except ImportError:
        raise ZygosError(f"{path}: .mcap needs mcap and mcap-ros2-support; remedy: {installs('ros')}") from None
    topics: dict[str, _Topic] = {}
    for channel in mapping.channels:
        assert channel.place is not None
        topics.setdefault(channel.place.topic, _Topic([])).channels.append(channel)
    taken = _Taken({channel.source: [] for channel in mapping.channels})
    damage: list[str] = []
    schemas: dict[int, Any] = {}
    connections: dict[int, Any] = {}
    decoders = DecoderFactory()
    known: set[str] = set()
    count = 0
    for record in read_records(path, damage):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif not isinstance(record, Message):
            connections[record.id] = record
            known.add(record.topic)
            if record.topic in topics:
                schema = schemas.get(record.schema_id)
                topics[record.topic].meet(path, schema.name if schema else "no type", record.metadata)
        elif (connection := connections.get(record.channel_id)) and connection.topic in topics:
            try:
                decode = decoders.decoder_for(connection.message_encoding, schemas.get(connection.schema_id))
                message: Any = decode(record.data) if decode else None
            except Exception:  # the decoder raises different errors for each kind of damage
                message = None
            if message is None:
                taken.left_out["messages that cannot be decoded"] += 1
                continue
            taken.take(topics[connection.topic], mapping.clock, record, message)
            count += 1
            if progress is not None and count % 5000 == 0:
                progress(count)
    _check_found(path, topics, taken, known, damage)
    stamps = [row.stamp for listed in taken.rows.values() for row in listed]
    begin, last = min(stamps), max(stamps)
    rows = {}
    for channel in mapping.channels:
        held = [row for row in taken.rows[channel.source] if span().holds(1e-9 * (row.stamp - begin))]
        if not held:
            raise span().nothing(path, 1e-9 * (last - begin))
        rows[channel.source] = _of_one(path, channel, held)
    sources = {
        source: SourceSamples(
            np.array([row.value for row in listed]),
            np.zeros(len(listed), dtype=np.int64),
            np.array([row.stamp - begin for row in listed]) * 1e-9,
        )
        for source, listed in rows.items()
    }
    return Recording(
        sources,
        np.zeros(0),
        np.zeros(0),
        None,
        missing=tuple(f"{path} {text}" for text in damage),
        left_out=tuple(taken.left_out.items()),
        warnings=tuple(_untold(topics)),
    )


def _check_found(path: Path, topics: Mapping[str, _Topic], taken: _Taken, known: set[str], damage: list[str]) -> None:
    """Refuse an MCAP in which a topic, a joint or all of its values are missing."""
    so_far = f" (it {damage[0]})" if damage else ""
    for name, topic in topics.items():
        for channel in topic.channels:
            if taken.rows[channel.source]:
                continue
            place = channel.place
            assert place is not None
            if channel.source in taken.lacking:
                raise ZygosError(f"{channel.where}: messages on {name} in {path.name} {taken.lacking[channel.source]}")
            if not known or "messages that cannot be decoded" in taken.left_out:
                raise ZygosError(
                    f"{path}: not a readable MCAP with messages of ROS 2{so_far}; remedy: record it again, or repair "
                    "it with `mcap recover`"
                )
            if name not in known:
                remedy = closest(name, sorted(known), "topics")
                raise ZygosError(
                    f'{channel.where}.topic: there is no "{name}" in {path.name}{so_far}; remedy: {remedy}'
                )
            joints = sorted({joint for names in topic.lists for joint in names})
            remedy = closest(place.joint, joints, "joints") if place.joint and joints else "record it"
            raise ZygosError(
                f"{channel.where}: {path.name} has no message on {channel.source}{so_far}; remedy: {remedy}"
            )


def _of_one(path: Path, channel: Channel, rows: list[_Row]) -> list[_Row]:
    """The values of one publisher in the order of reception, or of several one after the other. Errors: ZygosError
    where several publish at the same time, and for a publisher that is not there."""
    assert channel.place is not None
    chosen = channel.place.publisher
    rows = sorted(rows, key=lambda row: row.logged)
    counts = Counter(row.publisher for row in rows)
    often = Counter(name for publisher in counts for name in publisher.names if name)
    names = {one: next(name for name in one.names if often[name] == 1) for one in counts}
    if chosen:
        rows = [row for row in rows if chosen in row.publisher.names]
        if not rows:
            raise ZygosError(
                f'{channel.where}.publisher: {channel.source} has no "{chosen}" in {path.name}; remedy: '
                f"{closest(chosen, names.values(), 'publishers')}"
            )
    spans = {one: [row.logged for row in rows if row.publisher == one] for one in counts}
    ends = sorted((times[0], times[-1]) for times in spans.values() if times)
    if any(after[0] < before[1] for before, after in pairwise(ends)):
        listed = ", ".join(f'"{names[one]}" ({count:,} messages)' for one, count in counts.most_common())
        raise ZygosError(
            f"{channel.where}: {channel.source} has {len(counts)} publishers at once in {path.name}: {listed}; remedy: "
            f'choose one, for instance with publisher = "{names[counts.most_common(1)[0][0]]}"'
        )
    return rows


def _untold(topics: Mapping[str, _Topic]) -> Iterator[str]:
    """Warnings about publishers that cannot be told apart."""
    for name, topic in topics.items():
        if topic.publishers > max(1, len(topic.lists)):
            yield (
                f"{name} had {topic.publishers} publishers when it was recorded, and the messages do not say from whom "
                "they are: check that only one of them sends these joints"
            )

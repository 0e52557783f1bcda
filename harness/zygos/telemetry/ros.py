"""Messages of ROS 2 in an MCAP: joint states and rates of a gyro, as a `Recording`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from zygos.errors import ZygosError
from zygos.files.inputs import local, suffix
from zygos.runs.span import span
from zygos.telemetry.map import Channel, Map, Recording, SourceSamples, closest

_TYPES = {"JointState": "sensor_msgs/msg/JointState", "Imu": "sensor_msgs/msg/Imu"}


def is_mcap(path: Path) -> bool:
    """Whether an input is an MCAP: by its suffix, or for standard input by its first bytes."""
    return suffix(path) == ".mcap"


def check_mcap(path: Path) -> None:
    """Refuse an MCAP that does not exist."""
    if not local(path).is_file():
        raise ZygosError(f"{path}: no such file; remedy: give an MCAP that exists")


def read_mcap(path: Path, mapping: Map, progress: Callable[[int], None] | None = None) -> Recording:
    """Read the values that a map names; times are those of the headers, or of the reception, as the map's clock says.

    progress is called from time to time with the number of messages. Errors: ZygosError for an MCAP that cannot be
    read, a topic or joint that is missing, a message of another type, or headers without time.
    """
    check_mcap(path)
    try:
        from mcap.exceptions import McapError  # noqa: PLC0415  (an extra: only MCAP needs it)
        from mcap.reader import make_reader  # noqa: PLC0415
        from mcap_ros2.decoder import DecoderFactory  # noqa: PLC0415
    except ImportError:
        raise ZygosError(
            f"{path}: .mcap needs mcap and mcap-ros2-support, which are not installed; remedy: pip install 'zygos[ros]'"
        ) from None
    channels: dict[str, list[Channel]] = {}
    for channel in mapping.channels:
        assert channel.place is not None
        channels.setdefault(channel.place.topic, []).append(channel)
    values: dict[str, list[tuple[int, float]]] = {channel.source: [] for channel in mapping.channels}
    joints: set[str] = set()
    try:
        with local(path).open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            _check_topics(path, reader.get_summary(), channels)
            for count, one in enumerate(reader.iter_decoded_messages(topics=list(channels)), start=1):
                stamp = _stamp(path, one, mapping)
                joints.update(getattr(one.decoded_message, "name", ()))
                for channel in channels[one.channel.topic]:
                    value = _value(path, channel, one.decoded_message)
                    if value is not None:
                        values[channel.source].append((stamp, value))
                if progress is not None and count % 5000 == 0:
                    progress(count)
    except ZygosError:
        raise
    except Exception as error:  # the reader and the decoder raise different errors for each kind of damage
        kind = str(error) if isinstance(error, McapError) and str(error) else type(error).__name__
        raise ZygosError(
            f"{path}: not a readable MCAP with messages of ROS 2 ({kind}); remedy: record it again, or repair it with "
            "`mcap recover`"
        ) from error
    for channel in mapping.channels:
        if not values[channel.source]:
            named = channel.place is not None and channel.place.joint
            remedy = closest(named, sorted(joints), "joints") if named and joints else "record it"
            raise ZygosError(f"{channel.where}: {path.name} has no message on {channel.source}; remedy: {remedy}")
    begin = min(rows[0][0] for rows in values.values())
    last_s = 1e-9 * (max(rows[-1][0] for rows in values.values()) - begin)
    values = {name: [row for row in rows if span().holds(1e-9 * (row[0] - begin))] for name, rows in values.items()}
    if not all(values.values()):
        raise span().nothing(path, last_s)
    sources = {
        source: SourceSamples(
            np.array([value for _, value in rows]),
            np.zeros(len(rows), dtype=np.int64),
            np.array([stamp - begin for stamp, _ in rows]) * 1e-9,
        )
        for source, rows in values.items()
    }
    return Recording(sources, np.zeros(0), np.zeros(0), None)


def _check_topics(path: Path, summary: Any, channels: dict[str, list[Channel]]) -> None:
    """Refuse topics that the summary of an MCAP does not have, or that have messages of another type."""
    if summary is None:
        return
    types = {
        channel.topic: summary.schemas[channel.schema_id].name if channel.schema_id in summary.schemas else "no type"
        for channel in summary.channels.values()
    }
    for topic, wanted in channels.items():
        first = wanted[0]
        if topic not in types:
            raise ZygosError(
                f'{first.where}.topic: there is no "{topic}" in {path.name}; remedy: {closest(topic, types, "topics")}'
            )
        for channel in wanted:
            expected = _TYPES["Imu" if channel.quantity == "rate" else "JointState"]
            if types[topic] != expected:
                raise ZygosError(
                    f"{channel.where}.topic: {topic} has messages of type {types[topic]}, not {expected}; remedy: name "
                    "a topic of that type"
                )


def _stamp(path: Path, one: Any, mapping: Map) -> int:
    """Time of a message, ns."""
    if mapping.clock.kind == "receive":
        return int(one.message.log_time)
    stamp = one.decoded_message.header.stamp
    found = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    if found == 0:
        raise ZygosError(
            f"{mapping.clock.where}.source: a header on {one.channel.topic} in {path.name} has no time; remedy: write "
            'source = "receive"'
        )
    return found


def _value(path: Path, channel: Channel, message: Any) -> float | None:
    """Value of a channel in a message; None if the message is about other joints. Errors: ZygosError where the message
    names the joint, but has no such value."""
    place = channel.place
    assert place is not None
    if not place.joint:
        return float(getattr(message.angular_velocity, place.field))
    names = list(message.name)
    if place.joint not in names:
        return None
    listed = getattr(message, place.field)
    if len(listed) != len(names):
        raise ZygosError(
            f"{channel.where}: messages on {place.topic} in {path.name} have {len(names)} joints and {len(listed)} "
            f"values of {place.field}; remedy: record the {place.field} of every joint"
        )
    return float(listed[names.index(place.joint)])

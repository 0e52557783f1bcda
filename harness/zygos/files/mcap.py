# SPDX-License-Identifier: MIT
"""Signals of joints as messages of ROS 2 in an MCAP, which PlotJuggler, Foxglove and Rerun show."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError, installs
from zygos.files.output import write_bytes

Floats = NDArray[np.float64]

BEGIN_S = 1.0
"""Time that is added to all: in ROS a time of 0 is none."""
UNITS = {"position": "rad", "velocity": "rad/s", "effort": "Nm"}
_RULE = "=" * 80
_STATE = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@dataclass(frozen=True)
class Topic:
    """Messages sensor_msgs/msg/JointState of N joints at m instants."""

    name: str
    joints: tuple[str, ...]
    t: Floats
    """(m,) s."""
    position: Floats
    """(m, N) rad."""
    velocity: Floats | None
    """(m, N) rad/s; None: empty in the messages."""
    effort: Floats | None
    """(m, N) Nm behind the gear, or the unit that `units` of the file states; None: empty."""


def check_mcap_name(path: Path | None) -> None:
    """Refuse a name that is no MCAP's, and an installation that writes none. Errors: ZygosError."""
    if path is None:
        return
    if path.suffix != ".mcap":
        raise ZygosError(f"{path}: not a name for an MCAP; remedy: give it the suffix .mcap")
    try:
        import mcap_ros2.writer  # noqa: PLC0415, F401  (an extra)
    except ImportError:
        raise ZygosError(f"{path}: .mcap needs mcap and mcap-ros2-support; remedy: {installs('ros')}") from None


def write_mcap(path: Path, topics: Sequence[Topic], units: Mapping[str, str] | None = None) -> None:
    """Write topics, completely or not at all, with the units as metadata. units: where they are others than `UNITS`."""
    from mcap_ros2.writer import Writer  # noqa: PLC0415  (an extra)

    content = io.BytesIO()
    writer: Any = Writer(content)
    schema = writer.register_msgdef("sensor_msgs/msg/JointState", _STATE)
    order = sorted((float(t), number, row) for number, topic in enumerate(topics) for row, t in enumerate(topic.t))
    for t, number, row in order:
        topic = topics[number]
        stamp = round((t + BEGIN_S) * 1e9)
        message = {
            "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""},
            "name": list(topic.joints),
            "position": topic.position[row].tolist(),
            "velocity": [] if topic.velocity is None else topic.velocity[row].tolist(),
            "effort": [] if topic.effort is None else topic.effort[row].tolist(),
        }
        writer.write_message(topic.name, schema, message, log_time=stamp)
    writer.add_metadata("units", dict(UNITS | dict(units or {})))
    writer.finish()
    write_bytes(path, content.getvalue())

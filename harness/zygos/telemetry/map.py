# SPDX-License-Identifier: MIT
"""Telemetry of other systems: which signal of a foreign log or table is which reading of the arm, in which unit
(`map.toml`).

A CAN log is decoded by cantools with the owner's DBC files, a table is read by its column names, an MCAP by its topics
(`zygos.telemetry.ros`). In each case the result is a `Recording`: each signal's values with their times.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.files.tables import Columns, read_columns
from zygos.files.toml import Table
from zygos.runs.span import span

Floats = NDArray[np.float64]
Quantity = Literal["angle", "torque", "rate", "time"]
Field = Literal["q", "theta", "tau", "omega"]
Source = Literal["sync", "signal", "column", "receive", "header"]
Input = Literal["log", "table", "mcap"]
"""Kind of a recording: a CAN log, a table, or an MCAP with messages of ROS 2."""
Interpolation = Literal["linear", "cubic"]

UNITS: dict[Quantity, dict[str, float]] = {
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "turn": 2 * math.pi, "counts": math.nan},
    "torque": {"Nm": 1.0, "mNm": 1e-3, "kNm": 1e3, "A": math.nan, "mA": math.nan},
    "rate": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": math.pi / 180,
        "mdeg/s": math.pi / 180e3,
        "turn/s": 2 * math.pi,
        "rpm": 2 * math.pi / 60,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""SI units per unit; NaN where another key of the map states it: counts_per_turn for counts, torque_constant for A,
mA."""
SI_UNIT: dict[Quantity, str] = {"angle": "rad", "torque": "Nm", "rate": "rad/s", "time": "s"}

_INTERPOLATIONS: tuple[Interpolation, ...] = ("linear", "cubic")
SPELLINGS = {
    "°": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "rev": "turn", "turns": "turn",
    "N·m": "Nm", "N m": "Nm", "N.m": "Nm", "N*m": "Nm", "mN·m": "mNm", "mN.m": "mNm", "Amps": "A", "1/min": "rpm",
    "r/min": "rpm", "RPM": "rpm", "°/s": "deg/s", "dps": "deg/s", "µs": "us", "sec": "s",
}  # fmt: skip
"""Other spellings of these units in DBC files."""


@dataclass(frozen=True)
class Place:
    """Where a value is in messages of ROS 2."""

    topic: str
    field: str
    """position, effort, x, y or z."""
    joint: str = ""
    """Its name in a JointState; empty for an Imu."""
    publisher: str = ""
    """Whose messages are taken; empty: all."""

    def __str__(self) -> str:
        """As in tables and messages."""
        return (
            f"{self.topic}:{self.joint}.{self.field}" if self.joint else f"{self.topic}:angular_velocity.{self.field}"
        )


@dataclass(frozen=True)
class Channel:
    """One reading of the arm: its source, and SI = gain * value + offset."""

    label: str
    """Name for people: shoulder.motor, gyro.x."""
    field: Field
    """Field of `Cycles` to which it belongs."""
    index: int
    """Its column in that field."""
    quantity: Quantity
    source: str
    """The source: message.signal, the name of a column, or the text of `place`."""
    unit: str
    gain: float
    offset: float
    bare: bool
    """Whether the map states neither scale nor offset: then the source's own unit must be the map's."""
    where: str
    """File and key in the map, for error messages."""
    place: Place | None = None
    """Of a channel in an MCAP."""
    in_message: bool = False
    """Whether the source is a signal of a CAN message."""
    scale: float = 1.0
    """Units of the map for one step of the source."""
    turn: float = math.inf
    """Steps of the source for one turn of the angle; infinite where it is no angle."""
    modulo: float | None = None
    """Steps of the source after which the angle starts again, if the map says so."""
    missing: float | None = None
    """Value of the source that means that there is none."""
    delay_s: float = 0.0
    """Time from the measurement to its stamp."""


@dataclass(frozen=True)
class Clock:
    """The source of times: the recording's stamps (`receive`), those of the messages (`header`), a time (`signal`,
    `column`) or a counter of cycles (`sync`)."""

    kind: Source
    source: str = ""
    """The source: message.signal, or the name of a column; empty for `receive` and `header`."""
    unit: str = "s"
    unit_s: float = 1.0
    """Duration of one count or unit, s."""
    modulo: float | None = None
    """Number of counts or units after which the value starts again."""
    interpolation: Interpolation | None = None
    """Interpolation of the signals; None where the counter numbers the cycles."""
    where: str = ""

    @property
    def stamped(self) -> bool:
        """Whether each value has a stamp of its own."""
        return self.kind in ("receive", "header")


@dataclass(frozen=True)
class Map:
    """The content of `map.toml` about the telemetry of an arm."""

    clock: Clock
    channels: tuple[Channel, ...]


@dataclass(frozen=True)
class SourceSamples:
    """The n values of one source, in its own unit, in the order of the recording."""

    value: Floats
    """(n,)"""
    group: NDArray[np.int64]
    """(n,) index of the clock's latest value before or with each value; zeros where there is no clock."""
    stamp: Floats
    """(n,) time after the first value of the recording, s: when it was received, or as its message says; NaN in a
    table."""
    width: float | None = None
    """Of an integer signal of a DBC: the number after which it starts again."""
    first_row: int = 1
    """Of a table: the row of the first value, counted below the names; `--from` leaves out rows."""


@dataclass(frozen=True)
class Recording:
    """Telemetry as it was recorded, with m values of the clock."""

    sources: dict[str, SourceSamples]
    clock: Floats
    """(m,) values of the clock minus the first one, in its own unit; empty where values have stamps of their own."""
    clock_stamp: Floats
    """(m,) receive stamps of the clock, s; NaN in a table."""
    modulo: float | None
    """Number of its units after which the clock starts again."""
    damaged: int = 0
    """Number of frames that the DBC could not decode."""
    missing: tuple[str, ...] = ()
    """Sentences about what is missing in a damaged file, each beginning with its name."""
    remarks: tuple[str, ...] = ()
    """Sentences about what else is unusual in a log, likewise."""
    left_out: tuple[tuple[str, int], ...] = ()
    """What was left out on reading, and how often."""
    warnings: tuple[str, ...] = ()
    """Sentences about faults in what the map does not need, or that only its owner can judge."""


def closest(name: str, known: Iterable[str], noun: str) -> str:
    """A remedy for a name that does not exist."""
    listed = list(known)
    close = difflib.get_close_matches(name, listed, n=1, cutoff=0.5)
    if close:
        return f'did you mean "{close[0]}"?'
    return f"the {noun} are {', '.join(listed[:12])}{' …' if len(listed) > 12 else ''}"


def load_map(path: str | Path, arm: Arm, kind: Input) -> Map:
    """Read `map.toml` for an arm and a kind of recording.

    Errors: ZygosError naming file, key and remedy for anything unknown, missing or contradictory.
    """
    return read_map(Table.load(path, "a map"), arm, kind)


def map_of(content: Mapping[str, Any], name: str, arm: Arm, kind: Input) -> Map:
    """The map with this content, which is called `name` in messages. Errors: as `load_map`."""
    return read_map(Table(content, Path(name)), arm, kind)


def read_map(top: Table, arm: Arm, kind: Input) -> Map:
    """The map of a table with the keys of `map.toml`. Errors: as `load_map`."""
    entries: dict[str, Table] = {}
    names = [joint.name for joint in arm.joints]
    for table in top.tables("joint", "The signals of each joint. Every joint of the arm has an entry."):
        name = table.text("name", "Name of the joint in the arm file.")
        if name not in names:
            raise table.error("name", f'"{name}" is no joint of arm {arm.name}', closest(name, names, "joints"))
        if name in entries:
            raise table.error("name", f'"{name}" appears twice', "keep one [[joint]] per joint")
        entries[name] = table
    missing = [name for name in names if name not in entries]
    if missing:
        raise top.error(
            "joint", f"no entry for {', '.join(missing)} of arm {arm.name}", "give every joint of the arm a [[joint]]"
        )
    channels: list[Channel] = []
    for i, joint in enumerate(arm.joints):
        table = entries[joint.name]
        if not joint.flexible and table.has("link"):
            raise table.error("link", "a rigid joint has only its motor's angle", "remove it")
        kinds: list[tuple[str, str, str, Field, Quantity]] = [
            ("motor", "The angle of the motor.", "", "theta", "angle"),
            ("torque", "The torque of the motor.", "", "tau", "torque"),
        ]
        if joint.flexible:
            only = "required for a flexible joint, refused for a rigid one"
            kinds.insert(0, ("link", "The angle of the link.", only, "q", "angle"))
        for key, meaning, otherwise, field, quantity in kinds:
            entry = table.table(key, meaning, otherwise=otherwise)
            label = f"{joint.name}.{key}"
            channels.append(_channel(entry, label, field, i, quantity, arm, kind, joint.name))
        table.finish()
    if arm.free:
        gyro = top.table(
            "gyro", "The rates of the base.", otherwise="required for an arm with a free base, refused for a fixed one"
        )
        for i, axis in enumerate("xyz"):
            entry = gyro.table(axis, f"The rate about the {axis} axis of the gyro.")
            channels.append(_channel(entry, f"gyro.{axis}", "omega", i, "rate", arm, kind, axis))
        gyro.finish()
    elif top.has("gyro"):
        raise top.error("gyro", f"the base of arm {arm.name} is fixed and has no gyro", "remove [gyro]")
    _check_once(channels)
    clock = _clock(top.table("time", "What says when a value was measured."), arm, kind)
    top.finish()
    _check_delays(channels, clock, kind)
    return Map(clock, tuple(channels))


def _check_once(channels: Sequence[Channel]) -> None:
    """Refuse one source for two readings."""
    first: dict[str, Channel] = {}
    for channel in channels:
        other = first.setdefault(channel.source, channel)
        if other is not channel:
            raise ZygosError(
                f"{channel.where}: {channel.source} is already that of {other.label}; remedy: name the source of "
                f"{channel.label}, or correct that of {other.label}"
            )


def _check_delays(channels: Sequence[Channel], clock: Clock, kind: Input) -> None:
    """Refuse a delay where nothing can be moved in time."""
    for channel in channels:
        if channel.delay_s and clock.kind == "sync":
            other = '"column", column and unit' if kind == "table" else '"receive", without signal and modulo'
            raise ZygosError(
                f'{channel.where}.delay_s: with source = "sync" values are not interpolated, and cannot be moved in '
                f'time; remedy: write in [time] source = {other}, and interpolation = "cubic"'
            )


_NAMED: dict[Input, tuple[str, str]] = {
    "log": ("signal", "a CAN log, which has signals of messages"),
    "table": ("column", "a table, which has columns"),
    "mcap": ("topic", "an MCAP, which has topics"),
}
"""Key that names a source in each kind of recording, and what it is called there."""


def _check_named(table: Table, kind: Input) -> None:
    """Refuse the key that names a source of another kind of recording."""
    key, called = _NAMED[kind]
    for other, _ in _NAMED.values():
        if other != key and table.has(other):
            raise table.error(other, f"the input is {called}", f"name a {key}")


def _source(table: Table, kind: Input, also: str = "") -> str:
    """also: a further condition of the map under which the source is named."""
    _check_named(table, kind)
    if kind == "table":
        meaning = 'Name of the column. The columns of a CSV without names are "1", "2", …'
        return table.text("column", meaning, otherwise=f"required where the input is a table{also}, refused elsewhere")
    meaning = "Message.Signal, as the DBC names them."
    name = table.text("signal", meaning, otherwise=f"required where the input is a CAN log{also}, refused elsewhere")
    if "." not in name:
        raise table.error("signal", f'"{name}" names no signal of a message', 'write "Message.Signal"')
    return name


_ROS_FIELDS: dict[Quantity, str] = {"angle": "position", "torque": "effort"}
"""Field of a JointState that has a quantity."""


def _place(table: Table, quantity: Quantity, name: str) -> Place:
    """name: of the joint in the arm file, or the axis of the gyro."""
    _check_named(table, "mcap")
    topic = table.text(
        "topic",
        "Topic of the messages: sensor_msgs/msg/JointState for a joint (position is the angle, effort the torque), "
        "sensor_msgs/msg/Imu for the gyro.",
        otherwise="required where the input is an MCAP, refused elsewhere",
    )
    publisher = ""
    if table.has("publisher"):
        publisher = table.text(
            "publisher",
            "Whose messages are taken, where several nodes publish the topic: frame_id of their headers, or the number "
            "of their channel in the MCAP.",
            otherwise="all",
        )
    if quantity == "rate":
        return Place(topic, name, publisher=publisher)
    joint = table.text("joint", "Name of the joint in the messages.", name, otherwise="its name in the arm file")
    return Place(topic, _ROS_FIELDS[quantity], joint, publisher)


def _unit(table: Table, quantity: Quantity, otherwise: str = "") -> str:
    unit = table.text("unit", f"Unit of the value: {', '.join(UNITS[quantity])}.", otherwise=otherwise)
    known = UNITS[quantity]
    if unit not in known:
        listed = ", ".join(f'"{name}"' for name in known)
        raise table.error("unit", f'"{unit}" is not a unit of {quantity}', f"write one of {listed}")
    return unit


def _channel(
    table: Table,
    label: str,
    field: Field,
    index: int,
    quantity: Quantity,
    arm: Arm,
    kind: Input,
    name: str,
) -> Channel:
    """name: of the joint in the arm file, or the axis of the gyro."""
    place = _place(table, quantity, name) if kind == "mcap" else None
    source = _source(table, kind) if place is None else str(place)
    unit = _unit(table, quantity)
    si = UNITS[quantity][unit]
    if unit == "counts":
        si = (
            2
            * math.pi
            / table.number(
                "counts_per_turn",
                "Counts of the encoder in one turn.",
                above=0.0,
                otherwise='required where unit is "counts", refused elsewhere',
            )
        )
    elif quantity == "torque":
        si = _torque_unit(table, unit, arm)
    bare = not (table.has("scale") or table.has("offset"))
    scale = table.number("scale", "Units for one step of the source. Not 0.", 1.0)
    offset = table.number("offset", "Value in units that is added after scaling, before the sign.", 0.0, unit=unit)
    sign = table.integer(
        "sign", "1, or -1 where the source counts against the axis of the arm file.", 1, low=-1, high=1
    )
    if scale == 0.0:
        raise table.error("scale", "is 0", "write the units per value of the source")
    if sign == 0:
        raise table.error("sign", "is 0", "write 1 or -1")
    delay_s = table.number(
        "delay_s", "Time from the measurement to its stamp. It is subtracted from the stamps.", 0.0, unit="s"
    )
    missing = modulo = None
    if table.has("missing"):
        missing = table.number(
            "missing",
            "Value of the source that means that there is none. Such samples are left out, with the rest of their "
            "message or row.",
            otherwise="every value is one",
        )
    if quantity == "angle" and table.has("modulo"):
        modulo = table.number(
            "modulo",
            "Number of units after which the angle starts again.",
            above=0.0,
            unit=unit,
            otherwise="the width of an integer signal in the DBC; elsewhere the angle does not start again",
        )
    # angles and torques may be given on either side of the gear; `Cycles` has angles after it and torques before it
    if quantity == "torque":
        geared = _beyond_gear(table, arm)
    else:
        sides = ("output", "rotor")
        geared = field == "theta" and (
            table.choice("side", "The side of the gear at which the encoder of the motor sits.", sides) == "rotor"
        )
    factor = sign * si / (arm.joints[index].gear_ratio if geared else 1.0)
    table.finish()
    return Channel(
        label,
        field,
        index,
        quantity,
        source,
        unit,
        factor * scale,
        factor * offset,
        bare,
        f"{table.file}: {table.where}",
        place,
        in_message=kind == "log",
        scale=abs(scale),
        turn=2 * math.pi / abs(si * scale) if quantity == "angle" else math.inf,
        modulo=None if modulo is None else modulo / abs(scale),
        missing=missing,
        delay_s=delay_s,
    )


def _torque_unit(table: Table, unit: str, arm: Arm) -> float:
    """One unit in Nm, or in A where the arm file says that torques are currents."""
    amperes = {"A": 1.0, "mA": 1e-3}.get(unit)
    if arm.torque_unit == "A":
        if amperes is None:
            raise table.error(
                "unit",
                f'"{unit}" is no current, but arm {arm.name} has torque_unit = "A"',
                'write "A" or "mA" if the values are currents, else remove torque_unit from the arm file',
            )
        if table.has("torque_constant"):
            raise table.error(
                "torque_constant",
                f'arm {arm.name} has torque_unit = "A", so that its torques remain currents',
                "remove it, or remove torque_unit from the arm file if the constant is known",
            )
        return amperes
    if amperes is None:
        return UNITS["torque"][unit]
    constant = table.number(
        "torque_constant",
        'Torque for one ampere on the side that `at` names: that of the motor, or with at = "output" that of motor and '
        "gear.",
        above=0.0,
        unit="Nm/A",
        otherwise=(
            'required where unit is "A" or "mA", refused elsewhere, and where the arm file has torque_unit = "A"'
        ),
    )
    return constant * amperes


def _beyond_gear(table: Table, arm: Arm) -> bool:
    """Whether a stated torque has to be divided by the gear ratio, to become one of the side that the arm file names.
    A torque of the motor is not that of a sensor behind the gear, which the rotor and friction do not reach."""
    behind = arm.torque_at == "joint"
    stated = table.choice(
        "at",
        "The side of the gear at which the torque is stated.",
        ("rotor", "output"),
        "output" if behind else "rotor",
        otherwise='"output" where the arm file has torque_at = "joint", else "rotor"',
    )
    if behind and stated == "rotor":
        raise table.error(
            "at",
            f'"rotor" is before the gear, but arm {arm.name} has torque_at = "joint", a sensor behind it',
            'write "output", or torque_at = "rotor" in the arm file',
        )
    return stated == "output" and not behind


_CLOCKS: dict[Input, tuple[Source, ...]] = {
    "log": ("sync", "signal", "receive"),
    "table": ("sync", "column"),
    "mcap": ("header", "receive"),
}
"""Clocks of each kind of recording."""


def _clock(table: Table, arm: Arm, recorded: Input) -> Clock:
    kind = table.choice(
        "source",
        'The clock. "sync": a counter of cycles, nothing is interpolated. "signal" or "column": a time that is '
        'recorded beside the values. "header": the stamp in the header of each message. "receive": the time at which '
        "each frame or message was received.",
        _CLOCKS[recorded],
    )
    source, unit, unit_s, modulo = "", "s", 1.0, None
    stamped = kind in ("receive", "header")
    if not stamped:
        source = _source(table, recorded, ' and source is not "receive"' if recorded == "log" else "")
        if table.has("modulo"):
            modulo = table.number(
                "modulo",
                "Counts, or units of time, after which the clock starts again at 0.",
                above=0.0,
                otherwise="the width of the signal in the DBC; in a table the clock does not start again",
            )
    interpolation: Interpolation | None = None
    if kind == "sync":
        unit = "counts"
        unit_s = table.number(
            "period_s",
            "Time between two counts of the counter.",
            arm.period_s,
            above=0.0,
            unit="s",
            otherwise='period_s of the arm file; refused where source is not "sync"',
        )
        cycle = arm.period_s / unit_s
        if cycle < 0.5 or abs(cycle - round(cycle)) > 1e-6 * cycle:
            raise table.error(
                "period_s",
                f"a count lasts {unit_s:g} s, and {arm.period_s:g} s, a period of arm {arm.name}, is not a multiple "
                "of it",
                "correct this period_s, or that of the arm file",
            )
    else:
        if not stamped:
            unit = _unit(table, "time", 'required where source is "signal" or "column", refused elsewhere')
            unit_s = UNITS["time"][unit]
        interpolation = table.choice(
            "interpolation",
            "How values are interpolated at the instants of the cycles.",
            _INTERPOLATIONS,
            otherwise='required where source is not "sync", refused elsewhere',
        )
    table.finish()
    return Clock(kind, source, unit, unit_s, modulo, interpolation, f"{table.file}: {table.where}")


def read_table(path: Path, mapping: Map) -> Recording:
    """Read the columns that a map names; rows without time are left out. Errors: ZygosError for a column that is
    missing or not numeric."""
    damage: list[str] = []
    columns = read_columns(path, damage)
    raw = _column(path, columns, mapping.clock.source, mapping.clock.where)
    if raw.dtype.kind == "u":
        raw = raw.astype(np.int64)
    timed = np.isfinite(raw)
    if not timed.any():
        raise ZygosError(
            f"{mapping.clock.where}: column {mapping.clock.source} of {path.name} has no value; remedy: name the "
            "column of the time"
        )
    modulo = mapping.clock.modulo
    clock = (raw[timed] - raw[timed][0]).astype(np.float64)  # ns since 1970 have more digits than a float can store
    kept = span().rows(path, (clock if modulo is None else np.unwrap(clock, period=modulo)) * mapping.clock.unit_s)
    first = int(np.flatnonzero(timed)[np.argmax(kept)]) + 1
    clock = clock[kept] - clock[kept][0]
    nowhere = np.full(len(clock), np.nan)
    rows = np.arange(len(clock))
    sources = {
        channel.source: SourceSamples(
            _column(path, columns, channel.source, channel.where)[timed][kept].astype(np.float64),
            rows,
            nowhere,
            first_row=first,
        )
        for channel in mapping.channels
    }
    return Recording(
        sources,
        clock,
        nowhere,
        modulo,
        missing=tuple(f"{path} {text}" for text in damage),
        left_out=(("rows without time", int(np.count_nonzero(~timed))),),
    )


def _column(path: Path, columns: Columns, name: str, where: str) -> NDArray[Any]:
    if name not in columns:
        raise ZygosError(f'{where}: {path.name} has no column "{name}"; remedy: {closest(name, columns, "columns")}')
    values = columns[name]
    if values.dtype.kind not in "iuf":
        raise ZygosError(
            f'{where}: column "{name}" of {path.name} has values that are not numbers ({_first_text(values)}); '
            "remedy: export numbers, and a time in seconds, or remove that row"
        )
    return values


def _first_text(values: NDArray[Any]) -> str:
    """The first value of a column that is no number, with its row, or the type of the column."""
    for row, value in enumerate(values.tolist(), start=1):
        try:
            float(value or "nan")
        except (TypeError, ValueError):
            if isinstance(value, str):
                return f'row {row} below the names has "{value[:40]}"'
            break
    return str(values.dtype)

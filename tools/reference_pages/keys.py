# SPDX-License-Identifier: MIT
"""The pages of the keys of arm.toml, model.toml, scenario.toml, map.toml and answers.toml.

The readers themselves read the files in tools/samples/, which have every key, and a `Recorder` notes what each reader
states of a key where it reads it.
"""

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from reference_pages.markdown import page, table
from zygos.arm import load_arm, read_arm
from zygos.effects import CATALOGUE, Kind
from zygos.effects.kind import Held
from zygos.files import toml
from zygos.files.toml import Entry, Table
from zygos.model.model import read_model
from zygos.simulation.scenario import read_scenario
from zygos.telemetry.map import Input, read_map
from zygos.urdf import answers

SAMPLES = Path(__file__).resolve().parents[1] / "samples"


@dataclass(frozen=True)
class Read:
    """A key that was read."""

    table: str
    """Dotted path of its table, without places in arrays: joint.link_encoder; empty for the top of the file."""
    entry: Entry
    place: tuple[str, int, int]
    """File, last line and last column of the call that read it."""


class Recorder(Table):
    """A table that notes what readers ask of it."""

    reads: ClassVar[list[Read]] = []
    arrays: ClassVar[set[str]] = set()
    """Dotted paths of arrays of tables."""

    def _take(self, entry: Entry) -> Any:
        path = without_places(self.where)
        if entry.kind.startswith("at least one [["):
            self.arrays.add(without_places(self._name(entry.key)))
        self.reads.append(Read(path, entry, _caller()))
        return super()._take(entry)


def without_places(where: str) -> str:
    """A dotted path without the places in arrays: joint[0].motor_encoder becomes joint.motor_encoder."""
    return ".".join(part.partition("[")[0] for part in where.split("."))


def _caller() -> tuple[str, int, int]:
    """Where the reader called the table: file, last line, last column."""
    frame = sys._getframe(1)
    while frame.f_code.co_filename in (__file__, toml.__file__):
        assert frame.f_back is not None
        frame = frame.f_back
    _, line, _, column = list(frame.f_code.co_positions())[frame.f_lasti // 2]
    assert line is not None and column is not None
    return str(Path(frame.f_code.co_filename).resolve()), line, column


def recorded(read: Callable[[Recorder], object], file: Path) -> list[Read]:
    """What a reader asks of a file."""
    Recorder.reads.clear()
    read(Recorder.load(file))
    return list(Recorder.reads)


@dataclass(frozen=True)
class File:
    """A kind of file, and how its keys are read."""

    name: str
    title: str
    intro: str
    read: Callable[[Recorder], object]
    also: str = ""
    """What else the page holds."""
    named: tuple[str, ...] = ()
    """Tables whose keys are names of the user's, and so stand in the page as NAME."""

    @property
    def samples(self) -> list[Path]:
        """The files of this kind in tools/samples/."""
        return [
            path for folder in ("free", "fixed", "space", "ros") if (path := SAMPLES / folder / self.name).is_file()
        ]

    def reads(self) -> list[Read]:
        """What the reader asks of the samples."""
        return [self._renamed(one) for sample in self.samples for one in recorded(self.read, sample)]

    def _renamed(self, one: Read) -> Read:
        first, _, rest = one.table.partition(".")
        if first not in self.named:
            return one
        if rest:
            return replace(one, table=f"{first}.NAME")
        return replace(one, entry=replace(one.entry, key="NAME"))


RECORDINGS: dict[str, Input] = {"free": "log", "fixed": "table", "ros": "mcap"}
"""Which kind of recording the map of a sample is for."""


def _read_map(top: Table) -> object:
    folder = top.file.parent.name
    arm = load_arm(SAMPLES / ("free" if folder == "free" else "fixed") / "arm.toml")
    return read_map(top, arm, RECORDINGS[folder])


SITES = {
    "motor": ("the motor of a joint, before the gear; its rate after it", "rotor torque −c f"),
    "link": ("the link of a joint", "link torque −c f"),
    "load": ("the gear of a joint, on its link", "link torque −c f"),
    "spring": ("the spring of a joint", "link torque +c f, rotor torque −c f / n"),
    "torque": ("the torque of a joint's motor", "the torque that acts exceeds the reported one by c f"),
    "rotor": ("the rotor of a joint", "as stated"),
    "base": ("the base; there is no key joint", "torque +c f on the base"),
    "field": ("all bodies; there is no key joint", "as stated"),
    "body": ("the bodies; there is no key joint", "as stated"),
    "sensor": ("an encoder of a joint, or the gyro, which has no key joint", "as stated"),
}


def _acts_at(kind: Kind) -> str:
    place = f"sensor: {kind.sensor}" if kind.sensor else kind.place
    world = {"plane": "; arms in a plane", "space": "; arms in space", "": ""}[kind.world]
    return place + ("; x, y, z in space" if kind.axes else "") + world


def _held(held: Held) -> str:
    return f"{held.how}: {held.by}" if held.by else held.how


EFFECTS = "\n\n".join(
    (
        "## The kinds of effects",
        "An effect has the coefficient c and a law f. What they do depends on where it acts. All angles and rates are "
        "after the gear, n is the gear ratio, τ the reported torque before the gear, sat a sign that is linear between "
        "−1 and 1.",
        table(("Acts at", "What that is", "What the effect does"), [(key, *text) for key, text in SITES.items()]),
        "A law with a shape has the key `shape` with its value, and optionally `shape_unit`. An effect with components "
        "has the key `component`. The flight library estimates the kinds that are marked; the others are refused by "
        "`zygos compile-model`.",
        table(
            ("Kind", "Effect", "Unit", "Acts at", "Law f", "Shape", "Value", "Flies"),
            [
                (
                    f"`{kind.key}`",
                    kind.title,
                    kind.unit,
                    _acts_at(kind),
                    kind.formula,
                    f"{kind.shape_title}, {kind.shape_unit}" if kind.shapes else "",
                    ">= 0" if kind.positive else "any",
                    "yes" if kind.flies else "",
                )
                for kind in CATALOGUE.values()
            ],
        ),
        "### In the files of other simulators",
        "What `zygos explain` writes of an effect into the MJCF of an arm, or the URDF of one with rigid joints "
        "([simulators](../simulators.md)). *Exact* and *approximate* are in the file. A *snippet* is Python for the "
        "loop that controls the simulation, written beside the file. *No*: it is no part of a robot, but of its "
        "sensors, of its motion, or of an instant.",
        table(
            ("Kind", "MJCF", "URDF"),
            [(f"`{kind.key}`", _held(kind.mjcf), _held(kind.urdf)) for kind in CATALOGUE.values()],
        ),
    )
)
FILES = (
    File(
        "arm.toml",
        "what the hardware is",
        "An arm file describes the joints, the encoders, the gyro, the timing and the declared noise. "
        "It holds no masses and no lengths; these belong to [model.toml](model.md).",
        read_arm,
    ),
    File(
        "model.toml",
        "what is believed of the dynamics",
        "A model file has one of two forms: bodies and joints, or base parameters. "
        "A value whose type is number or table is taken as exact where it is written as a number.",
        read_model,
        also=EFFECTS,
        named=("parameters", "correlation"),
    ),
    File(
        "scenario.toml",
        "what is done with the arm",
        "A scenario is what `zygos simulate` runs: arm, model, manoeuvre and controller.",
        read_scenario,
    ),
    File(
        "map.toml",
        "which foreign signal is which quantity of the arm",
        "A map tells `zygos convert` where the readings of the arm are in a foreign CAN log, table or MCAP, and in "
        "which units ([telemetry](../telemetry.md)).",
        _read_map,
    ),
)


@dataclass(frozen=True)
class Row:
    """One line of a page."""

    key: str
    kind: str
    unit: str
    bounds: str
    default: str
    meaning: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The line as it is printed."""
        return (f"`{self.key}`", self.kind, self.unit, self.bounds, self.default, self.meaning)


HEADS = ("Key", "Type", "Unit", "Range", "Default", "Meaning")
ABOVE = "as stated above"


def default_of(entry: Entry) -> str:
    """What holds where a key is absent."""
    if entry.otherwise:
        return entry.otherwise
    if entry.default is None:
        return "required"
    if entry.default in ({}, []):
        return "none"
    return json.dumps(entry.default)


def rows(reads: Iterable[Read]) -> dict[str, list[Row]]:
    """The lines of each table. Several reads of one key make one line."""
    keys: dict[tuple[str, str], list[Entry]] = {}
    for one in reads:
        keys.setdefault((one.table, one.entry.key), []).append(one.entry)
    tables: dict[str, list[Row]] = {}
    for (where, key), entries in keys.items():
        kinds = _once(kind for entry in entries for kind in _kinds(entry))
        lengths = {kind for kind in kinds if kind.startswith("array of") and kind.endswith("numbers")}
        if len(lengths) > 1 or "array of 1 numbers" in lengths:  # its length depends on the arm
            kinds = _once("array of numbers" if kind in lengths else kind for kind in kinds)
        in_unit = (where, "unit") in keys and key in ("value", "sigma", "offset", "modulo") and where != "time"
        row = Row(
            key,
            " or ".join(kinds),
            "as `unit` says" if in_unit else _joined(entry.unit for entry in entries),
            _joined(_range(entry.bounds) for entry in entries),
            _joined(map(default_of, entries)),
            " ".join(_once(entry.meaning for entry in entries)),
        )
        tables.setdefault(where, []).append(row)
    return {
        where: sorted(lines, key=lambda row: row.kind in ("table", "array of tables"))
        for where, lines in tables.items()
    }


def _range(bounds: Sequence[str]) -> str:
    if len(bounds) == 2 and bounds[0].startswith(">= ") and bounds[1].startswith("<= "):
        return f"{bounds[0][3:]} … {bounds[1][3:]}"
    return ", ".join(bounds)


def _once(words: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(word for word in words if word))


def _joined(words: Iterable[str]) -> str:
    return " or ".join(_once(words))


def _kinds(entry: Entry) -> list[str]:
    if entry.kind.startswith("at least one"):
        return ["array of tables"]
    if entry.kind.startswith('"'):
        return [f"`{word}`" for word in entry.kind.split(" or ")]
    return [entry.kind.removeprefix("an ").removeprefix("a ")]


def _heading(where: str) -> str:
    if not where:
        return "At the top of the file"
    return f"`[[{where}]]`" if where in Recorder.arrays else f"`[{where}]`"


def sections(tables: dict[str, list[Row]]) -> list[tuple[list[str], list[Row]]]:
    """Tables with the same keys and meanings share a section. Where their units differ, the key itself states them."""
    shared: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for where, lines in tables.items():
        alike = tuple((row.key, row.meaning) for row in lines)
        shared.setdefault(alike, []).append(where)
    found = []
    for group in shared.values():
        common = []
        for same in zip(*(tables[where] for where in group), strict=True):
            columns = zip(*(row.cells[1:] for row in same), strict=True)
            cells = [column[0] if len(set(column)) == 1 else ABOVE for column in columns]
            common.append(Row(same[0].key, *cells))
        found.append((group, common))
    return found


def keys_page(file: File) -> str:
    """The page of one kind of file."""
    parts = []
    for group, lines in sections(rows(file.reads())):
        parts.append("## " + ", ".join(map(_heading, group)))
        parts.append(table(HEADS, [row.cells for row in lines]))
    intro = file.intro + (
        " A key that is not listed here is refused. The column of defaults states which keys are required."
    )
    return page(f"`{file.name}`: {file.title}", intro, *parts, *filter(None, [file.also]))


def answers_page() -> str:
    """The page of answers.toml, whose values the readers of arm.toml and model.toml check."""
    arm, model = (rows(file.reads()) for file in FILES[:2])
    top, joint = {row.key: row for row in arm[""]}, {row.key: row for row in arm["joint"]}
    drive = {row.key: row for row in model["joint"]}
    heads = ("Key", "Type", "Unit", "Range", "Usual values", "Meaning", "File")
    of_arm = [line for key in answers.TOP for line in _answers(key, top[key], arm.get(key, []), "arm")]
    of_joint = [
        line
        for key in answers.JOINT
        for line in (
            _answers(key, joint[key], arm.get(f"joint.{key}", []), "arm")
            if key in joint
            else _answers(key, drive[key], [], "model")
        )
    ]
    intro = (
        "`zygos import` asks for the values that a URDF does not contain. With `--answers answers.toml` they are read "
        "from a file. They go into the files that the last column names; the defaults are on the pages of these files. "
        "`[default]` applies to every joint, and `[joint.NAME]` to the joint of that name in the URDF; it has priority "
        "over `[default]`. A key with usual values is required. For a fixed base, `gravity` is `[0, 0, -9.81]` unless "
        "it is given. A value with a standard deviation is written as in [model.toml](model.md)."
    )
    return page(
        "`answers.toml`: what a URDF does not say",
        intro,
        "## At the top of the file",
        table(heads, of_arm),
        "## `[default]` and `[joint.NAME]`",
        table(heads, of_joint),
    )


def _answers(key: str, row: Row, inner: Sequence[Row], name: str) -> list[list[str]]:
    """The lines of a key of arm.toml or model.toml: one, or one for each key of its table."""
    usual = {question.key: question.usual for question in answers.QUESTIONS}
    listed = {f"{key}.{one.key}": one for one in inner} or {key: row}
    return [
        [f"`{dotted}`", one.kind, one.unit, one.bounds, usual.get(dotted, ""), one.meaning, f"[{name}.toml]({name}.md)"]
        for dotted, one in listed.items()
    ]

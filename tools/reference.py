"""Writes the reference pages in docs/reference/: the keys of the files, the codes of the C library, the JSON outputs.

Usage: reference.py [FOLDER]

The keys come from the readers themselves: they read the files in tools/samples/, which have every key, and a
`Recorder` notes what each reader states of a key where it reads it. The codes come from the C library and the comments
in its headers, the JSON outputs from the schemas in docs/reference/schemas/.
"""

import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from zygos.arm import load_arm, read_arm
from zygos.effects import CATALOGUE
from zygos.files import toml
from zygos.files.output import write_text
from zygos.files.toml import Entry, Table
from zygos.model.model import read_model
from zygos.native.flight import ffi, lib
from zygos.simulation.scenario import read_scenario
from zygos.telemetry.map import read_map
from zygos.urdf import answers

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "tools" / "samples"
PAGES = ROOT / "docs" / "reference"
COMMAND = "`make reference`"


@dataclass(frozen=True)
class Read:
    """A key that was read."""

    table: str
    """Its table as TOML writes it: [[joint]], [joint.link_encoder]; empty for the top of the file."""
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
    return frame.f_code.co_filename, line, column


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
    named: str = ""
    """A table whose keys are names of the user's, and so stand in the page as NAME."""

    def reads(self) -> list[Read]:
        """What the reader asks of the samples."""
        found = [one for sample in ("free", "fixed") for one in recorded(self.read, SAMPLES / sample / self.name)]
        return [self._renamed(one) for one in found]

    def _renamed(self, one: Read) -> Read:
        first, _, rest = one.table.partition(".")
        if not self.named or first != self.named:
            return one
        if rest:
            return replace(one, table=f"{first}.NAME")
        return replace(one, entry=replace(one.entry, key="NAME"))


def _read_map(top: Table) -> object:
    arm = load_arm(top.file.parent / "arm.toml")
    return read_map(top, arm, tabular=top.file.parent.name == "fixed")


def markdown(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """A table of Markdown."""
    escaped = [" | ".join(cell.replace("|", "\\|") for cell in line) for line in lines]
    return [f"| {' | '.join(heads)} |", "|" + " --- |" * len(heads), *(f"| {line} |" for line in escaped)]


PLACES = {
    "motor": "the motor of a joint, before the gear; its rate after it",
    "link": "the link of a joint",
    "spring": "the spring of a joint",
    "torque": "the torque of a joint's motor",
    "rotor": "the rotor of a joint",
    "base": "the whole arm; there is no key joint",
}
EFFECTS = "\n".join(
    (
        "## The kinds of effects",
        "",
        *markdown(
            ("Kind", "Effect", "Unit", "Acts at", "Value"),
            [
                (f"`{kind.key}`", kind.title, kind.unit, PLACES[kind.place], ">= 0" if kind.positive else "any")
                for kind in CATALOGUE.values()
            ],
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
        named="parameters",
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
        "A map tells `zygos convert` where the readings of the arm are in a foreign CAN log or table, and in which "
        "units ([telemetry](../telemetry.md)).",
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
    for (table, key), entries in keys.items():
        kinds = _once(kind for entry in entries for kind in _kinds(entry))
        lengths = {kind for kind in kinds if kind.startswith("array of") and kind.endswith("numbers")}
        if len(lengths) > 1 or "array of 1 numbers" in lengths:  # its length depends on the arm
            kinds = _once("array of numbers" if kind in lengths else kind for kind in kinds)
        in_unit = key in ("value", "sigma", "offset") and (table, "unit") in keys
        row = Row(
            key,
            " or ".join(kinds),
            "as `unit` says" if in_unit else _joined(entry.unit for entry in entries),
            _joined(_range(entry.bounds) for entry in entries),
            _joined(map(default_of, entries)),
            " ".join(_once(entry.meaning for entry in entries)),
        )
        tables.setdefault(table, []).append(row)
    return {
        table: sorted(lines, key=lambda row: row.kind in ("table", "array of tables"))
        for table, lines in tables.items()
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


def _heading(table: str) -> str:
    if not table:
        return "At the top of the file"
    return f"`[[{table}]]`" if table in Recorder.arrays else f"`[{table}]`"


def sections(tables: dict[str, list[Row]]) -> list[tuple[list[str], list[Row]]]:
    """Tables with the same keys and meanings share a section. Where their units differ, the key itself states them."""
    shared: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for table, lines in tables.items():
        alike = tuple((row.key, row.meaning) for row in lines)
        shared.setdefault(alike, []).append(table)
    found = []
    for group in shared.values():
        common = []
        for same in zip(*(tables[table] for table in group), strict=True):
            columns = zip(*(row.cells[1:] for row in same), strict=True)
            cells = [column[0] if len(set(column)) == 1 else ABOVE for column in columns]
            common.append(Row(same[0].key, *cells))
        found.append((group, common))
    return found


def page(title: str, *paragraphs: str) -> str:
    """A whole page. It says how it is made."""
    note = f"<!-- This page is generated by {COMMAND}. Do not edit it. -->"
    return "\n\n".join((note, f"# {title}", *paragraphs)) + "\n"


def keys_page(file: File) -> str:
    """The page of one kind of file."""
    parts = []
    for group, lines in sections(rows(file.reads())):
        parts.append("## " + ", ".join(map(_heading, group)))
        parts.append("\n".join(markdown(HEADS, [row.cells for row in lines])))
    intro = file.intro + (
        " A key that is not listed here is refused. A key without a default is required."
        " Angles are in rad, and all other quantities in SI units, unless the column says otherwise."
    )
    return page(f"`{file.name}`: {file.title}", intro, *parts, *filter(None, [file.also]))


def answers_page() -> str:
    """The page of answers.toml, whose values the readers of arm.toml and model.toml check."""
    asked = {question.key: question for question in answers.QUESTIONS}
    arm, model = rows(FILES[0].reads()), rows(FILES[1].reads())
    parts = []
    for title, keys, sources in (
        ("At the top of the file", answers.TOP, [("arm", "", arm)]),
        ("`[default]` and `[joint.NAME]`", answers.JOINT, [("arm", "joint", arm), ("model", "joint", model)]),
    ):
        lines = []
        for key in keys:
            for name, table, tables in sources:
                for row in tables[table]:
                    inner = tables.get(f"{table}.{key}".strip("."), []) if name == "arm" else []
                    if row.key == key:
                        listed = [(entry.key, entry) for entry in [row]] if not inner else []
                        listed += [(f"{key}.{entry.key}", entry) for entry in inner]
                        lines += [_answer(dotted, entry, asked.get(dotted), name) for dotted, entry in listed]
        parts += [f"## {title}", "\n".join(markdown((*HEADS[:4], "Usual values", "Meaning", "File"), lines))]
    intro = (
        "`zygos import` asks for what a URDF does not say. `--answers answers.toml` answers beforehand. Values go into "
        "the files that the last column names, whose pages have the defaults. `[default]` holds for every joint, "
        "`[joint.NAME]` for the joint of that name in the URDF, before `[default]`. A key with usual values must be "
        "answered, `gravity` is `[0, 0, -9.81]` for a fixed base unless it is given, and a value with a standard "
        "deviation is written as in [model.toml](model.md)."
    )
    return page("`answers.toml`: what a URDF does not say", intro, *parts)


def _answer(key: str, row: Row, question: "answers.Question | None", name: str) -> list[str]:
    usual = question.usual if question else ""
    return [f"`{key}`", row.kind, row.unit, row.bounds, usual, row.meaning, f"[{name}.toml]({name}.md)"]


HEADERS = ROOT / "include" / "zygos"
ENUM = re.compile(r"((?:^///[^\n]*\n)*)^(?:#define \w+ \d+\n)?enum (zygos_\w+) \{(.*?)\};", re.M | re.S)
MEMBER = re.compile(r"(ZYGOS_\w+)(?:\s*=\s*[^,\n/]+?)?\s*,?\s*((?:///<[^\n]*\n?\s*)*)(?=ZYGOS_|\s*$)")
TEXTS = {"zygos_error": "zygos_text", "zygos_effect_kind": "zygos_effect_text"}
"""Functions of text.h whose names are not that of the enumeration with _text behind it."""


def _words(comment: str) -> str:
    return " ".join(line.strip().removeprefix("///").removeprefix("<").strip() for line in comment.splitlines()).strip()


def codes() -> list[tuple[str, str, str, list[tuple[str, int, str]]]]:
    """Each enumeration of the C library: name, header, comment, and the enumerators with value and comment."""
    found = []
    for header in sorted(HEADERS.glob("*.h")):
        for comment, name, body in ENUM.findall(header.read_text()):
            values = {member: value for value, member in ffi.typeof(f"enum {name}").elements.items()}
            members = [(member, values.pop(member), _words(words)) for member, words in MEMBER.findall(body)]
            if values:
                raise ValueError(f"{header}: {', '.join(values)} of enum {name} not found; remedy: correct MEMBER")
            found.append((name, header.name, _words(comment), members))
    return found


def text_of(function: str, code: int) -> str:
    """The text of a code in C; enumerations of bits have none, nor has the number of the codes."""
    known = getattr(lib, function, None)
    text = ffi.string(known(code)).decode() if known else ""
    return "" if text == "unknown code" else text


def codes_page() -> str:
    """The page of the enumerations, and of the fault counters."""
    parts = []
    for name, header, comment, members in codes():
        function = TEXTS.get(name, f"{name}_text")
        texts = [text_of(function, value) for _, value, _ in members]
        said = [f"`{function}()` returns the texts."] if any(texts) else []
        parts.append(f"## `enum {name}`")
        parts.append(" ".join(filter(None, (comment, f"Declared in `zygos/{header}`.", *said))))
        lines = [
            (f"`{member}`", str(value), text, words)
            for (member, value, words), text in zip(members, texts, strict=True)
        ]
        heads = ("Enumerator", "Value", "Text", "Comment in the header")
        if not any(texts):
            heads, lines = (heads[0], heads[1], heads[3]), [(line[0], line[1], line[3]) for line in lines]
        parts.append("\n".join(markdown(heads, lines)))
    counters = [name for name, _ in ffi.typeof("zygos_faults_t").fields]
    faults = [(f"`{name}`", text_of("zygos_fault_text", place)) for place, name in enumerate(counters)]
    return page(
        "Codes of the C library",
        "Every enumeration that a caller of the C library can meet, and the fault counters.",
        *parts,
        "## Fault counters",
        "Members of `zygos_faults_t` (`zygos/cycle.h`), which have the same names in JSON. `zygos_fault_text()` "
        "returns the texts.",
        "\n".join(markdown(("Counter", "What it counts"), faults)),
    )


SCHEMAS = PAGES / "schemas"


def schemas() -> dict[str, Any]:
    """The schemas by their names."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(SCHEMAS.glob("*.json"))}


def _type(schema: Any) -> str:
    if "const" in schema or "enum" in schema:
        return " or ".join(f"`{json.dumps(value)}`" for value in schema.get("enum", [schema.get("const")]))
    named = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    inner = schema.get("items", {}).get("type")
    listed = {"array": f"array of {inner if isinstance(inner, str) else (inner or ['any'])[0]}s"}
    return " or ".join(listed.get(name, name) for name in named)


def _unit(schema: Any) -> str:
    """The unit of a schema, or of the numbers in its arrays and in its maps of plain values."""
    for inner in ("items", "additionalProperties"):
        if "unit" not in schema and isinstance(schema.get(inner), dict):
            return _unit(schema[inner])
    return str(schema.get("unit", ""))


def flat(schema: Any, path: str = "") -> Iterable[tuple[str, str, str, str]]:
    """Each key of a schema with type, unit and meaning. [] stands for the entries of an array, NAME for any name."""
    for key, inner in schema.get("properties", {}).items():
        name = f"{path}.{key}" if path else key
        yield f"`{name}`", _type(inner), _unit(inner), inner["description"]
        yield from flat(inner, name)
    if "items" in schema:
        yield from flat(schema["items"], f"{path}[]")
    if isinstance(schema.get("additionalProperties"), dict):
        yield from flat(schema["additionalProperties"], f"{path}.NAME")


def json_page() -> str:
    """The page of the JSON outputs."""
    parts = []
    for name, schema in schemas().items():
        parts.append(f"## {schema['title']}")
        parts.append(f"Schema: [schemas/{name}.json](schemas/{name}.json)")
        parts.append("\n".join(markdown(("Key", "Type", "Unit", "Meaning"), flat(schema))))
    intro = (
        "Every JSON output has a JSON Schema (draft 2020-12) in [schemas](schemas/). A number that does not exist, "
        "such as the value of a parameter that is not identifiable, is null. In the tables `[]` stands for the "
        "entries of an array, and `NAME` for the names of parameters, joints or messages. The unit 1 means that a "
        "number has no unit. In the schemas the keyword `unit` holds the unit of a number, and `commands` the "
        "commands that write the output."
    )
    return page("JSON outputs", intro, *parts)


def pages() -> dict[str, str]:
    """Every page by its name."""
    found = {Path(file.name).stem + ".md": keys_page(file) for file in FILES}
    return found | {"answers.md": answers_page(), "codes.md": codes_page(), "json.md": json_page()}


def main() -> None:
    """Write the pages."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGES
    for name, text in pages().items():
        write_text(folder / name, text)


if __name__ == "__main__":
    main()

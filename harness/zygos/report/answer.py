# SPDX-License-Identifier: MIT
"""What a command found: a verdict, and sections with typed content. Terminal and HTML show this one structure.

Texts may hold `code` in backticks and **stress** in asterisks. Numbers are written as people write them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, cast

Tone = Literal["good", "open", "named", "differ"]
"""Colour of a verdict."""
ColumnKind = Literal["title", "name", "number", "main", "text", "wrap", "unit", "state", "bar", "signed"]
"""title: text in the first column. name: of a parameter. main: the number that counts. wrap: a long text. state: what
is said of the row. bar: a position on the scale of the table. signed: one about its middle."""


@dataclass(frozen=True)
class Mark:
    """A mark on the scale of a table."""

    at: float | None
    """Per cent of the width; None: it is not drawn."""
    kind: Literal["tick", "tick dotted", "mark", "ring"] = "tick"
    note: str = ""
    colour: str = "ink"


@dataclass(frozen=True)
class Bar:
    """A cell that is drawn on the scale of its table; the numbers stand in other cells."""

    fill: float | None = None
    """Length from the left end, per cent of the width."""
    colour: str = "ink"
    marks: tuple[Mark, ...] = ()
    band: tuple[float, float] | None = None
    """Left end and width of an interval, per cent of the width."""


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    title: str
    kind: ColumnKind = "number"


@dataclass(frozen=True)
class Row:
    """A row of a table. state: class of the row; colour: of the dot before it; about: a line below the first cell."""

    cells: tuple[str | Bar, ...]
    state: Literal["", "named", "guess", "fails", "outside"] = ""
    colour: str = ""
    about: str = ""


@dataclass(frozen=True)
class Table:
    """Rows of cells. ticks: of the scale of its bars, with `at` and `label`; one: position of a dashed line."""

    shape: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    ticks: Sequence[Mapping[str, Any]] = ()
    one: float | None = None


@dataclass(frozen=True)
class Text:
    """A paragraph. label: what it begins with, stressed."""

    shape: ClassVar[str] = "text"
    text: str
    kind: Literal["plain", "lead", "note", "small"] = "plain"
    label: str = ""


@dataclass(frozen=True)
class Items:
    """A list of sentences."""

    shape: ClassVar[str] = "items"
    items: tuple[str, ...]


@dataclass(frozen=True)
class Fact:
    """A number of the whole with its title. more: lines below it; key: by which a program finds it."""

    title: str
    value: str
    more: tuple[str, ...] = ()
    colour: str = ""
    key: str = ""


@dataclass(frozen=True)
class Facts:
    """Numbers of the whole, side by side."""

    shape: ClassVar[str] = "facts"
    facts: tuple[Fact, ...]


@dataclass(frozen=True)
class Card:
    """A finding: title, number and lines."""

    title: str
    value: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class Cards:
    """Findings, side by side."""

    shape: ClassVar[str] = "cards"
    cards: tuple[Card, ...]
    tone: Tone


@dataclass(frozen=True)
class Charts:
    """Charts by their ids in `Answer.drawn`. layout: how many stand side by side. scaling: a choice of scales."""

    shape: ClassVar[str] = "charts"
    ids: tuple[str, ...]
    layout: Literal["one", "two", "three", "many"] = "two"
    scaling: bool = False


@dataclass(frozen=True)
class Counts:
    """Numbers of events by their names."""

    shape: ClassVar[str] = "counts"
    counts: Mapping[str, int]


Content = Table | Text | Items | Facts | Cards | Charts | Counts


@dataclass(frozen=True)
class Section:
    """A part of an answer. key: its anchor in the page."""

    key: str
    title: str
    content: tuple[Content, ...]


@dataclass(frozen=True)
class Answer:
    """What a command found."""

    about: str
    """What it is, for the line above the verdict: the parameters from a run."""
    arm: str
    verdict: str
    """In one or two words."""
    tone: Tone
    sentence: str
    lead: tuple[Text, ...] = ()
    """What a reader needs to know first, in a few lines."""
    facts: tuple[Facts | Cards, ...] = ()
    """Numbers and findings that belong to the verdict."""
    reading: tuple[tuple[str, str], ...] = ()
    """How to read the page: titles and texts."""
    sections: tuple[Section, ...] = ()
    drawn: Mapping[str, Any] = field(default_factory=lambda: NOTHING_DRAWN)
    """What the script of the page draws; empty where nobody asked for charts."""
    foot: str = ""
    brief: tuple[str, ...] = ()
    """The values themselves, where they are few enough for the terminal."""


NOTHING_DRAWN: Mapping[str, Any] = {"times": {}, "refused": [], "charts": {}}


def sections(*parts: Section | None) -> tuple[Section, ...]:
    """Those that there are, without empty content."""
    return tuple(one for one in parts if one is not None and one.content)


def section(key: str, title: str, *content: Content | None) -> Section | None:
    """A section with the content that there is; None where none is."""
    kept = tuple(one for one in content if one is not None)
    return Section(key, title, kept) if kept else None


def table(heads: str | Sequence[str], rows: Sequence[Row | Sequence[str | Bar]], **scale: Any) -> Table | None:
    """A table; None where it has no rows.

    heads: titles of the columns, in one text with " | " between them or one by one. Behind "::" a title has the kind of
    its column; others are numbers, the first one is a title.
    """
    if not rows:
        return None
    columns = []
    for k, head in enumerate(heads.split(" | ") if isinstance(heads, str) else heads):
        title, _, kind = head.partition("::")
        columns.append(Column(title, cast(ColumnKind, kind or ("number" if k else "title"))))
    lines = [one if isinstance(one, Row) else Row(tuple(one)) for one in rows]
    assert all(len(line.cells) == len(columns) for line in lines), "a row has as many cells as there are columns"
    return Table(tuple(columns), tuple(lines), **scale)


def charts(drawn: Sequence[Mapping[str, Any]], layout: Literal["one", "two", "three", "many"] = "two") -> Charts | None:
    """Charts by what is drawn; None where nothing is."""
    return Charts(tuple(one["id"] for one in drawn), layout) if drawn else None

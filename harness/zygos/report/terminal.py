# SPDX-License-Identifier: MIT
"""An answer in the terminal: the verdict first, then a few lines; all tables where they are asked for."""

from __future__ import annotations

import re
from collections.abc import Sequence

from zygos.files.output import say, table
from zygos.report.answer import Answer, Bar, Cards, Content, Counts, Facts, Items, Table, Text

LINES = 10
"""Lines of an answer of which nobody asked for more."""
_KEPT = 2
"""Lines of the brief content that are shown however many others there are."""
_MORE = "--details shows the tables"
_WIDTH = 110
"""Of a line of short texts, in characters."""


def show(answer: Answer, *, details: bool = False) -> None:
    """Print an answer."""
    say(f"{answer.verdict}: {answer.sentence}")
    lead = [_line(one) for one in answer.lead]
    if details:
        for text in lead:
            say(text)
        for fact in answer.facts:
            _content(fact)
        for part in answer.sections:
            say(f"\n{_plain(part.title)}")
            tabled = any(isinstance(one, Table) for one in part.content)
            for one in part.content:
                if not (tabled and isinstance(one, Text) and one.kind == "plain"):  # it says how to read the page
                    _content(one)
        return
    first = [*lead, *(line for one in answer.facts for line in _brief(one))]
    last, room = _packed(answer.brief), LINES - 2
    shown = [*first[: room - min(len(last), _KEPT)], *last][:room]
    for text in shown:
        say(text)
    more = len(first) + len(last) - len(shown)
    say(f"{more} more; {_MORE}" if more > 0 else _MORE)


def _content(one: Content) -> None:
    match one:
        case Table():
            shown = [k for k, column in enumerate(one.columns) if column.kind not in ("bar", "signed")]
            heads = [_plain(one.columns[k].title) for k in shown]
            table(heads, [[_cell(row.cells[k]) for k in shown] for row in one.rows])
        case Text():
            say(_line(one))
        case Items():
            for item in one.items:
                say(f"- {_plain(item)}")
        case Counts():
            seen = [f"{name} {count:,}" for name, count in one.counts.items() if count]
            if seen:
                say(", ".join(seen))
        case Facts() | Cards():
            for line in _brief(one):
                say(line)


def _brief(one: Facts | Cards) -> list[str]:
    if isinstance(one, Cards):
        return [f"{_plain(card.title)}: {card.value}; {'; '.join(card.lines[:1])}" for card in one.cards]
    return [" · ".join(f"{fact.title}: {fact.value}" for fact in one.facts)]


def _packed(entries: Sequence[str]) -> list[str]:
    """Short texts, several in a line."""
    lines: list[str] = []
    for entry in entries:
        if lines and len(lines[-1]) + len(entry) < _WIDTH:
            lines[-1] += f" · {entry}"
        else:
            lines.append(entry)
    return lines


def _line(one: Text) -> str:
    return f"{one.label.lower()}: {_plain(one.text)}" if one.label else _plain(one.text)


def _cell(cell: str | Bar) -> str:
    return _plain(cell) if isinstance(cell, str) else ""


def _plain(text: str) -> str:
    """A text without marks."""
    return re.sub(r"`([^`]+)`", r"\1", text).replace("**", "")

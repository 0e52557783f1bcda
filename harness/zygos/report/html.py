# SPDX-License-Identifier: MIT
"""An answer as a page: one self-contained file, from one template."""

from __future__ import annotations

import re
from pathlib import Path

from markupsafe import Markup, escape

from zygos.report.answer import Answer, Column, Row, Table
from zygos.report.page import PAGES, render
from zygos.report.provenance import Provenance

_CELLS = {"main": "c", "text": "text", "wrap": "text wrap", "unit": "unit text", "state": "text wrap state"}
_HEADS = {"text": "text", "wrap": "text", "unit": "text", "state": "text", "bar": "text log", "signed": "text"}


def write_page(path: Path, answer: Answer, provenance: Provenance) -> None:
    """Write the page of an answer. Errors: ZygosError if it cannot be written."""
    files = Table(
        (Column("what", "title"), Column("file", "text"), Column("SHA-256", "text")),
        tuple(Row(one) for one in provenance.files),
    )
    render(path, "answer.html", answer.drawn, answer=answer, provenance=provenance, files=files, whole="Show all of it")


def marked(text: str) -> Markup:
    """A text with its `code` and **stress**."""
    out = str(escape(text))
    out = re.sub(r"`([^`]+)`", r"<code>\1</code>", out)
    return Markup(re.sub(r"\*\*([^*]+)\*\*", r"<b>\1</b>", out))


def _of(classes: dict[str, str]) -> object:
    return lambda kind: Markup(f' class="{classes[kind]}"') if kind in classes else ""


PAGES.filters |= {"marked": marked, "cell_class": _of(_CELLS), "head_class": _of(_HEADS)}

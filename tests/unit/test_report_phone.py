# SPDX-License-Identifier: MIT
"""The pages on a phone, 360 px wide: no number of a table is outside of the screen."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from conftest import ROOT
from zygos.report.answer import Answer, Bar, section, sections, table
from zygos.report.html import write_page
from zygos.report.page import render
from zygos.report.provenance import Provenance

REPORT = ROOT / "harness" / "zygos" / "report"
PAGES = ("demo/page.html", "accuracy/page.html", "report/answer.html")


class Tables(HTMLParser):
    """How many tables there are, and how many of them are a child of an element that scrolls."""

    def __init__(self) -> None:
        super().__init__()
        self.count = self.scrolling = 0
        self.before: tuple[str, str] = ("", "")

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        classes = dict(attributes).get("class") or ""
        if tag == "table":
            self.count += 1
            self.scrolling += self.before[0] == "div" and "scroll" in self.before[1].split()
        self.before = (tag, classes)


@pytest.mark.parametrize("page", PAGES)
def test_tables_are_stacked_or_scroll(page: str, tmp_path: Path) -> None:
    """A script gives each cell the head of its column; the style then makes rows blocks. Without it, tables scroll."""
    text = (REPORT.parent / page).read_text()
    assert text.startswith('{% extends "base.html" %}')
    assert text.rindex("</table>") < text.rindex("{% endblock %}")
    if page == "report/answer.html":
        part = section("parts", "Parts", table("name | size::bar", [("k1", Bar(50.0))]))
        answer = Answer("an answer", "paper", "valid", "good", "all of it", sections=sections(part, part))
        write_page(tmp_path / "page.html", answer, Provenance("zygos", "1", ()))
        text = (tmp_path / "page.html").read_text()
    found = Tables()
    found.feed(text)
    assert found.count >= 1
    assert found.scrolling == found.count


def test_the_script_of_every_page_finds_all_tables() -> None:
    text = (REPORT / "base.html").read_text()
    assert 'name="viewport" content="width=device-width' in text
    assert text.index('{% include "style.html" %}') < text.index("{% block main %}")
    assert text.index("{% block main %}") < text.index('{% include "labels.html" %}')


def test_the_style_stacks_what_the_script_labels() -> None:
    style, script = (REPORT / "style.html").read_text(), (REPORT / "labels.html").read_text()
    assert re.search(r"^\.scroll { overflow-x: auto; }", style, re.M)
    narrow = re.search(r"^@media \(max-width: (\d+)rem\) {\n(.*?)^}", style, re.M | re.S)
    assert narrow is not None
    assert int(narrow[1]) * 16 > 360
    assert "content: attr(data-label)" in narrow[2]
    for element in ("thead { display: none", "tr { display: flex; flex-wrap: wrap", "td { display: block"):
        assert f".labelled .scroll {element}" in narrow[2]
    assert ".scroll > table" in script
    assert "dataset.label" in script
    assert 'classList.add("labelled")' in script


def test_a_page_holds_style_and_script(tmp_path: Path) -> None:
    data = {"times": {}, "charts": {}, "refused": []}
    content = {
        "seeds": 2,
        "draws": 2,
        "commit": "abc",
        "estimators": [],
        "groups": [],
        "band": (0.92, 0.97),
        "refusals": 0.05,
    }
    render(tmp_path / "a.html", "accuracy/page.html", data, **content, wild=(5, 2), figure=None)
    text = (tmp_path / "a.html").read_text()
    assert "dataset.label" in text
    assert "attr(data-label)" in text

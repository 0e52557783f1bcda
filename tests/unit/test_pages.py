# SPDX-License-Identifier: MIT
"""The hand-written pages: every link leads somewhere, README stays a first page, and all of them can be read."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from conftest import ROOT

README = ROOT / "README.md"
PAGES = sorted({README, ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")})

REFERENCE = {"conventions", "glossary", "snapshot", "wire"}
EVIDENCE = {
    "accuracy", "assurance", "cost", "laboratory", "mission", "mutants", "paper-tables", "results", "soak", "trials",
    "upset", "verification",
}  # fmt: skip
"""Pages that are looked up, and not read from one end to the other. docs/reference is generated."""
MOST_WORDS = 40_000


def links(page: Path) -> list[str]:
    """What the page links to in this repository."""
    found = re.findall(r"\]\(([^)\s]+)\)", page.read_text())
    return [link for link in found if not link.startswith(("http:", "https:", "mailto:"))]


@cache
def anchors(page: Path) -> set[str]:
    """The anchors that GitHub gives the headings of a page."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.S)
    headings = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def dead(page: Path) -> list[str]:
    """The links of a page that lead nowhere."""
    out = []
    for link in links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors(target)):
            out.append(link)
    return out


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    assert dead(page) == []


def test_every_page_is_in_the_list_of_pages() -> None:
    listed = {(ROOT / "docs" / link.partition("#")[0]).resolve() for link in links(ROOT / "docs" / "README.md")}
    written = {page for page in PAGES if page.parent == ROOT / "docs"} - {ROOT / "docs" / "README.md"}
    assert {page.name for page in written - listed} == set()


def test_readme_is_short_and_begins_with_a_picture() -> None:
    text = README.read_text()
    assert len(text.split()) <= 1200
    assert "![" in "\n".join(text.splitlines()[:40])


def listed(section: str) -> set[str]:
    """The pages that docs/README.md has in one of its sections."""
    text = (ROOT / "docs" / "README.md").read_text().partition(f"\n## {section}\n")[2].partition("\n## ")[0]
    return {name for name in re.findall(r"\]\(([\w-]+)\.md\)", text)}


def words(text: str) -> int:
    """Words of a page: the bars of tables and the signs of formulas are none, and tables that a command writes are not
    counted."""
    text = re.sub(r"<!-- [^\n]*\bwrit[^\n]*-->.*?<!-- (?:to here|end of \w+) -->", "", text, flags=re.S)
    return sum(any(sign.isalnum() for sign in word) for word in text.split())


def test_reference_and_evidence_are_where_they_are_listed() -> None:
    assert (listed("Reference"), listed("Evidence")) == (REFERENCE, EVIDENCE)


def test_the_hand_written_pages_can_be_read() -> None:
    pages = [page for page in (ROOT / "docs").glob("*.md") if page.stem not in REFERENCE | EVIDENCE]
    counted = {page.name: words(page.read_text()) for page in (README, *pages)}
    longest = sorted(counted, key=counted.__getitem__)[-3:]
    assert sum(counted.values()) <= MOST_WORDS, f"remedy: say a thing once; the longest pages are {longest}"


def test_what_is_a_word() -> None:
    assert words("# Two words\n| a | 1 |\n<!-- written by make times -->\n| b | 2 |\n<!-- end of times -->\n") == 4


def test_a_dead_link_is_seen(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Here it is\n[good](#here-it-is) [bad](#there) [worse](nowhere.md) [far](https://example.org)\n")
    assert dead(page) == ["#there", "nowhere.md"]

# SPDX-License-Identifier: MIT
"""The documentation site (`make docs`): the pages of this folder, as they are, with navigation and search.

The groups of the navigation are the sections of README.md, so that they are written once.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent
VERSION = re.findall(
    r"ZYGOS_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)", (FOLDER.parent / "include/zygos/types.h").read_text(encoding="utf-8")
)

project, author, language = "zygos", "The zygos authors", "en"
release = version = ".".join(VERSION)
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "README"
html_theme = "furo"
html_title = f"zygos {release}"
html_copy_source = False
html_show_sphinx = False
myst_heading_anchors = 4
highlight_language = "none"
html_extra_path = ["accuracy.html"]
suppress_warnings = ["myst.header", "misc.highlighting_failure"]


def with_navigation(app: Any, page: str, text: list[str]) -> None:
    """Add the pages that each section of a list of pages names to the navigation, with its title."""
    folder = page.rpartition("/")[0]
    if page not in {"README", "reference/README"}:
        return
    seen: set[str] = set()
    out = [text[0]]
    for title, body in re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", text[0], re.M | re.S) or [("", text[0])]:
        names = [name for name in dict.fromkeys(re.findall(r"\]\(([\w/-]+)\.md\)", body)) if name not in seen]
        names = [name for name in names if (FOLDER / folder / f"{name}.md").is_file()]
        seen.update(names)
        if names:
            options = [":hidden:", f":caption: {title}"] if title else [":hidden:"]
            out.append("\n".join(["```{toctree}", *options, "", *names, "```"]))
    text[0] = "\n\n".join(out)


def to_the_repository(app: Any, page: str, text: list[str]) -> None:
    """Links to files outside this folder are shown as their paths: the site has no copy of them."""

    def shown(found: re.Match[str]) -> str:
        target = found[2].partition("#")[0]
        path = (FOLDER / page).parent.joinpath(target).resolve()
        if path.is_relative_to(FOLDER) and path.suffix in {".md", ".svg", ".html"}:
            return found[0]
        inside = path.relative_to(FOLDER.parent) if path.exists() and path.is_relative_to(FOLDER.parent) else None
        return f"{found[1]} (`{inside}`)" if inside is not None else found[0]

    text[0] = re.sub(r"(?<!!)\[([^\]\n]*)\]\((?!https?:|#)([^)\s]+)\)", shown, text[0])


def setup(app: Any) -> None:
    """Read the pages through the two functions above."""
    app.connect("source-read", to_the_repository)
    app.connect("source-read", with_navigation)

# SPDX-License-Identifier: MIT
"""Writes the reference pages in docs/reference/: command line, keys of files, codes and configuration of the C
library, its functions, the Python interface, JSON outputs, limits.

Usage: reference.py [FOLDER]
"""

import sys
from pathlib import Path

from reference_pages.codes import codes_page
from reference_pages.commands import commands_page
from reference_pages.config import config_page
from reference_pages.headers import headers_page
from reference_pages.keys import FILES, answers_page, keys_page
from reference_pages.limits import limits_page
from reference_pages.outputs import json_page
from reference_pages.python import python_page

from zygos.files.output import write_text

PAGES = Path(__file__).resolve().parents[1] / "docs" / "reference"


def pages() -> dict[str, str]:
    """Every page by its name."""
    found = {Path(file.name).stem + ".md": keys_page(file) for file in FILES}
    others = {
        "answers.md": answers_page(),
        "c.md": headers_page(),
        "codes.md": codes_page(),
        "commands.md": commands_page(),
        "config.md": config_page(),
        "json.md": json_page(),
        "limits.md": limits_page(),
        "python.md": python_page(),
    }
    return found | others


def main() -> None:
    """Write the pages."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGES
    for name, text in pages().items():
        write_text(folder / name, text)


if __name__ == "__main__":
    main()

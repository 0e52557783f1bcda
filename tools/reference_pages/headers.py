# SPDX-License-Identifier: MIT
"""The page of the functions and structs of the C library, from the comments of its public headers."""

import re

from reference_pages.codes import HEADERS
from reference_pages.config import STRUCT, fields, words_of
from reference_pages.markdown import page, table

PUBLIC = {
    "zygos.h": "The calls of an onboard program",
    "types.h": "Types",
    "refine.h": "Refinement with a task of your own",
    "wire.h": "CAN frames",
}
"""The public headers, in the order of the page."""
FUNCTION = re.compile(r"((?:^///[^\n]*\n)+)((?:^(?!typedef|static|#|/)[a-z][\w *]*?\bzygos_\w+\([^;{]*\);\n)+)", re.M)
NAME = re.compile(r"\b(zygos_\w+)\(")
OPEN = (
    "zygos_frame_t", "zygos_cycle_t", "zygos_estimate_t", "zygos_refine_settings_t", "zygos_refined_t",
    "zygos_record_t",
)  # fmt: skip
"""Structs that a program fills or reads; the page of the configuration has those of the configuration."""


def _shown(words: str) -> str:
    return words.replace("*", "\\*").replace("<", "\\<")


def functions(header: str) -> list[tuple[str, str]]:
    """Comment and prototypes of the functions that a public header declares."""
    return [
        (_shown(words_of(comment)), code.rstrip()) for comment, code in FUNCTION.findall((HEADERS / header).read_text())
    ]


def structs() -> list[tuple[str, str, str, list[tuple[str, str, str]]]]:
    """Name, header and comment of each struct that a program fills or reads, and its members."""
    found = []
    for header in PUBLIC:
        for _, _, name in STRUCT.findall((HEADERS / header).read_text()):
            if name in OPEN:
                comment, members = fields(name, header)
                said = [(f"`{field}`", f"`{kind}`", _shown(words)) for field, kind, words in members]
                found.append((name, header, _shown(comment), said))
    return found


def headers_page() -> str:
    """The page of the C interface."""
    parts = []
    for header, title in PUBLIC.items():
        declared = functions(header)
        parts += [f"## {title}: `zygos/{header}`"] if declared else []
        for comment, code in declared:
            parts += [f"### {', '.join(f'`{name}()`' for name in NAME.findall(code))}", f"```c\n{code}\n```", comment]
    parts.append("## Structs")
    for name, header, comment, members in structs():
        parts += [f"### `{name}`", f"{comment} Declared in `zygos/{header}`."]
        parts.append(table(("Member", "Type", "Comment in the header"), members))
    return page(
        "C interface",
        "Every function of the public headers, and the structs that a program fills or reads. "
        "[Configuration](config.md) has those of the configuration, [codes](codes.md) the enumerations; "
        "[the manual](../integrate.md) shows how they are used.",
        *parts,
    )

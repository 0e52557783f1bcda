# SPDX-License-Identifier: MIT
"""The page of the configuration and the capacities of the C library: fields, ranges and comments from types.h."""

import re

from reference_pages.codes import HEADERS
from reference_pages.markdown import page, table

STRUCTS = {
    "zygos_config_t": "The arm",
    "zygos_joint_config_t": "Each joint",
    "zygos_effect_config_t": "Each effect",
    "zygos_reduction_t": "Each entry of the reduction",
}
"""In the order of the page."""
STRUCT = re.compile(r"((?:^///[^\n]*\n)+)typedef struct \{\n((?:(?!^\}).*\n)*)\} (zygos_\w+_t);", re.M)
FIELD = re.compile(r"^    (\w+)\s+(\w+)((?:\[[^;]*\])?);[ \t]*((?:///<[^\n]*(?:\n[ \t]+(?=///<))?)*)", re.M)
CAPACITY = re.compile(
    r"((?:^///[^\n]*\n)+)(?:^#(?:if|define|else|endif)[^\n]*\n)*?"
    r"^#ifndef (ZYGOS_\w+)\n#define \2 (\S+)\n#endif\n(?:^#if[^\n]*\n#error \"\2 must be ([^\"]*)\"\n#endif\n)?"
    r"(?:^#if[^\n]*\n#error \"\2 must be ([^\"]*)\"\n#endif\n)?",
    re.M,
)
USUAL = {
    "ZYGOS_USUAL_EFFECTS": "3 for each joint, at least 8; in a planar build 8",
    "ZYGOS_USUAL_REDUCTION": "12 for each column; in a planar build 1",
    "ZYGOS_MAX_COLUMNS": "number of columns",
}
"""Defaults that are expressions, in words."""


def words_of(comment: str) -> str:
    """The text of a comment of a header."""
    return " ".join(line.strip().lstrip("/").removeprefix("<").strip() for line in comment.splitlines()).strip()


def fields(struct: str, header: str = "types.h") -> tuple[str, list[tuple[str, str, str]]]:
    """The comment of a struct in a header, and of each field name, type and comment."""
    for comment, body, name in STRUCT.findall((HEADERS / header).read_text()):
        if name == struct:
            found = FIELD.findall(re.sub(r"\n +(?=\w+\[)", " ", body))
            members = [
                (field, kind + size, words_of(words)) for kind, field, size, words in found if field != "reserved"
            ]
            return words_of(comment), members
    raise ValueError(f"{header}: {struct} not found; remedy: correct STRUCT")


def capacities() -> list[tuple[str, str, str, str]]:
    """Name, default, range and comment of each capacity."""
    return [
        (name, USUAL.get(usual, usual), "; ".join(filter(None, (low, high))), words_of(comment))
        for comment, name, usual, low, high in CAPACITY.findall((HEADERS / "types.h").read_text())
    ]


def config_page() -> str:
    """The page of the configuration."""
    parts = []
    for struct, title in STRUCTS.items():
        comment, members = fields(struct)
        lines = [(f"`{name}`", f"`{kind}`", words) for name, kind, words in members]
        parts += [f"## {title}: `{struct}`", comment, table(("Field", "Type", "Comment in the header"), lines)]
    macros = [(f"`{name}`", usual, bounds, words) for name, usual, bounds, words in capacities()]
    return page(
        "Configuration and capacities of the C library",
        "`zygos compile-model` writes the configuration from an [arm file](arm.md). If you write it by hand, begin "
        "with a struct of zeros. The page lists `zygos/types.h`; the enumerations are in [codes](codes.md).",
        *parts,
        "## Capacities",
        "Macros of the compiler, as decimal numbers: `-DZYGOS_MAX_JOINTS=2`. They must be the same for the library and "
        "for all files that include its headers. Other objects do not link, and `zygos_init()` refuses other structs "
        "(`ZYGOS_E_ABI`).",
        table(("Macro", "Default", "Range", "Comment in the header"), macros),
    )

# SPDX-License-Identifier: MIT
"""The page of the enumerations of the C library: names and comments from its headers, values and texts from itself."""

import re
from pathlib import Path

from reference_pages.markdown import page, table
from zygos.native.flight import ffi, lib

HEADERS = Path(__file__).resolve().parents[2] / "include" / "zygos"
ENUM = re.compile(r"((?:^///[^\n]*\n)*)^(?:#define \w+ \d+\n)?enum (zygos_\w+) \{(.*?)\};", re.M | re.S)
MEMBER = re.compile(r"(ZYGOS_\w+)(?:\s*=\s*[^,\n/]+?)?\s*,?\s*((?:///<[^\n]*\n?\s*)*)(?=ZYGOS_|\s*$)")
TEXTS = {"zygos_error": "zygos_text", "zygos_effect_kind": "zygos_effect_text"}
"""Functions of the library whose names are not that of the enumeration with _text behind it."""


def _words(comment: str) -> str:
    return " ".join(line.strip().removeprefix("///").removeprefix("<").strip() for line in comment.splitlines()).strip()


def codes() -> list[tuple[str, str, str, list[tuple[str, int, str]]]]:
    """Each enumeration of the C library: name, header, comment, and the enumerators with value and comment."""
    found = []
    for header in sorted(HEADERS.rglob("*.h")):
        for comment, name, body in ENUM.findall(header.read_text()):
            values = {member: value for value, member in ffi.typeof(f"enum {name}").elements.items()}
            members = [(member, values.pop(member), _words(words)) for member, words in MEMBER.findall(body)]
            if values:
                raise ValueError(f"{header}: {', '.join(values)} of enum {name} not found; remedy: correct MEMBER")
            found.append((name, str(header.relative_to(HEADERS)), _words(comment), members))
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
            (f"`{member}`", str(value), *([text] if said else []), words)
            for (member, value, words), text in zip(members, texts, strict=True)
        ]
        heads = ("Enumerator", "Value", *(["Text"] if said else []), "Comment in the header")
        parts.append(table(heads, lines))
    counters = [name for name, _ in ffi.typeof("zygos_faults_t").fields]
    faults = [(f"`{name}`", text_of("zygos_fault_text", place)) for place, name in enumerate(counters)]
    return page(
        "Codes of the C library",
        "Every enumeration that a caller of the C library can meet, and the fault counters.",
        *parts,
        "## Fault counters",
        "Members of `zygos_faults_t` (`zygos/priv/cycle.h`), which have the same names in JSON. `zygos_fault_text()` "
        "returns the texts.",
        table(("Counter", "What it counts"), faults),
    )

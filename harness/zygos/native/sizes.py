# SPDX-License-Identifier: MIT
"""The memory of the flight library at other capacities than those of this build, from the text of its headers."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from cffi import FFI

_HEADERS = Path(__file__).parents[1] / "_native" / "zygos.headers"
"""The headers one behind the other, without comments and includes (`tools/build_native.py`)."""
_NAME = re.compile(r"\b[A-Za-z_]\w*\b")
_OPERATORS = {"&&": " and ", "||": " or ", "!=": "!=", "!": " not "}


def _value(text: str, macros: Mapping[str, str]) -> int:
    """A constant expression of the preprocessor."""
    text = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda found: str(int(found[1] in macros)), text)
    for _ in range(20):  # macros stand for macros
        text = _NAME.sub(lambda found: f"({macros.get(found[0], '0')})", text)
    text = re.sub(r"(?<=\d)[uU]\b", "", text).replace("/", "//")
    text = re.sub(r"&&|\|\||!=|!", lambda found: _OPERATORS[found[0]], text)
    if not re.fullmatch(r"[\d\s()+*/%<>=!-]*", re.sub(r"\b(and|or|not)\b", "", text)):
        return 0  # functions of a compiler
    return int(eval(text, {"__builtins__": {}}))


def _structs(given: Mapping[str, int]) -> str:
    """The type definitions at the capacities that are given, with numbers as lengths of arrays."""
    macros = {name: str(value) for name, value in given.items()} | {"ZYGOS_DECLARATIONS_ONLY": "1"}
    kept: list[str] = []
    taken: list[bool] = []
    done: list[bool] = []  # whether an earlier branch of each was taken
    for line in _HEADERS.read_text().replace("\\\n", " ").splitlines():
        directive, _, rest = line.removeprefix("#").partition(" ") if line.startswith("#") else ("", "", line)
        match directive:
            case "ifdef" | "ifndef":
                taken.append((rest.strip() in macros) == (directive == "ifdef"))
                done.append(False)
            case "if":
                taken.append(all(taken) and bool(_value(rest, macros)))
                done.append(False)
            case "elif":
                done[-1] = done[-1] or taken[-1]
                taken[-1] = all(taken[:-1]) and not done[-1] and bool(_value(rest, macros))
            case "else":
                taken[-1] = not (taken[-1] or done[-1])
            case "endif":
                taken.pop()
                done.pop()
            case "define" if all(taken) and (found := re.fullmatch(r"(\w+) +(.+)", rest.strip())):
                macros[found[1]] = found[2]
            case "" if all(taken):
                kept.append(line)
    enumerators = re.findall(r"\b(ZYGOS_\w+) = (\d+)\b", "\n".join(kept))
    macros = dict(enumerators) | macros
    text = "\n".join(re.findall(r"^(?:typedef struct \{.*?^\} \w+;|enum \w+ \{.*?\};)", "\n".join(kept), re.M | re.S))
    return re.sub(r"\[([^\]]+)\]", lambda found: f"[{_value(found[1], macros)}]", text)


@lru_cache
def _sizes(given: tuple[tuple[str, int], ...]) -> dict[str, int]:
    binding = FFI()
    binding.cdef(_structs(dict(given)))
    structs = {"configuration": "zygos_config_t", "arm": "zygos_t", "background": "zygos_background_t"}
    structs |= {"in_place": "zygos_in_place_t", "estimate": "zygos_estimate_t"}
    return {name: int(binding.sizeof(struct)) for name, struct in structs.items()}


def memory(capacities: Mapping[str, int], *, in_place: bool = False) -> dict[str, int]:
    """Bytes of a build with these capacities, by macro: ``configuration``, ``arm``, ``background``, ``estimate``.

    in_place: with ``in_place`` instead of ``background``. A capacity that is missing has its default. The arm has a
    copy of the configuration; the constant that it is initialised with is memory of its own, which may be read-only.
    """
    needless = "background" if in_place else "in_place"
    return {name: size for name, size in _sizes(tuple(sorted(capacities.items()))).items() if name != needless}

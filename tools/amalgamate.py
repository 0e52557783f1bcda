# SPDX-License-Identifier: MIT
"""Writes the C library as one file: the sources in the order in which a frame passes them, with the headers beside."""

import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("in", "rows", "sums", "solve", "refine", "loop")
"""Of c/, as a frame passes them."""


def amalgamated() -> str:
    """The text of the one file. Macros of a source end with it; every other name is unique in the library."""
    paths = sorted((ROOT / "c").glob("*/*.c"), key=lambda path: (FOLDERS.index(path.parent.name), path))
    included: list[str] = []
    parts = ["/* The C library of zygos as one file, written by `make amalgamation`. */\n"]
    for path in paths:
        text = path.read_text()
        included += [line for line in re.findall(r"^#include .*$", text, re.M) if line not in included]
        macros = dict.fromkeys(re.findall(r"^#define (\w+)", text, re.M))
        body = re.sub(r"^#include .*\n+", "", text, flags=re.M)
        ended = "".join(f"#undef {name}\n" for name in macros)
        parts.append(f"/* ---- {path.relative_to(ROOT)} ---- */\n\n{body.strip()}\n\n{ended}")
    system = [line for line in included if "<" in line]
    own = [line for line in included if "<" not in line]
    return "\n".join([parts[0], *sorted(system), *own, "", *parts[1:]])


def main(folder: Path) -> None:
    """Write zygos.c and the folder zygos/ with the headers."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "zygos.c").write_text(amalgamated())
    shutil.copytree(ROOT / "include" / "zygos", folder / "zygos", dirs_exist_ok=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

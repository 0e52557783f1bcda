# SPDX-License-Identifier: MIT
"""Compiles the C library for the harness into the package: library, declarations for cffi, text of the headers, DBC.

Usage: build_native.py OUTPUT_FOLDER. Environment: CC (default cc), CFLAGS (added).

The declarations are the headers themselves after the C preprocessor, so they cannot drift from them; cffi parses them
here, because that takes half a second. A digest of their text is compiled into the library, and the binding compares
the two when it loads.
"""

import hashlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from cffi import FFI

ROOT = Path(__file__).resolve().parent.parent
HOST = ROOT / "c" / "ports" / "host"
HEADERS = ("batch.h", "multibody.h")
INCLUDES = ["-I", str(ROOT / "include"), "-I", str(HOST)]
FLAGS = "-g -fPIC " + (ROOT / "c" / "flags.txt").read_text()
CONSTANTS = (
    "ZYGOS_MAX_JOINTS ZYGOS_MAX_HALF_WIDTH ZYGOS_MAX_BLOCKS ZYGOS_CYCLE_QUEUE ZYGOS_MAX_EFFECTS ZYGOS_MAX_PARAMETERS "
    "ZYGOS_MAX_ROW ZYGOS_MAX_PACKED_ROW ZYGOS_MAX_BODY ZYGOS_SPATIAL ZYGOS_MOMENTUM ZYGOS_MIN_ARC_INSTANTS "
    "ZYGOS_JOINT_ROWS ZYGOS_MAX_COLUMNS ZYGOS_MAX_REDUCTION ZYGOS_NO_PLACE ZYGOS_JOINT_GROUPS "
    "ZYGOS_MAX_WINDOW ZYGOS_VERSION_MAJOR ZYGOS_VERSION_MINOR ZYGOS_LAYOUT "
    "ZYGOS_SNAPSHOT_HEAD"
).split()


def declarations(*defines: str) -> str:
    """Text of the headers for cffi, at the capacities that -D flags say; constants stand in it as enumerators."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    probe = "".join(f"\nenum {{ {name}_VALUE = {name} }};" for name in CONSTANTS)
    return subprocess.run(
        [*compiler, "-E", "-P", "-x", "c", "-DZYGOS_DECLARATIONS_ONLY", *defines, *INCLUDES, "-"],
        input="".join(f'#include "{name}"\n' for name in HEADERS) + f"{probe}\n",
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def digest_of(text: str) -> int:
    """The digest that declarations and library have in common."""
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def write_binding(text: str, path: Path) -> None:
    """Write the Python module that declares the library to cffi, with the digest of the text."""
    binding = FFI()
    binding.cdef(text)
    binding.set_source(path.stem, None)
    binding.emit_python_code(str(path))
    with path.open("a", encoding="ascii") as stream:
        stream.write(f"DIGEST = {digest_of(text)}\n")


def headers() -> str:
    """The public headers in the order in which they include each other, without comments and includes."""
    listed: list[str] = []

    def visit(name: str) -> None:
        path = (ROOT / "include" / "zygos" / name).resolve()
        text = re.sub(r"//.*|/\*.*?\*/", "", path.read_text())
        for included in re.findall(r'^#include "(.+\.h)"$', text, re.M):
            visit(str(path.parent / included))
        text = "\n".join(line.rstrip() for line in text.splitlines() if line.strip() and "#include" not in line)
        if text not in listed:
            listed.append(text)

    visit("zygos.h")
    return "\n".join(listed) + "\n"


def main(folder: Path) -> None:
    """Write libzygos.so, declarations.py, zygos.headers and the DBC files into the folder."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    extra = shlex.split(os.environ.get("CFLAGS", ""))
    folder.mkdir(parents=True, exist_ok=True)
    text = declarations(*(flag for flag in extra if flag.startswith("-D")))
    sources = sorted(str(path) for path in [*(ROOT / "c").glob("*/*.c"), *HOST.glob("*.c")])
    # the simulator takes three times as long at -O2; no optimisation changes a result
    command = [*compiler, *FLAGS.split(), "-O3", *extra]
    command += [f"-DZYGOS_DECLARATIONS_DIGEST={digest_of(text)}u", *INCLUDES, "-shared", *sources, "-lm"]
    partial = folder / "libzygos.so.partial"
    subprocess.run([*command, "-o", str(partial)], check=True)
    write_binding(text, folder / "declarations.py")
    (folder / "zygos.headers").write_text(headers())
    for database in (ROOT / "include" / "zygos").glob("*.dbc"):
        shutil.copy(database, folder)
    partial.replace(folder / "libzygos.so")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

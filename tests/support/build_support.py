# SPDX-License-Identifier: MIT
"""Builds of the library: each is compiled once and kept in build/builds, under a digest of the sources and of what it
was made of. `make clean` removes the folder, and other sources begin a new one.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest

from conftest import need
from zygos.native import flight

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(os.environ.get("ZYGOS_BUILDS", ROOT / "build" / "builds"))
INCLUDE = f"-I{ROOT / 'include'}"
ROOMS = sorted((ROOT / "c").glob("*/*.c"))
"""The sources of the flight library."""
ONBOARD = ROOT / "examples" / "onboard"
STRICT = "-Wconversion -Wsign-conversion -Wdouble-promotion -Wshadow -pedantic -Werror"
TARGETS = {
    "gcc": ("gcc", "CC=gcc"),
    "clang": ("clang", "CC=clang"),
    "m7": ("arm-none-eabi-gcc", "TARGET=m7"),
    "m4f": ("arm-none-eabi-gcc", "TARGET=m4f"),
    "leon3": ("sparc64-linux-gnu-gcc", "TARGET=leon3"),
    "aarch64": ("aarch64-linux-gnu-gcc", "CC=aarch64-linux-gnu-gcc"),
}
"""A compiler, and what the Makefile of examples/onboard is told so that it takes it."""
PLANAR = "-DZYGOS_MAX_JOINTS=2 -DZYGOS_SPATIAL=0 -DZYGOS_MOMENTUM=0"
"""The capacities of examples/onboard."""


def tool(name: str) -> str:
    """The program, or a skipped test; on a build server a failed one."""
    path = shutil.which(name)
    need(path, f"{name}: what it builds stays unchecked")
    return str(path)


def run(command: list[str], folder: Path, **environment: str) -> str:
    """Standard output of a command that must succeed and write nothing else."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(
        command, cwd=folder, env={**inherited, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    assert not done.stderr, done.stderr
    return done.stdout


def make(target: str, build: Path, tree: Path = ROOT, **variables: str | Path) -> str:
    """Run `make TARGET NAME=value ..` in a source tree, objects below `build`; what it prints."""
    words = [f"{name}={value}" for name, value in variables.items()]
    return run([tool("make"), "--no-print-directory", "-j2", target, f"BUILD={build}", *words], tree)


def kept(build: Callable[[Path], object], *arguments: str, sources: Iterable[Path] = ()) -> Path:
    """The folder that `build` has filled, once. arguments: what it depends on beside the library; sources: further
    files whose content it depends on. Of several processes that ask for it at the same time, one builds."""
    digest = hashlib.sha256("\0".join(arguments).encode())
    for path in sources:
        digest.update(path.read_bytes())
    folder = FOLDER / _state() / digest.hexdigest()[:24]
    _begin(folder.parent)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            build(folder)
            (folder / "complete").touch()
    return folder


@cache
def _state() -> str:
    """Digest of all from which builds are made."""
    digest = hashlib.sha256()
    for name in ("Makefile", "c", "include", "tools", "examples/onboard"):
        place = ROOT / name
        for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
            if path.is_file() and not {"build", "__pycache__"} & set(path.relative_to(ROOT).parts):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _begin(folder: Path) -> None:
    """Make the folder of a state of the sources, and remove those of other states."""
    if not folder.exists():
        for other in FOLDER.glob("*"):
            if other != folder:
                shutil.rmtree(other, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)


def copied(build: Path, folder: Path) -> Path:
    """A copy of a kept build in which `make` finds everything up to date."""
    shutil.copytree(build, folder)
    now = time.time()
    for path in folder.rglob("*"):
        os.utime(path, (now, now))
    return folder


def onboard(target: str = "gcc") -> Path:
    """A build of examples/onboard, by its Makefile and with strict warnings: the program `onboard`, the `library` with
    objects and archive, and `zygos`, the prefix where that is installed."""
    compiler, chosen = TARGETS[target]
    tool(compiler)
    words = [chosen, f"CFLAGS={flags_of(target)}"]

    def build(folder: Path) -> None:
        run([tool("make"), "-s", "-j2", f"BUILD={folder}", *words], ONBOARD)

    return kept(build, "onboard", *words)


def emulated(*words: str) -> list[str]:
    """A command that runs a program for aarch64, whose words follow."""
    tool("aarch64-linux-gnu-gcc")
    return [tool("qemu-aarch64"), "-L", "/usr/aarch64-linux-gnu", *words]


def flags_of(target: str) -> str:
    """The flags that the builds of examples/onboard add to those of every build. GCC writes the call graph with the
    frames of all functions; arguments that x86 would push for a call become a part of the frame."""
    graph = {"gcc": " -fcallgraph-info=su -maccumulate-outgoing-args", "clang": ""}
    return STRICT + graph.get(target, " -fcallgraph-info=su")


def native(*defines: str) -> Path:
    """The folder of the harness' library with other capacities. It is optimised less, which changes no result."""

    def build(folder: Path) -> None:
        environment = {**os.environ, "CFLAGS": " ".join([*defines, "-O1"])}
        script = [sys.executable, str(ROOT / "tools" / "build_native.py"), str(folder)]
        subprocess.run(script, env=environment, check=True)

    tool(os.environ.get("CC", "cc").split()[0])
    return kept(build, "native", os.environ.get("CC", ""), *defines)


@contextmanager
def capacities(*defines: str) -> Iterator[None]:
    """Within it zygos.native.flight is that of a library with these capacities."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight, "_FOLDER", native(*defines))
        ffi, lib = flight._load()
        patch.setattr(flight, "ffi", ffi)
        patch.setattr(flight, "lib", lib)
        yield


def objects(compiler: Iterable[str], rooms: Sequence[Path] = ROOMS) -> list[Path]:
    """The rooms of the library, or other sources, compiled by a compiler with its flags. No warning may come."""
    command = [*compiler, INCLUDE]
    tool(command[0])

    def build(folder: Path) -> None:
        run([*command, "-c", *map(str, rooms)], folder)

    folder = kept(build, "objects", *command, *(room.name for room in rooms))
    return [folder / f"{room.stem}.o" for room in rooms]

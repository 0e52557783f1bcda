# SPDX-License-Identifier: MIT
"""Instructions on the host, counted by valgrind's callgrind: each instruction that retires, exactly and repeatably."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from bench.counting import DRIVER, ENTRIES, FOLDED, MARKS, STAGES, TOPS, Count, Tally, joined
from conftest import ROOT, house_flags
from zygos.errors import ZygosError

COMPILER = ["gcc", *house_flags(), "-g", "-static"]
"""Static: no call is bound while it is counted. With -g callgrind tells which file a function is of."""
NO_STRING_INSTRUCTIONS = "glibc.cpu.x86_rep_movsb_threshold=1000000000:glibc.cpu.x86_rep_stosb_threshold=1000000000"
"""With these, memcpy() and memset() of glibc work by vectors at any size. Of `rep movsb`, which is one instruction of
the processor, callgrind counts every byte."""
ENVIRONMENT = {**os.environ, "GLIBC_TUNABLES": NO_STRING_INSTRUCTIONS}
_WATCHED = [f"--toggle-collect={entry}" for entry in ENTRIES.values()]


def build(folder: Path, capacities: tuple[str, ...], library: Sequence[Path] = ()) -> Path:
    """Compile library and driver with the house flags. Returns the program.

    library: an archive of the library in place of its sources; of its functions it is not known which file they are of.
    """
    program = folder / "driver"
    folder.mkdir(parents=True, exist_ok=True)
    includes = [f"-I{ROOT / 'include'}", f"-I{ROOT / 'c' / 'ports' / 'cortex-m'}"]
    sources = [DRIVER, DRIVER.with_name("host.c"), *(library or sorted((ROOT / "c").glob("*/*.c")))]
    subprocess.run([*COMPILER, *capacities, *includes, *map(str, sources), "-o", str(program)], check=True)
    return program


def count(folder: Path) -> Count:
    """Run folder/driver on folder/run.bin and count. Errors: ZygosError without valgrind, or what the program says."""
    if shutil.which("valgrind") is None:
        raise ZygosError("valgrind is not installed, which counts the instructions; remedy: apt install valgrind")
    out = folder / "callgrind.out"
    when = ["--dump-after=driver_mark", "--combine-dumps=yes", f"--callgrind-out-file={out.name}"]
    command = ["valgrind", "--tool=callgrind", *_WATCHED, *when, "./driver"]
    done = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"the driver failed under callgrind: {done.stderr.strip()[-500:]}; remedy: see there")
    tally = tally_of(out)
    out.unlink()
    return joined(tally, folder, "callgrind")


def _room(path: str) -> str:
    stem = Path(path).stem
    return FOLDED.get(stem, stem)


class Part:
    """What one part of a callgrind file, a cycle, says."""

    def __init__(self) -> None:
        self.own: dict[str, int] = defaultdict(int)
        self.stages: dict[str, int] = defaultdict(int)
        self.total: dict[str, int] = defaultdict(int)
        self.calls: dict[str, int] = defaultdict(int)
        """How often each function was called."""

    def call(self, caller: str, room: str, callee_room: str, cost: int) -> None:
        """Book a call of a function of one file from another, and all that it cost."""
        self.total[caller] += cost
        if room in TOPS:
            self.stages[callee_room] += cost
        elif (room, callee_room) == ("cycle", "wire"):
            self.stages["wire"] += cost
            self.stages["cycle"] -= cost

    def of(self, function: str) -> int:
        """Instructions of a function and of all that it calls, whatever file it is of."""
        keys = [key for key in {*self.own, *self.total} if key.endswith(f": {function}")]
        return sum(self.own.get(key, 0) + self.total.get(key, 0) for key in keys)

    def stage(self, name: str) -> int:
        """Instructions of a stage."""
        entry = ENTRIES.get("solve" if name == "solver" else name)
        return self.of(entry) if entry else self.stages[name]


def parts(path: Path) -> Iterator[Part]:
    """The parts of a callgrind file, one after the other, that of the program's end last."""
    names: dict[str, str] = {}

    def named(kind: str, value: str) -> str:
        number, _, name = value.rstrip().partition(" ")
        return names.setdefault(kind + number, name) if name else names[kind + number]

    part: Part | None = None
    room = here = callee_room = function = callee = ""
    calling = False
    with path.open() as lines:
        for line in lines:
            if part is not None and line[0] in "+-*0123456789":
                cost = int(line.rsplit(maxsplit=1)[1])
                if calling:
                    part.call(function, room, callee_room, cost)
                    callee_room, calling = here, False
                else:
                    part.own[function] += cost
                continue
            key, _, value = line.partition("=")
            if key == "fn":
                function, callee_room = f"{room}: {named('n', value)}", here
            elif key in ("fl", "fi", "fe"):
                here = callee_room = _room(named("f", value))
                room = here if key == "fl" else room
            elif key in ("cfi", "cfl"):
                callee_room = _room(named("f", value))
            elif key == "cfn":
                callee = named("n", value)
            elif key == "calls":
                calling = True
                if part is not None:
                    part.calls[callee] += int(value.split()[0])
            elif line.startswith("desc: Trigger"):
                if part is not None:
                    yield part
                part = Part()
    if part is not None:
        yield part


def tally_of(path: Path) -> Tally:
    """Of the first part of each cycle, and of the last part of all, in which the solution is."""
    stages: list[list[int]] = []
    functions: dict[str, dict[int, int]] = defaultdict(dict)
    last = Part()
    for number, part in enumerate(parts(path)):
        if number % MARKS == 0:
            stages.append([part.stage(stage) for stage in STAGES])
            for name, cost in part.own.items():
                functions[name][number // MARKS] = cost
        last = part
    count = len(stages) - 1
    calls = {name: np.zeros(count + 1, dtype=np.int64) for name in functions}
    for name, costs in functions.items():
        calls[name][list(costs)] = list(costs.values())
    own = {name: all_of[:count] for name, all_of in calls.items() if all_of[:count].any()}
    return Tally(np.array(stages[:count], dtype=np.int64), own, last.stage("solve"))

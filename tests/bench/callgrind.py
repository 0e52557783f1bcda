"""Instructions on the host, counted by valgrind's callgrind: each instruction that retires, exactly and repeatably."""

from __future__ import annotations

import shutil
import subprocess
from collections import defaultdict
from pathlib import Path

import numpy as np

from bench.counting import DRIVER, FOLDED, STAGES, WHOLE, Count, Tally, joined
from conftest import ROOT, house_flags
from zygos.errors import ZygosError

COMPILER = ["gcc", *house_flags(), "-g", "-static"]
"""Static: no call is bound while it is counted. With -g callgrind tells which file a function is of."""
_WATCHED = [f"--toggle-collect=zygos_{one}" for one in ("frame", "step", "solve")]


def build(folder: Path, capacities: tuple[str, ...]) -> Path:
    """Compile library and driver with the house flags. Returns the program."""
    program = folder / "driver"
    folder.mkdir(parents=True, exist_ok=True)
    includes = [f"-I{ROOT / 'include'}", f"-I{ROOT / 'c' / 'ports' / 'cortex-m'}"]
    sources = [*sorted((ROOT / "c").glob("*.c")), DRIVER, DRIVER.with_name("host.c")]
    subprocess.run([*COMPILER, *capacities, *includes, *map(str, sources), "-o", str(program)], check=True)
    return program


def count(folder: Path) -> Count:
    """Run folder/driver on folder/run.bin and count. Errors: ZygosError without valgrind, or what the program says."""
    if shutil.which("valgrind") is None:
        raise ZygosError("valgrind is not installed, which counts the instructions; remedy: apt install valgrind")
    out = folder / "callgrind.out"
    when = ["--dump-after=driver_mark", "--combine-dumps=yes", f"--callgrind-out-file={out.name}"]
    command = ["valgrind", "--tool=callgrind", *_WATCHED, *when, "./driver"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
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

    def call(self, caller: str, room: str, callee_room: str, cost: int) -> None:
        """Book a call of a function of one file from another, and all that it cost."""
        self.total[caller] += cost
        if room == "zygos":
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
        if name in WHOLE or name == "solver":
            return self.of(f"zygos_{'solve' if name == 'solver' else name}")
        return self.stages[name]


def parts(path: Path) -> list[Part]:
    """The parts of a callgrind file, the one at the program's end last."""
    names: dict[str, str] = {}

    def named(kind: str, value: str) -> str:
        number, _, name = value.rstrip().partition(" ")
        return names.setdefault(kind + number, name) if name else names[kind + number]

    found: list[Part] = []
    room = here = callee_room = function = ""
    calling = False
    with path.open() as lines:
        for line in lines:
            first = line[0]
            if first in "+-*0123456789":
                cost = int(line.rsplit(maxsplit=1)[1])
                if calling:
                    found[-1].call(function, room, callee_room, cost)
                    callee_room, calling = here, False
                else:
                    found[-1].own[function] += cost
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
                named("n", value)
            elif key == "calls":
                calling = True
            elif line.startswith("desc: Trigger"):
                found.append(Part())
    return found


def tally_of(path: Path) -> Tally:
    """Of each part, which is a cycle, and of the last one, in which the solution is."""
    *cycles, last = parts(path)
    functions = sorted({name for part in cycles for name in part.own})
    return Tally(
        np.array([[part.stage(stage) for stage in STAGES] for part in cycles], dtype=np.int64),
        {name: np.array([part.own.get(name, 0) for part in cycles], dtype=np.int64) for name in functions},
        last.stage("solve"),
    )

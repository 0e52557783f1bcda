"""Counts the instructions of zygos_cycle(), call by call, with valgrind's callgrind.

    python -m bench.count out/count.json

Each configuration is fed different data. What a valid cycle costs must not depend on them (docs/theory.md).
"""

from __future__ import annotations

import json
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conftest import EXAMPLE, ROOT, house_flags
from zygos.arm import Arm, load_arm
from zygos.cycles import Cycles
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.flight import config_of, cycles_to_native, ffi
from zygos.model import load_model
from zygos.output import say, table
from zygos.plant import simulate
from zygos.scenario import load_scenario

COMPILER = ["gcc", *house_flags(), "-static"]
"""Static: no call is bound while it is counted."""
KINDS = ("cycle", "block", "arc", "fills")
"""Of calls, as bench/cycles.c names them."""
RING = 24
"""Instructions that the rings of torques and samples cost where they begin anew, at most."""
CYCLES = 500
ARC_S = 15.0
"""Short enough for an arc to end in a run."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Configuration:
    """What is switched on, at which arm."""

    arm: Arm
    effects: tuple[Effect, ...] = ()


@dataclass(frozen=True)
class Count:
    """Instructions of the calls of one run."""

    parameters: int
    calls: NDArray[np.int64]
    """(n,)"""
    kinds: NDArray[np.str_]
    """(n,) what each call was, as bench/cycles.c names it."""
    turns: NDArray[np.str_]
    """(n,) whose turn it was."""

    def of(self, kind: str) -> NDArray[np.int64]:
        """Those of one kind; there may be none."""
        return self.calls[self.kinds == kind]


def _paper() -> Arm:
    return replace(load_arm(EXAMPLE / "arm.toml"), arc_max_s=ARC_S)


def _three(momentum: bool) -> Arm:
    arm = load_arm(EXAMPLE.parent / "spatial" / "arm.toml")
    return replace(arm, arc_max_s=300 * arm.period_s, momentum_max_s=200 * arm.period_s * momentum)


def _seven() -> Arm:
    arm = load_arm(EXAMPLE.parent / "seven" / "arm.toml")
    return replace(arm, arc_max_s=300 * arm.period_s)


def _at_each(arm: Arm, key: str) -> tuple[Effect, ...]:
    return tuple(Effect(CATALOGUE[key], joint.name, 0.0) for joint in arm.joints)


CONFIGURATIONS: dict[str, Callable[[], Configuration]] = {
    "paper": lambda: Configuration(_paper()),
    "paper, neither compensated nor motor rows": lambda: Configuration(
        replace(_paper(), compensate_every=0, impulse_arc_s=0.0)
    ),
    "paper, not compensated": lambda: Configuration(replace(_paper(), compensate_every=0)),
    "paper, friction": lambda: Configuration(_paper(), _at_each(_paper(), "motor_coulomb")),
    "paper, spring offsets": lambda: Configuration(_paper(), _at_each(_paper(), "spring_offset")),
    "three joints in space": lambda: Configuration(_three(momentum=True)),
    "three joints in space, no momentum rows": lambda: Configuration(_three(momentum=False)),
    "seven joints in space": lambda: Configuration(_seven()),
}
"""Variants by name. Each is fed all the data that suit its arm."""


def data(arm: Arm) -> dict[str, Cycles]:
    """Runs that have nothing in common: at rest, at random, and for the paper's arm its noisy motion."""
    rng = np.random.default_rng(0)
    shape = (CYCLES, arm.n)
    sync, flags = np.arange(1, CYCLES + 1, dtype=np.uint64), np.zeros(CYCLES, dtype=np.uint32)
    still = Cycles(sync, np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros((CYCLES, 3)), flags)
    draws = [rng.normal(size=shape) for _ in range(3)]
    runs = {"rest": still, "random": Cycles(sync, *draws, rng.normal(size=(CYCLES, 3)), flags)}
    if arm.name == "paper":
        model, scenario = load_model(EXAMPLE / "model.toml"), load_scenario(EXAMPLE / "scenario.toml")
        runs["motion"] = simulate(arm, model, scenario, noise=True, duration_s=CYCLES * arm.period_s).cycles()
    return runs


def build(folder: Path, *flags: str) -> Path:
    """Compile library and driver with the house flags. Returns the program."""
    program = folder / "cycles"
    sources = [*sorted((ROOT / "c").glob("*.c")), Path(__file__).with_name("cycles.c")]
    command = [*COMPILER, *flags, f"-I{ROOT / 'include'}", *map(str, sources), "-o", str(program)]
    subprocess.run(command, check=True)
    return program


def count(program: Path, one: Configuration, cycles: Cycles, folder: Path) -> Count:
    """Run the program on these cycles, and count. Errors: ZygosError without valgrind, or what the program says."""
    if shutil.which("valgrind") is None:
        raise ZygosError("valgrind is not installed, which counts the instructions; remedy: apt install valgrind")
    run, out = folder / "run.bin", folder / "callgrind.out"
    config: Any = config_of(one.arm, one.effects)
    size = ffi.sizeof("zygos_cycle_t")
    head = struct.pack("=3Q", ffi.sizeof("zygos_config_t"), size, len(cycles))
    run.write_bytes(
        head + bytes(ffi.buffer(config)) + bytes(ffi.buffer(cycles_to_native(cycles)))[: size * len(cycles)]
    )
    watch = "--toggle-collect=zygos_cycle --dump-after=zygos_cycle --combine-dumps=yes".split()
    command = ["valgrind", "--tool=callgrind", *watch, f"--callgrind-out-file={out}", str(program), str(run)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"{program.name} failed under callgrind: {done.stderr.strip()[-500:]}; remedy: see there")
    *kinds, last = done.stdout.splitlines()
    parts = re.findall(r"^desc: Trigger: (.*)$\n(?:.*\n)*?^summary: (\d+)$", out.read_text(), re.M)
    counts = np.array([int(total) for trigger, total in parts if trigger.startswith("--dump-after")], dtype=np.int64)
    if len(counts) != len(cycles) or len(kinds) != len(cycles):
        raise ZygosError(f"callgrind told {len(counts)} calls of {len(cycles)}; remedy: another version of valgrind")
    words = np.array([line.split() for line in kinds])
    return Count(int(last.split()[1]), counts, words[:, 0], words[:, 1])


def spread(runs: dict[str, Count]) -> int:
    """Most instructions by which an ordinary call depends on its data: of those whose turn is the same, in all runs.

    The place in the rings costs a handful, which are not of the data either.
    """
    calls = np.concatenate([one.of("cycle") for one in runs.values()])
    turns = np.concatenate([one.turns[one.kinds == "cycle"] for one in runs.values()])
    most = max(int(np.ptp(calls[turns == turn])) for turn in np.unique(turns))
    return most if most > RING else 0


def shared(runs: dict[str, Count]) -> int:
    """Turns of ordinary calls that all runs had."""
    return len(set.intersection(*(set(one.turns[one.kinds == "cycle"].tolist()) for one in runs.values())))


def every(folder: Path) -> dict[str, dict[str, Count]]:
    """Counts by configuration and data."""
    program = build(folder)
    listed: dict[str, dict[str, Count]] = {}
    runs: dict[str, dict[str, Cycles]] = {}
    for name, configured in CONFIGURATIONS.items():
        one = configured()
        runs.setdefault(one.arm.name, data(one.arm))
        listed[name] = {kind: count(program, one, cycles, folder) for kind, cycles in runs[one.arm.name].items()}
    return listed


def show(listed: dict[str, dict[str, Count]]) -> None:
    """Print a line for each run."""
    rows = []
    for name, runs in listed.items():
        for kind, one in runs.items():
            cells = (_range(one.of(key)) for key in KINDS)
            rows.append((name, str(one.parameters), kind, *cells, f"{one.calls.mean():,.0f}", str(spread(runs))))
    heading = ("instructions of a cycle", "opens a block", "ends an arc", "fills", "mean of all", "by data")
    table(("configuration", "p", "data", *heading), rows)


def _range(x: NDArray[np.int64]) -> str:
    if len(x) == 0:
        return "–"
    return f"{x.min():,}" if np.ptp(x) == 0 else f"{x.min():,} … {x.max():,}"


def _content(runs: dict[str, Count]) -> dict[str, Any]:
    def numbers(x: NDArray[np.int64]) -> dict[str, float]:
        return {"calls": len(x), "min": int(x.min()), "mean": float(x.mean()), "max": int(x.max())}

    listed = {
        name: {key: numbers(one.of(key)) for key in KINDS if len(one.of(key))} | {"every": numbers(one.calls)}
        for name, one in runs.items()
    }
    known = {"parameters": next(iter(runs.values())).parameters, "turns_shared": shared(runs)}
    return {**known, "spread_by_data": spread(runs), "data": listed}


def main(path: Path) -> None:
    """Count everything; write path, print a table."""
    folder = path.parent / "count"
    folder.mkdir(parents=True, exist_ok=True)
    listed = every(folder)
    version = [subprocess.run([t, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
               for t in (COMPILER[0], "valgrind")]  # fmt: skip
    content = {
        "compiler": version[0],
        "flags": COMPILER[1:],
        "tool": version[1],
        "configurations": {name: _content(runs) for name, runs in listed.items()},
    }
    path.write_text(json.dumps(content, indent=2) + "\n")
    show(listed)
    say(f"{version[0]} · {' '.join(COMPILER[1:])} · {path}")


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except ZygosError as error:
        sys.exit(f"zygos: {error}")

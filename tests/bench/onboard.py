# SPDX-License-Identifier: MIT
"""What the refinement on board costs on a Cortex-M7: the table of docs/results.md.

    python -m bench.onboard

Counts the instructions of every slice under QEMU. Cycles are those of simulated motions; the start is the true model
with 0.3 % of deviation.
"""

from __future__ import annotations

import struct
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from build_support import INCLUDE, objects
from numpy.typing import NDArray
from refine_support import noisy, plant
from runs_support import trajectory_of

from bench import cortex
from bench.configurations import build_of
from bench.counting import STAGES
from bench.rows import FOLDER
from conftest import ROOT
from zygos.native import flight
from zygos.refinement.motion import FlexibleMotion
from zygos.simulation.scenario import load_scenario

DRIVER = Path(__file__).with_name("refine.c")
PHASES = ("take", "move", "slopes", "series", "carry", "table", "rows", "read", "close")
"""As enum phase in c/refine/refine.c."""
_END = 255


@dataclass(frozen=True)
class Case:
    """An arm, and how its readings are used."""

    example: str
    capacities: tuple[str, ...]
    every: int
    """Cycles to a use of readings."""
    terms: int
    cycles: int


CASES = {
    "planar, 2 joints, every cycle": Case("paper", ("-DZYGOS_MAX_JOINTS=2", "-DZYGOS_SPATIAL=0"), 1, 6, 60),
    "space, 3 joints, every 20th cycle": Case("spatial", ("-DZYGOS_MAX_JOINTS=3",), 20, 12, 260),
}


@dataclass(frozen=True)
class Cost:
    """What was counted; n slices."""

    phase: NDArray[np.int64]
    """(n,) place in PHASES."""
    cycle: NDArray[np.int64]
    """(n,) number of the cycle after which the slice was done."""
    instructions: NDArray[np.int64]
    """(n,)"""
    bytes: int
    """Of zygos_refine_t, with filter and scratch,"""
    filter: int
    """and of its filter alone."""
    result: bytes
    """Estimate and root at the end."""

    def period(self, every: int) -> dict[str, float]:
        """Instructions from one use of readings to the next, by phase, after the state has begun."""
        begun = int(self.cycle[self.phase == PHASES.index("move")].min())
        last = int(self.cycle.max())
        first = last - (last - begun) // every * every
        chosen = self.cycle > first
        uses = (last - first) / every
        return {
            name: float(self.instructions[chosen & (self.phase == k)].sum()) / uses for k, name in enumerate(PHASES)
        }


def write_run(case: Case, path: Path) -> None:
    """Write what refine.c reads."""
    arm, model = noisy(case.example, 0.005), plant(case.example)
    scenario = load_scenario(ROOT / "examples" / case.example / "scenario.toml")
    seconds = case.cycles * arm.period_s
    run = trajectory_of(arm, model, scenario, duration_s=seconds, rtol=1e-6, atol=1e-8).cycles()
    truth = model.base_values(arm)
    sigma = 0.003 * FlexibleMotion(arm, truth).size
    with build_of(case.capacities) as ffi:
        config, estimate = flight.config_of(arm), ffi.new("zygos_estimate_t *")
        estimate.parameters, estimate.validity = len(truth), 3
        for k, (value, own) in enumerate(zip(truth.tolist(), sigma.tolist(), strict=True)):
            estimate.value[k], estimate.sigma[k], estimate.half95[k] = value, own, 2.0 * own
            estimate.covariance[k * (k + 1) // 2 + k] = own**2
        parts = [bytes(ffi.buffer(one)) for one in (config, estimate)]
        cycles = bytes(ffi.buffer(flight.cycles_to_native(run)))
        size = ffi.sizeof("zygos_cycle_t")
    head = struct.pack("=6Id", *map(len, parts), size, len(run), case.every, case.terms, 0.005)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(head + b"".join(parts) + cycles[: size * len(run)])


def on_host(case: Case, folder: Path) -> bytes:
    """Estimate and root at the end, by a program of this machine on folder/run.bin."""
    program = folder / "driver"
    compiler = ["gcc", "-std=c11", "-O1", "-ffp-contract=off", *case.capacities]
    command = [*compiler, INCLUDE, f"-I{ROOT / 'c' / 'ports' / 'cortex-m'}", DRIVER, DRIVER.with_name("host.c")]
    subprocess.run([*command, *objects(compiler), "-lm", "-o", str(program)], check=True)
    subprocess.run([program.resolve()], cwd=folder, check=True)
    return _split((folder / "out.bin").read_bytes())[2]


def _split(out: bytes) -> tuple[NDArray[np.uint8], tuple[int, ...], bytes]:
    """Phases, sizes, and the rest of out.bin, which ends with n entries and n (n + 1) / 2 of the root."""
    for n in range(1, 300):
        at = len(out) - 8 * (n + n * (n + 1) // 2) - 16
        if at >= 0 and struct.unpack_from("<4I", out, at)[3] == n:
            return np.frombuffer(out[:at], np.uint8), struct.unpack_from("<4I", out, at), out[at + 16 :]
    raise ValueError("out.bin has no end")


@cache
def measure(name: str, target: str = "m7") -> Cost:
    """Run a case under QEMU. Errors: as `cortex.run`."""
    case, folder = CASES[name], FOLDER / target / f"refine-{CASES[name].example}"
    write_run(case, folder / "run.bin")
    elf = cortex.firmware.build(target, folder / "driver.elf", [DRIVER], case.capacities)
    names = cortex.write_symbols(elf, folder / "symbols.txt")
    parts = cortex.run(target, elf, folder).reshape(-1, len(STAGES) + len(names))
    marks, sizes, result = _split((folder / "out.bin").read_bytes())
    own = parts[: len(marks), STAGES.index("step")]
    cycle = np.concatenate([[0], np.cumsum(marks == _END)[:-1]])
    slices = marks != _END
    return Cost(marks[slices].astype(np.int64), cycle[slices], own[slices], sizes[0], sizes[1], result)


def row(name: str) -> str:
    """A row of the table."""
    case, cost = CASES[name], measure(name)
    period = cost.period(case.every)
    moved = period["take"] + period["move"]
    cells = [
        name, f"{moved / case.every:,.0f}", f"{sum(period.values()) - moved:,.0f}", f"{sum(period.values()):,.0f}",
        f"{int(cost.instructions.max()):,}", f"{cost.bytes:,}", f"{cost.filter:,}",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Measure, and print."""
    print(
        "| arm | state, a cycle | filter, a use of readings | all, a use of readings | largest slice | bytes | filter |"
    )
    for name, case in CASES.items():
        print(row(name))
        for part, count in measure(name).period(case.every).items():
            print(f"    {part} {count:,.0f}")


if __name__ == "__main__":
    main()

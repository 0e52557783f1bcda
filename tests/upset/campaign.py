"""Flies the campaign of campaign.c and says which members of the state the silent trials hit."""

from __future__ import annotations

import subprocess
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from runs_support import trajectory_of
from state_support import Leaf, leaves

from bench.configurations import Configuration, build_of, write_run
from conftest import ROOT, house_flags
from zygos.arm import load_arm
from zygos.model.model import load_model
from zygos.simulation.scenario import load_scenario

FOLDER = Path("out/upset")
OUTCOMES = ("unfinished", "no effect", "detected", "silent", "crash", "hang")
"""As `enum outcome` of campaign.c counts."""
RECORD = np.dtype([("bit", "<u8"), ("cycle", "<u4"), ("outcome", "<u4"), ("moved", "<f8")])
SANITIZED = ["-fsanitize=bounds,integer-divide-by-zero", "-fsanitize-undefined-trap-on-error"]
"""A wrong index of an array is a crash even where it stays inside the state."""
ARC_CYCLES = 300
"""Of the energy rows, so that arcs end before and behind each flip."""


@dataclass(frozen=True)
class Campaign:
    """An arm, and the build that flies it."""

    title: str
    example: str
    capacities: tuple[str, ...]
    duration_s: float
    first: int
    """First cycle in which bits flip; by then an estimate is adopted."""
    in_place: bool = False
    """Whether estimates are made without a copy of the sums, `zygos_arm_solve()`."""


PLANAR = ("-DZYGOS_MAX_JOINTS=2", "-DZYGOS_SPATIAL=0", "-DZYGOS_MOMENTUM=0")
FEWEST = ("-DZYGOS_MAX_BLOCKS=11", "-DZYGOS_MAX_MOTOR_BLOCKS=4")
CAMPAIGNS = {
    "planar": Campaign("2 joints in a plane", "paper", PLANAR, 120.0, 1500),
    "in_place": Campaign(
        "2 joints in a plane, 11 blocks, solved in place", "paper", (*PLANAR, *FEWEST), 120.0, 1500, in_place=True
    ),
    "spatial": Campaign("3 joints in space", "spatial", ("-DZYGOS_MAX_JOINTS=3",), 30.0, 12000),
}


def write(one: Campaign, folder: Path) -> int:
    """Simulate the motion and write what the program reads. Returns the number of cycles."""
    place = ROOT / "examples" / one.example
    arm, model = load_arm(place / "arm.toml"), load_model(place / "model.toml")
    arm = replace(arm, arc_max_s=ARC_CYCLES * arm.period_s)
    cycles = trajectory_of(arm, model, load_scenario(place / "scenario.toml"), duration_s=one.duration_s).cycles()
    write_run(Configuration(one.example, arm, one.capacities), cycles, folder / "run.bin")
    return len(cycles)


def build(one: Campaign, folder: Path) -> Path:
    """Compile library and campaign with the house flags."""
    program = folder / "campaign"
    sources = [*sorted((ROOT / "c").glob("*.c")), ROOT / "tests" / "upset" / "campaign.c"]
    flags = [flag for flag in house_flags() if flag != "-std=c11"]
    chosen = [*one.capacities, *(["-DCAMPAIGN_IN_PLACE"] if one.in_place else [])]
    command = ["gcc", "-std=gnu11", *flags, "-g", *SANITIZED, *chosen, f"-I{ROOT / 'include'}"]
    subprocess.run([*command, *map(str, sources), "-o", str(program)], check=True)
    return program


def fly(name: str, trials: int, seed: int = 0, folder: Path = FOLDER) -> NDArray[Any]:
    """The records of so many trials with the seeds from `seed` on."""
    one, place = CAMPAIGNS[name], folder / name
    place.mkdir(parents=True, exist_ok=True)
    cycles = write(one, place)
    program = build(one, place)
    last = cycles - 2 * ARC_CYCLES
    command = ["nice", "-n", "15", program, place / "run.bin", one.first, last, trials, seed, place / "records.bin"]
    subprocess.run([str(part) for part in command], check=True, stderr=(place / "said.txt").open("w"))
    return np.fromfile(place / "records.bin", dtype=RECORD)


def leaves_of(name: str) -> list[Leaf]:
    """The numbers of the state in the build of a campaign."""
    with build_of(CAMPAIGNS[name].capacities) as binding:
        return list(leaves(binding.typeof("zygos_arm_t"), sizeof=binding.sizeof))


def members(name: str, records: NDArray[Any]) -> Counter[str]:
    """How often the records hit each member."""
    listed = leaves_of(name)
    first = np.array([leaf.offset for leaf in listed])
    at = np.searchsorted(first, records["bit"] // 8, side="right") - 1
    return Counter(listed[k].member for k in at)


def sizes(name: str) -> Counter[str]:
    """Bytes of each member, of all elements of arrays of structs together."""
    out: Counter[str] = Counter()
    for leaf in leaves_of(name):
        out[leaf.member] += leaf.size * leaf.count
    return out

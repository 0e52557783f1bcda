# SPDX-License-Identifier: MIT
"""Flies the campaign of campaign.c and says which members of the library's memory the silent trials hit."""

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
from zygos.arm import JOINT_ROW_S, load_arm
from zygos.model.model import load_model
from zygos.simulation.scenario import load_scenario

FOLDER = Path("out/upset")
OUTCOMES = ("unfinished", "no effect", "detected", "silent", "crash", "hang")
"""As `enum outcome` of campaign.c counts."""
RECORD = np.dtype([("bit", "<u8"), ("other", "<u8"), ("cycle", "<u4"), ("outcome", "<u4"), ("moved", "<f8")])
IN_PLACE, REFINED, PAIRS = 1, 2, 4
"""What campaign.c calls KIND is a sum of these."""
SANITIZED = ["-fsanitize=bounds,integer-divide-by-zero", "-fsanitize-undefined-trap-on-error"]
"""A wrong index of an array is a crash even where it stays inside the memory of the library."""
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
    kind: int = 0
    memory_s: float | None = None
    """Where sums of closed arcs fade."""
    joint_rows: bool = False
    behind: int = 3 * ARC_CYCLES
    """Cycles of the flight behind the last flip, in which two more estimates are given."""

    @property
    def structs(self) -> list[str]:
        """The memory in which bits flip, in this order."""
        memory = "zygos_in_place_t" if self.kind & IN_PLACE else "zygos_background_t"
        return ["zygos_t", memory, *(["zygos_refine_t"] if self.kind & REFINED else [])]


PLANAR = ("-DZYGOS_MAX_JOINTS=2", "-DZYGOS_SPATIAL=0", "-DZYGOS_MOMENTUM=0")
FEWEST = (*PLANAR, "-DZYGOS_MAX_BLOCKS=11", "-DZYGOS_MAX_MOTOR_BLOCKS=4")
CAMPAIGNS = {
    "planar": Campaign("2 joints in a plane", "paper", PLANAR, 140.0, 1500),
    "in_place": Campaign("2 joints in a plane, 11 blocks, in place", "paper", FEWEST, 140.0, 1500, IN_PLACE),
    "refined": Campaign("2 joints in a plane, refined", "paper", PLANAR, 140.0, 1500, REFINED),
    "fading": Campaign("2 joints in a plane, fading", "paper", PLANAR, 140.0, 1500, memory_s=30.0),
    "pairs": Campaign("2 joints in a plane, pairs of bits", "paper", PLANAR, 140.0, 1500, PAIRS),
    "spatial": Campaign(
        "3 joints in space", "spatial", ("-DZYGOS_MAX_JOINTS=3",), 34.0, 12000, joint_rows=True, behind=3000
    ),
}


def write(one: Campaign, folder: Path) -> int:
    """Simulate the motion and write what the program reads. Returns the number of cycles."""
    place = ROOT / "examples" / one.example
    arm, model = load_arm(place / "arm.toml"), load_model(place / "model.toml")
    arm = replace(arm, arc_max_s=ARC_CYCLES * arm.period_s, memory_s=one.memory_s)
    arm = replace(arm, joint_increment_s=JOINT_ROW_S) if one.joint_rows else arm
    cycles = trajectory_of(arm, model, load_scenario(place / "scenario.toml"), duration_s=one.duration_s).cycles()
    write_run(Configuration(one.example, arm, one.capacities), cycles, folder / "run.bin")
    return len(cycles)


def build(one: Campaign, folder: Path) -> Path:
    """Compile library and campaign with the house flags."""
    program = folder / "campaign"
    sources = [*sorted((ROOT / "c").glob("*/*.c")), ROOT / "tests" / "upset" / "campaign.c"]
    flags = [flag for flag in house_flags() if flag != "-std=c11"]
    command = ["gcc", "-std=gnu11", *flags, "-g", *SANITIZED, *one.capacities, f"-I{ROOT / 'include'}"]
    subprocess.run([*command, *map(str, sources), "-o", str(program)], check=True)
    return program


def fly(name: str, trials: int, seed: int = 0, folder: Path = FOLDER) -> NDArray[Any]:
    """The records of so many trials with the seeds from `seed` on."""
    one, place = CAMPAIGNS[name], folder / name
    place.mkdir(parents=True, exist_ok=True)
    cycles = write(one, place)
    program = build(one, place)
    last = cycles - one.behind
    places = [place / "run.bin", one.first, last, trials, seed, one.kind, place / "records.bin"]
    command = ["nice", "-n", "15", program, *places]
    subprocess.run([str(part) for part in command], check=True, stderr=(place / "said.txt").open("w"))
    return np.fromfile(place / "records.bin", dtype=RECORD)


def leaves_of(name: str) -> list[Leaf]:
    """The numbers of the memory in the build of a campaign, in the order of their places."""
    one, out, first = CAMPAIGNS[name], [], 0
    with build_of(one.capacities) as binding:
        for struct in one.structs:
            kind = binding.typeof(struct)
            prefix = "" if struct == "zygos_t" else struct.split("_")[1]
            out += leaves(kind, prefix, first, binding.sizeof)
            first += binding.sizeof(kind)
    return out


def members(name: str, records: NDArray[Any]) -> Counter[str]:
    """How often the records hit each member; of a pair both together."""
    listed = leaves_of(name)
    first = np.array([leaf.offset for leaf in listed])
    at, other = (np.searchsorted(first, records[bit] // 8, side="right") - 1 for bit in ("bit", "other"))
    pair = records["bit"] != records["other"]
    return Counter(
        listed[k].member + (f", {listed[j].member}" if both else "") for k, j, both in zip(at, other, pair, strict=True)
    )


def sizes(name: str) -> Counter[str]:
    """Bytes of each member, of all elements of arrays of structs together."""
    out: Counter[str] = Counter()
    for leaf in leaves_of(name):
        out[leaf.member] += leaf.size * leaf.count
    return out

# SPDX-License-Identifier: MIT
"""Bytes of code and of stack, stage by stage, as compiled and linked for a target."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from calls_support import Calls

from bench import callgrind
from bench.cortex import firmware
from bench.counting import FOLDED, ROOMS, WHOLE
from conftest import ROOT

ENTRIES = ("zygos_init", "zygos_frame", "zygos_step", "zygos_solve")
"""What an onboard program calls; all else is left out by the linker."""
REFINEMENT = {"attach", "refine", "refiner", "propagation"}
"""Files that a program leaves out, or an archive does not link, where nothing is refined."""
LIBRARY = "library"
"""The stage of all of them together."""

SUMS = ("store", "sums")
"""Files with what the sums of several kinds of rows have in common: of the room in which rows are added to sums."""


@dataclass(frozen=True)
class Footprint:
    """Bytes of a stage."""

    code: int
    """Instructions and constants. Of a room, those of its files; of frame, step, solve and the library, all that they
    reach. Without what the compiler's runtime adds."""
    stack: int
    """Below and including the deepest call, without that of the compiler's runtime."""


def footprints(target: str, folder: Path, capacities: tuple[str, ...]) -> dict[str, Footprint]:
    """Of each stage and of the library. Compiles into folder."""
    host = target == "x86-64"
    # Arguments that x86 would push for a call become a part of the frame, as they are on the others.
    compiler = [*callgrind.COMPILER, "-maccumulate-outgoing-args"] if host else firmware.compiler(target)
    prefix = "" if host else "arm-none-eabi-"
    folder.mkdir(parents=True, exist_ok=True)
    rooms = sorted((ROOT / "c").glob("*/*.c"))
    includes = ["-I", str(ROOT / "include")]
    # functions with the same content stay apart: one that was folded into another has no stack in the call graph
    sections = ["-fno-ipa-icf", "-fcallgraph-info=su", "-ffunction-sections", "-fdata-sections"]
    subprocess.run([*compiler, *sections, *capacities, *includes, "-c", *map(str, rooms)], cwd=folder, check=True)
    calls = Calls(folder)

    def linked(*entries: str) -> Path:
        image = folder / "linked.elf"
        keep = [f"--undefined={entry}" for entry in entries]
        command = [f"{prefix}ld", "--gc-sections", f"--entry={entries[0]}", *keep, "--unresolved-symbols=ignore-all"]
        objects = [f"{room.stem}.o" for room in rooms if room.stem not in REFINEMENT]
        subprocess.run([*command, *objects, "-o", image.name], cwd=folder, check=True)
        return image

    found = {}
    for stage, entries in {**{one: (f"zygos_{one}",) for one in WHOLE}, LIBRARY: ENTRIES}.items():
        sizes = subprocess.run(
            [f"{prefix}size", "-A", str(linked(*entries))], capture_output=True, text=True, check=True
        )
        code = sum(int(size) for size in re.findall(r"^\.(?:text|rodata)\S*\s+(\d+)", sizes.stdout, re.M))
        found[stage] = Footprint(code, max(calls.depth(entry) for entry in entries))
    listing = subprocess.run(
        [f"{prefix}nm", "-S", "-l", "--defined-only", str(linked(*ENTRIES))], capture_output=True, text=True, check=True
    ).stdout
    code_of = dict.fromkeys(ROOMS, 0)
    stack_of = dict.fromkeys(ROOMS, 0)
    for size, name, file in re.findall(r"^\S+ ([0-9a-f]+) [TtRr] (\S+)\t.*?([a-z]+)\.c:\d+$", listing, re.M):
        room = FOLDED.get(file, "accumulator" if file in SUMS else file)
        if room in code_of:
            code_of[room] += int(size, 16)
            stack_of[room] = max(stack_of[room], calls.depth(name) if name in calls.calls else 0)
    return {**{room: Footprint(code_of[room], stack_of[room]) for room in ROOMS}, **found}

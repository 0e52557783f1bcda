# SPDX-License-Identifier: MIT
"""Write the bytes of the structs, and where they are beside the budgets, into docs/cost.md, and what `zygos
compile-model` proposes for the paper's arm into README.md, docs/tasks.md and docs/integrate.md.

PYTHONPATH=tests:tests/support python -m bench.sizes
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from conftest import ROOT
from zygos.files.output import write_text
from zygos.native.sizes import memory

ROW = re.compile(r"^(\| (\d) \| (\d) \| (\d+) \|).*$", re.M)
"""A row of the manual's table: joints, whether spatial, blocks."""
STRUCTS = {
    "arm": "zygos_arm_t", "work": "zygos_work_t", "solver": "zygos_solver_t", "estimate": "zygos_estimate_t",
    "energy": "zygos_accumulator_t",
    "motors": "zygos_motor_sums_t", "momentum": "zygos_momentum_sums_t", "joints": "zygos_joint_sums_t",
}  # fmt: skip
USUAL, LEAST = "usual capacities", "least capacities"
SMALLEST = (
    "MAX_BLOCKS=11", "MAX_MOTOR_BLOCKS=4", "MAX_MOMENTUM_BLOCKS=4", "MAX_EFFECTS=0", "MAX_REDUCTION=0", "JOINT_ROWS=0",
    "MAX_HALF_WIDTH=7",
)  # fmt: skip
"""The least numbers of blocks, no effects and no joint rows, which a free base with springs does not need, and windows
of 15 points."""
PLANAR = ("MAX_JOINTS=2", "SPATIAL=0")
BUILDS = (
    ("2 joints in a plane", (42, 78), PLANAR, (*SMALLEST, "MOMENTUM=0", "MAX_PARAMETERS=12")),
    ("3 joints in space", (395, 490), ("MAX_JOINTS=3",), SMALLEST),
    ("7 joints in space", (3400, 3600), ("MAX_JOINTS=7",), SMALLEST),
)
"""Arm, budgets in kB without and with eight effects, capacities, and those of the least build beside them."""
EFFECTS = 8
BEGIN, END = "<!-- python -m bench.sizes writes this -->\n", "<!-- to here -->"


def sizes(*capacities: str) -> dict[str, int]:
    """Bytes of each struct at these capacities, without their prefix, by the compiler of this machine."""
    flags = [f"-DZYGOS_{capacity}" for capacity in capacities]
    rooms = ", ".join(f"{name}[sizeof({struct})]" for name, struct in STRUCTS.items())
    source = f'#include "zygos/zygos.h"\nchar {rooms};\n'
    with TemporaryDirectory() as folder:
        out = str(Path(folder, "sizes.o"))
        command = ["cc", "-std=c11", *flags, "-I", str(ROOT / "include"), "-x", "c", "-c", "-o", out, "-"]
        subprocess.run(command, input=source, text=True, check=True)
        listed = subprocess.run(["nm", "-S", "-t", "d", out], capture_output=True, text=True, check=True).stdout
    return {name: int(size) for size, name in re.findall(r"^\d+ 0*(\d+) B (\w+)$", listed, re.M)}


def total(size: dict[str, int]) -> int:
    """Bytes of the three structs that a program needs."""
    return size["arm"] + size["work"] + size["estimate"]


def in_place(size: dict[str, int]) -> int:
    """The same of a program that solves in place."""
    return size["arm"] + size["solver"] + size["estimate"]


def profile() -> str:
    """The table of where the bytes are, in kB."""
    head = ["", "budget", "in place", "with a copy", "energy rows", "motor rows", "momentum rows", "joint rows",
            "rest of the state", "solver", "estimate"]  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "| --- |" + " ---: |" * (len(head) - 1)]
    kinds = ("energy", "motors", "momentum", "joints")
    for title, (budget, with_effects), usual, least in BUILDS:
        fewest = (*usual, *least)
        more = {"MAX_PARAMETERS=12": f"MAX_PARAMETERS={12 + EFFECTS}", "MAX_EFFECTS=0": f"MAX_EFFECTS={EFFECTS}"}
        for name, limit, capacities in (
            (LEAST, f"{budget:,}", fewest),
            (f"the same and {EFFECTS} effects", f"{with_effects:,}", [more.get(flag, flag) for flag in fewest]),
            (USUAL, "", usual),
        ):
            size = sizes(*capacities)
            rows = [size[kind] for kind in kinds]
            cells = [in_place(size), total(size), *rows, size["arm"] - sum(rows), size["solver"], size["estimate"]]
            shown = [f"{cell / 1000:,.0f}" for cell in cells]
            lines.append(f"| {title}, {name} | {limit} | " + " | ".join(shown) + " |")
    return "\n".join(lines) + "\n"


def with_gains(written: str) -> str:
    """What the builds of an arm_config.h take with columns for the error of a torque sensor's gain, in a sentence."""
    said = []
    for count in (1, 2):
        for in_place, build in enumerate(re.findall(r"^// [TW].*: (-D.*)$", written, re.M)):
            given = {name: int(value) for name, value in re.findall(r"-D(\w+)=(\d+)", build)}
            given["ZYGOS_MAX_EFFECTS"] += count
            given["ZYGOS_MAX_PARAMETERS"] += count
            said.append(f"{sum(memory(given, in_place=bool(in_place)).values()) / 1000:.1f}")
    return (
        "With one column for the error of a torque sensor's gain, what `compile-model` proposes for the paper's arm "
        f"takes\n{said[0]} kB with a background solver and {said[1]} kB in place; with two such columns {said[2]} and "
        f"{said[3]} kB.\n"
    )


def main() -> None:
    """Measure every row of docs/cost.md, the budgets, and what `zygos compile-model` proposes for the paper's arm."""

    def row(found: re.Match[str]) -> str:
        given = {"ZYGOS_MAX_JOINTS": int(found[2]), "ZYGOS_SPATIAL": int(found[3]), "ZYGOS_MAX_BLOCKS": int(found[4])}
        size = memory(given) | memory(given, in_place=True)
        cells = [f"{size[name]:,}" for name in ("arm", "background", "in_place", "estimate")]
        return f"{found[1]} {' | '.join(cells)} |"

    manual, tasks, readme, cost = (
        ROOT / page for page in ("docs/integrate.md", "docs/tasks.md", "README.md", "docs/cost.md")
    )
    written = (ROOT / "examples" / "onboard" / "arm_config.h").read_text()
    usual, fewest = re.findall(r" takes ([\d,]+) bytes", written)
    said = f"{usual} bytes for that of the paper, and {fewest} in place"
    write_text(manual, re.sub(r"[\d,]+ bytes for that of the paper, and [\d,]+ in place", said, manual.read_text()))
    copied, placed = (int(size.replace(",", "")) / 1000 for size in (usual, fewest))
    text = re.sub(r"(paper's arm:) \d+ kB for", rf"\1 {copied:.0f} kB for", tasks.read_text())
    write_text(tasks, re.sub(r"; [\d.]+ kB where", f"; {placed:.1f} kB where", text))
    said = f"{copied:.0f} kB, or {placed:.1f} kB where frames wait"
    write_text(readme, re.sub(r"\d+ kB, or [\d.]+ kB where frames wait", said, readme.read_text()))
    large = memory({"ZYGOS_MAX_JOINTS": 7, "ZYGOS_SPATIAL": 1, "ZYGOS_MAX_BLOCKS": 32})
    together = (sum(large.values()) - large["configuration"]) / 1e6
    text = re.sub(r"(estimate, take|joints take) [\d.]+ MB", rf"\1 {together:.1f} MB", ROW.sub(row, cost.read_text()))
    two, three, seven = (in_place(sizes(*given, *least)) for _, _, given, least in BUILDS)
    said = (
        f"takes {two / 1000:.0f} kB for two joints, {three / 1000:.0f} kB for three and {seven / 1e6:.1f} MB\nfor seven"
    )
    text = re.sub(r"takes \d+ kB for two joints, \d+ kB for three and [\d.]+ MB\nfor seven", said, text)
    before, _, rest = text.partition(BEGIN)
    written_by_this = f"{BEGIN}\n{profile()}\n{with_gains(written)}\n{END}"
    write_text(cost, before + written_by_this + rest.partition(END)[2])


if __name__ == "__main__":
    main()

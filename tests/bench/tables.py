# SPDX-License-Identifier: MIT
"""The tables that docs/cost.md has of docs/bench.json, a copy of what `make bench` found last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import peers
from bench.configurations import BARE, CONFIGURATIONS, JOINT_ROWS
from bench.counting import ROOMS, TOGETHER
from bench.solutions import dearest
from conftest import ROOT
from zygos.files.output import write_text

COMMITTED = ROOT / "docs" / "bench.json"
TITLES = {"x86-64": "x86-64", "m7": "Cortex-M7", "m4f": "Cortex-M4F"}
ARMS = {"paper": "planar, 2 joints", "spatial": "space, 3 joints", "seven": "space, 7 joints",
        "ground": "fixed base, 6 rigid joints"}  # fmt: skip
SIZED = [name for name in CONFIGURATIONS if name.endswith(BARE) or name == "ground" + JOINT_ROWS]
"""Configurations of which the tables have bytes: one of each build."""


BUDGETS = {("x86-64", "paper, bare"): 3000, ("m7", "paper, bare"): 3600, ("m7", "seven, bare"): 80_000}
"""Most instructions of a full cycle, by target and configuration."""
HELD = {("x86-64", "paper, bare"): 5270, ("m7", "paper, bare"): 5600, ("m7", "seven, bare"): 90_000}
"""What is held: a budget that is met, and what stands in place of those that are missed. Each cycle stores its frames
in the interrupt and decodes them in the task, verifies the places by which it addresses memory, the integrals and a
part of the tables (docs/upset.md), and has its share of the work beside the rows."""
WHOLE = {"paper, bare": 0.5, "spatial, bare": 0.9, "seven, bare": 0.9}
"""Most that kinematics, balance and accumulator take of the instructions of Pinocchio and Eigen for the same p."""
NEEDED = ("wire", "cycle", "smoother", "kinematics", "balance")
"""Stages that every design has."""
FLAT = 1.51
"""Most that a cycle costs relative to the mean."""
QUARTER = 0.25
"""Most that balance and accumulator take of the instructions of Pinocchio, as it comes, and Eigen; paper's arm."""
CLOCK_MHZ, CYCLES_PER_INSTRUCTION = 216.0, (1.0, 2.0)
"""For times on a Cortex-M7: a usual clock, and what is assumed, not measured. The processor issues up to two
instructions a cycle; products of doubles, branches and memory beyond the caches take several."""
SHOWN = 12
"""Functions of a profile that a table has."""


@dataclass(frozen=True)
class Block:
    """Lines of a file between two markers."""

    path: Path
    title: str
    text: str

    @property
    def markers(self) -> tuple[str, str]:
        """What stands before and behind the lines."""
        return f"<!-- make bench writes this {self.title} -->", "<!-- to here -->"

    def _split(self) -> tuple[str, str, str]:
        begin, end = self.markers
        before, _, rest = self.path.read_text().partition(begin + "\n")
        found, _, behind = rest.partition(end)
        return before, found, behind

    def found(self) -> str:
        """What stands there."""
        return self._split()[1]

    def write(self) -> None:
        """Put the text there."""
        before, _, behind = self._split()
        begin, end = self.markers
        write_text(self.path, f"{before}{begin}\n{self.text}{end}{behind}")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:,.0f}"


def _arm(name: str) -> str:
    return ARMS[name.partition(", ")[0]]


def _title(name: str, parameters: int) -> str:
    rows = name.partition(", ")[2]
    said = {
        "": ", everything on", "bare": "", "joint rows": ", everything and joint rows on",
        "ground": ", joint rows and energy rows", "ground, joint rows": ", joint rows alone",
    }  # fmt: skip
    return f"{_arm(name)}, p = {parameters}{said.get(name, said[rows])}"


def ratios(content: dict[str, Any], name: str) -> dict[str, float]:
    """zygos over Pinocchio with Eigen, in the same run: of instructions and of time, and of its sums alone over those
    of Pinocchio as it comes."""
    of = {peer["name"]: peer for peer in content["peers"] if peer["configuration"] == name}
    peer, ours = of[peers.PINOCCHIO], of[peers.ZYGOS]
    return {
        "instructions": ours["instructions"] / peer["instructions"],
        "sums to its own": of[peers.SUMS]["instructions"] / of[peers.OWN]["instructions"],
        "time": ours["nanoseconds"] / peer["nanoseconds"],
    }


def blocks(content: dict[str, Any]) -> list[Block]:
    """What the page has to say: the summary at its begin, and the details."""
    page = ROOT / "docs" / "cost.md"
    return [Block(page, "summary", _summary(content)), Block(page, "table", _details(content))]


def _summary(content: dict[str, Any]) -> str:
    rows = {(row["target"], row["configuration"], row["stage"]): row for row in content["rows"]}
    cycles, sizes = [], []
    for name in CONFIGURATIONS:
        here = [rows[target, name, TOGETHER] for target in TITLES]
        cycles.append([_title(name, here[0]["parameters"]), *(_number(row["instructions"]) for row in here)])
    for name in SIZED:
        here = [rows[target, name, "library"] for target in TITLES]
        structs = rows["x86-64", name, "library"]["bytes_state"]
        cells = (f"{row['bytes_code'] / 1000:.0f} kB, {_number(row['bytes_stack'])} B" for row in here)
        sizes.append([_arm(name), *cells, f"{structs / 1000:,.0f} kB"])
    compared = " · ".join(
        f"{_arm(name)} {ratios(content, name)['instructions']:.2f}"
        for name in CONFIGURATIONS if name.endswith(BARE)
    )  # fmt: skip
    return (
        "\n"
        + _table(("instructions of a full cycle", *TITLES.values()), cycles)
        + "\n"
        + _table(("code and deepest stack", *TITLES.values(), "state + work + estimate"), sizes)
        + "\nInstructions of kinematics, balance and accumulator, divided by those of Pinocchio's C++ regressor with "
        f"Eigen's rank-1 update, for the same p at -O2: {compared}.\n\n"
    )


def _details(content: dict[str, Any]) -> str:
    out = ["\n" + " · ".join(content["tools"].values()) + "\n"]
    of = {(row["target"], row["configuration"], row["stage"]): row for row in content["rows"]}
    out.append(_budgets(content, of))
    out.append(_most_expensive(of))
    out.append(_times(of))
    out.append(_solutions(content["solutions"]))
    for name in CONFIGURATIONS:
        head = [f"{title}{what}" for title in TITLES.values() for what in ("", ", spread", ", most")]
        lines = []
        for stage in (*ROOMS[:-1], "frame", "step", TOGETHER, "solve"):
            here = [of[target, name, stage] for target in TITLES]
            lines.append([stage, *(_number(row[key]) for row in here for key in ("instructions", "spread", "most"))])
        title = _title(name, of["x86-64", name, "step"]["parameters"])
        out.append(f"\n### Instructions: {title}\n\n" + _table(("stage", *head), lines))
    for name in SIZED:
        head = [f"{title}, {what}" for title in TITLES.values() for what in ("code", "stack")]
        lines = []
        for stage in (*ROOMS, "frame", "step", "solve", "library"):
            here = [of[target, name, stage] for target in TITLES]
            cells = [_number(row[key]) for row in here for key in ("bytes_code", "bytes_stack")]
            lines.append([stage, *cells, _number(here[0]["bytes_state"])])
        out.append(f"\n### Bytes: {_arm(name)}\n\n" + _table(("stage", *head, "state"), lines))
    lines = []
    for peer in content["peers"]:
        arm = _arm(peer["configuration"])
        base = next(
            other for other in content["peers"]
            if (other["configuration"], other["name"]) == (peer["configuration"], peers.ZYGOS)
        )  # fmt: skip
        cells = [
            _ratio(peer["instructions"], base["instructions"]),
            _ratio(peer["nanoseconds"], base["nanoseconds"]),
        ]
        lines.append([f"{arm}: {peer['name']}", _number(peer["instructions"]), *cells])
    out.append(
        "\n### Comparison with other software\n\n"
        + _table(("one sample", "instructions", "instructions relative to zygos", "time relative to zygos"), lines)
    )
    frames = content["frames_per_second"]
    fastest = max(frames.values())
    out.append(
        "\n### Frames\n\n"
        + _table(
            ("frames into the library, the paper's arm", "share of the fastest"),
            [[k, f"{v / fastest:.4f}"] for k, v in frames.items()],
        )
        + "\n"
    )
    return "".join(out)


def products(of: dict[tuple[str, str, str], dict[str, Any]], target: str, name: str) -> float:
    """Instructions of a product and a sum for each entry of the normal matrix, one an entry: two for two entries
    at a time on x86-64, and one that does both on Cortex-M7."""
    columns = of[target, name, TOGETHER]["parameters"] + 2
    return columns * (columns + 1) / 2


def floor(of: dict[tuple[str, str, str], dict[str, Any]], target: str, name: str) -> float:
    """Instructions of the stages that every design has, and of a product and a sum for each entry."""
    return float(sum(of[target, name, stage]["instructions"] for stage in NEEDED) + products(of, target, name))


def floor_ratio(content: dict[str, Any], of: dict[tuple[str, str, str], dict[str, Any]], name: str) -> float:
    """The same without decoding and smoother, over Pinocchio with Eigen."""
    peer = {peer["name"]: peer["instructions"] for peer in content["peers"] if peer["configuration"] == name}
    balance = of["x86-64", name, "balance"]["instructions"]
    return float((peer[peers.KINEMATICS] + balance + products(of, "x86-64", name)) / peer[peers.PINOCCHIO])


def _budgets(content: dict[str, Any], of: dict[tuple[str, str, str], dict[str, Any]]) -> str:
    """Budgets, and where a full cycle goes that misses its own."""
    lines, missed = [], []
    for (target, name), most in BUDGETS.items():
        row = of[target, name, TOGETHER]
        title = f"{TITLES[target]}: {_title(name, row['parameters'])}"
        lines.append([title, _number(row["instructions"]), _number(floor(of, target, name)), _number(most)])
        if row["instructions"] > most:
            functions = list(content["profiles"][target][name].items())[:SHOWN]
            shown = [
                [function, _number(own), f"{100 * own / row['instructions']:.0f} %"] for function, own in functions
            ]
            missed.append(
                f"\n{title} exceeds its budget. Its most expensive functions are:\n\n"
                + _table(("function", "instructions", "share"), shown)
            )
    found = ratios(content, "paper, bare")
    compared = [
        [
            f"balance + accumulator: {_arm('paper')}, Pinocchio with ten parameters per body, without reduction",
            f"{found['sums to its own']:.2f}",
            "–",
            "–",
            f"{QUARTER}",
        ]
    ]
    for name, share in WHOLE.items():
        found = ratios(content, name)
        title = f"kinematics, balance + accumulator: {_arm(name)}, for the same p (reduction not counted)"
        least = floor_ratio(content, of, name)
        compared.append([title, f"{found['instructions']:.2f}", f"{least:.2f}", f"{found['time']:.2f}", f"{share}"])
    return (
        "\n### Budgets\n\n"
        + _table(("full cycle", "instructions", "floor", "budget"), lines)
        + "\n*Floor*: decoding, smoother, kinematics and balance as they are, and a product and a sum for each entry "
        "of the normal matrix: two instructions for two entries on x86-64, one on Cortex-M7, which has one for both. "
        "Entries are not loaded and stored. The rest is what this design adds: rows are shared out to blocks, "
        "arcs end by a part per cycle, and memory is verified.\n\n"
        + _table(
            ("relative to Pinocchio C++ + Eigen", "instructions", "floor", "time", "budget, instructions"), compared
        )
        + "".join(missed)
    )


def _most_expensive(of: dict[tuple[str, str, str], dict[str, Any]]) -> str:
    """The most expensive cycles over the mean of those that only add rows."""
    lines = []
    for name in CONFIGURATIONS:
        here = [of[target, name, TOGETHER] for target in TITLES]
        cells = [_ratio(row[which], row["instructions"]) for row in here for which in ("most", "waits", "hands")]
        lines.append([_title(name, here[0]["parameters"]), *cells])
    head = [f"{title}{what}" for title in TITLES.values() for what in ("", ", an arc waits", ", hand-over")]
    return (
        "\n### Most expensive cycle, relative to the mean of a full cycle\n\n"
        "Of all cycles, of those in which an arc that has ended waits until the one before it is closed, and of those "
        "in which sums are copied for a solution or its estimate is adopted.\n\n"
        + _table(("configuration", *head), lines)
    )


def _solutions(measured: dict[str, Any]) -> str:
    """What solutions cost by their answer, beside the first of their configuration."""
    cases = measured["cases"]
    first = {one["configuration"]: one for one in reversed(cases)}
    titles = {name: _title(name, one["parameters"]) for name, one in first.items()}
    lines = [
        [
            f"{_title(one['configuration'], one['parameters'])}: {one['case']}",
            one["validity"] + (", without old arcs" if one["left_out"] else ""),
            _number(one["pairs"]),
            _number(one["most"]),
            _number(one["instructions"]),
            _ratio(one["instructions"], first[one["configuration"]]["instructions"]),
        ]
        for one in cases
    ]
    found = []
    for name, title in reversed(titles.items()):
        here = [one for one in cases if one["configuration"] == name]
        found.append(f"{title} {dearest(here, 'instructions'):.2f}")
    return (
        "\n### Dearest solution\n\n"
        f"On x86-64, with the usual capacities, of {measured['zygos']}. *Pairs* are pairs of factorisations of order "
        "p, and *at most* is what `include/zygos/priv/solver.h` states for the blocks of this state. What is valid is "
        "adopted, so that old arcs may be left out. The dearest solution, divided by the dearest valid one for as many "
        "parameters: "
        f"{' · '.join(found)}.\n\n"
        + _table(("state", "answer", "pairs", "at most", "instructions", "relative to the first"), lines)
    )


def _times(of: dict[tuple[str, str, str], dict[str, Any]]) -> str:
    """Times on a Cortex-M7 at a stated clock, as they follow from the counts."""

    def cells(instructions: float, unit_s: float) -> str:
        times = (instructions * cycles / (CLOCK_MHZ * 1e6) / unit_s for cycles in CYCLES_PER_INSTRUCTION)
        return " – ".join(f"{time:,.0f}" if time >= 100.0 else f"{time:.3g}" for time in times)

    lines = []
    for name, make in CONFIGURATIONS.items():
        together, solve = of["m7", name, TOGETHER], of["m7", name, "solve"]
        lines.append(
            [
                _title(name, together["parameters"]),
                f"{1e3 * make().arm.period_s:g}",
                cells(together["instructions"], 1e-6),
                cells(together["most"], 1e-3),
                cells(solve["most"], 1e-3),
            ]
        )
    low, high = CYCLES_PER_INSTRUCTION
    return (
        f"\n### Time on a Cortex-M7 at {CLOCK_MHZ:g} MHz\n\n"
        f"The counts times {low:g} to {high:g} processor cycles per instruction. This factor is assumed: QEMU has "
        "neither caches nor a pipeline. Measure it on the board, with the memory that holds the structs.\n\n"
        + _table(
            (
                "configuration",
                "SYNC period, ms",
                "full cycle, µs",
                "most expensive cycle, ms",
                "solve, ms",
            ),
            lines,
        )
    )


def _ratio(value: float | None, base: float | None) -> str:
    return "–" if value is None or base is None else f"{value / base:.2f}"

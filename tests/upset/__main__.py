# SPDX-License-Identifier: MIT
"""Flips bits in the memory of the flight library and writes what came of it into docs/upset.md (`make upset`).

    python -m upset [share=SHARE] [seed=SEED]

SHARE of TRIALS, default 1. Writes out/upset.json as well. The exit code is 1 after a crash,
a hang, or more silent trials than LIMIT.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from conftest import ROOT
from upset.campaign import CAMPAIGNS, OUTCOMES, fly, members
from zygos.files.output import write_json, write_text
from zygos.report.provenance import measured_commit

DOCUMENT = ROOT / "docs" / "upset.md"
BEGIN, END = "<!-- make upset writes this -->\n", "<!-- to here -->"
TRIALS = {
    "planar": 80_000, "in_place": 40_000, "refined": 8_000, "fading": 32_000, "pairs": 36_000, "spatial": 4_000,
}  # fmt: skip
LIMIT = 1e-4
"""Most silent trials, as a share of all."""


def outcome_of(name: str, trials: int, seed: int) -> dict[str, Any]:
    """Counts of a campaign, and the members that silent trials and crashes hit."""
    records = fly(name, trials, seed)
    count = {outcome: int((records["outcome"] == k).sum()) for k, outcome in enumerate(OUTCOMES)}
    hit = {
        outcome: dict(members(name, records[records["outcome"] == k]).most_common())
        for k, outcome in enumerate(OUTCOMES)
        if k >= OUTCOMES.index("silent")
    }
    return {"trials": len(records), "count": count, "members": hit}


def table(results: dict[str, dict[str, Any]]) -> str:
    """The lines of the page that the command writes."""
    shown = OUTCOMES[1:]
    lines = ["| arm | trials | " + " | ".join(shown) + " |", "|" + " --- |" * (len(shown) + 2)]
    for name, result in results.items():
        cells = [f"{result['count'][outcome]:,}" for outcome in shown]
        lines.append(f"| {CAMPAIGNS[name].title} | {result['trials']:,} | " + " | ".join(cells) + " |")
    trials = sum(result["trials"] for result in results.values())
    silent = sum(result["count"]["silent"] for result in results.values())
    share = f"{silent} were silent: a share of {silent / trials:.1e}." if silent else "none was silent."
    lines += ["", f"Of {trials:,} trials, {share} Measured with commit {measured_commit()}.", ""]
    hits = [one for result in results.values() for one in result["members"].values() if one]
    lines += (
        ["| arm | member of `zygos_t`, or of the memory given | silent | crash or hang |", "| --- | --- | --- | --- |"]
        if hits
        else []
    )
    for name, result in results.items():
        hit = result["members"]
        known = sorted({member for one in hit.values() for member in one}, key=lambda m: (-hit["silent"].get(m, 0), m))
        for member in known:
            lost = hit["crash"].get(member, 0) + hit["hang"].get(member, 0)
            lines.append(f"| {CAMPAIGNS[name].title} | `{member}` | {hit['silent'].get(member, 0)} | {lost} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Run all campaigns."""
    given = dict(argument.split("=", 1) for argument in arguments)
    share, seed = float(given.get("share", "1")), int(given.get("seed", "0"))
    results = {name: outcome_of(name, round(share * trials), seed) for name, trials in TRIALS.items()}
    text = table(results)
    write_json(Path("out/upset.json"), results)
    print(text)
    before, _, rest = DOCUMENT.read_text().partition(BEGIN)
    write_text(DOCUMENT, before + BEGIN + "\n" + text + "\n" + END + rest.partition(END)[2])
    counts = [result["count"] for result in results.values()]
    lost = sum(count["crash"] + count["hang"] + count["unfinished"] for count in counts)
    silent = np.sum([count["silent"] for count in counts]) / sum(result["trials"] for result in results.values())
    return int(lost > 0 or silent > LIMIT)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

# SPDX-License-Identifier: MIT
"""Writes the table of what the tests take into docs/testing.md, from what `make test-all` has measured.

    python tools/test_times.py out/tests.json docs/testing.md

Processor time of a test is that of its process and of its ended children; a fixture counts to the first test that
uses it.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- times: written by make times -->\n", "<!-- end of times -->\n"
SLOWEST = 10


def table(content: dict[str, Any]) -> str:
    """Markdown of the folders and of the slowest quick tests."""
    costs: dict[str, dict[str, float]] = content["tests"]
    folders: dict[str, list[list[float]]] = defaultdict(lambda: [[0, 0.0], [0, 0.0]])
    for name, cost in costs.items():
        tier = folders["/".join(name.split("/")[:2])][bool(cost["slow"])]
        tier[0] += 1
        tier[1] += cost["processor_s"]
    total = [[sum(tiers[k][i] for tiers in folders.values()) for i in (0, 1)] for k in (0, 1)]
    lines = ["| folder | quick tests | processor time, s | slow tests | processor time, s |", "|---|---|---|---|---|"]
    for name, tiers in [*sorted(folders.items()), ("all", total)]:
        cells = [cell for count, spent in tiers for cell in (f"{count:,}", f"{spent:.0f}")]
        lines.append(f"| {name if name == 'all' else f'`{name}`'} | {' | '.join(cells)} |")
    quick = sorted((cost["processor_s"], name) for name, cost in costs.items() if not cost["slow"])
    lines += ["", "| the longest quick tests | processor time, s |", "|---|---|"]
    lines += [f"| `{name.replace('|', '/')}` | {spent:.1f} |" for spent, name in quick[: -SLOWEST - 1 : -1]]
    whole, unit = content["processor_s"], content["unit_s"]
    units = f"{whole / unit:,.0f} units of {unit:.3f} s"
    lines += ["", f"With what collects them, all take {whole:.0f} s: {units}. Commit {content['commit']}."]
    return "\n".join(lines) + "\n"


def main(measured: Path, page: Path) -> int:
    """Replace what stands between the two marks; the exit code."""
    if not measured.is_file():
        print(f"{measured}: no such file; remedy: make test-all writes it", file=sys.stderr)
        return 2
    text = page.read_text(encoding="utf-8")
    before, found, rest = text.partition(BEGIN)
    _, ended, after = rest.partition(END)
    if not found or not ended:
        print(f"{page}: the lines {BEGIN.strip()} and {END.strip()} are missing; remedy: restore them", file=sys.stderr)
        return 2
    content = json.loads(measured.read_text(encoding="utf-8"))
    page.write_text(f"{before}{BEGIN}{table(content)}{END}{after}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))

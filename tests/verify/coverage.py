# SPDX-License-Identifier: MIT
"""Lines and branches of the C library that the quick tests run, against the floors of pyproject.toml."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conftest import ROOT
from verify.result import BUILD, Result, digest, judged, missing
from zygos.errors import ZygosError

PLACE = BUILD / "coverage"
LISTED = BUILD / "gaps.txt"
"""The lines and branches that no test runs, as they were measured last."""


@dataclass(frozen=True)
class Gap:
    """Something that no test runs."""

    file: str
    function: str
    line: int
    source: str
    """The line without its indentation."""
    what: str
    """line, or the number of branches that are never taken."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.function}: {self.what}: {self.source}"


def functions_of(text: str) -> list[str]:
    """The function in whose head or body each line is. What gcov says is that which a line was inlined into."""
    found, current = [], "?"
    for line in text.splitlines():
        head = re.match(r"[a-z].*?\b(\w+)\(", line)
        if head and not line.startswith("typedef") and not line.endswith(";"):
            current = head[1]
        found.append(current)
    return found


def gaps_of(report: Mapping[str, Any], root: Path = ROOT) -> tuple[list[Gap], dict[str, int]]:
    """The gaps in a report of gcovr (--json), and the numbers of lines and branches with those that ran."""
    gaps: list[Gap] = []
    totals: Counter[str] = Counter()
    for file in report["files"]:
        path = root / file["file"]
        text, functions = path.read_text().splitlines(), functions_of(path.read_text())
        seen: dict[int, dict[str, Any]] = {}
        for row in file["lines"]:  # a line of a function that is inlined, or of a header, may have several rows
            if row.get("gcovr/noncode"):
                continue
            known = seen.setdefault(row["line_number"], {"count": 0, "taken": []})
            known["count"] += row["count"]
            taken = [branch["count"] for branch in row["branches"]]
            old = known["taken"]
            known["taken"] = [a + b for a, b in zip(old, taken, strict=True)] if len(old) == len(taken) else old + taken
        for number, row in sorted(seen.items()):
            untaken = sum(count == 0 for count in row["taken"])
            totals["lines"] += 1
            totals["lines run"] += row["count"] > 0
            totals["branches"] += len(row["taken"])
            totals["branches taken"] += len(row["taken"]) - untaken
            what = "line" if row["count"] == 0 else f"{untaken} of {len(row['taken'])} branches" if untaken else ""
            if what:
                gaps.append(Gap(path.name, functions[number - 1], number, text[number - 1].strip(), what))
    return gaps, dict(totals)


def below(totals: Mapping[str, int], floors: Mapping[str, str]) -> list[str]:
    """What is below its floor, a sentence each. floors: the table [tool.gcovr]."""
    shares = {"line": totals["lines run"] / totals["lines"], "branch": totals["branches taken"] / totals["branches"]}
    return [
        f"{100.0 * share:.1f}% are run, and fail-under-{what} is {floors[f'fail-under-{what}']}; "
        f"remedy: test those of build/verify/{LISTED.name}"
        for what, share in shares.items()
        if 100.0 * share < float(floors[f"fail-under-{what}"])
    ]


def measured() -> Path:
    """Run `make coverage`, which leaves its counters in build/coverage. Returns the checkout. Errors: ZygosError."""
    done = subprocess.run(["make", "coverage"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"`make coverage` fails: {(done.stdout + done.stderr)[-800:]}; remedy: see there")
    return ROOT


def reported(checkout: Path) -> dict[str, Any]:
    """What gcovr says of the counters in a checkout. Errors: ZygosError if there are none, or of other sources."""
    native = checkout / "build" / "coverage" / "harness" / "zygos" / "_native"
    if not any(native.glob("*.gcda")):
        raise ZygosError(f"{checkout} has no counters of the C library; remedy: run `make coverage` there")
    if digest(checkout) != digest():
        raise ZygosError(f"the sources of {checkout} are not those of this checkout; remedy: leave out COUNTERS=")
    PLACE.mkdir(parents=True, exist_ok=True)
    for path in native.glob("*.gc??"):
        shutil.copy(path, PLACE)
    out = PLACE / "report.json"
    tool = [sys.executable, "-m", "gcovr", "--config", os.devnull, "--root", str(checkout)]
    tool += ["--filter", f"{checkout}/c/[a-z]+/[a-z]+\\.c", "--json", str(out), str(PLACE)]
    tool += ["--gcov-suspicious-hits-threshold", "0"]  # a loop of the filter runs more often than it takes for possible
    subprocess.run(tool, cwd=checkout, check=True, capture_output=True)
    content: dict[str, Any] = json.loads(out.read_text())
    return content


def result(counters: str) -> Result:
    """Lines and branches against their floors. counters: a checkout that has them; empty: count anew."""
    if shutil.which("gcov") is None:
        return missing("gcov", "gcc")
    gaps, totals = gaps_of(reported(Path(counters).resolve() if counters else measured()))
    LISTED.write_text("".join(f"{gap}\n" for gap in gaps))
    floors = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["gcovr"]
    figure = (
        f"{totals['lines run']:,} of {totals['lines']:,} lines ({totals['lines run'] / totals['lines']:.1%}), "
        f"{totals['branches taken']:,} of {totals['branches']:,} branches "
        f"({totals['branches taken'] / totals['branches']:.1%}); {len(gaps)} gaps in build/verify/{LISTED.name}"
    )
    return judged(below(totals, floors), figure, **totals, gaps=len(gaps))

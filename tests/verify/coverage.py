"""Lines and branches of the C library that the quick tests of the library run, and reasons for the others."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conftest import ROOT
from verify.result import BUILD, FOLDER, Result, entries, judged, missing
from zygos.errors import ZygosError

GAPS = FOLDER / "gaps.toml"
PLACE = BUILD / "coverage"


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

    @property
    def place(self) -> str:
        """What gaps.toml names it by: it stays where lines above it are added."""
        return f"{self.file}: {self.function}: {self.source}"


def gaps_of(report: Mapping[str, Any], root: Path = ROOT) -> tuple[list[Gap], dict[str, int]]:
    """The gaps in a report of gcovr (--json), and the numbers of lines and branches with those that ran."""
    gaps: list[Gap] = []
    totals: Counter[str] = Counter()
    for file in report["files"]:
        path = root / file["file"]
        text = path.read_text().splitlines()
        seen: dict[int, dict[str, Any]] = {}
        for row in file["lines"]:  # a line of a function that is inlined, or of a header, may have several rows
            if row.get("gcovr/noncode"):
                continue
            known = seen.setdefault(row["line_number"], {"count": 0, "function": row.get("function_name"), "taken": []})
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
                gaps.append(Gap(path.name, row["function"] or "?", number, text[number - 1].strip(), what))
    return gaps, dict(totals)


def reasons(path: Path) -> dict[str, str]:
    """Place to reason. Errors: ZygosError for a place that stands twice."""
    found: dict[str, str] = {}
    for entry in entries(path, "reason", "places"):
        for place in entry["places"]:
            if place in found:
                raise ZygosError(f"{path.name}: {place!r} stands twice; remedy: leave one of them out")
            found[place] = entry["reason"]
    return found


def unexplained(gaps: Iterable[Gap], known: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """The gaps without a reason, and the places of reasons that no gap needs."""
    gaps = list(gaps)
    needed = {gap.place for gap in gaps}
    open_ones = [
        f"{gap.file}:{gap.line} ({gap.what}) has no reason: {gap.place}" for gap in gaps if gap.place not in known
    ]
    return open_ones, [place for place in known if place not in needed]


def measured(tests: Iterable[str], jobs: str) -> dict[str, Any]:
    """Compile the library with counters, run the tests with it, and return the report of gcovr."""
    shutil.rmtree(PLACE, ignore_errors=True)
    package = PLACE / "harness" / "zygos"
    shutil.copytree(ROOT / "harness" / "zygos", package, ignore=shutil.ignore_patterns("_native", "__pycache__"))
    environment = {**os.environ, "CFLAGS": "--coverage", "OPENBLAS_NUM_THREADS": "1"}
    build = [sys.executable, str(ROOT / "tools" / "build_native.py"), str(package / "_native")]
    subprocess.run(build, check=True, env=environment, cwd=ROOT)
    environment["PYTHONPATH"] = str(PLACE / "harness")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-n",
        jobs,
        "--dist",
        "loadfile",
        "-m",
        "not slow",
        "-o",
        "quick_limit_s=0",
    ]
    done = subprocess.run([*command, *tests], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ZygosError(f"a test fails with counters: {done.stdout[-800:]}; remedy: repair it")
    return reported()


def reported() -> dict[str, Any]:
    """What gcovr says of the counters of the last run."""
    out = PLACE / "report.json"
    tool = [
        sys.executable,
        "-m",
        "gcovr",
        "--config",
        os.devnull,
        "--root",
        str(ROOT),
        "--filter",
        f"{ROOT}/c/[a-z]+\\.c",
    ]
    subprocess.run([*tool, "--json", str(out), str(PLACE)], cwd=ROOT, check=True, capture_output=True)
    content: dict[str, Any] = json.loads(out.read_text())
    return content


def result(tests: Iterable[str], jobs: str = "auto") -> Result:
    """Lines and branches, with each gap that has no reason."""
    if shutil.which("gcov") is None:
        return missing("gcov", "gcc")
    gaps, totals = gaps_of(measured(tests, jobs))
    open_ones, unused = unexplained(gaps, reasons(GAPS))
    figure = (
        f"{totals['lines run']:,} of {totals['lines']:,} lines ({totals['lines run'] / totals['lines']:.1%}), "
        f"{totals['branches taken']:,} of {totals['branches']:,} branches "
        f"({totals['branches taken'] / totals['branches']:.1%}); {len(gaps)} gaps, {len(open_ones)} without a reason"
    )
    return judged(open_ones, figure, **totals, gaps=len(gaps), unused_reasons=unused)

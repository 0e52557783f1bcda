# SPDX-License-Identifier: MIT
"""The mutation run: a random sample of all mutants, each against the unit tests that reach it.

The survivors stand in docs/mutants.md, which this writes. Their judgements are written there by hand, and stay when the
page is written again.
"""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conftest import ROOT
from verify.mutants import Mutant, library
from verify.result import BUILD, FOLDER, Result, digest, judged
from verify.selecting import digest_of
from zygos.errors import ZygosError
from zygos.files.output import write_text
from zygos.report.provenance import measured_commit

PAGE = ROOT / "docs" / "mutants.md"
BAR = r"\|"
"""A vertical bar within a cell of a table of Markdown."""
PLACE = BUILD / "mutants"
WANTED = 0.85
"""Share of the mutants, without the equivalent ones, that the tests must kill."""
EQUIVALENT, ACCEPTED, LACKING = "equivalent", "accepted", "needs a test"
BUDGET_S = 60.0
"""Processor time of the tests that are tried with one mutant, as they take it with unchanged code."""
JUDGEMENTS = (EQUIVALENT, ACCEPTED, LACKING)
"""No input shows it; it shows in a way that no test should hold; a test is missing."""


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant."""

    mutant: Mutant
    verdict: str
    """killed, crash, timeout, survived or not reached."""
    test: str
    """The test that failed."""

    @property
    def killed(self) -> bool:
        """Whether the tests notice it. A loop without an end, or a crash, is noticed."""
        return self.verdict in ("killed", "crash", "timeout")


def judgements(page: Path) -> dict[str, tuple[str, str]]:
    """Key of a mutant to its judgement and the reason, of the rows of the page that have one.

    Errors: ZygosError for a judgement that is none, or that has no reason.
    """
    found = {}
    for line in page.read_text().splitlines() if page.exists() else ():
        cells = [cell.strip().replace(BAR, "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        if len(cells) == 6 and cells[0].startswith("`"):
            file, function, original, changed = (cell.strip("`") for cell in cells[:4])
            changed, _, again = changed.partition("` #")
            judgement, reason = cells[4:]
            if not judgement:
                continue
            if judgement not in JUDGEMENTS or not reason:
                raise ZygosError(
                    f"{page.name}: {file}: {function}: {original}: no judgement {judgement!r} with a reason; "
                    f"remedy: use {' · '.join(JUDGEMENTS)}, and say why"
                )
            key = Mutant(file, function, 0, original, changed, int(again or 0)).key
            found[key] = judgement, reason
    return found


def rows_of(survivors: Sequence[Mutant], known: Mapping[str, tuple[str, str]]) -> str:
    """Rows of the page, with the judgements that are known."""
    rows = ["| file | function | original | changed | judgement | reason |", "|---|---|---|---|---|---|"]
    for mutant in survivors:
        judgement, reason = known.get(mutant.key, ("", ""))
        again = f" #{mutant.again}" if mutant.again else ""
        cells = [f"`{mutant.file}`", f"`{mutant.function}`", f"`{mutant.original}`", f"`{mutant.changed}`{again}"]
        rows.append(f"| {' | '.join(cell.replace('|', BAR) for cell in (*cells, judgement, reason))} |")
    return "\n".join(rows) + "\n"


def text_of_page(figure: str, survivors: Sequence[Mutant], known: Mapping[str, tuple[str, str]]) -> str:
    """docs/mutants.md."""
    return f"""# Mutants that survive

`make verify STEPS=mutation` writes this page ([verification.md](verification.md)), of commit {measured_commit(ROOT)}.
First are the survivors of its sample, then those that were judged in other samples. The last two columns are written
by hand. A judgement stays as long as its mutant survives: *equivalent* (no input shows it), *accepted* (it shows in a
way that no test should hold) or *needs a test*. `#K` counts equal changes in a function.

{figure}.

{rows_of(survivors, known)}"""


def assessed(outcomes: Sequence[Outcome], known: Mapping[str, str]) -> Result:
    """Score and survivors. Fails below WANTED, and where a survivor is not judged."""
    survivors = [one.mutant for one in outcomes if not one.killed]
    judged_as = Counter(known.get(mutant.key, "not judged") for mutant in survivors)
    counted = len(outcomes) - judged_as[EQUIVALENT]
    score = (len(outcomes) - len(survivors)) / counted if counted else 1.0
    raw = 1.0 - len(survivors) / len(outcomes) if outcomes else 1.0
    findings = [f"not judged: {mutant.key} (line {mutant.line})" for mutant in survivors if mutant.key not in known]
    if findings:
        findings.append(f"remedy: judge them in {PAGE.relative_to(ROOT)} and run the step again")
    if score < WANTED:
        findings.insert(
            0, f"the tests kill {score:.1%} of the mutants, and {WANTED:.0%} are wanted; remedy: write tests"
        )
    verdicts = Counter(one.verdict for one in outcomes)
    figure = (
        f"{score:.1%} killed of {counted} mutants that are not equivalent ({raw:.1%} of all {len(outcomes)}); "
        "survivors: " + (", ".join(f"{count} {kind}" for kind, count in sorted(judged_as.items())) or "none")
    )
    return judged(
        findings, figure, score=round(score, 4), raw=round(raw, 4), verdicts=dict(verdicts), judged=dict(judged_as)
    )


def sample(count: int, number: int, seed: int) -> list[int]:
    """The numbers of a random sample, in random order: a larger one begins with a smaller one."""
    return random.Random(seed).sample(range(count), count)[: number or count]


def run(tests: Sequence[str], mutants: Sequence[Mutant], numbers: Sequence[int], jobs: int, folder: Path, results: Path,
        path: Path) -> list[Outcome]:  # fmt: skip
    """Try the mutants whose numbers are given; those that results has are not tried again. path: the library's.

    A kill holds as long as the file of the test that kills is the same. A survivor is tried again with the files that
    have changed since.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = [ROOT / test for test in tests]
    state = digest_of(files)
    states = {str(path): digest_of([path]) for path in files}

    def stored(which: str) -> Path:
        return results.with_suffix(f".{which}.files.json")

    def survived() -> dict[int, list[str]]:
        """To each number the files as they are that did not kill it."""
        rows = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
        found: dict[int, list[str]] = {}
        for row in rows:
            if not row["file"] and stored(row["state"]).exists():
                before = json.loads(stored(row["state"]).read_text())
                found.setdefault(row["number"], []).extend(
                    name for name, one in states.items() if before.get(name) == one
                )
        return found

    def read() -> dict[int, dict[str, Any]]:
        rows = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
        return {row["number"]: row for row in rows if row["state"] == states.get(row["file"], state)}

    done = read()
    waiting = [number for number in numbers if number not in done]
    if waiting:
        told: dict[str, Any] = {
            "library": str(path),
            "folder": str(folder),
            "numbers": waiting,
            "jobs": jobs,
            "results": str(results),
        }
        told["budget_s"] = BUDGET_S
        told["state"], told["states"] = state, states
        told["tried"] = survived()
        stored(state).write_text(json.dumps(states))
        told["functions"] = [f"{mutants[number].file}:{mutants[number].function}" for number in waiting]
        told["kills"] = [
            (f"{mutants[number].file}:{mutants[number].function}", row["test"])
            for number, row in done.items()
            if row["test"]
        ]
        told["unchanged"] = str(results.with_suffix(f".{state}.unchanged.json"))
        (folder / "told.json").write_text(json.dumps(told))
        (folder / "failed.json").unlink(missing_ok=True)
        environment = {
            **os.environ,
            "VERIFY_MUTANTS": str(folder / "told.json"),
            "PYTHONPATH": os.pathsep.join([str(path.parents[2]), str(FOLDER.parent)]),
            "OPENBLAS_NUM_THREADS": "1",
        }
        options = [
            *"-p verify.selecting -p no:xdist -m".split(),
            "not slow",
            *"-o quick_limit=0 -o timeout=0".split(),
        ]
        command = [sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml"), f"--rootdir={ROOT}"]
        command += [*options, *tests]
        ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
        done = read()
        if any(number not in done for number in waiting):
            failed = folder / "failed.json"
            why = f"{', '.join(json.loads(failed.read_text())[:5])} fail" if failed.exists() else ended.stdout[-1500:]
            raise ZygosError(f"the tests do not pass with unchanged code: {why}; remedy: repair them first")
    return [Outcome(mutants[number], done[number]["verdict"], done[number]["test"]) for number in numbers]


def result(tests: Sequence[str], number: int, seed: int, jobs: int) -> Result:
    """Compile, try, judge. What was tried of the same sources and tests is not tried again."""
    mutants = library(PLACE, jobs)
    shared = [
        path for folder in (ROOT / "harness" / "zygos", FOLDER.parent / "support") for path in folder.rglob("*.py")
    ]
    state = digest_of([*sorted(shared), FOLDER.parent / "conftest.py", FOLDER / "mutants.py"])
    results = PLACE / f"results-{digest()}-{state}.jsonl"
    native = PLACE / "harness" / "zygos" / "_native" / "libzygos.so"
    outcomes = run(tests, mutants, sample(len(mutants), number, seed), jobs, PLACE / "run", results, native)
    known = judgements(PAGE)
    found = assessed(outcomes, {key: judgement for key, (judgement, _) in known.items()})
    figure = f"{found.figure}; {len(mutants):,} mutants in all, seed {seed}"
    tried = {outcome.mutant.key for outcome in outcomes}
    # judged in another sample, and still there
    before = [mutant for mutant in mutants if mutant.key in known and mutant.key not in tried]
    survivors = [outcome.mutant for outcome in outcomes if not outcome.killed]
    write_text(PAGE, text_of_page(figure, [*survivors, *before], known))
    return Result(found.verdict, figure, found.findings, found.figures)

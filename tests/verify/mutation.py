"""The mutation run: a random sample of all mutants, each against the unit tests that reach it."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from conftest import ROOT
from verify.mutants import Mutant, library
from verify.result import BUILD, FOLDER, Result, digest, entries, judged
from verify.selecting import digest_of
from zygos.errors import ZygosError

SURVIVORS = FOLDER / "survivors.toml"
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


def judgements(path: Path) -> dict[str, str]:
    """Key of a mutant to its judgement. Errors: ZygosError for a judgement that is none."""
    found = {}
    for entry in entries(path, "file", "function", "original", "changed", "judgement", "reason"):
        if entry["judgement"] not in JUDGEMENTS:
            raise ZygosError(f"{path.name}: no judgement {entry['judgement']!r}; remedy: use {' · '.join(JUDGEMENTS)}")
        names = [entry[key] for key in ("file", "function", "original", "changed")]
        found[Mutant(names[0], names[1], 0, names[2], names[3], int(entry.get("again", 0))).key] = entry["judgement"]
    return found


def proposal(mutant: Mutant) -> str:
    """An entry of survivors.toml that lacks its judgement."""
    rows = [f"{key} = {json.dumps(getattr(mutant, key))}" for key in ("file", "function", "original", "changed")]
    rows += [f"again = {mutant.again}"] if mutant.again else []
    return "\n".join(["[[entry]]", *rows, 'judgement = ""', 'reason = ""']) + "\n"


def assessed(outcomes: Sequence[Outcome], known: dict[str, str]) -> Result:
    """Score and survivors. Fails below WANTED, and where a survivor is not judged."""
    survivors = [one.mutant for one in outcomes if not one.killed]
    judged_as = Counter(known.get(mutant.key, "not judged") for mutant in survivors)
    counted = len(outcomes) - judged_as[EQUIVALENT]
    score = (len(outcomes) - len(survivors)) / counted if counted else 1.0
    raw = 1.0 - len(survivors) / len(outcomes) if outcomes else 1.0
    findings = [f"not judged: {mutant.key} (line {mutant.line})" for mutant in survivors if mutant.key not in known]
    if findings:
        findings.append(
            f"remedy: judge them in {SURVIVORS.relative_to(ROOT)}; build/verify/survivors.toml has the entries"
        )
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
    known = judgements(SURVIVORS)
    open_ones = [one.mutant for one in outcomes if not one.killed and one.mutant.key not in known]
    (BUILD / "survivors.toml").write_text("\n".join(map(proposal, open_ones)))
    found = assessed(outcomes, known)
    return Result(
        found.verdict, f"{found.figure}; {len(mutants):,} mutants in all, seed {seed}", found.findings, found.figures
    )

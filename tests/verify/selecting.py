# SPDX-License-Identifier: MIT
"""A pytest plugin that runs the collected tests for each mutant, in a fork of this process that has collected them.

Environment: VERIFY_MUTANTS, a file of JSON that `mutation.py` writes: the library, the numbers, where results go.
A first fork runs all tests with the unchanged code and notes which mutants each one reaches. The fork of a mutant runs
the tests that reach it, those first that kill most of the mutants of its function in their time, until one fails or the
budget of time is spent. The tests of one module follow each other, because pytest makes the fixtures of a module again
whenever a test of another module was between; only the few most promising tests are put before all others. This process
never runs a test, so that no cache that the unchanged code has filled hides a mutant.
"""

from __future__ import annotations

import gc
import hashlib
import json
import os
import resource
import signal
import sys
import time
import traceback
from array import array
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from cffi import FFI

BASE_S = 10.0
"""Processor time that a test has beside three times that of the unchanged code; a loop without an end takes all."""
FIRST_S = 1.0
"""Processor time of the tests that are put before all others."""
ELSEWHERE, SAME_FILE = 0.02, 0.2
"""What a kill of a mutant of another function, of any file or of the same one, counts for the order of the tests."""
CALLS, NAMED = 2.0, 0.3
"""The same for a test whose module has the name of the function, or is named after the file."""


def digest_of(paths: Iterable[Path]) -> str:
    """Short digest of the content of files, which says of which state of the tests a result is."""
    total = hashlib.sha256()
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()[:12]


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


class Selected:
    """The library with its mutants."""

    def __init__(self, path: str) -> None:
        self.ffi = FFI()
        self.ffi.cdef("extern int zygos_mutant; extern unsigned char zygos_reached[]; extern unsigned zygos_mutants;")
        self.library: Any = self.ffi.dlopen(path)

    def reached(self) -> bytes:
        """A byte for each mutant, not zero where it was asked for; and forgets them."""
        count = self.library.zygos_mutants
        place = self.ffi.cast("char *", self.ffi.addressof(self.library, "zygos_reached"))
        out = bytes(self.ffi.buffer(place, count))
        self.ffi.memmove(place, bytes(count), count)
        return out


def _failed(item: pytest.Item, following: pytest.Item | None) -> bool:
    return any(report.failed for report in runtestprotocol(item, log=False, nextitem=following))


def forked(work: Callable[[], int], limit_s: float, log: str = os.devnull) -> int:
    """Start a fork that ends with the status that work returns, and prints into log. Returns its process."""
    process = os.fork()
    if process:
        return process
    status = 99
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit_s) + 1, int(limit_s) + 2))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        quiet = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        status = work()
    except BaseException:
        traceback.print_exc(file=sys.__stderr__)
    finally:
        sys.__stderr__.flush()  # type: ignore[union-attr]
        os._exit(status)


@dataclass(frozen=True)
class Test:
    """A test, and what it takes with the unchanged code."""

    item: pytest.Item
    seconds: float
    limit_s: float
    """Processor time after which it counts as a loop without an end. The fixtures of its module are included, because
    another test made them with the unchanged code."""

    @property
    def module(self) -> Path:
        """The file of the test."""
        return self.item.path


def tests_of(items: Sequence[pytest.Item], seconds: Sequence[float]) -> list[Test]:
    """The tests with their limits. seconds: processor time of each one with the unchanged code."""
    dearest: dict[Path, float] = defaultdict(float)
    for item, one in zip(items, seconds, strict=True):
        dearest[item.path] = max(dearest[item.path], one)
    limits = [BASE_S + 3.0 * (one + dearest[item.path]) for item, one in zip(items, seconds, strict=True)]
    return [Test(*one) for one in zip(items, seconds, limits, strict=True)]


def ordered(tests: Sequence[Test], worth: Sequence[float], budget_s: float) -> list[Test]:
    """The tests of a mutant that fit into the budget, in the order in which they run. worth: how much each kills."""
    ranked = sorted(range(len(tests)), key=lambda k: -worth[k] / (0.02 + tests[k].seconds))
    chosen, total = [], 0.0
    for k in ranked:
        if not chosen or total + tests[k].seconds <= budget_s:
            chosen.append(tests[k])
            total += tests[k].seconds
    first, total = 0, 0.0
    while first < len(chosen) and total + chosen[first].seconds <= FIRST_S:
        total += chosen[first].seconds
        first += 1
    modules: dict[Path, list[Test]] = {}
    for test in chosen[first:]:
        modules.setdefault(test.module, []).append(test)
    return chosen[:first] + [test for rest in modules.values() for test in rest]


class Loop:
    """Takes the place of pytest's loop over the tests."""

    def __init__(self, told: dict[str, Any]) -> None:
        self.told = told
        self.library = Selected(told["library"])
        self.folder = Path(told["folder"])
        self.trusted: set[str] = set()

    def _unchanged(self, items: list[pytest.Item]) -> int:
        rows = []
        self.library.reached()
        for place, item in enumerate(items):
            begin = _processor_s()
            bad = _failed(item, items[place + 1] if place + 1 < len(items) else None)
            reached = self.library.reached()
            numbers = [k for k, byte in enumerate(reached) if byte]
            rows.append({"test": item.nodeid, "failed": bad, "seconds": _processor_s() - begin, "reached": numbers})
        Path(self.told["unchanged"]).write_text(json.dumps(rows))
        return 0

    def _left(self, number: int, at: Sequence[int], tests: Sequence[Test]) -> list[int]:
        """The tests of a mutant less those of files that it has survived as they are."""
        tried = set(self.told["tried"].get(str(number), ()))
        return [k for k in at if str(tests[k].module) not in tried]

    def _killed(self, number: int, tests: Sequence[Test]) -> int:
        """Run the tests of a mutant in its fork. A file names the one that runs, and ends this process's time."""
        self.library.library.zygos_mutant = number
        items = [test.item for test in tests]
        for place, test in enumerate(tests):
            (self.folder / f"at-{number}").write_text(json.dumps({"test": test.item.nodeid, "file": str(test.module)}))
            signal.setitimer(signal.ITIMER_PROF, test.limit_s)  # its signal ends the process
            if _failed(test.item, items[place + 1] if place + 1 < len(items) else None):
                return 1
        return 0

    def _passes_alone(self, test: Test) -> bool:
        """Whether a test passes alone and with the unchanged code; otherwise its failure tells of no mutant."""
        if test.item.nodeid not in self.trusted:
            _, status = os.waitpid(forked(lambda: self._killed(-1, [test]), test.limit_s), 0)
            (self.folder / "at--1").unlink(missing_ok=True)
            if status != 0:
                return False
            self.trusted.add(test.item.nodeid)
        return True

    def _note(self, number: int, verdict: str) -> str:
        """Write a result. Returns the test that kills."""
        at = self.folder / f"at-{number}"
        found = {"test": "", "file": ""}
        if at.exists() and verdict not in ("survived", "not reached"):
            found = json.loads(at.read_text())
        at.unlink(missing_ok=True)
        state = self.told["states"][found["file"]] if found["file"] else self.told["state"]
        with Path(self.told["results"]).open("a") as results:
            results.write(json.dumps({"number": number, "verdict": verdict, **found, "state": state}) + "\n")
        return found["test"]

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the unchanged code and then each mutant."""
        if session.testsfailed:
            raise pytest.UsageError("tests cannot be collected")
        items = session.items
        stored = Path(self.told["unchanged"])
        if not stored.exists():
            os.waitpid(forked(lambda: self._unchanged(items), 1e6, str(self.folder / "unchanged.log")), 0)
        known = {row["test"]: row for row in json.loads(stored.read_text())}
        items = [item for item in items if item.nodeid in known]
        rows = [known[item.nodeid] for item in items]
        bad = [row["test"] for row in rows if row["failed"]]
        if bad:
            stored.unlink()
            (self.folder / "failed.json").write_text(json.dumps(bad))
            session.testsfailed = len(bad)
            return True
        tests = tests_of(items, [row["seconds"] for row in rows])
        functions = dict(zip(self.told["numbers"], self.told["functions"], strict=True))
        at: dict[int, array[int]] = {number: array("I") for number in functions}
        for k, row in enumerate(rows):
            for number in row["reached"]:
                if number in at:
                    at[number].append(k)
        del known, rows
        places = {test.item.nodeid: k for k, test in enumerate(tests)}
        texts = {path: path.read_text() for path in {test.module for test in tests}}
        kills: dict[str, dict[int, float]] = defaultdict(lambda: defaultdict(float))

        def count(function: str, test: str) -> None:
            for key, weight in (("", ELSEWHERE), (function.split(":", maxsplit=1)[0], SAME_FILE), (function, 1.0)):
                if test in places:
                    kills[key][places[test]] += weight

        def worth(function: str, k: int) -> float:
            file, name = function.split(":")
            path = tests[k].module
            out = 0.01 + (CALLS if name in texts[path] else 0.0)
            out += NAMED if file.removesuffix(".c") in path.name else 0.0
            return out + sum(kills[key].get(k, 0.0) for key in ("", file, function))

        for function, test in self.told["kills"]:
            count(function, test)
        running: dict[int, tuple[int, float]] = {}
        waiting = [number for number in self.told["numbers"]][::-1]
        gc.collect()
        gc.freeze()
        while waiting or running:
            while waiting and len(running) < self.told["jobs"]:
                number = waiting.pop()
                if not at[number]:
                    self._note(number, "not reached")
                    continue
                left = self._left(number, at[number], tests)
                if not left:
                    self._note(number, "survived")
                    continue
                worths = [worth(functions[number], k) for k in left]
                chosen = ordered([tests[k] for k in left], worths, self.told["budget_s"])
                limit = sum(test.limit_s for test in chosen)
                process = forked(lambda n=number, c=chosen: self._killed(n, c), limit)  # type: ignore[misc]
                running[process] = (number, time.monotonic() + 10.0 * limit)
            process, status = os.waitpid(-1, os.WNOHANG) if running else (0, 0)
            if process == 0:
                for late, (_, until) in running.items():
                    if time.monotonic() > until:
                        os.kill(late, signal.SIGKILL)
                time.sleep(0.01)
                continue
            if process not in running:
                continue
            number, _ = running.pop(process)
            if os.WIFSIGNALED(status):
                cut = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL, signal.SIGPROF)
                verdict = "timeout" if cut else "crash"
            else:
                verdict = {0: "survived", 1: "killed"}.get(os.WEXITSTATUS(status), "crash")
            if verdict != "survived":
                last = json.loads((self.folder / f"at-{number}").read_text())["test"]
                if not self._passes_alone(tests[places[last]]):
                    (self.folder / "failed.json").write_text(json.dumps([last]))
                    session.testsfailed = 1
                    return True
            count(functions[number], self._note(number, verdict))
        return True


def pytest_configure(config: pytest.Config) -> None:
    """Take over the loop."""
    told = json.loads(Path(os.environ["VERIFY_MUTANTS"]).read_text())
    config.pluginmanager.register(Loop(told))

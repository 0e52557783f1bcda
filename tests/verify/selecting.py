"""A pytest plugin that runs the collected tests for each mutant, in a fork of this process that has collected them.

Environment: VERIFY_MUTANTS, a file of JSON that `mutation.py` writes: the library, the numbers, where results go.
A first fork runs all tests with the unchanged code and notes which mutants each one reaches. The fork of a mutant runs
the tests that reach it, those that kill most in their time first, until one fails or the budget of time is spent. This
process never runs a test, so that no cache that the unchanged code has filled hides a mutant.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol
from cffi import FFI

BASE_S = 15.0
"""Processor time that a mutant has beside three times that of the unchanged code; a loop without an end takes all."""


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


class Loop:
    """Takes the place of pytest's loop over the tests."""

    def __init__(self, told: dict[str, Any]) -> None:
        self.told = told
        self.library = Selected(told["library"])
        self.folder = Path(told["folder"])

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

    def _killed(self, number: int, items: list[pytest.Item]) -> int:
        self.library.library.zygos_mutant = number
        for place, item in enumerate(items):
            if _failed(item, items[place + 1] if place + 1 < len(items) else None):
                (self.folder / f"killed-{number}").write_text(item.nodeid)
                return 1
        return 0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run the unchanged code and then each mutant."""
        if session.testsfailed:
            raise pytest.UsageError("tests cannot be collected")
        items = session.items
        gc.freeze()
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
        at: dict[int, list[int]] = {}
        for k, row in enumerate(rows):
            for number in row["reached"]:
                at.setdefault(number, []).append(k)
        kills = [0.01] * len(items)
        places = {item.nodeid: k for k, item in enumerate(items)}
        running: dict[int, tuple[int, float]] = {}
        waiting = [number for number in self.told["numbers"]][::-1]
        with Path(self.told["results"]).open("a", buffering=1) as results:

            def note(number: int, verdict: str) -> None:
                killer = self.folder / f"killed-{number}"
                test = killer.read_text() if killer.exists() else ""
                killer.unlink(missing_ok=True)
                if test:
                    kills[places[test]] += 1.0
                results.write(json.dumps({"number": number, "verdict": verdict, "test": test}) + "\n")

            while waiting or running:
                while waiting and len(running) < self.told["jobs"]:
                    number = waiting.pop()
                    if number not in at:
                        note(number, "not reached")
                        continue
                    # first what has killed most in its time
                    order = sorted(at[number], key=lambda k: -kills[k] / (0.02 + rows[k]["seconds"]))
                    chosen, seconds = [], 0.0
                    for k in order:
                        if not chosen or seconds + rows[k]["seconds"] <= self.told["budget_s"]:
                            chosen.append(items[k])
                            seconds += rows[k]["seconds"]
                    limit = BASE_S + 3.0 * seconds
                    process = forked(lambda n=number, c=chosen: self._killed(n, c), limit)  # type: ignore[misc]
                    running[process] = (number, time.monotonic() + 10.0 * limit)
                process, status = os.waitpid(-1, os.WNOHANG)
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
                    cut = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
                    note(number, "timeout" if cut else "crash")
                else:
                    note(number, {0: "survived", 1: "killed"}.get(os.WEXITSTATUS(status), "crash"))
        return True


def pytest_configure(config: pytest.Config) -> None:
    """Take over the loop."""
    told = json.loads(Path(os.environ["VERIFY_MUTANTS"]).read_text())
    config.pluginmanager.register(Loop(told))

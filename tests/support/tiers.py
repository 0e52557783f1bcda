# SPDX-License-Identifier: MIT
"""The tiers of the tests (docs/testing.md): which test is slow, what each one takes, and what all may take.

A pytest plugin, loaded by tests/conftest.py. Processor time is that of the test's process and of its children that have
ended: unlike the time of the clock it hardly depends on what else the machine does. Budgets are in units of the time
that a fixed piece of work takes on the same machine, so that they hold on a slow one too.
"""

from __future__ import annotations

import json
import resource
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zygos.report.provenance import measured_commit

SLOW_FOLDERS = ("hil", "pil", "soak")
"""Folders whose tests are all slow: `make test` does not run them."""
SLOW_TIMEOUT_S = 1800.0
"""After this time of the clock a slow test counts as stuck."""
DEAREST = 20
TESTS = Path(__file__).resolve().parents[1]
CLOCK = pytest.StashKey[float]()


@dataclass(frozen=True)
class Cost:
    """What a test or a phase of it takes."""

    processor_s: float = 0.0
    wall_s: float = 0.0
    slow: bool = False


def processor_s() -> float:
    """Processor time of this process and of its ended children."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@cache
def unit_s() -> float:
    """Processor time of the unit of budgets: the least of five turns of a loop over small arrays."""

    def turn() -> float:
        begin, total = time.process_time(), np.eye(12)
        for k in range(20_000):
            total = total + 1e-9 * (total @ total.T) * (k % 7)
        return time.process_time() - begin

    return min(turn() for _ in range(5))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addini("quick_limit", "units of processor time that a test without the marker `slow` may take; 0: any")
    parser.addoption("--times", metavar="FILE", help="write the processor time and the wall time of each test as JSON")
    parser.addoption("--budget", metavar="UNITS", type=float, help="fail if all tests take more processor time")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[CLOCK] = processor_s()
    if not hasattr(config, "workerinput") and (config.getoption("--times") or config.getoption("--budget")):
        path = config.getoption("--times")
        config.pluginmanager.register(Ledger(Path(path) if path else None, config.getoption("--budget")))


def is_slow(case: str, only: Sequence[str] = ("*",), but: Sequence[str] = ()) -> bool:
    """Whether a parametrised case of a slow test is slow: its id matches a pattern of `only`, and none of `but`."""
    return any(fnmatchcase(case, pattern) for pattern in only) and not any(
        fnmatchcase(case, pattern) for pattern in but
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of slow folders, unmark the quick cases of slow tests, and give slow tests their own timeout."""
    for item in items:
        slow = item.get_closest_marker("slow")
        case = getattr(getattr(item, "callspec", None), "id", "")
        if slow and not is_slow(case, **slow.kwargs):
            item.own_markers[:] = [marker for marker in item.own_markers if marker.name != "slow"]
        if item.path.is_relative_to(TESTS) and item.path.relative_to(TESTS).parts[0] in SLOW_FOLDERS:
            item.add_marker("slow")
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_TIMEOUT_S))


def pytest_collection_finish(session: pytest.Session) -> None:
    session.config.stash[CLOCK] = processor_s()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note the processor time of the phase that has ended, and fail a quick test that took too long."""
    report = yield
    now = processor_s()
    spent, item.config.stash[CLOCK] = now - item.config.stash[CLOCK], now
    limit = float(item.config.getini("quick_limit") or 0.0)
    slow = item.get_closest_marker("slow") is not None
    report.cost = asdict(Cost(spent, report.duration, slow))
    if report.when == "call" and report.passed and not slow and 0.0 < limit * unit_s() < spent:
        report.outcome = "failed"
        report.longrepr = (
            f"{item.nodeid} took {spent / unit_s():.0f} units of processor time ({spent:.1f} s), and a test of "
            f"`make test` may take {limit:g}; remedy: make it smaller, or mark it with @pytest.mark.slow and leave a "
            "quick case of its kind (docs/testing.md)"
        )
    elif report.failed and "from pytest-timeout" in report.longreprtext:
        remedy = "find what it waits for" if slow else "find what it waits for, or mark it with @pytest.mark.slow"
        report.sections.append(("Timeout", f"the test took longer than its tier allows; remedy: {remedy}"))
    return report


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """A process that ran tests tells the one that collects their results what it took as a whole."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["processor_s"] = processor_s()


def summary(costs: Mapping[str, Cost], total_s: float, unit: float, budget: float | None) -> tuple[bool, list[str]]:
    """Whether a run keeps its budget, and what is said of it: the sum and the dearest tests."""
    dearest = sorted(costs, key=lambda name: -costs[name].processor_s)[:DEAREST]
    lines = [f"{costs[name].processor_s:8.1f} s  {name}" for name in dearest]
    units = total_s / unit
    lines.append(f"{total_s:8.1f} s of processor time for {len(costs):,} tests: {units:,.0f} units of {unit:.3f} s")
    if budget is None or units <= budget:
        return True, lines
    lines.append(
        f"the tests take {units:,.0f} units of processor time, and their budget is {budget:,.0f}; remedy: make the "
        "dearest of those above cheaper, or slow (docs/testing.md)"
    )
    return False, lines


class Ledger:
    """What each test takes, and all of them: written, shown and compared with the budget when the run ends."""

    def __init__(self, path: Path | None, budget: float | None) -> None:
        self.path, self.budget = path, budget
        self.costs: dict[str, Cost] = {}
        self.workers_s = 0.0
        unit_s()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add a phase of a test, from whichever process ran it."""
        if hasattr(report, "cost"):
            known, phase = self.costs.get(report.nodeid, Cost()), Cost(**report.cost)
            self.costs[report.nodeid] = Cost(
                known.processor_s + phase.processor_s, known.wall_s + phase.wall_s, phase.slow
            )

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """A process that ran tests has ended."""
        self.workers_s += getattr(node, "workeroutput", {}).get("processor_s", 0.0)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the file, and fail a run that costs too much."""
        total_s = self.workers_s or processor_s()
        kept, self.lines = summary(self.costs, total_s, unit_s(), self.budget)
        if not kept and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
        if self.path:
            tests = {name: asdict(cost) for name, cost in sorted(self.costs.items())}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            content = {"commit": measured_commit(), "processor_s": total_s, "unit_s": unit_s(), "tests": tests}
            self.path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the dearest tests and the sum."""
        terminalreporter.section(f"the {DEAREST} dearest tests")
        for line in self.lines:
            terminalreporter.write_line(line)

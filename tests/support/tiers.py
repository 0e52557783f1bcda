"""The tiers of the tests (docs/testing.md): which test is slow, how long a quick one may take, and what each one takes.

A pytest plugin, loaded by tests/conftest.py. Processor time is that of the test's process and of its children that have
ended: unlike the time of the clock it hardly depends on what else the machine does.
"""

from __future__ import annotations

import json
import re
import resource
import time
import zlib
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

SLOW_FOLDERS = ("hil", "pil", "soak")
"""Folders whose tests are all slow: `make test` does not run them."""
SLOW_TIMEOUT_S = 1800.0
"""After this time of the clock a slow test counts as stuck."""
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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addini("quick_limit_s", "processor time that a test without the marker `slow` may take; 0: any", default="0")
    parser.addoption("--times", metavar="FILE", help="write the processor time and the wall time of each test as JSON")
    parser.addoption("--part", metavar="K/N", default="1/1", help="the tests of one of N parts, 1/N to N/N")


def pytest_configure(config: pytest.Config) -> None:
    config.stash[CLOCK] = processor_s()
    path = config.getoption("--times")
    if path and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Times(Path(path)))


def part_of(text: str) -> tuple[int, int]:
    """Number of a part, from 0, and the number of parts. Errors: pytest.UsageError for what is no part."""
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise pytest.UsageError(f"--part {text}: not K/N with K from 1 to N; remedy: for example --part 1/3")
    return int(found[1]) - 1, int(found[2])


def in_part(name: str, number: int, parts: int) -> bool:
    """Whether a test belongs to a part: by its name, so that a part stays what it is when tests are added."""
    return zlib.crc32(name.encode()) % parts == number


def is_slow(case: str, only: Sequence[str] = ("*",), but: Sequence[str] = ()) -> bool:
    """Whether a parametrised case of a slow test is slow: its id matches a pattern of `only`, and none of `but`."""
    return any(fnmatchcase(case, one) for one in only) and not any(fnmatchcase(case, one) for one in but)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what belongs to other parts, mark the tests of slow folders, unmark the quick cases of slow tests, and
    give slow tests their own timeout."""
    number, parts = part_of(config.getoption("--part"))
    others = {item for item in items if not in_part(item.nodeid, number, parts)}
    if others:
        config.hook.pytest_deselected(items=list(others))
        items[:] = [item for item in items if item not in others]
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
    limit = float(item.config.getini("quick_limit_s"))
    slow = item.get_closest_marker("slow") is not None
    report.cost = Cost(spent, report.duration, slow).__dict__
    if report.when == "call" and report.passed and not slow and 0.0 < limit < spent:
        report.outcome = "failed"
        report.longrepr = (
            f"{item.nodeid} took {spent:.1f} s of processor time, and a test of `make test` may take {limit:g} s; "
            f"remedy: make it smaller, or mark it with @pytest.mark.slow and leave a quick case of its kind "
            f"(docs/testing.md)"
        )
    elif report.failed and "from pytest-timeout" in report.longreprtext:
        remedy = "find what it waits for" if slow else "find what it waits for, or mark it with @pytest.mark.slow"
        report.sections.append(("Timeout", f"the test took longer than its tier allows; remedy: {remedy}"))
    return report


class Times:
    """What each test takes, written when the run ends."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.costs: dict[str, Cost] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add a phase of a test, from whichever process ran it."""
        if hasattr(report, "cost"):
            known, phase = self.costs.get(report.nodeid, Cost()), Cost(**report.cost)
            self.costs[report.nodeid] = Cost(
                known.processor_s + phase.processor_s, known.wall_s + phase.wall_s, phase.slow
            )

    def pytest_sessionfinish(self) -> None:
        """Write the file."""
        rows = {
            name: {"processor_s": round(cost.processor_s, 3), "wall_s": round(cost.wall_s, 3), "slow": cost.slow}
            for name, cost in sorted(self.costs.items())
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")

# SPDX-License-Identifier: MIT
"""What was compared with what: a table at the end of the run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from pil.pil_support import Comparison, Sizes, need_tools
from zygos.files.output import table

Agree = Callable[[str, str, str, Comparison], None]
Measured = Callable[[str, str, Sizes], None]


@pytest.fixture(scope="session", autouse=True)
def _tools() -> None:
    need_tools()


@pytest.fixture
def agree(record_property: Callable[[str, object], None]) -> Agree:
    """Asserts that every byte is the same, and puts a line into the table: target, configuration, what was compared."""

    def check(target: str, configuration: str, what: str, found: Comparison) -> None:
        verdict = found.first or "equal"
        record_property("compared", [target, configuration, what, f"{found.equal:,}", f"{found.total:,}", verdict])
        assert found.total > 0
        assert not found.first

    return check


@pytest.fixture
def measured(record_property: Callable[[str, object], None]) -> Measured:
    """Puts a line into the table of sizes."""

    def note(target: str, configuration: str, sizes: Sizes) -> None:
        numbers = (sizes.code, sizes.state, sizes.work, sizes.estimate, sizes.stack)
        record_property("measured", [target, configuration, *(f"{n:,}" for n in numbers)])

    return note


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print what the tests noted, from all processes."""
    noted: dict[str, list[list[str]]] = {"compared": [], "measured": []}
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, row in getattr(report, "user_properties", ()) if getattr(report, "when", "") == "call" else ():
                noted[name].append(row)
    if noted["compared"]:
        heading = ("target", "configuration", "compared with the host", "bytes equal", "of", "verdict")
        table(heading, sorted(noted["compared"]))
    if noted["measured"]:
        heading = ("target", "capacity", "code", "zygos_arm_t", "zygos_work_t", "zygos_estimate_t", "stack used, bytes")
        table(heading, sorted(noted["measured"]))

"""The bench of `make hil`: the paper's arm for half a minute."""

from __future__ import annotations

import os
from collections.abc import Generator
from dataclasses import replace

import pytest

from conftest import EXAMPLE
from zygos.scenario import load_scenario
from zygos.testing import Plant
from zygos.testing.dut import EXTERNAL

CYCLES = 600


@pytest.fixture(scope="session")
def plant(pytestconfig: pytest.Config) -> Plant:
    scenario = replace(load_scenario(EXAMPLE / "scenario.toml"), duration_s=30.0)
    return Plant(scenario, pytestconfig.getoption("--zygos-channel"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """In CI nothing is left out, unless the device is somebody else's."""
    report = yield
    if report.skipped and os.environ.get("CI") and item.config.getoption("--zygos-dut") != EXTERNAL:
        report.outcome = "failed"
    return report

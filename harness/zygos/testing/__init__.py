# SPDX-License-Identifier: MIT
"""A test bench for flight computers, as a pytest plugin: `pytest_plugins = ["zygos.testing"]` (docs/hil.md).

Fixtures: `bus`, `plant`, `dut`, `faults`. Options: --zygos-channel, --zygos-dut, --zygos-scenario, --zygos-json.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import can

from zygos.can.bus import open_bus
from zygos.errors import ZygosError, installs
from zygos.files.output import check_outputs, table, write_json
from zygos.simulation.scenario import load_scenario
from zygos.testing import faults as _faults
from zygos.testing.dut import EXTERNAL, Dut
from zygos.testing.plant import Pace, Plant, Sent
from zygos.testing.stream import Fault, Stream

try:
    import pytest
except ImportError as error:
    raise ZygosError(f"zygos.testing needs pytest; remedy: {installs('testing')}") from error

__all__ = ["Dut", "Fault", "Pace", "Plant", "Sent", "Stream"]

_DRILL = "zygos drill"
_VERDICTS = {"passed": "pass", "failed": "fail", "error": "fail", "skipped": "not evaluated"}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the bench."""
    group = parser.getgroup("zygos")
    group.addoption("--zygos-channel", metavar="NAME", default="vcan0", help="SocketCAN interface (vcan0).")
    group.addoption(
        "--zygos-dut",
        metavar="COMMAND",
        default="zygos-node",
        help=f"Command that starts the device under test (zygos-node); {EXTERNAL}: a device already on the channel.",
    )
    group.addoption("--zygos-scenario", metavar="FILE", help="The plant: a scenario.toml, which names arm and model.")
    group.addoption("--zygos-json", metavar="FILE", help="Also write the table of drills to this file, as JSON.")


def pytest_configure(config: pytest.Config) -> None:
    """Refuse, before the drills, a file for their table that cannot be written."""
    try:
        check_outputs([config.getoption("--zygos-json")], [])
    except ZygosError as error:
        raise pytest.UsageError(str(error)) from error


@pytest.fixture
def bus(pytestconfig: pytest.Config) -> Iterator[can.BusABC]:
    """The bench's channel as a bus of python-can, for frames that a test sends itself."""
    with open_bus("socketcan", pytestconfig.getoption("--zygos-channel")) as opened:
        yield opened


@pytest.fixture(scope="session")
def plant(pytestconfig: pytest.Config) -> Plant:
    """The plant that moves according to --zygos-scenario."""
    scenario = pytestconfig.getoption("--zygos-scenario")
    if scenario is None:
        pytest.fail("no plant is given; remedy: pytest --zygos-scenario SCENARIO.toml", pytrace=False)
    return Plant(load_scenario(Path(scenario)), pytestconfig.getoption("--zygos-channel"))


@pytest.fixture(scope="session")
def _device(plant: Plant, pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dut]:
    """One device per session, because an external one has received everything that was sent before."""
    command = pytestconfig.getoption("--zygos-dut")
    with Dut(plant.arm, plant.channel, command, tmp_path_factory.mktemp("dut")) as device:
        yield device


@pytest.fixture
def dut(_device: Dut, request: pytest.FixtureRequest) -> Dut:
    """The device under test: our own one is reset in each test and not started yet."""
    _device.renew()
    request.node.user_properties.append((_DRILL, _device.record))
    return _device


@pytest.fixture(name="faults")
def faults_fixture() -> ModuleType:
    """The module `zygos.testing.faults`, which changes streams."""
    return _faults


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Print the table of drills, and write it as JSON."""
    rows = []
    for outcome, verdict in _VERDICTS.items():
        for report in terminalreporter.getreports(outcome):
            record = dict(getattr(report, "user_properties", ())).get(_DRILL)  # a failed collection has none
            if record is None or (outcome == "passed" and (report.when != "call" or record["expected"] is None)):
                continue  # not a drill, or a test that judged nothing
            reason = report.longrepr[2].partition("not evaluated: ")[2] if outcome == "skipped" else None
            name = report.nodeid.rpartition("::")[2]
            rows.append({"drill": name, **record, "verdict": verdict, "reason": reason})
    if not rows:
        return
    table(
        ("drill", "frames", "faults expected", "found", "verdict"),
        [
            (
                r["drill"],
                f"{r['frames']:,}",
                _listed(r["expected"]),
                _listed(r["found"]),
                f"{r['verdict']}: {r['reason']}" if r["reason"] else r["verdict"],
            )
            for r in rows
        ],
    )
    path = config.getoption("--zygos-json")
    if path:
        write_json(path, {"channel": config.getoption("--zygos-channel"), "drills": rows})


def _listed(counts: dict[str, int] | None) -> str:
    """Counters as text of a table cell."""
    if counts is None:
        return "–"
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "none"

# SPDX-License-Identifier: MIT
"""The bench as its users run it: the example of docs/hil.md, and drills on a device that is somebody else's."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import pytest
from schema_support import hold

from conftest import PAPER, ROOT
from zygos.can.bus import from_messages
from zygos.errors import ZygosError
from zygos.testing import Dut, Plant, Stream

DRILLS = "tests/hil/test_drills.py::test_drill"


def run(config: pytest.Config, device: str, out: Path, *tests: str) -> tuple[int, dict[str, dict[str, Any]]]:
    """Run tests in a session of their own. Returns its status and the rows by drill."""
    bench = ["--zygos-scenario", str(PAPER / "scenario.toml"), "--zygos-dut", device, "--zygos-json", str(out)]
    bench += ["--zygos-channel", config.getoption("--zygos-channel")]
    outer = sys.modules["conftest"]
    status = pytest.main(["-rs", *(str(ROOT / test) for test in tests), *bench])
    sys.modules["conftest"] = outer
    content = json.loads(out.read_text())
    hold("hil", content)
    return int(status), {row["drill"]: row for row in content["drills"]}


def test_the_example_of_the_manual(pytestconfig: pytest.Config, dut: Dut, tmp_path: Path) -> None:
    device = pytestconfig.getoption("--zygos-dut")
    status, rows = run(pytestconfig, device, tmp_path / "hil.json", "examples/bench")
    assert status == 0
    faults = {"dropped": 3, "incomplete": 3}
    row = {"drill": "test_three_lost_frames", "frames": 2803, "expected": faults, "found": faults}
    assert rows == {"test_three_lost_frames": row | {"verdict": "pass", "reason": None}}
    manual = (ROOT / "docs" / "hil.md").read_text(encoding="utf-8")
    for name in ("conftest.py", "test_flight_computer.py"):
        text = (ROOT / "examples" / "bench" / name).read_text(encoding="utf-8")
        text = text.removeprefix("# SPDX-License-Identifier: MIT\n").lstrip("\n")
        assert "".join(f"    {line}".rstrip() + "\n" for line in text.splitlines()) in manual


def test_drills_on_whatever_answers(
    pytestconfig: pytest.Config, dut: Dut, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What would have to kill the device, or to be its controller, is not evaluated. The rest is, and can fail: of a
    device that has heard something else before, the counters and estimates are others."""
    names = [f"{DRILLS}[{name}]" for name in ("lost", "clean", "flipped", "error frames")]
    names.append("tests/hil/test_node.py::test_killed_and_resumed")
    dut.start()
    status, rows = run(pytestconfig, "external", tmp_path / "hil.json", *names)
    assert status == 0
    verdicts = {name: row["verdict"] for name, row in rows.items()}
    done, skipped = "pass", "not evaluated"
    assert verdicts == {
        "test_drill[lost]": done,
        "test_drill[clean]": done,
        "test_drill[flipped]": done,
        "test_drill[error frames]": skipped,
        "test_killed_and_resumed": skipped,
    }
    reason = "an external device cannot be ended by the bench"
    assert rows["test_killed_and_resumed"]["reason"] == reason
    assert f"not evaluated: {reason}" in capsys.readouterr().out
    # The run of "lost" ends with an open cycle, 50 behind its last FTIME; that of "clean" begins 80 counters on, with
    # a clock at zero.
    assert rows["test_drill[lost]"]["found"] == {"dropped": 3, "incomplete": 3}
    assert rows["test_drill[clean]"]["found"] == {
        **dict.fromkeys(["dropped", "incomplete", "sync_jumped", "time_lost", "time_jumped"], 1)
    }
    status, rows = run(pytestconfig, "external", tmp_path / "again.json", f"{DRILLS}[clean]")
    assert status == 1
    assert rows["test_drill[clean]"]["verdict"] == "fail"
    assert dut.stop()["fault_crc"] == 20


def test_a_frame_of_ones_own(bus: can.BusABC, plant: Plant, dut: Dut) -> None:
    """Sent by hand between two cycles: joint 1's angles without a CRC."""
    stream = plant.run(400)
    mine = can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(range(8)))
    dut.start()
    plant.send(stream.part(0, 100))
    bus.send(mine)
    plant.send(stream.part(100))
    heard = stream.part(0, 100) + Stream.recorded(plant.arm, from_messages([mine])) + stream.part(100)
    dut.judge(heard, crc=1)


def test_what_does_not_answer_is_named(plant: Plant, dut: Dut) -> None:
    stream = plant.run(50)
    with pytest.raises(ZygosError, match=r"no answer \(frame 0x1A0\) to 15 SYNCs for 0.5 s; remedy: check that"):
        replace(plant, patience_s=0.5).send(stream)
    with pytest.raises(ZygosError, match=r"nothere0: .*No such device; remedy"):
        replace(plant, channel="nothere0").send(stream)
    with pytest.raises(ZygosError, match="is not running"):
        dut.stop()
    with pytest.raises(ZygosError, match="scenario lively has 1200 cycles; remedy"):
        plant.run(1201)


def test_a_node_that_refuses_says_why(dut: Dut) -> None:
    dut.start()
    dut.stop()
    state = bytearray(dut.state.read_bytes())
    state[1000] ^= 1
    dut.state.write_bytes(state)
    with pytest.raises(ZygosError, match=r"state.zyg: is damaged: its CRC does not fit its bytes"):
        dut.start()

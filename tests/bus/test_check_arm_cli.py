# SPDX-License-Identifier: MIT
"""`zygos check-arm`, through the command line: logs and cycle tables, clean and spoilt."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import run
from scipy.io import loadmat

from conftest import EXAMPLE, ROOT, need
from zygos.arm import Arm
from zygos.audit.readings import noise_level
from zygos.can import bus
from zygos.native.flight import encode
from zygos.runs.cycles import Cycles
from zygos.runs.tables import write_cycles
from zygos.simulation.plant import Trajectory

ARM = EXAMPLE / "arm.toml"
KR300 = ROOT.parent / "shared" / "data" / "kr300" / "run_a.mat"


@pytest.fixture
def cycles(noisy: Trajectory) -> Cycles:
    return noisy.cycles(0)


def logged(path: Path, arm: Arm, cycles: Cycles) -> Path:
    bus.write_log(path, encode(arm, cycles), arm.period_s)
    return path


def answer(tmp_path: Path, arm_file: Path, log: Path, code: int) -> dict[str, Any]:
    assert run("check-arm", log, "--arm", arm_file, "--json", tmp_path / "a.json") == code
    content: dict[str, Any] = json.loads((tmp_path / "a.json").read_text())
    return content


def faults(content: dict[str, Any]) -> list[tuple[str, str]]:
    return [(f["signal"], f["fault"]) for f in content["findings"]]


@pytest.mark.slow
def test_a_clean_log_is_clean(tmp_path: Path, arm: Arm, cycles: Cycles, capsys: pytest.CaptureFixture[str]) -> None:
    content = answer(tmp_path, ARM, logged(tmp_path / "run.blf", arm, cycles), 0)
    assert content["ok"]
    assert content["findings"] == []
    assert [s["verdict"] for s in content["signals"]] == ["ok"] * 9
    assert all(s["share"] == 1.0 for s in content["signals"])
    assert "1,200 cycles" in capsys.readouterr().out
    assert run("check-arm", tmp_path / "run.blf", "--arm", ARM, "--details") == 0
    assert "shoulder link angle" in capsys.readouterr().out


@pytest.mark.slow
def test_a_wrong_arm_file_is_told_what_to_write(
    tmp_path: Path, arm: Arm, cycles: Cycles, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "arm.toml"
    wrong.write_text(ARM.read_text().replace('side = "output", sign = 1', 'side = "output", sign = -1', 1))
    content = answer(tmp_path, wrong, logged(tmp_path / "run.log", arm, cycles), 3)
    assert faults(content) == [("shoulder motor angle", "inverted")]
    assert content["findings"][0]["remedy"] == "sign = 1 of the motor_encoder"
    said = capsys.readouterr()
    assert "shoulder motor angle: inverted" in said.out
    assert "1 finding, the first: shoulder motor angle inverted; remedy: sign = 1" in said.err


@pytest.mark.slow
def test_json_alone_on_stdout(tmp_path: Path, arm: Arm, cycles: Cycles, capsys: pytest.CaptureFixture[str]) -> None:
    log = logged(tmp_path / "run.blf", arm, cycles)
    assert run("check-arm", log, "--arm", ARM, "--json", "-") == 0
    assert json.loads(capsys.readouterr().out)["arm"] == "lively"


@pytest.mark.slow
def test_a_cycle_table_gives_what_the_log_gives(tmp_path: Path, arm: Arm, cycles: Cycles) -> None:
    q = cycles.q.copy()
    q[:, 1] *= -1
    spoilt = replace(cycles, q=q)
    np.savez(tmp_path / "run.npz", **asdict(spoilt))
    from_table = faults(answer(tmp_path, ARM, tmp_path / "run.npz", 3))
    assert from_table == [("elbow link angle", "inverted")]
    assert faults(answer(tmp_path, ARM, logged(tmp_path / "run.blf", arm, spoilt), 3)) == from_table


def test_torque_beyond_the_wire_is_saturated(tmp_path: Path, arm: Arm, cycles: Cycles) -> None:
    """The receiver drops these cycles, so that only the frames show which signal it was."""
    tau = cycles.tau.copy()
    peak = min(tau[:, 1].max(), -tau[:, 1].min())  # so that both ends of the range are reached
    tau[:, 1] *= 838.8606 / (0.95 * peak)
    content = answer(tmp_path, ARM, logged(tmp_path / "run.blf", arm, replace(cycles, tau=tau)), 3)
    beyond = int(np.sum(np.abs(tau[:, 1]) >= 838.8607))
    assert beyond > 0
    (finding,) = (f for f in content["findings"] if f["fault"] == "saturated")
    assert finding["signal"] == "elbow torque"
    assert finding["evidence"].startswith(f"{beyond} frames")


@pytest.mark.slow
def test_lost_frames_are_counted_by_signal(tmp_path: Path, arm: Arm, cycles: Cycles) -> None:
    frames = encode(arm, cycles)
    torque = np.flatnonzero(frames["id"] == 0x281)
    bus.write_log(tmp_path / "run.blf", np.delete(frames, torque[::20]), arm.period_s)
    content = answer(tmp_path, ARM, tmp_path / "run.blf", 3)
    assert ("shoulder torque", "loses 5.0 %") in faults(content)
    assert {s for s, fault in faults(content) if "loses" in fault} == {"shoulder torque"}


@pytest.mark.slow
def test_a_node_that_is_not_there_is_missing(tmp_path: Path, arm: Arm, cycles: Cycles) -> None:
    wrong = tmp_path / "arm.toml"
    wrong.write_text(ARM.read_text().replace("node = 2", "node = 3"))
    content = answer(tmp_path, wrong, logged(tmp_path / "run.blf", arm, cycles), 3)
    missing = {"elbow link angle", "elbow motor angle", "elbow torque"}
    assert {signal for signal, fault in faults(content) if fault == "missing"} == missing
    assert {s["verdict"] for s in content["signals"]} == {"missing", "not decidable"}


@pytest.mark.slow
def test_the_clock_of_the_bus_is_held_against_the_period(tmp_path: Path, arm: Arm, cycles: Cycles) -> None:
    wrong = tmp_path / "arm.toml"
    wrong.write_text(ARM.read_text().replace("period_s = 0.05", "period_s = 0.04"))
    content = answer(tmp_path, wrong, logged(tmp_path / "run.blf", arm, cycles), 3)
    assert ("SYNC", "every 50 ms, not 40 ms") in faults(content)


def test_a_run_at_rest_confirms_nothing(
    tmp_path: Path, arm: Arm, cycles: Cycles, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    still = replace(
        cycles,
        q=0.3 + 0.0008 * rng.standard_normal(cycles.q.shape),
        theta=0.3 + 0.0008 * rng.standard_normal(cycles.q.shape),
        tau=0.01 * rng.standard_normal(cycles.q.shape),
        omega=1e-6 * rng.standard_normal(cycles.omega.shape),
    )
    content = answer(tmp_path, ARM, logged(tmp_path / "run.blf", arm, still), 3)
    assert content["findings"] == []
    assert not content["ok"]
    assert "no fault was found, but nothing confirms" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ({"theta": None}, "has no column theta1"),
        ({"tau": np.zeros((1200, 3))}, "tau3 is no column of a cycle table of 2 joints"),
        ({"q": np.zeros((1200, 1))}, "has no column q2"),
        ({"q": np.full((1200, 2), "a")}, "q1"),
    ],
    ids=["missing", "shape", "joints", "text"],
)
def test_a_bad_table_is_refused(
    tmp_path: Path, cycles: Cycles, capsys: pytest.CaptureFixture[str], spoil: dict[str, Any], message: str
) -> None:
    fields = {name: value for name, value in {**asdict(cycles), **spoil}.items() if value is not None}
    np.savez(tmp_path / "run.npz", **fields)
    assert run("check-arm", tmp_path / "run.npz", "--arm", ARM, "--json", tmp_path / "a.json") == 2
    said = capsys.readouterr().err
    assert message in said.replace("\n", " ")
    assert "; remedy:" in said.replace("\n", " ")
    assert not (tmp_path / "a.json").exists()


@pytest.mark.slow
def test_a_measured_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A KUKA KR300's table: the skew between its encoders is named before anybody reads a stiffness from them."""
    need(KR300.is_file(), f"the measured run of a KUKA KR300, {KR300.name}")
    record = loadmat(KR300, squeeze_me=True, struct_as_record=False)["rec"]
    q, theta = np.deg2rad(record.act_pos_se_deg[:3].T), np.deg2rad(record.act_pos_mot_deg[:3].T)
    n = len(q)
    table = Cycles(
        np.arange(n, dtype=np.uint64),
        q,
        theta,
        record.act_torque_abs_nm[:3].T,
        np.zeros((n, 3)),
        np.zeros(n, dtype=np.uint32),
    )
    write_cycles(tmp_path / "kr300.npz", table)
    lines = [
        'name = "kr300"', 'base = "fixed"', "gravity = [0, 0, -9.81]", 'kinetic = "spatial"', "period_s = 0.004",
        'torque_law = "sampled"', 'torque_at = "rotor"',
    ]  # fmt: skip
    for i, (ratio, axis) in enumerate(((256.8571, "[0, 0, -1]"), (267.4286, "[0, 1, 0]"), (252.3333, "[0, 1, 0]"))):
        link, motor = (float(np.sqrt(12) * noise_level(x[:, i], [(0, n)])) for x in (q, theta))
        lines += [
            "[[joint]]", f'name = "a{i + 1}"', f"node = {i + 1}", f"axis = {axis}", f"gear_ratio = {ratio}",
            f"link_encoder = {{ quantum_rad = {link} }}",
            f'motor_encoder = {{ quantum_rad = {motor}, side = "output" }}',
        ]  # fmt: skip
    (tmp_path / "arm.toml").write_text("\n".join(lines))
    content = answer(tmp_path, tmp_path / "arm.toml", tmp_path / "kr300.npz", 3)
    assert content["door"] == "cycle"
    skewed = {signal: fault for signal, fault in faults(content) if fault.startswith("skewed")}
    assert set(skewed) == {f"a{i} motor angle" for i in (1, 2, 3)}
    for fault in skewed.values():
        found = re.search(r"([0-9.]+) ms", fault)
        assert found is not None
        assert float(found[1]) == pytest.approx(3.0, abs=0.2)
    assert "latch_us" in capsys.readouterr().out


def test_swapped_arguments_are_said_to_be_swapped(
    tmp_path: Path, arm: Arm, cycles: Cycles, capsys: pytest.CaptureFixture[str]
) -> None:
    log = logged(tmp_path / "run.blf", arm, cycles)
    assert run("check-arm", log, "--arm", log) == 2
    said = capsys.readouterr().err
    assert (
        "run.blf is a recording, in the place of the arm file: are the two swapped? "
        "remedy: `zygos check-arm RUN --arm ARM.toml`" in said
    )
    for command in (("estimate", ARM, "-o", tmp_path / "m.toml"), ("predict", ARM, "--model", EXAMPLE / "model.toml")):
        assert run(*command) == 2
        assert "arm.toml is an arm file, in the place of a recording" in capsys.readouterr().err
    assert run("estimate", log, "--arm", log, "-o", tmp_path / "m.toml") == 2
    assert "`zygos estimate RUN... --arm ARM.toml`" in capsys.readouterr().err
    (tmp_path / "map.toml").write_text("[time]\n")
    assert run("convert", tmp_path / "map.toml", "--map", log, "--arm", ARM, "-o", tmp_path / "out" / "run.npz") == 2
    assert "`zygos convert RECORDING --map MAP.toml --arm ARM.toml -o RUN`" in capsys.readouterr().err
    for arguments, wrong in (
        (("check-arm", log, "--arm", tmp_path), "is a folder; remedy: give the arm file in it"),
        (
            ("check-arm", log, "--arm", EXAMPLE / "model.toml"),
            "model.toml: is a model, not an arm file; remedy: give an arm file",
        ),
        (
            ("convert", log, "--map", ARM, "--dbc", "x.dbc", "--arm", ARM, "-o", tmp_path / "r.npz"),
            "is an arm file, not a map",
        ),
        (("predict", log, "--arm", ARM, "--model", tmp_path), "is a folder; remedy: give a model in it"),
        (("simulate", ARM, "-o", tmp_path / "r.blf"), "is an arm file, not a scenario"),
    ):
        assert run(*arguments) == 2
        assert wrong in capsys.readouterr().err
    assert {file.name for file in tmp_path.iterdir()} == {"run.blf", "map.toml"}


def test_other_bad_input_is_refused(
    tmp_path: Path, arm: Arm, cycles: Cycles, capsys: pytest.CaptureFixture[str]
) -> None:
    log = logged(tmp_path / "run.blf", arm, cycles)
    (tmp_path / "broken.npz").write_bytes(b"no archive")
    before = log.read_bytes()
    for arguments in (
        (tmp_path / "none.npz", "--arm", ARM),
        (tmp_path / "none.blf", "--arm", ARM),
        (tmp_path / "broken.npz", "--arm", ARM),
        (log, "--arm", tmp_path / "none.toml"),
        (log, "--arm", ARM, "--json", log),
    ):
        assert run("check-arm", *arguments) == 2
        assert "remedy" in capsys.readouterr().err
    assert log.read_bytes() == before


@pytest.mark.slow
def test_the_manual_runs_from_a_fresh_clone(tmp_path: Path) -> None:
    """Every command of docs/check-arm.md, with nothing beside the checkout; the last one finds what was done to it."""
    text = (ROOT / "docs" / "check-arm.md").read_text()
    commands = [
        line.strip() for line in re.findall(r"^    (.*zygos .*)$", text, re.M) if "RUN --arm ARM.toml" not in line
    ]
    assert len(commands) == 3
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    codes = []
    for command in commands:
        done = subprocess.run(
            command, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        codes.append(done.returncode)
    assert codes == [0, 0, 3]
    assert "shoulder motor angle: inverted" in done.stdout
    assert "elbow motor angle: inverted" in done.stdout
    # what is not in the repository is named as that, with its source
    _, before, behind = text.partition("run_a.mat")
    assert before
    assert "not part of this repository" in " ".join(text.split())
    assert "github.com/JonasWeigand/Robot_Identification" in behind

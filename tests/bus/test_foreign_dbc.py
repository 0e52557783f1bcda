# SPDX-License-Identifier: MIT
"""DBC files with faults: of messages that the map does not use they are warnings, of others refusals."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import can
import numpy as np
import pytest
import telemetry_support as foreign
from cli_support import run

from conftest import PAPER, ROOT, need
from zygos.arm import load_arm
from zygos.runs.cycles import Cycles
from zygos.runs.tables import read_cycles

CASES = ROOT.parent / "shared" / "cases"
SOUND = foreign.EXAMPLE / "arm.dbc"
FOREIGN = '\nBO_ 1000 Foreign: 4 Drive1\n SG_ Big : {} (1,0) [0|0] "" Recorder\n'


def convert(dbc: Path, out: Path, *more: object) -> int:
    files = ("--map", foreign.EXAMPLE / "map.toml", "--arm", PAPER / "arm.toml")
    return run("convert", foreign.EXAMPLE / "run.blf", "--dbc", dbc, *files, "-o", out / "run.npz", *more)


@cache
def sound_run() -> Cycles:
    with TemporaryDirectory() as folder:
        assert convert(SOUND, Path(folder)) == 0
        return read_cycles(Path(folder) / "run.npz", load_arm(PAPER / "arm.toml"))


def warnings(dbc: Path, folder: Path) -> list[str]:
    """What is said of a DBC that is read; the run must be that of the sound DBC."""
    assert convert(dbc, folder / "own", "--json", folder / "c.json") == 0
    own, sound = read_cycles(folder / "own" / "run.npz", load_arm(PAPER / "arm.toml")), sound_run()
    np.testing.assert_array_equal(own.q, sound.q)
    np.testing.assert_array_equal(own.tau, sound.tau)
    found: list[str] = json.loads((folder / "c.json").read_text())["warnings"]
    return found


@pytest.mark.slow(only=["dbc_foreign_message_with_too_long_signal*"])
@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "dbc_foreign_message_with_too_long_signal",
            "the signal Big does not fit in message Foreign; the map does not use that message",
        ),
        (
            "dbc_overlapping_signals",
            "the signals OutputHigh and Output are overlapping in message Drive1Torque; the map uses one of these "
            "signals: check that message in the DBC",
        ),
    ],
)
def test_the_faults_of_the_shared_cases(name: str, said: str, tmp_path: Path) -> None:
    need((CASES / f"{name}.dbc").is_file(), f"the case {name}")
    assert warnings(CASES / f"{name}.dbc", tmp_path) == [f"{name}.dbc: {said}"]


@pytest.mark.slow
def test_a_message_that_comes_twice_in_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Which of the two the map means cannot be told; of a message that it does not use that does not matter."""
    case = CASES / "dbc_message_name_twice_in_one_file.dbc"
    need(case.is_file(), case.name)
    assert convert(case, tmp_path) == 2
    said = capsys.readouterr().err
    assert "message Drive1Torque is defined twice, with the identifiers 0x311 and 0x384; remedy: " in said
    twice = FOREIGN.format("0|8@1+") + FOREIGN.replace("1000", "1001").format("0|8@1+")
    (tmp_path / "x.dbc").write_text(SOUND.read_text() + twice)
    (said,) = warnings(tmp_path / "x.dbc", tmp_path)
    assert "message Foreign is defined twice, with the identifiers 0x3E8 and 0x3E9; the map does not" in said
    same = FOREIGN.format("0|8@1+") + FOREIGN.replace("Foreign", "Valve").format("0|8@1+")
    (tmp_path / "x.dbc").write_text(SOUND.read_text() + same)
    (said,) = warnings(tmp_path / "x.dbc", tmp_path)
    assert "messages Foreign and Valve have the same identifier 0x3E8; the map does not use that message" in said


@pytest.mark.slow(only=["length", "identifier", "two"])
@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FOREIGN.format("0|0@1+"), "the signal Big length 0 is not greater than 0 in message Foreign"),
        (FOREIGN.replace("1000", "3000").format("0|8@1+"), "standard frame id 0xbb8 is more than 11 bits in message"),
        (FOREIGN.format("0|0@1+") + 'VAL_ 1000 Big 0 "off" ;\n', "length 0 is not greater than 0 in message Foreign"),
        (
            FOREIGN.format("0|40@1+") + FOREIGN.replace("1000 Foreign", "1001 Other").format("0|0@1+"),
            "in message Other, and 1 more such fault; the map does not use that message",
        ),
    ],
    ids=["length", "identifier", "values", "two"],
)
def test_faults_that_the_library_refuses(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "x.dbc").write_text(SOUND.read_text() + text)
    (found,) = warnings(tmp_path / "x.dbc", tmp_path)
    assert said in found


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Output : 7|32@0-", "Output : 7|40@0-", "the signal Output does not fit in message Drive1Torque"),
        ("Output : 7|32@0-", "Output : 7|0@0-", "length 0 is not greater than 0 in message Drive1Torque"),
        ("Link : 39|32@0-", "Link : 31|32@0-", "the signals Link and Motor are overlapping in message Drive1Position"),
        ("BO_ 785 ", "BO_ 769 ", "messages Drive1Position and Drive1Torque have the same identifier 0x301"),
        ("SG_ Output", "SG Output", "not a readable DBC (DBC: \"Invalid syntax at line 18"),
    ],
    ids=["long", "length", "overlap", "identifier", "syntax"],
)  # fmt: skip
def test_faults_of_what_the_map_uses_are_refused(
    old: str, new: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SOUND.read_text()
    assert old in text
    (tmp_path / "x.dbc").write_text(text.replace(old, new, 1))
    assert convert(tmp_path / "x.dbc", tmp_path / "out") == 2
    refusal = capsys.readouterr().err.replace("\n", " ")
    assert said in refusal and "; remedy: " in refusal
    assert not (tmp_path / "out").exists()


def test_a_dbc_in_utf_8(tmp_path: Path) -> None:
    """In the encoding of Vector's tools its degrees would be another unit."""
    text = SOUND.read_text().replace('"deg"', '"°"')
    for encoding in ("utf-8", "utf-8-sig", "cp1252"):
        (tmp_path / "x.dbc").write_text(text, encoding=encoding)
        assert warnings(tmp_path / "x.dbc", tmp_path) == []


MUX = """
BO_ 1000 Mux: 4 Drive1
 SG_ Which M : 0|8@1+ (1,0) [0|0] "" Recorder
 SG_ Other m0 : 8|{}@1- (1,0) [0|0] "" Recorder
 SG_ Torque m1 : 8|16@1- (1,0) [0|0] "mNm" Recorder
 SG_ Overlap m1 : 16|16@1- (1,0) [0|0] "" Recorder
"""


@pytest.mark.slow
@pytest.mark.parametrize("bits", [16, 40])
def test_frames_with_other_signals_are_not_damaged(bits: int, tmp_path: Path) -> None:
    """A multiplexed torque, between whose frames come those with another signal, which does not even fit."""
    (tmp_path / "x.dbc").write_text(SOUND.read_text() + MUX.format(bits))
    log = []
    for message in can.LogReader(str(foreign.EXAMPLE / "run.blf")):
        if message.arbitration_id == 785:
            data = bytes(message.data)
            torque = int.from_bytes(data, "big", signed=True) // 256
            for which in (0, 1):
                low = torque.to_bytes(2, "little", signed=True)
                kind = {"arbitration_id": 1000, "is_extended_id": False, "timestamp": message.timestamp}
                log.append(can.Message(data=bytes([which]) + low + b"\0", **kind))
        log.append(message)
    source = foreign.write(tmp_path / "x.blf", log)
    changed = foreign.edited(foreign.EXAMPLE / "map.toml", tmp_path / "map.toml", ("Drive1Torque.Output", "Mux.Torque"))
    files = ("--dbc", tmp_path / "x.dbc", "--map", changed, "--arm", PAPER / "arm.toml")
    assert run("convert", source, *files, "-o", tmp_path / "r.npz", "--json", tmp_path / "c.json") == 0
    report = json.loads((tmp_path / "c.json").read_text())
    assert (report["cycles"], report["damaged_frames"]) == (1200, 0)
    assert len(report["warnings"]) == 1 and "in message Mux; the map uses one of these" in report["warnings"][0]

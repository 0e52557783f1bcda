# SPDX-License-Identifier: MIT
"""Drive profiles: their frames, written byte by byte as the makers publish them, and options that do not fit.

Expected values are written as numbers: the comments name the code of a maker, or its package, that gives them.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from cli_support import run

from conftest import ROOT
from zygos.arm import load_arm
from zygos.files.tables import read_columns
from zygos.telemetry.drives import profiles, read_drives

URDF = ROOT / "examples" / "openarm" / "openarm.urdf"


SI = {"rad": 1.0, "turn": 2 * math.pi, "Nm": 1.0, "mNm": 1e-3}
EDS = """[FileInfo]
FileName=drive.eds
[6076]
ParameterName=Motor rated torque
DefaultValue=0
ParameterValue=1250
[608F]
SubNumber=3
[608Fsub1]
DefaultValue=65536
[608Fsub2]
DefaultValue=1
[1800sub1]
DefaultValue=$NODEID+0x40000180
[1A00sub0]
DefaultValue=3
[1A00sub1]
DefaultValue=0x60410010
[1A00sub2]
DefaultValue=0x60640020
[1A00sub3]
DefaultValue=0x60770010 ; torque actual value
[1801sub1]
DefaultValue=0x80000280
[1A01sub0]
DefaultValue=1
[1A01sub1]
DefaultValue=0x60640020
"""
"""Of a drive that sends position and torque in one frame; a second one is switched off."""


def decoded(drive: str, node: int, *frames: can.Message, eds: tuple[Path, ...] = ()) -> tuple[float, float]:
    """Angle in rad and torque in Nm that the profile reads from frames of one node."""
    drives = read_drives(drive, str(node), eds)
    dictionary = drives.dictionary()
    found = {}
    for kind in ("motor", "torque"):
        entry = drives.entry(0, kind)
        message, signal = dictionary.find(entry["signal"], "test")
        (frame,) = [
            one
            for one in frames
            if (one.arbitration_id & ~dictionary.ignored_bits, one.is_extended_id)
            == (message.frame_id & ~dictionary.ignored_bits, message.is_extended_frame)
        ]
        value: Any = message.decode(bytes(frame.data))
        found[kind] = value[signal.name] * entry.get("scale", 1.0) * SI[entry["unit"]]
    return found["motor"], found["torque"]


def frame(identifier: int, data: bytes, *, extended: bool = False, fd: bool = False) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=extended, is_fd=fd, data=data)


@pytest.mark.parametrize(("motor", "torque"), [("DM8009", 54.0), ("DM4340", 28.0), ("DM4310", 10.0)])
def test_damiao(motor: str, torque: float) -> None:
    """decode_sensor_feedback() of the package damiao-motor 1.0.6 and CanPacketDecoder of openarm_can give the same."""
    zero = decoded(f"damiao:{motor}", 3, frame(0x13, bytes.fromhex("13 80 00 80 07 ff 1e 20")))
    assert zero == pytest.approx((25.0 * 0x8000 / 65535 - 12.5, 2 * torque * 0x7FF / 4095 - torque), abs=1e-9)
    high = decoded(f"damiao:{motor}", 3, frame(0x13, bytes.fromhex("13 ff ff 00 0f ff 1e 20")))
    assert high == pytest.approx((12.5, torque), abs=1e-9)


def test_cubemars() -> None:
    """parse_MIT_message() of TMotorCANControl 1.2.6: byte 0 is the node, then 16, 12 and 12 bits; 6 or 8 bytes."""
    for tail in ("", "1e 00"):
        found = decoded("cubemars:AK80-9", 5, frame(5, bytes.fromhex("05 c0 00 80 0c 00" + tail)))
        assert found == pytest.approx((25.0 * 0xC000 / 65535 - 12.5, 36.0 * 0xC00 / 4095 - 18.0), abs=1e-9)


@pytest.mark.parametrize("identifier", [0x028003FD, 0x028103FF, 0x02BF0300])
def test_robstride(identifier: int) -> None:
    """receive_status_frame() of RobStride's robstride_dynamics: (u16 / 0x7FFF - 1) of 4 pi and of the torque range."""
    data = struct.pack(">HHHH", 0x4000, 0x7FFF, 0xC000, 250)
    found = decoded("robstride:RS04", 3, frame(identifier, data, extended=True))
    assert found == pytest.approx((4 * math.pi * (0x4000 / 0x7FFF - 1), 120.0 * (0xC000 / 0x7FFF - 1)), abs=1e-9)


def test_odrive() -> None:
    """can_simple.py of ODriveResources: node << 5 | 0x09, two floats in turns; Get_Torques is 0x1C."""
    angles = frame(2 << 5 | 0x09, struct.pack("<ff", 0.75, 0.1))
    torques = frame(2 << 5 | 0x1C, struct.pack("<ff", 0.5, 0.625))
    assert decoded("odrive", 2, angles, torques) == pytest.approx((1.5 * math.pi, 0.625))


@pytest.mark.parametrize(("node", "extended"), [(4, False), (12, True)])
def test_moteus(node: int, extended: bool) -> None:
    """RegisterParser of the package moteus 1.1.1 reads position 0.25 and torque 1.75 from these 24 bytes of CAN FD."""
    data = bytes.fromhex("21000a2f010000803e000000bf0000e03f230d301e005050")
    found = decoded("moteus", node, frame(node << 8, data, extended=extended, fd=True))
    assert found == pytest.approx((0.5 * math.pi, 1.75))


def written(folder: Path, **changed: str) -> Path:
    """The EDS, with other lines in the place of some: a section and its value."""
    text = EDS
    for section, value in changed.items():
        text += f"[{section.removeprefix('_')}]\nParameterValue={value}\n"
    path = folder / "drive.eds"
    path.write_text(text)
    return path


def test_cia402(tmp_path: Path) -> None:
    """TPDO1 is 0x180 + node (CiA 301); 16384 of 65536 increments are a quarter of a turn of the motor, and 500 per
    mille of 1250 mNm are 0.625 Nm (CiA 402)."""
    words = frame(0x183, struct.pack("<Hih", 0x0637, 16384, 500))
    eds = written(tmp_path)
    assert decoded("cia402", 3, words, eds=(eds,)) == pytest.approx((0.5 * math.pi, 0.625))
    backwards = frame(0x183, struct.pack("<Hih", 0x0637, -16384, -500))
    assert decoded("cia402", 3, backwards, eds=(eds,)) == pytest.approx((-0.5 * math.pi, -0.625))
    drives = read_drives("cia402", "3,4", (eds,))
    assert drives.entry(0, "motor")["side"] == "rotor" and drives.entry(0, "torque")["at"] == "rotor"
    assert drives.described()[1] == "node 3, 4: steps of 0.0959 mrad and 1.25 mNm"
    assert {one.frame_id for one in drives.dictionary().messages.values()} == {0x183, 0x184}


def test_cia402_with_user_units_and_29_bits(tmp_path: Path) -> None:
    """A DCF: degrees times 1000 behind a gear of 50 (0x6091, 0x6092), and objects in two frames, one of 29 bits."""
    eds = written(
        tmp_path, _1A00sub0="2", _1801sub1="0x20012300+$NODEID", _1A01sub1="0x60770010", _6091sub1="50", _6091sub2="1",
        _6092sub1="360000", _6092sub2="1",
    )  # fmt: skip
    position = frame(0x183, struct.pack("<Hi", 0x0637, 90000))
    torque = frame(0x12303, struct.pack("<h", -100), extended=True)
    assert decoded("cia402", 3, position, torque, eds=(eds,)) == pytest.approx((0.5 * math.pi, -0.125))
    assert read_drives("cia402", "3", (eds,)).entry(0, "motor")["side"] == "output"


def test_cia402_with_a_second_encoder(tmp_path: Path) -> None:
    """0x60E4:01 in the steps of 0x60E9 over 0x60EE is the angle of the link."""
    eds = written(
        tmp_path, _1801sub1="0x280+$NODEID", _1A01sub1="0x60E40120", _60E9sub1="0x100000", _60EEsub1="1"
    )  # fmt: skip
    drives = read_drives("cia402", "5", (eds,))
    entry = drives.entry(0, "link")
    message, signal = drives.dictionary().find(entry["signal"], "test")
    value: Any = message.decode(struct.pack("<i", 0x40000))
    assert message.frame_id == 0x285 and value[signal.name] * entry["scale"] == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"_6076": "0"}, "the rated torque (0x6076, mNm), of which the torque is a share, has no value"),
        ({"_608Fsub2": "0"}, "the steps of the position in a turn (0x6092, or 0x608F for increments) have no value"),
        ({"_1A00sub0": "2"}, "no process data that node 1 sends have 0x6077"),
        ({"_1800sub1": "0x80000181"}, "no process data that node 1 sends have 0x6064"),
        ({"_1A00sub1": "what"}, '"what" is no number'),
    ],
)
def test_cia402_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], changed: dict[str, str], said: str) -> None:
    log = tmp_path / "run.log"
    log.write_text("(0.0) can0 181#0000000000000000\n")
    eds, out = written(tmp_path, **changed), tmp_path / "out" / "run.npz"
    assert run("convert", log, "--drive", "cia402", "--nodes", "1", "--eds", eds, "--arm", "a.toml", "-o", out) == 2
    err = capsys.readouterr().err.replace("\n", " ")
    assert said in err and "remedy: " in err


def test_every_profile_says_what_it_is(tmp_path: Path) -> None:
    for name, profile in profiles().items():
        own = set() if "eds" in profile else {"motor", "torque_entry"}
        assert {"title", "torque", "identifier", "source"} | own <= set(profile), name
        drive = f"{name}:{next(iter(profile['model']))}" if "model" in profile else name
        lines = read_drives(drive, "1-2", (written(tmp_path),) if "eds" in profile else ()).described()
        assert "the torque is current times" in lines[0]
        assert lines[1].startswith("node 1, 2: ")


def test_the_page_has_the_profiles() -> None:
    page = (ROOT / "docs" / "drives.md").read_text()
    for name, profile in profiles().items():
        motors = ", ".join(profile.get("model", {})) or "–"
        assert f"| `{name}` | {profile['title']} | {profile['identifier']} | {motors} | {profile['torque']} |" in page


def test_nodes_may_count_down() -> None:
    assert read_drives("odrive", "6-4,1").nodes == (6, 5, 4, 1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--drive", "damiao"), "needs the nodes"),
        (("--drive", "damiaoo", "--nodes", "1-7"), 'did you mean "damiao"?'),
        (("--drive", "damiao", "--nodes", "1-9"), "the scale of the frames depends on the motors"),
        (("--drive", "damiao:DM9999", "--nodes", "1-7"), 'no motor "DM9999"'),
        (("--drive", "damiao:DM4310,DM4340", "--nodes", "1-7"), "2 motors for 7 nodes"),
        (("--drive", "damiao", "--nodes", "7-1x"), "not a list of numbers"),
        (("--drive", "damiao", "--nodes", "1-99999999999"), "not a list of numbers"),
        (("--drive", "damiao", "--nodes", "1,1"), "nodes must differ"),
        (("--drive", "damiao:DM4310", "--nodes", "1-99"), "16 is no node"),
        (("--drive", "odrive:S1", "--nodes", "0"), "needs no motors"),
        (("--drive", "odrive", "--nodes", "0-6", "--urdf", URDF), "make the arm file with `zygos import`"),
        (("--drive", "damiao", "--nodes", "1-6", "--urdf", URDF), "the chain of the URDF has 7 joints"),
        (("--drive", "damiao", "--nodes", "1-7", "--map", "map.toml"), "leave out --map"),
        (("--drive", "damiao", "--nodes", "1-7", "--arm", "a.toml", "--urdf", URDF), "both describe the arm"),
        (("--nodes", "1-7"), "belongs to --drive"),
        (("--eds", "drive.eds"), "belongs to --drive"),
        (("--drive", "damiao", "--nodes", "1-7", "--eds", "drive.eds"), "the frames of damiao are known"),
        (("--drive", "cia402", "--nodes", "1-7"), "give it with --eds"),
        (("--drive", "cia402", "--nodes", "1-7", "--eds", "drive.eds"), "no such file"),
        (("--drive", "cia402", "--nodes", "1-3", "--eds", URDF, "--eds", URDF), "2 files for 3 nodes"),
        (("--drive", "cia402", "--nodes", "1-7", "--eds", URDF), "not an EDS or DCF"),
    ],
)
def test_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[Any, ...], said: str) -> None:
    log = tmp_path / "run.log"
    log.write_text("(0.0) can0 011#0000000000000000\n")
    assert run("convert", log, *options, "-o", tmp_path / "out" / "run.npz") == 2
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert not (tmp_path / "out").exists()


def test_convert_from_candump(tmp_path: Path) -> None:
    """Seven motors of one bus in candump's format, classical and FD, become a run and an arm file. It has the noise of
    the torques: four steps, in means of two and a half samples before a gear of ten."""
    times, noise = np.arange(0.0, 4.0, 0.004), np.random.default_rng(0).normal(0.0, 4.0, 1000)
    ranges = (54, 54, 28, 28, 10, 10, 10)
    lines, angles = [], []
    for k, t in enumerate(times):
        for i, high in enumerate(ranges):
            angle = 0.5 * math.sin(1.5 * t + i)
            code = round((angle + 12.5) / 25 * 65535)
            exact = (0.02 * high * math.cos(2 * t) + high) / (2 * high) * 4095
            torque = round(exact + (noise[k] if i == 6 else 0.0))
            data = bytes([i + 1, code >> 8, code & 255, 0x80, torque >> 8, torque & 255, 30, 30])
            fd = "##1" if k % 2 else "#"
            lines.append(f"({t + 1e-4 * i:.6f}) can0 {0x11 + i:03X}{fd}{data.hex().upper()}\n")
        angles.append(0.5 * math.sin(1.5 * t))
    log = tmp_path / "run.log"
    log.write_text("".join(lines))
    out = tmp_path / "a" / "run.npz"
    assert run("convert", log, "--drive", "damiao", "--nodes", "1-7", "--urdf", URDF, "-o", out) in (0, 3)
    columns = read_columns(out, [])
    at = np.asarray(columns["sync"], dtype=float) * 0.01
    expected = 0.5 * np.sin(1.5 * (at + times[0]))
    shift = np.asarray(columns["theta[0]"], dtype=float)
    assert np.abs(shift[20:-20] - expected[20:-20]).max() < 0.02
    torque = np.asarray(columns["tau[0]"], dtype=float)
    assert np.abs(torque).max() == pytest.approx(0.02 * 54 / 9, rel=0.05)
    joints = load_arm(out.parent / "arm.toml").joints
    assert joints[6].name == "joint7"
    step = 20.0 / 4095 / 10.0 / math.sqrt(2.5)
    assert joints[6].torque_sigma == pytest.approx(4.0 * step, rel=0.1)
    assert joints[5].torque_sigma == pytest.approx(step / math.sqrt(12.0), rel=0.1)

# SPDX-License-Identifier: MIT
"""What each format of log keeps, what is refused, and logs as the programs of others write them."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import can
import numpy as np
import pytest
from cli_support import run

from conftest import EXAMPLE
from zygos.arm import Arm
from zygos.can import bus
from zygos.can.wire import BUS_OFF, ERROR, EXTENDED, FD, REMOTE
from zygos.errors import ZygosError
from zygos.native.flight import Flight, encode
from zygos.simulation.plant import Trajectory

DATA = bytes(range(1, 9))
EPOCH = 1_700_000_000.0
"""Recorders stamp with the time of day."""
MESSAGES = {
    "classical": can.Message(EPOCH, 0x123, is_extended_id=False, data=DATA),
    "empty": can.Message(EPOCH, 0x123, is_extended_id=False),
    "extended": can.Message(EPOCH, 0x123, is_extended_id=True, data=DATA[:3]),
    "extended, large": can.Message(EPOCH, 0x1ABCDEF0, is_extended_id=True, data=DATA),
    "remote": can.Message(EPOCH, 0x123, is_extended_id=False, is_remote_frame=True, dlc=4),
    "fd": can.Message(EPOCH, 0x123, is_extended_id=False, is_fd=True, bitrate_switch=True, data=DATA),
    "fd, long": can.Message(EPOCH, 0x123, is_extended_id=False, is_fd=True, data=bytes(range(64))),
    "bus-off": can.Message(EPOCH, BUS_OFF, is_error_frame=True, is_extended_id=False, dlc=8, data=bytes(8)),
}
FLAGS = {
    "extended": EXTENDED,
    "extended, large": EXTENDED,
    "remote": REMOTE,
    "fd": FD,
    "fd, long": FD,
    "bus-off": ERROR,
}


def recorded(path: Path, *messages: can.Message) -> bus.Log:
    recording = bus.LogWriter(path)
    recording.append(messages)
    recording.finish()
    return bus.read_log(path)


@pytest.mark.slow(but=[".log-*", ".blf-*", ".asc-*", ".trc-*", ".mf4-fd, long"])
@pytest.mark.parametrize("what", MESSAGES)
@pytest.mark.parametrize("suffix", bus.LOG_SUFFIXES)
def test_what_a_format_keeps(suffix: str, what: str, tmp_path: Path) -> None:
    """All of a frame that the estimator looks at, but for the class of an error in .log and .asc."""
    path, message = tmp_path / f"run{suffix}", MESSAGES[what]
    if suffix == ".trc" and FLAGS.get(what, 0) & (REMOTE | FD | ERROR):
        with pytest.raises(
            ZygosError, match=r"run\.trc: a \.trc cannot hold an? (FD|remote|error) frame; remedy: .*blf"
        ):
            recorded(path, message)
        assert list(tmp_path.iterdir()) == []
        return
    log = recorded(path, message)
    assert log.damage == ()
    (frame,) = log.frames
    if what == "bus-off" and suffix in (".log", ".asc"):
        assert frame["flags"] & ERROR and not frame["id"] & BUS_OFF
        return
    assert (frame["id"], frame["flags"]) == (message.arbitration_id, FLAGS.get(what, 0))
    content = b"" if message.is_remote_frame else bytes(message.data)
    assert frame["length"] == len(content)
    assert frame["data"].tobytes() == content[:8].ljust(8, b"\0")


@pytest.mark.slow(only=[".mf4"])
@pytest.mark.parametrize("suffix", bus.LOG_SUFFIXES)
def test_channels_are_read_as_one_bus_in_file_order(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    with can.Logger(path) as writer:
        for k in range(20):
            writer(can.Message(EPOCH + k, 0x100 + k, is_extended_id=False, data=DATA, channel=k % 3))
    assert bus.read_log(path).frames["id"].tolist() == list(range(0x100, 0x100 + 20))


def test_a_db_is_refused_with_a_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.db").write_bytes(b"SQLite format 3\0")
    new_log = ("--log", tmp_path / "n.db")
    for arguments in (
        ("estimate", tmp_path / "run.db", "--arm", EXAMPLE / "arm.toml", "-o", tmp_path / "m.toml"),
        ("simulate", EXAMPLE / "scenario.toml", "-o", tmp_path / "new.db"),
        ("listen", "--arm", EXAMPLE / "arm.toml", "-i", "virtual", "-o", tmp_path / "m.toml", *new_log),
    ):
        assert run(*arguments) == 2
        assert "python-can loses frames when it writes a .db; remedy" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run.db"]


def test_mf4_without_asammdf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(ZygosError, match=r"\.mf4 needs asammdf; remedy: .* -m pip install 'zygos\[mf4\]'"):
        bus.check_log_name(tmp_path / "run.mf4")
    bus.check_log_name(tmp_path / "run.blf")


CANDUMP = """\
(1436509052.249713) vcan0 044#2A366C2BBA
(1436509052.449847) vcan0 0F6#7ADFE07BD2
(1436509052.650004) vcan0 12345678#R
(1436509052.850173) vcan0 20000040#0000000000000000
(1436509053.050341) vcan0 213##311223344 R
"""
"""As `candump -L -e` of can-utils writes it; a frame of a controller that is off the bus is the fourth."""
ASC = """\
date Mon Feb 18 11:13:22.123 pm 2013
base dec  timestamps absolute
// version 8.1.0
   0.015991 2  128             Tx   d 8 10 41 02 0 0 0 0 0 Length = 240015 BitCount = 124 ID = 128
Begin Triggerblock Mon Feb 18 11:13:22.123 pm 2013
   0.000000 Start of measurement
   0.017000 CAN 1 Status:chip status error active - TxErr: 132 RxErr: 0
   1.000000 1  Statistic: D 5 R 0 XD 0 XR 0 E 0 O 0 B 0.04%
   2.5010 1  ErrorFrame
   3.098426 1  418119424x      Rx   d 8 1 160 15 166 96 59 208 64
   3.148421 1 J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F DE 80 1F DE 80 1F 00 FE FF
   3.298426 1  384             Rx   r
   4.876870 Log Trigger Event
End TriggerBlock
"""
"""As Vector's programs write it, in decimal numbers, and without the line on internal events."""
TRC = """\
;$FILEVERSION=1.1
;$STARTTIME=43008.920986006946
;
;   Start time: 30.09.2017 22:06:13.191.000
;-------------------------------------------------------------------------------
     1)     17535.4  Tx   00000100 8  00 00 00 00 00 00 00 00
     2)     17540.3  Warng FFFFFFFF 4  00 00 00 08  BUSHEAVY
     3)     17700.3  Tx   0080     1  55
     4)     17873.8  Tx   0003     8  RTR
"""
"""As PEAK's programs write it."""


BUSMASTER = """\
***BUSMASTER Ver 3.2.2***
***PROTOCOL CAN***
***NOTE: PLEASE DO NOT EDIT THIS DOCUMENT***
***[START LOGGING SESSION]***
***START DATE AND TIME 8:8:2014 11:49:7:965***
***HEX***
***SYSTEM MODE***
***START CHANNEL BAUD RATE***
***CHANNEL 1 - Simulation - 500 Kbps***
***END CHANNEL BAUD RATE***
***START DATABASE FILES***
***END OF DATABASE FILES***
***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***
11:49:12:9420 Rx 1 0x012 s 1 40
11:49:12:9440 Tx 1 0x1ABCDEF0 x 8 03 E0 00 00 C0 00 00 00
11:49:12:9441 Rx 1 0x012 sr 4
11:49:12:9442 Rx 1 0x012 s-fd 12 00 01 02 03 04 05 06 07 08 09 0A 0B
11:49:12:9443 Rx 1 0x000 ERR Stuff Error
***END DATE AND TIME 8:8:2014 11:49:39:4***
***[STOP LOGGING SESSION]***
"""
SLCAN = "V1013\nzt1002ab01\nT1ABCDEF03010203EA5F\nr1004\nd1009000102030405060708090A0B\nz\nR000001230\n"
SAVVYCAN = """\
Time Stamp,ID,Extended,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
39747828,000005EB,false,0,8,E8,45,85,4B,4A,28,36,69,
39747829,0x18FEFF32,true,0,0
39747830,000005EB,false,0,9,1,2,3,4,5,6,7,8,9
"""
"""The first of its versions, which has no direction."""
PYTHON_CAN = """\
timestamp,arbitration_id,extended,remote,error,dlc,data
1.5,0x80,0,0,0,1,QA==
1.6,0x80,1,0,0,0,
1.7,0x80,0,1,0,4,
1.8,0x0,1,0,1,8,AAAAAAAAAAA=
"""
SCREEN = [
    (0x123, 0, "1122334455667788"),
    (0x12345678, EXTENDED, "aabb"),
    (0x123, REMOTE, ""),
    (0x123, FD, "112233"),
    (BUS_OFF, EXTENDED | ERROR, "0000000000000000"),
]
SCREENS = {
    "-ta -x -a": """\
 (1795896477.323498)  vcan0  TX - -  123   [8]  11 22 33 44 55 66 77 88   '."3DUfw.'
 (1795896477.416728)  vcan0  TX - -  12345678   [2]  AA BB                     '..'
 (1795896477.444094)  vcan0  TX - -       123   [4]  remote request
 (1795896477.453957)  vcan0  TX B -       123  [03]  11 22 33                  '."3'
 (1795896477.603484)  vcan0  TX - -  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME
""",
    "-ta -ccc": """\
 \033[1m\033[34m(1795896479.023451)  vcan0  123   [8]  11 22 33 44 55 66 77 88\033[0m
 \033[1m\033[34m(1795896479.052969)  vcan0  12345678   [2]  AA BB\033[0m
 \033[1m\033[34m(1795896479.182664)  vcan0       123   [4]  remote request\033[0m
 \033[1m\033[34m(1795896479.211128)  vcan0       123  [03]  11 22 33\033[0m
 \033[1m\033[34m(1795896479.459918)  vcan0  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME\033[0m
""",
    "-td -e -c": """\
 (000.000000)  \033[1m\033[34mvcan0\033[0m  123   [8]  11 22 33 44 55 66 77 88
 (000.278531)  \033[1m\033[34mvcan0\033[0m  12345678   [2]  AA BB
 (000.110113)  \033[1m\033[34mvcan0\033[0m       123   [4]  remote request
 (000.143045)  \033[1m\033[34mvcan0\033[0m       123  [03]  11 22 33
 (000.130895)  \033[1m\033[34mvcan0\033[0m  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME
	bus-off
""",
    "-tA -S": """\
 (2026-11-28 20:08:20.993965)  vcan0  123   [8]  88`77`66`55`44`33`22`11
 (2026-11-28 20:08:21.055187)  vcan0  12345678   [2]  BB`AA
 (2026-11-28 20:08:21.075142)  vcan0       123   [4]  remote request
 (2026-11-28 20:08:21.109502)  vcan0       123  [03]  33`22`11
 (2026-11-28 20:08:21.172565)  vcan0  20000040   [8]  00`00`00`00`00`00`00`00   ERRORFRAME
""",
    "-i": """\
  vcan0  123   [8]  00010001 00100010 00110011 01000100 01010101 01100110 01110111 10001000
  vcan0  12345678   [2]  10101010 10111011
  vcan0       123   [4]  remote request
  vcan0       123  [03]  00010001 00100010 00110011
  vcan0  20000040   [8]  00000000 00000000 00000000 00000000 00000000 00000000 00000000 00000000   ERRORFRAME
""",
}
"""As candump 2020.11 of can-utils wrote five frames on the screen, by its options."""


@pytest.mark.parametrize("suffix", [".log", ".txt", ""])
@pytest.mark.parametrize("options", SCREENS)
def test_the_screen_of_candump(options: str, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_text(SCREENS[options])
    log = bus.read_log(path)
    assert log.damage == ()
    found = [(int(f["id"]), int(f["flags"]), bytes(f["data"][: f["length"]]).hex()) for f in log.frames]
    assert found == SCREEN


def test_a_damaged_line_of_a_dialect(tmp_path: Path) -> None:
    """A byte that is missing, a digit that is none, and a last line without its end."""
    path = tmp_path / "run.log"
    first, second = SCREENS["-ta -x -a"].splitlines(keepends=True)[:2]
    path.write_text(first + first.replace("77 88 ", "77 ")[:-13] + "\n" + second.replace("AA", "AG") + second[:50])
    log = bus.read_log(path)
    assert [int(frame["id"]) for frame in log.frames] == [0x123]
    assert [text.removeprefix(f"{path} ") for text in log.damage] == [
        "has no frame in line 2 nor in 1 line after it",
        "ends in the middle of line 4, which is left out",
    ]


@pytest.mark.parametrize(
    ("suffix", "text", "found"),
    [
        (
            ".log",
            CANDUMP,
            [(0x44, 0), (0xF6, 0), (0x12345678, EXTENDED | REMOTE), (BUS_OFF, EXTENDED | ERROR), (0x213, FD)],
        ),
        (".asc", ASC, [(128, 0), (0, EXTENDED | ERROR), (418119424, EXTENDED), (384, REMOTE)]),
        (".trc", TRC, [(0x100, EXTENDED), (0x80, 0), (3, REMOTE)]),
        (".log", BUSMASTER, [(0x12, 0), (0x1ABCDEF0, EXTENDED), (0x12, REMOTE), (0x12, FD), (0, EXTENDED | ERROR)]),
        (".log", SLCAN, [(0x100, 0), (0x1ABCDEF0, EXTENDED), (0x100, REMOTE), (0x100, FD), (0x123, EXTENDED | REMOTE)]),
        (".csv", SAVVYCAN, [(0x5EB, 0), (0x18FEFF32, EXTENDED), (0x5EB, FD)]),
        (".csv", PYTHON_CAN, [(0x80, 0), (0x80, EXTENDED), (0x80, REMOTE), (0, EXTENDED | ERROR)]),
    ],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_logs_of_others(suffix: str, text: str, found: list[tuple[int, int]], end: str, tmp_path: Path) -> None:
    """Each frame comes, nothing else is taken for one, and what is no frame is no damage."""
    path = tmp_path / f"run{suffix}"
    path.write_bytes(text.replace("\n", end).encode())
    log = bus.read_log(path)
    assert log.damage == ()
    assert [(int(frame["id"]), int(frame["flags"])) for frame in log.frames] == found


def test_a_comment_that_is_no_utf8(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    """Vector's programs write in the machine's own code page."""
    frames = encode(arm, noisy.cycles(0))[:100]
    path = tmp_path / "run.asc"
    bus.write_log(path, frames, arm.period_s)
    path.write_bytes("// Prüfstand Süd, März\n".encode("latin-1") + path.read_bytes())
    log = bus.read_log(path)
    assert log.damage == ()
    assert log.frames.tobytes() == frames.tobytes()


@pytest.mark.slow
def test_bus_off_in_a_candump_log_ends_the_arc(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    bus.write_log(path, encode(arm, noisy.cycles(0))[:4000], arm.period_s)
    lines = path.read_text().splitlines(keepends=True)
    arcs = []
    for error in ("", "(1.0) can0 20000040#0000000000000000\n", "(1.0) can0 20000004#0004000000000000\n"):
        path.write_text("".join([*lines[:2000], error, *lines[2000:]]))
        flight = Flight(arm)
        flight.frames(bus.read_log(path).frames)
        assert flight.faults["bus_error"] == bool(error)
        arcs.append(flight.estimate().arcs)
    assert arcs == [1, 2, 1]


def test_reading_leaves_logging_as_it_was(arm: Arm, noisy: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "run.trc"
    bus.write_log(path, encode(arm, noisy.cycles(0))[:50], arm.period_s)
    before = logging.root.manager.disable
    bus.read_log(path)
    assert logging.root.manager.disable == before


def test_a_log_of_error_frames_is_no_log_of_data(tmp_path: Path) -> None:
    """Written again, an error frame stays one: as a data frame it would be a SYNC."""
    path = tmp_path / "run.blf"
    log = recorded(path, can.Message(EPOCH, 0x80, is_error_frame=True, is_extended_id=False, dlc=8, data=bytes(8)))
    bus.write_log(path, log.frames, 0.05)
    np.testing.assert_array_equal(bus.read_log(path).frames, log.frames)

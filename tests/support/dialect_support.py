# SPDX-License-Identifier: MIT
"""Frames as the programs of others write them, each with the kinds of time stamps that it has.

The writers follow candump.c and lib.c of can-utils, the samples in BUSMASTER's repository, the manual of the CAN232,
saveNativeCSVFile() of SavvyCAN, the test data of python-can for Vector's .asc, and PEAK's description of .trc. They
share no code with the readers.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
from numpy.typing import NDArray

DAY_S = 86400.0
EPOCH_S = 1_700_000_000.0

STAMPS: dict[str, Callable[[Sequence[float]], list[float]]] = {
    "from zero": lambda times: [t - times[0] for t in times],
    "absolute": lambda times: [EPOCH_S + t for t in times],
    "negative": lambda times: [t - times[0] - 2.0 for t in times],
    "relative": lambda times: [0.0, *(b - a for a, b in pairwise(times))],
    "over midnight": lambda times: [(DAY_S - 1.0 + t) % DAY_S for t in times],
    "date": lambda times: [EPOCH_S + t for t in times],
    "none": lambda times: [0.0 for _ in times],
}
"""What is written for frames that came at these times, s."""


@dataclass(frozen=True)
class Sent:
    """What a writer is given of a frame."""

    identifier: int
    data: bytes
    stamp_s: float
    received: bool
    fd: bool

    @property
    def direction(self) -> str:
        return "Rx" if self.received else "Tx"

    @property
    def spaced(self) -> str:
        return self.data.hex(" ").upper()


Writer = Callable[[Sequence[Sent], str], Iterator[str]]


def candump(frames: Sequence[Sent], _: str) -> Iterator[str]:
    for f in frames:
        mark = "##0" if f.fd else "#"
        yield f"({f.stamp_s:.6f}) can0 {f.identifier:03X}{mark}{f.data.hex().upper()} {f.direction[0]}\n"


def screen(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    for f in frames:
        date = datetime.fromtimestamp(f.stamp_s, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")
        stamp = {"none": "", "date": f"({date}) "}.get(kind, f"({f.stamp_s:010.6f}) ")
        length = f"[{len(f.data):02d}]" if f.fd else f" [{len(f.data)}]"
        yield f" {stamp} can0  {f.direction.upper()} - -  {f.identifier:03X}  {length}  {f.spaced}\n"


def screen_ascii(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    for line, f in zip(screen(frames, kind), frames, strict=True):
        text = "".join(chr(b) if 32 <= b < 127 else "." for b in f.data)
        yield f"{line.rstrip():<80}'{text}'\n".replace(f" {f.direction.upper()} - - ", "")


def busmaster(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    mode = {"relative": "RELATIVE", "over midnight": "SYSTEM"}.get(kind, "ABSOLUTE")
    yield "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***[START LOGGING SESSION]***\n"
    yield f"***START DATE AND TIME 5:10:2026 16:34:30:698***\n***HEX***\n***{mode} MODE***\n"
    yield "***START CHANNEL BAUD RATE***\n***CHANNEL 1 - Simulation - 500 Kbps***\n***END CHANNEL BAUD RATE***\n"
    yield "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n"
    for f in frames:
        units = round(f.stamp_s * 1e4)
        clock = f"{units // 36_000_000:02d}:{units // 600_000 % 60:02d}:{units // 10_000 % 60:02d}:{units % 10_000:04d}"
        yield f"{clock} {f.direction} 1 0x{f.identifier:03X} s{'-fd' if f.fd else ''} {len(f.data)} {f.spaced} \n"
    yield "***END DATE AND TIME 5:10:2026 16:35:30:698***\n***[STOP LOGGING SESSION]***\n"


def busmaster_decimal(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    for line in "".join(busmaster(frames, kind)).splitlines(keepends=True):
        words = line.split()
        if line.startswith("***"):
            yield line.replace("HEX", "DEC")
        else:
            content = " ".join(f"{int(word, 16):03d}" for word in words[6:])
            yield f"{' '.join(words[:3])} {int(words[3], 16):04d} {' '.join(words[4:6])} {content}\n"


def slcan(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    yield "\rz\r"
    for f in frames:
        stamp = "" if kind == "none" else f"{round(1e3 * f.stamp_s) % 60_000:04X}"
        yield f"{'d' if f.fd else 't'}{f.identifier:03X}{len(f.data)}{f.data.hex().upper()}{stamp}\r"


def savvycan(frames: Sequence[Sent], _: str) -> Iterator[str]:
    yield "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    for f in frames:
        content = "".join(f"{byte:02X}," for byte in f.data.ljust(8, b"\0"))
        yield f"{round(1e6 * f.stamp_s)},{f.identifier:08X},false,{f.direction},0,{len(f.data)},{content}\n"


def python_can(frames: Sequence[Sent], _: str) -> Iterator[str]:
    yield "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
    for f in frames:
        yield f"{f.stamp_s:.6f},0x{f.identifier:x},0,0,0,{len(f.data)},{b64encode(f.data).decode()}\n"


def _asc(kind: str) -> str:
    mode = "relative" if kind == "relative" else "absolute"
    return f"date Fr Mär 01 10:11:12.345 2024\nbase hex  timestamps {mode}\ninternal events logged\n// version 11.0.0\n"


def asc(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    yield _asc(kind) + f"Begin Triggerblock Fr Mär 01 10:11:12.345 2024\n {frames[0].stamp_s:.6f} Start der Messung\n"
    for k, f in enumerate(frames):
        yield f" {f.stamp_s:.6f} 1  {f.identifier:X}             {f.direction}   d {len(f.data)} {f.spaced}\n"
        if k % 20 == 0:
            at = "0.000000" if kind == "relative" else f"{f.stamp_s:.6f}"
            yield f" {at} 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n"
    yield "End TriggerBlock\n"


def asc_canfd(frames: Sequence[Sent], kind: str) -> Iterator[str]:
    """All frames in CANFD lines, as from a channel that can FD; some with a name."""
    yield _asc(kind)
    for k, f in enumerate(frames):
        flags = 0x201000 if f.fd else 0x200000
        name = "Name_1" if k % 3 else ""
        yield (
            f" {f.stamp_s:.6f} CANFD   1 {f.direction} {f.identifier:10x}  {name:<32} 0 0 {len(f.data):x} "
            f"{len(f.data):2d} {f.spaced}   130000  130   {flags:x} e0006659 46500250 4b140250 20011736 2001040d\n"
        )


def trc_1_1(frames: Sequence[Sent], _: str) -> Iterator[str]:
    yield ";$FILEVERSION=1.1\n;$STARTTIME=43008.920986006946\n;\n"
    for k, f in enumerate(frames, start=1):
        yield f"{k:6d})  {1e3 * f.stamp_s:10.3f}  {f.direction}         {f.identifier:04X} {len(f.data)}  {f.spaced}\n"


def trc_2_1(frames: Sequence[Sent], _: str) -> Iterator[str]:
    yield ";$FILEVERSION=2.1\n;$STARTTIME=43008.920986006946\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n"
    for k, f in enumerate(frames, start=1):
        kind = "FD" if f.fd else "DT"
        at = f"{k:7d} {1e3 * f.stamp_s:13.3f} {kind} 1      {f.identifier:04X} {f.direction} -"
        yield f"{at}  {len(f.data):2d}    {f.spaced}\n"


def blf(path: Path, frames: Sequence[Sent]) -> None:
    with can.BLFWriter(path) as writer:
        for f in frames:
            writer.on_message_received(
                can.Message(f.stamp_s, f.identifier, False, data=f.data, is_rx=f.received, is_fd=f.fd, channel=0)
            )


@dataclass(frozen=True)
class Format:
    """A format, and what it can hold."""

    suffix: str
    writer: Writer
    stamps: tuple[str, ...]
    step_s: float = 1e-6
    """Of its stamps."""
    fd: bool = True
    directions: bool = True


FORMATS = {
    "candump -L": Format(".log", candump, ("from zero", "absolute")),
    "candump -x": Format(".log", screen, ("from zero", "absolute", "relative", "date", "none")),
    "candump -a": Format(".log", screen_ascii, ("from zero", "absolute", "relative", "none"), directions=False),
    "BUSMASTER": Format(".log", busmaster, ("from zero", "relative", "over midnight"), 1e-4),
    "BUSMASTER, decimal": Format(".log", busmaster_decimal, ("from zero", "relative", "over midnight"), 1e-4),
    "slcan": Format(".log", slcan, ("from zero", "none"), 1e-3, directions=False),
    "SavvyCAN": Format(".csv", savvycan, ("from zero", "absolute", "negative"), fd=False),
    "python-can": Format(".csv", python_can, ("from zero", "absolute", "negative"), fd=False, directions=False),
    "asc": Format(".asc", asc, ("from zero", "absolute", "negative", "relative", "over midnight"), fd=False),
    "asc, CANFD lines": Format(".asc", asc_canfd, ("from zero", "absolute", "negative", "relative", "over midnight")),
    "trc 1.1": Format(".trc", trc_1_1, ("from zero", "negative"), fd=False),
    "trc 2.1": Format(".trc", trc_2_1, ("from zero", "negative")),
    "blf": Format(".blf", asc, ("from zero", "absolute")),
}


def write_dialect(
    folder: Path,
    name: str,
    frames: NDArray[Any],
    times: Sequence[float],
    *,
    stamps: str,
    tx: bool = False,
    fd: bool = False,
) -> Path:
    """Write `FRAME` records (n,) that came at times (n,), s."""
    kind = FORMATS[name]
    written = STAMPS[stamps](times)
    sent = [
        Sent(int(f["id"]), bytes(f["data"][: f["length"]]), stamp, not tx, fd)
        for f, stamp in zip(frames, written, strict=True)
    ]
    path = folder / f"run{kind.suffix}"
    if kind.suffix == ".blf":
        blf(path, sent)
    else:
        path.write_bytes("".join(kind.writer(sent, stamps)).encode("latin-1"))
    return path

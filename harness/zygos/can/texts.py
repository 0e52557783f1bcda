# SPDX-License-Identifier: MIT
"""CAN logs in text: python-can decodes each line, after dialects that it does not know were translated for it."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any

import can

from zygos.files.inputs import encoding as text_encoding
from zygos.files.inputs import kind, local
from zygos.files.output import counted

NO_IDENTIFIER = 1 << 29
"""The smallest number that is too large for a CAN identifier."""
_CANDUMP_ERROR = re.compile(r"\s*\S+\s+\S+\s+([23][0-9a-f]{7})#", re.IGNORECASE)
"""candump marks error frames by bit 29 of the identifier; python-can's reader recognises only one class of them."""
_DAY_S = 86400.0
_SLCAN_WRAP_S = 60.0
"""The stamps of slcan start again after that time."""
_EXAMINED = 1000
"""Number of lines of candump's screen output from which the kind of its stamps is found."""
_FALLS = 0.1
"""Share of stamps below the one before from which on candump's stamps are differences."""


class _Clock:
    """The times of a log from the stamps of its lines."""

    def __init__(self) -> None:
        self.relative = False
        """Whether a stamp is the time since the one before."""
        self.wrap_s = _DAY_S
        """Time after which stamps start again: those of the time of day at midnight."""
        self._time_s: float | None = None

    def at(self, stamp_s: float) -> float:
        """The time of the next stamp, s."""
        last = self._time_s
        if self.relative:
            self._time_s = (last or 0.0) + stamp_s
        else:
            # a small step back is a frame that was written late
            turns = 0 if last is None else max(0, round((last - stamp_s) / self.wrap_s))
            self._time_s = stamp_s + turns * self.wrap_s
        return self._time_s


Translated = tuple[str, float | None]
"""A line for python-can's reader, and its time in s where that is not the one that the reader finds."""


class _Plain:
    """Lines that python-can's reader understands as they are."""

    silent = re.compile(r"\s*$")
    """Pattern of intact lines that hold no frame."""

    def __init__(self, head: list[str]) -> None:
        """head: the first lines of the log."""
        self.clock = _Clock()

    def translate(self, line: str) -> Translated:
        """The line for the reader."""
        return line, None

    def repair(self, message: can.Message, line: str) -> None:
        """Correct what the reader made of a line."""


class _Candump(_Plain):
    """A line of `candump -L`, as which other dialects are translated."""

    def repair(self, message: can.Message, line: str) -> None:
        """Mark error frames as such, and keep what they report."""
        error = _CANDUMP_ERROR.match(line)
        if error:
            message.is_error_frame = True
            message.arbitration_id = int(error[1], 16) % NO_IDENTIFIER

    def _line(self, channel: str, identifier: str, data: str, received: bool = True) -> str:
        return f"(0.0) {channel} {identifier}#{data} {'R' if received else 'T'}\n"


class _Screen(_Candump):
    """What candump writes on the screen: candump.c and lib.c of can-utils."""

    # -e explains an error frame in lines of their own
    silent = re.compile(r"\s*$|\t|DROPCOUNT:")
    _FRAME = re.compile(
        r"\s*(?:\((?P<stamp>[-\d:. ]*\d)\)\s+)?(?P<channel>\S+)\s+(?:(?P<direction>[RT]X) [B-] [E-]\s+)?"
        r"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})\s+(?:\[(?P<length>\d\d?)\]|\{[9A-F]\})\s*(?P<data>.*)"
    )
    _COLOUR = re.compile(r"\x1b\[\d*m")

    def __init__(self, head: list[str]) -> None:
        super().__init__(head)
        found = [match["stamp"] for line in head if (match := self._FRAME.match(self._COLOUR.sub("", line)))]
        times = [self._seconds(stamp) for stamp in found if stamp and ":" not in stamp]
        falls = sum(later < earlier for earlier, later in pairwise(times))
        # -t d and -t z look alike, but the differences fall as often as they rise, or do not rise at all
        self.clock.relative = falls > _FALLS * len(times) or (len(times) > 2 and times[-1] <= times[1])

    @staticmethod
    def _seconds(stamp: str) -> float:
        """A stamp in s; -t A writes the date in the zone of the computer, whose distance from UTC has no influence."""
        return datetime.fromisoformat(stamp).replace(tzinfo=UTC).timestamp() if ":" in stamp else float(stamp)

    def translate(self, line: str) -> Translated:
        frame = self._FRAME.match(self._COLOUR.sub("", line))
        if frame is None:
            return line, None
        text = frame["length"]
        length = 8 if text is None else int(text)  # in braces stands a DLC above 8
        fd = "#0" if text is not None and len(text) == 2 else ""
        if frame["data"].startswith("remote request"):
            data = f"R{length}"
        else:
            # -S swaps the bytes and writes ` between them, and -i writes each in binary
            swapped = re.match(r"\w+`", frame["data"]) is not None
            words = re.split(r"`|\s+" if swapped else r"\s+", frame["data"], maxsplit=length)[:length]
            if len(words) < length:
                return line, None
            content = [int(word, 2 if len(word) == 8 else 16) for word in words]
            data = fd + bytes(content[::-1] if swapped else content).hex()
        stamp = frame["stamp"]
        time_s = float("nan") if stamp is None else self.clock.at(self._seconds(stamp))
        return self._line(frame["channel"], frame["id"], data, frame["direction"] != "TX"), time_s


class _BusMaster(_Candump):
    """A log of BUSMASTER: the samples in its repository, and wiretap/busmaster_parser.lemon of Wireshark."""

    silent = re.compile(r"\s*$|\*\*\*")
    _FRAME = re.compile(
        r"(\d+):(\d+):(\d+):(\d+)\s+([RT])x\s+(\d+)\s+(?:0x)?([0-9A-F]+)\s+(?:(s|x)(r|-fd)?\s+(\d+)\s*(.*)|ERR.*)",
        re.IGNORECASE,
    )

    def __init__(self, head: list[str]) -> None:
        super().__init__(head)
        self._base = 16

    def translate(self, line: str) -> Translated:
        if line.startswith("***"):
            mode = line.strip("*\r\n ").upper()
            if mode in ("HEX", "DEC"):
                self._base = 16 if mode == "HEX" else 10
            elif mode.endswith(" MODE"):
                self.clock.relative = mode.startswith("RELATIVE")
            return line, None
        frame = self._FRAME.match(line)
        if frame is None:
            return line, None
        hours, minutes, seconds, fraction = frame.groups()[:4]
        # four digits are units of 100 us; programs that imitate the format write three, of milliseconds
        rest_s = int(fraction) / 10 ** len(fraction)
        direction, channel, identifier, width, form, length, content = frame.groups()[4:]
        if width is None:
            text, data = "20000000", bytes(8).hex()
        else:
            number = int(identifier, self._base)
            text = f"{number:08X}" if width.lower() == "x" else f"{number:03X}"
            words = content.split()
            if form and form.lower() == "r":
                data = f"R{length}"
            else:
                if len(words) != int(length) and not form:
                    return line, None
                data = ("#0" if form else "") + bytes(int(word, self._base) for word in words).hex()
        time_s = self.clock.at(3600 * int(hours) + 60 * int(minutes) + int(seconds) + rest_s)
        return self._line(channel, text, data, direction.upper() == "R"), time_s


class _Slcan(_Candump):
    """The lines of an adapter that speaks slcan: the manual of the CAN232 by LAWICEL, and python-can's interface."""

    silent = re.compile(r"[\azZ]*$|[CFLMNOQSVWXYsmv][0-9A-Fa-f]*$")
    _FRAME = re.compile(r"(?:([trdb])([0-7][0-9A-F]{2})|([TRDB])([01][0-9A-F]{7}))([0-9A-F])([0-9A-F]*)\s*$")
    _LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)

    def __init__(self, head: list[str]) -> None:
        super().__init__(head)
        self.clock.wrap_s = _SLCAN_WRAP_S

    def translate(self, line: str) -> Translated:
        # the letter of the kind has a case, the digits have none
        answered = line.lstrip("\azZ")
        frame = self._FRAME.match(answered[:1] + answered[1:].upper())
        if frame is None:
            return line, None
        letter, identifier = frame[1] or frame[3], frame[2] or frame[4]
        dlc, content = int(frame[5], 16), frame[6]
        if letter.lower() == "r":
            data, end = f"R{dlc}", 0
        else:
            end = 2 * self._LENGTHS[dlc if letter in "dDbB" else min(dlc, 8)]
            data = ("#0" if letter in "dDbB" else "") + content[:end]
        stamp = content[end:]
        if len(content) < end or len(stamp) not in (0, 4):
            return line, None
        time_s = self.clock.at(int(stamp, 16) / 1000.0) if stamp else float("nan")
        return self._line("slcan0", identifier, data), time_s


class _SavvyCan(_Candump):
    """The CSV of SavvyCAN and of GVRET adapters: loadNativeCSVFile() in framefileio.cpp of SavvyCAN."""

    silent = re.compile(r"\s*$|Time Stamp,", re.IGNORECASE)

    def __init__(self, head: list[str]) -> None:
        super().__init__(head)
        names = [name.strip().lower() for name in head[0].split(",")]
        self._at = {name: names.index(name) for name in ("time stamp", "id", "extended", "bus", "len")}
        self._direction = names.index("dir") if "dir" in names else None

    def translate(self, line: str) -> Translated:
        words = [word.strip() for word in line.split(",")]
        if len(words) <= max(self._at.values()):
            return line, None
        stamp, identifier, extended, bus, length = (words[place] for place in self._at.values())
        begin = self._at["len"] + 1
        content = [int(word, 16) for word in words[begin : begin + int(length)]]
        number = int(identifier, 16)
        if len(content) != int(length):
            return line, None
        time_s = self.clock.at(int(stamp) * 1e-6)
        received = self._direction is None or not words[self._direction].lower().startswith("t")
        text = f"{number:08X}" if extended.lower() == "true" else f"{number:03X}"
        data = ("#0" if len(content) > 8 else "") + bytes(content).hex()
        return self._line(bus, text, data, received), time_s


class _PythonCan(_Candump):
    """The CSV of python-can, whose reader is not used: it passes over a line after each one that it cannot read."""

    silent = re.compile(r"\s*$|timestamp,")

    def translate(self, line: str) -> Translated:
        words = line.strip().split(",")
        if len(words) != 7 or words[0] == "timestamp":
            return line, None
        stamp, identifier, extended, remote, error, dlc, content = words
        number = int(identifier, 16) + NO_IDENTIFIER * int(error)
        data = f"R{int(dlc)}" if remote == "1" else base64.b64decode(content).hex()
        return self._line("can0", f"{number:08X}" if extended == "1" or number >> 11 else f"{number:03X}", data), float(
            stamp
        )


class _Asc(_Plain):
    """Lines of Vector's programs."""

    # Many kinds of events begin with a time stamp. A line that looks like a frame has to be one.
    silent = re.compile(
        r"\s*($|//|(date|base|((no\s+)?internal)|previous|begin|end)\b"
        r"|\d+\.\d+\s+(.*J1939|(?!CANFD\s)(?!\d+\s+[0-9a-f]+x?\s)(?!.*\s[RT]x\s+[dr]\s)))",
        re.IGNORECASE,
    )
    _STAMP = re.compile(r"\s*([+-]?\d+\.\d+)(?=\s)")
    _BASE = re.compile(r"\s*base\s+\w+\s+timestamps\s+(\w+)", re.IGNORECASE)
    _REMOTE, _FD = 0x10, 0x1000
    """Flags of the frames in CANFD lines, as in a .blf."""

    def translate(self, line: str) -> Translated:
        base = self._BASE.match(line)
        if base:
            self.clock.relative = base[1].lower() == "relative"
        stamp = self._STAMP.match(line)
        if stamp is None:
            return line, None
        # python-can reads relative stamps as absolute ones, and passes over lines with a negative stamp
        return "0.0" + line[stamp.end() :], self.clock.at(float(stamp[1]))

    def repair(self, message: can.Message, line: str) -> None:
        """python-can takes every frame in a CANFD line for one of CAN FD; the flags say which are."""
        words = line.split()
        if not message.is_fd or message.is_error_frame:
            return
        begin = 5 if words[5].isdigit() else 6  # where the frame has a name
        try:
            length = int(words[begin + 3])
            flags = int(words[begin + 4 + length + 2], 16)
        except (IndexError, ValueError):
            return
        if not flags & self._FD and length <= 8:
            message.is_fd = False
            message.is_remote_frame = bool(flags & self._REMOTE)


class _Trc(_Plain):
    """Lines of PEAK's programs."""

    silent = re.compile(r"\s*($|;|.*\s(ST|EC|ER|EV|Warng|Error)\s)")


_READERS: dict[str, tuple[Any, type[_Plain]]] = {
    ".asc": (can.ASCReader, _Asc),
    ".trc": (can.TRCReader, _Trc),
}
"""Reader of python-can and translator of the other texts than .log."""
_DIALECTS: dict[str, type[_Plain]] = {
    "candump on the screen": _Screen,
    "BUSMASTER": _BusMaster,
    "slcan": _Slcan,
    "SavvyCAN": _SavvyCan,
    "python-can": _PythonCan,
}
"""Translators of the dialects of .log."""


class _Lines:
    """The lines of a text log as a file object, from which a reader of python-can reads."""

    def __init__(self, stream: Iterator[str], dialect: _Plain) -> None:
        self._stream = stream
        self._dialect = dialect
        self._offered = 0
        """How often the reader got the current line without returning a frame for it; 0: the line is finished."""
        self.line = ""
        """The line as it stands in the log, or its translation."""
        self.time_s: float | None = None
        """Time of the line, s, where the reader does not find it."""
        self.number = 0
        self.bad: list[int] = []
        """Numbers of the lines that should hold a frame but do not."""
        self.cut = False
        """Whether the last line lacks its line end."""
        self.begun = False
        """Whether a Begin TriggerBlock of an .asc file has no End TriggerBlock yet."""
        self.over = False

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        """The next line, translated. A line that gave no frame is given twice, because the .asc reader skips the one
        after a header."""
        if self._offered == 2:
            self.refuse()
        if self._offered:
            self._offered += 1
            return self.line
        self._advance()
        while "\0" in self.line:  # a disk returns zeros for a lost sector, which joins the lines on both sides
            self.bad.append(self.number)
            self._advance()
        whole = self.line.endswith("\n")
        try:
            self.line, self.time_s = self._dialect.translate(self.line)
        except ValueError:  # of a number that is none
            self.time_s = None
        silent = self._dialect.silent.match(self.line) is not None
        self.cut = not whole and not silent
        self.over = not self.line or self.cut
        if self.over:
            raise StopIteration
        self._offered = 0 if silent else 1
        words = self.line.lower().split(maxsplit=2)
        if words[1:2] == ["triggerblock"]:
            self.begun = words[0] == "begin"
        return self.line

    def _advance(self) -> None:
        self.line = next(self._stream, "")
        self.number += 1

    def answer(self) -> None:
        """Record that the line gave a frame."""
        self._offered = 0

    def refuse(self) -> None:
        """Record that the line gave no frame, which it should unless it is silent."""
        if self._offered and not self.over:
            self.bad.append(self.number)
        self._offered = 0

    def close(self) -> None:
        """Do nothing; readers of python-can close their file."""


def text_messages(path: Path, damage: list[str]) -> Iterator[can.Message]:
    """Read line by line. After a line that it cannot read, the reader continues with the next and keeps the header."""
    found = kind(path)
    reader_of, dialect_of = _READERS.get(found.suffix, (can.CanutilsLogReader, _DIALECTS.get(found.dialect, _Candump)))
    with local(path).open(encoding=text_encoding(path), errors="replace") as stream:
        head = list(islice(stream, _EXAMINED))
        dialect = dialect_of(head)
        lines = _Lines(chain(head, stream), dialect)
        reader = reader_of(lines)
        while not lines.over:
            try:
                for message in reader:
                    if not 0 <= message.arbitration_id < NO_IDENTIFIER:
                        lines.refuse()
                        continue
                    lines.answer()
                    dialect.repair(message, lines.line)
                    if lines.time_s is not None:
                        message.timestamp = lines.time_s
                    yield message
            except Exception:  # each reader raises different errors
                lines.refuse()
    if lines.bad:
        others = f" nor in {counted(len(lines.bad) - 1, 'line')} after it" if len(lines.bad) > 1 else ""
        damage.append(f"has no frame in line {lines.bad[0]:,}{others}")
    if lines.cut:
        damage.append(f"ends in the middle of line {lines.number:,}, which is left out")
    elif lines.begun:
        damage.append("ends without its end mark, End TriggerBlock")

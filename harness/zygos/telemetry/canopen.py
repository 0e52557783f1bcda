# SPDX-License-Identifier: MIT
"""The EDS or DCF of a CiA 402 drive: which of its process data hold angle and torque, and the scales of both.

The files are those of CiA 306, the parameters of process data those of CiA 301: 0x1800 and following hold their
identifiers, 0x1A00 and following their content. Of CiA 402 are the objects of the drive itself.
"""

from __future__ import annotations

import configparser
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

from cantools.database.can import Message, Signal

from zygos.errors import ZygosError
from zygos.files.inputs import check_file, local
from zygos.telemetry.dictionary import Dictionary
from zygos.telemetry.drives import Drives

POSITION, TORQUE, SECOND_POSITION = (0x6064, 0), (0x6077, 0), (0x60E4, 1)
"""Objects that are read: position, torque as per mille of the rated one, position of a second encoder."""
_RATED_TORQUE, _RESOLUTION, _GEAR, _FEED, _SECOND_FEED = 0x6076, 0x608F, 0x6091, 0x6092, (0x60E9, 0x60EE)
_NAMES = {POSITION: "Position", TORQUE: "Torque", SECOND_POSITION: "SecondPosition"}
_COUNT = 512
"""Process data objects that a device may send."""
_PREDEFINED = 4
"""Those whose identifier follows from the node where none is written."""
_INVALID, _EXTENDED = 1 << 31, 1 << 29
"""Bits of an identifier: the object is not sent; it has 29 bits."""
_LONGEST = 64
"""Bytes of a CAN FD frame."""


@dataclass(frozen=True)
class Device:
    """A drive as its EDS or DCF describes it."""

    path: Path
    sections: configparser.RawConfigParser

    @classmethod
    def load(cls, path: Path) -> Device:
        """Read a file. Errors: ZygosError where it is missing, or is no EDS or DCF."""
        check_file(path, "give the EDS or DCF of the drive")
        parser = configparser.RawConfigParser(strict=False, comment_prefixes=(";", "#"), delimiters=("=",))
        try:
            parser.read_string(local(path).read_text(encoding="cp1252", errors="replace"))
        except configparser.Error as error:
            first = str(error).splitlines()[0]
            raise ZygosError(f"{path}: not an EDS or DCF ({first}); remedy: give that of the drive") from error
        for name in parser.sections():
            if name.lower() != name and not parser.has_section(name.lower()):
                parser[name.lower()] = parser[name]
        if not any(parser.has_section(name) for name in ("fileinfo", "deviceinfo")):
            raise ZygosError(f"{path}: not an EDS or DCF (no [FileInfo]); remedy: give that of the drive")
        return cls(path, parser)

    def value(self, index: int, sub: int = 0, node: int = 0) -> int | None:
        """The value of an object: as a DCF configures it, or as it is by default; None where none is written.

        Errors: ZygosError for a text that is no number.
        """
        for name in (f"{index:x}sub{sub:x}", *([f"{index:x}"] if sub == 0 else [])):
            for key in ("parametervalue", "defaultvalue"):
                text = self.sections.get(name, key, fallback="").partition(";")[0].strip()
                if text:
                    return self._number(text, name, key, node)
        return None

    def _number(self, text: str, name: str, key: str, node: int) -> int:
        total = 0
        for part in text.split("+"):
            one = part.strip().lower()
            try:
                total += node if one == "$nodeid" else int(one, 16 if one.startswith("0x") else 10)
            except ValueError:
                raise ZygosError(
                    f'{self.path}: [{name}] {key}: "{text}" is no number; remedy: write for instance 0x60640020'
                ) from None
        return total

    def ratio(self, index: int, below: int | None = None) -> Fraction | None:
        """Sub-index 1 of an object over its sub-index 2, or over sub-index 1 of another; None where one is not written,
        or zero."""
        over = self.value(index, 1)
        under = self.value(index, 2) if below is None else self.value(below, 1)
        return Fraction(over, under) if over and under else None

    def messages(self, node: int) -> list[Message]:
        """What a node sends of the objects that are read. Errors: ZygosError for content that no frame holds."""
        out: list[Message] = []
        for k in range(_COUNT):
            count = self.value(0x1A00 + k, 0)
            if not count:
                continue
            usual = 0x180 + 0x100 * k + node if k < _PREDEFINED else _INVALID
            cob = self.value(0x1800 + k, 1, node)
            cob = usual if cob is None else cob
            if cob & _INVALID:
                continue
            signals, at = [], 0
            for sub in range(1, count + 1):
                entry = self.value(0x1A00 + k, sub) or 0
                name = _NAMES.get((entry >> 16, entry >> 8 & 0xFF))
                length = entry & 0xFF
                if name is not None and length:
                    signals.append(Signal(name, at, length, is_signed=True))
                at += length
            if at > 8 * _LONGEST:
                raise ZygosError(
                    f"{self.path}: [{0x1A00 + k:X}] maps {at} bits, which no frame holds; remedy: correct the mapping"
                )
            if signals:
                extended = bool(cob & _EXTENDED)
                identifier = cob & (0x1FFFFFFF if extended else 0x7FF)
                name = f"TPDO{k + 1}_node{node}"
                out.append(Message(identifier, name, (at + 7) // 8, signals, is_extended_frame=extended))
        return out

    def torque_mnm(self) -> float:
        """Torque of one step, mNm. Errors: ZygosError where the file does not say it."""
        rated = self.value(_RATED_TORQUE)
        if not rated:
            raise ZygosError(
                f"{self.path}: the rated torque (0x6076, mNm), of which the torque is a share, has no value; remedy: "
                "read it from the drive, and write it into the file: ParameterValue in [6076]"
            )
        return rated / 1000.0

    def angle(self, second: bool = False) -> tuple[float, bool]:
        """Turns of one step, and whether it is the shaft behind the gear that turns. second: of the second encoder.

        Errors: ZygosError where the file does not say it.
        """
        if second:
            feed = self.ratio(*_SECOND_FEED)
            if feed is None:
                raise ZygosError(
                    f"{self.path}: the steps of the second encoder in a turn (0x60E9 over 0x60EE) have no value; "
                    "remedy: write both into the file: ParameterValue in [60E9sub1] and [60EEsub1]"
                )
            return float(1 / feed), True
        feed = self.ratio(_FEED)
        if feed is not None:
            return float(1 / feed), (self.ratio(_GEAR) or 1) != 1
        steps = self.ratio(_RESOLUTION)
        if steps is None:
            raise ZygosError(
                f"{self.path}: the steps of the position in a turn (0x6092, or 0x608F for increments) have no value; "
                "remedy: read them from the drive, and write them into the file: ParameterValue in [6092sub1] and "
                "[6092sub2]"
            )
        return float(1 / steps), False


@dataclass(frozen=True)
class CanopenDrives(Drives):
    """Drives whose frames are those that their files describe."""

    devices: tuple[Device, ...] = ()
    """One for each node."""

    @cached_property
    def _sent(self) -> tuple[list[Message], ...]:
        return tuple(device.messages(node) for device, node in zip(self.devices, self.nodes, strict=True))

    def entry(self, index: int, kind: str) -> dict[str, Any]:
        """As `Drives.entry`. Errors: ZygosError where no process data have the object."""
        device, node = self.devices[index], self.nodes[index]
        wanted = {"motor": POSITION, "torque": TORQUE, "link": SECOND_POSITION}[kind]
        for message in self._sent[index]:
            if any(signal.name == _NAMES[wanted] for signal in message.signals):
                source = f"{message.name}.{_NAMES[wanted]}"
                break
        else:
            raise ZygosError(
                f"{device.path}: no process data that node {node} sends have 0x{wanted[0]:X}; remedy: map it in the "
                "drive, and write identifier and mapping into the file: ParameterValue in [1800sub1], [1A00sub0], "
                "[1A00sub1] and following"
            )
        if kind == "torque":
            return {"signal": source, "unit": "mNm", "at": "rotor", "scale": device.torque_mnm()}
        turns, behind = device.angle(second=kind == "link")
        side = {} if kind == "link" else {"side": "output" if behind else "rotor"}
        return {"signal": source, "unit": "turn", "scale": turns} | side

    def dictionary(self) -> Dictionary:
        """As `Drives.dictionary`."""
        messages = {message.name: message for sent in self._sent for message in sent}
        return Dictionary(tuple(dict.fromkeys(device.path for device in self.devices)), messages, {}, {})


def devices_of(files: Sequence[Path], nodes: Sequence[int]) -> tuple[Device, ...]:
    """The device of each node. files: one for all nodes, or one for each. Errors: ZygosError for another number."""
    if len(files) not in (1, len(nodes)):
        raise ZygosError(
            f"--eds: {len(files)} files for {len(nodes)} nodes; remedy: give one, or one for each node in their order"
        )
    read = {file: Device.load(file) for file in files}
    return tuple(read[file] for file in (files if len(files) > 1 else list(files) * len(nodes)))

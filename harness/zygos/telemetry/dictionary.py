# SPDX-License-Identifier: MIT
"""The messages of DBC files, whose faults do not hinder the messages that are needed."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Message

from zygos.can.damaged import silence
from zygos.errors import ZygosError
from zygos.files.inputs import check_file, local
from zygos.files.output import counted, is_dash
from zygos.telemetry.map import closest


@dataclass(frozen=True)
class Dictionary:
    """The messages of all DBC files of a log."""

    files: tuple[Path, ...]
    messages: dict[str, Message]
    unusable: dict[str, str]
    """Faults of messages whose signals cannot be read, by the name of the message: each begins with its file."""
    doubtful: dict[str, str]
    """Faults of messages of which single signals can be read, likewise."""
    ignored_bits: int = 0
    """Bits of identifiers that do not say which message it is."""

    @classmethod
    def load(cls, files: Sequence[Path]) -> Dictionary:
        """Read DBC files. Faults of single messages are recorded. Errors: ZygosError for a file that is missing or
        unreadable."""
        messages: dict[str, Message] = {}
        origin: dict[str, Path] = {}
        unusable: dict[str, str] = {}
        doubtful: dict[str, str] = {}
        for file in files:
            for name, fault in (parsed := _parse(file))[1].items():
                unusable[name] = f"{file.name}: {fault}"
            for message in parsed[0]:
                name, other = message.name, messages.get(message.name)
                if other is not None:
                    both = f"0x{other.frame_id:X} and 0x{message.frame_id:X}"
                    before = "twice" if origin[name] is file else f"in {origin[name].name} as well"
                    unusable[name] = f"{file.name}: message {name} is defined {before}, with the identifiers {both}"
                    continue
                messages[name], origin[name] = message, file
                try:
                    message.refresh(strict=True)
                except cantools.Error as error:
                    doubtful[name] = f"{file.name}: {sentence(error)}"
        first: dict[tuple[int, bool], str] = {}
        for name, message in messages.items():
            before = first.setdefault((message.frame_id, message.is_extended_frame), name)
            if before != name:
                both = f"messages {before} and {name} have the same identifier 0x{message.frame_id:X}"
                doubtful[before] = doubtful[name] = f"{origin[name].name}: {both}"
        return cls(tuple(files), messages, unusable, doubtful)

    def find(self, source: str, where: str) -> tuple[Message, Any]:
        """Message and signal of "message.signal". Errors: ZygosError for a message with a fault, and for a signal that
        does not exist, naming the closest."""
        name, _, signal_name = source.partition(".")
        if name in self.unusable:
            raise ZygosError(
                f"{where}: {self.unusable[name]}; remedy: correct that message in the DBC, or "
                "leave out a file that defines it as well"
            )
        message = self.messages.get(name)
        if message is not None:
            for signal in message.signals:
                if signal.name == signal_name:
                    return message, signal
        known = [f"{m.name}.{s.name}" for m in self.messages.values() for s in m.signals]
        files = " or ".join(file.name for file in self.files)
        raise ZygosError(f'{where}: there is no "{source}" in {files}; remedy: {closest(source, known, "signals")}')

    def warnings(self, used: Collection[str]) -> list[str]:
        """Sentences about the faults of messages, which did not hinder. used: the messages that a map uses."""
        said = [
            f"{fault}; the map uses one of these signals: check that message in the DBC"
            for name, fault in self.doubtful.items()
            if name in used
        ]
        others = [fault for name, fault in (self.unusable | self.doubtful).items() if name not in used]
        others = list(dict.fromkeys(others))
        if others:
            more = f", and {counted(len(others) - 1, 'more such fault')}" if len(others) > 1 else ""
            said.append(f"{others[0]}{more}; the map does not use that message")
        return said


_DATABASES = ("arxml", "cdd", "dbc", "kcd", "sym")
"""Formats of cantools."""


def _parse(file: Path) -> tuple[list[Message], dict[str, str]]:
    """The messages of a DBC file, and the faults of those that the library refuses, by their names; these are left out
    of its text until it accepts the rest."""
    check_file(file, "check the path")
    try:
        content = local(file).read_bytes()
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")  # the encoding of Vector's tools
    kind = "dbc" if is_dash(file) else file.suffix.lower().removeprefix(".")
    faults: dict[str, str] = {}
    with silence():
        while True:
            try:
                database = cantools.database.load_string(text, kind if kind in _DATABASES else None, strict=False)
                return list(getattr(database, "messages", ())), faults
            except Exception as error:  # cantools raises different errors for each format
                shorter, name = _without(text, str(error))
                if shorter == text:
                    first = (str(error).strip().splitlines() or [""])[0]
                    raise ZygosError(f"{file}: not a readable DBC ({first}); remedy: correct that file") from error
                if name:
                    faults[name] = sentence(error)
                text = shorter


def _without(text: str, error: str) -> tuple[str, str]:
    """The text of a DBC without the message that an error of cantools names, or without the entries that belong to no
    message, and the name of the message."""
    if found := re.search(r"in message (\w+)\.", error):
        return re.sub(rf"^BO_ +\d+ +{found[1]} *:.*\n(\s+SG_ .*\n)*", "", text, flags=re.MULTILINE), found[1]
    for entry in re.findall(r"^\s+((?:VAL_|SIG_VALTYPE_) \d+ \w+)", error, re.MULTILINE):
        text = re.sub(rf"^{entry}\b[^;]*;", "", text, flags=re.MULTILINE)
    return text, ""


def sentence(error: Exception) -> str:
    """The text of an error of cantools, as part of a sentence."""
    text = re.sub(r'^DBC: "|"$', "", str(error).strip()).rstrip(".")
    return text[:1].lower() + text[1:]

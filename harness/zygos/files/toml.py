# SPDX-License-Identifier: MIT
"""Strict reading of TOML tables: every error message names the file, the key and the remedy.

Readers state the meaning of each key where they read it; `tools/reference.py` makes the reference pages of these.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeVar

from zygos.errors import ZygosError
from zygos.files.inputs import TOML_KINDS, local

Word = TypeVar("Word", bound=str)


@dataclass(frozen=True)
class Entry:
    """What a reader states of one key."""

    key: str
    meaning: str
    kind: str
    """What may be written, in words: a number, true or false, …"""
    default: Any
    """None: the key is required, unless `otherwise` says something else."""
    otherwise: str = ""
    """What holds where the key is absent, in words, if that is no constant."""
    unit: str = ""
    bounds: tuple[str, ...] = ()
    """Of a number, or of each in an array: > 0, <= 1."""

    @property
    def expected(self) -> str:
        """Kind and unit, as a refusal says them."""
        return self.kind + (f" in {self.unit}" if self.unit else "")


class Table:
    """One TOML table whose keys are read one by one; `finish` refuses the keys that were not read."""

    def __init__(self, data: Mapping[str, Any], file: Path, where: str = "") -> None:
        """Store a parsed table of `file` found at the dotted path `where`."""
        self._data = dict(data)
        self._known: list[str] = []
        self.file = file
        self.where = where

    @classmethod
    def load(cls, path: str | Path, kind: str = "") -> Self:
        """Read a TOML file. kind: one of `TOML_KINDS`, which it must be.

        Errors: ZygosError if it is missing, a folder, unreadable, not TOML, or of another kind.
        """
        file = Path(path)
        try:
            with local(file).open("rb") as stream:
                data = tomllib.load(stream)
        except IsADirectoryError:
            raise ZygosError(f"{file}: is a folder; remedy: give {kind or 'a file'} in it") from None
        except FileNotFoundError:
            raise ZygosError(f"{file}: no such file; remedy: check the path") from None
        except OSError as error:
            raise ZygosError(
                f"{file}: cannot be read ({error.strerror}); remedy: check the path and its permissions"
            ) from None
        except UnicodeDecodeError:
            raise ZygosError(f"{file}: is not UTF-8 text; remedy: save the file as UTF-8") from None
        except (ValueError, RecursionError) as error:  # TOMLDecodeError, integers too long, nesting too deep
            raise ZygosError(f"{file}: is not valid TOML ({error}); remedy: correct that line") from None
        found = next((known for sign, known in TOML_KINDS.items() if sign in data), kind)
        if kind and found != kind:
            raise ZygosError(f"{file}: is {found}, not {kind}; remedy: give {kind} there")
        return cls(data, file)

    def error(self, key: str, wrong: str, remedy: str) -> ZygosError:
        """The error for one key of this table."""
        return ZygosError(f"{self.file}: {self._name(key)}: {wrong}; remedy: {remedy}")

    def has(self, key: str) -> bool:
        """Whether the key is present and has not been read yet."""
        return key in self._data

    def number(
        self,
        key: str,
        meaning: str,
        default: float | None = None,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
        unit: str = "",
        infinite: bool = False,
        otherwise: str = "",
    ) -> float:
        """A finite number with low <= value <= high and value > above, as float; with `infinite` also inf."""
        bounds = _bounds(low, high, above)
        value = self._take(Entry(key, meaning, "a number", default, otherwise, unit, (*bounds, *["or inf"] * infinite)))
        if infinite and value == math.inf:
            return math.inf
        return self._checked(key, value, unit, low=low, high=high, above=above)

    def integer(
        self,
        key: str,
        meaning: str,
        default: int | None = None,
        *,
        low: int,
        high: int,
        unit: str = "",
        otherwise: str = "",
    ) -> int:
        """A whole number with low <= value <= high."""
        bounds = (f">= {low}", f"<= {high}")
        value = self._take(Entry(key, meaning, "a whole number", default, otherwise, unit, bounds))
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"{value!r} is not a whole number", f"write an integer from {low} to {high}")
        if not low <= value <= high:
            raise self.error(key, f"{value} is out of range", f"write an integer from {low} to {high}")
        return value

    def boolean(self, key: str, meaning: str, default: bool | None = None) -> bool:
        """Either true or false."""
        value = self._take(Entry(key, meaning, "true or false", default))
        if not isinstance(value, bool):
            raise self.error(key, f"{value!r} is neither true nor false", "write true or false, without quotes")
        return value

    def text(self, key: str, meaning: str, default: str | None = None, *, otherwise: str = "") -> str:
        """A non-empty string."""
        value = self._take(Entry(key, meaning, "a string in quotes", default, otherwise))
        if not isinstance(value, str) or not value:
            raise self.error(key, f"{value!r} is not a string", "write a non-empty string in quotes")
        return value

    def choice(
        self, key: str, meaning: str, choices: Sequence[Word], default: Word | None = None, *, otherwise: str = ""
    ) -> Word:
        """One of the given strings."""
        listed = " or ".join(f'"{choice}"' for choice in choices)
        value = self._take(Entry(key, meaning, listed, default, otherwise))
        for choice in choices:
            if value == choice:
                return choice
        raise self.error(key, f"{value!r} is not known", f"write {listed}")

    def vector(
        self,
        key: str,
        meaning: str,
        length: int,
        default: Sequence[float] | None = None,
        *,
        limit: float = math.inf,
        unit: str = "",
        otherwise: str = "",
    ) -> tuple[float, ...]:
        """An array of `length` finite numbers between -limit and limit."""
        bounds = _bounds(-limit, limit)
        value = self._take(Entry(key, meaning, f"an array of {length} numbers", default, otherwise, unit, bounds))
        if not isinstance(value, list | tuple) or len(value) != length:
            raise self.error(key, f"{value!r} is not an array of {length} numbers", f"write {length} numbers in [ ]")
        return tuple(self._checked(key, item, unit, low=-limit, high=limit) for item in value)

    def table(self, key: str, meaning: str, *, optional: bool = False, otherwise: str = "") -> Self:
        """A sub-table; a missing optional one is empty."""
        value = self._take(Entry(key, meaning, "a table", {} if optional else None, otherwise))
        if not isinstance(value, dict):
            raise self.error(key, f"{value!r} is not a table", f"write [{self._name(key)}] or {key} = {{ … }}")
        return self._within(value, self._name(key))

    def tables(self, key: str, meaning: str, *, optional: bool = False, otherwise: str = "") -> list[Self]:
        """An array of tables ([[key]]); it may be empty only if it is optional."""
        kind = f"at least one [[{self._name(key)}]]"
        value = self._take(Entry(key, meaning, kind, [] if optional else None, otherwise))
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, "is not an array of tables", f"write [[{self._name(key)}]] before each entry")
        if not value and not optional:
            raise self.error(key, "is empty", f"write at least one [[{self._name(key)}]]")
        return [self._within(item, f"{self._name(key)}[{index}]") for index, item in enumerate(value)]

    def names(self) -> list[str]:
        """The keys that have not been read yet, in file order."""
        return list(self._data)

    def peek(self, key: str) -> Any:
        """The value of a present key as parsed from TOML; it still counts as not read."""
        return self._data[key]

    def finish(self) -> None:
        """Refuse keys that were not read. Errors: ZygosError naming the first of them."""
        for key in self._data:
            close = difflib.get_close_matches(key, self._known, n=1)
            remedy = f'did you mean "{close[0]}"?' if close else f"remove it; known here: {', '.join(self._known)}"
            raise self.error(key, "unknown key", remedy)

    def _name(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def _within(self, data: Mapping[str, Any], where: str) -> Self:
        return type(self)(data, self.file, where)

    def _take(self, entry: Entry) -> Any:
        self._known.append(entry.key)
        if entry.key in self._data:
            return self._data.pop(entry.key)
        if entry.default is None:
            raise self.error(entry.key, "is missing", f"add {entry.key} = {entry.expected}")
        return entry.default

    def _checked(
        self,
        key: str,
        value: Any,
        unit: str,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
    ) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(key, f"{value!r} is not a number", "write a number" + (f" in {unit}" if unit else ""))
        # an integer may be too long for a float
        number = value if isinstance(value, float) else float(value) if abs(value) < 2**1023 else math.inf
        if not (math.isfinite(number) and low <= number <= high and number > above):
            wanted = " and ".join(_bounds(low, high, above)) or "finite"
            raise self.error(key, f"{number:g} is out of range", f"write a number {wanted}{' ' + unit if unit else ''}")
        return number


def _bounds(low: float, high: float, above: float = -math.inf) -> tuple[str, ...]:
    """The limits of a number in signs; those at infinity are none."""
    return (
        *[f"> {above:g}"] * (above > -math.inf),
        *[f">= {low:g}"] * (low > above),
        *[f"<= {high:g}"] * (high < math.inf),
    )

"""Strict reading of TOML tables: every error message names the file, the key and the remedy."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from zygos.errors import ZygosError
from zygos.files.inputs import local

Word = TypeVar("Word", bound=str)


class Table:
    """One TOML table whose keys are read one by one; `finish` refuses the keys that were not read."""

    def __init__(self, data: Mapping[str, Any], file: Path, where: str = "") -> None:
        """Store a parsed table of `file` found at the dotted path `where`."""
        self._data = dict(data)
        self._known: list[str] = []
        self.file = file
        self.where = where

    @classmethod
    def load(cls, path: str | Path) -> Table:
        """Read a TOML file. Errors: ZygosError if it is missing, unreadable or not TOML."""
        file = Path(path)
        try:
            with local(file).open("rb") as stream:
                return cls(tomllib.load(stream), file)
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

    def error(self, key: str, wrong: str, remedy: str) -> ZygosError:
        """The error for one key of this table."""
        return ZygosError(f"{self.file}: {self._name(key)}: {wrong}; remedy: {remedy}")

    def has(self, key: str) -> bool:
        """Whether the key is present and has not been read yet."""
        return key in self._data

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        low: float = -math.inf,
        high: float = math.inf,
        above: float = -math.inf,
        unit: str = "",
        infinite: bool = False,
    ) -> float:
        """A finite number with low <= value <= high and value > above, as float; with `infinite` also inf."""
        value = self._take(key, default, "a number" + (f" in {unit}" if unit else ""))
        if infinite and value == math.inf:
            return math.inf
        return self._checked(key, value, unit, low=low, high=high, above=above)

    def integer(self, key: str, default: int | None = None, *, low: int, high: int) -> int:
        """A whole number with low <= value <= high."""
        value = self._take(key, default, "a whole number")
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"{value!r} is not a whole number", f"write an integer from {low} to {high}")
        if not low <= value <= high:
            raise self.error(key, f"{value} is out of range", f"write an integer from {low} to {high}")
        return value

    def boolean(self, key: str, default: bool | None = None) -> bool:
        """Either true or false."""
        value = self._take(key, default, "true or false")
        if not isinstance(value, bool):
            raise self.error(key, f"{value!r} is neither true nor false", "write true or false, without quotes")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """A non-empty string."""
        value = self._take(key, default, "a string in quotes")
        if not isinstance(value, str) or not value:
            raise self.error(key, f"{value!r} is not a string", "write a non-empty string in quotes")
        return value

    def choice(self, key: str, choices: Sequence[Word], default: Word | None = None) -> Word:
        """One of the given strings."""
        listed = " or ".join(f'"{choice}"' for choice in choices)
        value = self._take(key, default, listed)
        for choice in choices:
            if value == choice:
                return choice
        raise self.error(key, f"{value!r} is not known", f"write {listed}")

    def vector(
        self,
        key: str,
        length: int,
        default: Sequence[float] | None = None,
        *,
        limit: float = math.inf,
        unit: str = "",
    ) -> tuple[float, ...]:
        """An array of `length` finite numbers between -limit and limit."""
        value = self._take(key, default, f"an array of {length} numbers" + (f" in {unit}" if unit else ""))
        if not isinstance(value, list | tuple) or len(value) != length:
            raise self.error(key, f"{value!r} is not an array of {length} numbers", f"write {length} numbers in [ ]")
        return tuple(self._checked(key, item, unit, low=-limit, high=limit) for item in value)

    def table(self, key: str, *, optional: bool = False) -> Table:
        """A sub-table; a missing optional one is empty."""
        value = self._take(key, {} if optional else None, "a table")
        if not isinstance(value, dict):
            raise self.error(key, f"{value!r} is not a table", f"write [{self._name(key)}] or {key} = {{ … }}")
        return Table(value, self.file, self._name(key))

    def tables(self, key: str, *, optional: bool = False) -> list[Table]:
        """An array of tables ([[key]]); it may be empty only if it is optional."""
        value = self._take(key, [] if optional else None, f"at least one [[{self._name(key)}]]")
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, "is not an array of tables", f"write [[{self._name(key)}]] before each entry")
        if not value and not optional:
            raise self.error(key, "is empty", f"write at least one [[{self._name(key)}]]")
        return [Table(item, self.file, f"{self._name(key)}[{index}]") for index, item in enumerate(value)]

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

    def _take(self, key: str, default: Any, expected: str) -> Any:
        self._known.append(key)
        if key in self._data:
            return self._data.pop(key)
        if default is None:
            raise self.error(key, "is missing", f"add {key} = {expected}")
        return default

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
            bounds = (
                [f"> {above:g}"] * (above > -math.inf)
                + [f">= {low:g}"] * (low > above)
                + [f"<= {high:g}"] * (high < math.inf)
            )
            wanted = " and ".join(bounds) or "finite"
            raise self.error(key, f"{number:g} is out of range", f"write a number {wanted}{' ' + unit if unit else ''}")
        return number

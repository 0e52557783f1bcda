# SPDX-License-Identifier: MIT
"""The part of a recording that is read."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError


@dataclass(frozen=True)
class Span:
    """From `begin_s` to before `end_s`, in s after the first frame, row or message of each recording."""

    begin_s: float = 0.0
    end_s: float = math.inf

    def __post_init__(self) -> None:
        """Refuse, with ZygosError, a span that nothing can lie in."""
        if not 0.0 <= self.begin_s < self.end_s:
            raise ZygosError(
                f"from {self.begin_s:g} s to {self.end_s:g} s: nothing lies between; remedy: give --from and --to in "
                "seconds after the beginning of the recording, --from below --to"
            )

    def holds(self, time_s: float) -> bool:
        """Whether a time is in the span."""
        return self.begin_s <= time_s < self.end_s

    def nothing(self, path: Path, last_s: float) -> ZygosError:
        """The error of a recording that has nothing in the span; last_s: its last time."""
        if not last_s > 0.0:
            return ZygosError(
                f"{path}: has no times at which it could be cut; remedy: record time stamps (candump -L; slcan: Z1), "
                "or leave out --from and --to"
            )
        return ZygosError(
            f"{path}: has nothing from {self.begin_s:g} s to {self.end_s:g} s, and ends {last_s:.6g} s after its "
            "beginning; remedy: give --from and --to in seconds after the beginning of the recording"
        )

    def rows(self, path: Path, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n,) the rows in the span; time_s: (n,) times after the first row, s. Raises ZygosError if there are none."""
        if self == WHOLE:
            return np.ones(len(time_s), dtype=np.bool_)
        found = (time_s >= self.begin_s) & (time_s < self.end_s)
        last_s = float(np.max(time_s, initial=0.0))
        if not np.any(found) or not last_s > 0.0:
            raise self.nothing(path, last_s)
        return found


WHOLE = Span()
_SPAN: ContextVar[Span] = ContextVar("span", default=WHOLE)


def span() -> Span:
    """The part of each recording that is read at present."""
    return _SPAN.get()


@contextmanager
def reading(begin_s: float | None, end_s: float | None) -> Iterator[None]:
    """Context in which only a part of each recording is read; None: from its beginning, or to its end."""
    token = _SPAN.set(Span(0.0 if begin_s is None else begin_s, math.inf if end_s is None else end_s))
    try:
        yield
    finally:
        _SPAN.reset(token)

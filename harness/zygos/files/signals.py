# SPDX-License-Identifier: MIT
"""Ctrl-C and SIGTERM as a request to end."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Gives a function that tells whether Ctrl-C or SIGTERM came. The first signal is a request, a second ends at
    once."""
    came: list[int] = []
    before = {which: signal.getsignal(which) for which in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for which, handler in before.items():
            signal.signal(which, handler)

    def take(which: int, _: Any) -> None:
        came.append(which)
        restore()

    for which in before:
        signal.signal(which, take)
    try:
        yield lambda: bool(came)
    finally:
        restore()

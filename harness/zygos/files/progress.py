# SPDX-License-Identifier: MIT
"""Progress of a long command where no bar can be drawn (pipe, file, CI): a line on stderr from time to time."""

from __future__ import annotations

import math
import threading
from datetime import timedelta

from rich.progress import BarColumn, Progress, Task, TextColumn, TimeRemainingColumn

from zygos.files.output import (
    errors,
    note,
)

FIRST_S = 2.0
"""Work that takes less time than this prints nothing, s."""


EVERY_S = 10.0
"""Time between two lines, s."""


class LineProgress(Progress):
    """Rich's tasks, and a thread that prints the state of the unfinished ones; nothing else is printed."""

    def __init__(self) -> None:
        """Keep Rich's times and speeds for tasks that are updated only once in many minutes."""
        super().__init__(console=errors, auto_refresh=False, speed_estimate_period=math.inf)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop printing."""
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        wait = FIRST_S
        while not self._ended.wait(wait):
            wait = EVERY_S
            for task in self.tasks:
                if not task.finished:
                    note(line(task))


def line(task: Task) -> str:
    """State of a task: its percentage, if the total is known, and times."""
    parts = [task.description]
    if task.total is not None:
        parts.append(f"{task.percentage:.0f} %")
    parts.append(f"{_clock(task.elapsed or 0.0)} elapsed")
    if task.total is not None and task.time_remaining is not None:
        parts.append(f"about {_clock(task.time_remaining)} left")
    return " · ".join(parts)


def _clock(seconds: float) -> str:
    return str(timedelta(seconds=round(seconds)))


def progress() -> Progress:
    """A progress bar on stderr; if stderr is not a terminal, a line from time to time."""
    if not errors.is_interactive:
        return LineProgress()
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=errors,
        transient=True,
    )

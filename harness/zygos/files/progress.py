"""How far a long command is, where nothing can be redrawn: a line on stderr now and then, for pipes, files and CI."""

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
"""Between two lines, s."""


class LineProgress(Progress):
    """Rich's tasks, and a thread that prints where those stand that are not finished; nothing else is printed."""

    def __init__(self) -> None:
        """Take the tasks' times and speeds from Rich, which may be updated once in many minutes."""
        super().__init__(console=errors, auto_refresh=False, speed_estimate_period=math.inf)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def stop(self) -> None:
        """Print nothing more."""
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
    """Where a task stands: its share, where its end is known, and times."""
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
    """A progress bar on stderr; where that is no terminal, a line now and then."""
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

# SPDX-License-Identifier: MIT
"""Runs the cells of a campaign on one machine or on a cluster; every finished cell is stored as a line of a file."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Protocol

from zygos.errors import ZygosError, installs
from zygos.files.output import write_text
from zygos.files.progress import progress

Line = dict[str, Any]
_CONNECT_S = 10


class Job(Protocol):
    """A job for one process, with a key for its result."""

    @property
    def code(self) -> str:
        """Fingerprint of the code that computes the result."""

    @property
    def key(self) -> str:
        """Key that differs if the result can differ."""

    def run(self) -> Line:
        """Compute the result."""


@contextmanager
def executor(scheduler: str | None, workers: int | None) -> Iterator[Executor]:
    """A pool of processes here, or the Dask cluster of a scheduler (tcp://host:port).

    Errors: ZygosError if the cluster cannot be reached, or Dask is not installed.
    """
    if scheduler is None:
        with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_end_on_interrupt) as pool:
            yield pool
        return
    try:
        distributed = import_module("distributed")
    except ImportError as error:
        raise ZygosError(f"--scheduler needs Dask ({error}); remedy: {installs('cluster')}") from None
    try:
        client: Any = distributed.Client(scheduler, timeout=_CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        raise ZygosError(
            f"no Dask scheduler answers at {scheduler!r} ({error}); remedy: give the address that it prints, "
            "tcp://host:port, or leave --scheduler out"
        ) from None
    with client:
        yield client.get_executor()


def run(jobs: Sequence[Job], file: Path, open_executor: Callable[[], Any]) -> list[Line]:
    """The lines of all jobs, in their order; jobs whose lines `file` already contains are not computed again.

    Each finished job adds a line to the file at once. Lines of other versions of the code are removed from it.
    """
    done = _known(file, jobs[0].code)
    missing = [job for job in jobs if job.key not in done]
    if missing:
        with open_executor() as pool, file.open("a", encoding="utf-8") as stream, progress() as bar:
            task = bar.add_task("cells", total=len(jobs), completed=len(jobs) - len(missing))
            futures = {pool.submit(_work, job): job for job in missing}
            try:
                for future in as_completed(futures):
                    job = futures[future]
                    line = {"key": job.key, "code": job.code, **future.result()}
                    stream.write(json.dumps(line, allow_nan=False, separators=(",", ":")) + "\n")
                    stream.flush()
                    done[job.key] = line
                    bar.advance(task)
            except BrokenExecutor as error:
                raise ZygosError(
                    f"a worker ended unexpectedly ({error}); remedy: find the cause, and start again: "
                    f"{len(done)} of {len(jobs)} finished cells are stored"
                ) from None
            finally:
                for future in futures:
                    future.cancel()
    return [done[job.key] for job in jobs]


def _work(job: Job) -> Line:
    return job.run()


def _end_on_interrupt() -> None:
    """Let a worker end at once and silently when the user interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _known(file: Path, code: str) -> dict[str, Line]:
    """Lines of this version of the code by key. An incomplete line, left by an interruption, is ignored."""
    kept: dict[str, Line] = {}
    texts = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    for text in texts:
        try:
            line = json.loads(text)
        except ValueError:
            continue
        if line["code"] == code:
            kept[line["key"]] = line
    write_text(file, "".join(json.dumps(line, separators=(",", ":")) + "\n" for line in kept.values()))
    return kept

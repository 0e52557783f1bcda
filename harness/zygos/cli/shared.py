"""Steps that several commands share: read a run, report damage, say where an answer is from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zygos.arm import Arm
from zygos.can import run as recorded
from zygos.can.run import Run
from zygos.errors import Damaged, ZygosError
from zygos.files.output import (
    is_dash,
    note,
)
from zygos.files.progress import progress


def check_model_name(path: Path) -> None:
    """Refuse a model file that is not called .toml, unless it is standard output."""
    if not is_dash(path) and path.suffix.lower() != ".toml":
        raise ZygosError(f"{path}: not a name for a model; remedy: give it the suffix .toml")


def read_run(run: Path, arm: Arm) -> Run:
    """Read a log or a table of cycles, with progress for a long log. Damage is reported at once; `not_whole` ends the
    command."""
    with progress() as bar:
        task = bar.add_task(f"reading {run.name}", total=None)
        read = recorded.read_run(
            run, arm, lambda count: bar.update(task, description=f"reading {run.name}: {count:,} frames")
        )
    warn(read.damage)
    return read


def warn(texts: Sequence[str]) -> None:
    """Print warnings about the result."""
    for text in texts:
        note(f"warning: {text}")


def not_whole(*damage: Sequence[str]) -> None:
    """End a command that has answered from logs. Raises Damaged if one of them was damaged."""
    if any(damage):
        raise Damaged(
            "the answer is based on the readable part of a damaged log; remedy: read the warnings above, and record "
            "again"
        )


def origin(run: Run) -> dict[str, Any]:
    """The entries about the run in the JSON of an answer: its file, the input of the library, and its damage."""
    return {"run": str(run.path), "door": "cycle" if run.frames is None else "frames", "damage": run.damage or None}

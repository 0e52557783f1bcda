"""Steps that several commands share: find the arm file, read a run, report damage, end at a signal."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zygos.arm import Arm
from zygos.can import bus
from zygos.can.run import Run
from zygos.errors import Damaged, ZygosError
from zygos.files.inputs import local
from zygos.files.output import (
    is_dash,
    note,
)
from zygos.files.progress import progress
from zygos.files.tables import check_table, is_table
from zygos.runs.tables import read_cycles


def find_arm(run: Path, arm: Path | None) -> Path:
    """The arm file of a run: the given one, or arm.toml next to the run. The run must exist."""
    if is_table(run):
        check_table(run)
    else:
        bus.check_log(run)
    chosen = arm or run.parent / "arm.toml"
    if not local(chosen).is_file():
        raise ZygosError(f"{chosen}: no such arm file; remedy: give it with --arm, or put arm.toml next to the run")
    return chosen


def check_model_name(path: Path) -> None:
    """Refuse a model file that is not called .toml, unless it is standard output."""
    if not is_dash(path) and path.suffix.lower() != ".toml":
        raise ZygosError(f"{path}: not a name for a model; remedy: give it the suffix .toml")


def read_run(run: Path, arm: Arm) -> Run:
    """Read a log or a table of cycles; as `read_log`."""
    if is_table(run):
        return Run(arm, table=read_cycles(run, arm), path=run)
    log = read_log(run)
    return Run(arm, log.frames, path=run, damage=log.damage)


def read_log(run: Path) -> bus.Log:
    """Read a log, with progress for a long one. Damage is reported at once; `not_whole` ends the command."""
    with progress() as bar:
        task = bar.add_task(f"reading {run.name}", total=None)
        log = bus.read_log(run, lambda count: bar.update(task, description=f"reading {run.name}: {count:,} frames"))
    warn(log.damage)
    return log


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

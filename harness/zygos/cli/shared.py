"""What several commands do: find the arm file, read a run, say what is damaged, end at a signal."""

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
    """The arm file of a run: the one given, or arm.toml beside the run. The run must exist."""
    if is_table(run):
        check_table(run)
    else:
        bus.check_log(run)
    chosen = arm or run.parent / "arm.toml"
    if not local(chosen).is_file():
        raise ZygosError(f"{chosen}: no such arm file; remedy: give it with --arm, or put arm.toml beside the run")
    return chosen


def check_model_name(path: Path) -> None:
    """Refuse a model file that is not called .toml, unless it is standard output."""
    if not is_dash(path) and path.suffix.lower() != ".toml":
        raise ZygosError(f"{path}: no name for a model; remedy: let it end in .toml")


def read_run(run: Path, arm: Arm) -> Run:
    """Read a log or a table of cycles; as `read_log`."""
    if is_table(run):
        return Run(arm, table=read_cycles(run, arm), path=run)
    log = read_log(run)
    return Run(arm, log.frames, path=run, damage=log.damage)


def read_log(run: Path) -> bus.Log:
    """Read a log; a long one shows how far it is. Damage is said at once; `not_whole` ends the command."""
    with progress() as bar:
        task = bar.add_task(f"reading {run.name}", total=None)
        log = bus.read_log(run, lambda count: bar.update(task, description=f"reading {run.name}: {count:,} frames"))
    warn(log.damage)
    return log


def warn(texts: Sequence[str]) -> None:
    """Say what the answer is to be taken with."""
    for text in texts:
        note(f"warning: {text}")


def not_whole(*damage: Sequence[str]) -> None:
    """The end of a command that has answered from logs. Raises Damaged when one of them was damaged."""
    if any(damage):
        raise Damaged(
            "answered from damaged input, from what could be read; remedy: see the warnings above, and record again"
        )


def origin(run: Run) -> dict[str, Any]:
    """What an answer's JSON says of its run, and the door of the flight library that it goes through: frames, or cycles
    of which nobody saw the frames."""
    return {"run": str(run.path), "door": "cycle" if run.frames is None else "frames", "damage": run.damage or None}

# SPDX-License-Identifier: MIT
"""Steps that several commands share: read a run, report damage, deliver an answer, say where it is from."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zygos.arm import Arm, Encoder, load_arm
from zygos.can import run as recorded
from zygos.can.run import Run, check_distinct, find_arm
from zygos.errors import Damaged, Undecided, ZygosError
from zygos.files.inputs import local
from zygos.files.output import is_dash, note, quiet, write_json
from zygos.files.progress import progress
from zygos.report.answer import Answer
from zygos.report.provenance import Provenance
from zygos.report.terminal import show

if TYPE_CHECKING:
    from zygos.simulators.explain import InSimulator


def check_model_name(path: Path | None) -> None:
    """Refuse a model file that is not called .toml, unless it is standard output, or none is wanted."""
    if path is not None and not is_dash(path) and path.suffix.lower() != ".toml":
        raise ZygosError(f"{path}: not a name for a model; remedy: give it the suffix .toml")


def read_run(run: Path, arm: Arm) -> Run:
    """Read a log or a table of cycles, with progress for a long log. Damage is reported at once; `not_whole` ends the
    command."""
    with progress() as bar:
        task = bar.add_task(f"reading {run.name}", total=None)
        read = recorded.read_run(
            run, arm, lambda count: bar.update(task, description=f"reading {run.name}: {count:,} frames")
        )
    warn((*read.remarks, *read.damage))
    return read


def read_runs(
    runs: Sequence[Path], arm_file: Path | None, chosen: Path, arm: Arm, *, own_noise: bool = False
) -> list[Run]:
    """Read runs of one arm.

    arm_file: what --arm says, which is that of all runs; chosen: the file of `arm`, beside the first run where --arm
    says nothing. own_noise: each run has the noise that the file beside it declares. Errors: ZygosError where the arm
    file beside a run contradicts the chosen one, and for a recording that is given twice.
    """
    arms = [arm_beside(path, arm_file, chosen, arm) for path in runs]
    found: list[Run] = []
    for path, own in zip(runs, arms, strict=True):
        found.append(read_run(path, own if own_noise else arm))
        check_distinct(found[-1], found[:-1])
    return found


def arm_beside(run: Path, arm_file: Path | None, chosen: Path, arm: Arm) -> Arm:
    """The arm with the noise that the file beside a run declares, if it is another file than the chosen one.

    Errors: ZygosError where it describes other hardware.
    """
    beside = run.parent / "arm.toml"
    find_arm(run, chosen)
    if arm_file is not None or not beside.is_file() or beside.samefile(local(chosen)):
        return arm
    other = load_arm(beside)
    differing = difference(silent(arm), silent(other))
    if differing is not None:
        where, ours, theirs = differing
        raise ZygosError(
            f"{beside} is of another arm than {chosen}: {where} is {theirs}, not {ours}; remedy: correct the wrong "
            "one, or give the arm file of all runs (--arm)"
        )
    return replace(arm, joints=other.joints, imu=other.imu, torque_averaged=other.torque_averaged)


def silent(arm: Arm) -> Arm:
    """The hardware alone: without the noise of its sensors, the name of the file, and what an estimator chooses."""

    def encoder(one: Encoder) -> Encoder:
        return replace(one, quantum_rad=0.0, counts=None, zero_sigma_rad=0.0)

    joints = tuple(
        replace(
            joint,
            link_encoder=encoder(joint.link_encoder) if joint.flexible else Encoder(0.0),  # a rigid joint has one
            motor_encoder=encoder(joint.motor_encoder),
            torque_sigma=0.0,
            torque_relative_sigma=0.0,
        )
        for joint in arm.joints
    )
    hardware = ("base", "kinetic", "period_s", "torque_law", "torque_at", "torque_unit", "gravity")
    return Arm(**{name: getattr(arm, name) for name in hardware}, name="", joints=joints,
                imu=replace(arm.imu, rate_sigma=0.0, bias_walk=0.0))  # fmt: skip


def difference(one: Any, other: Any, where: str = "") -> tuple[str, Any, Any] | None:
    """The first entry in which two descriptions differ, with both values; None: they are the same."""
    if is_dataclass(one) and type(one) is type(other):
        for field in fields(one):
            name = f"{where}.{field.name}" if where else field.name
            found = difference(getattr(one, field.name), getattr(other, field.name), name)
            if found is not None:
                return found
        return None
    if isinstance(one, tuple) and isinstance(other, tuple) and any(map(is_dataclass, one)):
        if len(one) != len(other):
            return f"number of {where}", len(one), len(other)
        pairs = (difference(a, b, f"{where}[{k}]") for k, (a, b) in enumerate(zip(one, other, strict=True)))
        return next((found for found in pairs if found is not None), None)
    return None if one == other else (where, one, other)


def warn(texts: Sequence[str]) -> None:
    """Print warnings about the result."""
    for text in texts:
        note(f"warning: {text}")


def conclude(validity: str, said: str) -> None:
    """End a command that has given an estimate. said: validity, reason and remedy. Raises Undecided if the estimate is
    doubtful or refused; the values of a partial one mean what they say, and a warning names the others."""
    if validity == "partial":
        warn([said])
    elif validity != "valid":
        raise Undecided(said)


@dataclass(frozen=True)
class Wanted:
    """What a command is to give beside the files that it is for."""

    json: str | None = None
    """File of the JSON."""
    report: Path | None = None
    """File of the page."""
    details: bool = False
    """Whether all tables are printed."""
    mcap: Path | None = None
    """File of the signals."""


def deliver(
    wanted: Wanted,
    answer: Callable[[bool], Answer],
    content: Callable[[], Mapping[str, Any]],
    source: Callable[[], Provenance],
    *outputs: str | Path | None,
    save: Callable[[], None] | None = None,
) -> None:
    """Print an answer, save what the command is for, and write page and JSON.

    answer: with charts, or without. content: of the JSON, which is written even if another file cannot be. source: what
    the answer was made from. outputs: other files, one of which may be standard output.
    """
    if not quiet(*outputs, wanted.json, wanted.report):
        show(answer(False), details=wanted.details)
    try:
        if save is not None:
            save()
        if wanted.report is not None:
            from zygos.report.html import write_page  # noqa: PLC0415  (only a page needs the templates)

            write_page(wanted.report, answer(True), source())
    finally:
        if wanted.json:
            write_json(wanted.json, content())


def save_corrected(own: InSimulator, out: Path) -> None:
    """Write the corrected file of a simulator, and say what is written beside it. Errors: as `InSimulator.save`."""
    for path in own.save(out)[1:]:
        note(f"{path}: written as well")


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

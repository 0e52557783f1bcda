"""`zygos check-arm`: compares a run with its arm file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import typer

from zygos.arm import load_arm
from zygos.audit.check import check_arm
from zygos.audit.sections import advice, answer_of, summary
from zygos.cli.options import ArmArgument, Details, Json, Report, Run, cuts
from zygos.cli.shared import Wanted, deliver, not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.files.output import check_outputs
from zygos.files.progress import progress
from zygos.report.provenance import provenance


def check_arm_run(arm_file: Path, run: Path, wanted: Wanted, command: Sequence[str]) -> None:
    """Audit a run against an arm file; see `zygos check-arm --help`."""
    check_outputs([wanted.json, wanted.report], [run, arm_file])
    arm = load_arm(arm_file)
    recorded = read_run(run, arm)
    with progress() as bar:
        task = bar.add_task("comparing", total=1.0)
        found = check_arm(recorded, progress=lambda share: bar.update(task, completed=share))
    deliver(
        wanted,
        lambda draw: answer_of(recorded, found.audit, draw=draw),
        lambda: {**origin(recorded), **found.as_dict()},
        partial(provenance, command, [("arm", arm_file), ("run", run)]),
    )
    if not found.ok:
        raise Undecided(f"{summary(found.audit)}; remedy: {advice(found.audit)}")
    not_whole(recorded.damage)


@cuts
def command(
    context: typer.Context,
    arm: ArmArgument,
    run: Run,
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Check a run against its arm file: rate, range, steps and noise of each signal, and whether the signals agree.

    Reports signals that wrap, that are in another unit, late, swapped, inverted, scaled, stuck, saturated or noisy, two
    encoders of a joint that are read at different times, zeros that are off, a wrong torque law, and a smoother that
    flattens the motion, each with the evidence in numbers, and with the key of the arm file or of the map of `zygos
    convert` that removes it. No model is needed. The page of --report has all of it, with charts of the readings.

    Exit code 3 when something is found, or the run does not confirm every signal. What else is open is listed.

    Example: zygos check-arm out/arm.toml out/run.blf
    """
    check_arm_run(arm, run, Wanted(json, report, details), context.obj or ["check-arm"])

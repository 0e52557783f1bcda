# SPDX-License-Identifier: MIT
"""`zygos check-arm`: compares a run with its arm file."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import Arm, load_arm
from zygos.audit.check import check_arm
from zygos.audit.sections import advice, answer_of, summary
from zygos.audit.weights import check_weighed
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Details, Json, Report, Run, cuts
from zygos.cli.shared import Wanted, deliver, not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.files.output import check_outputs
from zygos.files.progress import progress
from zygos.model.model import Model, load_model
from zygos.report.provenance import provenance


def check_arm_run(run: Path, arm_file: Path, simulation: Path | None, wanted: Wanted, command: Sequence[str]) -> None:
    """Audit a run against an arm file; see `zygos check-arm --help`."""
    check_outputs([wanted.json, wanted.report], [run, arm_file, simulation])
    arm = load_arm(arm_file)
    model = None if simulation is None else _model(simulation, arm)
    recorded = read_run(run, arm)
    with progress() as bar:
        task = bar.add_task("comparing", total=1.0)
        found = check_arm(recorded, simulation=model, progress=lambda share: bar.update(task, completed=share))
    deliver(
        wanted,
        lambda draw: answer_of(recorded, found.audit, draw=draw, weighed=model is not None),
        lambda: {**origin(recorded), **found.as_dict()},
        partial(
            provenance,
            command,
            [("arm", arm_file), ("run", run), *([] if simulation is None else [("simulation", simulation)])],
        ),
    )
    if not found.ok:
        raise Undecided(f"{summary(found.audit)}; remedy: {advice(found.audit)}")
    not_whole(recorded.damage)


def _model(simulation: Path, arm: Arm) -> Model:
    """The model of a file of bodies. Errors: ZygosError where it does not weigh the torques of the arm."""
    from zygos.simulators.file import is_simulator_file, read_robot  # noqa: PLC0415  (of use here alone, and slow to load)

    model = read_robot(simulation, arm).model(arm) if is_simulator_file(simulation) else load_model(simulation)
    check_weighed(arm, model)
    return model


@cuts
def command(
    context: typer.Context,
    run: Run,
    arm: ArmFile = None,
    simulation: Annotated[
        Path | None,
        typer.Option(
            "--simulation",
            metavar="ROBOT.urdf|ROBOT.xml|CAD.toml",
            help="Also compare the torques of an arm on the ground with what the masses of this file weigh.",
        ),
    ] = None,
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Check a run against its arm file: rate, range, steps and noise of each signal, and whether the signals agree.

    Reports signals that wrap, that are in another unit, late, swapped, inverted, scaled, stuck, saturated or noisy, two
    encoders of a joint that are read at different times, zeros that are off, a wrong torque law, and a smoother that
    flattens the motion, each with the evidence in numbers, and with the key of the arm file or of the map of `zygos
    convert` that removes it. No model is needed. The page of --report has all of it, with charts of the readings.

    With --simulation, gravity tells the scale of each torque against the masses of a URDF, an MJCF or a model: a factor
    is said to be one of "torque scale or masses", and never of friction.

    Exit code 3 when something is found, or the run does not confirm every signal. What else is open is listed.

    Example: zygos check-arm out/run.blf --arm out/arm.toml
    """
    check_arm_run(run, find_arm(run, arm), simulation, Wanted(json, report, details), context.obj or ["check-arm"])

# SPDX-License-Identifier: MIT
"""`zygos predict`: compares runs with what a model predicts of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Details, Json, Report, Runs, cuts
from zygos.cli.shared import Wanted, deliver, not_whole, read_runs
from zygos.files.output import check_outputs
from zygos.files.progress import progress
from zygos.gap.predict import predict
from zygos.gap.prediction import answer_of
from zygos.model.model import load_model
from zygos.report.provenance import provenance


@cuts
def command(
    context: typer.Context,
    run: Runs,
    model: Annotated[Path, typer.Option("--model", metavar="MODEL.toml", help="The model that predicts.")],
    arm: ArmFile = None,
    cutoff: Annotated[
        float | None,
        typer.Option(
            "--cutoff",
            metavar="HZ",
            help="Cut-off of the filter of angles and torques. Default: that of the arm's smoother, at most 10 Hz.",
        ),
    ] = None,
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Compare runs with what a model predicts of them: the torques of each joint, and the motion half a second ahead.

    For each joint: root mean square of the measured torque and of the error, in Nm behind the gear and in per cent, and
    of the work over one second that the error makes. The floor stands beside the error: what the noise of all sensors,
    quanta and filters make of the same model; σ is the error in floors, and near 1 only noise is left. A joint whose
    torque is below five floors is not evaluated. Instants at which a joint rests are apart: its friction may be
    anything there. The constant offset of each torque in each run is taken out first, and shown; "with offset" has it
    in it.

    The motion of an arm that floats or has flexible joints is also predicted half a second ahead, again and again, from
    the readings before and under the measured torques.

    The model may be any: bodies or base parameters, from a drawing or from an estimate.

    Example: zygos predict out/run.npz --model learned.toml
    """
    chosen = find_arm(run[0], arm)
    check_outputs([json, report], [*run, chosen, model])
    hardware, assumed = load_arm(chosen), load_model(model)
    recorded = read_runs(run, arm, chosen, hardware, own_noise=True)
    predictions = []
    with progress() as bar:
        task = bar.add_task("predicting", total=len(recorded))
        for one in recorded:
            predictions.append(predict(assumed, one, cutoff=cutoff))
            bar.advance(task)
    files = [*(("run", path) for path in run), ("arm", chosen), ("model", model)]
    deliver(
        Wanted(json, report, details),
        lambda draw: answer_of(predictions, draw=draw),
        lambda: {"model": str(model), "runs": [one.as_dict() for one in predictions]},
        partial(provenance, context.obj or ["predict"], files),
    )
    not_whole(*(one.damage for one in recorded))

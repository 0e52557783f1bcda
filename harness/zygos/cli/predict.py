"""`zygos predict`: compares the torques of runs with those that a model predicts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.ground import scores_table
from zygos.cli.options import ArmFile, Json, Report, Runs
from zygos.cli.shared import not_whole, read_runs
from zygos.files.output import check_outputs, quiet, write_json
from zygos.ground.score import score
from zygos.model.model import load_model
from zygos.report.provenance import provenance


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
) -> None:
    """Compare the torques of runs with those that a model predicts, joint by joint.

    For each joint: root mean square of the measured torque and of the error, in Nm behind the gear and in per cent, and
    of the work over one second that the error makes; the error in standard deviations of the torque's noise (σ). On the
    ground the floor stands beside the error: what the model leaves of its own simulated twin, because of noise, quanta
    and filters. A joint whose torque is below five floors is not evaluated. The constant offset of each torque in each
    run is taken out first, and shown; "with offset" has it in it.

    The model may be any: bodies or base parameters, from a drawing or from an estimate.

    Example: zygos predict out/run.npz --model learned.toml
    """
    chosen = find_arm(run[0], arm)
    check_outputs([json, report], [*run, chosen, model])
    hardware, assumed = load_arm(chosen), load_model(model)
    recorded = read_runs(run, arm, chosen, hardware, own_noise=True)
    scores = [score(one, assumed, cutoff=cutoff) for one in recorded]
    if report is not None:
        from zygos.ground.page import write_score_report  # noqa: PLC0415  (only a report needs charts)

        files = [*(("run", path) for path in run), ("arm", chosen), ("model", model)]
        write_score_report(report, scores, provenance(context.obj or ["predict"], files))
    if json:
        write_json(json, {"model": str(model), "runs": [one.as_dict() for one in scores]})
    if not quiet(json, report):
        scores_table(scores)
    not_whole(*(one.damage for one in recorded))

"""`zygos estimate`: estimates the parameters from a recorded run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.answer import finish_estimate
from zygos.cli.options import ArmFile, Json, Report, Run
from zygos.cli.shared import check_model_name, not_whole, origin, read_run
from zygos.estimation.estimate import estimate
from zygos.files.output import (
    check_outputs,
)
from zygos.files.progress import progress
from zygos.model.model import load_model
from zygos.report.provenance import provenance


def estimate_run(
    run: Path,
    arm_file: Path | None,
    out: Path,
    model_file: Path | None,
    json: str | None,
    report: Path | None,
    command: Sequence[str],
) -> None:
    """Estimate from a recorded run; see `zygos estimate --help`."""
    chosen = find_arm(run, arm_file)
    check_model_name(out)
    check_outputs([out, json, report], [run, chosen, run.parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    prior = load_model(model_file) if model_file else None
    recorded = read_run(run, arm)
    with progress() as bar:
        task = bar.add_task("learning", total=1.0)
        found = estimate(
            recorded,
            model=prior,
            progress=lambda share: bar.update(task, completed=share),
            trace=report is not None,
        )
    source = None
    if report is not None:
        source = provenance(command, [("run", run), ("arm", chosen), *([("prior", model_file)] if model_file else [])])
    finish_estimate(found, out, json, origin(recorded), report, source)
    not_whole(recorded.damage)


def command(
    context: typer.Context,
    run: Run,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MODEL.toml", help="The model to write.")],
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PRIOR.toml",
            help="Also estimate the effects of this model, and use its values where the run determines none.",
        ),
    ] = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Estimate the parameters from a run, with the C library for flight.

    Writes a model.toml with value and sigma of each parameter. A parameter that the motion does not determine is left
    out, or taken from --model. The [[effect]] entries of --model (friction, cubic stiffness, torque lag) are estimated
    as well, whatever their values; so is a spring_offset of each joint whose encoder zeros are uncertain by the arm
    file (zero_sigma_rad above 0). Exit code 3 when something is undecided; the reason is on stderr and in the JSON. If
    the arm changed during the run, a warning on stderr and the JSON state when, and in which parameters.

    The page of --report has the verdict with reason and remedy, the parameters with their intervals, the data that were
    lost or left out, and charts of the motion and of the energy balance.

    Example: zygos estimate out/run.blf -o out/estimate.toml
    """
    estimate_run(run, arm, out, model, json, report, context.obj or ["estimate"])

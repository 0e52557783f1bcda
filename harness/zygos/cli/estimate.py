"""`zygos estimate`: the parameters from a recorded run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.cli.answer import finish_estimate
from zygos.cli.options import ArmFile, Json, Report, Run
from zygos.cli.shared import check_model_name, damage_of, find_arm, not_whole, origin, read_run
from zygos.estimation.watch import Watch
from zygos.files.output import (
    check_outputs,
)
from zygos.files.progress import progress
from zygos.files.tables import is_table
from zygos.model.model import load_model
from zygos.native.flight import Flight
from zygos.report.provenance import provenance
from zygos.runs.tables import read_cycles


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
    if prior is not None:
        prior.base_parameters(arm)
    watch = Watch(Flight(arm, prior.effects if prior else ()), trace=report is not None)
    log = None if is_table(run) else read_run(run)
    with progress() as bar:
        task = bar.add_task("learning", total=1.0)

        def show(share: float) -> None:
            bar.update(task, completed=share)

        if log is None:
            watch.cycles(read_cycles(run, arm), show)
        else:
            watch.frames(log.frames, show)
        result = watch.flight.estimate()
    page = None
    if report is not None:
        files = [("run", run), ("arm", chosen), *([("prior", model_file)] if model_file else [])]
        page = (report, provenance(command, files))
    finish_estimate(result, watch, out, prior, json, origin(run, log), page)
    not_whole(damage_of(log))


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
            help="Also learn the effects of this model, and keep its values where the run determines none.",
        ),
    ] = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Learn the parameters from a run, with the C library that flies.

    Writes a model.toml with value and sigma of each parameter. A parameter that the motion does not determine is left
    out, or taken from --model. The [[effect]] entries of --model (friction, cubic stiffness, torque lag) are learned as
    well, whatever their values; so is a spring_offset of each joint whose zeros the arm file does not vouch for
    (zero_sigma_rad above 0). Exit code 3 when something is undecided; the reason is on stderr and in the JSON. Where
    the arm changed during the run, a warning on stderr and the JSON say when, and in which parameters.

    The page of --report has the verdict with reason and remedy, the parameters with their intervals, what was lost or
    left out, and charts of the motion and of the energy balance.

    Example: zygos estimate out/run.blf -o out/estimate.toml
    """
    estimate_run(run, arm, out, model, json, report, context.obj or ["estimate"])

"""`zygos check`: compares the C library with numpy on a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Json, Report, Run
from zygos.cli.shared import not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.files.output import (
    bad,
    check_outputs,
    good,
    number,
    quiet,
    say,
    table,
    write_json,
)
from zygos.model.model import load_model
from zygos.reference.check import check
from zygos.report.provenance import provenance


def check_run(
    run: Path,
    arm_file: Path | None,
    model_file: Path | None,
    json: str | None,
    report: Path | None,
    command: Sequence[str],
) -> None:
    """Compare C with numpy on a run; see `zygos check --help`."""
    chosen = find_arm(run, arm_file)
    check_outputs([json, report], [run, chosen, run.parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    effects = load_model(model_file).effects if model_file else ()
    recorded = read_run(run, arm)
    found = check(recorded, effects=effects)
    if json:
        write_json(json, {**origin(recorded), **found.as_dict()})
    if report is not None:
        from zygos.reference.page import write_check_report  # noqa: PLC0415  (only a report needs charts)

        files = [("run", run), ("arm", chosen), *([("model", model_file)] if model_file else [])]
        write_check_report(report, found, provenance(command, files), damage=recorded.damage)
    if not quiet(json, report):
        table(
            ("stage", "compared", "largest difference", "at cycle", "tolerance", ""),
            [
                (
                    room.name,
                    f"{room.compared:,}",
                    number(room.difference, 2),
                    "–" if room.cycle is None else str(room.cycle),
                    number(room.tolerance, 2),
                    good("equal") if room.equal else bad("differs"),
                )
                for room in found.stages
            ],
        )
        if recorded.frames is None:
            say("input: table of cycles")
    if found.undecided is not None:
        raise Undecided("; remedy: ".join(found.undecided))
    not_whole(recorded.damage)


def command(
    context: typer.Context,
    run: Run,
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.toml", help="Also compare the columns of this model's effects."),
    ] = None,
    json: Json = None,
    report: Report = None,
) -> None:
    """Compare the C library with numpy on a run, stage by stage.

    The stages are wire and cycles, smoother, rows, normal equations and solution. For each the table has the largest
    difference, the cycle in which it occurs, and the tolerance. The two sides share no code: on numpy's side cantools
    and autosar-e2e decode, a convolution of the whole record smooths, and lstsq solves. The page of --report also draws
    the differences over the cycles of the run.

    Exit code 3 when a stage differs by more than its tolerance, or the run does not determine the parameters.

    Example: zygos check out/run.blf
    """
    check_run(run, arm, model, json, report, context.obj or ["check"])

# SPDX-License-Identifier: MIT
"""`zygos self-test`: compares the C library with numpy on a run."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Details, Json, Report, Run, cuts
from zygos.cli.shared import Wanted, deliver, not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.files.output import check_outputs
from zygos.model.model import load_model
from zygos.reference.check import check
from zygos.reference.sections import answer_of
from zygos.report.provenance import provenance


def check_run(
    run: Path,
    arm_file: Path | None,
    model_file: Path | None,
    wanted: Wanted,
    command: Sequence[str],
) -> None:
    """Compare C with numpy on a run; see `zygos self-test --help`."""
    chosen = find_arm(run, arm_file)
    check_outputs([wanted.json, wanted.report], [run, chosen, run.parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    effects = load_model(model_file).effects if model_file else ()
    recorded = read_run(run, arm)
    found = check(recorded, effects=effects)
    files = [("run", run), ("arm", chosen), *([("model", model_file)] if model_file else [])]
    deliver(
        wanted,
        lambda draw: answer_of(found, draw=draw),
        lambda: {**origin(recorded), **found.as_dict()},
        partial(provenance, command, files),
    )
    if found.undecided is not None:
        raise Undecided("; remedy: ".join(found.undecided))
    not_whole(recorded.damage)


@cuts
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
    details: Details = False,
) -> None:
    """Compare the C library with numpy on a run, stage by stage.

    The stages are wire and cycles, smoother, rows, normal equations and solution. For each the table has the largest
    difference, the cycle in which it occurs, and the tolerance. The two sides share no code: on numpy's side cantools
    and autosar-e2e decode, a convolution of the whole record smooths, and lstsq solves. The page of --report also draws
    the differences over the cycles of the run.

    Exit code 3 when a stage differs by more than its tolerance, or the run does not determine the parameters.

    Example: zygos self-test out/run.blf
    """
    check_run(run, arm, model, Wanted(json, report, details), context.obj or ["self-test"])

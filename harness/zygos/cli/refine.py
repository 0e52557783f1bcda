# SPDX-License-Identifier: MIT
"""`zygos refine`: parameters near the information limit from one or several recorded runs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Details, Json, Out, Report, Runs, cuts
from zygos.cli.shared import Wanted, check_model_name, deliver, not_whole, read_runs
from zygos.errors import Undecided
from zygos.files.output import check_outputs, named
from zygos.files.progress import progress
from zygos.model.model import load_model, save_model
from zygos.refinement.refine import refine_runs
from zygos.refinement.search import REMEDY
from zygos.refinement.sections import answer_of
from zygos.report.provenance import provenance


def refine_files(
    runs: Sequence[Path],
    arm_file: Path | None,
    out: Path | None,
    model_file: Path | None,
    wanted: Wanted,
    called: Sequence[str],
) -> None:
    """Refine from recorded runs; see `zygos refine --help`."""
    chosen = find_arm(runs[0], arm_file)
    check_model_name(out)
    check_outputs([out, wanted.json, wanted.report], [*runs, chosen, runs[0].parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    model = load_model(model_file) if model_file else None
    recorded = read_runs(runs, arm_file, chosen, arm)
    with progress() as bar:
        task = bar.add_task("refining", total=1.0)
        found = refine_runs(recorded, model=model, progress=lambda share: bar.update(task, completed=share))
    where = f"{named(out)} written" if found.published and out else "no model written"
    files = [*(("run", path) for path in runs), ("arm", chosen), *([("prior", model_file)] if model_file else [])]
    damage = [text for run in recorded for text in run.damage]
    heading = {"runs": [str(path) for path in runs], "damage": damage or None}
    deliver(
        wanted,
        lambda draw: answer_of(found, written=where, damage=damage, draw=draw),
        lambda: found.as_dict(heading),
        partial(provenance, called, files),
        out,
        save=(lambda: save_model(found.to_model(), out)) if found.published and out else None,
    )
    if not found.published:
        raise Undecided(f"not published: {found.reason} ({where}); remedy: {REMEDY}")
    not_whole(*(run.damage for run in recorded))


@cuts
def command(
    context: typer.Context,
    run: Runs,
    out: Out = None,
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PRIOR.toml",
            help="Also estimate the Coulomb frictions of motors and the offsets of torques of this model, and begin "
            "with its values where energy rows determine none.",
        ),
    ] = None,
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Refine the parameters of an arm up to what its frames tell at most.

    Beginning with the estimate of `zygos estimate`, states and parameters are solved from all readings at once, with
    the equations of motion. Where the model is complete, its values are several to many times better, and about as
    good as `zygos bound` allows. Several runs give one estimate. Lost cycles are bridged, and over long gaps the state
    begins anew.

    Such a fit cannot notice all that its model lacks. The model is therefore written only if all of this holds: the
    estimate from energy rows is not doubtful and agrees; the innovations of all sensors are as small as expected,
    over the whole record and in twelve windows; the noise of the torques that the readings need is not above the
    torque_relative_sigma of arm.toml; and a delay of the torques, another gain of one joint, friction or an offset does
    not follow the readings better. Otherwise the exit code is 3, no model is written, and the message says what failed.

    All joints are flexible, and the torques are held from SYNC to SYNC. Effects other than motor_coulomb and
    torque_offset are refused.

    The page of --report shows the rules, the innovations, the way of each parameter, and the distance from the bound.

    Example: zygos refine out/run.blf -o out/refined.toml --report out/refined.html
    """
    refine_files(run, arm, out, model, Wanted(json, report, details), context.obj or ["refine"])

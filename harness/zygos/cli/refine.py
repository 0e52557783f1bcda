"""`zygos refine`: parameters near the information limit from one or several recorded runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import find_arm
from zygos.cli.options import ArmFile, Json, Report, Runs
from zygos.cli.shared import check_model_name, not_whole, read_runs
from zygos.errors import Undecided
from zygos.files.output import check_outputs, counted, named, number, quiet, ratio, say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import load_model, save_model
from zygos.native.flight import CHANNELS
from zygos.refinement.refine import Refinement, refine_runs
from zygos.refinement.search import REMEDY
from zygos.report.provenance import provenance


def refine_files(
    runs: Sequence[Path],
    arm_file: Path | None,
    out: Path,
    model_file: Path | None,
    json: str | None,
    report: Path | None,
    called: Sequence[str],
) -> None:
    """Refine from recorded runs; see `zygos refine --help`."""
    chosen = find_arm(runs[0], arm_file)
    check_model_name(out)
    check_outputs([out, json, report], [*runs, chosen, runs[0].parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    model = load_model(model_file) if model_file else None
    recorded = read_runs(runs, arm_file, chosen, arm)
    with progress() as bar:
        task = bar.add_task("refining", total=1.0)
        found = refine_runs(recorded, model=model, progress=lambda share: bar.update(task, completed=share))
    if not quiet(out, json, report):
        _tables(found)
    where = f"{named(out)} written" if found.published else "no model written"
    try:
        if found.published:
            save_model(found.to_model(), out)
        if report is not None:
            from zygos.refinement.page import write_refine_report  # noqa: PLC0415  (only a report needs charts)

            files = [
                *(("run", path) for path in runs),
                ("arm", chosen),
                *([("prior", model_file)] if model_file else []),
            ]
            damage = [text for run in recorded for text in run.damage]
            write_refine_report(report, found, provenance(called, files), written=where, damage=damage)
    finally:
        if json:
            damage = [text for run in recorded for text in run.damage]
            write_json(json, found.as_dict({"runs": [str(path) for path in runs], "damage": damage or None}))
    if not found.published:
        raise Undecided(f"not published: {found.reason} ({where}); remedy: {REMEDY}")
    not_whole(*(run.damage for run in recorded))


def _tables(found: Refinement) -> None:
    if found.published:
        bound = ["–"] * len(found.names) if found.times_bound is None else [number(x, 3) for x in found.times_bound]
        rows = [
            (name, unit, number(value, 8), number(half, 2), number(100.0 * ratio(half, abs(value)), 2), times)
            for name, unit, value, half, times in zip(
                found.names, found.units, found.value.tolist(), found.half95.tolist(), bound, strict=True
            )
        ]
        effects = [
            (f"{one.kind.key} {one.joint}", one.kind.unit, number(one.value), number(1.96 * one.sigma, 2), "", "")
            for one in found.effects
        ]
        table(("name", "unit", "estimate", "±95 %", "in %", "σ, × bound"), [*rows, *effects])
    table(
        ("what is checked", "found", "passes up to", ""),
        [
            (rule.title, number(rule.value, 3), number(rule.limit, 3), "holds" if rule.holds else "FAILS")
            for rule in found.rules
        ],
    )
    levels = ", ".join(
        f"{joint.name} {100.0 * level:.2g} % (declared {100.0 * declared:.2g} %)"
        for joint, level, declared in zip(found.arm.joints, found.level, found.declared, strict=True)
    )
    squares = ", ".join(
        f"{channel} {number(mean, 3)}"
        for channel, mean, count in zip(CHANNELS, found.squares.tolist(), found.final.counts, strict=True)
        if count
    )
    say(
        f"arm {found.arm.name} · {counted(found.record.cycles, 'cycle')} in "
        f"{counted(len(found.record.pieces), 'piece')}, {found.record.lost:,} lost in them, "
        f"{found.record.left_out:,} left out · start: the estimate from energy rows, {found.energy.validity}"
    )
    say(f"noise of the torques: {levels}")
    say(f"mean square of the innovations, 1 is expected: {squares}")


def command(
    context: typer.Context,
    run: Runs,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="BETTER.toml", help="The model to write.")],
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
    refine_files(run, arm, out, model, json, report, context.obj or ["refine"])

"""`zygos check`: the C library beside numpy on a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.cli.options import ArmFile, Json, Report, Run
from zygos.cli.shared import damage_of, find_arm, not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.estimation.remedies import remedy
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
from zygos.files.tables import is_table
from zygos.model.model import load_model
from zygos.native.flight import Flight
from zygos.reference.compare import Room, check_cycles, check_frames
from zygos.report.provenance import provenance
from zygos.runs.tables import read_cycles


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
    flight = Flight(arm, load_model(model_file).effects if model_file else ())
    log = None if is_table(run) else read_run(run)
    rooms = check_cycles(arm, read_cycles(run, arm), flight) if log is None else check_frames(arm, log.frames, flight)
    undecided = _undecided(rooms, flight)
    if json:
        write_json(json, {**origin(run, log), "arm": arm.name, "rooms": [room.as_json() for room in rooms]})
    if report is not None:
        from zygos.reference.page import write_check_report  # noqa: PLC0415  (only a report needs charts)

        files = [("run", run), ("arm", chosen), *([("model", model_file)] if model_file else [])]
        write_check_report(report, arm, rooms, undecided, damage_of(log), provenance(command, files))
    if not quiet(json, report):
        table(
            ("room", "compared", "largest difference", "at cycle", "tolerance", ""),
            [
                (
                    room.name,
                    f"{room.compared:,}",
                    number(room.difference, 2),
                    "–" if room.cycle is None else str(room.cycle),
                    number(room.tolerance, 2),
                    good("equal") if room.equal else bad("differs"),
                )
                for room in rooms
            ],
        )
        if is_table(run):
            say("door: cycle")
    if undecided:
        what, advice = undecided
        raise Undecided(f"{what}; remedy: {advice}")
    not_whole(damage_of(log))


def _undecided(rooms: Sequence[Room], flight: Flight) -> tuple[str, str] | None:
    """What differs or is missing, and the remedy; None where all is equal."""
    failed = [room.name for room in rooms if not room.equal]
    if failed:
        return f"C and numpy differ in: {', '.join(failed)}", "report the run, it is worth a look"
    if rooms[-1].name != "solution":
        result = flight.estimate()
        return f"no solution to compare, {result.validity}: {result.reason}", remedy(result, flight)
    return None


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
    """Compare the C library with numpy on a run, room by room.

    The rooms are wire and cycles, smoother, rows, normal equations and solution. For each the table has the largest
    difference, the cycle where it is found, and the tolerance. The two sides share no code: on numpy's side cantools
    and autosar-e2e decode, a convolution of the whole record smooths, and lstsq solves. The page of --report also draws
    the differences over the cycles of the run.

    Exit code 3 when a room differs by more than its tolerance, or the run does not determine the parameters.

    Example: zygos check out/run.blf
    """
    check_run(run, arm, model, json, report, context.obj or ["check"])

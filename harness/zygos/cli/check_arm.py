"""`zygos check-arm`: compares a run with its arm file, and prints the result as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.audit import Audit
from zygos.audit.answer import advice, summary
from zygos.audit.check import check_arm
from zygos.cli.options import Json, Report, Run
from zygos.cli.shared import not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.files.output import check_outputs, counted, good, number, quiet, say, table, write_json
from zygos.files.progress import progress
from zygos.report.provenance import provenance


def check_arm_run(arm_file: Path, run: Path, json: str | None, report: Path | None, command: Sequence[str]) -> None:
    """Audit a run against an arm file; see `zygos check-arm --help`."""
    check_outputs([json, report], [run, arm_file])
    arm = load_arm(arm_file)
    recorded = read_run(run, arm)
    with progress() as bar:
        task = bar.add_task("comparing", total=1.0)
        found = check_arm(recorded, progress=lambda share: bar.update(task, completed=share))
    if json:
        write_json(json, {**origin(recorded), **found.as_dict()})
    if report is not None:
        from zygos.audit.page import write_audit_report  # noqa: PLC0415  (only a report needs charts)

        write_audit_report(report, recorded, found.audit, provenance(command, [("arm", arm_file), ("run", run)]))
    if not quiet(json, report):
        show_audit(found.audit)
        seen = [f"{name} {count:,}" for name, count in recorded.faults.items() if count]
        say(f"arm {arm.name} · {counted(len(recorded), 'cycle')}" + (f" · faults: {', '.join(seen)}" if seen else ""))
    if not found.ok:
        raise Undecided(f"{summary(found.audit)}; remedy: {advice(found.audit)}")
    not_whole(recorded.damage)


def show_audit(found: Audit) -> None:
    """Print the results."""
    table(
        ("signal", "unit", "rate %", "low", "high", "steps", "declared", "noise", "declared", "verdict"),
        [
            (
                s.name,
                s.unit,
                number(100 * s.share, 4),
                number(s.low, 4),
                number(s.high, 4),
                number(s.step, 3),
                number(s.quantum, 3),
                number(s.noise, 2),
                number(s.declared, 2),
                good(s.verdict) if s.verdict == "ok" else s.verdict,
            )
            for s in found.signals
        ],
    )
    if found.pairs:
        table(
            ("encoders of", "motor newer by ms", "±", "zero mrad", "±", "k as read", "k without skew"),
            [
                (
                    p.joint,
                    number(1e3 * p.skew_s, 3),
                    number(1e3 * p.skew_sigma_s, 1),
                    number(1e3 * p.zero_rad, 3),
                    number(1e3 * p.zero_sigma_rad, 1),
                    number(p.stiffness, 3),
                    number(p.stiffness_unskewed, 3),
                )
                for p in found.pairs
            ],
        )
    for f in found.findings:
        say(f"{f.signal}: {f.fault} ({f.evidence}); remedy: {f.remedy}")
    for text in found.notes:
        say(f"open: {text}")


def command(
    context: typer.Context,
    arm: Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.")],
    run: Run,
    json: Json = None,
    report: Report = None,
) -> None:
    """Check a run against its arm file: rate, range, steps and noise of each signal, and whether the signals agree.

    Reports signals that are swapped, inverted, scaled by the gear ratio, stuck or saturated, a skew in time between the
    two encoders of a joint, zeros that are off, a wrong torque law, and a smoother that flattens the motion, each with
    the evidence in numbers and the remedy. No model is needed. The page of --report has all of it, with charts of the
    readings.

    Exit code 3 when something is found, or the run does not confirm every signal.

    Example: zygos check-arm out/arm.toml out/run.blf
    """
    check_arm_run(arm, run, json, report, context.obj or ["check-arm"])

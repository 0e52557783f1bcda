"""`zygos check-arm`: what a run says of its arm file, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from zygos.arm import Arm, load_arm
from zygos.audit import Audit, Traffic, audit, signal_names
from zygos.audit.answer import advice, as_json, summary
from zygos.can.wire import identifiers
from zygos.cli.options import Json, Report, Run
from zygos.cli.shared import damage_of, not_whole, origin, read_run
from zygos.errors import Undecided
from zygos.files.output import check_outputs, counted, good, number, quiet, say, table, write_json
from zygos.files.progress import progress
from zygos.files.tables import is_table
from zygos.native.flight import Flight, ffi, lib
from zygos.report.provenance import provenance
from zygos.runs.cycles import Cycles
from zygos.runs.tables import read_cycles

_SYNC, _FTIME = 0x080, 0x3A0
_ACCEPTED = 1


def check_arm_run(arm_file: Path, run: Path, json: str | None, report: Path | None, command: Sequence[str]) -> None:
    """Audit a run against an arm file; see `zygos check-arm --help`."""
    check_outputs([json, report], [run, arm_file])
    arm = load_arm(arm_file)
    log = None if is_table(run) else read_run(run)
    if log is None:
        cycles, traffic, faults = read_cycles(run, arm), Traffic(), dict[str, int]()
    else:
        cycles, traffic, faults = listen_to(arm, log.frames)
    with progress() as bar:
        task = bar.add_task("comparing", total=1.0)
        found = audit(arm, cycles, traffic, lambda share: bar.update(task, completed=share))
    if json:
        write_json(json, {**origin(run, log), "arm": arm.name, "ok": found.ok, "faults": faults, **as_json(found)})
    if report is not None:
        from zygos.audit.page import write_audit_report  # noqa: PLC0415  (only a report needs charts)

        source = provenance(command, [("arm", arm_file), ("run", run)])
        write_audit_report(report, arm, cycles, found, faults, damage_of(log), source)
    if not quiet(json, report):
        show(found)
        seen = [f"{name} {count:,}" for name, count in faults.items() if count]
        say(f"arm {arm.name} · {counted(len(cycles), 'cycle')}" + (f" · faults: {', '.join(seen)}" if seen else ""))
    if not found.ok:
        raise Undecided(f"{summary(found)}; remedy: {advice(found)}")
    not_whole(damage_of(log))


def show(found: Audit) -> None:
    """Print what was found."""
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


def listen_to(arm: Arm, frames: NDArray[Any]) -> tuple[Cycles, Traffic, dict[str, int]]:
    """What the C receiver makes of a log: its cycles, what only the frames show, and its fault counters."""
    frames = np.ascontiguousarray(frames)
    judge = Flight(arm)
    verdicts = np.zeros(len(frames), dtype=np.uint8)
    lib.zygos_batch_frames(
        judge.native,
        ffi.cast("zygos_frame_t *", frames.ctypes.data),
        len(frames),
        ffi.cast("uint8_t *", verdicts.ctypes.data),
        ffi.NULL,
    )
    trace = Flight(arm).frames(frames, trace=True)
    assert trace is not None
    return trace.cycles, _traffic(arm, frames, verdicts == _ACCEPTED), judge.faults


def _traffic(arm: Arm, frames: NDArray[Any], accepted: NDArray[np.bool_]) -> Traffic:
    syncs = (frames["id"] == _SYNC) & accepted
    counters = frames["data"][syncs, 0].astype(np.int64)
    if len(counters) < 2:
        return Traffic(share={name: 0.0 for name, _, _ in signal_names(arm)})
    numbers = np.concatenate([[0], np.cumsum(np.diff(counters) % 240)])
    expected = int(numbers[-1])  # the last SYNC opens a cycle that nothing closes
    number_at = np.concatenate([[0], numbers])[np.cumsum(syncs)]
    share, saturated = {}, {}
    parts = {kind.part: identifier for identifier, kind in identifiers(arm).items()}
    coarse = arm.imu.resolution == "coarse"
    for name, kind, i in signal_names(arm):
        if kind == "omega":
            part, first, width = (
                ("rate", 2 + 2 * i, 2) if coarse else (("rate_xy", "rate_xy", "rate_z")[i], (2, 5, 2)[i], 3)
            )
        else:
            part, first, width = f"{'torque' if kind == 'tau' else 'angles'}{i}", 2, 3
        ours = frames["id"] == parts[part]
        share[name] = min(1.0, float(np.sum(ours & accepted)) / expected)
        if kind in ("tau", "omega"):
            data = frames["data"][ours & ~accepted, first : first + width].astype(np.int64)
            codes = (data << (8 * np.arange(width))).sum(axis=1)
            half = 1 << (8 * width - 1)
            saturated[name] = int(np.sum((codes == half) | (codes == half - 1)))
    times = (frames["id"] == _FTIME) & accepted
    micros = (frames["data"][times, 3:7].astype(np.int64) << (8 * np.arange(4))).sum(axis=1)
    period = float("nan")
    if len(micros) > 2:
        steps = (np.diff(micros) + 2**31) % 2**32 - 2**31
        cycles = np.diff(number_at[times])
        # the median keeps a clock that started anew out of it
        period = float(np.median(1e-6 * steps[cycles > 0] / cycles[cycles > 0])) if np.any(cycles > 0) else period
    return Traffic(share, saturated, period)


def command(
    context: typer.Context,
    arm: Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.")],
    run: Run,
    json: Json = None,
    report: Report = None,
) -> None:
    """Hold a run against its arm file: rate, range, steps and noise of each signal, and whether the signals agree.

    Names signals that are swapped, inverted, scaled by the gear ratio, stuck or saturated, a skew in time between the
    two encoders of a joint, zeros that are off, and a wrong torque law; each with the number that says how sure it is,
    and the remedy. No model is needed. The page of --report has all of it, with the readings as charts.

    Exit code 3 when something is found, or the run does not confirm every signal.

    Example: zygos check-arm out/arm.toml out/run.blf
    """
    check_arm_run(arm, run, json, report, context.obj or ["check-arm"])

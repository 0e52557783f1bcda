# SPDX-License-Identifier: MIT
"""`zygos listen`: estimates while frames arrive."""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import can
import typer

from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.can.dbc import arm_database
from zygos.can.rounds import Telemetry
from zygos.cli.estimated import finish_estimate
from zygos.cli.live import Screen
from zygos.cli.onboard import report_refined
from zygos.cli.options import Bitrate, ChannelOption, Details, Interface, Json, Out, Report
from zygos.cli.shared import Wanted, check_model_name
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import Estimation, conclude
from zygos.estimation.watch import Watch
from zygos.files.output import check_outputs, counted, named, note, quiet
from zygos.files.signals import stop_signals
from zygos.model.model import Model, load_model
from zygos.native.flight import Flight
from zygos.report.provenance import provenance


def listen_bus(
    arm_file: Path,
    out: Path | None,
    model_file: Path | None,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    log: Path | None,
    duration: float,
    idle: float,
    wanted: Wanted,
) -> None:
    """Estimate while frames arrive; see `zygos listen --help`."""
    arm = load_arm(arm_file)
    _check_files(out, log, wanted, [arm_file, model_file])
    prior = load_model(model_file) if model_file else None
    flight = (watch := watched(arm, prior, trace=wanted.report is not None)).flight
    telemetry = Telemetry(arm_database(arm, flight.effects))
    batch: list[can.Message] = []
    failures: list[ZygosError] = []
    where = f"{interface or 'can.conf'} {channel or ''}".strip()

    def fail(error: ZygosError) -> None:
        note(str(error))
        failures.append(error)

    with bus.open_bus(interface, channel, bitrate) as source, stop_signals() as stopped:
        recording = bus.LogWriter(log) if log is not None else None

        def work_off() -> None:
            nonlocal recording
            watch.frames(bus.from_messages(batch))
            try:
                if recording is not None:
                    recording.append(batch)
            except ZygosError as error:
                recording = None
                fail(error)
            batch.clear()

        note(f"listening to {where}; Ctrl-C ends, with the estimate so far")
        begin = time.monotonic()
        try:
            with Screen(watch) as screen:
                for message in bus.received_messages(
                    source, idle, lambda: stopped() or (duration > 0.0 and time.monotonic() - begin > duration)
                ):
                    batch.append(message)
                    telemetry.take(message)
                    due = screen.due()
                    if due or len(batch) >= 256:
                        work_off()
                    if due:
                        screen.show()
        except can.CanError as error:
            fail(
                Undecided(
                    f"{where} failed while listening ({error}), the estimate so far is written; remedy: check "
                    "that the interface is up, and listen again"
                )
            )
        work_off()
        if stopped():
            note(_kept(flight, out, log if recording is not None else None))
    if recording is not None:
        try:
            recording.finish()
        except ZygosError as error:
            fail(error)
    refined = report_refined(telemetry, arm, shown=not quiet(out, wanted.json))
    _end(conclude(watch, prior=prior), out, {"bus": where, "door": "frames", "refined": refined}, wanted)
    if failures:
        sys.exit(failures[0].exit_code)


def _kept(flight: Flight, out: Path | None, log: Path | None) -> str:
    """What remains of a listening that was stopped."""
    estimate = f"stopped; the estimate is of {counted(flight.counts['cycles'], 'cycle')}"
    if out is not None:
        estimate += f" and goes to {named(out)}"
    return estimate + (f", and the frames to {named(log)}" if log is not None else "")


def _end(found: Estimation, out: Path | None, heading: dict[str, Any], wanted: Wanted) -> None:
    finish_estimate(found, out, heading, wanted, partial(provenance, ["listen"], []))


def _check_files(out: Path | None, log: Path | None, wanted: Wanted, inputs: list[Path | None]) -> None:
    """Refuse outputs that have a wrong suffix or would replace an input."""
    check_model_name(out)
    if log is not None:
        bus.check_log_name(log)
    check_outputs([out, log, wanted.json, wanted.report], inputs)


def watched(arm: Arm, prior: Model | None, *, trace: bool = False) -> Watch:
    """The estimator of an arm, with the effects of a model; trace: as of `Watch`. Errors: ZygosError where the effects
    do not fit."""
    if prior is None:
        return Watch(Flight(arm), trace=trace)
    prior.base_parameters(arm)
    return Watch(Flight(arm, prior.effects), trace=trace)


def command(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    out: Out = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PRIOR.toml",
            help="Also estimate the effects of this model, and use its values where the run determines none.",
        ),
    ] = None,
    interface: Interface = None,
    channel: ChannelOption = None,
    bitrate: Bitrate = None,
    log: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Also record the frames in this CAN log, which appears at the end."),
    ] = None,
    duration: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="Stop after so many seconds; 0: no limit.")
    ] = 0.0,
    idle: Annotated[
        float,
        typer.Option(
            metavar="S", min=0.1, help="Stop so many seconds after the last SYNC; the first may take 10 times as long."
        ),
    ] = 2.0,
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Listen to a bus and estimate while the frames arrive. Ctrl-C or SIGTERM ends it and writes the estimate so far.

    On a terminal, a table shows the values with their 95 % intervals, the residual, and the cycles and frames that were
    lost; elsewhere there is a line every two seconds. *learning* means that there is too little data so far.

    At the end, table and JSON give the significance of each effect of --model: its value in standard deviations.

    If a flight computer on the bus refines its estimate (zygos-node --refine), they also give the newest result that it
    told: the refined values where they are published, otherwise why they are not, and the innovations of each kind of
    sensor.

    Exit code 3 when the estimate is doubtful or refused, or the bus failed; the estimate so far is written
    nevertheless.

    Example: zygos listen -i socketcan -c vcan0 --arm examples/paper/arm.toml -o out/live.toml
    """
    listen_bus(arm, out, model, interface, channel, bitrate, log, duration, idle, Wanted(json, report, details))

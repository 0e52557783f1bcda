# SPDX-License-Identifier: MIT
"""`zygos listen`: estimates while frames arrive."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import can
import typer
from rich.table import Table

from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.can.dbc import arm_database
from zygos.can.rounds import Telemetry
from zygos.can.run import Run
from zygos.cli.driven import Drive, Eds, Nodes, Urdf, arm_file_of, named_drives
from zygos.cli.estimated import finish_estimate, finish_ground
from zygos.cli.live import Screen, line_of, table_of
from zygos.cli.onboard import report_refined
from zygos.cli.options import Bitrate, ChannelOption, Details, Interface, Json, Out, Report, of_arm
from zygos.cli.shared import Wanted, check_model_name, warn
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import conclude
from zygos.estimation.watch import Watch
from zygos.files.output import check_outputs, counted, named, note, number, quiet
from zygos.files.signals import stop_signals
from zygos.ground.estimate import estimate_ground
from zygos.model.model import Model, load_model
from zygos.native.flight import Flight
from zygos.report.provenance import provenance
from zygos.telemetry.convert import converted
from zygos.telemetry.drives import Drives
from zygos.telemetry.frames import Decoder
from zygos.telemetry.map import SI_UNIT


class _Frames:
    """Frames of an arm, from which the C library estimates while they arrive."""

    def __init__(self, arm: Arm, prior: Model | None, *, trace: bool) -> None:
        self.watch = watched(arm, prior, trace=trace)
        self.telemetry = Telemetry(arm_database(arm, self.watch.flight.effects))

    def counts(self, message: can.Message) -> bool:
        self.telemetry.take(message)
        return bus.is_sync(message)

    def feed(self, batch: Sequence[can.Message]) -> None:
        self.watch.frames(bus.from_messages(batch))

    def line(self) -> str:
        return line_of(self.watch, self.watch.flight.estimate())

    def table(self) -> Table:
        return table_of(self.watch, self.watch.flight.estimate())

    def kept(self) -> str:
        return f"the estimate is of {counted(self.watch.flight.counts['cycles'], 'cycle')}"


class _Answers:
    """Frames of drives, whose signals are kept for an estimate at the end."""

    def __init__(self, arm: Arm, drives: Drives, scatter: bool) -> None:
        """scatter: as of `converted`."""
        self.arm, self.mapping, self.scatter = arm, drives.mapping(arm), scatter
        self.decoder = Decoder(drives.dictionary(), self.mapping)

    def counts(self, message: can.Message) -> bool:
        return self.decoder.take(message)

    def feed(self, batch: Sequence[can.Message]) -> None:
        """Nothing: each message was taken when it came."""

    def line(self) -> str:
        newest = self.decoder.newest()
        silent = [channel.label for channel, count, _ in newest if not count]
        heard = f"{len(newest) - len(silent)}/{len(newest)} signals"
        damaged = f" · {self.decoder.damaged:,} damaged" if self.decoder.damaged else ""
        return f"{counted(self.decoder.taken, 'frame')} · {heard}{damaged}" + (
            f" · silent: {', '.join(silent)}" if silent else ""
        )

    def table(self) -> Table:
        table = Table(caption=self.line(), caption_justify="left")
        for heading in ("signal", "newest", "unit", "samples"):
            table.add_column(heading, justify="right" if heading in ("newest", "samples") else "left")
        for channel, count, value in self.decoder.newest():
            unit = self.arm.torque_unit if channel.quantity == "torque" else SI_UNIT[channel.quantity]
            table.add_row(channel.label, "–" if value is None else number(value, 4), unit, f"{count:,}")
        return table

    def kept(self) -> str:
        return f"the estimate is of {counted(self.decoder.taken, 'frame')}"

    def run(self, where: str) -> Run:
        """What was heard, on the grid of the arm, with warnings about it. Errors: as `Decoder.recording` and
        `converted`."""
        result = converted(self.decoder.recording(Path(where)), self.mapping, self.arm, self.scatter)
        warn(result.warnings)
        return Run(result.arm, table=result.cycles)


@dataclass(frozen=True)
class _Bus:
    """The bus to listen on, and until when."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    duration: float
    idle: float

    def __str__(self) -> str:
        return f"{self.interface or 'can.conf'} {self.channel or ''}".strip()


def listen_bus(
    arm: Arm,
    inputs: Sequence[Path | None],
    out: Path | None,
    model_file: Path | None,
    source: _Bus,
    log: Path | None,
    wanted: Wanted,
    drives: Drives | None = None,
    scatter: bool = False,
) -> None:
    """Estimate while frames arrive; see `zygos listen --help`. inputs: the files that outputs may not replace; scatter:
    as of `converted`."""
    _check_files(out, log, wanted, [*inputs, model_file])
    prior = load_model(model_file) if model_file else None
    if drives is None:
        heard = _Frames(arm, prior, trace=wanted.report is not None)
        failures = _hear(heard, source, out, log)
        refined = report_refined(heard.telemetry, arm, shown=not quiet(out, wanted.json))
        heading = {"bus": str(source), "door": "frames", "refined": refined}
        found = conclude(heard.watch, prior=prior)
        finish_estimate(found, out, heading, wanted, partial(provenance, ["listen"], []))
    else:
        if not arm.grounded:
            raise ZygosError(
                f"--drive: arm {arm.name} floats or has flexible joints, and its estimate at the end is that of an arm "
                "on the ground with rigid ones; remedy: record (candump -L), and use `zygos convert --drive`"
            )
        answers = _Answers(arm, drives, scatter)
        failures = _hear(answers, source, out, log)
        learned = estimate_ground([answers.run(str(source))], model=prior)
        finish_ground(learned, out, wanted, partial(provenance, ["listen"], []))
    if failures:
        sys.exit(failures[0].exit_code)


def _hear(heard: _Frames | _Answers, source: _Bus, out: Path | None, log: Path | None) -> list[ZygosError]:
    """Hear what comes until nothing comes any more, and record it. Returns what failed meanwhile."""
    batch: list[can.Message] = []
    failures: list[ZygosError] = []

    def fail(error: ZygosError) -> None:
        note(str(error))
        failures.append(error)

    with bus.open_bus(source.interface, source.channel, source.bitrate) as opened, stop_signals() as stopped:
        recording = bus.LogWriter(log) if log is not None else None

        def work_off() -> None:
            nonlocal recording
            heard.feed(batch)
            try:
                if recording is not None:
                    recording.append(batch)
            except ZygosError as error:
                recording = None
                fail(error)
            batch.clear()

        note(f"listening to {source}; Ctrl-C ends, with the estimate so far")
        begin = time.monotonic()

        def ended() -> bool:
            return stopped() or (source.duration > 0.0 and time.monotonic() - begin > source.duration)

        try:
            with Screen(heard) as screen:
                for message in bus.received_messages(opened, source.idle, ended, heard.counts):
                    batch.append(message)
                    due = screen.due()
                    if due or len(batch) >= 256:
                        work_off()
                    if due:
                        screen.show()
        except can.CanError as error:
            fail(
                Undecided(
                    f"{source} failed while listening ({error}), the estimate so far is written; remedy: check "
                    "that the interface is up, and listen again"
                )
            )
        work_off()
        if stopped():
            note(_kept(heard.kept(), out, log if recording is not None else None))
    if recording is not None:
        try:
            recording.finish()
        except ZygosError as error:
            fail(error)
    return failures


def _kept(estimated: str, out: Path | None, log: Path | None) -> str:
    """What remains of a listening that was stopped."""
    estimate = f"stopped; {estimated}"
    if out is not None:
        estimate += f" and goes to {named(out)}"
    return estimate + (f", and the frames to {named(log)}" if log is not None else "")


def _check_files(out: Path | None, log: Path | None, wanted: Wanted, inputs: Sequence[Path | None]) -> None:
    """Refuse outputs that have a wrong suffix or would replace an input."""
    check_model_name(out)
    if log is not None:
        bus.check_log_name(log)
    check_outputs([out, log, wanted.json, wanted.report], list(inputs))


def watched(arm: Arm, prior: Model | None, *, trace: bool = False) -> Watch:
    """The estimator of an arm, with the effects of a model; trace: as of `Watch`. Errors: ZygosError where the effects
    do not fit."""
    if prior is None:
        return Watch(Flight(arm), trace=trace)
    prior.base_parameters(arm)
    return Watch(Flight(arm, prior.effects), trace=trace)


def command(
    arm: Annotated[
        Path | None,
        typer.Option("--arm", metavar="ARM.toml", help="The arm file. Needed unless --urdf is given.", callback=of_arm),
    ] = None,
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
            metavar="S",
            min=0.1,
            help="Stop so many seconds after the last SYNC, or frame of a drive; the first may take 10 times as long.",
        ),
    ] = 2.0,
    drive: Drive = None,
    nodes: Nodes = None,
    eds: Eds = None,
    urdf: Urdf = None,
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

    With --drive, the frames are those of drives (classical, of 29 bits, or CAN FD) of an arm on the ground with rigid
    joints. The table shows the newest angles and torques and how many came; at the end they are brought to the grid of
    the arm as `zygos convert` does, and estimated as `zygos estimate` does.

    Exit code 3 when the estimate is doubtful or refused, or the bus failed; the estimate so far is written
    nevertheless.

    Example: zygos listen -i socketcan -c vcan0 --arm examples/paper/arm.toml -o out/live.toml

    Example: zygos listen -i socketcan -c can0 --drive damiao --nodes 1-7 --urdf arm.urdf -o out/live.toml
    """
    drives = named_drives(drive, nodes, eds, arm, urdf)
    source = _Bus(interface, channel, bitrate, duration, idle)
    wanted = Wanted(json, report, details)
    with arm_file_of(arm, urdf, drives, "listen") as described:
        if described is None:
            raise ZygosError("the arm is not described; remedy: give its file with --arm, or with --drive its --urdf")
        known = load_arm(described)
    listen_bus(known, [arm, urdf], out, model, source, log, wanted, drives, scatter=urdf is not None)

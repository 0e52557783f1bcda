# SPDX-License-Identifier: MIT
"""`zygos simulate`: simulates a scenario and records the run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import can
import numpy as np
import typer

from zygos.arm import load_arm
from zygos.can import bus
from zygos.cli.driven import Drive, Eds, Nodes, named_drives
from zygos.cli.options import Bitrate, ChannelOption, Interface, Json, Mcap
from zygos.dynamics.equations import ENGINES
from zygos.errors import ZygosError
from zygos.files.mcap import check_mcap_name, write_mcap
from zygos.files.output import (
    check_outputs,
    counted,
    is_dash,
    named,
    number,
    quiet,
    say,
    table,
    write_bytes,
    write_json,
)
from zygos.files.progress import progress
from zygos.model.model import load_model
from zygos.native.flight import encode
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import load_scenario
from zygos.telemetry.drives import Drives
from zygos.telemetry.frames import Encoder
from zygos.telemetry.published import measured


def simulate_run(
    scenario_file: Path,
    out: Path,
    model_file: Path | None,
    seed: int | None,
    noise: bool | None,
    engine: str,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    json: str | None,
    mcap: Path | None = None,
    drives: Drives | None = None,
) -> None:
    """Simulate a scenario and record its traffic; see `zygos simulate --help`."""
    if not is_dash(out):
        bus.check_log_name(out)
    check_mcap_name(mcap)
    chosen = next((name for name in ENGINES if name == engine), None)
    if chosen is None:
        raise ZygosError(f"there is no engine {engine!r}; remedy: use one of {', '.join(ENGINES)}")
    scenario = load_scenario(scenario_file)
    arm_file = scenario.arm
    arm = load_arm(arm_file)
    beside = None if is_dash(out) else out.parent / "arm.toml"
    check_outputs([out, json, mcap], [scenario_file, arm_file, scenario.plant, model_file, beside])
    if beside and beside.exists() and beside.read_bytes() != arm_file.read_bytes():
        raise ZygosError(
            f"{beside} describes a different arm than {arm_file}; remedy: write the run into another folder, or "
            "remove that file"
        )
    if seed is not None:
        scenario = replace(scenario, seed=seed)
    model = load_model(model_file or scenario.plant)
    encoder = Encoder(drives.dictionary(), drives.mapping(arm)) if drives else None
    wanted = interface is not None or channel is not None
    with bus.open_bus(interface, channel, bitrate) if wanted else nullcontext() as wire:
        with progress() as bar:
            task = bar.add_task("simulating", total=1.0)
            trajectory = simulate(
                arm,
                model,
                scenario,
                engine=chosen,
                noise=noise,
                progress=lambda share: bar.update(task, completed=share),
            )
        cycles = trajectory.cycles(0)
        messages = encoder.messages(cycles, arm) if encoder else bus.to_messages(encode(arm, cycles), arm.period_s)
        bus.write_messages(out, messages)
        if beside and not beside.exists():
            write_bytes(beside, arm_file.read_bytes())
        if mcap:
            write_mcap(mcap, measured(arm, cycles), {"effort": arm.unit("Nm")})
        if wire is not None:
            send(wire, messages, out)
    ranges = [
        ("rotor torque", "Nm", float(np.abs(cycles.tau).max())),
        ("link angle", "rad", float(np.abs(cycles.q).max())),
        ("deflection", "rad", float(np.abs(cycles.theta - cycles.q).max())),
        ("base rate", "rad/s", float(np.abs(cycles.omega).max())),
    ]
    summary = {
        "run": str(out),
        "arm": str(beside or arm_file),
        "seed": scenario.seed,
        "engine": chosen,
        "cycles": len(cycles),
        "frames": len(messages),
        "duration_s": len(cycles) * arm.period_s,
        "largest": {name: value for name, _, value in ranges},
    }
    if not quiet(out, json):
        table(("largest", "unit", ""), [(name, unit, number(value, 4)) for name, unit, value in ranges])
        say(f"{out}: {counted(len(cycles), 'cycle')}, {counted(len(messages), 'frame')}, seed {scenario.seed}")
    if json:
        write_json(json, summary)


def send(wire: can.BusABC, messages: Sequence[can.Message], run: Path) -> None:
    """Send the messages of a run that is already recorded; each one waits for its time."""
    with progress() as bar:
        task = bar.add_task("sending", total=len(messages))
        begin = time.monotonic()
        for message in messages:
            delay = begin + message.timestamp - time.monotonic()
            if delay > 0.0:
                time.sleep(delay)
            try:
                wire.send(message, timeout=2.0)
            except (can.CanError, OSError) as error:
                raise ZygosError(
                    f"the bus accepted no more frames ({error}); {named(run)} is written; remedy: check that the bus "
                    "is up and another node acknowledges, then send the run with python-can's `can_player`"
                ) from error
            bar.advance(task)


def command(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="The scenario, which names arm and plant.")],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="RUN", help="The CAN log to write; - writes lines of candump.")
    ],
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL", help="Simulate this plant instead of the scenario's."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Seed of the sensor noise. Default: the scenario's.")
    ] = None,
    noise: Annotated[
        bool | None,
        typer.Option("--noise/--no-noise", help="Whether sensors are noisy. Default: as the scenario says."),
    ] = None,
    engine: Annotated[
        str,
        typer.Option(metavar="ENGINE", help="The source of the equations of motion: zygos, pinocchio or mujoco."),
    ] = "zygos",
    interface: Interface = None,
    channel: ChannelOption = None,
    bitrate: Bitrate = None,
    drive: Drive = None,
    nodes: Nodes = None,
    eds: Eds = None,
    json: Json = None,
    mcap: Mcap = None,
) -> None:
    """Simulate a run: plant, servo and sensors, recorded as CAN traffic.

    Writes RUN, and a copy of the arm file next to it as arm.toml. The plant's true values are not written anywhere.
    With -i and -c the frames are also sent on that bus, at the rate of the SYNCs. With --engine, Pinocchio or MuJoCo
    move the same bodies by their own equations, which support no effects.

    With --drive the frames are those of the drives (classical, of 29 bits, or CAN FD), as `zygos convert --drive` and
    `zygos listen --drive` read them: angles and torques at the instants of the cycles, in the steps of the drive;
    whatever else is in a frame is 0.

    Example: zygos simulate examples/paper/scenario.toml -o out/run.blf
    """
    drives = named_drives(drive, nodes, eds)
    simulate_run(scenario, out, model, seed, noise, engine, interface, channel, bitrate, json, mcap, drives)

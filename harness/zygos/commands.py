"""The commands behind the command line."""

from __future__ import annotations

import shutil
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from zygos import bus
from zygos.arm import Arm, load_arm
from zygos.check import check_frames
from zygos.errors import Undecided, ZygosError
from zygos.flight import Estimate, Flight, encode
from zygos.model import Model, Quantity, load_model, save_model
from zygos.output import console, errors, number, table, write_json
from zygos.plant import simulate
from zygos.scenario import load_scenario


def progress() -> Progress:
    """A progress bar on stderr."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=errors,
        transient=True,
    )


def find_arm(run: Path, arm: Path | None) -> Path:
    """The arm file of a run: the one given, or arm.toml beside the run."""
    chosen = arm or run.parent / "arm.toml"
    if not chosen.is_file():
        raise ZygosError(f"{chosen}: no such arm file; remedy: give it with --arm, or put arm.toml beside the run")
    return chosen


def read_run(run: Path) -> NDArray[Any]:
    """Read a log; a long one shows how far it is."""
    with progress() as bar:
        task = bar.add_task(f"reading {run.name}", total=None)
        return bus.read_log(run, lambda count: bar.update(task, description=f"reading {run.name}: {count:,} frames"))


def simulate_run(
    scenario_file: Path,
    out: Path,
    model_file: Path | None,
    seed: int | None,
    noise: bool | None,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    json: str | None,
) -> None:
    """Simulate a scenario and record its traffic; see `zygos simulate --help`."""
    bus.check_log_name(out)
    scenario = load_scenario(scenario_file)
    arm_file = scenario.arm
    arm = load_arm(arm_file)
    beside = out.parent / "arm.toml"
    if beside.exists() and beside.read_bytes() != arm_file.read_bytes():
        raise ZygosError(
            f"{beside} describes another arm than {arm_file}; remedy: write the run into another folder, or "
            "remove that file"
        )
    if seed is not None:
        scenario = replace(scenario, seed=seed)
    model = load_model(model_file or scenario.plant)
    with progress() as bar:
        task = bar.add_task("simulating", total=1.0)
        trajectory = simulate(
            arm, model, scenario, noise=noise, progress=lambda share: bar.update(task, completed=share)
        )
    cycles = trajectory.cycles(0)
    frames = encode(arm, cycles)
    bus.write_log(out, frames, arm.period_s)
    if not beside.exists():
        shutil.copyfile(arm_file, beside)
    if interface is not None or channel is not None:
        send(frames, arm, interface, channel, bitrate)
    ranges = [
        ("rotor torque", "Nm", float(np.abs(cycles.tau).max())),
        ("link angle", "rad", float(np.abs(cycles.q).max())),
        ("deflection", "rad", float(np.abs(cycles.theta - cycles.q).max())),
        ("base rate", "rad/s", float(np.abs(cycles.omega).max())),
    ]
    summary = {
        "run": str(out),
        "arm": str(beside),
        "seed": scenario.seed,
        "cycles": len(cycles),
        "frames": len(frames),
        "duration_s": len(cycles) * arm.period_s,
        "largest": {name: value for name, _, value in ranges},
    }
    if json != "-":
        table(("largest", "unit", ""), [(name, unit, number(value, 4)) for name, unit, value in ranges])
        console.print(f"{out}: {len(cycles):,} cycles, {len(frames):,} frames, seed {scenario.seed}", highlight=False)
    if json:
        write_json(json, summary)


def send(frames: NDArray[Any], arm: Arm, interface: str | None, channel: str | None, bitrate: int | None) -> None:
    """Send frames on a bus; each cycle waits for its time."""
    messages = bus.to_messages(frames, arm.period_s)
    with bus.open_bus(interface, channel, bitrate) as out, progress() as bar:
        task = bar.add_task("sending", total=len(messages))
        begin = time.monotonic()
        for message in messages:
            delay = begin + message.timestamp - time.monotonic()
            if delay > 0.0:
                time.sleep(delay)
            out.send(message, timeout=2.0)
            bar.advance(task)


def report_estimate(result: Estimate, flight: Flight, heading: Mapping[str, Any]) -> dict[str, Any]:
    """The content of an estimate's JSON."""
    return {
        **heading,
        "arm": flight.arm.name,
        "validity": result.validity,
        "reason": result.reason or None,
        "cycles": flight.counts["cycles"],
        "accepted": result.accepted,
        "refused": result.refused,
        "arcs": result.arcs,
        "blocks": result.blocks,
        "rank": result.rank,
        "condition": result.condition,
        "residual_j": result.residual,
        "faults": flight.faults,
        "counts": flight.counts,
        "parameters": [
            {"name": name, "unit": unit, "value": float(value), "sigma": float(sigma)}
            for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True)
        ],
    }


def finish_estimate(
    result: Estimate, flight: Flight, out: Path, prior: Model | None, json: str | None, heading: Mapping[str, Any]
) -> None:
    """Write the model, print the table, and say what is undecided."""
    quantities = {}
    for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True):
        if np.isfinite(value):
            quantities[name] = Quantity(float(value), float(sigma), "zygos", unit)
        elif prior is not None:
            quantities[name] = prior.base_parameters(flight.arm)[name]
    content = report_estimate(result, flight, heading)
    if result.validity != "refused":
        save_model(Model(name=flight.arm.name, parameters=quantities), out)
    if json:
        write_json(json, content)
    if json != "-":
        rows = [
            (name, unit, number(value), number(sigma, 2), number(100 * sigma / abs(value), 2))
            for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True)
        ]
        table(("name", "unit", "estimate", "sigma", "sigma %"), rows)
        faults = sum(flight.faults.values())
        console.print(
            f"arm {flight.arm.name} · {flight.counts['cycles']:,} cycles · {faults} faults · "
            f"{result.accepted:,} instants accepted, {result.refused} refused · {result.arcs} arcs · {result.validity}",
            highlight=False,
        )
        seen = [f"{name} {count}" for name, count in flight.faults.items() if count]
        if seen:
            console.print("faults: " + ", ".join(seen), highlight=False)
    if result.validity != "valid":
        where = "nothing written" if result.validity == "refused" else f"{out} written"
        raise Undecided(f"{result.validity}: {result.reason} ({where}); remedy: {_remedy(result, flight)}")


def _remedy(result: Estimate, flight: Flight) -> str:
    if flight.counts["cycles"] == 0:
        return "no cycle was complete: compare the node numbers of the arm file and the fault counters with the bus"
    if "too fast" in result.reason:
        return "a higher SYNC rate, a shorter smoother window, or a slower motion"
    if "not physical" in result.reason:
        return "check signs, gear ratios and the torque_law of the arm file, or a longer run"
    return "a longer run that moves every joint at different speeds"


def estimate_run(run: Path, arm_file: Path | None, out: Path, model_file: Path | None, json: str | None) -> None:
    """Estimate from a recorded run; see `zygos estimate --help`."""
    arm = load_arm(find_arm(run, arm_file))
    prior = load_model(model_file) if model_file else None
    if prior is not None:
        prior.base_parameters(arm)
    frames = read_run(run)
    flight = Flight(arm)
    flight.frames(frames)
    finish_estimate(flight.estimate(), flight, out, prior, json, {"run": str(run)})


def check_run(run: Path, arm_file: Path | None, json: str | None) -> None:
    """Compare C with numpy on a run; see `zygos check --help`."""
    arm = load_arm(find_arm(run, arm_file))
    rooms = check_frames(arm, read_run(run))
    if json:
        write_json(json, {"run": str(run), "arm": arm.name, "rooms": [room.as_json() for room in rooms]})
    if json != "-":
        table(
            ("room", "compared", "largest difference", "at cycle", "tolerance", ""),
            [
                (
                    room.name,
                    f"{room.compared:,}",
                    number(room.difference, 2),
                    "–" if room.cycle is None else str(room.cycle),
                    number(room.tolerance, 2),
                    "[green]equal[/]" if room.equal else "[red]differs[/]",
                )
                for room in rooms
            ],
        )
    failed = [room.name for room in rooms if not room.equal]
    if failed:
        raise Undecided(f"C and numpy differ in: {', '.join(failed)}; remedy: report the run, it is worth a look")


def listen_bus(
    arm_file: Path,
    out: Path,
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    log: Path | None,
    duration: float,
    idle: float,
    json: str | None,
) -> None:
    """Estimate while frames arrive; see `zygos listen --help`."""
    arm = load_arm(arm_file)
    if log is not None:
        bus.check_log_name(log)
    flight = Flight(arm)
    kept = []
    batch: list[Any] = []
    begin = time.monotonic()

    def work_off() -> None:
        frames = bus.from_messages(batch)
        flight.frames(frames)
        if log is not None:
            kept.append(frames)
        batch.clear()

    with bus.open_bus(interface, channel, bitrate) as source:
        where = f"{interface or 'can.conf'} {channel or ''}".strip()
        errors.print(f"listening to {where}; Ctrl-C ends", highlight=False)
        shown = begin
        try:
            for message in bus.receive(source, idle, lambda: bool(duration) and time.monotonic() - begin > duration):
                batch.append(message)
                if len(batch) >= 256:
                    work_off()
                if time.monotonic() - shown > 2.0:
                    work_off()
                    shown = time.monotonic()
                    now = flight.estimate()
                    known = int(np.isfinite(now.value).sum())
                    errors.print(
                        f"{flight.counts['cycles']:>8,} cycles · {sum(flight.faults.values())} faults · "
                        f"{known}/{len(now.names)} parameters · {now.validity}",
                        highlight=False,
                    )
        except KeyboardInterrupt:
            errors.print("stopped; keeping what was learned")
    work_off()
    if log is not None and any(len(frames) for frames in kept):
        bus.write_log(log, np.concatenate(kept), arm.period_s)
    finish_estimate(flight.estimate(), flight, out, None, json, {"bus": where})

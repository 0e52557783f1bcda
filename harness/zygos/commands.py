"""The commands behind the command line."""

from __future__ import annotations

import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from zygos import bus
from zygos.arm import Arm, load_arm
from zygos.check import check_cycles, check_frames
from zygos.columns import check_table, is_table
from zygos.cycletable import read_cycles
from zygos.effects import Effect
from zygos.errors import Damaged, Undecided, ZygosError
from zygos.flight import GATE, OVERDECLARED, ROWS, Drift, Estimate, Flight, encode
from zygos.lines import LineProgress
from zygos.model import Model, Quantity, load_model, save_model
from zygos.motion import ENGINES
from zygos.output import bad, check_outputs, counted, errors, good, note, number, ratio, say, table, write_json
from zygos.plant import simulate
from zygos.scenario import load_scenario
from zygos.watch import Watch

NO_FRAMES = frozenset({"incomplete", "dropped", "sync_jumped", "time_lost", "time_jumped", "overrun", "bus_error"})
"""Fault counters that count something else than rejected frames."""
MANY_DROPPED = 0.02
"""Share of the cycles whose loss is worth a word before anything else."""
REMEDIES = {
    "too fast": "a higher SYNC rate, a shorter smoother window, or a slower motion",
    "does not close": (
        "check gear ratios, signs, zeros and the torque_law of the arm file; friction, cubic springs and torque "
        "lag are in the balance only where --model names them, noise of the torques and torques on the base never"
    ),
    "arm changed": (
        "split the log where the arm changed, or let old arcs fade ([arc] memory_min); on board zygos_restart()"
    ),
    "not physical": "check signs, gear ratios and the torque_law of the arm file, or a longer run",
}
"""What helps where the estimate's reason says so."""
LEFT_OUT_SHOWN = 6
"""Arcs of a kind whose times are said."""


def progress() -> Progress:
    """A progress bar on stderr; where that is no terminal, a line now and then."""
    if not errors.is_interactive:
        return LineProgress()
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=errors,
        transient=True,
    )


def find_arm(run: Path, arm: Path | None) -> Path:
    """The arm file of a run: the one given, or arm.toml beside the run. The run must exist."""
    if is_table(run):
        check_table(run)
    else:
        bus.check_log(run)
    chosen = arm or run.parent / "arm.toml"
    if not chosen.is_file():
        raise ZygosError(f"{chosen}: no such arm file; remedy: give it with --arm, or put arm.toml beside the run")
    return chosen


def check_model_name(path: Path) -> None:
    """Refuse a model file that is not called .toml."""
    if path.suffix.lower() != ".toml":
        raise ZygosError(f"{path}: no name for a model; remedy: let it end in .toml")


def read_run(run: Path) -> bus.Log:
    """Read a log; a long one shows how far it is. Damage is said at once; `not_whole` ends the command."""
    with progress() as bar:
        task = bar.add_task(f"reading {run.name}", total=None)
        log = bus.read_log(run, lambda count: bar.update(task, description=f"reading {run.name}: {count:,} frames"))
    warn(log.damage)
    return log


def warn(texts: Sequence[str]) -> None:
    """Say what the answer is to be taken with."""
    for text in texts:
        note(f"warning: {text}")


def not_whole(*damage: Sequence[str]) -> None:
    """The end of a command that has answered from logs. Raises Damaged when one of them was damaged."""
    if any(damage):
        raise Damaged(
            "answered from damaged input, from what could be read; remedy: see the warnings above, and record again"
        )


def damage_of(log: bus.Log | None) -> tuple[str, ...]:
    """What is missing of a log; nothing of a table, which has none."""
    return log.damage if log else ()


def door(run: Path) -> str:
    """The door of the flight library that a run goes through: frames, or cycles of which nobody saw the frames."""
    return "cycle" if is_table(run) else "frames"


def origin(run: Path, log: bus.Log | None) -> dict[str, Any]:
    """What an answer's JSON says of its run; of a table there is no log."""
    return {"run": str(run), "door": door(run), "damage": damage_of(log) or None}


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
) -> None:
    """Simulate a scenario and record its traffic; see `zygos simulate --help`."""
    bus.check_log_name(out)
    chosen = next((name for name in ENGINES if name == engine), None)
    if chosen is None:
        raise ZygosError(f"there is no engine {engine!r}; remedy: one of {', '.join(ENGINES)}")
    scenario = load_scenario(scenario_file)
    arm_file = scenario.arm
    arm = load_arm(arm_file)
    beside = out.parent / "arm.toml"
    check_outputs([out, json], [scenario_file, arm_file, scenario.plant, model_file, beside])
    if beside.exists() and beside.read_bytes() != arm_file.read_bytes():
        raise ZygosError(
            f"{beside} describes another arm than {arm_file}; remedy: write the run into another folder, or "
            "remove that file"
        )
    if seed is not None:
        scenario = replace(scenario, seed=seed)
    model = load_model(model_file or scenario.plant)
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
        frames = encode(arm, cycles)
        bus.write_log(out, frames, arm.period_s)
        if not beside.exists():
            shutil.copyfile(arm_file, beside)
        if wire is not None:
            send(wire, frames, arm, out)
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
        "engine": chosen,
        "cycles": len(cycles),
        "frames": len(frames),
        "duration_s": len(cycles) * arm.period_s,
        "largest": {name: value for name, _, value in ranges},
    }
    if json != "-":
        table(("largest", "unit", ""), [(name, unit, number(value, 4)) for name, unit, value in ranges])
        say(f"{out}: {counted(len(cycles), 'cycle')}, {counted(len(frames), 'frame')}, seed {scenario.seed}")
    if json:
        write_json(json, summary)


def send(wire: can.BusABC, frames: NDArray[Any], arm: Arm, run: Path) -> None:
    """Send the frames of a run that is already recorded; each cycle waits for its time."""
    messages = bus.to_messages(frames, arm.period_s)
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
                    f"the bus took no more frames ({error}); {run} is written; remedy: see whether the bus is up and "
                    "another node acknowledges, then send the run with python-can's `can_player`"
                ) from error
            bar.advance(task)


def report_estimate(result: Estimate, watch: Watch, drift: Drift | None, heading: Mapping[str, Any]) -> dict[str, Any]:
    """The content of an estimate's JSON."""
    flight = watch.flight
    return {
        **heading,
        "arm": flight.arm.name,
        "validity": result.validity,
        "reason": result.reason or None,
        "cycles": flight.counts["cycles"],
        "accepted": result.accepted,
        "refused": result.refused,
        "arcs": result.arcs,
        "left_out": dict(zip(ROWS, result.left_out, strict=True)),
        "left_out_arcs": [
            {"rows": arc.rows, "from_s": arc.first * flight.arm.period_s, "to_s": arc.last * flight.arm.period_s}
            for arc in watch.left_out
        ],
        "blocks": result.blocks,
        "rank": result.rank,
        "condition": result.condition,
        "residual_j": result.residual,
        "cluster": result.cluster,
        "noise_ratio": result.noise_ratio,
        "gate": result.gate,
        "drift": dict(zip(drift.names, drift.deviation.tolist(), strict=True)) if drift else None,
        "changed": drift.changed if drift else (),
        "changed_after_s": drift.until * flight.arm.period_s if drift and drift.changed else None,
        "faults": flight.faults,
        "counts": flight.counts,
        "parameters": [
            {"name": name, "unit": unit, "value": float(value), "sigma": float(sigma), "half95": float(half95)}
            for name, unit, value, sigma, half95 in zip(
                result.names, result.units, result.value, result.sigma, result.half95, strict=True
            )
        ],
        "solution": result.solution.tolist(),
        "covariance": result.covariance.tolist(),
        # of the normal equations: how the columns lie to each other in the motion, which `zygos fit` weighs with
        "normal": flight.normal_equations()[0].tolist(),
    }


def losses(flight: Flight) -> str:
    """What the receiver lost, in words."""
    rejected = sum(count for name, count in flight.faults.items() if name not in NO_FRAMES)
    return f"{counted(flight.faults['dropped'], 'cycle')} dropped, {counted(rejected, 'frame')} rejected"


def learned(effect: Effect, found: Quantity | None) -> Effect:
    """The entry of a model for what was found of an effect. A friction or lag that noise makes negative is none."""
    if found is None:
        return effect
    value = max(found.value, 0.0) if effect.kind.positive else found.value
    return replace(effect, value=value, sigma=found.sigma, source=found.source)


def about_noise(result: Estimate) -> str:
    """What the noise did to an estimate, where that is worth a word."""
    if result.gate < GATE:
        return (
            f"noise: in some combination of parameters the motion is {number(result.gate, 2)} times as large as the "
            "sensors' noise; the intervals hold what that may hide"
        )
    if result.noise_ratio < OVERDECLARED:
        return (
            f"noise: the residuals' square is {number(result.noise_ratio, 2)} of what the arm file's sigmas make of it;"
            " they were believed to that extent"
        )
    if result.noise_ratio > 1.0 / OVERDECLARED:
        return (
            f"noise: the residuals' square is {number(result.noise_ratio, 2)} times what the arm file's sigmas make of "
            "it: sensors are noisier, or something is not in the balance; the intervals hold what that may hide"
        )
    return ""


def about_left_out(result: Estimate, watch: Watch) -> str:
    """How many arcs contradicted the others, and when; empty where none did."""
    if not any(result.left_out):
        return ""
    period, found = watch.flight.arm.period_s, []
    for rows, count in zip(ROWS, result.left_out, strict=True):
        spans = [f"{arc.first * period:.0f}..{arc.last * period:.0f} s" for arc in watch.left_out if arc.rows == rows]
        opened = ["the newest, still open"] if count > watch.flight.native.guard.left_out[ROWS.index(rows)] else []
        shown = [*spans[:LEFT_OUT_SHOWN], *(["…"] if len(spans) > LEFT_OUT_SHOWN else []), *opened]
        found += [f"{counted(count, 'arc')} of the {rows} rows ({', '.join(shown)})"] if count else []
    return f"left out, for they contradict the others: {'; '.join(found)}"


def about_change(result: Estimate, drift: Drift, arm: Arm) -> str:
    """That the arm changed, and what to do."""
    values = "are those of the arm before" if result.in_a_row else "mix what it was and is"
    names = ", ".join(
        f"{name} by {abs(far):.0f}"
        for name, far in zip(drift.names, drift.deviation, strict=True)
        if name in drift.changed
    )
    return (
        f"the arm changed after {drift.until * arm.period_s:.0f} s, in standard deviations: {names}; the values "
        f"{values}; remedy: split the log there, or let old arcs fade ([arc] memory_min); on board "
        "zygos_restart()"
    )


def finish_estimate(
    result: Estimate, watch: Watch, out: Path, prior: Model | None, json: str | None, heading: Mapping[str, Any]
) -> None:
    """Print the table, write the model, say that the arm changed and what is undecided."""
    flight, drift = watch.flight, watch.look()
    found = {
        name: Quantity(float(value), float(sigma), "zygos", unit)
        for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True)
        if np.isfinite(value)
    }
    known = (prior.base_parameters(flight.arm) if prior is not None else {}) | found
    quantities = {name: known[name] for name in flight.arm.parameter_names if name in known}
    given = prior.effects if prior is not None else ()
    # an offset that only the arm file asked for, and the run is silent on, is none
    asked = (one for one in flight.effects if one not in given and one.column(flight.arm) in found)
    effects = tuple(learned(effect, found.get(effect.column(flight.arm))) for effect in (*given, *asked))
    if json != "-":
        rows = [
            (name, unit, number(value), number(float(f"{half95:.2g}")), number(100 * ratio(half95, abs(value)), 2))
            for name, unit, value, half95 in zip(result.names, result.units, result.value, result.half95, strict=True)
        ]
        table(("name", "unit", "estimate", "±95 %", "in %"), rows)
        say(
            f"arm {flight.arm.name} · {counted(flight.counts['cycles'], 'cycle')} · {losses(flight)} · "
            f"{counted(result.accepted, 'instant')} accepted, {result.refused:,} refused · "
            f"{counted(result.arcs, 'arc')}, {flight.counts['arcs_dropped']:,} dropped, "
            f"{result.left_out[0]:,} left out · "
            f"{np.isfinite(result.value).sum()} of {counted(len(result.names), 'parameter')} · {result.validity}"
            + (" · door: cycle" if heading["door"] == "cycle" else "")
        )
        seen = [f"{name} {count:,}" for name, count in flight.faults.items() if count]
        if seen:
            say("faults: " + ", ".join(seen))
        if left_out := about_left_out(result, watch):
            say(left_out)
        if noise := about_noise(result):
            say(noise)
    if drift and drift.changed:
        warn([about_change(result, drift, flight.arm)])
    try:
        if result.validity != "refused":
            save_model(Model(name=flight.arm.name, parameters=quantities, effects=effects), out)
    finally:
        if json:
            write_json(json, report_estimate(result, watch, drift, heading))
    if result.validity != "valid":
        where = "nothing written" if result.validity == "refused" else f"{out} written"
        remedy = "see the warning: the arm changed" if drift and drift.changed else _remedy(result, flight)
        raise Undecided(f"{result.validity}: {result.reason} ({where}); remedy: {remedy}")


def _remedy(result: Estimate, flight: Flight) -> str:
    """What helps: what the bus did wrong comes first, for it spoils everything behind it."""
    faults, cycles = flight.faults, flight.counts["cycles"]
    largest = sorted(((count, name) for name, count in faults.items() if count and name != "dropped"), reverse=True)
    seen = ", ".join(f"{name} {count:,}" for count, name in largest[:3])
    if cycles == 0:
        if flight.counts["invalid"]:
            seen = f"{counted(flight.counts['invalid'], 'cycle')} invalid, not finite or beyond all reason"
        came = f"the fault counters say {seen}" if seen else "no frame of this arm came"
        return f"no cycle was complete and {came}: compare the node numbers and the gyro of the arm file with the bus"
    found = []
    if faults["dropped"] > MANY_DROPPED * (cycles + faults["dropped"]):
        found.append(f"the bus loses or damages frames, or some are not as the arm file says ({seen}): repair that")
    if flight.counts["apart"] > MANY_DROPPED * cycles:
        found.append("link and motor angle of a joint read more than 8 turns apart: check unit, side, sign and zeros")
    if faults["time_lost"]:
        found.append("FTIME (0x3A0) must come at least every 100 cycles")
    if faults["time_jumped"]:
        found.append("period_s of the arm file disagrees with the clock of the bus, or SYNCs are lost")
    if found:
        return "; ".join(found)
    for words, remedy in REMEDIES.items():
        if words in result.reason:
            return remedy
    return "a longer run that moves every joint at different speeds"


def estimate_run(run: Path, arm_file: Path | None, out: Path, model_file: Path | None, json: str | None) -> None:
    """Estimate from a recorded run; see `zygos estimate --help`."""
    chosen = find_arm(run, arm_file)
    check_model_name(out)
    check_outputs([out, json], [run, chosen, run.parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    prior = load_model(model_file) if model_file else None
    if prior is not None:
        prior.base_parameters(arm)
    watch = Watch(Flight(arm, prior.effects if prior else ()))
    log = None if is_table(run) else read_run(run)
    with progress() as bar:
        task = bar.add_task("learning", total=1.0)

        def show(share: float) -> None:
            bar.update(task, completed=share)

        if log is None:
            watch.cycles(read_cycles(run, arm), show)
        else:
            watch.frames(log.frames, show)
        result = watch.flight.estimate()
    finish_estimate(result, watch, out, prior, json, origin(run, log))
    not_whole(damage_of(log))


def check_run(run: Path, arm_file: Path | None, model_file: Path | None, json: str | None) -> None:
    """Compare C with numpy on a run; see `zygos check --help`."""
    chosen = find_arm(run, arm_file)
    check_outputs([json], [run, chosen, run.parent / "arm.toml", model_file])
    arm = load_arm(chosen)
    flight = Flight(arm, load_model(model_file).effects if model_file else ())
    log = None if is_table(run) else read_run(run)
    rooms = check_cycles(arm, read_cycles(run, arm), flight) if log is None else check_frames(arm, log.frames, flight)
    if json:
        write_json(json, {**origin(run, log), "arm": arm.name, "rooms": [room.as_json() for room in rooms]})
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
                    good("equal") if room.equal else bad("differs"),
                )
                for room in rooms
            ],
        )
        if is_table(run):
            say("door: cycle")
    failed = [room.name for room in rooms if not room.equal]
    if failed:
        raise Undecided(f"C and numpy differ in: {', '.join(failed)}; remedy: report the run, it is worth a look")
    if rooms[-1].name != "solution":
        result = flight.estimate()
        raise Undecided(
            f"no solution to compare, {result.validity}: {result.reason}; remedy: {_remedy(result, flight)}"
        )
    not_whole(damage_of(log))


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Gives a function that says whether Ctrl-C or SIGTERM came: the first one is a wish, a second one ends at once."""
    came: list[int] = []
    before = {which: signal.getsignal(which) for which in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for which, handler in before.items():
            signal.signal(which, handler)

    def take(which: int, _: Any) -> None:
        came.append(which)
        restore()

    for which in before:
        signal.signal(which, take)
    try:
        yield lambda: bool(came)
    finally:
        restore()


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
    check_model_name(out)
    if log is not None:
        bus.check_log_name(log)
    check_outputs([out, log, json], [arm_file])
    watch = Watch(Flight(arm))
    flight = watch.flight
    batch: list[can.Message] = []
    failures: list[ZygosError] = []
    where = f"{interface or 'can.conf'} {channel or ''}".strip()

    def fail(error: ZygosError) -> None:
        note(str(error))
        failures.append(error)

    with bus.open_bus(interface, channel, bitrate) as source, stop_signals() as stopped:
        recording = bus.Recording(log) if log is not None else None

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

        note(f"listening to {where}; Ctrl-C ends")
        begin = shown = time.monotonic()
        try:
            for message in bus.receive(
                source, idle, lambda: stopped() or (duration > 0.0 and time.monotonic() - begin > duration)
            ):
                batch.append(message)
                late = time.monotonic() - shown > 2.0
                if late or len(batch) >= 256:
                    work_off()
                if late:
                    shown = time.monotonic()
                    result = flight.estimate()
                    note(
                        f"{counted(flight.counts['cycles'], 'cycle'):>16} · {losses(flight)} · "
                        f"{np.isfinite(result.value).sum()}/{len(result.names)} parameters · {result.validity}"
                        + (" · the arm changed" if watch.plainest and watch.plainest.changed else "")
                    )
        except can.CanError as error:
            fail(
                Undecided(
                    f"{where} failed while listening ({error}), what was learned until then is kept; remedy: see "
                    "whether the interface is up, and listen again"
                )
            )
        if stopped():
            note("stopped; keeping what was learned")
        work_off()
    if recording is not None:
        try:
            recording.finish()
        except ZygosError as error:
            fail(error)
    finish_estimate(flight.estimate(), watch, out, None, json, {"bus": where, "door": "frames"})
    if failures:
        sys.exit(failures[0].exit_code)

"""`zygos convert`: telemetry of others becomes a run of zygos, with a table of what became of each signal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from zygos import bus
from zygos.arm import Arm, load_arm
from zygos.columns import check_table, is_table
from zygos.commands import not_whole, progress, warn
from zygos.cycles import INVALID, Cycles
from zygos.cycletable import write_cycles
from zygos.errors import Undecided, ZygosError
from zygos.flight import Flight, encode
from zygos.gap.record import ANGLE_STEP, COARSE_RATE_STEP, RATE_STEP, TORQUE_STEP
from zygos.grid import (
    REFUSED_MAX,
    Track,
    declared_sigma,
    interpolation_sigma,
    kind_of,
    needed_rate,
    noisier,
    regrid,
    synchronous,
    tracks,
    tracks_of,
)
from zygos.inputs import local
from zygos.output import check_outputs, counted, is_dash, number, say, table, write_json, write_text
from zygos.sensors import encoder_angle
from zygos.telemetry import SI_UNIT, Channel, Dictionary, Map, Recording, load_map, read_can, read_table

_FTIME_CYCLES = 50
"""`encode` sends FTIME with every cycle whose number is a multiple of this."""
_ANGLE_MAX, _TORQUE_MAX, _RATE_MAX = 16 * math.pi, (2**23 - 1) * TORQUE_STEP, 4.0
"""What the wire carries, SI (docs/wire.md)."""
UNLIKE = 5.0
"""Motor and link angle of a joint whose motions differ by such a factor are worth a word."""


def convert_run(
    source: Path, dbc: Sequence[Path], map_file: Path, arm_file: Path | None, out: Path, json: str | None
) -> None:
    """Convert foreign telemetry; see `zygos convert --help`."""
    tabular = is_table(source)
    _check_names(source, dbc, out, tabular=tabular)
    chosen = arm_file or map_file.parent / "arm.toml"
    if not local(chosen).is_file():
        raise ZygosError(f"{chosen}: no such arm file; remedy: give it with --arm, or put arm.toml beside the map")
    beside = out.parent / "arm.toml"
    check_outputs([out, json], [source, *dbc, map_file, chosen, beside])
    arm = load_arm(chosen)
    Flight(arm)  # an arm that the library refuses is refused before anything is read
    mapping = load_map(map_file, arm, tabular=tabular)
    with progress() as bar:
        task = bar.add_task(f"reading {source.name}", total=None)
        if tabular:
            recording = read_table(source, mapping)
        else:
            recording = read_can(
                source,
                Dictionary.load(dbc),
                mapping,
                lambda count: bar.update(task, description=f"reading {source.name}: {count:,} frames"),
            )
        bar.update(task, description="converting")
        found, cycles, lost = _cycles(recording, mapping, arm)
        added = _added(found, mapping, arm)
        if not any(added):
            described, text = arm, local(chosen).read_text(encoding="utf-8")
        else:
            described = noisier(arm, mapping.channels, added)
            text = _arm_text(chosen, described, f"{source.name} by {map_file.name}")
        _check_noise(described, mapping, added)
        rate, needed = needed_rate(found, arm, mapping)
        # where the motion passes with even stamps, it is not the motion that is too fast
        _, even = needed_rate([track.evened for track in found], arm, mapping) if needed != rate else (rate, needed)
        frames = None if is_table(out) else encode(described, _with_time(cycles))
        _write(out, cycles, frames, arm.period_s, beside, text)
        refused = _refused(described, cycles, frames)
    warn(recording.missing)
    rows = _rows(recording, found, cycles, described, mapping, added)
    warnings = _warnings(arm, cycles, described, recording, found, out)
    content: dict[str, Any] = {
        "input": str(source),
        "map": str(map_file),
        "run": str(out),
        "arm": str(beside),
        "door": "cycle" if is_table(out) else "frames",
        "time": mapping.clock.kind,
        "interpolation": mapping.clock.interpolation,
        "period_s": arm.period_s,
        "cycles": len(cycles),
        "breaks": int(np.count_nonzero(cycles.flags)),
        "left_out": lost,
        "damage": recording.missing or None,
        "damaged_frames": recording.damaged,
        "signals": rows,
        "bandwidth": {
            "rate_hz": rate,
            "needed_hz": needed,
            "needed_with_even_stamps_hz": even,
            "stamps_sigma_s": _stamps(found),
            "refused_share": refused,
        },
        "warnings": warnings,
    }
    if json != "-":
        _print(content)
    if json:
        write_json(json, content)
    _judge(rate, needed, even, _stamps(found), refused, mapping, out)
    not_whole(recording.missing)


def _check_names(source: Path, dbc: Sequence[Path], out: Path, *, tabular: bool) -> None:
    if tabular:
        check_table(source)
        if dbc:
            raise ZygosError(f"{source}: a table needs no --dbc; remedy: leave it out")
    else:
        bus.check_log(source)
        if not dbc:
            raise ZygosError(f"{source}: a CAN log needs the DBC of its bus; remedy: give it with --dbc")
    if is_dash(out):
        raise ZygosError("- cannot be the run, which has its arm file beside it; remedy: give -o a file's name")
    if not is_table(out):
        bus.check_log_name(out)


def _cycles(recording: Recording, mapping: Map, arm: Arm) -> tuple[list[Track], Cycles, dict[str, int]]:
    """Tracks, cycles, and how much was left out for which reason."""
    if mapping.clock.kind == "sync":
        run = synchronous(recording, mapping, arm)
        lost = {"incomplete cycles": run.incomplete, "repeated cycles": run.repeated}
        return tracks_of(run.cycles, arm, mapping), run.cycles, lost
    found = tracks(recording, mapping)
    cycles = regrid(found, arm, mapping)
    missing = int(cycles.sync[-1]) + 1 - len(cycles)
    return found, cycles, {"instants in holes": missing, "repeated stamps": sum(track.repeated for track in found)}


def _added(found: Sequence[Track], mapping: Map, arm: Arm) -> list[float]:
    """What the interpolation adds to the noise of each channel, SI."""
    if mapping.clock.kind == "sync":
        return [0.0] * len(found)
    return [
        interpolation_sigma(track, kind_of(track.channel, mapping, arm), declared_sigma(arm, track.channel))
        for track in found
    ]


def _check_noise(arm: Arm, mapping: Map, added: Sequence[float]) -> None:
    for channel, sigma in zip(mapping.channels, added, strict=True):
        if channel.quantity == "angle" and math.sqrt(12.0) * declared_sigma(arm, channel) > 1.0:
            raise ZygosError(
                f"{channel.where}: between the samples of {channel.source} the angle is unknown by {sigma:.2g} rad; "
                "remedy: record faster, and check unit and stamps"
            )


def _arm_text(file: Path, arm: Arm, whence: str) -> str:
    """The arm file with the noise of `arm`."""
    document = tomlkit.parse(local(file).read_text(encoding="utf-8"))
    for entry, joint in zip(document["joint"], arm.joints, strict=True):
        for key, encoder in (("link_encoder", joint.link_encoder), ("motor_encoder", joint.motor_encoder)):
            if key in entry and encoder.counts is None:
                entry[key].pop("counts", None)
                geared = joint.gear_ratio if encoder.side == "rotor" else 1.0
                entry[key]["quantum_rad"] = encoder.quantum_rad * geared
        entry["torque_sigma"] = joint.torque_sigma
    if arm.free:
        document["imu"]["rate_sigma"] = arm.imu.rate_sigma
    head = f"# Quanta and sigmas contain what interpolation and stamps of {whence} err (zygos convert).\n"
    return head + tomlkit.dumps(document)


def _write(out: Path, cycles: Cycles, frames: NDArray[Any] | None, period_s: float, beside: Path, text: str) -> None:
    """Write the run, as frames where there are any, and the arm file beside it."""
    if beside.exists() and beside.read_text(encoding="utf-8") != text:
        raise ZygosError(
            f"{beside} is not the arm file of this run, whose noise contains that of the interpolation; remedy: write "
            "the run into another folder, or remove that file"
        )
    if frames is None:
        write_cycles(out, cycles)
    else:
        bus.write_log(out, frames, period_s)
    if not beside.exists():
        write_text(beside, text)


def _with_time(cycles: Cycles) -> Cycles:
    """The cycles, and invalid ones where only they can carry FTIME: a receiver loses its time after 120 cycles."""
    ticks = np.arange(0, int(cycles.sync[-1]), _FTIME_CYCLES, dtype=np.uint64)
    sync = np.union1d(cycles.sync, ticks)
    at = np.searchsorted(sync, cycles.sync)

    def spread(values: Any) -> Any:
        out = np.zeros((len(sync), *values.shape[1:]), dtype=values.dtype)
        out[at] = values
        return out

    flags = np.full(len(sync), INVALID, dtype=np.uint32)
    flags[at] = cycles.flags
    return replace(
        cycles,
        sync=sync,
        q=spread(cycles.q),
        theta=spread(cycles.theta),
        tau=spread(cycles.tau),
        omega=spread(cycles.omega),
        flags=flags,
    )


def _refused(arm: Arm, cycles: Cycles, frames: NDArray[Any] | None) -> float | None:
    """Share of the run's instants that the flight library's bandwidth test refuses; None without an instant."""
    flight = Flight(arm)
    if frames is None:
        flight.cycles(cycles)
    else:
        flight.frames(frames)
    accepted, refused = flight.counts["accepted"], flight.counts["refused"]
    return refused / (accepted + refused) if accepted + refused else None


def _wire_step(channel: Channel, arm: Arm) -> float:
    """Step of the wire's code, SI."""
    if channel.field == "omega":
        return RATE_STEP if arm.imu.resolution == "fine" else COARSE_RATE_STEP
    return TORQUE_STEP if channel.field == "tau" else ANGLE_STEP


def _rows(
    recording: Recording, found: Sequence[Track], cycles: Cycles, arm: Arm, mapping: Map, added: Sequence[float]
) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for track, more in zip(found, added, strict=True):
        channel = track.channel
        values = getattr(cycles, channel.field)[:, channel.index]
        rows.append(
            {
                "signal": channel.label,
                "from": channel.source,
                "from_unit": channel.unit,
                "samples": len(recording.sources[channel.source].value),
                "rate_hz": 1.0 / track.interval_s if len(track.t) > 1 else math.nan,
                "holes": int(track.holes.sum()) if len(track.t) > 1 else 0,
                "unit": SI_UNIT[channel.quantity],
                "smallest": float(values.min()),
                "largest": float(values.max()),
                "sigma": declared_sigma(arm, channel),
                "added_by_interpolation": more,
                "wire_step": _wire_step(channel, arm),
            }
        )
    return rows


def _warnings(
    arm: Arm, cycles: Cycles, described: Arm, recording: Recording, found: Sequence[Track], out: Path
) -> list[str]:
    """What a person should look at."""
    said = []
    if recording.damaged:
        said.append(f"{counted(recording.damaged, 'frame')} could not be decoded by the DBC")
    q = encoder_angle([joint.link_encoder for joint in arm.joints], cycles.q)
    theta = encoder_angle([joint.motor_encoder for joint in arm.joints], cycles.theta)
    for i, joint in enumerate(arm.joints):
        motor, link = float(np.std(theta[:, i])), float(np.std(q[:, i]))
        together = float(np.mean((theta[:, i] - theta[:, i].mean()) * (q[:, i] - q[:, i].mean())))
        if together < 0.0 or motor > UNLIKE * link or link > UNLIKE * motor:
            said.append(
                f"{joint.name}: motor and link angle do not move alike (after signs and zeros {motor:.3g} and "
                f"{link:.3g} rad rms{', against each other' if together < 0.0 else ''}): look at unit, side, sign and "
                "counts_per_turn of both"
            )
    if is_table(out):
        return said
    outside = [
        ("angles beyond ±8 turns wrap", np.abs(np.hstack([cycles.q, cycles.theta])) > _ANGLE_MAX),
        ("torques beyond ±838.8606 Nm saturate", np.abs(cycles.tau) >= _TORQUE_MAX),
        ("rates beyond ±4 rad/s saturate", np.abs(cycles.omega) >= _RATE_MAX),
    ]
    for what, where in outside:
        bad = int(np.any(where, axis=1).sum())
        if bad:
            said.append(f"{counted(bad, 'cycle')}: on the wire {what}; a cycle table (-o RUN.npz) carries them whole")
    for track in found:
        channel = track.channel
        step = _wire_step(channel, arm)
        if channel.quantity == "angle":
            own = math.sqrt(12.0) * declared_sigma(described, channel)
            if step > own * (1 + 1e-9):
                said.append(
                    f"{channel.label}: the wire's step of {step:.3g} rad is coarser than the quantum of {own:.3g} rad; "
                    "a cycle table (-o RUN.npz) keeps it"
                )
    return said


def _print(content: dict[str, Any]) -> None:
    table(
        ("signal", "from", "in", "samples", "Hz", "smallest", "largest", "unit", "sigma", "of it added"),
        [
            (
                row["signal"],
                row["from"],
                row["from_unit"],
                f"{row['samples']:,}",
                number(row["rate_hz"], 4),
                number(row["smallest"], 4),
                number(row["largest"], 4),
                row["unit"],
                number(row["sigma"], 3),
                number(row["added_by_interpolation"], 3) if row["added_by_interpolation"] else "–",
            )
            for row in content["signals"]
        ],
    )
    how = "by its cycle counter" if content["interpolation"] is None else f"{content['interpolation']} interpolation"
    left = ", ".join(f"{count:,} {reason}" for reason, count in content["left_out"].items() if count)
    say(
        f"{content['run']}: {counted(content['cycles'], 'cycle')} at {1 / content['period_s']:g} Hz {how}, "
        f"{counted(content['breaks'], 'break')}, left out: {left or 'nothing'} · door: {content['door']}"
    )
    for line in content["warnings"]:
        say(f"look: {line}")


def _stamps(found: Sequence[Track]) -> float:
    """How far the stamps of the worst signal lie off an even train, s."""
    return max(track.stamp_sigma_s for track in found)


def _judge(
    rate: float,
    needed: float | None,
    even: float | None,
    stamps_s: float,
    refused: float | None,
    mapping: Map,
    out: Path,
) -> None:
    """Undecided where the motion is faster than the recording, or the stamps make it look so."""
    lie = f"the time stamps jitter by {1e3 * stamps_s:.3g} ms ({100 * stamps_s * rate:.0f} % of the interval)"
    if needed is None or needed > rate * 1.001:
        if even is not None and even <= rate * 1.001:
            raise Undecided(
                f"{lie}, and the bandwidth test takes that for motion; with even stamps the same samples pass at "
                f'{rate:.4g} Hz ({out} written); remedy: a cycle counter (source = "sync"), or a time that is taken '
                "with the sample; recording faster does not help"
            )
        # a number that even stamps lower is not all the motion's
        known = [one for one in (needed, even) if one is not None]
        wanted = f">= {min(known):.4g} Hz" if known else "more than the search holds"
        raise Undecided(
            f"{rate:.4g} Hz; this motion needs {wanted} ({out} written); remedy: record faster, where the recording is "
            "faster shorten period_s of the arm file, or move more slowly"
        )
    if refused is not None and refused > REFUSED_MAX:
        raise Undecided(
            f"{refused:.0%} of the instants fail the bandwidth test on the grid, though the telemetry is fast enough "
            f"({out} written; {lie}); remedy: "
            + ('interpolation = "cubic", ' if mapping.clock.interpolation == "linear" else "")
            + 'honest quanta in the arm file, or a cycle counter (source = "sync")'
        )

# SPDX-License-Identifier: MIT
"""`zygos convert`: converts telemetry of other systems to a run, with a report on each signal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import Progress

from zygos.arm import Arm, load_arm
from zygos.can import bus
from zygos.cli.driven import Drive, Eds, Nodes, Urdf, arm_file_of, named_drives
from zygos.cli.options import Json, Mcap, cuts, of_arm, of_map, of_runs
from zygos.cli.shared import not_whole, read_run, warn
from zygos.errors import Undecided, ZygosError
from zygos.files.inputs import local
from zygos.files.mcap import check_mcap_name, write_mcap
from zygos.files.output import check_outputs, counted, is_dash, number, say, table, write_json
from zygos.files.progress import progress
from zygos.files.tables import check_table, is_table
from zygos.native.flight import MAX_REFUSED_SHARE, Flight, encode, receivable
from zygos.telemetry.convert import (
    SPARSE,
    converted,
    fitting_cutoff_hz,
    noisier_arm_text,
    refused_share,
    signal_rows,
    stamps_sigma,
    warnings_of,
    with_time,
    write_run,
)
from zygos.telemetry.dictionary import Dictionary
from zygos.telemetry.drives import Drives
from zygos.telemetry.frames import read_can
from zygos.telemetry.grid import needed_rate
from zygos.telemetry.map import Input, Map, Recording, load_map, read_table
from zygos.telemetry.of_run import run_map, run_recording, with_breaks
from zygos.telemetry.published import measured
from zygos.telemetry.ros import check_mcap, is_mcap, read_mcap


def convert_run(
    source: Path,
    dbc: Sequence[Path],
    map_file: Path | None,
    arm_file: Path | None,
    out: Path,
    json: str | None,
    drives: Drives | None = None,
    mcap: Path | None = None,
    scatter: bool = False,
) -> None:
    """Convert foreign telemetry; see `zygos convert --help`. scatter: as of `converted`."""
    kind: Input = "mcap" if is_mcap(source) else "table" if is_table(source) else "log"
    _check_names(source, dbc, out, kind, mapped=map_file is not None, drives=drives)
    chosen = arm_file or (map_file or source).parent / "arm.toml"
    if not local(chosen).is_file():
        near = "the recording" if map_file is None else "the map"
        raise ZygosError(f"{chosen}: no such arm file; remedy: give it with --arm, or put arm.toml next to {near}")
    beside = out.parent / "arm.toml"
    check_outputs([out, json, mcap], [source, *dbc, map_file, chosen, beside])
    arm = load_arm(chosen)
    # raises an error for an arm that the library refuses, before anything is read; on the ground any window will do
    Flight(receivable(arm) if arm.grounded else arm)
    run = None if map_file or drives else read_run(source, arm)
    with progress() as bar:
        mapping = run_map(run) if run else _map(map_file or source, drives, arm, kind)
        dictionary = drives.dictionary if drives else partial(Dictionary.load, dbc)
        recording = run_recording(run, mapping) if run else _read(source, kind, dictionary, mapping, bar)
        samples = {source: len(one.value) for source, one in recording.sources.items()}
        result = converted(recording, mapping, arm, scatter)
        mended, found, noise, described = result.mended, result.found, result.noise, result.arm
        recording = mended.recording
        cycles = with_breaks(result.cycles, run) if run else result.cycles
        text = local(chosen).read_text(encoding="utf-8") if described is arm else noisier_arm_text(chosen, described)
        rate, needed = needed_rate(found, arm, mapping)
        # if the motion passes the test with even stamps, it is not too fast
        _, even = needed_rate([track.evened for track in found], arm, mapping) if needed != rate else (rate, needed)
        frames = None if is_table(out) else encode(described, with_time(cycles))
        write_run(out, cycles, frames, arm.period_s, text, chosen)
        if mcap:
            write_mcap(mcap, measured(described, cycles), {"effort": arm.unit("Nm")})
        refused = refused_share(described, cycles, frames)
    rows = signal_rows(samples, mended, found, cycles, described, noise)
    cutoff = arm.smoother.cutoff_hz
    fitting = fitting_cutoff_hz(cycles, described) if cutoff is None else None
    warnings = [*result.warnings, *warnings_of(arm, cycles, described, recording, found, out, refused)]
    content: dict[str, Any] = {
        "input": str(source),
        "map": str(map_file) if map_file else None,
        "run": str(out),
        "arm": str(beside),
        "door": "cycle" if is_table(out) else "frames",
        "time": mapping.clock.kind,
        "interpolation": mapping.clock.interpolation,
        "period_s": arm.period_s,
        "cycles": len(cycles),
        "breaks": int(np.count_nonzero(cycles.flags)),
        "left_out": result.lost,
        "damage": recording.missing or None,
        "damaged_frames": recording.damaged,
        "signals": rows,
        "bandwidth": {
            "rate_hz": rate,
            "needed_hz": needed,
            "needed_with_even_stamps_hz": even,
            "stamps_sigma_s": stamps_sigma(found),
            "refused_share": refused,
            "fitting_cutoff_hz": fitting,
        },
        "warnings": warnings,
    }
    _tell(content, json)
    recorded = 1.0 / max(track.interval_s for track in found) if len(cycles) > 1 else rate
    faster = "shorten period_s of the arm file" if recorded > 1.2 * rate else "record faster"
    if recorded * SPARSE * arm.period_s < 1.0 and mapping.clock.kind in ("column", "signal"):
        faster = f'correct unit = "{mapping.clock.unit}" of the time in the map if it is in another one; else {faster}'
    _judge(content["bandwidth"], faster, mapping, out, arm)
    not_whole(recording.missing)


def _map(file: Path, drives: Drives | None, arm: Arm, kind: Input) -> Map:
    """The map of the drives, or of a file."""
    return drives.mapping(arm) if drives else load_map(file, arm, kind)


def _read(source: Path, kind: Input, dictionary: Callable[[], Dictionary], mapping: Map, bar: Progress) -> Recording:
    """Read the signals of a map, and say how far the reading is. dictionary: reads the messages of a CAN log."""
    task = bar.add_task(f"reading {source.name}", total=None)

    def reading(count: int) -> None:
        noun = "messages" if kind == "mcap" else "frames"
        bar.update(task, description=f"reading {source.name}: {count:,} {noun}")

    if kind == "table":
        recording = read_table(source, mapping)
    elif kind == "mcap":
        recording = read_mcap(source, mapping, reading)
    else:
        recording = read_can(source, dictionary(), mapping, reading)
    bar.update(task, description="converting")
    warn((*recording.remarks, *recording.missing))
    return recording


def _check_names(
    source: Path, dbc: Sequence[Path], out: Path, kind: Input, *, mapped: bool, drives: Drives | None
) -> None:
    if drives and (dbc or mapped):
        given = "--dbc" if dbc else "--map"
        raise ZygosError(f"--drive {drives.name} has its DBC and its map; remedy: leave out {given}")
    if drives and kind != "log":
        raise ZygosError(f"{source}: --drive is for a CAN log; remedy: give one, or a map with --map")
    if kind != "log":
        check = check_mcap if kind == "mcap" else check_table
        check(source)
        if dbc:
            called = "an MCAP" if kind == "mcap" else "a table"
            raise ZygosError(f"{source}: {called} needs no --dbc; remedy: leave it out")
        if kind == "mcap" and not mapped:
            raise ZygosError(f"{source}: an MCAP needs a map; remedy: give it with --map (docs/telemetry.md)")
    else:
        bus.check_log(source)
        if not dbc and mapped:
            raise ZygosError(f"{source}: a CAN log needs the DBC of its bus; remedy: give it with --dbc")
    if is_dash(out):
        raise ZygosError("- cannot be the run, which needs its arm file next to it; remedy: give -o a file name")
    if not is_table(out):
        bus.check_log_name(out)


def _tell(content: dict[str, Any], json: str | None) -> None:
    if json != "-":
        _print(content)
    if json:
        write_json(json, content)


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
    turns = sum(row["turns"] for row in content["signals"])
    bridged, longest = (max(row[key] for row in content["signals"]) for key in ("bridged", "longest_bridged_s"))
    say(
        f"{content['run']}: {counted(content['cycles'], 'cycle')} at {1 / content['period_s']:g} Hz {how}, "
        f"{counted(content['breaks'], 'break')}, left out: {left or 'nothing'}"
        + (f", {counted(bridged, 'gap')} of up to {1e3 * longest:.3g} ms bridged" if bridged else "")
        + (f", {counted(turns, 'turn')} unwrapped" if turns else "")
        + " · output: "
        + ("table of cycles" if content["door"] == "cycle" else "CAN frames")
    )
    for line in content["warnings"]:
        say(f"check: {line}")
    say(f"next: zygos check-arm {content['run']} · signs, places, scales and delays of the signals")


def _judge(bandwidth: dict[str, Any], faster: str, mapping: Map, out: Path, arm: Arm) -> None:
    """Raise Undecided if the motion is faster than the recording, or seems so because of its time stamps.

    faster: what makes the grid faster.
    """
    rate, needed, refused = (bandwidth[key] for key in ("rate_hz", "needed_hz", "refused_share"))
    even, stamps_s = bandwidth["needed_with_even_stamps_hz"], bandwidth["stamps_sigma_s"]
    cutoff_hz = arm.smoother.cutoff_hz
    smoother = "make the motion smoother: the test counts vibration and jerks as motion"
    if arm.grounded and bandwidth["fitting_cutoff_hz"] is not None:
        smoother = (
            f"write cutoff_hz = {bandwidth['fitting_cutoff_hz']:g} in [smoother] of the arm file: twice the frequency "
            "below which 99 % of the square of the rates lies"
        )
    jitter = f"the time stamps jitter by {1e3 * stamps_s:.3g} ms ({100 * stamps_s * rate:.0f} % of the interval)"
    if cutoff_hz is not None and needed is not None and needed > rate * 1.001:
        raise Undecided(
            f"{rate:.4g} Hz; a cut-off of {cutoff_hz:g} Hz needs >= {needed:.4g} Hz ({out} written); remedy: {faster}, "
            "or lower cutoff_hz of the arm file"
        )
    if needed is None or needed > rate * 1.001:
        if even is not None and even <= rate * 1.001:
            raise Undecided(
                f"{jitter}, which looks like motion in the bandwidth test; with even stamps the same samples pass at "
                f'{rate:.4g} Hz ({out} written); remedy: use a cycle counter (source = "sync"), or a time that is '
                "taken with the sample; recording faster does not help"
            )
        # a number that even stamps reduce is not due to the motion alone
        known = [one for one in (needed, even) if one is not None]
        wanted = f">= {min(known):.4g} Hz" if known else "more than the searched range"
        raise Undecided(f"{rate:.4g} Hz; this motion needs {wanted} ({out} written); remedy: {faster}, or {smoother}")
    if cutoff_hz is None and refused is not None and refused > MAX_REFUSED_SHARE:
        raise Undecided(
            f"{refused:.0%} of the instants fail the bandwidth test on the grid, though the telemetry is fast enough "
            f"({out} written; {jitter}); remedy: "
            + ('interpolation = "cubic", ' if mapping.clock.interpolation == "linear" else "")
            + 'correct quanta in the arm file, or a cycle counter (source = "sync")'
        )


@cuts
def command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="A CAN log (.log .blf .asc .trc .mf4), a table (.csv .parquet .npz), or an MCAP (.mcap).",
            callback=of_runs,
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="RUN", help="The run to write: a CAN log or a table of cycles.")
    ],
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="MAP.toml",
            help="Assigns signals to readings of the arm, with units. Not needed for a run of zygos.",
            callback=of_map,
        ),
    ] = None,
    dbc: Annotated[
        list[Path] | None,
        typer.Option("--dbc", metavar="MY.dbc", help="The DBC of a CAN log; may be given several times."),
    ] = None,
    arm: Annotated[
        Path | None,
        typer.Option(
            "--arm",
            metavar="ARM.toml",
            help="The arm file. Default: arm.toml next to the map or the run.",
            callback=of_arm,
        ),
    ] = None,
    drive: Drive = None,
    nodes: Nodes = None,
    eds: Eds = None,
    urdf: Urdf = None,
    json: Json = None,
    mcap: Mcap = None,
) -> None:
    """Convert telemetry of another system to a run.

    Decodes a CAN log with its own DBC, a table by its columns, or an MCAP with JointState and Imu messages of ROS 2 by
    its topics, converts signals to SI units by scale, sign and unit, and writes RUN with arm.toml next to it. A cycle
    counter in the telemetry gives one record per cycle. Without one, signals are interpolated on the grid of the arm's
    period, or averaged if they are recorded at 2.5 times its rate or more, and the arm.toml next to RUN declares the
    noise that they then have. The table shows the range of every signal: check whether it is plausible.

    Without --map the recording is a run already: angles that start again after a turn are unwrapped, and impossible
    samples are left out.

    An earlier RUN and its arm.toml are replaced.

    Exit code 3 when the motion is faster than the recording; RUN is written nevertheless.

    Example: zygos convert MY.blf --dbc MY.dbc --map map.toml -o out/run.blf

    Example: zygos convert run.log --drive damiao --nodes 1-7 --urdf arm.urdf -o run.npz
    """
    check_mcap_name(mcap)
    drives = named_drives(drive, nodes, eds, arm, urdf)
    with arm_file_of(arm, urdf, drives, "convert") as described:
        convert_run(source, dbc or [], map_file, described, out, json, drives, mcap, scatter=urdf is not None)

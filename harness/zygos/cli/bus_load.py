# SPDX-License-Identifier: MIT
"""`zygos bus-load`: computes how much of a classical CAN bus an arm's frames take, and prints a table."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from zygos.arm import Arm, load_arm
from zygos.can.bus import check_log
from zygos.can.load import LIMIT, OTHERS, Plan, Usage, exact_bits, plan, usage
from zygos.cli.options import Json, cuts
from zygos.cli.shared import not_whole, read_run
from zygos.errors import Undecided, ZygosError
from zygos.files.output import check_outputs, counted, note, number, say, table, write_json
from zygos.files.progress import progress
from zygos.files.tables import is_table

_FASTEST = 1_000_000
"""Largest bit rate of classical CAN, bit/s."""


_LONGEST_S = 0.065
"""Largest SYNC period of an arm file, s (docs/wire.md)."""


_AT_ONCE = 65_536
"""Number of frames whose bits are counted together."""


def report_bus_load(
    arm_file: Path, bitrate: int, attitude_hz: float | None, telemetry_hz: float, run: Path | None, json: str | None
) -> None:
    """Print the load of an arm's frames; see `zygos bus-load --help`."""
    if run is not None:
        if is_table(run):
            raise ZygosError(
                f"{run}: a table of cycles has no frames whose bits could be counted; remedy: give the CAN log"
            )
        check_log(run)
    check_outputs([json], [arm_file, run])
    arm = load_arm(arm_file)
    planned = plan(arm, bitrate, attitude_hz, telemetry_hz)
    used, log = None, None
    if run is not None:
        log = read_run(run, arm)
        frames = log.frames
        assert frames is not None
        parts = [frames[k : k + _AT_ONCE] for k in range(0, len(frames), _AT_ONCE)]
        with progress() as bar:
            bits = np.concatenate([exact_bits(part) for part in bar.track(parts, description="counting bits")])
        used = usage(arm, bitrate, frames, bits)
    if json:
        write_json(
            json,
            {
                "arm": arm.name,
                "bitrate": bitrate,
                "sync_hz": 1.0 / arm.period_s,
                "messages": [asdict(share) for share in planned.shares],
                "load": planned.load,
                "limit": LIMIT,
                "margin": LIMIT - planned.load,
                "largest_sync_hz": planned.largest_sync_hz,
                "run": None if used is None else {"file": str(run), **asdict(used)},
            },
        )
    if json != "-":
        _print(arm, bitrate, planned, used)
    if used is not None and used.uncounted:
        note(f"{counted(used.uncounted, 'error or CAN FD frame')} of {run}: their bits are not counted")
    if planned.load > LIMIT:
        much = "exceeds the bus" if planned.load > 1.0 else f"is above {100 * LIMIT:g} %"
        raise Undecided(f"a load of {100 * planned.load:.1f} % {much}; remedy: {_remedy(planned, bitrate)}")
    if used is not None and used.load > LIMIT:
        raise Undecided(
            f"{run}: a load of {100 * used.load:.1f} % is above {100 * LIMIT:g} %, {OTHERS} included; remedy: a higher "
            "bit rate, or fewer foreign frames"
        )
    not_whole(log.damage if log else ())


def _print(arm: Arm, bitrate: int, planned: Plan, used: Usage | None) -> None:
    rows = [
        [
            share.name,
            f"0x{share.id:03X}",
            str(share.bytes),
            str(share.bits),
            number(share.rate_hz),
            _percent(share.load),
        ]
        for share in planned.shares
    ]
    columns = ["message", "identifier", "bytes", "bits at worst", "per second", "load %"]
    total = ["all", "", "", "", number(sum(share.rate_hz for share in planned.shares)), _percent(planned.load)]
    if used is not None:
        columns += ["frames in the log", "bits, mean", "load %"]
        rows.append([OTHERS, *[""] * 5])
        capacity = bitrate * used.duration_s
        for row in rows:
            frames, bits = used.frames[row[0]], used.bits[row[0]]
            row += [f"{frames:,}", number(bits / frames, 4) if frames else "–", _percent(bits / capacity)]
        total += [f"{sum(used.frames.values()):,}", "", _percent(used.load)]
    table(columns, [*rows, total])
    if used is not None:
        say(f"the log: {used.duration_s:,.1f} s, cycle with the largest load {_percent(used.busiest)} %")
    say(
        f"arm {arm.name} · {bitrate:,} bit/s · SYNC {1 / arm.period_s:.6g} Hz · load {_percent(planned.load)} %, "
        f"margin to {100 * LIMIT:g} % {_percent(LIMIT - planned.load)} % · largest SYNC rate "
        f"{math.floor(10 * planned.largest_sync_hz) / 10:g} Hz"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.3f}"


def _remedy(planned: Plan, bitrate: int) -> str:
    ways = []
    if planned.largest_sync_hz >= 1.0 / _LONGEST_S:
        ways.append(f"a period_s of at least {math.ceil(1e6 / planned.largest_sync_hz) / 1e6:g}")
    needed = math.ceil(planned.load * bitrate / LIMIT)
    if needed <= _FASTEST:
        ways.append(f"at least {needed:,} bit/s")
    return " or ".join([*ways, "fewer frames of attitude and telemetry"] if ways else ["fewer joints on this bus"])


@cuts
def command(
    run: Annotated[
        Path | None,
        typer.Argument(metavar="RUN", help="Also count the bits of this CAN log, stuff bits included."),
    ] = None,
    *,
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    bitrate: Annotated[
        int, typer.Option(metavar="BIT/S", min=1000, max=1_000_000, help="The bit rate of the bus.")
    ] = 1_000_000,
    attitude_hz: Annotated[
        float | None,
        typer.Option(metavar="HZ", min=0.0, max=1e6, help="Attitude frames per second. Default: 100 with a gyro."),
    ] = None,
    telemetry_hz: Annotated[
        float, typer.Option(metavar="HZ", min=0.0, max=1e6, help="Telemetry frames per second.")
    ] = 100.0,
    former: Annotated[
        Path | None, typer.Option("--run", metavar="RUN", help="Former place of RUN.", hidden=True)
    ] = None,
    json: Json = None,
) -> None:
    """Compute how much of the bus this arm's frames take, and its largest SYNC rate.

    The load is that at the arm file's period_s if bit stuffing makes every frame as long as possible. The largest SYNC
    rate is the one that fills 70 % of the bus.

    Exit code 3 when the load is above 70 %, or that of RUN including all foreign frames.

    Example: zygos bus-load --arm examples/paper/arm.toml --bitrate 500000
    """
    if former is not None:
        note("zygos: --run goes in the next version: the run comes first, `zygos bus-load RUN --arm ARM.toml`")
    report_bus_load(arm, bitrate, attitude_hz, telemetry_hz, run or former, json)

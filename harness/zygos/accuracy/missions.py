# SPDX-License-Identifier: MIT
"""`python -m zygos.accuracy.missions`, used by `make mission`: coverage of intervals in runs from a minute to a
month."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.accuracy import campaign
from zygos.accuracy.cases import Case
from zygos.accuracy.cell import fingerprint
from zygos.accuracy.mission import LENGTHS, LOST, MISSING, MOTION_S, MOTIONS, REPEATED, Mission
from zygos.arm import load_arm
from zygos.errors import ZygosError
from zygos.files.output import (
    check_outputs,
    counted,
    errors_end_the_program,
    number,
    say,
    table,
    write_json,
    write_text,
)
from zygos.model.model import load_model
from zygos.report.provenance import measured_commit
from zygos.simulation.scenario import load_scenario

Line = dict[str, Any]

EXAMPLE = "paper"
FOLDER = Path("out/mission")


def case_of(name: str, folder: Path = Path("examples")) -> Case:
    """The arm, plant and scenario of an example. Errors: ZygosError if it has none."""
    own = folder / name
    if not (own / "scenario.toml").is_file():
        raise ZygosError(
            f"{own / 'scenario.toml'}: no such file; remedy: run inside a checkout, and name a folder of {folder}/"
        )
    arm = load_arm(own / "arm.toml")
    return Case(name, "", arm, arm, load_model(own / "model.toml"), load_scenario(own / "scenario.toml"))


def summarised(case: Case, lines: Sequence[Line]) -> list[Line]:
    """One entry for each length, which compares the estimates with the true values."""
    true = case.model.base_values(case.arm)
    out = []
    for length in LENGTHS:
        own = [line for line in lines if (line["case"], line["length"]) == (case.name, length.name)]
        if not own:
            continue
        value, half, sigma = (
            np.array([line[key] for line in own], dtype=np.float64) for key in ("value", "half95", "sigma")
        )
        with np.errstate(invalid="ignore"):
            holds = np.abs(value - true) <= half
        published = np.isfinite(half)
        each = [float(h[p].mean()) for h, p in zip(holds, published, strict=True) if p.any()]
        parameters = {}
        for k, name in enumerate(case.arm.parameter_names):
            error = 100.0 * (value[:, k] / true[k] - 1.0)
            parameters[name] = {
                "bias_percent": float(np.nanmean(error)),
                "spread_percent": float(np.nanstd(error, ddof=1)) if len(own) > 1 else None,
                "half95_percent": float(np.nanmedian(100.0 * half[:, k] / abs(true[k]))),
                "sigma_percent": float(np.nanmedian(100.0 * sigma[:, k] / abs(true[k]))),
                "coverage95": float(holds[published[:, k], k].mean()) if published[:, k].any() else None,
            }
        out.append(
            {
                "case": case.name,
                "length": length.name,
                "door": length.door,
                "missions": len(own),
                "cycles": own[0]["cycles"],
                "resumed": own[0]["resumed"],
                "valid": sum(line["validity"] == "valid" for line in own),
                "coverage95": float(np.mean(each)) if each else None,
                "coverage95_error": float(np.std(each, ddof=1) / np.sqrt(len(each))) if len(each) > 1 else None,
                "seconds": float(np.median([line["seconds"] for line in own])),
                "parameters": parameters,
            }
        )
    return out


def missions_page(entries: Sequence[Line]) -> str:
    """The numbers as Markdown."""
    lines = [
        "# Coverage of the intervals, from a minute to a month",
        "",
        f"`make mission` writes this page. A mission repeats up to {REPEATED} of {MOTIONS} stored motions of "
        f"{MOTION_S:g} s. The motions differ because the errors of the encoders act on the servo. "
        "Every repetition draws new errors of all sensors. "
        f"Between two motions, {MISSING} cycles are missing, and a share of {LOST:g} of the CAN traffic is lost. "
        "The state is saved and resumed once per day of the mission, or once per hour in missions of up to a day. "
        "In the tables, *bias* and *spread* are the mean and the standard deviation of the errors over the missions, "
        "and *half width* is the median half width of the 95 % interval. All three are in percent of the true value. "
        "*Coverage* is the share of intervals that contain the true value. "
        f"Measured with commit {measured_commit()}.",
    ]
    for entry in entries:
        off = entry["coverage95_error"]
        lines += [
            "",
            f"## {entry['case']}, {entry['length']}",
            "",
            f"{counted(entry['missions'], 'mission')} of {entry['cycles']:,} cycles, sent as {entry['door']}, "
            f"{entry['valid']} of them valid, each resumed {counted(entry['resumed'], 'time')}. "
            f"The intervals contain the true value in {100 * (entry['coverage95'] or 0.0):.1f} %"
            + (f" ± {100 * off:.1f} %" if off is not None else "")
            + " of all cases.",
            "",
            "| parameter | bias % | spread % | half width % | coverage % |",
            "|---|---|---|---|---|",
        ]
        for name, own in entry["parameters"].items():
            share = own["coverage95"]
            lines.append(
                f"| {name} | {number(own['bias_percent'], 3)} | {number(own['spread_percent'], 3)} | "
                f"{number(own['half95_percent'], 3)} | {number(100 * share if share is not None else None, 3)} |"
            )
    return "\n".join(lines) + "\n"


def mission(
    lengths: Annotated[
        list[str] | None, typer.Argument(metavar="[LENGTH]...", help="60s, 300s, 3h, 30d; default: all of them.")
    ] = None,
    example: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Folder of examples/; repeatable; default: paper.")
    ] = None,
    draws: Annotated[
        int | None, typer.Option(min=1, help="Missions of each length; default: 200, 200, 60, 12.")
    ] = None,
    door: Annotated[
        str | None, typer.Option(help="Input of the library: frames or cycles; default: frames, but cycles for 30d.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1,
    folder: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder of stored motions and finished missions.")
    ] = FOLDER,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Results; default: docs/mission.json, if all lengths run.")
    ] = None,
) -> None:
    """Repeat stored motions with new sensor errors, for up to a month, and count how often the intervals hold.

    Example: python -m zygos.accuracy.missions 300s --draws 20
    """
    known = {length.name: length for length in LENGTHS}
    for name in lengths or []:
        if name not in known:
            raise ZygosError(f"there is no length {name!r}; remedy: use one of {', '.join(known)}")
    if door not in (None, "frames", "cycles"):
        raise ZygosError(f"{door!r} is not a value of --door; remedy: write frames or cycles")
    chosen_lengths = [
        replace(length, door=door or length.door, draws=draws or length.draws)
        for length in LENGTHS
        if not lengths or length.name in lengths
    ]
    target = json or (FOLDER / "mission.json" if lengths or draws or example or door else Path("docs/mission.json"))
    check_outputs([target, target.with_suffix(".md"), folder / "lines.jsonl"], [])
    begin = time.monotonic()
    cases = [case_of(name) for name in example or [EXAMPLE]]
    jobs = [
        Mission(one, replace(length, draws=0), k, folder, fingerprint())
        for one in cases
        for length in chosen_lengths
        for k in range(length.draws)
    ]
    found = campaign.run(jobs, folder / "lines.jsonl", lambda: campaign.executor(None, workers))
    entries = [entry for one in cases for entry in summarised(one, found)]
    write_json(target, {"missions": entries})
    write_text(target.with_suffix(".md"), missions_page(entries))
    table(
        ("case", "length", "missions", "valid", "cycles", "coverage 95 %, %", "worst parameter"),
        [_row(entry) for entry in entries],
    )
    say(f"{counted(len(jobs), 'mission')} in {time.monotonic() - begin:.0f} s · {target} · {target.with_suffix('.md')}")


def _row(entry: Line) -> tuple[str, ...]:
    shares = {name: own["coverage95"] for name, own in entry["parameters"].items() if own["coverage95"] is not None}
    worst = min(shares, key=lambda name: shares[name]) if shares else "–"
    return (
        entry["case"],
        entry["length"],
        str(entry["missions"]),
        str(entry["valid"]),
        f"{entry['cycles']:,}",
        f"{100 * (entry['coverage95'] or 0.0):.1f} ± {100 * (entry['coverage95_error'] or 0.0):.1f}",
        f"{worst} {100 * shares[worst]:.1f}" if shares else "–",
    )


def main(arguments: list[str] | None = None) -> None:
    """Run with the arguments of the command line, or with the given ones."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(mission)
    with errors_end_the_program():
        app(args=arguments, prog_name="python -m zygos.accuracy.missions")


if __name__ == "__main__":
    main()

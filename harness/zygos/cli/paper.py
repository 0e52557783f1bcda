# SPDX-License-Identifier: MIT
"""`zygos paper`: reproduces the paper's Tables III and IV and Fig. 4(b), next to the printed values."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.arm import Arm
from zygos.cli.options import Json
from zygos.files.output import check_outputs, number, say, table, write_json
from zygos.files.progress import progress
from zygos.paper import printed
from zygos.paper.readings import COLUMNS, compare
from zygos.paper.response import HAIR_RAD, PARTING
from zygos.paper.tables import (
    EXACT,
    NOISE,
    NOISY,
    SAID,
    Floats,
    agreements,
    mean_error,
    paper_example,
    reproduce,
)
from zygos.simulation.score import Score


def run_paper(seeds: int, folder: Path | None, json: str | None) -> None:
    """Print Tables III and IV and the numbers of Fig. 4(b); see `zygos paper --help`."""
    example, momentum = paper_example(folder)
    check_outputs([json], example.files)
    with progress() as bar:
        task = bar.add_task("", total=1.0)
        found = reproduce(
            example, momentum, seeds, lambda what, share: bar.update(task, description=what, completed=share)
        )
    if json:
        write_json(json, found.as_json())
    if json == "-":
        return
    say(f"Noise, as interpreted here: {NOISE}.")
    say(f"{seeds} seeds, {example.scenario.duration_s:g} s at {1 / example.arm.period_s:g} Hz\n")
    _table_3(example.arm, example.true, found.estimates, found.described)
    _table_4(example.arm, found.scores, found.described)
    if found.figure is not None:
        _table_figure(found.figure, example.arm)


def _order(arm: Arm, described: bool) -> list[int]:
    """Rows of a table: in the paper's order for the paper's arm."""
    names = list(arm.parameter_names)
    return [names.index(n) for n in printed.PARAMETERS] if described else list(range(len(names)))


def _table_3(arm: Arm, true: Floats, estimates: dict[str, Floats], described: bool) -> None:
    rows = []
    for k in _order(arm, described):
        n = arm.parameter_names[k]
        row = [n, number(float(true[k]), 9)]
        for name in ("DE", "EB", "EB (32)", "flight"):
            if described and name in printed.ESTIMATES:
                row.append(number(printed.ESTIMATES[name][n], 6))
            row.append(number(float(estimates[name][:, k].mean()), 5))
        rows.append(row)
    paired = ("DE printed", "DE", "EB printed", "EB") if described else ("DE", "EB")
    title = "Table III: estimates in SI units, mean over the seeds"
    table(["", "true", *paired, "EB (32)", "flight"], rows, title=title)
    if described:
        say(
            "\nThe DE estimates are printed with the opposite sign of their error: a00 is printed as 47320, which\n"
            "is 99 % too high, but Table IV says -99 %. Table IV is right, because noise attenuates the estimates.\n"
        )


def _table_4(arm: Arm, scores: dict[str, Score], described: bool) -> None:
    if described:
        for left, right, title in (
            ("DE, exact data", "EB, exact data", "Table IV, exact data: error, %"),
            ("DE", "EB", "Table IV, noise: error, %, mean over the seeds"),
        ):
            heads = ["", "DE printed", "here", "agree in", "EB printed", "here", "agree in"]
            means = {name: mean_error(scores[name]) for name in (left, right)}
            rows = []
            for k in _order(arm, described):
                n = arm.parameter_names[k]
                cells = [n]
                for name in (left, right):
                    ours = float(means[name][k])
                    cells += [number(printed.ERRORS[name][n], 3), number(ours, 3)]
                    cells.append(printed.agreement(ours, printed.ERRORS[name][n]))
                rows.append(cells)
            total = ["in all"]
            for name in (left, right):
                words = list(agreements(name, scores[name], arm).values())
                sizes = [np.mean([abs(x) for x in column]) for column in (printed.ERRORS[name].values(), means[name])]
                total += [*(number(float(size), 3) for size in sizes), _counted(words)]
            table(heads, [*rows, total], title=title)
            say("")
        say(
            f"Sizes agree within a factor of {printed.SIZE:g}. In all: mean size of the errors; number of signs + "
            "sizes that agree.\nThe errors of DE on exact data are rounding errors, here and in the paper.\n"
        )
    names = (*NOISY, *EXACT[1:])
    rows = [
        [arm.parameter_names[k], *(number(float(scores[n].rms[k]), 3) for n in names)] for k in _order(arm, described)
    ]
    rows.append(["mean", *(number(float(np.nanmean(scores[n].rms)), 3) for n in names)])
    rows.append(["largest", *(number(float(np.nanmax(scores[n].rms)), 3) for n in names)])
    heads = ["", *NOISY, *(name.replace(", ", "\n") for name in EXACT[1:])]
    table(heads, rows, title="Table IV, in size: root mean square error over the seeds, %")
    say(f"\nEB (32): {SAID['EB (32)']}. flight reads CAN frames; the last two columns are without noise.")


def _counted(words: Sequence[str]) -> str:
    if "rounding" in words:
        return "rounding"
    return f"{sum('sign' in w for w in words)} + {sum('size' in w for w in words)} of {len(words)}"


def _table_figure(figure: dict[str, Any], arm: Arm) -> None:
    names = list(figure["error_percent"])
    rows = []
    for joint, label in enumerate(joint.name for joint in arm.joints):
        for k, t in enumerate(figure["time_s"]):
            errors = (number(figure["error_percent"][name][joint][k], 3) for name in names)
            rows.append([f"{label} {t:g} s", number(figure["true_rad"][joint][k], 3), *errors])
    rows.append(["rms, both", "", *(number(figure["rms_percent"][name], 3) for name in names)])
    say("")
    table(
        ["", "true, rad", *names],
        rows,
        title="Fig. 4(b): response to the torques (50), error in % of the largest angle of that joint so far",
    )
    for name, why in figure["missing"].items():
        say(f"{name} has no response: {why}")
    say(
        f"\nEB and flight: from seed 0. The motion is not chaotic: a change of the start by {1e3 * HAIR_RAD:g} mrad "
        f"grows by a factor of at most {figure['parting']:.1f}."
        if figure["parting"] < PARTING
        else f"\nEB and flight: from seed 0. The motion is chaotic: a change of the start by {1e3 * HAIR_RAD:g} mrad "
        f"grows by a factor of {figure['parting']:.0f}."
    )


def run_readings(seeds: int, folder: Path | None, json: str | None) -> None:
    """Print how close each interpretation of the paper comes to Table IV; see `zygos paper --help`."""
    example, _ = paper_example(folder)
    check_outputs([json], example.files)
    with progress() as bar:
        task = bar.add_task("", total=1.0)
        found = compare(example, seeds, lambda what, share: bar.update(task, description=what, completed=share))
    if json:
        write_json(json, {"seeds": seeds, "columns": COLUMNS, "printed_percent": printed.ERRORS, "readings": found})
    if json == "-":
        return
    rows = []
    sizes = {name: float(np.mean(np.abs(list(printed.ERRORS[name[:2]].values())))) for name in COLUMNS}
    rows.append(["printed", *(cell for name in COLUMNS for cell in (number(sizes[name], 3), ""))])
    for entry in found:
        cells = (entry[name] for name in COLUMNS)
        rows.append(
            [
                entry["reading"],
                *(text for c in cells for text in (number(c["mean_size_percent"], 3), f"{c['signs']}+{c['sizes']}")),
            ]
        )
    table(["", *(head for name in COLUMNS for head in (name, "agree"))], rows, title=f"Table IV, noise, {seeds} seeds")
    say(
        "\nMean size of the twelve errors in %; number of errors that agree with the printed ones in sign + in size "
        f"(a factor of {printed.SIZE:g})."
    )
    for name, description in COLUMNS.items():
        say(f"{name}: {description}.")


def command(
    seeds: Annotated[int, typer.Option(min=2, max=1000, help="Seeds 0 .. SEEDS-1.")] = 50,
    folder: Annotated[
        Path | None, typer.Option("--example", metavar="FOLDER", help="Folder with arm, model and scenario.toml.")
    ] = None,
    readings: Annotated[
        bool, typer.Option("--readings", help="Instead: compare other interpretations of the paper with Table IV.")
    ] = False,
    json: Json = None,
) -> None:
    """Reproduce the paper's Tables III and IV and the numbers of Fig. 4(b), next to the printed ones.

    AMC, DE and EB, with the paper's sensors and without noise, and the C library for flight. --readings varies what the
    paper leaves open: duration, start, the servo's angle, noise and differences.

    Example: zygos paper --seeds 50
    """
    if readings:
        run_readings(seeds, folder, json)
        return
    run_paper(seeds, folder, json)

"""`zygos paper`: the paper's Tables III and IV and Fig. 4(b), reproduced beside what is printed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.arm import Arm
from zygos.cli.options import Json
from zygos.errors import ZygosError
from zygos.files.output import check_outputs, number, say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import load_model
from zygos.paper import printed
from zygos.paper.methods import amc, de, eb, exact_record, noisy_states
from zygos.paper.readings import COLUMNS, READINGS, closeness, solved
from zygos.paper.response import HAIR_RAD, PARTING
from zygos.paper.tables import (
    EXACT,
    NOISE,
    NOISY,
    SAID,
    Floats,
    agreements,
    flight_estimates,
    mean_error,
    noisy_record,
    paper_example,
    responses,
    summary,
)
from zygos.simulation.plant import simulate
from zygos.simulation.score import Score, score


def run_paper(seeds: int, folder: Path | None, json: str | None) -> None:
    """Print Tables III and IV and the numbers of Fig. 4(b); see `zygos paper --help`."""
    example, momentum = paper_example(folder)
    check_outputs([json], example.files)
    arm, true = example.arm, example.true
    model = load_model(example.scenario.plant)
    with progress() as bar:
        task = bar.add_task(f"simulating {seeds} seeds", total=1.0)

        def show(share: float) -> None:
            bar.update(task, completed=share)

        noisy = simulate(arm, model, example.scenario, seeds=range(seeds), noise=True, progress=show)
        bar.update(task, description="simulating without noise", completed=0.0)
        clean = simulate(arm, model, example.scenario, seeds=[0], noise=False, progress=show)
        bar.update(task, description="estimating", completed=0.0)
        record, exact = noisy_record(arm, noisy), exact_record(clean)
        estimates: dict[str, Floats] = {
            "AMC": amc.estimate(arm, record, momentum_nms=momentum),
            "DE": de.estimate(arm, record),
            "EB": eb.estimate(arm, record, rates="backward", start="rest"),
            "EB (32)": eb.estimate(arm, noisy_states(arm, exact, range(seeds)), rates="exact", start="rest"),
            "flight": flight_estimates(arm, noisy),
            "DE, exact data": de.estimate(arm, exact, exact=True),
            "EB, exact data": eb.estimate(arm, exact, rates="exact", start="rest"),
            "flight, no noise": flight_estimates(arm, clean),
        }
        bar.update(task, description="responding to the torques (50)", completed=0.5)
        told = printed.describes(arm, true)
        figure = responses(arm, true, estimates, momentum) if told else None
    scores = {name: score(value, true) for name, value in estimates.items()}
    content: dict[str, Any] = {
        "arm": arm.name,
        "seeds": seeds,
        "duration_s": example.scenario.duration_s,
        "noise": NOISE,
        "methods": [summary(name, estimates[name], scores[name], arm) for name in estimates],
    }
    if told:
        content["printed"] = {
            "actual": printed.ACTUAL,
            "estimates": printed.ESTIMATES,
            "errors_percent": printed.ERRORS,
            "agreement": {name: agreements(name, scores[name], arm) for name in printed.ERRORS},
        }
    if figure is not None:
        content["figure4b"] = figure
    if json:
        write_json(json, content)
    if json == "-":
        return
    say(f"Noise, as read here: {NOISE}.")
    say(f"{seeds} seeds, {example.scenario.duration_s:g} s at {1 / arm.period_s:g} Hz\n")
    _table_3(arm, true, estimates, told)
    _table_4(arm, scores, told)
    if figure is not None:
        _table_figure(figure, arm)


def _order(arm: Arm, told: bool) -> list[int]:
    """Rows of a table: the paper's order where it is the paper's arm."""
    names = list(arm.parameter_names)
    return [names.index(n) for n in printed.PARAMETERS] if told else list(range(len(names)))


def _table_3(arm: Arm, true: Floats, estimates: dict[str, Floats], told: bool) -> None:
    rows = []
    for k in _order(arm, told):
        n = arm.parameter_names[k]
        row = [n, number(float(true[k]), 9)]
        for name in ("DE", "EB", "EB (32)", "flight"):
            if told and name in printed.ESTIMATES:
                row.append(number(printed.ESTIMATES[name][n], 6))
            row.append(number(float(estimates[name][:, k].mean()), 5))
        rows.append(row)
    paired = ("DE printed", "DE", "EB printed", "EB") if told else ("DE", "EB")
    title = "Table III: estimates in SI units, mean over the seeds"
    table(["", "true", *paired, "EB (32)", "flight"], rows, title=title)
    if told:
        say(
            "\nThe DE estimates are printed with the sign of their error turned round: a00 is 47320, which\n"
            "is 99 % too high, and Table IV says -99 %. Table IV is right: noise attenuates.\n"
        )


def _table_4(arm: Arm, scores: dict[str, Score], told: bool) -> None:
    if told:
        for left, right, title in (
            ("DE, exact data", "EB, exact data", "Table IV, exact data: error, %"),
            ("DE", "EB", "Table IV, noise: error, %, mean over the seeds"),
        ):
            heads = ["", "DE printed", "here", "agree in", "EB printed", "here", "agree in"]
            means = {name: mean_error(scores[name]) for name in (left, right)}
            rows = []
            for k in _order(arm, told):
                n = arm.parameter_names[k]
                cells = [n]
                for name in (left, right):
                    ours = float(means[name][k])
                    cells += [number(printed.ERRORS[name][n], 3), number(ours, 3)]
                    cells.append(printed.agreement(ours, printed.ERRORS[name][n]))
                rows.append(cells)
            said = ["in all"]
            for name in (left, right):
                words = list(agreements(name, scores[name], arm).values())
                sizes = [np.mean([abs(x) for x in column]) for column in (printed.ERRORS[name].values(), means[name])]
                said += [*(number(float(size), 3) for size in sizes), _counted(words)]
            table(heads, [*rows, said], title=title)
            say("")
        say(
            f"Sizes agree within a factor of {printed.SIZE:g}. In all: mean size of the errors; how many signs + sizes "
            "agree.\nWhat DE leaves on exact data is rounding, here as there.\n"
        )
    names = (*NOISY, *EXACT[1:])
    rows = [[arm.parameter_names[k], *(number(float(scores[n].rms[k]), 3) for n in names)] for k in _order(arm, told)]
    rows.append(["mean", *(number(float(np.nanmean(scores[n].rms)), 3) for n in names)])
    rows.append(["largest", *(number(float(np.nanmax(scores[n].rms)), 3) for n in names)])
    heads = ["", *NOISY, *(name.replace(", ", "\n") for name in EXACT[1:])]
    table(heads, rows, title="Table IV, in size: root mean square error over the seeds, %")
    say(f"\nEB (32): {SAID['EB (32)']}. The flight chain reads CAN frames; the last two columns have no noise.")


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
        f"\nEB and flight: from seed 0. The motion is not chaotic: a start {1e3 * HAIR_RAD:g} mrad aside gets at most "
        f"{figure['parting']:.1f} times as far apart."
        if figure["parting"] < PARTING
        else f"\nEB and flight: from seed 0. The motion is chaotic: a start {1e3 * HAIR_RAD:g} mrad aside gets "
        f"{figure['parting']:.0f} times as far apart."
    )


def run_readings(seeds: int, folder: Path | None, json: str | None) -> None:
    """Print how close each reading comes to Table IV; see `zygos paper --help`."""
    example, _ = paper_example(folder)
    check_outputs([json], example.files)
    if not printed.describes(example.arm, example.true):
        raise ZygosError(
            f"arm {example.arm.name}: its true values are not those of the paper's Table III, with which the readings "
            "are compared; remedy: examples/paper, or a copy of it with another scenario"
        )
    if any(not motion.sines for motion in example.scenario.manoeuvre.values()):
        raise ZygosError(
            f"scenario {example.scenario.name}: a joint has no sines, as the paper's motion (47) has; remedy: "
            '`kind = "sines"` for each joint'
        )
    model = load_model(example.scenario.plant)
    found = []
    with progress() as bar:
        task = bar.add_task("", total=float(len(READINGS)))
        for index, reading in enumerate(READINGS):
            bar.update(task, description=reading.said, completed=float(index))
            arm, scenario = reading.arm(example.arm), reading.scenario(example.scenario)
            noisy = simulate(arm, model, scenario, seeds=range(seeds), noise=True, rtol=1e-9, atol=1e-11)
            exact = exact_record(simulate(arm, model, scenario, seeds=[0], noise=False))
            record, states = noisy_record(arm, noisy), noisy_states(arm, exact, range(seeds))
            estimates = {
                "DE": de.rows(arm, record),
                "DE (32)": de.rows(arm, states, exact=True),
                "EB": eb.rows(arm, record, reading.rates),
                "EB (32)": eb.rows(arm, states, "exact"),
            }
            close: dict[str, Any] = {"reading": reading.said}
            for name, (z, w) in estimates.items():
                value = solved(z, w, reading.every, 2 * arm.n + 1 if "DE" in name else 1)
                close[name] = closeness(name, value, example.true, arm)
            found.append(close)
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
        "\nMean size of the twelve errors in %; how many of them agree with the printed ones in sign + in size "
        f"(a factor of {printed.SIZE:g})."
    )
    for name, said in COLUMNS.items():
        say(f"{name}: {said}.")


def command(
    seeds: Annotated[int, typer.Option(min=2, max=1000, help="Seeds 0 .. SEEDS-1.")] = 50,
    folder: Annotated[
        Path | None, typer.Option("--example", metavar="FOLDER", help="Folder with arm, model and scenario.toml.")
    ] = None,
    readings: Annotated[
        bool, typer.Option("--readings", help="Instead: how close other readings of the paper come to Table IV.")
    ] = False,
    json: Json = None,
) -> None:
    """Reproduce the paper's Tables III and IV and the numbers of Fig. 4(b), with the printed ones beside them.

    AMC, DE and EB, with the paper's sensors and without, and the flight chain. --readings varies what the paper leaves
    open: duration, start, the servo's angle, noise and differences.

    Example: zygos paper --seeds 50
    """
    if readings:
        run_readings(seeds, folder, json)
        return
    run_paper(seeds, folder, json)

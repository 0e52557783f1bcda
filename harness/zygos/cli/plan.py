"""`zygos plan`: what a motion will tell about each parameter, and a motion that tells more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.arm import load_arm
from zygos.cli.options import Json
from zygos.cli.shared import check_model_name
from zygos.errors import ZygosError
from zygos.files.output import check_outputs, number, quiet, say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import load_model
from zygos.plan.expected import Expectation, expected_on_ground, scenario_of
from zygos.plan.limits import Limits, as_number, limits_of, per_joint
from zygos.plan.rows import Grounded
from zygos.plan.search import search
from zygos.simulation.scenario import load_scenario, save_scenario


def plan_motion(
    arm_file: Path,
    model_file: Path,
    scenario_files: Sequence[Path],
    out: Path | None,
    angle: str | None,
    rate: str | None,
    torque: str | None,
    torque_noise: str | None,
    period_s: float,
    harmonics: int,
    duration_s: float,
    seed: int,
    json: str | None,
) -> None:
    """Rank motions and plan one; see `zygos plan --help`."""
    if out is not None:
        check_model_name(out)
    check_outputs([out, json], [arm_file, model_file, *scenario_files])
    if out is None and not scenario_files:
        raise ZygosError(
            "there is nothing to plan; remedy: name the scenario to write with -o, or scenarios whose motions are ranked"
        )
    arm, model = load_arm(arm_file), load_model(model_file)
    limits = limits_of(arm, angle, rate, torque)
    sigma = np.array([joint.torque_sigma for joint in arm.joints])
    if torque_noise is not None:
        texts = per_joint([joint.name for joint in arm.joints], "torque noise", torque_noise, "nan")
        sigma = np.array([as_number("torque noise", text) for text in texts.values()])
    grounded = Grounded(arm, model, sigma)
    given: list[Expectation] = []
    planned: Expectation | None = None
    with progress() as bar:
        for file in scenario_files:
            task = bar.add_task(f"computing {file.name}", total=1.0)
            scenario = load_scenario(file)
            given.append(
                expected_on_ground(grounded, scenario, limits, lambda share, k=task: bar.update(k, completed=share))
            )
            bar.update(task, completed=1.0)
        if out is not None:
            repeats = duration_s / period_s
            if abs(repeats - round(repeats)) > 1e-9 or round(repeats) < 1:
                raise ZygosError(
                    f"{duration_s:g} s are not a whole number of periods of {period_s:g} s, so that the motion would not "
                    "end at rest; remedy: a multiple of --period as --duration"
                )
            task = bar.add_task("searching a motion", total=1.0)
            found = search(
                grounded,
                limits,
                period_s,
                harmonics,
                seed=seed,
                progress=lambda share: bar.update(task, completed=share),
            )
            bar.update(task, completed=1.0)
            scenario = scenario_of(grounded, found.motion, out.stem, arm_file, model_file, duration_s, seed)
            planned = expected_on_ground(grounded, scenario, limits)
            save_scenario(scenario, out)
    best = min([*given, *([planned] if planned else [])], key=lambda one: one.measure)
    if not quiet(out, json):
        _tables(given, planned)
    if json:
        write_json(json, _answer(arm.name, given, planned, best, out, limits))


def _tables(given: Sequence[Expectation], planned: Expectation | None) -> None:
    every = [*given, *([planned] if planned else [])]
    rows = [
        (
            column.name,
            column.unit,
            number(column.value, 4),
            *(number(float(one.percent[k]), 3) for one in every),
        )
        for k, column in enumerate(every[0].columns)
    ]
    table(("parameter", "unit", "model", *(f"{one.name} %" for one in every)), rows)
    ranked = sorted(every, key=lambda one: one.measure)
    if len(every) > 1:
        table(
            ("motion", "mean sigma, relative to the best", "worst parameter", "its sigma in %"),
            [
                (
                    one.name,
                    number(math.exp(one.measure - ranked[0].measure), 3),
                    one.worst.name,
                    number(float(one.percent[one.columns.index(one.worst)]), 3),
                )
                for one in ranked
            ],
        )
    for one in every:
        say(
            f"{one.name}: expected of one run · worst is {one.worst.name} with "
            f"{number(float(one.percent[one.columns.index(one.worst)]), 3)} % · largest rate "
            f"{number(float(np.abs(one.rate).max()), 3)} rad/s · largest torque "
            f"{number(float(np.abs(one.torque).max()), 3)} Nm"
        )


def _answer(
    arm: str,
    given: Sequence[Expectation],
    planned: Expectation | None,
    best: Expectation,
    out: Path | None,
    limits: Limits,
) -> dict[str, Any]:
    return {
        "arm": arm,
        "scenario": str(out) if out else None,
        "best": best.name,
        "limits": {
            "low_rad": limits.low.tolist(),
            "high_rad": limits.high.tolist(),
            "rate_rad_s": limits.rate.tolist(),
            "torque_nm": limits.torque.tolist(),
        },
        "motions": [
            {
                "name": one.name,
                "planned": one is planned,
                "measure": one.measure,
                "worst": one.worst.name,
                "largest_rate_rad_s": np.abs(one.rate).max(axis=0).tolist(),
                "largest_torque_nm": np.abs(one.torque).max(axis=0).tolist(),
                "parameters": [
                    {
                        "name": column.name,
                        "unit": column.unit,
                        "value": column.value,
                        "sigma": float(sigma),
                        "percent": float(percent),
                        "of_the_arm": column.structural,
                    }
                    for column, sigma, percent in zip(one.columns, one.sigma, one.percent, strict=True)
                ],
            }
            for one in (*given, *([planned] if planned else []))
        ],
    }


def command(
    arm: Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.")],
    model: Annotated[Path, typer.Option("--model", metavar="MODEL.toml", help="The model that is assumed.")],
    scenarios: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[SCENARIO.toml]...", help="Motions to rank, and to compare the planned one with."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="SCENARIO.toml", help="Search a motion, and write it here.")
    ] = None,
    candidates: Annotated[
        bool, typer.Option("--candidates", help="Only rank the given scenarios; not together with -o.")
    ] = False,
    angle: Annotated[
        str | None,
        typer.Option(
            metavar="RAD", help="Range of the angles: A for -A to A, or LOW:HIGH; NAME=LOW:HIGH,... for single joints."
        ),
    ] = None,
    rate: Annotated[
        str | None, typer.Option(metavar="RAD/S", help="Largest rate; NAME=RATE,... for single joints.")
    ] = None,
    torque: Annotated[
        str | None,
        typer.Option(metavar="NM", help="Largest torque, as in the frames; NAME=TORQUE,... for single joints."),
    ] = None,
    torque_noise: Annotated[
        str | None,
        typer.Option(metavar="NM", help="Standard deviation of the torques. Default: torque_sigma of the arm file."),
    ] = None,
    period: Annotated[float, typer.Option(metavar="S", min=0.5, help="Period of the motion.")] = 10.0,
    harmonics: Annotated[int, typer.Option(metavar="K", min=3, max=30, help="Harmonics of the motion.")] = 5,
    duration: Annotated[
        float, typer.Option(metavar="S", min=0.5, help="Duration of the run, in whole periods.")
    ] = 20.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the search.")] = 0,
    json: Json = None,
) -> None:
    """Plan a motion that excites every parameter, or rank given motions by what they tell.

    The table has the standard deviation that is expected of each parameter after one run.

    Example: zygos plan arm.toml --model model.toml --angle 2.5 --rate 1.5 -o planned.toml
    """
    if candidates and out is not None:
        raise ZygosError("--candidates only ranks; remedy: leave out --candidates, or -o")
    plan_motion(
        arm,
        model,
        scenarios or [],
        out,
        angle,
        rate,
        torque,
        torque_noise,
        period,
        harmonics,
        duration,
        seed,
        json,
    )

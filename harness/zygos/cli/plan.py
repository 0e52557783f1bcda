# SPDX-License-Identifier: MIT
"""`zygos plan`: what a motion will tell about each parameter, and a motion that tells more."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import Progress, TaskID

from zygos.arm import Arm, load_arm
from zygos.cli.options import Details, Json, Report, of_arm
from zygos.cli.shared import Wanted, check_model_name, deliver
from zygos.errors import ZygosError
from zygos.files.inputs import toml_kind
from zygos.files.output import check_outputs, note
from zygos.files.progress import progress
from zygos.model.model import load_model
from zygos.plan.expected import Expectation
from zygos.plan.limits import ANGLE_RAD, RATE_RAD_S, as_number, limits_of, per_joint
from zygos.plan.planning import Motion, Planner, ranked
from zygos.plan.sections import answer_of, as_json
from zygos.plan.simulated import By
from zygos.report.provenance import provenance
from zygos.simulation.scenario import load_scenario, save_scenario


def plan_motion(
    arm_file: Path,
    model_file: Path,
    scenario_files: Sequence[Path],
    out: Path | None,
    limits: tuple[str | None, str | None, str | None],
    torque_noise: str | None,
    sought: Motion,
    wanted: Wanted,
    called: Sequence[str],
    by: By = "energy",
) -> None:
    """Rank motions and plan one; see `zygos plan --help`."""
    if out is not None:
        check_model_name(out)
    check_outputs([out, wanted.json, wanted.report], [arm_file, model_file, *scenario_files])
    if out is None and not scenario_files:
        raise ZygosError(
            "there is nothing to do; remedy: name the scenario to write with -o, or scenarios whose motions are ranked"
        )
    arm, model = load_arm(arm_file), load_model(model_file)
    planner = Planner(arm, model, limits_of(arm, *limits), _torque_sigma(arm, torque_noise), by)
    scenarios = [load_scenario(file) for file in scenario_files]
    expected: list[Expectation] = []
    with progress() as bar:
        for file, scenario in zip(scenario_files, scenarios, strict=True):
            task = bar.add_task(f"computing {file.name}", total=1.0)
            expected.append(planner.expected(scenario, partial(_update, bar, task)))
            bar.update(task, completed=1.0)
        if out is not None:
            task = bar.add_task("searching a motion", total=1.0)
            template = scenarios[0] if scenarios else None
            planned, expectation = planner.plan(
                out.stem, sought, arm_file, model_file, template, partial(_update, bar, task)
            )
            expected.append(expectation)
    ranked(expected)  # refuses motions of which none keeps the limits
    if out is not None:
        save_scenario(planned, out)
    written = f"{out}: written, {planned.duration_s:g} s; zygos simulate {out} -o RUN" if out is not None else ""
    files = [("arm", arm_file), ("model", model_file), *(("scenario", file) for file in scenario_files)]
    deliver(
        wanted,
        lambda draw: answer_of(expected, planner, written=written, draw=draw),
        lambda: as_json(expected, planner, str(out) if out else None),
        partial(provenance, called, files),
        out,
    )


def _update(bar: Progress, task: TaskID, share: float) -> None:
    bar.update(task, completed=share)


def _torque_sigma(arm: Arm, given: str | None) -> NDArray[np.float64]:
    declared = [joint.torque_sigma for joint in arm.joints]
    if given is None:
        return np.array(declared)
    texts = per_joint([joint.name for joint in arm.joints], "torque noise", given, "")
    return np.array(
        [as_number("torque noise", text) if text else own for text, own in zip(texts.values(), declared, strict=True)]
    )


def command(
    context: typer.Context,
    scenarios: Annotated[
        list[Path] | None,
        typer.Argument(metavar="SCENARIO...", help="Motions to rank, and to compare the planned one with."),
    ] = None,
    arm: Annotated[
        Path | None,
        typer.Option(
            "--arm", metavar="ARM.toml", help="The arm file. Default: that of the first scenario.", callback=of_arm
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model", metavar="MODEL.toml", help="The model that is assumed. Default: the plant of the first scenario."
        ),
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
            metavar="RAD",
            help="Range of the angles: A for -A to A, or LOW:HIGH; with NAME= before it of one joint. A search "
            f"assumes {ANGLE_RAD:.2f} where there is none.",
        ),
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            metavar="RAD/S",
            help="Largest rate; with NAME= before it of one joint. A search assumes "
            f"{RATE_RAD_S:g} where there is none.",
        ),
    ] = None,
    torque: Annotated[
        str | None,
        typer.Option(metavar="NM", help="Largest torque as the frames report it; with NAME= before it of one joint."),
    ] = None,
    torque_noise: Annotated[
        str | None,
        typer.Option(
            metavar="NM",
            help="Standard deviation of the torques; with NAME= before it of one joint. Default: torque_sigma.",
        ),
    ] = None,
    period: Annotated[float, typer.Option(metavar="S", min=0.5, help="Period of the motion.")] = 10.0,
    harmonics: Annotated[int, typer.Option(metavar="K", min=3, max=30, help="Harmonics of the motion.")] = 5,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            min=0.5,
            help="Duration of the run. Default: two periods; that of the first scenario, if the motion is simulated.",
        ),
    ] = None,
    simulations: Annotated[
        int, typer.Option(metavar="N", min=1, help="Motions to simulate, if the arm floats or has springs.")
    ] = 24,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the search.")] = 0,
    by: Annotated[
        By,
        typer.Option(
            metavar="energy|bound",
            help="What ranks the motions: what zygos estimate will tell, or the smallest standard deviations of any "
            "estimate; the bound needs joints that are all flexible, and a model without effects.",
        ),
    ] = "energy",
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Plan a motion that excites every parameter, or rank given motions by what they tell.

    The table has the standard deviation that is expected of each parameter after one run, in % of the largest value
    with the same unit of the same body, for each given scenario and for the planned one. For an arm on the ground with
    rigid joints it follows from the joint rows of the motion and from the noise of the torques, and the planned
    scenario has a drive that follows the motion. An arm that floats or has springs is simulated, and its first scenario
    gives servo, angular momentum and duration.

    With --by bound, the deviations are the smallest that any unbiased estimate can have (the Cramér-Rao bound), and the
    motion with the smallest mean is the best one. Refined values of zygos estimate are near this bound.

    A planned motion keeps all limits. A given one that exceeds a limit is ranked last; if all do, they are refused.

    Example: zygos plan --arm arm.toml --model model.toml --angle 2.5 --rate 1.5 -o planned.toml
    """
    given = list(scenarios or [])
    if arm is None and given and toml_kind(given[0]) == "an arm file":
        note("zygos: ARM.toml in front goes in the next version: `zygos plan SCENARIO... --arm ARM.toml`")
        arm = given.pop(0)
    if candidates and out is not None:
        raise ZygosError("--candidates only ranks; remedy: leave out --candidates, or -o")
    if given and (arm is None or model is None):
        first = load_scenario(given[0])
        arm, model = arm or first.arm, model or first.plant
    if arm is None or model is None:
        raise ZygosError("without a scenario the motion has no arm and no model; remedy: add --arm and --model")
    plan_motion(
        arm,
        model,
        given,
        out,
        (angle, rate, torque),
        torque_noise,
        Motion(period, harmonics, duration, seed, simulations),
        Wanted(json, report, details),
        context.obj or ["plan"],
        by,
    )

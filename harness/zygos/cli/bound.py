# SPDX-License-Identifier: MIT
"""`zygos bound`: the smallest standard deviations that any estimator can have from a motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from zygos.arm import Arm, load_arm
from zygos.cli.options import Json
from zygos.files.output import check_outputs, counted, number, quiet, say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import load_model
from zygos.refinement.bound import Bound, bound
from zygos.simulation.scenario import load_scenario


def compute_bound(scenario_file: Path, model_file: Path | None, noise: Sequence[float], json: str | None) -> None:
    """Compute the bound of a scenario; see `zygos bound --help`."""
    scenario = load_scenario(scenario_file)
    check_outputs([json], [scenario_file, scenario.arm, scenario.plant, model_file])
    arm, model = load_arm(scenario.arm), load_model(model_file or scenario.plant)
    with progress() as bar:
        task = bar.add_task("computing the bound", total=1.0)
        found = bound(arm, model, scenario, noise or (None,), lambda share: bar.update(task, completed=share))
    if not quiet(json):
        _tables(arm, found)
    if json:
        write_json(json, _answer(arm, scenario_file, found))


def _level(one: Bound) -> str:
    """Torque noise of a bound, in words."""
    shares = [f"{100.0 * share:g} %" for share in dict.fromkeys(one.torque_relative_sigma)]
    return ", ".join(shares)


def _tables(arm: Arm, found: Sequence[Bound]) -> None:
    first = found[0]
    heads = [f"σ in %, torques {_level(one)}" for one in found] if len(found) > 1 else ["σ", "σ in %"]
    rows = []
    for k, (name, unit) in enumerate(zip(first.names, first.units, strict=True)):
        own = () if len(found) > 1 else (number(float(first.sigma[k]), 3),)
        rows.append(
            (name, unit, number(float(first.value[k]), 4), *own, *(number(float(one.percent[k]), 3) for one in found))
        )
    table(("parameter", "unit", "model", *heads), rows)
    space = first.inertia_percent is not None
    table(
        ("noise of the torques", "mean σ in %", "worst", *(("H(q), worst %", "H(q), median %") if space else ())),
        [
            (
                _level(one),
                number(one.mean_percent, 3),
                one.names[int(one.percent.argmax())],
                *(number(x, 3) for x in one.inertia_percent or ()),
            )
            for one in found
        ],
    )
    seconds = first.cycles * arm.period_s
    say(f"arm {arm.name}: {counted(first.cycles, 'cycle')}, {seconds:g} s, {counted(len(first.names), 'parameter')}")
    say("σ: the smallest standard deviation of any unbiased estimate; in % of the value, or of what it is compared to")


def _answer(arm: Arm, scenario: Path, found: Sequence[Bound]) -> dict[str, Any]:
    return {
        "arm": arm.name,
        "scenario": str(scenario),
        "cycles": found[0].cycles,
        "duration_s": found[0].cycles * arm.period_s,
        "bounds": [
            {
                "torque_relative_sigma": list(one.torque_relative_sigma),
                "mean_percent": one.mean_percent,
                "worst": one.names[int(one.percent.argmax())],
                "inertia_percent": None
                if one.inertia_percent is None
                else dict(zip(("worst", "median"), one.inertia_percent, strict=True)),
                "parameters": [
                    {"name": name, "unit": unit, "value": value, "size": size, "sigma": sigma, "percent": percent}
                    for name, unit, value, size, sigma, percent in zip(
                        one.names,
                        one.units,
                        one.value.tolist(),
                        one.size.tolist(),
                        one.sigma.tolist(),
                        one.percent.tolist(),
                        strict=True,
                    )
                ],
            }
            for one in found
        ],
    }


def command(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="The scenario, which names arm and plant.")],
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.toml", help="Assume this model instead of the plant."),
    ] = None,
    torque_noise: Annotated[
        list[float] | None,
        typer.Option(
            metavar="SHARE",
            min=0.0,
            max=1.0,
            help="Noise of the torques as a share of their size, for instance 0.005; may be repeated. Default: "
            "what the arm file declares.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Compute the smallest standard deviations that any estimator can have from a motion.

    The scenario is simulated, and around its motion it is computed what the frames tell about each parameter at most
    (Cramér-Rao bound).
    The noise is that which arm.toml declares, with the steps of the CAN frames. Unknown besides the parameters are the
    state of the arm at the start, the bias of the gyro, and the zeros of the encoders, to a step at least. An estimate
    whose errors are as small as these uses all that the frames hold.

    For an arm in space that floats, "H(q)" is the largest relative error of its inertia matrix, worst and median of
    200 postures.

    All joints are flexible, and the model has no effects; the base may float or be fixed.

    Example: zygos bound examples/paper/scenario.toml --torque-noise 0 --torque-noise 0.005
    """
    compute_bound(scenario, model, torque_noise or [], json)

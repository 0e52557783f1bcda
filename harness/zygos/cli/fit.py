# SPDX-License-Identifier: MIT
"""The command `zygos fit`: from an estimate to the physical arm that explains it."""

from __future__ import annotations

import json as reader
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.arm import Arm, load_arm
from zygos.cli.options import Json, Out
from zygos.cli.shared import check_model_name
from zygos.effects import Effect
from zygos.errors import Undecided, ZygosError
from zygos.estimation.sections import learned
from zygos.files.inputs import local
from zygos.files.output import check_outputs, number, quiet, say, table, write_json
from zygos.files.progress import progress
from zygos.model.model import Model, Quantity, load_model, save_model
from zygos.model.physical import CHANCE, PhysicalFit, entries_of_model, fit_bodies, observe

_KEYS = ("arm", "parameters", "solution", "normal", "validity", "reason", "blocks")


def fit_estimate(
    estimate: Path, arm_file: Path, drawing_file: Path, out: Path | None, length_sigma: float, json: str | None
) -> None:
    """Fit bodies to an estimate; see `zygos fit --help`."""
    check_model_name(out)
    check_outputs([out, json], [estimate, arm_file, drawing_file])
    arm, drawing = load_arm(arm_file), load_model(drawing_file)
    if not drawing.bodies:
        raise ZygosError(f"{drawing_file}: contains base parameters; remedy: give a model with [[body]] and [[joint]]")
    report = read_estimate(estimate)
    observed = observe(arm.parameter_names, report)
    effects = _effects(arm, drawing, report)
    with progress() as bar:
        task = bar.add_task("fitting bodies", total=1.0)
        found = fit_bodies(arm, drawing, observed, length_sigma, lambda share: bar.update(task, completed=share))
    model = replace(found.model, effects=effects)
    if not quiet(out, json):
        _tables(arm, drawing, found)
    try:
        if found.explained and out:
            save_model(model, out)
    finally:
        if json:
            write_json(json, _report(arm, found, out))
    if not found.explained:
        raise Undecided(
            f"no arm like {arm.name} explains the estimate: chi^2/dof is {number(found.chi2 / found.dof, 3)}, above "
            f"the limit {number(found.limit, 3)} (nothing written)"
            + (
                ", and no positive definite N near it does either"
                if found.least > found.limit * found.dof
                else ", although some positive definite N does"
            )
            + f"; remedy: compare axes, frame_rpy, ratios and zeros of {arm_file} and the lengths of {drawing_file} "
            "with the arm, check that the estimate belongs to it, and give a drawing that is nearer to the arm"
        )


def read_estimate(path: Path) -> dict[str, Any]:
    """The JSON of `zygos estimate`. Errors: ZygosError if it is missing or not such a file."""
    try:
        content = reader.loads(local(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ZygosError(
            f"{path}: cannot be read ({error.strerror}); remedy: give the file that `zygos estimate --json` wrote"
        ) from error
    except ValueError as error:
        raise ZygosError(
            f"{path}: is not JSON ({error}); remedy: give the file that `zygos estimate --json` wrote"
        ) from error
    missing = [key for key in _KEYS if not isinstance(content, dict) or key not in content]
    if missing:
        raise ZygosError(
            f"{path}: has no {', '.join(missing)}; remedy: give the file that `zygos estimate --json` wrote"
        )
    count = len(content["parameters"])
    # a refused estimate has no solution
    given = [content["normal"]] + ([content["solution"]] if content["validity"] != "refused" else [])
    try:
        arrays = [np.array(entry, dtype=float) for entry in given]
        good = [array.shape for array in arrays] == [(count, count), (count,)][: len(arrays)]
        good = good and all(np.isfinite(array).all() for array in arrays)
    except (TypeError, ValueError):
        good = False
    if not good:
        raise ZygosError(
            f"{path}: solution and normal do not have {count} parameters; remedy: give the file that `zygos estimate` "
            "wrote"
        )
    report: dict[str, Any] = content
    return report


def _effects(arm: Arm, drawing: Model, report: dict[str, Any]) -> tuple[Effect, ...]:
    """The drawing's effects with their estimated values."""
    found = {
        entry["name"]: Quantity(float(entry["value"]), float(entry["sigma"]), "zygos", entry["unit"])
        for entry in report["parameters"]
        if entry["value"] is not None
    }
    return tuple(learned(effect, found.get(effect.column(arm))) for effect in drawing.effects)


def _tables(arm: Arm, drawing: Model, found: PhysicalFit) -> None:
    drawn = entries_of_model(arm, drawing)
    rows = [
        (
            name,
            entry.unit,
            number(drawn[name].value),
            number(entry.value),
            number(entry.sigma, 2),
            f"{100 * found.known[name]:.2f} %",
        )
        for name, entry in entries_of_model(arm, found.model).items()
    ]
    table(("entry", "unit", "drawing", "fit", "sigma", "known"), rows)
    say("sigma: of this entry alone · known: share of the drawing's uncertainty, a factor of e, that is removed")
    farthest = 1e3 * float(np.abs(found.lengths).max(initial=0.0))
    quality = f"limit {number(found.limit, 3)}" if np.isfinite(found.limit) else "no limit: bodies can fit any estimate"
    say(
        f"chi^2 {number(found.chi2, 3)} · dof {number(found.dof, 3)} · {quality} · lengths changed by up to "
        f"{number(farthest, 2)} mm"
    )


def _report(arm: Arm, found: PhysicalFit, out: Path | None) -> dict[str, Any]:
    return {
        "model": str(out) if found.explained and out else None,
        "arm": arm.name,
        "chi2": found.chi2,
        "dof": found.dof,
        "limit": found.limit,
        "chance": CHANCE,
        "chi2_of_nearest_matrix": found.least,
        "explained": found.explained,
        "lengths_moved_m": found.lengths.tolist(),
        "parameters": [
            {"name": name, "unit": unit, "value": float(value), "sigma": float(sigma)}
            for name, unit, value, sigma in zip(
                arm.parameter_names,
                arm.parameter_units,
                found.value,
                np.sqrt(np.diag(found.covariance)),
                strict=True,
            )
        ],
        "covariance": found.covariance.tolist(),
        "entries": [
            {"name": name, "unit": entry.unit, "value": entry.value, "sigma": entry.sigma, "known": found.known[name]}
            for name, entry in entries_of_model(arm, found.model).items()
        ],
    }


def command(
    estimate: Annotated[
        Path, typer.Argument(metavar="ESTIMATE.json", help="The file that `zygos estimate --json` wrote.")
    ],
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    model: Annotated[Path, typer.Option("--model", metavar="CAD.toml", help="The model by bodies, from the drawing.")],
    out: Out = None,
    lengths: Annotated[
        float,
        typer.Option(metavar="MM", min=0.0, help="Standard deviation of CAD.toml's lengths in mm; 0: exact."),
    ] = 1.0,
    json: Json = None,
) -> None:
    """Find the physical arm that explains an estimate: possible bodies, lengths and drives.

    An estimate contains noise, and in general no bodies have exactly its values. The bodies found here are physically
    possible: their matrix N is positive definite, and predicts inertias better than the estimate itself. What the
    estimate does not determine stays as in CAD.toml. chi^2/dof measures how well the arm explains the estimate. This
    command needs an extra: pip install 'zygos[fit]'.

    Exit code 3 when no arm with these axes, and lengths near the drawing's, explains it; then nothing is written.

    Example: zygos fit out/estimate.json --arm out/arm.toml --model examples/spatial/model.toml -o out/fitted.toml
    """
    fit_estimate(estimate, arm, model, out, lengths * 1e-3, json)

# SPDX-License-Identifier: MIT
"""`zygos parameters`: the base parameters of an arm, and what each of them stands for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from zygos.arm import Arm, load_arm
from zygos.cli.options import ArmArgument, Json
from zygos.files.output import check_outputs, counted, quiet, say, table, write_json


def list_parameters(arm_file: Path, json: str | None) -> None:
    """List the base parameters of an arm; see `zygos parameters --help`."""
    check_outputs([json], [arm_file])
    arm = load_arm(arm_file)
    structure = arm.structure
    grouped, unseen = ([one.name for one in some] for some in (structure.grouped, structure.unseen))
    if json:
        write_json(json, _report(arm, grouped, unseen))
    if quiet(json):
        return
    rows = [
        (one.name, one.unit, "itself" if said == one.name else said)
        for one, said in zip(structure.parameters, structure.grouping, strict=True)
    ]
    table(("parameter", "unit", "stands for"), rows)
    if grouped:
        say(f"seen only as parts of these: {', '.join(grouped)}")
    if unseen:
        say(f"without any effect on the motion: {', '.join(unseen)}")
    origin = "of the bodies' inertial parameters" if not structure.candidates_are_full else "of products of inertia"
    say(
        f"arm {arm.name}: {counted(len(structure.parameters), 'base parameter')}, from {len(structure.candidates)} "
        f"{origin} and drives; {counted(len(arm.full_parameters), 'parameter')} for axes in general position and "
        "unknown lengths"
    )


def _report(arm: Arm, grouped: list[str], unseen: list[str]) -> dict[str, Any]:
    structure = arm.structure
    return {
        "arm": arm.name,
        "full": len(arm.full_parameters),
        "candidates": [one.name for one in structure.candidates],
        "lengths_known": not structure.candidates_are_full,
        "parameters": [
            {
                "name": one.name,
                "unit": one.unit,
                "stands_for": said,
                "terms": {
                    part.name: float(size) for part, size in zip(structure.candidates, row, strict=True) if size != 0.0
                },
            }
            for one, said, row in zip(structure.parameters, structure.grouping, structure.groups, strict=True)
        ],
        "grouped": grouped,
        "without_effect": unseen,
    }


def command(
    arm: ArmArgument,
    json: Json = None,
) -> None:
    """List the base parameters of an arm, and what each of them stands for.

    Base parameters are those that some motion determines. Parallel and perpendicular axes, a fixed base and rotors
    that turn with their links make others inseparable, which follows from the geometry alone. With position_m for
    every joint, an arm on a fixed base has the inertial parameters of its bodies: mass m, first moments mx my mz, and
    inertias Ixx .. Izz about the origin of the joint's frame. Elsewhere the parameters are products of inertia
    (docs/theory.md). Where Izz2 stands for `Izz2 - Ixx2`, an estimate of Izz2 is one of this difference. Coefficients
    are in SI units, with 6 digits.

    Example: zygos parameters examples/paper/arm.toml
    """
    list_parameters(arm, json)

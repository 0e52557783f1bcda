# SPDX-License-Identifier: MIT
"""`zygos export`: writes the file of a simulator with the values of a model."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from zygos.arm import load_arm
from zygos.cli.links import links_as_json, table_of_bodies
from zygos.cli.options import Json
from zygos.errors import ZygosError
from zygos.files.output import (
    check_outputs,
    counted,
    named,
    note,
    number,
    quiet,
    say,
    table,
    write_json,
    write_text,
)
from zygos.files.progress import progress
from zygos.model.model import Model, load_model
from zygos.model.nearest import DETERMINED, ENTRIES, UNITS, Nearest, entries_of, nearest_bodies


def export_urdf(
    arm_file: Path, model_file: Path, urdf: Path, out: Path, cad: Path | None, base: str | None, json: str | None
) -> None:
    """Write a URDF with the inertials of a model; see `zygos export --help`."""
    from zygos.urdf.chain import with_inertials  # noqa: PLC0415  (the help needs no extra)
    from zygos.urdf.exporting import bodies_of, chain_of, comment  # noqa: PLC0415

    check_outputs([out, json], [arm_file, model_file, urdf, cad])
    arm, model = load_arm(arm_file), load_model(model_file)
    bodies = bodies_of(model_file, model, cad)
    chain = chain_of(urdf, arm, bodies, base)
    found: Nearest | None = None
    if bodies is not model:
        with progress() as bar:
            task = bar.add_task("nearest bodies", total=1.0)
            found = nearest_bodies(arm, bodies, model, lambda share: bar.update(task, completed=share))
    result = found.model if found else bodies
    remark = comment(found, model, bodies) if found else f" Inertials by `zygos export`: those of model {model.name}. "
    write_text(out, with_inertials(urdf, chain.segments, result.bodies, remark))
    notes = [
        f"link {segment.link} also contains the inertia of {', '.join(segment.merged)}, which have none"
        for segment in chain.segments
        if segment.merged
    ]
    if model.effects:
        notes.append("a URDF cannot contain the [[effect]] entries")
    for line in notes:
        note(f"note: {line}")
    if not quiet(out, json):
        if found:
            _table_of_entries(found, bodies)
        else:
            table_of_bodies(chain, result)
        say(f"{out}: {urdf.name} with the inertials of {counted(len(result.bodies), 'link')}")
    if json:
        links = links_as_json(chain, result)
        if found:
            for link, entries in zip(links, _entries(found, bodies), strict=True):
                link["entries"] = entries
        write_json(json, {"urdf": str(out), "links": links, "tolerance": DETERMINED if found else None, "notes": notes})


def export_mjcf(arm_file: Path, model_file: Path, mjcf: Path, out: Path) -> None:
    """Write an MJCF with bodies, rotors, springs and effects of a model, and with springs that it lacks."""
    from zygos.gap.ground.predictions import Stage  # noqa: PLC0415  (of use here alone, and slow to load)
    from zygos.simulators.added import other_actuators  # noqa: PLC0415
    from zygos.simulators.correct import corrected  # noqa: PLC0415
    from zygos.simulators.explain import InSimulator  # noqa: PLC0415
    from zygos.simulators.file import for_output, is_urdf, read_robot, tree_of  # noqa: PLC0415

    check_outputs([out], [arm_file, model_file, mjcf])
    arm, model = load_arm(arm_file), load_model(model_file)
    if is_urdf(mjcf):
        raise ZygosError(f"--mjcf {mjcf}: is a URDF; remedy: --urdf")
    if arm.grounded:
        raise ZygosError(
            f"--mjcf: arm {arm.name} is on the ground and has rigid joints, and only runs say what matters of its "
            f"bodies; remedy: `zygos estimate RUN... --simulation {mjcf.name} -o NEW.xml`"
        )
    robot = for_output(read_robot(mjcf, arm, add=True), out)
    found = corrected(robot, arm, Stage.of("model", model, arm), [])
    tree_of(robot, found.robot, out.parent)  # what MuJoCo rejects is told before anything is written
    own = InSimulator(robot, arm, found, (), ())
    files = own.save(out)
    for line in (*own.notes, *other_actuators(robot)):
        note(f"note: {line}")
    added = ", ".join(hinge.written for hinge in robot.added)
    springs = f", with springs at {added}" if added else ""
    say(f"{', '.join(map(named, files))}: {mjcf.name} with the values of model {model.name}{springs}")


def _entries(found: Nearest, cad: Model) -> list[list[dict[str, Any]]]:
    """For each link, the result for each entry of its inertial."""
    return [
        [
            {
                "name": entry,
                "value": entries_of(body)[k],
                "cad": entries_of(drawn)[k],
                "moved": float(found.moved[index, k]),
                "known": float(found.known[index, k]),
                "determined": bool(found.determined[index, k]),
            }
            for k, entry in enumerate(ENTRIES)
        ]
        for index, (body, drawn) in enumerate(zip(found.model.bodies, cad.bodies, strict=True))
    ]


def _table_of_entries(found: Nearest, cad: Model) -> None:
    rows = [
        (
            f"{body.name} {entry['name']}",
            unit,
            number(entry["cad"]),
            number(entry["value"]),
            f"{entry['moved']:+.2f}",
            f"{100 * entry['known']:.1f} %",
            "yes" if entry["determined"] else "no",
        )
        for body, entries in zip(found.model.bodies, _entries(found, cad), strict=True)
        for entry, unit in zip(entries, UNITS, strict=True)
    ]
    table(("entry", "unit", "CAD", "nearest", "moved", "known", "determined"), rows)
    say(
        "moved: in units of the drawing's sigma · known: share of it that the base parameters remove · "
        f"determined: no change of more than {DETERMINED:g} units leaves the base parameters the same"
    )


def command(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    model: Annotated[
        Path, typer.Option("--model", metavar="MODEL.toml", help="A model by bodies, or by base parameters.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT", help="The URDF or MJCF to write.")],
    urdf: Annotated[
        Path | None, typer.Option("--urdf", metavar="IN.urdf", help="The URDF whose inertials are replaced.")
    ] = None,
    mjcf: Annotated[
        Path | None,
        typer.Option(
            "--mjcf",
            metavar="IN.xml",
            help="The MJCF of an arm that floats or has flexible joints: bodies, rotors, springs and friction become "
            "those of the model, and a flexible joint without a spring gets one.",
        ),
    ] = None,
    cad: Annotated[
        Path | None,
        typer.Option(
            "--cad",
            metavar="CAD.toml",
            help="With --urdf and base parameters: the model by bodies that determines the rest.",
        ),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="With --urdf: the link at which the arm begins. Default: that of the model's first body.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Write a URDF or an MJCF with the values of a model; everything else in it is unchanged.

    Base parameters, as `zygos estimate` writes them, do not determine every inertial. With --urdf, of all bodies that
    have them, those nearest to the bodies of --cad are written, and a table shows which entries are determined. With
    --mjcf, they are those near the bodies of the file.

    With --urdf, exit code 3 when no physically possible bodies have these base parameters.

    Example: zygos export --arm arm.toml --model estimate.toml --cad model.toml --urdf arm.urdf -o new.urdf

    Example: zygos export --arm arm.toml --model estimate.toml --mjcf arm.xml -o springs.xml
    """
    if (urdf is None) == (mjcf is None):
        raise ZygosError("one file is exported at a time; remedy: --urdf IN.urdf, or --mjcf IN.xml")
    if urdf is not None:
        export_urdf(arm, model, urdf, out, cad, base, json)
        return
    for name, given in (("--cad", cad), ("--base", base), ("--json", json)):
        if given is not None:
            raise ZygosError(f"{name} belongs to --urdf; remedy: leave it out")
    assert mjcf is not None
    export_mjcf(arm, model, mjcf, out)

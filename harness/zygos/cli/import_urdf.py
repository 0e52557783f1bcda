# SPDX-License-Identifier: MIT
"""`zygos import`: makes arm.toml and model.toml from a URDF."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from zygos.arm import load_arm
from zygos.cli.links import links_as_json, table_of_bodies
from zygos.cli.options import Json
from zygos.errors import ZygosError
from zygos.files.output import check_outputs, counted, note, number, quiet, say, write_json, write_text
from zygos.model.model import load_model, save_model

if TYPE_CHECKING:
    from zygos.urdf.answers import Answers
    from zygos.urdf.chain import Chain


def import_urdf(
    urdf: Path,
    out: Path | None,
    base: str | None,
    tip: str | None,
    answers_file: Path | None,
    template: Path | None,
    json: str | None,
) -> None:
    """Write arm.toml and model.toml from a URDF; see `zygos import --help`."""
    from zygos.urdf.answers import Answers  # noqa: PLC0415  (the help needs no extra)
    from zygos.urdf.chain import read_chain  # noqa: PLC0415
    from zygos.urdf.importing import arm_text, model_of  # noqa: PLC0415

    arm_file, model_file = _files(out, template)
    files = [file for file in (template, arm_file, model_file) if file]
    check_outputs([*files, json], [urdf, answers_file])
    for file in files:
        if file.exists():
            raise ZygosError(f"{file}: exists already; remedy: remove it, or name another place")
    chain, inertials = read_chain(urdf, base, tip, weighed=model_file is not None)
    notes = list(chain.notes)
    if model_file and not inertials:
        notes.append("no link has an <inertial>, so that only the arm file is written, which needs none")
        model_file = None
    answers = Answers(
        answers_file, [hinge.name for hinge in chain.hinges], driven=template is not None or model_file is not None
    )
    if template:
        _write_template(template, answers, chain, json)
        return
    if sys.stdin.isatty():
        answers.ask()
    assert arm_file is not None
    arm = answers.arm(chain)
    model = model_of(chain, inertials, answers) if model_file else None
    origin = f"From {urdf.name} by `zygos import`, and from answers for what a URDF does not contain."
    try:
        write_text(arm_file, arm_text(arm, origin))
        checked = load_arm(arm_file)
        if model and model_file:
            save_model(model, model_file)
            load_model(model_file).check_fits(checked)
    except ZygosError:
        for file in files:
            file.unlink(missing_ok=True)
        raise
    for line in notes:
        note(f"note: {line}")
    if json != "-":
        weight = ""
        if model:
            table_of_bodies(chain, model)
            weight = f", {number(sum(body.mass.value for body in model.bodies))} kg without rotors"
        what = "arm.toml and model.toml" if model else "the arm file"
        say(f"{out}: {what}, {counted(len(chain.hinges), 'joint')}{weight}")
    if json:
        content = {
            "arm": str(arm_file),
            "model": str(model_file) if model_file else None,
            "joints": [hinge.name for hinge in chain.hinges],
            "bodies": links_as_json(chain, model) if model else [],
            "notes": notes,
        }
        write_json(json, content)


def _files(out: Path | None, template: Path | None) -> tuple[Path | None, Path | None]:
    """The arm file and the model file that -o names; None: it is not written."""
    if (out is None) == (template is None):
        raise ZygosError("nothing to write; remedy: give either -o FOLDER or --template ANSWERS.toml")
    if out is None:
        return None, None
    return (out, None) if out.suffix.lower() == ".toml" else (out / "arm.toml", out / "model.toml")


def _write_template(template: Path, answers: Answers, chain: Chain, json: str | None) -> None:
    """Write the open questions instead of the arm."""
    write_text(template, answers.template(chain))
    missing = answers.missing()
    if not quiet(template, json):
        say(f"{template}: {counted(len(missing), 'value')} to fill in")
    if json:
        listed = [{"joint": joint or None, "key": question.key} for joint, question in missing]
        write_json(json, {"template": str(template), "missing": listed})


def command(
    urdf: Annotated[Path, typer.Argument(metavar="ARM.urdf", help="The URDF of the arm.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FOLDER",
            help="The folder where arm.toml and model.toml are written, or ARM.toml: the arm file alone.",
        ),
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="LINK", help="The link at which the arm begins. Default: the root.")
    ] = None,
    tip: Annotated[
        str | None, typer.Option(metavar="LINK", help="The last link of the arm. Default: the only end.")
    ] = None,
    answers: Annotated[
        Path | None, typer.Option(metavar="ANSWERS.toml", help="Values that a URDF lacks: motors, sensors, bus.")
    ] = None,
    template: Annotated[
        Path | None, typer.Option(metavar="ANSWERS.toml", help="Write only a file of questions, to be filled in.")
    ] = None,
    json: Json = None,
) -> None:
    """Make arm.toml and model.toml from a URDF.

    Links at fixed joints, and branches outside the chain, are merged into the link that carries them. A URDF contains
    no gears, rotors, springs, encoders, gyro and bus: these come from --answers, or are asked for at a terminal. With
    -o ARM.toml neither masses and inertias of the URDF nor rotors and springs are needed.

    Example: zygos import examples/urdf/arm.urdf --answers examples/urdf/answers.toml -o out/arm
    """
    import_urdf(urdf, out, base, tip, answers, template, json)

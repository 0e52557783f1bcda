"""The commands `zygos import` and `zygos export`: between a URDF and zygos' own files."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from zygos.answers import Answers
from zygos.arm import Arm, load_arm
from zygos.commands import progress
from zygos.errors import ZygosError
from zygos.model import Body, Model, Quantity, load_model, save_model
from zygos.nearest import DETERMINED, ENTRIES, UNITS, Nearest, entries_of, nearest_bodies
from zygos.output import check_outputs, counted, note, number, quiet, say, table, write_json, write_text
from zygos.urdf import Chain, Inertial, read_chain, read_chain_of, with_inertials

_SAME = 1e-9
"""Largest difference of lengths, relative to the longest, and of attitudes between a URDF and an arm."""


def import_urdf(
    urdf: Path,
    folder: Path | None,
    base: str | None,
    tip: str | None,
    answers_file: Path | None,
    template: Path | None,
    json: str | None,
) -> None:
    """Write arm.toml and model.toml from a URDF; see `zygos import --help`."""
    if (folder is None) == (template is None):
        raise ZygosError("what is to be written?; remedy: give either -o FOLDER or --template ANSWERS.toml")
    files = [template] if template else [folder / "arm.toml", folder / "model.toml"] if folder else []
    check_outputs([*files, json], [urdf, answers_file])
    for file in files:
        if file and file.exists():
            raise ZygosError(f"{file}: exists; remedy: remove it, or name another place")
    chain, inertials = read_chain(urdf, base, tip)
    answers = Answers(answers_file, [hinge.name for hinge in chain.hinges])
    if template:
        _write_template(template, answers, chain, json)
        return
    if sys.stdin.isatty():
        answers.ask()
    arm = answers.arm(chain)
    model = _model(chain, inertials, answers)
    assert folder is not None
    origin = f"From {urdf.name} by `zygos import`, and from answers to what a URDF does not say."
    try:
        save_model(model, folder / "model.toml")
        write_text(folder / "arm.toml", _arm_text(arm, origin))
        load_model(folder / "model.toml").check_fits(load_arm(folder / "arm.toml"))
    except ZygosError:
        for file in files:
            if file:
                file.unlink(missing_ok=True)
        raise
    for line in chain.notes:
        note(f"note: {line}")
    if json != "-":
        _table_of_bodies(chain, model)
        say(
            f"{folder}: arm.toml and model.toml, {counted(len(chain.hinges), 'joint')}, "
            f"{number(sum(body.mass.value for body in model.bodies))} kg without rotors"
        )
    if json:
        write_json(
            json,
            {
                "arm": str(folder / "arm.toml"),
                "model": str(folder / "model.toml"),
                "joints": [hinge.name for hinge in chain.hinges],
                "bodies": _links(chain, model),
                "notes": list(chain.notes),
            },
        )


def _write_template(template: Path, answers: Answers, chain: Chain, json: str | None) -> None:
    """Write the questions that are open, instead of the arm."""
    write_text(template, answers.template(chain))
    missing = answers.missing()
    if not quiet(template, json):
        say(f"{template}: {counted(len(missing), 'value')} to fill in")
    if json:
        listed = [{"joint": joint or None, "key": question.key} for joint, question in missing]
        write_json(json, {"template": str(template), "missing": listed})


def export_urdf(
    arm_file: Path, model_file: Path, urdf: Path, out: Path, cad: Path | None, base: str | None, json: str | None
) -> None:
    """Write a URDF with the inertials of a model; see `zygos export --help`."""
    check_outputs([out, json], [arm_file, model_file, urdf, cad])
    arm, model = load_arm(arm_file), load_model(model_file)
    bodies = _bodies(model_file, model, cad)
    chain = _chain_of(urdf, arm, bodies, base)
    found: Nearest | None = None
    if bodies is not model:
        with progress() as bar:
            task = bar.add_task("nearest bodies", total=1.0)
            found = nearest_bodies(arm, bodies, model, lambda share: bar.update(task, completed=share))
    result = found.model if found else bodies
    comment = (
        _comment(found, model, bodies) if found else f" Inertials by `zygos export`: those of model {model.name}. "
    )
    write_text(out, with_inertials(urdf, chain.segments, result.bodies, comment))
    notes = [
        f"link {segment.link} holds the inertia of {', '.join(segment.merged)} as well, which have none"
        for segment in chain.segments
        if segment.merged
    ]
    if model.effects:
        notes.append("a URDF has no place for what [[effect]] says")
    for line in notes:
        note(f"note: {line}")
    if not quiet(out, json):
        if found:
            _table_of_entries(found, bodies)
        else:
            _table_of_bodies(chain, result)
        say(f"{out}: {urdf.name} with the inertials of {counted(len(result.bodies), 'link')}")
    if json:
        links = _links(chain, result)
        if found:
            for link, entries in zip(links, _entries(found, bodies), strict=True):
                link["entries"] = entries
        write_json(json, {"urdf": str(out), "links": links, "tolerance": DETERMINED if found else None, "notes": notes})


def _bodies(model_file: Path, model: Model, cad: Path | None) -> Model:
    """The model itself if it is given by bodies, else the drawing."""
    if model.bodies:
        if cad is not None:
            raise ZygosError(
                f"{model_file}: is given by bodies, which are written as they are; remedy: leave out --cad"
            )
        return model
    if cad is None:
        raise ZygosError(
            f"{model_file}: base parameters do not determine the inertials one by one; remedy: give the drawing that "
            "decides the rest with --cad MODEL.toml"
        )
    drawing = load_model(cad)
    if not drawing.bodies:
        raise ZygosError(f"{cad}: holds base parameters; remedy: give a model with [[body]] and [[joint]]")
    return drawing


def _entries(found: Nearest, cad: Model) -> list[list[dict[str, Any]]]:
    """For each link, what is known of each entry of its inertial."""
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


def _model(chain: Chain, inertials: Sequence[Inertial], answers: Answers) -> Model:
    bodies: list[Body] = []
    for index, (segment, inertial) in enumerate(zip(chain.segments, inertials, strict=True)):
        ixx, ixy, ixz, iyy, iyz, izz = (
            Quantity(float(entry), 0.0, "CAD", "kg m^2") for entry in inertial.tensor[np.triu_indices(3)]
        )
        x, y, z = (float(value) for value in inertial.centre)
        bodies.append(
            Body(
                segment.link,
                Quantity(inertial.mass, 0.0, "CAD", "kg"),
                (x, y, z),
                (ixx, ixy, ixz, iyy, iyz, izz),
                chain.hinges[index].xyz if index < len(chain.hinges) else None,
            )
        )
    return Model(chain.name, tuple(bodies), answers.drives())


def _arm_text(arm: dict[str, Any], origin: str) -> str:
    document = tomlkit.document()
    document.add(tomlkit.comment(origin))
    for key, value in arm.items():
        if key == "joint":
            joints = tomlkit.aot()
            for joint in value:
                entry = tomlkit.table()
                for name, content in joint.items():
                    entry[name] = _inline(content) if isinstance(content, dict) else content
                joints.append(entry)
            document["joint"] = joints
        elif not isinstance(value, dict):
            document[key] = value
    for key, value in arm.items():
        if isinstance(value, dict):
            document[key] = value
    return tomlkit.dumps(document)


def _inline(content: dict[str, Any]) -> Any:
    entry = tomlkit.inline_table()
    entry.update(content)
    return entry


def _chain_of(urdf: Path, arm: Arm, model: Model, base: str | None) -> Chain:
    """The chain of a URDF that is this arm's, with this model's lengths."""
    names = [joint.name for joint in arm.joints]
    if [joint.name for joint in model.joints] != names:
        raise ZygosError(
            f"model {model.name} has joints {[joint.name for joint in model.joints]}, arm {arm.name} has {names}; "
            "remedy: name the joints alike, from the base outwards"
        )
    chain = read_chain_of(urdf, base or model.bodies[0].name, names)
    reach = max(float(np.linalg.norm(hinge.xyz)) for hinge in chain.hinges) or 1.0
    for hinge, joint, body in zip(chain.hinges, arm.joints, model.bodies[:-1], strict=True):
        for what, own, other, scale in (
            ("attitude", _attitude(hinge.rpy), _attitude(joint.frame_rpy), 1.0),
            ("axis", np.array(hinge.axis), np.array(joint.axis), 1.0),
            ("place (m)", np.array(hinge.xyz), np.array(body.joint_xyz), reach),
        ):
            if np.max(np.abs(own - other)) > _SAME * scale:
                raise ZygosError(
                    f"{urdf}: the {what} of joint {hinge.name} is {own.tolist()}, but arm {arm.name} and model "
                    f"{model.name} say {other.tolist()}; remedy: give the files of one and the same arm; a fit "
                    "keeps the lengths of its drawing with `zygos fit --lengths 0`"
                )
    return chain


def _attitude(rpy: Sequence[float]) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = Rotation.from_euler("xyz", rpy).as_matrix()
    return matrix


def _comment(found: Nearest, given: Model, cad: Model) -> str:
    """What the file says of itself: where its inertials come from, and which of their entries are known."""
    lines = [
        f" Inertials by `zygos export`: of all bodies with the base parameters of model {given.name}, those nearest to",
        f"     model {cad.name}. Entries that the base parameters determine, all others keep that model's share:",
    ]
    for body, determined in zip(found.model.bodies, found.determined, strict=True):
        names = [entry for entry, yes in zip(ENTRIES, determined, strict=True) if yes]
        lines.append(f"     {body.name}: {', '.join(names) or 'none'}")
    return "\n".join(lines) + " "


def _table_of_bodies(chain: Chain, model: Model) -> None:
    rows = []
    for segment, body in zip(chain.segments, model.bodies, strict=True):
        moments = np.linalg.eigvalsh(body.tensor)
        values = [body.mass.value, *body.origin_xyz, *moments]
        rows.append((segment.link, str(len(segment.merged)), *(number(float(value), 4) for value in values)))
    table(("link", "merged", "mass, kg", "x, m", "y, m", "z, m", "I1, kg m^2", "I2, kg m^2", "I3, kg m^2"), rows)


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
        "moved: in units of the drawing's sigma · known: how much of it the base parameters take away · "
        f"determined: no change of more than {DETERMINED:g} units leaves them the same"
    )


def _links(chain: Chain, model: Model) -> list[dict[str, Any]]:
    return [
        {
            "link": segment.link,
            "merged": list(segment.merged),
            "mass": body.mass.value,
            "centre": list(body.origin_xyz),
            "inertia": [entry.value for entry in body.inertia],
        }
        for segment, body in zip(chain.segments, model.bodies, strict=True)
    ]

# SPDX-License-Identifier: MIT
"""A file of a simulator with what was learned, written so that its own folder still holds all that it refers to."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.files.output import write_bytes
from zygos.simulators.added import with_springs
from zygos.simulators.measure import Simulator
from zygos.simulators.mjcf import compiled, corrected_mjcf, load_mujoco, read_mjcf
from zygos.simulators.robot import Robot, check_gears
from zygos.simulators.translate import Translation
from zygos.simulators.xml import read_document

SUFFIXES = (".xml", ".mjcf", ".urdf")


def is_simulator_file(path: Path) -> bool:
    """Whether a file is one of a simulator, by its suffix."""
    return path.suffix.lower() in SUFFIXES


def is_urdf(path: Path) -> bool:
    """Whether a file of a simulator is a URDF: by its root, because either may be called .xml."""
    return read_document(path).root.tag == "robot"


def read_robot(path: Path, arm: Arm | None, joints: int | None = None, *, add: bool = False) -> Robot:
    """The arm of a file. arm: whose joints it has; None: the first `joints` hinges of its only chain. add: springs that
    the file lacks, as `with_springs`.

    Errors: ZygosError as `read_mjcf` and `read_urdf`, and where the file is not of that arm.
    """
    names = joints if arm is None else [joint.name for joint in arm.joints]
    if is_urdf(path):
        from zygos.simulators.urdf import ON_EARTH, read_urdf  # noqa: PLC0415  (an extra)

        robot = read_urdf(path, names, ON_EARTH if arm is None else arm.gravity)
    else:
        robot = read_mjcf(path, names)
    if arm is None:
        return robot
    if robot.format == "URDF" and not arm.grounded:
        raise ZygosError(
            f"{path}: arm {arm.name} floats or has flexible joints, and a URDF holds neither rotors nor springs; "
            "remedy: an MJCF with both (docs/simulators.md), or a model.toml as --simulation (`zygos import` makes one "
            "from a URDF)"
        )
    check_gears(arm, arm.name)
    return (with_springs(robot, arm) if add and len(robot.hinges) == arm.n else robot).ordered(arm)


def for_output(robot: Robot, out: Path) -> Robot:
    """The robot in the format that the suffix of `out` chooses: an MJCF is also made from a URDF.

    Errors: ZygosError for a place from which a corrected file would not find what it refers to, and for a name of
    another kind of file.
    """
    suffix = out.suffix.lower()
    if suffix not in SUFFIXES or (suffix == ".urdf" and robot.format == "MJCF"):
        either = ".xml" if robot.format == "MJCF" else ".urdf, or .xml for an MJCF"
        raise ZygosError(
            f"{out}: not a name for the corrected {robot.format}; remedy: give it the suffix {either}, or .toml for a "
            "model of zygos"
        )
    if robot.format == "URDF" and suffix != ".urdf":
        made = Translation(robot.path, robot.path.read_bytes(), robot.gravity, out.parent)
        made.text({})
        robot = replace(robot, format="MJCF", notes=(*robot.notes, *made.notes), translated=True)
    if robot.format == "URDF" or robot.translated:
        tree_of(robot, None, out.parent)  # what MuJoCo rejects is told before anything is learned
        return robot
    if robot.format == "MJCF" and out.parent.resolve() != robot.path.parent.resolve():
        for one in read_document(robot.path, includes=True).root.walk():
            if "file" in one.attributes or "content_type" in one.attributes:
                raise ZygosError(
                    f"{out}: would not find {one.attributes.get('file', 'the files')}, which {robot.path.name} refers "
                    f"to; remedy: write it into the same folder: -o {robot.path.parent / out.name}"
                )
        if read_document(robot.path, includes=True).included:
            raise ZygosError(
                f"{out}: would not find the files that {robot.path.name} includes; remedy: write it into the same "
                f"folder: -o {robot.path.parent / out.name}"
            )
    return robot


def contents(old: Robot, new: Robot, out: Path) -> dict[Path, bytes]:
    """What is to be written for a robot with other numbers: `out`, and the included files that change beside it, whose
    names begin with that of `out`."""
    if old.format == "URDF" or old.translated:
        from zygos.simulators.urdf import corrected_urdf  # noqa: PLC0415  (an extra)

        content = corrected_urdf(old, new)[old.path]
        if old.translated:
            made = Translation(old.path, content, old.gravity, out.parent)
            content = made.text({hinge.written: hinge.armature for hinge in new.hinges}).encode()
        return {out: content}

    def rename(file: Path) -> str:
        return (file.parent / f"{out.stem}-{file.name}").relative_to(old.path.parent).as_posix()

    found = corrected_mjcf(old, new, rename)
    return {out if file == old.path else old.path.parent / rename(file): text for file, text in found.items()}


def write(files: dict[Path, bytes]) -> None:
    """Write files, each completely or not at all, the last one being that which refers to the others."""
    for path in sorted(files, key=lambda path: path == next(iter(files))):
        write_bytes(path, files[path])


def tree_of(robot: Robot, changed: Robot | None, folder: Path | None) -> Any:
    """The MjModel of a file. changed: with other numbers, as it would be written into a folder. Errors: ZygosError
    where MuJoCo is not installed or rejects it."""
    if robot.format == "URDF":
        from zygos.simulators.urdf import corrected_urdf  # noqa: PLC0415  (an extra)

        content = robot.path.read_bytes() if changed is None else corrected_urdf(robot, changed)[robot.path]
        tree = _urdf_compiled(robot.path, content)
        tree.opt.gravity[:] = robot.gravity
        return tree
    if changed is None and not robot.translated:
        return compiled(robot.path)
    place = folder or robot.path.parent
    files = contents(robot, changed or robot, place / f".{os.getpid()}.partial.xml")
    try:
        write(files)
        return compiled(next(path for path in files if path.parent == place and path.name.startswith(".")))
    finally:
        for path in files:
            path.unlink(missing_ok=True)


def _urdf_compiled(path: Path, content: bytes) -> Any:
    """The MjModel of a URDF, without geometry. Errors: ZygosError with MuJoCo's reason."""
    from zygos.simulators.urdf import without_geometry  # noqa: PLC0415  (an extra)

    mujoco = load_mujoco()
    try:
        return mujoco.MjModel.from_xml_string(without_geometry(content).decode())
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ZygosError(f"{path}: MuJoCo does not read it ({reason}); remedy: correct the file") from None


def simulator(robot: Robot, arm: Arm, changed: Robot | None = None, folder: Path | None = None) -> Simulator:
    """The file in MuJoCo. changed: with other numbers, as it would be written into a folder.

    Errors: ZygosError where MuJoCo is not installed or rejects it.
    """
    return Simulator(tree_of(robot, changed, folder), robot, arm)

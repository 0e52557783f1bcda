# SPDX-License-Identifier: MIT
"""Options that name the drives of an arm, whose frames zygos knows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from zygos.errors import ZygosError
from zygos.files.output import note, write_text
from zygos.telemetry.drives import Drives, read_drives

Drive = Annotated[
    str | None,
    typer.Option(
        metavar="DRIVES",
        help="Drives whose frames zygos knows: damiao, cubemars, robstride, odrive, moteus or cia402, with the name of "
        "the motor, or of the motor of each node, behind a colon and with commas between.",
    ),
]
Nodes = Annotated[
    str | None, typer.Option(metavar="1-7", help="With --drive: the node of each joint, from the base on.")
]
Eds = Annotated[
    list[Path] | None,
    typer.Option(
        "--eds",
        metavar="DRIVE.eds",
        help="With --drive cia402: the EDS or DCF of the drives, or that of each node in turn.",
    ),
]
Urdf = Annotated[
    Path | None,
    typer.Option(
        "--urdf", metavar="ARM.urdf", help="With --drive: the arm, which stands on the ground, in place of --arm."
    ),
]


def named_drives(
    drive: str | None, nodes: str | None, eds: Sequence[Path] | None, arm: Path | None = None, urdf: Path | None = None
) -> Drives | None:
    """The drives that the options name, described on stderr; None where there are none. Errors: ZygosError for options
    that do not belong together."""
    if drive is None:
        if nodes or eds or urdf:
            given = "--nodes" if nodes else "--eds" if eds else "--urdf"
            raise ZygosError(f"{given} belongs to --drive; remedy: name the drives, or leave it out")
        return None
    if nodes is None:
        raise ZygosError(f"--drive {drive} needs the nodes; remedy: add for instance --nodes 1-7")
    if arm and urdf:
        raise ZygosError("--arm and --urdf both describe the arm; remedy: give one of them")
    drives = read_drives(drive, nodes, eds or ())
    note("\n".join(drives.described()))
    return drives


@contextmanager
def arm_file_of(arm: Path | None, urdf: Path | None, drives: Drives | None, command: str) -> Iterator[Path | None]:
    """The arm file that is given, or within the context one of the URDF with these drives. command: the one that makes
    it."""
    if drives is None or urdf is None:
        yield arm
        return
    with TemporaryDirectory() as folder:
        made = Path(folder, "arm.toml")
        write_text(made, _arm_text(urdf, drives, command))
        yield made


def _arm_text(urdf: Path, drives: Drives, command: str) -> str:
    from zygos.urdf.answers import Answers  # noqa: PLC0415  (other arms need no extra)
    from zygos.urdf.chain import read_chain  # noqa: PLC0415
    from zygos.urdf.importing import arm_text  # noqa: PLC0415

    chain, _ = read_chain(urdf, None, None, weighed=False)
    for line in chain.notes:
        note(f"note: {line}")
    names = [hinge.name for hinge in chain.hinges]
    answers = Answers(None, names, driven=False, known=drives.answers(names))
    return arm_text(answers.arm(chain), f"From {urdf.name} and the profile {drives.name} by `zygos {command}`.")

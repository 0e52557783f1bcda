# SPDX-License-Identifier: MIT
"""The examples that come with the package: their folders, and copies of them."""

from __future__ import annotations

import shutil
from pathlib import Path

from zygos.errors import ZygosError

EXAMPLES = {
    "paper": "The arm and motion of the paper: two flexible joints on a free-floating base, in the plane.",
    "lively": "The same kind of arm with a larger motion, which determines every parameter well within 60 s.",
    "spatial": "Three flexible joints on a free-floating base, in space.",
    "seven": "Seven flexible joints on a free-floating base, in space.",
    "gap": "A simulation model, and three recorded runs of an arm that has an effect the model lacks.",
    "telemetry": "A run on a bus that speaks another language, with its DBC and the map that `zygos convert` needs.",
    "pendulum": "Measured runs of a real arm with two joints on the ground, as the CAN frames of its drives.",
    "notebook": "A notebook: the paper's example simulated and estimated, then a gap explained.",
    "urdf": "A URDF, and the answers to what it does not say, for `zygos import`.",
}
"""Name and content of each example."""

_PACKAGE = Path(__file__).resolve().parents[1]


def _root() -> Path:
    """The folder of all examples: inside an installed package, or that of the checkout it is run from."""
    packaged = _PACKAGE / "_examples"
    return packaged if packaged.is_dir() else _PACKAGE.parents[1] / "examples"


def example(name: str) -> Path:
    """The folder of an example, to read from. Errors: ZygosError for a name that is not in `EXAMPLES`."""
    if name not in EXAMPLES:
        raise ZygosError(f"there is no example {name!r}; remedy: one of {', '.join(EXAMPLES)}")
    folder = _root() / name
    if not folder.is_dir():
        raise ZygosError(f"{folder}: the example is not there; remedy: install the package again")
    return folder


def write_example(name: str, folder: Path) -> tuple[Path, ...]:
    """Copy an example into a folder that does not exist yet; returns the files in it.

    Errors: ZygosError for an unknown name, a folder that exists, or one that cannot be written.
    """
    source = example(name)
    if folder.exists():
        raise ZygosError(f"{folder}: exists; remedy: remove it, or name another folder")
    try:
        # the copies are the user's: files of a package may be read-only
        shutil.copytree(source, folder, copy_function=shutil.copyfile)
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise ZygosError(
            f"{folder}: cannot be written ({error.strerror or error}); remedy: choose another folder"
        ) from error
    return tuple(sorted(path for path in folder.rglob("*") if path.is_file()))

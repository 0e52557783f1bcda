# SPDX-License-Identifier: MIT
"""`zygos example`: an example of the package, as files of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from zygos.errors import ZygosError
from zygos.files.examples import EXAMPLES, write_example
from zygos.files.output import counted, say


def command(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="The example to write. Without it: the list of all.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="The folder to write. Default: NAME, where you are."),
    ] = None,
) -> None:
    """Write one of the examples into a folder, or list them.

    The folder must not exist yet. What the examples are good for is in the documentation of the commands.

    Example: zygos example paper -o out/paper
    """
    if name is None:
        if out is not None:
            raise ZygosError(f"which example is to be written?; remedy: one of {', '.join(EXAMPLES)}, before -o {out}")
        for each, content in EXAMPLES.items():
            say(f"{each:<11}{content}")
        return
    folder = Path(name) if out is None else out
    files = write_example(name, folder)
    for file in files:
        say(str(file))
    say(f"{folder}: {counted(len(files), 'file')}")

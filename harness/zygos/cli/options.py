"""Options and arguments that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Json = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Also write the result as JSON to this file.")]
Report = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE.html", help="Also write a report, one HTML page."),
]
Details = Annotated[bool, typer.Option("--details", help="Print all tables, not only the verdict.")]
ArmFile = Annotated[
    Path | None, typer.Option("--arm", metavar="ARM.toml", help="The arm file. Default: arm.toml next to the run.")
]
Run = Annotated[
    Path,
    typer.Argument(
        metavar="RUN", help="A CAN log (.log .blf .asc .trc .mf4), or a table of cycles (.npz .csv .parquet)."
    ),
]
Interface = Annotated[
    str | None,
    typer.Option("-i", "--interface", metavar="NAME", help="The interface of python-can, for instance socketcan."),
]
ChannelOption = Annotated[
    str | None, typer.Option("-c", "--channel", metavar="NAME", help="The channel of that interface, such as vcan0.")
]
Bitrate = Annotated[
    int | None, typer.Option("-b", "--bitrate", metavar="BIT/S", help="The bit rate, if the interface asks for one.")
]
Runs = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...", help="CAN logs (.log .blf .asc .trc .mf4), or tables of cycles (.npz .csv .parquet)."
    ),
]

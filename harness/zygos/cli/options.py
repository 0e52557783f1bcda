# SPDX-License-Identifier: MIT
"""Options and arguments that several commands have."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import typer

from zygos.errors import ZygosError
from zygos.files.inputs import LOG_SUFFIXES, local, toml_kind
from zygos.files.tables import TABLE_SUFFIXES
from zygos.runs.span import reading

Out = Annotated[
    Path | None,
    typer.Option("-o", "--out", metavar="MODEL.toml", help="The model to write. Without it none is written."),
]
Json = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Also write the result as JSON to this file.")]
Report = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE.html", help="Also write a report, one HTML page."),
]
Mcap = Annotated[
    Path | None,
    typer.Option(
        "--mcap",
        metavar="FILE.mcap",
        help="Also write the signals as messages of ROS 2, for programs that draw them (Foxglove, Rerun).",
    ),
]
Details = Annotated[bool, typer.Option("--details", help="Print all tables, not only the verdict.")]


def _usage(context: typer.Context) -> str:
    """The command with what it takes, in order."""
    params = context.command.params
    names = [str(one.metavar) for one in params if one.param_type_name == "argument"]
    names += ["--map MAP.toml"] if any("--map" in one.opts for one in params) else []
    names += [] if "ARM.toml" in names else ["--arm ARM.toml"]
    names += [
        f"{min(one.opts, key=len)} {str(one.metavar).partition('|')[0]}"
        for one in params
        if one.param_type_name == "option" and one.required and one.opts[0] != "--map"
    ]
    return f"`zygos {' '.join([str(context.info_name), *names])}`"


def _instead(context: typer.Context, path: Path | None, wanted: str) -> Path | None:
    """Refuse a recording or a folder in the place of another file."""
    if path is not None and local(path).is_dir():
        raise ZygosError(f"{path}: is a folder; remedy: give {wanted} in it")
    suffixes = (*LOG_SUFFIXES, *TABLE_SUFFIXES, ".mcap")
    if path is not None and path.name.lower().removesuffix(".gz").endswith(suffixes):
        raise ZygosError(
            f"{path} is a recording, in the place of {wanted}: are the two swapped? remedy: {_usage(context)}"
        )
    return path


def of_arm(context: typer.Context, path: Path | None) -> Path | None:
    """Refuse a recording or a folder in the place of the arm file."""
    return _instead(context, path, "the arm file")


def of_map(context: typer.Context, path: Path | None) -> Path | None:
    """Refuse a recording or a folder in the place of the map."""
    return _instead(context, path, "the map")


def of_runs(context: typer.Context, runs: Any) -> Any:
    """Refuse a TOML file in the place of a recording."""
    for path in runs if isinstance(runs, list) else [runs] if runs is not None else []:
        if path.suffix.lower() == ".toml":
            found = toml_kind(path)
            raise ZygosError(
                f"{path} is {found}, in the place of a recording: are the two swapped? remedy: {_usage(context)}"
            )
    return runs


ArmFile = Annotated[
    Path | None,
    typer.Option("--arm", metavar="ARM.toml", help="The arm file. Default: arm.toml next to the run.", callback=of_arm),
]
ArmArgument = Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.", callback=of_arm)]
Run = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="A CAN log (.log .blf .asc .trc .mf4), or a table of cycles (.npz .csv .parquet).",
        callback=of_runs,
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
_FROM = Annotated[
    float | None,
    typer.Option(
        "--from", metavar="S", help="Read each recording from that many seconds after its beginning. Default: all."
    ),
]
_TO = Annotated[
    float | None,
    typer.Option("--to", metavar="S", help="Read each recording to that many seconds after its beginning."),
]
Command = TypeVar("Command", bound=Callable[..., None])


def cuts(command: Command) -> Command:
    """A command that reads recordings, with the options --from and --to, which its readers obey."""

    @wraps(command)
    def cutting(*arguments: Any, from_s: float | None, to_s: float | None, **options: Any) -> None:
        with reading(from_s, to_s):
            command(*arguments, **options)

    keyword = inspect.Parameter.KEYWORD_ONLY
    added = {"from_s": _FROM, "to_s": _TO}
    own = inspect.signature(command, eval_str=True)
    parameters = [inspect.Parameter(name, keyword, default=None, annotation=kind) for name, kind in added.items()]
    cutting.__signature__ = own.replace(parameters=[*own.parameters.values(), *parameters])  # type: ignore[attr-defined]
    cutting.__annotations__ = {**inspect.get_annotations(command, eval_str=True), **added}
    return cast("Command", cutting)


Runs = Annotated[
    list[Path],
    typer.Argument(
        metavar="RUN...",
        help="CAN logs (.log .blf .asc .trc .mf4), or tables of cycles (.npz .csv .parquet).",
        callback=of_runs,
    ),
]

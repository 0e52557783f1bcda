"""Options and arguments that several commands have."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import typer

from zygos.errors import ZygosError
from zygos.files.inputs import LOG_SUFFIXES
from zygos.files.tables import TABLE_SUFFIXES
from zygos.runs.span import reading

Json = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Also write the result as JSON to this file.")]
Report = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE.html", help="Also write a report, one HTML page."),
]
Details = Annotated[bool, typer.Option("--details", help="Print all tables, not only the verdict.")]


def _usage(context: typer.Context) -> str:
    """The command with what it takes, in order."""
    names = [str(one.metavar) for one in context.command.params if one.param_type_name == "argument"]
    names += [] if "ARM.toml" in names else ["--arm ARM.toml"]
    return f"`zygos {' '.join([str(context.info_name), *names])}`"


def _arm(context: typer.Context, path: Path | None) -> Path | None:
    """Refuse a run in the place of the arm file."""
    if path is not None and path.name.lower().removesuffix(".gz").endswith((*LOG_SUFFIXES, *TABLE_SUFFIXES)):
        raise ZygosError(
            f"{path} is a run, in the place of the arm file: the two are swapped; remedy: {_usage(context)}"
        )
    return path


def _runs(context: typer.Context, runs: Any) -> Any:
    """Refuse an arm file in the place of a run."""
    for path in runs if isinstance(runs, list) else [runs]:
        if path.suffix.lower() == ".toml":
            raise ZygosError(f"{path} is an arm file or a model, in the place of a run; remedy: {_usage(context)}")
    return runs


ArmFile = Annotated[
    Path | None,
    typer.Option("--arm", metavar="ARM.toml", help="The arm file. Default: arm.toml next to the run.", callback=_arm),
]
ArmArgument = Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.", callback=_arm)]
Run = Annotated[
    Path,
    typer.Argument(
        metavar="RUN",
        help="A CAN log (.log .blf .asc .trc .mf4), or a table of cycles (.npz .csv .parquet).",
        callback=_runs,
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
        callback=_runs,
    ),
]

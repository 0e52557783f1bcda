"""The command line: one file a command, loaded when it is called."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.metadata import version as version_of
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from zygos.files.inputs import standard_input
from zygos.files.output import errors_end_the_program

COMMANDS = {
    "simulate": ("simulate", "Simulate a run: plant, servo and sensors, recorded as the CAN traffic they would cause."),
    "estimate": ("estimate", "Learn the parameters from a run, with the C library that flies."),
    "check": ("check", "Compare the C library with numpy on a run, room by room."),
    "check-arm": (
        "check_arm",
        "Hold a run against its arm file: rate, range, steps and noise of each signal, and whether the signals agree.",
    ),
    "convert": ("convert", "Make a run of somebody else's telemetry."),
    "view": ("view", "Show the arm of a run moving in 3-D: in the browser, as a page to keep, or as stills."),
    "explain": (
        "explain",
        "Say where simulation and measurement disagree, name the missing effect, add it, and show the gap shrink.",
    ),
    "listen": (
        "listen",
        "Listen to a bus and learn while the frames arrive. Ctrl-C or SIGTERM ends it and keeps what was learned.",
    ),
    "import": ("import_urdf", "Make arm.toml and model.toml from a URDF."),
    "export": ("export_urdf", "Write a URDF with the inertials of a model; all else of the URDF stays as it is."),
    "fit": ("fit", "Find the arm behind an estimate: bodies that can exist, lengths and drives that explain it."),
    "dbc": ("dbc", "Write the DBC of this arm, for any CAN tool: its frames, with the joints' and parameters' names."),
    "compile-model": (
        "compile_model",
        "Compile an arm file into the constant that onboard software links, and into bytes that it loads.",
    ),
    "bus-load": ("bus_load", "Say how much of the bus this arm's frames take, and how fast its SYNC may be."),
    "example": ("example", "Write one of the examples into a folder, or list them."),
    "paper": (
        "paper",
        "Reproduce the paper's Tables III and IV and the numbers of Fig. 4(b), with the printed ones beside them.",
    ),
}
"""The module and the first line of the help of each command. The modules load numpy, scipy and more: the list of all
commands must not wait for that."""


def load(name: str) -> TyperCommand:
    """A command with its arguments and options, by its name."""
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="markdown")
    alone.command(name)(import_module(f"zygos.cli.{COMMANDS[name][0]}").command)
    command = typer.main.get_command(alone)
    assert isinstance(command, TyperCommand)
    return command


class Commands(TyperGroup):
    """The group of `COMMANDS`, of which only the one that is called is loaded."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:
        """A command as lists show it: name and first line."""
        return TyperCommand(cmd_name, help=COMMANDS[cmd_name][1]) if cmd_name in COMMANDS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """The command that is called, in full."""
        name, found, rest = super().resolve_command(ctx, args)
        return name, load(name) if name and found else found, rest


app = typer.Typer(
    name="zygos",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # in Rich's own markup [view] and [[effect]] would be tags, and vanish
)


def _version(wanted: bool) -> None:
    """Print name and version, and end."""
    if wanted:
        print(f"zygos {version_of('zygos')}")
        raise typer.Exit


@app.callback()
def zygos(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Learn the dynamics of a flexible-joint space arm from its CAN frames.

    There are three kinds of file: **arm.toml** says what the hardware is, **model.toml** what someone believes of its
    dynamics, and **scenario.toml** what is done with it. A run is a CAN log (.log .blf .asc .trc .mf4), or, for
    estimate, check, check-arm and view, a table of cycles (.npz .csv .parquet).

    The name - stands for standard input wherever a file is read, and for standard output wherever one file is written.
    What kind of log or table comes on standard input is seen from how it begins.

    Exit codes: 0 answered, 2 bad input, 3 refused or undecided, 4 answered from a damaged log.
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Errors of the user end with a message on stderr and their exit code, never a traceback."""
    with errors_end_the_program(), standard_input():
        app(args=arguments, obj=sys.argv[1:] if arguments is None else arguments)

# SPDX-License-Identifier: MIT
"""The command line: one file per command, loaded when the command is called."""

from __future__ import annotations

import sys
from difflib import get_close_matches
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from zygos.files.inputs import standard_input
from zygos.files.output import errors_end_the_program, note

GROUPS = {
    "Begin here": {
        "estimate": ("estimate", "Estimate the parameters from one or several runs of an arm."),
        "explain": (
            "explain",
            "Find where simulation and measurement disagree, name the missing effect, add it, and "
            "show how the gap shrinks.",
        ),
        "check-arm": (
            "check_arm",
            "Check a run against its arm file: rate, range, steps and noise of each signal, and "
            "whether the signals agree.",
        ),
        "simulate": ("simulate", "Simulate a run: plant, servo and sensors, recorded as CAN traffic."),
        "view": (
            "view",
            "Show the arm of a run moving in 3-D: in the browser, as a page in a file, or as still pictures.",
        ),
    },
    "Runs": {
        "convert": ("convert", "Convert telemetry of another system to a run."),
        "predict": (
            "predict",
            "Compare runs with what a model predicts of them: the torques of each joint, and "
            "the motion half a second ahead.",
        ),
        "self-test": ("self_test", "Compare the C library with numpy on a run, stage by stage."),
    },
    "On a bus and on board": {
        "listen": (
            "listen",
            "Listen to a bus and estimate while the frames arrive. Ctrl-C or SIGTERM ends it and writes "
            "the estimate so far.",
        ),
        "compile-model": (
            "compile_model",
            "Compile an arm file into a constant that onboard software links, and into bytes that it loads.",
        ),
        "dbc": (
            "dbc",
            "Write the DBC of this arm, for any CAN tool: its frames, with the joints' and parameters' names.",
        ),
        "bus-load": ("bus_load", "Compute how much of the bus this arm's frames take, and its largest SYNC rate."),
    },
    "Motions and models": {
        "plan": ("plan", "Plan a motion that excites every parameter, or rank given motions by what they tell."),
        "fit": ("fit", "Find the physical arm that explains an estimate: possible bodies, lengths and drives."),
        "parameters": ("parameters", "List the base parameters of an arm, and what each of them stands for."),
        "import": ("import_urdf", "Make arm.toml and model.toml from a URDF."),
        "export": (
            "export_urdf",
            "Write a URDF or an MJCF with the values of a model; everything else in it is unchanged.",
        ),
    },
    "Examples": {
        "example": ("example", "Write one of the examples into a folder, or list them."),
        "paper": (
            "paper",
            "Reproduce the paper's Tables III and IV and the numbers of Fig. 4(b), next to the printed ones.",
        ),
    },
}
"""The module and the first line of the help of each command, in the order of the list of commands. The modules load
numpy, scipy and more, which would delay that list."""
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
FORMER = {
    "check": ("self_test", "it is called `zygos self-test`"),
    "refine": ("refine", "`zygos estimate` refines by itself"),
    "bound": ("bound", "`zygos plan SCENARIO.toml --by bound` has the same standard deviations"),
}
"""The module of each command that has gone, and what has its place. They go on in this version, and are in no list."""


class Greedy(TyperCommand):
    """A command whose repeatable options take all values that follow, up to the next option, where it needs
    no arguments: `--validate A B` is `--validate A --validate B`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat the option before each further value."""
        repeatable = {name for one in self.params if getattr(one, "multiple", False) for name in one.opts}
        if any(one.param_type_name == "argument" and one.required for one in self.params):
            return super().parse_args(ctx, args)
        out: list[str] = []
        option, count = "", 0
        for arg in args:
            if arg.startswith("-") and arg != "-":
                option, count = arg if arg in repeatable else "", 0
            elif option:
                count += 1
                if count > 1:
                    out.append(option)
            out.append(arg)
        return super().parse_args(ctx, out)


def load(name: str) -> TyperCommand:
    """A command with its arguments and options, by its name."""
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="markdown")
    alone.command(name, cls=Greedy)(import_module(f"zygos.cli.{(COMMANDS | FORMER)[name][0]}").command)
    command = typer.main.get_command(alone)
    assert isinstance(command, TyperCommand)
    return command


class Commands(TyperGroup):
    """The group of `COMMANDS`; only the command that is called is loaded."""

    def list_commands(self, ctx: Any) -> list[str]:
        """The names, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> TyperCommand | None:
        """A command for lists: its name, first line and group."""
        for group, commands in GROUPS.items():
            if cmd_name in commands:
                return TyperCommand(cmd_name, help=commands[cmd_name][1], rich_help_panel=group)
        return None

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """The called command, completely loaded. Errors: that of a wrong name, with the name that was meant."""
        if args and args[0] in FORMER:
            note(f"zygos: {args[0]} goes in the next version: {FORMER[args[0]][1]}")
            return args[0], load(args[0]), args[1:]
        if args and args[0] not in COMMANDS and (meant := get_close_matches(args[0], COMMANDS, 1)):
            ctx.fail(f"No such command '{args[0]}'. Did you mean '{meant[0]}'?")
        match args:
            case ["check-arm", arm, run, *rest] if arm.lower().endswith(".toml") and (run == "-" or run[:1] != "-"):
                note("zygos: ARM.toml before RUN goes in the next version: `zygos check-arm RUN --arm ARM.toml`")
                args = ["check-arm", run, "--arm", arm, *rest]
        name, found, rest = super().resolve_command(ctx, args)
        return name, load(name) if name and found else found, rest


app = typer.Typer(
    name="zygos",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # in Rich's own markup [view] and [[effect]] would be tags, and would disappear
)


def _version(wanted: bool) -> None:
    """Print name and version, and end."""
    if wanted:
        from importlib.metadata import version as version_of  # noqa: PLC0415  (slow to load)

        print(f"zygos {version_of('zygos')}")
        raise typer.Exit


@app.callback()
def zygos(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Estimate the dynamics of a space arm with flexible joints from its CAN frames.

    There are three kinds of input file: **arm.toml** describes the hardware, **model.toml** an assumed dynamic model,
    and **scenario.toml** a manoeuvre to simulate. A run is a CAN log (.log .blf .asc .trc .mf4), or, for all
    commands that need no frames, a table of cycles (.npz .csv .parquet).

    The name - stands for standard input wherever a file is read, and for standard output wherever one file is written.
    The kind of log or table on standard input is recognised by its first bytes.

    Exit codes: 0 answered, 2 bad input, 3 refused or undecided, 4 answered from a damaged log.
    """


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Errors of the user end with a message on stderr and their exit code, never a traceback."""
    called = sys.argv[1:] if arguments is None else arguments
    # `-h` beside `--help` in the lists of options would take the room of longer names in a narrow window
    with errors_end_the_program(), standard_input():
        app(args=["--help" if word == "-h" else word for word in called], obj=called)

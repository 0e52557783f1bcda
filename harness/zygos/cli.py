"""The command line: thin, every command is a few calls into the package."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    name="zygos",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode="rich",
    help="Learn the dynamics of a flexible-joint space arm from its CAN frames.\n\n"
    "Three kinds of file: [bold]arm.toml[/] says what the hardware is, [bold]model.toml[/] what someone believes of "
    "its dynamics, [bold]scenario.toml[/] what is done with it. A run is a CAN log (.log .blf .asc .trc .mf4).\n\n"
    "Exit codes: 0 answered, 2 bad input, 3 refused or undecided, 4 answered from a damaged log.",
)

Json = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Also write the result as JSON; - for stdout.")
]
ArmFile = Annotated[
    Path | None, typer.Option("--arm", metavar="ARM.toml", help="The hardware. Default: arm.toml beside the run.")
]
Run = Annotated[Path, typer.Argument(metavar="RUN", help="A CAN log: .log, .blf, .asc, .trc or .mf4.")]
Interface = Annotated[str | None, typer.Option("-i", "--interface", help="python-can's interface, e.g. socketcan.")]
Channel = Annotated[str | None, typer.Option("-c", "--channel", help="python-can's channel, e.g. vcan0.")]
Bitrate = Annotated[int | None, typer.Option("-b", "--bitrate", help="Bit rate, where the interface wants one.")]


@app.command()
def simulate(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="What is done, with which arm and plant.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="RUN", help="The CAN log to write.")],
    model: Annotated[
        Path | None, typer.Option("--model", metavar="MODEL.toml", help="Simulate this plant, not the scenario's.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the sensor noise. Default: the scenario's.")] = None,
    noise: Annotated[bool | None, typer.Option("--noise/--no-noise", help="Default: the scenario's.")] = None,
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    json: Json = None,
) -> None:
    """Simulate a run: plant, servo and sensors, recorded as the CAN traffic they would cause.

    Writes RUN, and a copy of the arm file beside it as arm.toml. The plant's true values are written nowhere.
    With -i and -c the frames are also sent on that bus, at the pace of the SYNCs.

    Example: zygos simulate examples/paper/scenario.toml -o out/run.blf
    """
    from zygos.commands import simulate_run  # noqa: PLC0415  (each command loads only what it needs)

    simulate_run(scenario, out, model, seed, noise, interface, channel, bitrate, json)


@app.command()
def estimate(
    run: Run,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MODEL.toml", help="The model to write.")],
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PRIOR.toml",
            help="Also learn the effects of this model; where the run is silent on a value, keep its own.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Learn the parameters from a run, with the C library that flies.

    Writes a model.toml with value and sigma of each parameter. A parameter that the motion does not determine is left
    out, or taken from --model. The [[effect]] entries of --model (friction, cubic stiffness, torque lag) are learned as
    well, whatever their values. Exit code 3 when something is undecided; the reason is on stderr and in the JSON.

    Example: zygos estimate out/run.blf -o out/estimate.toml
    """
    from zygos.commands import estimate_run  # noqa: PLC0415

    estimate_run(run, arm, out, model, json)


@app.command()
def check(
    run: Run,
    arm: ArmFile = None,
    model: Annotated[
        Path | None, typer.Option("--model", metavar="MODEL.toml", help="Also compare the columns of its effects.")
    ] = None,
    json: Json = None,
) -> None:
    """Compare the C library with numpy on a run, room by room.

    Wire and cycles, smoother, rows, normal equations, solution: the largest difference, its cycle and the tolerance.
    The two share no code: cantools and autosar-e2e decode, whole-record convolution smooths, lstsq solves.
    Exit code 3 when a room differs by more than its tolerance, or the run does not determine the parameters.

    Example: zygos check out/run.blf
    """
    from zygos.commands import check_run  # noqa: PLC0415

    check_run(run, arm, model, json)


@app.command()
def explain(
    context: typer.Context,
    simulation: Annotated[
        Path, typer.Option("--simulation", metavar="CAD.toml", help="The model that the simulation uses.")
    ],
    measured: Annotated[
        tuple[Path, Path],
        typer.Option("--measured", metavar="RUN_A RUN_B", help="Two runs: what one says must hold on the other."),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="NEW.toml", help="The model to write.")],
    validate: Annotated[
        Path | None,
        typer.Option("--validate", metavar="RUN_C", help="A third run, kept apart: the gap is measured on it."),
    ] = None,
    arm: ArmFile = None,
    report: Annotated[Path | None, typer.Option("--report", metavar="GAP.html", help="Also write a page.")] = None,
    json: Json = None,
) -> None:
    """Say where simulation and measurement disagree, name the missing effect, add it, and show the gap shrink.

    Balances of energy, motor impulse and momentum are drawn up on cycles that the C library decoded, and read against
    those of the simulation's own twin. The answer is one of: values differ, named, cannot tell these apart, nothing
    missing above the detection limits, unknown. What is named enters NEW.toml with value, interval and evidence; the
    gap is that of predictions half a second ahead on RUN_C, in the sensors' noise: as delivered, refit, closed, floor.

    Exit code 3 when the answer is unknown or cannot tell; then NEW.toml is not written.

    Example: zygos explain --simulation examples/gap/cad.toml --measured A.blf B.blf --validate C.blf -o out/new.toml
    """
    from zygos.gap.command import explain_run  # noqa: PLC0415

    explain_run(simulation, measured, validate, arm, out, report, json, context.obj or ["explain"])


@app.command()
def listen(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The hardware.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MODEL.toml", help="The model to write at the end.")],
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    log: Annotated[
        Path | None, typer.Option(metavar="RUN", help="Also record the frames in this CAN log. It appears at the end.")
    ] = None,
    duration: Annotated[float, typer.Option(min=0.0, help="Stop after so many seconds; 0: no limit.")] = 0.0,
    idle: Annotated[
        float, typer.Option(min=0.1, help="Stop when the bus is silent for so many seconds; at first for ten times.")
    ] = 2.0,
    json: Json = None,
) -> None:
    """Listen to a bus and learn while the frames arrive. Ctrl-C or SIGTERM ends it and keeps what was learned.

    Exit code 3 when something is undecided, or the bus failed; what was learned until then is kept.

    Example: zygos listen -i socketcan -c vcan0 --arm examples/paper/arm.toml -o out/live.toml
    """
    from zygos.commands import listen_bus  # noqa: PLC0415

    listen_bus(arm, out, interface, channel, bitrate, log, duration, idle, json)


@app.command()
def paper(
    seeds: Annotated[int, typer.Option(min=2, max=1000, help="Seeds 0 .. SEEDS-1.")] = 50,
    folder: Annotated[
        Path | None, typer.Option("--example", metavar="FOLDER", help="Folder with arm, model and scenario.toml.")
    ] = None,
    json: Json = None,
) -> None:
    """Reproduce the paper's Tables III and IV: AMC, DE and EB, with its sensors and without, beside the flight chain.

    Example: zygos paper --seeds 50
    """
    from zygos.paper import run_paper  # noqa: PLC0415

    run_paper(seeds, folder, json)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line. Errors of the user end with a message on stderr and their exit code, never a traceback."""
    from zygos.output import errors_end_the_program  # noqa: PLC0415

    with errors_end_the_program():
        app(args=arguments, obj=sys.argv[1:] if arguments is None else arguments)


if __name__ == "__main__":
    main()

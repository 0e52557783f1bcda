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
    rich_markup_mode="markdown",  # in Rich's own markup [view] and [[effect]] would be tags, and vanish
)


def _version(wanted: bool) -> None:
    """Print name and version, and end."""
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415

        print(f"zygos {version('zygos')}")
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


Json = Annotated[str | None, typer.Option("--json", metavar="FILE", help="Also write the result as JSON to this file.")]
ArmFile = Annotated[
    Path | None, typer.Option("--arm", metavar="ARM.toml", help="The arm file. Default: arm.toml beside the run.")
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
Channel = Annotated[
    str | None, typer.Option("-c", "--channel", metavar="NAME", help="The channel of that interface, such as vcan0.")
]
Bitrate = Annotated[
    int | None, typer.Option("-b", "--bitrate", metavar="BIT/S", help="The bit rate, if the interface asks for one.")
]


@app.command()
def simulate(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.toml", help="The scenario, which names arm and plant.")],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="RUN", help="The CAN log to write; - writes lines of candump.")
    ],
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL", help="Simulate this plant instead of the scenario's."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Seed of the sensor noise. Default: the scenario's.")
    ] = None,
    noise: Annotated[
        bool | None,
        typer.Option("--noise/--no-noise", help="Whether sensors are noisy. Default: as the scenario says."),
    ] = None,
    engine: Annotated[
        str,
        typer.Option(
            metavar="ENGINE", help="Whose equations of motion are integrated: those of zygos, pinocchio or mujoco."
        ),
    ] = "zygos",
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    json: Json = None,
) -> None:
    """Simulate a run: plant, servo and sensors, recorded as the CAN traffic they would cause.

    Writes RUN, and a copy of the arm file beside it as arm.toml. The plant's true values are written nowhere. With
    -i and -c the frames are also sent on that bus, at the pace of the SYNCs. With --engine, Pinocchio or MuJoCo move
    the same bodies by their own equations; those know no effects.

    Example: zygos simulate examples/paper/scenario.toml -o out/run.blf
    """
    from zygos.commands import simulate_run  # noqa: PLC0415  (each command loads only what it needs)

    simulate_run(scenario, out, model, seed, noise, engine, interface, channel, bitrate, json)


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
            help="Also learn the effects of this model, and keep its values where the run determines none.",
        ),
    ] = None,
    json: Json = None,
) -> None:
    """Learn the parameters from a run, with the C library that flies.

    Writes a model.toml with value and sigma of each parameter. A parameter that the motion does not determine is left
    out, or taken from --model. The [[effect]] entries of --model (friction, cubic stiffness, torque lag) are learned as
    well, whatever their values; so is a spring_offset of each joint whose zeros the arm file does not vouch for
    (zero_sigma_rad above 0). Exit code 3 when something is undecided; the reason is on stderr and in the JSON. Where
    the arm changed during the run, a warning on stderr and the JSON say when, and in which parameters.

    Example: zygos estimate out/run.blf -o out/estimate.toml
    """
    from zygos.commands import estimate_run  # noqa: PLC0415

    estimate_run(run, arm, out, model, json)


@app.command()
def check(
    run: Run,
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.toml", help="Also compare the columns of this model's effects."),
    ] = None,
    json: Json = None,
) -> None:
    """Compare the C library with numpy on a run, room by room.

    The rooms are wire and cycles, smoother, rows, normal equations and solution. For each the table has the largest
    difference, the cycle where it is found, and the tolerance. The two sides share no code: on numpy's side cantools
    and autosar-e2e decode, a convolution of the whole record smooths, and lstsq solves.

    Exit code 3 when a room differs by more than its tolerance, or the run does not determine the parameters.

    Example: zygos check out/run.blf
    """
    from zygos.commands import check_run  # noqa: PLC0415

    check_run(run, arm, model, json)


@app.command(name="check-arm")
def check_arm(
    arm: Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.")],
    run: Run,
    json: Json = None,
) -> None:
    """Hold a run against its arm file: rate, range, steps and noise of each signal, and whether the signals agree.

    Names signals that are swapped, inverted, scaled by the gear ratio, stuck or saturated, a skew in time between the
    two encoders of a joint, zeros that are off, and a wrong torque law; each with the number that says how sure it is,
    and the remedy. No model is needed.

    Exit code 3 when something is found, or the run does not confirm every signal.

    Example: zygos check-arm out/arm.toml out/run.blf
    """
    from zygos.check_arm import check_arm_run  # noqa: PLC0415

    check_arm_run(arm, run, json)


@app.command()
def convert(
    source: Annotated[
        Path,
        typer.Argument(metavar="LOG", help="A CAN log (.log .blf .asc .trc .mf4), or a table (.csv .parquet .npz)."),
    ],
    map_file: Annotated[
        Path, typer.Option("--map", metavar="MAP.toml", help="Says which signal is what of the arm, in which unit.")
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="RUN", help="The run to write: a CAN log or a table of cycles.")
    ],
    dbc: Annotated[
        list[Path] | None,
        typer.Option("--dbc", metavar="MY.dbc", help="The DBC of a CAN log; may be given several times."),
    ] = None,
    arm: Annotated[
        Path | None, typer.Option("--arm", metavar="ARM.toml", help="The arm file. Default: arm.toml beside the map.")
    ] = None,
    json: Json = None,
) -> None:
    """Make a run of somebody else's telemetry.

    Decodes LOG with its own DBC, turns signals into SI by scale, sign and unit, and writes RUN with arm.toml beside it.
    A cycle counter in the telemetry gives one record a cycle. Without one, signals are interpolated on the grid of the
    arm's period, and the error of that is added to the noise that the arm.toml beside RUN declares. The table shows the
    range of every signal: see whether it is plausible.

    Exit code 3 when the motion is faster than the recording; RUN is written all the same.

    Example: zygos convert MY.blf --dbc MY.dbc --map map.toml -o out/run.blf
    """
    from zygos.convert import convert_run  # noqa: PLC0415

    convert_run(source, dbc or [], map_file, arm, out, json)


@app.command()
def view(
    run: Run,
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.toml", help="Bodies with lengths and masses. Default: all lengths 1 m."),
    ] = None,
    png: Annotated[
        Path | None, typer.Option("--png", metavar="FILE", help="Draw six stills, or with --at one.")
    ] = None,
    at: Annotated[float | None, typer.Option("--at", metavar="SECONDS", help="The instant of the one still.")] = None,
    html: Annotated[
        Path | None, typer.Option("--html", metavar="FILE", help="Write a page that a browser plays, offline too.")
    ] = None,
    exaggerate: Annotated[
        float, typer.Option(metavar="FACTOR", min=0.0, help="Draw theta - q larger by this factor.")
    ] = 1.0,
    port: Annotated[
        int, typer.Option(metavar="N", min=0, max=65535, help="Port of the browser's page; 0 takes a free one.")
    ] = 0,
    json: Json = None,
) -> None:
    """Show the arm of a run moving in 3-D: in the browser, as a page to keep, or as stills.

    Joint angles and the gyro move it; a free-floating arm is drawn about its mass centre. The translucent arm shows
    where the motors are (theta). Without --png and --html a page opens in the browser until Ctrl-C. --png needs no
    screen. This command needs an extra: pip install 'zygos[view]'.

    Example: zygos view out/run.blf --model examples/paper/model.toml --png out/arm.png
    """
    from zygos.view import view_run  # noqa: PLC0415

    view_run(run, arm, model, png, at, html, exaggerate, port, json)


@app.command()
def explain(
    context: typer.Context,
    simulation: Annotated[
        Path, typer.Option("--simulation", metavar="CAD.toml", help="The model that the simulation uses.")
    ],
    measured: Annotated[
        tuple[Path, Path],
        typer.Option(
            "--measured", metavar="RUN_A RUN_B", help="Two runs; what is learned from one must hold on the other."
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="NEW.toml", help="The model to write.")],
    validate: Annotated[
        Path | None,
        typer.Option(
            "--validate", metavar="RUN_C", help="A third run, from which nothing is learned; the gap is measured on it."
        ),
    ] = None,
    arm: ArmFile = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="GAP.html", help="Also write a report, one HTML page.")
    ] = None,
    json: Json = None,
) -> None:
    """Say where simulation and measurement disagree, name the missing effect, add it, and show the gap shrink.

    Balances of energy, motor impulse and momentum are drawn up on cycles that the C library decoded, and compared with
    those of a simulated twin of the run. The answer is one of: values differ, named, cannot tell these apart, nothing
    missing above the detection limits, unknown. What is named enters NEW.toml with value, interval and evidence. The
    gap is the error of predictions half a second ahead on RUN_C, in units of the sensors' noise: with the model as
    delivered, refit, closed (with what was named), and the floor that noise leaves.

    Exit code 3 when the answer is unknown or cannot tell; then NEW.toml is not written.

    Example: zygos explain --simulation examples/gap/cad.toml --measured A.blf B.blf --validate C.blf -o out/new.toml
    """
    from zygos.gap.command import explain_run  # noqa: PLC0415

    explain_run(simulation, measured, validate, arm, out, report, json, context.obj or ["explain"])


@app.command()
def listen(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MODEL.toml", help="The model to write at the end.")],
    interface: Interface = None,
    channel: Channel = None,
    bitrate: Bitrate = None,
    log: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Also record the frames in this CAN log, which appears at the end."),
    ] = None,
    duration: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="Stop after so many seconds; 0: no limit.")
    ] = 0.0,
    idle: Annotated[
        float,
        typer.Option(
            metavar="S", min=0.1, help="Stop so many seconds after the last SYNC; the first may take 10 times as long."
        ),
    ] = 2.0,
    json: Json = None,
) -> None:
    """Listen to a bus and learn while the frames arrive. Ctrl-C or SIGTERM ends it and keeps what was learned.

    Exit code 3 when something is undecided, or the bus failed; what was learned until then is kept.

    Example: zygos listen -i socketcan -c vcan0 --arm examples/paper/arm.toml -o out/live.toml
    """
    from zygos.commands import listen_bus  # noqa: PLC0415

    listen_bus(arm, out, interface, channel, bitrate, log, duration, idle, json)


@app.command("import")
def import_(
    urdf: Annotated[Path, typer.Argument(metavar="ARM.urdf", help="The URDF of the arm.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="The folder where arm.toml and model.toml are written."),
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="LINK", help="The link that the arm begins at. Default: the root.")
    ] = None,
    tip: Annotated[
        str | None, typer.Option(metavar="LINK", help="The last link of the arm. Default: the only end.")
    ] = None,
    answers: Annotated[
        Path | None, typer.Option(metavar="ANSWERS.toml", help="Says what a URDF does not: motors, sensors, bus.")
    ] = None,
    template: Annotated[
        Path | None, typer.Option(metavar="ANSWERS.toml", help="Write only this file of questions, to be filled in.")
    ] = None,
    json: Json = None,
) -> None:
    """Make arm.toml and model.toml from a URDF.

    Links behind fixed joints, and branches off the chain, are merged into the link that carries them. Gears, rotors,
    springs, encoders, gyro and bus are in no URDF: they come from --answers, or are asked for at a terminal.

    Example: zygos import examples/urdf/arm.urdf --answers examples/urdf/answers.toml -o out/arm
    """
    from zygos.urdf_command import import_urdf  # noqa: PLC0415

    import_urdf(urdf, out, base, tip, answers, template, json)


@app.command()
def export(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    model: Annotated[
        Path, typer.Option("--model", metavar="MODEL.toml", help="A model by bodies, or by base parameters.")
    ],
    urdf: Annotated[Path, typer.Option("--urdf", metavar="IN.urdf", help="The URDF whose inertials are replaced.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="OUT.urdf", help="The URDF to write.")],
    cad: Annotated[
        Path | None,
        typer.Option(
            "--cad", metavar="CAD.toml", help="For base parameters: the model by bodies that decides the rest."
        ),
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(metavar="LINK", help="The link that the arm begins at. Default: that of the model's first body."),
    ] = None,
    json: Json = None,
) -> None:
    """Write a URDF with the inertials of a model; all else of the URDF stays as it is.

    Base parameters, as `zygos estimate` writes them, do not determine every inertial. Of all bodies that have them, the
    nearest to those of --cad are written, and a table says which entries are determined.

    Exit code 3 when no bodies that can exist have these base parameters.

    Example: zygos export --arm arm.toml --model estimate.toml --cad model.toml --urdf arm.urdf -o new.urdf
    """
    from zygos.urdf_command import export_urdf  # noqa: PLC0415

    export_urdf(arm, model, urdf, out, cad, base, json)


@app.command()
def fit(
    estimate: Annotated[
        Path, typer.Argument(metavar="ESTIMATE.json", help="What `zygos estimate --json` has written.")
    ],
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    model: Annotated[Path, typer.Option("--model", metavar="CAD.toml", help="The model by bodies from the drawing.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="MODEL.toml", help="The model by bodies to write.")],
    lengths: Annotated[
        float,
        typer.Option(metavar="MM", min=0.0, help="One sigma of the lengths of CAD.toml in mm; 0 takes them as exact."),
    ] = 1.0,
    json: Json = None,
) -> None:
    """Find the arm behind an estimate: bodies that can exist, lengths and drives that explain it.

    An estimate has noise, and in general no bodies have exactly its values. The bodies found here can exist: their
    matrix N is positive definite, and predicts inertias better than the estimate itself. What the estimate does not
    determine stays as in CAD.toml. chi^2/dof says how well the arm explains the estimate. This command needs an extra:
    pip install 'zygos[fit]'.

    Exit code 3 when no arm with these axes, and lengths near the drawing's, explains it; then nothing is written.

    Example: zygos fit out/estimate.json --arm out/arm.toml --model examples/spatial/model.toml -o out/fitted.toml
    """
    from zygos.physical_command import fit_estimate  # noqa: PLC0415

    fit_estimate(estimate, arm, model, out, lengths * 1e-3, json)


@app.command()
def dbc(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    out: Annotated[Path, typer.Option("-o", "--out", metavar="ARM.dbc", help="The DBC to write.")],
    model: Annotated[
        Path | None, typer.Option("--model", metavar="PRIOR.toml", help="Also name the effects of this model.")
    ] = None,
    json: Json = None,
) -> None:
    """Write the DBC of this arm, for any CAN tool: its frames, with the joints' and parameters' names.

    A joint's name becomes an identifier of at most 20 letters, digits and underscores. Where two joints would have the
    same identifier, all of them end in their node numbers.

    Example: zygos dbc --arm examples/paper/arm.toml -o out/arm.dbc
    """
    from zygos.dbc import write_dbc  # noqa: PLC0415

    write_dbc(arm, model, out, json)


@app.command()
def compile_model(
    arm: Annotated[Path, typer.Argument(metavar="ARM.toml", help="The arm file.")],
    out: Annotated[
        Path,
        typer.Option("-o", "--out", metavar="FOLDER", help="The folder where arm_config.h and arm.zyg are written."),
    ] = Path(),
    model: Annotated[
        Path | None, typer.Option("--model", metavar="PRIOR.toml", help="Also learn the effects of this model.")
    ] = None,
    json: Json = None,
) -> None:
    """Compile an arm file into the constant that onboard software links, and into bytes that it loads.

    Writes arm_config.h, for C11 and C++17, with the configuration and the places of the parameters (ARM_k1), and
    arm.zyg, the bytes of the same configuration in this build behind a head with layout and CRC (docs/snapshot.md),
    which `zygos-node` loads. A configuration that the flight library would refuse is not written.

    Example: zygos compile-model examples/paper/arm.toml -o out/onboard
    """
    from zygos.compiled import compile_model as compile_arm  # noqa: PLC0415

    compile_arm(arm, out, model, json)


@app.command()
def bus_load(
    arm: Annotated[Path, typer.Option("--arm", metavar="ARM.toml", help="The arm file.")],
    bitrate: Annotated[
        int, typer.Option(metavar="BIT/S", min=1000, max=1_000_000, help="The bit rate of the bus.")
    ] = 1_000_000,
    attitude_hz: Annotated[
        float | None,
        typer.Option(metavar="HZ", min=0.0, max=1e6, help="Attitude frames per second. Default: 100 with a gyro."),
    ] = None,
    telemetry_hz: Annotated[
        float, typer.Option(metavar="HZ", min=0.0, max=1e6, help="Telemetry frames per second.")
    ] = 100.0,
    run: Annotated[
        Path | None,
        typer.Option("--run", metavar="RUN", help="Also count the bits of this CAN log, stuff bits included."),
    ] = None,
    json: Json = None,
) -> None:
    """Say how much of the bus this arm's frames take, and how fast its SYNC may be.

    The load is that at the arm file's period_s if bit stuffing makes every frame as long as it can be. The largest SYNC
    rate is the one that fills 70 % of the bus.

    Exit code 3 when the load is above 70 %, or that of RUN with all frames of others in it.

    Example: zygos bus-load --arm examples/paper/arm.toml --bitrate 500000
    """
    from zygos.busload import report_bus_load  # noqa: PLC0415

    report_bus_load(arm, bitrate, attitude_hz, telemetry_hz, run, json)


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

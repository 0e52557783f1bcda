# SPDX-License-Identifier: MIT
"""`zygos estimate`: estimates the parameters from one or several recorded runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from zygos.arm import load_arm
from zygos.can.run import Run as RecordedRun
from zygos.can.run import find_arm, joined
from zygos.cli.estimated import finish_estimate, finish_ground, finish_payload
from zygos.cli.options import ArmFile, Details, Json, Report, Runs, cuts
from zygos.cli.shared import Wanted, check_model_name, not_whole, origin, read_runs, warn
from zygos.effects import CATALOGUE, Effect
from zygos.errors import ZygosError
from zygos.estimation.estimate import estimate
from zygos.files.output import check_outputs
from zygos.files.progress import progress
from zygos.ground.estimate import estimate_ground
from zygos.ground.payload import payload
from zygos.ground.rows import friction
from zygos.model.model import load_model
from zygos.report.provenance import Provenance, provenance

FRICTIONS = {
    "coulomb": ("motor_coulomb",),
    "viscous": ("motor_viscous",),
    "asymmetric": ("viscous_asymmetry",),
    "load": ("load_friction",),
    "gain": ("torque_gain",),
    "none": (),
}
"""What --friction can name, and the effects it stands for."""


@dataclass(frozen=True)
class GroundOptions:
    """Options that only an estimate on the ground has."""

    validate: Sequence[Path] = ()
    friction: str | None = None
    doubtful: bool = False
    since: Path | None = None
    simulation: Path | None = None
    """A file of a simulator that is to be corrected."""

    @property
    def given(self) -> list[str]:
        """The names of those that were given."""
        names = {
            "--validate": self.validate,
            "--friction": self.friction,
            "--doubtful": self.doubtful,
            "--since": self.since,
            "--simulation": self.simulation,
        }
        return [name for name, value in names.items() if value]


def estimate_runs(
    runs: Sequence[Path],
    arm_file: Path | None,
    out: Path | None,
    model_file: Path | None,
    wanted: Wanted,
    command: Sequence[str],
    flight: bool,
    ground: GroundOptions,
    energy: bool = False,
) -> None:
    """Estimate from recorded runs; see `zygos estimate --help`."""
    if ground.simulation is not None:
        _correct(runs, arm_file, out, model_file, wanted, command, flight, ground, ground.simulation)
        return
    chosen = find_arm(runs[0], arm_file)
    check_model_name(out)
    inputs = [*runs, chosen, runs[0].parent / "arm.toml", model_file, *ground.validate, ground.since]
    check_outputs([out, wanted.json, wanted.report], inputs)
    arm = load_arm(chosen)
    prior = load_model(model_file) if model_file else None
    on_ground = arm.grounded and not flight
    if on_ground and energy:
        raise ZygosError(
            f"--energy: arm {arm.name} is estimated on the ground, where nothing is refined; remedy: leave it out"
        )
    recorded = read_runs([*runs, *ground.validate], arm_file, chosen, arm, own_noise=on_ground)
    learned, checked = recorded[: len(runs)], recorded[len(runs) :]
    files = [*(("run", path) for path in runs), ("arm", chosen), *(("validated", path) for path in ground.validate)]
    files += [(role, path) for role, path in (("prior", model_file), ("since", ground.since)) if path is not None]
    source = partial(provenance, command, files)
    if on_ground and ground.since is not None:
        _payload(learned, ground, out, model_file, wanted, source)
        not_whole(*(run.damage for run in learned))
        return
    if on_ground:
        effects = None if ground.friction is None else _friction(learned[0], ground.friction)
        with progress() as bar:
            task = bar.add_task("learning", total=1.0)
            found = estimate_ground(
                learned,
                model=prior,
                effects=effects,
                validate=checked,
                doubtful=ground.doubtful,
                progress=lambda share: bar.update(task, completed=share),
            )
        finish_ground(found, out, wanted, source)
        not_whole(*(run.damage for run in recorded))
        return
    if ground.given:
        raise ZygosError(
            f"{', '.join(ground.given)}: only an estimate on the ground has this, for arms with a fixed base and rigid "
            f"joints, but arm {arm.name} {'is estimated by --flight' if arm.grounded else 'is another one'}; remedy: "
            "leave it out; `zygos predict` compares a model with another run"
        )
    run = joined(learned)
    with progress() as bar:
        task = bar.add_task("learning", total=1.0)
        answer = estimate(
            run, model=prior, progress=lambda share: bar.update(task, completed=share), trace=wanted.report is not None
        )
    best = None
    if not energy:
        from zygos.cli.best import best_of  # noqa: PLC0415  (a refinement is slow to load)

        with progress() as bar:
            task = bar.add_task("refining", total=1.0)
            best = best_of(answer, learned, prior, lambda share: bar.update(task, completed=share))
    finish_estimate(answer, out, origin(run), wanted, source, best)
    not_whole(*(one.damage for one in learned))


def _correct(
    runs: Sequence[Path],
    arm_file: Path | None,
    out: Path | None,
    model_file: Path | None,
    wanted: Wanted,
    command: Sequence[str],
    flight: bool,
    ground: GroundOptions,
    simulation: Path,
) -> None:
    """Estimate, and write the estimate into the file of a simulator."""
    from zygos.simulators.explain import estimated_in  # noqa: PLC0415  (of use here alone, and slow to load)
    from zygos.simulators.file import for_output, is_simulator_file, read_robot  # noqa: PLC0415
    from zygos.simulators.robot import at_stops  # noqa: PLC0415
    from zygos.simulators.runs import read_plain  # noqa: PLC0415

    beside = [
        name for name, value in (("--model", model_file), ("--since", ground.since), ("--flight", flight)) if value
    ]
    if beside:
        raise ZygosError(
            f"{', '.join(beside)} with --simulation: the file of the simulator is the model; remedy: leave "
            f"{'it' if len(beside) == 1 else 'them'} out"
        )
    if not is_simulator_file(simulation):
        raise ZygosError(
            f"--simulation {simulation}: is no MJCF or URDF (.xml, .mjcf, .urdf); remedy: a model of zygos is given "
            "with --model"
        )
    if out is None or not is_simulator_file(out):
        check_model_name(out)
    read = [*runs, *ground.validate]
    files = [("simulation", simulation), *(("run", path) for path in runs)]
    if (arm_file or runs[0].parent / "arm.toml").is_file():
        chosen = find_arm(runs[0], arm_file)
        files.append(("arm", chosen))
        check_outputs([out, wanted.json, wanted.report], [*read, chosen, simulation])
        arm = load_arm(chosen)
        if not arm.grounded:
            raise ZygosError(
                f"--simulation: arm {arm.name} floats or has flexible joints, and its estimate is not written into the "
                f"file of a simulator; remedy: `zygos explain --simulation {simulation}`, or leave it out, with -o "
                "MODEL.toml"
            )
        robot = read_robot(simulation, arm)
        recorded = read_runs(read, arm_file, chosen, arm, own_noise=True)
    else:
        if arm_file is not None:
            find_arm(runs[0], arm_file)
        check_outputs([out, wanted.json, wanted.report], [*read, simulation])
        robot, arm, recorded = read_plain(read, simulation)
    files += [("validated", path) for path in ground.validate]
    if out is not None and is_simulator_file(out):
        robot = for_output(robot, out)
    warn(at_stops(robot, recorded))
    learned, checked = recorded[: len(runs)], recorded[len(runs) :]
    with progress() as bar:
        task = bar.add_task("learning", total=1.0)
        found = estimate_ground(
            learned,
            model=robot.model(arm),
            effects=_friction(learned[0], ground.friction or "coulomb,viscous"),
            validate=checked,
            doubtful=ground.doubtful,
            progress=lambda share: bar.update(task, completed=share),
        )
        bar.update(task, description=f"{simulation.name} with what was found")
        own = estimated_in(robot, found, checked, Path() if out is None else out.parent)
    finish_ground(found, out, wanted, partial(provenance, command, files), own)
    not_whole(*(run.damage for run in recorded))


def _payload(
    runs: Sequence[RecordedRun],
    ground: GroundOptions,
    out: Path | None,
    model_file: Path | None,
    wanted: Wanted,
    source: Callable[[], Provenance],
) -> None:
    """Estimate the payload since a model was made."""
    beside = {
        "--validate": ground.validate,
        "--friction": ground.friction,
        "--doubtful": ground.doubtful,
        "--model": model_file,
        "--report": wanted.report,
    }
    given = [name for name, value in beside.items() if value]
    if given:
        raise ZygosError(
            f"{', '.join(given)} with --since: everything but the payload comes from the model of --since; remedy: "
            f"leave {'it' if len(given) == 1 else 'them'} out"
        )
    assert ground.since is not None
    finish_payload(payload(runs, load_model(ground.since)), out, wanted, source)


def _friction(run: RecordedRun, text: str) -> tuple[Effect, ...]:
    """The effects that --friction names. Errors: ZygosError for an unknown name, and one that is given twice."""
    found: list[Effect] = []
    names = [part.strip() for part in text.split(",")]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise ZygosError(f"--friction {text}: {name} is named twice; remedy: name it once")
        if name not in FRICTIONS:
            raise ZygosError(f"--friction {text}: there is no {name!r}; remedy: name some of {', '.join(FRICTIONS)}")
        for key in FRICTIONS[name]:
            every = friction(run.arm, [CATALOGUE[key]])
            # the gain of one joint is the unit of all others
            found += every[1:] if key == "torque_gain" else every
    return tuple(found)


@cuts
def command(
    context: typer.Context,
    run: Runs,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="MODEL.toml|NEW.xml|NEW.urdf",
            help="The model to write, or with --simulation the corrected file of the simulator. Without it "
            "none is written.",
        ),
    ] = None,
    arm: ArmFile = None,
    model: Annotated[
        Path | None,
        typer.Option(
            "--model",
            metavar="PRIOR.toml",
            help="Also estimate the effects of this model, and use its values where the run determines none.",
        ),
    ] = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            "--validate", metavar="RUN", help="Also predict this run with the estimate. May be given several times."
        ),
    ] = None,
    friction: Annotated[
        str | None,
        typer.Option(
            "--friction",
            metavar="LAWS",
            help="Laws to estimate at every joint on the ground, with commas between: coulomb, viscous, asymmetric "
            "(different in the two directions), load (in proportion to the torque), gain (of the torque sensors), "
            "none. Default: coulomb,viscous.",
        ),
    ] = None,
    doubtful: Annotated[
        bool, typer.Option("--doubtful", help="Also give values that the runs hardly determine, with their intervals.")
    ] = False,
    since: Annotated[
        Path | None,
        typer.Option(
            "--since",
            metavar="MODEL.toml",
            help="Estimate only what the last body took on since this model was made, such as a payload: its mass, "
            "first moments and inertia. Needs position_m of every joint in the arm file.",
        ),
    ] = None,
    simulation: Annotated[
        Path | None,
        typer.Option(
            "--simulation",
            metavar="ROBOT.xml|ROBOT.urdf",
            help="The MJCF or URDF of an arm on the ground, which -o CORRECTED.xml or .urdf writes with this estimate. "
            "It gives what the runs do not determine. Without an arm file, runs are tables.",
        ),
    ] = None,
    flight: Annotated[
        bool, typer.Option("--flight", help="Use the C library for flight also where the arm stands on the ground.")
    ] = False,
    energy: Annotated[
        bool, typer.Option("--energy", help="Stop at the values of the energy balance; do not refine them.")
    ] = False,
    json: Json = None,
    report: Report = None,
    details: Details = False,
) -> None:
    """Estimate the parameters from one or several runs of an arm.

    An arm that floats or has flexible joints is estimated with the C library for flight; the runs are fed to it one
    after the other. An arm on a fixed base with rigid joints is estimated on the ground, by least squares of joint
    rows, with a constant offset of each torque in each run; --flight uses the C library for it as well.

    The values of the energy balance are then refined with the equations of motion, where the arm and its effects allow
    it: states and parameters are solved from all readings at once, and come near the least standard deviations that
    any estimator can have (`zygos plan --by bound`). Such a fit cannot notice all that its model lacks. Refined values
    are therefore published only if all of this holds: the energy balance agrees; the innovations of all sensors are as
    small as expected, over the whole record and in twelve windows; the noise of the torques is not above the
    torque_relative_sigma of arm.toml; and a delay of the torques, another gain of one joint, friction or an offset
    does not follow the readings better. Otherwise the values are those of the energy balance. The answer says for each
    value which it is, and why. --energy stops before the refinement. A refinement takes at most 1 GB of memory: of
    longer runs it uses the beginning, and says so.

    Writes a model.toml with value and sigma of each parameter. A parameter that the motion does not determine is left
    out, or taken from --model. The [[effect]] entries of --model (friction, cubic stiffness, torque lag) are estimated
    as well, whatever their values; so is a spring_offset of each joint whose encoder zeros are uncertain by the arm
    file (zero_sigma_rad above 0). Exit code 3 when the estimate is doubtful or refused; where it is partial, a warning
    names what the motion does not determine. The reason is on stderr and in the JSON. If the arm changed during the
    run, a warning on stderr and the JSON state when, and in which parameters.

    The page of --report has the verdict with reason and remedy, the parameters with their intervals, the data that were
    lost or left out, and charts of the motion and of the balance.

    Example: zygos estimate out/run.blf -o out/estimate.toml

    Example: zygos estimate a/run.npz b/run.npz --validate c/run.npz -o learned.toml

    Example: zygos estimate a.npz b.npz --simulation robot.xml --validate c.npz -o corrected.xml

    Example: zygos estimate loaded/run.npz --since learned.toml -o loaded.toml
    """
    estimate_runs(
        run,
        arm,
        out,
        model,
        Wanted(json, report, details),
        context.obj or ["estimate"],
        flight,
        GroundOptions(validate or (), friction, doubtful, since, simulation),
        energy,
    )

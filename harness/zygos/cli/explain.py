# SPDX-License-Identifier: MIT
"""`zygos explain`: compares runs with a simulation, names what is missing, and writes model, report and JSON."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.arm import load_arm
from zygos.can.run import Run, check_distinct, find_arm, read_run
from zygos.cli.options import ArmFile, Details, Json, Mcap, cuts, of_runs
from zygos.cli.shared import Wanted, arm_beside, check_model_name, deliver, not_whole, save_corrected, warn
from zygos.effects import estimated, laws
from zygos.errors import Undecided, ZygosError
from zygos.files.mcap import Topic, check_mcap_name, write_mcap
from zygos.files.output import check_outputs, named, note, number
from zygos.files.progress import progress
from zygos.gap import sections
from zygos.gap.content import as_json, planned_json
from zygos.gap.explanation import Explanation
from zygos.gap.findings import undecided
from zygos.gap.ground import sections as ground_sections
from zygos.gap.ground.content import as_json as ground_json
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.predictions import run_name
from zygos.gap.record import letter
from zygos.gap.runs import check_arm_of_gap, check_keys, explain_runs, plan_next
from zygos.model.model import load_model, save_model
from zygos.native.flight import Flight
from zygos.plan.limits import Limits, limits_of
from zygos.plan.separating import Separating
from zygos.report.answer import Answer
from zygos.report.provenance import Provenance, provenance
from zygos.simulation.scenario import save_scenario
from zygos.simulators.explain import InSimulator, explained_in
from zygos.simulators.file import for_output, is_simulator_file, read_robot
from zygos.simulators.robot import Robot, at_stops
from zygos.simulators.runs import read_plain


@dataclass(frozen=True)
class Inputs:
    """The files that are read."""

    simulation: Path
    arm: Path | None
    measured: tuple[Path, ...]
    validate: tuple[Path, ...]

    @property
    def files(self) -> list[tuple[str, Path]]:
        """Their roles and paths."""
        listed = [("simulation", self.simulation), *([] if self.arm is None else [("arm", self.arm)])]
        listed += [("measured", run) for run in self.measured]
        return listed + [("validate", run) for run in self.validate]


@dataclass(frozen=True)
class Planned:
    """The motion to plan where effects cannot be told apart."""

    file: Path
    """The scenario to write."""
    limits: tuple[str | None, str | None, str | None]
    """Of angle, rate and torque, as `zygos plan` takes them."""


def explain_run(
    simulation: Path,
    measured: Sequence[Path],
    validate: Sequence[Path],
    arm_file: Path | None,
    out: Path | None,
    wanted: Wanted,
    command: Sequence[str],
    effects: Sequence[Path] = (),
    without: Sequence[str] = (),
    planned: Planned | None = None,
) -> None:
    """Explain the gap between a simulation and measured runs; see `zygos explain --help`."""
    check_mcap_name(wanted.mcap)
    if wanted.mcap and len(measured) > 1 and not validate:
        raise ZygosError(
            f"{wanted.mcap}: the signals are those of an untouched run; remedy: keep one apart with --validate"
        )
    with laws(*effects):
        check_keys(without)
        _explain_run(simulation, measured, validate, arm_file, out, wanted, command, without, planned)


def _explain_run(
    simulation: Path,
    measured: Sequence[Path],
    validate: Sequence[Path],
    arm_file: Path | None,
    out: Path | None,
    wanted: Wanted,
    command: Sequence[str],
    without: Sequence[str],
    planned: Planned | None,
) -> None:
    if is_simulator_file(simulation) and not (arm_file or measured[0].parent / "arm.toml").is_file():
        _without_arm_file(simulation, measured, validate, arm_file, out, wanted, command, without, planned)
        return
    chosen = find_arm(measured[0], arm_file)
    inputs = Inputs(simulation, chosen, tuple(measured), tuple(validate))
    runs = [run for role, run in inputs.files if role in {"measured", "validate"}]
    check_new_name(out, simulation)
    if planned is not None:
        check_model_name(planned.file)
    check_outputs(
        [out, wanted.report, wanted.json, wanted.mcap, planned.file if planned is not None else None],
        [path for _, path in inputs.files],
    )
    arm = load_arm(chosen)
    for run in runs:
        arm_beside(run, arm_file, chosen, arm)
    robot = read_robot(simulation, arm) if is_simulator_file(simulation) else None
    model = load_model(simulation) if simulation.suffix == ".toml" else None if robot is None else robot.model(arm)
    if robot is not None:
        robot = _for_output(robot, out, planned)
    elif model is None and planned is not None:
        raise ZygosError(
            f"--next-motion: a scenario needs the file of a model, and {simulation} is a run; remedy: "
            f"`zygos estimate {simulation} -o MODEL.toml`, and MODEL.toml as --simulation"
        )
    limits = limits_of(arm, *(planned.limits if planned is not None else (None, None, None)))
    if not arm.grounded:
        check_arm_of_gap(arm, str(chosen))
        if wanted.mcap:
            raise ZygosError(
                f"{wanted.mcap}: only arms on the ground have predicted torques to draw, and {arm.name} floats or has "
                "flexible joints; remedy: leave out --mcap, and draw the gap with --report"
            )
    if model is not None:
        model.base_parameters(arm)
    with progress() as bar:
        task = bar.add_task("reading", total=1.0)
        logs: list[Run] = []
        for k, run in enumerate(runs):
            bar.update(task, description=f"reading {run.name}", completed=0.2 * k / len(runs))
            logs.append(read_run(run, arm))
            warn((*logs[-1].remarks, *logs[-1].damage))
            check_distinct(logs[-1], logs[:-1])
        found = explain_runs(
            read_run(simulation, arm) if model is None else model,
            logs[: len(measured)],
            validate=logs[len(measured) :],
            without=without,
            progress=lambda share, what: bar.update(task, description=what, completed=0.2 + 0.8 * share),
        )
        if robot is not None:
            warn(at_stops(robot, logs))
        own = None
        if robot is not None:
            bar.update(task, description=f"{simulation.name} with what was found")
            own = explained_in(robot, found, Path() if out is None else out.parent)
        motion = None
        if planned is not None and undecided(found.findings):
            bar.update(task, description="the next motion")
            motion = _next(found, planned, limits, inputs)
    said = [] if planned is None else [_planned(found, planned, motion)]
    finish(found, logs, inputs, partial(provenance, command, inputs.files), out, wanted, said, motion, own)
    not_whole(*(log.damage for log in logs))


def check_new_name(out: Path | None, simulation: Path) -> None:
    """Refuse a name of what is to be written that is no model's, and, where the simulation is a file of a simulator, no
    such file's either."""
    if out is not None and not (is_simulator_file(simulation) and is_simulator_file(out)):
        check_model_name(out)


def _for_output(robot: Robot, out: Path | None, planned: Planned | None) -> Robot:
    if planned is not None:
        raise ZygosError(
            f"--next-motion: a scenario needs the file of a model, and {robot.path} is one of a simulator; remedy: "
            "leave it out, or write the model first (-o MODEL.toml)"
        )
    return robot if out is None or not is_simulator_file(out) else for_output(robot, out)


def _without_arm_file(
    simulation: Path,
    measured: Sequence[Path],
    validate: Sequence[Path],
    arm_file: Path | None,
    out: Path | None,
    wanted: Wanted,
    command: Sequence[str],
    without: Sequence[str],
    planned: Planned | None,
) -> None:
    """The runs are plain tables, and the arm is that of the file of the simulator."""
    if arm_file is not None:
        find_arm(measured[0], arm_file)
    inputs = Inputs(simulation, None, tuple(measured), tuple(validate))
    check_new_name(out, simulation)
    check_outputs([out, wanted.report, wanted.json, wanted.mcap], [path for _, path in inputs.files])
    robot, arm, runs = read_plain([*measured, *validate], simulation)
    robot = _for_output(robot, out, planned)
    warn(at_stops(robot, runs))
    with progress() as bar:
        task = bar.add_task("reading", total=1.0)
        found = explain_runs(
            robot.model(arm),
            runs[: len(measured)],
            validate=runs[len(measured) :],
            without=without,
            progress=lambda share, what: bar.update(task, description=what, completed=share),
        )
        assert isinstance(found, GroundExplanation), "files of simulators are of arms on the ground"
        bar.update(task, description=f"{simulation.name} with what was found")
        own = explained_in(robot, found, Path() if out is None else out.parent)
    text = f"no arm file: the arm is that of {simulation.name}, with torques at the joints that are sampled"
    finish(found, runs, inputs, partial(provenance, command, inputs.files), out, wanted, [text], None, own)


def _next(
    found: Explanation | GroundExplanation, planned: Planned, limits: Limits, inputs: Inputs
) -> Separating | None:
    """Plan the next motion and write its scenario; None, with a warning, where no motion tells the effects apart."""
    assert inputs.arm is not None, "a motion is planned for a model of zygos, whose arm has a file"
    try:
        motion = plan_next(found, limits, inputs.arm, inputs.simulation, name=planned.file.stem)
    except Undecided as error:
        warn([f"{planned.file} not written: {error}"])
        return None
    save_scenario(motion.scenario, planned.file)
    return motion


def _planned(found: Explanation | GroundExplanation, planned: Planned, motion: Separating | None) -> str:
    """What became of the next motion."""
    if motion is not None:
        return (
            f"{planned.file}: written, {motion.scenario.duration_s:g} s, {motion.form}; after one run the effects are "
            f"expected to be {motion.z:.3g} standard deviations apart"
        )
    if undecided(found.findings):
        return f"{planned.file}: not written"
    return f"{planned.file}: not written; the answer is {found.answer!r}, and no effects have to be told apart"


def unflown(found: Explanation) -> list[str]:
    """Columns of effects in the model to adopt that the flight library lacks."""
    effects = () if found.model is None else found.model.effects
    return [effect.column(found.arm) for effect in effects if not effect.kind.flies]


def flown(found: Explanation | GroundExplanation, logs: Sequence[Run]) -> list[dict[str, Any]]:
    """Estimates of the flight library from the same runs, with the columns of the findings switched on. None where it
    lacks a column, because its estimate would be biased."""
    if isinstance(found, GroundExplanation) or unflown(found):
        return []
    columns = [] if found.model is None else list(estimated(found.arm, found.model.effects))
    names = {effect.column(found.arm) for effect in columns if effect.source == "zygos"}
    if not names:
        return []
    out = []
    for run, log in enumerate(logs):
        flight = Flight(found.arm, columns)
        if log.frames is None:
            flight.cycles(log.cycles)
        else:
            flight.frames(log.frames)
        result = flight.estimate()
        out += [
            {
                "run": letter(run),
                "column": name,
                "unit": unit,
                "value": float(result.value[i]),
                "sigma": float(result.sigma[i]),
                "half95": float(result.half95[i]),
            }
            for i, (name, unit) in enumerate(zip(result.names, result.units, strict=True))
            if name in names
        ]
    return out


def beside(found: Explanation | GroundExplanation, flight: Sequence[dict[str, Any]]) -> list[str]:
    """What the flight library says of the effects that were found, in words."""
    if isinstance(found, GroundExplanation):
        return []
    lacking = unflown(found)
    out = [f"the flight library has no column for {', '.join(lacking)}: not estimated on board"] if lacking else []
    for column in dict.fromkeys(str(entry["column"]) for entry in flight):
        each = [
            f"{number(e['value'], 4)} ± {number(e['half95'], 2)} {e['unit']} on run {e['run']}"
            if np.isfinite(e["value"])
            else f"no value on run {e['run']}"
            for e in flight
            if e["column"] == column
        ]
        out.append(f"estimate of the flight library: {column} = {', '.join(each)}")
    return out


def drawn(found: GroundExplanation) -> list[Topic]:
    """Motion and torques of the untouched runs: measured, as the simulation was delivered, and with what was found.
    Each predicted torque has the constant offset that it leaves."""
    topics = []
    for one in () if found.gap is None else found.gap.predictions:
        kept = one.rows.kept
        name = re.sub(r"\W", "_", run_name(one.run))
        names = tuple(joint.name for joint in one.run.arm.joints)
        torques = {"measured": one.rows.tau[kept]}
        for which, score in (("simulated", one.delivered), ("corrected", one.closed)):
            offset = np.nan_to_num([joint.offset_nm for joint in score.joints])
            torques[which] = score.predicted + offset
        for which, effort in torques.items():
            place = f"/{name}/{which}/joint_states"
            topics.append(Topic(place, names, one.closed.t, one.rows.state.q[kept], one.rows.state.qd[kept], effort))
    return topics


def finish(
    found: Explanation | GroundExplanation,
    logs: Sequence[Run],
    inputs: Inputs,
    source: Callable[[], Provenance],
    out: Path | None,
    wanted: Wanted,
    said: Sequence[str],
    motion: Separating | None,
    own: InSimulator | None = None,
) -> None:
    """Deliver the answer, and raise Undecided if no model is written. said: what became of the next motion. own: the
    corrected file of the simulator."""
    flight = flown(found, logs[: len(inputs.measured)])
    remarks = [*beside(found, flight), *said]
    damage = [text for log in logs for text in log.damage]
    model = found.model

    def answer(draw: bool) -> Answer:
        if isinstance(found, GroundExplanation):
            whole = ground_sections.answer_of(found, planned=motion, beside=remarks, draw=draw)
        else:
            whole = sections.answer_of(found, planned=motion, beside=remarks, draw=draw)
        return whole if own is None else own.beside(whole)

    def content() -> dict[str, Any]:
        known = ground_json(found, source()) if isinstance(found, GroundExplanation) else as_json(found, source())
        known["simulator"] = None if own is None else own.as_json()
        return {**known, "next_motion": planned_json(motion), "flight": flight, "damage": damage or None}

    def save() -> None:
        assert model is not None
        assert out is not None
        if own is None or not is_simulator_file(out):
            save_model(model, out)
            return
        save_corrected(own, out)

    if wanted.mcap and isinstance(found, GroundExplanation):
        write_mcap(wanted.mcap, drawn(found), {"effort": found.arm.unit("Nm")})
    deliver(wanted, answer, content, source, out, save=None if model is None or out is None else save)
    if model is None:
        missing = "no model" if out is None else f"{named(out)} not written"
        raise Undecided(f"{found.answer}: {found.sentence} ({missing}); remedy: {found.remedy}")


@cuts
def command(
    context: typer.Context,
    run: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="RUN...",
            help="Runs to learn from: two or more, because a result from one must hold on the others. A single run is "
            "cut into thirds, of which the last is kept apart.",
            callback=of_runs,
        ),
    ] = None,
    simulation: Annotated[
        Path | None,
        typer.Option(
            "--simulation",
            metavar="CAD.toml|ROBOT.xml|ROBOT.urdf|RUN",
            help="The model that the simulation uses; the MJCF of the arm, or its URDF where it is on the ground with "
            "rigid joints; or a run that another simulator made from the torques of a measured run. Required.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="NEW.toml|NEW.xml|NEW.urdf",
            help="The model to write, or the corrected file of the simulator. Without it none is written.",
        ),
    ] = None,
    measured: Annotated[
        list[Path] | None, typer.Option("--measured", metavar="RUN...", help="Former place of the runs.", hidden=True)
    ] = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option(
            "--validate", metavar="RUN...", help="Runs that are not used for estimation; the gap is measured on them."
        ),
    ] = None,
    arm: ArmFile = None,
    effects: Annotated[
        list[Path] | None,
        typer.Option(
            "--effects",
            metavar="LAWS.py",
            help="Also try the effects that this Python file defines (docs/gap.md has an example of ten lines).",
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option("--without", metavar="KIND...", help="Do not try these entries of the catalogue."),
    ] = None,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="GAP.html", help="Also write a report, one HTML page.")
    ] = None,
    json: Json = None,
    mcap: Mcap = None,
    next_motion: Annotated[
        Path | None,
        typer.Option(
            "--next-motion",
            metavar="NEXT.toml",
            help="If the runs cannot tell effects apart, plan the motion that tells them apart best, and write it as "
            "a scenario for `zygos simulate`.",
        ),
    ] = None,
    angle: Annotated[
        str | None,
        typer.Option(
            metavar="RAD",
            help="Range of the angles of the next motion, as of `zygos plan`. Default: what the measured runs reached.",
        ),
    ] = None,
    rate: Annotated[str | None, typer.Option(metavar="RAD/S", help="Its largest rate. Default: likewise.")] = None,
    torque: Annotated[str | None, typer.Option(metavar="NM", help="Its largest torque. Default: likewise.")] = None,
    details: Details = False,
) -> None:
    """Find where simulation and measurement disagree, name the missing effect, add it, and show how the gap shrinks.

    Balances of energy, motor impulse and momentum are computed on cycles that the C library decoded, and compared with
    those of a simulation of the same run. The answer is one of: values differ, named, part named, changed, plain
    estimate, cannot tell these apart, nothing missing above the detection limits, unknown. A named effect is added to
    NEW.toml with value, interval and evidence. The gap is the error of predictions half a second ahead on the runs of
    --validate, in units of the sensors' noise: with the model as delivered, refit, closed (with the named effects), and
    the floor, which is caused by noise alone. "part named" is the answer where the closed model still predicts much
    worse than that floor.

    With --next-motion a set of effects that cannot be told apart comes with a scenario that tells them apart.

    A model is written only if an arm can have it and it predicts the runs of --validate no worse than the model as
    delivered, the refit, and the estimate of `zygos estimate`; otherwise this estimate is the answer. Exit code 3 when
    NEW.toml is not written, because nothing is decided.

    With the MJCF or URDF of a simulator as --simulation, -o NEW.xml or NEW.urdf writes that file with the inertials,
    armatures, friction, damping and springs that were found; every other byte stays as it is. NEW.xml from a URDF is a
    new MJCF. The gap is measured in MuJoCo as well. Without an arm file, runs are tables of t, q1 .. qN and
    tau1 .. tauN at the joints (docs/simulators.md).

    Example: zygos explain A.blf B.blf --simulation examples/gap/cad.toml --validate C.blf -o out/new.toml
    """
    asked, limits = context.obj or ["explain"], (angle, rate, torque)
    if measured:
        note("zygos: --measured goes in the next version: runs come first, `zygos explain RUN...`")
    runs = [*(run or ()), *(measured or ())]
    if not runs:
        raise ZygosError("there is no run to explain; remedy: `zygos explain RUN... --simulation MODEL.toml`")
    if simulation is None:
        raise ZygosError("there is no simulation to compare with; remedy: add --simulation and the model or its run")
    if next_motion is None and any(limits):
        raise ZygosError(
            "--angle, --rate and --torque are limits of a motion that is planned; remedy: give --next-motion, too"
        )
    planned = None if next_motion is None else Planned(next_motion, limits)
    explain_run(
        simulation,
        runs,
        validate or (),
        arm,
        out,
        Wanted(json, report, details, mcap),
        asked,
        effects or (),
        without or (),
        planned,
    )

# SPDX-License-Identifier: MIT
"""From an explanation to the file of the simulator: corrected, measured in that simulator, and written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from zygos import limits
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.errors import Undecided, ZygosError
from zygos.files.output import number, write_text
from zygos.gap.explanation import Explanation
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.predictions import Prediction, Stage, predict, run_name
from zygos.gap.record import MeasuredRun
from zygos.gap.runs import explain_runs
from zygos.gap.study import split
from zygos.ground.estimate import GroundEstimate, complete
from zygos.ground.motion import Motion, TorqueRows, cutoff_hz, torque_rows
from zygos.model.model import Model
from zygos.report.answer import Answer, Items, Section, Text, section, table
from zygos.simulators.correct import Corrected, corrected
from zygos.simulators.file import contents, for_output, read_robot, simulator, write
from zygos.simulators.held import in_snippet, snippet
from zygos.simulators.measure import Simulated, floor_of, simulated
from zygos.simulators.robot import Robot, at_stops


@dataclass(frozen=True)
class Measured:
    """A model of the answer, as the file holds it, in the simulator."""

    name: str
    runs: tuple[Simulated, ...]
    """One for each untouched run."""


@dataclass(frozen=True, eq=False)
class InSimulator:
    """A file of a simulator with what was learned."""

    robot: Robot
    """As delivered."""
    arm: Arm
    corrected: Corrected
    measured: tuple[Measured, ...]
    """As delivered, refit and corrected; empty where no run was kept apart."""
    runs: tuple[str, ...]
    """Names of the untouched runs."""
    stops: tuple[str, ...] = ()
    """Which joints reach a stop of the file."""
    integrator: str = ""
    """Of the file, with its time step; empty where no run was kept apart."""

    @property
    def good(self) -> bool:
        """Whether the simulator predicts the untouched runs as zygos does with what the file holds."""
        return all(one.good for one in self.measured[-1].runs) if self.measured else True

    def check(self, out: Path) -> None:
        """Refuse, with Undecided, to write a file that does not do what was found."""
        if not self.good:
            worst = max((one for one in self.measured[-1].runs if not one.good), key=lambda one: one.ratio)
            raise Undecided(
                f"{out} not written: in MuJoCo it leaves {number(worst.ratio, 3)} times the error of zygos' own "
                f"equations, and may leave {limits.NOT_WORSE.value:g} times, or what noise alone leaves of the work, "
                f"{number(100.0 * worst.floor, 2)} %, more; remedy: a model of zygos as output (-o MODEL.toml), and a "
                "smaller time constant of friction (solreffriction) in the simulator"
            )

    def contents(self, out: Path) -> dict[Path, bytes]:
        """What is to be written, by path."""
        return contents(self.robot, self.corrected.robot, out)

    def save(self, out: Path) -> tuple[Path, ...]:
        """Write the corrected file, those that it includes and that change, and the snippet; their paths. Errors: as
        `check`."""
        self.check(out)
        files = self.contents(out)
        write(files)
        if not in_snippet(self.corrected.lost):
            return tuple(files)
        beside = out.with_name(f"{out.stem}_torques.py")
        write_text(beside, snippet(self.arm, self.corrected.lost))
        return (*files, beside)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the file cannot hold, and what was not used of it, in sentences."""
        out = [*self.robot.notes, *self.stops]
        told = in_snippet(self.corrected.lost)
        for one in self.corrected.lost:
            where = f" ({one.joint})" if one.joint else ""
            end = "it is in the snippet" if one in told else "it is no part of a robot"
            out.append(f"{one.kind.title}{where} has no place in {self.robot.format}: {end}")
        rotors = [p.name for p in self.arm.parameters if p.symbol == "Im"]
        if self.robot.format == "URDF" and rotors:
            out.append(f"a URDF holds no rotor ({', '.join(rotors)}): the links take its place as far as they can")
        if self.arm.torque_at == "joint" and self.robot.format == "MJCF":
            out.append("the torques are measured behind the gears, so that the armatures of the file stay as they are")
        if self.corrected.left > limits.MATERIAL_DIFFERENCE.value:
            out.append(
                f"possible bodies come as near as {number(100.0 * self.corrected.left, 2)} % of "
                f"{'the torques' if self.arm.grounded else 'these'} to the parameters that were found"
            )
        return tuple(out)

    @property
    def sentence(self) -> str:
        """The errors in MuJoCo in a line; empty without an untouched run."""
        each = [
            f"{run} "
            + " → ".join(number(100.0 * one.runs[k].energy, 3) for one in self.measured)
            + f" (zygos {number(100.0 * self.measured[-1].runs[k].own, 3)})"
            for k, run in enumerate(self.runs)
        ]
        stages = " → ".join(one.name for one in self.measured)
        return f"in MuJoCo, work predicted wrongly, %, {stages}: {', '.join(each)}" if each else ""

    def section(self) -> Section | None:
        """The section of the answer."""
        rows = [
            (
                one.name,
                run,
                number(100.0 * each.energy, 3),
                number(100.0 * each.own, 3),
                number(100.0 * each.forward, 3),
            )
            for k, run in enumerate(self.runs)
            for one, each in ((one, one.runs[k]) for one in self.measured)
        ]
        return section(
            "simulator",
            "In MuJoCo",
            Text(
                f"{self.robot.path.name} on the untouched runs: the share of the work of the motors in one second that "
                "is predicted wrongly, from the torques of `mj_inverse` on the same filtered motion, beside that of "
                "zygos' own equations with what the file holds. Forward: error of the angles half a second after the "
                f"measured torques began to act, with the integrator of the file ({self.integrator}), as share of the "
                "way of the joints."
            ),
            table("model | run::text | MuJoCo, %::main | zygos, % | forward, %", rows),
            Items(self.notes) if self.notes else None,
        )

    def beside(self, answer: Answer) -> Answer:
        """An answer with the section about the simulator, behind that of the gap."""
        own = self.section()
        if own is None:
            return answer
        keys = [one.key for one in answer.sections]
        at = keys.index("gap") + 1 if "gap" in keys else len(keys)
        brief = (*answer.brief, *([self.sentence] if self.sentence else []))
        return replace(answer, sections=(*answer.sections[:at], own, *answer.sections[at:]), brief=brief)

    def as_json(self) -> dict[str, Any]:
        """The entry of the JSON."""
        return {
            "file": str(self.robot.path),
            "format": self.robot.format,
            "good": self.good,
            "integrator": self.integrator or None,
            "runs": [
                {
                    "run": run,
                    "floor": self.measured[-1].runs[k].floor,
                    **{
                        one.name.replace(" ", "_"): {
                            "energy": one.runs[k].energy,
                            "own": one.runs[k].own,
                            "forward": one.runs[k].forward,
                        }
                        for one in self.measured
                    },
                }
                for k, run in enumerate(self.runs)
            ],
            "lost": [one.column(self.arm) for one in self.corrected.lost],
            "notes": list(self.notes),
        }


def rows_of(runs: Sequence[Run]) -> list[TorqueRows]:
    """Torque rows of runs, as predictions have them. Errors: ZygosError for a run that is too short."""
    out = []
    for run in runs:
        motion = Motion.of(run)
        out.append(torque_rows(motion.arm, motion.samples, min(cutoff_hz(run.arm), limits.HIGHEST_CUTOFF_HZ.value)))
    return out


def in_simulator(
    robot: Robot,
    arm: Arm,
    model: Model,
    runs: Sequence[Run | MeasuredRun],
    predictions: Sequence[Prediction | MeasuredRun] = (),
    refit: Stage | None = None,
    folder: Path | None = None,
) -> InSimulator:
    """The file with the values of a model, measured in MuJoCo on untouched runs.

    runs: from which the model was learned. predictions: of the untouched runs; of an arm that floats or has flexible
    joints, these runs. folder: where the corrected file will be.

    Errors: ZygosError where MuJoCo is not installed or rejects the file.
    """
    rows = rows_of([run for run in runs if isinstance(run, Run)])
    rows += [one.rows for one in predictions if isinstance(one, Prediction)]
    found = corrected(robot, arm, Stage.of("corrected", model, arm), rows)
    measured, integrator = [], ""
    untouched = [one.run if isinstance(one, Prediction) else one for one in predictions]
    if predictions:
        stages: list[tuple[Robot | None, Stage]] = [(None, Stage.of("as delivered", robot.model(arm), arm))]
        if refit is not None:
            by_refit = corrected(robot, arm, refit, rows)
            stages.append((by_refit.robot, by_refit.stage("refit")))
        stages.append((found.robot, found.stage("corrected")))
        floors = [floor_of(one, stages[-1][1]) for one in predictions]
        for changed, stage in stages:
            own = simulator(robot, arm, changed, folder)
            integrator = own.integrator
            runs_of = zip(predictions, floors, strict=True)
            measured.append(Measured(stage.name, tuple(simulated(own, one, stage, least) for one, least in runs_of)))
    stops = tuple(at_stops(robot, [*runs, *untouched]))
    return InSimulator(robot, arm, found, tuple(measured), tuple(map(run_name, untouched)), stops, integrator)


def explained_in(
    robot: Robot, found: GroundExplanation | Explanation, folder: Path | None = None
) -> InSimulator | None:
    """The file with the model of an explanation; None where there is none. Errors: as `in_simulator`."""
    if found.model is None:
        return None
    if isinstance(found, Explanation):
        refit = found.refit
        values, effects = split(refit.hypothesis, refit.value)
        stage = Stage("refit", values, tuple(effects)) if refit.physical else None
        return in_simulator(robot, found.arm, found.model, refit.records, found.validated, stage, folder)
    gap = found.gap
    return in_simulator(
        robot,
        found.arm,
        found.model,
        found.measured,
        () if gap is None else gap.predictions,
        None if gap is None else gap.stages[1],
        folder,
    )


def estimated_in(
    robot: Robot, found: GroundEstimate, untouched: Sequence[Run], folder: Path | None = None
) -> InSimulator | None:
    """The file with the model of an estimate, and with its own values where the runs determine none; None where the
    estimate is refused. Errors: as `in_simulator`."""
    if found.validity == "refused":
        return None
    model = complete(found.to_model(), found.arm)
    stages = Stage.of("as delivered", robot.model(found.arm), found.arm), Stage.of("estimate", model, found.arm)
    predictions = [predict(run, stages[0], *stages) for run in untouched]
    return in_simulator(robot, found.arm, model, found.runs, predictions, None, folder)


@dataclass(frozen=True, eq=False)
class FileExplanation:
    """An explanation whose simulation is a file of a simulator."""

    found: GroundExplanation | Explanation
    """The explanation itself: answer, findings, model, gap."""
    robot: Robot

    @property
    def answer(self) -> str:
        """The kind of verdict."""
        return self.found.answer

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return self.found.sentence

    @cached_property
    def simulator(self) -> InSimulator:
        """The corrected file, measured. Errors: Undecided where no model is to be written."""
        return self._measured(self.robot)

    @cached_property
    def _translated(self) -> InSimulator:
        """The MJCF of a URDF, measured, wherever it is written."""
        return self._measured(for_output(self.robot, self.robot.path.with_name("corrected.xml")))

    def _measured(self, robot: Robot) -> InSimulator:
        own = explained_in(robot, self.found)
        if own is None:
            raise Undecided(f"{self.found.answer}: {self.found.sentence}; remedy: {self.found.remedy}")
        return own

    def written_as(self, out: Path) -> InSimulator:
        """The corrected file in the format of a name, measured. Errors: as `to_mjcf`."""
        robot = for_output(self.robot, out)
        return replace(self._translated, robot=robot) if robot.translated else self.simulator

    def to_mjcf(self) -> str:
        """The text of the corrected MJCF, beside the file that was read; also of a URDF. Errors: Undecided where no
        model is to be written; ZygosError where an included file changes, which `save` writes as well."""
        out = self.robot.path.with_name("corrected.xml")
        own = self.written_as(out)
        own.check(out)
        files = own.contents(out)
        if len(files) > 1:
            raise ZygosError(f"{self.robot.path}: files that it includes change as well; remedy: save('corrected.xml')")
        return files[out].decode()

    def save(self, out: str | Path) -> tuple[Path, ...]:
        """Write the corrected file, and what goes with it; their paths. Errors: as `to_mjcf`, and ZygosError for a name
        or a folder in which it would not be found."""
        place = Path(out)
        return self.written_as(place).save(place)


def explain(
    simulation: Model | Run | str | Path,
    measured: Sequence[Run],
    *,
    validate: Run | Sequence[Run] | None = None,
    without: Sequence[str] = (),
    progress: Any = None,
) -> Explanation | GroundExplanation | FileExplanation:
    """Say where a simulation and the measured runs of an arm disagree, and which effect the simulation lacks.

    simulation: the model that the simulation uses; or a run that another simulator made from the torques of a measured
    run, from which its model is estimated first; or the path of an MJCF or URDF, which the answer can write corrected.
    measured: runs of one arm; what is learned from one must hold on the others. A single run is cut into thirds, of
    which the last is kept apart. validate: runs from which nothing is learned; the gap is measured on them, before and
    after. without: keys of effects that are not tried. progress is called with the share that is done and what is
    being done.

    `Explanation.answer` is "values differ", "named", "part named", "changed", "plain estimate", "cannot tell", "nothing
    missing" or "unknown"; `sentence` says it in words, and `findings` has the effects with value and interval. `model`
    is the one with what was learned, or that of `zygos estimate` where this one does not pass the checks of
    `zygos.gap.adopted`, or None.

    Errors: ZygosError for runs of different arms or that are the same recording, for a model or a file that does not
    fit, and for an arm that floats or is flexible and whose torques are currents; Undecided where the runs do not tell
    the parameters apart.
    """
    if isinstance(simulation, Model | Run):
        return explain_runs(simulation, measured, validate=validate, without=without, progress=progress)
    if not measured:
        raise ZygosError("no measured run; remedy: one run, or better two to learn from and a third to validate")
    arm = measured[0].arm
    robot = read_robot(Path(simulation), arm)
    found = explain_runs(robot.model(arm), measured, validate=validate, without=without, progress=progress)
    return FileExplanation(found, robot)

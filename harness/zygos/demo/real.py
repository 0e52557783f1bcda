# SPDX-License-Identifier: MIT
"""`python -m zygos.demo.real`, used by `make real`: measured runs of real arms, from CAN logs to a validated model.

The recordings of examples/pendulum are converted, three of them are learned from, and two are predicted. Batch least
squares on filtered accelerations and the model that was published with the recordings are compared with the same runs
after the estimate has been made.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from zygos.accuracy.idim import idim
from zygos.arm import load_arm
from zygos.can.run import Run
from zygos.demo.gap_picture import write_picture
from zygos.demo.kr300 import SOURCE, Skew, audit_kr300
from zygos.errors import Undecided, ZygosError
from zygos.files.output import check_outputs, errors_end_the_program, number, say, write_json
from zygos.files.output import table as show_table
from zygos.files.progress import progress
from zygos.gap.ground.explain import explain_ground
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.predictions import run_name
from zygos.gap.ground.sections import answer_of
from zygos.ground.estimate import GroundEstimate, estimate_ground
from zygos.ground.score import Score, beside, score
from zygos.ground.sections import estimate_answer
from zygos.model.model import load_model, save_model
from zygos.report.answer import Answer, Row, Text, section, sections, table
from zygos.report.figures import unit_of
from zygos.report.html import write_page
from zygos.report.page import joint_colour
from zygos.report.provenance import provenance
from zygos.runs.tables import read_cycles
from zygos.simulators.explain import FileExplanation, InSimulator
from zygos.simulators.file import read_robot

EXAMPLE = Path("examples/pendulum")
LEARNED = ("00", "01", "02")
"""Recordings that are learned from."""
LIMITS = {"03": (0.27, 0.20), "11": (0.70, 0.14)}
"""Recordings that are predicted, and the largest share of the torque of each joint that may be left."""
BATCH_LIMIT = 1.05
"""Largest error in units of that of batch least squares."""


@dataclass(frozen=True)
class HeldOut:
    """The error of the predicted torque of one joint in one recording, as share of the measured torque. A constant
    offset of the torque in the recording is left out of both."""

    recording: str
    joint: str
    zygos: float
    batch: float
    """Of batch least squares with the same terms."""
    published: float
    """Of the published model."""
    limit: float
    with_offset: float
    """That of zygos with the offset of the recording in it."""

    @property
    def good(self) -> bool:
        """Whether it is within the limits."""
        return self.zygos <= self.limit and self.zygos <= BATCH_LIMIT * self.batch


@dataclass(frozen=True)
class Value:
    """A learned parameter beside the published one."""

    name: str
    stands_for: str
    unit: str
    value: float
    half95: float
    batch: float
    published: float


@dataclass(frozen=True)
class Real:
    """What the recordings of real arms say."""

    found: GroundEstimate
    held_out: tuple[HeldOut, ...]
    values: tuple[Value, ...]
    skews: tuple[Skew, ...] | None
    """None: the run of the KR300 is not there."""

    @property
    def good(self) -> bool:
        """Whether all errors are within their limits."""
        return all(one.good for one in self.held_out)

    def as_dict(self) -> dict[str, Any]:
        """What the JSON file has."""
        return {
            "validity": self.found.validity,
            "reason": self.found.reason or None,
            "good": self.good,
            "held_out": [{**asdict(one), "good": one.good} for one in self.held_out],
            "values": [asdict(one) for one in self.values],
            "kr300": None if self.skews is None else [asdict(one) for one in self.skews],
        }


def converted(name: str, folder: Path, example: Path = EXAMPLE) -> Run:
    """A recording as a run, converted by `zygos convert` into a folder of its own. Errors: ZygosError if it fails."""
    out = folder / name / "run.npz"
    out.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "zygos.cli", "convert", str(example / f"{name}.blf")]
    command += ["--dbc", str(example / "arm.dbc"), "--map", str(example / "map.toml"), "-o", str(out)]
    ended = subprocess.run(command, check=False, capture_output=True, text=True)
    if ended.returncode != 0:
        raise ZygosError(f"`zygos convert` failed: {ended.stderr.strip()}; remedy: see its message")
    arm = load_arm(out.parent / "arm.toml")
    return Run(arm, table=read_cycles(out, arm), path=out)


def learn_pendulum(folder: Path, example: Path = EXAMPLE) -> tuple[GroundEstimate, list[Run]]:
    """Convert the recordings, estimate, and write the model; also the runs that were learned from."""
    names = [*LEARNED, *LIMITS]
    with progress() as bar:
        task = bar.add_task("converting", total=len(names) + 2.0)
        runs = {}
        for name in names:
            bar.update(task, description=f"converting {name}.blf")
            runs[name] = converted(name, folder, example)
            bar.advance(task)
        bar.update(task, description="estimating")
        learned = [runs[name] for name in LEARNED]
        found = estimate_ground(
            learned,
            validate=[runs[name] for name in LIMITS],
            progress=lambda share: bar.update(task, completed=len(names) + 2.0 * share),
        )
    save_model(found.to_model(), folder / "learned.toml")
    return found, learned


def compared(found: GroundEstimate, learned: Sequence[Run], example: Path = EXAMPLE) -> Real:
    """The estimate beside batch least squares and beside the published model."""
    published = load_model(example / "published.toml")
    cutoff = found.validated[0].cutoff_hz
    assert cutoff is not None  # the arm is on the ground
    batch = idim(learned, found.effects, cutoff)
    held_out = []
    for (name, limits), own in zip(LIMITS.items(), found.validated, strict=True):
        theirs: tuple[Score, Score] = (beside(batch.score(own.run), own), beside(score(own.run, published), own))
        for joint, limit, by_batch, by_published in zip(
            own.joints, limits, theirs[0].joints, theirs[1].joints, strict=True
        ):
            shares = (joint.share, by_batch.share, by_published.share)
            held_out.append(HeldOut(name, joint.joint, *shares, limit, joint.raw_share))
    arm = found.arm
    known = dict(zip(arm.parameter_names, published.base_values(arm).tolist(), strict=True))
    known |= {effect.column(arm): effect.value for effect in published.effects}
    said = dict(zip(arm.parameter_names, arm.structure.grouping, strict=True))
    values = tuple(
        Value(name, said.get(name, name), unit, float(x), float(half), float(other), known.get(name, float("nan")))
        for name, unit, x, half, other in zip(
            found.names, found.units, found.value, found.half95, batch.value, strict=True
        )
    )
    return Real(found, tuple(held_out), values, None)


def audited(source: Path, folder: Path) -> tuple[Skew, ...] | None:
    """The audit of the KR300; None where its run is not there. Errors: ZygosError if it is not there and CI is set."""
    if source.is_file():
        return audit_kr300(source, folder)
    if os.environ.get("CI"):
        raise ZygosError(f"{source}: missing in CI; remedy: put the run of the KR300 there (docs/check-arm.md)")
    return None


def real_answer(real: Real, *, draw: bool = False) -> Answer:
    """The answer of the estimate, with what stands beside it. draw: with charts."""
    colours = {joint.name: joint_colour(j) for j, joint in enumerate(real.found.arm.joints)}
    held_out = section(
        "compared",
        "Torques that are not predicted",
        Text(
            "The part of the measured torque, in per cent, that each model leaves in recordings that nothing was "
            "learned from, without a constant offset of the torque in the recording. Batch least squares has the "
            "same terms, on filtered accelerations. The published model comes from those who recorded the runs. The "
            f"largest ratio to batch least squares that passes is {BATCH_LIMIT}."
        ),
        table(
            "joint | recording::text | zygos::main | batch least squares | ratio | published model | limit | zygos, "
            "with the offset",
            [
                Row(
                    (
                        one.joint,
                        one.recording,
                        number(100 * one.zygos, 3),
                        number(100 * one.batch, 3),
                        number(one.zygos / one.batch, 4),
                        number(100 * one.published, 3),
                        number(100 * one.limit, 3),
                        number(100 * one.with_offset, 3),
                    ),
                    "" if one.good else "fails",
                    colours[one.joint],
                )
                for one in real.held_out
            ],
        ),
    )
    values = section(
        "values",
        "Learned and published values",
        Text(
            "The published values are read after the estimate. The last column is the difference in half widths of the "
            "95 % interval."
        ),
        table(
            "name::name | stands for::wrap | learned::main | ± 95 % | unit::unit | batch least squares | published | "
            "difference",
            [
                (
                    one.name,
                    one.stands_for if one.stands_for != one.name else "",
                    number(one.value, 4),
                    number(one.half95, 2),
                    unit_of(one.unit),
                    number(one.batch, 4),
                    number(one.published, 4),
                    number((one.value - one.published) / one.half95, 2) if np.isfinite(one.published) else "–",
                )
                for one in real.values
            ],
        ),
    )
    skews = section(
        "kr300",
        "The encoders of a KUKA KR300",
        Text("The time by which the encoder of the motor is read later than that of the link, from a recorded run.")
        if real.skews
        else Text("Its run is not there, so that its audit is left out.", "note"),
        table(
            "axis | later by, ms::main | ± standard error | zygos check-arm::text",
            [
                (
                    one.axis,
                    number(one.skew_ms, 3),
                    number(one.sigma_ms, 2),
                    "reports a skew" if one.reported else "reports nothing",
                )
                for one in real.skews or ()
            ],
        ),
    )
    return estimate_answer(real.found, draw=draw, beside=sections(held_out, values, skews))


def explained(
    learned: Sequence[Run], found: GroundEstimate, folder: Path, example: Path = EXAMPLE
) -> tuple[GroundExplanation, InSimulator]:
    """What the published model without friction lacks, and its MJCF with that, with a page and a picture.

    Errors: ZygosError if a file cannot be read or written, and where MuJoCo is not installed; Undecided where there is
    no model, and where MuJoCo does not predict as zygos does.
    """
    arm, simulation = learned[0].arm, example / "pendulum.xml"
    robot = read_robot(simulation, arm)
    gap = explain_ground(arm, robot.model(arm), learned, [one.run for one in found.validated])
    own = FileExplanation(gap, robot).simulator
    own.save(folder / "pendulum.xml")
    files = [("simulation", simulation), ("arm", example / "arm.toml")]
    files += [("recording", example / f"{name}.blf") for name in (*LEARNED, *LIMITS)]
    write_page(folder / "gap.html", own.beside(answer_of(gap, draw=True)), provenance(["real"], files))
    delivered, corrected = own.measured[0].runs, own.measured[-1].runs
    stages = zip(own.runs, delivered, corrected, strict=True)
    scores = [(run, a.score, b.score) for run, a, b in stages if a.score is not None and b.score is not None]
    write_picture(folder / "gap.svg", scores, "MuJoCo")
    return gap, own


def run_real(
    folder: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder of everything that is written.")] = Path(
        "out/real"
    ),
    kr300: Annotated[Path, typer.Option(metavar="FILE", help="The run of the KR300.")] = SOURCE,
) -> None:
    """Estimate and validate on measured runs of real arms, and write FOLDER/real.html.

    Exit code 3 when an error is beyond its limit.

    Example: python -m zygos.demo.real
    """
    if not (EXAMPLE / "arm.toml").is_file():
        raise ZygosError(f"{EXAMPLE / 'arm.toml'}: no such file; remedy: run inside a checkout")
    folder.mkdir(parents=True, exist_ok=True)
    page, json = folder / "real.html", folder / "real.json"
    others = [folder / name for name in ("learned.toml", "pendulum.xml", "gap.html", "gap.svg")]
    check_outputs([page, json, *others], [])
    found, learned = learn_pendulum(folder)
    beside = compared(found, learned)
    real = Real(found, beside.held_out, beside.values, audited(kr300, folder / "kr300"))
    files = [("recording", EXAMPLE / f"{name}.blf") for name in (*LEARNED, *LIMITS)]
    files += [("arm", EXAMPLE / "arm.toml"), ("published model", EXAMPLE / "published.toml")]
    write_json(json, real.as_dict())
    write_page(page, real_answer(real, draw=True), provenance(["real"], files))
    _print(real, kr300)
    gap, own = explained(learned, found, folder)
    if gap.gap is not None:
        show_table(
            ("recording", *(f"{name}, %" for name, _ in gap.gap.predictions[0].scores)),
            [
                (run_name(one.run), *(number(100 * score.arm_energy_share, 3) for _, score in one.scores))
                for one in gap.gap.predictions
            ],
            title="the gap of the published model without friction: error of the energy over one second",
        )
    say(f"{gap.answer}: {gap.sentence}")
    say(own.sentence)
    say(f"{folder / 'pendulum.xml'} · {folder / 'gap.html'} · {folder / 'gap.svg'}")
    say(f"{found.validity}: {found.reason}" if found.reason else found.validity)
    say(f"{page} · {json}")
    if not real.good:
        bad = ", ".join(f"{one.joint} in {one.recording}" for one in real.held_out if not one.good)
        raise Undecided(f"the predicted torque is beyond its limit ({bad}); remedy: read {page}")


def _print(real: Real, kr300: Path) -> None:
    show_table(
        ("recording", "joint", "torque left, %", "batch", "published", "limit", "of batch", "with offset"),
        [
            (
                one.recording,
                one.joint,
                number(100 * one.zygos, 3),
                number(100 * one.batch, 3),
                number(100 * one.published, 3),
                number(100 * one.limit, 3),
                number(one.zygos / one.batch, 4),
                number(100 * one.with_offset, 3),
            )
            for one in real.held_out
        ],
        title="the pendulum: torque that is not predicted, without the offset of the recording",
    )
    show_table(
        ("name", "unit", "learned", "±95 %", "batch", "published"),
        [
            (
                one.name,
                one.unit,
                number(one.value, 4),
                number(one.half95, 2),
                number(one.batch, 4),
                number(one.published, 4),
            )
            for one in real.values
        ],
    )
    if real.skews is None:
        say(f"KR300: {kr300} is not there, so that its audit is left out")
        return
    show_table(
        ("axis of the KR300", "motor newer by ms", "±", "reported"),
        [
            (one.axis, number(one.skew_ms, 3), number(one.sigma_ms, 2), "yes" if one.reported else "no")
            for one in real.skews
        ],
    )


def main(arguments: list[str] | None = None) -> None:
    """Run with the arguments of the command line, or with the given ones."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command()(run_real)
    with errors_end_the_program():
        app(args=arguments, prog_name="python -m zygos.demo.real")


if __name__ == "__main__":
    main()

# SPDX-License-Identifier: MIT
"""Runs as they are loaded, to explain or to predict: what a gap needs of them, checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zygos.arm import Arm
from zygos.can.run import Run, check_distinct, joined
from zygos.effects import CATALOGUE
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import estimate
from zygos.gap.explain import explain
from zygos.gap.explanation import Explanation
from zygos.gap.ground.explain import cut, explain_ground
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.next_motion import next_ground_motion, reached_on_ground
from zygos.gap.next_motion import next_motion, reached
from zygos.gap.record import MeasuredRun, measured_run
from zygos.gap.simulated import model_of_simulator
from zygos.model.model import Model
from zygos.plan.limits import Limits
from zygos.plan.separating import Separating


def check_arm_of_gap(arm: Arm, named: str) -> None:
    """Refuse, with ZygosError, an arm that the balances of a gap do not describe. named: how the message begins."""
    if arm.torque_unit != "Nm":
        raise ZygosError(
            f"{named}: its torques are motor currents, whose torque constants nobody knows, so that no run can be "
            "simulated; remedy: give torques in Nm, or use `zygos estimate`"
        )


def record_of(run: Run, number: int = 1) -> MeasuredRun:
    """A run cut into arcs. number: which run it is, for messages. Errors: ZygosError where it has no unbroken stretch
    of 2 s."""
    return measured_run(run, run.path or Path(f"run {number}"))


def explain_runs(
    simulation: Model | Run,
    measured: Sequence[Run],
    *,
    validate: Run | Sequence[Run] | None = None,
    without: Sequence[str] = (),
    progress: Callable[[float, str], None] | None = None,
) -> Explanation | GroundExplanation:
    """As `zygos.explain`, for a model of zygos or a run of another simulator.

    An arm on a fixed base with rigid joints is explained by the momentum rows of its joints and the scatter between
    blocks and runs, every other arm by its balances beside those of a simulated twin (docs/gap-method.md).

    Errors: as `zygos.explain`, and as `model_of_simulator`.
    """
    kept = (validate,) if isinstance(validate, Run) else tuple(validate or ())
    runs = [*measured, *kept]
    if not measured:
        raise ZygosError("no measured run; remedy: one run, or better two to learn from and a third to validate")
    arm = runs[0].arm
    if any(run.arm != arm for run in runs):
        raise ZygosError("the runs are of different arms; remedy: runs of one arm, loaded with the same arm file")
    if isinstance(simulation, Model):
        simulation.base_parameters(arm)
    for number, run in enumerate(runs):
        check_distinct(run, runs[:number])
    check_keys(without)
    step = progress or (lambda share, what: None)
    if isinstance(simulation, Run):
        if simulation.arm != arm:
            raise ZygosError("the simulated run is of another arm; remedy: a run of the arm of the measured ones")
        check_distinct(simulation, runs)
        step(0.0, "the model of the simulator")
        model, simulated = model_of_simulator(simulation, measured)
        return replace(
            explain_runs(model, measured, validate=kept, without=without, progress=progress), simulated=simulated
        )
    if arm.grounded:
        return explain_ground(arm, simulation, measured, kept, step, without)
    check_arm_of_gap(arm, f"arm {arm.name}")
    records = [record_of(run, number) for number, run in enumerate(runs, start=1)]
    learned, apart = records[: len(measured)], records[len(measured) :]
    own = list(measured)
    if len(learned) == 1:
        count = 2 if apart else 3
        parts = thirds(learned[0], count)
        own = [*cut(measured[0], count)[:2]]
        learned, apart = parts[:2], apart or parts[2:]
    return explain(arm, simulation, learned, apart, step, without, _plain(own))


def _plain(runs: Sequence[Run]) -> Model | None:
    """The estimate of `zygos estimate` from runs; None where it has no value of some parameter."""
    try:
        model = estimate(joined(runs)).to_model()
    except (Undecided, ZygosError):
        return None
    return model if set(runs[0].arm.parameter_names) <= set(model.parameters) else None


def plan_next(
    found: Explanation | GroundExplanation,
    given: Limits,
    arm_file: Path,
    model_file: Path,
    *,
    name: str = "next",
    progress: Callable[[float], None] = lambda share: None,
) -> Separating:
    """The motion that best tells apart the effects that the runs cannot, as a scenario that is ready to fly.

    given: limits; where there is none, the motion stays within what the measured runs reached. arm_file, model_file:
    what the scenario refers to.

    Errors: ZygosError where nothing has to be told apart; Undecided where no motion within the limits tells them apart.
    """
    own = reached_on_ground(found.measured) if isinstance(found, GroundExplanation) else reached(found.refit.records)
    limits = Limits(*(
        np.where(np.isfinite(asked), asked, seen)
        for asked, seen in (
            (given.low, own.low), (given.high, own.high), (given.rate, own.rate), (given.torque, own.torque)
        )
    ))  # fmt: skip
    if isinstance(found, GroundExplanation):
        return next_ground_motion(found, limits, arm_file, model_file, name=name, progress=progress)
    return next_motion(found, limits, arm_file, model_file, name=name, progress=progress)


def check_keys(without: Sequence[str]) -> None:
    """Refuse, with ZygosError, what is no key of the catalogue."""
    for key in without:
        if key not in CATALOGUE:
            raise ZygosError(f"there is no effect {key!r}; remedy: one of {', '.join(CATALOGUE)}")


def thirds(record: MeasuredRun, parts: int = 3) -> list[MeasuredRun]:
    """A run cut into parts of about equal length, as if each had been recorded by itself.

    Errors: ZygosError where it has fewer arcs than parts.
    """
    if len(record.starts) < parts:
        raise ZygosError(
            f"{record.path}: one run of {len(record.starts)} arcs cannot be cut into {parts} parts, of which one must "
            "hold what another says; remedy: give two runs, or one of at least 30 s"
        )
    return [replace(record, starts=starts) for starts in np.array_split(record.starts, parts)]

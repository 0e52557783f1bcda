"""Runs as they are loaded, to explain or to predict: what a gap needs of them, checked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.gap.explain import explain
from zygos.gap.explanation import Explanation
from zygos.gap.record import MeasuredRun, measured_run
from zygos.model.model import Model


def check_arm_of_gap(arm: Arm, named: str) -> None:
    """Refuse, with ZygosError, an arm that the balances of a gap do not describe. named: how the message begins."""
    if arm.kinetic != "planar-symmetric" or not arm.free or not all(joint.flexible for joint in arm.joints):
        raise ZygosError(
            f"{named}: a gap can be explained only for a free-floating, planar-symmetric arm with flexible "
            "joints; remedy: use `zygos estimate` or `zygos check`, which take any arm"
        )


def record_of(run: Run, number: int = 1) -> MeasuredRun:
    """A run cut into arcs. number: which run it is, for messages. Errors: ZygosError where it has no unbroken stretch
    of 2 s."""
    return measured_run(run, run.path or Path(f"run {number}"))


def same_recording(one: Run, other: Run) -> bool:
    """Whether two runs have the same cycles, in whatever format."""
    return np.array_equal(one.cycles.tau, other.cycles.tau) and np.array_equal(one.cycles.theta, other.cycles.theta)


def explain_runs(
    simulation: Model,
    measured: Sequence[Run],
    *,
    validate: Run | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Explanation:
    """Say where a simulation and the measured runs of an arm disagree, and which effect the simulation lacks.

    simulation: the model that the simulation uses. measured: two runs of one arm; what is learned from one must hold on
    the other. validate: a third run, from which nothing is learned; the gap is measured on it, before and after.
    progress is called with the share that is done and what is being done.

    `Explanation.answer` is "values differ", "named", "cannot tell", "nothing missing" or "unknown"; `sentence` says it
    in words, `findings` has the effects with value and interval, and `model` is the model with what was learned, or
    None where nothing is to be adopted.

    Errors: ZygosError for an arm that is not free-floating, planar-symmetric and flexible in all joints, for runs of
    different arms or that are the same recording, and for a model that does not fit; Undecided where the runs do not
    tell its parameters apart.
    """
    runs = [*measured, *([] if validate is None else [validate])]
    if len(measured) != 2:
        raise ZygosError(f"{len(measured)} measured runs; remedy: two runs to learn from, and a third to validate")
    arm = runs[0].arm
    if any(run.arm != arm for run in runs):
        raise ZygosError("the runs are of different arms; remedy: runs of one arm, loaded with the same arm file")
    check_arm_of_gap(arm, f"arm {arm.name}")
    simulation.base_parameters(arm)
    records = [record_of(run, number) for number, run in enumerate(runs, start=1)]
    for (one, first), (other, second) in combinations(zip(records, runs, strict=True), 2):
        if same_recording(first, second):
            raise ZygosError(
                f"{one.path} and {other.path} are the same recording; remedy: two runs to learn from, and a third to "
                "validate, for what one run says must hold on another"
            )
    step = progress or (lambda share, what: None)
    return explain(arm, simulation, records[:2], records[2] if validate is not None else None, step)

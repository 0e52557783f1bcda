# SPDX-License-Identifier: MIT
"""The motion after which effects that these runs cannot tell apart can be told, as a scenario that is ready to fly.

Motions are simulated with the model that was found, and read by the declared sensors. Each effect of a set must then
stand out of the twin's noise beside the other one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.can.run import Run
from zygos.errors import ZygosError
from zygos.gap.balances import accumulate, balance_rows
from zygos.gap.explanation import Explanation
from zygos.gap.findings import undecided
from zygos.gap.fit import Hypothesis, fit
from zygos.gap.record import MeasuredRun, followed, measured_run, smoothed_states
from zygos.gap.study import Study, base_values
from zygos.gap.twin import Twin, measure
from zygos.plan.limits import Limits
from zygos.plan.separating import LONGEST_S, Separating, most_separating, servo_of
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import Scenario

Array = NDArray[np.float64]


def next_motion(
    found: Explanation,
    allowed: Limits,
    arm_file: Path,
    model_file: Path,
    *,
    name: str = "next",
    progress: Callable[[float], None] = lambda share: None,
) -> Separating:
    """The motion that best tells apart the effects that the runs cannot. allowed: finite limits of angles and rates.

    Errors: ZygosError where nothing has to be told apart; Undecided where no motion within the limits tells them apart.
    """
    if not undecided(found.findings) or found.search is None:
        raise ZygosError(f"the answer is {found.answer!r}: no effects have to be told apart, and no motion is planned")
    study, arm = found.search.after, found.arm
    dynamics = study.dynamics()
    hypotheses = [one for names in found.search.sets for one in _pairs(study, names)]
    names = [joint.name for joint in arm.joints]
    values = base_values(dynamics, study.layout)

    def judge(scenario: Scenario) -> float:
        moved = simulate(
            arm,
            found.simulation,
            scenario,
            dynamics=dynamics,
            noise=False,
            rtol=limits.RTOL.value,
            atol=limits.ATOL.value,
        )
        if excess := allowed.violation(arm, moved.q[0], moved.qd[0], moved.tau[0]):
            raise ZygosError(excess)
        record = measured_run(Run.of_cycles(arm, moved.cycles()), Path(scenario.name))
        twin = Twin(record.arm, record.readings())
        seen = [measure(twin, k) for k in range(limits.MOTION_DRAWS.value)]
        scores = []
        for both, sizes in hypotheses:
            sums = [
                accumulate(balance_rows(both.layout, one, values), followed(arm, one), both.uncentred) for one in seen
            ]
            drawn = [fit(both, [one], study.weight) for one in sums]
            for column, size in sizes:
                scores.append(size / float(np.std([float(one.of(column)) for one in drawn], ddof=1)))
        return min(scores)

    record = study.records[0]
    template = Scenario(
        name,
        arm_file,
        model_file,
        float(round(min(LONGEST_S, max(_length(one) for one in study.records)))),
        {},
        servo_of(arm, dynamics, record.samples.q[record.starts]),
        encoder_noise="quantised",
        angular_momentum_nms=_momentum(record, study),
    )
    return most_separating(template, names, allowed, judge, needed=limits.NAMED_Z.value, progress=progress)


def _pairs(study: Study, names: Sequence[str]) -> Iterator[tuple[Hypothesis, list[tuple[str, float]]]]:
    """For each effect that may stand in for the first of a set: the hypothesis that has both, and the size of each."""
    first, *others = names
    rest = tuple(one for one in study.hypothesis.effects if one != first)
    for other in others:
        wide = study.hypothesis.layout
        acting = [wide.find(one) for one in (*study.hypothesis.effects, other)]
        layout = replace(wide, wide=False, own=tuple({one.name: one for one in (*wide.own, *acting)}.values()))
        instead = study.of(replace(study.hypothesis, effects=(*rest, other)))
        sizes = [
            (first, abs(float(study.value[study.hypothesis.names.index(first)]))),
            (other, abs(float(instead.of(other)))),
        ]
        yield replace(study.hypothesis, layout=layout, effects=(*study.hypothesis.effects, other)), sizes


def _length(record: MeasuredRun) -> float:
    """Duration of a record, s."""
    return float(record.clock_s[-1])


def _momentum(record: MeasuredRun, study: Study) -> float | tuple[float, float, float]:
    """Angular momentum at the start of a record, Nms; of an arm on the ground 0."""
    if not record.arm.free:
        return 0.0
    state = smoothed_states(record.arm, record.readings())
    own = study.dynamics().momentum(state.q, state.base, state.qd, state.thetad)[0, 0]
    rounded = [float(f"{x:.4g}") for x in np.atleast_1d(own).tolist()]
    return (rounded[0], rounded[1], rounded[2]) if record.arm.spatial else rounded[0]


def reached(records: Sequence[MeasuredRun]) -> Limits:
    """The ranges, rates and torques that measured runs reached."""
    states = [smoothed_states(one.arm, one.readings()) for one in records]
    joints = records[0].arm.n
    angle = np.concatenate([one.q.reshape(-1, joints) for one in states])
    rate = np.concatenate([one.qd.reshape(-1, joints) for one in states])
    tau = np.concatenate([one.samples.tau for one in records])
    return Limits(angle.min(axis=0), angle.max(axis=0), np.abs(rate).max(axis=0), np.nanmax(np.abs(tau), axis=0))

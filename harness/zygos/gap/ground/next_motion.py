# SPDX-License-Identifier: MIT
"""The motion after which the effects that runs of an arm on the ground cannot tell apart can be told, ready to fly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.errors import Undecided, ZygosError
from zygos.gap.findings import ASYMMETRY, Finding
from zygos.gap.ground.candidates import OFFSET_OF_TORQUE, candidates_of
from zygos.gap.ground.columns import Layout, table_of
from zygos.gap.ground.direction import phases
from zygos.gap.ground.explanation import GroundExplanation
from zygos.gap.ground.fit import fit, jackknife
from zygos.ground.motion import Motion
from zygos.ground.twin import predicted_load
from zygos.plan.limits import Limits
from zygos.plan.separating import LONGEST_S, Separating, most_separating, servo_of
from zygos.runs.cycles import Cycles
from zygos.simulation.plant import needed_torque
from zygos.simulation.scenario import Scenario
from zygos.simulation.sensors import draw_noise, encoder_reading, torque_record

Floats = NDArray[np.float64]


def next_ground_motion(
    found: GroundExplanation,
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
    pairs = [(one, other) for one in found.findings for other in one.instead]
    if not pairs or found.likely is None:
        raise ZygosError(f"the answer is {found.answer!r}: no effects have to be told apart, and no motion is planned")
    arm, model = found.arm, found.likely
    dynamics = from_model(arm, model)
    offsets = np.zeros(arm.n)
    for one in found.findings:
        if one.kind == OFFSET_OF_TORQUE:
            offsets[_at(arm, one)] = one.value
    # what the model leaves of the torques of the measured runs is expected in the next one as well
    left = found.search.after.sigma / (arm.gear_ratios * np.sqrt(arm.period_s * found.span_s))
    noisy = replace(arm, joints=tuple(replace(j, torque_sigma=float(s)) for j, s in zip(arm.joints, left, strict=True)))
    rests = [one for one, other in pairs if other.startswith(ASYMMETRY)]
    columns = [(one, other) for one, other in pairs if not other.startswith(ASYMMETRY)]
    names = [joint.name for joint in arm.joints]

    def flown(scenario: Scenario) -> Run:
        h = arm.period_s
        count = round(scenario.duration_s / h)
        t = h * np.arange(count, dtype=np.float64)
        # a torque that is held acts in the middle of a period
        acts = t + (0.0 if arm.torque_law == "sampled" else 0.5 * h)
        angle, rate = scenario.desired(names, acts)
        tau = needed_torque(arm, dynamics, angle, rate, scenario.accelerations(names, acts))
        if excess := allowed.violation(arm, angle, rate, tau):
            raise ZygosError(excess)
        noise = draw_noise(noisy, count, [scenario.seed], scenario.encoder_noise)
        read = scenario.desired(names, t)[0]
        sides = [(j.link_encoder for j in arm.joints), (j.motor_encoder for j in arm.joints)]
        q, theta = (
            encoder_reading(list(side), read, error[0], noise.rounding)
            for side, error in zip(sides, (noise.link, noise.motor), strict=True)
        )
        return Run.of_cycles(
            arm,
            Cycles(
                np.arange(count, dtype=np.uint64),
                q,
                theta,
                torque_record(noisy, tau + offsets, noise.torque[0], noise.torque_share[0]),
                np.zeros((count, 3)),
                np.zeros(count, dtype=np.uint32),
            ),
        )

    def judge(scenario: Scenario) -> float:
        motion = Motion.of(flown(scenario))
        kept = {*found.search.beside, *(one.name for one in found.search.named), *(other for _, other in columns)}
        listed = [one for one in candidates_of(arm, found.simulation) if one.name in kept]
        layout = Layout.of(arm, found.simulation, listed, 1)
        load = predicted_load(motion, model.base_values(arm))
        table = table_of(layout, [motion], found.span_s, [load])
        known = found.search.free(layout)
        fitted = fit(table, known)
        scores = []
        for one in rests:
            seen = np.array([*phases(table, table.rows[0], fitted, _at(arm, one))])
            scores.append(abs(one.value) / float(seen.std(ddof=1)) if len(seen) >= limits.PHASES.value else 0.0)
        for one, other in columns:
            own = next(names_[0] for names_ in found.search.sets if other in names_[1:])
            both = fit(table, [*dict.fromkeys([*known, layout.at(other)])])
            sigma = dict(zip(both.free, np.sqrt(np.diag(jackknife(table, both)[0])).tolist(), strict=True))
            sizes = ((layout.at(own), one.value), (layout.at(other), _size(found, other)))
            scores += [abs(size) / sigma[place] for place, size in sizes]
        return min(scores)

    longest = max(len(run) for run in found.measured) * arm.period_s
    middle = 0.5 * (allowed.low + allowed.high)
    template = Scenario(
        name,
        arm_file,
        model_file,
        min(longest, LONGEST_S),
        {},
        servo_of(arm, dynamics, middle[None]),
        encoder_noise="quantised",
        angular_momentum_nms=0.0,
    )
    return most_separating(template, names, allowed, judge, needed=limits.NAMED_Z.value, progress=progress)


def _at(arm: Arm, one: Finding) -> int:
    return [joint.name for joint in arm.joints].index(one.joint or "")


def _size(found: GroundExplanation, column: str) -> float:
    """Coefficient that a candidate had when it was tried last."""
    rounds = reversed(found.search.rounds)
    one = next((one for tried in rounds for one in tried if one.name == column), None)
    if one is None:
        raise Undecided(f"{column} was not tried; remedy: another motion")
    return one.value


def reached_on_ground(runs: Sequence[Run]) -> Limits:
    """The ranges, rates and torques that measured runs reached."""
    motions = [Motion.of(run) for run in runs]
    angle = np.concatenate([motion.smoothed.q for motion in motions])
    rate = np.concatenate([motion.smoothed.qd for motion in motions])
    tau = np.concatenate([run.cycles.tau for run in runs])
    return Limits(angle.min(axis=0), angle.max(axis=0), np.abs(rate).max(axis=0), np.abs(tau).max(axis=0))

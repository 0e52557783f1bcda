# SPDX-License-Identifier: MIT
"""The rows beside those of the energy, their weights, and their use together (docs/theory.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances import impulse
from zygos.balances.arcs import MIN_ARC_INSTANTS, numbered, unused, without_row
from zygos.balances.momentum import Turns
from zygos.effects import Effect, estimated
from zygos.reference.accumulator import Design
from zygos.reference.gains import Prior, solve_held
from zygos.reference.joints import CAUTION, Groups, suffice
from zygos.reference.solver import Rows, Solution, explained, solve
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]

LEAST_ARCS = 3
"""Smallest number of arcs from which the noise of the rows is estimated."""
WALK = 10.0
"""The mean square of a random walk about its own mean is sigma^2 T^2 divided by this, which is between 6 and 15."""


MOMENTUM_CAUTION = 5.0
"""Factor by which the noise of the momentum rows is increased: neighbouring rows are correlated, energy rows are
not."""


@dataclass(frozen=True)
class MotorRows:
    """Accepted rows of one joint's motor in its turn, minus each arc's mean; m rows, p parameters of the arm.

    joint: from 0. rows: z (m, p), zero outside the joint's own columns, w (m,) [Nms], and their noise (p+1, p+1).
    arcs: number of arcs in use.
    """

    joint: int
    rows: Rows
    arcs: int


def motors(arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect] = ()) -> tuple[MotorRows, ...]:
    """Rows of every flexible joint over a whole record; none if the arm switches them off. Errors: as `estimated`."""
    if arm.impulse_arc_s == 0.0:
        return ()
    longest = max(1, round(arm.impulse_arc_s / arm.period_s))
    arc = numbered(smoothed, longest, without_row(arm, samples, smoothed, "motor"))
    _, first, which = np.unique(arc, return_index=True, return_inverse=True)
    position = np.arange(len(arc)) - first[which]
    void = unused(arm, samples, smoothed, arc, longest, "motor")
    names = [*arm.parameter_names, *(effect.column(arm) for effect in estimated(arm, effects))]
    out = []
    for one in impulse.impulse_rows(arm, samples, smoothed, arc, effects):
        places = [names.index(name) for name in one.names]
        z, w, count = [np.zeros((0, len(names)))], [np.zeros(0)], 0
        for number in range(int(arc.max(initial=-1)) + 1):
            accepted = np.flatnonzero((arc == number) & smoothed.accepted)
            mine = accepted[position[accepted] % arm.n == one.joint]
            if len(accepted) < MIN_ARC_INSTANTS or number in void or not len(mine):
                continue
            own = np.zeros((len(mine), len(names)))
            own[:, places] = one.z[mine] - one.z[mine].mean(axis=0)
            z.append(own)
            w.append(one.w[mine] - one.w[mine].mean())
            count += 1
        noise = np.zeros((len(names) + 1, len(names) + 1))
        if arm.compensation:
            noise[np.ix_(places, places)] = sum(map(len, w)) * impulse.impulse_noise(arm, one.joint, effects)
        out.append(MotorRows(one.joint, Rows(np.concatenate(z), np.concatenate(w), noise), count))
    return tuple(out)


def weight(arm: Arm, own: MotorRows, energy: Floats, x: Floats) -> float:
    """Weight of a joint's rows relative to those of the energy: the ratio of their noise.

    energy: (p+1, p+1) noise of one energy row. x: (p,) the parameters estimated from the energy rows only.
    """
    joint = arm.joints[own.joint]
    stiffness = x[arm.parameter_names.index(f"k{own.joint + 1}")]
    link, motor = joint.link_encoder.over_the_wire, joint.motor_encoder.over_the_wire
    reading = link.sigma_rad**2 + motor.sigma_rad**2
    arc_s = arm.period_s * max(1, round(arm.impulse_arc_s / arm.period_s))
    instant = explained(own.rows.noise, x) / max(len(own.rows.w), 1)
    noise = instant + stiffness**2 * reading * arc_s**2 / WALK
    return float(explained(energy, x) / noise) if noise > 0.0 and own.arcs >= LEAST_ARCS else 0.0


def placed(names: Sequence[str], own: Turns) -> Rows:
    """The momentum rows with p parameters, without a weight. A floating arm's parameters are some of the full ones."""
    kept = [k for k, name in enumerate(own.names) if name in names]
    places = [names.index(own.names[k]) for k in kept]
    z, noise = np.zeros((len(own.z), len(names))), np.zeros((len(names) + 1, len(names) + 1))
    z[:, places] = own.z[:, kept]
    noise[np.ix_(places, places)] = own.noise.sum(axis=0)[np.ix_(kept, kept)]
    return Rows(z, np.zeros(len(z)), noise)


def momentum_weight(own: Turns, rows: Rows, energy: Floats, x: Floats) -> float:
    """Weight of the momentum rows; 0 if fewer than LEAST_ARCS arcs, or no noise, determine it.

    energy: (p+1, p+1) noise of one energy row. x: (p,) the parameters estimated from the other rows.
    """
    mean = explained(rows.noise, x) / max(len(rows.z), 1)
    if len(own.noise) < LEAST_ARCS or not mean > 0.0:
        return 0.0
    return float(explained(energy, x) / (MOMENTUM_CAUTION * mean))


@dataclass(frozen=True)
class Combined:
    """The estimate from all rows. weights: those of each joint's motor rows. momentum_weight, joints_weight: those of
    the momentum rows and of the joint rows."""

    solution: Solution
    weights: tuple[float, ...]
    momentum_weight: float
    joints_weight: float = 0.0


def joints_weight(own: Groups, energy: Floats, x: Floats, *, measured: bool) -> float:
    """Weight of the joint rows by their declared noise at the parameters x (p,), or by their residuals there.

    energy: (p+1, p+1) noise of one energy row.
    """
    left = own.rows.z @ x - own.rows.w
    square = float(left @ left if measured else x @ own.rows.noise[:-1, :-1] @ x)
    return float(explained(energy, x) * len(own.rows.z) / (CAUTION * square)) if square > 0.0 else 0.0


def combine(
    arm: Arm,
    design: Design,
    motors: Sequence[MotorRows],
    momentum: Turns | None,
    joints: Groups | None = None,
    effects: Sequence[Effect] = (),
    prior: Prior | None = None,
) -> Combined:
    """Combine energy, motor, momentum and joint rows, each weighted by its noise; where the joint rows suffice, they
    are the only ones. effects: those of the columns. prior: of the gains among them, which are held at 0 without one.
    Raises Undecided as `solve`."""
    gains = sum(effect.kind.gain for effect in effects)

    def solved(energy: Rows, beside: Sequence[Rows] = ()) -> Solution:
        if prior is None:
            return solve_held(energy, beside, gains)
        return solve(energy, [*beside, prior.rows(energy.z.shape[1])])

    if joints is not None and suffice(arm):
        return Combined(solved(joints.rows), (), 0.0, 1.0)
    energy = Rows(design.z, design.w, design.noise)
    alone = solved(energy)
    noise = design.noise / max(len(design.w), 1)
    weights = tuple(weight(arm, own, noise, alone.x) for own in motors)
    beside = [own.rows.times(factor) for factor, own in zip(weights, motors, strict=True) if factor > 0.0]
    solution, factor = solved(energy, beside), 0.0
    if momentum is not None:
        names = [*arm.parameter_names, *(effect.column(arm) for effect in estimated(arm, effects))]
        third = placed(names, momentum)
        factor = momentum_weight(momentum, third, noise, solution.x)
        if factor > 0.0:
            beside.append(third.times(factor))
            solution = solved(energy, beside)
    fourth = 0.0
    if joints is not None and joints.enough:
        for measured in (False, True):
            now = joints_weight(joints, noise, solution.x, measured=measured)
            if not now > 0.0:
                break
            fourth = now
            solution = solved(energy, [*beside, joints.rows.times(fourth)])
    return Combined(solution, weights, factor, fourth)

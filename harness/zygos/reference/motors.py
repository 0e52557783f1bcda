"""Motor and momentum rows that count beside those of the energy, and their weights (docs/theory.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.effects import Effect, estimated
from zygos.reference import impulse, momentum
from zygos.reference.accumulator import MIN_ARC_INSTANTS, Design
from zygos.reference.arcs import numbered
from zygos.reference.balance import End, void_arcs
from zygos.reference.cycle import Samples
from zygos.reference.smoother import Smoothed
from zygos.reference.solver import Rows, Solution, explained, solve

Floats = NDArray[np.float64]

LEAST_ARCS = 3
"""Of fewer arcs nothing is learned about their noise."""
MOMENTUM_CAUTION = 5.0
"""The noise of neighbouring momentum rows is alike, that of energy rows forgets at once: so much less they count."""
WALK = 10.0
"""The mean square of a random walk about its own mean is sigma^2 T^2 over this, between 6 and 15."""


@dataclass(frozen=True)
class Motors:
    """Accepted rows of one joint whose turn it was, less each arc's mean; m rows, p parameters of the arm.

    joint: from 0. rows: z (m, p) with zeros but for the joint's own, w (m,) [Nms], noise (p+1, p+1) that they hold.
    arcs: arcs that count.
    """

    joint: int
    rows: Rows
    arcs: int


def _ends(arm: Arm, smoothed: Smoothed, arc: NDArray[np.int64], longest: int) -> list[End]:
    ends = []
    for number in range(int(arc.max(initial=-1)) + 1):
        of = np.flatnonzero(arc == number)
        ends.append(End(int(smoothed.index[of[-1]]) + arm.smoother.lag, len(of) == longest))
    return ends


def motors(arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect] = ()) -> tuple[Motors, ...]:
    """Rows of every flexible joint over a whole record; none if the arm switches them off. Errors: as `estimated`."""
    if arm.impulse_arc_s == 0.0:
        return ()
    longest = max(1, round(arm.impulse_arc_s / arm.period_s))
    arc = numbered(smoothed, longest)
    position = np.arange(len(arc)) - np.searchsorted(arc, arc)
    ends = _ends(arm, smoothed, arc, longest)
    void = void_arcs(samples, ends)
    names = [*arm.parameter_names, *(effect.column(arm) for effect in estimated(arm, effects))]
    out = []
    for one in impulse.rows(arm, samples, smoothed, arc, effects):
        places = [names.index(name) for name in one.names]
        z, w, count = [np.zeros((0, len(names)))], [np.zeros(0)], 0
        for number in range(len(ends)):
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
            noise[np.ix_(places, places)] = sum(map(len, w)) * impulse.noise(arm, one.joint, effects)
        out.append(Motors(one.joint, Rows(np.concatenate(z), np.concatenate(w), noise), count))
    return tuple(out)


def weight(arm: Arm, own: Motors, energy: Floats, x: Floats) -> float:
    """Of a joint's rows beside those of the energy: the ratio of the noise in them.

    energy: (p+1, p+1) noise of one energy row. x: (p,) the parameters, by the energy rows alone.
    """
    joint = arm.joints[own.joint]
    stiffness = x[arm.parameter_names.index(f"k{own.joint + 1}")]
    link, motor = joint.link_encoder.over_the_wire, joint.motor_encoder.over_the_wire
    reading = link.sigma_rad**2 + motor.sigma_rad**2
    arc_s = arm.period_s * max(1, round(arm.impulse_arc_s / arm.period_s))
    instant = explained(own.rows.noise, x) / max(len(own.rows.w), 1)
    noise = instant + stiffness**2 * reading * arc_s**2 / WALK
    return float(explained(energy, x) / noise) if noise > 0.0 and own.arcs >= LEAST_ARCS else 0.0


@dataclass(frozen=True)
class Momenta:
    """Momentum rows of all arcs that count. rows: as in `Motors`, right side 0. arcs: how many. instants: accepted."""

    rows: Rows
    arcs: int
    instants: int


def momenta(arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect] = ()) -> Momenta | None:
    """Momentum rows over a whole record; None where the arm switches them off. Errors: as `estimated`."""
    if arm.momentum_arc_s == 0.0:
        return None
    longest = max(1, round(arm.momentum_arc_s / arm.period_s))
    arc = numbered(smoothed, longest)
    counts = []
    for number in void_arcs(samples, _ends(arm, smoothed, arc, longest)):
        arc[arc == number] = -1
    for number in range(int(arc.max(initial=-1)) + 1):
        accepted = int(np.count_nonzero(smoothed.accepted[arc == number]))
        counts += [accepted] if accepted >= MIN_ARC_INSTANTS else []
    grams, owed = momentum.sums(arm, smoothed, arc)
    names = [*arm.parameter_names, *(effect.column(arm) for effect in estimated(arm, effects))]
    kinetic = len(arm.body_parameters)
    places = [*range(kinetic), *(names.index(f"Im{i + 1}") for i in range(arm.n))]
    size = len(places)
    z, noise = np.zeros((size, len(names))), np.zeros((len(names) + 1, len(names) + 1))
    if grams:
        gram = np.sum(grams, axis=0)
        scale = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
        value, vector = np.linalg.eigh(gram / np.outer(scale, scale))
        z[:, places] = np.sqrt(np.maximum(value, 0.0))[:, None] * vector.T * scale
        noise[np.ix_(places, places)] = np.sum(owed, axis=0)
    return Momenta(Rows(z, np.zeros(size), noise), len(grams), sum(counts))


def solve_together(arm: Arm, design: Design, own: Sequence[Motors], of_base: Momenta | None = None) -> Solution:
    """Energy, motor and momentum rows, each weighed by its noise. Raises Undecided as `solve`."""
    energy = Rows(design.z, design.w, design.noise)
    alone = solve(energy)
    noise = design.noise / max(len(design.w), 1)
    weighed = [(weight(arm, one, noise, alone.x), one.rows) for one in own]
    beside = [rows.times(factor) for factor, rows in weighed if factor > 0.0]
    so_far = solve(energy, beside) if beside else alone
    if of_base is None or of_base.arcs < LEAST_ARCS:
        return so_far
    owed = explained(of_base.rows.noise, so_far.x) / of_base.instants
    if not owed > 0.0:
        return so_far
    factor = explained(noise, so_far.x) / (MOMENTUM_CAUTION * owed)
    return solve(energy, [*beside, of_base.rows.times(factor)])

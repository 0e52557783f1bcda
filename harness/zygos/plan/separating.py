# SPDX-License-Identifier: MIT
"""The motion that separates hypotheses best: periodic motions and motions with stops are tried within the limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.dynamics.joints import Drives
from zygos.errors import Undecided, ZygosError
from zygos.plan.limits import Limits
from zygos.plan.series import Space
from zygos.simulation.scenario import Controller, Motion, Ramp, Scenario

Floats = NDArray[np.float64]

LONGEST_S = 60.0
"""Of a run that is planned, s."""
_PERIODS_S = (4.0, 8.0, 16.0, 32.0)
_HARMONICS = 3
_SLOTS_S = (5.0, 8.0)
"""From one stop to the next."""
_REST = 0.4
"""Share of it at rest."""
_BANDWIDTH_RAD_S = 6.0
_FEWEST_STOPS = 4
_LARGE = 2.0
"""Coordinate of a size of 88 % of what the limits permit."""
_SHARES = (1.0, 0.75, 0.5)
"""Of the limits, tried one after the other until the motion keeps them."""
_DRAWS = 2
"""Random motions of each kind."""


@dataclass(frozen=True)
class Separating:
    """A motion that separates hypotheses, ready to fly."""

    scenario: Scenario
    form: str
    """What kind of motion it is, in words."""
    z: float
    """Standard deviations by which the hypotheses are expected to be apart after one run."""
    tried: int
    """Number of motions that were judged."""


def most_separating(
    template: Scenario,
    names: list[str],
    limits: Limits,
    judge: Callable[[Scenario], float],
    *,
    needed: float,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> Separating:
    """The best of a few motions. template: all but the desired angles is taken from it. limits: finite ranges and
    rates. judge: standard deviations by which the hypotheses are apart after one run of a scenario; what it raises
    excludes the motion. needed: what is enough.

    Errors: Undecided where no motion that keeps the limits separates them.
    """
    best: tuple[float, str, Scenario] | None = None
    drawn = list(_candidates(template.duration_s, len(names), np.random.default_rng(seed)))
    judged, reason = 0, ""
    for k, (form, motions_within) in enumerate(drawn):
        progress(k / len(drawn))
        # a servo does not follow exactly, so that a smaller motion may keep limits that a larger one exceeds
        for share in _SHARES:
            motions = motions_within(_narrowed(limits, share))
            start = tuple(float(motion.desired(0.0)[0]) for motion in motions)
            scenario = replace(
                template, manoeuvre=dict(zip(names, motions, strict=True)), initial_angles_rad=start, seed=seed
            )
            try:
                z = judge(scenario)
            except ZygosError as error:
                reason = str(error).partition(";")[0]
                continue
            judged += 1
            if best is None or z > best[0]:
                best = z, form, scenario
            break
    if best is None:
        raise Undecided(f"none of {len(drawn)} motions can be flown; the last one: {reason}; remedy: other limits")
    if best[0] < needed:
        raise Undecided(
            f"none of {judged} motions within the limits separates them: the best by {best[0]:.2g} standard deviations "
            f"of {needed:g} that are needed; remedy: wider limits (--angle, --rate, --torque), or other sensors"
        )
    return Separating(best[2], best[1], best[0], judged)


def servo_of(arm: Arm, drives: Drives, postures: Floats) -> Controller:
    """A servo for an arm whose motion is not known beforehand. postures: (m, N) rad.

    A rigid joint is as stiff as the inertia at the postures permits at a bandwidth of 6 rad/s, a flexible one as its
    spring, both well damped. On the ground, where joints are rigid, a feedforward torque follows the motion.
    """
    inertia = 1.0 / np.diagonal(drives.mobility(postures), axis1=-2, axis2=-1).max(axis=0)
    soft = ~drives.rigid
    kp = np.where(soft, np.where(soft, drives.stiffness, 0.0), inertia * _BANDWIDTH_RAD_S**2)
    kd = np.where(soft, np.sqrt(kp * inertia), 2.0 * inertia * _BANDWIDTH_RAD_S)
    return Controller(_rounded(kp), _rounded(kd), feedforward=arm.grounded)


def _rounded(values: Floats) -> tuple[float, ...]:
    return tuple(float(f"{value:.3g}") for value in values.tolist())


def _narrowed(limits: Limits, share: float) -> Limits:
    """Limits with a share of their ranges and rates."""
    middle, half = 0.5 * (limits.low + limits.high), 0.5 * (limits.high - limits.low)
    return replace(limits, low=middle - share * half, high=middle + share * half, rate=share * limits.rate)


def _candidates(
    duration_s: float, joints: int, rng: np.random.Generator
) -> Iterator[tuple[str, Callable[[Limits], list[Motion]]]]:
    """Forms of motions, each as a function of the limits that it keeps."""
    for slot in _SLOTS_S:
        for _ in range(_DRAWS):
            # to and fro, so that every joint moves in both directions
            turns = np.arange(int(duration_s // slot))[:, None] + rng.integers(2, size=joints)
            goals = 0.5 * (turns % 2) + 0.5 * rng.uniform(size=turns.shape)
            if len(goals) >= _FEWEST_STOPS:
                yield f"moves with a stop every {slot:g} s", partial(_stops, goals, slot)
    for period in _PERIODS_S:
        for _ in range(_DRAWS):
            shape = rng.normal(size=joints * 2 * _HARMONICS)
            if duration_s >= 2.0 * period:
                yield f"sums of sines with a period of {period:g} s", partial(_sines, shape, period)


def _sines(shape: Floats, period_s: float, limits: Limits) -> list[Motion]:
    """A periodic motion that uses the limits. shape: coordinates of `Space`, of which the size is not read."""
    x = shape.reshape(len(limits.low), -1).copy()
    x[:, -2] = _LARGE
    return Space(limits, period_s, _HARMONICS).motion(x.ravel()).motions()


def _stops(goals: Floats, slot_s: float, limits: Limits) -> list[Motion]:
    """All joints move together from one posture to the next, and rest there. goals: (stops, N) shares of the range."""
    moving = (1.0 - _REST) * slot_s
    farthest = 0.98 * 2.0 / np.pi * limits.rate * moving
    place = [0.5 * (limits.low + limits.high)]
    for share in goals:
        goal = limits.low + share * (limits.high - limits.low)
        place.append(place[-1] + np.clip(goal - place[-1], -farthest, farthest))
    rest = _REST * slot_s
    return [
        Motion(
            float(place[0][j]),
            ramps=tuple(
                Ramp(k * slot_s + rest, moving, float(b[j] - a[j])) for k, (a, b) in enumerate(pairwise(place))
            ),
        )
        for j in range(len(limits.low))
    ]

"""The motion that separates hypotheses best: periodic motions and motions with stops are tried within the limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
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
    drawn = list(_candidates(limits, template.duration_s, np.random.default_rng(seed)))
    judged, reason = 0, ""
    for k, (form, motions) in enumerate(drawn):
        start = tuple(float(motion.desired(0.0)[0]) for motion in motions)
        scenario = replace(
            template, manoeuvre=dict(zip(names, motions, strict=True)), initial_angles_rad=start, seed=seed
        )
        progress(k / len(drawn))
        try:
            z = judge(scenario)
        except (ZygosError, Undecided) as error:
            reason = str(error).partition(";")[0]
            continue
        judged += 1
        if best is None or z > best[0]:
            best = z, form, scenario
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


def _candidates(limits: Limits, duration_s: float, rng: np.random.Generator) -> Iterator[tuple[str, list[Motion]]]:
    for slot in _SLOTS_S:
        for _ in range(_DRAWS):
            if duration_s >= 4.0 * slot:
                yield f"moves with a stop every {slot:g} s", _stops(limits, duration_s, slot, rng)
    for period in _PERIODS_S:
        if duration_s < 2.0 * period:
            continue
        space = Space(limits, period, _HARMONICS)
        for _ in range(_DRAWS):
            yield f"sums of sines with a period of {period:g} s", space.motion(space.draw(rng)).motions()


def _stops(limits: Limits, duration_s: float, slot_s: float, rng: np.random.Generator) -> list[Motion]:
    """All joints move together from one posture to the next, and rest there."""
    moving = (1.0 - _REST) * slot_s
    farthest = 0.98 * 2.0 / np.pi * limits.rate * moving
    count = int(duration_s // slot_s)
    place = [0.5 * (limits.low + limits.high)]
    for _ in range(count):
        goal = rng.uniform(limits.low, limits.high)
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

# SPDX-License-Identifier: MIT
"""What a motion tells about an arm that floats or has springs: it is simulated, and either the flight library
estimates, or the Cramér-Rao bound says what the frames tell at most.

Such an arm does not follow a desired motion, and its sigmas depend on angles and rates of base, links and motors, on
all sensors and on the balances that the library uses. A simulated run contains all of this.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import with_gains
from zygos.errors import Undecided, ZygosError
from zygos.estimation.estimate import estimate
from zygos.model.model import Model
from zygos.plan.expected import Expectation, common_sizes
from zygos.plan.limits import Limits
from zygos.plan.rows import Column
from zygos.plan.series import Space
from zygos.refinement.bound import ATOL, RTOL, bound_along, bounded, states_of
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

By = Literal["energy", "bound"]
"""Which standard deviations are expected: those of `zygos estimate`, or the smallest of any estimator."""

_RTOL, _ATOL = 1e-9, 1e-11
"""Tolerances of the integration where the library estimates: its errors are far below the noise of any sensor."""
_SHARE_OF_RUN = 0.3
"""Share of the progress that the simulation has where the bound follows."""
_NARROWER = 0.7
"""Factor on the width of the search after a motion that is not better; its inverse follows a better one twice."""


class _Told(NamedTuple):
    """What a simulated run tells; see `Expectation`."""

    columns: tuple[Column, ...]
    sigma: Floats
    size: Floats
    measure: float
    open: str | None = None


def expected_by_simulation(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    limits: Limits,
    progress: Callable[[float], None] = lambda share: None,
    *,
    by: By = "energy",
    within: bool = False,
) -> Expectation:
    """The sigmas of `zygos estimate` after a simulated run of a scenario, with the noise of its seed, or the bound.

    within: a motion that exceeds a limit is refused before its sigmas are computed. Errors: ZygosError if arm, model
    and scenario do not fit each other, or the motion diverges; as `bounded` where the bound is asked for.
    """
    if by == "bound":
        bounded(arm, model)  # refuses before the simulation
        run = simulate(
            arm, model, scenario, rtol=RTOL, atol=ATOL, progress=lambda share: progress(_SHARE_OF_RUN * share)
        )
    else:
        run = simulate(arm, model, scenario, noise=True, rtol=_RTOL, atol=_ATOL, progress=progress)
    excess = limits.violation(arm, run.q[0], run.qd[0], run.tau[0])
    if within and excess:
        raise ZygosError(f"{excess}; remedy: a wider limit, or a stiffer controller in the given scenario")
    told = _estimated(arm, model, run) if by == "energy" else _bound(arm, model, run, progress)
    return Expectation(
        scenario.name,
        told.columns,
        told.sigma,
        told.size,
        told.measure,
        run.q[0],
        run.qd[0],
        run.tau[0],
        arm.period_s,
        excess,
        told.open,
    )


def _estimated(arm: Arm, model: Model, run: Trajectory) -> _Told:
    """What the flight library says."""
    found = estimate(Run.of_cycles(arm, run.cycles()), model=model)
    known = {name: quantity.value for name, quantity in model.base_parameters(arm).items()}
    known |= {one.column(arm): one.value for one in with_gains(arm, model.effects)}
    columns = tuple(
        Column(name, unit, known.get(name, 0.0), name in arm.parameter_names)
        for name, unit in zip(found.names, found.units, strict=True)
    )
    value = np.abs([column.value for column in columns])
    share = np.where(value > 0.0, found.sigma / np.where(value > 0.0, value, 1.0), 1.0)
    share = np.where(np.isfinite(share), np.minimum(share, 1.0), 1.0)
    own = [column.structural and column.value != 0.0 for column in columns]
    sigma = np.asarray(found.sigma, dtype=np.float64)
    return _Told(columns, sigma, common_sizes(columns), float(np.mean(np.log(share[own]))))


def _bound(arm: Arm, model: Model, run: Trajectory, progress: Callable[[float], None]) -> _Told:
    """What the frames tell at most."""
    motion = bounded(arm, model)
    values = motion.values.tolist()
    columns = tuple(
        Column(name, unit, value, True)
        for name, unit, value in zip(arm.parameter_names, arm.parameter_units, values, strict=True)
    )
    relative = np.array([joint.torque_relative_sigma for joint in arm.joints])
    try:
        found = bound_along(
            motion,
            [(states_of(motion, run), run.tau[0, :-1])],
            relative,
            lambda share: progress(_SHARE_OF_RUN + (1.0 - _SHARE_OF_RUN) * share),
        )
    except Undecided as error:
        return _Told(columns, np.full(len(columns), np.nan), motion.size, math.inf, str(error).partition("; ")[0])
    return _Told(columns, found.sigma, found.size, math.log(found.mean_percent / 100.0))


@dataclass(frozen=True)
class Chosen:
    """The best motion of a search by simulation."""

    scenario: Scenario
    expectation: Expectation
    simulated: int
    """Number of simulated motions."""
    excluded: int
    """How many of them exceeded a limit, diverged, or did not determine all parameters."""


def search_by_simulation(
    arm: Arm,
    model: Model,
    template: Scenario,
    limits: Limits,
    period_s: float,
    harmonics: int,
    *,
    seed: int = 0,
    count: int = 24,
    by: By = "energy",
    progress: Callable[[float], None] = lambda share: None,
) -> Chosen:
    """The best of `count` simulated motions; all but the desired angles is that of the template.

    The first half are random Fourier motions within the limits; each of the others is drawn near the best so far, the
    nearer, the more of them were not better. Errors: ZygosError if none keeps the limits, and as `bounded` where the
    bound is asked for.
    """
    if by == "bound":
        bounded(arm, model)
    space = Space(limits, period_s, harmonics)
    rng = np.random.default_rng(seed)
    names = [joint.name for joint in arm.joints]
    best: tuple[float, Floats, Scenario, Expectation] | None = None
    reason, excluded, width = "", 0, 1.0
    for k in range(count):
        x = space.draw(rng)
        if best is None:
            # smaller motions, as long as none has kept the limits of the simulated run
            x.reshape(space.joints, -1)[:, -2] -= 0.5 * k
        elif 2 * k >= count:
            x = best[1] + width * rng.normal(size=space.size) * rng.choice([0.0, 1.0], space.size)
        motion = space.motion(x)
        scenario = replace(
            template,
            manoeuvre=dict(zip(names, motion.motions(), strict=True)),
            initial_angles_rad=tuple(motion.at(np.zeros(1))[0][0].tolist()),
        )
        expectation: Expectation | None = None

        def moved(share: float, k: int = k) -> None:
            progress((k + share) / count)

        try:
            expectation = expected_by_simulation(arm, model, scenario, limits, moved, by=by, within=True)
        except ZygosError as error:  # the motion diverges, or exceeds a limit
            reason = str(error)
        if expectation is not None and expectation.open:
            reason, expectation = f"{expectation.open}; remedy: a longer --duration", None
        excluded += expectation is None
        if expectation is not None and (best is None or expectation.measure < best[0]):
            best = (expectation.measure, x, scenario, expectation)
            width /= _NARROWER**2 if 2 * k >= count else 1.0
        elif 2 * k >= count:
            width *= _NARROWER
        width = min(width, 1.0)
        progress((k + 1) / count)
    if best is None:
        raise ZygosError(f"none of {count} motions can be used; the last one: {reason}")
    return Chosen(best[2], best[3], count, excluded)

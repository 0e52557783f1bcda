"""What a motion tells about an arm that floats or has springs: it is simulated, and the flight library estimates.

Such an arm does not follow a desired motion, and its sigmas depend on angles and rates of base, links and motors, on
all sensors and on the balances that the library uses. A simulated run contains all of this.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.effects import estimated
from zygos.errors import ZygosError
from zygos.estimation.estimate import estimate
from zygos.model.model import Model
from zygos.plan.expected import Expectation
from zygos.plan.limits import Limits
from zygos.plan.rows import Column
from zygos.plan.series import Space
from zygos.refinement.bound import bound_of, check_bounded
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

_RTOL, _ATOL = 1e-9, 1e-11
"""Tolerances of the integration: its errors are far below the noise of any sensor."""
_NARROWER = 0.7
"""Factor on the width of the search after a motion that is not better; its inverse follows a better one twice."""


Expected = Callable[[Scenario, Callable[[float], None]], Expectation]
"""What a motion tells, with a function that is called with the share of the work that is done."""


def expected_by_simulation(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    limits: Limits,
    progress: Callable[[float], None] = lambda share: None,
) -> Expectation:
    """The sigmas of `zygos estimate` after a simulated run of a scenario, with the noise of its seed.

    Errors: ZygosError if arm, model and scenario do not fit each other, or the motion diverges.
    """
    run = simulate(arm, model, scenario, noise=True, rtol=_RTOL, atol=_ATOL, progress=progress)
    found = estimate(Run.of_cycles(arm, run.cycles()), model=model)
    return _expectation(arm, model, scenario, limits, run, (found.names, found.units, found.sigma))


def expected_by_bound(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    limits: Limits,
    progress: Callable[[float], None] = lambda share: None,
) -> Expectation:
    """The smallest sigmas that any unbiased estimator can have after a simulated run of a scenario.

    Errors: ZygosError as `bound`, or if the motion diverges; Undecided if it does not determine all parameters.
    """
    check_bounded(arm, model)
    half = 0.5
    run = simulate(arm, model, scenario, rtol=_RTOL, atol=_ATOL, progress=lambda share: progress(half * share))
    (found,) = bound_of(arm, model, run, progress=lambda share: progress(half + (1.0 - half) * share))
    return _expectation(arm, model, scenario, limits, run, (found.names, found.units, found.sigma))


def _expectation(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    limits: Limits,
    run: Trajectory,
    found: tuple[Sequence[str], Sequence[str], Floats],
) -> Expectation:
    """What the first run of a trajectory tells: found are names, units and sigmas of its columns."""
    names, units, sigma = found
    known = {name: quantity.value for name, quantity in model.base_parameters(arm).items()}
    known |= {one.column(arm): one.value for one in estimated(arm, model.effects)}
    columns = tuple(
        Column(name, unit, known.get(name, 0.0), name in arm.parameter_names)
        for name, unit in zip(names, units, strict=True)
    )
    value = np.abs([column.value for column in columns])
    share = np.where(value > 0.0, sigma / np.where(value > 0.0, value, 1.0), 1.0)
    share = np.where(np.isfinite(share), np.minimum(share, 1.0), 1.0)
    own = [column.structural and column.value != 0.0 for column in columns]
    return Expectation(
        scenario.name,
        columns,
        np.asarray(sigma, dtype=np.float64),
        float(np.mean(np.log(share[own]))),
        run.q[0],
        run.qd[0],
        run.tau[0],
        arm.period_s,
        limits.violation(arm, run.q[0], run.qd[0], run.tau[0]),
    )


@dataclass(frozen=True)
class Chosen:
    """The best motion of a search by simulation."""

    scenario: Scenario
    expectation: Expectation
    simulated: int
    """Number of simulated motions."""
    excluded: int
    """How many of them exceeded a limit or diverged."""


def search_by_simulation(
    arm: Arm,
    template: Scenario,
    limits: Limits,
    period_s: float,
    harmonics: int,
    expected: Expected,
    *,
    seed: int = 0,
    count: int = 24,
    progress: Callable[[float], None] = lambda share: None,
) -> Chosen:
    """The best of `count` simulated motions by what is expected of them; all but the desired angles is that of the
    template.

    The first half are random Fourier motions within the limits; each of the others is drawn near the best so far, the
    nearer, the more of them were not better. Errors: ZygosError if none keeps the limits.
    """
    space = Space(limits, period_s, harmonics)
    rng = np.random.default_rng(seed)
    names = [joint.name for joint in arm.joints]

    def part_of(done: int, share: float) -> None:
        progress((done + share) / count)

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
        try:
            expectation = expected(scenario, partial(part_of, k))
        except ZygosError as error:  # the motion diverges, or does not determine all parameters
            reason = str(error)
        if expectation is not None and expectation.excess:
            reason = f"{expectation.excess}; remedy: a wider limit, or a stiffer controller in the given scenario"
            expectation = None
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

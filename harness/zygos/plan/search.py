# SPDX-License-Identifier: MIT
"""The search for the motion of an arm on the ground that tells most about its parameters.

The measure is the mean logarithm of the sigmas of the parameters' independent combinations: the logarithm of the
determinant of their covariance, from which offsets and friction have been eliminated, over twice their number. The best
motion depends neither on units nor on which parameters stand for a dependent set, and the measure has derivatives
(D-optimal design: Swevers et al., IEEE Transactions on Robotics and Automation 13, 1997). A joint that lingers near
standstill costs a little, because the sign of its friction is not certain there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from zygos.errors import ZygosError
from zygos.plan.limits import Limits
from zygos.plan.rows import Grounded
from zygos.plan.series import FourierMotion, Space

Floats = NDArray[np.float64]

_ROUNDS = 4
"""How often the search is repeated with a larger margin to the limits of the torque."""
_MARGIN = 0.97
"""Share of the limit of a torque within which the search stays; between its instants there may be a bit more."""
_STEP = 1e-6
"""Step of the numerical differentiation, rad or rad/s."""
_SLOW_RAD_S = 0.02
"""A joint that is slower than about this stands, for friction: its sign, and more of its law, are not certain there."""
_SLOW_COST = 0.03
"""What one instant costs at which a joint stands."""
_WEIGHT = 1e3
"""Weight of the square of a torque's excess, as a share of its limit, at one instant."""


@dataclass(frozen=True)
class Found:
    """The best motion of a search."""

    motion: FourierMotion
    measure: float
    """Mean logarithm of the sigmas of the parameters' independent combinations."""
    started: float
    """The same of the best random motion, from which the search began."""
    evaluations: int


class _Goal:
    """The measure and its derivatives with respect to the coordinates of a motion, over one period."""

    def __init__(self, arm: Grounded, space: Space, limits: Limits) -> None:
        self.arm, self.space = arm, space
        self.nodes = 2 * max(2, round(space.period_s / arm.increment_s)) + 1
        self.step = space.period_s / (self.nodes - 1)
        self.t: Floats = self.step * np.arange(self.nodes, dtype=np.float64)
        self.limit = arm.arm.gear_ratios * limits.torque * _MARGIN
        self.evaluations = 0
        unit = np.abs([column.value for column in arm.columns])
        self.unit = np.where(unit > 0.0, unit, np.median(unit[unit > 0.0]))

    def value(self, x: Floats) -> float:
        """The measure, plus what excessive torques cost; large where the motion does not determine all parameters."""
        angle, rate, _ = self.space.motion(x).at(self.t)
        return self._of(*self.arm.at(angle, rate))[0] + float(_standing(rate)[0].sum())

    def value_and_slope(self, x: Floats) -> tuple[float, Floats]:
        """As `value`, and its derivatives (size,)."""
        self.evaluations += 1
        angle, rate, _ = self.space.motion(x).at(self.t)
        momentum, force = self.arm.at(angle, rate)
        value, by_momentum, by_force = self._of(momentum, force)
        by_angle, by_rate = np.zeros_like(angle), np.zeros_like(rate)
        for j in range(self.arm.arm.n):
            shift = np.zeros_like(angle)
            shift[:, j] = _STEP
            for slope, of in ((by_angle, (angle + shift, rate)), (by_rate, (angle, rate + shift))):
                moved = self.arm.at(*of)
                slope[:, j] = np.einsum("tjc,tjc->t", by_momentum, moved[0] - momentum) / _STEP
                slope[:, j] += np.einsum("tjc,tjc->t", by_force, moved[1] - force) / _STEP
        standing, slope_of_standing = _standing(rate)
        by_rate += slope_of_standing
        angles, rates = self.space.derivatives(x, self.t)
        return value + float(standing.sum()), np.einsum("xtj,tj->x", angles, by_angle) + np.einsum(
            "xtj,tj->x", rates, by_rate
        )

    def _of(self, momentum: Floats, force: Floats) -> tuple[float, Floats, Floats]:
        """Value, and its derivatives with respect to the columns of momentum and force (m, N, c)."""
        arm, step = self.arm, self.step
        rows = arm.rows(momentum, force, step, 1) * self.unit / arm.impulse_sigma[:, None]
        p = arm.structural
        normal = np.einsum("kjc,kjd->cd", rows, rows)
        normal += 1e-12 * np.trace(normal) / len(normal) * np.eye(len(normal))
        (_, whole), (_, beside) = np.linalg.slogdet(normal), np.linalg.slogdet(normal[p:, p:])
        inverse = np.linalg.inv(normal)
        inverse[p:, p:] -= np.linalg.inv(normal[p:, p:])
        value = -(whole - beside) / (2 * p)
        by_rows = -(rows @ inverse) / p * self.unit / arm.impulse_sigma[:, None]
        by_momentum, by_force = np.zeros_like(momentum), np.zeros_like(force)
        by_momentum[2:] += by_rows
        by_momentum[:-2] -= by_rows
        for shift, weight in ((0, 1.0), (1, 4.0), (2, 1.0)):
            by_force[shift : len(by_force) - 2 + shift] -= weight * step / 3.0 * by_rows
        # torque from the change of momentum around each inner instant
        torque = ((momentum[2:] - momentum[:-2]) / (2.0 * step) - force[1:-1]) @ arm.coefficients
        over = np.maximum(np.abs(torque) / self.limit - 1.0, 0.0)
        cost = (2.0 * _WEIGHT * over * np.sign(torque) / self.limit)[..., None] * arm.coefficients
        by_momentum[2:] += cost / (2.0 * step)
        by_momentum[:-2] -= cost / (2.0 * step)
        by_force[1:-1] -= cost
        return float(value + _WEIGHT * np.sum(over**2)), by_momentum, by_force


def _standing(rate: Floats) -> tuple[Floats, Floats]:
    """Cost of the instants at which a joint stands, and its derivatives with respect to the rates; both (m, N)."""
    share = rate / _SLOW_RAD_S
    cost = _SLOW_COST * np.exp(-(share**2))
    return cost, -2.0 * share / _SLOW_RAD_S * cost


def search(
    arm: Grounded,
    limits: Limits,
    period_s: float,
    harmonics: int,
    *,
    seed: int = 0,
    starts: int = 40,
    iterations: int = 80,
    progress: Callable[[float], None] = lambda share: None,
) -> Found:
    """The best periodic motion within the limits that is at rest at its start and end.

    The best of `starts` random motions is improved by at most `iterations` steps of L-BFGS. progress is called with the
    share that is finished. Errors: ZygosError if no motion within the limits of the torque is found.
    """
    space = Space(limits, period_s, harmonics)
    goal = _Goal(arm, space, limits)
    rng = np.random.default_rng(seed)
    drawn = []
    for k in range(starts):
        x = space.draw(rng)
        drawn.append((goal.value(x), x))
        progress(0.1 * k / starts)
    started, x = min(drawn, key=lambda one: one[0])
    dense: Floats = period_s * np.arange(8 * goal.nodes, dtype=np.float64) / (8 * goal.nodes)
    steps = 0

    def count(_: Floats) -> None:
        nonlocal steps
        steps += 1
        progress(min(0.99, 0.1 + 0.9 * steps / iterations))

    excess: str | None = None
    for _ in range(_ROUNDS):
        result = minimize(
            goal.value_and_slope, x, jac=True, method="L-BFGS-B", callback=count, options={"maxiter": iterations}
        )
        x = result.x
        motion = space.motion(x)
        angle, rate, acceleration = motion.at(dense)
        torque = arm.torque(angle, rate, acceleration)
        excess = limits.violation(arm.arm, angle, rate, torque)
        if excess is None:
            return Found(motion, float(result.fun), float(started), goal.evaluations)
        over = np.abs(torque).max(axis=0) / limits.torque
        goal.limit = np.where(over > 1.0, goal.limit * _MARGIN / over, goal.limit)
    raise ZygosError(
        f"no motion within the limits was found: {excess}; remedy: raise the limit, or restrict the angles to postures "
        "in which gravity asks for less torque"
    )

# SPDX-License-Identifier: MIT
"""Integrals of sampled signals (docs/theory.md, "The energy balance").

Rates bend at every torque step, so a step is integrated from the instants up to its end alone: with the cubic through
the four newest values, and as a trapezoid where there are fewer than four.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def step_integrals(g: Floats, h: float, axis: int = -1) -> Floats:
    """Integral of g over each step between neighbouring instants, h seconds apart; one entry fewer along the axis.

    (h/24)(9 g_k + 19 g_k-1 - 5 g_k-2 + g_k-3) of the step up to the instant k, (h/2)(g_k + g_k-1) of the first two.
    """
    g = np.moveaxis(g, axis, -1)
    step = 0.5 * h * (g[..., 1:] + g[..., :-1])
    step[..., 2:] = (h / 24.0) * (9.0 * g[..., 3:] + 19.0 * g[..., 2:-1] - 5.0 * g[..., 1:-2] + g[..., :-3])
    return np.asarray(np.moveaxis(step, -1, axis), dtype=np.float64)


def from_first(steps: Floats, axis: int = -1) -> Floats:
    """Running sum of the steps between instants, 0 at the first instant; one entry more along the axis."""
    shape = list(steps.shape)
    shape[axis] += 1
    total = np.zeros(shape)
    rest = [slice(None)] * steps.ndim
    rest[axis] = slice(1, None)
    np.cumsum(steps, axis=axis, out=total[tuple(rest)])
    return total


def integral(g: Floats, h: float, axis: int = -1) -> Floats:
    """Integral of g from the first instant to each, shape of g."""
    return from_first(step_integrals(g, h, axis), axis)


def since_origin(total: Floats, arc: NDArray[np.int64]) -> Floats:
    """A running total (m,) less its value at the first instant of its arc; arc: (m,) number of the arc of each."""
    position = np.arange(len(arc))
    opens = np.diff(arc, prepend=-2) != 0
    return total - total[np.maximum.accumulate(np.where(opens, position, 0))]


@dataclass(frozen=True)
class FromOrigin:
    """Running totals of signals (..., m) that begin at 0 with their arc; what stands where there is no arc means
    nothing."""

    period_s: float
    arc: NDArray[np.int64] | None = None
    """(m,) number of the arc of each instant, -1 for none; None: all m are one arc."""

    def integral(self, g: Floats) -> Floats:
        """Integral of g, by `step_integrals`."""
        return self._begun(integral(g, self.period_s))

    def held(self, g: Callable[[int], Floats]) -> Floats:
        """Integral of a signal of m instants that jumps at each of them.

        g(i): (..., m - 1) its value for each step i instants before the step's end, as it is within the step; for i = 2
        and 3, the first two steps are not used.
        """
        h = self.period_s
        one, two = g(0), g(1)
        step = 0.5 * h * (one + two)
        step[..., 2:] = (h / 24.0) * (9.0 * one + 19.0 * two - 5.0 * g(2) + g(3))[..., 2:]
        return self._begun(from_first(step))

    def sum_before(self, x: Floats) -> Floats:
        """Sum of x from the arc's origin on up to the instant before."""
        return self._begun(from_first(x[..., :-1]))

    def _begun(self, total: Floats) -> Floats:
        return total if self.arc is None else since_origin(total, self.arc)

# SPDX-License-Identifier: MIT
"""Faults of angles and torques, detected by the laws of the motors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment, nnls

from zygos import limits
from zygos.audit.means import Array, Means, smooth_direction
from zygos.audit.remedies import KINDS, Kind
from zygos.audit.units import nearest, scales
from zygos.runs.cycles import Cycles


@dataclass(frozen=True)
class Change:
    """A fault, as the change that corrects it: link angle, motor angle and torque of joint i are `sign * scale` times
    those of the joints `source[kind][i]`; the two encoders of the joints in `exchanged` are exchanged."""

    what: str
    """Kind of fault: "inverted", "swapped", "exchanged", "scaled"."""
    kind: Kind | None = None
    """Field of `Cycles`; None where both angles are exchanged."""
    joints: tuple[int, ...] = ()
    source: tuple[int, ...] = ()
    factor: float = 1.0


NOTHING = Change("nothing")


def changed(cycles: Cycles, change: Change, zeros: dict[str, Array]) -> Cycles:
    """The run without the fault. zeros: (N,) for each kind of reading, the angles about which signs are inverted."""
    if change.what == "nothing":
        return cycles
    if change.what == "exchanged":
        q, theta = cycles.q.copy(), cycles.theta.copy()
        for i in change.joints:
            q[:, i], theta[:, i] = cycles.theta[:, i], cycles.q[:, i]
        return replace(cycles, q=q, theta=theta)
    assert change.kind is not None
    readings: Array = getattr(cycles, change.kind).copy()
    zero = zeros.get(change.kind, np.zeros(readings.shape[1])) * (change.what == "inverted")
    for i, j in zip(change.joints, change.source, strict=True):
        readings[:, i] = zero[i] + change.factor * (getattr(cycles, change.kind)[:, j] - zero[i])
    fields: dict[str, Any] = {change.kind: readings}
    return replace(cycles, **fields)


def _unexplained(y: Array, positive: Sequence[Array], free: Sequence[Array]) -> float:
    """Share of y, outside the span of the free columns, that no non-negative combination of `positive` explains."""
    basis, _ = np.linalg.qr(np.column_stack([c / max(float(np.linalg.norm(c)), 1e-300) for c in free]))

    def beside(x: Array) -> Array:
        out: Array = x - basis @ (basis.T @ x)
        return out

    target = beside(y)
    size = float(np.linalg.norm(target))
    if size <= 1e-9 * float(np.linalg.norm(y)) or size == 0.0:
        return 1.0
    columns = []
    for x in positive:
        rest = beside(x)
        length = float(np.linalg.norm(rest))
        if length > 1e-9 * max(float(np.linalg.norm(x)), 1e-300):
            columns.append(rest / length)
    if not columns:
        return 1.0
    _, left = nnls(np.column_stack(columns), target)
    return float(left) / size


def _law(means: Means, joint: int, q: list[Array], theta: list[Array], tau: Array) -> float:
    """Unexplained share of a torque under the motor's law (module docstring). Friction may have any value."""
    rate = theta[1]
    sense = smooth_direction(rate)
    if means.arm.joints[joint].flexible:
        return _unexplained(tau, [theta[2], theta[0] - q[0], theta[1] - q[1]], [means.one, rate, sense])
    free = [means.one]
    if means.arm.feels_gravity[joint]:
        free += [f(other[0]) for other in means.theta for f in (np.sin, np.cos)]
    return _unexplained(tau, [theta[2], rate, sense], free)


class Motors:
    """How well each fault of angles and torques of the joints explains the run."""

    def __init__(self, means: Means, use: Sequence[int]) -> None:
        """Take the joints in `use`, which move and whose signals work."""
        self.means, self.use = means, list(use)
        self.arm = means.arm
        rates = [
            max(abs(self._correlation(means.q[j][1], means.theta[i][1])) for j in self.use) if i in self.use else 0.0
            for i in range(self.arm.n)
        ]
        self.stiff = [
            joint.flexible and rate >= limits.STIFF.value for joint, rate in zip(self.arm.joints, rates, strict=True)
        ]
        self._known: dict[Any, tuple[float, ...]] = {}

    @staticmethod
    def _correlation(x: Array, y: Array) -> float:
        spread = float(np.std(x) * np.std(y))
        return float(np.mean((x - x.mean()) * (y - y.mean()))) / spread if spread > 0.0 else 0.0

    def score(self, joint: int, change: Change) -> float:
        """Logarithm of the unexplained part at a joint: of its torque, and for a stiff joint also of one rate by the
        other, which have the same scale."""
        return sum(math.log(max(share, 1e-6)) for share in self._shares(joint, change))

    def left(self, joint: int, change: Change) -> float:
        """Share of a joint's torque that the law of its motor does not explain."""
        return self._shares(joint, change)[0]

    def _shares(self, joint: int, change: Change) -> tuple[float, ...]:
        m = self.means
        source = {"q": joint, "theta": joint, "tau": joint}
        factor = {"q": 1.0, "theta": 1.0, "tau": 1.0}
        exchanged = change.what == "exchanged" and joint in change.joints
        if change.kind and joint in change.joints:
            source[change.kind] = change.source[change.joints.index(joint)]
            factor[change.kind] = change.factor
        key = (joint, *source.values(), *factor.values(), exchanged)
        if key not in self._known:
            q = [factor["q"] * x for x in m.q[source["q"]]]
            theta = [factor["theta"] * x for x in m.theta[source["theta"]]]
            if not self.arm.joints[joint].flexible:
                q = theta
            if exchanged:
                q, theta = theta, q
            shares = [_law(m, joint, q, theta, factor["tau"] * m.tau[source["tau"]][0])]
            if self.stiff[joint]:
                # the rates of a stiff joint are equal, so a wrong scale or sign shows as their difference
                left = np.std(theta[1] - q[1]) / max(float(np.std(theta[1])), float(np.std(q[1])), 1e-300)
                shares.append(float(left))
            self._known[key] = tuple(shares)
        return self._known[key]

    def total(self, change: Change) -> float:
        """Sum of the scores of the joints in use."""
        return sum(self.score(i, change) for i in self.use)

    def changes(self) -> Iterator[Change]:
        """The faults that are distinguished."""
        for i in self.use:
            flexible = self.arm.joints[i].flexible
            for kind in KINDS if flexible else KINDS[2:]:
                yield Change("inverted", kind, (i,), (i,), -1.0)
            if flexible and not self.stiff[i]:
                yield Change("exchanged", None, (i,))
            if flexible:
                for kind in KINDS[:2]:
                    factors = [scale.factor for scale in scales(self.arm, kind, i)]
                    if self.stiff[i]:
                        both = self.means.q[i][1], self.means.theta[i][1]
                        own, other = both if kind == "q" else both[::-1]
                        measured = float(np.std(other) / np.std(own))
                        known = nearest(scales(self.arm, kind, i), measured, limits.SCALE_OFF.value)
                        factors = [measured] if known is None else [measured, known.factor]
                    for factor in factors:
                        yield Change("scaled", kind, (i,), (i,), factor)
        for kind in KINDS:
            swap = self._best_assignment(kind)
            if swap is not None:
                yield swap

    def _best_assignment(self, kind: Kind) -> Change | None:
        joints = [i for i in self.use if kind == "tau" or self.arm.joints[i].flexible]
        if len(joints) < 2:
            return None
        costs = np.array([[self.score(i, Change("swapped", kind, (i,), (j,))) for j in joints] for i in joints])
        rows, columns = linear_sum_assignment(costs)
        moved = [(joints[r], joints[c]) for r, c in zip(rows, columns, strict=True) if r != c]
        if not moved:
            # the second best is reported as an alternative
            best = min(
                itertools.combinations(range(len(joints)), 2),
                key=lambda p: costs[p[0], p[1]] + costs[p[1], p[0]] - costs[p[0], p[0]] - costs[p[1], p[1]],
            )
            moved = [(joints[best[0]], joints[best[1]]), (joints[best[1]], joints[best[0]])]
        return Change("swapped", kind, tuple(i for i, _ in moved), tuple(j for _, j in moved))

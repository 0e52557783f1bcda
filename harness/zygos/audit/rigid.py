# SPDX-License-Identifier: MIT
"""Which reading is the torque of which joint, and with which sign and scale, by the law of the whole rigid arm.

The joint rows of all bodies, with Coulomb and viscous friction and an offset of each joint, are fitted to one half of a
run and predict the other. Every hypothesis about the torques has the same columns, so that none gains by freedom. A
joint's weight is the inverse of its own residual.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from zygos.arm import Arm
from zygos.audit.means import Array
from zygos.audit.units import FACTORS, scales
from zygos.balances.joint import in_order, increment_instants, joint_columns, joint_rows
from zygos.balances.state import State
from zygos.runs.cycles import Cycles
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth

INCREMENT_S = 0.2
"""Length of the increments, s."""
_HALF_STEPS = 10
"""Smallest number of steps of half an increment between instants at which columns are computed."""
MOST_CYCLES = 20_000
"""Largest number of cycles that are compared."""
_PIECE = 4_000
"""Number of smoothed instants whose columns are in memory at a time."""
_BLOCKS = 8
"""Number of blocks into which a run is cut; every second one belongs to the same half."""
_ROUNDS = 6
"""Number of times that the weights follow the residuals."""
_RIDGE = 1e-9
"""Weight of small parameters, as a share of the largest column: it decides about directions that no row determines."""
_LEAST = 1e-4
"""Smallest share of a torque that a residual is taken to be."""
_STATES = 200
"""Number of states at which the kinetic energy is looked at."""
_WIDEST = 1e4
"""Largest factor of a torque's scale that is tried."""
_STRIDE, _SEARCHES = 0.3, 20
"""How far a scale is searched to both sides of a first value, as its logarithm, and how often it is searched again from
the end of that range."""
_LOOSE = 0.1
"""Share of a torque by which its prediction from the other joints may be off."""


@dataclass(frozen=True)
class Reading:
    """A hypothesis: the torque of joint i is `factor[i]` times the reading of joint `source[i]`, its angle `angle[i]`
    times its reading, where -1 turns it about its zero."""

    source: tuple[int, ...]
    factor: tuple[float, ...]
    angle: tuple[float, ...]

    @classmethod
    def declared(cls, n: int) -> Reading:
        """The hypothesis that the arm file is right."""
        return cls(tuple(range(n)), (1.0,) * n, (1.0,) * n)

    def swapped(self, i: int, j: int) -> Reading:
        """Two torques exchanged in addition."""
        source = list(self.source)
        source[i], source[j] = source[j], source[i]
        return replace(self, source=tuple(source))

    def scaled(self, by: float, *joints: int) -> Reading:
        """The torques of joints multiplied in addition."""
        return replace(self, factor=tuple(f * by if i in joints else f for i, f in enumerate(self.factor)))

    def with_angles(self, by: float, *joints: int) -> Reading:
        """The angles of joints multiplied in addition."""
        return replace(self, angle=tuple(f * by if i in joints else f for i, f in enumerate(self.angle)))

    def differs(self, other: Reading) -> tuple[int, ...]:
        """Joints of which the two do not say the same."""
        return tuple(
            i
            for i in range(len(self.source))
            if (self.source[i], self.factor[i], self.angle[i]) != (other.source[i], other.factor[i], other.angle[i])
        )


@dataclass(frozen=True)
class Score:
    """How well a hypothesis predicts the half that it was not fitted to."""

    total: float
    """Sum over the joints of the logarithm of the residual, in units of the readings; infinite for a motion of negative
    kinetic energy."""
    share: Array
    """(N,) residual as a share of each torque; NaN where a joint has no rows."""


@dataclass(frozen=True)
class _Sums:
    """Products of columns and impulses over a part of a run, by joint: (N, p + 3N + N, ...) squared."""

    gram: Array
    rows: int


def with_angles(arm: Arm, cycles: Cycles, angle: tuple[float, ...]) -> Cycles:
    """The run under a hypothesis about the angles of its rigid joints: a factor in their unit, or -1 about the zero."""
    factor = np.array(angle)
    zero = np.array([joint.motor_encoder.zero_rad for joint in arm.joints])
    theta = factor * cycles.theta + np.where(factor < 0.0, (1.0 - factor) * zero, 0.0)
    return replace(cycles, q=theta, theta=theta)


class RigidLaw:
    """The law of a whole arm with a fixed base and rigid joints, for any hypothesis about its torques."""

    def __init__(self, arm: Arm, cycles: Cycles, broken: set[int]) -> None:
        """Take the first `MOST_CYCLES` cycles. broken: joints whose torque has no rows."""
        self.arm = arm
        self.cycles = Cycles(*(getattr(cycles, name)[:MOST_CYCLES] for name in Cycles.__dataclass_fields__))
        self.with_rows = [i for i in range(arm.n) if i not in broken]
        self._without: int | None = None
        self._sums: dict[tuple[float, ...], tuple[_Sums, ...]] = {}
        self._kinetic: dict[tuple[float, ...], Array] = {}
        self._scores: dict[Reading, Score] = {}

    @cached_property
    def enough(self) -> bool:
        """Whether each half has at least 3 times as many rows as the law has parameters."""
        halves = self._halves((1.0,) * self.arm.n)
        return bool(halves) and min(half.rows for half in halves) * len(self.with_rows) >= 3 * self.unknown

    @property
    def unknown(self) -> int:
        """Number of parameters: those of the arm, and three of each joint."""
        return len(self.arm.parameter_names) + 3 * self.arm.n

    def score(self, reading: Reading) -> Score:
        """The score of a hypothesis."""
        if reading not in self._scores:
            self._scores[reading] = self._score(reading)
        return self._scores[reading]

    def torque_changes(self, reading: Reading, use: Sequence[int]) -> Iterator[Reading]:
        """The same with one torque or all torques inverted, or two exchanged; currents have the scales that fit."""
        for one in self._torque_changes(reading, use):
            yield self.with_fitted_scales(one, use) if self.arm.torque_unit == "A" else one

    @staticmethod
    def _torque_changes(reading: Reading, use: Sequence[int]) -> Iterator[Reading]:
        for i in use:
            yield reading.scaled(-1.0, i)
        if len(use) > 1:
            yield reading.scaled(-1.0, *use)
        for i, j in itertools.combinations(use, 2):
            yield reading.swapped(i, j)

    def angle_changes(self, reading: Reading, use: Sequence[int]) -> Iterator[Reading]:
        """The same with the angles of all joints or of one in another unit, and with that of a joint inverted, alone or
        with its torque."""
        for factor in FACTORS["angle"].values():
            yield reading.with_angles(factor, *use)
        for i in use:
            for scale in scales(self.arm, "theta", i) if len(use) > 1 else ():
                yield reading.with_angles(scale.factor, i)
            yield reading.with_angles(-1.0, i)
            yield reading.with_angles(-1.0, i).scaled(-1.0, i)

    def rescaled(self, reading: Reading, joint: int) -> Reading:
        """The same with the scale of a torque that fits best, searched from what the other joints predict; unchanged
        where no other scale fits better."""

        def total(logarithm: float) -> float:
            return min(self._score(reading.scaled(math.exp(logarithm), joint)).total, 1e6)

        predicted = self._predicted_scale(reading, joint)
        if not 1.0 / _WIDEST < predicted < _WIDEST:
            return reading
        best = math.log(predicted)
        for _ in range(_SEARCHES):
            start = best
            limits = (start - _STRIDE, start + _STRIDE)
            best = float(minimize_scalar(total, bounds=limits, method="bounded", options={"xatol": 0.003}).x)
            if abs(best - start) < 0.9 * _STRIDE:
                break
        return reading.scaled(math.exp(best), joint) if total(best) < total(0.0) else reading

    def with_fitted_scales(self, reading: Reading, joints: Sequence[int]) -> Reading:
        """The same with the scales of torques that fit best beside each other, relative to the first of these joints: a
        linear fit in which they are unknowns beside the law's parameters. Signs remain."""
        halves = self._halves(reading.angle)
        used = [j for j in joints if j in self.with_rows]
        if not halves or len(used) < 2:
            return reading
        both = _Sums(halves[0].gram + halves[1].gram, halves[0].rows + halves[1].rows)
        # scales that fitted another hypothesis are no start
        reading = replace(reading, factor=tuple(math.copysign(1.0, f) for f in reading.factor))
        targets = {j: self._target(both, reading, j) for j in used}
        count, first, scale = self.unknown, used[0], dict.fromkeys(used, 1.0)
        rest = {j: size for j, (_, size) in targets.items()}
        for _ in range(_ROUNDS):
            a, right = np.zeros((count + len(used) - 1,) * 2), np.zeros(count + len(used) - 1)
            for place, j in enumerate(used, count - 1):
                own = targets[j][0] / rest[j]
                a[:count, :count] += own[:-1, :-1]
                if j == first:
                    right[:count] = own[:-1, -1]
                    continue
                a[:count, place] = a[place, :count] = -own[:-1, -1]
                a[place, place] = own[-1, -1]
            x = _regular(a, right)
            found = [1.0, *x[count:].tolist()]
            scale = {j: math.copysign(max(abs(one), 1.0 / _WIDEST), one) for j, one in zip(used, found, strict=True)}
            for j, (gram, whole) in targets.items():
                # a residual in units of the reading, because that of a small scale is small
                rest[j] = max(_square(gram, x[:count] / scale[j]), _LEAST**2 * whole) * scale[j] ** 2
        factor = [f * abs(scale.get(j, 1.0)) for j, f in enumerate(reading.factor)]
        return replace(reading, factor=tuple(factor))

    def _predicted_scale(self, reading: Reading, joint: int) -> float:
        """Scale of a joint's torque by which it follows from the parameters that the other joints' torques show."""
        halves = self._halves(reading.angle)
        others = [j for j in self.with_rows if j != joint]
        if not halves or not others or joint not in self.with_rows:
            return 1.0
        found = []
        for half in halves:
            x = self._fit(half, reading, others)
            targets = {j: self._target(half, reading, j) for j in others}
            normal = np.zeros((self.unknown + 1, self.unknown + 1))
            for gram, size in targets.values():
                rest = max(_square(gram, x), _LEAST**2 * size)
                normal[:-1, :-1] += gram[:-1, :-1] / rest
                normal[:-1, -1] += gram[:-1, -1] / rest
            own, size = self._target(half, reading, joint)
            weight = 1.0 / (_LOOSE**2 * size)
            # the scale takes the place of the joint's torque among the unknowns
            a = np.zeros((self.unknown + 1, self.unknown + 1))
            a[:-1, :-1] = normal[:-1, :-1] + weight * own[:-1, :-1]
            a[:-1, -1] = a[-1, :-1] = -weight * own[:-1, -1]
            a[-1, -1] = weight * own[-1, -1]
            right = np.append(normal[:-1, -1], 0.0)
            found.append(float(_regular(a, right)[-1]))
        return float(np.mean(found))

    # -- sums

    def taking(self, reading: Reading, other: RigidLaw, joints: Collection[int], block: int | None) -> RigidLaw:
        """This law with the torques of joints from another run of the same motion, and without a block of the run; for
        hypotheses with the angles of one."""
        mixed = copy(self)
        mixed._without, mixed._scores = block, {}
        chosen = np.isin(np.arange(self.arm.n), list(joints))[:, None, None]
        mixed._sums = {
            reading.angle: tuple(
                _Sums(np.where(chosen, theirs.gram, own.gram), min(own.rows, theirs.rows))
                for own, theirs in zip(self._blocks(reading.angle), other._blocks(reading.angle), strict=True)
            )
        }
        return mixed

    def _blocks(self, angle: tuple[float, ...]) -> tuple[_Sums, ...]:
        """The sums of each block; none for a run that is too short."""
        if angle not in self._sums:
            self._sums[angle] = self._products(angle)
        return self._sums[angle]

    def _halves(self, angle: tuple[float, ...]) -> tuple[_Sums, _Sums] | tuple[()]:
        blocks = self._blocks(angle)
        if not blocks:
            return ()
        used = [(k, block) for k, block in enumerate(blocks) if k != self._without]
        one, other = (
            _Sums(
                sum((b.gram for k, b in used if k % 2 == side), np.zeros(())),
                sum(b.rows for k, b in used if k % 2 == side),
            )
            for side in (0, 1)
        )
        return (one, other) if one.rows and other.rows else ()

    def _products(self, angle: tuple[float, ...]) -> tuple[_Sums, ...]:
        """The sums of each block, with the angles of joints multiplied; none for a run that is too short."""
        arm = self.arm
        samples = calibrate(arm, with_angles(arm, self.cycles, angle))
        smoothed = smooth(arm, samples)
        if len(smoothed.index) == 0:
            return ()
        friction = _friction(arm, smoothed)
        blocks: list[Array] = []
        for piece in _pieces(smoothed):
            rows = _columns(arm, samples, smoothed.part(piece), friction[piece])
            if rows is not None:
                blocks.append(rows)
        if not blocks:
            return ()
        some = np.unique(np.linspace(0, len(smoothed.index) - 1, _STATES, dtype=int))
        state = State.smoothed(arm, smoothed.part(some))
        columns = joint_columns(arm, state)
        momentum = in_order(arm, columns.momentum, columns.rotor_momentum)
        self._kinetic[angle] = np.einsum("mj,mjp->p", state.qd, momentum)
        rows = np.concatenate(blocks)
        number = np.arange(len(rows)) * _BLOCKS // len(rows)
        whole = np.append(True, number[1:] == number[:-1])  # neighbours share half of their time
        blocks = [rows[whole & (number == block)] for block in range(_BLOCKS)]
        return tuple(_Sums(np.einsum("mja,mjb->jab", block, block), len(block)) for block in blocks)

    # -- fits

    def _score(self, reading: Reading) -> Score:
        halves = self._halves(reading.angle)
        n = self.arm.n
        if not halves:
            return Score(math.inf, np.full(n, math.nan))
        left, size = np.zeros(n), np.zeros(n)
        energy = 0.0
        for train, test in (halves, halves[::-1]):
            x = self._fit(train, reading)
            energy += float(self._kinetic[reading.angle] @ x[: len(self._kinetic[reading.angle])])
            for j in self.with_rows:
                gram, target = self._target(test, reading, j)
                left[j] += max(_square(gram, x), _LEAST**2 * target)
                size[j] += target
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.sqrt(left / size)
        scale = np.abs(self.arm.gear_ratios * np.array(reading.factor))
        used = self.with_rows
        total = float(np.sum(0.5 * np.log(np.maximum(left[used], 1e-300)) - np.log(scale[used])))
        return Score(total if energy > 0.0 else math.inf, np.where(size > 0.0, share, math.nan))

    def _target(self, half: _Sums, reading: Reading, j: int) -> tuple[Array, float]:
        """Products of the columns and the torque of a joint, and the square of the torque beside its mean."""
        count = self.unknown
        weight = self.arm.gear_ratios[j] * reading.factor[j]
        place = count + reading.source[j]
        keep = [*range(count), place]
        gram = half.gram[j][np.ix_(keep, keep)].copy()
        gram[-1, :] *= weight
        gram[:, -1] *= weight
        offset = len(self.arm.parameter_names) + 3 * j + 2
        mean = gram[offset, -1] ** 2 / gram[offset, offset] if gram[offset, offset] > 0.0 else 0.0
        return gram, max(float(gram[-1, -1] - mean), 1e-300)

    def _fit(self, half: _Sums, reading: Reading, joints: Sequence[int] | None = None) -> Array:
        """(p + 3N,) parameters by weighted least squares on the rows of joints; friction is not negative."""
        targets = {j: self._target(half, reading, j) for j in (self.with_rows if joints is None else joints)}
        variance = {j: size / half.rows for j, (_, size) in targets.items()}
        x = np.zeros(self.unknown)
        for _ in range(_ROUNDS):
            normal = sum((gram / variance[j] for j, (gram, _) in targets.items()), np.zeros((1, 1)))
            x = self._solved(normal)
            for j, (gram, size) in targets.items():
                variance[j] = max(_square(gram, x), _LEAST**2 * size) / half.rows
        return x

    def _solved(self, normal: Array) -> Array:
        scale = np.sqrt(np.diag(normal)[:-1])
        used = scale > 0.0
        first = len(self.arm.parameter_names)
        x = np.zeros(len(scale))
        for _ in range(4):
            x[:] = 0.0
            x[used] = _regular(normal[:-1, :-1][np.ix_(used, used)], normal[:-1, -1][used])
            negative = np.zeros(len(x), dtype=np.bool_)
            for kind in (0, 1):
                negative[first + kind :: 3] = x[first + kind :: 3] < 0.0
            if not negative.any():
                break
            used &= ~negative
        return np.maximum(x, np.where(_is_friction(len(x), first), 0.0, -np.inf))


def _square(gram: Array, x: Array) -> float:
    """Sum of the squares of what a fit leaves."""
    return float(gram[-1, -1] - 2 * x @ gram[:-1, -1] + x @ gram[:-1, :-1] @ x)


def _regular(a: Array, b: Array) -> Array:
    """Solution of normal equations; directions that no row determines are 0."""
    scale = np.sqrt(np.diag(a))
    scale = np.where(scale > 0.0, scale, 1.0)
    x: Array = np.linalg.solve(a / np.outer(scale, scale) + _RIDGE * np.eye(len(b)), b / scale) / scale
    return x


def _is_friction(count: int, first: int) -> NDArray[np.bool_]:
    place = np.arange(count) - first
    chosen: NDArray[np.bool_] = (place >= 0) & (place % 3 < 2)
    return chosen


def _friction(arm: Arm, smoothed: Smoothed) -> Array:
    """(m, N, 3) Coulomb friction, viscous friction and offset at the smoothed instants, before integration."""
    sense = np.tanh(smoothed.qd / 0.01)
    return np.stack([sense, smoothed.qd, np.ones_like(sense)], axis=-1)


def _pieces(smoothed: Smoothed) -> Iterator[NDArray[np.int64]]:
    """Positions of the instants of each piece of a segment."""
    for number in np.unique(smoothed.segment):
        of = np.flatnonzero(smoothed.segment == number)
        yield from np.array_split(of, max(1, math.ceil(len(of) / _PIECE)))


def _columns(arm: Arm, samples: Samples, smoothed: Smoothed, friction: Array) -> Array | None:
    """(m, N, p + 3N + N) columns of the increments of a piece, and the impulses of all torque readings; None for a
    piece that is too short."""
    half = increment_instants(arm, INCREMENT_S) // 2
    every = max(k for k in range(1, half + 1) if half % k == 0 and (k == 1 or half >= _HALF_STEPS * k))
    rows = joint_rows(arm, samples, smoothed, INCREMENT_S, every=every)
    if rows.count == 0:
        return None
    n, h = arm.n, arm.period_s
    running = np.concatenate([np.zeros((1, n, 3)), np.cumsum(0.5 * h * (friction[1:] + friction[:-1]), axis=0)])
    own = running[rows.end] - running[rows.begin]
    spread = np.zeros((rows.count, n, n, 3))
    spread[:, np.arange(n), np.arange(n)] = own
    impulse = rows.w / arm.gear_ratios  # of the readings, before the gear
    return np.concatenate(
        [rows.z, spread.reshape(rows.count, n, 3 * n), np.broadcast_to(impulse[:, None, :], (rows.count, n, n))],
        axis=-1,
    )

"""One solution for all readings of a record: a filter of state and bias over its blocks, with what the constants move.

A Kalman filter that takes the constants as known follows the changes of state and bias, and leaves innovations. Beside
it goes what a change of each constant does to them, so that the constants follow from least squares over all
innovations, each divided by its deviation (docs/theory.md, "All readings at once").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dtrtrs
from threadpoolctl import threadpool_limits

from zygos.arm import Arm
from zygos.native.flight import CHANNELS
from zygos.refinement.blocks import Linear, torque_steps

Floats = NDArray[np.float64]

_WAY = 120
"""Blocks, at most, at which the way of the estimate is kept."""


@dataclass(frozen=True)
class Start:
    """Where a solution begins: p parameters in SI units, and 4N constants beside them: friction of each rotor, Nm, the
    offset of each torque, Nm before the gear, and the zeros of link and motor encoders, rad."""

    value: Floats
    """(p,)."""
    beside: Floats
    """(4N,)."""


@dataclass(frozen=True)
class Prior:
    """What is known of the c constants of `Linear` without the readings, and which of them are solved for."""

    unit: Floats
    """(c,) units of their changes, SI units."""
    solved: NDArray[np.int64]
    """(s,) which of them are solved for, parameters first; the others do not change."""
    root: Floats
    """(s, s) and"""
    pull: Floats
    """(s,): what is known is the sum of squares |root z + pull|^2 of the changes z."""

    def beside(self, found: Floats, more: Sequence[int] = ()) -> Floats:
        """(s + e + 1, s + e + 1) `Pass.triangle` with the prior, of what is solved for and of e constants more."""
        columns = [*self.solved.tolist(), *more, len(self.unit)]
        known = np.zeros((len(self.root), len(columns)))
        known[:, : len(self.root)] = self.root
        known[:, -1] = self.pull
        return triangle_of(np.concatenate([found[:, columns], known]))


@dataclass(frozen=True)
class Pass:
    """What one solution has found; p parameters, 4N constants beside them."""

    value: Floats
    """(p,) parameters, SI units."""
    covariance: Floats
    """(p, p)."""
    beside: Floats
    """(4N,) friction, offsets and zeros, as in `Start`."""
    beside_sigma: Floats
    """(4N,)."""
    deviance: float
    """Sum of ln s + e^2/s over all innovations e with variances s: the lower, the more the readings favour the
    noise that was assumed. Comparable where the linear motion is the same."""
    triangle: Floats
    """(c + 1, c + 1) upper triangular R: |R (z, 1)|^2 is the sum of the squared innovations, each divided by its
    variance, for the changes z of all constants of `Linear`, in units of `Prior.unit`."""
    squares: Floats
    """(n, channels) normalised squared innovations of each SYNC that was read, summed over the sensors of a channel;
    of all pieces one after the other. Those of a block are spread evenly. Empty where they were not asked for."""
    counts: Floats
    """(channels,) readings of a SYNC."""
    way: tuple[tuple[int, Floats, Floats], ...]
    """At some instants the number of SYNCs read, the parameters and their standard deviations, (p,) each."""
    states: Floats
    """(B, W + 4N) states at the first SYNCs of the blocks, from all readings; empty where they were not asked for."""


@dataclass
class _Memory:
    """What is kept of the blocks for their states and innovations; c constants, f entries of state and bias."""

    moved: list[Floats]
    """(f, c + 1) changes of state and bias at the beginning, from the readings so far and by each constant."""
    ahead: list[Floats]
    """(f, c + 1) the same at the end."""
    back: list[Floats]
    """(f, f) what a change at the end says of that at the beginning."""
    shares: list[Floats]
    """(d r, c + 1) innovations divided by their deviations."""
    way: list[tuple[int, Floats]]
    """Blocks and the triangle so far."""


def follow(linear: Linear, relative: Floats, start: Start, prior: Prior, *, keep: bool = False) -> Pass:
    """Solve for all constants, states and biases, from the motion around `start`.

    relative: (N,) noise of the torques as a share of their size. keep: also states, innovations and the way of the
    estimate.
    """
    blocks = linear.blocks
    arm, p = blocks.record.arm, len(start.value)
    with threadpool_limits(1):  # many small matrices, for which more threads only wait for each other
        triangle, volume, memory = _filter(linear, relative, prior.unit, keep)
    posterior = prior.beside(triangle)
    change = np.zeros(len(prior.unit) + 1)
    change[-1] = 1.0
    change[prior.solved] = -solve_triangular(posterior[:-1, :-1], posterior[:-1, -1])
    root = np.zeros((len(prior.unit), len(prior.solved)))
    root[prior.solved] = solve_triangular(posterior[:-1, :-1], np.eye(len(prior.solved)))
    root *= prior.unit[:, None]
    moved = prior.unit * change[:-1]
    last = p + len(start.beside)
    deviance = volume + float(posterior[-1, -1] ** 2 + 2.0 * np.sum(np.log(np.abs(np.diag(posterior)[:-1]))))
    width = 0 if not arm.free else 3 if arm.spatial else 1
    return Pass(
        start.value + moved[:p],
        root[:p] @ root[:p].T,
        start.beside + moved[p:last],
        np.sqrt(np.sum(root[p:last] ** 2, axis=1)),
        deviance,
        triangle,
        _squares(linear, memory, change) if keep else np.zeros((0, len(CHANNELS))),
        np.array([arm.n, arm.n, width], dtype=np.float64),
        _way(linear, memory, start, prior) if keep else (),
        linear.states + _smoothed(memory, change, blocks.first, linear.of_state.shape[-1])
        if keep
        else np.zeros((0, linear.of_state.shape[-1])),
    )


def _sensors(arm: Arm) -> Floats:
    """(r,) noise of link encoders, motor encoders and base rates, rad and rad/s."""
    wire = arm.over_the_wire
    width = 0 if not arm.free else 3 if arm.spatial else 1
    encoders = [one.link_encoder for one in wire.joints] + [one.motor_encoder for one in wire.joints]
    return np.array([one.sigma_rad for one in encoders] + [wire.imu.rate_sigma] * width)


def _filter(linear: Linear, relative: Floats, unit: Floats, keep: bool) -> tuple[Floats, float, _Memory]:
    """The triangle of `Pass`, the sum of ln s of all innovations, and what was to be kept."""
    blocks = linear.blocks
    arm, count = blocks.record.arm, len(linear.error)
    d, r, x = linear.of_state.shape[1:]
    c, width = len(unit), r - 2 * arm.n
    fast = x + width
    sensors = np.repeat(_sensors(arm), d)
    walk = arm.imu.bias_walk * math.sqrt(arm.period_s * blocks.cycles)

    def by_sensor(values: Floats) -> Floats:
        """(B, r d, ..) of (B, d, r, ..)."""
        return np.swapaxes(values, 1, 2).reshape(count, r * d, *values.shape[3:])

    noise = linear.noise(torque_steps(arm), relative)
    look = np.zeros((count, r * d, fast))
    look[:, :, :x] = by_sensor(linear.of_state)
    for k in range(width):
        rows = slice((2 * arm.n + k) * d, (2 * arm.n + k + 1) * d)
        look[:, rows, x + k] = blocks.kept.sum(axis=1)
    shapes = linear.noise_across.shape[2]
    heard = by_sensor(np.einsum("bdrsn,bnst->bdrtn", linear.of_noise, noise)).reshape(count, r * d, -1)
    pushed = np.einsum("bxsn,bnst->bxtn", linear.noise_across, noise).reshape(count, x, -1)
    seen = np.concatenate([by_sensor(linear.of_constant) * unit, -by_sensor(linear.error)[..., None]], axis=2)
    added = np.concatenate([linear.constant_across * unit, linear.gap[..., None]], axis=2)

    m, torques = r * d, shapes * arm.n
    front = np.zeros((m + fast + torques, m + fast + torques))
    after = np.zeros((fast + torques + width, fast))
    after[fast + torques :, x:] = walk * np.eye(width)
    across = np.eye(fast)
    memory = _Memory([], [], [], [], [])
    marks = set(np.linspace(0, count, min(_WAY, count) + 1).astype(int)[1:].tolist()) if keep else {count}
    rows: list[Floats] = []
    triangle, volume, piece = np.zeros((c + 1, c + 1)), 0.0, 0
    moved, root = np.zeros((fast, c + 1)), np.zeros((fast, fast))
    place, diagonal = np.arange(m), np.arange(fast, fast + torques) + m
    for k in range(count):
        if blocks.first[k]:
            begin, sigma = blocks.begins[piece]
            moved = np.zeros((fast, c + 1))
            moved[:x, -1] = begin[:x] - linear.states[k]
            moved[x:, -1] = begin[x:]
            root, piece = np.diag(sigma), piece + 1
        # the transpose of [[noise, seen roots], [0, roots]] of readings, state, bias, and shapes of the torques
        front[:] = 0.0
        front[place, place] = sensors
        front[m : m + fast, :m] = (look[k] @ root).T
        front[m + fast :, :m] = heard[k].T
        front[m : m + fast, m : m + fast] = root.T
        front[diagonal, diagonal] = 1.0
        upper = np.linalg.qr(front, mode="r")
        share = dtrtrs(upper[:m, :m], seen[k] + look[k] @ moved, trans=1)[0]
        volume += 2.0 * float(np.sum(np.log(np.abs(np.diag(upper)[:m]))))
        rows.append(share)
        moved = moved - upper[:m, m : m + fast].T @ share
        torque = -upper[:m, m + fast :].T @ share
        across[:x, :x] = linear.across[k]
        ahead = across @ moved
        ahead[:x] += pushed[k] @ torque + added[k]
        own = upper[m:, m:]
        after[: fast + torques] = own[:, :fast] @ across.T
        after[: fast + torques, :x] += own[:, fast:] @ pushed[k].T
        if keep:
            turn, next_root = np.linalg.qr(after)
            memory.back.append(own[:, :fast].T @ dtrtrs(next_root, turn[: fast + torques].T)[0].T)
            memory.moved.append(moved)
            memory.ahead.append(ahead)
            memory.shares.append(share)
        else:
            next_root = np.linalg.qr(after, mode="r")
        root, moved = next_root.T, ahead
        if len(rows) * m > 8 * c or k + 1 in marks:
            triangle = triangle_of(np.concatenate([triangle, *rows]))
            rows = []
            if keep and k + 1 in marks:
                memory.way.append((k + 1, triangle))
    return triangle, volume, memory


def _squares(linear: Linear, memory: _Memory, change: Floats) -> Floats:
    """As `Pass.squares`."""
    blocks = linear.blocks
    arm, d = blocks.record.arm, linear.error.shape[1]
    left = np.stack(memory.shares) @ change
    own = np.square(left).reshape(len(left), -1, d).sum(axis=2) + linear.rest / _sensors(arm) ** 2
    channel = np.repeat(np.arange(3), [arm.n, arm.n, own.shape[1] - 2 * arm.n])
    sums = np.stack([own[:, channel == one].sum(axis=1) for one in range(len(CHANNELS))], axis=1)
    read = blocks.read.sum(axis=1)
    return np.repeat(sums / np.maximum(read, 1)[:, None], read, axis=0)


def _smoothed(memory: _Memory, change: Floats, first: NDArray[np.bool_], x: int) -> Floats:
    """(B, x) changes of the states at the first SYNCs of the blocks, from all readings."""
    states = np.empty((len(first), len(memory.back[0])))
    for k in range(len(first) - 1, -1, -1):
        states[k] = memory.moved[k] @ change
        if k + 1 < len(first) and not first[k + 1]:
            states[k] += memory.back[k] @ (states[k + 1] - memory.ahead[k] @ change)
    return states[:, :x]


def _way(linear: Linear, memory: _Memory, start: Start, prior: Prior) -> tuple[tuple[int, Floats, Floats], ...]:
    """As `Pass.way`."""
    p, read = len(start.value), np.cumsum(linear.blocks.read.sum(axis=1))
    way = []
    for block, found in memory.way:
        posterior = prior.beside(found)[:-1]
        # the parameters are the first constants that are solved for
        root = linear.size[:, None] * solve_triangular(posterior[:, :-1], np.eye(len(posterior)))[:p]
        way.append((int(read[block - 1]), start.value - root @ posterior[:, -1], np.sqrt(np.sum(root**2, axis=1))))
    return tuple(way)


def triangle_of(rows: Floats) -> Floats:
    """The upper triangular R with R' R = rows' rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)

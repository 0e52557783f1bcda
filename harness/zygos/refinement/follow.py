# SPDX-License-Identifier: MIT
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
from zygos.refinement.blocks import Linear, Slopes, torque_steps
from zygos.refinement.motion import base_rates

Floats = NDArray[np.float64]

_WAY = 120
"""Blocks, at most, at which the way of the estimate is kept."""
_ROWS = 8
"""Innovations that are gathered before they are reduced to a triangle, as a multiple of the constants."""


@dataclass(frozen=True)
class Start:
    """Where a solution begins: p parameters in SI units, and 5N constants beside them: friction of each rotor, Nm, the
    offset of each torque, Nm before the gear, its gain, the share by which it exceeds the reported one, and the zeros
    of link and motor encoders, rad."""

    value: Floats
    """(p,)."""
    beside: Floats
    """(5N,)."""


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
    """What one solution has found; p parameters, 5N constants beside them."""

    value: Floats
    """(p,) parameters, SI units."""
    covariance: Floats
    """(p, p)."""
    beside: Floats
    """(5N,) as in `Start`."""
    beside_sigma: Floats
    """(5N,)."""
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
    width = base_rates(arm)
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
        linear.states + _smoothed(linear, memory, change) if keep else np.zeros((0, linear.states.shape[1])),
    )


def _sensors(arm: Arm) -> Floats:
    """(r,) noise of link encoders, motor encoders and base rates, rad and rad/s."""
    wire = arm.over_the_wire
    width = base_rates(arm)
    encoders = [one.link_encoder for one in wire.joints] + [one.motor_encoder for one in wire.joints]
    return np.array([one.sigma_rad for one in encoders] + [wire.imu.rate_sigma] * width)


def _filter(linear: Linear, relative: Floats, unit: Floats, keep: bool) -> tuple[Floats, float, _Memory]:
    """The triangle of `Pass`, the sum of ln s of all innovations, and what was to be kept."""
    blocks, c = linear.blocks, len(unit)
    arm, count, x = blocks.record.arm, *linear.states.shape
    width = base_rates(arm)
    walk = arm.imu.bias_walk * math.sqrt(arm.period_s * blocks.cycles)
    noise = linear.noise(torque_steps(arm), relative)
    reading = _Table(linear.reading, unit, noise, -linear.error)
    end = _Table(linear.end, unit, noise, linear.gap)
    sensors = np.repeat(_sensors(arm), blocks.kept.shape[2])
    m, fast = len(sensors), x + width
    # of the rates, sensors see the biases too
    biased = np.concatenate([np.zeros((2 * arm.n, width)), np.eye(width)])
    looks = np.concatenate([reading.state, np.kron(biased, blocks.kept.sum(axis=1)[:, :, None])], axis=2)
    across, across_noise = np.eye(fast), np.zeros((fast, reading.noise.shape[2]))
    memory = _Memory([], [], [], [], [])
    marks = set(np.linspace(0, count, min(_WAY, count) + 1).astype(int)[1:].tolist()) if keep else {count}
    begins = iter(blocks.begins)
    shares: list[Floats] = []
    triangle, volume = np.zeros((c + 1, c + 1)), 0.0
    moved, root = np.zeros((fast, c + 1)), np.eye(fast)
    for k in range(count):
        if blocks.first[k]:
            begin, sigma = next(begins)
            moved, root = np.zeros_like(moved), np.diag(sigma)
            moved[:, -1] = begin - np.concatenate([linear.states[k], np.zeros(width)])
        upper = _read(sensors, looks[k] @ root, reading.noise[k], root)
        share = dtrtrs(upper[:m, :m], reading.constant[k] + looks[k] @ moved, trans=1)[0]
        gain, own = upper[:m, m:].T @ share, upper[m:, m:]
        volume += 2.0 * float(np.sum(np.log(np.abs(np.diag(upper)[:m]))))
        moved = moved - gain[:fast]
        across[:x, :x], across_noise[:x] = end.state[k], end.noise[k]
        ahead = across @ moved - across_noise @ gain[fast:]
        ahead[:x] += end.constant[k]
        # the roots of state and bias, torques and walks of the bias, transposed
        after = np.zeros((len(own) + width, fast))
        after[: len(own)] = own[:, :fast] @ across.T + own[:, fast:] @ across_noise.T
        after[len(own) :, x:] = walk * np.eye(width)
        if keep:
            turn, following = np.linalg.qr(after)
            memory.back.append(own[:, :fast].T @ dtrtrs(following, turn[: len(own)].T)[0].T)
            memory.moved.append(moved)
            memory.ahead.append(ahead)
            memory.shares.append(share)
        else:
            following = triangle_of(after)
        root, moved = following.T, ahead
        shares.append(share)
        if len(shares) * m > _ROWS * c or k + 1 in marks:
            triangle = triangle_of(np.concatenate([triangle, *shares]))
            shares = []
        if keep and k + 1 in marks:
            memory.way.append((k + 1, triangle))
    return triangle, volume, memory


class _Table:
    """Derivatives of k numbers of each block as the filter takes them: by the state (B, k, x), by torques with the
    standard deviation 1 (B, k, L N), and by the constants in their units with what is left without changes
    (B, k, c + 1)."""

    def __init__(self, slopes: Slopes, unit: Floats, noise: Floats, left: Floats) -> None:
        """noise: (B, N, L, L) as `Linear.noise`; left: (B, k)."""
        self.state = slopes.of_state
        own = np.moveaxis(slopes.of_torque, 3, 1) @ noise
        self.noise = np.swapaxes(own, 1, 2).reshape(*left.shape, -1)
        self.constant = np.concatenate([slopes.of_constant * unit, left[..., None]], axis=2)


def _read(sensors: Floats, seen: Floats, heard: Floats, root: Floats) -> Floats:
    """The upper triangular U with U' U = F F' of F = [[noise, seen, heard], [0, root, 0], [0, 0, 1]]: readings with
    the noise (m,), state and bias, and torques."""
    m, fast, torques = len(sensors), len(root), heard.shape[1]
    front = np.zeros((m + fast + torques, m + fast + torques))
    front[range(m), range(m)] = sensors
    front[m : m + fast, :m] = seen.T
    front[m + fast :, :m] = heard.T
    front[m : m + fast, m : m + fast] = root.T
    front[m + fast :, m + fast :] = np.eye(torques)
    return triangle_of(front)


def _squares(linear: Linear, memory: _Memory, change: Floats) -> Floats:
    """As `Pass.squares`."""
    blocks = linear.blocks
    arm, d = blocks.record.arm, blocks.kept.shape[2]
    left = np.stack(memory.shares) @ change
    own = np.square(left).reshape(len(left), -1, d).sum(axis=2) + linear.rest / _sensors(arm) ** 2
    channel = np.repeat(np.arange(3), [arm.n, arm.n, own.shape[1] - 2 * arm.n])
    sums = np.stack([own[:, channel == one].sum(axis=1) for one in range(len(CHANNELS))], axis=1)
    read = blocks.read.sum(axis=1)
    return np.repeat(sums / np.maximum(read, 1)[:, None], read, axis=0)


def _smoothed(linear: Linear, memory: _Memory, change: Floats) -> Floats:
    """(B, W + 4N) changes of the states at the first SYNCs of the blocks, from all readings."""
    first, x = linear.blocks.first, linear.states.shape[1]
    changes = [memory.moved[-1] @ change]
    for k in range(len(first) - 2, -1, -1):
        own = memory.moved[k] @ change
        later = changes[-1] - memory.ahead[k] @ change
        changes.append(own if first[k + 1] else own + memory.back[k] @ later)
    return np.array(changes[::-1])[:, :x]


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

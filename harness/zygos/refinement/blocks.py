# SPDX-License-Identifier: MIT
"""A record in blocks of successive cycles, and the motion in each of them as linear functions of what is unknown.

Over 10 ms the derivatives of the accelerations hardly change, so that an exponential series carries them on. Readings
of a block are compressed to their products with a few polynomials of time, and the noise of the torques is made of a
few others (docs/theory.md, "All readings at once").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import TORQUE_STEP, Arm
from zygos.effects import SLOWEST_RATE
from zygos.native.propagation import Propagation
from zygos.refinement.motion import FlexibleMotion, base_rates
from zygos.refinement.record import Record, start_of

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

BLOCK_S = 0.04
"""Longest block of more than one cycle, s."""
_SHAPES = 6
"""Polynomials of time of which the noise of a torque in a block is made."""
_KEPT = 5
"""Polynomials of time to which the readings of a sensor in a block are compressed."""
_STRETCH_S = 0.01
"""Longest part of a block over which derivatives of the accelerations are taken once, at its middle, s."""
_STEPS = 5
"""Runge-Kutta steps that such a part may have: more would need more terms."""
_TERMS = 12
"""Terms of the exponential series over such a part."""
_STEADY = 1e-6
"""Change of a motor's rate in a cycle below which it is constant, as a share of `SLOWEST_RATE`."""
_TOGETHER = 250
"""Blocks whose derivatives are computed together; more need more memory."""
MOST_BYTES = 1e9
"""Memory that the derivatives of a record may take: they grow with its length."""
_APART_S = 0.025
"""Time to both sides of a SYNC over which the first guess takes rates from angles, s."""


@dataclass(frozen=True)
class Blocks:
    """B blocks of m cycles; N joints, W rates of the base, r = 2N + W sensors, d kept and L shapes of polynomials."""

    record: Record
    first: Flags
    """(B,) whether a piece begins with this block."""
    begins: tuple[tuple[Floats, Floats], ...]
    """Of each piece state and bias at its first SYNC with their standard deviations, (W + 4N + W,) each."""
    read: Flags
    """(B, m) whether the readings of a SYNC were received."""
    value: Floats
    """(B, m, r) readings."""
    tau: Floats
    """(B, m, N) torques of the cycles, Nm before the gear."""
    around: Floats
    """(B, m, N) half the torque of the cycle before less half of that after."""
    lost: Floats
    """(B, m) as `Piece.lost`."""
    kept: Floats
    """(B, m, d) orthonormal polynomials of the SYNCs that were read, 0 at others."""
    shape: Floats
    """(m, L) orthonormal polynomials of the cycles, of which the noise of a torque is made."""
    states: Floats
    """(B, W + 4N) first guess of the state at the first SYNC of each block."""

    @property
    def cycles(self) -> int:
        """m."""
        return int(self.read.shape[1])


@dataclass(frozen=True)
class Slopes:
    """Derivatives of k numbers of each block.

    Constants are the p parameters, then Coulomb friction of each rotor, the offset and the gain of each torque, the
    zeros of all encoders, and what no model has: a delay of all torques in periods. All are in SI units.
    """

    of_state: Floats
    """(B, k, x) by the state at the first SYNC of the block, x = W + 4N."""
    of_constant: Floats
    """(B, k, c)."""
    of_torque: Floats
    """(B, k, L, N) by the shapes of the torques."""


@dataclass(frozen=True)
class Linear:
    """The motion of all blocks, and what small changes do to it."""

    blocks: Blocks
    size: Floats
    """(p,) sizes of the parameters."""
    states: Floats
    """(B, x) states at the first SYNCs of the blocks, around which all of this is."""
    error: Floats
    """(B, r d) compressed readings less what the motion gives, those of a sensor one after the other."""
    rest: Floats
    """(B, r) sum of squares of what the compression leaves."""
    gap: Floats
    """(B, x) state that the motion gives at the end, less that with which the next block begins."""
    unsure: Floats
    """(B, m, N) friction of cycles in which a motor turns back or stands still, where it is not linear, Nm."""
    reading: Slopes
    """Of the compressed readings."""
    end: Slopes
    """Of the state at the end."""

    def noise(self, own: Floats, relative: Floats) -> Floats:
        """(B, N, L, L) roots of the covariance of the shapes of torques with the noise (N,) Nm and (N,) of their
        size."""
        blocks = self.blocks
        variance = own**2 + (relative * blocks.tau) ** 2 + blocks.lost[..., None] ** 2 + self.unsure**2
        return np.linalg.cholesky(np.einsum("ks,bkn,kt->bnst", blocks.shape, variance, blocks.shape))


def torque_steps(arm: Arm) -> Floats:
    """(N,) noise of the torques that does not depend on them, Nm before the gear."""
    return np.hypot([joint.torque_sigma for joint in arm.joints], TORQUE_STEP / math.sqrt(12.0))


def blocks_of(record: Record) -> Blocks:
    """The pieces of a record in blocks."""
    arm = record.arm
    width = base_rates(arm)
    m = max(1, round(BLOCK_S / arm.period_s))
    parts: list[tuple[Floats, ...]] = []
    for piece in record.pieces:
        n = len(piece.read)
        count = -(-n // m)
        base = piece.omega if width == 3 else (piece.omega @ np.array(arm.axis))[:, None] if width else np.zeros((n, 0))
        value = np.concatenate([piece.q, piece.theta, base], axis=1)
        tau = np.concatenate([piece.tau, np.repeat(piece.tau[-1:], count * m - n + 1, axis=0)])
        beside = np.concatenate([tau[:1], tau, tau[-1:]])
        first = np.zeros(count)
        first[0] = 1.0

        def cut(values: Floats, count: int = count) -> Floats:
            whole = np.zeros((count * m, *values.shape[1:]))
            whole[: len(values)] = values
            return whole.reshape(count, m, *values.shape[1:])

        parts.append(
            (
                first,
                cut(piece.read.astype(float)),
                cut(value),
                cut(tau),
                cut(0.5 * (beside[:-2] - beside[2:])),
                cut(piece.lost),
                _guess(arm, width, np.flatnonzero(piece.read), value, m * np.arange(count)),
            )
        )
    first, read, value, tau, around, lost, states = (np.concatenate(listed) for listed in zip(*parts, strict=True))
    seen = read > 0.0
    return Blocks(
        record, first > 0.0, tuple(start_of(arm, piece) for piece in record.pieces), seen, value, tau, around, lost,
        _kept(seen),
        _polynomials(m, min(_SHAPES, m)),
        states,
    )  # fmt: skip


def within_memory(blocks: Blocks, parameters: int) -> Blocks:
    """The blocks whose derivatives by so many parameters fit into MOST_BYTES: those at the beginning, at least one."""
    (count, moving), n = blocks.states.shape, blocks.record.arm.n
    rows = blocks.value.shape[2] * blocks.kept.shape[2] + moving
    columns = moving + parameters + 5 * n + 1 + blocks.shape.shape[1] * n
    taken = 2.0 * 8.0 * rows * columns  # of a block; twice, while parts are put together
    if count * taken <= MOST_BYTES:
        return blocks
    return blocks_of(blocks.record.beginning(max(1, int(MOST_BYTES / taken)) * blocks.cycles))


def _guess(arm: Arm, width: int, read: NDArray[np.int64], value: Floats, at: NDArray[np.int64]) -> Floats:
    """(k, W + 4N) states at the SYNCs `at`, from the readings value (n, r) at the SYNCs `read`."""
    n = arm.n
    apart = max(1, round(_APART_S / arm.period_s))

    def angles(sync: NDArray[np.int64]) -> Floats:
        return np.stack([np.interp(sync, read, value[read, k]) for k in range(value.shape[1])], axis=1)

    # a parabola through three angles, at an end of the record through those inside
    middle = np.clip(at, apart, max(apart, len(value) - 1 - apart))
    before, here, after = angles(middle - apart), angles(middle), angles(middle + apart)
    aside = ((at - middle) / apart)[:, None]
    rate = (0.5 * (after - before) + aside * (after - 2.0 * here + before)) / (apart * arm.period_s)
    now = angles(at)
    return np.concatenate([now[:, 2 * n : 2 * n + width], now[:, : 2 * n], rate[:, : 2 * n]], axis=1)


def _kept(read: Flags) -> Floats:
    """(B, m, d) as `Blocks.kept`."""
    m = read.shape[1]
    d = min(_KEPT, m)
    powers = _polynomials(m, d)
    known: dict[bytes, Floats] = {}
    for row in read:
        key = row.tobytes()
        if key not in known:
            count = min(d, int(row.sum()))
            known[key] = np.zeros((m, d))
            known[key][row, :count] = np.linalg.qr(powers[row, :count])[0]
    return np.stack([known[row.tobytes()] for row in read])


def _polynomials(m: int, count: int) -> Floats:
    """(m, count) orthonormal polynomials of ascending degree."""
    return np.linalg.qr(np.vander((np.arange(m) - 0.5 * (m - 1)) / m, count, increasing=True))[0]


def linearise(blocks: Blocks, propagation: Propagation, values: Floats, beside: Floats, states: Floats) -> Linear:
    """The motion of all blocks, from states (B, W + 4N) at their first SYNCs with parameters (p,), SI units, and
    constants beside them (5N,) as in `Slopes`.

    Errors: ZygosError where no inertia resists.
    """
    arm, n = blocks.record.arm, blocks.record.arm.n
    motion = FlexibleMotion(arm, values)
    friction, offset, gain, zero = beside[:n], beside[n : 2 * n], beside[2 * n : 3 * n], beside[3 * n :]
    drive = (1.0 + gain) * blocks.tau - offset
    path = propagation.path(np.concatenate([values, friction]), states, drive)
    look = _look(arm, motion.base_rates)
    parts = [
        _stretches(motion, look, blocks.kept[part], blocks.shape, path[part], drive[part])
        for part in (slice(first, first + _TOGETHER) for first in range(0, len(states), _TOGETHER))
    ]
    read, end = (np.concatenate(listed) for listed in zip(*parts, strict=True))
    signs = _signs(path[:, :: propagation.steps, -n:])
    acting = np.einsum("ks,bkan->bsna", blocks.shape, _added(blocks, signs))
    zeros = np.zeros((*read.shape[:2], 2 * n))
    kept = blocks.kept.sum(axis=1)
    for row in range(2 * n):
        zeros[:, row * kept.shape[1] : (row + 1) * kept.shape[1], row] = kept
    off = blocks.value - path[:, : -1 : propagation.steps] @ look.T
    off[:, :, : 2 * n] -= zero
    off = np.where(blocks.read[..., None], off, 0.0)
    error = np.swapaxes(off, 1, 2) @ blocks.kept
    return Linear(
        blocks,
        motion.size,
        states,
        error.reshape(len(states), -1),
        np.maximum(np.sum(off**2, axis=1) - np.sum(error**2, axis=2), 0.0),
        path[:, -1] - np.concatenate([states[1:], states[-1:]]),
        friction * (1.0 - np.abs(signs)),
        _slopes(read, motion, acting, zeros),
        _slopes(end, motion, acting, np.zeros((*end.shape[:2], 2 * n))),
    )


def _slopes(table: Floats, motion: FlexibleMotion, acting: Floats, zeros: Floats) -> Slopes:
    """Of a table (B, k, x + p + L N) as `_stretches` gives it. acting: (B, L, N, a) shapes of the torques that a
    constants stand for, of which the first 3N come before the zeros; zeros: (B, k, 2N) what those of encoders do."""
    n, x, p = motion.arm.n, motion.states, len(motion.values)
    of_torque = table[..., x + p :]
    moved = of_torque @ acting.reshape(len(table), -1, acting.shape[-1])
    return Slopes(
        table[..., :x],
        np.concatenate([table[..., x : x + p], moved[..., : 3 * n], zeros, moved[..., 3 * n :]], axis=2),
        of_torque.reshape(*table.shape[:2], -1, n),
    )


def _stretches(
    motion: FlexibleMotion, look: Floats, kept: Floats, shape: Floats, path: Floats, drive: Floats
) -> tuple[Floats, Floats]:
    """Derivatives of the compressed readings (B, r d, ..) and of the state at the end (B, x, ..) of some blocks by the
    state at the beginning (x), the parameters (p) and the shapes of the torques (L N), from one stretch to the next.

    look: (r, x) as `_look`; path: (B, m * steps + 1, x) states; drive: (B, m, N) torques that acted.
    """
    n, x, p = motion.arm.n, motion.states, len(motion.values)
    batch, cycles, d = kept.shape
    r, shapes = len(look), shape.shape[1]
    steps = (path.shape[1] - 1) // cycles
    time = motion.arm.period_s / steps
    # what each step of the integration has of the polynomials; only at the first of a cycle there are readings
    pushes = np.concatenate([np.ones((cycles * steps, 1)), np.repeat(shape, steps, axis=0)], axis=1)
    listens = np.zeros((batch, d, cycles * steps))
    listens[:, :, ::steps] = np.swapaxes(kept, 1, 2)
    end = np.zeros((batch, x, x + p + shapes * n))
    end[:, :, :x] = np.eye(x)
    read = np.zeros((batch, d * r, x + p + shapes * n))
    together = max(1, min(_STEPS, round(_STRETCH_S / time)))
    for first in range(0, cycles * steps, together):
        last = min(first + together, cycles * steps)
        middle = 0.5 * (path[:, (first + last) // 2] + path[:, (first + last + 1) // 2])
        flow, push = _flow(motion, middle, drive[:, first // steps : (last - 1) // steps + 1].mean(axis=1))
        powers = np.empty((batch, _TERMS, x, x))
        powers[:, 0] = np.eye(x)
        for t in range(1, _TERMS):
            powers[:, t] = powers[:, t - 1] @ flow
        of_power, of_push = _series(time, pushes[first:last])
        every, heard = (table.reshape(batch, _TERMS, -1) for table in (powers, look @ powers))
        weight = listens[:, :, first:last]
        read += (weight @ of_power[:-1] @ heard).reshape(batch, d * r, x) @ end
        end = (of_power[-1] @ every).reshape(batch, x, x) @ end
        by_push = (weight[:, None] @ of_push[:, :-1]).reshape(batch, -1, _TERMS) @ heard
        for out, by in (
            (read, by_push.reshape(batch, 1 + shapes, d * r, x)),
            (end, (of_push[:, -1] @ every).reshape(batch, 1 + shapes, x, x)),
        ):
            out[:, :, x : x + p] += by[:, 0] @ push[:, :, :p]
            for k in range(shapes):
                out[:, :, x + p + k * n : x + p + (k + 1) * n] += by[:, 1 + k] @ push[:, :, p:]
    read = np.swapaxes(read.reshape(batch, d, r, -1), 1, 2).reshape(batch, r * d, -1)
    return read, end


def _flow(motion: FlexibleMotion, states: Floats, drive: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the rates of change of states (B, x): (B, x, x) by themselves, and (B, x, p + N) by parameters and
    torques."""
    n, x, width = motion.arm.n, motion.states, motion.base_rates
    slopes = motion.slopes(states, drive)
    rates = np.concatenate([np.arange(width), np.arange(width + 2 * n, x)])
    flow, push = np.zeros((len(states), x, x)), np.zeros((len(states), x, len(motion.values) + n))
    flow[:, width : width + 2 * n, width + 2 * n :] = np.eye(2 * n)
    flow[:, rates] = slopes.of_state
    push[:, rates] = np.concatenate([slopes.of_parameters, slopes.of_torque], axis=2)
    return flow, push


def _series(time: float, shape: Floats) -> tuple[Floats, Floats]:
    """Factors of the powers of the flow after 0 to k steps of `time` s: (k + 1, terms) for a state at the beginning,
    and (L, k + 1, terms) for an acceleration held in each step that has the shapes (k, L)."""
    count = len(shape)
    factorial = np.array([math.factorial(t) for t in range(_TERMS + 1)], dtype=np.float64)
    power = (time * np.arange(count + 1))[:, None] ** np.arange(_TERMS + 1) / factorial
    # an acceleration in one step acts as one from its beginning on, less one from its end on
    held = power[1:, 1:] - power[:-1, 1:]
    of_shape = np.zeros((shape.shape[1], count + 1, _TERMS))
    for k in range(1, count + 1):
        of_shape[:, k] = shape[:k].T @ held[k - 1 :: -1][:k]
    return power[:, :-1], of_shape


def _look(arm: Arm, width: int) -> Floats:
    """(r, W + 4N) what the sensors read of a state: an encoder that latches after SYNC an angle that has moved on."""
    arm, n = arm.over_the_wire, arm.n
    look = np.zeros((2 * n + width, width + 4 * n))
    look[: 2 * n, width : width + 2 * n] = np.eye(2 * n)
    for row, encoder in enumerate([one.link_encoder for one in arm.joints] + [one.motor_encoder for one in arm.joints]):
        look[row, width + 2 * n + row] = 1e-6 * (arm.joints[row % n].latch_us + encoder.latch_us)
    look[2 * n :, :width] = np.eye(width)
    return look


def _signs(motor: Floats) -> Floats:
    """(B, m, N) mean in each cycle of the sign of motor rates (B, m + 1, N) that change steadily, linear within
    `SLOWEST_RATE`."""
    size = np.abs(motor)
    area = np.where(size < SLOWEST_RATE, 0.5 * size**2 / SLOWEST_RATE, size - 0.5 * SLOWEST_RATE)
    change = np.diff(motor, axis=1)
    steady = np.abs(change) < _STEADY * SLOWEST_RATE
    mean = np.diff(area, axis=1) / np.where(steady, 1.0, change)
    return np.where(steady, np.clip(motor[:, 1:] / SLOWEST_RATE, -1.0, 1.0), mean)


def _added(blocks: Blocks, signs: Floats) -> Floats:
    """(B, m, 3N + 1, N) what the constants that act like torques add to each of them: friction, offset and gain of each
    joint, and a delay. signs: as `_signs`."""
    own = np.eye(signs.shape[2])
    offset = np.broadcast_to(-own, (*signs.shape, len(own)))
    return np.concatenate(
        [-signs[:, :, None] * own, offset, blocks.tau[:, :, None] * own, blocks.around[:, :, None]], axis=2
    )

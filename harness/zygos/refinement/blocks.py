"""A record in blocks of successive cycles, and the motion in each of them as linear functions of what is unknown.

Over 10 ms the derivatives of the accelerations hardly change, so that an exponential series carries them on. Readings are compressed to their products with a few polynomials of time, and the noise of the torques is made of
a few others (docs/theory.md, "All readings at once").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import TORQUE_STEP, Arm
from zygos.native.propagation import Propagation
from zygos.refinement.motion import FlexibleMotion
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
_TERMS = 10
"""Terms of the exponential series over such a part."""
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
    states: Floats
    """(B, W + 4N) first guess of the state at the first SYNC of each block."""

    @property
    def cycles(self) -> int:
        """m."""
        return self.read.shape[1]


@dataclass(frozen=True)
class Linear:
    """What a small change of state s (x = W + 4N), constants c and torque noise w does in each block.

    Constants are the parameters, then Coulomb friction of each rotor, the offset of each
    torque, the zeros of all encoders, and what no model has: a delay of all torques in periods, and a gain of each.
    """

    blocks: Blocks
    size: Floats
    """(p,) sizes of the parameters."""
    error: Floats
    """(B, d, r) compressed readings less what the motion gives."""
    rest: Floats
    """(B, r) sum of squares of what the compression leaves."""
    of_state: Floats
    """(B, d, r, x) of the compressed readings by s."""
    of_constant: Floats
    """(B, d, r, c)."""
    of_noise: Floats
    """(B, d, r, L, N)."""
    across: Floats
    """(B, x, x) of the state at the end by that at the beginning."""
    constant_across: Floats
    """(B, x, c)."""
    noise_across: Floats
    """(B, x, L, N)."""
    states: Floats
    """(B, x) states at the first SYNCs of the blocks, around which all of this is."""
    gap: Floats
    """(B, x) state that the motion gives at the end, less that with which the next block begins."""
    shape: Floats
    """(m, L) orthonormal polynomials of the cycles."""

    def noise(self, own: Floats, relative: Floats) -> Floats:
        """(B, N, L, L) roots of the covariance of the shapes of torques with the noise (N,) Nm and (N,) of their
        size."""
        blocks = self.blocks
        variance = own**2 + (relative * blocks.tau) ** 2 + blocks.lost[..., None] ** 2
        return np.linalg.cholesky(np.einsum("ks,bkn,kt->bnst", self.shape, variance, self.shape))


def torque_steps(arm: Arm) -> Floats:
    """(N,) noise of the torques that does not depend on them, Nm before the gear."""
    return np.hypot([joint.torque_sigma for joint in arm.joints], TORQUE_STEP / math.sqrt(12.0))


def blocks_of(record: Record) -> Blocks:
    """The pieces of a record in blocks."""
    arm = record.arm
    width = 0 if not arm.free else 3 if arm.spatial else 1
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
        _kept(seen), states,
    )  # fmt: skip


def _guess(arm: Arm, width: int, read: NDArray[np.int64], value: Floats, at: NDArray[np.int64]) -> Floats:
    """(k, W + 4N) states at the SYNCs `at`, from the readings value (n, r) at the SYNCs `read`."""
    n = arm.n
    apart = max(1, round(_APART_S / arm.period_s))

    def angles(sync: Floats) -> Floats:
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
    constants beside them (4N,) as in `Linear`.

    Errors: ZygosError where no inertia resists.
    """
    arm = blocks.record.arm
    n, m, d = arm.n, blocks.cycles, blocks.kept.shape[2]
    motion = FlexibleMotion(arm, values)
    x, width = motion.states, motion.base_rates
    friction, offset, zero = beside[:n], beside[n : 2 * n], beside[2 * n :]
    path = propagation.path(np.concatenate([values, friction]), states, blocks.tau - offset)
    steps, p = propagation.steps, len(values)
    shape = _polynomials(m, min(_SHAPES, m))
    shapes = shape.shape[1]
    look = _look(arm, width)
    r = len(look)
    # what each step of the integration has of the polynomials of torques, and of those of readings
    pushes, listens = np.repeat(shape, steps, axis=0), np.zeros((len(states), m * steps, d))
    listens[:, ::steps] = blocks.kept
    rates = np.concatenate([np.arange(width), np.arange(width + 2 * n, x)])
    # derivatives by the state at the beginning, the parameters, and the shapes of the torques
    columns = x + p + shapes * n
    now = np.zeros((len(states), x, columns))
    now[:, :, :x] = np.eye(x)
    seen = np.zeros((len(states), d * r, columns))
    together = max(1, round(_STRETCH_S * steps / arm.period_s))
    for begin in range(0, m * steps, together):
        part = slice(begin, min(begin + together, m * steps))
        length = part.stop - begin
        middle = 0.5 * (path[:, begin + length // 2] + path[:, begin + (length + 1) // 2])
        acting = blocks.tau[:, begin // steps : (part.stop - 1) // steps + 1].mean(axis=1) - offset
        slopes = motion.slopes(middle, acting)
        flow, push = np.zeros((len(states), x, x)), np.zeros((len(states), x, p + n))
        flow[:, width : width + 2 * n, width + 2 * n :] = np.eye(2 * n)
        flow[:, rates] = slopes.of_state
        push[:, rates, :p] = slopes.of_parameters
        push[:, rates, p:] = slopes.of_torque
        powers = np.empty((len(states), _TERMS, x, x))
        powers[:, 0] = np.eye(x)
        for t in range(1, _TERMS):
            powers[:, t] = powers[:, t - 1] @ flow
        own = np.concatenate([np.ones((length, 1)), pushes[part]], axis=1)
        of_power, of_shape = _series(arm.period_s / steps, own)
        every = powers.reshape(len(states), _TERMS, -1)
        heard = (look @ powers).reshape(len(states), _TERMS, -1)
        weight = np.swapaxes(listens[:, part], 1, 2)
        looks = (weight @ of_power[:-1] @ heard).reshape(len(states), d * r, x)
        seen += looks @ now
        by_push = np.moveaxis(
            (np.einsum("bdk,kst->bdst", weight, of_shape[:-1]).reshape(len(states), -1, _TERMS) @ heard).reshape(
                len(states), d, 1 + shapes, r, x
            ),
            2,
            1,
        ).reshape(len(states), 1 + shapes, d * r, x)
        moved = (of_shape[-1] @ every).reshape(len(states), 1 + shapes, x, x)
        now = (of_power[-1] @ every).reshape(len(states), x, x) @ now
        for out, by in ((seen, by_push), (now, moved)):
            out[:, :, x : x + p] += by[:, 0] @ push[:, :, :p]
            for k in range(shapes):
                out[:, :, x + p + k * n : x + p + (k + 1) * n] += by[:, 1 + k] @ push[:, :, p:]
    seen = seen.reshape(len(states), d, r, columns)
    of_noise = seen[..., x + p :].reshape(len(states), d, r, shapes, n)
    noise_across = now[..., x + p :].reshape(len(states), x, shapes, n)

    # what a constant adds to the torques
    added = _added(blocks, path[:, ::steps, width + 3 * n :])
    parts = np.einsum("ks,bkan->bsna", shape, added)
    zeros = np.zeros((len(states), d, r, 2 * n))
    zeros[:, :, : 2 * n] = blocks.kept.sum(axis=1)[:, :, None, None] * np.eye(2 * n)
    by_added = np.einsum("bdrsn,bsna->bdra", of_noise, parts)
    added_across = np.einsum("bxsn,bsna->bxa", noise_across, parts)
    of_constant = np.concatenate([seen[..., x : x + p], by_added[..., : 2 * n], zeros, by_added[..., 2 * n :]], axis=3)
    constant_across = np.concatenate(
        [
            now[..., x : x + p],
            added_across[..., : 2 * n],
            np.zeros((len(states), x, 2 * n)),
            added_across[..., 2 * n :],
        ],
        axis=2,
    )
    off = blocks.value - path[:, :-1:steps] @ look.T
    off[:, :, : 2 * n] -= zero
    off = np.where(blocks.read[..., None], off, 0.0)
    error = np.einsum("bkd,bkr->bdr", blocks.kept, off)
    return Linear(
        blocks,
        motion.size,
        error,
        np.maximum(np.sum(off**2, axis=1) - np.sum(error**2, axis=1), 0.0),
        seen[..., :x],
        of_constant,
        of_noise,
        now[..., :x],
        constant_across,
        noise_across,
        states,
        path[:, -1] - np.concatenate([states[1:], states[-1:]]),
        shape,
    )


def _series(time: float, shape: Floats) -> tuple[Floats, Floats]:
    """Factors of the powers of the flow after 0 to k steps of `time` s: (k + 1, terms) for a state at the beginning,
    and (k + 1, L, terms) for an acceleration held in each step that has the shapes (k, L)."""
    count = len(shape)
    factorial = np.array([math.factorial(t) for t in range(_TERMS + 1)], dtype=np.float64)
    power = (time * np.arange(count + 1))[:, None] ** np.arange(_TERMS + 1) / factorial
    # an acceleration in one step acts as one from its beginning on, less one from its end on
    held = power[1:, 1:] - power[:-1, 1:]
    of_shape = np.zeros((count + 1, shape.shape[1], _TERMS))
    for k in range(1, count + 1):
        of_shape[k] = shape[:k].T @ held[k - 1 :: -1][:k]
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


def _added(blocks: Blocks, motor: Floats) -> Floats:
    """(B, m, 3N + 1, N) what the constants that act like torques add to each of them: friction and offset of each
    joint, a delay, and the gain of each. motor: (B, m + 1, N) rates at the SYNCs."""
    n = motor.shape[2]
    change = np.diff(motor, axis=1)
    own = np.eye(n)
    # the mean sign of a rate that changes steadily
    still = np.abs(change) < 1e-12
    sign = np.where(still, np.sign(motor[:, 1:]), np.diff(np.abs(motor), axis=1) / np.where(still, 1.0, change))
    offset = np.broadcast_to(-own, (*sign.shape[:2], n, n))
    return np.concatenate(
        [-sign[:, :, None] * own, offset, blocks.around[:, :, None], blocks.tau[:, :, None] * own], axis=2
    )

# SPDX-License-Identifier: MIT
"""Recorded runs as a refinement takes them: pieces of motion over which its state can be followed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.refinement.motion import base_rates
from zygos.runs.cycles import BREAK_BEFORE
from zygos.runs.samples import HALF_RANGE_RAD, Samples, calibrate

Floats = NDArray[np.float64]

LONGEST_GAP = 20
"""Cycles that may be missing in a piece; over more, the torques are not known well enough to follow the state."""
_SHORTEST = 20
"""Readings of the shortest piece that is used."""
_APART_S = 0.025
"""Time between the four angles from which the rates at the start of a piece are taken, s."""
_SHARE = 10.0
"""Standard deviation of what is read off the first readings, as a multiple of that of their noise."""
_BIAS_RAD_S = 1e-3
"""Standard deviation of the bias of a gyro before the first reading, rad/s."""


@dataclass(frozen=True)
class Piece:
    """n successive SYNCs of an arm with N joints."""

    run: int
    """Number of its run, from 0."""
    first: int
    """Number of the first SYNC."""
    read: NDArray[np.bool_]
    """(n,) whether the readings of this SYNC were received."""
    q: Floats
    """(n, N) link angles, rad, after sign and zero; anything where nothing was received, as the next two."""
    theta: Floats
    """(n, N) motor angles, rad."""
    omega: Floats
    """(n, 3) rate of the base in its axes, rad/s."""
    tau: Floats
    """(n - 1, N) torques held from each SYNC to the next, Nm before the gear, interpolated where nobody reported
    them."""
    lost: Floats
    """(n - 1,) standard deviation that interpolation adds, Nm; 0 where the torques were received."""


@dataclass(frozen=True)
class Record:
    """All pieces of several runs."""

    arm: Arm
    pieces: tuple[Piece, ...]
    cycles: int
    """Readings that are used."""
    lost: int
    """SYNCs inside pieces whose readings are missing."""
    left_out: int
    """Usable readings that are in no piece."""

    def beginning(self, syncs: int) -> Record:
        """The pieces of the first so many SYNCs; the readings of all others are left out."""
        pieces: list[Piece] = []
        for piece in self.pieces:
            room = syncs - sum(len(one.read) for one in pieces)
            if room < max(_SHORTEST, 4 * _apart(self.arm)) and pieces:
                break
            end = int(np.flatnonzero(piece.read[: max(room, _SHORTEST)])[-1]) + 1
            pieces.append(
                replace(
                    piece,
                    read=piece.read[:end],
                    q=piece.q[:end],
                    theta=piece.theta[:end],
                    omega=piece.omega[:end],
                    tau=piece.tau[: end - 1],
                    lost=piece.lost[: end - 1],
                )
            )
        used = sum(int(piece.read.sum()) for piece in pieces)
        lost = sum(int((~piece.read).sum()) for piece in pieces)
        return Record(self.arm, tuple(pieces), used, lost, self.cycles + self.left_out - used)


def record_of(arm: Arm, runs: Sequence[Run]) -> Record:
    """The pieces of runs. Errors: ZygosError where a run does not fit the arm, or has no whole cycle of it."""
    pieces: list[Piece] = []
    usable = 0
    for k, run in enumerate(runs):
        run.check_cycles()
        cycles = run.cycles
        samples = calibrate(arm, cycles)
        kept = _trusted(samples)
        usable += int(kept.sum())
        broken = (cycles.flags & BREAK_BEFORE) != 0
        pieces += _pieces(arm, k, samples, kept, broken)
    used = sum(int(piece.read.sum()) for piece in pieces)
    missing = sum(int((~piece.read).sum()) for piece in pieces)
    return Record(arm, tuple(pieces), used, missing, usable - used)


def _trusted(samples: Samples) -> NDArray[np.bool_]:
    """(n,) whether a cycle is in a segment, and before no void that takes it back."""
    kept = np.zeros(len(samples.sync), dtype=np.bool_)
    for start, stop in samples.segments:
        kept[start:stop] = True
    for at, last in samples.voids:
        begin = max((start for start, _ in samples.segments if start < at), default=0)
        back = np.arange(len(kept))
        doubtful = (back < at) & (back >= begin)
        kept &= ~(doubtful & (samples.sync > np.uint64(last) if last is not None else True))
    return kept


def _pieces(arm: Arm, run: int, samples: Samples, kept: NDArray[np.bool_], broken: NDArray[np.bool_]) -> list[Piece]:
    at = np.flatnonzero(kept)
    if not len(at):
        return []
    step = np.diff(samples.sync[at].astype(np.int64))
    inside = np.zeros(len(kept), dtype=np.int64)
    for number, (start, stop) in enumerate(samples.segments):
        inside[start:stop] = number
    jump = np.zeros(len(step), dtype=np.bool_)
    for angle in (samples.q, samples.theta):
        jump |= np.any(np.abs(np.diff(angle[at], axis=0)) > HALF_RANGE_RAD, axis=1)
    # between two segments whose numbers follow on each other lies an interruption that no number tells
    jump |= (np.diff(inside[at]) != 0) & (step == 1)
    cuts = np.flatnonzero(jump | broken[at[1:]] | (step > LONGEST_GAP + 1)) + 1
    parts = [part for part in np.split(at, cuts) if len(part) >= max(_SHORTEST, 4 * _apart(arm))]
    return [_piece(run, samples, part) for part in parts]


def _piece(run: int, samples: Samples, at: NDArray[np.int64]) -> Piece:
    place = (samples.sync[at] - samples.sync[at[0]]).astype(np.int64)
    n = int(place[-1]) + 1
    read = np.zeros(n, dtype=np.bool_)
    read[place] = True

    def spread(values: Floats) -> Floats:
        out = np.zeros((n, values.shape[1]))
        out[place] = values[at]
        return out

    known = place[np.isfinite(samples.tau[at]).all(axis=1)]
    known = known[known < n - 1]
    tau, lost = np.zeros((n - 1, samples.tau.shape[1])), np.zeros(n - 1)
    reported = spread(samples.tau)
    if len(known):
        for joint in range(tau.shape[1]):
            tau[:, joint] = np.interp(np.arange(n - 1), known, reported[known, joint])
        # a walk between two known ends: its step is that of the torques of this piece
        follows = np.flatnonzero(np.diff(known) == 1)
        change = np.diff(reported[known], axis=0)[follows]
        walk = float(np.sqrt(np.mean(change**2, axis=0).max())) if len(follows) else float(np.abs(reported).max())
        after = np.minimum(np.searchsorted(known, np.arange(n - 1)), len(known) - 1)
        before = np.maximum(after - 1, 0)
        distance = np.minimum(np.abs(known[after] - np.arange(n - 1)), np.abs(known[before] - np.arange(n - 1)))
        lost = walk * np.sqrt(distance)
    return Piece(
        run, int(samples.sync[at[0]]), read, spread(samples.q), spread(samples.theta), spread(samples.omega), tau, lost
    )


def _apart(arm: Arm) -> int:
    """Cycles between the angles from which rates are taken."""
    return max(1, round(_APART_S / arm.period_s))


def start_of(arm: Arm, piece: Piece) -> tuple[Floats, Floats]:
    """State and bias at the first SYNC of a piece, and their standard deviations (W + 4N + W,) each.

    Rates are those of a parabola through the first angles; what the next angle says otherwise widens their deviations.
    """
    wire = arm.over_the_wire
    width = base_rates(arm)
    part = _apart(arm)
    seen = np.flatnonzero(piece.read)
    at = seen[:1]
    while len(at) < 4:  # behind a hole the next reading may be due for two of them
        due = max(part * len(at), at[-1] + 1)
        at = np.append(at, seen[min(np.searchsorted(seen, due), len(seen) - 1)])
    t = at * arm.period_s
    # of the polynomials through three and through four angles, the rates at the start
    three, four = (np.linalg.inv(np.vander(t[:k], increasing=True))[1] for k in (3, 4))
    angles, sigmas, rates, doubts = [], [], [], []
    for values, encoders in (
        (piece.q, [joint.link_encoder for joint in wire.joints]),
        (piece.theta, [joint.motor_encoder for joint in wire.joints]),
    ):
        noise = np.array([one.sigma_rad for one in encoders])
        angles.append(values[0])
        sigmas.append(_SHARE * np.hypot(noise, [one.zero_uncertainty_rad for one in encoders]))
        rates.append(three @ values[at[:3]])
        doubts.append(np.abs(four @ values[at] - rates[-1]) + float(np.linalg.norm(four)) * noise)
    base = piece.omega[0] if width == 3 else np.array([piece.omega[0] @ arm.axis])[:width]
    gyro = math.hypot(_SHARE * wire.imu.rate_sigma, _BIAS_RAD_S)
    x = np.concatenate([base, *angles, *rates, np.zeros(width)])
    sigma = np.concatenate([np.full(width, gyro), *sigmas, *doubts, np.full(width, _BIAS_RAD_S)])
    return x, sigma

# SPDX-License-Identifier: MIT
"""The joint rows in interleaved groups, their noise, and their part in the estimate (docs/theory.md, "Joint rows")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.joint import JointRows, in_order, increment_instants, joint_columns, joint_rows
from zygos.balances.momentum import variances
from zygos.balances.state import State
from zygos.effects import Effect, estimated
from zygos.reference.solver import Rows
from zygos.runs.samples import Samples
from zygos.runs.smoother import Smoothed

Floats = NDArray[np.float64]
Places = NDArray[np.int64]

GROUPS = 8
"""Number of groups."""
LEAST_GROUPS = 4
"""Smallest number of groups from whose scatter sigmas follow."""
SEGMENT_INCREMENTS = 16
"""Smallest number of increments in a segment."""
SEGMENT_S = 2.0
"""Shortest time that a segment takes, s."""
CAUTION = 2.0
"""Factor by which the noise of joint rows is increased beside others: neighbouring increments share halves."""


@dataclass(frozen=True)
class Groups:
    """The rows of all joints in one table, each divided by the deviation of its torque where all are declared.

    rows: z (m, p), w (m,), and their noise (p+1, p+1), to which that of the torques belongs. group: (m,) which group a
    row is in. segment: (m,) number of its segment. joint: (m,) from 0. shares: (groups, p, p) noise in each group.
    """

    rows: Rows
    group: Places
    segment: Places
    joint: Places
    shares: Floats

    @property
    def enough(self) -> bool:
        """Whether sigmas can follow from them."""
        return len(np.unique(self.group)) >= LEAST_GROUPS

    def sums(self, group: int) -> Floats:
        """(p+1, p+1) squares of the rows of a group, less their noise."""
        table = np.column_stack([self.rows.z, self.rows.w])[self.group == group]
        out: Floats = table.T @ table
        out[:-1, :-1] -= self.shares[group]
        return out

    def apart(self) -> tuple[Floats, int]:
        """(p+1, p+1) sum of s s^T / (2 n) over the sums s of each joint's n rows in a segment, and their number."""
        table = np.column_stack([self.rows.z, self.rows.w])
        total, count = np.zeros((table.shape[1],) * 2), 0
        for number in np.unique(self.segment):
            for joint in np.unique(self.joint):
                of = (self.segment == number) & (self.joint == joint)
                added = table[of].sum(axis=0)
                total += np.outer(added, added) / (2.0 * max(1, int(np.count_nonzero(of))))
                count += int(of.any())
        return total, count


def suffice(arm: Arm) -> bool:
    """Whether the joint rows alone determine the estimate."""
    return arm.grounded and arm.joint_row_s > 0.0


def weights(arm: Arm) -> Floats:
    """(N,) factors of the joints' rows."""
    sigma = _torque_sigma(arm)
    return 1.0 / sigma if (sigma > 0.0).all() else np.ones(arm.n)


def _torque_sigma(arm: Arm) -> Floats:
    """(N,) declared deviations of the torques behind the gear, over the wire; 0 where none is declared [Nm]."""
    declared = np.array([joint.torque_sigma > 0.0 for joint in arm.joints])
    sigma = np.array([joint.over_the_wire.torque_sigma for joint in arm.joints])
    return np.asarray(declared * arm.gear_ratios * sigma, dtype=np.float64)


def torque_noise(arm: Arm) -> float:
    """Mean square of the declared noise of torques in a row: that of each period is independent."""
    steps = increment_instants(arm, arm.joint_row_s)
    square: Floats = (weights(arm) * _torque_sigma(arm) * arm.period_s) ** 2
    return float(square.mean()) * steps


def groups(arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect] = ()) -> Groups | None:
    """The joint rows of a whole record without the segments that the library left out; None if the arm switches them
    off. Errors: as `estimated`."""
    if arm.joint_row_s == 0.0:
        return None
    rows = joint_rows(arm, samples, smoothed, arm.joint_row_s, effects)
    formed = _formed(arm, smoothed, rows)
    half_s = 0.5 * arm.period_s * increment_instants(arm, arm.joint_row_s)
    length = max(SEGMENT_INCREMENTS, int(SEGMENT_S / half_s))
    complete = formed[:, -1]
    # an increment counts for a segment with the row of its last joint
    counts: Places = 1 * (rows.accepted & complete)
    segment: Places = (np.cumsum(counts) - counts) // length
    segment, kept = _kept(arm, samples, smoothed, rows, segment)
    used = formed & (rows.accepted & kept)[:, None]
    factor = weights(arm)
    increment, joint = np.nonzero(used)
    z, w = rows.z[increment, joint] * factor[joint, None], rows.w[increment, joint] * factor[joint]
    p, effects_count = z.shape[1], len(estimated(arm, effects))
    number = segment[increment]
    shares = np.zeros((GROUPS, p, p))
    if arm.compensation:
        turn: Places = np.cumsum(complete) - complete
        lines, rotors = _noise(arm, smoothed, rows, turn)
        own = lines[increment, joint] * factor[joint, None]
        own = np.concatenate([own, np.zeros((len(own), effects_count))], axis=1)
        for g in range(GROUPS):
            of = number % GROUPS == g
            shares[g] = own[of].T @ own[of]
            diagonal = (rotors[increment[of], joint[of]] * factor[joint[of], None] ** 2).sum(axis=0)
            for i, entry in enumerate(diagonal):
                if arm.joints[i].flexible:
                    at = arm.parameter_names.index(f"Im{i + 1}")
                    shares[g, at, at] += entry
    noise = np.zeros((p + 1, p + 1))
    noise[:-1, :-1] = shares.sum(axis=0)
    noise[-1, -1] = torque_noise(arm) * len(z)
    return Groups(Rows(z, w, noise), number % GROUPS, number, joint, shares)


def _kept(
    arm: Arm, samples: Samples, smoothed: Smoothed, rows: JointRows, segment: Places
) -> tuple[Places, NDArray[np.bool_]]:
    """(m,) number of each increment's segment among those that the library kept, and (m,) whether it kept it.

    The library ends a segment when it has added the last row, that of the last joint of the last accepted increment;
    the cycle in which it says so is that of the row or a later one, before the next segment is complete.
    """
    told = samples.left_out.get("energy", frozenset()) if suffice(arm) else frozenset()
    kept = np.ones(len(segment), dtype=np.bool_)
    number = segment.copy()
    if not told:
        return number, kept
    complete = np.unique(segment[rows.accepted])
    formed = np.zeros(len(complete), dtype=np.int64)
    for k, one in enumerate(complete.tolist()):
        last = int(np.flatnonzero((segment == one) & rows.accepted)[-1])
        row = min(int(rows.end[last]) + arm.n, len(smoothed.index) - 1)
        formed[k] = int(samples.sync[smoothed.index[row] + arm.smoother.lag])
    for end in sorted(told):
        if (formed <= end).any():
            one = complete[np.argmax(np.where(formed <= end, formed, -1))]
            kept &= segment != one
            number -= segment > one
    return number, kept


def _formed(arm: Arm, smoothed: Smoothed, rows: JointRows) -> NDArray[np.bool_]:
    """(m, N) whether a row was formed: that of joint j (from 0) j + 1 instants after its increment."""
    last = np.full(int(smoothed.segment.max(initial=-1)) + 1, -1)
    np.maximum.at(last, smoothed.segment, np.arange(len(smoothed.segment)))
    return np.asarray(rows.end[:, None] + 1 + np.arange(arm.n) <= last[rows.segment][:, None], dtype=np.bool_)


def _noise(arm: Arm, smoothed: Smoothed, rows: JointRows, turn: Places) -> tuple[Floats, Floats]:
    """Lines (m, N, p) whose squares are the noise of the signal whose turn it is, times the number of signals; and the
    noise (m, N, N) of the rates of rotors behind springs, on the diagonal at their inertia.

    The columns of momentum are linear in the rates, so those of a unit rate are their derivatives. Both ends of an
    increment count as the last.
    """
    state, known = State.smoothed(arm, smoothed), variances(arm)
    q = state.q[rows.end]
    still = np.zeros_like(q)
    rest = np.zeros((len(q), 3)) if arm.spatial else np.zeros(len(q))
    axes = (np.eye(3) if arm.spatial else np.ones((1,))) if arm.free else np.zeros((0,))
    signals = arm.n + len(axes)
    flexible = np.array([joint.flexible for joint in arm.joints])
    slopes = []
    for signal in range(signals):
        rate, base = still.copy(), rest.copy()
        if signal < arm.n:
            rate[:, signal] = np.sqrt(2.0 * signals * known.link[signal])
        else:
            base = base + np.sqrt(2.0 * signals * known.base) * axes[signal - arm.n]
        columns = joint_columns(arm, State(q, q, rate, rate * ~flexible, base))
        slopes.append(in_order(arm, columns.momentum, columns.rotor_momentum))
    lines = np.stack(slopes)[turn % signals, np.arange(len(q))]
    spun = np.zeros((len(q), arm.n, arm.n))
    for i in np.flatnonzero(flexible):
        unit = still.copy()
        unit[:, i] = 1.0
        columns = joint_columns(arm, State(q, q, still, unit, rest))
        spun[:, :, i] = 2.0 * known.rotor[i] * columns.rotor_momentum[:, :, i] ** 2 * (np.arange(arm.n) < i)
    return lines, spun

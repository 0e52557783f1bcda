# SPDX-License-Identifier: MIT
"""Faults that only the arm as a whole shows, detected by the C library's energy balance."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from zygos.arm import HIGHEST_ORDER, TORQUE_GAIN_SIGMA, Arm, Smoother, TorqueLaw
from zygos.audit.means import Array
from zygos.audit.remedies import KINDS
from zygos.effects import CATALOGUE, GAIN, Effect, with_gains
from zygos.files.output import counted
from zygos.native.flight import REASONS, Estimate, Flight, fits_window, lib
from zygos.runs.cycles import Cycles

MOST_CYCLES = 20_000
"""Largest number of cycles in the balance, which is computed again for every possible fault."""
MOST_SMOOTHED = 100_000
"""The same where the run is flown two to four times."""
LAWS: tuple[TorqueLaw, ...] = ("applied_from_sync", "applied_previous_cycle", "sampled")


@dataclass(frozen=True)
class WholeFault:
    """A fault of the gyro, or of all signals of a joint, and the run after correction."""

    what: str
    """Kind of fault: "gyro", "inverted", "swapped"."""
    joints: tuple[int, ...]
    turn: Array
    """(3, 3) true gyro reading = turn @ reading; the identity for a fault of joints."""
    cycles: Cycles


@dataclass(frozen=True)
class Flattened:
    """What another smoother makes of a run."""

    smoother: Smoother
    """Of the next order, in the same window or the next one that holds it."""
    parameter: str
    """The parameter that moves furthest."""
    sigmas: float
    """How far, in its larger standard deviation with one of the smoothers."""


def flattened(arm: Arm, cycles: Cycles, effects: Sequence[Effect]) -> Flattened | None:
    """Compare the estimate with that of a smoother whose polynomial has the next order. None where one of them gives
    no values, neither with these effects nor without, or the C library has no room for the other.

    Noise moves a value by less than the larger standard deviation; what a polynomial takes off the motion, which the
    standard deviations do not contain, moves it further.
    """
    points = max(arm.smoother.points, arm.smoother.order + 5)
    other = replace(arm, smoother=Smoother(points, arm.smoother.order + 2, points // 2))
    if arm.smoother.cutoff_hz is not None or other.smoother.order > HIGHEST_ORDER or not fits_window(other):
        return None
    part = Cycles(*(getattr(cycles, name)[:MOST_SMOOTHED] for name in Cycles.__dataclass_fields__))

    def estimate(own: Arm, columns: Sequence[Effect]) -> Estimate:
        flight = Flight(own, columns)
        flight.cycles(part)
        return flight.estimate()

    for columns in ((), effects):
        first = estimate(arm, columns)
        if first.validity not in ("valid", "partial"):
            continue
        second = estimate(other, columns)
        if second.validity not in ("valid", "partial"):
            continue
        with np.errstate(invalid="ignore"):
            moved = np.nan_to_num(np.abs(second.value - first.value) / np.maximum(first.sigma, second.sigma))
        furthest = int(np.argmax(moved))
        return Flattened(other.smoother, first.names[furthest], float(moved[furthest]))
    return None


class Balance:
    """The energy balance of a run under any arm file. It includes friction in the motors, which real motors have."""

    def __init__(self, arm: Arm, cycles: Cycles) -> None:
        """Take the first `MOST_CYCLES` cycles. Errors: ZygosError if the C library has no columns for the arm."""
        self.arm = arm
        self.cycles = Cycles(*(getattr(cycles, name)[:MOST_CYCLES] for name in Cycles.__dataclass_fields__))
        unused = lib.ZYGOS_MAX_EFFECTS_VALUE - len(with_gains(arm, ()))
        friction = [(kind, joint.name) for kind in ("motor_coulomb", "motor_viscous") for joint in arm.joints]
        self.friction = [Effect(CATALOGUE[kind], joint, 0.0) for kind, joint in friction[: max(unused, 0)]]
        self.reason = ""
        """The reason why the last computed residual is infinite."""
        self.few = False
        """Whether the reason is that there are too few instants."""
        self.residual_j = self.residual(arm, self.cycles)
        self.noisy = self._reason == REASONS[lib.ZYGOS_REASON_NOISE]
        """Whether sensor noise is as large as the motion, so that no shift in time can be told from another."""

    def residual(self, arm: Arm, cycles: Cycles) -> float:
        """rms residual, J; infinite if there is no estimate."""
        return self._residuals(arm, cycles)[0]

    def share(self, cycles: Cycles) -> float:
        """rms residual as a share of the rms work; infinite if there is no estimate."""
        return self._residuals(self.arm, cycles)[1]

    def closes(self, cycles: Cycles) -> bool:
        """Whether an estimate from a run is valid, so that the balance closes without doubt."""
        self.residual(self.arm, cycles)
        return self._validity in ("valid", "partial")

    def _residuals(self, arm: Arm, cycles: Cycles) -> tuple[float, float]:
        """rms residual, J, and its share of the rms work."""
        flight = Flight(arm, self.friction)
        flight.cycles(cycles)
        estimate = flight.estimate()
        residual = float(estimate.residual)
        self._reason, self._validity = estimate.reason, estimate.validity
        if math.isfinite(residual) and residual > 0.0:
            return residual, math.sqrt(flight.unexplained(estimate))
        self.few = estimate.reason == REASONS[1]
        self.reason = (
            f"{estimate.reason}: {counted(estimate.accepted, 'instant')} accepted, {estimate.refused:,} refused by the "
            "bandwidth test"
        )
        return math.inf, math.inf

    def gains(self, cycles: Cycles) -> Array | None:
        """(N,) how many times the torque that fits the first joint's each torque sensor reports; None where the balance
        does not close with any gains."""
        joints = tuple(
            replace(joint, torque_gain_sigma=joint.torque_gain_sigma or TORQUE_GAIN_SIGMA) for joint in self.arm.joints
        )
        arm = replace(self.arm, joints=joints)
        room = lib.ZYGOS_MAX_EFFECTS_VALUE - len(with_gains(arm, ()))
        flight = Flight(arm, self.friction[: max(room, 0)])
        flight.cycles(cycles)
        estimate = flight.estimate()
        if estimate.validity not in ("valid", "partial") and estimate.reason != REASONS[lib.ZYGOS_REASON_GAIN]:
            return None
        found = np.ones(arm.n)
        for i in arm.relative_gains:
            found[i] = 1.0 / (1.0 + estimate.solution[estimate.names.index(f"{GAIN}{i + 1}")])
        return np.asarray(found / found[0], dtype=np.float64)

    def laws(self, arm: Arm, cycles: Cycles) -> dict[TorqueLaw, float]:
        """rms residual under each torque law, J."""
        return {law: self.residual(replace(arm, torque_law=law), cycles) for law in LAWS}

    def trials(self, zeros: dict[str, Array]) -> Iterator[tuple[float, WholeFault]]:
        """What is `left` after correction of each fault. zeros: as in `zygos.audit.motors.changed`."""
        for turn in self._turns():
            moved = replace(self.cycles, omega=self.cycles.omega @ turn.T)
            yield self.residual(self.arm, moved), WholeFault("gyro", (), turn, moved)
        for i in range(self.arm.n):
            fields = {kind: getattr(self.cycles, kind).copy() for kind in KINDS}
            for kind in KINDS:
                fields[kind][:, i] = 2.0 * (zeros[kind][i] if kind in zeros else 0.0) - fields[kind][:, i]
            moved = replace(self.cycles, **cast("dict[str, object]", fields))  # type: ignore[arg-type]
            yield self.residual(self.arm, moved), WholeFault("inverted", (i,), np.eye(3), moved)
        for a, b in itertools.combinations(range(self.arm.n), 2):
            order = list(range(self.arm.n))
            order[a], order[b] = b, a
            c = self.cycles
            moved = replace(c, q=c.q[:, order], theta=c.theta[:, order], tau=c.tau[:, order])
            yield self.residual(self.arm, moved), WholeFault("swapped", (a, b), np.eye(3), moved)

    def _turns(self) -> Iterator[Array]:
        """Exchanges and inversions of the gyro's axes, the simplest first; where several are equivalent on a planar
        arm, only one of them."""
        identity = np.eye(3)
        turns = [
            np.diag(signs) @ identity[list(order)]
            for order in itertools.permutations(range(3))
            for signs in itertools.product((1.0, -1.0), repeat=3)
        ]
        axis = None if self.arm.spatial else self.arm.mount.T @ self.arm.axis
        seen: list[Array] = []
        for turn in sorted(turns, key=lambda t: float(np.abs(t - identity).sum())):
            felt = turn if axis is None else turn.T @ axis
            if not any(np.allclose(felt, other) for other in seen):
                seen.append(felt)
                if len(seen) > 1:
                    yield turn

# SPDX-License-Identifier: MIT
"""Which balances fail by themselves, and where to look for the cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.gap.balances import Layout
from zygos.gap.findings import Deflection, Finding
from zygos.gap.record import MeasuredRun

Array = NDArray[np.float64]
Side = Literal["motors", "joints", "base", "link"]
"""Motor side of joints, flexibility of joints, base and gyro and assumed momentum, link side."""


@dataclass(frozen=True)
class Failing:
    """A balance that does not close when it is fitted by itself."""

    balance: str
    """E, M or L and the number of a joint, H or Hx, Hy, Hz."""
    rho: float
    """Residual in units of the null twin's, on the run where it is larger."""

    @property
    def joint(self) -> int | None:
        """Joint from 0 of a motor's balance; None for one of the whole arm."""
        return joint_of(self.balance)


@dataclass(frozen=True)
class Whereabouts:
    """Where a simulation and runs disagree."""

    bent: tuple[Deflection, ...]
    """Joints that bend, of those that the simulation takes as rigid."""
    failing: tuple[Failing, ...]
    look: tuple[Side, ...]
    """Sides to look at, most likely first; empty where effects were named or the arm file comes first."""
    motors: tuple[str, ...]
    """Joints whose motor sides are meant."""
    named: tuple[Finding, ...]
    """Effects whose places say it."""


def joint_of(balance: str) -> int | None:
    """Joint from 0 of a motor's balance; None for a balance of the whole arm."""
    return int(balance[1:]) - 1 if balance[0] == "M" else None


def whereabouts(
    arm: Arm,
    layout: Layout,
    local: Array,
    flexible: Sequence[Deflection],
    findings: Sequence[Finding] = (),
    *,
    first: bool = False,
) -> Whereabouts:
    """From each balance by itself, local (runs, balances) rho.

    Where effects were named, it is their places; where timing or sensors come first, it is the verdict that says where.
    Else it is where those balances are that fail about as much as the worst: an effect shows in others, too.
    """
    worst = np.nanmax(np.where(np.isnan(local), 0.0, local), axis=0)
    every = [Failing(name, rho) for name, rho in zip(layout.balances, worst.tolist(), strict=True)]
    failing = tuple(one for one in every if one.rho**2 - 1.0 > limits.EXCESS.value)
    look: tuple[Side, ...] = ()
    motors: tuple[str, ...] = ()
    if (flexible or failing) and not findings and not first:
        most = max((one.rho for one in failing), default=0.0)
        plain = [one for one in failing if one.rho >= limits.FAILS_ALIKE.value * most]
        motors = tuple(arm.joints[one.joint].name for one in plain if one.joint is not None)
        look = _sides([one.balance for one in plain], [one.balance for one in failing], bent=bool(flexible))
    return Whereabouts(tuple(flexible), failing, look, motors, tuple(findings))


def _sides(plain: Sequence[str], failing: Sequence[str], *, bent: bool) -> tuple[Side, ...]:
    """plain: balances that fail about as much as the worst of those that fail."""
    if any(joint_of(name) is not None for name in plain):
        return ("motors", "base") if any(name[0] == "H" for name in plain) else ("motors",)
    if bent:
        return ("joints",)
    if any(name[0] == "H" for name in plain):
        # friction at a link shows in the momentum, too
        return ("base", "link") if "E" in failing else ("base",)
    return ("link", "base") if any(name[0] == "H" for name in failing) else ("link",)


def deflection(arm: Arm, records: Sequence[MeasuredRun], joint: int) -> Deflection:
    """How far link and motor part at a joint, and how much of it goes with the joint's rate."""
    h = arm.period_s
    parted, rate = [], []
    for record in records:
        readings = record.readings()
        apart = (readings.theta - readings.q)[..., joint]
        parted.append((apart - apart.mean())[:, 1:-1].ravel())
        rate.append(((readings.q[:, 2:, joint] - readings.q[:, :-2, joint]) / (2.0 * h)).ravel())
    d, v = np.concatenate(parted), np.concatenate(rate)
    v = v - v.mean()
    skew = float(d @ v / (v @ v)) if np.any(v) else 0.0
    described = arm.joints[joint]
    return Deflection(
        described.name,
        float(np.sqrt(np.mean(d**2))),
        float(np.hypot(described.link_encoder.sigma_rad, described.motor_encoder.sigma_rad)),
        skew,
        float(1.0 - np.mean((d - skew * v) ** 2) / np.mean(d**2)) if np.any(d) else 0.0,
    )

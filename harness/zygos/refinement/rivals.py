"""Tests of a fit against models that have one thing more.

The filter takes the torques as they are reported. If it follows the readings better once all torques are delayed a
little, once those of one joint are a little larger, or once there is friction, an offset or an encoder zero, then the
model of the fit lacks something, and its values have errors that their deviations do not show. The fall of the deviance
is the square of a number of standard deviations.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError
from zygos.refinement.follow import Beside, Pass
from zygos.refinement.record import Piece, Record

Floats = NDArray[np.float64]

Follow = Callable[[Record, Beside], Pass]

_LARGEST = 0.3
"""Largest share by which torques are changed."""
EXPECTED = 0.003
"""Standard deviation of friction and offsets before the first reading, as a share of the typical torque. Much more
leads the filter out of the range in which the motion is linear."""


@dataclass(frozen=True)
class Rival:
    """A model with one thing more."""

    title: str
    """What it has, in words."""
    value: float
    """Its estimate."""
    unit: str
    sigmas: float
    """By how many standard deviations the readings favour it."""


def rivals(
    record: Record, beside: Beside, found: Pass, step: float, follow: Follow, progress: Callable[[float], None]
) -> tuple[Rival, ...]:
    """Each rival of the pass `found`, which `follow` made of the record with the constants `beside`; those with which
    the filter fails are left out.

    step: share by which torques are changed; the noise of the torques as a share of their size is a good one.
    """
    arm = record.arm
    sigma = EXPECTED * typical_torque(record)
    unknown = np.stack([np.zeros_like(sigma), sigma])
    tests: list[Callable[[], list[Rival]]] = []

    def changed(title: str, unit: str, factor: float, change: Callable[[Piece, float], Piece]) -> None:
        def deviance(share: float) -> float:
            pieces = tuple(change(piece, share) for piece in record.pieces)
            return follow(replace(record, pieces=pieces), beside).deviance

        def run() -> list[Rival]:
            share = step
            below, above = deviance(-share), deviance(share)
            bend = 0.5 * (below + above) - found.deviance
            if bend < 1.0 and share < _LARGEST:
                # the change is smaller than its standard deviation, so that a parabola through it says little
                share = min(_LARGEST, 3.0 * share / math.sqrt(bend)) if bend > 0.01 else min(_LARGEST, 30.0 * share)
                below, above = deviance(-share), deviance(share)
            return [_between(title, unit, factor * share, below, found.deviance, above)]

        tests.append(run)

    def added(title: str, more: Beside, place: int) -> None:
        def run() -> list[Rival]:
            other = follow(record, more)
            pairs = list(zip(other.beside[place:], other.beside_sigma[place:], arm.joints, strict=False))
            return [Rival(title.format(j.name), float(x), "Nm", abs(float(x / sigma))) for x, sigma, j in pairs]

        tests.append(run)

    changed("a delay of the torques", "ms", 1e3 * arm.period_s, _delayed)
    # nobody can tell the gain of all joints together
    for k, joint in enumerate(arm.joints[1:], 1):
        changed(f"a larger torque of {joint.name}", "%", 100.0, partial(_scaled, k))
    if beside.friction is None:
        added("Coulomb friction of the motor of {}", replace(beside, friction=unknown), 0)
    if beside.offsets is None:
        place = 0 if beside.friction is None else arm.n
        added("an offset of the torque of {}", replace(beside, offsets=unknown), place)
    answers: list[Rival] = []
    for number, test in enumerate(tests):
        with suppress(ZygosError):
            answers += test()
        progress((number + 1) / len(tests))
    return tuple(answers)


def typical_torque(record: Record) -> Floats:
    """(N,) root mean square of the torques of a record, Nm before the gear."""
    torque = np.concatenate([piece.tau for piece in record.pieces])
    return np.asarray(np.sqrt(np.mean(torque**2, axis=0)), dtype=np.float64)


def _between(title: str, unit: str, step: float, below: float, at: float, above: float) -> Rival:
    """The lowest point of the parabola through three deviances; where it has none, the lowest of the three."""
    bend, slope = 0.5 * (below + above) - at, 0.5 * (above - below)
    if bend > 0.0:
        return Rival(title, -0.5 * slope / bend * step, unit, 0.5 * abs(slope) / math.sqrt(bend))
    return Rival(title, step if above < below else -step, unit, math.sqrt(at - min(below, above)))


def _delayed(piece: Piece, share: float) -> Piece:
    """Torques that act a share of a period later; a negative share: earlier."""
    other = np.roll(piece.tau, 1 if share > 0.0 else -1, axis=0)
    if share > 0.0:
        other[0] = piece.tau[0]
    else:
        other[-1] = piece.tau[-1]
    return replace(piece, tau=piece.tau + abs(share) * (other - piece.tau))


def _scaled(joint: int, piece: Piece, share: float) -> Piece:
    tau = piece.tau.copy()
    tau[:, joint] *= 1.0 + share
    return replace(piece, tau=tau)

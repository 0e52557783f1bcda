"""One pass of the filter of the C library over a record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.native.flight import CHANNELS
from zygos.native.refiner import Refiner, Settings
from zygos.refinement.record import Record, start_of

Floats = NDArray[np.float64]


_WAY = 120
"""Instants at which the way of the estimate is kept."""
_SOME = 200
"""SYNCs between two reports of the progress."""


@dataclass(frozen=True)
class Beside:
    """Constants that are estimated beside the parameters: values and standard deviations before the first reading, one
    row each; N joints."""

    friction: Floats | None = None
    """(2, N) of the Coulomb friction of each rotor, Nm; None: there is none."""
    offsets: Floats | None = None
    """(2, N) of the offset of each torque, Nm before the gear."""
    zeros: Floats | None = None
    """(2, 2N) of the zeros of link and motor encoders, rad."""

    @property
    def all(self) -> Floats:
        """(2, c) of all of them."""
        parts = [part for part in (self.friction, self.offsets, self.zeros) if part is not None]
        return np.concatenate([np.zeros((2, 0)), *parts], axis=1)


@dataclass(frozen=True)
class Start:
    """What is known of the p parameters before the first reading, SI units."""

    value: Floats
    """(p,)."""
    covariance: Floats
    """(p, p)."""


@dataclass(frozen=True)
class Pass:
    """What one pass has found; p parameters, c constants beside them."""

    value: Floats
    """(p,) parameters, SI units."""
    covariance: Floats
    """(p, p)."""
    beside: Floats
    """(c,) friction, offsets and zeros, as in `Beside`."""
    beside_sigma: Floats
    """(c,)."""
    deviance: float
    """As `Refiner.deviance`."""
    squares: Floats
    """(n, channels) normalised squared innovations of each SYNC that was read, summed over the sensors of a channel;
    of all pieces one after the other."""
    counts: Floats
    """(channels,) readings of a SYNC."""
    way: tuple[tuple[int, Floats, Floats], ...]
    """At some instants the number of SYNCs read, the parameters and their standard deviations, (p,) each."""
    states: tuple[Floats, ...]
    """Of each piece (n, W + 4N) the filtered states, where they were asked for."""


def follow(
    record: Record,
    settings: Settings,
    start: Start,
    beside: Beside | None = None,
    *,
    keep: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Pass:
    """Follow all pieces: parameters and constants beside them are the same in all, and state and bias begin anew.

    keep: also return states and the way of the estimate. Errors: ZygosError if the filter fails.
    """
    arm = record.arm
    refiner = Refiner(arm, settings)
    extra = (beside or Beside()).all
    total = sum(len(piece.read) for piece in record.pieces)
    done, read = 0, 0
    marks = np.linspace(0, record.cycles, _WAY + 1)[1:] if keep else np.zeros(0)
    squares = np.zeros((record.cycles, len(CHANNELS)))
    way: list[tuple[int, Floats, Floats]] = []
    states: list[Floats] = []
    before = np.zeros(len(CHANNELS))
    for number, piece in enumerate(record.pieces):
        x, sigma = start_of(arm, piece)
        if number == 0:
            x = np.concatenate([x, start.value, extra[0]])
            sigma = np.concatenate([sigma, np.zeros_like(start.value), extra[1]])
            refiner.start(x, sigma, start.covariance)
        else:
            refiner.resume(x, sigma)
        kept = np.zeros((len(piece.read), refiner.states)) if keep else np.zeros((0, 0))
        for k, seen in enumerate(piece.read):
            if k:
                refiner.advance(piece.tau[k - 1], float(piece.lost[k - 1]))
            if seen:
                refiner.read(piece.q[k], piece.theta[k], piece.omega[k])
                now = refiner.sums
                squares[read] = now - before
                before = now
                read += 1
                if len(way) < len(marks) and read >= marks[len(way)]:
                    value, covariance = refiner.estimate()
                    way.append((read, value, np.sqrt(np.diag(covariance))))
            if keep:
                kept[k] = refiner.x[: refiner.states]
            if (done + k) % _SOME == 0:
                progress((done + k) / total)
        done += len(piece.read)
        if keep:
            states.append(kept)
    value, covariance = refiner.estimate()
    places = slice(refiner.fast + len(value), None)
    spread = np.sqrt(np.sum(refiner.root[places] ** 2, axis=1))
    width = 0 if not arm.free else 3 if arm.spatial else 1
    return Pass(
        value,
        covariance,
        refiner.x[places],
        spread,
        refiner.deviance,
        squares,
        np.array([arm.n, arm.n, width], dtype=np.float64),
        tuple(way),
        tuple(states),
    )

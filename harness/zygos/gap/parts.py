# SPDX-License-Identifier: MIT
"""Parts of a law: each may have a size of its own where the law of the arm has another form than its column."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.effects import Kind, Motion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """The law where what it acts on lies between two sizes, or what lags behind it there."""

    kind: Kind
    share: float
    """Of the square of the law's torque."""
    lags: bool


def acted_on(kind: Kind, motion: Motion) -> Array:
    """(...) size of the deflection that a law of a spring acts on, of the rate elsewhere."""
    signal = motion.deflection if kind.place == "spring" else motion.rate
    return np.abs(np.broadcast_to(signal, np.shape(motion.rate)))


def parts_of(kind: Kind, torque: Array, size: Array) -> list[Part]:
    """Strata of what a law acts on, and what lags behind it. torque, size: (n,) of the law along the motion, per unit
    of its coefficient, and of what it acts on."""
    square, order = torque**2, np.argsort(size)
    grown = np.cumsum(square[order])

    def below(share: float) -> float:
        return float(size[order][np.searchsorted(grown, share * grown[-1])])

    def part(name: str, low: float, high: float, *, lags: bool = False) -> Part:
        share = float(square[(size >= low) & (size < high)].sum() / grown[-1])
        return Part(_cut(kind, name, low, high, lags=lags), share, lags)

    edges = [*enumerate(pairwise([0.0, *map(below, limits.STRATA.value)]))]
    strata = [part(f"stratum{'abcdef'[k]}", low, high) for k, (low, high) in edges]
    return [one for one in (*strata, part("lagging", 0.0, below(limits.REVERSAL.value), lags=True)) if one.share > 0.0]


def _cut(kind: Kind, name: str, low: float, high: float, *, lags: bool) -> Kind:
    """The entry with its law where what it acts on lies between two sizes. lags: with the sign of its growth, which
    turns where what it acts on does: behind the law by a quarter of a turn."""
    law = kind.law
    assert law is not None

    def cut(motion: Motion, shape: float) -> Array:
        size = acted_on(kind, motion)
        sign = -np.sign(np.gradient(size, axis=-1)) if lags else 1.0
        return np.asarray(law(motion, shape) * ((size >= low) & (size < high)) * sign, dtype=np.float64)

    return replace(kind, key=f"{kind.key}_{name}", law=cut, potential=None, impulse=None, viscous=False, positive=False)

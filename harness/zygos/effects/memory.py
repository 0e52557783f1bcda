# SPDX-License-Identifier: MIT
"""The memory of a law: internal states that follow the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.effects.motion import Motion

Array = NDArray[np.float64]
States = NDArray[Any]
"""Internal states, real or complex."""


@dataclass(frozen=True)
class Memory:
    """Internal states z of a law, of which each obeys dz/dt = b - a z.

    A state whose a is complex swings. At the start of a run states are where they would rest at its first rate: at
    b / a, or at 0 where a is 0.
    """

    rates: Callable[[Motion, float], tuple[States, States]]
    """rates(motion, shape): b and a, (..., s) each, 1/s."""
    size: int = 1
    """s."""
    stops: bool = False
    """Whether a state that reaches -1 or 1 stays there until it turns back; its a is real."""

    def derivative(self, z: States, b: States, a: States) -> States:
        """dz/dt of states (..., s)."""
        rate = b - a * z
        return np.where((np.abs(z) >= 1.0) & (np.real(rate) * np.real(z) > 0.0), 0.0, rate) if self.stops else rate

    def advanced(self, z: States, b: States, a: States, span: float) -> States:
        """States (..., s) after so many seconds with constant b and a."""
        kept, gained = _over(b, a, span)
        after = kept * z + gained
        return np.clip(np.real(after), -1.0, 1.0) if self.stops else after

    def along(self, motion: Motion, shape: float, period_s: float) -> Motion:
        """The motion (..., m) or (..., A, m) with the states along it.

        The m instants are a period apart, and those of the A arcs one after the other if their time says so. Between
        two instants b and a are the means of those at both.
        """
        b, a = self.rates(motion, shape)
        shaped = b.shape
        rows = shaped[:-1][-2:]
        length = int(np.prod(rows))
        joined = (*shaped[: len(shaped) - 1 - len(rows)], length, shaped[-1])
        b, a = b.reshape(joined), a.reshape(joined)
        kept, gained = _over(0.5 * (b[..., 1:, :] + b[..., :-1, :]), 0.5 * (a[..., 1:, :] + a[..., :-1, :]), period_s)
        first = np.zeros_like(b[..., :1, :])
        kept, gained = np.concatenate([first, kept], axis=-2), np.concatenate([first, gained], axis=-2)
        anew = _anew(np.broadcast_to(motion.time, shaped[:-1]).reshape(joined[:-1]), rows[-1], period_s)[..., None]
        kept, gained = np.where(anew, 0.0, kept), np.where(anew, at_rest(b, a), gained)
        return replace(motion, memory=self._followed(kept, gained).reshape(shaped))

    def _followed(self, kept: States, gained: States) -> States:
        """(..., n, s) states after each of n steps z -> kept z + gained, the first of which keeps nothing.

        The steps are cut into blocks as long as there are blocks: first what each block does to the state before it is
        composed, of all blocks at once, then one block follows on the other.
        """
        count = kept.shape[-2]
        size = max(1, round(float(np.sqrt(count))))
        blocks = -(-count // size)

        def cut(x: States) -> States:
            """(size, ..., blocks, s)"""
            padded = np.zeros((*x.shape[:-2], blocks * size, x.shape[-1]), dtype=x.dtype)
            padded[..., :count, :] = x
            return np.moveaxis(padded.reshape(*x.shape[:-2], blocks, size, x.shape[-1]), -2, 0).copy()

        keep, gain = cut(kept), cut(gained)
        low, high = (np.full(gain.shape if self.stops else 0, x) for x in (-1.0, 1.0))
        for k in range(1, size):
            if self.stops:
                # a stop before is moved by the steps behind it, and stopped again
                low[k], high[k] = (np.clip(keep[k] * x[k - 1] + gain[k], -1.0, 1.0) for x in (low, high))
            gain[k] += keep[k] * gain[k - 1]
            keep[k] *= keep[k - 1]
        for k in range(blocks):
            at = (..., k, slice(None))
            if k > 0:
                gain[at] += keep[at] * gain[-1, ..., k - 1, :]
            if self.stops:
                gain[at] = np.clip(gain[at], low[at], high[at])
        joined = np.moveaxis(gain, 0, -2).reshape(*kept.shape[:-2], blocks * size, kept.shape[-1])
        return np.asarray(joined[..., :count, :])


def at_rest(b: States, a: States) -> States:
    """b / a, and 0 where a is 0."""
    return np.where(a != 0.0, b, 0.0) / np.where(a != 0.0, a, 1.0)


def _over(b: States, a: States, span: float) -> tuple[States, States]:
    """What a step of so many seconds keeps of a state, and adds to it."""
    if not a.any():
        return np.ones_like(b), b * span
    decay = a * span
    small = np.abs(decay) < 1e-8
    share = np.where(small, 1.0 - 0.5 * decay, -np.expm1(-decay) / np.where(small, 1.0, decay))
    return np.exp(-decay), b * span * share


def _anew(time: Array, length: int, period_s: float) -> NDArray[np.bool_]:
    """(..., n) instants that do not follow on the one before; rows of that length whose time is unknown do not."""
    apart = np.diff(time, axis=-1)
    out = np.concatenate(
        [np.ones((*time.shape[:-1], 1), dtype=np.bool_), np.abs(apart - period_s) > 0.5 * period_s], -1
    )
    if not np.isfinite(time).all():
        out[..., ::length] = True
    return out

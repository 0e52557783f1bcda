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
        """(..., n, s) states after each of n steps z -> kept z + gained, all of which are taken at once: the steps of
        twice as many instants are those of the first half of them, and then those of the second."""
        low, high = np.full(kept.shape, -1.0), np.full(kept.shape, 1.0)
        gained, kept = gained.copy(), kept.copy()
        span = 1
        while span < kept.shape[-2]:
            before, now = (..., slice(None, -span), slice(None)), (..., slice(span, None), slice(None))
            if self.stops:
                # a stop before is moved by the steps behind it, and stopped again
                limits = [np.clip(kept[now] * x[before] + gained[now], low[now], high[now]) for x in (low, high)]
            gained[now] += kept[now] * gained[before]
            kept[now] = kept[now] * kept[before]
            if self.stops:
                low[now], high[now] = limits
            span *= 2
        return np.clip(gained, low, high) if self.stops else gained


def at_rest(b: States, a: States) -> States:
    """b / a, and 0 where a is 0."""
    return np.where(a != 0.0, b, 0.0) / np.where(a != 0.0, a, 1.0)


def _over(b: States, a: States, span: float) -> tuple[States, States]:
    """What a step of so many seconds keeps of a state, and adds to it."""
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

# SPDX-License-Identifier: MIT
"""The window of a Savitzky-Golay filter whose rates have a wanted cut-off."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

HALF_WIDTH_MAX = 31
"""Largest half width of a window, in cycles."""
ORDERS = (4, 2)
"""Orders of the polynomial, in the order of preference: the rates of the first one are flatter below the cut-off."""
_NARROWEST = {4: 3, 2: 2}
"""Smallest half width for each order, which the bandwidth test needs."""


@cache
def rate_cutoff(half_width: int, order: int) -> float:
    """Frequency, in cycles per sample, at which the rate of a window of 2 half_width + 1 samples is 3 dB below the true
    one."""
    at = np.arange(-half_width, half_width + 1)
    slope = np.linalg.pinv(np.vander(at / half_width, order + 1, increasing=True))[1]  # of the fitted polynomial at 0
    weights = slope / half_width
    f = np.linspace(0.0, 0.5, 64 * half_width + 1)[1:]
    gain = np.sin(2.0 * np.pi * np.outer(f, at)) @ weights / (2.0 * np.pi * f)
    below = int(np.argmax(gain < math.sqrt(0.5)))
    return float(np.interp(-math.sqrt(0.5), -gain[below - 1 : below + 1], f[below - 1 : below + 1]))


def window(cutoff_hz: float, period_s: float) -> tuple[int, int] | None:
    """Points and order of the filter whose cut-off is nearest to the wanted one; order 4 where its window is not too
    wide, else order 2. None: no window at this period has that cut-off."""
    wanted = cutoff_hz * period_s
    for order in ORDERS:
        if rate_cutoff(HALF_WIDTH_MAX, order) <= wanted <= rate_cutoff(_NARROWEST[order], order):
            widths = range(_NARROWEST[order], HALF_WIDTH_MAX + 1)
            half = min(widths, key=lambda width: abs(math.log(rate_cutoff(width, order) / wanted)))
            return 2 * half + 1, order
    return None


def periods(cutoff_hz: float) -> tuple[float, float]:
    """The shortest and the longest period, s, at which an order-4 window has that cut-off."""
    return rate_cutoff(HALF_WIDTH_MAX, 4) / cutoff_hz, rate_cutoff(_NARROWEST[4], 4) / cutoff_hz

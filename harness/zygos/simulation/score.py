# SPDX-License-Identifier: MIT
"""Compares estimates with true values; this happens only here, after the estimate is written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Score:
    """Relative errors of estimates (..., p) against true values (p,), in percent."""

    error_percent: NDArray[np.float64]
    """(..., p) signed errors."""

    @property
    def rms(self) -> NDArray[np.float64]:
        """(p,) root mean square over all leading axes."""
        flat = self.error_percent.reshape(-1, self.error_percent.shape[-1])
        rms: NDArray[np.float64] = np.sqrt(np.mean(flat**2, axis=0))
        return rms

    @property
    def mean(self) -> float:
        """Mean over the parameters of the rms."""
        return float(np.mean(self.rms))

    @property
    def worst(self) -> float:
        """Largest rms of a parameter."""
        return float(np.max(self.rms))


def score(estimate: NDArray[np.float64], true: NDArray[np.float64]) -> Score:
    """Compare estimates (..., p) with true values (p,)."""
    return Score(100.0 * (np.asarray(estimate) / np.asarray(true) - 1.0))

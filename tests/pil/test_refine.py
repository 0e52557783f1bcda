# SPDX-License-Identifier: MIT
"""The refinement on board on a Cortex-M7: the host's bits, and what it costs (docs/results.md)."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.onboard import CASES, measure, on_host, write_run
from pil.pil_support import need_tools

BUDGETS = {"paper": (400_000, 17_000), "spatial": (2_200_000, 96_000)}
"""Most instructions of the filter for a use of readings, and bytes."""


@pytest.mark.parametrize("name", CASES)
def test_bits_and_budget(name: str, tmp_path: Path) -> None:
    """Every bit of estimate and root at the end, after slices that are far smaller than the whole."""
    need_tools()
    case, cost = CASES[name], measure(name)
    write_run(case, tmp_path / "run.bin")
    assert on_host(case, tmp_path) == cost.result
    instructions, size = BUDGETS[case.example]
    period = cost.period(case.every)
    # where readings are used in every cycle, the motion of the state is part of the work
    outside = period["move"] + period["take"] if case.every > 1 else 0.0
    assert sum(period.values()) - outside <= instructions
    assert cost.bytes <= size
    assert cost.instructions.max() <= 170_000

# SPDX-License-Identifier: MIT
"""What is said of the simulator's cost in space is so."""

from __future__ import annotations

import pytest

from bench.simulator import measure

LEAST = 10.0
"""How many times faster the compiled equations are, at the least, on any machine."""
ERROR = 1e-9


@pytest.mark.slow(only=["seven"])
@pytest.mark.parametrize("name", ["spatial", "seven"])
def test_compiled_equations_are_ten_times_as_fast(name: str) -> None:
    cost = measure(name, 0.02)
    assert cost.ratio >= LEAST
    assert 0.0 < cost.error < ERROR
    assert cost.evaluations > 12  # of DOP853: a step is no less

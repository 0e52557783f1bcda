# SPDX-License-Identifier: MIT
"""Arc constants, short arcs and blocks of the numpy accumulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_support import Floats

from zygos.balances.arcs import MIN_ARC_INSTANTS
from zygos.balances.energy import EnergyRows
from zygos.reference.accumulator import design
from zygos.reference.solver import Rows, solve


def balance(lengths: list[int], p: int = 4, seed: int = 0, noise: float = 0.1) -> tuple[EnergyRows, Floats]:
    """Random rows with another constant in each arc, and the parameters behind them."""
    rng = np.random.default_rng(seed)
    arc = np.repeat(np.arange(len(lengths)), lengths)
    m = len(arc)
    x = rng.normal(size=p)
    z = rng.normal(size=(m, p)) + 3.0
    w = z @ x + rng.normal(scale=100.0, size=len(lengths))[arc] + noise * rng.normal(size=m)
    made = EnergyRows(np.arange(m), np.arange(m, dtype=np.uint64), arc, np.ones(m, dtype=np.bool_), z, w, np.ones(m))
    return made, x


def test_the_constant_of_each_arc_is_eliminated_exactly() -> None:
    """The estimate is that of a fit that has one column of ones for each arc."""
    made, _ = balance([50, 80, 33])
    accumulated = design(made)
    explicit = np.hstack([made.z, (made.arc[:, None] == np.arange(3)).astype(np.float64)])
    expected = np.linalg.lstsq(explicit, made.w, rcond=None)[0][:4]
    solution = solve(Rows.exact(accumulated.z, accumulated.w))
    np.testing.assert_allclose(solution.x, expected, rtol=1e-11)
    assert solution.residual == pytest.approx(0.1, rel=0.2)
    a, b = accumulated.normal()
    np.testing.assert_allclose(np.linalg.solve(a, b), expected, rtol=1e-10)


def test_only_arcs_with_enough_accepted_instants_count() -> None:
    made, x = balance([40, 25, 19, 20], noise=0.0)
    made.accepted[40:46] = False
    made.w[40:65] += 1e6 * np.arange(25)
    made.w[65:84] += 1e6 * np.arange(19)
    accumulated = design(made)
    assert (accumulated.arcs, accumulated.dropped_arcs, accumulated.refused) == (2, 2, 6)
    assert len(accumulated.w) == 60
    np.testing.assert_array_equal(np.unique(accumulated.arc), [0, 3])
    np.testing.assert_allclose(solve(Rows.exact(accumulated.z, accumulated.w)).x, x, rtol=1e-10)
    assert MIN_ARC_INSTANTS == 20


def test_a_void_arc_is_dropped_whatever_its_length() -> None:
    made, x = balance([40, 25, 30], noise=0.0)
    made.w[40:65] += 1e6 * np.arange(25)
    accumulated = design(replace(made, void=frozenset({1})))
    assert (accumulated.arcs, accumulated.dropped_arcs, accumulated.refused) == (2, 1, 0)
    np.testing.assert_array_equal(np.unique(accumulated.arc), [0, 2])
    np.testing.assert_allclose(solve(Rows.exact(accumulated.z, accumulated.w)).x, x, rtol=1e-10)


def test_refused_instants_do_not_count() -> None:
    made, x = balance([100], noise=0.0)
    made.accepted[30:40] = False
    made.w[30:40] = 1e9
    accumulated = design(made)
    assert accumulated.refused == 10
    np.testing.assert_allclose(solve(Rows.exact(accumulated.z, accumulated.w)).x, x, rtol=1e-10)


def test_no_row_at_all() -> None:
    made, _ = balance([5])
    accumulated = design(made)
    assert accumulated.z.shape == (0, 4)
    assert accumulated.dropped_arcs == 1

"""Least squares and jackknife of the numpy solver."""

from __future__ import annotations

import numpy as np
import pytest

from zygos.errors import Undecided
from zygos.reference.solver import jackknife, solve


def test_columns_of_any_size_are_solved() -> None:
    rng = np.random.default_rng(0)
    scale = 10.0 ** np.arange(-12, 12, 4)
    z = rng.normal(size=(80, 6)) * scale
    x = rng.normal(size=6) / scale
    solution = solve(z, z @ x)
    np.testing.assert_allclose(solution.x, x, rtol=1e-12)
    assert solution.condition < 20.0
    assert solution.residual < 1e-12


def test_condition_is_that_of_the_scaled_normal_matrix() -> None:
    rng = np.random.default_rng(1)
    z = rng.normal(size=(50, 3)) @ np.array([[1.0, 0.99, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 5.0]])
    a = z.T @ z
    d = 1.0 / np.sqrt(np.diag(a))
    scaled = d[:, None] * a * d
    expected = np.linalg.norm(scaled, 1) * np.linalg.norm(np.linalg.inv(scaled), 1)
    assert solve(z, z[:, 0]).condition == pytest.approx(expected, rel=1e-9)


def test_residual_is_a_root_mean_square() -> None:
    z = np.array([[1.0], [1.0], [1.0], [1.0]])
    solution = solve(z, np.array([0.0, 2.0, 0.0, 2.0]))
    assert solution.x[0] == pytest.approx(1.0)
    assert solution.residual == pytest.approx(1.0)


@pytest.mark.parametrize(
    "z",
    [
        np.ones((2, 3)),
        np.stack([np.arange(9.0), np.zeros(9)], axis=1),
        np.stack([np.arange(9.0), 3.0 * np.arange(9.0)], axis=1),
    ],
    ids=["few rows", "zero column", "dependent columns"],
)
def test_what_the_rows_do_not_determine_is_refused(z: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    with pytest.raises(Undecided, match="remedy"):
        solve(z, np.ones(len(z)))


def test_jackknife_of_a_mean_is_its_standard_error() -> None:
    """For one column of ones and blocks of one row the jackknife is s / sqrt(m), a textbook identity."""
    w = np.random.default_rng(2).normal(size=40)
    sigma = jackknife(np.ones((40, 1)), w, [np.array([i]) for i in range(40)])
    assert sigma[0] == pytest.approx(np.std(w, ddof=1) / np.sqrt(40), rel=1e-12)


def test_jackknife_is_honest_where_neighbours_share_noise() -> None:
    """Noise constant over ten rows: sigmas from long blocks match the spread of repeated trials, from rows do not."""
    rng = np.random.default_rng(3)
    z = np.repeat(rng.normal(size=(60, 2)), 10, axis=0)
    trials = np.repeat(rng.normal(size=(400, 60)), 10, axis=1)
    spread = np.std([solve(z, w).x for w in trials], axis=0)
    long = np.mean([jackknife(z, w, np.split(np.arange(600), 30)) for w in trials[:40]], axis=0)
    single = np.mean([jackknife(z, w, np.split(np.arange(600), 300)) for w in trials[:10]], axis=0)
    np.testing.assert_allclose(long, spread, rtol=0.15)
    assert np.all(single < 0.6 * spread)


def test_one_block_has_no_spread() -> None:
    with pytest.raises(Undecided, match="blocks"):
        jackknife(np.ones((5, 1)), np.ones(5), [np.arange(5)])

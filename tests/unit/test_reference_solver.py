# SPDX-License-Identifier: MIT
"""Least squares, compensation and scatter of the numpy solver."""

from __future__ import annotations

import numpy as np
import pytest
from reference_support import Floats

from zygos.errors import Undecided
from zygos.reference.solver import Rows, Scatter, scatter, solve


def test_columns_of_any_size_are_solved() -> None:
    rng = np.random.default_rng(0)
    scale = 10.0 ** np.arange(-12, 12, 4)
    z = rng.normal(size=(80, 6)) * scale
    x = rng.normal(size=6) / scale
    solution = solve(Rows.exact(z, z @ x))
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
    assert solve(Rows.exact(z, z[:, 0])).condition == pytest.approx(expected, rel=1e-9)


def test_residual_is_a_root_mean_square() -> None:
    z = np.array([[1.0], [1.0], [1.0], [1.0]])
    solution = solve(Rows.exact(z, np.array([0.0, 2.0, 0.0, 2.0])))
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
        solve(Rows.exact(z, np.ones(len(z))))


def test_rows_beside_count_by_their_weight_and_leave_the_residual_alone() -> None:
    """As if every row had been multiplied by the root of its weight; the residual is that of the energy rows."""
    rng = np.random.default_rng(9)
    z, other = rng.normal(size=(60, 3)), rng.normal(size=(20, 3))
    w, own = rng.normal(size=60), rng.normal(size=20)
    noise, of_others = np.diag([0.6, 0.3, 0.9, 60.0]), np.diag([0.5, 0.1, 0.0, 0.2])
    solution = solve(Rows(z, w, noise), [Rows(other, own, of_others).times(7.0)])
    a = z.T @ z - noise[:3, :3] + 7.0 * (other.T @ other - of_others[:3, :3])
    np.testing.assert_allclose(solution.x, np.linalg.solve(a, z.T @ w + 7.0 * other.T @ own), rtol=1e-11)
    assert solution.noise_scale == 1.0
    assert solution.residual == pytest.approx(np.sqrt(np.mean((z @ solution.x - w) ** 2)), rel=1e-12)


def blocks_of(m: int, count: int) -> Floats:
    """Weights of `count` blocks of neighbouring rows that do not overlap."""
    return np.repeat(np.eye(count), m // count, axis=1)


def test_scatter_of_a_mean_is_its_standard_error() -> None:
    """For one column of ones and blocks of one row it is s / sqrt(m), with m - 1 degrees of freedom or nearly."""
    w = np.random.default_rng(2).normal(size=40)
    told = scatter(np.ones((40, 1)), w, np.eye(40))
    assert told.covariance[0, 0] == pytest.approx(np.var(w, ddof=1) / 40, rel=1e-12)
    assert told.freedom[0] == pytest.approx(40.0)


@pytest.mark.slow
def test_scatter_is_unbiased_where_few_blocks_have_the_information() -> None:
    """Leaving out alone overstates it, the pull alone understates it; the product does neither."""
    rng = np.random.default_rng(5)
    z = rng.normal(size=(8, 2)) * np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 4.0])[:, None]
    trials = rng.normal(size=(1000, 8))
    told = [scatter(z, w, np.eye(8)).covariance for w in trials]
    expected = np.linalg.inv(z.T @ z)
    error = np.std(told, axis=0) / np.sqrt(len(told))
    assert np.all(np.abs(np.mean(told, axis=0) - expected) < 3.0 * error)
    assert np.all(3.0 * error < 0.2 * np.sqrt(np.outer(np.diag(expected), np.diag(expected))))


@pytest.mark.slow
def test_scatter_is_honest_where_neighbours_share_noise() -> None:
    """Noise constant over ten rows: sigmas from long blocks match the spread of repeated trials, from rows do not."""
    rng = np.random.default_rng(3)
    z = np.repeat(rng.normal(size=(60, 2)), 10, axis=0)
    trials = np.repeat(rng.normal(size=(200, 60)), 10, axis=1)
    spread = np.std([solve(Rows.exact(z, w)).x for w in trials], axis=0)

    def sigma(told: Scatter) -> Floats:
        return np.sqrt(np.diag(told.covariance))

    long = np.mean([sigma(scatter(z, w, blocks_of(600, 30))) for w in trials[:20]], axis=0)
    single = np.mean([sigma(scatter(z, w, blocks_of(600, 300))) for w in trials[:5]], axis=0)
    np.testing.assert_allclose(long, spread, rtol=0.15)
    assert np.all(single < 0.8 * spread)


def test_one_block_has_no_spread() -> None:
    with pytest.raises(Undecided, match="blocks"):
        scatter(np.ones((5, 1)), np.ones(5), np.ones((1, 5)))


def noisy(rng: np.random.Generator, m: int, sigma: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Rows with errors in columns and work of deviation sigma (p+1,), what that adds to their squares, and the truth.

    The last column is excited less.
    """
    p = len(sigma) - 1
    x = np.array([1.0, -2.0, 0.5])[:p]
    z = rng.normal(size=(m, p)) * np.array([3.0, 3.0, 1.0])[:p]
    w = z @ x
    errors = rng.normal(size=(m, p + 1)) * sigma
    return z + errors[:, :p], w + errors[:, p], m * np.diag(sigma**2), x


def test_declared_noise_is_taken_off() -> None:
    """The estimate is that of the equations without it, and no longer drawn to zero."""
    z, w, noise, x = noisy(np.random.default_rng(6), 100_000, np.array([0.5, 0.5, 0.3, 0.1]))
    solution = solve(Rows(z, w, noise))
    plain = np.linalg.solve(z.T @ z - noise[:3, :3], z.T @ w - noise[3, :3])
    np.testing.assert_allclose(solution.x, plain, rtol=1e-11)
    np.testing.assert_allclose(solution.x, x, rtol=0.01)
    assert np.all(np.abs(solve(Rows.exact(z, w)).x) < 0.98 * np.abs(x))
    assert solution.noise_scale == 1.0
    assert solution.signal_to_noise == pytest.approx((1.0 + 0.3**2) / 0.3**2, rel=0.02)
    a = (z.T @ z - noise[:3, :3]) / np.outer(*[np.linalg.norm(z, axis=0)] * 2)
    assert solution.condition == pytest.approx(np.linalg.cond(a, 1), rel=1e-9)


def test_noise_that_the_residuals_do_not_show_is_not_believed() -> None:
    z, w, noise, x = noisy(np.random.default_rng(7), 100_000, np.array([0.2, 0.2, 0.1, 0.1]))
    solution = solve(Rows(z, w, 4.0 * noise))
    assert solution.noise_scale == pytest.approx(0.25, rel=0.05)
    np.testing.assert_allclose(solution.x, x, rtol=0.01)
    assert solve(Rows(z, w, 1.5 * noise)).noise_scale == 1.0


def test_of_noise_as_large_as_the_motion_half_is_taken_off() -> None:
    z, w, noise, _ = noisy(np.random.default_rng(8), 100_000, np.array([0.5, 0.5, 2.0, 0.1]))
    solution = solve(Rows(z, w, noise))
    assert solution.signal_to_noise == pytest.approx(5.0 / 4.0, rel=0.02)
    assert solution.noise_scale == pytest.approx(solution.signal_to_noise / 2.0, rel=1e-12)

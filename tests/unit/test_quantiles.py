# SPDX-License-Identifier: MIT
"""The tails and quantiles agree with scipy.stats, which computes some of them in another way."""

import numpy as np
import pytest
from scipy import stats

from zygos import quantiles

FREEDOM = np.array([1.0, 2.5, 7.0, 40.0, 1e4])
TAILS = np.array([1e-12, 1e-4, 0.025, 0.3, 0.5, 0.9])


def test_the_normal_distribution() -> None:
    z = np.array([-3.0, 0.0, 1.0, 6.0, 20.0])
    assert quantiles.normal_sf(z) == pytest.approx(stats.norm.sf(z), rel=1e-12)
    assert quantiles.normal_isf(TAILS) == pytest.approx(stats.norm.isf(TAILS), rel=1e-12, abs=1e-15)


def test_students_distribution() -> None:
    tail, freedom = TAILS[:, None], FREEDOM[None, :]
    t = stats.t.isf(tail, freedom)
    assert quantiles.student_isf(tail, freedom) == pytest.approx(t, rel=1e-9, abs=1e-12)
    assert quantiles.student_sf(t, freedom) == pytest.approx(np.broadcast_to(tail, t.shape), rel=1e-9)
    assert quantiles.student_factor(0.95, FREEDOM) == pytest.approx(stats.t.interval(0.95, FREEDOM)[1], rel=1e-9)
    assert np.isnan(quantiles.student_isf(0.1, 0.0))


def test_chi_square_and_fishers_distribution() -> None:
    tail, freedom = TAILS[:, None], FREEDOM[None, :]
    assert quantiles.chi_square_isf(tail, freedom) == pytest.approx(stats.chi2.isf(tail, freedom), rel=1e-9)
    assert quantiles.chi_square_ppf(tail, freedom) == pytest.approx(stats.chi2.ppf(tail, freedom), rel=1e-9)
    assert quantiles.fisher_isf(1e-4, 3.5, 17.0) == pytest.approx(stats.f.isf(1e-4, 3.5, 17.0), rel=1e-9)

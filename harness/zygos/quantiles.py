# SPDX-License-Identifier: MIT
"""Tails and quantiles of the distributions that verdicts and intervals use.

They are SciPy's special functions under the names of `scipy.stats`, whose import alone takes most of a second.
"""

from __future__ import annotations

from typing import Any

from scipy.special import chdtri, fdtri, gammaincinv, ndtr, ndtri, stdtr, stdtrit


def normal_sf(z: Any) -> Any:
    """Probability that a normally distributed number exceeds z, of any shape."""
    return ndtr(-z)


def normal_isf(probability: Any) -> Any:
    """The number that a normally distributed one exceeds with this probability, of any shape."""
    return -ndtri(probability)


def student_sf(t: Any, freedom: Any) -> Any:
    """Probability that a number of Student's distribution with these degrees of freedom exceeds t; shapes broadcast."""
    return stdtr(freedom, -t)


def student_isf(probability: Any, freedom: Any) -> Any:
    """The number that one of Student's distribution exceeds with this probability; shapes broadcast."""
    return -stdtrit(freedom, probability)


def student_factor(confidence: float, freedom: Any) -> Any:
    """Half width of a two-sided interval of this confidence in standard deviations, of the shape of `freedom`."""
    return stdtrit(freedom, 0.5 + 0.5 * confidence)


def chi_square_ppf(probability: Any, freedom: Any) -> Any:
    """The number that chi square with these degrees of freedom stays below with this probability; shapes broadcast."""
    return 2.0 * gammaincinv(0.5 * freedom, probability)


def chi_square_isf(probability: Any, freedom: Any) -> Any:
    """The number that chi square with these degrees of freedom exceeds with this probability; shapes broadcast."""
    return chdtri(freedom, probability)


def fisher_isf(probability: float, numerator: float, denominator: float) -> float:
    """The number that a ratio of Fisher's distribution with these degrees of freedom exceeds with this probability."""
    return float(fdtri(numerator, denominator, 1.0 - probability))

# SPDX-License-Identifier: MIT
"""The values printed in Tables III and IV of the paper, by the names of `arm.toml`; the paper's a21 is a12 here."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm

Floats = NDArray[np.float64]

PARAMETERS = ("a00", "a01", "a02", "a11", "a12", "a22", "Im1", "Im2", "k1", "k2", "b1", "b2")
"""Parameters in the paper's order."""

# Table III, in units of 10^4
_ACTUAL = (2.3774, 4.2330, 0.9612, 8.1832, 1.9709, 0.5099, 0.0001, 0.0001, 0.1000, 0.1000, 0.0085, 0.0075)
_DE = (4.7320, 8.4258, 1.9129, 16.2882, 3.9231, 1.0150, 0.00017, 0.00012, 0.1669, 0.1553, 0.0207, 0.0120)
_EB = (2.2731, 4.0615, 0.9168, 7.8909, 1.8933, 0.4888, 0.00010, 0.00010, 0.0919, 0.0978, 0.0077, 0.0071)
# Table IV, in per cent, of which the first two columns are in units of 1e-8 and 1e-6
_DE_EXACT = (0.1645, 0.1646, 0.1646, 0.1646, 0.1645, 0.1644, 0.0434, 0.0344, 0.0871, 0.0928, 0.1594, 0.0843)
_EB_EXACT = (
    *(-0.1720, -0.0901, -0.1169, -0.0166, -0.0403, -0.0652),
    *(0.1119, -0.1614, -0.1358, -0.1024, -0.2205, 0.3829),
)
_DE_NOISY = (
    *(-99.0396, -99.0497, -99.0108, -99.0439, -99.0507, -99.0478),
    *(-72.3263, -20.8492, -66.8517, -55.3035, -143.7792, -60.4581),
)
_EB_NOISY = (
    *(-4.3859, -4.0512, -4.6137, -3.5711, -3.9361, -4.1264),
    *(-0.3497, -6.4170, -8.0512, -2.1779, -9.1603, -5.4391),
)


def _column(values: tuple[float, ...], scale: float = 1.0) -> dict[str, float]:
    return {name: scale * value for name, value in zip(PARAMETERS, values, strict=True)}


ACTUAL = _column(_ACTUAL, 1e4)
_STEP = 0.5 * (1.0 + 1e-9)
"""Tolerance: half of the last digit of Table III, plus the rounding error of a float."""
ESTIMATES = {"DE": _column(_DE, 1e4), "EB": _column(_EB, 1e4)}
"""Values of Table III."""
ERRORS = {
    "DE, exact data": _column(_DE_EXACT, 1e-8),
    "EB, exact data": _column(_EB_EXACT, 1e-6),
    "DE": _column(_DE_NOISY),
    "EB": _column(_EB_NOISY),
}
"""Errors of Table IV, per cent."""
SIZE = 2.0
"""Two errors agree in size if neither is larger than the other by more than this factor."""


def describes(arm: Arm, true: Floats) -> bool:
    """Whether an arm with these true values (p,) is the one of the tables, to all digits that they print."""
    if sorted(arm.parameter_names) != sorted(PARAMETERS):
        return False
    actual = np.array([ACTUAL[name] for name in arm.parameter_names])
    return bool(np.all(np.abs(true - actual) <= _STEP))


ROUNDING = 1e-8
"""Errors below this, per cent, are rounding errors of the arithmetic."""


def agreement(ours: float, printed: float) -> str:
    """Agreement of two errors: "sign, size", "sign", "size" or "–"; "rounding" if both are only rounding errors."""
    if max(abs(ours), abs(printed)) < ROUNDING:
        return "rounding"
    words = []
    if ours * printed > 0.0:
        words.append("sign")
    if min(abs(ours), abs(printed)) * SIZE >= max(abs(ours), abs(printed)):
        words.append("size")
    return ", ".join(words) or "–"


def eb_values(true: Floats, names: tuple[str, ...]) -> Floats:
    """(p,) the EB estimates of the parameters `names` that follow from the four digits of the printed errors.

    Raises KeyError for a name that the paper does not have.
    """
    return np.array([t * (1.0 + ERRORS["EB"][name] / 100.0) for t, name in zip(true, names, strict=True)])

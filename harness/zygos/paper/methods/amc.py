# SPDX-License-Identifier: MIT
"""Angular momentum conservation in batch: the paper's first method (docs/theory, "The other two methods").

The momentum of the free-floating arm is a known constant h and linear in the inertias. Springs and dampers are internal
and do not appear: k and b cannot be determined.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.state import State
from zygos.errors import ZygosError
from zygos.paper.methods import Record, by_backward_difference
from zygos.reference.solver import Rows, solve

Floats = NDArray[np.float64]


def columns(arm: Arm, state: State) -> Floats:
    """Momentum about the common axis per unit parameter, one column for each parameter that is `seen`.

    Column of a_ii: f_i; of a_ij: cos(phi_j - phi_i)(f_i + f_j), of b_ij the same with the sine; of Im_i: n thetad_i.
    """
    f, phi = state.f, state.phi
    i, j = np.triu_indices(f.shape[-1])
    parts = [np.where(i == j, f[..., i], np.cos(phi[..., j] - phi[..., i]) * (f[..., i] + f[..., j]))]
    if arm.kinetic == "planar":
        i, j = np.triu_indices(f.shape[-1], 1)
        parts.append(np.sin(phi[..., j] - phi[..., i]) * (f[..., i] + f[..., j]))
    return np.concatenate([*parts, arm.gear_ratios * state.thetad], axis=-1)


def regressor(arm: Arm, record: Record, exact: bool = False) -> Floats:
    """Design (B, m, columns). Rates by backward difference as in the paper, or the record's own.

    Raises ZygosError if exact rates are requested but missing in the record.
    """
    if not exact:
        return columns(arm, by_backward_difference(arm, record))
    if record.qd is None or record.thetad is None:
        raise ZygosError("what is wrong: the record has no exact rates; remedy: use a simulated record, or differences")
    return columns(arm, State(record.q, record.theta, record.qd, record.thetad, record.f0))


def seen(arm: Arm) -> NDArray[np.bool_]:
    """Which parameters the momentum depends on, (p,)."""
    kinetic = len(arm.parameter_names) - 3 * arm.n
    return np.array([True] * kinetic + [True, False, False] * arm.n)


def estimate(arm: Arm, record: Record, *, momentum_nms: float = 1.0, exact: bool = False) -> Floats:
    """Estimates, (B, p), NaN for k and b. momentum_nms: the known momentum about the common axis [Nms], not zero.

    With the paper's sensors the noise of a row is about 3,000 Nms, so the best fit to h = 1 Nms is nearly zero, and the
    error of the method is -100 %. Raises Undecided if a record does not determine the parameters, ZygosError if
    momentum_nms is zero.
    """
    if momentum_nms == 0.0:
        raise ZygosError("what is wrong: momentum 0 fits any scale of the parameters; remedy: give a known one, not 0")
    z = regressor(arm, record, exact)
    out = np.full((z.shape[0], len(arm.parameter_names)), np.nan)
    target = np.full(z.shape[1], momentum_nms)
    visible = seen(arm)
    for b, zb in enumerate(z):
        out[b, visible] = solve(Rows.exact(zb, target)).x
    return out

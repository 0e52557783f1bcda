# SPDX-License-Identifier: MIT
"""Energy balance in batch, Nanos & Papadopoulos eqs. (37)-(39) with the errata of docs/paper-tables.md.

Rows are cumulative from a known start: the work of the motors since the start equals the change of kinetic and elastic
energy plus the energy dissipated. The dissipation is added (eqs. (38) and (39) subtract it), and the gear ratio is part
of the work (eq. (37) omits it).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.energy import energy_columns, step_work, torque_jump_energy
from zygos.balances.quadrature import from_first, integral
from zygos.balances.state import State
from zygos.errors import ZygosError
from zygos.paper.methods import Record, by_backward_difference
from zygos.reference.solver import Rows, solve
from zygos.runs.smoother import coefficients, convolve

Floats = NDArray[np.float64]
Rates = Literal["backward", "midpoint", "savgol", "exact"]
Start = Literal["rest", "first"]


def work(arm: Arm, record: Record) -> Floats:
    """W, shape (B, n) [J]: work of the motors since the first instant, exact for a torque held between samples."""
    return from_first(step_work(arm, record.theta, record.tau))


def regressor(arm: Arm, record: Record, rates: Rates = "backward", start: Start = "rest") -> tuple[Floats, Floats]:
    """Design (B, m, p) and work (B, m) [J].

    rates: "backward" differences as in the paper, the angles of the newer instant; "midpoint", the same differences
    with angles, gyro, work and dissipation taken at the middle of the step; "savgol", the arm's smoother; "exact", the
    record's own rates and dissipation.
    start: "rest", the arm starts at rest and undeflected, so that nothing is subtracted, as in the paper; "first", the
    row of the first instant with a row is subtracted.
    Raises ZygosError if exact rates are requested but missing in the record, or if it is shorter than the smoother.
    """
    h = arm.period_s
    total = work(arm, record)
    if rates == "exact":
        if record.qd is None or record.thetad is None or record.slip2 is None:
            raise ZygosError(
                "what is wrong: the record has no exact rates; remedy: give a simulated record, or other rates"
            )
        z = energy_columns(arm, State(record.q, record.theta, record.qd, record.thetad, record.f0), record.slip2)
        w = total
    elif rates == "backward":
        state = by_backward_difference(arm, record)
        z = energy_columns(arm, state, np.cumsum(h * (state.thetad - state.qd) ** 2, axis=1))
        w = total[:, 1:]
    elif rates == "midpoint":
        end = by_backward_difference(arm, record)
        state = State(_middle(record.q), _middle(record.theta), end.qd, end.thetad, _middle(record.f0))
        step = h * (end.thetad - end.qd) ** 2
        z = energy_columns(arm, state, np.cumsum(step, axis=1) - step / 2.0)
        # The held torque does half of the step's work up to the middle of the angle's path.
        w = _middle(total)
    elif rates == "savgol":
        z, w = _smoothed_rows(arm, record)
    else:
        raise ZygosError(f"what is wrong: no rate estimate '{rates}'; remedy: use backward, midpoint, savgol or exact")
    if start == "first":
        z, w = z[:, 1:] - z[:, :1], w[:, 1:] - w[:, :1]
    elif start != "rest":
        raise ZygosError(f"what is wrong: no start '{start}'; remedy: use rest or first")
    return z, w


def estimate(arm: Arm, record: Record, *, rates: Rates = "backward", start: Start = "rest") -> Floats:
    """Estimates of all parameters, (B, p). See regressor() for the options. Raises Undecided if a record does not
    determine them."""
    z, w = regressor(arm, record, rates, start)
    return np.stack([solve(Rows.exact(zb, wb)).x for zb, wb in zip(z, w, strict=True)])


def _middle(x: Floats) -> Floats:
    return 0.5 * (x[:, 1:] + x[:, :-1])


def _smoothed_rows(arm: Arm, record: Record) -> tuple[Floats, Floats]:
    """Rows at the instants the smoother reaches. The first window's polynomial covers the time from the start to
    determine them."""
    points, order, h = arm.smoother.points, arm.smoother.order, arm.period_s
    half = points // 2
    if record.q.shape[1] < points + 1:
        raise ZygosError(f"what is wrong: {record.q.shape[1]} samples do not fill the smoother; remedy: more samples")

    def run(x: Floats, derivative: int) -> Floats:
        """All instants but the last `half`; the first `half` from the first window's polynomial."""
        by_time = np.moveaxis(x, 1, 0)
        readers = np.stack([coefficients(points, order, s - half, derivative) for s in range(half)])
        head = np.tensordot(readers, by_time[:points], 1)
        body = convolve(by_time, coefficients(points, order, 0.0, derivative))
        return np.moveaxis(np.concatenate([head, body]), 0, 1) / h**derivative

    state = State(
        q=run(record.q, 0),
        theta=run(record.theta, 0),
        qd=run(record.q, 1),
        thetad=run(record.theta, 1),
        base=run(record.f0, 0),
    )
    tau = record.tau[:, : state.theta.shape[1]]
    w = from_first(step_work(arm, state.theta, tau))
    w[:, 1:] += torque_jump_energy(arm, state.thetad[:, 1:], tau[:, :-1], tau[:, 1:])
    z = energy_columns(arm, state, integral((state.thetad - state.qd) ** 2, h, axis=1))
    return z[:, half:], w[:, half:]

"""Energy balance in batch, Nanos & Papadopoulos eqs. (37)-(39) with the errata of docs/paper.md.

Rows are cumulative from a known start: the work of the motors since the start equals the change of kinetic and elastic
energy plus the energy dissipated. The dissipation is added (eqs. (38) and (39) subtract it), and the gear ratio is part
of the work (eq. (37) omits it).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.balances.energy import energy_columns
from zygos.balances.kinematics import State
from zygos.errors import ZygosError
from zygos.paper.methods import Record, by_backward_difference
from zygos.reference.solver import Rows, solve
from zygos.runs.smoother import coefficients, convolve

Floats = NDArray[np.float64]
Rates = Literal["backward", "midpoint", "savgol", "exact"]
Start = Literal["rest", "first"]


def work(arm: Arm, record: Record) -> Floats:
    """W, shape (B, n) [J]: work of the motors since the first instant, exact for a torque held between samples."""
    steps = np.sum(arm.gear_ratios * record.tau[:, :-1] * np.diff(record.theta, axis=1), axis=-1)
    return np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))


def rows(arm: Arm, record: Record, rates: Rates = "backward", start: Start = "rest") -> tuple[Floats, Floats]:
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
    """Estimates of all parameters, (B, p). See rows() for the options. Raises Undecided if a record does not determine
    them."""
    z, w = rows(arm, record, rates, start)
    return np.stack([solve(Rows.exact(zb, wb)).x for zb, wb in zip(z, w, strict=True)])


def _middle(x: Floats) -> Floats:
    return 0.5 * (x[:, 1:] + x[:, :-1])


def _smoothed_rows(arm: Arm, record: Record) -> tuple[Floats, Floats]:
    """Rows at the instants the smoother reaches. The first window's polynomial covers the time from the start to
    them."""
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
    theta = state.theta
    steps = np.sum(arm.gear_ratios * record.tau[:, : theta.shape[1] - 1] * np.diff(theta, axis=1), axis=-1)
    w = np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))
    if arm.torque_law != "sampled":
        # The effect of a held torque on the slope of a smooth curve (docs/theory.md).
        jumps = np.diff(record.tau[:, : theta.shape[1]], axis=1)
        w[:, 1:] += h / 12.0 * np.sum(arm.gear_ratios * jumps * state.thetad[:, 1:], axis=-1)
    g = (state.thetad - state.qd) ** 2
    # Trapezoid over the first two steps, then the cubic through the four newest values.
    loss = h / 2.0 * (g[:, 1:] + g[:, :-1])
    loss[:, 2:] = h / 24.0 * (9.0 * g[:, 3:] + 19.0 * g[:, 2:-1] - 5.0 * g[:, 1:-2] + g[:, :-3])
    slip2 = np.pad(np.cumsum(loss, axis=1), ((0, 0), (1, 0), (0, 0)))
    z = energy_columns(arm, state, slip2)
    return z[:, half:], w[:, half:]

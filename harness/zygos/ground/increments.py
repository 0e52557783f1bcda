# SPDX-License-Identifier: MIT
"""The score of a model of an arm that floats or has flexible joints: mean torques over increments.

For a flexible joint the balance of its rotor and that of its link are added, so that the spring between them drops out:
what is left compares the motor's torque with that of bodies, rotor and friction, as for a rigid joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Arm
from zygos.balances.energy import energy_rows
from zygos.balances.impulse import impulse_rows
from zygos.balances.joint import in_order, joint_columns, joint_rows
from zygos.balances.momentum import variances
from zygos.balances.state import State
from zygos.can.run import Run
from zygos.effects import Effect
from zygos.errors import ZygosError
from zygos.runs.samples import Samples, calibrate
from zygos.runs.smoother import Smoothed, smooth

Floats = NDArray[np.float64]

SPANS_S = (0.2, 0.5, 1.0, 2.0, 5.0)
"""Lengths of increments, s: the shortest is taken at which the sensors' noise is small."""


@dataclass(frozen=True)
class Increments:
    """m increments of N joints."""

    span_s: float
    at: NDArray[np.int64]
    """(m,) middle of each, as position among the cycles."""
    measured: Floats
    """(m, N) mean torque of the motors after the gear, Nm."""
    predicted: Floats
    """(m, N) Nm."""
    rate: Floats
    """(m, N) mean rate of the motors after the gear, rad/s."""
    spring: Floats
    """(m, N) mean torque at the link that neither spring nor bodies explain, Nm; 0 at rigid joints."""
    noise: Floats
    """(N,) standard deviation of an increment by the declared noise of rates and torques, Nm."""
    work: Floats
    """(w,) work of all motors in each second, J."""
    work_left: Floats
    """(w,) what the energy balance leaves of it, J."""


def increments(run: Run, values: Floats, effects: Sequence[Effect], window_s: float) -> Increments:
    """Compare a run with parameters in the order of the arm, and with effects. Errors: ZygosError for a run that is too
    short, and for an effect that exists only in estimates on the ground."""
    arm = run.arm
    for effect in effects:
        if effect.kind.place == "load":
            raise ZygosError(
                f"effect {effect.kind.key} at {effect.joint}: arm {arm.name} has no rows for it; remedy: remove "
                "the entry"
            )
    acting = [effect for effect in effects if effect.kind.place not in ("rotor", "base")]
    samples = calibrate(arm, run.cycles)
    smoothed = smooth(arm, samples)
    smoothed = replace(smoothed, accepted=np.ones_like(smoothed.accepted))
    found: Increments | None = None
    for span in SPANS_S:
        longer = _over(span, run, samples, smoothed, values, acting, window_s)
        found = longer or found
        if found and np.all(found.noise <= limits.TORQUE_NOISE.value * np.sqrt(np.mean(found.measured**2, axis=0))):
            break
    if found is None:
        raise ZygosError(f"{run.path or 'the run'}: no unbroken piece of {SPANS_S[0]:g} s; remedy: a longer run")
    return found


def _over(
    span: float,
    run: Run,
    samples: Samples,
    smoothed: Smoothed,
    values: Floats,
    acting: Sequence[Effect],
    window_s: float,
) -> Increments | None:
    """The comparison over increments of one length; None where the run is shorter."""
    arm = run.arm
    rows = joint_rows(arm, samples, smoothed, span, acting)
    if not rows.count:
        return None
    span = float(rows.end[0] - rows.begin[0]) * arm.period_s
    x = np.concatenate([values, [effect.value for effect in acting]])
    link = rows.z @ x
    measured, predicted = rows.w.copy(), link.copy()
    names = [*arm.parameter_names, *(effect.column(arm) for effect in acting)]
    for motor in impulse_rows(arm, samples, smoothed, smoothed.segment, acting):
        own = motor.z @ x[[names.index(name) for name in motor.names]]
        j = motor.joint
        measured[:, j] += motor.w[rows.end] - motor.w[rows.begin]
        predicted[:, j] += own[rows.end] - own[rows.begin]
    rigid = np.array([not joint.flexible for joint in arm.joints])
    turned = smoothed.theta[rows.end] - smoothed.theta[rows.begin]
    work, left = _energy(arm, samples, smoothed, acting, x, window_s)
    return Increments(
        span_s=span,
        at=(smoothed.index[rows.begin] + smoothed.index[rows.end]) // 2,
        measured=measured / span,
        predicted=predicted / span,
        rate=turned / span,
        spring=np.where(rigid, 0.0, link) / span,
        noise=_noise(arm, smoothed, values, rows.begin, span),
        work=work,
        work_left=left,
    )


def _energy(
    arm: Arm, samples: Samples, smoothed: Smoothed, effects: Sequence[Effect], x: Floats, window_s: float
) -> tuple[Floats, Floats]:
    """Work over windows, and what the energy balance leaves of it, J."""
    rows = energy_rows(arm, samples, smoothed, effects)
    left = rows.w - rows.z @ x[: rows.z.shape[1]]
    window = max(1, round(window_s / arm.period_s))
    begin = np.arange(0, max(0, len(left) - window), window)
    begin = begin[rows.arc[begin] == rows.arc[begin + window]]
    return rows.w[begin + window] - rows.w[begin], left[begin + window] - left[begin]


def _noise(arm: Arm, smoothed: Smoothed, values: Floats, begin: NDArray[np.int64], span: float) -> Floats:
    """(N,) standard deviation of the mean torque of an increment: the rates at both ends, and the torques between."""
    some = begin[:: max(1, len(begin) // 20)]
    state = State.smoothed(arm, smoothed)
    still = State(state.q[some], state.q[some], *(np.zeros((len(some), arm.n)),) * 2, np.zeros_like(state.base[some]))
    of_rates = variances(arm)
    total = np.zeros(arm.n)
    for i in range(arm.n):
        unit = np.broadcast_to(np.eye(arm.n)[i], still.q.shape)
        rigid = not arm.joints[i].flexible
        columns = joint_columns(arm, replace(still, qd=unit, thetad=unit * rigid))
        momentum = in_order(arm, columns.momentum, columns.rotor_momentum) @ values
        total += of_rates.link[i] * np.mean(momentum**2, axis=0)
    names = list(arm.parameter_names)
    for j, joint in enumerate(arm.joints):
        if joint.flexible:
            total[j] += of_rates.rotor[j] * (joint.gear_ratio**2 * values[names.index(f"Im{j + 1}")]) ** 2
    torque = np.array([joint.over_the_wire.torque_sigma for joint in arm.joints]) * arm.gear_ratios
    return np.asarray(np.sqrt(2.0 * total / span**2 + torque**2 * arm.period_s / span), dtype=np.float64)

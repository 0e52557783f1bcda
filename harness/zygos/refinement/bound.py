# SPDX-License-Identifier: MIT
"""The Cramér-Rao bound: the smallest standard deviations that any unbiased estimator can have from the frames of a
motion (docs/theory.md, "The information limit").

The frames hold noisy angles, a noisy and biased rate of the base, and noisy torques, which also drive the motion.
Nobody knows the state at the start and the bias of the gyro. Around the true motion all of this is linear. A Kalman
filter that knows the parameters follows the errors of state and bias, and leaves innovations; an error of a parameter
moves them by known amounts. The information about the parameters is the sum of the squares of these amounts, each
divided by the variance of its innovation (Friedland's separated filter). Nothing is inverted that the motion does not
determine, and no prior of the parameters is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits

from zygos.arm import TORQUE_STEP, Arm
from zygos.balances.state import State
from zygos.dynamics.equations import from_parameters
from zygos.dynamics.replay import substeps
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Model
from zygos.refinement.inertia import inertia_errors
from zygos.refinement.motion import FlexibleMotion
from zygos.simulation.plant import Trajectory, simulate
from zygos.simulation.scenario import Scenario

Floats = NDArray[np.float64]

RTOL, ATOL = 1e-10, 1e-12
"""Tolerances of the integration of the motion."""
LONGEST_STEP_S = 0.01
"""Longest Runge-Kutta step of the derivatives of the motion, s."""
_UNKNOWN_RAD, _UNKNOWN_RAD_S = 1.0, 10.0
"""Standard deviations of what nobody knows at the start: far more than any sensor leaves."""
_TOGETHER = 2000
"""Cycles whose derivatives are computed together; more need more memory."""
_DRAWS = 20
_SHARE_OF_MOTION = 0.6
"""Share of the progress that the derivatives of the motion have; the rest is the filter's."""
_LEAST = 1e-9
"""Singular value of the information, relative to the largest, below which a motion does not determine a combination."""


@dataclass(frozen=True)
class Bound:
    """The bound after one run of a motion; p parameters."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Floats
    """(p,) parameters of the model, SI units."""
    size: Floats
    """(p,) to which sigmas are compared, as `FlexibleMotion.size`."""
    covariance: Floats
    """(p, p) smallest covariance of an unbiased estimate."""
    inertia_percent: tuple[float, float] | None
    """Worst and median error of the inertia matrix with which such an estimate predicts (`inertia_errors`), from 20
    draws; None except for a spatial arm that floats."""
    cycles: int
    torque_relative_sigma: tuple[float, ...]
    """(N,) noise of the torques as a share of their size."""

    @property
    def sigma(self) -> Floats:
        """(p,) smallest standard deviations, SI units."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def percent(self) -> Floats:
        """(p,) sigmas in per cent of `size`; infinite where that is 0."""
        with np.errstate(divide="ignore"):
            return np.asarray(100.0 * self.sigma / self.size, dtype=np.float64)

    @property
    def mean_percent(self) -> float:
        """Mean of `percent` over the parameters whose size is not 0."""
        return float(np.mean(self.percent[self.size > 0.0]))


def bounded(arm: Arm, model: Model) -> FlexibleMotion:
    """The motion of an arm and model that have a bound.

    Errors: ZygosError if the model has effects or does not fit the arm, a joint is rigid, or torques are sampled values
    of a continuous torque.
    """
    if model.effects:
        raise ZygosError(
            f"model {model.name}: the bound is computed for bodies, rotors and linear springs, not for effects "
            f"({', '.join(sorted({one.kind.key for one in model.effects}))}); remedy: remove them from the model"
        )
    if arm.torque_law == "sampled":
        raise ZygosError(
            f"arm {arm.name}: the bound is computed for torques that are held from SYNC to SYNC; remedy: "
            'torque_law = "applied_from_sync" in the arm file'
        )
    return FlexibleMotion(arm, np.array(model.base_values(arm), dtype=np.float64))


def states_of(motion: FlexibleMotion, run: Trajectory) -> Floats:
    """(n, W + 4N) true states at the SYNCs of a simulated run, of its first seed."""
    base = run.omega0[0] if motion.base_rates else np.zeros((len(run.t), 0))
    return State(run.q[0], run.theta[0], run.qd[0], run.thetad[0], base).packed()


def bound(
    arm: Arm,
    model: Model,
    scenario: Scenario,
    relative: Sequence[float | None] = (None,),
    progress: Callable[[float], None] = lambda share: None,
) -> list[Bound]:
    """The bound of each relative torque noise (None: as the arm declares) after the scenario's run of its seed.

    Errors: ZygosError as `bounded`; Undecided if the motion does not determine all parameters.
    """
    motion = bounded(arm, model)
    half = 0.5 * _SHARE_OF_MOTION
    run = simulate(arm, model, scenario, rtol=RTOL, atol=ATOL, progress=lambda share: progress(half * share))
    state, tau = states_of(motion, run), run.tau[0]
    slopes = _slopes(motion, state, tau, steps_of(motion, run.q[0]), lambda share: progress(half * (1.0 + share)))
    found = []
    for k, share in enumerate(relative):
        width = (1.0 - _SHARE_OF_MOTION) / len(relative)
        begin = _SHARE_OF_MOTION + k * width

        def moved(x: float, begin: float = begin, width: float = width) -> None:
            progress(begin + width * x)

        shares = np.array([one.torque_relative_sigma if share is None else share for one in arm.joints])
        sigma = _torque_sigma(arm, tau, shares)
        with threadpool_limits(1):  # many small matrices, for which more threads only wait for each other
            found.append(_bound(motion, slopes, sigma, shares, moved))
    progress(1.0)
    return found


def bound_along(
    motion: FlexibleMotion,
    pieces: Sequence[tuple[Floats, Floats]],
    relative: Floats,
    progress: Callable[[float], None] = lambda share: None,
) -> Bound:
    """The bound of motions that were followed: of each piece the states (n, W + 4N) at its SYNCs, and the torques
    (n - 1, N) between them, Nm before the gear. relative: (N,) noise of the torques as a share of their size.

    Nobody knows the state at the start of a piece. Errors: Undecided as `bound`.
    """
    arm, rows = motion.arm, [np.zeros((0, len(motion.size)))]
    cycles = sum(len(states) for states, _ in pieces)
    done = 0
    for states, tau in pieces:
        sigma = _torque_sigma(arm, tau, relative)
        share = len(states) / cycles
        begin, half = done / cycles, 0.5 * share

        def moved(x: float, begin: float = begin, half: float = half) -> None:
            progress(begin + half * x)

        steps = steps_of(motion, states[:, motion.base_rates : motion.base_rates + arm.n])
        slopes = _slopes(motion, states, tau, steps, moved)

        def followed(x: float, begin: float = begin, half: float = half) -> None:
            progress(begin + half * (1.0 + x))

        with threadpool_limits(1):
            rows.append(_information(motion, slopes, sigma, motion.size, followed))
        done += len(states)
    return _conclude(motion, _triangle(np.concatenate(rows)), relative, cycles)


def _torque_sigma(arm: Arm, tau: Floats, relative: Floats) -> Floats:
    """(n, N) standard deviations of the errors of the torques tau (n, N), Nm before the gear."""
    own = np.array([joint.torque_sigma for joint in arm.joints])
    return np.sqrt(own**2 + TORQUE_STEP**2 / 12.0 + (relative * tau) ** 2)


def _slopes(
    motion: FlexibleMotion, state: Floats, tau: Floats, steps: int, progress: Callable[[float], None]
) -> Floats:
    """(n - 1, x, x + p + N) derivatives of the state at each SYNC with respect to that at the SYNC before, to the
    parameters and to the torques, along the states (n, x) under the torques (n - 1 or more, N)."""
    last = len(state) - 1
    slopes = np.empty((last, motion.states, motion.states + len(motion.values) + motion.arm.n))
    for first in range(0, last, _TOGETHER):
        part = slice(first, min(first + _TOGETHER, last))
        slopes[part] = motion.step(state[part], tau[part], motion.arm.period_s, steps)[1]
        progress(part.stop / last)
    return slopes


def steps_of(motion: FlexibleMotion, q: Floats) -> int:
    """Runge-Kutta steps in a period with which derivatives at the link angles q (n, N), rad, are good to a tenth of a
    per cent: twice as long ones as a replay takes."""
    period = motion.arm.period_s
    needed = substeps(from_parameters(motion.arm, motion.values), q[:: max(1, len(q) // 50)], period)
    return max(-(-needed // 2), math.ceil(period / LONGEST_STEP_S - 1e-9))


def _bound(
    motion: FlexibleMotion, slopes: Floats, torque: Floats, relative: Floats, progress: Callable[[float], None]
) -> Bound:
    information = _information(motion, slopes, torque, motion.size, progress)
    return _conclude(motion, information, relative, len(slopes) + 1)


def bound_from(motion: FlexibleMotion, information: Floats, relative: Floats, cycles: int) -> Bound:
    """The bound without the errors of the inertia matrix, from the square root (p, p) of the information about the
    parameters in units of their sizes. relative: (N,) noise of the torques as a share of their size.

    Errors: Undecided as `bound`.
    """
    return _conclude(motion, information, relative, cycles, draws=0)


def _conclude(motion: FlexibleMotion, information: Floats, relative: Floats, cycles: int, draws: int = _DRAWS) -> Bound:
    """The bound from the square root of the information in units of `size`."""
    arm, size = motion.arm, motion.size
    scale = np.linalg.norm(information, axis=0)
    strength = np.linalg.svd(information / np.where(scale > 0.0, scale, 1.0), full_matrices=False)
    if not scale.all() or strength.S[-1] < _LEAST * strength.S[0]:
        weak = arm.parameter_names[int(np.argmax(np.abs(strength.Vh[-1])) if scale.all() else np.argmin(scale))]
        raise Undecided(
            f"arm {arm.name}: the motion does not determine {weak}, nor what it is combined with; remedy: a motion "
            "that moves all joints, or a longer duration_s (`zygos plan` searches one)"
        )
    root = size[:, None] * solve_triangular(information, np.eye(len(size)))
    inertia = None
    if draws and arm.free and arm.spatial:
        errors = np.random.default_rng(0).normal(size=(draws, len(size))) @ root.T
        inertia = inertia_errors(arm, motion.values + errors, motion.values)
    return Bound(
        arm.parameter_names,
        arm.parameter_units,
        motion.values,
        size,
        root @ root.T,
        inertia,
        cycles,
        tuple(relative.tolist()),
    )


def _information(
    motion: FlexibleMotion, slopes: Floats, torque: Floats, size: Floats, progress: Callable[[float], None]
) -> Floats:
    """(p, p) upper triangular square root of the information about the parameters in units of `size`."""
    arm = motion.arm
    n, width, x, p = arm.n, motion.base_rates, motion.states, len(size)
    read, noise, unknown = _readings(motion)
    root = np.diag(unknown)
    states = len(root)
    walk = arm.imu.bias_walk * math.sqrt(arm.period_s)
    moves, moved = np.zeros((states, p)), np.zeros((states, p))
    rows, triangle = [], np.zeros((p, p))
    across = np.eye(states)
    m = len(read)
    front = np.zeros((m + states, m + states))
    front[:m, :m] = np.diag(noise)
    pushed = np.zeros((states, states + n + width))
    last = len(slopes)
    for k in range(last + 1):
        front[:m, m:] = read @ root
        front[m:, m:] = root
        front[m:, :m] = 0.0
        lower = _triangle(front.T).T
        # amounts by which the parameters move the innovations, in their standard deviations
        share = solve_triangular(lower[:m, :m], read @ moved, lower=True)
        rows.append(share)
        moves = moved - lower[m:, :m] @ share
        root = lower[m:, m:]
        if k < last:
            across[:x, :x] = slopes[k, :, :x]
            moved = across @ moves
            moved[:x] += slopes[k, :, x : x + p] * size
            pushed[:, :states] = across @ root
            pushed[:x, states : states + n] = slopes[k, :, x + p :] * torque[k]
            pushed[x : x + width, states + n :] = walk * np.eye(width)
            root = _triangle(pushed.T).T
        if len(rows) * m > 4 * p or k == last:
            triangle = _triangle(np.concatenate([triangle, *rows]))
            rows = []
            progress(k / max(1, last))
    return triangle


def _readings(motion: FlexibleMotion) -> tuple[Floats, Floats, Floats]:
    """What the 2N + W sensors read of state, gyro bias and encoder zeros (m, s), the standard deviations of their noise
    (m,), and those of state, bias and zeros before the first reading (s,).

    An encoder that latches after SYNC reads an angle that its rate has moved on by then. A zero belongs to it
    unless it has no steps and the arm declares none.
    """
    arm = motion.arm.over_the_wire
    n, width, x = arm.n, motion.base_rates, motion.states
    encoders = [one.link_encoder for one in arm.joints] + [one.motor_encoder for one in arm.joints]
    doubtful = [row for row, one in enumerate(encoders) if one.zero_uncertainty_rad > 0.0]
    read = np.zeros((2 * n + width, x + width + len(doubtful)))
    noise = np.empty(len(read))
    for row, encoder in enumerate(encoders):
        read[row, width + row] = 1.0
        read[row, width + 2 * n + row] = 1e-6 * (arm.joints[row % n].latch_us + encoder.latch_us)
        noise[row] = encoder.sigma_rad
    read[2 * n :, :width] = read[2 * n :, x : x + width] = np.eye(width)
    noise[2 * n :] = arm.imu.rate_sigma
    unknown = np.full(read.shape[1], _UNKNOWN_RAD_S)
    unknown[width : width + 2 * n] = _UNKNOWN_RAD
    for column, row in enumerate(doubtful, x + width):
        read[row, column] = 1.0
        unknown[column] = encoders[row].zero_uncertainty_rad
    return read, noise, unknown


def _triangle(rows: Floats) -> Floats:
    """The upper triangular R with R' R = rows' rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"), dtype=np.float64)

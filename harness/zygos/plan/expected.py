# SPDX-License-Identifier: MIT
"""What a motion is expected to tell about each parameter."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.errors import ZygosError
from zygos.ground.estimate import sizes
from zygos.plan.limits import Limits
from zygos.plan.rows import Column, Grounded
from zygos.plan.series import FourierMotion
from zygos.simulation.plant import simulate
from zygos.simulation.scenario import Controller, Scenario

Floats = NDArray[np.float64]

_FINE = 4
"""Instants in half an increment at which the columns of a motion are computed."""
_BANDWIDTH_RAD_S = 6.0
"""Bandwidth of the servo of a planned motion, rad/s: it only corrects what the feedforward torque leaves."""


@dataclass(frozen=True)
class Expectation:
    """Expected standard deviations after one run of a motion; c columns."""

    name: str
    """Of the motion."""
    columns: tuple[Column, ...]
    sigma: Floats
    """(c,) standard deviations, SI units; NaN where the estimator is not expected to give a value."""
    size: Floats
    """(c,) to which sigmas are compared, SI units: `common_sizes`, or `FlexibleMotion.size` where it is the bound."""
    measure: float
    """Mean logarithm of relative sigmas, or logarithm of the mean of them where it is the bound: motions are ranked by
    it, the lowest first. Infinite where `open` is not None."""
    angle: Floats
    """(m, N) rad, of one run."""
    rate: Floats
    """(m, N) rad/s."""
    torque: Floats
    """(m, N) as the frames report it, Nm."""
    step_s: float
    """Time between two of the m instants, s."""
    excess: str | None
    """The limit that the motion exceeds most, in words; None if it keeps all."""
    open: str | None = None
    """What the motion does not determine, in words, if that leaves no parameter a sigma; None otherwise."""

    @property
    def percent(self) -> Floats:
        """(c,) standard deviations in per cent of `size`; infinite where that is 0."""
        return np.where(self.size > 0.0, 100.0 * self.sigma / np.where(self.size > 0.0, self.size, 1.0), math.inf)

    @property
    def mean_percent(self) -> float:
        """Mean of `percent` over the parameters of the arm whose size is not 0; NaN if one of them has no value."""
        own = np.array([column.structural for column in self.columns]) & (self.size > 0.0)
        return float(np.mean(self.percent[own]))

    @property
    def worst(self) -> int:
        """Position of the parameter of the arm with the largest relative deviation, or of one without a value."""
        own = np.array([column.structural for column in self.columns])
        percent = np.where(np.isnan(self.percent), np.inf, self.percent)
        return int(np.argmax(np.where(own, percent, -1.0)))


def common_sizes(columns: Sequence[Column]) -> Floats:
    """(c,) the largest value with the same unit of the same body, as an estimate on the ground judges sigmas."""
    return sizes([one.name for one in columns], [one.unit for one in columns], np.array([one.value for one in columns]))


def desired_by(arm: Arm, scenario: Scenario, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Desired angles, rates and accelerations (m, N) of a scenario at times t (m,), s."""
    names = [joint.name for joint in arm.joints]
    return *scenario.desired(names, t), scenario.accelerations(names, t)


def expected_on_ground(
    grounded: Grounded, scenario: Scenario, limits: Limits, progress: Callable[[float], None] = lambda share: None
) -> Expectation:
    """What a run of a scenario with an arm on the ground tells: the desired motion where the drive has a feedforward
    torque, the simulated one otherwise.

    Errors: ZygosError if the motion does not determine every parameter, is too short, or does not fit the arm.
    """
    arm = grounded.arm
    half = 0.5 * grounded.increment_s
    step = half / _FINE
    t: Floats = step * np.arange(math.floor(scenario.duration_s / step + 1e-9) + 1, dtype=np.float64)
    if scenario.controller.feedforward:
        angle, rate, acceleration = desired_by(arm, scenario, t)
        torque = grounded.torque(angle, rate, acceleration)
    else:
        run = simulate(arm, grounded.model, scenario, noise=False, progress=progress)
        t = t[t <= run.t[-1]]
        angle, rate, torque = (
            np.stack([np.interp(t, run.t, signal[0][:, i]) for i in range(arm.n)], axis=1)
            for signal in (run.q, run.qd, run.tau)
        )
    if len(t) < 4 * _FINE:
        raise ZygosError(
            f"scenario {scenario.name}: {scenario.duration_s:g} s are too short for increments of "
            f"{grounded.increment_s:g} s; remedy: a longer duration_s"
        )
    rows = grounded.rows(*grounded.at(angle, rate), step, _FINE)
    spread = grounded.covariance(rows)
    p = grounded.structural
    scale = np.abs([column.value for column in grounded.columns[:p]])
    scale = np.where(scale > 0.0, scale, np.median(scale[scale > 0.0]))
    measure = np.linalg.slogdet(spread[:p, :p] / np.outer(scale, scale))[1] / (2 * p)
    return Expectation(
        scenario.name,
        grounded.columns,
        np.sqrt(np.diag(spread)),
        common_sizes(grounded.columns),
        float(measure),
        angle,
        rate,
        torque,
        step,
        limits.violation(arm, angle, rate, torque),
    )


def scenario_of(
    grounded: Grounded, motion: FourierMotion, name: str, arm_file: Path, model_file: Path, duration_s: float, seed: int
) -> Scenario:
    """The scenario that moves an arm on the ground along a motion: a feedforward torque, and a servo that corrects."""
    arm = grounded.arm
    angle, rate, _ = motion.at(motion.period_s * np.arange(20) / 20)
    inertia = np.zeros(arm.n)
    for i in range(arm.n):
        unit = np.zeros_like(rate)
        unit[:, i] = 1.0
        inertia[i] = np.mean(grounded.at(angle, unit)[0][:, i] @ grounded.coefficients)
    controller = Controller(
        kp=_rounded(inertia * _BANDWIDTH_RAD_S**2),
        kd=_rounded(2.0 * inertia * _BANDWIDTH_RAD_S),
        feedforward=True,
    )
    start = motion.at(np.zeros(1))[0][0]
    return Scenario(
        name,
        arm_file,
        model_file,
        duration_s,
        dict(zip([joint.name for joint in arm.joints], motion.motions(), strict=True)),
        controller,
        seed=seed,
        encoder_noise="quantised",
        initial_angles_rad=tuple(start.tolist()),
    )


def _rounded(values: Sequence[float] | Floats) -> tuple[float, ...]:
    return tuple(float(f"{value:.3g}") for value in values)

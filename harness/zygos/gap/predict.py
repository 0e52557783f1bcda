# SPDX-License-Identifier: MIT
"""How well a model predicts a run: its torques joint by joint, and the motion half a second ahead.

Both errors stand beside their floor, which is what the noise of all sensors makes of the same model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.errors import Undecided, ZygosError
from zygos.gap.forecast import Forecast, Stretches, cut, forecast
from zygos.gap.runs import record_of
from zygos.ground.score import Score, score
from zygos.model.model import Model
from zygos.simulation.sensors import draw_noise, torque_error

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Ahead:
    """Predictions of S stretches of a run: n instants of half a second each, N joints.

    The signals are the N link angles and the N motor angles (rad), and the base rate (rad/s): about the arm's axis in a
    plane, three components in space, none on a fixed base. The state before each stretch is fitted, with the model, to
    the half second of readings before it.
    """

    stretches: Stretches
    forecast: Forecast
    floor: Array
    """(2N + W,) as `error`, of the same motion of the model itself, with the noise of all sensors drawn anew."""
    distance: Array
    """(S,) error of each stretch in standard deviations: the errors of all signals and instants, weighted with the
    inverse of the covariance that the noise of all sensors gives them; 1 where only that noise is left."""

    @property
    def t(self) -> Array:
        """(S, n) time of the predicted instants since the run's first cycle, s."""
        return self.stretches.time_s[:, -self.forecast.predicted.shape[1] :]

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the 2N + W signals."""
        names = [joint.name for joint in self.stretches.arm.joints]
        width = self.stretches.width
        base = ["base rate"] if width == 1 else [f"base rate {axis}" for axis in "xyz"[:width]]
        return (*(f"{name} link angle" for name in names), *(f"{name} motor angle" for name in names), *base)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the signals."""
        joints = 2 * self.stretches.arm.n
        return ("rad",) * joints + ("rad/s",) * self.stretches.width

    @property
    def predicted(self) -> Array:
        """(S, n, 2N + W) the signals as the model predicts them, rad and rad/s."""
        return self.forecast.predicted

    @property
    def measured(self) -> Array:
        """(S, n, 2N + W) the signals as they were measured, rad and rad/s."""
        return self.stretches.readings[:, -self.forecast.predicted.shape[1] :]

    @property
    def error(self) -> Array:
        """(2N + W,) error of each signal, rad and rad/s: the median over the stretches of their root mean square."""
        return _typical(self.forecast.residual) * self.stretches.sigma

    @property
    def median(self) -> float:
        """Median of `distance`."""
        return float(np.median(self.distance))

    @property
    def tenth(self) -> float:
        """What a tenth of the stretches exceeds."""
        return float(np.percentile(self.distance, limits.TAIL_PERCENT.value, method="higher"))


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """What a model predicts of a run, beside what was measured."""

    torques: Score
    ahead: Ahead | None
    """None for an arm on the ground with rigid joints, whose torques say all, and where `reason` says why."""
    reason: str = ""
    """Why the motion is not predicted; empty where it is, or need not be."""

    @property
    def gap(self) -> float:
        """Error of the prediction in standard deviations of the noise of all sensors: the median over the stretches of
        the motion half a second ahead, or else the root mean square over the torques. NaN where neither is known."""
        if self.ahead is not None:
            return self.ahead.median
        each = [one.sigmas for one in self.torques.joints if one.evaluated]
        return float(np.sqrt(np.mean(np.square(each)))) if each else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """What `zygos predict --json` writes of a run."""
        ahead = self.ahead
        return self.torques.as_dict() | {
            "ahead": ahead
            and {
                "stretches": len(ahead.distance),
                "median": ahead.median,
                "ninetieth": ahead.tenth,
                "signals": [
                    {"name": name, "unit": unit, "error": error, "floor": floor}
                    for name, unit, error, floor in zip(
                        ahead.signals, ahead.units, ahead.error.tolist(), ahead.floor.tolist(), strict=True
                    )
                ],
            },
            "not_ahead": self.reason or None,
        }

    def __repr__(self) -> str:
        """Errors of the torques, and of the motion."""
        ahead = self.ahead
        if ahead is None:
            return repr(self.torques)
        return (
            f"{self.torques!r}\nhalf a second ahead, {len(ahead.distance)} stretches: {ahead.median:.3g} standard "
            f"deviations of noise in the median, 90th percentile {ahead.tenth:.3g}"
        )


def predict(model: Model, run: Run, *, cutoff: float | None = None) -> Prediction:
    """Compare a run with what a model predicts of it: the torques of its joints, and the motion half a second ahead.

    Torques: those that the model needs for the measured motion, as `zygos.ground.score.score` has them. cutoff: of
    their filter, Hz, of an arm on the ground with rigid joints.

    Motion, of every other arm: from the readings before and under the measured torques, again and again. The motion of
    a flexible arm is chaotic, so that longer predictions compare nothing. The fit before each stretch takes another
    half second. `Prediction.gap` near 1 is a model as good as the sensors can tell.

    Errors: ZygosError where the model lacks a parameter of the arm, or the run is too short.
    """
    torques = score(run, model, cutoff=cutoff)
    if run.arm.grounded:
        return Prediction(torques, None)
    try:
        dynamics, stretches = from_model(run.arm, model), cut(record_of(run))
    except (ZygosError, Undecided) as error:
        return Prediction(torques, None, str(error).partition("; remedy")[0])
    stretches = stretches.thinned(-(-stretches.readings.size // limits.PREDICTED_READINGS.value))
    found = forecast(dynamics, stretches)
    drawn = [_drawn(stretches, found, seed) for seed in range(limits.PREDICTED_DRAWS.value)]
    each = forecast(dynamics, Stretches.joined(drawn), near=found.repeated(len(drawn)))
    residual, predicted = (x.reshape(len(drawn), *found.residual.shape) for x in (each.residual, each.predicted))
    strayed = (predicted - found.predicted) / stretches.sigma
    floor = _typical(each.residual) * stretches.sigma
    return Prediction(torques, Ahead(stretches, found, floor, distances(found.residual, residual, strayed)))


def _drawn(stretches: Stretches, found: Forecast, seed: int) -> Stretches:
    """What the sensors would have read, had the model moved from the fitted starts under the torques that were read."""
    arm, (count, cycles) = stretches.arm.over_the_wire, stretches.tau.shape[:2]
    rng = np.random.default_rng([limits.TWIN_SEEDS.value, seed])
    readings = found.path + stretches.sigma * rng.standard_normal(found.path.shape)
    tau = np.concatenate([stretches.before[:, None], stretches.tau], axis=1)
    noise = draw_noise(arm, count * (cycles + 1), [limits.TWIN_SEEDS.value + seed])
    shaped = (x[0].reshape(count, cycles + 1, arm.n) for x in (noise.torque, noise.torque_share))
    tau = tau + torque_error(tau, *shaped)
    return replace(stretches, readings=readings, tau=tau[:, 1:], before=tau[:, 0])


def distances(residual: Array, drawn: Array, strayed: Array) -> Array:
    """(S,) errors of stretches in standard deviations of noise.

    residual: (S, n, W) predicted less measured, in units of the sensors' noise. drawn: (D, S, n, W) the same of the
    model itself with noise drawn anew. strayed: (D, S, n, W) predicted less exact of these draws; its products, and the
    noise of one reading, make the covariance. Each draw is judged by the others, and their median is the unit: with few
    draws the covariance is not exact, and in chaotic motion single draws run away.
    """
    count = len(drawn)
    own = np.array([_distance(residual[s], strayed[:, s]) for s in range(len(residual))])
    others = [
        _distance(drawn[d, s], np.delete(strayed[:, s], d, axis=0)) for d in range(count) for s in range(len(residual))
    ]
    return np.asarray(own / np.median(others), dtype=np.float64)


def _typical(residual: Array) -> Array:
    """(W,) the median over stretches (S, n, W) of the root mean square of each signal."""
    with np.errstate(over="ignore"):
        return np.asarray(np.median(np.sqrt(np.mean(residual**2, axis=1)), axis=0), dtype=np.float64)


def _distance(residual: Array, strayed: Array) -> float:
    """Root mean square of a residual that is weighted with the inverse of 1 + the mean product of `strayed` (D, …)."""
    strayed = strayed[np.isfinite(strayed).all(axis=(1, 2))]
    if not (np.isfinite(residual).all() and len(strayed)):
        return float("inf")
    with np.errstate(over="ignore"):
        e, u = residual.ravel(), strayed.reshape(len(strayed), -1) / np.sqrt(len(strayed))
        inside = np.linalg.solve(np.eye(len(u)) + u @ u.T, u @ e)
        return float(np.sqrt(max(0.0, float(e @ e - (u @ e) @ inside)) / len(e)))

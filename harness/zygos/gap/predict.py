"""How well a model predicts a run, half a second ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.can.run import Run
from zygos.dynamics.equations import from_model
from zygos.gap.forecast import Forecast, Stretches, cut, forecast
from zygos.gap.runs import record_of
from zygos.model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """Predictions of S stretches of a run: n instants of half a second each, N joints.

    The signals are the N link angles and the N motor angles (rad), and the base rate (rad/s): about the arm's axis in a
    plane, three components in space, none on a fixed base. The
    state before each stretch is fitted, with the model, to the half second of readings before it.
    """

    stretches: Stretches
    forecast: Forecast

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
    def predicted(self) -> Array:
        """(S, n, 2N + W) the signals as the model predicts them, rad and rad/s."""
        return self.forecast.predicted

    @property
    def measured(self) -> Array:
        """(S, n, 2N + W) the signals as they were measured, rad and rad/s."""
        return self.stretches.readings[:, -self.forecast.predicted.shape[1] :]

    @property
    def sigma(self) -> Array:
        """(2N + W,) declared standard deviation of one reading of each signal, rad and rad/s."""
        return self.stretches.sigma

    @property
    def gap(self) -> float:
        """Root mean square error in units of `sigma`; infinite where a prediction diverges."""
        return self.forecast.gap

    @property
    def median(self) -> float:
        """Median over the stretches of their root mean square error, in units of `sigma`."""
        return self.forecast.median

    def __repr__(self) -> str:
        """Size and errors."""
        stretches, instants, _ = self.predicted.shape
        return (
            f"<Prediction of {stretches} stretches of {instants} instants: rms error {self.gap:.3g} sigma, median "
            f"{self.median:.3g} sigma>"
        )


def predict(model: Model, run: Run) -> Prediction:
    """Predict a run half a second ahead, again and again, from the readings before and under the measured torques.

    The motion of a flexible arm is chaotic, so that longer predictions compare nothing. The fit before each stretch
    takes another half second. `Prediction.gap` near 1 is a model as good as the sensors can tell.

    Errors: ZygosError for a run without unbroken stretches of some seconds, and for a model that does not fit the arm.
    """
    dynamics = from_model(run.arm, model)
    stretches = cut(record_of(run))
    return Prediction(stretches, forecast(dynamics, stretches))

"""How well a model predicts a run, half a second ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zygos.arm import Arm
from zygos.can.run import Run
from zygos.dynamics.planar import PlanarDynamics
from zygos.errors import ZygosError
from zygos.gap.forecast import Forecast, Stretches, cut, forecast
from zygos.gap.runs import record_of
from zygos.model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """Predictions of S stretches of a run: n instants of half a second each, N joints.

    The signals are the N link angles and the N motor angles (rad), and the base rate about the arm's axis (rad/s). The
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
        """Names of the 2N + 1 signals."""
        names = [joint.name for joint in self.stretches.arm.joints]
        return (*(f"{name} link angle" for name in names), *(f"{name} motor angle" for name in names), "base rate")

    @property
    def predicted(self) -> Array:
        """(S, n, 2N + 1) the signals as the model predicts them, rad and rad/s."""
        return self.forecast.predicted

    @property
    def measured(self) -> Array:
        """(S, n, 2N + 1) the signals as they were measured, rad and rad/s."""
        return self.stretches.readings[:, -self.forecast.predicted.shape[1] :]

    @property
    def sigma(self) -> Array:
        """(2N + 1,) declared standard deviation of one reading of each signal, rad and rad/s."""
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


def check_arm_of_forecast(arm: Arm) -> None:
    """Refuse, with ZygosError, an arm whose motion cannot be predicted here."""
    if arm.spatial or not arm.free or not all(joint.flexible for joint in arm.joints):
        raise ZygosError(
            f"arm {arm.name}: predictions are there for free-floating arms with flexible joints that move in a plane; "
            "remedy: simulate its model with the scenario of the run, and compare the two runs"
        )


def predict(model: Model, run: Run) -> Prediction:
    """Predict a run half a second ahead, again and again, from the readings before and under the measured torques.

    The motion of a flexible arm is chaotic, so that longer predictions compare nothing. The fit before each stretch
    takes another half second. `Prediction.gap` near 1 is a model as good as the sensors can tell.

    Errors: ZygosError for an arm that does not float freely in a plane with flexible joints, for a run
    without unbroken stretches of some seconds, and for a model that does not fit the arm.
    """
    check_arm_of_forecast(run.arm)
    dynamics = PlanarDynamics.from_model(run.arm, model)
    stretches = cut(record_of(run))
    return Prediction(stretches, forecast(dynamics, stretches))

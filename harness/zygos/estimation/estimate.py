# SPDX-License-Identifier: MIT
"""An estimate from a run: the values of the flight library, what it left out, and whether the arm changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zygos.can.run import Run
from zygos.effects import Effect
from zygos.errors import Undecided
from zygos.estimation.remedies import measured, remedy
from zygos.estimation.sections import learned, report_estimate
from zygos.estimation.watch import Watch
from zygos.estimation.words import about_change, about_left_out, about_noise, shows_change
from zygos.model.model import Model, Quantity
from zygos.native.flight import Drift, Estimate, Flight
from zygos.report.values import Valued

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Estimation(Valued):
    """What the flight library learned: p parameters, those of the arm first, then the columns of the effects."""

    watch: Watch
    """The flight that was fed, and the arcs that it left out."""
    result: Estimate
    """The solver's answer in full."""
    drift: Drift | None
    """The look that shows a change of the arm most plainly; None where there was none."""
    run: Run | None = None
    """The run; None for an estimate of frames that were never recorded."""
    prior: Model | None = None
    """The model that was given."""
    asked: tuple[Effect, ...] = ()
    """Effects that were to be learned beside those of the model."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p parameters."""
        return self.result.names

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the p parameters."""
        return self.result.units

    @property
    def value(self) -> Array:
        """(p,) values in `units`; NaN where the motion does not determine a parameter."""
        return self.result.value

    @property
    def sigma(self) -> Array:
        """(p,) standard deviations; NaN as `value`."""
        return self.result.sigma

    @property
    def half95(self) -> Array:
        """(p,) half widths of the 95 % intervals; NaN as `value`."""
        return self.result.half95

    @property
    def covariance(self) -> Array:
        """(p, p) covariance of the values."""
        return self.result.covariance

    @property
    def validity(self) -> str:
        """One of "valid", "partial" (some parameters have no value), "doubtful" and "refused"."""
        return self.result.validity

    @property
    def reason(self) -> str:
        """Why the estimate is not valid; empty where it is."""
        return self.result.reason

    @property
    def remedy(self) -> str:
        """What to do about an estimate that is not valid; empty where it is."""
        if self.validity == "valid":
            return ""
        if self.drift and shows_change(self.result, self.drift):
            return "read the warning: the arm changed"
        return remedy(self.result, self.watch.flight, self.watch.known)

    @property
    def measured(self) -> str:
        """The number behind `reason`, in words; empty where there is none."""
        return measured(self.result, self.watch.flight)

    @property
    def change(self) -> str:
        """That arcs of the run contradict those before, when and in which parameters; empty where none does."""
        if self.drift is None or not self.drift.contradicting:
            return ""
        return about_change(self.result, self.drift, self.watch.flight.arm)

    @property
    def notes(self) -> tuple[str, ...]:
        """Arcs that were left out, and noise that is worth a word, in sentences."""
        said = (about_left_out(self.result, self.watch), about_noise(self.result))
        return tuple(text for text in said if text)

    def to_model(self) -> Model:
        """The model with what was learned: base parameters and effects with value and sigma.

        What the run does not determine comes from the model that was given, or is left out. Errors: Undecided where
        the estimate was refused.
        """
        if self.validity == "refused":
            raise Undecided(f"refused: {self.reason}; remedy: {self.remedy}")
        result, flight = self.result, self.watch.flight
        found = {
            name: Quantity(float(value), float(sigma), "zygos", unit)
            for name, unit, value, sigma in zip(result.names, result.units, result.value, result.sigma, strict=True)
            if np.isfinite(value)
        }
        known = (self.prior.base_parameters(flight.arm) if self.prior is not None else {}) | found
        quantities = {name: known[name] for name in flight.arm.parameter_names if name in known}
        given = (*(self.prior.effects if self.prior is not None else ()), *self.asked)
        # an offset that is estimated only because of the arm file is left out if the run does not determine it
        others = (one for one in flight.effects if one not in given and one.column(flight.arm) in found)
        effects = tuple(learned(effect, found.get(effect.column(flight.arm))) for effect in (*given, *others))
        return Model(name=flight.arm.name, parameters=quantities, effects=effects)

    def as_dict(self, heading: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """All of it in numbers, texts, lists and dictionaries: what `zygos estimate --json` writes behind a heading."""
        return report_estimate(self.result, self.watch, self.drift, heading or {})

    def __repr__(self) -> str:
        """Validity, and a line for each parameter."""
        lines = [f"{self.validity}{f': {self.reason}' if self.reason else ''}"]
        for name, unit, value, half in zip(self.names, self.units, self.value, self.half95, strict=True):
            lines.append(f"{name:<18}{value:>14.7g} ± {half:<10.2g} {unit}")
        return "\n".join(lines)


def conclude(
    watch: Watch, run: Run | None = None, prior: Model | None = None, asked: Sequence[Effect] = ()
) -> Estimation:
    """The estimate of a flight that was fed, and a last look for a change."""
    result = watch.flight.estimate()
    return Estimation(watch, result, watch.look(), run, prior, tuple(asked))


def estimate(
    run: Run,
    *,
    model: Model | None = None,
    effects: Sequence[Effect] = (),
    progress: Callable[[float], None] | None = None,
    trace: bool = False,
) -> Estimation:
    """Learn the parameters of an arm from a run, with the C library that flies.

    model: its effects are learned as well, whatever their values, and it keeps its values where the run determines
    none (`Estimation.to_model`). effects: further ones to be learned. progress is called now and then with the share
    that is done. trace: keep the intermediate results of each cycle, which the report page draws.

    An estimate that is not valid is no error: see `Estimation.validity`, `reason` and `remedy`.

    Errors: ZygosError where the model or an effect does not fit the arm, or the library refuses the arm.
    """
    if model is not None:
        model.base_parameters(run.arm)
    watch = Watch(Flight(run.arm, (*(model.effects if model is not None else ()), *effects)), trace=trace)
    if run.frames is not None:
        watch.frames(run.frames, progress)
    else:
        watch.cycles(run.cycles, progress)
    return conclude(watch, run, model, effects)

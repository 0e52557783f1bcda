# SPDX-License-Identifier: MIT
"""What is found where a simulation and runs disagree, as data: values, effects, deflections, and the gap itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zygos import limits
from zygos.effects import Kind, is_column
from zygos.gap.forecast import Forecast, Stretches

FLEXIBILITY = "joint_flexibility"
"""Kind of a finding that is no entry of the catalogue: the simulation's joint is rigid."""
ROTOR_INERTIA = "rotor_inertia"
"""Likewise: the simulation's rotor has no inertia."""
ASYMMETRY = "coulomb_asymmetry"
"""Likewise: half of the difference of the Coulomb friction in positive and negative direction."""
_TITLES = {
    FLEXIBILITY: "joint flexibility",
    ROTOR_INERTIA: "inertia of the rotor",
    ASYMMETRY: "Coulomb friction that differs between the directions",
}


@dataclass(frozen=True)
class Value:
    """A base parameter, or an effect that the simulation knows: what it had, and what the runs say."""

    name: str
    unit: str
    delivered: float
    delivered_sigma: float
    found: float
    sigma: float

    @property
    def change(self) -> float:
        """Relative difference; NaN where the value that was delivered is hardly one."""
        if not np.isfinite(self.delivered) or abs(self.delivered) < limits.MATERIAL_DIFFERENCE.value * abs(self.found):
            return np.nan
        return self.found / self.delivered - 1.0 if self.delivered else np.nan

    @property
    def absent(self) -> bool:
        """Whether it is an effect of which the runs show nothing."""
        return is_column(self.name) and abs(self.found) < limits.DIFFERS_Z.value * self.sigma

    @property
    def differs(self) -> bool:
        """Whether the two are further apart than their deviations and their sizes allow."""
        apart = abs(self.found - self.delivered)
        return bool(
            np.isfinite(apart)
            and apart > limits.DIFFERS_Z.value * np.hypot(self.sigma, self.delivered_sigma)
            and apart > limits.MATERIAL_DIFFERENCE.value * abs(self.delivered)
        )


@dataclass(frozen=True)
class Disagreement:
    """A parameter on which two runs disagree while each of them closes by itself."""

    name: str
    first: float
    second: float


@dataclass(frozen=True)
class Deflection:
    """A joint that the simulation takes as rigid."""

    joint: str
    rms_rad: float
    noise_rad: float
    skew_s: float
    skew_share: float
    """Share of the deflection's variance that a delay between the encoders would explain."""


@dataclass(frozen=True)
class Significance:
    """The evidence for an effect of the catalogue."""

    z: float
    """Standard deviations of the null twin, on the run where they are fewer."""
    completeness: float
    """Share of the excess that all named effects explain, on the run where it is less."""


@dataclass(frozen=True)
class Repeated:
    """The evidence for an effect of an arm on the ground, which every run shows."""

    z: float
    """Standard deviations by which the coefficient differs from 0, from the scatter over blocks of time."""
    completeness: float
    """Share of the squared residual beyond noise that it explains at its joint, at the value of the other runs."""
    each: tuple[float, ...]
    """The coefficient on each run by itself; NaN on a run that does not show it."""


@dataclass(frozen=True)
class Finding:
    """An effect that the simulation lacks."""

    kind: str
    """Name in the catalogue, or `FLEXIBILITY`."""
    joint: str | None
    value: float
    sigma: float
    unit: str
    evidence: Significance | Deflection | Repeated
    instead: tuple[str, ...] = ()
    """Columns that the runs cannot tell from it."""
    assumed: float | None = None
    """What the simulation has in its place, in the same unit; None where it has nothing."""
    shape: float | None = None
    """Of its law, where that has one."""
    component: str = ""
    """Which axis it acts along, where it has several."""
    entry: Kind | None = None
    """Of the catalogue; None where it is none."""

    @property
    def title(self) -> str:
        """The effect as a sentence names it."""
        plain = self.entry.title if self.entry else _TITLES[self.kind]
        return f"the right {plain} (it assumes {self.assumed:g} Nms)" if self.assumed else plain

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, of values that the entry may have."""
        low, high = (self.value + z * self.sigma for z in (-limits.INTERVAL_Z.value, limits.INTERVAL_Z.value))
        return (0.0 if low < 0.0 < high and self.entry is not None and self.entry.positive else low), high

    @property
    def signed(self) -> bool:
        """Whether its interval says in which direction it differs from what the simulation has in its place."""
        low, high = self.interval
        return not low <= (self.assumed or 0.0) <= high


def undecided(findings: Sequence[Finding]) -> bool:
    """Whether some of the findings cannot be told from other effects."""
    return any(finding.instead for finding in findings)


@dataclass(frozen=True)
class Gap:
    """Predictions of the untouched run; all in units of the sensors' declared noise."""

    segments: Stretches
    delivered: Forecast
    refit: Forecast
    closed: Forecast
    floor: Forecast
    struck: Forecast | None
    """The closed model with the named effects of the catalogue struck out; None where none was."""
    wrong: Forecast | None
    """With the best other candidate in place of the named effect."""
    wrong_name: str
    reach: tuple[Forecast, ...] = ()
    """Predictions of the floor's twin by models whose values err as much as noise makes a fit of these runs err."""
    runs: tuple[str, ...] = ()
    """Names of the untouched runs."""

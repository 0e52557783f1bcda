# SPDX-License-Identifier: MIT
"""The gate of an explanation: a model leaves it as `Adopted` only, which no failing check lets be made."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from zygos import limits
from zygos.arm import Arm
from zygos.dynamics.equations import from_model
from zygos.effects import Effect
from zygos.errors import Undecided, ZygosError
from zygos.model.model import Model
from zygos.report.figures import figure


@dataclass(frozen=True)
class Check:
    """A condition that a model has to meet."""

    name: str
    """What was found, as the subject of a sentence."""
    found: float
    unit: str
    lowest: float = -math.inf
    highest: float = math.inf
    beside: str = ""
    """Where the limit is from; empty where it is a physical one."""

    @property
    def holds(self) -> bool:
        """Whether it is met; NaN is not."""
        return self.lowest <= self.found <= self.highest

    @property
    def limit(self) -> float:
        """The bound that counts: the one that is not kept, or else the highest, or else the lowest."""
        return self.highest if self.found > self.highest or math.isfinite(self.highest) else self.lowest

    @property
    def sentence(self) -> str:
        """What was found beside its limit, in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        which = "at least" if self.limit == self.lowest else "at most"
        beside = f" ({self.beside})" if self.beside else ""
        return f"{self.name} is {figure(self.found)}{unit}, and may be {which} {figure(self.limit)}{unit}{beside}"


class NotAdopted(Undecided):
    """A model that does not pass the gate."""

    def __init__(self, model: Model, failed: Sequence[Check]) -> None:
        """failed: the checks that do not hold."""
        self.failed = tuple(failed)
        said = "; ".join(check.sentence for check in failed)
        super().__init__(f"model {model.name} is not adopted: {said}; remedy: `zygos estimate`, or further runs")


@dataclass(frozen=True)
class Adopted:
    """A model that an explanation reports, predicts with and writes.

    Errors: NotAdopted where a check does not hold.
    """

    arm: Arm
    model: Model
    comparisons: tuple[Check, ...] = ()
    """Its predictions of untouched runs beside those of the baselines."""
    checks: tuple[Check, ...] = field(init=False)
    """All that it passed: `possible`, then the comparisons."""

    def __post_init__(self) -> None:
        """Refuse what does not hold."""
        checks = (*possible(self.arm, self.model), *self.comparisons)
        failed = [check for check in checks if not check.holds]
        if failed:
            raise NotAdopted(self.model, failed)
        object.__setattr__(self, "checks", checks)


def possible(arm: Arm, model: Model) -> tuple[Check, ...]:
    """Whether some arm can have the parameters of a model, and whether its effects lie within their physical bounds.

    Errors: ZygosError where the model lacks a parameter of the arm.
    """
    values = dict(zip(arm.parameter_names, model.base_values(arm).tolist(), strict=True))
    checks = [
        Check(
            name,
            values[name],
            unit,
            lowest=0.0
            if one.symbol == "b" or (one.symbol == "Im" and not arm.joints[one.joint].flexible)
            else limits.LEAST_INERTIA.value,
        )
        for name, unit, one in zip(arm.parameter_names, arm.parameter_units, arm.parameters, strict=True)
        if one.joint is not None and one.symbol in ("Im", "k", "b")
    ]
    for effect in model.effects:
        low, high = bounds(arm, effect, values)
        checks.append(Check(effect.column(arm), effect.value, effect.kind.unit, low, high))
    if all(check.holds for check in checks):
        checks.append(_of_an_arm(arm, model))
    return tuple(checks)


def bounds(arm: Arm, effect: Effect, values: dict[str, float]) -> tuple[float, float]:
    """Smallest and largest value that an effect can have. values: base parameters by name."""
    kind = effect.kind
    low = 0.0 if kind.positive else -math.inf
    if kind.lags:
        return low, math.nextafter(arm.period_s, 0.0)
    if kind.unit == "s":
        return -arm.period_s, arm.period_s
    if kind.unit == "1" and kind.place in ("torque", "sensor"):
        return max(low, limits.LEAST_GAIN.value), 1.0
    if kind.key == "backlash":
        # where the gap is free, the spring pushes nothing; with more it would pull
        return low, values.get(f"k{effect.index(arm) + 1}", math.inf)
    return low, math.inf


def _of_an_arm(arm: Arm, model: Model) -> Check:
    """Whether the kinetic energy of the parameters is positive in every motion."""
    broken = ""
    try:
        from_model(arm, model)
    except ZygosError as error:
        broken = str(error).partition(";")[0]
    name = "the number of conditions that every arm meets and its parameters do not"
    return Check(name, float(bool(broken)), "1", highest=0.0, beside=broken)


def no_worse(name: str, unit: str, found: float, baselines: Iterable[tuple[str, float]], closed: float = 0.0) -> Check:
    """Compare an error of predictions with the smallest one of the baselines, which have names. closed: up to which it
    closes, whatever the baselines do."""
    which, least = min(baselines, key=lambda one: one[1] if math.isfinite(one[1]) else math.inf)
    if closed > limits.NOT_WORSE.value * least:
        return Check(name, found, unit, highest=closed, beside="up to which only noise is left")
    return Check(
        name,
        found,
        unit,
        highest=limits.NOT_WORSE.value * least,
        beside=f"{limits.NOT_WORSE.value:g} times that of the model {which}",
    )

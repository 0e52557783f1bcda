# SPDX-License-Identifier: MIT
"""Numbers as people write them, and scales of powers of ten."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from zygos.report.page import UNITS, Entry


def figure(value: float, digits: int = 3) -> str:
    """A number with so many digits that count; powers of ten where it is small, a dash where it is none."""
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "0"
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    if int(power) < -3:
        return f"{mantissa}·10{raised(int(power))}".replace("-", "−")
    return f"{value:,.{max(0, digits - 1 - int(power))}f}".replace("-", "−")


def raised(power: int) -> str:
    """A power as an exponent."""
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def down_to(value: float, sigma: float) -> str:
    """A value down to the second digit of its standard deviation."""
    if not (sigma > 0.0 and math.isfinite(value) and math.isfinite(sigma)):
        return figure(value, 6)
    return f"{value:,.{min(9, max(0, 1 - math.floor(math.log10(sigma))))}f}".replace("-", "−")


def within(value: float, sigma: float) -> str:
    """A value ± its standard deviation, both down to the second digit of the latter."""
    known = sigma > 0.0 and math.isfinite(value) and math.isfinite(sigma)
    return f"{down_to(value, sigma)} ± {down_to(sigma, sigma)}" if known else figure(value, 6)


def listed(
    names: Iterable[str], units: Iterable[str], values: Iterable[float], halves: Iterable[float]
) -> tuple[str, ...]:
    """Each value that there is, with half of its 95 % interval."""
    return tuple(
        f"{name} {within(x, half)} {unit_of(unit)}".strip()
        for name, unit, x, half in zip(names, units, values, halves, strict=True)
        if math.isfinite(x)
    )


def unit_of(unit: str) -> str:
    """A unit of a file as people write it; nothing for a pure number."""
    return "" if unit == "1" else UNITS.get(unit, unit.replace("Nms", "N m s").replace("Nm", "N m").replace("^3", "³"))


def percent(share: float) -> str:
    """A signed share in per cent."""
    if not math.isfinite(share):
        return "–"
    if abs(share) < 5e-5:
        return "0.00" if share == 0.0 else "< 0.01"
    return f"{100.0 * share:+.2f}".replace("-", "−")


def signed(value: float, digits: int = 2) -> str:
    """A number with its sign and so many decimals; a dash where it is none."""
    return f"{value:+.{digits}f}".replace("-", "−") if math.isfinite(value) else "–"


def grouped(value: float) -> str:
    """A number of seven digits with its thousands apart; a dash where it is none."""
    return f"{value:,.7g}".replace("-", "−") if math.isfinite(value) else "–"


@dataclass(frozen=True)
class LogScale:
    """A scale of powers of ten, in per cent of a cell's width."""

    low: float
    high: float
    """Decimal logarithms of its ends."""

    @classmethod
    def of(cls, values: Iterable[float], least: float, most: float) -> LogScale:
        """From the least of all values to a bit above the largest; it holds `least` and `most` in any case."""
        known = [math.log10(v) for v in values if math.isfinite(v) and v > least]
        return cls(math.log10(least), max([*known, math.log10(most)]) + 0.1)

    def at(self, value: float) -> float | None:
        """Position of a value; the scale's ends where it is beyond them, None where it is no number."""
        if math.isnan(value):
            return None
        if value <= 0.0:
            return 0.0
        share = (math.log10(value) - self.low) / (self.high - self.low) if math.isfinite(value) else 1.0
        return min(100.0, max(0.0, 100.0 * share))

    @property
    def ticks(self) -> list[Entry]:
        """Powers of ten, thinned to eight."""
        first, last = math.ceil(self.low - 1e-9), math.floor(self.high)
        powers = range(first, last + 1, max(1, math.ceil((last - first) / 8)))
        return [
            {"at": self.at(10.0**k), "label": figure(10.0**k, 1) if abs(k) <= 3 else f"10{raised(k)}"} for k in powers
        ]

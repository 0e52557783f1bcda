# SPDX-License-Identifier: MIT
"""Values with their intervals, as notebooks and scripts want them: by name, as a table, as a picture."""

from __future__ import annotations

import html
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zygos.errors import ZygosError, installs
from zygos.report.figures import down_to, figure, unit_of

if TYPE_CHECKING:
    import polars
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Value:
    """One value. SI units."""

    name: str
    unit: str
    value: float
    """NaN where nothing is known of it."""
    sigma: float
    """Standard deviation."""
    half95: float
    """Half width of the 95 % interval."""

    def __float__(self) -> float:
        """The value alone."""
        return self.value

    def __str__(self) -> str:
        """Name, value, interval and unit, with the digits that the deviation leaves."""
        value, half = _cells(self)
        known = math.isfinite(self.value)
        return f"{self.name} = {value} ± {half} {unit_of(self.unit)}".strip() if known else f"{self.name}: no value"


class Valued:
    """An answer with `names`, `units`, `value`, `sigma` and `half95`."""

    if TYPE_CHECKING:  # fields of some answers, properties of others

        @property
        def names(self) -> tuple[str, ...]: ...  # noqa: D102
        @property
        def units(self) -> tuple[str, ...]: ...  # noqa: D102
        @property
        def value(self) -> Floats: ...  # noqa: D102
        @property
        def sigma(self) -> Floats: ...  # noqa: D102
        @property
        def half95(self) -> Floats: ...  # noqa: D102

    def values(self) -> tuple[Value, ...]:
        """The p values, in the order of `names`."""
        columns = (self.value.tolist(), self.sigma.tolist(), self.half95.tolist())
        return tuple(Value(*entry) for entry in zip(self.names, self.units, *columns, strict=True))

    def __getitem__(self, name: str) -> Value:
        """A value by the name of its parameter. Errors: KeyError, with the names that there are."""
        for one in self.values():
            if one.name == name:
                return one
        raise KeyError(f"there is no {name!r}; remedy: one of {', '.join(self.names)}")

    def to_frame(self) -> polars.DataFrame:
        """A table of polars with a row for each value: name, unit, value, sigma, half95. `.to_pandas()` is one of
        pandas. Errors: ZygosError where polars is missing."""
        try:
            import polars as frames  # noqa: PLC0415  (an extra)
        except ImportError as error:
            raise ZygosError(f"a table needs polars; remedy: {installs('tables')}") from error
        return frames.DataFrame([vars(one) for one in self.values()])

    def _repr_html_(self) -> str:
        """What a notebook shows: the values with their intervals."""
        rows = "".join(
            f"<tr><th>{html.escape(one.name)}</th><td>{shown}</td><td>{half}</td>"
            f"<td>{html.escape(unit_of(one.unit))}</td></tr>"
            for one in self.values()
            for shown, half in [_cells(one)]
        )
        said = html.escape(repr(self).partition("\n")[0])
        head = "<tr><th>parameter</th><th>value</th><th>± 95 %</th><th>unit</th></tr>"
        return f"<p>{said}</p><table>{head}{rows}</table>"

    def plot(self, true: Any = None, ax: Axes | None = None) -> Axes:
        """Draw the values with their 95 % intervals, each in per cent of itself; returns the axes of matplotlib.

        true: what to compare with, for instance a drawing: a mapping from names to values, or values in the order of
        `names`; then deviations from it are drawn. Errors: ZygosError where matplotlib is missing.
        """
        try:
            import matplotlib.pyplot as plt  # noqa: PLC0415  (an extra)
        except ImportError as error:
            raise ZygosError(f"a picture needs matplotlib; remedy: {installs('view')}") from error
        known = [one for one in self.values() if math.isfinite(one.value) and one.value]
        wanted: dict[str, float] = {}
        if true is not None:
            wanted = dict(true) if hasattr(true, "keys") else dict(zip(self.names, map(float, true), strict=True))
            known = [one for one in known if wanted.get(one.name)]
        base = [wanted.get(one.name, one.value) for one in known]
        drawn = ax if ax is not None else plt.subplots(figsize=(6.0, 0.6 + 0.3 * len(known)))[1]
        far = [100.0 * (one.value / own - 1.0) for one, own in zip(known, base, strict=True)]
        half = [100.0 * abs(one.half95 / own) for one, own in zip(known, base, strict=True)]
        drawn.errorbar(far, range(len(known)), xerr=half, fmt="o", capsize=3)
        drawn.axvline(0.0, color="black", linewidth=0.8)
        drawn.set_yticks(range(len(known)), [one.name for one in known])
        drawn.invert_yaxis()
        drawn.set_xlabel("deviation, %" if wanted else "95 % interval, % of the value")
        return drawn


def _cells(one: Value) -> tuple[str, str]:
    if not math.isfinite(one.value):
        return "–", "–"
    return down_to(one.value, one.sigma), figure(one.half95, 2)

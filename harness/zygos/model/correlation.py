# SPDX-License-Identifier: MIT
"""Correlations between the values of a model that were estimated together (`[correlation]` of `model.toml`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import tomlkit
from numpy.typing import NDArray

from zygos.files.toml import Table


@dataclass(frozen=True)
class Correlation:
    """Coefficients of correlation between the errors of n named values; other values are independent of them."""

    names: tuple[str, ...]
    """Base parameters and columns of effects, as `zygos estimate` names them."""
    rows: tuple[tuple[float, ...], ...]
    """Of each value with those before it."""

    @classmethod
    def of(cls, names: Sequence[str], covariance: NDArray[np.float64]) -> Correlation:
        """From the covariance (n, n) of the values; one without variance is independent of the others."""
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        scale = np.where(sigma > 0.0, sigma, np.inf)
        matrix = np.clip(covariance / np.outer(scale, scale), -1.0, 1.0)
        return cls(tuple(names), tuple(tuple(row[:k].tolist()) for k, row in enumerate(matrix)))

    def matrix(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(m, m) for the values of these names, in their order."""
        out = np.eye(len(names))
        place = {name: k for k, name in enumerate(names)}
        for name, row in zip(self.names, self.rows, strict=True):
            for other, value in zip(self.names, row, strict=False):
                if name in place and other in place:
                    out[place[name], place[other]] = out[place[other], place[name]] = value
        return out

    def table(self) -> tomlkit.items.Table:
        """What a model file has of it."""
        table = tomlkit.table()
        for name, row in zip(self.names, self.rows, strict=True):
            table[name] = list(row)
        return table


def read_correlation(table: Table) -> Correlation:
    """The correlations of a table with one key for each value. Errors: ZygosError for what no errors can have."""
    names = tuple(table.names())
    rows = tuple(
        table.vector(
            name, "Correlations of this base parameter or effect with those of the keys before it.", k, limit=1.0
        )
        for k, name in enumerate(names)
    )
    table.finish()
    found = Correlation(names, rows)
    least = float(np.linalg.eigvalsh(found.matrix(names))[0]) if names else 0.0
    if least < -1e-6 * len(names):
        raise table.error(names[-1], "the correlations contradict each other", "remove [correlation], or write it anew")
    return found

# SPDX-License-Identifier: MIT
"""The shapes of the laws that were named, between those of the catalogue's grid, and what is open in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.gap.ground.candidates import Candidate
from zygos.gap.ground.columns import Layout, Table, table_of
from zygos.gap.ground.fit import Fit, fit, residual
from zygos.gap.ground.search import Search, Tried, search
from zygos.ground.twin import predicted_load
from zygos.model.model import Model

Floats = NDArray[np.float64]


def with_best_shapes(
    simulation: Model, table: Table, found: Search, values: Floats, step: Callable[[str], None]
) -> tuple[Table, Search]:
    """The sums and the search with the shapes that leave least, each with a neighbour that is held; as they are where
    no law that was named has a shape. values: of the parameters, by which the load of the joints is predicted."""
    shaped = [one.candidate for one in found.named if _has_shape(one.candidate)]
    if not shaped:
        return table, found
    loads = [predicted_load(rows.motion, values) for rows in table.rows]
    best = {one.name: one for one in shaped}
    for distance in limits.SHAPE_STEPS.value:
        for one in shaped:
            best[one.name] = _best(simulation, table, found, loads, best, one.name, distance)
    listed = [best.get(one.name, one) for one in table.layout.candidates]
    listed += [_shaped(one, _shape(one) * limits.NEIGHBOUR.value) for one in best.values()]
    there = table_of(_layout(simulation, table, listed), [rows.motion for rows in table.rows], table.span_s, loads)
    named = tuple(replace(one, candidate=best.get(one.name, one.candidate)) for one in found.named)
    sets = tuple(tuple(best[name].name if name in best else name for name in names) for names in found.sets)
    return there, search(there, step, replace(found, named=named, sets=sets))


def open_shapes(table: Table, named: Sequence[Tried]) -> list[tuple[int, int]]:
    """Places of the columns of laws with a shape, and of their neighbours."""
    names = set(table.layout.names)
    out = []
    for one in named:
        if _has_shape(one.candidate):
            other = _shaped(one.candidate, _shape(one.candidate) * limits.NEIGHBOUR.value).name
            if other in names:
                out.append((table.layout.at(one.name), table.layout.at(other)))
    return out


def _has_shape(one: Candidate) -> bool:
    return one.effect is not None and one.effect.shape is not None and one.effect.kind.shape_varies


def _shape(one: Candidate) -> float:
    assert one.effect is not None
    assert one.effect.shape is not None
    return one.effect.shape


def _shaped(one: Candidate, shape: float) -> Candidate:
    """The candidate with another shape."""
    assert one.effect is not None
    rounded = float(f"{shape:.4g}")
    return replace(one, name=f"{one.name.partition('@')[0]}@{rounded:g}", effect=replace(one.effect, shape=rounded))


def _layout(simulation: Model, table: Table, listed: Sequence[Candidate]) -> Layout:
    return Layout.of(table.layout.arm, simulation, listed, table.layout.runs)


def _best(
    simulation: Model,
    table: Table,
    found: Search,
    loads: Sequence[Floats],
    best: dict[str, Candidate],
    name: str,
    distance: float,
) -> Candidate:
    """The candidate with that of a finer grid about its shape which leaves least. loads: as of `table_of`. best: what
    stands for each name."""
    one = best[name]
    assert one.effect is not None
    grid = one.effect.kind.shapes
    ratio = grid[1] / grid[0]
    finer = [_shaped(one, _shape(one) * ratio ** (k * distance)) for k in range(-3, 4)]
    others = [best.get(other.name, other.candidate) for other in found.named if other.name != name]
    others += found.unnamed(table.layout)
    there = table_of(
        _layout(simulation, table, [*others, *finer]), [rows.motion for rows in table.rows], table.span_s, loads
    )
    layout = there.layout
    held = [*layout.basis, *(layout.at(other.name) for other in others)]

    def left(tried: Candidate) -> float:
        fitted: Fit = fit(there, [*held, layout.at(tried.name)])
        return float(np.sum(residual(there, fitted.x) / there.floor**2))

    return min(finer, key=left)

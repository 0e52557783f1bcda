# SPDX-License-Identifier: MIT
"""What passes for an effect because smoother and quadrature err alike in all runs: the twin of the model that was found
shows it as well."""

from __future__ import annotations

from zygos import limits
from zygos.gap.ground.columns import Layout, Table, table_of
from zygos.gap.ground.fit import fit
from zygos.gap.ground.predictions import Stage
from zygos.gap.ground.search import Search, is_gain, without
from zygos.ground.twin import Twins, acting_of, predicted_load
from zygos.model.model import Model


def confirmed(simulation: Model, table: Table, found: Search, model: Stage, known: Twins) -> Search:
    """The search without what the twin of its model shows half as large beyond what acts there. model: with what was
    found.

    The errors do not depend on what acts beside, so that one twin tells of all. Gains are found together or not at all.
    """
    if not found.named:
        return found
    places = {one.name: table.layout.at(one.name) for one in found.named if not is_gain(one.candidate)}
    free = set(found.free(table.layout))
    kept = [one for one in table.layout.candidates if table.layout.at(one.name) in free]
    layout = Layout.of(table.layout.arm, simulation, kept, table.layout.runs)
    twins = [known.of(rows.motion, model.values, model.effects) for rows in table.rows]
    there = table_of(layout, twins, table.span_s, [predicted_load(twin, model.values) for twin in twins])
    shared = [layout.at(table.layout.names[k]) for k in found.after.free if k < table.layout.shared]
    again = fit(there, [*shared, *range(layout.shared, layout.width - 1)])
    acts = {effect.column(layout.arm) for effect in acting_of(model.effects)} | set(layout.arm.parameter_names)
    left_out = []
    for name, place in places.items():
        size = float(found.after.x[place])
        acting = size if name.partition("@")[0] in acts else 0.0
        if abs(float(again.x[layout.at(name)]) - acting) > limits.BIAS.value * abs(size):
            left_out.append(name)
    return without(table, found, left_out) if left_out else found

# SPDX-License-Identifier: MIT
"""What the form of a law leaves open of its size, as `zygos.gap.form` has it, from the rows of joints.

The size by least squares of the torque is compared with that by least squares of the increments. Smoother and
quadrature err near reversals; what they make of the twin of the model is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos.balances.state import State
from zygos.effects import Motion as JointMotion
from zygos.gap.ground.candidates import Candidate
from zygos.gap.ground.columns import Layout, Table, table_of
from zygos.gap.ground.fit import fit, jackknife, unknown
from zygos.gap.ground.predictions import Stage
from zygos.gap.ground.search import Search, is_gain
from zygos.gap.parts import Part, acted_on, parts_of
from zygos.ground.motion import Motion
from zygos.ground.twin import Twins, predicted_load
from zygos.model.model import Model

Floats = NDArray[np.float64]


def form_sigmas(simulation: Model, table: Table, found: Search, model: Stage, known_twins: Twins) -> dict[str, float]:
    """Standard deviation of the coefficient of each named law by what its form leaves open. model: with what was
    found."""
    motions = [rows.motion for rows in table.rows]
    listed = [one.candidate for one in found.named]
    laws = [one for one in listed if one.effect is not None and one.effect.kind.law is not None and not is_gain(one)]
    if not laws:
        return {}
    twins = [known_twins.of(motion, model.values, model.effects) for motion in motions]
    loads = [[predicted_load(motion, model.values) for motion in of] for of in (motions, twins)]
    parted = [_Parted.of(law, _parts(law, motions, loads[0])) for law in laws]
    known = [
        (one.name, abs(float(found.after.x[table.layout.at(own.law.name)]))) for own in parted for one in own.columns
    ]
    beside = found.unnamed(table.layout)
    columns = [*listed, *beside, *(one for own in parted for one in own.columns)]
    layout = replace(Layout.of(table.layout.arm, simulation, columns, len(motions)), known=tuple(known))
    measured, null = (
        table_of(layout, of, table.span_s, load) for of, load in zip((motions, twins), loads, strict=True)
    )
    named = [one.name for one in (*listed, *beside)]
    return {own.law.name: own.sigma(measured, null, named) for own in parted}


def _parts(law: Candidate, motions: Sequence[Motion], loads: Sequence[Floats]) -> list[Part]:
    assert law.effect is not None
    torque, size = [], []
    for motion, load in zip(motions, loads, strict=True):
        arm, kept = motion.arm, motion.smoothed.accepted
        state = State.smoothed(arm, motion.smoothed)
        there = JointMotion(
            rate=state.qd[:, law.joint],
            angle=state.q[:, law.joint],
            load=load[:, law.joint],
            ratio=float(arm.gear_ratios[law.joint]),
        )
        acted = acted_on(law.effect.kind, there)
        torque.append(np.broadcast_to(law.effect.law(there, arm.period_s), acted.shape)[kept])
        size.append(acted[kept])
    return parts_of(law.effect.kind, np.concatenate(torque), np.concatenate(size))


@dataclass(frozen=True)
class _Parted:
    """A law and its parts."""

    law: Candidate
    parts: tuple[Part, ...]
    columns: tuple[Candidate, ...]
    """Of the parts."""

    @classmethod
    def of(cls, law: Candidate, parts: Sequence[Part]) -> _Parted:
        """The columns of parts of a law."""
        assert law.effect is not None
        effects = [replace(law.effect, kind=part.kind) for part in parts]
        listed = [
            replace(law, name=f"{part.kind.key}{law.joint + 1}", key=part.kind.key, effect=effect)
            for part, effect in zip(parts, effects, strict=True)
        ]
        return cls(law, tuple(parts), tuple(listed))

    def sigma(self, measured: Table, null: Table, named: Sequence[str]) -> float:
        """How far the size by least squares of the torque is from the coefficient, and how well that is known."""
        layout = measured.layout
        plain = [*layout.basis, *(layout.at(name) for name in named)]
        wider = [*plain, *(layout.at(one.name) for one in self.columns)]
        at = layout.at(self.law.name)
        mix = np.zeros((2, layout.width - 1))
        mix[0, at] = 1.0
        for part, one in zip(self.parts, self.columns, strict=True):
            mix[int(part.lags), layout.at(one.name)] = part.share
        moved = []
        for table in (measured, null):
            moved.append(mix @ fit(table, wider).x - [fit(table, plain).x[at], 0.0])
        fitted = fit(measured, wider)
        scatter, alone = jackknife(measured, fitted)[0], jackknife(measured, fit(measured, plain))[0]
        off, own = moved[0] - moved[1], mix[:, fitted.free]
        # what noise does to the coefficient itself is known otherwise
        noise = np.diagonal(own @ scatter @ own.T) - [alone[plain.index(at), plain.index(at)], 0.0]
        hidden = own @ unknown(measured, fitted) @ own.T
        return float(np.sqrt(off @ off + np.maximum(noise, 0.0).sum() + np.trace(hidden)))

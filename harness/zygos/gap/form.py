# SPDX-License-Identifier: MIT
"""What the form of a law leaves open of its size.

A coefficient is the size of its column that suits the rows best. Where the law of the arm is exactly that of the
column, other rows give the same size. Where it is not, all arcs and all runs may agree on a size that is not that of
the torque: rows of energy hardly see what a friction does near rest. Two questions show it:

- Which part of the law has which size? Columns of its `Part`s are fitted beside it, each held to 0 within the size of
  the law itself, so that one that no row sees stays as unknown as that. Least squares of the torque weight the parts by
  its square.
- Which balance says what? The size is fitted without each of the balances.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import Undecided
from zygos.gap.balances import Acting, Sums, law_along
from zygos.gap.fit import fit, held
from zygos.gap.parts import Part, parts_of
from zygos.gap.study import Study, base_values, laid_out

Array = NDArray[np.float64]


def form_sigma(study: Study, name: str) -> float:
    """Standard deviation of the coefficient of a named effect by what its form leaves open."""
    return float(np.hypot(_of_parts(study, name), _of_balances(study, name)))


def _of_parts(study: Study, name: str) -> float:
    """How far the size by least squares of the torque is from the coefficient, and how well that is known."""
    one = study.layout.find(name)
    if one.kind.law is None:
        return 0.0
    parts = _parts(study, one)
    acting = [one._replace(kind=part.kind) for part in parts]
    named = [study.layout.find(effect) for effect in study.hypothesis.effects]
    own = (*study.layout.own, *named, *acting)
    there = laid_out(study, replace(study.layout, wide=False, own=tuple(dict.fromkeys(own))))
    plain = there.hypothesis
    wider = replace(plain, effects=(*plain.effects, *(part.name for part in acting)))
    at = plain.names.index(name)
    size = abs(float(study.value[at]))
    known = {part.name: size for part in acting}
    # the size by least squares of the torque, and what lags
    mix = np.zeros((2, len(wider.names)))
    mix[0, at] = 1.0
    for part, its in zip(parts, acting, strict=True):
        mix[int(part.lags), wider.names.index(its.name)] = part.share

    def moved(runs: Sequence[Sums]) -> tuple[Array, float]:
        value, unknown = held(wider, runs, study.weight, known)
        alone, _ = held(plain, runs, study.weight, {})
        return mix @ value - [alone[at], 0.0], float(np.trace(mix @ unknown @ mix.T))

    found, unknown = moved(there.sums)
    readings = range(len(there.twin_sums[0].gram[0]))
    drawn = np.array([moved([one.reading(k) for one in there.twin_sums])[0] for k in readings])
    off = found - drawn.mean(axis=0)
    return float(np.sqrt(off @ off + drawn.var(axis=0, ddof=1).sum() + unknown))


def _parts(study: Study, one: Acting) -> list[Part]:
    values = base_values(study.model, study.layout)
    along = [law_along(study.layout, one, record.readings(), values) for record in study.records]
    torque, size = (
        np.concatenate([signals[k][kept] for signals, kept in zip(along, study.accepted, strict=True)]) for k in (0, 1)
    )
    return parts_of(one.kind, torque, size)


def _of_balances(study: Study, name: str) -> float:
    """The most that a coefficient moves when a balance is left out, beyond what noise makes it move."""
    hypothesis = study.hypothesis
    whole = study.fit.of(name) - study.of_twin(hypothesis).of(name)
    most = 0.0
    for balance in hypothesis.balances:
        weight = study.weight.copy()
        weight[balance] *= limits.LEFT_OUT.value
        with suppress(Undecided):
            moved = fit(hypothesis, study.sums, weight).of(name) - fit(hypothesis, study.twin_sums, weight).of(name)
            by = moved - whole
            if abs(by.mean()) > limits.DIFFERS_Z.value * by.std(ddof=1):
                most = max(most, float(np.sqrt(by.mean() ** 2 - by.var(ddof=1))))
    return most

"""What the form of a law leaves open of its size.

A coefficient is the size of its column that suits the rows best. Where the law of the arm is exactly that of the
column, other rows give the same size. Where it is not, all arcs and all runs may agree on a size that is not that of
the torque: rows of energy hardly see what a friction does near rest. Two questions show it:

- Which part of the law has which size? Columns of parts of the law are fitted beside it: of the strata of what it acts
  on, and of what lags behind it, as a hysteresis does. Each part is held to 0 within the size of the law itself, so
  that one that no row sees stays as unknown as that. Least squares of the torque weight the parts by its square.
- Which balance says what? The size is fitted without each of the balances.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from zygos.effects import Kind, Motion
from zygos.errors import Undecided
from zygos.gap.balances import Acting, Sums, acted_on, law_along
from zygos.gap.findings import DIFFERS
from zygos.gap.fit import fit, held
from zygos.gap.study import Study, base_values, laid_out

Array = NDArray[np.float64]

_STRATA = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)
"""Shares of the square of the law's torque up to which the strata reach: time near rest is short, and rows see little
of it."""
_REVERSAL = 1 / 16
"""The share in which what lags behind the law is looked at: there a hysteresis differs most from a law without one."""
_LEFT_OUT = 1e-3
"""Weight of a balance that is left out."""


def form_sigma(study: Study, name: str) -> float:
    """Standard deviation of the coefficient of a named effect by what its form leaves open."""
    return float(np.hypot(_of_parts(study, name), _of_balances(study, name)))


@dataclass(frozen=True)
class _Part:
    acting: Acting
    share: float
    """Of the square of the law's torque."""
    lags: bool


def _of_parts(study: Study, name: str) -> float:
    """How far the size by least squares of the torque is from the coefficient, and how well that is known."""
    one = study.layout.find(name)
    if one.kind.law is None:
        return 0.0
    parts = [*_parts(study, one)]
    named = [study.layout.find(effect) for effect in study.hypothesis.effects]
    own = (*study.layout.own, *named, *(part.acting for part in parts))
    there = laid_out(study, replace(study.layout, wide=False, own=tuple(dict.fromkeys(own))))
    plain = there.hypothesis
    wider = replace(plain, effects=(*plain.effects, *(part.acting.name for part in parts)))
    at = plain.names.index(name)
    size = abs(float(study.value[at]))
    known = {part.acting.name: size for part in parts}
    # the size by least squares of the torque, and what lags
    mix = np.zeros((2, len(wider.names)))
    mix[0, at] = 1.0
    for part in parts:
        mix[int(part.lags), wider.names.index(part.acting.name)] = part.share

    def moved(runs: Sequence[Sums]) -> tuple[Array, float]:
        value, unknown = held(wider, runs, study.weight, known)
        alone, _ = held(plain, runs, study.weight, {})
        return mix @ value - [alone[at], 0.0], float(np.trace(mix @ unknown @ mix.T))

    found, unknown = moved(there.sums)
    readings = range(len(there.twin_sums[0].gram[0]))
    drawn = np.array([moved([one.reading(k) for one in there.twin_sums])[0] for k in readings])
    off = found - drawn.mean(axis=0)
    return float(np.sqrt(off @ off + drawn.var(axis=0, ddof=1).sum() + unknown))


def _parts(study: Study, one: Acting) -> Iterator[_Part]:
    """Parts of a law: its strata, and what lags behind it."""
    values = base_values(study.model, study.layout)
    along = [law_along(study.layout, one, record.readings(), values) for record in study.records]
    kept = study.accepted
    square = np.concatenate([torque[own] ** 2 for (torque, _), own in zip(along, kept, strict=True)])
    size = np.concatenate([acted[own] for (_, acted), own in zip(along, kept, strict=True)])
    order = np.argsort(size)
    grown = np.cumsum(square[order])

    def below(share: float) -> float:
        return float(size[order][np.searchsorted(grown, share * grown[-1])])

    def part(kind: Kind, low: float, high: float, lags: bool) -> _Part:
        share = float(square[(size >= low) & (size < high)].sum() / grown[-1])
        return _Part(one._replace(kind=kind), share, lags)

    edges = [0.0, *map(below, _STRATA)]
    for k, (low, high) in enumerate(pairwise(edges)):
        if low < high:
            yield part(_cut(one.kind, f"stratum{'abcdef'[k]}", low, high), low, high, lags=False)
    high = below(_REVERSAL)
    if high > 0.0:
        yield part(_cut(one.kind, "lagging", 0.0, high, lags=True), 0.0, high, lags=True)


def _cut(kind: Kind, name: str, low: float, high: float, *, lags: bool = False) -> Kind:
    """The entry with its law where what it acts on lies between two sizes. lags: with the sign of its growth, which
    turns where what it acts on does: behind the law by a quarter of a turn."""
    law = kind.law
    assert law is not None

    def cut(motion: Motion, shape: float) -> Array:
        size = acted_on(kind, motion)
        sign = -np.sign(np.gradient(size, axis=-1)) if lags else 1.0
        return np.asarray(law(motion, shape) * ((size >= low) & (size < high)) * sign, dtype=np.float64)

    return replace(kind, key=f"{kind.key}_{name}", law=cut, potential=None, impulse=None, viscous=False, positive=False)


def _of_balances(study: Study, name: str) -> float:
    """The most that a coefficient moves when a balance is left out, beyond what noise makes it move."""
    hypothesis = study.hypothesis
    whole = study.fit.of(name) - study.of_twin(hypothesis).of(name)
    most = 0.0
    for balance in hypothesis.balances:
        weight = study.weight.copy()
        weight[balance] *= _LEFT_OUT
        with suppress(Undecided):
            moved = fit(hypothesis, study.sums, weight).of(name) - fit(hypothesis, study.twin_sums, weight).of(name)
            by = moved - whole
            if abs(by.mean()) > DIFFERS * by.std(ddof=1):
                most = max(most, float(np.sqrt(by.mean() ** 2 - by.var(ddof=1))))
    return most

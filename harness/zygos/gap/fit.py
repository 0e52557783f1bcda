# SPDX-License-Identifier: MIT
"""Least squares over several runs and balances at once, from their sums.

A hypothesis says which columns have a coefficient: base parameters that the model knows, effects that it carries. All
runs and balances share the coefficients; each balance is weighted by its noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.arm import Parameter
from zygos.effects import CATALOGUE, column_name
from zygos.errors import Undecided
from zygos.gap.balances import Layout, Sums

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hypothesis:
    """Which equations are taken to hold."""

    layout: Layout
    rigid: tuple[bool, ...]
    """Joints without flexibility: theta = q, no stiffness and no damping, hence no motor balance."""
    uncoupled: tuple[bool, ...]
    """Joints whose rotor does not feel the carrying body turn, nor acts on it."""
    momentum: float | None
    """Angular momentum taken as known, Nms; None: each arc has its own."""
    effects: tuple[str, ...] = ()
    """Columns of the catalogue that have a coefficient of their own."""
    without: tuple[str, ...] = ()
    """Keys of entries that are not to be added."""

    @property
    def names(self) -> tuple[str, ...]:
        """The coefficients that all runs share: base parameters in the arm's order, then effects."""
        return (*(one.name for one in self.parameters), *self.effects)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The base parameters in the arm's order; a rigid joint has neither stiffness nor damping."""
        return tuple(
            one
            for one in self.layout.arm.parameters
            if one.joint is None or one.symbol == "Im" or not self.rigid[one.joint]
        )

    @property
    def balances(self) -> tuple[int, ...]:
        """The balances that can be drawn up: none at the motor of a joint that could bend, but is taken as rigid."""
        names = self.layout.balances
        gone = {f"M{i + 1}" for i, rigid in enumerate(self.rigid) if rigid}
        return tuple(k for k, name in enumerate(names) if name not in gone)

    @property
    def uncentred(self) -> tuple[int, ...]:
        """The balances without a constant of each arc: those of a momentum that is taken as known, and that no torque
        on the base changes."""
        acting = [self.layout.find(name).kind for name in self.effects]
        pushed = any(kind.place == "field" or (kind.place == "base" and kind.law is not None) for kind in acting)
        momenta = self.layout.momenta if self.momentum is not None and not pushed else ()
        return tuple(self.layout.balances.index(name) for name in momenta)

    def basis(self, target: str = "") -> Array:
        """(columns + 1, zeros + coefficients + 1): what each run's zeros of the sensors, each coefficient and the
        right side consist of. With `target` that column takes the right side's place."""
        columns, zeros = self.layout.columns, self.layout.zeros
        out = np.zeros((len(columns) + 1, len(zeros) + len(self.names) + 1))
        at = self.layout.index
        for k, name in enumerate((*zeros, *self.names)):
            out[at[name], k] = 1.0
        for k, one in enumerate(self.parameters, start=len(zeros)):
            if one.symbol == "Im" and one.joint is not None and self.uncoupled[one.joint]:
                # of the rotor its own share alone
                out[at[column_name(CATALOGUE["rotor_coupling"], one.joint)], k] = -1.0
        if target:
            out[at[target], -1] = 1.0
            return out
        out[-1, -1] = 1.0
        if self.momentum is not None and "angular_momentum" not in self.effects:
            out[at["angular_momentum"], -1] = -self.momentum
        return out


@dataclass(frozen=True)
class Fit:
    """Coefficients of a hypothesis and what they leave over."""

    names: tuple[str, ...]
    value: Array
    """(..., coefficients)"""
    zeros: Array
    """(..., runs, zeros) of the sensors, rad and rad/s, in the order of the layout; what is not seen stays 0."""
    rms: Array
    """(..., runs, balances) what is left over of each balance, in its unit; NaN where it was not used."""

    def of(self, name: str) -> Array:
        """(...) the coefficient of that name."""
        return np.asarray(self.value[..., self.names.index(name)], dtype=np.float64)


def fit(
    hypothesis: Hypothesis,
    runs: Sequence[Sums],
    weight: Array,
    fixed: Array | None = None,
    target: str = "",
    alone: int | None = None,
) -> Fit:
    """Fit all runs together. weight: (balances,) 1/noise of each balance.

    Coefficients are shared; the zeros of the sensors, which a restart may shift, belong to a run and are held by what
    the arm file knows of them. With `fixed` (coefficients,) only they are fitted. With `target` it is that column which
    is to be explained. With `alone` one balance stands by itself, and what it does not see is 0. Leading axes of the
    sums (draws of a twin) are kept. Errors: Undecided where the motion does not tell the coefficients apart.
    """
    used = list(hypothesis.balances) if alone is None else [alone]
    bases = {k: _Basis.of(hypothesis, k, target) for k in used}
    zeros = len(hypothesis.layout.zeros)
    size = zeros + len(hypothesis.names) + 1
    parts = [[bases[k].of_gram(run.gram[k]) for k in used] for run in runs]
    settled: list[Array] = []
    total = np.zeros(())
    for run, part in zip(runs, parts, strict=True):
        whole = np.zeros((*part[0].shape[:-2], size, size))
        for k, own in zip(used, part, strict=True):
            # noise in the columns would pull every coefficient towards zero; what it leaves over is looked at all the
            # same
            clean = own if run.noise is None else own - bases[k].of_gram(run.noise[k])
            at = bases[k].places
            whole[..., at[:, None], at] += weight[k] ** 2 * clean
        rest, settle = without_zeros(hypothesis.layout, whole, run.applied)
        settled.append(settle)
        total = total + rest
    if fixed is None:
        value = _solve(total, hypothesis.names, blind=alone is not None)
    else:
        value = np.broadcast_to(fixed, (*total.shape[:-2], len(fixed)))
    lead = value.shape[:-1]
    shared = np.concatenate([value, -np.ones((*lead, 1))], axis=-1)
    rms = np.full((*lead, len(runs), len(hypothesis.layout.balances)), np.nan)
    found = np.empty((*lead, len(runs), zeros))
    for k, (run, part, settle) in enumerate(zip(runs, parts, settled, strict=True)):
        found[..., k, :] = -(settle @ shared[..., None])[..., 0]
        full = np.concatenate([found[..., k, :], shared], axis=-1)
        for balance, one in zip(used, part, strict=True):
            own = full[..., bases[balance].places]
            square = (own[..., None, :] @ one @ own[..., None])[..., 0, 0]
            rms[..., k, balance] = np.sqrt(np.maximum(square, 0.0) / run.count[balance])
    return Fit(hypothesis.names, value, found, rms)


def shares_of_pairs(hypothesis: Hypothesis, runs: Sequence[Sums], weight: Array, names: Sequence[str]) -> Array:
    """(C, C) share of what a hypothesis leaves over beyond noise that each two of C columns take away together, over
    all runs and balances; on the diagonal that of one alone."""
    wider = replace(hypothesis, effects=(*hypothesis.effects, *names))
    count = len(hypothesis.names)
    total, _ = _normal(wider, runs, weight)
    scale = np.sqrt(np.maximum(np.diagonal(total), 1e-300))
    total = total / np.outer(scale, scale)
    rest = total[count:, count:] - total[count:, :count] @ np.linalg.solve(total[:count, :count], total[:count, count:])
    gram, right = rest[:-1, :-1], rest[:-1, -1]
    own = np.diagonal(gram)
    seen = own > limits.TOLD_APART.value
    alone = np.where(seen, right**2 / np.where(seen, own, 1.0), 0.0)
    product = np.outer(own, own)
    apart = np.outer(seen, seen) & (product - gram**2 > limits.TOLD_APART.value * product)
    both = right[:, None] ** 2 * own + right**2 * own[:, None] - 2.0 * np.outer(right, right) * gram
    taken = np.where(apart, both / np.where(apart, product - gram**2, 1.0), np.maximum(alone[:, None], alone))
    return np.asarray(taken / rest[-1, -1], dtype=np.float64)


def influence(hypothesis: Hypothesis, runs: Sequence[Sums], weight: Array, name: str) -> list[dict[int, Array]]:
    """For each run and balance (columns + 1,): what a coefficient changes by, per unit of the products of the columns
    and of what is left over. Of sums without leading axes. Errors: as `fit`."""
    whole, settled = _normal(hypothesis, runs, weight)
    total = whole[:-1, :-1]
    scale = np.sqrt(np.maximum(np.diagonal(total), 0.0))
    if not np.all(scale > 0.0) or np.linalg.eigvalsh(total / np.outer(scale, scale))[0] < limits.TOLD_APART.value:
        raise Undecided(f"these runs do not tell {name} from the other coefficients")
    unit = np.zeros(len(total))
    unit[hypothesis.names.index(name)] = 1.0
    row = np.linalg.solve(total / np.outer(scale, scale), unit / scale) / scale
    bases = {k: _Basis.of(hypothesis, k, "") for k in hypothesis.balances}
    out = []
    for own in settled:
        # what is left over lowers the coefficient that would explain it
        full = -np.concatenate([-(own[:, :-1] @ row), row, [0.0]])
        out.append({k: weight[k] ** 2 * (basis.mix @ full[basis.places]) for k, basis in bases.items()})
    return out


def held(hypothesis: Hypothesis, runs: Sequence[Sums], weight: Array, sigma: dict[str, float]) -> tuple[Array, Array]:
    """Coefficients (c,), where some are known beforehand to be 0 to within deviations `sigma`; and what they may be all
    the same adds to the covariance (c, c).

    Noise is not taken off the sums, since less than nothing might be left of a column that is hardly there: it holds
    the coefficients as well. Of sums without leading axes.
    """
    total, _ = _normal(hypothesis, [replace(run, noise=None) for run in runs], weight)
    known = np.array([sigma.get(name, np.inf) for name in hypothesis.names])
    matrix = total[:-1, :-1] + np.diag(known**-2.0)
    scale = np.sqrt(np.maximum(np.diagonal(matrix), 1e-300))
    inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    lost = inverse / known
    return np.asarray(inverse @ total[:-1, -1], dtype=np.float64), np.asarray(lost @ lost.T, dtype=np.float64)


def without_zeros(layout: Layout, whole: Array, applied: Array | None) -> tuple[Array, Array]:
    """Sums (..., c + 1, c + 1) of a run without the zeros of its sensors, which come first in `whole` (..., z + c + 1,
    z + c + 1); and the zeros as functions (..., z, c + 1) of the others and the right side.

    They are held by what the arm file knows of the sum of these and of those that have been taken off before, `applied`
    (z,).
    """
    zeros = len(layout.zeros)
    prior = np.diag(layout.zero_sigma**-2.0)
    across, rest = whole[..., :zeros, zeros:].copy(), whole[..., zeros:, zeros:].copy()
    if applied is not None:
        known = prior @ applied
        across[..., -1] -= known
        rest[..., -1, -1] += applied @ known
    settled = np.asarray(np.linalg.solve(whole[..., :zeros, :zeros] + prior, across), dtype=np.float64)
    return np.asarray(rest - np.swapaxes(across, -1, -2) @ settled, dtype=np.float64), settled


def _normal(hypothesis: Hypothesis, runs: Sequence[Sums], weight: Array) -> tuple[Array, list[Array]]:
    """Normal equations (c + 1, c + 1) of the coefficients and the right side, without the zeros of the sensors; and for
    each run what these are (zeros, c + 1), as functions of them."""
    zeros = len(hypothesis.layout.zeros)
    size = zeros + len(hypothesis.names) + 1
    bases = {k: _Basis.of(hypothesis, k, "") for k in hypothesis.balances}
    total, settled = np.zeros((size - zeros, size - zeros)), []
    for run in runs:
        whole = np.zeros((size, size))
        for k, basis in bases.items():
            clean = run.gram[k] if run.noise is None else run.gram[k] - run.noise[k]
            whole[np.ix_(basis.places, basis.places)] += weight[k] ** 2 * basis.of_gram(clean)
        rest, settle = without_zeros(hypothesis.layout, whole, run.applied)
        settled.append(settle)
        total += rest
    return total, settled


@dataclass(frozen=True)
class _Basis:
    """What the coefficients of a hypothesis are in one balance."""

    places: NDArray[np.int64]
    """Positions of the zeros, coefficients and right side that the balance has."""
    chosen: NDArray[np.int64] | None
    """The columns of the balance that these are; None: they are sums of columns."""
    mix: Array
    """(columns + 1, places) of these sums."""

    @classmethod
    def of(cls, hypothesis: Hypothesis, balance: int, target: str) -> _Basis:
        own = np.append(hypothesis.layout.used[balance], len(hypothesis.layout.columns))
        mix = hypothesis.basis(target)[own]
        places = np.flatnonzero(np.any(mix != 0.0, axis=0))
        mix = mix[:, places]
        single = np.all(np.count_nonzero(mix, axis=0) == 1) and np.all(mix.sum(axis=0) == 1.0)
        return cls(places, np.argmax(mix, axis=0) if single else None, mix)

    def of_gram(self, gram: Array) -> Array:
        """(..., places, places) from sums over the columns of the balance."""
        if self.chosen is not None:
            return np.asarray(gram[..., self.chosen[:, None], self.chosen], dtype=np.float64)
        return np.asarray(self.mix.T @ gram @ self.mix, dtype=np.float64)


def _solve(total: Array, names: Sequence[str], *, blind: bool) -> Array:
    """Solve for the coefficients; the sums are first scaled to a unit diagonal. blind: columns may be empty."""
    scale = np.sqrt(np.maximum(np.einsum("...kk->...k", total[..., :-1, :-1]), 0.0))
    seen = np.reshape(scale > 0.0, (-1, len(names))).all(axis=0)
    if not (blind or seen.all()):
        raise Undecided(
            f"{names[int(np.argmin(seen))]} moves nothing in these runs; remedy: a motion that moves every joint"
        )
    kept = np.flatnonzero(seen)
    matrix, right, scale = total[..., kept[:, None], kept], total[..., kept, -1], scale[..., kept]
    scaled = matrix / (scale[..., :, None] * scale[..., None, :])
    # draws of a twin differ little
    one = scaled.reshape(-1, *scaled.shape[-2:])[0]
    if len(one) and np.min(np.linalg.eigvalsh(one)[0]) < limits.TOLD_APART.value:
        raise Undecided(
            "these runs do not tell the parameters apart (a combination of columns is empty); remedy: a motion that "
            "moves every joint, at different speeds; more of the same motion adds nothing"
        )
    out = np.zeros((*total.shape[:-2], len(names)))
    out[..., kept] = np.linalg.solve(scaled, (right / scale)[..., None])[..., 0] / scale
    return out

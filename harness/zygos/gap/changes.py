# SPDX-License-Identifier: MIT
"""When something changed: a coefficient, or the bodies as a payload changes them, that is another after an instant.

Rows are summed arc by arc. A change multiplies columns by a step from an arc on, so that every candidate and every
instant between two arcs is one small solve. Errors of the sensors are fitted beside it in every run: those that were
found without the change stand for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zygos import limits
from zygos.errors import Undecided
from zygos.gap.balances import balance_rows, kept_rows, thinning
from zygos.gap.fit import Hypothesis, without_zeros
from zygos.gap.study import Study, again, base_values, part_of

Array = NDArray[np.float64]

BODIES = "bodies"
"""Name of a change of all inertial parameters, as a payload makes it."""


@dataclass(frozen=True)
class Change:
    """Coefficients that are others from an instant on."""

    what: str
    """A parameter, a column of the catalogue that was not there before, or `BODIES`."""
    run: int
    """The run (from 0) in which it is first seen."""
    arc: int
    """The arc (from 0) of that run with which it is certain, or which it tears apart."""
    after_s: float
    """Time in that run at which it is there at the latest, s."""
    before_s: float
    """Time until which it is certain that it was not there, s."""
    names: tuple[str, ...]
    """The coefficients that changed."""
    old: Array
    """Their values before; 0 of an effect that was not there."""
    new: Array
    """Their values after it."""
    sigma: Array
    """Standard deviations of the differences."""
    z: float
    """Of the difference of one coefficient; of several the root of their chi square over their number."""
    share: float
    """Share of what was left over beyond noise that it takes away."""
    torn: bool = False
    """Whether the instant lies within that arc, which is neither of before nor of after."""

    @property
    def between(self) -> bool:
        """Whether it happened between two runs."""
        return self.arc == 0 and not self.torn


def settled(study: Study, change: Change, allowed: float) -> tuple[Change, Study, Study | None] | None:
    """The change with values from what was recorded before and after it, the study of what was recorded after it, and
    that of what was recorded before it where that is enough. None where a balance after it leaves more than `allowed`
    times what its twin does: what is left over is no matter of time.

    The arc with which it is first seen, and the one before it, may hold the instant: each is left out where something
    is left over with it, and an arc that is torn apart always.
    Errors: Undecided where too little was recorded after it.
    """
    hypothesis = study.hypothesis
    added = [name for name in change.names if name not in hypothesis.names]
    wider = replace(hypothesis, effects=(*hypothesis.effects, *added))
    if change.what == BODIES and not change.between:
        # what is taken up brings its own momentum, and what is left takes some away
        wider = replace(wider, momentum=None)
    spares = (0,) if change.between else (0, 1)
    later = [_after(study, change, spared) for spared in ((1,) if change.torn else spares)]
    now = _closed(study, wider, later, allowed)
    if now is None:
        return None
    places = [wider.names.index(name) for name in change.names]
    old, sigma = change.old, now.spread[places]
    was: Study | None = None
    parts = [_before(study, change, spared) for spared in spares]
    with suppress(Undecided):
        was = _closed(study, hypothesis, parts, allowed) or again(part_of(study, parts[0], hypothesis), hypothesis)
    if was is not None:
        known = [hypothesis.names.index(n) if n in hypothesis.names else None for n in change.names]
        old = np.array([0.0 if k is None else was.value[k] for k in known])
        sigma = np.hypot(sigma, [0.0 if k is None else was.spread[k] for k in known])
    return replace(change, old=old, new=now.value[places], sigma=sigma), now, was


def _closed(study: Study, hypothesis: Hypothesis, parts: Sequence[list[slice]], allowed: float) -> Study | None:
    """The study of the first of these parts of the runs of which no balance leaves more than `allowed` times what its
    twin does; None where each does. Errors: Undecided where the first does not tell the coefficients apart."""
    for number, arcs in enumerate(parts):
        try:
            few = _approached(part_of(study, arcs, hypothesis), hypothesis, limits.REDRAWN_FAR.value * allowed)
            if np.nanmax(few.excess) > limits.REDRAWN_FAR.value * allowed:
                continue
            found = again(few, hypothesis)
        except Undecided:
            if number == 0:
                raise
            continue
        if np.nanmax(found.excess) <= allowed:
            return found
    return None


def _approached(study: Study, hypothesis: Hypothesis, enough: float) -> Study:
    """The same runs with a twin of their own, again and again while what is left over falls and is not `enough`.

    The twins that are there are of an arm that is neither the one before nor the one after, and so are the values from
    which errors of sensors are judged.
    """
    now = again(study, hypothesis, limits.FEW_DRAWS.value)
    for _ in range(limits.CHANGE_ROUNDS.value):
        most = float(np.nanmax(now.excess))
        if most <= enough:
            break
        then = again(now, hypothesis, limits.FEW_DRAWS.value)
        if np.nanmax(then.excess) > limits.CHANGE_FALLS.value * most:
            break
        now = then
    return now


def _after(study: Study, change: Change, spared: int) -> list[slice]:
    """The arcs of each run after a change, but so many of the first."""
    none, every, runs = slice(0, 0), slice(None), range(len(study.records))
    own = slice(change.arc + spared, None)
    return [own if k == change.run else every if k > change.run else none for k in runs]


def _before(study: Study, change: Change, spared: int) -> list[slice]:
    """The arcs of each run before a change, but so many of the last."""
    none, every, runs = slice(0, 0), slice(None), range(len(study.records))
    own = slice(max(change.arc - spared, 0))
    return [own if k == change.run else every if k < change.run else none for k in runs]


@dataclass(frozen=True)
class _Arc:
    run: int
    number: int
    begin_s: float
    end_s: float
    gram: Array
    """(s + c + 1, s + c + 1) of the errors of the sensors, of all coefficients and candidates, and of the right side,
    weighted."""
    expected: float
    """What noise adds to the sum of squares of the right side."""


def find_change(study: Study, candidates: Sequence[str]) -> Change | None:
    """The change that explains most of what a study leaves over; None where none explains most of it.

    candidates: columns of the catalogue, beside those of the hypothesis, that may have appeared.
    """
    names = [*study.hypothesis.names, *(c for c in candidates if c not in study.hypothesis.names)]
    arcs = [arc for run in range(len(study.records)) for arc in _arcs(study, run, names)]
    if len(arcs) < 2:
        return None
    own = len(study.hypothesis.names)
    total = _stepped(study, arcs, len(arcs))
    naive = np.sqrt(np.diag(np.linalg.pinv(_block(total, range(own)), hermitian=True)))
    # neighbouring rows share their noise; the twin's draws say by how much that widens the deviations
    widened = float(np.median(study.spread / np.maximum(naive, 1e-300)))
    inertial = [k for k, name in enumerate(names) if name in _inertial(study)]
    groups = [(name, [k]) for k, name in enumerate(names)] + [(BODIES, inertial)]
    sought = _Sought(study, arcs, names, groups, widened)
    whole = sought.best(torn=False)
    if whole is not None and whole.closes:
        return whole.change
    torn = sought.best(torn=True)
    if torn is None or (whole is not None and torn.score >= limits.TORN.value * whole.score):
        return None if whole is None else whole.change
    return torn.change


@dataclass(frozen=True)
class _Scored:
    change: Change
    score: float
    """What is left over, and what its columns take away by chance."""
    closes: bool
    """Whether nothing is left over beyond noise."""


@dataclass(frozen=True)
class _Sought:
    """Changes that a study may show, and what they leave over."""

    study: Study
    arcs: Sequence[_Arc]
    names: Sequence[str]
    """All columns of the sums of arcs; the first are those of the hypothesis."""
    groups: Sequence[tuple[str, Sequence[int]]]
    """What may change, and its columns."""
    widened: float
    """Deviations of the coefficients over those of independent rows."""

    def best(self, *, torn: bool) -> _Scored | None:
        """The best change between two arcs, or within an arc that is left out and has others on both sides."""
        cuts = range(1, len(self.arcs) - torn)
        return min((one for cut in cuts for one in self._of(cut, torn)), key=lambda one: one.score, default=None)

    def _of(self, cut: int, torn: bool) -> Iterator[_Scored]:
        """The changes from an arc on that pass all tests."""
        own, count = len(self.study.hypothesis.names), len(self.names)
        kept = [*self.arcs[:cut], *self.arcs[cut + torn :]]
        first = self.arcs[cut]
        floor = sum(arc.expected for arc in kept)
        sums = _stepped(self.study, kept, cut)
        rest = _beside(sums, own)
        left = float(rest[-1, -1])
        excess = left - floor
        if torn and excess <= limits.EXCESS.value * floor:
            # an arc that disagrees with all others, which do not with each other, is no change
            return
        for what, columns in self.groups:
            at = [count - own + k for k in columns]
            delta, over = _solved(rest, at)
            inverse = np.linalg.pinv(_block(rest, at), hermitian=True) * self.widened**2
            square = float(delta @ np.linalg.pinv(inverse, hermitian=True) @ delta)
            z = float(np.sqrt(max(square, 0.0) / len(columns)))
            share = (left - over) / excess if excess > 0.0 else 1.0
            if z < limits.CHANGE_Z.value or (
                excess > limits.EXCESS.value * floor and share < limits.CHANGE_TAKES.value
            ):
                continue
            # what an effect explains that was there all the time is no change
            if columns[0] >= own and _solved(rest, [columns[0] - own])[1] - over < limits.STEP_LEAVES.value * (
                left - over
            ):
                continue
            found = _solved(sums, [*range(own), *(count + k for k in columns)])[0]
            old = np.array([found[k] if k < own else 0.0 for k in columns])
            change = Change(
                what,
                first.run,
                first.number,
                first.end_s,
                (first if torn else self.arcs[cut - 1]).begin_s,
                tuple(self.names[k] for k in columns),
                old,
                old + delta,
                np.sqrt(np.diag(inverse)),
                z,
                float(share),
                torn,
            )
            # each column takes away a little by chance, and what is left out is left over as well
            chance = 2.0 * len(columns) * self.widened**2 * np.log(max(floor / self.widened**2, np.e))
            yield _Scored(
                change, float(over + chance + torn * first.expected), bool(over - floor <= limits.EXCESS.value * floor)
            )


def _inertial(study: Study) -> set[str]:
    return {one.name for one in study.layout.arm.parameters if one.joint is None}


def _arcs(study: Study, run: int, names: Sequence[str]) -> Iterator[_Arc]:
    """Weighted sums of each arc of a run."""
    record, accepted = study.records[run], study.accepted[run]
    arm, layout = record.arm, study.layout
    rows = balance_rows(layout, record.readings(), base_values(study.model, layout), every=thinning(arm))
    wider = replace(
        study.hypothesis, effects=tuple(n for n in names if n not in {p.name for p in layout.arm.parameters})
    )
    order = [wider.names.index(name) for name in names]
    zeros = len(layout.zeros)
    basis = wider.basis()
    mix = np.concatenate([basis[:, :zeros], basis[:, zeros:][:, order], basis[:, -1:]], axis=1)
    expected = study.sums[run].noise
    used = study.hypothesis.balances
    grams = [np.zeros((mix.shape[1], mix.shape[1])) for _ in record.starts]
    expects = [0.0] * len(grams)
    for k in used:
        own, columns = rows.balances[k], layout.used[k]
        kept = kept_rows(own, accepted)
        places = np.append(columns, len(layout.columns))
        z = np.concatenate([own.left, own.right[..., None]], axis=-1) @ mix[places]
        scale = float(study.weight[k] ** 2 * np.mean(study.noise[:, k] ** 2))
        noise = np.zeros_like(grams[0]) if expected is None else mix[places].T @ expected[k] @ mix[places]
        for a, good in enumerate(kept):
            part = z[a][good]
            if own.begin is None and k not in study.hypothesis.uncentred:
                part = part - part.mean(axis=0) if len(part) else part
            share = float(good.sum()) / max(float(kept.sum()), 1.0)
            scaled = study.weight[k] ** 2 * (part.T @ part)
            clean = study.weight[k] ** 2 * share * noise
            # what noise leaves over is looked at all the same
            clean[-1, -1] = 0.0
            grams[a] += scaled - clean
            expects[a] += float(good.sum()) * scale
    for a, start in enumerate(record.starts):
        first = float((record.samples.sync[start] - record.samples.sync[0]) * arm.period_s)
        yield _Arc(run, a, first, first + record.cycles * arm.period_s, grams[a], expects[a])


def _stepped(study: Study, arcs: Sequence[_Arc], cut: int) -> Array:
    """(2c + 1, 2c + 1) sums of all columns, of the same columns from an arc on, and of the right side; the errors of
    each run's sensors are eliminated, held by what the arm file knows of them."""
    zeros = len(study.layout.zeros)
    count = len(arcs[0].gram) - zeros - 1
    size = zeros + 2 * count + 1
    before = np.append(np.arange(zeros + count), size - 1)
    # a column and the same column from an arc on are one in that arc
    after = np.concatenate([np.arange(zeros + count), np.arange(zeros, zeros + count + 1)])
    both = np.zeros((2 * count + 1, 2 * count + 1))
    for run, sums in enumerate(study.sums):
        whole = np.zeros((size, size))
        for number, arc in enumerate(arcs):
            if arc.run == run and number >= cut:
                whole += arc.gram[np.ix_(after, after)]
            elif arc.run == run:
                whole[np.ix_(before, before)] += arc.gram
        both += without_zeros(study.layout, whole, sums.applied)[0]
    return both


def _beside(sums: Array, count: int) -> Array:
    """Sums of all but the first columns, beside these."""
    across = sums[:count, count:]
    return np.asarray(sums[count:, count:] - across.T @ _inverse(sums[:count, :count]) @ across, dtype=np.float64)


def _block(gram: Array, free: Sequence[int]) -> Array:
    return np.asarray(gram[np.ix_(free, free)], dtype=np.float64)


def _inverse(matrix: Array) -> Array:
    """Of sums of columns of any size, whose combinations may be empty."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = np.linalg.pinv(matrix * scale * scale[:, None], rcond=limits.RCOND.value, hermitian=True)
    return np.asarray(scaled * scale * scale[:, None], dtype=np.float64)


def _solved(gram: Array, free: Sequence[int]) -> tuple[Array, float]:
    """Least squares of the right side by the free columns, and the sum of squares that is left over."""
    right = gram[free, -1]
    found = _inverse(_block(gram, free)) @ right
    return np.asarray(found, dtype=np.float64), float(gram[-1, -1] - found @ right)
